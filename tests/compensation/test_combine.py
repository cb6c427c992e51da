"""Old table and successor as one: simulated machines measured with the old table active."""

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet
from metrosep.compensation.combine import combine_tables
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.errors import DataError, SignCheckFailedError, TableError

PM = 1e-12
ROUND = 1e-18
P = np.linspace(0.0, 100e-3, 401)


ROUNDING = 1e-18
"""Of sums of micrometres in m."""


def error(x):
    """Steep on purpose, 120 um with slopes of 2 %, so that the place of the lookup shows."""
    x = np.asarray(x)
    return 100e-6 * np.sin(2 * np.pi * x / 40e-3) + 3e-4 * x + 2e-3 * x * x


def run_machine(command, table=None):
    """Return actual minus commanded position of an axis that looks up at the command."""
    c = 0.0 if table is None else np.interp(command, table.positions, table.forward)
    driven = command + c
    return driven + error(driven) - command


def made(measured, p=P, **options):
    return CompensationTable.from_error(measured, positions=p, **{"axis": "X"} | options)


def test_two_iterations_converge_though_each_measures_ten_percent_too_little():
    """A scale wrong by 10 % leaves 10 %, then 1 %, then 0.1 %."""
    table, left = None, [np.ptp(run_machine(P))]
    for _ in range(3):
        successor = made(lambda p, t=table: 0.9 * run_machine(p, t))
        table = successor if table is None else combine_tables(table, successor)
        left.append(np.ptp(run_machine(P, table)))
    assert left[1] / left[0] == pytest.approx(0.1, rel=0.1, abs=0.0)
    assert left[2] / left[0] == pytest.approx(0.01, rel=0.1, abs=0.0)
    assert left[3] / left[0] < 0.003
    assert table.positions.size == P.size


def test_the_old_table_is_looked_up_at_the_newly_corrected_command():
    """Old a wrong one, new the rest, exactly: the right argument leaves pm, the others 100s of nm."""
    fine = np.linspace(0.0, 100e-3, 4001)
    old = made(lambda x: 0.5 * error(x + 9e-3), fine)
    new = made(lambda p: run_machine(p, old), fine)

    together = combine_tables(old, new)
    inside = P[10:-10]

    def left(c):
        rest = c + error(inside + c) - error(0.0)
        return np.abs(rest).max()

    c_old, c_new = old.correction(inside), new.correction(inside)
    assert left(together.correction(inside)) < 2e-11
    assert left(c_new + old.correction(inside + c_new)) < 2e-11
    assert left(c_new + c_old) > 100e-9
    assert left(c_old + new.correction(inside + c_old)) > 100e-9
    assert together.is_exact_inverse


def test_interpolation_error_covers_the_bends_of_the_old_table():
    """Old bends by 1 % at 50 mm; there new adds 30 um: the bend lies 30 um off, 0.3 um high."""
    old = CompensationTable([0.0, 50e-3, 100e-3], [0.0, 0.0, 5e-4], None, "X", "X", 0.0)
    new = CompensationTable(
        [0.0, 10e-3, 100e-3], [0.0, 30e-6, 30e-6], None, "X", "X", 0.0, interpolation_error=0.0
    )
    together = combine_tables(old, new)
    dense = np.linspace(0.0, 100e-3, 100001)
    truth = new.correction(dense) + old.correction(dense + new.correction(dense))
    worst = np.abs(truth - together.correction(dense)).max()
    assert together.interpolation_error == pytest.approx(0.3e-6, rel=1e-2, abs=0.0)
    assert together.interpolation_error == pytest.approx(worst, rel=1e-2, abs=0.0)


def test_cross_tables_add_on_the_positions_of_both():
    old = CompensationTable([0.0, 0.3, 0.6, 0.9], [0.0, -3e-6, 1e-6, 2e-6], None, "X", "Z", 0.0)
    new = CompensationTable([0.0, 0.1 * 3, 0.75], [0.0, 1e-6, -2e-6], None, "X", "Z", 0.0)
    together = combine_tables(old, new)
    assert together.positions == pytest.approx([0.0, 0.3, 0.6, 0.75, 0.9], abs=PM)
    dense = np.linspace(-0.1, 1.0, 1111)
    assert together.correction(dense) == pytest.approx(
        old.correction(dense) + new.correction(dense), abs=ROUND
    )


def test_each_direction_has_its_own_sum():
    p = np.array([0.0, 0.5, 1.0])
    old = CompensationTable(p, [0.0, 1e-6, 2e-6], [5e-7, 1e-6, 3e-6], "X", "Z", 0.0)
    new = CompensationTable(p, [0.0, -3e-6, 1e-6], [2e-7, 2e-6, 2e-6], "X", "Z", 0.0)
    together = combine_tables(old, new)
    assert together.forward == pytest.approx([0.0, -2e-6, 3e-6], abs=ROUND)
    assert together.reverse == pytest.approx([7e-7, 3e-6, 5e-6], abs=ROUND)


def test_the_raw_error_is_found_again_for_the_dry_run():
    old = made(lambda x: 0.8 * error(x))
    new = made(lambda p: run_machine(p, old))
    together = combine_tables(old, new)
    raw = Profile(np.linspace(0, 100e-3, 2001), error(np.linspace(0, 100e-3, 2001)))

    assert together.verify(together.source).after_pv < 0.01 * np.ptp(raw.z)
    assert together.verify(raw).after_pv < 0.01 * np.ptp(raw.z)
    run = together.source.runs[0]
    assert np.abs(run.z - error(run.x) - (run.z[0] - error(run.x[0]))).max() < 5e-8
    with pytest.raises(SignCheckFailedError):
        together.negated().verify(raw)
    assert not new.verify(Profile(P, -0.1 * np.cos(P))).passed


def test_lookup_source_of_runs_in_both_directions():
    p = np.linspace(0.0, 1.0, 5)
    runs = RunSet([Run(p, 1e-6 * p, run_id="f"), Run(p[::-1], 2e-6 * p[::-1], run_id="r")])
    old = CompensationTable(p, -1e-6 * p, -3e-6 * p, "X", "Z", 0.0)
    new = CompensationTable(p, -1e-6 * p, -2e-6 * p, "X", "Z", 0.0, source=runs)
    raw = combine_tables(old, new).source
    assert raw.runs[0].z == pytest.approx(2e-6 * p, abs=ROUND)
    assert raw.runs[1].z == pytest.approx(5e-6 * p[::-1], abs=ROUND)
    assert combine_tables(old, CompensationTable(p, -1e-6 * p, p, "X", "Z", 0.0)).source is None


def test_where_it_came_from_and_what_it_is_worth():
    old = made(error, source_sha256=("aa", "bb"))
    new = made(lambda p: run_machine(p, old) + 4e-6, source_sha256=("bb", "cc"))
    together = combine_tables(old, new)
    assert together.source_sha256 == ("aa", "bb", "cc")
    assert [s.name for s in together.history] == ["table", "table", "combine"]
    assert together.offset_removed == pytest.approx(
        old.offset_removed + new.offset_removed, abs=ROUND
    )
    assert together.forward[0] == 0.0
    p = np.array([0.0, 1.0])
    sure = CompensationTable(p, p, None, "X", "Z", 0.0, u=[1e-9, 3e-9], removed="line")
    doubtful = CompensationTable(
        np.array([0.0, 0.5, 1.0]), np.zeros(3), None, "X", "Z", 0.0, u=[1.0, 1.0, 1.0]
    )
    assert combine_tables(doubtful, sure).u == pytest.approx([1e-9, 2e-9, 3e-9], abs=ROUND)
    assert combine_tables(doubtful, sure).removed == "line"


def area_error(x, y):
    return 40e-6 * np.sin(x / 10e-3) * np.cos(y / 14e-3) + 2e-4 * x - 3e-4 * y


GX = np.linspace(0.0, 50e-3, 101)
GY = np.linspace(-20e-3, 20e-3, 61)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_maps_converge_in_any_axis(axis):
    def run(x, y, table=None):
        c = 0.0 if table is None else table.correction(x, y)
        x, y = (x + c if axis == "X" else x), (y + c if axis == "Y" else y)
        return c + area_error(x, y)

    options = {"x": GX, "y": GY, "compensates": axis}
    table = CompensationMap.from_error(lambda x, y: 0.9 * run(x, y), **options)
    new = CompensationMap.from_error(lambda x, y: 0.9 * run(x, y, table), **options)
    together = combine_tables(table, new)
    x, y = np.meshgrid(GX[5:-5], GY[5:-5])
    raw, one, two = np.ptp(run(x, y)), np.ptp(run(x, y, table)), np.ptp(run(x, y, together))
    assert one / raw == pytest.approx(0.1, rel=0.15, abs=0.0)
    assert two / raw == pytest.approx(0.01, rel=0.2, abs=0.0)
    assert together.verify().after_pv < 0.03 * raw
    assert together.verify(area_error).after_pv < 0.03 * raw
    assert together.values.shape == (61, 101)


@pytest.mark.parametrize("along", [0, 1])
def test_the_old_map_is_looked_up_at_the_newly_corrected_command(along):
    """Old a wrong one, new the rest: with the lookup at p some 50 nm would stay."""
    axis = "XY"[along]

    def moved(x, y, c):
        return (x + c, y) if along == 0 else (x, y + c)

    def seen(x, y):
        c = old.correction(x, y)
        return c + area_error(*moved(x, y, c))

    options = {"x": GX, "y": GY, "compensates": axis}
    old = CompensationMap.from_error(lambda x, y: 2 * area_error(x + 9e-3, y + 2e-3), **options)
    new = CompensationMap.from_error(seen, **options)
    together = combine_tables(old, new)
    x, y = np.meshgrid(GX[5:-5], GY[5:-5])

    def left(c):
        return np.abs(c + area_error(*moved(x, y, c)) - area_error(0.0, 0.0)).max()

    assert left(together.correction(x, y)) < 2e-12
    assert left(new.correction(x, y) + old.correction(x, y)) > 50e-9


def test_maps_of_other_grids_add_on_both():
    old = CompensationMap([0.0, 1.0], [0.0, 1.0], [[0.0, 1e-6], [2e-6, 5e-6]])
    new = CompensationMap([0.0, 0.5, 1.0], [0.0, 1.0], [[0.0, 3e-6, 0.0], [0.0, 0.0, 1e-6]])
    together = combine_tables(old, new)
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-0.2, 1.2, 100), rng.uniform(-0.2, 1.2, 100)
    assert together.x.tolist() == [0.0, 0.5, 1.0]
    assert together.correction(x, y) == pytest.approx(
        old.correction(x, y) + new.correction(x, y), abs=ROUND
    )
    assert together.history[-1].name == "combine"
    assert together.source is None


def test_ring_of_zeros_stays_one_only_where_both_have_it():
    make = lambda x, border: CompensationMap.from_error(  # noqa: E731
        area_error, x=x, y=GY, border=border
    )
    same = combine_tables(make(GX, "zero"), make(GX, "zero"))
    assert same.border == "zero"
    assert not same.values[0].any()
    assert combine_tables(make(GX, "zero"), make(GX, None)).border is None
    assert combine_tables(make(GX, "zero"), make(GX[:50], "zero")).border is None


def table(**changes):
    fields = {"positions": [0.0, 1.0], "forward": [0.0, 1e-6], "reverse": None, "axis": "X",
              "compensates": "Z", "reference": 0.0}  # fmt: skip
    return CompensationTable(**fields | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": "Y"}, "same axes"),
        ({"compensates": "X"}, "same axes"),
        ({"reference": 1.0, "forward": [1e-6, 0.0]}, "zero of the machine"),
        ({"positions": [2.0, 3.0], "reference": 0.0}, "do not overlap"),
    ],
)
def test_tables_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(TableError, match=message):
        combine_tables(table(), table(**changes))
    with pytest.raises(TableError, match=message):
        combine_tables(table(**changes), table())


def test_one_column_acts_alike_in_both_directions():
    both = table(reverse=[2e-6, 5e-6])
    for old, new in ((table(), both), (both, table())):
        made = combine_tables(old, new)
        np.testing.assert_allclose(made.forward, [0.0, 2e-6], rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(made.reverse, [2e-6, 6e-6], rtol=0, atol=ROUNDING)


def test_maps_that_do_not_fit_are_refused():
    one = CompensationMap([0.0, 1.0], [0.0, 1.0], np.zeros((2, 2)))
    with pytest.raises(TableError, match="same order"):
        combine_tables(one, CompensationMap([0.0, 1.0], [0.0, 1.0], np.zeros((2, 2)), ("Y", "X")))
    with pytest.raises(TableError, match="reference"):
        combine_tables(
            one, CompensationMap([0.0, 1.0], [0.0, 1.0], np.zeros((2, 2)), reference=(0, 1))
        )
    with pytest.raises(TableError, match="overlap"):
        combine_tables(one, CompensationMap([0.0, 1.0], [1.0, 2.0], np.zeros((2, 2))))
    with pytest.raises(DataError, match="CompensationTable and a CompensationMap"):
        combine_tables(table(), one)
    with pytest.raises(DataError, match="list"):
        combine_tables([], [])

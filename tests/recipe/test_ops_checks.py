"""Steps around a separation: each gives what the call gives, and names what was planted."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, MetrosepError, RecipeError
from metrosep.recipe.result import load_document
from metrosep.separation import (
    check_probes,
    evidence_table,
    fit_speed_sweep,
    machine_axis,
    optimise_probe_angles,
    register_points,
)

DRAWN = True

N = 128
ANGLE = 2 * np.pi * np.arange(N) / N
STATED = np.radians([0.0, 20.0, 75.0, 260.0])
TRUE = STATED + np.radians([0.0, 0.0, 1.5, 0.0])
NOISE = 0.2e-9


@pytest.fixture
def table(tmp_path):
    def write(header, rows, name="m.csv"):
        text = [header, *(",".join(_cell(v) for v in row) for row in rows)]
        file = tmp_path / name
        file.write_text("\n".join(text) + "\n", "ascii")
        return file

    return write


def _cell(value):
    return value if isinstance(value, str) else f"{value:.9f}"


def run(text, files, **options):
    return ms.Recipe.parse("metrosep = 1\n" + text).run(files, **options)


def metrics(result):
    return {c["metric"]: c["value"] for c in result.document["characteristics"]}


def four_probes(angles):
    """Return readings of an asymmetric ball that moves in x and y."""
    rng = np.random.default_rng(11)
    ball = [sum(2e-8 / k * np.cos(k * (ANGLE + a) + k * k) for k in range(2, 18)) for a in angles]
    x, y = 3e-8 * np.cos(2 * ANGLE + 0.4), 2e-8 * np.sin(3 * ANGLE)
    m = [b + x * np.cos(a) + y * np.sin(a) for b, a in zip(ball, angles, strict=True)]
    return np.array(m) + NOISE * rng.standard_normal((4, N))


PROBES = """[input]
readings = ["p0_nm", "p1_nm", "p2_nm", "p3_nm"]
angle = "angle_deg"
[[step]]
op = "check_probes"
angles = ["0 deg", "20 deg", "75 deg", "260 deg"]
kmax = 18
u_reading = "0.2 nm"
[[output]]
kind = "parts"
[[output]]
kind = "report"
"""


def probe_table(table, m):
    return table(
        "angle_deg,p0_nm,p1_nm,p2_nm,p3_nm", zip(np.degrees(ANGLE), *(m * 1e9), strict=True)
    )


def test_probe_that_stands_elsewhere_is_named(table, tmp_path):
    m = four_probes(TRUE)
    result = run(PROBES, probe_table(table, m), out=tmp_path / "out")

    called = check_probes(m, STATED, 18, u_reading=NOISE)
    assert result.produced.chi2 == pytest.approx(called.chi2, abs=1e-3 * called.chi2)
    found = metrics(result)
    assert found["probe_2.angle"] == pytest.approx(np.radians(1.5), abs=np.radians(0.1))
    assert found["disagreement"] > 10.0
    document = load_document(tmp_path / "out")
    assert any("probe 2 stands +1.5" in m for m in document["messages"])
    assert document["separation"]["agrees"] is False
    suspects = (tmp_path / "out" / "parts-suspects.csv").read_text().splitlines()
    assert suspects[0] == "probe,fault,angle_deg,sensitivity_excess,chi2"
    assert suspects[1].startswith("2,angle,1.5")
    assert (tmp_path / "out" / "report.html").stat().st_size > 20_000


def test_probes_that_agree_pass_a_limit(table):
    limit = '[[check]]\nmetric = "p"\nlower = 0.002\n'
    result = run(PROBES + limit, probe_table(table, four_probes(STATED)))

    # expectation 1, two standard deviations 2 sqrt(2 / freedom)
    assert abs(metrics(result)["disagreement"] - 1.0) < 5 * np.sqrt(2 / result.produced.freedom)
    assert result.verdict == "accept"
    assert run(PROBES + limit, probe_table(table, four_probes(TRUE))).verdict == "reject"
    assert set(metrics(result)) == {"p", "disagreement"}


def test_three_probes_cannot_be_checked(table):
    text = PROBES.replace(', "p3_nm"', "").replace(', "260 deg"', "")
    with pytest.raises(MetrosepError, match="need >= 4"):
        run(text, probe_table(table, four_probes(STATED)))


CHOICE = """[input]
angle = "probe_deg"
[[step]]
op = "optimise_probe_angles"
n = 4
kmax = 12
min_separation = "15 deg"
"""


def test_probes_are_added_to_those_that_stand(table):
    file = table("probe_deg", [(10.0,), (55.0,)])
    result = run(CHOICE, file)

    called = optimise_probe_angles(
        4, 12, min_separation=np.radians(15), fixed=np.radians([10.0, 55.0])
    )
    np.testing.assert_allclose(result.produced.angles, called.angles, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(np.degrees(called.angles[:2]), [10.0, 55.0], rtol=0.0, atol=1e-9)
    found = metrics(result)
    assert found["gain"] == pytest.approx(called.gain, abs=1e-9)
    assert found["probe_3"] == pytest.approx(called.angles[3], abs=1e-9)
    assert result.document["separation"]["not_seen"] == [0, 1]
    assert any("stand at 10, 55, " in m for m in result.document["messages"])
    gaps = np.diff(np.sort(np.append(called.angles, called.angles.min() + 2 * np.pi)))
    assert gaps.min() > np.radians(15) - 1e-9


def test_no_probe_left_to_place_is_refused(table):
    file = table("probe_deg", [(10.0,), (55.0,), (100.0,), (200.0,)])
    with pytest.raises(DataError, match="none is to be placed"):
        run(CHOICE, file)


EVIDENCE = """[input]
x = "x_mm"
z = "z_um"
feed = "feed_mm_min:mm/min"
time = "t_ms"
run = "run"
[[step]]
op = "evidence_table"
"""


@pytest.fixture
def runs_csv(repository):
    return repository / "examples" / "straightness" / "runs.csv"


def test_evidence_of_the_runs_of_an_example(runs_csv, tmp_path):
    outputs = '[[output]]\nkind = "parts"\n[[output]]\nkind = "report"\n'
    result = run(EVIDENCE + outputs, runs_csv, out=tmp_path / "out")

    called = evidence_table(
        ms.read_runs(
            runs_csv, x="x_mm", z="z_um", feed="feed_mm_min:mm/min", time="t_ms", run="run"
        )
    )
    assert list(result.produced.columns["selected"]) == list(called.columns["selected"])
    np.testing.assert_allclose(result.produced.columns["p"], called.columns["p"], rtol=1e-9)
    found = metrics(result)
    assert found["n_selected"] == sum(called.columns["selected"])
    assert found["shortest"] == pytest.approx(
        1e-3 * min(called.to_frame().query("selected")["wavelength_mm"]), abs=1e-12
    )
    lines = (tmp_path / "out" / "parts.csv").read_text().splitlines()
    assert len(lines) == 1 + len(called.columns["selected"])


def test_evidence_is_of_one_direction(table):
    runs = machine_axis(seed=3).runs
    rows = []
    for i, r in enumerate(runs):
        t, x, z = r.t, r.x, r.z
        if i % 3 == 0:
            x, z = x[::-1], z[::-1]
        rows += [
            (f"r{i}", r.feed * 6e4, a * 1e3, b * 1e3, c * 1e9)
            for a, b, c in zip(t, x, z, strict=True)
        ]
    file = table("run,feed_mm_min,t_ms,x_mm,z_nm", rows)
    text = EVIDENCE.replace("z_um", "z_nm")
    with pytest.raises(DataError, match="both ways"):
        run(text, file)
    one = run(text + 'direction = "forward"\n', file).produced
    assert one.audit["n_runs"] + one.audit["n_runs_left_out"] == sum(
        i % 3 != 0 for i in range(len(runs))
    )


def test_a_run_at_two_feedrates_is_refused(table):
    rows = [("a", 4800.0 + 10 * (i > 20), 1.0 * i, 0.08 * i, 1.0) for i in range(50)]
    file = table("run,feed_mm_min,t_ms,x_mm,z_nm", rows)
    with pytest.raises(InvalidSamplesError, match="run a: its rows have different feedrates"):
        run(EVIDENCE.replace("z_um", "z_nm"), file)


FIDUCIALS = """[input]
x_fixed = "x1_mm"
y_fixed = "y1_mm"
x_moved = "x2_mm"
y_moved = "y2_mm"
[[step]]
op = "register_points"
"""
HEADER = "x1_mm,y1_mm,x2_mm,y2_mm"


def fiducials():
    fixed = np.array([[-10.0, -7.0], [12.0, -6.0], [9.0, 11.0], [-8.0, 5.0]]) * 1e-3
    c, s = np.cos(0.02), np.sin(0.02)
    moved = fixed @ np.array([[c, s], [-s, c]]) + np.array([0.3e-3, -0.1e-3])
    rng = np.random.default_rng(5)
    return fixed, moved + 1e-6 * rng.standard_normal(moved.shape)


def test_marked_points_give_shift_and_turn_with_their_signs(table, tmp_path):
    fixed, moved = fiducials()
    file = table(HEADER, np.column_stack([fixed, moved]) * 1e3)
    text = FIDUCIALS + '[[output]]\nkind = "report"\n'
    found = metrics(run(text, file, out=tmp_path / "out"))

    called = register_points(fixed, moved)
    assert found["angle"] == pytest.approx(0.02, abs=5 * called.u_angle)
    assert found["shift_x"] == pytest.approx(0.3e-3, abs=5e-6)
    assert found["shift_y"] == pytest.approx(-0.1e-3, abs=5e-6)
    assert found["angle"] == pytest.approx(called.angle, abs=1e-9)


def test_a_point_that_was_not_marked_twice_is_refused(table):
    fixed, moved = fiducials()
    moved[2, 0] = np.nan
    with pytest.raises(InvalidSamplesError, match="point 3 of 4 lacks"):
        run(FIDUCIALS, table(HEADER, np.column_stack([fixed, moved]) * 1e3))
    with pytest.raises(MetrosepError, match="two points or more"):
        run(FIDUCIALS, table(HEADER, np.column_stack([fixed, moved])[:1] * 1e3, "one.csv"))


SWEEP = """[input]
speed = "speed_rpm"
readings = ["synchronous_nm", "asynchronous_nm"]
[[step]]
op = "fit_speed_sweep"
speed_unit = "rev/min"
natural_frequency = "105 Hz"
orders = [1, 2, 3]
"""
SPEED = np.arange(5.0, 61.0, 5.0)


def sweep_rows(*, u=()):
    rng = np.random.default_rng(2)
    synchronous = 20.0 + 0.004 * SPEED**2 + 0.2 * rng.standard_normal(SPEED.size)
    synchronous[SPEED == 35.0] += 8.0  # 105 Hz is three times 35 rev/s
    rest = 5.0 + 0.001 * SPEED**2 + 0.1 * rng.standard_normal(SPEED.size)
    columns = [SPEED * 60.0, synchronous, rest, *(np.full(SPEED.size, v) for v in u)]
    return np.column_stack(columns)


def test_sweep_gives_what_the_call_gives_and_names_the_peak(table, tmp_path):
    rows = sweep_rows()
    file = table("speed_rpm,synchronous_nm,asynchronous_nm", rows)
    text = SWEEP + '[[output]]\nkind = "parts"\n[[output]]\nkind = "report"\n'
    result = run(text, file, out=tmp_path / "out")

    called = fit_speed_sweep(
        SPEED,
        {"synchronous": rows[:, 1] * 1e-9, "asynchronous": rows[:, 2] * 1e-9},
        natural_frequency=105.0,
        orders=(1, 2, 3),
    )
    found = metrics(result)
    assert found["synchronous.c2"] == pytest.approx(
        called["synchronous"].coefficients[1], abs=1e-19
    )
    assert found["synchronous.peak"] == pytest.approx(35.0, abs=1e-9)
    assert "asynchronous.peak" not in found
    assert any("met by k=3" in m for m in result.document["messages"])
    lines = (tmp_path / "out" / "parts.csv").read_text().splitlines()
    assert lines[0].startswith("speed_Hz,synchronous_m,u_synchronous_m")
    assert (tmp_path / "out" / "report.html").stat().st_size > 20_000


def test_stated_uncertainties_weigh(table):
    file = table("speed_rpm,synchronous_nm,asynchronous_nm,us_nm,ua_nm", sweep_rows(u=(0.2, 0.1)))
    text = SWEEP.replace("[[step]]", 'u = ["us_nm", "ua_nm"]\n[[step]]')
    fits = run(text, file).produced.fits
    assert fits["asynchronous"].p_fit > 0.01
    assert fits["synchronous"].p_fit < 1e-6  # the resonance is not a polynomial
    with pytest.raises(DataError, match="1 columns of uncertainties for 2"):
        run(text.replace(', "ua_nm"', ""), file)


def test_speed_must_say_per_what(table):
    with pytest.raises(RecipeError, match="speed_unit"):
        ms.Recipe.parse("metrosep = 1\n" + SWEEP.replace('speed_unit = "rev/min"\n', ""))
    file = table("speed_rpm,synchronous_nm,asynchronous_nm", sweep_rows())
    with pytest.raises(MetrosepError, match="rev/s"):
        run(SWEEP.replace('speed_unit = "rev/min"', 'speed_unit = "rev/s"'), file)


def test_names_of_values_are_as_many_and_differ(table):
    file = table("speed_rpm,synchronous_nm,asynchronous_nm", sweep_rows())
    with pytest.raises(DataError, match="different names"):
        run(SWEEP + 'names = ["a", "a"]\n', file)
    assert set(run(SWEEP + 'names = ["a", "b"]\n', file).produced.fits) == {"a", "b"}


def test_evidence_recipe_of_the_example_finds_the_planted_wave(repository):
    found = ms.Recipe.load(repository / "examples" / "straightness" / "evidence.toml").run()

    table = found.produced.to_frame()
    near = table.iloc[(table["wavelength_mm"] - 9.0).abs().argmin()]  # 45 mm / 5
    assert bool(near["selected"])
    assert near["amplitude_nm"] > 200.0

"""Charts of a ranking: what is drawn is what was ranked."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.forms import Plane, Toric
from metrosep.machine.chains import presets
from metrosep.machine.ranking import rank
from metrosep.plot.sensitivity_chart import (
    sensitivity_bars,
    sensitivity_maps,
    sensitivity_pareto,
)

R = 20e-3
TERMS = ("EXX", "EYX", "EZX", "EAX", "EBX", "ECC", "EXC", "EYC", "EAC", "EBC", "B0Z")
ERRORS = {t: "0.001 deg" if t[1] in "ABC" or t == "B0Z" else "1 um" for t in TERMS}


@pytest.fixture(scope="module")
def tables():
    lathe, form = presets("fts_lathe", radius=R), Toric(Rb=0.265, Rd=0.1325)
    return {
        label: rank(lathe, form, radius=R, errors=ERRORS, removed=r, n_rho=40, n_azimuth=72)
        for label, r in (("raw", "none"), ("levelled", "plane"), ("defocused", "plane+defocus"))
    }


def test_bars_hold_the_sq_of_every_variant_in_the_order_of_the_last(tables):
    axes = sensitivity_bars(tables)
    assert len(axes.containers) == 3
    last = tables["defocused"]
    assert [t.get_text().split()[0] for t in axes.get_yticklabels()] == list(last.order)
    for bars, table in zip(axes.containers, tables.values(), strict=True):
        found = np.array([b.get_width() for b in bars])
        sq = np.array([table.sq[table.names.index(n)] for n in last.order]) * 1e9
        shown = np.isfinite(found)
        assert found[shown] == pytest.approx(sq[shown], abs=1e-9)
        assert (sq[~shown] <= 1e-4 * 1000.1).all()
    assert axes.get_xlabel() == "Sq of the vertical deviation / nm"
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # the largest on top


def test_a_term_of_which_nothing_is_left_has_a_zero(tables):
    axes = sensitivity_bars(tables["levelled"])
    assert "0" in [t.get_text() for t in axes.texts]
    assert "tilt_x" in axes.get_title()


def test_groups_are_numbered(tables):
    labels = [t.get_text() for t in sensitivity_bars(tables["levelled"]).get_yticklabels()]
    assert "EXX (1)" in labels
    assert "EBX (1)" in labels
    assert "B0Z" in labels


def test_maps_lie_where_the_part_lies(tables):
    """B0Z is a cone, highest at the rim; EYX rises towards one side only."""
    figure = sensitivity_maps(tables["raw"], ["EZX", "B0Z", "EYX"], aligned=False, columns=2)
    maps = [a for a in figure.axes if a.get_title()]
    assert [a.get_title().split(",")[0] for a in maps] == ["EZX", "B0Z", "EYX"]
    mesh = maps[1].collections[0]
    corners, values = mesh.get_coordinates(), np.asarray(mesh.get_array())
    radius = np.hypot(*np.moveaxis(corners, -1, 0))[:-1, :-1]
    assert radius.max() < 20.0
    cone = -1e9 * np.radians(1e-3) * (R - 1e-3 * (radius + 0.25))
    assert values == pytest.approx(cone, abs=0.5)
    assert "nm" in maps[1].get_title()


def test_default_maps_leave_out_what_is_not_visible(tables):
    titles = [a.get_title() for a in sensitivity_maps(tables["levelled"]).axes if a.get_title()]
    assert len(titles) == 8
    assert titles[0].startswith("B0Z")
    assert not any(t.startswith("EZX") for t in titles)


def test_pareto_falls_from_the_expectation(tables):
    table = tables["levelled"]
    (line,) = sensitivity_pareto(table).lines
    y = line.get_ydata()
    assert y[0] == pytest.approx(1e9 * table.expected_sq, abs=1e-9)
    assert (np.diff(y) <= 0).all()


def test_bad_input_is_refused(tables):
    with pytest.raises(DataError, match="1 to 4"):
        sensitivity_bars({})
    other = rank(
        presets("fts_lathe", radius=R),
        Plane(),
        radius=R,
        errors={"EZX": 1e-6},
        n_rho=9,
        n_azimuth=9,
    )
    with pytest.raises(DataError, match="different terms"):
        sensitivity_bars({"a": tables["raw"], "b": other})
    with pytest.raises(DataError, match="not ranked"):
        sensitivity_maps(tables["raw"], ["EXQ"])
    with pytest.raises(DataError, match="no map"):
        sensitivity_maps(other)
    with pytest.raises(DataError, match="columns"):
        sensitivity_maps(tables["raw"], columns=0)

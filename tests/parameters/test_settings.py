"""Setting classes of ISO 21920-3 and the cutoff rule of ISO 4288."""

import math
from itertools import pairwise

import pytest

from metrosep.core.errors import DataError, NotConvergedError
from metrosep.parameters.profile import (
    SETTING_CLASSES,
    setting_class,
    settle_cutoff,
    suggested_cutoff,
)

UM = 1e-6
MM = 1e-3


@pytest.mark.parametrize(
    ("limit", "name", "nic", "le", "nis", "dx", "tip"),
    [
        (0.005, "Sc1", 0.08, 0.4, 2.5, 0.5, 2),
        (0.02, "Sc1", 0.08, 0.4, 2.5, 0.5, 2),
        (0.1, "Sc2", 0.25, 1.25, 2.5, 0.5, 2),
        (0.11, "Sc3", 0.8, 4, 2.5, 0.5, 2),
        (2, "Sc3", 0.8, 4, 2.5, 0.5, 2),
        (10, "Sc4", 2.5, 12.5, 8, 1.5, 5),
        (10.1, "Sc5", 8, 40, 25, 5, 10),
    ],
)
def test_class_of_an_ra_limit(limit, name, nic, le, nis, dx, tip):
    found = setting_class(Ra=limit * UM)

    assert found.name == name
    assert found.nic == pytest.approx(nic * MM, rel=1e-9, abs=0.0)
    assert found.le == pytest.approx(le * MM, rel=1e-9, abs=0.0)
    assert found.nis == pytest.approx(nis * UM, rel=1e-9, abs=0.0)
    assert found.max_dx == pytest.approx(dx * UM, rel=1e-9, abs=0.0)
    assert found.tip_radius == pytest.approx(tip * UM, rel=1e-9, abs=0.0)


@pytest.mark.parametrize(
    ("limit", "name"),
    [(0.16, "Sc1"), (0.17, "Sc2"), (0.8, "Sc2"), (16, "Sc3"), (80, "Sc4"), (81, "Sc5")],
)
def test_class_of_an_rz_limit(limit, name):
    assert setting_class(Rz=limit * UM).name == name


def test_classes_hang_together():
    for finer, coarser in pairwise(SETTING_CLASSES):
        assert finer.nic < coarser.nic
        assert finer.Ra_max < coarser.Ra_max
    for one in SETTING_CLASSES:
        assert one.le == pytest.approx(one.sections * one.nic, rel=1e-9, abs=0.0)
        assert one.max_dx <= one.nis / 5
        assert "nic" not in one.read  # recalled, and says so


def test_editions_differ_for_the_same_rz():
    assert setting_class(Rz=12 * UM).nic == pytest.approx(0.8 * MM, rel=1e-9, abs=0.0)
    assert suggested_cutoff("Rz", 12 * UM) == pytest.approx(2.5 * MM, rel=1e-9, abs=0.0)


@pytest.mark.parametrize(
    ("symbol", "value", "cutoff"),
    [
        ("Ra", 0.02 * UM, 0.08),
        ("Ra", 3.308 * UM, 2.5),
        ("Rz", 0.5 * UM, 0.25),
        ("Rz", 18.485 * UM, 2.5),
        ("Rz", 200 * UM, 8),
        ("RSm", 0.4199 * MM, 2.5),
        ("RSm", 0.13 * MM, 0.25),
    ],
)
def test_cutoff_after_4288(symbol, value, cutoff):
    assert suggested_cutoff(symbol, value) == pytest.approx(cutoff * MM, rel=1e-9, abs=0.0)


def test_iteration_settles():
    asked = []

    def measure(cutoff):
        asked.append(cutoff)
        return {0.8 * MM: 2.1 * UM, 2.5 * MM: 3.3 * UM}[cutoff]

    assert settle_cutoff("Ra", measure) == pytest.approx(2.5 * MM, rel=1e-9, abs=0.0)
    assert asked == [0.8 * MM, 2.5 * MM]


def test_iteration_that_runs_in_a_circle_raises():
    with pytest.raises(NotConvergedError, match="ask for each other"):
        settle_cutoff("Ra", lambda cutoff: 2.1 * UM if cutoff < MM else 1.9 * UM)


@pytest.mark.parametrize("bad", [0.0, -1e-6, math.nan, math.inf])
def test_bad_limits_raise(bad):
    with pytest.raises(DataError, match="positive and finite"):
        setting_class(Ra=bad)
    with pytest.raises(DataError, match="positive and finite"):
        suggested_cutoff("Rz", bad)


def test_bad_calls_raise():
    with pytest.raises(DataError, match="one parameter"):
        setting_class()
    with pytest.raises(DataError, match="one parameter"):
        setting_class(Ra=1e-6, Rz=1e-6)
    with pytest.raises(DataError, match="Ra, Rz, RSm"):
        suggested_cutoff("Rq", 1e-6)
    with pytest.raises(DataError, match="Ra, Rz, RSm"):
        settle_cutoff("Rq", lambda _: 1e-6)
    with pytest.raises(DataError, match="last entry"):
        suggested_cutoff("Rz", 201 * UM)
    with pytest.raises(DataError, match="one of"):
        settle_cutoff("Ra", lambda _: 1e-6, start=1e-3)


@pytest.mark.parametrize("limit", ["5", True, [1e-6, 2e-6]])
def test_limit_that_is_no_number_is_refused(limit):
    with pytest.raises(DataError, match="Ra"):
        setting_class(Ra=limit)
    with pytest.raises(DataError, match="Rz"):
        suggested_cutoff("Rz", limit)

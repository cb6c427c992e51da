"""Ranking of waves and random curves: numbers of the specification, and curves drawn one by one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from metrosep.core.errors import DataError
from metrosep.forms import Plane
from metrosep.machine import PolynomialTerm, TableTerm, presets, rank

NM = 1e-9
RADIUS = 25e-3


def ranked(**errors):
    return rank(presets("sts_lathe"), Plane(), radius=RADIUS, errors=errors, removed="piston")


def sq(table, name):
    row = table.to_frame().reset_index()
    return float(row.loc[row.iloc[:, 0] == name, "sq_nm"].iloc[0])


@pytest.mark.parametrize(
    ("length", "value"), [("8 mm", 703.689), ("3 mm", 706.607), ("60 mm", 400.954)]
)
def test_a_wave_of_the_slide_on_a_face(length, value):
    # the mesh has 300 rings: the printed values are integrals, 0.002 nm apart
    assert_allclose(sq(ranked(EZX=f"wave {length} 1 um"), "EZX"), value, rtol=0, atol=0.003)


def test_two_undulations_of_the_spindle_are_seen_whole():
    assert_allclose(sq(ranked(EZC="2 upr 50 nm"), "EZC"), 50.0 / np.sqrt(2.0), rtol=1e-6, atol=0)


def test_a_random_curve_is_the_mean_over_curves_that_were_drawn():
    rho = RADIUS * np.sqrt((np.arange(300) + 0.5) / 300)
    covariance = np.exp(-((rho[:, None] - rho) ** 2) / (2 * 5e-3**2)) + 1e-10 * np.eye(rho.size)
    z = np.linalg.cholesky(covariance) @ np.random.default_rng(3).normal(size=(rho.size, 20000))
    drawn = 1000.0 * np.sqrt(np.mean((z - z.mean(axis=0)) ** 2))
    # 20,000 curves of a few correlation lengths each: 0.5 %
    table = ranked(EZX="random 1 um length 5 mm")
    assert_allclose(sq(table, "EZX"), drawn, rtol=0.015, atol=0)
    # of a draw: it lies among the drawn ones (it was that of the longest wave alone, 0.5 nm)
    spans = 1000.0 * np.ptp(z, axis=0)
    low, high = np.quantile(spans, [0.005, 0.995])
    row = table.to_frame().reset_index()
    assert low < float(row["pv_nm"].iloc[0]) < high


def test_waves_add_up_in_squares_and_are_said():
    both = ranked(EZX="wave 8 mm 1 um", EZC="3 upr 1 um")
    total = np.hypot(sq(both, "EZX"), sq(both, "EZC"))
    assert f"expected Sq {total:.1f} nm"[:15] in repr(both)
    assert "EZX: wave 8 mm 1 um over the travel" in " ".join(both.messages)
    assert "constant over the travel" not in " ".join(both.messages)


def test_curves_that_make_no_sense_are_refused():
    with pytest.raises(DataError, match="belong to a rotary axis"):
        ranked(EZX="2 upr 50 nm")
    with pytest.raises(DataError, match="B0Z is a constant"):
        ranked(B0Z="wave 8 mm 1 urad")
    with pytest.raises(DataError):
        ranked(EZX="wave 8 mm")
    with pytest.raises(DataError, match="wavelength of EZX"):
        ranked(EZX="wave 8 kg 1 um")
    with pytest.raises(DataError, match="leave correlations out"):
        rank(
            presets("sts_lathe"), Plane(), radius=RADIUS, errors={"EZX": "wave 8 mm 1 um", "EXX": 1e-6},
            correlations={("EZX", "EXX"): 0.5},
        )  # fmt: skip


def bow(x):
    """A bow of 60 nm at the rim."""
    return 60 * NM * (np.asarray(x) / RADIUS) ** 2


def test_a_known_curve_acts_with_its_shape():
    # rho^2 is evenly spread over a disc, so its standard deviation is 1 / sqrt(12)
    x = np.linspace(-0.03, 0.03, 601)
    for curve in (bow, TableTerm(x, bow(x)), PolynomialTerm([0.0, 0.0, 60 * NM / RADIUS**2])):
        assert_allclose(sq(ranked(EZX=curve), "EZX"), 60.0 / np.sqrt(12.0), rtol=0, atol=0.01)


def test_known_curves_stand_beside_magnitudes_in_their_order():
    table = ranked(EZC="2 upr 50 nm", EZX=bow, B0Z="1 urad")

    assert table.names == ("EZC", "EZX", "B0Z")
    assert_allclose(sq(table, "EZC"), 50.0 / np.sqrt(2.0), rtol=1e-6, atol=0)
    assert_allclose(sq(table, "EZX"), 60.0 / np.sqrt(12.0), rtol=0, atol=0.01)
    # a cone of 1 urad: rho has the variance R^2 / 18 over a disc
    assert_allclose(sq(table, "B0Z"), 25e3 / np.sqrt(18.0) * 1e-3, rtol=0, atol=0.01)


def test_a_table_that_ends_before_the_rim_is_refused():
    with pytest.raises(DataError, match="outside the error table"):
        ranked(EZX=TableTerm([0.0, 0.01], [0.0, 1e-7]))
    with pytest.raises(DataError, match="a known curve, so it has no mean"):
        rank(presets("sts_lathe"), Plane(), radius=RADIUS, errors={"EZX": bow}, mean={"EZX": 1e-7})

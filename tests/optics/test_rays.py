"""Optical path by an independent trace: vectors, Snell's law, intersection with the plane z = 0."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.errors import DataError, InvalidSamplesError
from metrosep.optics import path_difference, path_sensitivity

EXACT = 1e-12
"""Relative; a dozen operations in float64."""


def traced(z, p, q, mode, n, side):
    """Return the path of one ray by vectors: incoming from a plane, onward to z = 0."""
    normal = np.array([-p, -q, 1.0]) / np.sqrt(1 + p * p + q * q)
    if mode == "reflect":
        d = np.array([0.0, 0.0, -1.0])
        out = d - 2 * (d @ normal) * normal
        return -((0.0 - z) + (0.0 - z) / out[2])  # lead: minus the path above the plane z = 0
    before, after = (n, 1.0) if side == "inside" else (1.0, n)
    d = np.array([0.0, 0.0, 1.0 if side == "inside" else -1.0])
    facing = normal if d @ normal < 0 else -normal
    ratio, cos_in = before / after, -(d @ facing)
    cos_out = np.sqrt(1 - ratio**2 * (1 - cos_in**2))
    out = ratio * d + (ratio * cos_in - cos_out) * facing
    assert abs(np.linalg.norm(out) - 1) < EXACT
    arrival = z if side == "inside" else -z
    return before * arrival + after * (0.0 - z) / out[2]


@pytest.mark.parametrize(
    ("mode", "n", "side"),
    [("reflect", None, "inside"), ("refract", 1.4914, "inside"), ("refract", 1.7, "outside")],
)
def test_agrees_with_a_trace_by_vectors(mode, n, side):
    rng = np.random.default_rng(3)
    z, p, q = rng.uniform(-1e-3, 1e-3, 50), rng.normal(0, 0.15, 50), rng.normal(0, 0.15, 50)

    found = path_difference(z, p, q, mode=mode, n=n, side=side)

    expected = [traced(*ray, mode, n, side) for ray in zip(z, p, q, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=EXACT, atol=1e-18)


def test_high_material_leads_in_reflection_and_lags_in_refraction():
    assert path_difference(1e-9, 0.0, 0.0) == pytest.approx(2e-9, abs=1e-20)
    for side in ("inside", "outside"):
        lag = path_difference(1e-9, 0.0, 0.0, mode="refract", n=1.5, side=side)
        assert lag == pytest.approx(0.5e-9, abs=1e-20)


@pytest.mark.parametrize(
    ("mode", "n", "side"),
    [("reflect", None, "inside"), ("refract", 1.5, "inside"), ("refract", 1.5, "outside")],
)
def test_sensitivity_is_the_derivative(mode, n, side):
    z, p, q, h = 2e-3, 0.11, -0.2, 1e-6
    options = {"mode": mode, "n": n, "side": side}

    by = path_sensitivity(z, p, q, **options)

    centred = [
        (path_difference(*(at + h * e), **options) - path_difference(*(at - h * e), **options))
        / (2 * h)
        for at in [np.array([z, p, q])]
        for e in np.eye(3)
    ]
    np.testing.assert_allclose([v.item() for v in by], centred, rtol=1e-8, atol=1e-14)


@pytest.mark.parametrize("function", [path_difference, path_sensitivity])
@pytest.mark.parametrize("hole", [(np.nan, 0, 0), (0, np.nan, 0), (0, 0, np.nan)])
@pytest.mark.parametrize("options", [{}, {"mode": "refract", "n": 1.5}], ids=["mirror", "glass"])
def test_nan_stays_nan(function, hole, options):
    z, p, q = np.array([[1e-6, 1e-6], [0.1, 0.1], [0.2, 0.2]])
    z[1], p[1], q[1] = np.array([z[1], p[1], q[1]]) + hole
    given = [v.copy() for v in (z, p, q)]
    out = np.atleast_2d(function(z, p, q, **options))
    assert np.isfinite(out[:, 0]).all()
    assert np.isnan(out[:, 1]).any()
    assert np.isnan(path_difference(z, p, q, **options)[1])
    for before, after in zip(given, (z, p, q), strict=True):
        np.testing.assert_array_equal(before, after)  # never changed


def test_masked_and_integer_arrays():
    z = np.ma.masked_equal([1.0, -9.0], -9.0)
    out = path_difference(z, [0, 0], [0, 0])
    assert out[0] == 2.0
    assert np.isnan(out[1])


def test_a_mirror_steeper_than_45_degrees_is_refused():
    with pytest.raises(
        InvalidSamplesError, match=r"1 of 2 rays are not reflected back.*50\.\d deg"
    ):
        path_difference([0.0, 0.0], [0.1, 1.2], [0.0, 0.0])


def test_total_reflection_is_named():
    with pytest.raises(InvalidSamplesError, match="totally reflected"):
        path_difference(0.0, 1.0, 0.0, mode="refract", n=1.6)
    path_difference(0.0, 1.0, 0.0, mode="refract", n=1.6, side="outside")  # into glass it goes


@pytest.mark.parametrize("slope", [3.4e38, 1e300])
def test_fill_values_of_files_are_refused_without_overflow(slope):
    for options in ({}, {"mode": "refract", "n": 1.5}):
        for function in (path_difference, path_sensitivity):
            with pytest.raises(InvalidSamplesError, match=r"90\.0 deg"):
                function(0.0, slope, slope, **options)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"mode": "absorb"}, "reflect"),
        ({"mode": "refract"}, "needs the refractive index"),
        ({"mode": "reflect", "n": 1.5}, "mirror has no"),
        ({"mode": "refract", "n": 1.0}, "refractive index n must be a number"),
        ({"mode": "refract", "n": np.nan}, "refractive index n must be a number"),
        ({"mode": "refract", "n": np.inf}, "refractive index n must be a number"),
        ({"mode": "refract", "n": 10.5}, "refractive index n must be a number"),
        ({"mode": "refract", "n": "1.5"}, "refractive index n must be a number"),
        ({"mode": "refract", "n": True}, "refractive index n must be a number"),
        ({"mode": "refract", "n": 1.5 + 0.1j}, "refractive index n must be a number"),
        ({"mode": "refract", "n": [1.5, 1.6]}, "refractive index n must be a number"),
        ({"mode": ["reflect"]}, "mode"),
        ({"mode": None}, "mode"),
        ({"mode": "refract", "n": 1.5, "side": "left"}, "side"),
    ],
)
def test_bad_options(options, match):
    with pytest.raises(DataError, match=match):
        path_difference(0.0, 0.0, 0.0, **options)


def test_unequal_shapes():
    with pytest.raises(InvalidSamplesError, match="one shape"):
        path_difference([0.0, 0.0], 0.0, 0.0)


WRONG = {
    "none": None,
    "truth": True,
    "text": "1",
    "date": np.datetime64("2024-01-01"),
    "complex": 1j,
    "infinite": np.inf,
    "ragged": [[0.0], [0.0, 1.0]],
}


@pytest.mark.parametrize("function", [path_difference, path_sensitivity])
@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize(("place", "name"), [(0, "z"), (1, "slope_x"), (2, "slope_y")])
def test_only_real_numbers_are_taken(function, wrong, place, name):
    given = [0.0, 0.0, 0.0]
    given[place] = wrong
    with pytest.raises(InvalidSamplesError, match=rf"^{name} "):
        function(*given)

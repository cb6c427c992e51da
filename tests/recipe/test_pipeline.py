"""Steps that measure, one by one and in a row: closed forms, planted asymmetries, bad input."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, MetrosepError, TooFewSamplesError
from metrosep.recipe import pipeline
from metrosep.recipe.pipeline import MEASURING, run_steps
from metrosep.recipe.pipeline_checks import StepError
from metrosep.recipe.pipeline_mask import middle_of, neighbour_deviation

NM = 1e-9
PITCH = 50e-6
ROUND = 1e-12
"""Metres: a billion times less than a pixel, far above rounding of coordinates of 10 mm."""


def plane_with_noise(n=101, *, seed=3, noise=1 * NM):
    """Return tilted heights with noise; the tilts differ, so that axes cannot be mixed up."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:n, :n] * PITCH
    return 3e-4 * x - 1e-4 * y + noise * rng.standard_normal((n, n))


def disc(n=200, *, centre=(5.3e-3, 4.4e-3), diameter=8e-3):
    """Return a map of zeros that was measured inside a disc off the middle."""
    y, x = np.mgrid[:n, :n] * PITCH
    inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 <= (diameter / 2) ** 2
    return ms.Surface(np.where(inside, x * 1e-4, np.nan), PITCH, PITCH)


def mask(**aperture):
    return {"op": "mask", "aperture": aperture}


def done(obj, *steps):
    return run_steps(obj, steps)[-1]


# mask


def test_a_circle_keeps_what_lies_inside_and_nothing_else():
    n, centre, diameter = 81, (1.7e-3, 2.6e-3), 2.2e-3
    surface = ms.Surface(np.ones((n, n + 20)), PITCH, PITCH)

    stage = done(surface, mask(shape="circle", diameter="2.2 mm", centre=["1.7 mm", "2.6 mm"]))

    y, x = np.mgrid[:n, : n + 20] * PITCH
    expected = np.hypot(x - centre[0], y - centre[1]) <= diameter / 2 * (1 + 1e-9)
    np.testing.assert_array_equal(~np.isnan(stage.obj.z), expected)
    assert stage.audit["taken_out"] == n * (n + 20) - expected.sum()
    assert str(stage.audit["taken_out"]) in stage.messages[0]
    assert surface.n_invalid == 0


def test_what_lies_inside_is_taken_out_on_demand():
    surface = ms.Surface(np.ones((60, 80)), PITCH, PITCH)
    step = mask(shape="rectangle", width="1 mm", height="0.5 mm", centre=["2 mm", "1 mm"])

    kept = done(surface, step).obj
    rest = done(surface, {**step, "outside": False}).obj

    np.testing.assert_array_equal(np.isnan(kept.z), ~np.isnan(rest.z))
    assert kept.z.size - kept.n_invalid == 21 * 11


def test_a_ring_has_a_hole():
    stage = done(disc(), mask(shape="ring", diameter="6 mm", inner_diameter="2 mm", centre="fit"))
    y, x = np.mgrid[:200, :200] * PITCH
    r = np.hypot(x - stage.audit["centre_m"][0], y - stage.audit["centre_m"][1])
    known = ~np.isnan(stage.obj.z)
    assert r[known].min() == pytest.approx(1e-3, abs=PITCH)
    assert r[known].max() == pytest.approx(3e-3, abs=PITCH)


def test_the_middle_is_found_where_stray_points_and_dropouts_are():
    z = disc().z.copy()
    z[0, 5] = z[3, 190] = 1e-6  # dirt outside of the part
    z[60:90, 100:120] = np.nan  # a dropout on one side
    z[:, 178:] = np.nan  # 0.4 mm of the rim cut off: less than half of the rows reach it

    x, y = middle_of(ms.Surface(z, PITCH, PITCH))

    assert x == pytest.approx(5.3e-3, abs=PITCH)
    assert y == pytest.approx(4.4e-3, abs=PITCH)


def test_the_origin_of_a_map_counts():
    moved = ms.Surface(disc().z, PITCH, PITCH, origin=(-1e-3, 2e-3))
    x, y = middle_of(moved)
    assert (x, y) == pytest.approx((4.3e-3, 6.4e-3), abs=PITCH)


def test_a_piece_of_a_profile():
    profile = ms.Profile(np.arange(101) * 1e-5, np.zeros(101))
    stage = done(profile, mask(shape="rectangle", width="0.2 mm", centre=["0.3 mm"]))
    known = stage.obj.x[~np.isnan(stage.obj.z)]
    assert known[0] == pytest.approx(0.2e-3, abs=ROUND)
    assert known[-1] == pytest.approx(0.4e-3, abs=ROUND)
    assert len(stage.obj) == 101


@pytest.mark.parametrize(
    ("aperture", "match"),
    [
        ({"shape": "oval", "diameter": "1 mm"}, "circle, ring, rectangle"),
        ({"shape": "circle"}, "needs diameter"),
        ({"shape": "circle", "diameter": "1"}, "unit"),
        ({"shape": "circle", "diameter": "-1 mm"}, "must be positive"),
        ({"shape": "circle", "diameter": "1 mm", "width": "1 mm"}, "has no width"),
        ({"shape": "ring", "diameter": "1 mm", "inner_diameter": "2 mm"}, "smaller than"),
        ({"shape": "circle", "diamter": "1 mm"}, 'Did you mean "diameter"'),
        ({"shape": "circle", "diameter": "1 mm", "centre": "middle"}, "fit"),
        ({"shape": "circle", "diameter": "1 mm", "centre": ["1 mm", "5"]}, "unit"),
        ({"shape": "circle", "diameter": "1 mm", "centre": [True, 1.0]}, "number"),
        ({"diameter": "1 mm"}, "shape"),
    ],
)
def test_apertures_that_are_none(aperture, match):
    with pytest.raises(StepError, match=match):
        done(disc(), mask(**aperture))


def test_a_map_needs_both_coordinates_and_a_step():
    with pytest.raises(DataError, match="x and y"):
        done(disc(), mask(shape="circle", diameter="1 mm", centre=["1 mm"]))
    with pytest.raises(DataError, match="lateral"):
        done(ms.Surface(np.ones((9, 9))), mask(shape="circle", diameter="1 mm"))


def test_nothing_left_is_an_error_not_an_empty_map():
    with pytest.raises(TooFewSamplesError, match="leaves nothing"):
        done(disc(), mask(shape="circle", diameter="1 mm", centre=["100 mm", "0 mm"]))


# outliers


def test_planted_spikes_go_and_nothing_else():
    z = plane_with_noise()
    spikes = [(10, 12), (50, 90), (51, 90), (70, 3)]
    for i, (row, column) in enumerate(spikes):
        z[row, column] += (-1) ** i * 12 * NM
    z[30:33, 40:60] = np.nan
    surface = ms.Surface(z, PITCH, PITCH)

    stage = done(surface, {"op": "outliers"})

    gone = np.isnan(stage.obj.z) & ~np.isnan(z)
    assert sorted(map(tuple, np.argwhere(gone).tolist())) == spikes
    assert stage.audit["taken_out"] == 4
    assert "4 of 10141" in stage.messages[0]
    np.testing.assert_array_equal(stage.obj.z[~np.isnan(stage.obj.z)], z[~np.isnan(stage.obj.z)])


def test_the_robust_sigma_is_that_of_a_height_against_the_means_of_its_neighbours():
    # var = 1 + var(median of 12 means of two), here by simulation: 1.03 standard deviations
    rng = np.random.default_rng(8)
    pairs = rng.standard_normal((20_000, 12, 2)).mean(axis=2)
    expected = np.hypot(1.0, np.median(pairs, axis=1).std()) * NM
    surface = ms.Surface(plane_with_noise(201), PITCH, PITCH)
    sigma = done(surface, {"op": "outliers"}).audit["sigma_m"]
    assert sigma == pytest.approx(expected, abs=0.03 * NM)  # MAD of 40 000 heights: 0.6 %


def test_a_cluster_goes_whole_and_its_neighbours_stay():
    z = plane_with_noise()
    z[40:43, 60:63] -= 60 * NM
    stage = done(ms.Surface(z, PITCH, PITCH), {"op": "outliers"})
    gone = np.zeros(z.shape, dtype=bool)
    gone[40:43, 60:63] = True
    np.testing.assert_array_equal(np.isnan(stage.obj.z), gone)


def test_slopes_cancel_at_edges_and_gaps():
    y, x = np.mgrid[:41, :41]
    z = np.where((x - 20) ** 2 + (y - 20) ** 2 < 300, 1e-3 * x - 2e-3 * y, np.nan)
    deviation = neighbour_deviation(z, 5)
    judged = ~np.isnan(deviation)
    assert np.abs(deviation[judged]).max() < 1e-15  # 8 eps of heights up to 0.1
    assert judged.sum() > 0.94 * (~np.isnan(z)).sum()


@pytest.mark.parametrize("about", [{}, {"form": "sphere"}])
def test_dust_on_a_steep_sphere_is_found(about):
    rng = np.random.default_rng(5)
    y, x = (np.mgrid[:161, :161] - 80) * PITCH
    z = 10e-3 - np.sqrt((10e-3) ** 2 - x**2 - y**2) + 1 * NM * rng.standard_normal(x.shape)
    z[40, 100] += 40 * NM
    surface = ms.Surface(z, PITCH, PITCH, origin=(-80 * PITCH, -80 * PITCH))

    stage = done(surface, {"op": "outliers", **about})

    assert np.argwhere(np.isnan(stage.obj.z)).tolist() == [[40, 100]]
    assert np.nanmax(stage.obj.z) == np.nanmax(z)  # the sphere is still there


@pytest.mark.parametrize("sign", [1, -1])
def test_spikes_of_a_profile(sign):
    rng = np.random.default_rng(2)
    x = np.arange(500) * 1e-6
    z = 2e-3 * x + 1 * NM * rng.standard_normal(500)
    z[[100, 101, 300]] += sign * 15 * NM
    stage = done(ms.Profile(x, z), {"op": "outliers", "threshold": 6})
    assert np.flatnonzero(np.isnan(stage.obj.z)).tolist() == [100, 101, 300]


def test_a_spike_on_exact_heights_and_the_steps_of_an_instrument():
    z = np.zeros((30, 30))
    z[7, 8] = 1e-9
    assert done(ms.Surface(z), {"op": "outliers"}).audit["taken_out"] == 1
    rng = np.random.default_rng(1)
    counts = ms.Surface(1e-9 * (rng.random((80, 80)) < 0.1))  # flicker of one count
    assert done(counts, {"op": "outliers"}).audit["taken_out"] == 0


def test_points_without_neighbours_are_not_judged_and_that_is_said():
    z = np.full((9, 9), np.nan)
    z[::4, ::4] = 1.0
    stage = done(ms.Surface(z), {"op": "outliers", "window": 3})
    assert stage.audit["not_judged"] == 9
    assert "not judged" in stage.messages[1]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"threshold": 0}, "more than zero"),
        ({"window": 4}, "odd"),
        ({"window": 1}, "odd"),
        ({"window": 2.5}, "whole number"),
        ({"form": "cone"}, "no form"),
        ({"treshold": 5}, 'Did you mean "threshold"'),
    ],
)
def test_outliers_bad_keys(options, match):
    with pytest.raises(StepError, match=match):
        done(disc(), {"op": "outliers", **options})


# form


def sphere_map(radius=100e-3, *, noise=2 * NM, seed=4, n=101, centre=(2.9e-3, 2.2e-3)):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:n, :n] * PITCH
    r2 = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
    z = radius - np.sqrt(radius**2 - r2) + noise * rng.standard_normal((n, n))
    return ms.Surface(z, PITCH, PITCH)


FREE = ["R", "piston", "shift_x", "shift_y"]


def test_the_radius_with_its_uncertainty_is_found_and_the_rest_is_noise():
    stage = done(sphere_map(), {"op": "form", "form": "sphere", "free": FREE})

    R = stage.found["R"]
    assert abs(R.value - 100e-3) < 4 * R.u
    # sag r^2/2R over a square of half width a: var(r^2) = 8 a^4 / 45
    a, n = 2.5e-3, 101**2
    expected = 2 * NM / (np.sqrt(8 / 45 * a**4 * n) / (2 * (100e-3) ** 2))
    assert stage.detail.u_white["R"] == pytest.approx(expected, abs=0.05 * expected)
    # what is looked at beside the model is known to a fifth or so
    assert 0.95 * expected < R.u < 1.5 * expected
    # the map has no origin: shifts count from its middle, 2.5 mm; the planted ones differ in sign
    assert stage.found["shift_x"].value == pytest.approx(0.4e-3, abs=1e-6)
    assert stage.found["shift_y"].value == pytest.approx(-0.3e-3, abs=1e-6)
    assert stage.found["residual.rms"].value == pytest.approx(2 * NM, abs=0.06 * NM)
    assert stage.obj.rms() == pytest.approx(2 * NM, abs=0.06 * NM)
    assert stage.detail.residual is stage.obj


def test_what_is_fixed_is_held_and_not_listed():
    step = {"op": "form", "form": "sphere", "fix": {"R": "90 mm"}, "free": FREE[1:]}
    stage = done(sphere_map(), step)
    assert "R" not in stage.found
    assert stage.detail.params["R"] == 90e-3


def test_centre_and_robust_reach_the_fit():
    step = {"op": "form", "form": "sphere: R=100 mm", "free": ["piston"]}
    off = done(sphere_map(), {**step, "centre": ["2.9 mm", "2.2 mm"]}).found["residual.rms"].value
    assert off == pytest.approx(2 * NM, abs=0.06 * NM)
    assert done(sphere_map(), step).found["residual.rms"].value > 100 * NM
    assert done(sphere_map(), {**step, "robust": "tukey"}).detail.robust == "tukey"


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({}, 'needs the key "form"'),
        ({"form": "cone"}, "no form"),
        ({"form": "sphere: R=10"}, "unit"),
        ({"form": "sphere", "fix": {"Q": "1 mm"}}, "none of"),
        ({"form": "sphere", "fix": {"R": 10.0}}, "needs its unit"),
        ({"form": "sphere", "fix": {"R": True}}, "not a number"),
        ({"form": "sphere", "fix": {"R": "10"}}, "unit"),
        ({"form": "sphere", "centre": ["1 mm", "2 mm", "3 mm"]}, "x and y"),
        ({"form": "sphere", "robust": "median"}, "tukey"),
    ],
)
def test_form_bad_keys(options, match):
    with pytest.raises(StepError, match=match):
        done(sphere_map(), {"op": "form", **options})


# filter


def waves(length, n=4000):
    x = np.arange(n) * 1e-6
    return ms.Profile(x, 50 * NM * np.cos(2 * np.pi * x / length))


@pytest.mark.parametrize("length", [50e-6, 100e-6, 200e-6])
def test_a_gaussian_filter_keeps_two_to_the_minus_ratio_squared(length):
    kept = 2.0 ** -((100e-6 / length) ** 2)
    low = done(waves(length), {"op": "filter", "cutoff": "100 um"}).obj.z[1000:3000]
    high = done(waves(length), {"op": "filter", "cutoff": 100e-6, "band": "short"}).obj.z[
        1000:3000
    ]
    # the sum over samples differs from the integral by less than 1e-6 at 100 samples a cut-off
    assert np.abs(low).max() == pytest.approx(50 * NM * kept, abs=1e-4 * NM)
    assert np.abs(high).max() == pytest.approx(50 * NM * (1 - kept), abs=1e-4 * NM)


def test_a_spline_keeps_one_half_at_its_cutoff():
    low = done(waves(100e-6), {"op": "filter", "kind": "spline", "cutoff": "100 um"}).obj
    assert np.abs(low.z[1000:3000]).max() == pytest.approx(25 * NM, abs=0.02 * NM)


def test_robust_and_morphological_filters_do_what_they_are_named_for():
    z = waves(2e-3).z + 0.01 * NM * np.random.default_rng(3).standard_normal(4000)
    z[2000] += 1e-6
    spiked = ms.Profile(waves(2e-3).x, z)
    plain = done(spiked, {"op": "filter", "cutoff": "100 um"}).obj.z
    robust = done(spiked, {"op": "filter", "kind": "robust", "cutoff": "100 um"}).obj.z
    assert abs(robust[2000] - 50 * NM) < 0.1 * abs(plain[2000] - 50 * NM)
    envelope = done(spiked, {"op": "filter", "kind": "opening", "length": "10 um"}).obj.z
    assert envelope[2000] == pytest.approx(50 * NM, abs=0.1 * NM)  # the spike is narrower


def test_lambda_c_makes_a_profile_rough_and_waviness_the_rest():
    rough = done(waves(100e-6), {"op": "filter", "lambda_c": "0.8 mm"}).obj
    wavy = done(waves(100e-6), {"op": "filter", "lambda_c": "0.8 mm", "profile": "W"}).obj
    assert rough.metadata["profile_kind"] == "R"
    assert wavy.metadata["profile_kind"] == "W"
    np.testing.assert_allclose(rough.z + wavy.z, waves(100e-6).z, rtol=0, atol=1e-15)


@pytest.mark.parametrize("is_map", [True, False])
def test_a_band_is_taken_out_and_what_lies_beside_it_stays(is_map):
    # two waves along an oblique direction, with steps that differ
    dx, dy = 2e-6, 3e-6
    y, x = np.mgrid[0:260, 0:420]
    s = 0.8 * dx * x - 0.6 * dy * y if is_map else dx * x[0]
    known = {90e-6: 40 * NM, 12e-6: 25 * NM}
    z = sum(a * np.cos(2 * np.pi * s / length + 0.3) for length, a in known.items()) + 5e-9
    obj = ms.Surface(z, dx, dy) if is_map else ms.Profile(s, z)
    result = done(obj, {"op": "filter", "lambda_s": 30e-6, "lambda_c": 180e-6, "band": "stop"})
    waves_ = [
        f(2 * np.pi * s.ravel() / length + 0.3) for length in known for f in (np.cos, np.sin)
    ]
    found = np.linalg.lstsq(
        np.stack([*waves_, np.ones(s.size)], axis=1), result.obj.z.ravel(), rcond=None
    )[0]
    assert np.hypot(found[0], found[1]) < 0.05 * 40 * NM
    assert found[2] == pytest.approx(25 * NM, abs=0.05 * 25 * NM)
    # a mean height is no wave: it stays, but for what the parabola takes of the wave, below 1 %
    assert found[-1] == pytest.approx(5e-9, abs=0.01 * 40 * NM)
    (said,) = result.messages
    assert "waves of 30 um to 180 um were removed: less than 5 % of the amplitude of each" in said
    assert "are missing" not in said
    shorter = "24.37" if is_map else "24.71"  # 1 / (1 / 30 + 6 / L), L = 780 or 840
    assert f"waves shorter than {shorter} um keep at least 95 %" in said


def test_a_band_says_how_much_is_missing():
    z = np.sin(np.arange(1000) / 50.0) * NM
    z[::20] = np.nan
    step = {"op": "filter", "lambda_s": 30e-6, "lambda_c": 100e-6, "band": "stop"}
    (said,) = done(ms.Profile(np.arange(1000) * 1e-6, z), step).messages
    assert "5 % of the samples are missing, so that these may keep less" in said


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({}, "lambda_s, lambda_c or both, or cutoff"),
        ({"cutoff": "1 um", "lambda_c": "2 um"}, "lambda_s, lambda_c or both, or cutoff"),
        ({"lambda_s": "1 mm", "lambda_c": "0.1 mm"}, "shorter"),
        ({"lambda_c": "1 mm", "band": "short"}, "goes with cutoff"),
        ({"cutoff": "1 mm", "profile": "R"}, "goes with lambda_c"),
        ({"kind": "spline", "lambda_c": "1 mm"}, "does not belong"),
        ({"kind": "spline"}, "needs cutoff"),
        ({"kind": "closing"}, "needs radius"),
        ({"kind": "closing", "radius": "1 um", "length": "1 um"}, "needs radius"),
        ({"cutoff": "1 mm", "end": "natural"}, "one of moment"),
        ({"cutoff": 0.0}, "must be positive"),
        ({"cutoff": float("nan")}, "finite"),
        ({"cutoff": "0 mm"}, "must be positive"),
        ({"cutoff": "1 mm", "band": "middle"}, "long, short"),
        ({"cutof": "1 mm"}, 'Did you mean "cutoff"'),
        ({"kind": "robust", "cutoff": "1 mm", "order": 3}, "0, 1, 2"),
        ({"lambda_c": "1 mm", "sections": 0}, "from 1"),
        ({"band": "stop", "lambda_c": "1 mm"}, "needs lambda_s and lambda_c"),
        ({"band": "stop", "cutoff": "1 mm"}, "needs lambda_s and lambda_c"),
        ({"kind": "spline", "cutoff": "1 mm", "band": "stop"}, "without a kind"),
        ({"kind": "opening", "radius": "1 mm", "band": "stop"}, "without a kind"),
        ({"band": "stop", "lambda_s": "1 mm", "lambda_c": "2 mm", "end": "cut"}, "does not go"),
        ({"band": "stop", "lambda_s": "1 mm", "lambda_c": "2 mm", "end": "moment"}, "not go"),
        ({"band": "stop", "lambda_s": "2 mm", "lambda_c": "1 mm"}, "shorter"),
        ({"band": "stop", "lambda_s": "1 um", "lambda_c": "1 mm", "profile": "W"}, "not go"),
    ],
)
def test_filter_bad_keys(options, match):
    with pytest.raises(StepError, match=match):
        done(waves(100e-6), {"op": "filter", **options})


def test_keys_of_profiles_are_refused_on_maps():
    for step in (
        {"op": "filter", "lambda_c": "0.8 mm", "profile": "W"},
        {"op": "filter", "lambda_c": "0.8 mm", "sections": 3},
        {"op": "parameters", "kind": "R"},
        {"op": "parameters", "sections": 5},
        {"op": "parameters", "edition": "ISO 4287:1997"},
    ):
        with pytest.raises(StepError, match="profiles, and this is a map"):
            done(disc(), step)


# parameters


def test_parameters_of_a_sine_are_those_of_the_book():
    found = done(waves(100e-6), {"op": "parameters", "names": ["Pa", "Pq", "Pt"]}).found
    assert list(found) == ["Pa", "Pq", "Pt"]
    assert found["Pq"].value == pytest.approx(50 * NM / np.sqrt(2), abs=1e-4 * NM)
    assert found["Pt"].value == pytest.approx(100 * NM, abs=1e-4 * NM)
    assert found["Pa"].value == pytest.approx(100 / np.pi * NM, abs=0.02 * NM)


def test_the_usual_set_goes_with_the_data():
    assert set(done(disc(), {"op": "parameters"}).found) >= {"PV", "RMS", "Sa", "Sq", "Sz"}
    profile = run_steps(
        waves(100e-6), [{"op": "filter", "lambda_c": "0.8 mm"}, {"op": "parameters"}]
    )
    assert set(profile[-1].found) >= {"Ra", "Rq", "Rz", "Rt"}
    every = done(disc(), {"op": "parameters", "names": ["all"]}).found
    assert {"Sdq", "Sk", "PV"} <= set(every)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"names": ["Ra"]}, "a map has no parameter 'Ra'"),
        ({"names": ["Sx"]}, "Sx"),
        ({"names": []}, "lists symbols"),
        ({"names": [1]}, "text"),
        ({"line": "middle"}, "lsq"),
        ({"sections": 0}, "from 1"),
    ],
)
def test_parameters_bad_keys(options, match):
    with pytest.raises(DataError, match=match):
        done(disc(), {"op": "parameters", **options})


# a list of steps


LIST = [
    mask(shape="circle", diameter="4.8 mm", centre="fit"),
    {"op": "outliers", "enabled": False},
    {"op": "form", "form": "sphere", "free": FREE},
    {"op": "filter", "cutoff": "0.2 mm"},
    {"op": "parameters", "names": ["Sq"]},
]


def test_stages_are_numbered_and_a_step_that_is_off_passes_the_map_on():
    surface = sphere_map()
    told = []

    stages = run_steps(surface, LIST, tell=told.append)

    assert [s.index for s in stages] == list(range(5))
    assert [s.enabled for s in stages] == [True, False, True, True, True]
    assert stages[1].obj is stages[0].obj
    assert not stages[1].history
    assert told == ["step 1: mask", "step 3: form", "step 4: filter", "step 5: parameters"]
    assert all(s.seconds >= 0.0 for s in stages)
    names = [h.name for s in stages for h in s.history]
    assert names == ["mask", "fit sphere", "gaussian", "parameters"]
    assert stages[3].obj.history[-1].name == "gaussian"
    assert not stages[-1].obj.z.flags.writeable


def test_a_list_is_the_same_in_pieces():
    surface = sphere_map()
    whole = run_steps(surface, LIST)
    begun = run_steps(surface, LIST, upto=3)
    rest = run_steps(begun[-1].obj, LIST[3:], first=3)
    assert len(begun) == 3
    assert [s.index for s in rest] == [3, 4]
    assert rest[-1].found["Sq"].value == whole[-1].found["Sq"].value
    assert run_steps(surface, LIST, upto=0) == ()


def test_it_can_be_stopped_between_steps():
    asked = []

    def cancel():
        asked.append(1)
        return len(asked) > 2

    with pytest.raises(pipeline.CancelledError, match="before step 3"):
        run_steps(sphere_map(), LIST, cancel=cancel)
    assert isinstance(pipeline.CancelledError(""), MetrosepError)


def test_texts_and_numbers_in_si_mean_the_same():
    surface = sphere_map()
    texts = run_steps(surface, LIST)[-1].found["Sq"].value
    numbers = [dict(s) for s in LIST]
    numbers[0] = mask(shape="circle", diameter=4.8e-3, centre="fit")
    numbers[3] = {"op": "filter", "cutoff": 0.2e-3}
    assert run_steps(surface, numbers)[-1].found["Sq"].value == texts


def test_lengths_stay_lengths_on_a_preview():
    surface = sphere_map(noise=0.0, n=201)
    preview = ms.Surface(surface.z[::2, ::2], 2 * PITCH, 2 * PITCH)
    for obj in (surface, preview):
        stages = run_steps(obj, LIST[:3])
        area = (obj.z.size - stages[0].obj.n_invalid) * obj.dx**2
        assert area == pytest.approx(np.pi / 4 * (4.8e-3) ** 2, abs=4.8e-3 * np.pi * 2 * PITCH / 4)
        assert stages[2].found["R"].value == pytest.approx(100e-3, abs=1e-9)


@pytest.mark.parametrize("bad", [np.ones((5, 5)), None, "file.sdf"])
def test_only_maps_and_profiles(bad):
    with pytest.raises(InvalidSamplesError, match="profile or a map"):
        run_steps(bad, LIST)


@pytest.mark.parametrize("step", [{}, {"op": "sharpen"}, {"op": 3}])
def test_unknown_steps(step):
    with pytest.raises(StepError, match="mask, outliers, form, filter, parameters"):
        run_steps(disc(), [step])


def test_enabled_is_true_or_false():
    with pytest.raises(StepError, match="true or false"):
        run_steps(disc(), [{"op": "parameters", "enabled": "no"}])


def test_nothing_measured_is_an_error_of_each_step():
    empty = ms.Surface(np.full((9, 9), np.nan), PITCH, PITCH)
    for step in (LIST[0], LIST[2], LIST[4]):
        with pytest.raises(MetrosepError):
            run_steps(empty, [step])
    assert done(empty, {"op": "outliers"}).audit["taken_out"] == 0


# schema


def test_schema_is_plain_and_says_everything_a_form_needs():
    again = json.loads(json.dumps(pipeline.schema()))
    assert [s["op"] for s in again["steps"]] == list(MEASURING)
    for step in again["steps"]:
        assert step["what"]
        assert {k["name"] for k in step["keys"]} | {"op"} == set(MEASURING[step["op"]].fields)
        for key in step["keys"]:
            assert key["help"], key["name"]
    keys = {k["name"]: k for k in again["steps"][3]["keys"]}
    assert keys["cutoff"]["dimension"] == "length"
    assert keys["band"]["choices"] == ["long", "short", "stop"]
    aperture = {k["name"]: k for k in again["steps"][0]["keys"]}["aperture"]
    assert "diameter" in {k["name"] for k in aperture["keys"]}


NEEDED = {
    "mask": LIST[0],
    "outliers": {"op": "outliers"},
    "form": {"op": "form", "form": "plane"},
    "filter": {"op": "filter", "cutoff": "0.2 mm"},
    "parameters": {"op": "parameters", "names": ["Sq"]},
    "psd": {"op": "psd", "limit": "rms = 1 mm from 1 mm to 2 mm"},
    "step_height": {"op": "step_height", "width": "0.2 mm", "middle": "2.5 mm"},
    "surface_profile": {"op": "surface_profile", "form": "sphere: R=50 mm"},
    "line_profile": {"op": "line_profile", "form": "sphere: R=50 mm"},
}


@pytest.mark.parametrize("op", MEASURING)
def test_a_stated_default_is_what_happens_without_it(op):
    step, data = NEEDED[op], sphere_map()
    if op == "line_profile":
        data = ms.Profile(np.linspace(-1, 1, 101) * 1e-3, np.zeros(101))
    plain = done(data, step)
    for name, key in MEASURING[op].all_keys.items():
        if (
            key.default is None
            or name in step
            or name in ("profile", "core_filter", "tension", "order", "edition")
        ):
            continue
        stated = done(data, {**step, name: key.default})
        np.testing.assert_array_equal(stated.obj.z, plain.obj.z, err_msg=name)
        if op != "form":  # of a fit u is worked out anew
            assert stated.found == plain.found, name

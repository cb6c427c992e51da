"""Grid plate that was placed anew for each repeat of a view, or stayed."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.separation.planes.lattice_calibration import (
    GridCalibration,
    GridView,
    grid_calibration,
)

NM = 1e-9
PITCH, N, REPEATS, NOISE = 10e-3, 6, 3, 5 * NM
PLACEMENTS = ((0, (0, 0)), (1, (0, 0)), (0, (1, 0)))
SITES = np.stack(np.meshgrid(np.arange(N) - (N - 1) / 2, np.arange(N) - (N - 1) / 2), axis=-1)
TURNED = np.stack([-SITES[..., 1], SITES[..., 0]], axis=-1)


def views(rng, *, noise=NOISE, relaid=True):
    """Stage, and three views of REPEATS, each with a translation and rotation of its own."""
    stage, plate = 100 * NM * rng.standard_normal((2, N, N, 2))
    spun = np.rot90(plate, -1)
    seen = [plate, np.stack([-spun[..., 1], spun[..., 0]], axis=-1), np.full_like(plate, np.nan)]
    seen[2][:, 1:] = plate[:, :-1]
    out = []
    for marks in seen:
        lays = [
            2000 * NM * rng.standard_normal(2) + 300 * NM * rng.standard_normal() * TURNED
            for _ in range(REPEATS if relaid else 1)
        ]
        lays = lays if relaid else lays * REPEATS
        each = np.array([stage + marks + lay for lay in lays])
        out.append(each + noise * rng.standard_normal(each.shape))
    return stage, np.array(out)


def without_terms(e):
    one, zero = np.ones((N, N)), np.zeros((N, N))
    pairs = [np.stack([one, zero], -1), np.stack([zero, one], -1), TURNED, SITES]
    b = np.stack([p.ravel() for p in pairs], axis=1)
    return e - (b @ np.linalg.lstsq(b, e.ravel(), rcond=None)[0]).reshape(e.shape)


def gaps(readings):
    readings = readings.copy()
    readings[0, 1, 2, 2] = np.nan
    readings[1, 0, 4, 1:3] = np.nan
    readings[2, 2, 0, 5] = np.nan
    return readings


def test_noise_is_noise_when_the_plate_is_placed_anew():
    _, readings = views(np.random.default_rng(1))

    found = GridCalibration(PITCH).separate(readings)
    stayed = GridCalibration(PITCH, repeats="passes").separate(readings)

    assert found.noise.value == pytest.approx(NOISE, rel=0.12, abs=0.0)  # sd of s 3.2 %
    assert found.u["stage"].max() < NOISE
    assert stayed.noise.value > 100 * NOISE
    assert any("placed anew" in m and "'relaid'" in m for m in stayed.messages)
    assert np.max(np.abs(stayed.stage - found.stage)) < 1e-15
    assert found.null_space == stayed.null_space


@pytest.mark.parametrize("missing", [False, True])
def test_repeats_placed_anew_are_views_of_their_own(missing):
    """Each repeat as a view with its own placement is the same least squares, written out."""
    _, readings = views(np.random.default_rng(2))
    readings = gaps(readings) if missing else readings
    apart = [
        GridView(z, *place) for view, place in zip(readings, PLACEMENTS, strict=True) for z in view
    ]

    found = GridCalibration(PITCH).separate(readings)
    same = grid_calibration(apart, pitch=PITCH, repeats="passes")

    for key in ("degrees_of_freedom", "n_readings"):
        assert found.audit[key] == same.audit[key]
    assert found.noise.value == pytest.approx(same.noise.value, rel=1e-9, abs=0.0)
    for part in ("stage", "plate"):
        assert np.max(np.abs(found.parts[part] - same.parts[part])) < 1e-9 * 100 * NM
        assert np.max(np.abs(found.u[part] - same.u[part])) < 1e-9 * 100 * NM


@pytest.mark.parametrize("missing", [False, True])
def test_noise_free_stage_is_exact(missing):
    stage, readings = views(np.random.default_rng(3), noise=0.0)
    readings = gaps(readings) if missing else readings

    found = GridCalibration(PITCH).separate(readings)

    assert np.nanmax(np.abs(found.stage - without_terms(stage))) < 1e-9 * np.ptp(stage)


def test_plate_that_stayed_has_more_freedom_and_no_alarm():
    for seed in range(20):
        _, readings = views(np.random.default_rng(20 + seed), relaid=False)
        stayed = GridCalibration(PITCH, repeats="passes").separate(readings)
        assert not any("placed anew" in m for m in stayed.messages)
    relaid = GridCalibration(PITCH).separate(readings)
    assert stayed.audit["degrees_of_freedom"] - relaid.audit["degrees_of_freedom"] == 2 * 9
    assert stayed.noise.value == pytest.approx(relaid.noise.value, rel=0.1, abs=0.0)


@pytest.mark.slow
def test_uncertainty_agrees_with_monte_carlo():
    """200 trials: the RMS over all sites is known to about 1 %, the told one to less."""
    rest, told = [], []
    for seed in range(200):
        stage, readings = views(np.random.default_rng(500 + seed))
        found = GridCalibration(PITCH).separate(readings)
        rest.append(found.stage - without_terms(stage))
        told.append(found.u["stage"])
    drawn = np.sqrt(np.mean(np.square(rest)))
    assert drawn == pytest.approx(np.sqrt(np.mean(np.square(told))), rel=0.05, abs=0.0)


def test_refuses():
    with pytest.raises(DataError, match="one of relaid, passes"):
        GridCalibration(PITCH, repeats="mean")
    with pytest.raises(DataError, match="one of relaid, passes"):
        grid_calibration({"initial": np.zeros((4, 4, 2))}, pitch=PITCH, repeats="one")

"""Groove depth of ISO 5436-1: values worked out by other code, planted asymmetries, drawn scatter."""

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.parameters import step_height

UM = 1e-6


def groove(shift=0.0):
    """Flat bottom with sloped edges, 1 um deep, on a tilt with a wave, in um."""
    x = np.arange(-300, 301) * 0.5
    f = np.clip((np.abs(x - shift) - 42) / 8, 0, 1)
    z = 0.002 * x + 0.3 - (1 - f) + 0.01 * np.sin(2 * np.pi * x / 23 + 0.4)
    return x, z


def test_flat_bottom():
    x, z = groove()
    found = step_height(Profile(x * UM, z * UM), width="100 um")
    assert found.n_used == 335
    assert found.height == pytest.approx(-1.00094578 * UM, rel=1e-8, abs=0.0)
    assert found.depth == -found.height
    assert found.slope == pytest.approx(0.002, rel=0.01, abs=0.0)
    assert found.to_quantity().symbol == "d"
    # The wave of 10 nm moves the bottom by its mean over 33 um.
    assert abs(found.depth - UM) < 3 * found.u


def test_round_bottom():
    x = np.arange(-360, 361) * 0.5
    z = 0.002 * x + 0.01 * np.sin(2 * np.pi * x / 23 + 0.4)
    z -= np.where(np.abs(x) < 60, 1.2 * (1 - (x / 60) ** 2), 0.0)
    found = step_height(Profile(x * UM, z * UM), width=120 * UM, kind="A2")
    assert found.height == pytest.approx(-1.19982290 * UM, rel=1e-8, abs=0.0)
    assert abs(found.depth - 1.2 * UM) < 3 * found.u


def test_ridges_are_positive_and_the_middle_moves_with_the_groove():
    x, z = groove()
    ridge = step_height(Profile(x * UM, -z * UM), width=100 * UM)
    assert ridge.height == pytest.approx(1.00094578 * UM, rel=1e-8, abs=0.0)
    moved = step_height(Profile((x + 1e4) * UM, z * UM), width=100 * UM, middle="10 mm")
    assert moved.height == pytest.approx(-1.00094578 * UM, rel=1e-6, abs=0.0)
    wrong = step_height(Profile(x * UM, z * UM), width=100 * UM, middle=40 * UM)
    assert abs(wrong.height + UM) > 0.01 * UM


def test_a_map_is_cut_across_the_groove():
    x, z = groove()
    rows = np.tile(z, (40, 1)) * UM
    rows[5, 300] = np.nan
    surface = Surface(rows, 0.5 * UM, 2 * UM, origin=(x[0] * UM, 0.0))
    turned = Surface(rows.T, 2 * UM, 0.5 * UM, origin=(0.0, x[0] * UM))
    along_x = step_height(surface, width=100 * UM)
    along_y = step_height(turned, width=100 * UM, axis="y")
    assert along_x.height == pytest.approx(-1.00094578 * UM, rel=1e-5, abs=0.0)
    assert along_y.height == pytest.approx(along_x.height, rel=1e-12, abs=0.0)


def test_u_is_the_scatter_of_noisy_grooves():
    x = np.arange(-300, 301) * 0.5
    clean = np.where(np.abs(x) < 46, -1.0, 0.0)
    found = []
    for seed in range(60):
        noise = np.convolve(
            np.random.default_rng(seed).standard_normal(620), np.ones(20) / 20, "valid"
        )
        found.append(step_height(Profile(x * UM, (clean + 0.02 * noise) * UM), width=100 * UM))
    pull = np.array([(f.height + UM) / f.u for f in found])
    assert 0.5 < np.sqrt(np.mean(pull**2)) < 1.6


def test_what_is_no_groove_is_refused():
    x, z = groove()
    profile = Profile(x * UM, z * UM)
    with pytest.raises(TooFewSamplesError, match="left face of the groove holds 0"):
        step_height(profile, width=100 * UM, middle=-149 * UM)
    with pytest.raises(TooFewSamplesError, match="bottom"):
        step_height(profile, width=100 * UM, middle=1.0)
    with pytest.raises(DataError, match="width"):
        step_height(profile, width=-1.0)
    with pytest.raises(DataError, match="kind"):
        step_height(profile, width=100 * UM, kind="A3")
    with pytest.raises(DataError, match="lateral step"):
        step_height(Surface(np.zeros((9, 9))), width=100 * UM)

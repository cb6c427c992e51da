"""Monte Carlo of every symbol: closed forms of squares under white noise, and that each one runs."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metrosep import Profile, Surface
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.filters import roughness
from metrosep.parameters import (
    WhiteNoise,
    areal_parameters,
    monte_carlo,
    monte_carlo_table,
    profile_parameters,
)

UM, NM = 1e-6, 1e-9
SEVEN_POINT = 2 * (45**2 + 9**2 + 1) / 3600
"""Sum of the squares of the weights of the 7-point derivative, 1.17055556."""


def rough(n=4000):
    i = np.arange(n)
    z = 0.4 * np.sin(2 * np.pi * i / 50) + 0.1 * np.sin(2 * np.pi * i / 13 + 1)
    z -= 0.2 * np.maximum(np.sin(2 * np.pi * i / 211), 0.9)
    return Profile(i * UM, z * UM)


def bumps(n=64):
    c = np.cos(2 * np.pi * (np.arange(n) - 5.5) / 16)
    return Surface(50 * NM * (c[:, None] + 0.9 * c), UM, 2 * UM)


def honed(n=64):
    """A plateau with grooves: two processes, as Spq, Svq and Smq need them (bumps are at their limit)."""
    fine, wide = (
        gaussian_filter(np.random.default_rng(seed).normal(size=(n, n)), width, mode="wrap")
        for seed, width in ((5, 1.5), (6, 4.0))
    )
    return Surface(np.minimum(100 * NM * fine, 200 * NM * (wide / wide.std() + 0.8)), UM, 2 * UM)


def test_mean_square_slope_of_a_profile_grows_as_the_stencil_says():
    profile, sigma = rough(), 20 * NM
    found = monte_carlo_table(["Rdq", "Rq"], profile, noise=WhiteNoise(sigma), draws=60)
    gradient = found["Rdq"]
    grown = np.mean(gradient.draws**2) - gradient.value**2
    assert grown == pytest.approx(SEVEN_POINT * sigma**2 / UM**2, rel=0.02, abs=0.0)
    height = found["Rq"]
    assert np.mean(height.draws**2) - height.value**2 == pytest.approx(sigma**2, rel=0.15, abs=0.0)


def test_mean_square_slope_of_a_map_counts_both_steps():
    surface, sigma = bumps(120), 10 * NM
    found = monte_carlo("Sdq", surface, noise=WhiteNoise(sigma), draws=40)
    grown = np.mean(found.draws**2) - found.value**2
    # At the rim: one-sided three points, three, five; elsewhere seven.
    stencil = (2 * 6.5 + 2 * 0.5 + 2 * 130 / 144 + 114 * SEVEN_POINT) / 120
    expected = stencil * sigma**2 * (1 / UM**2 + 1 / (2 * UM) ** 2)
    assert grown == pytest.approx(expected, rel=0.02, abs=0.0)
    assert found.notes


def test_every_symbol_of_a_profile_runs():
    profile = rough()
    names = [*profile_parameters(profile, kind="R"), "Rmr(0.1 um)", "Rdc(20 %, 80 %)", "Rcm(5 %)"]
    found = monte_carlo_table(names, profile, noise=WhiteNoise(0.5 * NM), draws=4, coverage=0.5)
    assert set(found.results) == set(names)
    assert len(names) > 40
    assert all(r.u >= 0.0 for r in found.results.values())
    assert found["Rz"].u > 0.0


def test_every_symbol_of_a_map_runs():
    surface = honed()
    names = [
        *areal_parameters(surface),
        "Smr(10 nm)",
        "Smc(20 %)",
        "Vm(10 %)",
        "PV",
        "FLTt",
        "Sha(30 %)",
    ]
    found = monte_carlo_table(names, surface, noise=WhiteNoise(0.1 * NM), draws=4, coverage=0.5)
    assert len(found.results) == len(names) > 45
    assert "Spq" in names


def test_fits_by_name_scatter_as_their_white_uncertainty():
    from metrosep.forms import Sphere, fit

    y, x = np.mgrid[-40:41, -40:41] * 0.1e-3
    sag = Sphere(R=80e-3).height(x, y)
    surface = Surface(np.where(x * x + y * y <= (4e-3) ** 2, sag, np.nan), 0.1e-3, 0.1e-3)
    names = ["sphere.R", "sphere.c", "sphere.tilt_x"]

    found = monte_carlo_table(names, surface, noise=WhiteNoise(5 * NM), draws=120)

    drawn = Surface(
        surface.z + 5 * NM * np.random.default_rng(3).standard_normal(x.shape), 0.1e-3, 0.1e-3
    )
    white = fit(drawn, Sphere()).u_white
    for name in names:
        assert found[name].u == pytest.approx(white[name.partition(".")[2]], rel=0.2, abs=0.0)
    assert found.correlation[0, 1] < -0.99  # R = 1 / c
    assert abs(found.correlation[1, 2]) < 0.3


def test_each_draw_is_filtered_before_it_is_evaluated():
    """Waves that the filter takes out bring no scatter; noise that it lets through does."""
    profile = rough()

    def prepare(drawn):
        return roughness(drawn, lambda_c=0.25e-3)

    told = []
    found = monte_carlo_table(
        ["Rz", "Rk"],
        profile,
        noise=WhiteNoise(10 * NM),
        draws=20,
        prepare=prepare,
        tell=told.append,
    )
    one = monte_carlo("Rz", profile, noise=WhiteNoise(10 * NM), draws=20, prepare=prepare)
    assert np.array_equal(found["Rz"].draws, one.draws)
    rough_rz = profile_parameters(prepare(profile), kind="R", names=["Rz"])["Rz"].value
    assert found["Rz"].value == rough_rz
    assert len(told) == 1
    assert told[0].startswith("20 draws take about")


def test_options_reach_the_table():
    old = monte_carlo(
        "RSm",
        rough(),
        noise=WhiteNoise(NM),
        draws=20,
        options={"edition": "ISO 4287:1997", "sections": 4},
    )
    new = monte_carlo("Rsm", rough(), noise=WhiteNoise(NM), draws=20)
    assert old.value != new.value
    direct = profile_parameters(
        rough(), kind="R", edition="ISO 4287:1997", sections=4, names=["RSm"]
    )
    assert old.value == direct["RSm"].value


def test_what_cannot_be_drawn_is_refused():
    noise = WhiteNoise(NM)
    with pytest.raises(DataError, match="nearest"):
        monte_carlo_table(["Rdx"], rough(), noise=noise, draws=20)
    with pytest.raises(DataError, match="no parameter"):
        monte_carlo_table(["Sq"], rough(), noise=noise, draws=20)
    with pytest.raises(DataError, match="a fit of the sphere gives"):
        monte_carlo_table(["sphere.k"], bumps(), noise=noise, draws=20)
    with pytest.raises(DataError, match="noise= or at least one effect"):
        monte_carlo_table(["Rq"], rough(), draws=20)
    with pytest.raises(TooFewSamplesError, match="draws"):
        monte_carlo_table(["Rq"], rough(), noise=noise, draws=3)
    flaky = iter([False, *[True] * 40])

    def prepare(drawn):
        if next(flaky):
            raise DataError("not this one")
        return drawn

    with pytest.raises(DataError, match="of 20 draws could not be evaluated, more than 1 %"):
        monte_carlo_table(["Rq"], rough(), noise=noise, draws=20, prepare=prepare)

"""Uncertainty of fits to maps whose residual is not white: z-scores over simulated noise."""

from itertools import cycle

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metrosep.core.surface import Surface
from metrosep.forms import Toric
from metrosep.machine._measured import map_noise
from metrosep.machine.chains import presets
from metrosep.machine.identification import identify

HONEST = (0.7, 1.4)
"""RMS of z-scores. 40 maps with 6 columns, about 240 scores: known to 5 % where independent."""

N = 50


def waves(rng, sigma, n=N):
    """Return waviness of unit size: white noise after a Gaussian filter, no edge in it."""
    edge = int(6 * sigma) + 1
    w = gaussian_filter(rng.standard_normal((n + 2 * edge,) * 2), sigma)[edge:-edge, edge:-edge]
    return w * 2 * np.sqrt(np.pi) * sigma


def exponential(rng, length, n=N):
    """Return noise whose likeness falls exponentially: no bell, by its spectrum on a large torus."""
    f = 2 * np.pi * np.hypot(*np.meshgrid(np.fft.fftfreq(4 * n), np.fft.fftfreq(4 * n)))
    density = (1 + (f * length) ** 2) ** -1.5
    white = np.fft.fft2(rng.standard_normal(f.shape))
    return np.fft.ifft2(white * np.sqrt(density / density.mean())).real[:n, :n]


NOISES = {
    "white": lambda rng: rng.standard_normal((N, N)),
    "1 px": lambda rng: waves(rng, 1),
    "2 px": lambda rng: waves(rng, 2),
    "4 px": lambda rng: waves(rng, 4),
    "6 px below white": lambda rng: 0.5 * waves(rng, 6) + 2 * rng.standard_normal((N, N)),
    "2 px and white": lambda rng: waves(rng, 2) + rng.standard_normal((N, N)),
    "exponential": lambda rng: exponential(rng, 3),
}


def fit(x, inside):
    """Return columns of a part (alignment, cone, saddles) as rows of an estimator, and a basis."""
    X, Y = np.meshgrid(x, x)
    rho, phi = np.hypot(X, Y), np.arctan2(Y, X)
    maps = (np.ones_like(X), X, Y, rho, rho * np.cos(2 * phi), rho * np.sin(2 * phi))
    columns = np.column_stack([m[inside] for m in maps])
    q, r = np.linalg.qr(columns)
    return q @ np.linalg.inv(r).T, q


@pytest.mark.parametrize(
    ("name", "part"),
    [
        pytest.param(name, part, marks=() if part == parts[0] else pytest.mark.slow)
        for name, parts in zip(
            NOISES, cycle((("square", "round"), ("round", "square"))), strict=False
        )
        for part in parts
    ],
)
def test_scores_are_one(name, part):
    x = np.linspace(-1, 1, N)
    inside = np.hypot(x, x[:, None]) < (1.0 if part == "round" else 2.0)
    rows, basis = fit(x, inside)
    place = np.flatnonzero(inside)
    rng = np.random.default_rng(7)
    scores = []
    for _ in range(40):
        noise = NOISES[name](rng)[inside]
        residual = noise - basis @ (basis.T @ noise)
        cov = map_noise(residual, basis, place, inside.shape).covariance(rows)
        scores.append(rows.T @ noise / np.sqrt(np.diag(cov)))
    assert HONEST[0] < np.sqrt(np.mean(np.square(scores))) < HONEST[1]


def test_the_noise_itself_comes_back():
    """2 px waviness of 1.0 and white noise of 1.0, within 10 % of variance over 5 maps."""
    place = np.arange(120 * 120)
    basis = np.full((place.size, 1), 1 / 120)
    rng = np.random.default_rng(1)
    white, wavy = [], []
    for _ in range(5):
        noise = (waves(rng, 2, 120) + rng.standard_normal((120, 120))).ravel()
        found = map_noise(noise - noise.mean(), basis, place, (120, 120))
        white.append(found.variances[0])
        wavy.append(sum(found.variances[1:]))
    assert np.mean(white) == pytest.approx(1.0, abs=0.1)
    assert np.mean(wavy) == pytest.approx(1.0, abs=0.1)


def test_no_noise_and_few_points():
    basis = np.full((100, 1), 0.1)
    found = map_noise(np.zeros(100), basis, np.arange(100), (10, 10))
    assert (found.covariance(basis) == 0.0).all()
    few = map_noise(np.array([1.0, -1.0, 1.0, -1.0]), np.full((4, 1), 0.5), np.arange(4), (2, 2))
    assert few.covariance(np.full((4, 1), 0.5))[0, 0] == pytest.approx(4 / 3, abs=1e-12)


R = 20e-3
TORIC = Toric(Rb=0.265, Rd=0.1325)
NM = 1e-9


@pytest.fixture(scope="module")
def lathe():
    return presets("fts_lathe", radius=R)


def test_scores_of_terms_and_freedoms_of_an_identification(lathe):
    """0.5 nm waviness of 6 px below 2 nm of white noise: the lag-one correlation shows nothing."""
    x = np.linspace(-0.7 * R, 0.7 * R, N)
    step = x[1] - x[0]
    clean = TORIC(x, x[:, None]) - 2e-5 * (R - np.hypot(x, x[:, None]))
    names = ["EXX", "EYX", "B0Z"]
    exact = identify(lathe, Surface(clean, dx=step, dy=step), form=TORIC, terms=names)
    rng = np.random.default_rng(3)
    scores = []
    for _ in range(30):
        z = clean + NM * NOISES["6 px below white"](rng)
        found = identify(lathe, Surface(z, dx=step, dy=step), form=TORIC, terms=names)
        tilt = found.freedoms["tilt_x"]
        scores.append(
            [
                *((found.values - exact.values) / found.u),
                (tilt[0] - exact.freedoms["tilt_x"][0]) / tilt[1],
            ]
        )
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (rms > 0.5).all()
    assert HONEST[0] < np.sqrt(np.mean(rms**2)) < HONEST[1]


def test_thinning_changes_no_uncertainty_of_waviness(lathe):
    """Every third pixel of a smooth error knows as much as every one."""
    x = np.linspace(-0.7 * R, 0.7 * R, 150)
    step = x[1] - x[0]
    z = TORIC(x, x[:, None]) - 2e-5 * (R - np.hypot(x, x[:, None]))
    z = z + 2 * NM * waves(np.random.default_rng(0), 8, 150)
    whole, thin = (
        identify(
            lathe, Surface(z, dx=step, dy=step), form=TORIC, terms=["B0Z", "EXX"], max_points=m
        )
        for m in (100_000, 3000)
    )
    assert (whole.audit["stride"], thin.audit["stride"]) == (1, 3)
    # the model of the noise differs by chance
    assert thin.u == pytest.approx(whole.u, abs=0.25 * whole.u.max())
    assert whole.audit["inflation"] > 2 * thin.audit["inflation"] > 4
    assert "not white" in thin.messages[-1]


def test_scattered_points_say_what_they_do_not_know(lathe):
    x = np.linspace(-0.7 * R, 0.7 * R, N)
    X, Y = np.meshgrid(x, x)
    z = TORIC(X, Y) - 2e-5 * (R - np.hypot(X, Y))
    z = z + NM * NOISES["4 px"](np.random.default_rng(2))
    points = tuple(v.ravel() for v in (X, Y, z))
    scattered = identify(lathe, points, form=TORIC, terms=["B0Z"])
    as_map = identify(lathe, (X, Y, z), form=TORIC, terms=["B0Z"])
    assert any("white residual only" in m for m in scattered.messages)
    assert not any("white residual only" in m for m in as_map.messages)
    assert as_map["B0Z"].value == pytest.approx(scattered["B0Z"].value, abs=1e-15)
    assert as_map["B0Z"].u > 5 * scattered["B0Z"].u

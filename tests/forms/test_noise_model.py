"""u of a fit from a noise model that is given: a table worked out by other code, and drawn fits."""

import numpy as np
import pytest
from scipy.stats import t as student

from metrosep import Profile, Surface
from metrosep.core.errors import DataError
from metrosep.forms import Plane, PointSet, Polynomial, Sphere, fit
from metrosep.forms._correlated import COVERAGE, _half_width, expanding_factor
from metrosep.parameters import CorrelatedNoise, NoiseFromRepeats, WhiteNoise

MM, NM = 1e-3, 1e-9
TABLE = {
    0.0: (0.574583, 0.117372, 8.24921e-5, 0.296972, -0.865597),
    0.4: (1.58449, 0.317432, 2.17489e-4, 0.782959, -0.865014),
    1.0: (3.72664, 0.731440, 4.76668e-4, 1.71600, -0.862008),
    2.0: (6.47619, 1.24867, 7.26660e-4, 2.61598, -0.850867),
}
"""Correlation length in mm: u of piston / nm, tilt / urad, c / (1/m), R / um; corr(piston, c)."""
STEP = 0.25 * MM


def disc():
    x = (np.arange(40) - 19.5) * STEP
    X, Y = np.meshgrid(x, x)
    z = Sphere(R=60 * MM).height(X, Y)
    z = np.where(X**2 + Y**2 <= (4.9 * MM) ** 2, z, np.nan)
    return Surface(z, STEP, STEP, origin=(x[0], x[0]))


@pytest.mark.parametrize("length", TABLE)
def test_sphere_under_a_given_noise(length):
    noise = CorrelatedNoise(10 * NM, length * MM) if length else WhiteNoise(10 * NM)
    found = fit(disc(), Sphere(), noise=noise)
    u = found.u
    piston, tilt, c, R, corr = TABLE[length]
    assert found.n_points == 1208
    assert u["piston"] / NM == pytest.approx(piston, rel=1e-5, abs=0.0)
    assert u["tilt_x"] * 1e6 == pytest.approx(tilt, rel=1e-5, abs=0.0)
    assert u["tilt_y"] * 1e6 == pytest.approx(tilt, rel=1e-5, abs=0.0)
    assert u["c"] == pytest.approx(c, rel=1e-5, abs=0.0)
    assert u["R"] * 1e6 == pytest.approx(R, rel=1e-5, abs=0.0)
    at = [found.names.index(n) for n in ("piston", "R")]
    assert -found.correlations[at[0], at[1]] == pytest.approx(
        corr, rel=1e-5, abs=0.0
    )  # R falls as c grows
    assert "noise model that was given" in found.assumption
    assert found.coverage_factor == pytest.approx(2.0, rel=1e-6, abs=0.0)


def test_profile_with_gaps_scatters_as_said():
    x = np.arange(300) * 10e-6
    gaps = np.zeros(300)
    gaps[100:140] = np.nan
    noise = CorrelatedNoise(5 * NM, 80e-6)
    fields = noise.draw(Profile(x, gaps), np.random.default_rng(1), 400)
    slopes = [fit(Profile(x, f + gaps), Polynomial(1)).params["c1"] for f in fields]
    u = fit(Profile(x, gaps), Polynomial(1), noise=noise).u["c1"]
    assert np.std(slopes) == pytest.approx(u, rel=0.1, abs=0.0)


def test_what_has_no_covariance_is_refused():
    with pytest.raises(DataError, match="covariance against lag"):
        fit(disc(), Plane(), noise=2e-9)
    rng = np.random.default_rng(0)
    stack = [Surface(rng.standard_normal((40, 40)) * NM, STEP, STEP) for _ in range(3)]
    with pytest.raises(DataError, match="covariance against lag"):
        fit(disc(), Plane(), noise=NoiseFromRepeats(stack))
    with pytest.raises(DataError, match="no lags"):
        fit(PointSet([0, 1, 2, 0], [0, 0, 1, 2], [0, 1, 2, 3]), Plane(), noise=WhiteNoise(1e-9))


def test_u_of_a_mixture_holds_95_percent_and_of_nothing_is_nothing():
    """One of the columns has no deviation in any part, another in one part only."""
    weights, freedom = np.array([0.6, 0.4]), np.array([5.0, 12.0])
    sd = np.array([[0.0, 2.0, 0.0], [0.0, 3.0, 1.0]])
    u = _half_width(weights, sd, freedom, COVERAGE) / expanding_factor(9)

    assert u[0] == 0.0
    half = expanding_factor(9) * u[1:]
    both = weights @ (1.0 - 2.0 * student.sf(half[0] / sd[:, 1], freedom))
    one = 0.6 + 0.4 * (1.0 - 2.0 * student.sf(half[1], 12.0))
    assert both == pytest.approx(COVERAGE, abs=1e-12)
    assert one == pytest.approx(COVERAGE, abs=1e-12)

"""Shift-rotation: joint fit, power and astigmatism in the null space, known power, noise."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import DataError, DegenerateFitError, NotSeparableError
from metrosep.separation.maps.lateral_shifts import ShiftRotation, shift_rotation

EXACT = 1e-15
"""1e-7 of 20 nm: rounding times the condition of the joint fit."""

N = 41
G = np.linspace(-1.0, 1.0, N)
X, Y = np.meshgrid(G, G)
STEP = G[1] - G[0]
POWERS = [(i, k - i) for k in range(2, 7) for i in range(k + 1)]
"""Monomials of degree 2 to 6: with piston and tilt the space of 28 Zernike terms."""

ANGLES = np.radians([0.0, 0.0, 0.0, 90.0, 133.0])
SHIFTS = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, -0.25], [0.0, 0.0], [0.0, 0.0]])


def monomials(x, y):
    return np.stack([x**i * y**j for i, j in POWERS])


def coefficients_of(z):
    a = np.concatenate([np.ones((1, *X.shape)), [X, Y], monomials(X, Y)]).reshape(
        3 + len(POWERS), -1
    )
    return np.linalg.lstsq(a.T, z.ravel(), rcond=None)[0]


def at(c, x, y):
    return c[0] + c[1] * x + c[2] * y + np.tensordot(c[3:], monomials(x, y), axes=1)


def rigid_off(z, power=True):
    """Map without its Zernike piston, tilts and power: fitted with all 28 on the square."""
    return at(without_terms(coefficients_of(z), power), X, Y)


def without_terms(c, power):
    """Coefficients with the Zernike terms (0, 0), (1, 1), (1, -1) and (2, 0) set to zero.

    On monomials: moments over the unit disc give the Zernike coefficients.
    """
    t = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    r, w = np.sqrt((nodes + 1) / 2), weights / 2  # uniform over the disc
    u, v = np.outer(r, np.cos(t)) * R, np.outer(r, np.sin(t)) * R
    mean = lambda f: float((w[:, None] * f).sum() / 64)  # noqa: E731
    z = at(c, u, v)
    out = np.array(c)
    out[0] -= mean(z)
    out[1] -= 4 * mean(z * u) / R**2
    out[2] -= 4 * mean(z * v) / R**2
    if power:
        p = 3 * mean(z * (2 * (u**2 + v**2) / R**2 - 1))
        out[0] += p
        for key in ((2, 0), (0, 2)):
            out[3 + POWERS.index(key)] -= 2 * p / R**2
    return out


R = math.sqrt(2.0)
"""Farthest pixel of the square: the radius of the library's disc."""


def random_map(rng, power=True, size=20e-9):
    c = np.concatenate([[0, 0, 0], size * rng.standard_normal(len(POWERS))])
    return at(without_terms(c, power), X, Y)


def all_readings(part, instrument, angles, shifts):
    p, i = coefficients_of(part), coefficients_of(instrument)
    out = []
    for a, (sx, sy) in zip(angles, shifts, strict=True):
        x, y, c, s = X - sx, Y - sy, math.cos(a), math.sin(a)
        out.append(at(i, X, Y) + at(p, c * x + s * y, -s * x + c * y))
    return np.stack(out)


class TestShiftsAndTurns(SeparationContract):
    has_redundancy = True
    sd = 1e-9
    exact = 1e-8

    def method(self):
        return ShiftRotation(ANGLES.tolist(), SHIFTS.tolist(), dx=STEP)

    def truth(self, rng):
        return {"part": random_map(rng)}

    def errors(self, rng):
        return {"instrument": random_map(rng)}

    def readings(self, truth, errors):
        zero = np.zeros((N, N))
        part, instrument = truth.get("part", zero), errors.get("instrument", zero)
        return all_readings(np.asarray(part), np.asarray(instrument), ANGLES, SHIFTS)

    def test_power_and_planes_reach_no_part(self):
        *_, readings = self.draw(8)
        plain = self.method().separate(readings)
        bowl = 1e-7 * (X**2 + Y**2)
        extra = all_readings(bowl, -bowl, ANGLES, SHIFTS)
        assert np.abs(extra - np.mean(extra)).max() > 1e-9  # planes only
        seen = self.method().separate(readings + extra)
        for name in ("part", "instrument"):
            np.testing.assert_allclose(seen.parts[name], plain.parts[name], rtol=0.0, atol=EXACT)
        assert [i.part for i in plain.null_space if "defocus" in i.indices] == [
            "part",
            "instrument",
        ]


def test_shifts_alone_lose_astigmatism_as_well():
    """Second order of a shifted part is a plane: power and both astigmatisms are seen by nothing."""
    rng = np.random.default_rng(1)
    shifts = [[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]]
    readings = all_readings(random_map(rng), random_map(rng), [0.0] * 3, shifts)
    result = shift_rotation(readings, [0.0] * 3, shifts, dx=STEP)
    lost = {t for i in result.null_space for t in i.indices}
    assert {"defocus", "astigmatism 0 deg", "astigmatism 45 deg"} <= lost
    assert "coma x" not in lost
    assert any("astigmatism" in m for m in result.messages)
    n, m = result.coordinates["zernike_n"], result.coordinates["zernike_m"]
    assert np.isnan(result.zernike_part[(n == 2) & (np.abs(m) == 2)]).all()


def test_known_power_comes_in_with_its_uncertainty():
    rng = np.random.default_rng(2)
    part, instrument = random_map(rng, power=False), random_map(rng, power=False)
    r2 = 2 * (X**2 + Y**2) / R**2 - 1
    bare = rigid_off(part)
    value = float((part - bare)[0, 0] / r2[0, 0])
    readings = all_readings(part, instrument, ANGLES, SHIFTS)
    result = shift_rotation(readings, ANGLES, SHIFTS, dx=STEP, power=(value, 2e-9), u_reading=0.0)

    assert np.abs(result.part - part).max() < EXACT
    assert np.abs(result.instrument - instrument).max() < EXACT
    assert not any("defocus" in i.indices for i in result.null_space)
    # an error of the stated power goes into the part, and with the other sign into the instrument
    wrong = shift_rotation(readings, ANGLES, SHIFTS, dx=STEP, power=(value + 2e-9, 0.0))
    np.testing.assert_allclose(wrong.part - part, 2e-9 * r2, rtol=0.0, atol=EXACT)
    np.testing.assert_allclose(wrong.instrument - instrument, -2e-9 * r2, rtol=0.0, atol=EXACT)
    np.testing.assert_allclose(result.u["part"], 2e-9 * np.abs(r2), rtol=0.0, atol=EXACT)


def test_noise_grows_as_the_shift_shrinks():
    """Third order needs the second difference of one shift: sd of coma grows as 1/shift."""
    u = []
    for shift in (0.4, 0.2, 0.1):
        shifts = [[0.0, 0.0], [shift, 0.0], [0.0, shift]]
        rng = np.random.default_rng(3)
        readings = all_readings(random_map(rng), random_map(rng), [0.0] * 3, shifts)
        result = shift_rotation(readings, [0.0] * 3, shifts, terms=10, dx=STEP, u_reading=1e-9)
        n, m = result.coordinates["zernike_n"], result.coordinates["zernike_m"]
        u.append(float(result.u["zernike_part"][(n == 3) & (m == 3)][0]))
    assert u[1] / u[0] == pytest.approx(2.0, rel=0.1, abs=0.0)
    assert u[2] / u[1] == pytest.approx(2.0, rel=0.1, abs=0.0)


def test_bad_input():
    z = np.zeros((3, N, N)) + 1e-9 * X * Y
    with pytest.raises(NotSeparableError, match="neither turned nor shifted"):
        shift_rotation(z, [0.0] * 3, np.zeros((3, 2)))
    with pytest.raises(DataError, match="degrees"):
        shift_rotation(z, [0.0, 90.0, 45.0], np.zeros((3, 2)))
    with pytest.raises(DataError, match="one finite shift"):
        shift_rotation(z, [0.0] * 3, np.zeros((2, 2)))
    with pytest.raises(DataError, match="no numbers"):
        shift_rotation(z, [0.0] * 3, [["a", "b"]] * 3)
    with pytest.raises(DataError, match="known power"):
        shift_rotation(z, [0.0, 1.0, 2.0], np.zeros((3, 2)), power=(math.nan, 0.0))
    spot = np.where(np.hypot(X, Y) < 0.2, z, np.nan)
    with pytest.raises(DegenerateFitError, match="fewer terms"):
        shift_rotation(spot, [0.0, 1.0, 2.0], np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"power": 3}, "power must be the known value and"),
        ({"power": (1e-9,)}, "power must be the known value and"),
        ({"terms": 36.0}, "terms must be a whole number"),
        ({"terms": 100000}, "terms go up to"),
        ({"u_reading": "1 V"}, "a length is needed"),
        ({"dx": "1e-4"}, "dx '1e-4' has no unit"),
    ],
)
def test_refused_by_name(options, match):
    z = np.zeros((3, N, N)) + 1e-9 * X * Y
    with pytest.raises(DataError, match=match):
        shift_rotation(z, [0.0, 1.0, 2.0], np.zeros((3, 2)), **options)

"""Three flats: planted asymmetry, null space, Zernike 2..36 (S16), registration, mirrored maps."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

import metrosep as ms
from metrosep.core.errors import DataError, DegenerateFitError, MetrosepError, NotSeparableError
from metrosep.separation.maps.flats import ThreeFlat, three_flat

ZERNIKE_EXACT = 1e-17
"""S16 asks for 0.1 nm; a least-squares fit of 20 nm has rounding only."""

PIXEL_EXACT = 1e-12
"""S16: 1e-4 of 20 nm; interpolation of radial order 7 over 129 pixels, none for 90 degrees."""


def radial(n, m, r):
    """Radial Zernike polynomial by its published sum of factorials."""
    f = math.factorial
    return sum(
        (-1) ** k
        * f(n - k)
        / (f(k) * f((n + m) // 2 - k) * f((n - m) // 2 - k))
        * r ** (n - 2 * k)
        for k in range((n - m) // 2 + 1)
    )


TERMS = [(n, m) for n in range(1, 8) for m in range(-n, n + 1, 2)]
"""Radial orders 1 to 7: Noll 2 to 36."""


def surface(c, x, y):
    """Sum of orthonormal Zernike terms: sum(c**2) is the mean square."""
    r, t = np.hypot(x, y), np.arctan2(y, x)
    z = np.zeros_like(x)
    for a, (n, m) in zip(c, TERMS, strict=True):
        scale = math.sqrt((n + 1) * (1 if m == 0 else 2))
        angle = np.cos(m * t) if m >= 0 else np.sin(-m * t)
        z = z + a * scale * radial(n, abs(m), r) * angle
    return z


N = 129
G = np.linspace(-1.0, 1.0, N)
GX, GY = np.meshgrid(G, G)
ROUND = np.hypot(GX, GY) <= 1.0
STEP = G[1] - G[0]


def flats(seed, rms=20e-9):
    c = np.random.default_rng(seed).standard_normal((3, len(TERMS)))
    return rms * c / np.sqrt((c**2).sum(axis=1, keepdims=True))


def turned_at(c, angle, shift, flip):
    """Flat at turned, shifted and (flip) mirrored coordinates: exact, without interpolation."""
    x, y = GX - shift[0], GY - shift[1]
    u = math.cos(angle) * x + math.sin(angle) * y
    v = -math.sin(angle) * x + math.cos(angle) * y
    if flip == "x":
        u = -u
    elif flip == "y":
        v = -v
    return surface(c, u, v)


def readings(c, angles=(), *, pair="AB", turned="first", flip="x", shifts=None, noise=0.0, seed=0):
    """AB, AC, BC, turned ones; each with its own plane."""
    rng = np.random.default_rng(seed)
    setups = [("AB", 0.0, 0.0), ("AC", 0.0, 0.0), ("BC", 0.0, 0.0)]
    setups += [(pair, a, 0.0) if turned == "first" else (pair, 0.0, a) for a in angles]
    shifts = np.zeros((len(setups), 2)) if shifts is None else shifts
    out = []
    for (names, first, second), s in zip(setups, shifts, strict=True):
        a, b = (c["ABC".index(k)] for k in names)
        moved_first = first != 0.0
        z = turned_at(a, first, s if moved_first else (0, 0), None)
        z = z + turned_at(b, second, (0, 0) if moved_first else s, flip)
        p, qx, qy = 3e-7 * rng.standard_normal(3)
        z = z + p + qx * GX + qy * GY + noise * rng.standard_normal(z.shape)
        out.append(np.where(ROUND, z, np.nan))
    return out


def plane_off(z):
    ok = np.isfinite(z)
    a = np.column_stack([np.ones(ok.sum()), GX[ok], GY[ok]])
    return (
        z - np.stack([np.ones_like(GX), GX, GY], axis=2) @ np.linalg.lstsq(a, z[ok], rcond=None)[0]
    )


def without(c, hidden):
    """Coefficients with the hidden (n, m) set to zero."""
    return np.array([0.0 if nm in hidden else a for a, nm in zip(c, TERMS, strict=True)])


def odd_terms(orders, flip):
    """Terms of these angular orders that change sign under the mirror."""

    def is_odd(m):
        sine = m < 0
        return sine if flip == "y" or m % 2 == 0 else not sine

    return [(n, m) for n, m in TERMS if abs(m) in orders and is_odd(m)]


def worst(result, c, hidden=()):
    errors = []
    for name, coefficients in zip("ABC", c, strict=True):
        error = result.parts[name] - surface(without(coefficients, hidden), GX, GY)
        assert np.isfinite(error).sum() > 0.85 * ROUND.sum()
        errors.append(np.nanmax(np.abs(plane_off(error))))
    return max(errors)


CASES = [
    ([90.0], "AB", "first", [4]),
    ([90.0], "AB", "second", [4]),
    ([180.0], "AC", "first", [2, 4, 6]),
    ([180.0, 90.0], "AB", "first", [4]),
    ([90.0, 180.0, 270.0], "AB", "first", [4]),
    ([180.0, 90.0, 45.0], "AB", "first", []),
    ([45.0], "BC", "first", []),
    ([54.0], "AB", "second", []),
    ([-120.0, 120.0], "AB", "first", [3, 6]),
]


@pytest.mark.parametrize("method", ["pixel", "zernike", "iterative"])
@pytest.mark.parametrize(("degrees", "pair", "turned", "orders"), CASES)
def test_three_flats_come_back(degrees, pair, turned, orders, method):
    """S16: noise-free, on the recoverable subspace, signs and mirror planted."""
    flip = "y" if len(degrees) == 2 else "x"
    c, angles = flats(1), np.radians(degrees)
    data = readings(c, angles, pair=pair, turned=turned, flip=flip)
    result = three_flat(
        *data[:3], data[3:], angles, pairs=pair, turned=turned, flip=flip, method=method, dx=STEP
    )
    hidden = odd_terms(orders, flip)

    assert worst(result, c, hidden) < (PIXEL_EXACT if method == "pixel" else ZERNIKE_EXACT)
    assert not result.messages
    if method == "pixel":
        listed = [i for i in result.null_space if i.part == "A" and i.kind == "angular order"]
        found = [m for i in listed for m in i.indices if m <= 7]
    else:
        listed = [i for i in result.null_space if i.part == "A" and "mirror" in i.reason]
        names = [n for i in listed for n in i.indices]
        found = {abs(m) for n, m in TERMS if any(f"Z({n}, {m})" in text for text in names)}
    assert sorted(found) == orders


def test_any_angle_goes_by_zernike_terms():
    c, angles = flats(2), np.radians([37.3, 101.9])
    data = readings(c, angles)
    result = three_flat(*data[:3], data[3:], angles)

    assert result.audit["method"] == "zernike"
    assert worst(result, c) < ZERNIKE_EXACT


def test_coefficients_are_those_planted_and_nan_where_hidden():
    c = flats(3)
    data = readings(c, [np.pi / 2])
    result = three_flat(*data[:3], data[3], np.pi / 2, method="zernike", terms=36)
    nm = list(
        zip(*(result.coordinates[k].astype(int) for k in ("zernike_n", "zernike_m")), strict=True)
    )

    for k, flat in enumerate("ABC"):
        for (n, m), found in zip(nm, result.parts[f"zernike_{flat}"], strict=True):
            if n <= 1 or (n, m) in ((4, -4), (6, -4)):
                assert math.isnan(found)
                continue
            scale = math.sqrt((n + 1) * (1 if m == 0 else 2))
            assert abs(found - scale * c[k][TERMS.index((n, m))]) < ZERNIKE_EXACT, (flat, n, m)


class TestDiameter:
    """Nothing turned: exact on the diameter, wrong beside it, so NaN there."""

    @pytest.mark.parametrize("flip", ["x", "y"])
    def test_known_on_the_diameter_only(self, flip):
        c = flats(4)
        result = three_flat(*readings(c, flip=flip), flip=flip)
        middle = (slice(None), N // 2) if flip == "x" else (N // 2, slice(None))
        for name, coefficients in zip("ABC", c, strict=True):
            found = result.parts[name]
            beside = np.ones_like(found, dtype=bool)
            beside[middle] = False
            assert np.isnan(found[beside]).all()
            error = found[middle] - surface(coefficients, GX, GY)[middle]
            ok = np.isfinite(error)  # a line is alignment
            assert ok.sum() == N
            assert np.abs(error - np.polyval(np.polyfit(G, error, 1), G)).max() < ZERNIKE_EXACT
            np.testing.assert_array_equal(result.parts[f"diameter_{name}"], found[middle])
        assert any("diameter only" in m for m in result.messages)

    def test_even_share_is_known_everywhere(self):
        c = flats(5)
        result = three_flat(*readings(c))
        for name, coefficients in zip("ABC", c, strict=True):
            z = surface(coefficients, GX, GY)
            error = plane_off(np.where(ROUND, result.parts[f"even_{name}"] - (z + z[:, ::-1]) / 2,
                                       np.nan))  # fmt: skip
            assert np.nanmax(np.abs(error)) < ZERNIKE_EXACT

    def test_odd_share_cannot_be_known(self):
        """A common odd share changes no reading: S16 null space, planted."""
        c, extra = flats(6), np.zeros(len(TERMS))
        extra[TERMS.index((3, 1))] = 30e-9  # coma x
        for a, b in zip(readings(c), readings(c + extra), strict=True):
            np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-21)
        assert set(three_flat(*readings(c)).null_space[0].indices) >= {1, 2, 3, 4}

    def test_noise_on_the_diameter(self):
        """sqrt(3)/2 of one reading, found without u_reading from the closure of the odd shares."""
        rng, sd = np.random.default_rng(7), 1e-9
        maps = [np.where(ROUND, sd * rng.standard_normal(GX.shape), np.nan) for _ in range(3)]
        found = [
            three_flat(*[np.where(ROUND, sd * rng.standard_normal(GX.shape), np.nan)
                         for _ in range(3)]).diameter_A for _ in range(40)
        ]  # fmt: skip
        result = three_flat(*maps)
        law = math.sqrt(3) / 2 * sd

        assert result.noise.value == pytest.approx(sd, rel=0.03, abs=0.0)
        assert np.nanmean(result.u["A"]) == pytest.approx(law, rel=0.03, abs=0.0)
        assert np.std(found) == pytest.approx(law, rel=0.05, abs=0.0)

    def test_even_number_of_columns_has_the_diameter_between_them(self):
        c = flats(8)
        maps = [m[:, 1:] for m in readings(c)]  # now the middle is half a pixel aside
        x = GX[:, 1:] - STEP / 2
        a, b, cc = (lambda x, y, k=k: surface(c[k], x, y) for k in range(3))
        maps = [a(x, GY[:, 1:]) + b(-x, GY[:, 1:]), a(x, GY[:, 1:]) + cc(-x, GY[:, 1:]),
                b(x, GY[:, 1:]) + cc(-x, GY[:, 1:])]  # fmt: skip
        result = three_flat(*maps)

        assert np.isnan(result.A).all()
        assert any("between two pixels" in m for m in result.messages)
        error = result.diameter_A - a(np.zeros(N), G)
        assert np.abs(error - np.polyval(np.polyfit(G, error, 1), G)).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "degrees"), [("pixel", [90.0]), ("pixel", [45.0]), ("zernike", [90.0])]
)
def test_noise_is_found_and_propagated(method, degrees):
    c, sd, angles = flats(9), 1e-9, np.radians(degrees)
    hidden = odd_terms([4], "x") if degrees == [90.0] else []
    errors, u, noise = [], [], []
    for seed in range(4):
        data = readings(c, angles, noise=sd, seed=seed)
        result = three_flat(*data[:3], data[3:], angles, method=method)
        for name, k in zip("ABC", c, strict=True):
            e = plane_off(result.parts[name] - surface(without(k, hidden), GX, GY))
            errors.append(np.nanmean(e**2))
            u.append(np.nanmean(result.u[name] ** 2))
        noise.append(result.noise.value)

    assert np.mean(noise) == pytest.approx(sd, rel=0.03, abs=0.0)
    assert math.sqrt(np.mean(u)) == pytest.approx(math.sqrt(np.mean(errors)), rel=0.1, abs=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["pixel", "zernike"])
def test_registration_error_is_reported(method):
    """S16: half a pixel; RMS error against RMS u within 20 %, over 20 draws."""
    c, rng = flats(10), np.random.default_rng(11)
    exact = readings(c, [np.pi / 2])
    stated = three_flat(*exact[:3], exact[3], np.pi / 2, method=method, dx=STEP, u_reading=0.0,
                        u_registration=0.5 * STEP)  # fmt: skip
    hidden = odd_terms([4], "x")
    squares = {name: [] for name in "ABC"}
    for _ in range(20):
        data = readings(c, [np.pi / 2], shifts=0.5 * STEP * rng.standard_normal((4, 2)))
        result = three_flat(*data[:3], data[3], np.pi / 2, method=method, dx=STEP, u_reading=0.0)
        for name, k in zip("ABC", c, strict=True):
            e = plane_off(result.parts[name] - surface(without(k, hidden), GX, GY))
            squares[name].append(np.nanmean(e**2))
    for name, s in squares.items():
        u = math.sqrt(np.nanmean(stated.u[name] ** 2))
        assert u == pytest.approx(math.sqrt(np.mean(s)), rel=0.2, abs=0.0), name


def test_one_shifted_reading_is_reported():
    """Half a pixel along x in the turned reading alone."""
    c = flats(12)
    shifts = np.zeros((4, 2))
    shifts[3, 0] = 0.5 * STEP
    data = readings(c, [np.pi / 2], shifts=shifts)
    result = three_flat(
        *data[:3], data[3], np.pi / 2, dx=STEP, u_reading=0.0,
        u_registration=np.abs(shifts),
    )  # fmt: skip
    e = plane_off(result.A - surface(without(c[0], odd_terms([4], "x")), GX, GY))
    u = math.sqrt(np.nanmean(result.u["A"] ** 2))

    assert u == pytest.approx(math.sqrt(np.nanmean(e**2)), rel=0.2, abs=0.0)


class TestQuarterTurn(SeparationContract):
    has_redundancy = True
    sd = 1e-9

    def method(self):
        return ThreeFlat(angles=(np.pi / 2,))

    def truth(self, rng):
        y, x = np.mgrid[-12:13, -12:13] / 12.0
        out = {}
        for name in "ABC":
            z = 20e-9 * rng.standard_normal(x.shape)
            four = sum(np.rot90(z, k) for k in range(4)) / 4
            z = z - (four - four[:, ::-1]) / 2  # a common odd share of orders 4, 8, ... is hidden
            a = np.column_stack([np.ones(x.size), x.ravel(), y.ravel()])
            out[name] = z - (a @ np.linalg.lstsq(a, z.ravel(), rcond=None)[0]).reshape(z.shape)
        return out

    def errors(self, rng):
        return {}

    def readings(self, truth, errors):
        a, b, c = (np.asarray(truth.get(k, np.zeros((25, 25)))) for k in "ABC")
        f = np.fliplr
        return np.stack([a + f(b), a + f(c), b + f(c), np.rot90(a, -1) + f(b)])

    def invisible(self, rng):
        y, x = np.mgrid[-12:13, -12:13] / 12.0
        leaf = 1e-7 * (x**3 * y - x * y**3)
        yield {"A": leaf, "B": leaf, "C": leaf}, {}


class TestDoubts:
    def test_mirrored_reading(self):
        c = flats(13)
        data = readings(c, [np.pi / 2], noise=1e-11)
        data[1] = data[1][:, ::-1]
        result = three_flat(*data[:3], data[3], np.pi / 2)
        assert any("reading 2 (AC) looks mirrored" in m for m in result.messages)

    def test_other_mirror_axis(self):
        c = flats(14)
        data = readings(c, [np.pi / 4], noise=1e-11, flip="y")
        result = three_flat(*data[:3], data[3], np.pi / 4, flip="x")
        assert any("flip='y' fits better" in m for m in result.messages)

    def test_other_sign_of_the_angle(self):
        c = flats(15)
        data = readings(c, [np.pi / 2], noise=1e-11)
        result = three_flat(*data[:3], data[3], -np.pi / 2)
        assert any("opposite sign" in m for m in result.messages)

    def test_mid_spatial_waves_are_named_by_zernike(self):
        c = flats(16)
        wave = 5e-9 * np.cos(2 * np.pi * GX * 8)
        data = [m + wave for m in readings(c, [np.pi / 2], noise=1e-10)]
        result = three_flat(*data[:3], data[3], np.pi / 2, method="zernike")
        assert any("do not describe" in m for m in result.messages)


class TestBadInput:
    data = readings(flats(17), [np.pi / 2])

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            ({"angles": 90.0}, "look like degrees"),
            ({"angles": [0.1, 0.2]}, "needs 5 maps"),
            ({"flip": "z"}, "flip is one of"),
            ({"method": "fritz"}, "method is one of"),
            ({"turned": "both"}, "turned is one of"),
            ({"pairs": "BA"}, "pairs must be"),
            ({"removed": ("coma",)}, "removed may hold"),
            ({"u_registration": -1.0}, "u_registration"),
            ({"u_registration": [1e-6, 1e-6]}, "one for each of 4"),
            ({"u_reading": -1.0}, "u_reading"),
            ({"method": "pixel", "angles": 0.777}, "method='zernike'"),
            ({"dx": 1.0, "centre": (60.0, 64.0)}, "middle of the map along x"),
        ],
    )
    def test_options(self, change, match):
        given = {"angles": np.pi / 2, **change}
        with pytest.raises(DataError, match=match):
            three_flat(*self.data[:3], self.data[3], **given)

    def test_angle_without_turn(self):
        with pytest.raises(NotSeparableError, match="angle 0"):
            three_flat(*self.data[:3], self.data[3], 2 * np.pi)
        with pytest.raises(DataError, match="without rotated maps"):
            three_flat(*self.data[:3], angles=[0.5])

    def test_maps_that_do_not_fit(self):
        with pytest.raises(DataError, match="one shape"):
            three_flat(self.data[0], self.data[1], self.data[2][1:])
        half = np.where(GX < -0.2, 1e-9, np.nan)
        with pytest.raises(DataError, match="do not overlap"):
            three_flat(half, half[:, ::-1], half)
        with pytest.raises(DataError, match="counterparts"):
            three_flat(half, half, half)
        spot = np.where(np.hypot(GX, GY) < 0.08, 1e-9 * GX, np.nan)
        with pytest.raises(DegenerateFitError, match="fewer terms"):
            three_flat(spot, spot, spot, method="zernike")

    def test_surfaces(self):
        maps = [ms.Surface(m, STEP, STEP) for m in self.data]
        result = three_flat(*maps[:3], maps[3], np.pi / 2)
        plain = three_flat(*self.data[:3], self.data[3], np.pi / 2, dx=STEP)
        np.testing.assert_array_equal(result.A, plain.A)
        with pytest.raises(MetrosepError, match="not mixed"):
            three_flat(maps[0], self.data[1], self.data[2])


class TestWrongSetUps:
    """What does not fit the set-ups is said; noise and round-off are not."""

    @staticmethod
    def said(maps, angle=np.pi / 2, **options):
        messages = three_flat(*maps[:3], maps[3], angle, dx=STEP, **options).messages
        words = ("are not noise", "mirrored", "fits better", "fit better", "do not describe")
        return [m for m in messages if any(w in m for w in words)]

    @pytest.mark.parametrize("fault", ["angle", "flat", "order"])
    def test_faults(self, fault):
        maps = list(readings(flats(21), [np.pi / 3 if fault == "angle" else np.pi / 2]))
        rng = np.random.default_rng(5)
        maps = [m + 2e-10 * rng.standard_normal(m.shape) for m in maps]
        if fault == "order":
            maps[1], maps[2] = maps[2], maps[1]
        assert self.said(maps, turned="second" if fault == "flat" else "first")

    @pytest.mark.parametrize("angle", [np.pi / 2, np.pi / 3, 0.9])
    def test_noise_alone_raises_no_doubt(self, angle):
        maps = list(readings(flats(21), [angle]))
        rng = np.random.default_rng(6)
        assert not self.said([m + 1e-9 * rng.standard_normal(m.shape) for m in maps], angle)

    def test_round_off_is_no_message(self):
        maps = readings(flats(21), [np.pi / 2])
        assert not self.said(maps)
        assert not self.said(maps, method="zernike")


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"terms": 36.0}, "terms must be a whole number"),
        ({"terms": 100000, "method": "zernike"}, "terms go up to"),
        ({"rotated": None}, "rotated must be"),
        ({"pairs": None}, "pairs must be"),
        ({"dx": "1e-4"}, "dx '1e-4' has no unit"),
        ({"u_reading": "1 V"}, "a length is needed"),
        ({"u_registration": "few"}, "u_registration 'few'"),
        ({"u_registration": 1e-6}, "no lateral step is known"),
        ({"centre": (1,)}, "centre must be two numbers"),
    ],
)
def test_refused_by_name(options, match):
    maps = readings(flats(17), [np.pi / 2])
    with pytest.raises(DataError, match=match):
        three_flat(*maps[:3], **{"rotated": maps[3], "angles": np.pi / 2, **options})


def test_masked_readings_are_not_measured():
    maps = [m.copy() for m in readings(flats(17), [np.pi / 2])]
    maps[1][40:44, 60:64] = np.nan
    masked = [np.ma.array(np.nan_to_num(m, nan=9.0), mask=np.isnan(m)) for m in maps]
    one, two = (three_flat(*m[:3], m[3], np.pi / 2) for m in (maps, masked))
    np.testing.assert_array_equal(one.A, two.A)

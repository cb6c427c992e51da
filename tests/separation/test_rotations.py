"""N-position test: exact by index, angular orders of the null space, uneven angles, registration."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

import metrosep as ms
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
)
from metrosep.separation.maps.rotations import RotationTest, rotation_average

N = 33
LINE = np.linspace(-1.0, 1.0, N)
X, Y = np.meshgrid(LINE, LINE)
DISC = np.hypot(X, Y) <= 1.0


def plane_off(z):
    """Map minus its least-squares plane over the measured pixels."""
    z = np.array(z)
    ok = np.isfinite(z)
    y, x = np.mgrid[: z.shape[0], : z.shape[1]]
    a = np.column_stack([np.ones(ok.sum()), x[ok], y[ok]])
    c = np.linalg.lstsq(a, z[ok], rcond=None)[0]
    return z - c[0] - c[1] * x - c[2] * y


def quarter(z, k):
    """Map turned by k right angles counter-clockwise, rows growing with y."""
    return np.rot90(z, -k)


def seen_by_four(rng, size=20e-9):
    """Random map on the square without orders 0, 4, 8 ... and without plane."""
    z = size * rng.standard_normal((N, N))
    z -= sum(quarter(z, k) for k in range(4)) / 4
    return plane_off(z)


class TestQuarterTurns(SeparationContract):
    has_redundancy = True
    sd = 1e-9

    def method(self):
        return RotationTest(tuple(np.radians([0.0, 90.0, 180.0, 270.0])))

    def truth(self, rng):
        return {"part": seen_by_four(rng)}

    def errors(self, rng):
        return {"instrument": seen_by_four(rng, size=8e-9)}

    def readings(self, truth, errors):
        p, i = (
            np.asarray(d.get(k, np.zeros((N, N))))
            for d, k in ((truth, "part"), (errors, "instrument"))
        )
        return np.stack([i + quarter(p, k) for k in range(4)])

    def invisible(self, rng):
        for hidden in (X**2 + Y**2, X**3 * Y - X * Y**3, np.ones((N, N))):
            yield {"part": 1e-7 * hidden}, {"instrument": -1e-7 * hidden}

    def test_shares_of_one_part_alone_are_kept_out_of_both(self):
        *_, readings = self.draw(8)
        plain = self.method().separate(readings)
        for hidden in (X**2 + Y**2, X**3 * Y - X * Y**3, 3 * X - Y + 2):
            for other in (1.0, 0.0):  # in the part and, negative, in the instrument; or in one
                part, instrument = 1e-7 * hidden, -1e-7 * other * hidden
                extra = np.stack([instrument + quarter(part, k) for k in range(4)])
                seen = self.method().separate(readings + extra)
                for name in ("part", "instrument"):
                    np.testing.assert_allclose(
                        seen.parts[name], plain.parts[name], rtol=0.0, atol=1e-20
                    )


# --- other angles: analytic surfaces evaluated at turned coordinates, no interpolation ---

BIG = 129
STEP = 2.0 / (BIG - 1)
G = np.linspace(-1.0, 1.0, BIG)
GX, GY = np.meshgrid(G, G)
ROUND = np.hypot(GX, GY) <= 1.0
SIZE = 20e-9

INTERPOLATION = 2e-14
"""1e-6 of the 20 nm surfaces: sixth-order interpolation of seven waves over 129 pixels."""


def part_surface(x, y, *, symmetric=0.0):
    """Orders 1, 2, 3, 5, 7 with planted signs; `symmetric` adds orders 0 and 4."""
    z = x**2 - y**2 + 0.7 * x * y - 1.3 * x**3 + 0.4 * y * (x**2 + y**2)
    z = z + 0.5 * (x**5 - 10 * x**3 * y**2 + 5 * x * y**4) + 0.3 * ((x + 1j * y) ** 7).imag
    return SIZE * (z + symmetric * (x**2 + y**2 + (x**4 - 6 * x**2 * y**2 + y**4)))


def instrument_surface(x, y):
    return 9e-9 * (0.8 * x * y + y**3 - 0.5 * (3 * x**2 * y - y**3) * (x**2 + y**2))


def turned_readings(angles, *, symmetric=0.0, noise=0.0, seed=0, shift=None):
    rng = np.random.default_rng(seed)
    shift = np.zeros((len(angles), 2)) if shift is None else shift
    maps = []
    for a, (sx, sy) in zip(angles, shift, strict=True):
        c, s = math.cos(a), math.sin(a)
        u, v = GX - sx, GY - sy
        z = instrument_surface(GX, GY) + part_surface(c * u + s * v, -s * u + c * v,
                                                      symmetric=symmetric)  # fmt: skip
        offset, tilt_x, tilt_y = 1e-7 * rng.standard_normal(3)  # each set-up is aligned anew
        z = z + offset + tilt_x * GX + tilt_y * GY
        maps.append(np.where(ROUND, z + noise * rng.standard_normal(z.shape), np.nan))
    return maps


def worst(found, expected):
    """Largest difference, planes removed, where found is known; at least 78 % of the disc is (circles lose six pixels)."""
    known = np.isfinite(found)
    assert known.sum() > 0.78 * ROUND.sum()
    return np.nanmax(np.abs(plane_off(found - expected)))


FOUR = np.radians([0.0, 90.0, 180.0, 270.0])


@pytest.mark.parametrize(
    "degrees",
    [
        [0, 90, 180, 270],
        [0, 90],
        [0, 60, 120, 180, 240, 300],
        [0, 45, 90],
        [30, 120, 210],
        [0, 30, 150],
        [0, -45, 45, 135, 180],
        [0, 41, 103, 222],
        [11, 97, 200, 287.5],
    ],
)
def test_parts_come_back_with_their_signs(degrees):
    angles = np.radians(degrees)
    result = rotation_average(turned_readings(angles), angles, dx=1e-4)

    assert worst(result.part, part_surface(GX, GY)) < INTERPOLATION
    assert worst(result.instrument, instrument_surface(GX, GY)) < INTERPOLATION
    assert np.nanmax(np.abs(result.unseparated)) < INTERPOLATION
    assert not result.messages


@pytest.mark.parametrize(
    ("degrees", "lost"),
    [
        ([0, 90, 180, 270], [0, 4, 8, 12]),
        ([0, 180], [0, 2, 4, 6]),
        ([0, 72, 144, 216, 288], [0, 5, 10]),
        ([0, 120, 240], [0, 3, 6]),
        ([0, 60, 90], [0, 12, 24]),
        ([0, 90, 45], [0, 8, 16]),
    ],
)
def test_orders_that_look_alike_are_listed(degrees, lost):
    hidden = RotationTest(np.radians(degrees).tolist()).null_space()[0].indices
    assert [m for m in hidden if m <= max(lost)] == lost


def test_prime_angles_lose_only_the_symmetric_share():
    hidden = RotationTest(np.radians([0, 41, 103, 222]).tolist()).null_space()[0].indices
    assert hidden == (0,)


def test_symmetric_share_goes_to_neither_part():
    """A dish and a four-leaf in the part: the sum is reported apart, never given to a part."""
    readings = turned_readings(FOUR, symmetric=1.0)
    result = rotation_average(readings, FOUR, dx=1e-4)

    assert worst(result.part, part_surface(GX, GY)) < INTERPOLATION
    assert worst(result.instrument, instrument_surface(GX, GY)) < INTERPOLATION
    both = part_surface(GX, GY, symmetric=1.0) - part_surface(GX, GY)
    assert worst(result.unseparated, both) < INTERPOLATION
    assert "sum of part and instrument" in result.null_space[0].reason


def test_two_sets_of_coprime_positions_leave_only_their_product():
    """4 and 3 positions in one test: only 0, 12, 24 ... stay together."""
    angles = np.radians([0, 90, 180, 270, 120, 240])
    assert RotationTest(angles.tolist()).null_space()[0].indices[:3] == (0, 12, 24)
    result = rotation_average(turned_readings(angles, symmetric=1.0), angles)

    dish = SIZE * (GX**2 + GY**2)
    leaf = part_surface(GX, GY, symmetric=1.0) - dish
    assert worst(result.part, leaf) < INTERPOLATION
    assert worst(result.unseparated, dish) < INTERPOLATION


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [[0, 60, 120, 180, 240, 300], [0, 41, 103, 222]])
def test_noise_and_its_law_where_maps_are_interpolated(degrees):
    angles, sd = np.radians(degrees), 1e-9
    found = []
    for seed in range(3):
        result = rotation_average(turned_readings(angles, noise=sd, seed=seed), angles)
        errors = [plane_off(result.part - part_surface(GX, GY)),
                  plane_off(result.instrument - instrument_surface(GX, GY))]  # fmt: skip
        stated = [result.u["part"], result.u["instrument"]]
        found.append(
            [result.noise.value, *(np.nanstd(e) for e in errors), *(np.nanmean(u) for u in stated)]
        )
    noise, part, instrument, u_part, u_instrument = np.mean(found, axis=0)

    assert noise == pytest.approx(sd, rel=0.03, abs=0.0)
    assert u_part == pytest.approx(part, rel=0.1, abs=0.0)
    assert u_instrument == pytest.approx(instrument, rel=0.1, abs=0.0)


def test_law_of_n_positions_by_index():
    rng = np.random.default_rng(1)
    noise = [np.where(ROUND, 1e-9 * rng.standard_normal(GX.shape), np.nan) for _ in range(4)]
    result = rotation_average(noise, FOUR)

    law = 1e-9 * math.sqrt((1 - 1 / 4) / 4)
    assert np.nanstd(result.part) == pytest.approx(law, rel=0.03, abs=0.0)
    assert np.nanmax(result.u["part"]) == pytest.approx(law, rel=0.03, abs=0.0)


def test_dust_costs_its_turned_counterparts_only():
    readings = turned_readings(FOUR)
    readings[1][40, 70] = np.nan
    result = rotation_average(readings, FOUR)

    lost = ROUND & ~np.isfinite(result.part)
    spots = np.zeros_like(ROUND)
    spots[40, 70] = True
    expected = np.any([np.rot90(spots, k) for k in range(4)], axis=0)
    np.testing.assert_array_equal(lost, expected)
    assert worst(result.part, part_surface(GX, GY)) < INTERPOLATION


@pytest.mark.slow
def test_centring_error_is_stated_by_its_uncertainty():
    """S16: half a pixel; RMS of the error within 20 % of the RMS of u."""
    step = G[1] - G[0]
    rng = np.random.default_rng(2)
    stated = rotation_average(
        turned_readings(FOUR), FOUR, dx=step, u_reading=0.0, u_registration=0.5 * step
    ).u
    errors = {"part": [], "instrument": []}
    for _ in range(25):  # 200 shifts: their scatter is known to 5 %
        shift = rng.standard_normal((4, 2)) * 0.5 * step
        result = rotation_average(turned_readings(FOUR, shift=shift), FOUR, u_reading=0.0)
        for name, surface in (("part", part_surface), ("instrument", instrument_surface)):
            error = plane_off(result.parts[name] - surface(GX, GY))
            errors[name].append(np.nanmean(error**2))
    for name, squares in errors.items():
        u = math.sqrt(np.nanmean(stated[name] ** 2))
        assert u == pytest.approx(math.sqrt(np.mean(squares)), rel=0.2, abs=0.0)


@pytest.mark.slow
def test_angle_error_is_stated_by_its_uncertainty():
    rng = np.random.default_rng(3)
    u = rotation_average(turned_readings(FOUR), FOUR, u_reading=0.0, u_angle=2e-3).u["part"]
    squares = []
    for _ in range(40):
        wrong = FOUR + 2e-3 * rng.standard_normal(4)
        result = rotation_average(turned_readings(wrong), FOUR, u_reading=0.0)
        squares.append(np.nanmean(plane_off(result.part - part_surface(GX, GY)) ** 2))
    expected = math.sqrt(np.mean(squares))
    assert math.sqrt(np.nanmean(u**2)) == pytest.approx(expected, rel=0.2, abs=0.0)


@pytest.mark.parametrize("degrees", [(0, 120, 240), (0, 50, 137)])
def test_registration_leaves_no_pixel_without_uncertainty(degrees):
    angles, sd = np.radians(degrees), 0.3 * STEP
    shift = sd * np.random.default_rng(4).standard_normal((3, 2))
    maps = turned_readings(angles, shift=shift)
    found = rotation_average(
        maps, angles, dx=STEP, u_reading=1e-12, u_registration=sd, u_angle=1e-4
    )
    for name in ("part", "instrument", "unseparated"):
        np.testing.assert_array_equal(np.isfinite(found.u[name]), np.isfinite(found.parts[name]))


def test_centring_counts_the_dish_that_no_turn_shows():
    """200 nm of sphere and 10 nm of astigmatism, 0.3 pixels: the slope of the dish is the error."""
    sd, errors, u = 0.3 * STEP, [], math.nan
    for k in range(8):
        maps = []
        for a, (sx, sy) in zip(
            FOUR, sd * np.random.default_rng(k).standard_normal((4, 2)), strict=True
        ):
            x, y = GX - sx, GY - sy
            z = 200e-9 * (x**2 + y**2) ** 2 + 10e-9 * math.cos(2 * a) * (x**2 - y**2)
            maps.append(np.where(ROUND, z, np.nan))
        found = rotation_average(maps, FOUR, dx=STEP, u_reading=1e-12, u_registration=sd)
        error = plane_off(found.part - np.where(ROUND, 10e-9 * (GX**2 - GY**2), np.nan))
        errors.append(np.nanmean(error**2))
        u = math.sqrt(np.nanmean(found.u["part"] ** 2))
    # 8 draws of 8 shifts: the RMS is known to about 15 %
    assert u == pytest.approx(math.sqrt(np.mean(errors)), rel=0.4, abs=0.0)


def test_axis_beside_the_middle_is_stated():
    """The part turns about a point 3 pixels off; with centre= it comes back."""
    step = G[1] - G[0]
    off = np.array([3 * step, -2 * step])
    maps = []
    for a in FOUR:
        c, s = math.cos(a), math.sin(a)
        u, v = GX - off[0], GY - off[1]
        z = instrument_surface(u, v) + part_surface(c * u + s * v, -s * u + c * v)
        maps.append(np.where(np.hypot(u, v) < 0.9, z, np.nan))
    centre = ((BIG // 2) * step + off[0], (BIG // 2) * step + off[1])
    result = rotation_average(maps, FOUR, dx=step, centre=centre)

    known = np.isfinite(result.part)
    error = plane_off(result.part - part_surface(GX - off[0], GY - off[1]))
    assert known.sum() > 0.6 * ROUND.sum()
    assert np.nanmax(np.abs(error)) < INTERPOLATION


class TestDoubts:
    def test_angles_of_the_other_sign(self):
        result = rotation_average(turned_readings(FOUR, noise=1e-10), -FOUR)
        assert any("opposite sign" in m for m in result.messages)

    def test_mirrored_map(self):
        readings = turned_readings(FOUR, noise=1e-10)
        readings[2] = readings[2][:, ::-1]
        result = rotation_average(readings, FOUR)
        assert any("map 3 looks mirrored" in m for m in result.messages)

    def test_good_maps_raise_none(self):
        for degrees in ([0, 90, 180, 270], [0, 60, 120], [0, 180]):
            angles = np.radians(degrees)
            assert not rotation_average(
                turned_readings(angles, noise=1e-9), angles, dx=1e-4
            ).messages


class TestBadInput:
    maps = [np.where(ROUND, 1e-9 * GX * GY, np.nan)] * 4

    def test_degrees_are_named(self):
        with pytest.raises(DataError, match="look like degrees"):
            rotation_average(self.maps, [0, 90, 180, 270])

    def test_one_map_and_no_turn(self):
        with pytest.raises(NotSeparableError, match="1 readings at one angle"):
            rotation_average(self.maps[:1], [0.0])
        for angles in ([0.0, 0.0], [1.0, 1.0 + 2 * np.pi]):
            with pytest.raises(NotSeparableError, match="was not turned"):
                rotation_average(self.maps[:2], angles)

    def test_unequal_maps(self):
        with pytest.raises(DataError, match="one shape"):
            rotation_average([self.maps[0], self.maps[1][:-1]], FOUR[:2])
        with pytest.raises(DataError, match="needs 3 maps"):
            rotation_average(self.maps, FOUR[:3])
        one, two = (ms.Surface(self.maps[0], d, d) for d in (1e-4, 1.1e-4))
        with pytest.raises(DataError, match="dx of map 2"):
            rotation_average([one, two], FOUR[:2])
        with pytest.raises(DataError, match="not mixed"):
            rotation_average([one, self.maps[0]], FOUR[:2])
        with pytest.raises(DataError, match="do not give them again"):
            rotation_average([one, one], FOUR[:2], dx=1e-4)

    def test_masks_that_do_not_overlap(self):
        left = np.where(GX < -0.1, 1.0, np.nan)
        with pytest.raises(DataError, match="masks do not overlap"):
            rotation_average([left, left[:, ::-1]], [0.0, np.pi])

    def test_half_of_a_map_has_no_turned_counterpart(self):
        left = np.where(GX < -0.1, 1e-9 * GX, np.nan)
        with pytest.raises(DataError, match="turned counterparts"):
            rotation_average([left, left], [0.0, np.pi])

    def test_wrong_options(self):
        with pytest.raises(DataError, match="removed may hold"):
            rotation_average(self.maps, FOUR, removed=("focus",))
        with pytest.raises(DataError, match="u_registration"):
            rotation_average(self.maps, FOUR, u_registration=-1.0)
        with pytest.raises(DataError, match="u_reading"):
            rotation_average(self.maps, FOUR, u_reading=math.nan)
        with pytest.raises(DataError, match="outside the map"):
            rotation_average(self.maps, FOUR, dx=1e-4, centre=(1.0, 0.0))
        with pytest.raises(InvalidSamplesError, match="no numbers"):
            rotation_average(self.maps, ["a", "b", "c", "d"])

    def test_integer_maps_and_surfaces(self):
        counts = np.where(ROUND, np.round(1e3 * part_surface(GX, GY) / SIZE), 0).astype(int)
        maps = [quarter(counts, k) for k in range(4)]
        plain = rotation_average(maps, FOUR, dx=1e-4)
        surfaces = rotation_average([ms.Surface(m, 1e-4, 1e-4) for m in maps], FOUR)
        np.testing.assert_array_equal(plain.part, surfaces.part)
        np.testing.assert_allclose(
            surfaces.coordinates["x"], (np.arange(BIG) - 64) * 1e-4, rtol=0.0, atol=1e-17
        )
        assert surfaces.history[-1].name == "rotation_average"


def test_tilt_is_kept_and_power_taken_as_asked():
    """An instrument whose alignment is not touched keeps its tilt; asked for, power goes."""
    plain = [np.rot90(SIZE * GX, -k) + 5e-9 * GY for k in range(4)]
    kept = rotation_average(plain, FOUR, removed=())
    np.testing.assert_allclose(kept.part, SIZE * GX, rtol=0.0, atol=1e-21)
    np.testing.assert_allclose(kept.instrument, 5e-9 * GY, rtol=0.0, atol=1e-21)
    assert not any(i.kind == "term" for i in kept.null_space)

    bowls = [m + 1e-7 * (GX**2 + GY**2) for m in plain]
    gone = rotation_average(bowls, FOUR, removed=("piston", "tilt", "power"))
    assert np.abs(gone.unseparated).max() < 1e-20
    assert any("defocus" in i.indices for i in gone.null_space)


class TestWrongSetUps:
    """What does not fit the model is said, and noise is not called a fault."""

    @staticmethod
    def said(maps, angles=FOUR, **options):
        messages = rotation_average(maps, angles, dx=STEP, **options).messages
        return [m for m in messages if "are not noise" in m or "mirrored" in m or "sign" in m]

    @pytest.mark.parametrize("fault", ["exchanged", "negated", "80 deg", "mirrored in y"])
    def test_faults(self, fault):
        true = np.radians([0.0, 80.0, 180.0, 270.0]) if fault == "80 deg" else FOUR
        maps = turned_readings(true, noise=1e-9)
        if fault == "exchanged":
            maps[1], maps[2] = maps[2], maps[1]
        elif fault == "negated":
            maps[1] = -maps[1]
        elif fault == "mirrored in y":
            maps[3] = maps[3][::-1]
        found = self.said(maps)
        assert found
        if fault == "mirrored in y":
            assert "map 4 looks mirrored: with y reversed" in found[0]

    @pytest.mark.parametrize(
        "degrees", [(0, 90, 180, 270), (0, 120, 240), (0, 45, 90, 225), (0, 50, 137)]
    )
    def test_noise_alone_raises_no_doubt(self, degrees):
        angles = np.radians(degrees)
        for noise in (0.0, 1e-9):
            assert not self.said(turned_readings(angles, noise=noise, seed=3), angles)


def test_quarter_turns_from_any_first_angle_are_exact():
    """10, 100, 190, 280 degrees: dust costs its counterparts, no circles, and the part is at 0."""
    angles = np.radians([10.0, 100.0, 190.0, 280.0])
    maps = turned_readings(angles)
    maps[0][40, 50] = np.nan
    result = rotation_average(maps, angles, dx=STEP)
    assert result.audit["positions_in_a_turn"] == 4
    assert worst(result.part, part_surface(GX, GY)) < INTERPOLATION
    assert worst(result.instrument, instrument_surface(GX, GY)) < 1e-20
    assert np.isfinite(result.instrument).sum() == ROUND.sum() - 4


def test_circles_lost_to_gaps_are_said():
    angles = np.radians([0.0, 50.0, 137.0])
    maps = turned_readings(angles)
    maps[0][64, 90] = np.nan
    result = rotation_average(maps, angles, dx=STEP)
    assert any("whole circle" in m for m in result.messages)
    whole = rotation_average(turned_readings(angles), angles, dx=STEP)
    assert not any("whole circle" in m for m in whole.messages)


class TestWhatIsGiven:
    maps = turned_readings(FOUR, noise=1e-9)

    def test_masked_is_not_measured(self):
        plain = [m.copy() for m in self.maps]
        plain[2][30:34, 60:70] = np.nan
        spoilt = [np.where(np.isnan(m), 99.0, m) for m in plain]
        masked = [np.ma.array(z, mask=np.isnan(m)) for z, m in zip(spoilt, plain, strict=True)]
        expected = rotation_average(plain, FOUR).part
        np.testing.assert_array_equal(rotation_average(masked, FOUR).part, expected)
        np.testing.assert_array_equal(
            RotationTest(tuple(FOUR)).separate(np.ma.stack(masked)).part, expected
        )

    def test_complex_heights_are_refused(self):
        with pytest.raises(InvalidSamplesError, match="complex"):
            rotation_average([m + 0j for m in self.maps], FOUR)

    def test_generator_keeps_the_scale(self):
        surfaces = (ms.Surface(m, STEP, STEP) for m in self.maps)
        result = rotation_average(surfaces, FOUR, u_reading=1e-9, u_registration=STEP)
        expected = rotation_average(self.maps, FOUR, dx=STEP, u_reading=1e-9, u_registration=STEP)
        np.testing.assert_array_equal(result.u["part"], expected.u["part"])

    def test_dy_alone_is_both(self):
        one = rotation_average(self.maps, FOUR, dy=STEP, u_reading=0.0, u_registration=STEP)
        two = rotation_average(self.maps, FOUR, dx=STEP, u_reading=0.0, u_registration=STEP)
        np.testing.assert_array_equal(one.u["part"], two.u["part"])

    @pytest.mark.parametrize(
        ("options", "match"),
        [
            ({"u_registration": 1e-5}, "no lateral step is known"),
            ({"dx": "1e-4"}, "dx '1e-4' has no unit"),
            ({"u_reading": "1 V"}, "a length is needed"),
            ({"u_registration": [1e-6] * 4, "dx": STEP}, "u_registration must be a number"),
            ({"centre": (1,)}, "centre must be two numbers"),
        ],
    )
    def test_refused(self, options, match):
        with pytest.raises(DataError, match=match):
            rotation_average(self.maps, FOUR, **options)

    def test_other_origins_are_refused(self):
        surfaces = [
            ms.Surface(m, STEP, STEP, origin=(i * STEP, 0.0)) for i, m in enumerate(self.maps)
        ]
        with pytest.raises(DataError, match="map 2 begins at"):
            rotation_average(surfaces, FOUR)

    def test_other_units_are_said(self):
        def messages(maps, angles, step):
            return " ".join(rotation_average(maps, angles, dx=step).messages)

        assert "more than 1 mm" in messages([m * 1e9 for m in self.maps], FOUR, STEP)
        assert "the lateral step is 0.5 m" in messages(self.maps, FOUR, 0.5)
        assert "more than a turn" in messages(self.maps[:3], [0.0, 5.0, 10.0], STEP)
        plain = messages(self.maps, FOUR, STEP)
        assert not any(t in plain for t in ("1 mm", "lateral step", "more than a turn"))

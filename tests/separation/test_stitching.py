"""Stitching: exact without noise, propagated sd, reference and its ambiguity, lateral offsets."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

import metrosep as ms
from metrosep.core.errors import DataError, DegenerateFitError, MetrosepError, NotSeparableError
from metrosep.separation.maps.stitching import Stitching, stitch

EXACT = 1e-9
"""Relative to the largest reading, noise-free: sums of doubles through small normal equations."""

CG = 2e-6
"""The map of pixels ends at 1e-10 of the normal equations' residual; their condition is 1e4."""

RMS_OVER_SD = 1.5
"""S17."""

STEP = 1e-3
ROWS, SIDE = 16, 30
FIVE = tuple((k * 18 * STEP, 0.0) for k in range(5))
"""Five sub-apertures of 30 columns with 40 % overlap."""

TWO_STEPS = tuple((a * STEP, b * STEP) for a in (0, 9, 20) for b in (0, 11, 20))
"""Steps of 9 and 11 pixels in x and in y: no common divisor."""


def grids(n_y, n_x):
    return np.meshgrid(np.linspace(-1, 1, n_x), np.linspace(-1, 1, n_y))


def without(values, *terms):
    """Least-squares removal, written here again."""
    good = np.isfinite(values)
    b = np.stack([t[good] for t in terms], axis=1)
    out = np.full(values.shape, np.nan)
    out[good] = values[good] - b @ np.linalg.lstsq(b, values[good], rcond=None)[0]
    return out


def plane_free(values):
    x, y = grids(*values.shape)
    return without(values, np.ones_like(x), x, y)


def parabola_free(values):
    x, y = grids(*values.shape)
    return without(values, np.ones_like(x), x, y, x * x, y * y, x * y)


def rough(rng, shape, size=50e-9):
    """Waves of random direction and phase."""
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    z = np.zeros(shape)
    for _ in range(12):
        fx, fy, p = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(0, 7)
        z += size / 4 * np.sin(fx * x + fy * y + p)
    return z


def cut(part, positions, shape, reference=0.0):
    out = []
    for x, y in positions:
        i, j = round(y / STEP), round(x / STEP)
        out.append(part[i : i + shape[0], j : j + shape[1]] + reference)
    return np.array(out)


def misaligned(maps, rng, *, size=1e-6, power=0.0):
    x, y = grids(*maps[0].shape)
    y = y * (maps[0].shape[0] - 1) / (maps[0].shape[1] - 1)  # square pixels: power is round
    a = size * rng.standard_normal((4, len(maps), 1, 1))
    return maps + a[0] + a[1] * x + a[2] * y + power * a[3] * (x**2 + y**2)


class TestPlain(SeparationContract):
    has_redundancy = True

    def method(self):
        return Stitching(FIVE, (ROWS, SIDE), dx=STEP)

    def truth(self, rng):
        return {"surface": plane_free(rough(rng, (ROWS, 4 * 18 + SIDE)))}

    def errors(self, rng):
        return {}

    def readings(self, truth, errors):
        part = truth.get("surface", np.zeros((ROWS, 4 * 18 + SIDE)))
        return cut(part, FIVE, (ROWS, SIDE), errors.get("reference", 0.0))

    def invisible(self, rng):
        return iter(())


class TestPolynomialReference(SeparationContract):
    has_redundancy = True
    shape = (24, 24)
    degree = 4

    def method(self):
        return Stitching(
            TWO_STEPS, self.shape, dx=STEP, fit_reference=True, reference_degree=self.degree
        )

    def truth(self, rng):
        return {"surface": parabola_free(rough(rng, (44, 44)))}

    def errors(self, rng):
        x, y = grids(*self.shape)
        a = rng.standard_normal(4)
        z = 20e-9 * (a[0] * x**3 + a[1] * x * y**2 + a[2] * y**4 + a[3] * x**2 * y)
        return {"reference": parabola_free(z)}

    def readings(self, truth, errors):
        return cut(
            truth.get("surface", np.zeros((44, 44))),
            TWO_STEPS,
            self.shape,
            errors.get("reference", 0.0),
        )

    def invisible(self, rng):
        a = rng.standard_normal()
        # parabolas leave planes in the readings: test_null_space_of_the_reference... has those
        yield {"surface": np.full((44, 44), a)}, {"reference": np.full((24, 24), -a)}

    @pytest.mark.slow
    def test_noise_is_found_from_redundancy(self):
        super().test_noise_is_found_from_redundancy()


def test_five_with_forty_percent_overlap_scatter_as_propagated():
    """S17, over seeds: RMS error within 1.5 of the propagated sd, and on average equal to it."""
    shape, ratios, noises = (ROWS, 4 * 18 + SIDE), [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        part = rough(rng, shape)
        maps = misaligned(cut(part, FIVE, (ROWS, SIDE)), rng)
        result = stitch(list(maps + 1e-9 * rng.standard_normal(maps.shape)), FIVE, dx=STEP)

        error = plane_free(result.surface - part)
        ratios.append(np.sqrt(np.mean(error**2) / np.mean(result.u["surface"] ** 2)))
        noises.append(result.noise.value)
    assert max(ratios) < RMS_OVER_SD
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.1)  # few long modes dominate
    assert np.mean(noises) == pytest.approx(1e-9, rel=0.01, abs=0.0)


def test_freedoms_come_back_with_their_sign():
    rng = np.random.default_rng(1)
    part = rough(rng, (ROWS, 4 * 18 + SIDE))
    maps = cut(part, FIVE, (ROWS, SIDE))
    x, _ = grids(ROWS, SIDE)
    maps[2] += 300e-9 + 70e-9 * x

    plain, moved = (
        stitch(list(cut(part, FIVE, (ROWS, SIDE))), FIVE, dx=STEP),
        stitch(list(maps), FIVE, dx=STEP),
    )

    change = np.array(moved.audit["freedoms_nm"]) - np.array(plain.audit["freedoms_nm"])
    change -= change[0]  # the whole is free
    tilt = change[:, 1] - np.mean(change[[0, 1, 3, 4], 1])
    assert tilt[2] == pytest.approx(70.0, abs=1e-5)
    np.testing.assert_allclose(moved.surface, plain.surface, rtol=0.0, atol=EXACT * 400e-9)


def test_power_of_each_is_removed_and_said():
    rng = np.random.default_rng(2)
    shape = (ROWS, 4 * 18 + SIDE)
    part = rough(rng, shape)
    maps = misaligned(cut(part, FIVE, (ROWS, SIDE)), rng, power=1.0)

    result = stitch(list(maps), FIVE, dx=STEP, freedoms=("piston", "tilt", "power"))

    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    x, y = x - x.mean(), y - y.mean()
    expected = without(part, np.ones(shape), x, y, x * x + y * y)
    np.testing.assert_allclose(result.surface, expected, rtol=0.0, atol=EXACT * 5e-6)
    assert result.null_space[0].indices == (0, 1, 2)


def test_three_ways_to_give_sub_apertures_agree():
    rng = np.random.default_rng(3)
    part = rough(rng, (ROWS, 4 * 18 + SIDE))
    maps = misaligned(cut(part, FIVE, (ROWS, SIDE)), rng)
    surfaces = [ms.Surface(z, STEP, STEP, origin=p) for z, p in zip(maps, FIVE, strict=True)]

    a, b = stitch(list(maps), FIVE, dx=STEP), stitch(surfaces)

    np.testing.assert_array_equal(a.surface, b.surface)
    row = [
        ms.Profile(p[0] + STEP * np.arange(SIDE), z[0]) for z, p in zip(maps, FIVE, strict=True)
    ]
    c = stitch(row)
    d = stitch([p.z for p in row], [p.x[0] for p in row], dx=STEP)
    np.testing.assert_allclose(c.surface, d.surface, rtol=0.0, atol=1e-20)
    assert c.surface.shape == (4 * 18 + SIDE,)
    line = np.polyfit(np.arange(102), part[0], 1)
    np.testing.assert_allclose(
        c.surface, part[0] - np.polyval(line, np.arange(102)), rtol=0.0, atol=EXACT * 5e-6
    )


# --- reference ---


def referenced(seed, *, positions=TWO_STEPS, sd=0.0, n=24):
    rng = np.random.default_rng(seed)
    x, y = grids(n, n)
    reference = rough(rng, (n, n), 15e-9) + 20e-9 * (x**3 - 0.4 * x * y**2)
    side = round(max(max(p) for p in positions) / STEP) + n
    part = rough(rng, (side, side))
    maps = misaligned(cut(part, positions, (n, n), reference), rng)
    return part, reference, maps + sd * rng.standard_normal(maps.shape)


def test_reference_of_pixels_comes_back_with_two_step_sizes():
    part, reference, maps = referenced(4)

    result = stitch(list(maps), TWO_STEPS, dx=STEP, reference="fit", draws=0)

    np.testing.assert_allclose(
        result.reference, parabola_free(reference), rtol=0.0, atol=CG * 3e-6
    )
    np.testing.assert_allclose(result.surface, parabola_free(part), rtol=0.0, atol=CG * 3e-6)
    terms = {i for item in result.null_space if item.kind == "term" for i in item.indices}
    assert terms == {"power", "astigmatism 0", "astigmatism 45"}
    assert any("power" in m for m in result.messages)
    assert np.isnan(result.u["surface"]).all()  # draws=0


@pytest.mark.slow
def test_reference_scatters_as_stated():
    ratios = {"reference": [], "surface": []}
    for seed in range(8):
        part, reference, maps = referenced(seed, sd=1e-9)
        result = stitch(list(maps), TWO_STEPS, dx=STEP, reference="fit")
        for name, truth in (("reference", reference), ("surface", part)):
            error = parabola_free(result.parts[name] - truth)
            ratios[name].append(np.mean(error**2) / np.mean(result.u[name] ** 2))
        assert result.noise.value == pytest.approx(1e-9, rel=0.06, abs=0.0)
    for name, values in ratios.items():
        # 16 simulated draws and 8 measured ones, each dominated by a few long modes
        assert 0.6 < np.mean(values) < 1.6, name
        assert np.sqrt(max(values)) < RMS_OVER_SD + 0.3, name


def test_power_given_to_the_surface_when_the_reference_is_free_of_it():
    rng = np.random.default_rng(5)
    x, y = grids(44, 44)
    part = rough(rng, (44, 44)) + 80e-9 * (x**2 + y**2)
    u, v = grids(24, 24)
    reference = parabola_free(20e-9 * u**3 + 10e-9 * u * v**3)
    maps = misaligned(cut(part, TWO_STEPS, (24, 24), reference), rng)
    for degree, tolerance in ((4, EXACT), (None, CG)):
        result = stitch(
            list(maps),
            TWO_STEPS,
            dx=STEP,
            reference="fit",
            reference_degree=degree,
            ambiguous="surface",
            draws=0,
        )
        np.testing.assert_allclose(
            result.surface, plane_free(part), rtol=0.0, atol=tolerance * 5e-6
        )
        assert any("given to the surface" in m for m in result.messages)


def test_power_of_the_reference_bends_the_whole_by_the_parabola_law():
    """sag = delta (L/d)^2 / 8 with delta = c d^2, for any d: c L^2 / 8."""
    c, d = 2e-6, 18 * STEP  # 1/m
    x = (np.arange(SIDE) - (SIDE - 1) / 2) * STEP
    pieces = [0.5 * c * x**2 + 1e-9 * k for k in range(5)]  # a perfectly flat part

    result = stitch(pieces, [p[0] for p in FIVE], dx=STEP)

    length = (4 * 18 + SIDE - 1) * STEP
    delta = c * d**2
    found = result.surface
    ends, middle = (found[0] + found[-1]) / 2, (found[50] + found[51]) / 2
    sag = ends - middle + c * (STEP / 2) ** 2 / 2  # the middle lies between two samples
    assert sag == pytest.approx(delta * (length / d) ** 2 / 8, rel=1e-9, abs=0.0)
    assert sag == pytest.approx(c * length**2 / 8, rel=1e-9, abs=0.0)
    assert result.noise.value < 1e-20  # and no overlap shows it


@pytest.mark.slow
def test_null_space_of_the_reference_by_what_it_does_to_readings():
    """A parabola moved from the surface to the reference leaves planes in each sub-aperture."""
    _, _, maps = referenced(6)
    x, y = np.meshgrid(np.arange(44) * STEP, np.arange(44) * STEP)
    for shape in (lambda a, b: a * a + b * b, lambda a, b: a * a - b * b, lambda a, b: a * b):
        moved = cut(-1e-5 * shape(x, y), TWO_STEPS, (24, 24), 1e-5 * shape(x, y)[:24, :24])
        assert max(np.abs(plane_free(m)).max() for m in moved) < 1e-20

        plain = stitch(list(maps), TWO_STEPS, dx=STEP, reference="fit", reference_degree=5)
        again = stitch(list(maps + moved), TWO_STEPS, dx=STEP, reference="fit", reference_degree=5)
        for name in ("surface", "reference"):
            np.testing.assert_allclose(
                again.parts[name], plain.parts[name], rtol=0.0, atol=EXACT * 1e-6
            )


def turned(positions, angles, n, f, reference=0.0):
    out = []
    u, v = np.meshgrid(np.arange(n) - (n - 1) / 2, np.arange(n) - (n - 1) / 2)
    for (a, b), t in zip(positions, angles, strict=True):
        x = a / STEP + (n - 1) / 2 + u * math.cos(t) - v * math.sin(t)
        y = b / STEP + (n - 1) / 2 + u * math.sin(t) + v * math.cos(t)
        out.append(f(x, y) + reference)
    return np.array(out)


def smooth(x, y):
    return 50e-9 * np.sin(x / 9.0) * np.cos(y / 7.0 + 0.3) + 30e-9 * np.sin(x / 23 + y / 31)


def test_a_turned_sub_aperture_shows_astigmatism_but_no_power():
    u, v = grids(24, 24)
    reference = 10e-9 * (u**2 - v**2) + 6e-9 * u * v + 7e-9 * u**3 + 5e-9 * (u**2 + v**2)
    angles = [0.0, 0.3, -1.0, math.pi / 2, 2.0, 0.1, 0.0, 0.7, -0.4]
    maps = turned(TWO_STEPS, angles, 24, smooth, reference)

    result = stitch(
        list(maps), TWO_STEPS, dx=STEP, rotations=angles, reference="fit", reference_degree=4
    )

    expected = without(reference, np.ones_like(u), u, v, u**2 + v**2)
    # cubic convolution of waves of 44 pixels: h^3 f''' / 12 is 0.03 nm
    np.testing.assert_allclose(result.reference, expected, rtol=0.0, atol=0.1e-9)
    terms = {i for item in result.null_space if item.kind == "term" for i in item.indices}
    assert terms == {"power"}


def test_known_reference_is_subtracted():
    part, reference, maps = referenced(7)

    result = stitch(list(maps), TWO_STEPS, dx=STEP, reference=reference)

    np.testing.assert_allclose(result.surface, plane_free(part), rtol=0.0, atol=EXACT * 5e-6)
    assert "reference" not in result.parts


def test_one_step_size_leaves_a_map_of_pixels_open():
    _, _, maps = referenced(8, positions=FIVE[:3], n=SIDE)
    with pytest.raises(NotSeparableError, match="one step size"):
        stitch(list(maps), FIVE[:3], dx=STEP, reference="fit")
    result = stitch(list(maps), FIVE[:3], dx=STEP, reference="fit", reference_degree=2)
    assert result.null_space  # a row of maps says nothing of y
    assert any("cubic in y" not in m and "power" in m for m in result.messages)


def test_steps_with_a_common_divisor_lose_what_repeats_with_it():
    """All steps are multiples of 2 pixels: a pattern of period 2 is invisible and is removed."""
    positions = tuple((a * STEP, b * STEP) for a in (0, 8, 18) for b in (0, 10, 18))
    rng = np.random.default_rng(9)
    part, reference = rough(rng, (42, 42)), rough(rng, (24, 24), 15e-9)
    comb = 5e-9 * (-1.0) ** np.arange(42)
    maps = misaligned(cut(part + comb, positions, (24, 24), reference - comb[:24]), rng)
    assert np.abs(cut(np.tile(comb, (42, 1)), positions, (24, 24), -comb[:24])).max() < 1e-20

    result = stitch(list(maps), positions, dx=STEP, reference="fit", draws=0)

    assert result.audit["reference_groups"] == 4
    assert any("4 groups" in str(item) for item in result.null_space)
    x, y = grids(24, 24)
    i, j = np.meshgrid(np.arange(24) % 2, np.arange(24) % 2)
    groups = [(i == a) * (j == b) * 1.0 for a in (0, 1) for b in (0, 1)]
    expected = without(reference, *groups, x, y, x * x, y * y, x * y)
    np.testing.assert_allclose(result.reference, expected, rtol=0.0, atol=CG * 3e-6)


def test_a_row_of_maps_says_nothing_of_what_varies_across_it():
    positions = tuple((a * STEP, 0.0) for a in np.cumsum([0, 14, 9, 14, 9]))
    rng = np.random.default_rng(17)
    x, y = grids(12, 30)
    reference = rough(rng, (12, 30), 15e-9)
    across = 40e-9 * rng.standard_normal((12, 1))
    part = rough(rng, (12, 46 + 30))
    maps = misaligned(cut(part, positions, (12, 30), reference + across), rng)

    result = stitch(list(maps), positions, dx=STEP, reference="fit", draws=0)

    rows = [1.0 * (np.arange(12)[:, None] == k) * np.ones((1, 30)) for k in range(12)]
    expected = without(reference, *rows, x, x * x, x * y)
    np.testing.assert_allclose(result.reference, expected, rtol=0.0, atol=CG * 3e-6)
    assert result.audit["reference_groups"] == 12
    assert any("12 groups" in str(item) for item in result.null_space)
    assert result.noise.value < 1e-13


# --- positions ---


def test_positions_between_pixels_and_turned():
    positions = [(0, 0), (21.3e-3, 0.4e-3), (44.7e-3, -0.7e-3), (2.5e-3, 20.2e-3), (22e-3, 23e-3)]
    rng = np.random.default_rng(10)
    for angles in (None, [0.0, 0.3, -1.0, 1.5, 2.0]):
        maps = misaligned(turned(positions, angles or [0.0] * 5, 36, smooth), rng)
        maps += 0.3e-9 * rng.standard_normal(maps.shape)

        result = stitch(list(maps), positions, dx=STEP, rotations=angles)

        x, y = np.meshgrid(result.coordinates["x"] / STEP, result.coordinates["y"] / STEP)
        error = without(result.surface - smooth(x, y), np.ones_like(x), x, y)
        rms = np.sqrt(np.nanmean(error**2))
        assert rms < RMS_OVER_SD * np.sqrt(np.nanmean(result.u["surface"] ** 2))
        assert result.noise.value == pytest.approx(0.3e-9, rel=0.06, abs=0.0)


def test_lateral_offsets_are_found_with_their_uncertainty():
    positions = np.array([(0, 0), (21, 0), (40, 0), (2, 20), (22, 23), (40, 21)]) * STEP
    score = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        off = 0.7 * STEP * rng.standard_normal((6, 2))
        off[0] = 0.0
        maps = misaligned(turned(positions + off, [0.0] * 6, 36, smooth), rng)
        maps += 0.5e-9 * rng.standard_normal(maps.shape)

        result = stitch(list(maps), positions, dx=STEP, registration="fit")

        error = np.array(result.audit["shifts_um"]) * 1e-6 - off
        score.append(error[1:] / (np.array(result.audit["u_shifts_um"])[1:] * 1e-6))
        assert result.noise.value == pytest.approx(0.5e-9, rel=0.1, abs=0.0)
        # sign: an offset ignored is seen in the overlaps
        assert stitch(list(maps), positions, dx=STEP).noise.value > 1e-9
    assert np.sqrt(np.mean(np.square(score))) == pytest.approx(1.0, abs=0.4)  # 50 values


@pytest.mark.parametrize(("sd", "round_"), [(0.0, True), (0.3e-9, True), (0.3e-9, False)])
def test_offsets_settle_with_noise_and_round_apertures(sd, round_):
    """Found by review: noise kept the passes from ending, and a round edge drew the offsets."""
    n, score, most = 31, [], 0.0
    positions = np.array([(a * 15, b * 15) for b in range(2) for a in range(3)]) * STEP
    x, y = grids(n, n)
    for seed in range(2 if sd == 0.0 else 4):
        rng = np.random.default_rng(seed)
        off = rng.uniform(-0.5, 0.5, (6, 2)) * STEP
        off[0] = 0.0
        maps = misaligned(turned(positions + off, [0.0] * 6, n, smooth), rng)
        maps += sd * rng.standard_normal(maps.shape)
        if round_:
            maps[:, np.hypot(x, y) > 1.0] = np.nan

        result = stitch(list(maps), positions, dx=STEP, registration="fit")

        error = np.array(result.audit["shifts_um"]) * 1e-6 - off
        score.append(error[1:] / (np.array(result.audit["u_shifts_um"])[1:] * 1e-6))
        most = max(most, float(np.abs(error).max()) / STEP)
    if sd == 0.0:
        assert most < 0.005  # pixels: what interpolation leaves; 0.03 with slopes of 0 at the edge
    else:
        assert np.sqrt(np.mean(np.square(score))) == pytest.approx(1.0, abs=0.4)  # 40 values


def test_offsets_of_a_parabola_cannot_be_found():
    x, y = np.meshgrid(np.arange(66.0), np.arange(30.0))
    part = 1e-9 * (x - 30) ** 2 + 1e-9 * (y - 9) ** 2
    positions = [(0, 0), (18 * STEP, 0), (36 * STEP, 0)]
    with pytest.raises(DegenerateFitError, match="registration"):
        stitch(list(cut(part, positions, (30, 30))), positions, dx=STEP, registration="fit")


# --- what was not measured, and what is wrong ---


def test_not_measured_stays_not_measured():
    rng = np.random.default_rng(11)
    part = rough(rng, (ROWS, 4 * 18 + SIDE))
    maps = misaligned(cut(part, FIVE, (ROWS, SIDE)), rng)
    maps[0, 3:5, 2:6] = np.nan  # seen by no other
    maps[1, 3:5, 0:6] = np.nan  # seen by the first

    result = stitch(list(maps), FIVE, dx=STEP)

    expected = np.zeros(part.shape, dtype=bool)
    expected[3:5, 2:6] = True
    np.testing.assert_array_equal(np.isnan(result.surface), expected)
    np.testing.assert_array_equal(np.isnan(result.u["surface"]), expected)
    hidden = np.where(expected, np.nan, part)
    np.testing.assert_allclose(result.surface, plane_free(hidden), rtol=0.0, atol=EXACT * 5e-6)
    assert result.audit["n_not_measured"] == 8


def test_islands_are_named():
    maps = list(np.zeros((4, ROWS, SIDE)))
    positions = [(0, 0), (18 * STEP, 0), (90 * STEP, 0), (108 * STEP, 0)]
    with pytest.raises(NotSeparableError, match=r"1, 2 \| 3, 4"):
        stitch(maps, positions, dx=STEP)
    maps[1] = maps[1].copy()
    maps[1][:, :12] = np.nan  # the mask eats the overlap
    with pytest.raises(NotSeparableError, match=r"1 \| 2"):
        stitch(maps[:2], positions[:2], dx=STEP)


@pytest.mark.parametrize("how", ["mirrored in x", "mirrored in y", "turned by half a turn"])
@pytest.mark.parametrize("n", [2, 5])
def test_mirrored_map_is_refused(how, n):
    rng = np.random.default_rng(12)
    part = rough(rng, (ROWS, 4 * 18 + SIDE))
    maps = cut(part, FIVE, (ROWS, SIDE)) + 0.2e-9 * rng.standard_normal((5, ROWS, SIDE))
    turn = {"mirrored in x": np.s_[:, ::-1], "mirrored in y": np.s_[::-1]}.get(
        how, np.s_[::-1, ::-1]
    )
    maps[1] = maps[1][turn]
    named = "[12]" if n == 2 else "2"  # of two maps either may be the wrong one
    with pytest.raises(DataError, match=f"map {named} fits its neighbours only when {how}"):
        stitch(list(maps[:n]), FIVE[:n], dx=STEP)


def test_wrong_position_is_named():
    _, _, maps = referenced(13)
    part = rough(np.random.default_rng(0), (44, 44))
    maps = cut(part, TWO_STEPS, (24, 24)) + 0.1e-9 * maps * 1e6
    positions = np.array(TWO_STEPS)
    positions[8] += [-2 * STEP, 0.0]

    result = stitch(list(maps), positions, dx=STEP)

    assert any("sub-aperture 9" in m for m in result.messages)
    assert all(9 in pair for pair in result.audit["outlying_pairs"])


GRID = np.array([(a * 15, b * 12) for b in range(2) for a in range(3)]) * STEP
TURNS = (0.0, 0.5, -0.8, 1.5, 0.2, -2.6)


def set_up(angles=(0.0,) * 6, reference=0.0):
    """Six maps of 31 x 31 pixels with 0.3 nm of noise."""
    rng = np.random.default_rng(20)
    maps = misaligned(turned(GRID, angles, 31, smooth, reference), rng)
    return list(maps + 0.3e-9 * rng.standard_normal(maps.shape))


@pytest.mark.parametrize(
    ("turn", "named"),
    [
        (((-1, 0), (0, 1)), "sign of x of the positions reversed"),
        (((1, 0), (0, -1)), "sign of y of the positions reversed"),
        (((0, 1), (1, 0)), "x and y of the positions exchanged"),
    ],
)
def test_positions_of_the_wrong_sense_are_said(turn, named):
    """Found by review: all maps shifted the wrong way looked like noise, 41 nm off with u 6.5."""
    result = stitch(set_up(), GRID @ np.array(turn), dx=STEP)
    assert any(named in m for m in result.messages)
    assert not stitch(set_up(), GRID, dx=STEP).messages  # and only then


def test_rows_in_the_other_order_are_said():
    result = stitch([z[::-1] for z in set_up()], GRID, dx=STEP)
    assert any("rows of each map" in m for m in result.messages)


def test_rotations_of_the_other_sign_are_said():
    maps = set_up(TURNS)
    result = stitch(maps, GRID, dx=STEP, rotations=-np.array(TURNS))
    assert any("sign of the rotations" in m for m in result.messages)
    assert not stitch(maps, GRID, dx=STEP, rotations=TURNS).messages


def test_known_reference_of_the_wrong_sign_is_said():
    x, y = grids(31, 31)
    error = 20e-9 * (x**3 - x * y**2) + 10e-9 * np.sin(5 * x + 1) * np.cos(4 * y)
    maps = set_up(reference=error)
    result = stitch(maps, GRID, dx=STEP, reference=-error)
    assert any("sign of the known reference" in m for m in result.messages)
    assert not stitch(maps, GRID, dx=STEP, reference=error).messages
    ignored = stitch(maps, GRID, dx=STEP)
    assert any("more than noise" in m for m in ignored.messages)


def test_one_wrong_position_among_few_is_said():
    """The mismatch is below three medians, but it is not noise."""
    wrong = GRID + np.array([[0, 0]] * 4 + [[1, 0]] + [[0, 0]]) * 0.6 * STEP
    result = stitch(set_up(), wrong, dx=STEP)
    assert not result.audit["outlying_pairs"]
    assert any("more than noise" in m for m in result.messages)


def test_large_maps_are_tried_on_coarse_pixels():
    """151 pixels are tried on every third; the positions are those of the full maps."""
    x, y = np.meshgrid(np.arange(330.0), np.arange(240.0))
    part = smooth(x / 5.0, y / 5.0)
    places = [(a * 75, b * 60) for b in range(2) for a in range(3)]
    maps = [part[j : j + 151, i : i + 151] for i, j in places]
    wrong = np.array(places) * [STEP, -STEP]
    result = stitch(maps, wrong, dx=STEP)
    assert any("sign of y of the positions" in m for m in result.messages)


def test_masked_arrays_are_not_measured():
    maps, masked = set_up(), []
    for z in maps:
        hole = np.zeros(z.shape, dtype=bool)
        hole[3:6, 4:9] = True
        masked.append(np.ma.array(np.where(hole, 1.0, z), mask=hole))
    result = stitch(masked, GRID, dx=STEP)
    expected = stitch([z.filled(np.nan) for z in masked], GRID, dx=STEP)
    np.testing.assert_array_equal(result.surface, expected.surface)
    assert result.noise.value < 1e-9


def test_units_that_look_wrong_are_said():
    maps = set_up()
    with pytest.raises(DataError, match="both in m"):
        stitch(maps, GRID * 1e-3, dx=STEP)
    with pytest.raises(DataError, match="dx was not given"):
        stitch(maps, GRID)
    with pytest.raises(DataError, match="dy is given without dx"):
        stitch(maps, GRID, dy=STEP)
    assert any("step is 1 m" in m for m in stitch(maps, GRID / STEP, dx=1.0).messages)
    large = stitch([1e6 * z for z in maps], GRID, dx=STEP)
    assert any("heights" in m for m in large.messages)


def test_overlap_of_one_column_fixes_no_tilt():
    rng = np.random.default_rng(14)
    maps = list(rng.standard_normal((2, ROWS, SIDE)) * 1e-9)
    with pytest.raises(DegenerateFitError, match="fixes no tilt"):
        stitch(maps, [(0, 0), ((SIDE - 1) * STEP, 0)], dx=STEP)


def test_stated_noise_that_does_not_fit_is_said():
    rng = np.random.default_rng(15)
    maps = 5e-9 * rng.standard_normal((5, ROWS, SIDE))
    result = stitch(list(maps), FIVE, dx=STEP, u_reading=1e-9)
    assert any("does not fit" in m or "do not fit" in m for m in result.messages)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"positions": None}, "need positions"),
        ({"positions": FIVE[:3]}, "shape"),
        ({"positions": np.array(FIVE) * 1e6}, "both in m"),
        ({"freedoms": ("tilt",)}, "piston"),
        ({"freedoms": ("piston", "twist")}, "twist"),
        ({"dx": -1.0}, "dx"),
        ({"rotations": [0, 0, 0, 0, 90.0]}, "degrees"),
        ({"reference": "guess"}, "guess"),
        ({"reference": np.zeros((3, 3))}, "shape"),
        ({"reference_degree": 4}, "fit"),
        ({"registration": "hope"}, "hope"),
        ({"u_reading": -1.0}, "u_reading"),
        ({"u_reading": "1"}, "u_reading"),
        ({"dx": "a"}, "dx"),
        ({"rotations": "ab"}, "rotations"),
        ({"reference": [["a"]]}, "reference"),
        ({"reference": "fit", "reference_degree": "x"}, "reference_degree"),
        ({"draws": None}, "draws"),
        ({"draws": -1}, "draws"),
        ({"freedoms": 3}, "freedoms"),
        ({"positions": np.array(FIVE) + 1j}, "complex"),
    ],
)
def test_bad_settings_are_refused(change, match):
    maps = list(np.random.default_rng(16).standard_normal((5, ROWS, SIDE)))
    given = {"positions": FIVE, "dx": STEP, **change}
    with pytest.raises(MetrosepError, match=match):
        stitch(maps, given.pop("positions"), **given)


def test_complex_maps_are_refused():
    with pytest.raises(MetrosepError, match="complex"):
        stitch(list(np.ones((5, ROWS, SIDE)) * 1j), FIVE, dx=STEP)


def test_real_mirror_in_pieces(corpus):
    """A dabam mirror cut in overlapping pieces with random line and a planted reference error."""
    mirror = ms.read(corpus / "dabam" / "dabam-010.dat")
    z, dx = mirror.z, mirror.dx
    starts = np.cumsum([0, 37, 44, 37, 41, 44, 39, 43])
    starts = starts[starts + 120 <= z.size]
    u = np.linspace(-1, 1, 120)
    reference = 4e-9 * (u**3 - u) + 1e-9 * np.sin(11 * u)
    plain, fitted = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        pieces = [
            ms.Profile(
                mirror.x[a : a + 120],
                z[a : a + 120]
                + reference
                + 1e-6 * rng.standard_normal()
                + 1e-6 * rng.standard_normal() * u
                + 0.1e-9 * rng.standard_normal(120),
            )
            for a in starts
        ]
        truth = z[: starts[-1] + 120]
        t = np.linspace(-1, 1, truth.size)
        for out, settings in ((plain, {}), (fitted, {"reference": "fit", "draws": 8})):
            result = stitch(pieces, **settings)
            error = result.surface - truth
            terms = [np.ones_like(t), t] + ([t**2] if settings else [])
            error = without(error, *terms)
            out.append(
                (np.sqrt(np.nanmean(error**2)), np.sqrt(np.nanmean(result.u["surface"] ** 2)))
            )
        assert result.coordinates["x"][0] == pytest.approx(mirror.x[0], abs=1e-9)
        assert abs(result.coordinates["x"][1] - result.coordinates["x"][0] - dx) < 1e-9
    assert np.mean([p[0] for p in plain]) > 4 * np.mean([f[0] for f in fitted])
    assert all(rms < 2 * u for rms, u in fitted)

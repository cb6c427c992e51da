"""Stage and grid plate under the contract; the plate is turned mark by mark as complex numbers."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.planes.lattice_calibration import (
    GridCalibration,
    GridView,
    grid_calibration,
)

PITCH = 10e-3
MORE = ((0, (0, 0)), (1, (0, 0)), (0, (1, 0)), (3, (0, -1)))

SAME = 1e-20
"""m; the class and the function do the same sums."""


def radial(n_y, n_x):
    """Positions of the sites about the centre as complex numbers, in pitches."""
    x = np.arange(n_x) - (n_x - 1) / 2
    y = np.arange(n_y) - (n_y - 1) / 2
    return x[None, :] + 1j * y[:, None]


def as_pairs(z):
    return np.stack([z.real, z.imag], axis=-1)


def without_terms(e):
    """Without translation, rotation and scale."""
    r = radial(*e.shape[:2])
    basis = np.stack([as_pairs(c * (r if k else np.ones_like(r))).ravel()
                      for k in (0, 1) for c in (1, 1j)], axis=1)  # fmt: skip
    return e - (basis @ np.linalg.lstsq(basis, e.ravel(), rcond=None)[0]).reshape(e.shape)


class TestThreeViews(SeparationContract):
    has_redundancy = True
    n_y, n_x = 6, 6
    placements = ((0, (0, 0)), (1, (0, 0)), (0, (1, 0)))

    def method(self):
        return GridCalibration(PITCH, self.placements)

    def draw_part(self, rng):
        return without_terms(100e-9 * rng.standard_normal((self.n_y, self.n_x, 2)))

    def truth(self, rng):
        return {"plate": self.draw_part(rng)}

    def errors(self, rng):
        return {"stage": self.draw_part(rng)}

    def readings(self, truth, errors):
        """``placement`` (views, 3): translation x, y and rotation of the plate as laid down."""
        zero = np.zeros((self.n_y, self.n_x, 2))
        plate = truth.get("plate", zero) @ np.array([1, 1j])
        stage = errors.get("stage", zero) @ np.array([1, 1j])
        laid = truth.get("placement", np.zeros((len(self.placements), 3)))
        where = radial(self.n_y, self.n_x)
        out = np.full((len(self.placements), self.n_y, self.n_x, 2), np.nan)
        for k, (turns, (a, b)) in enumerate(self.placements):
            for mark in np.ndindex(self.n_y, self.n_x):
                site = where[mark] * 1j**turns + a + 1j * b
                hit = np.argwhere(np.abs(where - site) < 0.1)
                if len(hit):
                    row, column = hit[0]
                    add = laid[k, 0] + 1j * laid[k, 1] + 1j * laid[k, 2] * site
                    z = plate[mark] * 1j**turns + stage[row, column] + add
                    out[k, row, column] = z.real, z.imag
        return out

    def invisible(self, rng):
        """Scale against scale, and translation and rotation of both against the placements."""
        s, spin, *rest = 1e-7 * rng.standard_normal(6)
        c, d = complex(*rest[:2]), complex(*rest[2:])
        r = radial(self.n_y, self.n_x)
        laid = np.zeros((len(self.placements), 3))
        for k, (turns, (a, b)) in enumerate(self.placements):
            shift = a + 1j * b
            move = s * shift - c * 1j**turns - d
            laid[k] = move.real, move.imag, -spin
        stage = -s * r + d + 1j * spin * r
        yield {"plate": as_pairs(s * r + c), "placement": laid}, {"stage": as_pairs(stage)}

    def test_null_space_changes_no_part_that_is_given(self):
        """Where no mark lies, nothing is read: NaN of a view count as unchanged."""
        rng, _, _, readings = self.draw(8)
        plain = self.method().separate(readings)
        for truth, errors in self.invisible(rng):
            hidden = self.readings(truth, errors)
            assert np.nanmax(np.abs(hidden)) < 1e-9 * np.max(np.abs(errors["stage"]))
            seen = self.method().separate(readings + hidden)
            for name, values in plain.parts.items():
                np.testing.assert_allclose(seen.parts[name], values, rtol=0.0, atol=1e-15)
        assert {item.part for item in plain.null_space} == {"stage", "plate"}

    def test_readings_of_sites_without_a_mark_stay_not_measured(self):
        *_, readings = self.draw(5)
        corrected = self.method().correct(readings)
        np.testing.assert_array_equal(np.isnan(corrected), np.isnan(readings))
        assert np.isnan(corrected).any()


class TestFourViewsOfAnOblongPlate(TestThreeViews):
    n_y, n_x = 4, 6
    placements = MORE


def test_the_class_gives_what_the_function_gives_with_repeats():
    rng = np.random.default_rng(4)
    case = TestThreeViews()
    readings = case.draw(3)[3][:, None] + 1e-9 * rng.standard_normal((3, 4, 6, 6, 2))
    readings[0, 1, 2, 2] = np.nan
    found = GridCalibration(PITCH).separate(readings)
    named = dict(zip(("initial", "rotated", "shifted"), readings, strict=True))
    same = grid_calibration(named, pitch=PITCH)
    np.testing.assert_allclose(found.stage, same.stage, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.u["plate"], same.u["plate"], rtol=0.0, atol=SAME)
    assert GridCalibration(PITCH).correct(readings).shape == readings.shape
    views = [GridView(r, *p) for r, p in zip(readings, case.placements, strict=True)]
    assert grid_calibration(views, pitch=PITCH).noise.value == found.noise.value


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: GridCalibration(0.0), "pitch"),
        (lambda: GridCalibration(PITCH, ((0, (0, 0)), (0.5, (0, 0)))), "view 2"),
        (lambda: GridCalibration(PITCH, (3,)), "placement 1"),
        (lambda: GridCalibration(PITCH).simulate({"plate": np.zeros((4, 5, 2))}, {}), "quarter"),
        (lambda: GridCalibration(PITCH).simulate({"plate": np.zeros((4, 4))}, {}), "shape"),
        (lambda: GridCalibration(PITCH).separate(np.zeros((2, 4, 4, 2))), "3 placements"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()

"""Lines in both directions under the contract: every line lies with its own offset and slope."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.planes.coupled_method import CoupledGrid, coupled_grid

N_Y, N_X = 9, 12
DX, DY = 5e-3, 4e-3
U, V = np.meshgrid(np.arange(N_X) - (N_X - 1) / 2, np.arange(N_Y) - (N_Y - 1) / 2)
TERMS = {
    "free": [np.ones_like(U), U, V, U * V],
    "common": [np.ones_like(U), U, V],
    "none": [np.ones_like(U)],
}

SAME = 1e-20
"""m; the class and the function do the same sums."""


def without(z, terms):
    b = np.stack([t.ravel() for t in terms], axis=1)
    return z - (b @ np.linalg.lstsq(b, z.ravel(), rcond=None)[0]).reshape(z.shape)


class TestFree(SeparationContract):
    has_redundancy = True
    slopes = "free"

    def method(self):
        return CoupledGrid(DX, DY, self.slopes)

    def truth(self, rng):
        return {}

    def errors(self, rng):
        return {"error": without(1e-7 * rng.standard_normal((N_Y, N_X)), TERMS[self.slopes])}

    def readings(self, truth, errors):
        """Offsets and slopes ``a + b x`` of rows, ``c + d y`` of columns are the test's own."""
        e = errors.get("error", np.zeros((N_Y, N_X)))
        a, b, c, d = truth.get("lines", (0.0, 0.0, 0.0, 0.0))
        out = np.empty((2, N_Y, N_X))
        for j in range(N_Y):
            for i in range(N_X):
                row = (np.broadcast_to(a, N_Y)[j], np.broadcast_to(b, N_Y)[j])
                column = (np.broadcast_to(c, N_X)[i], np.broadcast_to(d, N_X)[i])
                out[0, j, i] = e[j, i] + row[0] + row[1] * U[j, i]
                out[1, j, i] = e[j, i] + column[0] + column[1] * V[j, i]
        return out

    def invisible(self, rng):
        k = 1e-6 * rng.standard_normal(4)
        error = {"error": k[0] + k[1] * U + k[2] * V + k[3] * U * V}
        lines = (
            -k[0] - k[2] * V[:, 0],
            -k[1] - k[3] * V[:, 0],
            -k[0] - k[1] * U[0],
            -k[2] - k[3] * U[0],
        )
        yield {"lines": lines}, error

    def test_null_space_changes_no_part_that_is_given(self):
        """The lines of different directions have different lengths: sizes are taken one by one."""
        rng, _, _, readings = self.draw(8)
        plain = self.method().separate(readings)
        for truth, errors in self.invisible(rng):
            hidden = self.readings(truth, errors)
            assert np.max(np.abs(hidden)) < 1e-9 * np.max(np.abs(errors["error"]))
            seen = self.method().separate(readings + hidden)
            np.testing.assert_allclose(seen.error, plain.error, rtol=0.0, atol=1e-15)
        assert all(item.part == "error" for item in plain.null_space)

    def own_lines(self, rng):
        count = {"free": (N_Y, N_Y, N_X, N_X), "common": (N_Y, 1, N_X, 1)}.get(
            self.slopes, (N_Y, 0, N_X, 0)
        )
        return [1e-6 * rng.standard_normal(n) if n else 0.0 for n in count]

    def test_how_the_lines_lie_does_not_reach_the_map_and_stays_in_corrected_readings(self):
        rng, _, errors, _ = self.draw(20)
        lines = {"lines": self.own_lines(rng)}
        found = self.method().separate(self.readings(lines, errors))
        np.testing.assert_allclose(found.error, errors["error"], rtol=0.0, atol=1e-14)

        left = self.method().correct(self.readings(lines, errors))
        np.testing.assert_allclose(left, self.readings(lines, {}), rtol=0.0, atol=1e-14)


class TestCommon(TestFree):
    slopes = "common"

    def invisible(self, rng):
        k = 1e-6 * rng.standard_normal(3)
        lines = (-k[0] - k[2] * V[:, 0], -k[1], -k[0] - k[1] * U[0], -k[2])
        yield {"lines": lines}, {"error": k[0] + k[1] * U + k[2] * V}


class TestReferenceKept(TestFree):
    slopes = "none"

    def invisible(self, rng):
        k = 1e-6 * rng.standard_normal()
        yield {"lines": (-k, 0.0, -k, 0.0)}, {"error": np.full((N_Y, N_X), k)}


def test_the_class_gives_what_the_function_gives_with_repeats_and_lines_that_were_not_run():
    rng = np.random.default_rng(2)
    readings = 1e-7 * rng.standard_normal((2, 3, N_Y, N_X))
    readings[0, :, 4] = np.nan
    readings[1, :, :, [2, 7]] = np.nan
    found = CoupledGrid(DX, DY).separate(readings)
    same = coupled_grid(readings[0], readings[1], dx=DX, dy=DY)
    np.testing.assert_allclose(found.error, same.error, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.u["error"], same.u["error"], rtol=0.0, atol=SAME)
    assert found.null_space == same.null_space
    left = CoupledGrid(DX, DY).correct(readings)
    assert left.shape == readings.shape
    np.testing.assert_allclose(left, readings - found.error, rtol=0.0, atol=SAME)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: CoupledGrid(-1e-3, 1e-3), "dx"),
        (lambda: CoupledGrid(1e-3, 1e-3, "some"), "slopes"),
        (lambda: CoupledGrid(DX, DY).simulate({"error": np.zeros((3, 3))}, {}), "it has none"),
        (lambda: CoupledGrid(DX, DY).simulate({}, {"error": np.zeros(3)}), "map"),
        (lambda: CoupledGrid(DX, DY).separate(np.zeros((3, 5, 5))), "lines along y"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()

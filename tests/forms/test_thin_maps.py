"""Uncertainty of a plane on maps of a few rows and thousands of columns, where blocks may not join the rows."""

import numpy as np
import pytest

from metrosep import Surface
from metrosep.forms import fit

STEP, NM = 1e-5, 1e-9


@pytest.mark.parametrize("rows", [2, 3, 8, 20])
@pytest.mark.parametrize("turned", [False, True])
def test_a_map_of_a_few_rows_has_the_u_of_its_white_noise(rows, turned):
    shape = (3000, rows) if turned else (rows, 3000)
    z = NM * np.random.default_rng(5).standard_normal(shape)
    found = fit(Surface(z, STEP, STEP), "plane")
    # of white noise: sigma / sqrt(N) over the standard deviation of the positions
    for key, n in (("tilt_x", shape[1]), ("tilt_y", shape[0])):
        white = NM / np.sqrt(z.size) / (STEP * np.sqrt((n * n - 1) / 12.0))
        assert (
            0.8 * white < found.u[key] < 2.5 * white
        )  # of some seeds more: a long spectrum may be likely
        assert abs(found.params[key]) < 4.0 * found.u[key]
    assert found.u["piston"] > 0.8 * NM / np.sqrt(z.size)

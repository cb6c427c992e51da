"""Fixtures of the file tests."""

import numpy as np
import pytest

import metrosep as ms


@pytest.fixture
def put(tmp_path):
    """Write text or bytes to a file and return its path."""

    def write(content, name="data.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def bump():
    """Surface without any symmetry: a bump in one corner, a hole in another, steps unequal."""
    z = np.zeros((4, 5))
    z[0, 4] = 90e-9
    z[3, 0] = np.nan
    z[2, 1] = -1.0 / 3.0 * 1e-9
    return ms.Surface(z, 1.5e-6, 2.5e-6, origin=(1e-3, -2e-3))

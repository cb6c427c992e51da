"""What arrays an object takes: masks, complex numbers."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core._arrays import as_float
from metrosep.core.errors import InvalidSamplesError


def test_masked_samples_are_not_measured():
    x = np.linspace(0.0, 1e-3, 5)
    masked = np.ma.masked_array(np.arange(5.0), mask=[0, 0, 1, 0, 0])

    assert np.isnan(ms.Profile(x, masked).z[2])
    assert ms.Profile(x, masked).n_invalid == 1


def test_complex_samples_are_refused():
    with pytest.raises(InvalidSamplesError, match="complex"):
        ms.Profile(np.linspace(0.0, 1e-3, 5), np.arange(5) + 1j)


def test_masks_of_rows_in_a_list_are_kept():
    """numpy drops them: np.array of a list of masked rows holds what was hidden."""
    row = np.ma.masked_array([1.0, 2.0, 3.0], mask=[0, 1, 0])

    for m in ([row, row], (row, [4.0, 5.0, 6.0])):
        assert np.isnan(as_float(m)[0, 1])
    with pytest.raises(TypeError, match="complex"):
        as_float([1j, 2.0])

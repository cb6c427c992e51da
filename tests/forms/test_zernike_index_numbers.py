"""Numbers of Zernike terms are whole numbers."""

import numpy as np
import pytest

from metrosep.errors import DataError
from metrosep.forms.zernike import term_indices


@pytest.mark.parametrize("terms", [[1.5], [2.0], [True, 2], ["3"], 2.5, None])
def test_only_whole_numbers_are_numbers_of_terms(terms):
    with pytest.raises(DataError, match="number of terms or a list of them"):
        term_indices(terms, "noll")


def test_numbers_of_numpy_are_whole_numbers_too():
    assert term_indices(np.array([4, 2]), "noll") == (4, 2)

"""Fixtures of the tests of the workbench."""

import pytest


@pytest.fixture(autouse=True)
def _once_here(separations_once, uncertainties_once, without_figures):
    """These tests ask what becomes of a separation, not whether it repeats itself."""

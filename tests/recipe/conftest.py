"""Fixtures of the tests of recipes."""

import pytest


@pytest.fixture(autouse=True)
def _once_here(separations_once, uncertainties_once, without_figures):
    """These tests ask what becomes of a separation, not whether it repeats itself; a module that looks at
    figures draws them (its own `without_figures`)."""

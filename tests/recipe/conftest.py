"""Fixtures of the tests of recipes."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def _once_here(quick_doors):
    """These tests ask what becomes of a result, not whether it repeats itself, and read the text."""

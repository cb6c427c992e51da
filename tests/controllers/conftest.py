"""A table that must not be mirrored or negated, and the measurement it comes from."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from metrosep import Profile
from metrosep.compensation import CompensationTable

MEMORY = Path("/dev/shm")  # noqa: S108  a folder in memory, of Linux


@pytest.fixture(scope="package", autouse=True)
def _small_files_in_memory() -> Iterator[None]:
    """Thousands of small files are written here."""
    with pytest.MonkeyPatch.context() as patch:
        if MEMORY.is_dir() and os.access(MEMORY, os.W_OK):
            patch.setattr(tempfile, "tempdir", str(MEMORY))
        yield


@pytest.fixture(scope="session")
def bump():
    """Error of +3 um at 12 mm of 50 mm, and a smaller one of -1 um at 20 mm."""

    def error(x):
        x = np.asarray(x)
        return 3e-6 * np.exp(-(((x - 12e-3) / 3e-3) ** 2)) - 1e-6 * np.exp(
            -(((x - 20e-3) / 2e-3) ** 2)
        )

    return error


@pytest.fixture(scope="session")
def measured(bump):
    """It as a profile."""
    x = np.linspace(0.0, 50e-3, 2001)
    return Profile(x, bump(x))


@pytest.fixture(scope="session")
def table(bump, measured):
    """Its table, with 0.7 um lost motion."""
    return CompensationTable.from_error(
        measured,
        reverse=lambda x: bump(x) + 0.7e-6,
        positions=np.linspace(0.0, 50e-3, 101),
        axis="X",
        source_sha256=("ab" * 32,),
    )

"""Fixtures shared by all tests."""

import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def corpus() -> Path:
    """Folder of real instrument files; the tests that need it skip by name where it is absent."""
    folder = Path(os.environ.get("METROSEP_CORPUS", REPOSITORY.parent / "shared" / "corpus"))
    if not (folder / "MANIFEST.tsv").is_file():
        pytest.skip("corpus not found: set METROSEP_CORPUS or put it at ../shared/corpus")
    return folder


@pytest.fixture
def repository() -> Path:
    """Root of the checkout."""
    return REPOSITORY


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded random generator."""
    return np.random.default_rng(20260101)


@pytest.fixture
def calls() -> Callable[[Callable[[], object]], int]:
    """Count the functions that a function calls: work in Python, the same on every machine."""

    def count(function: Callable[[], object]) -> int:
        n = 0

        def tick(_frame, event, _argument):
            nonlocal n
            n += event in ("call", "c_call")

        function()  # imports and caches
        sys.setprofile(tick)
        try:
            function()
        finally:
            sys.setprofile(None)
        return n

    return count


@pytest.fixture(scope="session")
def contract_machine():
    """The module with the machine simulator that shares no code with metrosep."""
    path = REPOSITORY / "tests" / "contracts" / "machine.py"
    spec = importlib.util.spec_from_file_location("contract_machine", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def as_runset():
    """Turn the runs of the contract simulator into a RunSet (mm, um, mm/s to SI)."""
    from metrosep import Run, RunSet

    def convert(*machines):
        return RunSet(
            Run(x * 1e-3, z * 1e-6, t=t, feed=v * 1e-3, run_id=f"{m}.{i}")
            for m, machine in enumerate(machines)
            for i, (x, z, t, v) in enumerate(machine.runs)
        )

    return convert

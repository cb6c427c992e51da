"""Parts of known roughness in three formats, and recipes that judge them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.recipe import Recipe

STEP = 1e-6  # m
PERIODS = 4
UPPER = 10e-9  # m, limit of Sa
U = 0.2e-9  # m
SA = {"accepted": 6e-9, "rejected": 14e-9, "inconclusive": 10e-9}
SUFFIXES = ("sdf", "x3p", "sur")

RECIPE = """metrosep = 1
title = "parts"
[input]
files = ["*.sdf", "*.x3p", "*.sur"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sa", "PV"]
[[check]]
name = "roughness"
metric = "Sa"
upper = "10 nm"
U = "0.2 nm"
"""


def part(sa: float, size: int, seed: int = 0) -> np.ndarray:
    """Heights of a tilted wave of whole periods, even about the middle: no plane hides in it."""
    wave = np.cos(2 * np.pi * PERIODS * (np.arange(size) + 0.5) / size)
    tilt = 20e-9 * (1 + seed % 7) * np.arange(size)[:, None] / size
    return np.broadcast_to(sa / np.abs(wave).mean() * wave, (size, size)) + tilt


def write_part(file: Path, sa: float, *, size: int = 32, seed: int = 0) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    ms.write(ms.Surface(part(sa, size, seed), STEP, STEP), file)
    return file


@pytest.fixture
def inbox(tmp_path) -> Path:
    """Six parts, two of each verdict, in two subfolders under equal names."""
    folder = tmp_path / "inbox"
    for i, status in enumerate(SA):
        for day in ("mo", "tu"):
            write_part(folder / day / f"P_{i}.{SUFFIXES[i]}", SA[status], seed=i)
    return folder


@pytest.fixture
def recipe() -> Recipe:
    return Recipe.parse(RECIPE)


@pytest.fixture
def parts() -> Callable[..., Path]:
    return write_part


@pytest.fixture
def recipe_text() -> str:
    return RECIPE


@pytest.fixture(autouse=True, scope="module")
def _once_here(quick_doors):
    """These tests ask what becomes of a result, not whether it repeats itself, and read the text."""

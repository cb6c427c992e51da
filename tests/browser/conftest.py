"""A headless Chromium and a running workbench; skipped where no Chromium is installed."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

DRIVER = Path(__file__).resolve().parents[2] / "tools" / "chromium.py"
FULL = "document.querySelector('#status-full.done') !== null"

N, STEP = 600, 10e-6
"""360 000 pixels: more than are shown without a preview."""


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("metrosep_chromium", DRIVER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


chromium = _load()


def heights() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return a bowl with two waves, seen through a circle, with a hole beside the middle."""
    rng = np.random.default_rng(5)
    x = (np.arange(N) - (N - 1) / 2) * STEP
    X, Y = np.meshgrid(x, x)
    r = np.hypot(X, Y)
    z = (
        r**2 / (2 * 0.2)
        + 40e-9 * np.cos(2 * np.pi * X / 0.5e-3)
        + 1e-9 * rng.standard_normal(r.shape)
    )
    z[r > 2.9e-3] = np.nan
    z[250:350, 360:420] = np.nan
    return z


@pytest.fixture(scope="session")
def _tab() -> Iterator[Any]:
    if chromium.find_chromium() is None:
        pytest.skip("no Chromium is installed")
    with chromium.browser() as page:
        yield page


@pytest.fixture
def tab(_tab: Any) -> Any:
    """The page, empty, with no request noted."""
    _tab.go("about:blank")
    _tab.wait("location.href === 'about:blank'")
    _tab.requests.clear()
    _tab.errors.clear()
    _tab.show(1366, 768)
    return _tab


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """A map with a hole."""
    from metrosep import Surface
    from metrosep.io.write import write

    file = tmp_path / "bowl.x3p"
    write(Surface(heights(), dx=STEP, dy=STEP), file)
    return file


@pytest.fixture
def opened(tab: Any) -> Iterator[Callable[..., Any]]:
    """Open a file in the workbench and wait for the full resolution."""
    from contextlib import ExitStack

    with ExitStack() as stack:

        def start(file: Path | None, ready: str = FULL) -> Any:
            tab.go(stack.enter_context(chromium.workbench(file)))
            tab.wait(ready)
            return tab

        yield start
        tab.go("about:blank")

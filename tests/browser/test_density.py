"""The spectrum panel of a step psd: density, limit, bands and verdict as the library has them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

STEP = 1e-5
LIMIT = "A = 5 nm^2 mm, B = 2 from 0.05 mm to 0.5 mm"


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """A disc of 3 mm, f^-3 in two dimensions, 20 nm RMS, with a recipe that compares its spectrum."""
    from metrosep import Surface
    from metrosep.io.write import write

    rng, n, wide = np.random.default_rng(0), 300, 1024
    fx = np.fft.fftfreq(wide)
    f = np.hypot(fx[:, None], fx)
    f[0, 0] = f[0, 1]
    z = np.fft.ifft2(np.fft.fft2(rng.standard_normal((wide, wide))) * f**-1.5).real[:n, :n]
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    z = np.where(x * x + y * y > 1.0, np.nan, z / z.std() * 20e-9 + 1e-6 * x)
    write(Surface(z, STEP, STEP), tmp_path / "disc.h5")
    file = tmp_path / "disc.toml"
    file.write_text(
        'metrosep = 1\n[input]\nfiles = ["disc.h5"]\n[[step]]\nop = "form"\nform = "plane"\n'
        f'[[step]]\nop = "psd"\nlimit = "{LIMIT}"\n[[check]]\nmetric = "PSD"\n',
        "utf-8",
    )
    return file


def test_the_density_stands_against_its_limit(
    opened: Callable[..., Any], recipe: Path, tmp_path: Path
) -> None:
    page = opened(recipe)
    page.wait("!document.querySelector('#density').hidden")
    page.wait(
        "document.querySelector('#density .readout').textContent.startsWith('rejected, worst band')"
    )
    assert page.text("#spectrum-title") == "Power spectral density"
    assert LIMIT in page.text("#spectrum-of")
    assert page.text("#verdict .word") == "Rejected"
    x, y, width, height = page.box("#density .u-over")
    page.mouse("mouseMoved", x + 0.5 * width, y + 0.5 * height)
    page.wait("document.querySelector('#density .readout').textContent.includes('of the limit,')")
    assert "nm² mm" in page.text("#density .readout")
    page.mouse("mouseMoved", 5, 5)

    page.click("#steps .pick")  # as measured: amplitudes again
    page.wait("document.querySelector('#density').hidden")
    page.wait("document.querySelector('#spectrum .readout').textContent.includes('RMS inside')")
    assert page.errors == []

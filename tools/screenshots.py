"""Make the pictures of the workbench for the documentation: light and dark, two sizes of screen.

Run with `python tools/screenshots.py [FOLDER]`; Chromium and the extra `ui` must be installed.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from chromium import Page, browser, workbench

HERE = Path(__file__).resolve().parents[1]
PART = HERE / "examples" / "measured_part"
SIZES = ((1366, 768), (1920, 1080))
READY = "document.querySelector('#status-full.done') !== null"


def main(target: Path) -> None:
    """Write the pictures into a folder."""
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, browser() as page:
        work = Path(folder)
        for name in ("measured.sdf", "recipe.toml"):
            shutil.copy(PART / name, work / name)
        with workbench(work / "recipe.toml") as address:
            page.show(*SIZES[0])
            page.go(address)
            page.wait(READY)
            for scheme in ("light", "dark"):
                for width, height in SIZES:
                    page.show(width, height, scheme)
                    keep(page, target / f"workbench-{scheme}-{width}x{height}.png")
            page.show(*SIZES[0])
            page.click('[data-step="2"] .pick')
            keep(page, target / "workbench-step.png")
        profile = work / "profile.x3p"
        make_profile(profile)
        with workbench(profile) as address:
            page.go(address)
            page.wait(READY)
            keep(page, target / "workbench-profile.png")


def keep(page: Page, file: Path) -> None:
    """Wait until nothing moves, and write what is seen."""
    before = b""
    for _ in range(20):
        time.sleep(0.4)
        now = page.picture()
        if now == before:
            break
        before = now
    file.write_bytes(before)
    print(f"{file.name}: {len(before)} bytes")


def make_profile(file: Path) -> None:
    """Write a slide's straightness with a dropout and a spike, 200 mm at 1 um."""
    import numpy as np

    from metrosep import Profile
    from metrosep.io.write import write

    rng = np.random.default_rng(8)
    x = np.arange(200_000) * 1e-6
    z = 3e-7 * np.cos(2 * np.pi * x / 0.05) + 6e-8 * np.cos(2 * np.pi * x / 2e-3)
    z += 1e-8 * np.cos(2 * np.pi * x / 1e-4) + 3e-9 * rng.standard_normal(x.size)
    z[60_000:64_000] = np.nan
    z[140_023] += 5e-7
    write(Profile(x, z), file)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "docs" / "_static")

"""Make the pictures of the workbench for the documentation: light and dark, two sizes of screen.

Run with `python tools/screenshots.py [FOLDER]`; Chromium and the extra `ui` must be installed.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from chromium import Page, browser, workbench

HERE = Path(__file__).resolve().parents[1]
EXAMPLES = HERE / "examples"
SIZES = ((1366, 768), (1920, 1080))
READY = "document.querySelector('#status-full.done') !== null"
QUIET = "document.querySelector('[aria-busy=true]') === null"
LONG = 120.0
"""Seconds: a separation or a folder, on a busy computer."""


def main(target: Path) -> None:
    """Write the pictures into a folder."""
    target.mkdir(parents=True, exist_ok=True)
    with browser() as page:
        for take in (take_map, take_profile, take_runs, take_ranking, take_machine, take_folder):
            folder = Path(tempfile.gettempdir()) / "parts"  # a name that the pictures can show
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            try:
                take(page, folder, target)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
        if page.errors:
            raise RuntimeError("\n".join(page.errors))


def take_map(page: Page, work: Path, target: Path) -> None:
    """Take the measured part: all sizes and colours, a chosen step, two results beside each other."""
    copy("measured_part", work)
    with opened(page, work / "recipe.toml"):
        for scheme in ("light", "dark"):
            for width, height in SIZES:
                page.show(width, height, scheme)
                keep(page, target / f"workbench-{scheme}-{width}x{height}.png")
        page.show(*SIZES[0])
        page.click('[data-step="2"] .pick')
        keep(page, target / "workbench-step.png")
        page.click("#tab-compare")
        page.click("#compare-pin")
        page.wait("document.querySelector('dialog[open]') !== null")
        page.fill("dialog[open] input", "L-filter 2.5 mm")
        page.press("Enter")
        page.wait("document.querySelectorAll('.compare-rows tbody tr').length > 3", LONG)
        change(page, "2.5 mm", "1.5 mm")
        page.wait("document.querySelector('#panel-compare .outdated') === null", LONG)
        keep(page, target / "workbench-compare.png")


def take_profile(page: Page, work: Path, target: Path) -> None:
    """Take a profile of 200 000 points."""
    profile = work / "profile.x3p"
    make_profile(profile)
    with opened(page, profile):
        keep(page, target / "workbench-profile.png")


def take_runs(page: Page, work: Path, target: Path) -> None:
    """Take nine runs of a slide: the separation and the table."""
    copy("straightness", work)
    with opened(page, work / "recipe.toml"):
        page.click("#tab-runs")
        page.wait("document.body.dataset.runs", LONG)
        keep(page, target / "workbench-runs.png")
        page.click("#tab-table")
        page.wait("document.querySelector('#table-plot canvas') !== null", LONG)
        keep(page, target / "workbench-table.png")


def take_ranking(page: Page, work: Path, target: Path) -> None:
    """Take the error terms of a lathe."""
    copy("fts_lathe", work)
    with opened(page, work / "recipe.toml"):
        page.wait("document.querySelector('.ranking tbody tr') !== null", LONG)
        keep(page, target / "workbench-ranking.png")


def take_machine(page: Page, work: Path, target: Path) -> None:
    """Take the error terms of a five-axis mill from three balls."""
    copy("five_axis_calibration", work)
    with opened(page, work / "recipe.toml"):
        page.click("#tab-machine")
        page.wait("document.querySelector('.machine-map') !== null", LONG)
        page.show(1366, 1100)
        keep(page, target / "workbench-machine.png")


def take_folder(page: Page, work: Path, target: Path) -> None:
    """Take a folder of eight parts, one too rough, one torn."""
    make_folder(work)
    with opened(page, work / "recipe.toml"):
        page.click("#tab-folder")
        page.wait("document.querySelector('#folder-pattern')?.value")
        page.click("#folder-start")
        page.wait("document.querySelectorAll('#panel-folder tbody tr').length === 9", LONG)
        keep(page, target / "workbench-folder.png")


@contextlib.contextmanager
def opened(page: Page, file: Path) -> Iterator[None]:
    """Open a file, light and small; leave the page before its server ends."""
    with workbench(file) as address:
        page.show(*SIZES[0])
        page.go(address)
        page.wait(READY, LONG)
        yield
        page.go("about:blank")


def change(page: Page, old: str, new: str) -> None:
    """Type a value in place of another into the field of a chosen step."""
    page.click('[data-step="4"] .pick')
    field = f"[...document.querySelectorAll('#steps input')].find((one) => one.value === '{old}')"
    page.wait(f"{field} !== undefined")
    page.run(f"{field}.id = 'to-be-changed'")
    before = page.run("document.body.dataset.full")
    page.fill("#to-be-changed", new)
    page.press("Enter")
    page.wait(f"document.body.dataset.full !== '{before}'", LONG)


def copy(example: str, work: Path) -> None:
    """Copy the files of an example, for the workbench keeps its session beside them."""
    for file in (EXAMPLES / example).iterdir():
        if file.is_file():
            shutil.copy(file, work)


def keep(page: Page, file: Path) -> None:
    """Wait until nothing moves, and write what is seen."""
    page.wait(QUIET, LONG)
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


def make_folder(work: Path) -> None:
    """Write eight parts that roughen from one to the next, a torn one, and their recipe."""
    import numpy as np

    from metrosep import Surface
    from metrosep.io.write import write

    rng = np.random.default_rng(5)
    wave = np.sqrt(2.0) * np.sin(2 * np.pi * 6 * np.arange(128) / 128) * np.ones((128, 1))
    for part in range(8):
        height = 1e-9 * (6.0 + 0.55 * part)
        z = height * wave + 1e-9 * rng.standard_normal(wave.shape)
        write(Surface(z, 10e-6, 10e-6), work / f"LENS_{part + 41:03d}.x3p")
    whole = (work / "LENS_041.x3p").read_bytes()
    (work / "LENS_049.x3p").write_bytes(whole[: len(whole) // 2])
    (work / "recipe.toml").write_text(
        'metrosep = 1\ntitle = "Lens texture"\n[input]\nfiles = ["LENS_041.x3p"]\n'
        '[[step]]\nop = "form"\nform = "plane"\n'
        '[[step]]\nop = "parameters"\nnames = ["Sa", "Sq"]\n'
        '[[check]]\nname = "roughness"\nmetric = "Sq"\nupper = "9 nm"\nU = "0.4 nm"\n'
        "[batch]\npattern = '(?P<part>[A-Z]+)_(?P<serial>[0-9]+)[.]x3p'\n"
        'key = ["part", "serial"]\n'
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "docs" / "_static")

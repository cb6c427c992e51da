"""Time what a hand waits for in the workbench, in headless Chromium.

    python tools/bench_workbench.py [--folder DIR] [--rounds 9]

Prints the first picture of a 4096 x 4096 float32 map (26 % not measured), the preview of a form step
on it, the frames and numbers of a section that is dragged, the frames of the view in three dimensions,
the move of a limit on a profile of 10^6 points, and the size of the page: medians in ms, beside what is
wanted. `make speeds` calls it.
Nothing is asserted: seconds belong to a computer.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from chromium import browser, find_chromium, workbench

N = 4096
POINTS = 10**6
FULL = "document.querySelector('#status-full.done') !== null"
WATCH = """(() => {
  window.times = [];
  new MutationObserver((all) => { for (const one of all) window.times.push([one.attributeName, performance.now()]); })
    .observe(document.body, { attributes: true });
  window.since = (what, start) => new Promise((done) => {
    const look = () => {
      const found = window.times.find(([name, at]) => name === `data-${what}` && at > start);
      if (found) requestAnimationFrame(() => done(performance.now() - start)); else setTimeout(look, 1);
    };
    look();
  });
})()"""


def make_map(path: Path) -> None:
    """Write a bowl with waves and noise, seen through a circle, with dropouts: 26 % invalid."""
    y, x = np.mgrid[-1 : 1 : N * 1j, -1 : 1 : N * 1j]
    rng = np.random.default_rng(0)
    z = 1e-6 * (x * x + y * y) + 40e-9 * np.cos(60 * x) + 5e-9 * rng.standard_normal((N, N))
    z[(x * x + y * y > 0.98) | (rng.random((N, N)) < 0.04)] = np.nan
    np.save(path, z.astype(np.float32))


def make_profile(path: Path) -> None:
    """Write two waves with noise."""
    x = np.arange(POINTS) * 1e-6
    rng = np.random.default_rng(1)
    z = 1e-6 * np.cos(2 * np.pi * x / 0.02) + 1e-7 * np.cos(2 * np.pi * x / 1e-4)
    z += 1e-8 * rng.standard_normal(POINTS)
    rows = np.stack([x * 1e3, z * 1e6], axis=1)
    np.savetxt(path, rows, fmt="%.7g", delimiter=",", header="x_mm,z_um", comments="")


def recipe(path: Path, name: str, form: str, reading: str) -> Path:
    """Write the recipe that the page opens: what such a file does not say stands in it."""
    path.write_text(
        f'metrosep = 1\n[input]\nfiles = ["{name}"]\n{reading}\n[[step]]\nop = "form"\nform = "{form}"\n'
        '[[step]]\nop = "parameters"\n'
    )
    return path


def first_picture(page: Any, file: Path) -> float:
    """Open a file by the dialog; return ms from Enter to the first picture."""
    with workbench(None, folder=file.parent) as address:
        page.go(address)
        page.wait("document.querySelector('#colours').options.length > 0")  # the page is at work
        page.wait("performance.now() > 1500")
        page.run(WATCH)
        page.press("o")
        page.wait("document.querySelector('dialog[open]') !== null")
        page.fill("dialog [name=path]", str(file))
        page.run("window.start = performance.now()")
        page.press("Enter")
        waited = float(page.run("window.since('maps', window.start)"))
        page.go("about:blank")
    return waited


def form_preview(page: Any, file: Path, rounds: int) -> list[float]:
    """Switch the form off and on; return ms from the click to the picture."""
    times = []
    with workbench(file) as address:
        page.go(address)
        page.wait(FULL, 120)
        page.run(WATCH)
        for _ in range(rounds):
            before = page.run("document.body.dataset.full")
            script = """(async () => { window.times.length = 0; const start = performance.now();
              document.querySelector('[aria-label="Step 1, form: on"]').click();
              return window.since('maps', start); })()"""
            times.append(float(page.run(script)))
            page.wait(f"document.body.dataset.full !== {json.dumps(before)}", 120)
            page.wait(FULL, 120)
        page.go("about:blank")
    return times


DRAG = """(async () => {
  const grip = document.querySelector('[aria-label="Section end A"]');
  const box = grip.getBoundingClientRect();
  const send = (kind, dx, dy) => grip.dispatchEvent(new PointerEvent(kind, { bubbles: true, pointerId: 1, button: 0,
    buttons: 1, clientX: box.left + 12 + dx, clientY: box.top + 12 + dy }));
  grip.setPointerCapture = () => {};
  grip.hasPointerCapture = () => true;
  send('pointerdown', 0, 0);
  const [frames, numbers] = [[], []];
  let last = performance.now();
  for (let i = 0; i < 120; i += 1) {
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    if (i > 1) frames.push(now - last);
    last = now;
    const before = document.body.dataset.sections;
    send('pointermove', i * 0.8, i * 0.5);
    if (i % 12 === 0) {
      const look = () => { if (document.body.dataset.sections !== before) numbers.push(performance.now() - now); else setTimeout(look, 1); };
      look();
    }
  }
  send('pointerup', 96, 60);
  await new Promise((done) => setTimeout(done, 1000));
  return [frames, numbers];
})()"""
BUSY = "not measured: this computer was too busy to draw it; end other programs and run this again"
TURN = """(async () => {
  document.getElementById('relief-on').click();
  const canvas = await new Promise((done) => { const look = () => { const c = document.querySelector('#relief canvas');
    if (Number(c?.dataset.frames) > 0) done(c); else setTimeout(look, 20); }; look(); });
  await new Promise((done) => setTimeout(done, 1500));
  const times = [];
  let last = performance.now();
  const start = last;
  while (last - start < 4000) {
    const before = canvas.dataset.frames;
    canvas.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowLeft', bubbles: true }));
    await new Promise((done) => { const look = () => (canvas.dataset.frames === before ? setTimeout(look, 0) : done()); look(); });
    times.push(performance.now() - last);
    last = performance.now();
  }
  return times.slice(8);
})()"""


def hand_moves(page: Any, file: Path) -> tuple[list[float], list[float], list[float]]:
    """Drag the section and turn the map; return ms of the frames, to the numbers, and of the frames in 3-D."""
    with workbench(file) as address:
        page.go(address)
        page.wait(FULL, 120)
        frames, numbers = page.run(DRAG)
        turned = page.run(TURN)
        page.go("about:blank")
    return frames, numbers, turned


def page_bytes() -> int:
    """Return the bytes of all that the page loads, vendor files too."""
    static = Path(__file__).resolve().parents[1] / "metrosep" / "app" / "static"
    return sum(f.stat().st_size for f in static.rglob("*") if f.suffix in (".js", ".css", ".html"))


def limit_moves(page: Any, file: Path, rounds: int) -> list[float]:
    """Move a limit of the spectrum by keys; return ms from each key to its picture."""
    times = []
    with workbench(file) as address:
        page.go(address)
        page.wait(FULL, 120)
        page.wait("document.querySelector('[aria-label^=Longest]') !== null")
        page.run(WATCH)
        for _ in range(rounds):
            script = """(async () => { window.times.length = 0; const start = performance.now();
              document.querySelector('[aria-label^=Longest]').dispatchEvent(
                new KeyboardEvent('keydown', { key: 'ArrowLeft', bubbles: true }));
              return window.since('spectrums', start); })()"""
            times.append(float(page.run(script)))
        page.go("about:blank")
    return times


def measured(folder: Path, rounds: int) -> Iterator[tuple[str, list[float], float]]:
    """Yield what was waited for, its times and what is wanted, ms."""
    with tempfile.TemporaryDirectory() as home, browser() as page:
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # as where metrosep is installed:
        os.environ["PYTHONPYCACHEPREFIX"] = f"{home}/pyc"  # compiled once, by the first start
        page.show(1366, 768)
        if not (folder / "map.npy").is_file():
            make_map(folder / "map.npy")
            make_profile(folder / "profile.csv")
        leveled = "polynomial: degree=1"
        on_map = recipe(
            folder / "map.toml", "map.npy", "plane", 'unit = "m"\nlateral_step = "1 um"'
        )
        on_profile = recipe(folder / "profile.toml", "profile.csv", leveled, "")
        first = [first_picture(page, on_map) for _ in range(1 + max(1, rounds // 2))]
        yield "first picture of a 4096 x 4096 map", first[1:], 2000
        yield "form step, preview", form_preview(page, on_map, rounds), 150
        frames, numbers, turned = hand_moves(page, on_map)
        yield "frame while the section is dragged", frames, 1000 / 60
        yield "numbers of the section behind the hand", numbers, 100
        yield "frame in three dimensions, software rendering", turned, 1000 / 30
        yield "limit on 10^6 points", limit_moves(page, on_profile, rounds), 120


def section(*, rounds: int = 9) -> list[str]:
    """Return the section of docs/benchmarks.md as lines."""
    lines = [
        "## What a hand waits for in the workbench",
        "",
        "`tools/bench_workbench.py`, in headless Chromium with server and page on this machine.",
        "",
    ]
    if find_chromium() is None:
        return [*lines, "Not measured: no Chromium is installed.", ""]
    with tempfile.TemporaryDirectory() as folder:
        rows = list(measured(Path(folder), rounds))
    lines += ["| wait | median | least to most | wanted |", "|---|---|---|---|"]
    for what, times, wanted in rows:
        if not times:
            lines.append(f"| {what} | {BUSY} | | {wanted:.0f} ms |")
            continue
        spread = f"{min(times):.0f} to {max(times):.0f} ms"
        lines.append(
            f"| {what} | {statistics.median(times):.0f} ms | {spread} | {wanted:.0f} ms |"
        )
    return [*lines, ""]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    if given.rounds < 1:
        parser.error("--rounds is a count from 1")
    with tempfile.TemporaryDirectory() as home:
        for what, times, wanted in measured(given.folder or Path(home), given.rounds):
            say(what, times, wanted)
    print(f"page with vendor files: {page_bytes() / 1e3:.0f} kB, wanted 1000 kB", flush=True)


def say(what: str, times: list[float], wanted: float) -> None:
    """Print a line."""
    if not times:
        print(f"{what}: {BUSY}", flush=True)
        return
    middle = statistics.median(times)
    print(f"{what}: median {middle:.0f} ms of {len(times)} ({min(times):.0f} to {max(times):.0f}), "
          f"wanted {wanted:.3g} ms, ratio {middle / wanted:.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()

"""Time `metrosep batch` over a folder of maps of 512 x 512 in three formats.

    python tools/bench_batch.py [--files 120] [--html 24] [--size 512] [--out FILE.md]

Files a second with one and with two workers, results only and with an HTML report of each file;
processor time of a file, and the largest memory of a worker. Set OMP_NUM_THREADS=1, as make does.
The first files of a worker, which import what is needed, are in the time of one file each.
Prints a section for docs/benchmarks.md; `section` returns it to another tool.
"""

import argparse
import os
import resource
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.batch import run_batch
from metrosep.recipe import Recipe

SUFFIXES = ("x3p", "sur", "sdf")
GOALS = {"results": 20.0, "results and HTML": 4.0}
RATIO = 1.8
STEP = 1e-6  # m
RECIPE = """metrosep = 1
title = "parts"
[input]
files = ["*.sdf", "*.x3p", "*.sur"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sa", "Sq", "Sz"]
[[check]]
name = "roughness"
metric = "Sa"
upper = "10 nm"
U = "0.2 nm"
"""
REPORT = """[[output]]
kind = "report"
formats = ["html"]
"""


def fill(folder, *, n, size):
    """Write `n` tilted waves with noise, a third of them in each format; equal ones are links."""
    folder.mkdir(parents=True)
    wave = 6e-9 * np.pi / 2 * np.cos(8 * np.pi * (np.arange(size) + 0.5) / size)
    models = {}
    for i in range(n):
        kind = (SUFFIXES[i % 3], i % 4)
        if kind not in models:
            noise = 1e-9 * np.random.default_rng(i).standard_normal((size, size))
            tilt = 20e-9 * np.arange(size)[:, None] / size
            models[kind] = folder.parent / f"model_{kind[1]}.{kind[0]}"
            ms.write(ms.Surface(wave + tilt + noise, STEP, STEP), models[kind])
        os.link(models[kind], folder / f"PART_{i:04d}.{kind[0]}")


def largest_child(stop):
    """Return a list of one number that becomes the largest memory of a child, or None."""
    try:
        import psutil
    except ImportError:
        return [None]
    most = [0]
    others = {child.pid for child in psutil.Process().children(recursive=True)}

    def look():
        while not stop.wait(0.1):
            for child in psutil.Process().children(recursive=True):
                if child.pid in others:  # of another benchmark
                    continue
                try:
                    most[0] = max(most[0], child.memory_info().rss)
                except psutil.Error:  # it ended meanwhile
                    continue

    threading.Thread(target=look, daemon=True).start()
    return most


def timed(recipe, folder, out, *, workers):
    """Return seconds, processor seconds of this process and its children, and their memory."""
    stop = threading.Event()
    most = largest_child(stop)
    before = processor_seconds()
    started = time.perf_counter()
    report = run_batch(recipe, folder, out=out, workers=workers)
    seconds = time.perf_counter() - started
    stop.set()
    if report.counts["accepted"] != report.counts["total"]:
        raise SystemExit(f"a file was not accepted: {report.counts}")
    shutil.rmtree(out)
    return seconds, processor_seconds() - before, most[0]


def processor_seconds():
    """Return the processor time of this process and of the children that ended."""
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def cases(folder, *, n, n_html, size):
    """Yield name, number of files, and for one and two workers what `timed` returns."""
    for name, text, count in (
        ("results", RECIPE, n),
        ("results and HTML", RECIPE + REPORT, n_html),
    ):
        inbox = folder / f"in_{count}_{len(text)}"
        fill(inbox, n=count, size=size)
        recipe = Recipe.parse(text)
        yield name, count, [timed(recipe, inbox, folder / "out", workers=k) for k in (1, 2)]
        for file in [*inbox.iterdir(), *folder.glob("model_*")]:
            file.unlink()


def section(*, n=120, n_html=24, size=512):
    """Return the section of docs/benchmarks.md as lines."""
    lines = [
        "## A folder of files",
        "",
        f"`tools/bench_batch.py`: maps of {size} x {size} in {', '.join(SUFFIXES)}; plane removed, Sa,",
        "Sq and Sz, one check. With all that a run takes, the start of the workers included.",
        "",
        "| written | files | files/s, 1 worker | 2 | goal | ratio | goal | CPU of a file | memory |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for name, count, (one, two) in cases(Path(folder), n=n, n_html=n_html, size=size):
            memory = "" if two[2] is None else f"{max(one[2], two[2]) / 1e6:.0f} MB"
            lines.append(
                f"| {name} | {count} | {count / one[0]:.1f} | {count / two[0]:.1f} | "
                f">= {GOALS[name]:g} | {one[0] / two[0]:.2f} | >= {RATIO} | "
                f"{one[1] / count * 1e3:.0f} ms | {memory} |"
            )
    return [*lines, ""]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=120, help="for results only")
    parser.add_argument("--html", type=int, default=24, help="for results with a report")
    parser.add_argument("--size", type=int, default=512, help="pixels of a side")
    parser.add_argument("--out", help="write the section to a file as well")
    arguments = parser.parse_args()
    if min(arguments.files, arguments.html, arguments.size) < 3:
        parser.error("at least 3 files of 3 pixels a side are needed")
    print(f"load before: {os.getloadavg()[0]:.1f}", file=sys.stderr)
    text = "\n".join(section(n=arguments.files, n_html=arguments.html, size=arguments.size))
    if arguments.out:
        Path(arguments.out).write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()

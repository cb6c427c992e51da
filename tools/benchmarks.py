"""Time metrosep against peers in one run and write docs/benchmarks.md.

    python tools/benchmarks.py --peers PYTHON [--quick] [--out docs/benchmarks.md]

PYTHON is the interpreter of an environment that holds the peers (make bench makes one). Ours and
the peer take turns; the median of the rounds counts. OMP_NUM_THREADS=1 is set by make. Ratios carry over
to other machines, seconds do not.
"""

import argparse
import importlib.metadata
import json
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import bench_batch
import bench_workbench
import numpy as np

import metrosep as ms

RIGID = ("piston", "tilt_x", "tilt_y", "shift_x", "shift_y")


def holes(z, share, rng):
    """Set a share of the pixels to NaN."""
    z[rng.random(z.shape) < share] = np.nan
    return z


def figure(n, *, share=0.0, seed=1):
    """Return a lens of 6 mm sag range with 20 nm of noise."""
    x = np.linspace(-1, 1, n)
    X, Y = np.meshgrid(x, x)
    rng = np.random.default_rng(seed)
    z = 3e-3 * (X**2 + Y**2) + 1e-6 * X**3 * Y + 20e-9 * rng.standard_normal((n, n))
    return holes(z, share, rng)


def texture(n, *, share=0.0, seed=2):
    """Return a rough surface of 20 um range."""
    rng = np.random.default_rng(seed)
    z = 5e-6 * np.sin(np.arange(n) / 150)[:, None] * np.cos(np.arange(n) / 90)[None, :]
    return holes(z + 1e-6 * rng.standard_normal((n, n)), share, rng)


def voids(z, share, rng):
    """Set round voids to NaN that cover about a share of the map."""
    n, radius = z.shape[0], z.shape[0] // 50
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    disc = x * x + y * y <= radius * radius
    for _ in range(int(share * z.size / disc.sum())):
        i, j = rng.integers(radius, n - radius - 1, 2)
        z[i - radius : i + radius + 1, j - radius : j + radius + 1][disc] = np.nan
    return z


def zernike_map(n):
    """Return a disc with astigmatism, 5 % missing."""
    x = np.linspace(-1, 1, n)
    X, Y = np.meshgrid(x, x)
    z = 1e-6 * (X**2 - Y**2) + 2e-7 * X
    z[np.hypot(X, Y) > 1] = np.nan
    return holes(z, 0.05, np.random.default_rng(3))


def conic_map(n):
    """Return a disc of a conic, shifted and tilted, 1 nm noise."""
    x = np.linspace(-10e-3, 10e-3, n)
    X, Y = np.meshgrid(x, x)
    z = ms.forms.Conic(R=50e-3, k=-1.2)(X - 1e-5, Y + 2e-5) + 1e-6 + 1e-4 * X
    z += 1e-9 * np.random.default_rng(4).standard_normal(z.shape)
    z[X**2 + Y**2 > 100e-6] = np.nan
    return z


def surface(z):
    """Return a map with steps so that it spans 20 mm, measured from its middle."""
    step = 20e-3 / (z.shape[0] - 1)
    return ms.Surface(z, step, step)


def pixels(z):
    """Return a map with pixels of 1 um."""
    return ms.Surface(z, 1e-6, 1e-6)


def ours_polynomial(obj):
    return ms.forms.fit(obj, ms.forms.Polynomial(5)).rms


def ours_zernike(obj):
    """Return the coefficient of astigmatism; coefficients only, as the peer's call gives."""
    axis, z = obj
    form = ms.forms.Zernike(terms=36, order="noll", radius=10e-3)
    return form.fit_grid(axis, axis, z).form.parameters["Z6"]


def ours_gaussian(obj):
    return float(ms.filters.gaussian(obj, nesting_index=80e-6).z[100, 200])


def ours_heights(obj):
    table = ms.parameters.areal_parameters(obj, names=("Sa", "Sq", "Ssk", "Sku", "Sz"))
    return table["Sq"].value


def ours_conic(obj):
    return ms.forms.fit(obj, ms.forms.Conic(), free=(*RIGID, "R", "k")).params["R"]


def ours_zone(obj):
    return ms.parameters.form_deviation(obj, kind="straightness", reference="MZ").value


@dataclass
class Row:
    """One line of the table."""

    title: str
    ours: object
    obj: object
    peers: dict[str, Path] = field(default_factory=dict)
    target: str = ""
    rounds: int = 3
    seconds: list = field(default_factory=list)
    peer_seconds: dict = field(default_factory=dict)
    value: float = float("nan")
    peer_values: dict = field(default_factory=dict)


class Peers:
    """The other environment, kept running."""

    def __init__(self, python):
        self.process = subprocess.Popen(
            [python, str(Path(__file__).with_name("bench_peers.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, **job):
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit("the peers' process ended; see its message above")
        return json.loads(line)


def rows(folder, *, quick):
    """Return the lines, with the data of the peers in `folder`."""
    small = 4 if quick else 1

    def stored(name, z):
        path = folder / f"{name}.npy"
        np.save(path, z)
        return path

    n = 2048 // small
    poly = figure(n, share=0.05)
    yield Row(
        f"polynomial of degree 5 off {n}^2, 5 % missing",
        ours_polynomial,
        surface(poly),
        {"prysm_polynomial": stored("poly", poly), "surfalize_polynomial": folder / "poly.npy"},
        ">= 300x",
    )
    n = 1024 // small
    zern = zernike_map(n)
    yield Row(
        f"Zernike, 36 terms, {n}^2 disc, 5 % missing",
        ours_zernike,
        (np.linspace(-10e-3, 10e-3, n), zern),
        {"prysm_zernike": stored("zern", zern)},
        ">= 500x",
        9,
    )
    n = 4096 // small
    rough = texture(n)
    rng = np.random.default_rng(6)
    for title, gaps in (
        ("5 % in round voids", voids(rough.copy(), 0.05, rng)),
        ("5 % of single pixels", holes(rough.copy(), 0.05, rng)),
    ):
        yield Row(
            f"areal Gaussian, {n}^2, nesting index 80 pixels; ours without {title}, theirs complete",
            ours_gaussian,
            pixels(gaps),
            {"surfalize_gaussian": stored("rough", rough)},
            ">= 2x",
        )
    n = 2048 // small
    flat = texture(n)
    yield Row(
        f"Sa, Sq, Ssk, Sku, Sz of {n}^2",
        ours_heights,
        pixels(flat),
        {"surfalize_heights": stored("flat", flat)},
        ">= 3x",
        7,
    )
    n = 1000 // small
    cone = conic_map(n)
    yield Row(
        f"conic with 7 freedoms, {int(np.isfinite(cone).sum())} points",
        ours_conic,
        surface(cone),
        {"lmfit_conic": stored("cone", cone)},
        ">= 10x",
    )
    n = 4000 // small
    yield Row(
        "conic with 7 freedoms, 12.6 M points" if not quick else f"conic, {n}^2 disc",
        ours_conic,
        surface(conic_map(n)),
        target="< 3 s",
    )
    count = 10**6 // small
    x = np.arange(count) * 1e-6
    z = 1e-6 * np.random.default_rng(5).standard_normal(count) + 1e-4 * x
    yield Row(
        f"minimum-zone straightness, {count} points", ours_zone, ms.Profile(x, z), target="< 0.3 s"
    )


_SECONDS = 2.0
"""Of a round of ours."""


def measure(row, peers):
    """Fill the times: ours and each peer take turns."""
    row.value = row.ours(row.obj)  # imports and caches
    started = time.perf_counter()
    row.ours(row.obj)
    short = time.perf_counter() - started
    # a peer's task runs for seconds at full clock: a short one is repeated until it does too
    repeats = max(3, min(400, int(_SECONDS / short)))
    for _ in range(row.rounds):
        for _ in range(repeats):
            started = time.perf_counter()
            row.ours(row.obj)
            row.seconds.append(time.perf_counter() - started)
        for case, path in row.peers.items():
            answer = peers.ask(case=case, data=str(path))
            row.peer_seconds.setdefault(case, []).append(answer["seconds"])
            row.peer_values[case] = answer["value"]


def slopes(*, quick):
    """Slope of log time against log points, per method."""
    sizes = (256, 512, 1024) if quick else (1024, 2048, 4096)
    jobs = {
        "polynomial of degree 5": lambda n: (ours_polynomial, surface(figure(n, share=0.05))),
        "Zernike, 36 terms": lambda n: (
            ours_zernike,
            (np.linspace(-10e-3, 10e-3, n), zernike_map(n)),
        ),
        "areal Gaussian": lambda n: (ours_gaussian, pixels(texture(n, share=0.05))),
        "Sa, Sq, Ssk, Sku, Sz": lambda n: (ours_heights, pixels(texture(n))),
        "conic, 7 freedoms": lambda n: (ours_conic, surface(conic_map(n))),
    }
    for title, make in jobs.items():
        cost = []
        for n in sizes:
            function, obj = make(n)
            function(obj)
            tries = []
            for _ in range(5):
                started = time.perf_counter()
                function(obj)
                tries.append(time.perf_counter() - started)
            cost.append(min(tries))
        slope = np.polyfit(np.log(np.square(sizes)), np.log(cost), 1)[0]
        yield title, sizes, cost, slope


def report(lines, versions, slope_lines):
    """Return the page."""
    own = ", ".join(f"{n} {importlib.metadata.version(n)}" for n in ("numpy", "scipy"))
    text = [
        "# Benchmarks",
        "",
        "Written by `make bench` (`tools/benchmarks.py`). Ours and the peers take turns in one run,",
        "one BLAS thread each, median of the rounds after a warm-up of ours. Ratios are what carries",
        "over to another machine; seconds are those of this one.",
        "",
        f"metrosep {ms.__version__} with {own}, Python {platform.python_version()}; peers: "
        + ", ".join(f"{k} {v}" for k, v in versions.items())
        + ".",
        "",
        "| task | metrosep | peer | ratio | goal | same answer |",
        "|---|---|---|---|---|---|",
    ]
    for row in lines:
        ours = statistics.median(row.seconds)
        if not row.peers:
            text.append(f"| {row.title} | {ours * 1e3:.4g} ms | | | {row.target} | |")
        for case in row.peers:
            theirs = statistics.median(row.peer_seconds[case])
            name, same = case.split("_")[0], row.peer_values[case] / row.value - 1
            text.append(
                f"| {row.title} | {ours * 1e3:.4g} ms | {name} {theirs * 1e3:.5g} ms | "
                f"{theirs / ours:.1f} | {row.target} | {same:+.1e} |"
            )
    text += [
        "",
        "*Same answer*: relative difference of one number of the result (standard deviation of the",
        "residual, coefficient of astigmatism, a filtered height, Sq, radius). The filtered heights differ",
        "because the peer cannot take the missing points and cuts the kernel at 4 standard deviations;",
        "its task is the easier one.",
        "",
        "## Cost against size",
        "",
        "Slope of log time over log points; 1 is proportional.",
        "",
        "| method | sides | ms | slope |",
        "|---|---|---|---|",
    ]
    for title, sizes, cost, slope in slope_lines:
        times = ", ".join(f"{c * 1e3:.3g}" for c in cost)
        text.append(f"| {title} | {', '.join(map(str, sizes))} | {times} | {slope:.2f} |")
    return "\n".join([*text, ""])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peers", required=True, help="interpreter with prysm, surfalize, lmfit")
    parser.add_argument("--quick", action="store_true", help="small sizes, to try the tool")
    parser.add_argument("--out", default="docs/benchmarks.md")
    arguments = parser.parse_args()
    peers = Peers(arguments.peers)
    versions = peers.ask(case="versions")
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(Path(folder), quick=arguments.quick):
            measure(row, peers)
            row.obj = None
            lines.append(row)
            print(row.title, statistics.median(row.seconds), row.peer_seconds, file=sys.stderr)
    page = report(lines, versions, list(slopes(quick=arguments.quick)))
    share = 20 if arguments.quick else 1
    batch = bench_batch.section(n=1000 // share, n_html=120 // share)
    page += "\n" + "\n".join([*batch, *bench_workbench.section(rounds=9 if share == 1 else 3)])
    Path(arguments.out).write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()

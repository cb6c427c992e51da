"""Print how often a harmful table is accepted and a true one refused, on drawn machines.

    python tools/acceptance_rates.py [--sets 1000] [--true 4000] [--made 800] [--seed 20240]
                                     [--noise tuned,slope] [--jobs 2] [--json FILE]
                                     [--travel 160] [--entries 81]

Numbers are for each kind of noise; tests/acceptance/table_rates.py says what is drawn. The exit code is
the number of figures that are missed.
"""

import argparse
import json
import multiprocessing
import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from acceptance.table_rates import (  # noqa: E402
    NOISES,
    Geometry,
    jobs,
    markdown,
    missed,
    outcomes,
    summary,
)


def chosen(text):
    """Return the kinds of noise that a comma-separated list of beginnings means."""
    words = [w.strip() for w in text.split(",") if w.strip()]
    unknown = [w for w in words if not any(n.startswith(w) for n in NOISES)]
    if unknown:
        raise SystemExit(f"no noise is called {unknown[0]!r}; there are {'; '.join(NOISES)}")
    return [n for n in NOISES if not words or n.startswith(tuple(words))]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=1000, help="corrupted tables")
    parser.add_argument("--true", type=int, default=4000, help="true tables, in 40 cells")
    parser.add_argument("--made", type=int, default=800, help="tables made of the runs")
    parser.add_argument("--seed", type=int, default=20_240)
    parser.add_argument("--noise", default="", help="comma-separated beginnings of names")
    parser.add_argument("--jobs", type=int, default=2, choices=(1, 2, 4, 8))
    parser.add_argument("--json", metavar="FILE", help="the numbers")
    parser.add_argument("--travel", type=float, default=160.0, help="mm")
    parser.add_argument("--entries", type=int, default=81)
    arguments = parser.parse_args()
    os.nice(10)
    counts = {"corrupted": arguments.sets, "true": arguments.true, "made": arguments.made}
    geometry = Geometry(1e-3 * arguments.travel, arguments.entries)
    noises = chosen(arguments.noise)
    todo = jobs(counts, noises, arguments.seed, geometry)
    found = {n: [] for n in noises}
    with multiprocessing.get_context("spawn").Pool(arguments.jobs) as pool:
        for some in pool.imap_unordered(outcomes, todo):
            found[some[0].noise] += some
    summaries = {n: summary(o) for n, o in found.items()}
    print(markdown(summaries))
    if arguments.json:
        stored = {"seed": arguments.seed, "counts": counts, "rates": summaries}
        Path(arguments.json).write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    bad = missed(summaries)
    print("\n".join(f"FAIL: {text}" for text in bad))
    return len(bad)


if __name__ == "__main__":
    sys.exit(main())

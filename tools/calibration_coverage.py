"""Print how often the truth is within 2 u of a calibration, on machines drawn anew for each seed.

    python tools/calibration_coverage.py [--seeds 200] [--first 0] [--only "R-test,circle"]

Noise is 1 um; tests/machine/calibration_rates.py says what is drawn.
"""

import argparse
import os
import sys
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from machine.calibration_rates import ROWS, Rate, calibrated, circle  # noqa: E402


def line(name, rates):
    """Return a row of the table; behind a share its standard deviation by the scatter of the machines."""
    cells, rate = [name], Rate.joined(rates)
    for kind in ("numbers", "curves"):
        share, worst, least, ratio = Rate.of(getattr(rate, kind))
        doubt = Rate.doubt([getattr(one, kind) for one in rates])
        is_none = share != share
        cells += (
            ["", "", ""]
            if is_none
            else [f"{share:.3f} +- {doubt:.3f}", f"{worst} {least:.3f}", f"{ratio:.2f}"]
        )
    bare = Rate.of(rate.bare)[0]
    return "| " + " | ".join([*cells, "" if bare != bare else f"{bare:.3f}"]) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="", help="comma-separated beginnings of rows")
    arguments = parser.parse_args()
    os.nice(10)
    chosen = tuple(w.strip() for w in arguments.only.split(",") if w.strip())
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    heads = [
        "readings",
        *("numbers", "worst", "u/error"),
        *("curves", "worst", "u/error"),
        "by noise alone",
    ]
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    if not chosen or "circle".startswith(chosen):
        rates = [Rate() for _ in seeds]
        for seed, rate in zip(seeds, rates, strict=True):
            circle(seed, rate)
        print(line("circle in motion (ISO 230-4)", rates), flush=True)
    for name in ROWS:
        if chosen and not name.startswith(chosen):
            continue
        rates, begin = [Rate() for _ in seeds], time.process_time()
        for seed, rate in zip(seeds, rates, strict=True):
            calibrated(name, seed, rate)
        print(line(name, rates), flush=True)
        print(f"{(time.process_time() - begin) / len(seeds):.2f} s each", file=sys.stderr)


if __name__ == "__main__":
    main()

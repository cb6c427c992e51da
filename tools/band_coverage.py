"""Print how far the joint estimate and its band can be trusted: simulated sets, judged by the truth.

    python tools/band_coverage.py [--rows base,turbulence] [--sets 24] [--seed 410000]
                                  [--json FILE] [--jobs 2] [--list]

One line of a Markdown table for each row (tests/acceptance/coverage/rows.py says what stands in the
shop), with the limits of the acceptance table that it misses. Row k begins with
the seed given + 1000 k. The exit code is the number of rows that fail.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from acceptance.coverage.judge import HEAD, failures, judge_row, markdown  # noqa: E402
from acceptance.coverage.rows import FIRST_SEED, ROWS  # noqa: E402


def chosen(text):
    """Return the names of rows that a comma-separated list means; a part of a name will do."""
    if not text:
        return list(ROWS)
    names = []
    for part in text.split(","):
        word = part.strip()
        found = [word] if word in ROWS else [n for n in ROWS if word and n.startswith(word)]
        if not found:
            raise SystemExit(f"no row is called {word!r}; --list shows them")
        names += [n for n in found if n not in names]
    return names


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", help="comma-separated; a name or the beginning of names")
    parser.add_argument("--sets", type=int, default=24)
    parser.add_argument("--seed", type=int, default=FIRST_SEED)
    parser.add_argument("--json", metavar="FILE", help="every number of every set")
    parser.add_argument("--jobs", type=int, default=2, choices=(1, 2))
    parser.add_argument("--list", action="store_true", help="names of the rows, and stop")
    arguments = parser.parse_args()
    if arguments.list:
        print("\n".join(ROWS))
        return 0
    os.nice(10)
    print(HEAD, end="", flush=True)
    failed, stored = 0, []
    with multiprocessing.get_context("spawn").Pool(arguments.jobs) as pool:
        for name in chosen(arguments.rows):
            result = judge_row(
                name,
                sets=arguments.sets,
                # sets of one seed share their noise: each row has seeds of its own
                seed=arguments.seed + 1000 * list(ROWS).index(name),
                clock=time.process_time,
                mapper=pool.imap,
            )
            print(markdown(result), flush=True)
            failed += bool(failures(result))
            stored.append(result.as_dict())
            if arguments.json:
                Path(arguments.json).write_text(json.dumps(stored, indent=1), encoding="utf-8")
    return failed


if __name__ == "__main__":
    sys.exit(main())

"""Print what is said of sets in which something is wrong, and how often nothing is wrong and it is said.

    python tools/run_faults.py [--sets 2] [--clean 200] [--seed 420000] [--only sign,stuck]

The exit code is the number of faults that are missed, plus one if false alarms exceed 2 %.
"""

import argparse
import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from acceptance.coverage.faults import FAULTS, false_alarms, fault_failures, fault_table  # noqa: E402
from acceptance.coverage.judge import metrosep_joint  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=2, help="of each fault")
    parser.add_argument("--clean", type=int, default=200, help="clean sets over all rows")
    parser.add_argument("--seed", type=int, default=420_000)
    parser.add_argument("--only", default="", help="comma-separated beginnings of names")
    arguments = parser.parse_args()
    os.nice(10)
    words = tuple(w.strip() for w in arguments.only.split(",") if w.strip())
    faults = [f for f in FAULTS if not words or f.name.startswith(words)]
    _, counts = fault_table(
        metrosep_joint,
        sets=arguments.sets,
        seed=arguments.seed,
        faults=faults,
        say=lambda line: print(line, flush=True),
    )
    bad = fault_failures(counts)
    if arguments.clean:
        print(flush=True)
        alarms = false_alarms(
            metrosep_joint,
            sets=arguments.clean,
            seed=arguments.seed + 10_000,
            say=lambda name, seed, text: print(f"- {name}, seed {seed}: {text[:200]}", flush=True),
        )
        print(f"false alarms: {len(alarms)} of {arguments.clean} clean sets")
        if len(alarms) > 0.02 * arguments.clean:
            bad.append(f"false alarms in {len(alarms)} of {arguments.clean} sets, allowed 2 %")
    print("\n".join(f"FAIL: {text}" for text in bad))
    return len(bad)


if __name__ == "__main__":
    sys.exit(main())

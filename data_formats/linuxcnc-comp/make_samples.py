"""Write the sample of a LinuxCNC table; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

# nominal position in mm, error in um moving + and moving -
ERRORS = [(-10, 2.0, 2.5), (0, 0.0, 0.5), (10, -3.0, -2.5), (20, 4.0, 4.5)]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    lines = [f"{p} {p + f * 1e-3:.6f} {p + r * 1e-3:.6f}\n" for p, f, r in ERRORS]
    (folder / "samples" / "x.comp").write_text("".join(lines), encoding="ascii", newline="\n")
    truth = {
        "kind": "compensation",
        "positions_mm": [p for p, _, _ in ERRORS],
        "correction_forward_um": [-f for _, f, _ in ERRORS],
        "correction_reverse_um": [-r for _, _, r in ERRORS],
    }
    text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
    (folder / "expected" / "x.comp.json").write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

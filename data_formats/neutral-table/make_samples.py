"""Write the sample of a neutral compensation table; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

POSITIONS_MM = [-10.0, 0.0, 10.0, 20.0]
FORWARD_UM = [-2.0, 0.0, 3.0, -4.0]
REVERSE_UM = [-2.5, -0.5, 2.5, -4.5]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    rows = zip(POSITIONS_MM, FORWARD_UM, REVERSE_UM, strict=True)
    text = "position_mm,correction_forward_um,correction_reverse_um\n"
    text += "".join(f"{p!r},{f!r},{r!r}\n" for p, f, r in rows)
    (folder / "samples" / "x-axis.csv").write_text(text, encoding="ascii", newline="\n")
    truth = {
        "kind": "compensation",
        "positions_mm": POSITIONS_MM,
        "correction_forward_um": FORWARD_UM,
        "correction_reverse_um": REVERSE_UM,
    }
    text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
    (folder / "expected" / "x-axis.csv.json").write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

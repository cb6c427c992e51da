"""Write the samples of Dektak text exports; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

HEAD = """Scan Parameters
Scan Type,Standard Scan
Stylus,Radius: 2.5 \u00b5m
Length,0.8 um

Analytical Results
Function,R.Cur Pos,R.Cur Width,M.Cur Pos,M.Cur Width,Result
Ra,0.0 um,0.0 um,0.8 um,0.0 um,0.00525 um

Scan Data
Lateral um,Raw Micrometer,
"""
ROWS = [(0.0, -0.00933), (0.2, 0.0076), (0.3, 0.5), (0.5, -0.25), (0.6, 1.0)]


def text(rows):
    return HEAD + "".join(f"{x:.1f},{z:.5f},,\n" for x, z in rows)


def main(folder):
    cases = {
        "scan.csv": (
            text(ROWS),
            {
                "kind": "profile",
                "shape": [5],
                "x_m": [x * 1e-6 for x, _ in ROWS],
                "z_m": [z * 1e-6 for _, z in ROWS],
            },
        ),
        "damaged-field.csv": (
            text(ROWS).replace("0.50000", "0.5OO00"),
            {"error": "CorruptFileError", "match": "line 14"},
        ),
    }
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (content, truth) in cases.items():
        (folder / "samples" / name).write_bytes(content.encode("latin-1"))
        encoded = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(encoded, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

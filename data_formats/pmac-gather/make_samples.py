"""Write the sample of PMAC gather text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

ROWS = [(1000, -3, 0.5), (1250, 7, -1.5), (1600, -20, 2.25)]
NAMES = ["actual", "error", "dac"]
COUNT = 0.5e-9  # m


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    text = "".join(" ".join(str(v) for v in row) + "\r\n" for row in ROWS)
    truth = {
        "kind": "recording",
        "t_s": [0.0, 0.002, 0.004],
        "channels": {
            "actual": [row[0] * COUNT for row in ROWS],
            "error": [row[1] * COUNT for row in ROWS],
            "dac": [row[2] for row in ROWS],
        },
        "options": {
            "format": "pmac-gather",
            "servo_period": "0.5 ms",
            "gather_period": 4,
            "names": NAMES,
            "scale": {"actual": "0.5 nm", "error": "0.5 nm"},
        },
    }
    (folder / "samples" / "counts.txt").write_bytes(text.encode())
    record = json.dumps(truth, indent=1, sort_keys=True) + "\n"
    (folder / "expected" / "counts.txt.json").write_text(record, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

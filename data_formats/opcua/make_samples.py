"""Write the samples of logs of an OPC UA historian as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

ROWS = [("2026-03-05T14:07:09.120Z", "X", "1.5", "Good"), ("2026-03-05T14:07:09.370Z", "X", "-2.25", "Good"),
        ("2026-03-05T14:07:10.120Z", "Z", "0.125", "Good"), ("2026-03-05T14:07:10.120Z", "X", "99", "BadNoCommunication"),
        ("2026-03-05T14:07:11.120Z", "X", "40", "Good")]  # fmt: skip


def table(rows, names="Timestamp,Tag,Value,Quality", separator=","):
    return names.replace(",", separator) + "\n" + "".join(separator.join(r) + "\n" for r in rows)


TRUTH = {"kind": "recording", "t_s": [0.0, 0.25, 1.0, 2.0], "warnings_match": "1 values are not good",
         "channels": {"X": [1.5, -2.25, None, 40.0], "Z": [None, None, 0.125, None]}}  # fmt: skip
COMMA = [(t, n, v.replace(".", ","), q) for t, n, v, q in ROWS]
ONE = [(t, v, "192" if q == "Good" else "0x80310000") for t, n, v, q in ROWS if n == "X"]
CASES = {
    "items.csv": (table(ROWS), TRUTH),
    "semicolons.csv": (table(COMMA, separator=";"), TRUTH),
    "one-item.csv": (table(ONE, "SourceTimestamp,Value,StatusCode"),
                     {"kind": "recording", "t_s": [0.0, 0.25, 1.0, 2.0], "channels": {"value": [1.5, -2.25, None, 40.0]}}),
    "field-lost.csv": (table(ROWS).replace(",40,", ","), {"error": "CorruptFileError", "match": "line 6"}),
    "two-zones.csv": (table(ROWS).replace("10.120Z,Z", "10.120+01:00,Z"), {"error": "CorruptFileError", "match": "zones"}),
}  # fmt: skip


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data.encode("utf-8"))
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

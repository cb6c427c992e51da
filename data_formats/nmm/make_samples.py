"""Write the samples of NMM scans as text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
A whole scan is three files, so it stands in ``pairs/``; ``samples/`` holds those that are refused.
"""

import json
import sys
from pathlib import Path

RULE = "-" * 42
SYMBOLS = ("Lx", "-Lz+Az", "XY vector")
LINES = [
    [(0.0, 5e-9, 0.0), (0.5, 7e-9, 1e-7), (1.0, -3e-9, 2.5e-7)],
    [(0.0, 1e-9, 0.0), (0.5, -4e-9, 1.25e-7)],
]
POSITIONS = [
    (0.0125, 0.011, 0.003, 21.5, 21.25, 21.0, 99240.0, 47.5, 23.0),
    (0.0126, 0.010, 0.003, 21.5, 21.25, 21.125, 99250.0, 47.5, 23.0),
]
TIMES = ["31-Dec-2024 23:59:50", "01-Jan-2025 00:00:26"]


def description(*, symbols=SYMBOLS, counts=(3, 2)):
    """Return the text of a description."""
    text = [RULE, "Scan procedure description file", "Creation time     :31-Dec-2024 23:59:30"]
    text += [
        RULE,
        "3. Scan field",
        "",
        "   Number of lines  : 2",
        "   Scan speed  : 10. [um/s]",
        RULE,
    ]
    for time, count in zip(TIMES, counts, strict=True):
        text.append(RULE)
        text += [f"{i} : {time} : {s} : {count} : {s} title" for i, s in enumerate(symbols)]
        text.append(RULE)
    return "\n".join(text) + "\n"


def table(rows):
    """Return rows as the machine writes them, with four digits of exponent."""
    lines = []
    for row in rows:
        parts = [f"{v:.14E}".split("E") for v in row]
        lines.append("".join(f"  {m}E{e[0]}{int(e[1:]):04d}" for m, e in parts))
    return "\n".join(lines) + "\n"


def profile(line, **options):
    x, z = [row[2] for row in line], [row[1] for row in line]
    return {"kind": "profile", "shape": [len(x)], "x_m": x, "z_m": z, "options": options}


WHOLE = description()
DATA = table([row for line in LINES for row in line])
ENVIRONMENT = {
    "kind": "recording",
    "options": {"channel": "positions"},
    "t_s": [0.0, 36.0],
    "channels": {
        "X": [0.0125, 0.0126],
        "air temperature z": [21.0, 21.125],
        "air pressure": [99240.0, 99250.0],
        "sample temperature": [23.0, 23.0],
    },
}
PAIRS = {
    "line-1": (WHOLE, DATA, profile(LINES[0], channel="line 1")),
    "line-2": (WHOLE, DATA, profile(LINES[1], channel="line 2")),
    "positions": (WHOLE, DATA, ENVIRONMENT),
    "interrupted": (
        WHOLE,
        table(LINES[0]),
        {"error": "CorruptFileError", "match": "field rows, expected 5, found 3",
         "options": {"channel": "line 1"}},
    ),
}  # fmt: skip
ALONE = {
    "two-lines.dsc": (WHOLE, "FormatMismatchError", "channel='positions' for their positions"),
    "no-columns.dsc": (WHOLE.split("0 :", maxsplit=1)[0], "CorruptFileError", "lists no columns"),
    "contradiction.dsc": (
        WHOLE.replace("XY vector : 2", "XY vector : 3"),
        "CorruptFileError",
        "contradict each other, line 16",
    ),
    "month.dsc": (WHOLE.replace("01-Jan", "01-Jen"), "CorruptFileError", "'01-Jen-2025 00:00:26'"),
}


def main(folder):
    for part in ("samples", "expected", "pairs"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (text, error, match) in ALONE.items():
        (folder / "samples" / name).write_bytes(text.encode())
        truth = json.dumps({"error": error, "match": match}, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")
    for name, (text, rows, truth) in PAIRS.items():
        (folder / "pairs" / f"{name}.dsc").write_bytes(text.encode())
        (folder / "pairs" / f"{name}.dat").write_bytes(rows.encode())
        (folder / "pairs" / f"{name}.pos").write_bytes(table(POSITIONS).encode())
        (folder / "pairs" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

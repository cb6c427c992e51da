"""Write the samples of ISO 230-2 lists as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

TARGETS = [15.0, 25.0, 35.5]
FORWARD = [[15.25, 15.5], [24.75, 25.125], [35.0, 36.5]]  # rows: positions, columns: cycles
BACKWARD = [[15.75, 16.0], [25.5, 26.0], [34.5, 35.625]]


def listing(*, unit="mm", cycles="2", positions="3"):
    """Return the text of a file, in the order in which a test runs."""
    out = [
        "# Input data file for ISO230-2 calcs",
        "#     TGT_DATA[<pos_id>] : target position",
        "REF_PV=TEST:PosAct",
        *([f"UNIT={unit}"] if unit else []),
        f"CYCLES={cycles}",
        f"POSITIONS={positions}",
        "DEC=5",
    ]
    for j in range(2):
        for i, target in enumerate(TARGETS):
            if j == 0:
                out.append(f"TGT_DATA[{i + 1}]={target!r}")
            out.append(f"REF_DATA_FWD[{i + 1},{j + 1}]={FORWARD[i][j]!r}")
        out += [f"REF_DATA_BWD[{i + 1},{j + 1}]={BACKWARD[i][j]!r}" for i in (2, 1, 0)]
    return "\n".join(out) + "\n  \n"


def run(values, j, factor):
    deviation = [(values[i][j] - t) * factor for i, t in enumerate(TARGETS)]
    return {"shape": [3], "x_m": [t * factor for t in TARGETS], "z_m": deviation}


CASES = {
    "backward.dat": (listing(), run(BACKWARD, 1, 1e-3), {"channel": "backward 2"}),
    "inches.dat": (
        listing(unit=""),
        run(FORWARD, 0, 0.0254),
        {"channel": "forward 1", "unit": "in"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    files = {name: text for name, (text, _, _) in CASES.items()}
    truths = {
        name: {"kind": "profile", **truth, "options": options}
        for name, (_, truth, options) in CASES.items()
    }
    whole = listing()
    for name, text, error, match in (
        ("no-run-chosen.dat", whole, "FormatMismatchError", "forward 1, forward 2, backward 1"),
        ("cut-off.dat", whole[: whole.rindex("REF_DATA_BWD")], "CorruptFileError", "is missing"),
        ("count.dat", listing(positions="4"), "CorruptFileError", "POSITIONS"),
    ):
        files[name] = text
        truths[name] = {"error": error, "match": match}
    for name, text in files.items():
        (folder / "samples" / name).write_bytes(text.encode())
        truth = json.dumps(truths[name], indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

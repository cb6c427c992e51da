"""Write the samples of PI GCS arrays as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

TARGET = [0.0, 0.5, 1.0, -0.25]
ACTUAL = [0.125, 0.375, 1.25, -0.5]


def array(*, code=32, mark=" ", sample_time="0.000050", tail=" ", n=4):
    """Return the text of a file; lines of an answer end with a blank."""
    out = [
        "# REM E-712",
        "# REM data recorder",
        "#",
        "# VERSION = 1",
        "# TYPE = 1",
        f"# SEPARATOR = {code}",
        "# DIM = 2",
        *([f"# SAMPLE_TIME = {sample_time}"] if sample_time else []),
        f"# NDATA = {n}",
        "#",
        "# NAME0 = Target Position of AXIS:1",
        "# NAME1 = Actual Position of AXIS:1",
        "#",
        "# END_HEADER",
    ]
    out += [f"{a!r}{mark}{b!r}" for a, b in zip(TARGET, ACTUAL, strict=True)]
    return "".join(f"{line}{tail}\n" for line in out)


def truth(step, factor):
    return {
        "t_s": [k * step for k in range(4)],
        "channels": {
            "Target Position of AXIS:1": [v * factor for v in TARGET],
            "Actual Position of AXIS:1": [v * factor for v in ACTUAL],
        },
    }


CASES = {
    "blank.dat": (array(), truth(5e-5, 1e-6), {"unit": "um"}),
    "tab.dat": (array(code=9, mark="\t", tail=""), truth(5e-5, 1.0), {}),
    "no-interval.dat": (array(sample_time=""), truth(1e-3, 1.0), {"sampling_rate": "1 kHz"}),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    files = {name: text for name, (text, _, _) in CASES.items()}
    truths = {
        name: {"kind": "recording", **values, "options": options}
        for name, (_, values, options) in CASES.items()
    }
    whole = array()
    for name, text, match in (
        ("cut-off.dat", whole[: whole.rindex("-0.25")], "count of rows is wrong"),
        ("half-row.dat", whole[: whole.rindex(" -0.5")] + "\n", "expected 2 numbers"),
        ("word.dat", whole.replace("0.375", "0.3z5"), "Actual Position of AXIS:1 is not a number"),
    ):
        files[name] = text
        truths[name] = {"error": "CorruptFileError", "match": match}
    for name, text in files.items():
        (folder / "samples" / name).write_bytes(text.encode())
        content = json.dumps(truths[name], indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(content, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

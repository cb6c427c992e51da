"""Write the samples of camonitor text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

INTERLEAVED = """\
stage:x                        2024-03-01 23:59:59.750000 1.5
stage:y                        2024-03-01 23:59:59.875000 -2.25
stage:x                        2024-03-02 00:00:00.250000 1.75
stage:y                        2024-03-02 00:00:00.250000 -2.5 HIHI MAJOR
stage:x                        2024-03-02 00:00:01.000000 1.25
"""
ODD = """\
gone                           *** Not connected (PV not found)
probe.VAL                      2024-03-01 10:00:00.000000 3.5
mode                           2024-03-01 10:00:00.000001 Closed Loop
probe.VAL                      2024-03-01 10:00:00.500000 4.5 UDF INVALID
probe.VAL                      2024-03-01 10:00:02.500000 -5.5e-1 LOW MINOR
old                            <undefined> 0 UDF INVALID
"""
CASES = {
    "interleaved.txt": (
        INTERLEAVED,
        {
            "t_s": [0.0, 0.125, 0.5, 1.25],
            "channels": {"stage:x": [1.5, None, 1.75, 1.25], "stage:y": [None, -2.25, -2.5, None]},
        },
    ),
    "odd-lines.txt": (
        ODD,
        {
            "t_s": [0.0, 0.5, 2.5],
            "channels": {"probe.VAL": [3.5e-6, None, -5.5e-7]},
            "options": {"unit": "um"},
            "warnings_match": "mode holds arrays or text",
        },
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    files = {name: text for name, (text, _) in CASES.items()}
    truths = {name: {"kind": "recording", **truth} for name, (_, truth) in CASES.items()}
    for name, text, match in (
        ("cut-off.txt", INTERLEAVED[: INTERLEAVED.rindex("00:00:01") + 6], "none of camonitor"),
        ("clock-set-back.txt", INTERLEAVED.replace("00:00:01.0", "00:00:00.0"), "goes back"),
        ("word.txt", INTERLEAVED.replace(" 1.75", " 1.7S"), "stage:x is not a number"),
    ):
        files[name] = text
        truths[name] = {"error": "CorruptFileError", "match": match}
    for name, text in files.items():
        (folder / "samples" / name).write_bytes(text.encode())
        truth = json.dumps(truths[name], indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

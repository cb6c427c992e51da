"""Write the samples of TwinCAT Scope exports as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

START = 132959733843760000  # ticks of 100 ns, odd in float64
ABOUT = [
    ("Name", "scope_1"),
    ("File", "scope_1.csv"),
    ("Starttime of export", str(START), "Montag, 2. Mai 2022", "15:56:24.376"),
]
KEYS = ("Name", "SymbolComment", "Data-Type", "SampleTime[ms]", "Offset", "ScaleFactor", "Unit")


def export(groups, rows, *, end, separator=";", eof=False, sample_time_key="SampleTime[ms]"):
    """Return the text of a file; groups are lists of (name, step in ms, offset, factor, unit)."""
    about = [*ABOUT, ("Endtime of export", str(end), "Montag, 2. Mai 2022", "15:56:24.380")]
    out = [separator.join(fields) for fields in about] + ["", ""]
    for key in KEYS:
        cells = []
        for group in groups:
            cells.append(sample_time_key if key == "SampleTime[ms]" else key)
            for name, step, offset, factor, unit in group:
                cells.append(
                    {
                        "Name": name,
                        "SymbolComment": "",
                        "Data-Type": "REAL64",
                        "SampleTime[ms]": step,
                        "Offset": offset,
                        "ScaleFactor": factor,
                        "Unit": unit,
                    }[key]
                )
        out.append(separator.join(cells))
    out.append("")
    out += [separator.join(row) for row in rows]
    return "\r\n".join([*out, "EOF"] if eof else out) + "\r\n"


POSITION = ("Axis 1.ActPos", "1", "0", "1", "mm (Length)")
ANGLE = ("Axis C", "1", "0", "1", "° (Angle)")
PLAIN = ("Name", "1", "0", "1", "(None)")
SCALED = ("probe", "5", "1", "-1", "V (Voltage)")
DEG = 0.017453292519943295

TICKS = [
    (str(START + 7), "1.5", "359.5", "4"),
    (str(START + 10007), "1.25", "0.25", ""),
    (str(START + 20007), "-1.75", "1.5", "6"),
]
COMMA = [
    ("0", "10,5", "-2", "0,5"),
    ("0,2", "-11,5", "3", "-1,25"),
    ("0,4", "12,5"),
    ("0,6", "-13,5"),
]
CASES = {
    "filetime.csv": (
        export([[POSITION, ANGLE, PLAIN]], TICKS, end=START + 20007, eof=True),
        {
            "t_s": [0.0, 1e-3, 2e-3],
            "channels": {
                "Axis 1.ActPos": [1.5e-3, 1.25e-3, -1.75e-3],
                "Axis C": [359.5 * DEG, 0.25 * DEG, 1.5 * DEG],
                "Name": [4.0, None, 6.0],
            },
        },
    ),
    "comma-slow-group.csv": (
        export([[POSITION], [SCALED]], COMMA, end=START + 6000, separator="\t"),
        {
            "t_s": [-2e-3, 3e-3],
            "channels": {"probe": [0.5, -1.25]},
            "options": {"channel": "probe"},
            "warnings_match": "factor or an offset for probe",
        },
    ),
    "round-brackets.csv": (
        export(
            [[PLAIN]],
            [("0", "1"), ("1", "3")],
            end=START + 90000,
            sample_time_key="SampleTime (ms)",
        ),
        {
            "t_s": [0.0, 1e-3],
            "channels": {"Name": [1.0, 3.0]},
            "warnings_match": "may be cut off",
        },
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    whole = CASES["filetime.csv"][0]
    files = {name: text for name, (text, _) in CASES.items()}
    truths = {name: {"kind": "recording", **truth} for name, (_, truth) in CASES.items()}
    for name, text, match in (
        ("cut-off.csv", whole[: whole.rindex(";1.5;")], "does not end with a group"),
        ("no-rows.csv", whole[: whole.index(TICKS[0][0])], "no row of numbers"),
        ("word.csv", whole.replace("359.5", "35g.5"), "Axis C is not a number"),
    ):
        files[name] = text
        truths[name] = {"error": "CorruptFileError", "match": match}
    for name, text in files.items():
        (folder / "samples" / name).write_bytes(text.encode())
        truth = json.dumps(truths[name], indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of LabVIEW measurement files as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

END = "***End_of_Header***"
F = [0.25, -0.5, 1.75]  # m/s^2
G = [1000.5, 2.0, -3.25]  # mV in the file


def lvm(segments, *, separator="\t", decimal=".", x_columns="No"):
    """Return the text of a file; a segment is (names, units, x0, dx, rows)."""

    def number(v):
        return "" if v is None else repr(v).replace(".", decimal)

    def line(*fields):
        return separator.join(fields)

    out = [
        line("LabVIEW Measurement", ""),
        line("Writer_Version", "2"),
        line("Separator", "Comma" if separator == "," else "Tab"),
        line("Decimal_Separator", decimal),
        line("Multi_Headings", "Yes"),
        line("X_Columns", x_columns),
        line("Time", "09:51:39,1970510124996275989") if separator == "\t" else line("Time", "9"),
        line(END, ""),
    ]
    gap = ["", ""] if x_columns == "Multi" else [""]

    def spread(values):
        cells = []
        for v in values:
            cells += [v, *gap[1:]]
        return cells

    for names, units, x0, dx, rows in segments:
        n = len(units)
        out += [
            "",
            line("Channels", str(n), *[""] * n),
            line("Samples", *spread(["3"] * n)),
            line("Y_Unit_Label", *spread(units)),
            line("X_Dimension", *spread(["Time"] * n)),
            line("X0", *spread([number(x0)] * n)),
            line("Delta_X", *spread([number(dx)] * n)),
            line(END, *[""] * n),
            line(*names),
        ]
        out += [line(*(c if isinstance(c, str) else number(c) for c in row)) for row in rows]
    return "\n".join(out) + "\n"


ONE = ["X_Value", "probe", "sensor", "Comment"]
TWO = ["X_Value", "probe", "X_Value", "sensor", "Comment"]
UNITS = ["m/s^2", "mV"]
NO_X = [("", f, g) for f, g in zip(F, G, strict=True)]
SECOND = [("", 9.5, 8.5), ("", 7.5, 6.5)]
CASES = {
    "comma.lvm": (
        lvm([(ONE, UNITS, 0.5, 0.25, NO_X)], decimal=","),
        ([0.5, 0.75, 1.0], {"probe": F, "sensor": [1.0005, 2e-3, -3.25e-3]}, {}),
    ),
    "comma-separated.lvm": (
        lvm([(ONE, UNITS, 0.5, 0.25, NO_X)], separator=","),
        ([0.5, 0.75, 1.0], {"probe": F, "sensor": [1.0005, 2e-3, -3.25e-3]}, {}),
    ),
    "one-x-gap.lvm": (
        lvm(
            [
                (
                    ONE,
                    ["m/s^2", "Newtons"],
                    0.0,
                    1.0,
                    [(0.0, 1.5, None, "start"), (0.3, 2.5, 6.5), (1.2, -3.5, 7.5)],
                )
            ],
            x_columns="One",
        ),
        ([0.0, 0.3, 1.2], {"probe": [1.5, 2.5, -3.5], "sensor": [None, 6.5, 7.5]}, {}),
    ),
    "ragged-multi.lvm": (
        lvm(
            [
                (
                    TWO,
                    UNITS,
                    0.0,
                    0.5,
                    [(0.0, 1.5, 0.0, 100.0), (0.5, 2.5, 0.5, 200.0), (1.0, 3.5, None, None)],
                )
            ],
            x_columns="Multi",
        ),
        ([0.0, 0.5, 1.0], {"probe": [1.5, 2.5, 3.5], "sensor": [0.1, 0.2, None]}, {}),
    ),
    "two-segments.lvm": (
        lvm([(ONE, UNITS, 0.5, 0.25, NO_X), (ONE, UNITS, 3.0, 0.5, SECOND)]),
        ([3.0, 3.5], {"probe": [9.5, 7.5], "sensor": [8.5e-3, 6.5e-3]}, {"segment": 1}),
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    truths = {}
    whole = CASES["comma.lvm"][0]
    files = {name: text for name, (text, _) in CASES.items()}
    for name, (_, (t, channels, options)) in CASES.items():
        truths[name] = {"kind": "recording", "t_s": t, "channels": channels, "options": options}
    for name, text, match in (
        ("cut-off.lvm", whole[: whole.rindex("\t")], "middle of a row"),
        ("no-end.lvm", whole.split(END)[0], "header has no end"),
    ):
        files[name] = text
        truths[name] = {"error": "CorruptFileError", "match": match}
    for name, text in files.items():
        (folder / "samples" / name).write_bytes(text.encode())
        truth = json.dumps(truths[name], indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

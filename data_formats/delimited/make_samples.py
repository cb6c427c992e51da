"""Write the samples of column text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

X_MM = [0.0, 0.5, 1.0, 1.75]
Z_UM = [0.25, -1.5, None, 3.0]


def number(value, decimal="."):
    return "" if value is None else repr(value).replace(".", decimal)


def rows(separator, decimal=".", *, end="", descending=False, missing=""):
    pairs = list(zip(X_MM, Z_UM, strict=True))
    if descending:
        pairs.reverse()
    lines = [
        f"{number(x, decimal)}{separator}{number(z, decimal) or missing}{end}" for x, z in pairs
    ]
    return "\n".join(lines) + "\n"


def profile(**options):
    truth = {
        "kind": "profile",
        "shape": [4],
        "x_m": [x * 1e-3 for x in X_MM],
        "z_m": [None if z is None else z * 1e-6 for z in Z_UM],
    }
    return {**truth, "options": options} if options else truth


MICRO = "\u00b5"
TEXTS = {
    "comma.csv": ("x_mm,z_um\n" + rows(","), profile()),
    "semicolon-decimal-comma.csv": ("x [mm];z [um]\n" + rows(";", ","), profile()),
    "tab-decimal-comma.tsv": ("x (mm)\tz (um)\n" + rows("\t", ","), profile()),
    "spaces.txt": ("# x_mm z_um\n" + rows("   ", missing="nan"), profile()),
    "comments.txt": (
        "% logger 7\n; channel one\n# tuned\nx_mm,z_um\n" + rows(",") + "# end\n",
        profile(),
    ),
    "unit-row.csv": ("position;gap\n[mm];[um]\n" + rows(";", ","), profile()),
    "trailing-separator.csv": ("x_mm;z_um;\n" + rows(";", end=";"), profile()),
    "descending.csv": ("x_mm,z_um\n" + rows(",", descending=True), profile()),
    "units-and-count.dat": (
        "mm\n4\n" + rows(","),
        {**profile(), "z_m": [None if z is None else z * 1e-3 for z in Z_UM]},
    ),
    "no-header.txt": (rows("\t", missing="--"), profile(unit=["mm", "um"])),
    "windows-bom.csv": ("\ufeff" + ("x_mm,z_um\n" + rows(",")).replace("\n", "\r\n"), profile()),
    "quoted-decimal-comma.csv": (
        '"x_mm","z_um"\n'
        + "".join(
            f'"{number(x, ",")}","{number(z, ",")}"\n' for x, z in zip(X_MM, Z_UM, strict=True)
        ),
        profile(),
    ),
    "recording.csv": (
        "t_ms,probe_V,run\n0,1.5,3\n0.5,-2.5,3\n1,,4\n",
        {
            "kind": "recording",
            "shape": [3, 2],
            "t_s": [0.0, 0.5e-3, 1e-3],
            "channels": {"probe_V": [1.5, -2.5, None], "run": [3.0, 3.0, 4.0]},
        },
    ),
    "points.xyz": (
        "x_mm y_mm z_um\n2 0 3\n0 0 1\n1 0 2\n0 0.5 4\n2 0.5 6\n",
        {
            "kind": "surface",
            "shape": [2, 3],
            "dx_m": 1e-3,
            "dy_m": 0.5e-3,
            "z_m": [[1e-6, 2e-6, 3e-6], [4e-6, None, 6e-6]],
        },
    ),
    "stacked.csv": (
        "x_mm,z_um,slice\n0,1,left\n1,2,left\n0,5,right\n1,6,right\n",
        {
            "kind": "profile",
            "shape": [2],
            "x_m": [0.0, 1e-3],
            "z_m": [5e-6, 6e-6],
            "options": {"channel": "right"},
        },
    ),
    "ambiguous.txt": ("0,123\n1,456\n", {"error": "AmbiguousFormatError", "match": "separator="}),
    "thousands.csv": (
        "1.234,5;2.345,6\n2.234,5;3.345,6\n",
        {"error": "AmbiguousFormatError", "match": "thousands"},
    ),
    "no-unit.csv": ("x_mm,gap\n0,1\n1,2\n", {"error": "UnitError", "match": "'gap'"}),
    "cut-off.csv": (
        "run,x_mm,z_um\n0,1,2\n0,2,3\n0,3",
        {"error": "CorruptFileError", "match": "middle of a row"},
    ),
    "word-in-number.csv": (
        "x_mm,z_um\n" + "".join(f"{i},{i}\n" for i in range(6)) + "6,oops\n7,7\n8,8\n",
        {"error": "CorruptFileError", "match": "oops"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    files = {name: (text.encode(), truth) for name, (text, truth) in TEXTS.items()}
    named = f"x / mm;H\u00f6he in {MICRO}m\n" + rows(";", ",")
    files["latin1-micro.csv"] = (named.encode("latin-1"), profile())
    files["utf16-micro.csv"] = (("\ufeff" + named).encode("utf-16-le"), profile())
    for name, (data, truth) in files.items():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of Gwyddion ASCII exports as text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

ROWS = [["90", "1.5", "2"], ["-3", "nan", "0.25"]]
ENGLISH = ("Channel", "Width", "Height", "Value units")
GERMAN = ("Kanal", "Breite", "Höhe", "Werteinheiten")


def export(rows, *, words=ENGLISH, width="6 µm", height="1000 nm", unit="nm", separator="\t"):
    """Return a file with the given rows, the top one first."""
    values = ("made up", width, height, unit)
    head = [f"# {w}: {v}".rstrip() for w, v in zip(words, values, strict=True)]
    return "\n".join([*head, *(separator.join(row) for row in rows)]) + "\n"


def surface(factor=1e-9, dx=2e-6, dy=0.5e-6, **more):
    """Return what a reader must give: the lowest row first."""
    z = [[None if v == "nan" else float(v) * factor for v in row] for row in reversed(ROWS)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": dx, "dy_m": dy, "z_m": z, **more}


COMMAS = [[v.replace(".", ",") for v in row] for row in ROWS]
RAGGED = [ROWS[0], ROWS[1][:2]]
CASES = {
    "english.txt": (export(ROWS), surface()),
    "german-comma.txt": (
        export(COMMAS, words=GERMAN, width="6,0 µm", separator=" "),
        surface(),
    ),
    "latin-1.txt": (export(ROWS).encode("latin-1"), surface()),
    "no-unit.txt": (export(ROWS, unit=""), surface(1e-6, options={"unit": "um"})),
    "no-unit-refused.txt": (
        export(ROWS, unit=""),
        {"error": "UnitError", "match": "states no unit of the values"},
    ),
    "volts.txt": (export(ROWS, unit="V"), {"error": "UnitError", "match": "'V'"}),
    "pixels.txt": (
        export(ROWS, width="3 px", height="2 px"),
        surface(dx=None, dy=None, warnings_match="taken as not calibrated"),
    ),
    "ragged.txt": (
        export(RAGGED),
        {"error": "CorruptFileError", "match": "line 6, expected 3 numbers, found 2"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (text, truth) in CASES.items():
        data = text if isinstance(text, bytes) else text.encode()
        (folder / "samples" / name).write_bytes(data)
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

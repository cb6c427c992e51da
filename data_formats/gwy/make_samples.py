"""Write the samples of Gwyddion files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[90e-9, 1e-9, 2e-9], [-3e-9, float("nan"), 0.25e-9]]


def text(value):
    return value.encode() + b"\0"


def component(name, code, value):
    """Return a component with its value packed."""
    if code in "bid":
        packed = struct.pack("<" + {"b": "?"}.get(code, code), value)
    elif code == "s":
        packed = text(value)
    elif code == "D":
        packed = struct.pack(f"<I{len(value)}d", len(value), *value)
    elif code == "S":
        packed = struct.pack("<I", len(value)) + b"".join(map(text, value))
    else:
        packed = value
    return text(name) + code.encode() + packed


def thing(name, *components):
    """Return an object."""
    body = b"".join(component(*c) for c in components)
    return text(name) + struct.pack("<I", len(body)) + body


def field(rows, *, xy="m", z="m", xreal=6e-6, yreal=1e-6, xres=None):
    """Return a data field, the top row first."""
    units = [(f"si_unit_{axis}", "o", thing("GwySIUnit", ("unitstr", "s", unit)))
             for axis, unit in (("xy", xy), ("z", z))]  # fmt: skip
    return thing(
        "GwyDataField",
        ("xres", "i", len(rows[0]) if xres is None else xres),
        ("yres", "i", len(rows)),
        ("xreal", "d", xreal),
        ("yreal", "d", yreal),
        ("xoff", "d", 1e-6),
        *units,
        ("data", "D", [v for row in rows for v in row]),
    )


def container(*components):
    return b"GWYP" + thing("GwyContainer", *components)


def plain(**options):
    return container(("/0/data", "o", field(ROWS, **options)), ("/0/data/title", "s", "Height"))


def surface(rows=ROWS, dx=2e-6, dy=0.5e-6, factor=1.0, **more):
    """Return what a reader must give: the lowest row first."""
    z = [[None if v != v else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": dx, "dy_m": dy, "z_m": z, **more}


MASK = [[0.0, 1.0, 1.0], [0.0, 0.0, 0.0]]
OTHER = [[v * -2 for v in row] for row in ROWS]
TWO = container(
    ("/10/data", "o", field(OTHER)),
    ("/10/data/title", "s", "Other"),
    ("/2/data", "o", field(ROWS)),
    ("/2/mask", "o", field(MASK, z="")),
    ("/2/data/visible", "b", True),
    ("/2/data/log", "o", thing("GwyStringList", ("strings", "S", ["one", "two"]))),
)
NESTED = thing("GwyContainer")
for _ in range(40):
    NESTED = thing("GwyContainer", ("deeper", "o", NESTED))
ALONE = {"xy": "", "z": ""}
CASES = {
    "plain.gwy": (plain(), surface()),
    "first-of-two.gwy": (TWO, surface()),
    "other-of-two.gwy": (TWO, surface(OTHER, options={"channel": "Other"})),
    "no-units.gwy": (plain(**ALONE, xreal=6.0, yreal=1.0),
                     surface(dx=2e-3, dy=0.5e-3, factor=1e-3, options={"unit": "mm"})),
    "no-steps.gwy": (plain(xreal=0.0, yreal=0.0), surface(dx=None, dy=None)),
    "no-unit-of-heights.gwy": (plain(z=""), surface(warnings_match="metres were taken")),
    "volts.gwy": (plain(z="V"), {"error": "UnitError", "match": "the unit of z is 'V'"}),
    "cut-off.gwy": (plain()[:-9], {"error": "CorruptFileError", "match": "size of GwyContainer"}),
    "wrong-size.gwy": (plain(xres=4), {"error": "CorruptFileError", "match": "expected 8 of type D"}),
    "nested.gwy": (b"GWYP" + NESTED, {"error": "CorruptFileError", "match": "nested too deep"}),
    "empty.gwy": (container(), {"error": "UnsupportedFeatureError", "match": "no data field"}),
}  # fmt: skip


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data)
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of surface data files with struct and text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

CODES = {0: "B", 1: "H", 2: "I", 3: "f", 4: "b", 5: "h", 6: "i", 7: "d"}
BAD = {1: 65535, 2: 4294967295, 3: float("nan"), 5: -32768, 6: -2147483648, 7: float("nan")}
DATES = "030120261200"

# first profile first (smallest y), no symmetry; None = not measured
ROWS = [
    [90, 10, 20, None],
    [1, 2, 3, 4],
    [5, 6, 7, 100],
]
FLAT = [v for row in ROWS for v in row]


def text(heights, *, version="aISO-1.0", size=(4, 3), scales=(1e-6, 2e-6, 1e-9), end="\n", **more):
    fields = {
        "ManufacID": "none",
        "CreateDate": DATES,
        "ModDate": DATES,
        "NumPoints": size[0],
        "NumProfiles": size[1],
        "Xscale": scales[0],
        "Yscale": scales[1],
        "Zscale": scales[2],
        "Zresolution": 1e-10,
        "Compression": 0,
        "DataType": 7,
        "CheckType": 0,
        **more,
    }
    lines = [version, *(f"{k} = {v}" for k, v in fields.items()), "*"]
    lines += [" ".join("BAD" if v is None else str(v) for v in heights), "*"]
    lines += ["<OperatorName> nobody </OperatorName>", "*"]
    return (end.join(lines) + end).encode("ascii")


def binary(
    kind, *, version=b"bISO-1.0", size=(4, 3), zscale=1e-9, extra=b"", trailer=b"", check=0
):
    wide = "I" if version.endswith(b"2.0") else "H"
    head = struct.pack(
        f"<8s10s12s12s{wide}{wide}ddddBBB",
        version,
        b"none",
        DATES.encode(),
        DATES.encode(),
        *size,
        1e-6,
        2e-6,
        zscale,
        -1.0,
        0,
        kind,
        check,
    )
    values = [BAD.get(kind, 0) if v is None else v for v in FLAT]
    return head + extra + struct.pack(f"<{len(FLAT)}{CODES[kind]}", *values) + trailer


def truth(scale=1e-9, rows=ROWS, **more):
    z = [[None if v is None else v * scale for v in row] for row in rows]
    steps = {"dx_m": 1e-6, "dy_m": 2e-6}
    return {"kind": "surface", "shape": [len(rows), len(rows[0])], "z_m": z, **steps, **more}


def samples():
    """Yield name, bytes and expectation."""
    yield "text.sdf", text(FLAT), truth()
    yield "text-bcr.sdf", text(FLAT, version="aBCR-1.0", end="\r\n"), truth()
    without = truth() | {"dx_m": None, "dy_m": None}
    yield "uncalibrated.sdf", text(FLAT, scales=(0, 0, 1e-9)), without
    x = [2.5e-7 * i for i in range(5)]
    heights = [-0.3, None, -0.25, 0.1, 0.4]
    z = [None if v is None else v * 1e-6 for v in heights]
    one = {"version": "aNPL-V1.0", "size": (5, 1), "scales": (2.5e-7, 0, 1e-6)}
    profile = {"kind": "profile", "shape": [5], "x_m": x, "z_m": z}
    yield "one-profile.sdf", text(heights, **one), profile
    for kind in (5, 6, 7):
        data = binary(kind, trailer=b"<PartName> bump </PartName>")
        yield f"binary-type{kind}.sdf", data, truth()
    yield "binary-iso2.sdf", binary(3, version=b"bISO-2.0"), truth()
    yield "binary-bcr-type1.sdf", binary(1, version=b"bBCR-1.0"), truth()
    longer = binary(5, extra=struct.pack("<II", 5, 1))
    yield "longer-header.sdf", longer, truth(warnings_match="8 bytes longer")
    yield from damaged()


def damaged():
    corrupt, unsupported = {"error": "CorruptFileError"}, {"error": "UnsupportedFeatureError"}
    yield "nan-scale.sdf", text(FLAT, Zscale="nan"), {**corrupt, "match": "Zscale"}
    yield "too-few.sdf", text(FLAT[:-1]), {**corrupt, "match": "do not fill the map"}
    yield "cut-off.sdf", binary(7)[:-3], {**corrupt, "match": "does not fit into the file"}
    yield (
        "wrong-type.sdf",
        binary(7).replace(b"\x07\x00", b"\x05\x00", 1),
        {
            **corrupt,
            "match": "is not text",
        },
    )
    yield "all-bad.sdf", text([None] * 12), {**corrupt, "match": "no point was measured"}
    yield (
        "absurd-size.sdf",
        text(FLAT, size=(70000, 70000)),
        {
            **unsupported,
            "match": "70000 x 70000",
        },
    )
    yield "checked.sdf", binary(7, check=1), {**unsupported, "match": "CheckType 1"}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, expected in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(expected, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of Vision64 files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

MAGIC = b"VCA DATA\x01\0\0\x55"
MICROMETER = ("Micrometer", "\xb5m", 1e6)
NANOMETER = ("Nanometer", "nm", 1e9)
VOLT = ("Volt", "V", 1.0)
END = struct.pack("<I", 0) + b"\x7f\xff\xff"


def name(text):
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def sized(data, width=None):
    """Return data behind its size, which takes 1, 2 or 4 bytes itself."""
    width = width or (1 if len(data) < 256 else 2)
    return bytes([width]) + len(data).to_bytes(width, "little") + data


def item(key, kind, value):
    return name(key) + bytes([kind]) + value


def container(key, *items, kind=0x7D, width=4):
    return item(key, kind, sized(b"".join(items) + END, width))


def text(key, value):
    return item(key, 0x12, sized(value.encode()))


def unit_of(unit):
    return name(unit[0]) + name(unit[1]) + struct.pack("<dIII", unit[2], 1, 0, 0)


def quantity(key, value, unit):
    return item(key, 0x13, sized(struct.pack("<d", value) + unit_of(unit)))


def array(key, values):
    data = b"\x0d\x08\0\0\0" + struct.pack(f"<{len(values)}d", *values)
    return item(key, 0x40, name("double * __ptr64") + sized(data))


def choice(key, kind, value):
    return item(key, 0x0E, name(f"enum Vca::DataCore::{kind}") + sized(struct.pack("<I", value)))


def matrix(rows, *, anonymous=False, type_name="VisionDataMatrix<float>"):
    data = struct.pack("<II", len(rows), len(rows[0]))
    data += b"".join(struct.pack("<f", float("nan") if v is None else v) for r in rows for v in r)
    if anonymous:
        return item("Matrix", 0x45, name("Matrix<float>") + sized(data))
    return item(
        "Matrix", 0x00, name(type_name) + struct.pack("<I", 0) + name("WykoData.dll") + sized(data)
    )


def surface(rows, *, key="Raw", scale=0.25, unit=NANOMETER, origin=None, steps=(1.5, 2.5), **more):
    extents = [s * (n - 1) for s, n in zip(steps, (len(rows[0]), len(rows)), strict=True)]
    parts = [
        quantity("Dimension1Extent", extents[1], MICROMETER),
        item("Dimension1Points", 0x07, struct.pack("<I", len(rows))),
        quantity("Dimension2Extent", extents[0], MICROMETER),
        item("Dimension2Points", 0x07, struct.pack("<I", len(rows[0]))),
        text("DataKind", "Height"),
        item("Aspect", 0x0C, struct.pack("<f", 1.0)),
        quantity("DataScale", scale, unit),
        matrix(rows, **more),
    ]
    if origin is not None:
        parts.insert(4, choice("Origin", "Data2D::EOrigin", origin))
    return container(key, *parts, kind=0x47)


def profile(heights, positions, *, scale=0.125, unit=NANOMETER, stored=True, extra=b""):
    parts = [
        text("DataKind", "Height"),
        quantity("Extent", positions[-1] - positions[0], MICROMETER),
        item("NumPoints", 0x0B, struct.pack("<Q", len(heights))),
        choice("ValueTypeID", "ETypeID", 13),
        quantity("DataScale", scale, unit),
        extra,
        array("Array", [float("nan") if v is None else v for v in heights]),
    ]
    if stored:
        parts += [
            item("PositionUnits", 0x18, sized(unit_of(MICROMETER))),
            array("PositionArray", positions),
        ]
    return container("Raw", *parts, kind=0x46)


def opdx(*, maps=(), profiles=(), kind="Surface Height", primary="Raw", first=b""):
    meta = [
        text("DataSetName", "planted bump, 5 \xb5m"),
        item("TimeStamp", 0x15, bytes(range(9))),
        item("Valid", 0x01, b"\x01"),
        item("Offset", 0x06, struct.pack("<i", -7)),
        container(
            "2D_Channels", item("Height", 0x42, name("vector<wstring>") + sized(name("Raw")))
        ),
        text("DataKind", kind),
        text("PrimaryData2D", primary),
    ]
    groups = (
        container("1D_Data", *profiles),
        container("2D_Data", *maps),
        container("MetaData", *meta),
    )
    return MAGIC + first + b"".join(groups) + END


def of_map(rows, *, scale=0.25e-9, **more):
    z = [[None if v is None else v * scale for v in row] for row in rows]
    return {
        "kind": "surface",
        "shape": [len(z), len(z[0])],
        "dx_m": 1.5e-6,
        "dy_m": 2.5e-6,
        "z_m": z,
        **more,
    }


def of_profile(heights, positions, **more):
    z = [None if v is None else v * 0.125e-9 for v in heights]
    x = [p * 1e-6 for p in positions]
    return {"kind": "profile", "shape": [len(z)], "x_m": x, "z_m": z, **more}


# the last value of the first stored row is the largest, the hole begins the last: no symmetry
ROWS = [[1.0, 2.0, 3.0, 900.0], [-5.0, 6.0, 7.0, 8.0], [None, 10.0, 20.0, 30.0]]
OTHER = [[2.0, 4.0], [8.0, 16.0], [32.0, -64.0]]
HEIGHTS = [5.0, 7.0, None, 11.0, -300.0, 2.5]
UNEVEN = [0.0, 0.5, 1.0, 1.5, 2.0, 3.0]
EVEN = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    top_first = list(reversed(ROWS))
    intensity = surface(OTHER, key="Intensity", unit=("", "", 1.0))
    unknown = item("Odd", 0x33, b"\x01\x02")
    files = {
        "lower-left.opdx": (opdx(maps=[surface(ROWS, origin=1), intensity]), of_map(ROWS)),
        "top-first.opdx": (opdx(maps=[surface(ROWS, anonymous=True)]), of_map(top_first)),
        "two-maps.opdx": (
            opdx(maps=[surface(OTHER, key="Second", origin=1), surface(ROWS, origin=1)]),
            of_map(OTHER, options={"channel": "2D_Data/Second"}),
        ),
        "primary.opdx": (
            opdx(maps=[surface(OTHER, key="Second", origin=1), surface(ROWS, origin=1)]),
            of_map(ROWS),
        ),
        "profile.opdx": (
            opdx(profiles=[profile(HEIGHTS, UNEVEN)], kind="Surface Profile"),
            of_profile(HEIGHTS, UNEVEN),
        ),
        "extent.opdx": (
            opdx(profiles=[profile(HEIGHTS, EVEN, stored=False)], kind="Surface Profile"),
            of_profile(HEIGHTS, EVEN),
        ),
        "both.opdx": (
            opdx(profiles=[profile(HEIGHTS, EVEN)], maps=[surface(ROWS, origin=1)]),
            of_profile(HEIGHTS, EVEN, options={"channel": "1D_Data/Raw"}),
        ),
        "unknown-type.opdx": (
            opdx(
                profiles=[profile(HEIGHTS, EVEN)],
                kind="Surface Profile",
                first=container("Settings", unknown),
            ),
            of_profile(HEIGHTS, EVEN, warnings_match="unknown type 0x33"),
        ),
    }
    whole = files["profile.opdx"][0]
    wrong_unit = ("Micrometer", "\xb5m", 1e9)
    depth = container("x")
    for _ in range(40):
        depth = container("x", depth)
    damaged = {
        "cut-off.opdx": (whole[:-200], "CorruptFileError", "larger than what encloses it"),
        "volts.opdx": (
            opdx(profiles=[profile(HEIGHTS, EVEN, unit=VOLT)]),
            "UnsupportedFeatureError",
            "in a unit of length",
        ),
        "factor.opdx": (
            opdx(maps=[surface(ROWS, unit=wrong_unit)]),
            "CorruptFileError",
            "contradicts its factor",
        ),
        "deep.opdx": (opdx(first=depth), "CorruptFileError", "nested too deep"),
    }
    for key, (data, error, match) in damaged.items():
        files[key] = (data, {"error": error, "match": match})
    for key, (data, truth) in files.items():
        (folder / "samples" / key).write_bytes(data)
        written = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{key}.json").write_text(written, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

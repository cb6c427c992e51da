"""Write the samples of Digital Surf files with struct and zlib; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
import zlib
from pathlib import Path

PROFILE, SURFACE, IMAGE, PROFILES, SURFACES = 1, 2, 3, 4, 5
FACTOR = {"m": 1.0, "mm": 1e-3, "\xb5m": 1e-6, "um": 1e-6, "nm": 1e-9}


def single(value):
    """Return a number as single precision keeps it."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


STEPS = (single(2.5), single(0.004), single(1e-10))
UNITS = ("\xb5m", "mm", "m")
OFFSETS = (single(0.5), single(-0.25), single(3e-8))


def text(value, size):
    return value.encode("latin-1").ljust(size)


def compressed(data, streams):
    """Return the zlib streams of Digital Surf: number, sizes, contents."""
    share = -(-len(data) // streams)
    parts = [data[i * share : (i + 1) * share] for i in range(streams)]
    packed = [zlib.compress(part, 9) for part in parts]
    sizes = b"".join(
        struct.pack("<II", len(a), len(b)) for a, b in zip(parts, packed, strict=True)
    )
    return struct.pack("<I", streams) + sizes + b"".join(packed)


def sur(
    rows,
    *,
    kind=SURFACE,
    bits=16,
    special=1,
    n_objects=1,
    name="planted bump",
    units=UNITS,
    steps=STEPS,
    offsets=OFFSETS,
    streams=0,
    comment="",
    private=b"",
    inverted=0,
    limits=None,
    ratio=1.0,
):
    """Return one object with the given raw values, top row first; None is not measured."""
    lines, points = len(rows), len(rows[0])
    known = [v for row in rows for v in row if v is not None]
    low, high = limits or (min(known), max(known))
    code = "<h" if bits == 16 else "<i"
    data = b"".join(struct.pack(code, low - 2 if v is None else v) for row in rows for v in row)
    body = compressed(data, streams) if streams else data
    note = comment.encode("latin-1")
    head = b"DSCOMPRESSED" if streams else b"DIGITAL SURF"
    head += struct.pack("<hHhh", 0, n_objects, 1, kind) + text(name, 30) + text("metrologist", 30)
    head += struct.pack("<hhhhhfI", 0, 9, 0, special, 1, 0.0, 0)
    head += struct.pack("<hiiiii", bits, low, high, points, lines, points * lines)
    head += struct.pack("<fff", *steps) + b"".join(text(t, 16) for t in ("X", "Y", "Z"))
    head += b"".join(text(u, 16) for u in units) + b"".join(text("nm", 16) for _ in units)
    head += struct.pack("<fff", ratio, ratio, ratio)
    head += struct.pack("<hhh", 0, inverted, 0) + bytes(12)
    head += struct.pack("<7hf", 30, 15, 9, 3, 1, 2026, 6, 1.5)
    head += struct.pack("<I", len(body) if streams else 0) + bytes(6)
    head += struct.pack("<HH", len(note), len(private)) + text("", 128)
    head += (
        struct.pack("<fff", *offsets)
        + struct.pack("<ff", 0.0, 0.0)
        + text("T", 13)
        + text("s", 13)
    )
    return head + note + private + body


def heights(row, low, units=UNITS, steps=STEPS, offsets=OFFSETS):
    factor = FACTOR[units[2]]
    dz, offset = steps[2] * factor, offsets[2] * factor
    return [None if v is None else (v - low) * dz + offset for v in row]


def surface(rows, *, units=UNITS, steps=STEPS, offsets=OFFSETS, **more):
    low = min(v for row in rows for v in row if v is not None)
    dx, dy = (
        steps[i] * FACTOR[units[i]] if units[i] in FACTOR and steps[i] else None for i in (0, 1)
    )
    return {
        "kind": "surface",
        "shape": [len(rows), len(rows[0])],
        "dx_m": dx,
        "dy_m": dy,
        "origin_m": [offsets[i] * FACTOR.get(units[i], 0.0) for i in (0, 1)],
        "z_m": [heights(row, low, units, steps, offsets) for row in reversed(rows)],
        **more,
    }


def profile(row, **more):
    low = min(v for v in row if v is not None)
    factor = FACTOR[UNITS[0]]
    x = [OFFSETS[0] * factor + i * (STEPS[0] * factor) for i in range(len(row))]
    return {"kind": "profile", "shape": [len(row)], "x_m": x, "z_m": heights(row, low), **more}


# the top row holds the largest value, the right column the hole: no mirror image looks the same
ROWS = [[900, 10, 20, None], [1, 2, 3, 4], [-5, -6, -7, 320]]
WIDE = [[None if v is None else v * 1000000 for v in row] for row in ROWS]
LINE = [5, 7, None, 11, -300, 2]
OTHER = [[v and v // 2 - 3 for v in row] for row in ROWS]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    second = surface(OTHER, options={"channel": "object 2"})
    files = {
        "surface16.sur": (sur(ROWS), surface(ROWS)),
        "surface32.sur": (
            sur(WIDE, bits=32, comment="5 \xb5m\r\n", private=b"\x01\x02\x03"),
            surface(WIDE),
        ),
        "streams.sur": (sur(WIDE, bits=32, streams=3), surface(WIDE)),
        "profile.pro": (sur([LINE], kind=PROFILE), profile(LINE)),
        "profiles.pro": (
            sur([LINE], kind=PROFILES, n_objects=2)
            + sur([LINE[::-1]], kind=PROFILES, n_objects=2, streams=1, name="back"),
            profile(LINE[::-1], options={"channel": "object 2"}),
        ),
        "series.sur": (
            sur(ROWS, kind=SURFACES, n_objects=2, streams=2)
            + sur(OTHER, kind=SURFACES, n_objects=2, name="second"),
            second,
        ),
        "dos-micro.sur": (
            sur(ROWS, units=("\xe6m", "\xe6m", "\xe6m")),
            surface(ROWS, units=("um", "um", "um")),
        ),
        "uncalibrated.sur": (
            sur(
                ROWS,
                units=("pixels", "\xb5m", "m"),
                steps=(1.0, 0.0, STEPS[2]),
                offsets=(0.0, 0.0, 0.0),
            ),
            surface(
                ROWS,
                units=("pixels", "um", "m"),
                steps=(1.0, 0.0, STEPS[2]),
                offsets=(0.0, 0.0, 0.0),
            ),
        ),
        "inverted.sur": (sur(ROWS, inverted=1), surface(ROWS, warnings_match="inverted")),
        "saturated.sur": (
            sur(ROWS[1:], limits=(-7, 4)),
            surface(ROWS[1:], warnings_match="1 values are outside"),
        ),
        "ratios.sur": (sur(ROWS, ratio=1000.0), surface(ROWS)),
        "trailing.sur": (sur(ROWS) + bytes(9), surface(ROWS, warnings_match="9 bytes follow")),
    }
    whole = sur(ROWS)
    damaged = {
        "cut-off.sur": (whole[:-3], "CorruptFileError", "does not fit"),
        "bits8.sur": (
            whole[:98] + struct.pack("<h", 8) + whole[100:],
            "CorruptFileError",
            "bits_per_point",
        ),
        "image.sur": (sur(ROWS, kind=IMAGE), "UnsupportedFeatureError", "binary image"),
        "volts.sur": (sur(ROWS, units=("mm", "mm", "V")), "UnitError", "z_step_unit"),
    }
    for name, (data, error, match) in damaged.items():
        files[name] = (data, {"error": error, "match": match})
    for name, (data, truth) in files.items():
        (folder / "samples" / name).write_bytes(data)
        written = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(written, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of imc files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path


def block(key, body, version=1):
    """Return a block with the length of its body."""
    data = body if isinstance(body, bytes) else body.encode("latin-1")
    return f"|{key},{version},{len(data)},".encode() + data + b";"


def component(index, kind, width, name, unit, scale=(0, 1, 0), place=(0, 0), x0=0.0, cs=1):
    """Return the blocks of one component; place is offset and bytes."""
    on, factor, offset = scale
    return b"".join((
        block("CC", f"{index},1"),
        block("CP", f"{index},{width},{kind},{8 * width},0,0,1,0"),
        block("Cb", f"1,0,{index},{cs},{place[0]},{place[1]},0,{place[1]},1,{x0},1000000.5,"),
        block("CR", f"{on},{factor},{offset},1,{len(unit.strip(chr(34)))},{unit}"),
        block("CN", f"0,0,0,{len(name)},{name},3,odd"),
    ))  # fmt: skip


START = block("CF", "1", 2) + block("CK", "1,1") + b"\r\n"


def single(kind, code, raw, *, name="gap", unit="um", scale=(0, 1, 0), x0=0.25, dx=0.5):
    """Return a file with one channel over time."""
    data = struct.pack(f"<{len(raw)}{code}", *raw)
    width = len(data) // len(raw)
    return (
        START + block("CG", "1,1,1") + block("CD", f"{dx},1,1,s,0,0,0,0,1", 2)
        + block("NT", "1,1,1980,0,0,0.0") + b"\r\n"
        + component(1, kind, width, name, unit, scale, (0, len(data)), x0)
        + block("CS", b"1," + data)
    )  # fmt: skip


def xy(time_unit="ms"):
    """Return an XY set whose times have six bytes and lie behind the values."""
    values = struct.pack("<3i", -7, 40, 2000)
    times = b"".join(struct.pack("<Q", t)[:6] for t in (100, 350, 2**32 + 1))
    return (
        START + block("CG", "2,2,2") + block("CD", "1,1,0,,0,0,0")
        + component(1, 6, 4, "force, of the probe", "N", (0, 1, 0), (0, 12))
        + component(2, 13, 6, "time", time_unit, (1, 0.5, 0), (12, 18))
        + block("CS", b"1," + values + times)
    )  # fmt: skip


def recording(times, **named):
    return {"kind": "recording", "t_s": times, "channels": named}


PIPE = single(7, "f", [1.5, -0.25, float(0x7C)])
CASES = {
    "float.raw": (PIPE, recording([0.25, 0.75, 1.25], gap=[1.5e-6, -0.25e-6, 124e-6])),
    "scaled.raw": (single(4, "h", [-100, 0, 32000], unit="nm", scale=(1, 0.25, 8.0)),
                   recording([0.25, 0.75, 1.25], gap=[-17e-9, 8e-9, 8008e-9])),
    "unknown-unit.raw": (single(1, "B", [0, 255], unit='"kph"', name="v"),
                         recording([0.25, 0.75], v=[0.0, 255.0])),
    "xy.dat": (xy(), recording([0.05, 0.175, (2**32 + 1) * 0.5e-3],
                               **{"force, of the probe": [-7.0, 40.0, 2000.0]})),
    "over-length.dat": (xy("mm"), {"error": "FormatMismatchError", "match": "not in a unit of time"}),
    "compressed.raw": (single(9, "h", [1, 2]), {"error": "UnsupportedFeatureError", "match": "type 9"}),
    "wrong-width.raw": (single(8, "f", [1.0, 2.0]), {"error": "CorruptFileError", "match": "expected 8"}),
    "cut-off.raw": (PIPE[:-3], {"error": "CorruptFileError", "match": "does not fit"}),
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

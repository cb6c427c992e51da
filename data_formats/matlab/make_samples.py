"""Write the samples of MATLAB files, version 5 with struct, 7.3 with h5py; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import struct
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np

NAN = float("nan")
Z = [[1.5, -2.0, NAN], [40.0, 0.25, 3.0]]  # nm; the hole is in row 1, the peak in row 2
COUNTS = [[1, 2, 3], [40, 50, -600]]
T, A, B = [0.0, 2.0, 5.0], [1.0, -7.0, 0.5], [10.0, 20.0, NAN]
NAMES = ['"Model Root"/" EncoderX"/"Pos"', '"Model Root"/"Gap"']
INT8, UINT8, INT16, UINT16, INT32, UINT32, DOUBLE, MATRIX, PACKED = 1, 2, 3, 4, 5, 6, 9, 14, 15
CODES = {INT8: "b", UINT8: "B", INT16: "h", UINT16: "H", INT32: "i", UINT32: "I", DOUBLE: "d"}
CELL, STRUCT, CHAR, CLASS_DOUBLE, CLASS_INT16 = 1, 2, 4, 6, 10
COMPLEX = 0x0800


class V5:
    """Writes elements in one byte order."""

    def __init__(self, order="<"):
        self.order = order

    def element(self, kind, values, small=False):
        """Return a tag and its data."""
        if kind == MATRIX:
            data = values
        else:
            data = struct.pack(f"{self.order}{len(values)}{CODES[kind]}", *values)
        if small and 0 < len(data) <= 4:
            return struct.pack(self.order + "I", len(data) << 16 | kind) + data.ljust(4, b"\0")
        return struct.pack(self.order + "II", kind, len(data)) + data + bytes(-len(data) % 8)

    def matrix(self, name, kind, shape, content, flags=0):
        """Return a variable of any class."""
        head = self.element(UINT32, [kind | flags, 0]) + self.element(INT32, shape)
        return self.element(MATRIX, head + self.element(INT8, name.encode(), True) + content)

    def array(self, name, rows, stored=DOUBLE, kind=CLASS_DOUBLE):
        """Return a variable of numbers."""
        columns = [v for column in zip(*rows, strict=True) for v in column]  # column by column
        content = self.element(stored, columns, True)
        return self.matrix(name, kind, [len(rows), len(rows[0])], content)

    def column(self, name, values):
        """Return a column of numbers."""
        return self.array(name, [[v] for v in values])

    def text(self, name, value):
        """Return a variable of text."""
        codes = self.element(UINT16, value.encode("utf-16-le")[::2], True)
        return self.matrix(name, CHAR, [1, len(value)], codes)

    def record(self, name, *items):
        """Return an array of structs; each item maps a field to its matrix."""
        fields = list(items[0])
        width = 32
        names = b"".join(f.encode().ljust(width, b"\0") for f in fields)
        content = self.element(INT32, [width], True) + self.element(INT8, names)
        values = b"".join(matrix for item in items for matrix in item.values())
        return self.matrix(name, STRUCT, [1, len(items)], content + values)

    def packed(self, element):
        """Return an element in zlib blocks without compression, the same from every zlib."""
        data = zlib.compress(element, 0)
        return struct.pack(self.order + "II", PACKED, len(data)) + data

    def file(self, *variables):
        """Return a file."""
        text = b"MATLAB 5.0 MAT-file, Platform: none, Created on: Thu Jan  1 00:00:00 1970"
        version = b"\0\1IM" if self.order == "<" else b"\1\0MI"
        return text.ljust(116) + bytes(8) + version + b"".join(variables)


def capture(v5):
    axis = v5.record("", {"Name": v5.text("", "time"), "Data": v5.array("", [T])})
    traces = v5.record(
        "",
        {"Name": v5.text("", NAMES[0]), "Data": v5.array("", [A])},
        {"Name": v5.text("", NAMES[1]), "Data": v5.array("", [B])},
    )
    settings = v5.record("", {"SamplingPeriod": v5.array("", [[0.001]])})
    return v5.record("capture_001", {"X": axis, "Y": traces, "Capture": settings})


def v73(**arrays):
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest", userblock_size=512) as handle:
        for name, rows in arrays.items():
            data = np.array(rows).T  # as MATLAB stores it
            found = handle.create_dataset(name, data=data, track_times=False)
            found.attrs["MATLAB_class"] = np.bytes_(b"double")
    text = b"MATLAB 7.3 MAT-file, Platform: none, Created on: Thu Jan  1 00:00:00 1970"
    return (text.ljust(116) + bytes(8) + b"\0\2IM").ljust(512, b"\0") + stream.getvalue()[512:]


def surface(rows, factor, options, dx=None, dy=None):
    z = [[None if v != v else v * factor for v in row] for row in rows]
    shape = [len(z), len(z[0])]
    return {
        "kind": "surface",
        "shape": shape,
        "dx_m": dx,
        "dy_m": dy,
        "z_m": z,
        "options": options,
    }


def recording(t, options, **channels):
    return {"kind": "recording", "t_s": t, "channels": channels, "options": options}


def cases():
    little, big = V5("<"), V5(">")
    step = {"unit": "nm", "lateral_step": ["2 um", "3 um"]}
    calibrated = surface(Z, 1e-9, step, 2e-6, 3e-6)
    yield "map.mat", little.file(little.array("z", Z)), calibrated
    counts = big.packed(big.array("counts", COUNTS, INT16, CLASS_INT16))
    other = big.packed(big.array("other", Z))
    chosen = {"unit": "um", "channel": "counts"}
    yield "packed-big-endian.mat", big.file(other, counts), surface(COUNTS, 1e-6, chosen)
    yield "map-7.3.mat", v73(z=Z), calibrated
    nested = little.record("data", {"z": little.array("", Z), "who": little.text("", "Jane")})
    yield "in-a-struct.mat", little.file(nested), surface(Z, 1e-6, {"unit": "um"})

    vectors = [little.column("tt", T), little.column("a", A), little.array("b", [B])]
    seconds = [0.0, 2e-3, 5e-3]
    gap = [10.0, 20.0, None]
    timed = recording(seconds, {"time": "tt:ms"}, a=A, b=gap)
    yield "vectors.mat", little.file(*vectors, little.array("n", [[3.0]])), timed
    rate = recording([0.0, 0.5, 1.0], {"sampling_rate": "2 Hz", "channel": "a"}, a=A)
    yield "vectors-7.3.mat", v73(a=[[v] for v in A], b=[B], long=[[1.0] * 5]), rate
    profile = {
        "kind": "profile",
        "shape": [3],
        "x_m": [0.0, 2e-3, 5e-3],
        "z_m": [1e-6, -7e-6, 0.5e-6],
        "options": {"x": "tt:mm", "z": "a:um"},
    }
    yield "profile.mat", little.file(*vectors), profile
    named = {NAMES[0]: A, NAMES[1]: gap}
    packed = little.packed(capture(little))
    yield "capture.mat", little.file(packed), recording(T, {}, **named)

    whole = little.file(little.array("z", Z))
    corrupt = {"error": "CorruptFileError"}
    yield "cut.mat", whole[:-8], {**corrupt, "match": "a variable does not fit"}
    claim = bytearray(whole)
    struct.pack_into("<i", claim, 160, 2**30)
    yield "absurd-rows.mat", bytes(claim), {**corrupt, "match": "an array (byte"}
    bomb = little.packed(struct.pack("<II", MATRIX, 2**31) + bytes(1000))
    yield "bomb.mat", little.file(bomb), {**corrupt, "match": "a packed variable does not fit"}
    yield "no-unit.mat", whole, {"error": "UnitError", "match": "declares no unit"}
    pair = little.element(DOUBLE, [1.0, 2.0]) * 2
    twofold = little.matrix("c", CLASS_DOUBLE, [1, 2], pair, COMPLEX)
    match = {"error": "UnsupportedFeatureError", "match": "omitted: c"}
    yield "complex.mat", little.file(twofold), match


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, content, truth in cases():
        (folder / "samples" / name).write_bytes(content)
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of Igor binary waves with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[0.5, -0.25, 3.5], [1.0, 0.0, -2.0]]  # smallest y first


def wave(
    layers,
    *,
    order="<",
    kind=4,
    code="d",
    xy="m",
    z="m",
    steps=(2e-6, 0.5e-6),
    starts=(1e-6, -3e-6),
    note=b"",
    names=(),
    dims=None,
    size=0,
):
    """Return a wave of version 5 with x fastest."""
    n = dims or (len(layers[0][0]), len(layers[0]), len(layers) if len(layers) > 1 else 0, 0)
    data = b"".join(
        struct.pack(f"{order}{len(row)}{code}", *row) for layer in layers for row in layer
    )
    labels = b"".join(name.encode().ljust(32, b"\0") for name in ("", *names)) if names else b""
    head = struct.pack(
        f"{order}hhiiii4i4iiii",
        5,
        0,
        320 + len(data) + size,
        0,
        len(note),
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        len(labels),
        0,
        0,
        0,
        0,
    )
    fields = struct.pack(
        f"{order}4xIIihh6xh32s4x4x4i4d4d4s4s4s4s4s", 0, 0, len(data) // struct.calcsize(code), kind, 0, 1, b"wave0", *n, *steps, 1.0, 1.0,
        *starts, 0.0, 0.0, z.encode(), xy.encode(), xy.encode(), b"", b"",
    )  # fmt: skip
    front = (head + fields).ljust(384, b"\0")
    total = (
        sum(struct.unpack(f"{order}192h", front)) & 0xFFFF
    )  # with its negative at byte 2 it is zero
    return front[:2] + struct.pack(f"{order}H", -total & 0xFFFF) + front[4:] + data + note + labels


def surface(rows=ROWS, factor=1.0, **more):
    z = [[v * factor for v in row] for row in rows]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z,
            "origin_m": [1e-6, -3e-6], **more}  # fmt: skip


PHASE = [[90.0, 91.0, 92.0], [93.0, 94.0, 95.0]]
NOTED = {
    "note": b"ScanSize: 6e-06\rMicroscopeModel: x\r",
    "names": ("HeightRetrace", "PhaseRetrace"),
    "z": "deg",
}
LINE = [[[0.5, -0.25, 3.5]]]
CASES = {
    "metres.ibw": (wave([ROWS]), surface()),
    "big-endian.ibw": (wave([ROWS], order=">", kind=2, code="f"), surface()),
    "no-units.ibw": (wave([ROWS], xy="", z="", steps=(2.0, 0.5), starts=(1.0, -3.0)),
                     surface(factor=1e-6, options={"unit": "um"})),
    "unit-asked-for.ibw": (wave([ROWS], xy="", z=""), {"error": "UnitError", "match": "declare it with unit="}),
    "two-layers.ibw": (wave([ROWS, PHASE], **NOTED), surface()),
    "phase-is-no-height.ibw": (wave([PHASE, ROWS], **{**NOTED, "names": ("PhaseRetrace", "HeightRetrace")}),
                               {"error": "UnitError", "match": "not a length"}),
    "profile.ibw": (wave(LINE, dims=(3, 0, 0, 0)),
                    {"kind": "profile", "shape": [3], "x_m": [1e-6, 3e-6, 5e-6], "z_m": LINE[0][0]}),
    "complex.ibw": (wave([ROWS], dims=(3, 2, 0, 2)), {"error": "UnsupportedFeatureError", "match": "fourth"}),
    "wrong-size.ibw": (wave([ROWS], size=-8), {"error": "CorruptFileError", "match": "wave"}),
    "cut-off.ibw": (wave([ROWS])[:-9], {"error": "CorruptFileError", "match": "does not fit"}),
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

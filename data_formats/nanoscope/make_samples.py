"""Write the samples of Nanoscope files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[0, 100, -200], [32767, 4, -32768]]  # the lowest row first
START = 8192


def image(
    name,
    number,
    *,
    soft="Sens. Zsens",
    unit="V",
    width=2,
    columns=3,
    rows=2,
    size="6 1 ~m",
    stored=2,
):
    """Return the section of one image."""
    length = columns * rows * stored
    return (
        f"\\*Ciao image list\r\n\\Data offset: {START + 64 * number}\r\n\\Data length: {length}\r\n"
        f"\\Bytes/pixel: {width}\r\n\\Samps/line: {columns}\r\n\\Number of lines: {rows}\r\n"
        f"\\Scan Size: {size}\r\n\\@2:Image Data: S [{name}] \"{name} title\"\r\n"
        f"\\@2:Z scale: V [{soft}] (0.0078125 {unit}/LSB) 512 {unit}\r\n"
    )  # fmt: skip


def spm(images, blocks, version="0x05310001", end="\\*File list end\r\n"):
    """Return a file: header, then a block of counts for each image."""
    head = (
        f"\\*File list\r\n\\Version: {version}\r\n\\Date: 10:20:30 AM Wed Mar 04 2026\r\n"
        "\\*Scanner list\r\n\\@Sens. Zsens: V 4.000000 nm/V\r\n\\@Sens. Current: V 10.0 nA/V\r\n"
        + "".join(images) + end
    )  # fmt: skip
    return head.encode("latin-1").ljust(START, b"\0") + b"".join(
        b.ljust(64, b"\0") for b in blocks
    )


def counts(code, rows=ROWS):
    return b"".join(struct.pack(f"<3{code}", *row) for row in rows)


def surface(factor, **more):
    z = [[v * factor for v in row] for row in ROWS]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z, **more}


STEP = 512 / 65536 * 4e-9  # full scale over 2^16, times the sensitivity
TWO = spm([image("Current", 0, soft="Sens. Current"), image("Height", 1)], [b"", counts("h")])
CASES = {
    "height.spm": (spm([image("Height", 0)], [counts("h")]), surface(STEP)),
    "second-is-height.spm": (TWO, surface(STEP, options={"channel": "Height"})),
    "millivolts.spm": (spm([image("ZSensor", 0, unit="mV")], [counts("h")]), surface(STEP * 1e-3)),
    "version-9.4.spm": (spm([image("Height", 0, stored=4)], [counts("i")], "0x09400103"), surface(STEP)),
    "wide.spm": (spm([image("Height", 0, width=4, stored=4)], [counts("i")]), surface(STEP / 65536)),
    "square.spm": (spm([image("Height", 0, size="6 um")], [counts("h")]),
                   surface(STEP) | {"dy_m": 3e-6}),
    "current-only.spm": (spm([image("Current", 0, soft="Sens. Current")], [counts("h")]),
                         {"error": "UnsupportedFeatureError", "match": "holds no map of heights"}),
    "short-block.spm": (spm([image("Height", 0, stored=1)], [counts("h")]),
                        {"error": "CorruptFileError", "match": "data length"}),
    "cut-off.spm": (spm([image("Height", 0)], [counts("h")])[: START + 5],
                    {"error": "CorruptFileError", "match": "the map does not fit"}),
    "no-end.spm": (spm([image("Height", 0)], [counts("h")], end=""),
                   {"error": "CorruptFileError", "match": "header has no end"}),
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

"""Write the samples of LEXT files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[900, 1, 2], [3, 65535, 7]]  # the top row first


def surface(factor, rows=ROWS, **more):
    """Return what a reader must give: the lowest row first."""
    z = [[None if v != v else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z, **more}


ABOUT = (
    "<TiffTagDescData><HeightInfo><HeightDataUnitX>0</HeightDataUnitX><HeightDataUnitY>0</HeightDataUnitY>"
    "<HeightDataUnitZ>0</HeightDataUnitZ><HeightDataPerPixelX>1000000</HeightDataPerPixelX>"
    "<HeightDataPerPixelY>1000000</HeightDataPerPixelY><HeightDataPerPixelZ>200</HeightDataPerPixelZ>"
    "</HeightInfo></TiffTagDescData>"
)
SETTINGS = (
    "<ExifTagDescData><ImageCommonSettingsInfo><MakerCalibrationValueX>2</MakerCalibrationValueX>"
    "<MakerCalibrationValueY>0.5</MakerCalibrationValueY><MakerCalibrationValueZ>1.25</MakerCalibrationValueZ>"
    "</ImageCommonSettingsInfo></ExifTagDescData>"
)


def lext(order="<", *, name="HEIGHT", bits=16, size=None, settings=SETTINGS):
    """Return a TIFF with a picture that carries the description, and the page of heights in two strips."""
    out = bytearray({"<": b"II*\0", ">": b"MM\0*"}[order] + bytes(4))

    def put(data):
        out.extend(data + bytes(-len(data) % 2))
        return len(out) - len(data) - len(data) % 2

    def tags(*entries):
        """Return the bytes of a page but for the offset of the next one: (tag, type, values)."""
        body = struct.pack(order + "H", len(entries))
        for tag, kind, values in entries:
            if isinstance(values, str):
                raw = values.encode() + b"\0"
                count = len(raw)
            else:
                raw, count = (
                    struct.pack(f"{order}{len(values)}{'H' if kind == 3 else 'I'}", *values),
                    len(values),
                )
            body += struct.pack(order + "HHI", tag, kind, count)
            body += raw.ljust(4, b"\0") if len(raw) <= 4 else struct.pack(order + "I", put(raw))
        return body

    rows = [struct.pack(order + "3H", *row) for row in ROWS]
    exif = put(tags((41995, 7, settings)) + bytes(4))
    picture = put(bytes(6))
    first = tags((256, 4, [3]), (257, 4, [2]), (258, 3, [8]), (259, 3, [1]), (270, 2, ABOUT), (273, 4, [picture]),
                 (277, 3, [1]), (278, 4, [2]), (279, 4, [6]), (34665, 4, [exif]))  # fmt: skip
    strips = [put(row) for row in rows]
    second = tags((256, 4, [3]), (257, 4, [2]), (258, 3, [bits]), (259, 3, [1]), (270, 2, name), (273, 4, strips),
                  (277, 3, [1]), (278, 4, [1]), (279, 4, [6, size or 6]))  # fmt: skip
    last = put(second + bytes(4))
    at = put(first + struct.pack(order + "I", last))
    out[4:8] = struct.pack(order + "I", at)
    return bytes(out)


CASES = {
    "little.lext": (lext(), surface(250e-12)),
    "big.lext": (lext(">"), surface(250e-12)),
    "8-bit.lext": (lext(bits=8), {"error": "UnsupportedFeatureError", "match": "8 bits"}),
    "wrong-strips.lext": (lext(size=4), {"error": "CorruptFileError", "match": "strips do not make the map"}),
    "no-calibration.lext": (lext(settings="<a></a>"), {"error": "CorruptFileError", "match": "MakerCalibrationValueX"}),
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

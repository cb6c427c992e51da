"""Write the samples of Nanosurf files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[0, 100, -200], [32767, 4, -32768]]  # the lowest row first
KEYS = (
    "Points=3\r\nLines=2\r\nFrame=Scan forward\r\nSaveMode={mode}\r\nSaveBits={bits}\r\nSaveSign={sign}\r\n"
    "SaveOrder={order}\r\nDim0Range=6e-06\r\nDim0Unit=m\r\nDim1Range=1e-06\r\nDim1Unit=m\r\n"
    "Dim2Name={name}\r\nDim2Range=0.000128\r\nDim2Min=-6.4e-05\r\nDim2Unit={unit}\r\n"
)
USUAL = {
    "mode": "Binary",
    "bits": 16,
    "sign": "Signed",
    "order": "Intel",
    "name": "Z-Axis",
    "unit": "m",
}


def nid(*channels, blocks, end="#!"):
    """Return a file: sections for each channel, then the counts."""
    text = f"[DataSet]\r\nVersion=2\r\nGroupCount=1\r\nGr0-Count={len(channels)}\r\n"
    text += "".join(f"Gr0-Ch{k}=DataSet-0:{k}\r\n" for k in range(len(channels)))
    for k, keys in enumerate(channels):
        text += f"\r\n[DataSet-0:{k}]\r\n" + KEYS.format(**{**USUAL, **keys})
    text += "\r\n[DataSet-Info]\r\nDate=04-03-2026\r\nTime=10:20:30\r\n"
    return text.encode("latin-1") + end.encode() + b"".join(blocks)


def counts(order="<", code="h", shift=0):
    return b"".join(struct.pack(f"{order}3{code}", *(v + shift for v in row)) for row in ROWS)


def surface(**more):
    z = [[v * 0.000128 / 65536 for v in row] for row in ROWS]  # Dim2Min + Dim2Range / 2 = 0
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z, **more}


VOLTS = {"unit": "V", "name": "Amplitude"}
CASES = {
    "forward.nid": (nid({}, blocks=[counts()]), surface()),
    "second.nid": (nid(VOLTS, {}, blocks=[counts(shift=-0), counts()]), surface()),
    "motorola.nid": (nid({"order": "Motorola"}, blocks=[counts(">")]), surface()),
    "unsigned.nid": (nid({"sign": "Unsigned"}, blocks=[counts(code="H", shift=32768)]), surface()),
    "volts.nid": (nid(VOLTS, blocks=[counts()]),
                  {"error": "UnsupportedFeatureError", "match": "no channel in a unit of length"}),
    "text.nid": (nid({"mode": "Text"}, blocks=[counts()]),
                 {"error": "CorruptFileError", "match": "SaveBits"}),
    "cut-off.nid": (nid({}, blocks=[counts()])[:-1],
                    {"error": "CorruptFileError", "match": "the map does not fit"}),
    "no-end.nid": (nid({}, blocks=[counts()], end="?"),
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

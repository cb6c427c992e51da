"""Write the samples of PLUX files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import struct
import sys
import zipfile
from pathlib import Path

ROWS = [[0.5, -0.25, 3.5], [1.0, float("nan"), -2.0]]  # the top row first, in um


def surface(factor, rows=ROWS, options=(), **more):
    """Return what a reader must give: the lowest row first; the caller states the order in the file."""
    z = [[None if v != v else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z,
            "options": {"row_order": "top row first", **dict(options)}, **more}  # fmt: skip


LAYER = "<LAYER_{k}><FILENAME_Z>LAYER_{k}.raw</FILENAME_Z></LAYER_{k}>"
INDEX = (
    "<xml><GENERAL><DATE>2026-03-04</DATE><IMAGE_SIZE_X>{n}</IMAGE_SIZE_X><IMAGE_SIZE_Y>2</IMAGE_SIZE_Y>"
    "<FOV_X>2</FOV_X><FOV_Y>0.5</FOV_Y></GENERAL><INFO><ITEM_0><NAME>Device</NAME><VALUE>x</VALUE></ITEM_0>"
    "</INFO>{layers}</xml>"
)


def plux(*layers, columns=3, index=None):
    """Return an archive with the index and its layers."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        parts = "".join(LAYER.format(k=k) for k in range(len(layers)))
        archive.writestr(
            zipfile.ZipInfo("index.xml"), index or INDEX.format(n=columns, layers=parts)
        )
        for k, rows in enumerate(layers):
            data = b"".join(struct.pack("<3f", *row) for row in rows)
            archive.writestr(zipfile.ZipInfo(f"LAYER_{k}.raw"), data)
    return memory.getvalue()


OTHER = [[v * -2 for v in row] for row in ROWS]
DOCTYPE = (
    '<!DOCTYPE x [<!ENTITY a "b">]><xml><GENERAL><IMAGE_SIZE_X>3</IMAGE_SIZE_X></GENERAL></xml>'
)
CASES = {
    "plain.plux": (plux(ROWS), surface(1e-6)),
    "second.plux": (plux(ROWS, OTHER), surface(1e-6, OTHER, options={"channel": "LAYER_1"})),
    "wrong-size.plux": (plux(ROWS, columns=4), {"error": "CorruptFileError", "match": "24 bytes where 32"}),
    "claims-absurd.plux": (plux(ROWS, columns=10**6), {"error": "CorruptFileError", "match": "24 bytes where"}),
    "entities.plux": (plux(ROWS, index=DOCTYPE), {"error": "CorruptFileError", "match": "declares a document"}),
    "no-layer.plux": (plux(), {"error": "CorruptFileError", "match": "no layer with heights"}),
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

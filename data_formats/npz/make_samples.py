"""Write the samples of ``.npz`` with struct and zipfile alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import struct
import sys
import zipfile
from pathlib import Path

X_MM = [0.0, 0.5, 1.0, 1.5]
Z_UM = [1.25, -3.5, float("nan"), 7.0]
ROWS = [[1.0, 2.0, -3.0], [4.0, 5.0, 60.0]]


def npy(values, *, code="d", descr="<f8", shape=None):
    text = repr({"descr": descr, "fortran_order": False, "shape": shape or (len(values),)})
    text += " " * (-(10 + len(text) + 1) % 64) + "\n"
    body = struct.pack("<" + code * len(values), *values)
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode("latin-1") + body


def npz(**arrays):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in arrays.items():
            info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.compress_type = zipfile.ZIP_STORED  # deflate may differ between versions of zlib
            archive.writestr(info, data)
    return stream.getvalue()


MAP = npy([v for row in ROWS for v in row], shape=(2, 3))
BOTH = npz(x_mm=npy(X_MM), z_um=npy(Z_UM), map_nm=MAP)
PROFILE = {
    "kind": "profile",
    "shape": [4],
    "x_m": [x * 1e-3 for x in X_MM],
    "z_m": [None if z != z else z * 1e-6 for z in Z_UM],
}
SURFACE = {
    "kind": "surface",
    "shape": [2, 3],
    "dx_m": None,
    "dy_m": None,
    "z_m": [[v * 1e-9 for v in row] for row in ROWS],
    "warnings_match": "which row is on top",
}
CASES = {
    "profile.npz": (npz(x_mm=npy(X_MM), z_um=npy(Z_UM)), PROFILE),
    "objects.npz": (
        npz(x_mm=npy(X_MM), z_um=npy(Z_UM), notes=npy([], descr="|O", shape=(0,))),
        {**PROFILE, "warnings_match": "array 'notes' was omitted"},
    ),
    "map.npz": (npz(map_nm=MAP), SURFACE),
    "chosen.npz": (BOTH, {**SURFACE, "options": {"sheet": "map_nm"}}),
    "several.npz": (
        BOTH,
        {"error": "FormatMismatchError", "match": "choose one with sheet='x_mm'"},
    ),
    "claims-more.npz": (
        npz(x_mm=npy(X_MM, shape=(400_000_000,))),
        {"error": "CorruptFileError", "match": "do not agree"},
    ),
}


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

"""Write the samples of 4Sight files with h5py alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import sys
from pathlib import Path

import h5py
import numpy as np

NOT_MEASURED = np.finfo(np.float32).max
ROWS = [  # top row first: the largest value top left, the hole top right
    [0.75, 0.125, NOT_MEASURED],
    [-0.25, 0.0625, 0.03125],
]
OTHER = [[1.5, 2.5], [3.5, NOT_MEASURED], [-8.0, 0.5]]


def measurement(handle, number, rows, **changes):
    group = handle.create_group(f"measurement{number}/genraw")
    attributes = {
        "wavelength": np.bytes_(b"632.8 nm"),
        "height_units": np.bytes_(b"wv"),
        "wedge": 0.5,
        "xpix": np.bytes_(b"0.0873 mm"),
        "aspect": 1.0,
        "lut_type": np.bytes_(b"opd"),
    }
    for name, value in {**attributes, **changes}.items():
        if value is not None:
            group.attrs[name] = value
    group.create_dataset("data", data=np.array(rows, dtype="<f4"), track_times=False)


def fourd(*maps, **changes):
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        root = handle.create_group("4D")
        root.attrs["version"] = np.bytes_(b"0.4")
        root.attrs["nummeas"] = 1
        for number, rows in maps:
            measurement(handle, number, rows, **changes)
    return stream.getvalue()


def expected(rows, dx=0.0873e-3, dy=0.0873e-3, factor=632.8e-9 * 0.5):
    z = [[None if v >= NOT_MEASURED else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [len(z), len(z[0])], "dx_m": dx, "dy_m": dy, "z_m": z}


def cases():
    yield "one.h5", fourd((0, ROWS)), expected(ROWS)
    yield (
        "several.h5",
        fourd((0, ROWS), (2, OTHER)),
        {
            **expected(OTHER),
            "options": {"channel": "measurement2"},
            "warnings_match": "declares 1 measurements and holds 2",
        },
    )
    yield (
        "camera-pixel.h5",
        fourd((0, ROWS), xpix=np.bytes_(b"0.00903 mm")),
        {**expected(ROWS, 0.00903e-3, 0.00903e-3), "warnings_match": "pixel of the camera"},
    )
    yield (
        "not-square.h5",
        fourd((0, ROWS), aspect=1.25, wedge=1.0),
        {
            **expected(ROWS, dy=0.0873e-3 * 1.25, factor=632.8e-9),
            "warnings_match": "dy / dx",
        },
    )
    yield "uncalibrated.h5", fourd((0, ROWS), xpix=None), expected(ROWS, None, None)
    corrupt = {"error": "CorruptFileError"}
    yield (
        "no-unit.h5",
        fourd((0, ROWS), wavelength=np.bytes_(b"632.8")),
        {**corrupt, "match": "genraw wavelength"},
    )
    yield (
        "all-invalid.h5",
        fourd((0, [[NOT_MEASURED] * 2] * 2)),
        {**corrupt, "match": "no point was measured"},
    )
    yield (
        "nanometres.h5",
        fourd((0, ROWS), height_units=np.bytes_(b"nm")),
        {"error": "UnsupportedFeatureError", "match": "height_units"},
    )


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, content, truth in cases():
        (folder / "samples" / name).write_bytes(content)
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

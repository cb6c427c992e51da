"""Write the samples of Mx files with h5py alone; metrosep is not imported. They are synthetic.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import sys
from pathlib import Path

import h5py
import numpy as np

NO_DATA = 1.7976931348623157e308
TEXT = "S40"
ROWS = [  # top row first: the hole top right, the largest value bottom left
    [1.0, 2.0, NO_DATA],
    [-4.0, 8.0, 16.0],
    [64.0, -32.0, 0.5],
]
OTHER = [[7.0, 5.0], [3.0, NO_DATA]]
LATERAL = [("category", TEXT), ("base", TEXT), ("more", "<i4"), ("parameters", "<f8", (3,))]


def converter(category, base, step):
    return np.array([(category, base, 0, (0.0, step, 0.0))], dtype=LATERAL)


def surface(handle, name, rows, **changes):
    data = np.array(rows, dtype="<f8") if "dtype" not in changes else np.array(rows, dtype="<i4")
    dataset = handle.create_dataset(f"Data/Surface/{name}", data=data, track_times=False)
    attributes = {
        "Unit": np.array([b"NanoMeters"], dtype=TEXT),
        "No Data": np.array([NO_DATA]),
        "Wavelength": np.array([632.8e-9]),
        "Interferometric Scale Factor": np.array([0.5]),
        "Obliquity Factor": np.array([1.02]),
        "X Converter": converter(b"LateralCat", b"Pixels", 2e-6),
        "Y Converter": converter(b"LateralCat", b"Pixels", 3e-6),
        "Z Converter": converter(b"HeightCat", b"NanoMeters", 1.0),
    }
    changes.pop("dtype", None)
    for key, value in {**attributes, **changes}.items():
        if value is not None:
            dataset.attrs[key] = value


def datx(surfaces, graph, **changes):
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        if graph is not None:
            table = np.array(graph, dtype=[(n, TEXT) for n in ("Source", "Link", "Destination")])
            handle.create_dataset("MetaData", data=table, track_times=False)
        general = handle.create_group("Attributes/{A0}")
        general.attrs["Data Context.Lateral Resolution:Value"] = np.array([2e-6])
        for name, rows in surfaces.items():
            surface(handle, name, rows, **changes)
    return stream.getvalue()


def graph(*names):
    rows = [("Root", "Measurement", "{M}"), ("{M}", "Note", "x")]
    for number, name in enumerate(names):
        rows.append(("{M}", "Surface", f"{{S{number}}}"))
        rows.append((f"{{S{number}}}", "Path", f"/Data/Surface/{name}"))
    return rows


def expected(rows, factor=1e-9, dx=2e-6, dy=3e-6):
    z = [[None if v == NO_DATA else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [len(z), len(z[0])], "dx_m": dx, "dy_m": dy, "z_m": z}


FRINGES = {"Unit": np.array([b"Fringes"], dtype=TEXT)}


def cases():
    one = {"{B}": ROWS}
    two = {"{A}": OTHER, "{B}": ROWS}
    yield "nanometres.datx", datx(one, graph("{B}")), expected(ROWS)
    yield (
        "fringes.datx",
        datx(one, graph("{B}"), **FRINGES),
        {
            **expected(ROWS, 0.5 * 1.02 * 632.8e-9),
            "warnings_match": "Unit was taken",
        },
    )
    yield "second-is-linked.datx", datx(two, graph("{B}")), expected(ROWS)
    yield (
        "not-linked.datx",
        datx(two, [("Root", "Other", "{M}")]),
        {**expected(OTHER), "warnings_match": "channel="},
    )
    yield (
        "uncalibrated.datx",
        datx(one, graph("{B}"), **{"X Converter": None, "Y Converter": None}),
        {**expected(ROWS, dx=None, dy=None), "warnings_match": "not calibrated"},
    )
    yield (
        "whole-numbers.datx",
        datx({"{B}": OTHER[:1]}, graph("{B}"), dtype="<i4"),
        {"error": "UnsupportedFeatureError", "match": "whole numbers"},
    )
    yield (
        "no-wavelength.datx",
        datx(one, graph("{B}"), **FRINGES, Wavelength=None),
        {"error": "CorruptFileError", "match": "Wavelength"},
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

"""Write the samples of metrosep's HDF5 with h5py alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import sys
from pathlib import Path

import h5py
import numpy as np

NAN = float("nan")
Z = [[1e-9, 2e-9, NAN], [-4e-9, 1 / 3 * 1e-9, 50e-9]]


def text(handle, name, value):
    data = np.frombuffer(json.dumps(value).encode(), dtype=np.uint8)
    handle.create_dataset(name, data=data, track_times=False)


def new(stream, kind, version=1):
    handle = h5py.File(stream, "w", libver="earliest")
    handle.attrs["metrosep_format"] = "metrosep-h5"
    handle.attrs["layout_version"] = version
    handle.attrs["metrosep_version"] = "0.1.0"
    handle.attrs["kind"] = kind
    text(handle, "history_json", [])
    text(handle, "metadata_json", {"operator": "Jane", "window": {"__tuple__": [1, 2]}})
    return handle


def surface(version=1, dx=1.5e-6):
    stream = io.BytesIO()
    with new(stream, "surface", version) as handle:
        data = handle.create_dataset("z", data=np.array(Z), track_times=False)
        if dx is not None:
            data.attrs["dx_m"], data.attrs["dy_m"] = dx, 2.5e-6
        data.attrs["origin_m"] = (1e-3, -2e-3)
    return stream.getvalue()


def profile():
    stream = io.BytesIO()
    with new(stream, "profile") as handle:
        handle.create_dataset("x", data=np.array([0.0, 1e-3, 3e-3]), track_times=False)
        handle.create_dataset("z", data=np.array([1e-9, NAN, -7e-9]), track_times=False)
    return stream.getvalue()


def recording():
    stream = io.BytesIO()
    with new(stream, "recording") as handle:
        handle.create_dataset("t", data=np.array([0.0, 0.5, 1.5]), track_times=False)
        channel = handle.create_dataset(
            "channels/0000", data=np.array([1e-6, 2e-6, NAN]), track_times=False
        )
        channel.attrs["name"], channel.attrs["unit"] = "gap/left", "m"
    return stream.getvalue()


def plain(rows):
    return [[None if v != v else v for v in row] for row in rows]


def main(folder):
    shape = {"kind": "surface", "shape": [2, 3], "z_m": plain(Z), "origin_m": [1e-3, -2e-3]}
    cases = {
        "surface.h5": (surface(), {**shape, "dx_m": 1.5e-6, "dy_m": 2.5e-6}),
        "uncalibrated.h5": (surface(dx=None), {**shape, "dx_m": None, "dy_m": None}),
        "profile.h5": (
            profile(),
            {
                "kind": "profile",
                "shape": [3],
                "x_m": [0.0, 1e-3, 3e-3],
                "z_m": [1e-9, None, -7e-9],
            },
        ),
        "recording.h5": (
            recording(),
            {
                "kind": "recording",
                "t_s": [0.0, 0.5, 1.5],
                "channels": {"gap/left": [1e-6, 2e-6, None]},
            },
        ),
        "later-layout.h5": (
            surface(version=2),
            {"error": "UnsupportedFeatureError", "match": "layout version 2"},
        ),
    }
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (content, truth) in cases.items():
        (folder / "samples" / name).write_bytes(content)
        encoded = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(encoded, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

"""Write the samples of plain HDF5 with h5py alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import sys
from pathlib import Path

import h5py
import numpy as np

Z = np.array([[1.0, 2.0, -3.0], [4.0, np.nan, 60.0]])
T = np.array([0.0, 0.5, 1.0, 1.5])
GAP = np.array([1.0, -2.0, np.nan, 4.0])


def packed(fill):
    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        fill(handle)
    return stream.getvalue()


def put(handle, name, data, unit=None, **storage):
    dataset = handle.create_dataset(name, data=data, track_times=False, **storage)
    if unit is not None:
        dataset.attrs["units"] = np.bytes_(unit)


def one_map(handle):
    put(handle, "scan/z", Z.astype(np.float32), "nm")


def packed_map(handle):
    put(handle, "z", Z, chunks=(1, 2), compression="gzip", shuffle=True)


def two_maps(handle):
    put(handle, "first", Z * 2, "nm")
    put(handle, "second", Z, "um")


def lines(handle):
    put(handle, "daq/time", (T * 1000).astype(">i4"), "ms")
    put(handle, "daq/gap", GAP, "um")
    put(handle, "daq/raw", np.arange(4, dtype=np.uint16))
    put(handle, "gain", np.array([7.0]))


def outside(handle):
    handle["z"] = h5py.ExternalLink("other.h5", "/z")


def plain(values, factor):
    return [[None if v != v else float(v) * factor for v in row] for row in values]


def surface(factor, **more):
    return {
        "kind": "surface",
        "shape": [2, 3],
        "dx_m": None,
        "dy_m": None,
        "z_m": plain(Z, factor),
        "warnings_match": "which row is on top",
        **more,
    }


def main(folder):
    stepped = {"unit": "nm", "lateral_step": ["2 um", "3 um"]}
    cases = {
        "one-map.h5": (one_map, surface(1e-9)),
        "packed-map.h5": (
            packed_map,
            surface(1e-9, options=stepped, dx_m=2e-6, dy_m=3e-6),
        ),
        "second-of-two.h5": (two_maps, surface(1e-6, options={"channel": "/second"})),
        "no-choice.h5": (two_maps, {"error": "FormatMismatchError", "match": "choose one with"}),
        "no-unit.h5": (packed_map, {"error": "UnitError", "match": "declares no unit"}),
        "recording.h5": (
            lines,
            {
                "kind": "recording",
                "t_s": [float(t) for t in T],
                "channels": {
                    "/daq/gap": [1e-6, -2e-6, None, 4e-6],
                    "/daq/raw": [0.0, 1.0, 2.0, 3.0],
                },
            },
        ),
        "link-outside.h5": (outside, {"error": "FormatMismatchError", "match": "no dataset"}),
    }
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (fill, truth) in cases.items():
        (folder / "samples" / name).write_bytes(packed(fill))
        encoded = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(encoded, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)

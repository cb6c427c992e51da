"""metrosep's own HDF5: any object with everything it carries; the same object gives the same bytes.

Layout version 1: attributes of the root say what it is; numbers are contiguous float64 datasets in
SI; history and metadata are UTF-8 JSON in datasets of bytes. See ``data_formats/metrosep-h5``.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep._version import __version__
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.io.native_json import encode_history, encode_mapping

__all__ = ["FORMAT", "LAYOUT_VERSION", "native_bytes"]

FORMAT = "metrosep-h5"
LAYOUT_VERSION = 1


def native_bytes(obj: Surface | Profile | Recording | RunSet) -> bytes:
    """Return an object as the content of an HDF5 file."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        handle.attrs["metrosep_format"] = FORMAT
        handle.attrs["layout_version"] = LAYOUT_VERSION
        handle.attrs["metrosep_version"] = __version__
        handle.attrs["kind"] = type(obj).__name__.lower()
        _put_text(handle, "history_json", encode_history(obj.history))
        _put_text(handle, "metadata_json", encode_mapping(obj.metadata))
        _PUT[type(obj)](handle, obj)
    return stream.getvalue()


def _put(group: Any, name: str, values: ArrayLike, unit: str | None) -> None:
    data = np.ascontiguousarray(values, dtype=np.float64)
    dataset = group.create_dataset(name, data=data, track_times=False)
    if unit is not None:
        dataset.attrs["unit"] = unit


def _put_text(group: Any, name: str, content: bytes) -> None:
    group.create_dataset(name, data=np.frombuffer(content, dtype=np.uint8), track_times=False)


def _put_surface(handle: Any, surface: Surface) -> None:
    _put(handle, "z", surface.z, "m")
    for name, step in (("dx_m", surface.dx), ("dy_m", surface.dy)):
        if step is not None:
            handle["z"].attrs[name] = step
    handle["z"].attrs["origin_m"] = surface.origin


def _put_profile(handle: Any, profile: Profile) -> None:
    _put(handle, "x", profile.x, "m")
    _put(handle, "z", profile.z, "m")


def _put_recording(handle: Any, recording: Recording) -> None:
    _put(handle, "t", recording.t, "s")
    group = handle.create_group("channels")
    for i, (name, values) in enumerate(recording.channels.items()):
        _put(group, f"{i:04d}", values, recording.units.get(name))
        group[f"{i:04d}"].attrs["name"] = name


def _put_runs(handle: Any, runs: RunSet) -> None:
    for i, run in enumerate(runs):
        group = handle.create_group(f"runs/{i:04d}")
        _put(group, "x", run.x, "m")
        _put(group, "z", run.z, "m")
        if run.t is not None:
            _put(group, "t", run.t, "s")
        if run.feed is not None:
            group.attrs["feed_m_s"] = run.feed
        group.attrs["run_id"] = run.run_id
        _put_text(group, "metadata_json", encode_mapping(run.metadata))


_PUT: dict[type, Any] = {
    Surface: _put_surface,
    Profile: _put_profile,
    Recording: _put_recording,
    RunSet: _put_runs,
}

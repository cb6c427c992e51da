"""Reader of metrosep's own HDF5: the object that was written, bit for bit.

The history goes on where it ended: the last step says that this file was read.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep._version import __version__
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    FormatMismatchError,
    ReadError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.recording import Recording
from metrosep.core.runset import Run, RunSet
from metrosep.core.surface import Surface
from metrosep.core.units import column_unit
from metrosep.io.containers.hdf5_file import Hdf5File, look_into, open_hdf5
from metrosep.io.objects import only_channels
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["channels", "decode_history", "encode_history", "read", "sniff", "table_bytes"]


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a file of metrosep."""
    handle = look_into(file)
    return Match.YES if handle is not None and _is_own(handle) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the channels of a recording, else the height."""
    with open_hdf5(file) as handle:
        if _kind(file, handle) == "recording":
            return tuple(name for _, name, _ in _channels(handle))
        return ("height",)


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface | Profile | Recording | RunSet:
    """Return the object that was written."""
    refuse_options(file, "an object of metrosep in SI", unit=unit)
    override = lateral_steps(lateral_step)
    with open_hdf5(file) as handle:
        kind = _kind(file, handle)
        if kind not in _READ:
            raise CorruptFileError(
                file.path, "the kind of object is unknown", field="kind", found=repr(kind[:40])
            )
        try:
            metadata = _metadata(file, _json(file, handle, "/metadata_json"))
            parameters = {"lateral_step_m": override} if override else {}
            history = (*_history(file, handle), *file.history(FORMAT, parameters))
            build = _READ[kind]
            return build(file, handle, metadata, history, channel, override, max_pixels)
        except ReadError:
            raise
        except DataError as exc:
            raise CorruptFileError(file.path, f"the numbers do not fit: {exc}") from None


def _is_own(handle: Hdf5File) -> bool:
    return bool(handle.attributes("/").get("metrosep_format") == FORMAT)


def _kind(file: RawFile, handle: Hdf5File) -> str:
    attributes = handle.attributes("/")
    if not _is_own(handle):
        raise FormatMismatchError(
            f"{file.path}: is no HDF5 file of metrosep; leave out format= to have it recognised"
        )
    version = attributes.get("layout_version")
    if version != LAYOUT_VERSION:
        raise UnsupportedFeatureError(
            f"{file.path}: has layout version {str(version)[:20]}, this metrosep reads {LAYOUT_VERSION}; update "
            "metrosep"
        )
    return str(attributes.get("kind"))


def _numbers(
    file: RawFile, handle: Hdf5File, name: str, max_pixels: int | None = None
) -> FloatArray:
    values = handle.read(name, max_pixels=max_pixels)
    if values.dtype != np.float64:
        raise CorruptFileError(
            file.path,
            "a dataset is of another type",
            field=name,
            expected="float64",
            found=str(values.dtype),
        )
    return np.asarray(values, dtype=np.float64)


def _json(file: RawFile, handle: Hdf5File, name: str) -> dict[str, Any]:
    try:
        return decode_mapping(handle.read(name).tobytes())
    except (ValueError, RecursionError) as exc:
        raise CorruptFileError(file.path, f"{name} is no JSON ({exc})") from None


def _history(file: RawFile, handle: Hdf5File) -> tuple[Step, ...]:
    try:
        return decode_history(handle.read("/history_json").tobytes())
    except (ValueError, KeyError, TypeError, RecursionError) as exc:
        raise CorruptFileError(file.path, f"history_json is no history ({exc})") from None


def _metadata(file: RawFile, stored: dict[str, Any]) -> dict[str, Any]:
    """Return the stored metadata under the name of this file; what that replaced stays."""
    own = file.metadata(FORMAT, {"layout_version": LAYOUT_VERSION})
    own.pop("warnings")
    replaced = {k: stored[k] for k in own if k in stored}
    return {"warnings": (), **stored, **own, **({"source": replaced} if replaced else {})}


def _surface(
    file: RawFile,
    handle: Hdf5File,
    metadata: dict[str, Any],
    history: tuple[Step, ...],
    channel: str | None,
    override: tuple[float, float] | None,
    max_pixels: int | None,
) -> Surface:
    only_channels(file, FORMAT, channel)
    z = _numbers(file, handle, "/z", max_pixels)
    if z.ndim != 2 or np.isnan(z).all():
        raise CorruptFileError(file.path, "the map has no heights", field="z", found=z.shape)
    attributes = handle.attributes("/z")
    origin = attributes.get("origin_m", [0.0, 0.0])
    own = (attributes.get("dx_m"), attributes.get("dy_m"))
    try:
        x, y = (float(v) for v in origin)
        steps = tuple(None if s is None else float(s) for s in own)
    except (TypeError, ValueError):
        raise CorruptFileError(
            file.path, "steps or origin are no numbers", field="z", found=f"{own}, {origin}"[:80]
        ) from None
    dx, dy = override or steps
    facts = {
        "row_order_in_file": "smallest y first",
        "lateral_step_in_file_m": steps,
        "lateral_step_override_m": override,
    }
    return Surface(z, dx, dy, origin=(x, y), metadata={**metadata, **facts}, history=history)


def _profile(
    file: RawFile,
    handle: Hdf5File,
    metadata: dict[str, Any],
    history: tuple[Step, ...],
    channel: str | None,
    override: tuple[float, float] | None,
    max_pixels: int | None,
) -> Profile:
    only_channels(file, FORMAT, channel)
    refuse_options(file, "a profile with its own positions", lateral_step=override)
    x, z = (_numbers(file, handle, n, max_pixels) for n in ("/x", "/z"))
    if np.isnan(z).all():
        raise CorruptFileError(file.path, "no point was measured", field="z")
    return Profile(x, z, metadata=metadata, history=history)


def _recording(
    file: RawFile,
    handle: Hdf5File,
    metadata: dict[str, Any],
    history: tuple[Step, ...],
    channel: str | None,
    override: tuple[float, float] | None,
    max_pixels: int | None,
) -> Recording:
    refuse_options(file, "a recording", lateral_step=override)
    parts = _channels(handle)
    if channel is not None:
        wanted = only_channels(file, FORMAT, channel, tuple(name for _, name, _ in parts))
        parts = [p for p in parts if p[1] == wanted]
    values = {name: _numbers(file, handle, key, max_pixels) for key, name, _ in parts}
    units = {name: unit for _, name, unit in parts if unit is not None}
    if not any(np.isfinite(v).any() for v in values.values()):
        raise CorruptFileError(file.path, "no channel holds a number", field="channels")
    t = _numbers(file, handle, "/t", max_pixels)
    return Recording(t, values, units=units, metadata=metadata, history=history)


def _channels(handle: Hdf5File) -> list[tuple[str, str, str | None]]:
    """Return path, name and unit of each channel of a recording."""
    found: list[tuple[str, str, str | None]] = []
    for key in handle.datasets:
        if key.startswith("/channels/"):
            own = handle.attributes(key)
            unit = str(own["unit"]) if "unit" in own else None
            found.append((key, str(own.get("name", key.rsplit("/", 1)[-1])), unit))
    return found


def _runset(
    file: RawFile,
    handle: Hdf5File,
    metadata: dict[str, Any],
    history: tuple[Step, ...],
    channel: str | None,
    override: tuple[float, float] | None,
    max_pixels: int | None,
) -> RunSet:
    only_channels(file, FORMAT, channel)
    refuse_options(file, "a set of runs with their own positions", lateral_step=override)
    groups = [g for g in handle.groups if g.startswith("/runs/")]
    runs = [_run(file, handle, name, max_pixels) for name in groups]
    return RunSet(runs, metadata=metadata, history=history)


def _run(file: RawFile, handle: Hdf5File, group: str, max_pixels: int | None) -> Run:
    attributes = handle.attributes(group)
    feed = attributes.get("feed_m_s")
    try:
        speed = None if feed is None else float(feed)
    except (TypeError, ValueError):
        raise CorruptFileError(
            file.path, "the feed is no number", field=f"{group} feed_m_s", found=repr(feed)[:40]
        ) from None
    return Run(
        _numbers(file, handle, f"{group}/x", max_pixels),
        _numbers(file, handle, f"{group}/z", max_pixels),
        t=_numbers(file, handle, f"{group}/t", max_pixels) if f"{group}/t" in handle else None,
        feed=speed,
        run_id=str(attributes.get("run_id", "")),
        metadata=_json(file, handle, f"{group}/metadata_json"),
    )


_READ: dict[str, Callable[..., Surface | Profile | Recording | RunSet]] = {
    "surface": _surface,
    "profile": _profile,
    "recording": _recording,
    "runset": _runset,
}


# ---- metrosep's own HDF5: any object with everything it carries; the same object gives the same bytes ----
# Layout version 1: attributes of the root say what it is; numbers are contiguous float64 datasets in
# SI; history and metadata are UTF-8 JSON in datasets of bytes. See ``data_formats/metrosep-h5``.

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


# ---- history and metadata as JSON that gives the same Python values back -----------------------
# Tuples, NaN and infinities are marked, since JSON has none; whatever else JSON lacks becomes text.

_TUPLE, _NUMBER = "__tuple__", "__number__"


def encode_mapping(values: Mapping[str, Any]) -> bytes:
    """Return a mapping as UTF-8 JSON with sorted keys."""
    return json.dumps(_encode(values), sort_keys=True, allow_nan=False).encode()


def decode_mapping(data: bytes) -> dict[str, Any]:
    """Return the mapping of `encode_mapping`."""
    found = _decode(json.loads(data))
    if not isinstance(found, dict):
        raise ValueError("a mapping was expected")  # noqa: TRY004  (one error for the reader)
    return found


def encode_history(history: tuple[Step, ...]) -> bytes:
    """Return a history as UTF-8 JSON."""
    return json.dumps(_encode(history_as_dicts(history)), sort_keys=True, allow_nan=False).encode()


def decode_history(data: bytes) -> tuple[Step, ...]:
    """Return the history of `encode_history`."""
    entries = _decode(json.loads(data))
    return tuple(Step(str(e["step"]), e["parameters"], str(e["version"])) for e in entries)


def _encode(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _encode(v) for k, v in value.items()}
    if isinstance(value, tuple):
        return {_TUPLE: [_encode(v) for v in value]}
    if isinstance(value, list):
        return [_encode(v) for v in value]
    if isinstance(value, np.ndarray):
        return _encode(value.tolist())
    if isinstance(value, np.generic):
        return _encode(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return {_NUMBER: repr(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)


def _decode(value: Any) -> Any:
    if isinstance(value, list):
        return [_decode(v) for v in value]
    if not isinstance(value, dict):
        return value
    if value.keys() == {_TUPLE}:
        return tuple(_decode(v) for v in value[_TUPLE])
    if value.keys() == {_NUMBER}:
        return float(value[_NUMBER])
    return {k: _decode(v) for k, v in value.items()}


# ---- A table as HDF5: a dataset for each column, with its unit, and where it comes from --------
# Any HDF5 program reads it, and so does `metrosep.read` with ``x`` and ``z`` naming columns. The same
# table gives the same bytes.

TABLE_VERSION = 1


def table_bytes(
    columns: Mapping[str, Sequence[Any] | NDArray[Any]], provenance: Mapping[str, str]
) -> bytes:
    """Return a table as the content of an HDF5 file."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        handle.attrs["metrosep_table"] = TABLE_VERSION
        handle.attrs["metrosep_version"] = __version__
        n = {len(values) for values in columns.values()}
        if len(n) > 1:
            raise WriteError(f"columns of {min(n)} and {max(n)} rows are no table")
        for i, (name, values) in enumerate(columns.items()):
            key = name.replace("/", "_")
            if key in handle or key in ("", ".", "provenance"):
                raise WriteError(f"column {name!r} has no name of its own in HDF5; rename it")
            dataset = handle.create_dataset(key, data=_array(values), track_times=False)
            dataset.attrs["name"] = name
            dataset.attrs["column"] = i
            unit = _unit(name)
            if unit is not None:
                dataset.attrs["unit"] = unit
        group = handle.create_group("provenance")
        for name, text in provenance.items():
            values = _texts([text])
            group.create_dataset(name, (), values.dtype, values[0], track_times=False)
    return stream.getvalue()


_NO_LENGTH = frozenset({"zernike_m"})
"""Names that end as a unit does: this is the azimuthal order of a term."""


def _unit(name: str) -> str | None:
    if name in _NO_LENGTH:
        return None
    bare, unit = column_unit(name)
    # a unit that is not known, such as rev_per_s, must not be taken for its last piece
    return None if unit is None or bare.endswith("_per") else unit.name


def _array(values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
    array = np.asarray(values)
    if array.dtype.kind in "iub":
        return array.astype(np.int64)
    if array.dtype.kind == "f" or all(v is None or isinstance(v, int | float) for v in values):
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
    return _texts(["" if v is None else str(v) for v in values])


def _texts(texts: Sequence[str]) -> NDArray[Any]:
    """Return UTF-8 of one length, as HDF5 stores it."""
    import h5py

    coded = [t.encode("utf-8", "backslashreplace") for t in texts]
    longest = max((len(c) for c in coded), default=0)
    return np.array(coded, dtype=h5py.string_dtype("utf-8", max(longest, 1)))

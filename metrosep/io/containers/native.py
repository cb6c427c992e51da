"""Reader of metrosep's own HDF5: the object that was written, bit for bit.

The history goes on where it ended: the last step says that this file was read.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep._version import __version__
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    ReadError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.core.runset import Run, RunSet
from metrosep.core.surface import Surface
from metrosep.core.units import column_unit
from metrosep.io.containers.hdf5_file import Hdf5File, open_hdf5
from metrosep.io.objects import only_channels
from metrosep.io.own_notes import decode_history, decode_mapping, encode_history, encode_mapping
from metrosep.io.registry import mismatch, sniffer
from metrosep.io.source import RawFile, declared_steps, refuse_options

FORMAT = "metrosep-h5"
sniff = sniffer(FORMAT)


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
    override = declared_steps(lateral_step)
    with open_hdf5(file) as handle:
        kind = _kind(file, handle)
        if kind not in _READ:
            raise file.corrupt(
                "the kind of object is unknown", field="kind", found=repr(kind[:40])
            )
        try:
            stored = _json(file, handle, "/metadata_json")
            metadata = stored_metadata(file, stored, FORMAT, {"layout_version": LAYOUT_VERSION})
            parameters = {"lateral_step_m": override} if override else {}
            history = (*_history(file, handle), *file.history(FORMAT, parameters))
            opened = _Stored(file, handle, channel, override, max_pixels)
            return _READ[kind](opened, metadata, history)
        except ReadError:
            raise
        except DataError as exc:
            raise file.corrupt(f"the numbers do not fit: {exc}") from None


def _kind(file: RawFile, handle: Hdf5File) -> str:
    attributes = handle.attributes("/")
    if attributes.get("metrosep_format") != FORMAT:
        raise mismatch(file, FORMAT)
    version = attributes.get("layout_version")
    if version != LAYOUT_VERSION:
        raise UnsupportedFeatureError(
            f"{file.path}: has layout version {str(version)[:20]}, this metrosep reads {LAYOUT_VERSION}; update "
            "metrosep"
        )
    return str(attributes.get("kind"))


def _json(file: RawFile, handle: Hdf5File, name: str) -> dict[str, Any]:
    content = handle.read(name).tobytes()
    try:
        return decode_mapping(content)
    except (ValueError, RecursionError) as exc:
        raise file.corrupt(f"{name} is not JSON ({exc})") from None


def _history(file: RawFile, handle: Hdf5File) -> tuple[Step, ...]:
    content = handle.read("/history_json").tobytes()
    try:
        return decode_history(content)
    except (ValueError, KeyError, TypeError, RecursionError) as exc:
        raise file.corrupt(f"history_json is not a history ({exc})") from None


def stored_metadata(
    file: RawFile, stored: Mapping[str, Any], format_id: str, header: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the stored metadata under the name of this file; what that replaced stays."""
    own = file.metadata(format_id, header)
    own.pop("warnings")
    replaced = {k: stored[k] for k in own if k in stored}
    return {"warnings": (), **stored, **own, **({"source": replaced} if replaced else {})}


class _Stored(NamedTuple):
    """An open file of metrosep, and what the caller asked for."""

    file: RawFile
    handle: Hdf5File
    channel: str | None
    override: tuple[float, float] | None
    max_pixels: int | None

    def numbers(self, name: str) -> FloatArray:
        """Return a dataset of float64."""
        values = self.handle.read(name, max_pixels=self.max_pixels)
        if values.dtype != np.float64:
            raise self.file.corrupt(
                "a dataset is of another type",
                field=name,
                expected="float64",
                found=str(values.dtype),
            )
        return np.asarray(values, dtype=np.float64)

    def demand_one(self, title: str = "") -> None:
        """Refuse a channel that there is not, and steps for what has positions."""
        only_channels(self.file, FORMAT, self.channel)
        if title:
            refuse_options(self.file, title, lateral_step=self.override)


def _surface(stored: _Stored, metadata: dict[str, Any], history: tuple[Step, ...]) -> Surface:
    stored.demand_one()
    z = stored.numbers("/z")
    file = stored.file
    if z.ndim != 2:
        raise file.corrupt("the heights are not rows of a map", field="z", found=z.shape)
    if np.isnan(z).all():
        raise _empty(file)
    attributes = stored.handle.attributes("/z")
    origin = attributes.get("origin_m", [0.0, 0.0])
    own = (attributes.get("dx_m"), attributes.get("dy_m"))
    try:
        x, y = (float(v) for v in origin)
        steps = tuple(None if s is None else float(s) for s in own)
    except (TypeError, ValueError):
        raise file.corrupt(
            "steps or origin are not numbers", field="z", found=f"{own}, {origin}"[:80]
        ) from None
    dx, dy = stored.override or steps
    facts = {
        "row_order_in_file": "smallest y first",
        "lateral_step_in_file_m": steps,
        "lateral_step_override_m": stored.override,
    }
    metadata = {"orientation_evidence": "standard", **metadata, **facts}
    return Surface(z, dx, dy, origin=(x, y), metadata=metadata, history=history)


def _profile(stored: _Stored, metadata: dict[str, Any], history: tuple[Step, ...]) -> Profile:
    stored.demand_one("a profile with its own positions")
    x, z = (stored.numbers(n) for n in ("/x", "/z"))
    if np.isnan(z).all():
        raise _empty(stored.file)
    return Profile(x, z, metadata=metadata, history=history)


def _empty(file: RawFile) -> ReadError:
    return file.corrupt(
        "no point was measured", hint="write the object again from before it was masked"
    )


def _recording(stored: _Stored, metadata: dict[str, Any], history: tuple[Step, ...]) -> Recording:
    file, channel = stored.file, stored.channel
    refuse_options(file, "a recording", lateral_step=stored.override)
    parts = _channels(stored.handle)
    if channel is not None:
        wanted = only_channels(file, FORMAT, channel, tuple(name for _, name, _ in parts))
        parts = [p for p in parts if p[1] == wanted]
    values = {name: stored.numbers(key) for key, name, _ in parts}
    units = {name: unit for _, name, unit in parts if unit is not None}
    if not any(np.isfinite(v).any() for v in values.values()):
        raise file.corrupt("no channel holds a number", field="channels")
    t = stored.numbers("/t")
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


def _runset(stored: _Stored, metadata: dict[str, Any], history: tuple[Step, ...]) -> RunSet:
    stored.demand_one("a set of runs with their own positions")
    groups = [g for g in stored.handle.groups if g.startswith("/runs/")]
    return RunSet([_run(stored, g) for g in groups], metadata=metadata, history=history)


def _run(stored: _Stored, group: str) -> Run:
    attributes = stored.handle.attributes(group)
    feed = attributes.get("feed_m_s")
    try:
        speed = None if feed is None else float(feed)
    except (TypeError, ValueError):
        raise stored.file.corrupt(
            "the feed is not a number", field=f"{group} feed_m_s", found=repr(feed)[:40]
        ) from None
    return Run(
        stored.numbers(f"{group}/x"),
        stored.numbers(f"{group}/z"),
        t=stored.numbers(f"{group}/t") if f"{group}/t" in stored.handle else None,
        feed=speed,
        run_id=str(attributes.get("run_id", "")),
        metadata=_json(stored.file, stored.handle, f"{group}/metadata_json"),
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

LAYOUT_VERSION = 1


def native_bytes(obj: Surface | Profile | Recording | RunSet) -> bytes:
    """Return an object as the content of an HDF5 file; what no reader takes, heights all missing, is refused."""
    if isinstance(obj, Surface | Profile) and np.isnan(obj.z).all():
        raise WriteError("nothing was measured, so there is nothing to write as HDF5")
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        handle.attrs["metrosep_format"] = FORMAT
        handle.attrs["layout_version"] = LAYOUT_VERSION
        handle.attrs["metrosep_version"] = __version__
        handle.attrs["kind"] = type(obj).__name__.lower()
        _put_text(handle, "history_json", encode_history(obj.history))
        _put_text(handle, "metadata_json", encode_mapping(obj.metadata))
        _put_object(handle, obj)
    return stream.getvalue()


def _put(group: Any, name: str, values: ArrayLike, unit: str | None) -> None:
    data = np.ascontiguousarray(values, dtype=np.float64)
    dataset = group.create_dataset(name, data=data, track_times=False)
    if unit is not None:
        dataset.attrs["unit"] = unit


def _put_text(group: Any, name: str, content: bytes) -> None:
    group.create_dataset(name, data=np.frombuffer(content, dtype=np.uint8), track_times=False)


def _put_object(handle: Any, obj: Surface | Profile | Recording | RunSet) -> None:
    if isinstance(obj, Surface):
        _put(handle, "z", obj.z, "m")
        for name, step in (("dx_m", obj.dx), ("dy_m", obj.dy)):
            if step is not None:
                handle["z"].attrs[name] = step
        handle["z"].attrs["origin_m"] = obj.origin
    elif isinstance(obj, Profile):
        _put(handle, "x", obj.x, "m")
        _put(handle, "z", obj.z, "m")
    elif isinstance(obj, Recording):
        _put(handle, "t", obj.t, "s")
        group = handle.create_group("channels")
        for i, (name, values) in enumerate(obj.channels.items()):
            _put(group, f"{i:04d}", values, obj.units.get(name))
            group[f"{i:04d}"].attrs["name"] = name
    else:
        for i, run in enumerate(obj):
            _put_run(handle.create_group(f"runs/{i:04d}"), run)


def _put_run(group: Any, run: Run) -> None:
    _put(group, "x", run.x, "m")
    _put(group, "z", run.z, "m")
    if run.t is not None:
        _put(group, "t", run.t, "s")
    if run.feed is not None:
        group.attrs["feed_m_s"] = run.feed
    group.attrs["run_id"] = run.run_id
    _put_text(group, "metadata_json", encode_mapping(run.metadata))


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
            raise WriteError(f"columns of {min(n)} and {max(n)} rows are not a table")
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

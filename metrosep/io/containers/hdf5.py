"""Plain HDF5: datasets that other programs wrote, with the units that attributes or callers declare.

Two-dimensional datasets are maps, one-dimensional ones of one length are the columns of a table.
The special formats on HDF5 (4D, Zygo Mx, MATLAB, metrosep's own) have readers of their own.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FormatMismatchError, ReadNameError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.public import state_of
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.units import Unit
from metrosep.io._roles import ColumnSpec
from metrosep.io.containers.hdf5_file import Hdf5File, open_hdf5
from metrosep.io.declared import Match
from metrosep.io.registry import get, sniffer
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.dialect import header_unit
from metrosep.io.text.measurement import columns_as_object, map_as_surface, unit_label, unit_of

FORMAT = "hdf5"

_FIRST_INVALID = 1e38


sniff = sniffer(FORMAT)


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the datasets of numbers with one or two dimensions."""
    with open_hdf5(file) as handle:
        if _SCHEMA in handle.attributes("/"):
            return ("height",)
        return tuple(n for n in handle.datasets if _dimensions(handle, n) in (1, 2))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
    max_pixels: int | None = None,
    row_order: str | None = None,
) -> Surface | Profile | Recording | RunSet:
    """Return a map, the columns of one length, or what metrosep saved."""
    if (saved := saved_object(file)) is not None:
        title = "an object that metrosep saved, in SI"
        columns_asked = {"x": x, "z": z, "time": time, "sampling_rate": sampling_rate}
        refuse_options(
            file,
            title,
            channel=channel,
            lateral_step=lateral_step,
            unit=unit,
            scale=scale,
            **columns_asked,
        )
        return saved
    with open_hdf5(file) as handle:
        if channel is None:
            _refuse_special(file)
        maps = [n for n in handle.datasets if _dimensions(handle, n) == 2]
        lines = [n for n in handle.datasets if _dimensions(handle, n) == 1]
        asked = (x, z, time, sampling_rate)
        header = {n: handle.attributes(n) for n in (*handle.groups, *maps, *lines)}
        if channel in maps or (channel is None and len(maps) == 1 and not any(asked)):
            name = channel or maps[0]
            values = _values(file, handle, name, max_pixels)
            return map_as_surface(
                file,
                FORMAT,
                values,
                name=name,
                own_unit=unit_of(handle.attributes(name)),
                unit=unit,
                lateral_step=lateral_step,
                scale=scale,
                row_order=row_order,
                header=header,
            )
        columns = {
            n: (_values(file, handle, n, max_pixels), _own_unit(file, n, handle.attributes(n)))
            for n in _chosen(file, handle, lines, maps, channel)
        }
    x, z, time = (_as_path(asked, columns) for asked in (x, z, time))
    if not any(np.isfinite(v).any() for v, _ in columns.values()):
        raise file.corrupt("no dataset holds a number")
    return columns_as_object(
        file,
        FORMAT,
        columns,
        header,
        lateral_step=lateral_step,
        unit=unit,
        x=x,
        z=z,
        time=time,
        sampling_rate=sampling_rate,
        scale=scale,
    )


def _own_unit(file: RawFile, name: str, attributes: Mapping[str, Any]) -> Unit | None:
    """Return the unit of a dataset: its attributes declare it, else its name, also the one in an attribute."""
    if unit_label(attributes):
        return unit_of(attributes)
    own, shown = (header_unit(n)[1] for n in (name, str(attributes.get("name") or "")))
    if own is not None and shown is not None and own != shown:
        raise UnitError(
            f"{file.path}: dataset {name!r} is in {own.name} by its name, but in {shown.name} by its attribute 'name' "
            f"({attributes['name']!r}); correct one of them"
        )
    return own or shown


_SCHEMA = "metrosep_schema"
_KINDS = {kind.__name__: kind for kind in (Surface, Profile, Recording, RunSet)}


def saved_object(file: RawFile) -> Surface | Profile | Recording | RunSet | None:
    """Return the measurement that its method ``save`` wrote, None for a file of others."""
    with open_hdf5(file) as handle:
        attributes = handle.attributes("/")
    if _SCHEMA not in attributes:
        return None
    name = str(attributes.get("metrosep_class")).rpartition(":")[2]
    if name not in _KINDS:
        raise FormatMismatchError(
            f"{file.path}: holds an object of metrosep ({name[:40]}), not a measurement; use metrosep.load"
        )
    from metrosep.io.containers.native import stored_metadata
    from metrosep.io.saved import restored

    made = restored(file.data, file.path)
    if type(made) is not _KINDS[name]:
        raise file.corrupt("the object is not of the class that the file names", expected=name)
    schema = str(attributes[_SCHEMA])
    try:
        state = dict(state_of(made))
        state["metadata"] = stored_metadata(file, state["metadata"], FORMAT, {_SCHEMA: schema})
        state["history"] = (*state["history"], *file.history(FORMAT))
        return _KINDS[name](**state)  # by the constructor, which checks the numbers
    except (DataError, KeyError, TypeError, ValueError) as exc:
        raise file.corrupt(f"the numbers do not fit: {exc}") from None


def _as_path(asked: ColumnSpec | None, columns: Container[str]) -> ColumnSpec | None:
    """Return a column that is named without the slash of the top as its path."""
    if asked is None or asked in columns:
        return asked
    name = asked.partition(":")[0] if isinstance(asked, str) else asked[0]
    if name.startswith("/") or f"/{name}" not in columns:
        return asked
    return f"/{asked}" if isinstance(asked, str) else (f"/{name}", asked[1])


def _dimensions(handle: Hdf5File, name: str) -> int:
    shape = handle.shape(name)
    return len(shape) if handle.is_numeric(name) and 0 not in shape else 0


def physical_values(
    file: RawFile, name: str, raw: NDArray[Any], attributes: Mapping[str, Any]
) -> FloatArray:
    """Return stored numbers as the attributes say that they are meant."""
    values = np.array(raw, dtype=np.float64)
    missing = ~(np.abs(values) < _FIRST_INVALID)
    for key in ("_FillValue", "missing_value"):
        if is_number(attributes.get(key)):
            missing |= values == float(attributes[key])
    factors = [attributes.get("scale_factor", 1.0), attributes.get("add_offset", 0.0)]
    if not all(is_number(f) and abs(f) < _FIRST_INVALID for f in factors) or factors[0] == 0:
        raise file.corrupt(
            "scale_factor or add_offset is not usable", field=name, found=repr(factors)[:60]
        )
    if factors != [1.0, 0.0]:
        values = values * float(factors[0]) + float(factors[1])
    values[missing] = np.nan
    return values


def is_number(value: Any) -> bool:
    """Return whether an attribute is one real number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _values(file: RawFile, handle: Hdf5File, name: str, max_pixels: int | None) -> FloatArray:
    raw = handle.read(name, max_pixels=max_pixels)
    return physical_values(file, name, raw, handle.attributes(name))


def _refuse_special(file: RawFile) -> None:
    """Name the reader of a special format for a file that was declared to be plain HDF5."""
    for found in ("metrosep-h5", "fourd", "datx"):
        if get(found).recognise(file) is not Match.YES:
            continue
        raise FormatMismatchError(
            f"{file.path}: is laid out as {found}; read it with format={found!r}, or name one dataset "
            "with channel="
        )


def _chosen(
    file: RawFile,
    handle: Hdf5File,
    lines: list[str],
    maps: list[str],
    channel: str | None,
) -> list[str]:
    """Return the lines that are as long as the longest one, or the one asked for and the times."""
    if channel is not None and channel not in lines:
        raise ReadNameError(
            f"{file.path}: has no dataset {channel!r}; there is {_listed([*maps, *lines])}"
        )
    if not lines:
        what = "no dataset of numbers in one or two dimensions"
        if maps:
            what = f"{len(maps)} maps ({_listed(maps)}); choose one with channel={maps[0]!r}"
        raise FormatMismatchError(f"{file.path}: holds {what}")
    length = max(handle.shape(n)[0] for n in ([channel] if channel else lines))
    alike = [n for n in lines if handle.shape(n)[0] == length]
    if channel is None:
        return alike
    return [n for n in alike if n == channel or n.rsplit("/", 1)[-1].lower() in ("t", "time")]


def _listed(names: list[str]) -> str:
    return ", ".join(repr(n) for n in names[:12]) + (" ..." if len(names) > 12 else "") or "none"


# ---- one-dimensional HDF5 datasets in chunks; the file is never loaded as a whole --------------

_TIME_NAMES = frozenset({"t", "time"})


def open_source(file: RawFile, stack: ExitStack) -> Hdf5Source:
    """Return the numeric 1-D datasets of an HDF5 file that are as long as the longest one."""
    handle = stack.enter_context(open_hdf5(file))
    if _SCHEMA in handle.attributes("/"):
        raise FormatMismatchError(
            f"{file.path}: holds an object that metrosep saved, which is not read in parts; use metrosep.read"
        )
    lengths = {
        name: handle.shape(name)[0]
        for name in handle.datasets
        if handle.is_numeric(name) and len(handle.shape(name)) == 1 and not name.endswith("_json")
    }
    longest = max(lengths.values(), default=0)
    if longest < 1:
        raise FormatMismatchError(
            f"{file.path}: holds no one-dimensional dataset of numbers, so there is nothing to stream"
        )
    return Hdf5Source(file, handle, tuple(n for n, k in lengths.items() if k == longest), longest)


class Hdf5Source:
    """Datasets of one length; see `metrosep.io.stream.ChunkSource`."""

    def __init__(
        self, file: RawFile, handle: Hdf5File, names: tuple[str, ...], n_samples: int
    ) -> None:
        self._file, self._handle = file, handle
        shown = [str(handle.attributes(n).get("name") or n) for n in names]
        self._paths = {
            s if shown.count(s) == 1 and (s == n or s not in names) else n: n
            for s, n in zip(shown, names, strict=True)
        }
        self.n_samples: int | None = n_samples
        of_matlab = file.head.startswith(b"MATLAB")  # there x_in is an input
        self._units = {
            p: None
            if of_matlab and p.endswith("_in") and not unit_label(handle.attributes(p))
            else _own_unit(file, p, handle.attributes(p))
            for p in names
        }
        self.labels: Mapping[str, str] = {
            n: unit_label(handle.attributes(p)) or (unit.name if (unit := self._units[p]) else "")
            for n, p in self._paths.items()
        }
        self.time_step = self._step()

    def _step(self) -> float | None:
        n = self.n_samples or 0
        for path in self._paths.values():
            bare = header_unit(path.rsplit("/", 1)[-1])[0].lower()
            if bare in _TIME_NAMES and n > 1:
                first, last = (float(self._values(path, k, k + 1)[0]) for k in (0, n - 1))
                unit = self._units[path]
                step = (last - first) / (n - 1) * (unit.factor if unit is not None else 1.0)
                return step if step > 0.0 else None
        return None

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the datasets, `size` samples at a time."""
        for start in range(0, self.n_samples or 0, size):
            yield {n: self._values(self._paths[n], start, start + size) for n in names}

    def _values(self, path: str, start: int, stop: int) -> FloatArray:
        raw = self._handle.read(path, start=start, stop=stop)
        return physical_values(self._file, path, raw, self._handle.attributes(path))

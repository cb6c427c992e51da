"""Height maps and line profiles of instruments: what all their readers promise, in one place.

Row 0 has the smallest y, column 0 the smallest x, heights are in metres and grow out of the
material, NaN is not measured, a step that is not calibrated is ``None``. A file's own order and
its own steps stay in the metadata.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import CheckedArray, FloatArray
from metrosep.core.errors import (
    AmbiguousFormatError,
    DataError,
    FormatMismatchError,
    ReadError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.io.source import MAX_PIXELS, RawFile, declared_steps, evidence, refuse_options

EVIDENCE = (
    "coordinates", "standard", "pair", "rotation", "writer", "peer", "assumed"
)  # fmt: skip
"""What can show which way up a map lies, declared by each format; `assumed` where nothing does."""

SI_NAMES = {
    "length": "m",
    "angle": "rad",
    "time": "s",
    "frequency": "Hz",
    "speed": "m/s",
    "acceleration": "m/s^2",
    "voltage": "V",
    "torque": "N m",
    "number": "1",
}
"""SI unit of each dimension that a channel can have."""

_Made = TypeVar("_Made", bound=Surface | Profile)

_BLOCK_VALUES = 2**17
"""Values that are scaled at once: they stay in the cache."""

_MAX_LATERAL = 1.0
"""Largest lateral step in m that is taken for a calibration."""


def not_calibrated(title: str) -> WriteError:
    """Return the refusal to write a map without lateral steps, for the caller to raise."""
    return WriteError(
        f"the surface is laterally not calibrated and {title} needs its steps; give them on reading, such as "
        "lateral_step='1 um', or write h5"
    )


def rows_to_write(
    obj: Surface | Profile, title: str
) -> tuple[FloatArray, float, float, tuple[float, float]]:
    """Return heights by rows, steps and origin for a format that has one step; refuse what it cannot hold."""
    if np.isnan(obj.z).all():
        raise WriteError(f"nothing was measured, so there is nothing to write as {title}")
    if isinstance(obj, Profile):
        if not obj.is_uniform:
            raise WriteError(
                f"the points of the profile are not equally spaced and {title} holds one step; resample "
                "the profile, or write X3P or CSV"
            )
        return obj.z[np.newaxis, :], obj.dx, 0.0, (float(obj.x[0]), 0.0)
    if obj.dx is None or obj.dy is None:
        raise not_calibrated(title)
    return obj.z, obj.dx, obj.dy, obj.origin


def height_only(file: RawFile) -> tuple[str, ...]:
    """Return the data sets of a format that holds one map: ``channels`` of its reader."""
    return ("height",)


def only_channels(
    file: RawFile, title: str, channel: str | None, names: Sequence[str] = ("height",)
) -> str:
    """Return the channel to read, the first if none was named."""
    if channel is None:
        return names[0]
    if channel in names:
        return channel
    raise UnsupportedFeatureError(
        f"{file.path}: has no {title} channel {channel!r}; there is "
        f"{', '.join(repr(n) for n in names[:20])}"
    )


def lateral_or_none(
    file: RawFile,
    name: str,
    value: float,
    warnings: list[str],
    *,
    offset: int | None = None,
    factor: float = 1.0,
) -> float | None:
    """Return a lateral step in m, or ``None`` where the file is not calibrated."""
    if value == 0.0:
        return None
    if math.isnan(value):
        warnings.append(f"{name} is NaN: taken as not calibrated")
        return None
    step = float(value) * factor
    if not 0.0 < step <= _MAX_LATERAL:
        raise file.corrupt(
            "the lateral step is not usable",
            field=name,
            offset=offset,
            expected=f"0 (not calibrated) or up to {_MAX_LATERAL / factor:g}",
            found=value,
        )
    return step


def scaled(
    raw: NDArray[Any],
    scale: float,
    invalid: NDArray[np.bool_] | Callable[[NDArray[Any]], NDArray[np.bool_]] | None = None,
    offset: float = 0.0,
    *,
    turned: bool = False,
) -> FloatArray:
    """Return heights in m of raw values, NaN where not measured."""
    z: FloatArray = np.empty(raw.shape, dtype=np.float64)
    target = z[::-1] if turned else z
    native = raw.dtype.newbyteorder("=")
    step = max(1, _BLOCK_VALUES // max(1, raw[:1].size))
    for start in range(0, raw.shape[0], step):
        rows = slice(start, start + step)
        block = raw[rows].astype(native, copy=False)
        with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged file
            np.multiply(block, scale, out=target[rows], dtype=np.float64)
        if offset != 0.0:
            target[rows] += offset
        mask = invalid(block) if callable(invalid) else None if invalid is None else invalid[rows]
        if mask is not None and mask.any():
            target[rows][mask] = np.nan
    return z


def scaled_file(
    file: RawFile,
    offset: int,
    shape: tuple[int, int],
    dtype: str,
    scale: float,
    invalid: Callable[[NDArray[Any]], NDArray[np.bool_]],
    *,
    turned: bool = False,
) -> FloatArray:
    """Return the heights of a map that lies in a file, without loading the file beside them."""
    z: FloatArray = np.empty(shape, dtype=np.float64)
    target = z[::-1] if turned else z
    step = max(1, _BLOCK_VALUES // shape[1])
    buffer: NDArray[Any] = np.empty((min(step, shape[0]), shape[1]), dtype=dtype)
    with file.stream() as stream:
        stream.seek(offset)
        for start in range(0, shape[0], step):
            block = buffer[: min(step, shape[0] - start)]
            n_bytes = stream.readinto(block.reshape(-1).view(np.uint8).data)
            if n_bytes != block.nbytes:
                raise file.corrupt(
                    "the map ends early",
                    offset=offset + start * shape[1] * buffer.itemsize + n_bytes,
                    expected=f"{shape[0]} rows",
                    found=f"{start} and a part",
                )
            target[start : start + step] = scaled(block, scale, invalid)
    return z


def make_surface(
    file: RawFile,
    format_id: str,
    z: FloatArray,
    own_steps: tuple[float | None, float | None],
    *,
    row_order: str,
    header: Mapping[str, Any],
    override: tuple[float, float] | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
    warnings: Sequence[str] = (),
    turned: bool = False,
    **facts: Any,
) -> Surface:
    """Return a surface that meets the contract of all readers."""
    z, notes = _measured(file, z)
    if row_order == ROW_ORDERS[1] and not turned:
        z = z[::-1]
    dx, dy = override or own_steps
    if "orientation_evidence" not in facts:
        facts["orientation_evidence"] = evidence(format_id)
        if facts["orientation_evidence"] == "assumed":
            raise rows_asked(file, f"of the format {format_id}")
    metadata = file.metadata(
        format_id,
        header,
        warnings=(*warnings, *notes),
        row_order_in_file=row_order,
        lateral_step_in_file_m=own_steps,
        lateral_step_override_m=override,
        **facts,
    )
    stated = {"row_order": row_order} if facts["orientation_evidence"] == "stated" else {}
    history = file.history(format_id, {"lateral_step_m": override, **stated})
    try:
        return Surface(
            z.view(CheckedArray), dx, dy, origin=origin, metadata=metadata, history=history
        )
    except DataError as exc:
        raise file.corrupt(f"the map does not fit: {exc}") from None


def rows_asked(file: RawFile, what: str) -> AmbiguousFormatError:
    """Return the question which row of a map is on top, which nothing shows, for the caller to raise."""
    return AmbiguousFormatError(
        f"{file.path}: nothing shows whether maps {what} begin with the top row or with the smallest y, and a "
        "mirrored map would compensate the wrong side; compare one map with the picture of the instrument and "
        f"give row_order={ROW_ORDERS[1]!r} or row_order={ROW_ORDERS[0]!r}, or export it as X3P"
    )


def rows_of_matrix(file: RawFile, row_order: str | None) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return facts for `make_surface` of a bare matrix, whose rows the caller states, and what to warn of."""
    if (stated := checked_row_order(file, row_order)) is not None:
        return {"row_order": stated, "orientation_evidence": "stated"}, ()
    said = (
        "nothing in the file shows which row is on top: its first row was taken as the smallest y; a mirrored map "
        "would compensate the wrong side, so compare it with the picture of the instrument and state "
        f"row_order={ROW_ORDERS[1]!r} or row_order={ROW_ORDERS[0]!r}"
    )
    return {"row_order": ROW_ORDERS[0], "orientation_evidence": "assumed"}, (said,)


def checked_row_order(file: RawFile, order: str | None) -> str | None:
    """Return the order of rows that the caller states, refused where it is none of `ROW_ORDERS`."""
    if order not in (None, *ROW_ORDERS):
        known = " or ".join(map(repr, ROW_ORDERS))
        raise ReadError(f"{file.path}: row_order = {order!r} is unknown; use {known}")
    return order


def make_profile(
    file: RawFile,
    format_id: str,
    x: FloatArray,
    z: FloatArray,
    *,
    header: Mapping[str, Any],
    override: float | None = None,
    warnings: Sequence[str] = (),
    steps: Sequence[Step] = (),
    **facts: Any,
) -> Profile:
    """Return a profile that meets the contract of all readers; falling positions are turned."""
    z, notes = _measured(file, z)
    order = "smallest x first"
    if x.size > 1 and x[0] > x[-1]:
        x, z, order = x[::-1], z[::-1], "largest x first"
    try:
        own = Profile(x, z)
        step = own.dx if own.is_uniform else None
        if override is not None:
            if step is None:
                refuse_options(file, "a profile with its own positions", lateral_step=override)
            x = x[0] + override * np.arange(x.size)
        metadata = file.metadata(
            format_id,
            header,
            warnings=(*warnings, *notes),
            point_order_in_file=order,
            lateral_step_in_file_m=step,
            lateral_step_override_m=override,
            **facts,
        )
        history = (*file.history(format_id, {"lateral_step_m": override}), *steps)
        return Profile(x, z, metadata=metadata, history=history)
    except DataError as exc:
        raise file.corrupt(f"the profile does not fit: {exc}") from None


@dataclass
class Request:
    """What a caller asked of the reader of a map or profile, checked in one way for all of them."""

    file: RawFile
    format_id: str
    title: str
    channel: str | None
    override: tuple[float, float] | None
    unit: Any
    max_pixels: int | None
    row_order: str | None = None  # what the caller states where the format does not show it
    warnings: list[str] = field(default_factory=list)

    @property
    def step(self) -> float | None:
        """The declared step along x in m."""
        return self.override[0] if self.override else None

    def choose(self, names: Iterable[str]) -> str:
        """Return the channel to read, the first if none was named."""
        return only_channels(self.file, self.title, self.channel, tuple(names))

    def surface(
        self, z: FloatArray, steps: tuple[float | None, float | None], **facts: Any
    ) -> Surface:
        """Return `make_surface` of the heights."""
        extremes = (float(np.fmin.reduce(z, axis=None)), float(np.fmax.reduce(z, axis=None)))
        if (far := max(extremes, key=abs)) and abs(far) > _HIGHEST:
            raise self.file.corrupt(
                "a height is beyond what any instrument measures",
                expected=f"at most {_HIGHEST:g} m",
                found=f"{far:.3g} m",
                hint="copy the file again, or export it again: its numbers or its mark for 'not measured' are damaged",
            )
        facts["warnings"] = (*self.warnings, *facts.get("warnings", ()))
        if self.row_order is not None:
            if facts.get("turned") and self.row_order != facts["row_order"]:
                z = z[::-1]
            facts |= {"row_order": self.row_order, "orientation_evidence": "stated"}
        return make_surface(self.file, self.format_id, z, steps, override=self.override, **facts)

    def profile(self, x: FloatArray, z: FloatArray, **facts: Any) -> Profile:
        """Return `make_profile` of positions and heights."""
        facts["warnings"] = (*self.warnings, *facts.get("warnings", ()))
        return make_profile(self.file, self.format_id, x, z, override=self.step, **facts)


_HIGHEST = 1e6
"""Height in m beyond which a map is damaged: the files of other lengths that are known stay below 1 km."""


def map_reader(
    format_id: str,
    title: str,
    own_units: str = "",
    *,
    several: bool = False,
    pixels: bool = True,
    no_steps: str = "",
) -> Callable[[Callable[..., _Made]], Callable[..., _Made]]:
    """Return what makes ``read`` of a module from a function of a `Request` and its own options."""
    assumed = evidence(format_id) == "assumed"

    def made(build: Callable[..., _Made]) -> Callable[..., _Made]:
        def read(
            file: RawFile,
            *,
            channel: str | None = None,
            lateral_step: Any = None,
            unit: Any = None,
            **own: Any,
        ) -> _Made:
            if own_units:
                refuse_options(file, own_units, unit=unit)
            if no_steps:
                refuse_options(file, no_steps, lateral_step=lateral_step)
            if not several:
                only_channels(file, title, channel)
            most = own.pop("max_pixels", None) if pixels else None
            override = declared_steps(lateral_step)
            order = checked_row_order(file, own.pop("row_order", None)) if assumed else None
            request = Request(file, format_id, title, channel, override, unit, most, order)
            return build(request, **own)

        usual = list(inspect.signature(read).parameters.values())[:-1]
        keyword = inspect.Parameter.KEYWORD_ONLY
        more = ["max_pixels"] * pixels + ["row_order"] * assumed
        usual += [inspect.Parameter(name, keyword, default=None) for name in more]
        options = list(inspect.signature(build).parameters.values())[1:]
        shown: Any = read
        shown.__signature__ = inspect.Signature([*usual, *options])
        read.__doc__ = build.__doc__
        return read

    return made


def _measured(file: RawFile, z: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Return heights without infinities, and sentences on what was odd; refuse an empty map."""
    notes: tuple[str, ...] = ()
    low, high = float(np.fmin.reduce(z, axis=None)), float(np.fmax.reduce(z, axis=None))
    if math.isinf(low) or math.isinf(high):
        infinite = np.isinf(z)
        z = np.where(infinite, np.nan, z)
        notes = (f"{int(infinite.sum())} infinite heights were taken as not measured",)
        low, high = float(np.fmin.reduce(z, axis=None)), float(np.fmax.reduce(z, axis=None))
    if math.isnan(low):
        raise file.corrupt(
            "no point was measured",
            expected="at least one valid height",
            found=f"{z.size} invalid ones",
            hint="measure again with more light or a larger mask",
        )
    if low == high:
        notes += (f"every valid height is the same, {low:g} m: no relief was stored",)
    return z, notes


def check_area(
    file: RawFile,
    columns: int,
    rows: int,
    *,
    max_pixels: int | None = None,
    names: tuple[str, str] = ("columns", "rows"),
    offsets: tuple[int | None, int | None] = (None, None),
) -> None:
    """Refuse a map without size, or with more pixels than may be allocated."""
    for value, name, offset in zip((columns, rows), names, offsets, strict=True):
        if value < 1:
            raise file.corrupt(
                "the map has no size",
                field=name,
                offset=offset,
                expected="at least 1",
                found=value,
            )
    limit = max_pixels or MAX_PIXELS
    if columns * rows > limit:
        raise UnsupportedFeatureError(
            f"{file.path}: claims {columns} x {rows} pixels ({names[0]} x {names[1]}), more than "
            f"{limit}; pass max_pixels= if that is true"
        )


def check_scale(
    file: RawFile,
    name: str,
    value: float,
    *,
    offset: int | None = None,
    low: float = 1e-3,
    high: float = 1e3,
) -> float:
    """Return a scale of the heights, or refuse it."""
    if not low <= value <= high:  # also catches NaN
        raise file.corrupt(
            "a scale of the heights is not usable",
            field=name,
            offset=offset,
            expected=f"{low:g} to {high:g}",
            found=value,
        )
    return float(value)


# ---- A list of points x, y, z on a regular grid becomes a surface ------------------------------

_STEP_RTOL = 1e-3
"""Largest deviation of a position from the grid, relative to the step (digits of a text file)."""

_NOISE = 1e-12
"""Positions closer than this, relative to the span, are one position."""

_SPARSE = 64
"""Pixels per point beyond which points are scattered and no map."""

_SMALL = 4096
"""Pixels that a map may have whatever its points."""


def to_grid(
    file: RawFile, x: FloatArray, y: FloatArray, z: FloatArray
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points in any order as a map."""
    columns, dx = _indices(file, x, "x")
    rows, dy = _indices(file, y, "y")
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    pixels = shape[0] * shape[1]
    if pixels > MAX_PIXELS:
        raise UnsupportedFeatureError(
            f"{file.path}: the points span {shape[1]} x {shape[0]} steps, more than {MAX_PIXELS} pixels"
        )
    if pixels > max(_SPARSE * x.size, _SMALL):
        raise UnsupportedFeatureError(
            f"{file.path}: {x.size} points are scattered over a grid of {shape[1]} x {shape[0]}; resample "
            "them to a map first"
        )
    places = rows * shape[1] + columns
    if np.unique(places).size != places.size:
        raise FormatMismatchError(
            f"{file.path}: two points of the list lie at the same place; remove the repeats"
        )
    heights = np.full(shape[0] * shape[1], np.nan)
    heights[places] = z
    return heights.reshape(shape), (dx, dy), (float(x.min()), float(y.min()))


def _indices(file: RawFile, values: FloatArray, name: str) -> tuple[NDArray[np.int64], float]:
    if np.isnan(values).any():
        raise FormatMismatchError(f"{file.path}: a point has no position {name}; remove its row")
    levels = np.unique(values)
    if levels.size < 2:
        raise FormatMismatchError(
            f"{file.path}: all points have the same {name}, so there is no grid; read a profile with x= "
            "and z="
        )
    steps = np.diff(levels)
    span = float(levels[-1] - levels[0])
    steps = steps[steps > _NOISE * span]
    for guess in (
        float(np.median(steps)),
        float(steps.min()),
    ):  # the smallest where rows are missing
        step = span / max(round(span / guess), 1)
        index = np.rint((values - levels[0]) / step)
        fits = np.abs(values - levels[0] - index * step).max() <= _STEP_RTOL * step
        if fits and np.unique(index).size == steps.size + 1:
            return index.astype(np.int64), step
    raise FormatMismatchError(
        f"{file.path}: the positions {name} do not lie on a regular grid (step near "
        f"{float(np.median(steps)):.6g} m); resample the points first"
    )

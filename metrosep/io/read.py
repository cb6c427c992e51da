"""`read`: a file becomes a surface, a profile or a recording."""

from __future__ import annotations

import importlib.util
import os
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePath
from typing import Any

import numpy as np

from metrosep.core.errors import (
    FormatMismatchError,
    ReadOptionError,
    UnitError,
    UnknownFormatError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.readable import did_you_mean
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS, TEXT_OPTIONS, accepted_options
from metrosep.core.units import parse_unit
from metrosep.io import registry
from metrosep.io.objects import (
    checked_row_order,
    lateral_or_none,
    make_profile,
    make_surface,
    only_channels,
    rows_asked,
)
from metrosep.io.registry import Format
from metrosep.io.several_runs import BLOCKS, SeveralRunsError
from metrosep.io.source import RawFile, declared_steps, open_file, refuse_options


def read(
    path: str | os.PathLike[str],
    *,
    channel: str | None = None,
    lateral_step: float | str | tuple[float | str, float | str] | None = None,
    unit: str | tuple[str, ...] | dict[str, str] | None = None,
    format: str | None = None,  # noqa: A002
    **layout: Any,
) -> Surface | Profile | Recording | RunSet:
    """Read a measurement; its kind follows from the content of the file.

    Parameters
    ----------
    path : str or path
        The file. It is recognised by its content, never by its name.
    channel : str, optional
        Which data set of a file that holds several; `channels` lists them.
    lateral_step : float (m), str with unit, or pair of either, optional
        Lateral step that replaces the file's own, as ``(dx, dy)`` or one for both. The file's
        own value stays in ``metadata["lateral_step_in_file_m"]``.
    unit : str, tuple of str or dict of str to str, optional
        For text whose columns declare no unit: one for all lengths, one per column, or by name.
    format : str, optional
        Identifier of the format, where the content fits several.
    **layout
        For text: ``x``, ``z``, ``time``, ``sampling_rate`` and how it is written: ``separator``,
        ``decimal``, ``thousands``, ``encoding``, ``comment``, ``skip_rows``, ``skip_lines``,
        ``missing``, ``sheet``; see `metrosep.io.text.delimited.read`. For binary maps: ``max_pixels``.
        For maps: ``row_order``, "top row first" or "smallest y first", where the file does not show
        it; where the file does, it must say the same.

    Returns
    -------
    Surface, Profile, Recording or RunSet
        SI, NaN = not measured. Nothing is levelled, filled or cropped. The first step of its
        ``history`` carries the SHA-256 of the file, its ``metadata["header"]`` every raw field.

    Raises
    ------
    ReadError
        If the file cannot be opened, is not recognised, is damaged or lacks what was asked for.
    UnitError
        If a column declares no unit and none was given.

    Notes
    -----
    Plain text gives a `Profile` when it has two columns of numbers and neither is a time, or when
    ``x=`` and ``z=`` name the columns; otherwise a `Recording`. A table of several runs gives a
    `RunSet` where names and units tell run, position and reading, and so does a file that metrosep
    wrote with its runs; else the message is the call of
    `metrosep.io.runs.read_runs` with what is to be filled in.
    """
    options: dict[str, Any] = {
        "channel": channel,
        "lateral_step": lateral_step,
        "unit": unit,
        "format": format,
    }
    try:
        return read_any(path, **options, **layout)
    except SeveralRunsError as exc:
        given = {k: v for k, v in {**options, **layout}.items() if v is not None}
        if exc.found.run == BLOCKS or not exc.found.is_known(given) or given.keys() - _OF_RUNS:
            raise
        from metrosep.io.runs import read_runs

        own = {
            k: v
            for k, v in exc.found.specs().items()
            if k != "time" or "sampling_rate" not in given
        }
        known = own | {k: v for k, v in given.items() if k not in ("unit", "format")}
        return read_runs(path, **known, angles=exc.found.turns)


_COLUMNS = frozenset({"x", "z", "time", "sampling_rate", "scale"})
_OF_RUNS = TEXT_OPTIONS.keys() | _COLUMNS | {"unit", "format"}
"""Options of `read` that apply to a set of runs too."""


def read_one(path: str | os.PathLike[str], **options: Any) -> Surface | Profile | Recording:
    """Return the one map, profile or recording of a file as `read` does; several runs are refused."""
    obj = read_any(path, **options)
    if not isinstance(obj, RunSet):
        return obj
    from metrosep.io._roles import runs_in
    from metrosep.io.own_runs import run_table

    if (found := runs_in(run_table(obj))) is not None:
        raise SeveralRunsError(path, replace(found, is_own=True))
    raise FormatMismatchError(
        f"{path}: holds one run; read it with metrosep.read_runs({str(path)!r}), or separate it with: "
        f"metrosep separate {shlex.quote(str(path))}"
    )


def read_any(
    path: str | os.PathLike[str],
    *,
    channel: str | None = None,
    lateral_step: float | str | tuple[float | str, float | str] | None = None,
    unit: str | tuple[str, ...] | dict[str, str] | None = None,
    format: str | None = None,  # noqa: A002
    **layout: Any,
) -> Surface | Profile | Recording | RunSet:
    """Return what a file holds, runs that metrosep wrote among it; other runs raise `SeveralRunsError`."""
    file = open_file(path)
    if format is None:
        file = registry.principal(file)
    description = recognise(file, format, layout)
    if description.reader == "via":
        row_order = layout.pop("row_order", None)
        refuse_options(file, description.title, **layout)
        return read_via(
            file, channel=channel, lateral_step=lateral_step, unit=unit, row_order=row_order
        )
    file.hash_aside()
    unit = _by_name(unit)
    reader = description.load_reader()
    accepted = accepted_options(reader.read)
    order = checked_row_order(file, layout.get("row_order"))
    if "row_order" not in accepted:
        layout.pop("row_order", None)
    for option in layout:
        if option not in accepted:
            own = [n for n in accepted if n not in {"file", "channel", "lateral_step", "unit"}]
            raise ReadOptionError(
                f"{file.path}: is {description.title}, which takes no option {option!r}; it takes "
                f"{', '.join(own) or 'none'}.{did_you_mean(option, own)}"
            )
    try:
        obj = reader.read(file, channel=channel, lateral_step=lateral_step, unit=unit, **layout)
    except SeveralRunsError as exc:
        said = {k: v for k, v in layout.items() if k in TEXT_OPTIONS.keys() | _COLUMNS}
        raise SeveralRunsError(exc.path, exc.found, said) from None
    if order is not None:
        _require_rows(file, obj, order)
    return obj


def _by_name(unit: Any) -> Any:
    """Return units that a command gives by name, "xy:um,z:nm", as a mapping; any other unit as it is."""
    if not isinstance(unit, str) or ":" not in unit:
        return unit
    parts = [part.rpartition(":") for part in unit.split(",")]
    return {name.strip(): own.strip() for name, _, own in parts}


class RowsShownError(ReadOptionError):
    """An order of rows was stated of a file that shows another one, or holds none."""

    def __init__(self, message: str, obj: Any = None) -> None:
        super().__init__(message)
        self.obj = obj  # what was read, by what the file shows


def _require_rows(file: RawFile, obj: Any, stated: str) -> None:
    """Refuse what the caller states of the rows where the file itself shows something else."""
    if not isinstance(obj, Surface):
        what = f"holds a {type(obj).__name__.lower()}, which has no rows"
    else:
        shown, own = (obj.metadata.get(k) for k in ("orientation_evidence", "row_order_in_file"))
        if shown == "stated" or own == stated or own == _SAME.get(stated):
            return
        what = f"shows itself how its rows lie ({own}, by {shown})"
    raise RowsShownError(
        f"{file.path}: {what}, and row_order={stated!r} says otherwise; leave row_order out", obj
    )


_SAME = {ROW_ORDERS[1]: "largest y first"}
"""Words of a reader for an order of rows that the caller states in others."""


def read_for_recipe(path: str | os.PathLike[str], **options: Any) -> Surface | Profile | Recording:
    """Return what `read_one` does; ``row_order`` of a recipe is for those of its files that show no rows."""
    try:
        return read_one(path, **options)
    except RowsShownError as exc:
        if not isinstance(exc.obj, Surface | Profile | Recording):
            raise
        said = (
            str(exc).removeprefix(f"{path}: ").rpartition("; ")[0].replace(" says otherwise", "")
        )
        warnings = (
            *exc.obj.metadata.get("warnings", ()),
            f"{said} of the recipe is not used for it",
        )
        return replace(exc.obj, metadata={**exc.obj.metadata, "warnings": warnings})


def recognise(
    file: RawFile,
    format_id: str | None,
    layout: Mapping[str, Any],
) -> registry.Format:
    """Return the format to read a file as."""
    if format_id is not None:
        return registry.get(format_id)
    try:
        return registry.find(file)
    except UnknownFormatError:
        if not TEXT_OPTIONS.keys().isdisjoint(layout):
            return registry.get("delimited")

        other = format_of(file)
        if other is None:
            raise
        return other


def channels(path: str | os.PathLike[str], *, format: str | None = None) -> tuple[str, ...]:  # noqa: A002
    """Return the names that ``read(path, channel=)`` accepts, the default first."""
    file = registry.principal(open_file(path))
    description = registry.get(format) if format is not None else registry.find(file)
    return description.load_reader().channels(file)


# ---- last resort for formats that metrosep does not read: the package SurfaceTopography, if installed ----
# It is asked only for a file that no reader of metrosep knows, whose suffix is one of `SUFFIXES`, and
# only with the reader of that format: others of its readers take anything for text, or allocate
# what a damaged header claims. What it gives is marked ``via`` and checked like every other map.
# Formats whose scale it was seen to get wrong (NanoFocus ``.nms``: 10^6) are not in the list.
#
# Its arrays are [x, y], most with the top row of the picture first, so rows are turned to begin at the
# smallest y. Where neither a pair of files nor the package itself shows that, a map is refused until
# the caller says how its rows lie: a map that may be mirrored compensates the wrong side.

PACKAGE = "SurfaceTopography"

SUFFIXES = {
    ".mdt": "mdt",
    ".mi": "mi",
    ".zmg": "zmg",
    ".zon": "zon",
    ".oir": "oir",
    ".poir": "poir",
    ".jpk": "jpk",
}
"""File name suffix to the name of SurfaceTopography's reader."""


_PEER, _STATED = "peer", "stated"
_EVIDENCE = dict.fromkeys(("jpk", "mdt", "mi"), _PEER)
"""What shows that a reader hands the top row over first; ``peer``: it is drawn as Gwyddion draws it."""

_TESTED = "1.27."
"""Versions of the package to which that applies; earlier ones turned some formats otherwise."""


def format_of(file: RawFile) -> Format | None:
    """Return the description of a format that SurfaceTopography reads, or ``None``."""
    suffix = PurePath(file.name).suffix.lower()
    if suffix not in SUFFIXES:
        return None
    if importlib.util.find_spec(PACKAGE) is None:
        raise UnsupportedFeatureError(
            f"{file.path}: metrosep has no reader of its own for {suffix}; install the package "
            f"{PACKAGE} (metrosep[exotic]) to read it through that, or export the map as X3P"
        )
    return Format(
        id=f"via-{SUFFIXES[suffix]}",
        title=f"{suffix} by {PACKAGE}",
        vendor="",
        kind="surface | profile",
        suffixes=(suffix,),
        reader="via",
        reads=True,
        writes=False,
        status=f"via {PACKAGE}",
    )


def read_via(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    row_order: str | None = None,
) -> Surface | Profile:
    """Return the map or line that SurfaceTopography reads."""
    import SurfaceTopography as package  # noqa: N813
    from SurfaceTopography.IO import readers

    refuse_options(file, f"read by {PACKAGE}, which knows the unit", unit=unit)
    override = declared_steps(lateral_step)
    name = SUFFIXES[PurePath(file.name).suffix.lower()]
    reader_class = next(r for r in readers if r.format() == name)
    try:
        reader = reader_class(str(file.path))
        channels = [c.name for c in reader.channels]
        wanted = only_channels(file, PACKAGE, channel, channels)
        topography = reader.topography(channel_index=channels.index(wanted))
        heights = np.ma.filled(np.ma.asarray(topography.heights(), dtype=np.float64), np.nan)
    except UnsupportedFeatureError:
        raise
    except Exception as exc:
        raise file.corrupt(f"{PACKAGE} cannot read it ({exc})") from None
    factor = _factor(file, topography.unit)
    version = str(package.__version__)
    facts = {"via": f"{PACKAGE} {version}", "channel": wanted, "unit_in_file": topography.unit}
    warnings = [f"read by {PACKAGE} {version}; metrosep has not verified the numbers"]
    header = {str(k): str(v) for k, v in dict(topography.info).items()}
    format_id = f"via-{name}"
    if topography.dim == 1:
        x = np.asarray(topography.positions(), dtype=np.float64) * factor
        refuse_options(file, "a profile, which has no rows", row_order=row_order)
        step = override[0] if override else None
        z = heights * factor
        return make_profile(
            file, format_id, x, z, header=header, override=step, warnings=warnings, **facts
        )
    order, evidence = _orientation(file, name, version, row_order)
    if evidence == _PEER:
        warnings.append(
            f"{PACKAGE} draws this format as Gwyddion does, so its first row was taken as the top one; "
            "no pair of files confirmed it: row_order= overrides it"
        )
    own = tuple(
        lateral_or_none(file, "pixel_size", float(s), warnings, factor=factor)
        for s in topography.pixel_size
    )
    return make_surface(
        file,
        format_id,
        heights.T * factor,
        (own[0], own[1]),
        row_order=order,
        header=header,
        override=override,
        warnings=warnings,
        orientation_evidence=evidence,
        **facts,
    )


def _orientation(file: RawFile, name: str, version: str, row_order: str | None) -> tuple[str, str]:
    """Return the order of the rows of the package's map, drawn without turning, and what shows it."""
    if row_order is not None:
        return str(checked_row_order(file, row_order)), _STATED
    if name in _EVIDENCE and version.startswith(_TESTED):
        return ROW_ORDERS[1], _EVIDENCE[name]
    reason = (
        f"of {PACKAGE} {version}" if name in _EVIDENCE else f"that {PACKAGE} reads as {name!r}"
    )
    raise rows_asked(file, reason)


def _factor(file: RawFile, unit: str | None) -> float:
    """Return metres per unit of the other package."""
    try:
        found = parse_unit(str(unit), dimension="length") if unit else None
    except UnitError:
        found = None
    if found is None:
        raise UnitError(f"{file.path}: {PACKAGE} knows no unit of length for it (found {unit!r})")
    return found.factor

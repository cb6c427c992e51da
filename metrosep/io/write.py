"""`write`: an object becomes a file that others read, whole or not at all.

Text is written in SI with the unit in every column name and with as many digits as it takes to
read back the same number. Comment lines above the table carry the history,
and of a profile its kind and cut-offs; `read` takes them up again.
"""

from __future__ import annotations

import csv
import importlib
import inspect
import io
import itertools
import os
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import (
    UnsupportedFeatureError,
    WriteError,
    WriteOptionError,
)
from metrosep.core.profile import Profile
from metrosep.core.readable import did_you_mean
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.io.objects import not_calibrated
from metrosep.io.own_notes import header_lines
from metrosep.io.own_runs import run_table
from metrosep.io.text.dialect import header_unit

_SUFFIXES = {
    ".x3p": "x3p",
    ".csv": "csv",
    ".xyz": "xyz",
    ".int": "int",
    ".sur": "sur",
    ".pro": "pro",
    ".smd": "smd",
    ".sdf": "sdf",
    ".h5": "h5",
}

SUFFIXES = tuple(_SUFFIXES)
"""Ends of the names of files that `write` makes."""

WITHOUT_HISTORY = ("int", "pro", "sdf", "smd", "sur")
"""Formats that do not tell what was removed from a map or filtered off before it was written."""

_Writer = tuple[str, str, tuple[type, ...]]

_BINARY: dict[str, _Writer] = {
    "x3p": ("metrosep.io.maps.x3p", "x3p_bytes", (Surface, Profile)),
    "int": ("metrosep.io.text.codev_int", "int_bytes", (Surface,)),
    "sur": ("metrosep.io.maps.digital_surf", "sur_bytes", (Surface,)),
    "pro": ("metrosep.io.maps.digital_surf", "sur_bytes", (Profile,)),
    "sdf": ("metrosep.io.maps.sdf", "sdf_bytes", (Surface, Profile)),
    "smd": ("metrosep.io.text.smd", "smd_bytes", (Profile,)),
    "h5": ("metrosep.io.containers.native", "native_bytes", (Surface, Profile, Recording, RunSet)),
}
"""Format to module, function and the objects that it holds."""


def write(
    obj: Surface | Profile | Recording | RunSet,
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
    **options: Any,
) -> Path:
    """Write a measurement to a file.

    Parameters
    ----------
    obj : Surface, Profile, Recording or RunSet
        What to write.
    path : str or path
        The file; its folder must exist.
    format : {"csv", "h5", "int", "pro", "sdf", "smd", "sur", "x3p", "xyz"}, optional
        Follows from the suffix of the name if omitted. CSV and h5 take everything, X3P and SDF
        surfaces and profiles, pro and smd profiles, the others surfaces.
    **options
        Of the format. int: ``wavelength`` (m, the unit of its scale, 1 um if omitted), ``kind`` ("SUR" or "WFR";
        heights are not converted) and ``title`` (up to 48 printable ASCII characters, to which the
        step of the counts is added). sdf: ``binary`` (bISO-1.0 instead of text).

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    UnsupportedFeatureError
        If the format is not written, or does not hold such an object.
    WriteError
        If the file cannot be written, an option is unknown, or a surface is laterally not
        calibrated where the format needs it; no half-written file is left behind.

    Notes
    -----
    csv, xyz, x3p, sdf, smd and h5 keep every digit. csv, xyz, x3p and h5 keep the history, and of a
    profile its kind and cut-offs, so that what was filtered is not filtered again; h5 keeps all
    metadata and gives the same object back. sdf, smd, sur, pro and int keep no history. int has 16
    bits, sur and pro 32: they round heights to steps of P-V/65534 and about P-V/2.1e9. sdf, smd and
    pro hold profiles of equal steps only, smd no point that was not measured. In text "not measured" is an empty field in CSV and ``nan`` in xyz. ``read`` gives a
    profile, a recording, a surface or a set of runs back.
    """
    where = Path(path)
    name = (
        format or _SUFFIXES.get(where.suffix.lower(), where.suffix.lstrip(".").lower())
    ).lower()
    data = _bytes(obj, name, where, options)
    return atomic_write(where, data)


def _bytes(
    obj: Surface | Profile | Recording | RunSet, name: str, path: Path, options: dict[str, Any]
) -> bytes:
    if not isinstance(obj, (Surface, Profile, Recording, RunSet)):
        raise WriteError(
            f"{path}: a {type(obj).__name__} cannot be written; give a Surface, Profile, Recording or "
            "RunSet"
        )
    if name not in _SUFFIXES.values():
        raise UnsupportedFeatureError(
            f"{path}: format {name!r} is not written; there are "
            f"{', '.join(sorted(set(_SUFFIXES.values())))}.{did_you_mean(name, _SUFFIXES.values())}"
        )
    if isinstance(obj, Profile) and obj.lateral_unit != "m" and name != "h5":
        raise WriteError(
            f"{path}: x of the profile counts pixels, and {name} holds positions in m; give the map its "
            "lateral_step where it is read, or write h5"
        )
    if name in _BINARY:
        return _by_module(obj, name, path, options)
    if options:
        raise WriteOptionError(f"{path}: {name} takes no option {next(iter(options))!r}")
    if name == "csv":
        return _csv(obj)
    if not isinstance(obj, Surface):
        raise _does_not_hold(obj, name, path)
    return _xyz(obj)


def _by_module(
    obj: Surface | Profile | Recording | RunSet, name: str, path: Path, options: dict[str, Any]
) -> bytes:
    module, function, kinds = _BINARY[name]
    if not isinstance(obj, kinds):
        raise _does_not_hold(obj, name, path)
    make = getattr(importlib.import_module(module), function)
    accepted = list(inspect.signature(make).parameters)[1:]
    for option in options:
        if option not in accepted:
            known = f"it takes {', '.join(accepted)}" if accepted else "it takes none"
            raise WriteOptionError(f"{path}: {name} takes no option {option!r}; {known}")
    try:
        return bytes(make(obj, **options))
    except WriteError as exc:
        raise WriteError(f"{path}: {exc}") from None


def _does_not_hold(obj: object, name: str, path: Path) -> UnsupportedFeatureError:
    others = sorted(f for f, (_, _, kinds) in _BINARY.items() if isinstance(obj, kinds))
    return UnsupportedFeatureError(
        f"{path}: {name} does not hold a {type(obj).__name__}; write it as csv, {', '.join(others)}"
    )


def _csv(obj: Surface | Profile | Recording | RunSet) -> bytes:
    if isinstance(obj, Profile):
        return _table(["x_m", "z_m"], [_texts(obj.x), _texts(obj.z)], obj)
    if isinstance(obj, Surface):
        return _table(["x_m", "y_m", "z_m"], _grid_texts(obj), obj)
    if isinstance(obj, Recording):
        columns = [_texts(obj.t), *(_texts(c) for c in obj.channels.values())]
        return _table(["t_s", *_channel_names(obj)], columns, obj)
    return _runs(obj)


def _channel_names(recording: Recording) -> list[str]:
    """Return names of channels with the unit they are written in, no two alike: probe (2) [m]."""
    names = {n: n for n in recording.channels if not recording.units.get(n)}
    for channel in recording.channels:
        bare, unit = header_unit(channel)[0], recording.units.get(channel)
        numbered = (f"{bare} ({k}) [{unit}]" for k in itertools.count(2))
        if unit:
            free = itertools.chain([f"{bare} [{unit}]"], numbered)
            names[channel] = next(n for n in free if n not in names.values())
    return [names[channel] for channel in recording.channels]


def _runs(runs: RunSet) -> bytes:
    columns = run_table(runs).columns
    texts = [
        [_quoted(label) for label in c.labels or ()] if c.values is None else _texts(c.values)
        for c in columns
    ]
    return _table([c.name for c in columns], texts, runs)


def _quoted(label: str) -> str:
    """Return the name of a run in quotes, so that it is a name whatever it looks like."""
    odd = [c for c in label if unicodedata.category(c) in _LOST]
    if odd or label != label.strip():
        what = f"the character {odd[0]!r}" if odd else "blanks at an end"
        raise WriteError(
            f"the name of run {label!r} holds {what}, which does not come back from text; rename that run"
        )
    return '"' + label.replace('"', '""') + '"'


_LOST = frozenset({"Cc", "Cs", "Zl", "Zp"})
"""Characters that end lines, steer or cannot be written."""


def _table(
    names: Sequence[str],
    columns: Sequence[Sequence[str]],
    obj: Surface | Profile | Recording | RunSet,
) -> bytes:
    stream = io.StringIO()
    stream.write(_comments(obj))
    csv.writer(stream, lineterminator="\n").writerow(names)
    stream.writelines(",".join(row) + "\n" for row in zip(*columns, strict=True))
    return stream.getvalue().encode("utf-8")


def _xyz(surface: Surface) -> bytes:
    columns = [[t or "nan" for t in column] for column in _grid_texts(surface)]
    rows = "\n".join(" ".join(row) for row in zip(*columns, strict=True))
    return f"{_comments(surface)}x_m y_m z_m\n{rows}\n".encode()


def _grid_texts(surface: Surface) -> list[list[str]]:
    """Return x, y and z of each pixel as text, x fastest."""
    if surface.dx is None or surface.dy is None:
        raise not_calibrated("a list of points")
    rows, columns = surface.shape
    x = _texts(surface.origin[0] + surface.dx * np.arange(columns))
    y = _texts(surface.origin[1] + surface.dy * np.arange(rows))
    return [
        x * rows,
        [text for text in y for _ in range(columns)],
        _texts(surface.z.ravel()),
    ]


def _texts(values: NDArray[np.floating]) -> list[str]:
    """Return numbers as the shortest text that reads back exactly; NaN as an empty field."""
    return ["" if v != v else repr(v) for v in values.tolist()]


def _comments(obj: Surface | Profile | Recording | RunSet) -> str:
    return "".join(f"# {line}\n" for line in header_lines(obj))

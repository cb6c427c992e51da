"""`read`: a file becomes a surface, a profile or a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from metrosep.core.errors import FormatMismatchError, ReadOptionError, UnknownFormatError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.text_options import TEXT_OPTIONS, accepted_options
from metrosep.io import registry
from metrosep.io.source import RawFile, open_file, refuse_options

__all__ = ["channels", "read", "recognise"]


def read(
    path: str | os.PathLike[str],
    *,
    channel: str | None = None,
    lateral_step: float | str | tuple[float | str, float | str] | None = None,
    unit: str | tuple[str, ...] | dict[str, str] | None = None,
    format: str | None = None,  # noqa: A002
    **layout: Any,
) -> Surface | Profile | Recording:
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
        ``missing``; see `metrosep.io.delimited.read`. For binary maps: ``max_pixels``.

    Returns
    -------
    Surface, Profile or Recording
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
    ``x=`` and ``z=`` name the columns; otherwise a `Recording`. Repeated runs are read with
    `metrosep.io.runs.read_runs`.
    """
    file = open_file(path)
    if format is None:
        file = registry.principal(file)
    description = recognise(file, format, layout)
    if description.reader == "via":
        from metrosep.io.via import read_via

        row_order = layout.pop("row_order", None)
        refuse_options(file, description.title, **layout)
        return read_via(
            file, channel=channel, lateral_step=lateral_step, unit=unit, row_order=row_order
        )
    file.hash_aside()
    reader = description.load_reader()
    accepted = accepted_options(reader.read)
    for option in layout:
        if option not in accepted:
            own = [n for n in accepted if n not in {"file", "channel", "lateral_step", "unit"}]
            raise ReadOptionError(
                f"{file.path}: is {description.title}, which takes no option {option!r}; it takes "
                f"{', '.join(own) or 'none'}"
            )
    obj = reader.read(file, channel=channel, lateral_step=lateral_step, unit=unit, **layout)
    if isinstance(obj, RunSet):
        raise FormatMismatchError(
            f"{file.path}: holds repeated runs; read them with metrosep.read_runs(path)"
        )
    return obj


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
        from metrosep.io.via import format_of

        other = format_of(file)
        if other is None:
            raise
        return other


def channels(path: str | os.PathLike[str], *, format: str | None = None) -> tuple[str, ...]:  # noqa: A002
    """Return the names that ``read(path, channel=)`` accepts, the default first."""
    file = registry.principal(open_file(path))
    description = registry.get(format) if format is not None else registry.find(file)
    return description.load_reader().channels(file)

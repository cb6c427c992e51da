"""X3P (ISO 25178-72): surfaces and profiles in metres, a zip archive with a description in XML.

A value is ``raw * Increment + Offset`` of its axis, the z axis included. Points lie x-fastest; the
first row has the smallest y. Not measured is NaN, an empty ``Datum``, or a zero bit in the
validity file (least significant bit first). A wrong MD5 is a warning, not an error: files with
wrong sums are in circulation. See ``data_formats/x3p/SPEC.md``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    FormatMismatchError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.grid import to_grid
from metrosep.io.maps import height_only as channels
from metrosep.io.own_notes import OwnNotes, comment_notes
from metrosep.io.registry import Match
from metrosep.io.source import MAX_PIXELS, RawFile, flat_map, lateral_steps, refuse_options
from metrosep.io.workbook import zip_members
from metrosep.io.x3p_container import Container, flatten, md5, parse_xml
from metrosep.io.x3p_points import Axis, feature, read_axes, read_points, read_shape, refuse_unread

__all__ = ["channels", "read", "sniff"]

FORMAT = "x3p"


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is an X3P file."""
    if not file.head.startswith(b"PK\x03\x04"):
        return Match.NO
    members = zip_members(file)
    if any(n.endswith(("main.xml", "md5checksum.hex")) or "bindata/" in n for n in members):
        return Match.YES
    return Match.MAYBE if file.name.lower().endswith(".x3p") else Match.NO


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface | Profile:
    """Return the surface or profile of an X3P file.

    Notes
    -----
    A list of points (PCL), or a surface whose points carry their positions, is a surface if they
    lie on a regular grid, in any order; then `lateral_step` is refused.
    """
    refuse_options(file, "an X3P file in metres", unit=unit)
    if channel not in (None, "height"):
        raise UnsupportedFeatureError(
            f"{file.path}: X3P channel {channel!r} cannot be read; the only one is 'height'"
        )
    override = lateral_steps(lateral_step)
    if not file.data.startswith(b"PK"):
        raise FormatMismatchError(
            f"{file.path}: is not an X3P file: expected a zip archive, found "
            f"{file.data[:4].hex(' ')}; leave out format= to have it recognised"
        )
    container = Container(file)
    document = container.read("main.xml")
    root = parse_xml(file, document)
    warnings = container.warnings
    if not root.tag.startswith("ISO5436"):
        raise CorruptFileError(
            file.path, "the XML is of something else", expected="ISO5436_2", found=root.tag
        )
    if root.tag != "ISO5436_2":
        warnings.append(f"the root element is {root.tag!r} instead of 'ISO5436_2'")
    _check_document_sum(container, document, warnings)
    axes = read_axes(file, root, warnings)
    shape = read_shape(file, root, max_pixels or MAX_PIXELS)
    refuse_unread(file, root, axes, shape)
    values = read_points(file, container, root, axes, shape, trusted=max_pixels is not None)
    warnings.extend(flat_map(values["CZ"]))
    header = flatten(root)
    _note_rotation(header, warnings)
    notes = comment_notes(file, header.get("Record2/Comment", ""))
    warnings.extend(notes.warnings)
    has_positions = axes[0].is_absolute or axes[1].is_absolute
    build = _profile if feature(root) == "PRF" else _gridded if has_positions else _surface
    try:
        return build(file, axes, shape, values, header, override, warnings, notes)
    except DataError as exc:
        raise FormatMismatchError(f"{file.path}: {exc}") from None


def _check_document_sum(container: Container, document: bytes, warnings: list[str]) -> None:
    if "md5checksum.hex" not in container:
        warnings.append("md5checksum.hex is missing")
        return
    text = container.read("md5checksum.hex", limit=4096).decode("latin-1").split()
    if not text or text[0].lower() != md5(document):
        warnings.append("the MD5 of main.xml is wrong: the description was changed after writing")


def _note_rotation(header: dict[str, str], warnings: list[str]) -> None:
    identity = {"r11": 1.0, "r22": 1.0, "r33": 1.0}
    for key, text in header.items():
        if "/Rotation/" not in key:
            continue
        try:
            turned = float(text) != identity.get(key.rsplit("/", 1)[-1], 0.0)
        except ValueError:
            turned = True
        if turned:
            warnings.append("the file's Rotation was not applied: heights are in its own frame")
            return


def _facts(
    file: RawFile,
    header: dict[str, str],
    warnings: list[str],
    **facts: Any,
) -> dict[str, Any]:
    return file.metadata(
        FORMAT,
        header,
        warnings=tuple(warnings),
        instrument=" ".join(
            header.get(f"Record2/Instrument/{k}", "") for k in ("Manufacturer", "Model", "Serial")
        ).strip(),
        **facts,
    )


def _surface(
    file: RawFile,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    values: dict[str, FloatArray],
    header: dict[str, str],
    override: tuple[float, float] | None,
    warnings: list[str],
    notes: OwnNotes,
) -> Surface:
    z = values["CZ"].reshape(shape)
    origin = []
    for axis, direction, n in ((axes[0], 1, shape[1]), (axes[1], 0, shape[0])):
        start = axis.offset
        if axis.increment < 0.0:
            z = np.flip(z, axis=direction)
            start += axis.increment * (n - 1)
        origin.append(start)
    own = (abs(axes[0].increment), abs(axes[1].increment))
    dx, dy = override or own
    metadata = _facts(
        file,
        header,
        warnings,
        row_order_in_file="smallest y first" if axes[1].increment > 0 else "largest y first",
        lateral_step_in_file_m=own,
        lateral_step_override_m=override,
    )
    history = (*notes.history, *file.history(FORMAT, {"lateral_step_m": override}))
    return Surface(z, dx, dy, origin=(origin[0], origin[1]), metadata=metadata, history=history)


def _gridded(
    file: RawFile,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    values: dict[str, FloatArray],
    header: dict[str, str],
    override: tuple[float, float] | None,
    warnings: list[str],
    notes: OwnNotes,
) -> Surface:
    refuse_options(file, "an X3P file with a position for each point", lateral_step=override)
    z, steps, origin = on_grid(file, axes, shape, values, warnings)
    metadata = _facts(
        file,
        header,
        warnings,
        row_order_in_file="points placed by their positions",
        lateral_step_in_file_m=steps,
        lateral_step_override_m=None,
        n_points=shape[0] * shape[1],
    )
    history = (*notes.history, *file.history(FORMAT))
    return Surface(z, *steps, origin=origin, metadata=metadata, history=history)


def _profile(
    file: RawFile,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    values: dict[str, FloatArray],
    header: dict[str, str],
    override: tuple[float, float] | None,
    warnings: list[str],
    notes: OwnNotes,
) -> Profile:
    z = values["CZ"]
    own = None if axes[0].is_absolute else axes[0].increment
    if axes[0].is_absolute:
        refuse_options(file, "an X3P profile with its own positions", lateral_step=override)
        x = values["CX"]
        known = ~np.isnan(x)
        if not known.all():
            warnings.append(f"{int((~known).sum())} points without a position were left out")
            x, z = x[known], z[known]
    else:
        step = override[0] if override else axes[0].increment
        x = axes[0].offset + step * np.arange(shape[1], dtype=np.float64)
    if axes[1].is_absolute:
        warnings.append("the y positions of the profile were not kept")
    metadata = _facts(
        file,
        header,
        warnings,
        lateral_step_in_file_m=own,
        lateral_step_override_m=override[0] if override else None,
        **notes.facts,
    )
    history = (*notes.history, *file.history(FORMAT))
    return Profile(x, z, metadata=metadata, history=history)


# ---- points of an X3P file that carry their positions become a map, if they lie on a regular grid ----

_MAX_GAPS = 64.0
"""Pixels of a grid per point of a list; with more the points are taken for scattered."""

_SAME = 1e-12
"""Positions closer than this, relative to the span, are one position."""


def on_grid(
    file: RawFile,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    values: dict[str, FloatArray],
    warnings: list[str],
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points that carry their positions as a map, if they lie on a regular grid."""
    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    x, y = (
        values[a.name] if a.is_absolute else a.metres(np.asarray(index, dtype=np.float64))
        for a, index in zip(axes, (column, row), strict=False)
    )
    known = ~(np.isnan(x) | np.isnan(y))
    if not known.all():
        warnings.append(f"{int((~known).sum())} points without a position were left out")
    x, y, z = x[known], y[known], values["CZ"][known]
    reason = "there are too few of them for a grid"
    if z.size and _n_steps(x) * _n_steps(y) <= _MAX_GAPS * z.size:
        try:
            return to_grid(file, x, y, z)
        except FormatMismatchError as exc:
            reason = str(exc).removeprefix(f"{file.path}: ")
    raise UnsupportedFeatureError(
        f"{file.path}: the points of the X3P file are scattered, not on a regular grid ({reason}); "
        "resample them to a grid and save it as a surface (SUR)"
    )


def _n_steps(values: FloatArray) -> float:
    """Return how many of the smallest steps the positions span."""
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > _SAME * (levels[-1] - levels[0])]
    return float((levels[-1] - levels[0]) / steps.min()) + 1.0 if steps.size else 1.0

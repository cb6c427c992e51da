"""Zygo XYZ text, "Zygo XYZ Data File - Format 1": one line per camera pixel.

After a header, closed by a line ``#``, each line is ``x y z`` or ``x y No Data``; x and y count
pixels in the frame of the camera, whose rows are counted from the top. Every point is put where
its indices say, whatever the order of the lines. z is in um by the description of the format;
the file itself does not say so, and other readings are in circulation, so ``unit=`` overrides it.
See ``data_formats/zygo-xyz/SPEC.md``.
"""

from __future__ import annotations

import re

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.core.units import parse_unit
from metrosep.io.objects import (
    Request,
    check_area,
    height_only,
    lateral_or_none,
    map_reader,
)
from metrosep.io.registry import demand, sniffer
from metrosep.io.source import RawFile
from metrosep.io.text.logger import one_number, parse_numbers

channels = height_only

FORMAT = "zygo-xyz"
_VERSION = "Format 1"
_MAX_HEADER = 60
_MAX_GAPS = 64
"""Pixels of the window per listed point: a window with fewer points is refused as damaged."""

_LINES: dict[int, tuple[str, ...]] = {
    2: ("software_type", "version_major", "version_minor", "version_bug", "software_date"),
    3: (
        "intensity_origin_x",
        "intensity_origin_y",
        "intensity_width",
        "intensity_height",
        "n_buckets",
        "intensity_range",
    ),
    4: ("phase_origin_x", "phase_origin_y", "phase_width", "phase_height"),
    5: ("comment",),
    6: ("part_serial",),
    7: ("part_number",),
    8: (
        "source",
        "interferometric_scale_factor",
        "wavelength",
        "numerical_aperture",
        "obliquity_factor",
        "line_8_field_6",
        "lateral_resolution",
        "time_stamp",
    ),
    9: (
        "camera_width",
        "camera_height",
        "system_type",
        "system_board",
        "system_serial",
        "instrument_id",
        "objective",
    ),
}
"""Names of the fields of each header line; the others are kept by line and position."""

_FIELD = re.compile(r'"[^"]*"|\S+')


sniff = sniffer(FORMAT)


@map_reader(FORMAT, "Zygo XYZ")
def read(asked: Request) -> Surface:
    """Return the height map of a Zygo XYZ file."""
    file = asked.file
    scale = parse_unit("um" if asked.unit is None else str(asked.unit), dimension="length")
    lines, start = _header_lines(file)
    header = _fields(lines)
    x0, y0, width, height = _window(file, header, asked.max_pixels)
    warnings = asked.warnings
    resolution = one_number(
        file,
        header.get("lateral_resolution", "0"),
        line=8,
        name="lateral_resolution",
        low=0.0,
        high=1.0,
    )
    own = lateral_or_none(file, "lateral_resolution", resolution, warnings)
    z = _heights(file, start, (x0, y0, width, height), warnings) * scale.factor
    if asked.unit is None and not np.isnan(z).all():
        warnings.append(_assumption(z))
    return asked.surface(
        z,
        (own, own),
        row_order="top row first",
        header=header,
        height_unit=scale.name,
        height_unit_from="caller" if asked.unit is not None else "description of the format",
        height_per_unit_m=scale.factor,
        window_origin_px=(x0, y0),
        camera_px=_camera(header),
    )


def _assumption(z: FloatArray) -> str:
    span = float(np.nanmax(z) - np.nanmin(z))
    return (
        f"the file states no unit of z; taken as um, so that P-V is {span * 1e9:.6g} nm; pass unit= "
        "if that cannot be"
    )


def _header_lines(file: RawFile) -> tuple[list[str], int]:
    """Return the lines before the first ``#``, and the offset of what follows it."""
    demand(file, FORMAT)
    lines: list[str] = []
    start = 0
    for _ in range(_MAX_HEADER):
        end = file.head.find(b"\n", start)
        if end < 0:
            break
        line = file.head[start:end].decode("latin-1").strip()
        start = end + 1
        if line == "#":
            if not lines[0].endswith(_VERSION):
                raise UnsupportedFeatureError(
                    f"{file.path}: is of another version ({lines[0][:60]!r}), only {_VERSION!r} is "
                    "read; export it as a .datx or .dat file"
                )
            if len(lines) >= max(_LINES):
                return lines, start
            break
        lines.append(line)
    raise file.corrupt(
        "the header is cut off",
        offset=start,
        expected=f"a line '#' after {max(_LINES)} to {_MAX_HEADER} lines",
        found=f"{len(lines)} lines",
    )


def _fields(lines: list[str]) -> dict[str, str]:
    header = {"title": lines[0]}
    for number, line in enumerate(lines[1:], start=2):
        names = _LINES.get(number, ())
        texts = [line] if len(names) == 1 else _FIELD.findall(line)
        for k, text in enumerate(texts):
            name = names[k] if k < len(names) else f"line_{number}_field_{k + 1}"
            header[name] = text.strip('"').strip()
    return header


def _window(
    file: RawFile, header: dict[str, str], max_pixels: int | None
) -> tuple[int, int, int, int]:
    found = []
    for name in _LINES[4]:
        text = header.get(name, "")
        if not (text.isascii() and text.isdecimal() and len(text) < 10):
            raise file.corrupt(
                "the window of the map is not usable",
                field=f"line 4, {name}",
                expected="a whole number",
                found=repr(text[:20]),
            )
        found.append(int(text))
    x0, y0, width, height = found
    names = ("phase_width", "phase_height")
    check_area(file, width, height, max_pixels=max_pixels, names=names)
    return x0, y0, width, height


def _camera(header: dict[str, str]) -> tuple[int, int] | None:
    texts = [header.get(name, "") for name in ("camera_width", "camera_height")]
    if all(t.isascii() and t.isdecimal() and len(t) < 10 for t in texts):
        return int(texts[0]), int(texts[1])
    return None


def _heights(
    file: RawFile, start: int, window: tuple[int, int, int, int], warnings: list[str]
) -> FloatArray:
    """Return z in the unit of the file, every point where its indices say."""
    x0, y0, width, height = window
    body = file.data[start:].rstrip()
    closed = body.endswith(b"#")
    values = parse_numbers(
        file, body.removesuffix(b"#"), offset=start, missing=(b"No Data",), what="a point"
    )
    n = values.size // 3
    if values.size != 3 * n or (not closed and n < width * height):
        raise file.corrupt(
            "the list of points is cut off",
            offset=file.size,
            expected=f"{width * height} points and a closing '#'",
            found=f"{values.size} numbers",
        )
    if not 0 < n <= width * height <= _MAX_GAPS * n:
        raise file.corrupt(
            "the points do not fill the window",
            field="line 4",
            expected=f"{width} x {height} = {width * height} points",
            found=f"{n}",
        )
    x, y, z = values.reshape(n, 3).T
    column, row = x - x0, y - y0
    fits = (column >= 0) & (column < width) & (row >= 0) & (row < height)  # NaN fits nowhere
    fits &= (column == np.floor(column)) & (row == np.floor(row))
    if not fits.all():
        k = int(np.argmin(fits))
        raise file.corrupt(
            "a point lies outside of the window",
            field=f"point {k + 1}",
            expected=f"whole x from {x0} to {x0 + width - 1}, y from {y0} to {y0 + height - 1}",
            found=f"{x[k]:g}, {y[k]:g}",
        )
    place = (row * width + column).astype(np.int64)
    heights = np.full(width * height, np.nan)
    heights[place] = z
    is_listed = np.zeros(width * height, dtype=np.bool_)
    is_listed[place] = True
    n_places = int(is_listed.sum())
    if n_places != n:
        raise file.corrupt(
            "two points lie at the same pixel", expected=f"{n} pixels", found=n_places
        )
    missing = width * height - n
    if missing:
        warnings.append(f"{missing} pixels of the window are not listed: taken as not measured")
    return heights.reshape(height, width)

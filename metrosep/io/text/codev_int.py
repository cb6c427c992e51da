"""Code V interferogram ``.int`` with a grid: integers, counted per wave, in text.

After comments (``!``) and a title comes ``GRD nx ny SUR|WFR|FIL WVL um SSZ counts NDA missing``,
then nx * ny integers, x fastest, the top row first; rows are turned so that row 0 has the
smallest y. Height in um is ``raw * WVL / SSZ``. A wavefront (WFR) stays a wavefront: no factor is
guessed. The format has no lateral step. See ``data_formats/codev-int/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from typing import Any, NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.io.declared import Match
from metrosep.io.objects import (
    Request,
    check_area,
    height_only,
    map_reader,
    scaled,
)
from metrosep.io.registry import mismatch
from metrosep.io.source import RawFile
from metrosep.io.text.logger import first_lines, one_number, parse_numbers

channels = height_only

_LINE_END = re.compile(rb"\r\r\n|\r\n|\r|\n")
FORMAT = "codev-int"
_HEADER = re.compile(r"\s*(GRD\s+\S+\s+\S+|ZRN\s+\S+)\s(?=.*\bSSZ\b)", re.IGNORECASE)
_COMMENT = re.compile(rb"^[ \t]*!.*$", re.MULTILINE)
_KINDS = {"SUR": "surface", "WFR": "wavefront", "FIL": "intensity filter"}
_NUMBER_KEYS = ("WVL", "SSZ", "NDA")
_MICROMETRE = 1e-6
_OWN = "written by metrosep"
"""How the first comment of our own files begins."""


class _Header(NamedTuple):
    """Title, comments and keywords of the header, its line, and where the integers begin."""

    title: str
    comments: list[str]
    keywords: dict[str, str]
    line: int
    start: int


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a Code V interferogram."""
    return Match.NO if _top(file)[-1] is None else Match.YES


@map_reader(FORMAT, "Code V", "a Code V interferogram with its own scale")
def read(asked: Request) -> Surface:
    """Return the grid of a Code V interferogram."""
    file = asked.file
    header = _header(file)
    kind = next((k for k in _KINDS if k in header.keywords), "")
    if kind not in ("SUR", "WFR"):
        raise UnsupportedFeatureError(
            f"{file.path}: the Code V grid holds {_KINDS.get(kind, 'data of unnamed kind')}, no heights; "
            "only SUR and WFR are read"
        )
    ranges = {"WVL": (1e-2, 1e3), "SSZ": (1e-9, 1e15)}
    wavelength, counts = (
        one_number(file, header.keywords.get(k, ""), line=header.line, name=k, low=low, high=high)
        for k, (low, high) in ranges.items()
    )
    scale = wavelength * _MICROMETRE / counts
    warnings = file.cut_text()
    raw = _integers(file, header, asked.max_pixels)
    own = _own_notes(header.comments)
    z = scaled(raw, scale, _missing(file, header, raw, warnings)) + own.middle
    return asked.surface(
        z,
        own.steps,
        origin=own.origin,
        row_order="top row first",
        header={"title": header.title, "comments": header.comments, **header.keywords},
        warnings=warnings,
        data_kind=_KINDS[kind],
        wavelength_m=wavelength * _MICROMETRE,
        counts_per_wave=counts,
        height_per_count_m=scale,
        nearest_neighbour="NNB" in header.keywords,
    )


def _header(file: RawFile) -> _Header:
    """Return the header: comments, the title, and the line of keywords."""
    comments, title, text, number = _top(file)
    if number is None:
        raise mismatch(file, FORMAT)
    ends = (m.end() for m in _LINE_END.finditer(file.data))
    start = next(itertools.islice(ends, number - 1, None), file.size)
    return _Header(title, comments, _keywords(file, text, number), number, start)


def _top(file: RawFile) -> tuple[list[str], str, str, int | None]:
    """Return comments, title, the line below it, and its number if it is a line of keywords."""
    comments: list[str] = []
    others: list[str] = []
    for number, line in enumerate(first_lines(file), start=1):
        text = line.strip()
        if text.startswith("!"):
            comments.append(text[1:].strip())
            continue
        others.append(text)
        if len(others) == 2:
            return comments, others[0], text, number if _HEADER.match(text) else None
    return comments, "", (others or [""])[-1], None


def _keywords(file: RawFile, text: str, line: int) -> dict[str, str]:
    """Return the keywords of the header line with their values as text."""
    words = text.upper().split()
    if words[0] == "ZRN":
        raise UnsupportedFeatureError(
            f"{file.path}: the Code V file holds Zernike coefficients, no grid; export it as a grid (GRD)"
        )
    found = {"GRD": " ".join(words[1:3])}
    k = 3
    while k < len(words):
        word = words[k]
        if word in _NUMBER_KEYS:
            found[word] = words[k + 1] if k + 1 < len(words) else ""
            k += 2
        elif word in _KINDS or word == "NNB":
            found[word] = ""
            k += 1
        else:
            raise UnsupportedFeatureError(
                f"{file.path}: line {line} of the Code V file has the keyword {word[:20]!r}, which is not "
                "read; export it with GRD, SUR or WFR, WVL, SSZ and NDA alone"
            )
    return found


def _integers(file: RawFile, header: _Header, max_pixels: int | None) -> FloatArray:
    """Return the grid of counts, top row first."""
    texts = header.keywords["GRD"].split()
    if not all(t.isascii() and t.isdecimal() and len(t) < 10 for t in texts):
        raise file.corrupt(
            "the size of the grid is not usable",
            field=f"line {header.line}, GRD",
            expected="two whole numbers",
            found=repr(header.keywords["GRD"][:40]),
        )
    columns, rows = (int(t) for t in texts)
    check_area(file, columns, rows, max_pixels=max_pixels, names=("GRD nx", "GRD ny"))
    body = _COMMENT.sub(lambda m: b" " * len(m.group()), file.data[header.start :])
    raw = parse_numbers(file, body, offset=header.start, what="a count")
    if raw.size != columns * rows:
        raise file.corrupt(
            "the integers do not fill the grid",
            field=f"line {header.line}, GRD",
            expected=f"{columns} x {rows} = {columns * rows}",
            found=raw.size,
        )
    if not np.array_equal(raw, np.rint(raw)):  # NaN is not a whole number either
        k = int(np.argmin(raw == np.rint(raw)))
        raise file.corrupt(
            "a count is not a whole number", field=f"count {k + 1}", found=f"{raw[k]:g}"
        )
    return raw.reshape(rows, columns)


class _Own(NamedTuple):
    """What metrosep states in the comments of its own files, in m; the format has none of it."""

    steps: tuple[float | None, float | None] = (None, None)
    middle: float = 0.0
    origin: tuple[float, float] = (0.0, 0.0)


_NUMBER = r"(-?\d[\d.]*(?:e[+-]?\d+)?)"
_STEPS = re.compile(rf"lateral steps dx = {_NUMBER} m, dy = {_NUMBER} m")
_MIDDLE = re.compile(rf"height of count 0: {_NUMBER} m")
_ORIGIN = re.compile(rf"first pixel at x = {_NUMBER} m, y = {_NUMBER} m")


def _own_notes(comments: list[str]) -> _Own:
    """Return the steps, the height of count 0 and the origin where metrosep wrote the file; no comment twice."""
    if not comments or not comments[0].startswith(_OWN):
        return _Own()
    stated = (
        [m for c in comments if (m := pattern.fullmatch(c))]
        for pattern in (_STEPS, _MIDDLE, _ORIGIN)
    )
    steps, middle, origin = (
        [*map(float, own[0].groups())] if len(own) == 1 else [] for own in stated
    )
    return _Own(
        (steps[0], steps[1]) if steps else (None, None),
        middle[0] if middle else 0.0,
        (origin[0], origin[1]) if origin else (0.0, 0.0),
    )


def _missing(
    file: RawFile, header: _Header, raw: FloatArray, warnings: list[str]
) -> np.ndarray[Any, np.dtype[np.bool_]] | None:
    """Return where nothing was measured."""
    if "NDA" not in header.keywords:
        warnings.append("the file declares no NDA: every count was taken as measured")
        return None
    text = header.keywords["NDA"]
    marker = one_number(file, text, line=header.line, name="NDA", low=-1e15, high=1e15)
    return np.asarray(raw == marker)


# ---- bytes of a Code V ``.int`` grid from a surface; the same surface gives the same bytes -----
# The format holds 16-bit counts: heights are rounded to steps of P-V / 65534. The middle between
# the largest and smallest height becomes 0, since a constant would cost resolution; comments state
# it, which we read back, and the title states the step. Written top row first; lines have at most 80 characters. WVL is
# only the unit of SSZ: with 1 um, programs that divide by it where they should multiply (prysm 0.21)
# read the right heights too.

_LARGEST = 32767
_MISSING = -32768
_PER_LINE = 10
_TITLE = 48
"""Characters of the caller's title; the step follows within the 80 of a record."""

_FLAT_STEP = 1e-15
"""Step in m for a surface without relief: every count is 0 whatever the step."""


def quantisation_step(surface: Surface) -> float:
    """Return the step to which `int_bytes` rounds heights."""
    low, high = _range(surface)
    return (high - low) / (2 * _LARGEST) if high > low else _FLAT_STEP


def int_bytes(
    surface: Surface,
    *,
    wavelength: float = 1e-6,
    kind: str = "SUR",
    title: str = "metrosep",
) -> bytes:
    """Return a surface as the content of a Code V ``.int`` file with a grid."""
    low, high = _range(surface)
    if kind not in ("SUR", "WFR"):
        raise WriteError(f"Code V kind {kind!r} is not written; use 'SUR' or 'WFR'")
    if not 1e-8 <= wavelength <= 1e-3:  # also catches NaN
        raise WriteError(f"wavelength is {wavelength} m; Code V needs one from 10 nm to 1 mm")
    clean = title.strip()
    if not (clean.isascii() and clean.isprintable() and len(clean) <= _TITLE) or "!" in clean:
        raise WriteError(
            f"title {title[:60]!r} does not fit; use up to {_TITLE} ASCII characters without !"
        )
    step = quantisation_step(surface)
    micrometres = f"{wavelength * 1e6:.12g}"
    counts_per_wave = f"{float(micrometres) * 1e-6 / step:.15g}"
    middle = low + (high - low) / 2
    unit = float(micrometres) * 1e-6 / float(counts_per_wave)
    raw = np.clip(np.rint((surface.z - middle) / unit), -_LARGEST, _LARGEST)
    counts = np.where(np.isnan(raw), _MISSING, raw).astype(np.int64)[::-1]
    rows, columns = surface.shape
    lines = [
        f"! {_OWN}; top row first, heights point out of the material",
        f"! height of count 0: {middle!r} m",
        f"! lateral steps dx = {surface.dx!r} m, dy = {surface.dy!r} m",
        "! first pixel at x = {!r} m, y = {!r} m".format(*surface.origin),
        f"{clean} (step {format_length(step, digits=6)})",
        f"GRD {columns} {rows} {kind} WVL {micrometres} SSZ {counts_per_wave} NDA {_MISSING}",
    ]
    flat = [f"{v:7d}" for v in counts.ravel().tolist()]
    lines += ["".join(flat[i : i + _PER_LINE]) for i in range(0, len(flat), _PER_LINE)]
    return ("\n".join(lines) + "\n").encode("ascii")


def _range(surface: Surface) -> tuple[float, float]:
    if np.isnan(surface.z).all():
        raise WriteError("nothing was measured, so there is nothing to write as Code V INT")
    return float(np.nanmin(surface.z)), float(np.nanmax(surface.z))

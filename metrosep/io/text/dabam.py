"""DABAM, the open database of mirror profiles: columns in ``.dat``, their meaning in JSON beside it.

The file to read is the JSON (``.txt``); the columns lie in ``.dat`` of the same stem in the same
folder. ``FILE_FORMAT`` says whether column Y1 holds slopes (1, rad) or heights (2, m). Slopes are
never returned as heights: ``slope="integrate"`` sums them by the trapezoid rule,
z[k] = z[k-1] + (s[k-1] + s[k]) / 2 * (x[k] - x[k-1]) with z[0] = 0. What that cannot know: the
height of the first point (piston); an offset of the slopes becomes a tilt, and noise of the
slopes grows like a random walk. See ``data_formats/dabam/SPEC.md``.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    ReadError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.io.objects import make_profile, only_channels
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options
from metrosep.io.text.logger import also_read, beside, first_lines, number_rows, text_lines

__all__ = ["channels", "read", "sniff"]

FORMAT = "dabam"
_MARKS = ('"FILE_FORMAT"', '"X1_FACTOR"', '"FILE_HEADER_LINES"')
_SUFFIXES = (".dat", ".DAT")
_MAX_JSON = 2**20
_MAX_COLUMNS = 1000
_SLOPES, _HEIGHTS = 1, 2
_KIND = {_SLOPES: "slope", _HEIGHTS: "height"}
_WORDS = (
    ("slope", re.compile("slope", re.IGNORECASE)),
    ("height", re.compile("hei[gt]", re.IGNORECASE)),
)
"""How titles name the quantity of a further column; the files write "Heigth" as well."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is the JSON of a DABAM profile."""
    top = next((line for line in first_lines(file) if line.strip()), "")
    if not top.lstrip().startswith("{") or file.size > _MAX_JSON:
        return Match.NO
    text = "\n".join(first_lines(file))
    return Match.YES if all(m in text for m in _MARKS) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the columns ``Y1``, ``Y2`` ... that have a factor to SI."""
    return _channels(_header(file))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    slope: str | None = None,
) -> Profile:
    """Return a height profile of a DABAM entry."""
    refuse_options(file, "a DABAM profile with its own factors", unit=unit)
    if slope not in (None, "integrate"):
        raise ReadError(f"{file.path}: slope={slope!r} is unknown; use slope='integrate'")
    override = lateral_steps(lateral_step)
    header = _header(file)
    name = only_channels(file, "DABAM", channel, _channels(header))
    column = int(name[1:])
    kind = _kind(file, header, column)
    data = beside(file, _SUFFIXES)
    x, values, n_columns = _columns(file, data, header, column)
    factor = {"X1_FACTOR": header["X1_FACTOR"], f"{name}_FACTOR": header[f"{name}_FACTOR"]}
    facts: dict[str, Any] = {
        "channel": name,
        "quantity_in_file": kind,
        "title_in_file": str(header.get(f"PLOT_TITLE_{name}") or ""),
        "factors_to_si": factor,
        "n_columns": n_columns,
        "data_file": data.name,
        "data_sha256": data.sha256,
    }
    steps = [also_read(data, channel=name)]
    if kind == "slope":
        refuse_options(file, "a profile of slopes over its own positions", lateral_step=override)
        facts |= _of_slopes(file, name, values, x, integrate=slope == "integrate")
        values = _integrated(x, values)
        steps.append(Step("integrate_slopes", {"rule": "trapezoid", "null_space": "piston"}))
    elif slope is not None:
        refuse_options(file, f"a DABAM profile whose {name} holds heights", slope=slope)
    profile = make_profile(
        file,
        FORMAT,
        x,
        values,
        header=header,
        override=override[0] if override else None,
        **facts,
    )
    history = (*profile.history, *steps)
    return Profile(profile.x, profile.z, metadata=profile.metadata, history=history)


def _header(file: RawFile) -> dict[str, Any]:
    """Return the JSON, refused unless the keys that say how to read the columns are usable."""
    if sniff(file) is Match.NO:
        raise FormatMismatchError(
            f"{file.path}: is no DABAM description: expected JSON with FILE_FORMAT, FILE_HEADER_LINES "
            "and X1_FACTOR; pass the .txt of the entry, not its .dat"
        )
    try:
        header = json.loads("\n".join(text_lines(file)))
    except (ValueError, RecursionError) as exc:
        reason = f"the JSON is damaged ({str(exc)[:80]})"
        raise CorruptFileError(file.path, reason, hint="copy the .txt again") from None
    if not isinstance(header, dict):
        raise CorruptFileError(file.path, "the JSON is no object", expected="{...}")
    if str(header.get("FILE_FORMAT")) not in {str(k) for k in _KIND}:
        raise UnsupportedFeatureError(
            f"{file.path}: FILE_FORMAT is {str(header.get('FILE_FORMAT'))[:20]}; metrosep reads 1 "
            "(slopes) and 2 (heights)"
        )
    n = header.get("FILE_HEADER_LINES")
    if not isinstance(n, int) or isinstance(n, bool) or n < 0:
        raise _wrong(file, "FILE_HEADER_LINES", "a count of lines", n)
    for key in ("X1_FACTOR", *(f"{c}_FACTOR" for c in _channels(header))):
        value = header.get(key)
        usable = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not usable or not 1e-15 <= abs(value or 0) <= 1e3:
            raise _wrong(file, key, "a factor to SI of 1e-15 to 1000", value)
    if not _channels(header):
        raise _wrong(file, "Y1_FACTOR", "a factor to SI", None)
    return header


def _wrong(file: RawFile, key: str, expected: str, found: object) -> CorruptFileError:
    return CorruptFileError(
        file.path,
        "the description of the columns is not usable",
        field=key,
        expected=expected,
        found=repr(found)[:40],
    )


def _channels(header: dict[str, Any]) -> tuple[str, ...]:
    names = (f"Y{i}" for i in range(1, _MAX_COLUMNS))
    return tuple(n for n in names if f"{n}_FACTOR" in header)


def _kind(file: RawFile, header: dict[str, Any], column: int) -> str:
    """Return what a column holds: Y1 by FILE_FORMAT, the others by their title."""
    if column == 1:
        return _KIND[int(header["FILE_FORMAT"])]
    title = str(header.get(f"PLOT_TITLE_Y{column}") or "")
    found = [word for word, pattern in _WORDS if pattern.search(title)]
    if len(found) != 1:
        raise UnsupportedFeatureError(
            f"{file.path}: nothing says whether Y{column} holds slopes or heights (its title is "
            f"{title[:40]!r}, FILE_FORMAT describes Y1 only); name it in PLOT_TITLE_Y{column}"
        )
    return found[0]


def _columns(
    file: RawFile, data: RawFile, header: dict[str, Any], column: int
) -> tuple[FloatArray, FloatArray, int]:
    """Return positions in m and one column in SI, and how many columns of values there are."""
    lines, rows = number_rows(file, data, skip=header["FILE_HEADER_LINES"])
    table = np.array(rows)
    if len(rows) < 2:
        raise CorruptFileError(
            file.path, f"there is one row in {data.name}", field=f"line {lines[0]}", expected=2
        )
    if column >= table.shape[1]:
        raise CorruptFileError(
            file.path,
            f"there is no column Y{column} in {data.name}",
            expected=f"{column + 1} columns",
            found=table.shape[1],
            hint="check FILE_HEADER_LINES, or copy both files again",
        )
    x = table[:, 0]
    if np.isnan(x).any():
        line = lines[int(np.flatnonzero(np.isnan(x))[0])]
        raise CorruptFileError(
            file.path, f"a point of {data.name} has no position", field=f"line {line}"
        )
    factors = header["X1_FACTOR"], header[f"Y{column}_FACTOR"]
    return x * factors[0], table[:, column] * factors[1], table.shape[1] - 1


def _of_slopes(
    file: RawFile, name: str, slopes: FloatArray, x: FloatArray, *, integrate: bool
) -> dict[str, Any]:
    """Return facts on slopes; refuse them as heights, or with gaps that no sum can bridge."""
    valid = slopes[~np.isnan(slopes)]
    pv, rms = (float(np.ptp(valid)), float(valid.std())) if valid.size else (math.nan, math.nan)
    if not integrate:
        raise UnsupportedFeatureError(
            f"{file.path}: {name} holds slopes (P-V {pv * 1e6:.7g} urad, RMS {rms * 1e6:.7g} urad), not "
            "heights; pass slope='integrate' for heights by the trapezoid rule (their piston stays "
            "unknown)"
        )
    if valid.size < slopes.size:
        raise UnsupportedFeatureError(
            f"{file.path}: {slopes.size - valid.size} slopes of {name} were not measured; heights beyond "
            "a gap cannot be joined: cut the columns at the gap"
        )
    step = float(np.abs(np.diff(x)).mean())
    return {
        "slope_pv_rad": pv,
        "slope_rms_rad": rms,
        "slope_mean_rad": float(valid.mean()),
        "end_height_noise_m_per_rad": step * math.sqrt(slopes.size - 1),
    }


def _integrated(x: FloatArray, slopes: FloatArray) -> FloatArray:
    heights = np.zeros(x.size)
    np.cumsum(0.5 * (slopes[1:] + slopes[:-1]) * np.diff(x), out=heights[1:])
    return heights

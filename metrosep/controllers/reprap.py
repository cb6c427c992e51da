"""Height map of RepRapFirmware: ``heightmap.csv``, version 2.

A value is the height that the firmware adds to the commanded Z, so c = -e; rows are the second axis,
values across the first. Between nodes it is bilinear in single precision, outside that of the
edge, at the far ends that 0.01 mm inside. A ``0`` without a decimal point means "not probed" and is
replaced by a fitted plane, so zeros are written ``0.000``; lines longer than the firmware's buffer
are cut, so decimals must fit. Read in the firmware's source (BedProbing/Grid.cpp), not run.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._grammar import (
    NUMBER,
    Line,
    Text,
    Word,
    damaged,
    decimal,
    decoded,
    fixed,
    joined,
    require_last_end,
)
from metrosep.controllers._grids import even_map
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    map_identity,
    nearest_zero,
    one_way,
)
from metrosep.controllers.options import Option, pick, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, Example, LimitError, TableError
from metrosep.core.units import format_length

# ---- bed mesh of Klipper: a profile ``[bed_mesh NAME]`` for its configuration ------------------
# A point is the height that Klipper adds to the commanded Z, so c = -e; rows are y from the lowest
# on, x across. With ``algo = direct`` and no points between, the mesh is plain bilinear and clamps at
# its edges; the other algorithms overshoot. Confirmed against Klipper's own mesh code
# (tests/acceptance/klipper). Klipper looks at the mesh at the end of a move and, within it, only every
# `move_check_distance`, where it acts on changes of `split_delta_z` and more: no carrier for
# ultraprecision unless the path itself is dense.

_FARTHEST, _LARGEST = 1e3, 1.0
"""Position and correction beyond which units are mistaken, m."""
_PLACES = 9
"""Decimals of a position in mm; Klipper keeps doubles."""
_KEYS = (
    "version",
    "points",
    "x_count",
    "y_count",
    "mesh_x_pps",
    "mesh_y_pps",
    "algo",
    "tension",
    "min_x",
    "max_x",
    "min_y",
    "max_y",
)
_FIXED = {"version": "1", "mesh_x_pps": "0", "mesh_y_pps": "0", "algo": "direct"}
_SECTION = re.compile(r"\[bed_mesh ([^\]\s]+)\]")
_PROFILE = re.compile(r"[A-Za-z0-9_.-]{1,60}")
"""Klipper cuts a line at # and ;, and takes no blanks here."""

SPACINGS = (
    Option(
        "x_spacing", "largest spacing of x, where positions are not even", "length", positive=True
    ),
    Option(
        "y_spacing", "largest spacing of y, where positions are not even", "length", positive=True
    ),
)
"""Options for a grid that the format wants even."""


class Klipper(Dialect):
    """Writer and reader of bed meshes; see the module."""

    info = DialectInfo(
        id="klipper",
        title="Klipper bed mesh",
        entry="height added to the commanded Z: -e",
        units="mm",
        outside="that of the nearest edge",
        sign_status="confirmed by running Klipper and its mesh code",
        activation=(
            "include the file in printer.cfg; [bed_mesh] must be there too, without fade_end",
            "set split_delta_z: 0.01 and move_check_distance: 3, the finest it takes",
            "restart Klipper, home, then BED_MESH_PROFILE LOAD=<name>; BED_MESH_CLEAR takes it off",
            "write paths whose points are nearer than the nodes of the mesh, or it is not followed",
            "compare the toolhead's Z of GET_POSITION with the commanded one at a node",
        ),
        sign="confirmed",
        carries="map",
        spacing="uniform",
        directions="one",
        resolution="10 um within a move, 1 pm as printed at its end",
        reference_rule="none; Z is homed with the mesh off",
        proof="Klipper's own mesh code",
        suffix=".cfg",
        page="meshes",
    )
    options = (
        Option("profile", "name of the mesh", "text", default="metrosep"),
        *SPACINGS,
        Option("split_delta_z", "as in printer.cfg", "length", default=25e-6, lowest=10e-6),
        Option("move_check_distance", "as in printer.cfg", "length", default=5e-3, lowest=3e-3),
        whole("decimals", "of a height in mm", 3, 12, default=_PLACES),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        require_bed(table, "Klipper")
        name = options["profile"]
        if _PROFILE.fullmatch(name) is None:
            raise TableError(
                f"profile={name[:60]!r} cannot be the name of a mesh; use letters, digits and _ . - "
                "(60 at most)"
            )
        carried, error = even_map(table, options, ("x_spacing", "y_spacing"))
        places = options["decimals"]
        printed = [[fixed(v / _MM, places) for v in row] for row in carried.values]
        back = np.array([[float(v) for v in row] for row in printed]) * _MM
        values = {
            **_FIXED,
            "x_count": str(carried.x.size),
            "y_count": str(carried.y.size),
            "tension": "0.2",
            **{
                f"{end}_{axis}": decimal(round(float(p[i]) / _MM, _PLACES))
                for axis, p in (("x", carried.x), ("y", carried.y))
                for end, i in (("min", 0), ("max", -1))
            },
        }
        lines = [f"[bed_mesh {name}]"]
        for key in _KEYS:
            if key == "points":
                lines += ["points =", *("  " + ", ".join(row) for row in printed)]
            else:
                lines.append(f"{key} = {values[key]}")
        return Encoded(
            data=joined(lines),
            quantisation=float(np.abs(back - carried.values).max()),
            notes={"load": f"BED_MESH_PROFILE LOAD={name}"},
            step=10.0**-places * _MM,
            carried=carried,
            resampling_error=error,
            findings=_klipper_findings(carried, options),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map, refusing what Klipper would drop or die of."""
        keys, rows = _klipper_parsed(data, path)
        for key, wanted in _FIXED.items():
            if keys[key] != wanted:
                raise CorruptFileError(
                    path,
                    "only plain bilinear meshes of version 1 hold what was written",
                    field=key,
                    expected=wanted,
                    found=keys[key],
                )
        n, m = (_count(keys[k], k, path) for k in ("x_count", "y_count"))
        if len(rows) != m or any(len(r) != n for _, r in rows):
            raise CorruptFileError(
                path,
                "rows of points are missing or ragged; Klipper would load them and die on the first "
                "move",
                field="points",
                expected=f"{m} rows of {n}",
                found=f"{len(rows)} rows of {sorted({len(r) for _, r in rows})}",
            )
        values = np.array([r for _, r in rows]) * _MM
        ends = [_number(keys[k], k, path) * _MM for k in _KEYS[-4:]]
        _number(keys["tension"], "tension", path)
        if not (ends[0] < ends[1] and ends[2] < ends[3]):
            raise CorruptFileError(
                path, "min must be below max", field="min_x, max_x, min_y, max_y", found=ends
            )
        x, y = np.linspace(ends[0], ends[1], n), np.linspace(ends[2], ends[3], m)
        return CompensationMap(x, y, values, is_exact_inverse=True, **_bed(path, x, y))


def _bed(path: Path, x: FloatArray, y: FloatArray) -> dict[str, Any]:
    """Return the fields of Z over X and Y."""
    zero, turns = nearest_zero(x, y), (False, False)
    return map_identity(path, axes=("X", "Y"), compensates="Z", first=zero, turns=turns)


def require_bed(table: CompensationMap, controller: str) -> None:
    """Refuse a map that is not Z over X and Y."""
    if table.axes != ("X", "Y") or table.compensates != "Z":
        raise TableError(
            f"{controller} corrects Z over X (columns) and Y (rows), this map is "
            f"{table.axes[0]}, {table.axes[1]} -> {table.compensates}; write controller='csv-map'"
        )
    for what, values, most in (
        ("position", table.x, _FARTHEST),
        ("position", table.y, _FARTHEST),
        ("correction", table.values, _LARGEST),
    ):
        worst = float(np.abs(values).max())
        if worst > most:
            raise LimitError(
                f"{controller}: a {what} of {format_length(worst)} exceeds {format_length(most)}; check "
                "the units of the map"
            )


def _klipper_findings(table: CompensationMap, options: dict[str, Any]) -> tuple[Finding, ...]:
    """Say what of the map Klipper cannot follow within a move."""
    delta, check = options["split_delta_z"], options["move_check_distance"]
    step_x, step_y = float(table.x[1] - table.x[0]), float(table.y[1] - table.y[0])
    span = float(np.ptp(table.values))
    found = [
        Finding.warning(
            "Klipper looks at the mesh at the end of a move, and within it every "
            f"{format_length(check)} for changes of {format_length(delta)}; the corrections span "
            f"{format_length(span)}"
            + (": within a move they are not followed at all" if span < delta else ""),
            f"write points nearer than {format_length(min(step_x, step_y))}, or rewrite the path "
            "itself instead of the mesh",
            "splitting",
        )
    ]
    if min(step_x, step_y) < check:
        found.append(
            Finding.warning(
                f"nodes lie {format_length(min(step_x, step_y))} apart, nearer than the "
                f"{format_length(check)} at which Klipper looks",
                "lower move_check_distance (3 mm at least), or write a denser path",
                "splitting",
            )
        )
    return tuple(found)


def _klipper_parsed(
    data: bytes, path: Path
) -> tuple[dict[str, str], list[tuple[int, list[float]]]]:
    """Return keys, and the rows of points with their lines."""
    keys: dict[str, str] = {}
    rows: list[tuple[int, list[float]]] = []
    section, last = False, ""
    lines = decoded(data, path, "Klipper configuration").splitlines()
    require_last_end(data.decode("ascii"), path)
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        if line.startswith("["):
            found = _SECTION.fullmatch(line)
            if section or found is None or _PROFILE.fullmatch(found[1]) is None:
                raise _wrong(path, number, "one section [bed_mesh NAME]", line)
            section = True
        elif line[0] in " \t" and last == "points":
            rows.append((number, _points(line, number, path)))
        else:
            key, sign, value = line.partition("=") if "=" in line else line.partition(":")
            last = key.strip()
            if not (section and sign) or last not in _KEYS or last in keys or line[0].isspace():
                raise _wrong(path, number, "a key of a mesh, once", line)
            keys[last] = value.strip()
            if last == "points" and value.strip():
                rows.append((number, _points(value, number, path)))
    missing = [k for k in _KEYS if k not in keys]
    if missing:
        raise CorruptFileError(path, "a mesh is not complete", field=missing[0], found="nothing")
    return keys, rows


def _points(line: str, number: int, path: Path) -> list[float]:
    words = [w.strip() for w in line.split(",")]
    if not all(map(_NUMBER.fullmatch, words)):
        raise _wrong(path, number, "numbers with commas between; Klipper would not start", line)
    return [float(w) for w in words]


def _count(text: str, key: str, path: Path) -> int:
    if not text.isdecimal() or int(text) < 2:
        raise CorruptFileError(path, "a mesh has 2 nodes at least", field=key, found=text)
    return int(text)


def _number(text: str, key: str, path: Path) -> float:
    if _NUMBER.fullmatch(text) is None:
        raise CorruptFileError(path, "a number is needed", field=key, found=text[:40])
    return float(text)


# ------------------------------------------------------------------------------------------------

MAX_COLUMNS = 41
"""Nodes along the first axis."""
MAX_LINE = 8 * MAX_COLUMNS
"""Characters of a line that surely fit the firmware's buffer, eight for each of its columns."""
_MIN_SPACING, _MIN_RANGE = 0.1, 1.0
"""Of the firmware, mm."""
_EDGE = np.float32(0.01)
"""Positions are held this far, in mm, inside the last node."""
_MM = 1e-3
_FEWEST, _MOST = 3, 7
"""Decimals of a height in mm; single precision of 1 mm ends there."""
_NUMBER = re.compile(r"-?\d+(\.\d+)?")
_HEAD = Line("RepRapFirmware height map file v2{more}", more=Word(".*"))
_LABELS = Line("axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1")
_ENDS, _STEPS = ("min0", "max0", "min1", "max1"), ("spacing0", "spacing1")
_SIZES = Line(
    "X,Y,{min0},{max0},{min1},{max1},{radius},{spacing0},{spacing1},{n},{m}",
    loose=False,
    **dict.fromkeys((*_ENDS, "radius", *_STEPS), NUMBER),
)
_POSITION = 6
"""Decimals of a position in mm."""
_HEIGHT = re.compile(r"-?\d+\.\d+")


class RepRap(Dialect):
    """Writer and reader of height maps; see the module."""

    info = DialectInfo(
        id="rrf",
        title="RepRapFirmware height map",
        entry="height added to the commanded Z: -e",
        units="mm",
        outside="that of the nearest edge; at the far ends that 0.01 mm inside",
        sign_status="read in the firmware's source, not run",
        activation=(
            "copy the file to /sys of the board",
            "home, then G29 S1 P<name> loads and enables it; G29 S2 takes it off",
            "M376 H0: no taper over height, or the correction fades with Z",
            "after loading: G29 reports the number of points; every one must count as probed",
        ),
        carries="map",
        spacing="uniform",
        directions="one",
        resolution="0.1 nm to 1 um: as many decimals as fit the line; single precision",
        reference_rule="none; Z is homed with the map off",
        proof="own strict parser and lookup after the firmware's source",
        suffix=".csv",
        page="meshes",
    )
    options = (
        *SPACINGS,
        pick("max_nodes", "441, or 961 of boards 6HC and 6XD", (441, 961), default=441),
        whole("decimals", "of a height in mm; as many as fit if omitted", _FEWEST, _MOST),
    )  # fmt: skip

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        require_bed(table, "RepRapFirmware")
        carried, error = even_map(table, options, ("x_spacing", "y_spacing"))
        _require_limits(carried, options["max_nodes"])
        places, rows = _fitting(carried.values / _MM, options["decimals"])
        back = (
            np.array([[float(v) for v in r] for r in rows], dtype=np.float32).astype(float) * _MM
        )
        ends = [float(p[i]) / _MM for p in (carried.x, carried.y) for i in (0, -1)]
        steps = [(e[1] - e[0]) / (p.size - 1) for e, p in _pairs(ends, carried)]
        words = [decimal(round(v, _POSITION)) for v in ends]
        words += [decimal(round(v, 12)) for v in steps]
        lines = [
            _HEAD.write(more=" generated by metrosep"),
            _LABELS.write(),
            _SIZES.write(
                **dict(zip((*_ENDS, *_STEPS), words, strict=True)),
                radius="-1.00",
                n=carried.x.size,
                m=carried.y.size,
            ),
            *(",".join(row) for row in rows),
        ]
        return Encoded(
            data=joined(lines),
            quantisation=float(np.abs(back - carried.values).max()) + _single(carried, back),
            notes={"decimals_of_mm": places},
            step=10.0**-places * _MM,
            carried=carried,
            resampling_error=error + _held_short(carried),
            findings=_findings(places, options["decimals"]),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map, refusing what the firmware would reject, cut or replace."""
        grid, values = _parsed(data, path, int(options.get("max_nodes") or 441))
        x, y = (
            np.asarray((grid[2 * i] + grid[4 + i] * np.arange(n, dtype=np.float64)) * _MM)
            for i, n in enumerate(values.shape[::-1])
        )
        return CompensationMap(x, y, values * _MM, is_exact_inverse=True, **_bed(path, x, y))

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the firmware adds to Z, in its single precision."""
        grid, values = _parsed(data, path, int(options.get("max_nodes") or 441))
        heights = values.astype(np.float32)
        low = [np.float32(grid[0]), np.float32(grid[2])]
        step = [np.float32(grid[4]), np.float32(grid[5])]

        def cells(p: NDArray[Any], i: int) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
            n = heights.shape[1 - i]
            last = low[i] + np.float32(n - 1) * step[i]
            inside = np.clip((p / _MM).astype(np.float32), low[i], last - _EDGE)
            u = (inside - low[i]) * (np.float32(1.0) / step[i])
            # rounding may reach the last node itself
            k = np.minimum(np.floor(u).astype(np.intp), n - 2)
            return k, u - k.astype(np.float32)

        def over(px: FloatArray, py: FloatArray) -> FloatArray:
            (i, s), (j, t) = cells(px, 0), cells(py, 1)
            both = s * t
            z = (
                heights[j, i] * (1.0 - s - t + both)
                + heights[j, i + 1] * (s - both)
                + heights[j + 1, i] * (t - both)
                + heights[j + 1, i + 1] * both
            )
            return np.asarray(z.astype(np.float64) * _MM)

        return one_way(over, 2)


def _pairs(ends: list[float], table: CompensationMap) -> list[tuple[list[float], FloatArray]]:
    """Return the ends as they are printed with the positions of either axis."""
    printed = [round(v, _POSITION) for v in ends]
    return [(printed[:2], table.x), (printed[2:], table.y)]


def _require_limits(table: CompensationMap, most: int) -> None:
    n, m = table.x.size, table.y.size
    if n * m > most or n > MAX_COLUMNS:
        raise LimitError(
            f"{n} x {m} nodes, the board takes {most} and {MAX_COLUMNS} along X; give x_spacing= and "
            "y_spacing=, or max_nodes=961 of a board that takes them"
        ).hinting(max_nodes=Example("961"))
    for name, p in zip(table.axes, (table.x, table.y), strict=True):
        span, step = float(p[-1] - p[0]) / _MM, float(p[1] - p[0]) / _MM
        if span < _MIN_RANGE or step < _MIN_SPACING * (1.0 + 1e-6):
            raise LimitError(
                f"{name} spans {span:.6g} mm in steps of {step:.6g} mm; the firmware takes "
                f"{_MIN_RANGE:g} mm and more, in steps above {_MIN_SPACING:g} mm"
            )


def _fitting(heights: FloatArray, wanted: int | None) -> tuple[int, list[list[str]]]:
    """Return decimals and printed rows that fit the firmware's line."""
    longest = 0
    for places in range(_MOST if wanted is None else wanted, _FEWEST - 1, -1):
        rows = [[fixed(v, places) for v in row] for row in heights]
        longest = max(len(",".join(row)) for row in rows)
        if longest <= MAX_LINE:
            return places, rows
        if wanted is not None:
            break
    raise LimitError(
        f"a row of {heights.shape[1]} heights is {longest} characters long, the firmware reads "
        f"{MAX_LINE} and cuts the rest; give fewer decimals=, or a coarser x_spacing="
    )


def _findings(places: int, wanted: int | None) -> tuple[Finding, ...]:
    if wanted is not None or places == _MOST:
        return ()
    return (
        Finding.warning(
            f"only {places} decimals of a mm fit a line: heights in steps of "
            f"{format_length(10.0**-places * _MM)}",
            "fewer columns (x_spacing=) leave room for more",
            "line",
        ),
    )


def _held_short(carried: CompensationMap) -> float:
    """Return what the firmware misses in the last 0.01 mm, where it holds the value before."""
    ends = (
        (np.diff(carried.values[:, -2:], axis=1), carried.x),
        (np.diff(carried.values[-2:], axis=0), carried.y),
    )
    return sum(float(np.abs(d).max()) * 0.01 * _MM / float(p[-1] - p[-2]) for d, p in ends)


def _single(carried: CompensationMap, back: FloatArray) -> float:
    """Return what single precision of heights and positions costs at most."""
    eps = float(np.finfo(np.float32).eps)
    slopes = [
        float(np.abs(np.diff(back, axis=axis)).max()) / float(np.diff(p).min())
        for axis, p in ((1, carried.x), (0, carried.y))
    ]
    reach = [float(np.abs(p).max() + np.ptp(p)) for p in (carried.x, carried.y)]
    shifts = sum(s * r for s, r in zip(slopes, reach, strict=True))
    return 4.0 * eps * (float(np.abs(back).max()) + shifts)


def _parsed(data: bytes, path: Path, most: int) -> tuple[list[float], FloatArray]:
    """Return min0, max0, min1, max1, spacings in mm, and the heights in mm."""
    lines = decoded(data, path, "height map").splitlines()
    require_last_end(data.decode("ascii"), path)
    long = [i for i, line in enumerate(lines, start=1) if len(line) > MAX_LINE]
    if long:
        raise _wrong(
            path, long[0], f"at most {MAX_LINE} characters: the rest is cut", lines[long[0] - 1]
        )
    text = Text(path, list(enumerate(lines, start=1)), "height map")
    text.take(_HEAD)
    text.take(_LABELS)
    sizes = text.take(_SIZES)
    if sizes["radius"] >= 0.0:
        raise _wrong(path, 3, "radius -1 (all of the rectangle)", lines[2])
    grid, n, m = [sizes[k] for k in (*_ENDS, *_STEPS)], sizes["n"], sizes["m"]
    _check_grid(grid, n, m, most, path, lines[2])
    if len(lines) != m + 3:
        raise CorruptFileError(
            path, "rows are missing or too many", expected=f"{m} rows", found=len(lines) - 3
        )
    return grid, np.array([_row(line, i, n, path) for i, line in text.rows[text.at :]])


def _check_grid(grid: list[float], n: int, m: int, most: int, path: Path, line: str) -> None:
    if n < 2 or m < 2 or n > MAX_COLUMNS or n * m > most:
        raise _wrong(path, 3, f"2 nodes and more, up to {MAX_COLUMNS} and {most} in all", line)
    for low, high, step, count in ((*grid[:2], grid[4], n), (*grid[2:4], grid[5], m)):
        if high - low < _MIN_RANGE or step < _MIN_SPACING:
            raise _wrong(path, 3, "ranges of 1 mm and spacings of 0.1 mm at least", line)
        if abs(low + step * (count - 1) - high) > 0.01 * step:
            raise _wrong(path, 3, "min + (num - 1) spacing = max", line)


def _row(line: str, number: int, n: int, path: Path) -> list[float]:
    words = [w.strip(" \t") for w in line.split(",")]
    if "0" in words:
        raise CorruptFileError(
            path,
            f"line {number}: 0 without a decimal point means not probed, the firmware would put a "
            "fitted plane there",
            hint="write 0.000 for a height of zero",
        )
    if len(words) != n or not all(map(_HEIGHT.fullmatch, words)):
        raise _wrong(path, number, f"{n} heights with decimal points", line)
    return [float(w) for w in words]


def _wrong(path: Path, line: int, expected: str, found: str) -> CorruptFileError:
    return damaged(
        path,
        f"line {line} does not belong into a mesh or height map",
        expected=expected,
        found=found.strip()[:60] or "nothing",
    )

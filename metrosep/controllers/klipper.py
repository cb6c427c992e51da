"""Bed mesh of Klipper: a profile ``[bed_mesh NAME]`` for its configuration.

A point is the height that Klipper adds to the commanded Z, so c = -e; rows are y from the lowest
on, x across. With ``algo = direct`` and no points between, the mesh is plain bilinear and clamps at
its edges; the other algorithms overshoot. Confirmed against Klipper's own mesh code
(tests/acceptance/klipper). Klipper looks at the mesh at the end of a move and, within it, only every
`move_check_distance`, where it acts on changes of `split_delta_z` and more: no carrier for
ultraprecision unless the path itself is dense.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._even import even_map
from metrosep.controllers._plain_text import ascii_lines, decimal
from metrosep.controllers.base import Dialect, DialectInfo, Encoded
from metrosep.controllers.neutral_map import map_fields, require_last_end
from metrosep.controllers.options import Option
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["SPACINGS", "Klipper", "require_bed"]


_MM = 1e-3
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
_NUMBER = re.compile(r"-?\d+(\.\d+)?")
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
        max_points=None,
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
        Option("decimals", "of a height in mm", "integer", default=_PLACES, lowest=3, highest=12),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the section."""
        require_bed(table, "Klipper")
        name = options["profile"]
        if _PROFILE.fullmatch(name) is None:
            raise TableError(
                f"profile={name[:60]!r} cannot be the name of a mesh; use letters, digits and _ . - "
                "(60 at most)"
            )
        carried, error = even_map(
            table, (options["x_spacing"], options["y_spacing"]), ("x_spacing", "y_spacing")
        )
        places = options["decimals"]
        printed = [[_height(v / _MM, places) for v in row] for row in carried.values]
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
            data=("\n".join(lines) + "\n").encode("ascii"),
            quantisation=float(np.abs(back - carried.values).max()),
            notes={"load": f"BED_MESH_PROFILE LOAD={name}"},
            step=10.0**-places * _MM,
            carried=carried,
            resampling_error=error,
            findings=_findings(carried, options),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map, refusing what Klipper would drop or die of."""
        keys, rows = _parsed(data, path)
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
        return CompensationMap(x, y, values, is_exact_inverse=True, **map_fields(path, x, y))


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


def _height(value: float, places: int) -> str:
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def _findings(table: CompensationMap, options: dict[str, Any]) -> tuple[Finding, ...]:
    """Say what of the map Klipper cannot follow within a move."""
    delta, check = options["split_delta_z"], options["move_check_distance"]
    step_x, step_y = float(table.x[1] - table.x[0]), float(table.y[1] - table.y[0])
    span = float(np.ptp(table.values))
    found = [
        Finding(
            "warning",
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
            Finding(
                "warning",
                f"nodes lie {format_length(min(step_x, step_y))} apart, nearer than the "
                f"{format_length(check)} at which Klipper looks",
                "lower move_check_distance (3 mm at least), or write a denser path",
                "splitting",
            )
        )
    return tuple(found)


def _parsed(data: bytes, path: Path) -> tuple[dict[str, str], list[tuple[int, list[float]]]]:
    """Return keys, and the rows of points with their lines."""
    keys: dict[str, str] = {}
    rows: list[tuple[int, list[float]]] = []
    section, last = False, ""
    require_last_end(data, path)
    for number, line in enumerate(ascii_lines(data, path, "Klipper configuration"), start=1):
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


def _wrong(path: Path, line: int, expected: str, found: str) -> CorruptFileError:
    return CorruptFileError(
        path,
        f"line {line} does not belong into a mesh",
        expected=expected,
        found=found.strip()[:60],
        hint="the file was cut or edited: write it again",
    )

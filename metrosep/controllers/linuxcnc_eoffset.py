"""LinuxCNC: a map over two axes as an external offset of a third, such as Z over X and Y.

The file is a program for HAL, a component that looks the map up at the commanded positions and sends
the correction to ``axis.z.eoffset-counts``; LinuxCNC ramps the offset within the share of velocity
and acceleration that OFFSET_AV_RATIO leaves it. Confirmed by running the controller
(tests/acceptance/linuxcnc).
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import bilinear
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._grammar import decoded
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    map_identity,
    nearest_zero,
    one_way,
)
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError

_MM = 1e-3
_DECIMALS = 10
"""Decimals of a position in mm: 0.1 pm."""
_MAX_COUNTS = 2**31 - 1
"""eoffset-counts is a signed integer of 32 bits."""
_MAX_NODES = 100_000
"""More have never been tried; the program is read by Python at every start."""


class LinuxCNCEoffset(Dialect):
    """Writer and reader of HAL components with a map; see the module."""

    info = DialectInfo(
        id="linuxcnc-eoffset",
        title="LinuxCNC map over two axes, external offset through a HAL component",
        entry="correction added to the axis, in counts: -e / count",
        units="whole counts of eoffset-scale; positions in mm (machine units of the configuration)",
        max_points=_MAX_NODES,
        outside="that of the nearest edge",
        sign_status="confirmed by running LinuxCNC 2.9",
        activation=(
            "copy the file beside the INI file, readable by the user who runs LinuxCNC",
            "set OFFSET_AV_RATIO in [AXIS_n] of the corrected axis as the head of the file says",
            "copy the lines in the head of the file into a HAL file that is read after motmod is loaded",
            "connect comp-map.fault to what stops the machine: LinuxCNC did not take what was sent",
            "restart LinuxCNC, home: the offset appears only when the machine is on and homed",
            "move and read axis.<letter>.eoffset: the correction in mm",
        ),
        sign="confirmed",
        carries="map",
        directions="one",
        resolution="0.1 nm as written by default, and LinuxCNC stops 0.001 a T^2 before the target",
        reference_rule="zero at the machine zero of both axes; nothing acts before homing",
        proof="LinuxCNC 2.9 itself, headless",
        suffix=".py",
        page="linuxcnc",
    )

    options = (
        Option(
            "count",
            "length of a count, written to eoffset-scale; at most 1 nm",
            "length",
            default=1e-10,
            positive=True,
            lowest=1e-13,
            highest=1.000001e-9,
        ),
        Option(
            "av_ratio",
            "share of velocity and acceleration that the offset takes from the axis",
            "number",
            default=0.1,
            lowest=0.001,
            highest=0.9,
        ),
        Option(
            "period",
            "time between two look-ups, not below the servo period",
            "time",
            default=2e-3,
            positive=True,
            lowest=1e-4,
            highest=0.1,
        ),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the program with the map in it."""
        count, av_ratio, period = (self.filled(options)[o.name] for o in self.options)
        letters = [*table.axes, table.compensates]
        wrong = [a for a in letters if a not in tuple(LETTERS)]
        if wrong:
            raise TableError(
                f"{wrong[0]!r} is not a linear axis of LinuxCNC ({', '.join(LETTERS)}); a map over a "
                "rotary axis can go along in the tool path"
            )
        if table.values.size > _MAX_NODES:
            raise LimitError(
                f"{table.values.size} nodes, at most {_MAX_NODES}: use a coarser grid"
            )
        step = printed(count / _MM, 16)
        unit = float(step) * _MM
        counts = [[round(v / unit) for v in row] for row in table.values.tolist()]
        _check_counts(table, counts, unit)
        grid = Grid(
            axes=(letters[0], letters[1], letters[2]),
            count=step,
            period=printed(period, 6),
            ratio=printed(av_ratio, 6),
            x=_positions(table.x, letters[0]),
            y=_positions(table.y, letters[1]),
            counts=tuple(tuple(row) for row in counts),
        )
        back = np.array(counts, dtype=np.float64) * unit
        return Encoded(
            data=grid.text().encode("ascii"),
            # what is between the nodes is rounded to whole counts once more
            quantisation=float(np.abs(back - table.values).max()) + 0.5 * unit,
            step=unit,
            notes={"hal": grid.hal_lines(), "ini": grid.ini_lines()},
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map, refusing a program that is not the one that was proven."""
        grid = _checked(data, path, options)
        unit = float(grid.count) * _MM
        x, y = (np.array([float(v) * _MM for v in p]) for p in (grid.x, grid.y))
        return CompensationMap(
            x=x,
            y=y,
            values=np.array(grid.counts, dtype=np.float64) * unit,
            is_exact_inverse=True,
            **_identity(path, grid.axes, x, y),
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the component sends: bilinear between the nodes, in whole counts."""
        grid = _checked(data, path, options)
        unit = float(grid.count) * _MM
        x, y = (np.array([float(v) for v in p]) for p in (grid.x, grid.y))
        counts = np.array(grid.counts, dtype=np.float64)

        def over(px: FloatArray, py: FloatArray) -> FloatArray:
            found = bilinear(x, y, counts, px / _MM, py / _MM).reshape(px.shape)
            return np.asarray(np.rint(found) * unit)

        return one_way(over, 2)


def _positions(values: FloatArray, axis: str) -> tuple[Decimal, ...]:
    found = tuple(printed(v / _MM, _DECIMALS) for v in values.tolist())
    if any(b <= a for a, b in itertools.pairwise(found)):
        raise TableError(f"positions of {axis} closer than 1e-{_DECIMALS} mm cannot be written")
    return found


def _check_counts(table: CompensationMap, counts: list[list[int]], unit: float) -> None:
    for j, row in enumerate(counts):
        for i, value in enumerate(row):
            if abs(value) > _MAX_COUNTS:
                raise LimitError(
                    f"the correction {table.values[j, i] * 1e3:.6g} mm at {table.axes[0]} = "
                    f"{table.x[i] * 1e3:.6g} mm, {table.axes[1]} = {table.y[j] * 1e3:.6g} mm is "
                    f"{value} counts, LinuxCNC takes 32 bits: at most {_MAX_COUNTS * unit * 1e3:.6g} "
                    "mm; use a larger count=, or check the units of the error"
                )


def _checked(data: bytes, path: Path, options: dict[str, Any]) -> Grid:
    """Return the grid of a file, checked against options that were given."""
    grid = grid_of(data, path)
    if max(abs(v) for row in grid.counts for v in row) > _MAX_COUNTS:
        raise LimitError(f"{path}: an entry exceeds 32 bits; write the map with a larger count=")
    said = {
        "count": float(grid.count) * _MM,
        "av_ratio": float(grid.ratio),
        "period": float(grid.period),
    }
    for name, found in said.items():
        value = options.get(name)
        if value is not None and abs(value - found) > 1e-3 * found:
            raise DataError(f"{path}: {name} is {found:.6g} in the file, not {value:.6g} (SI)")
    return grid


def _identity(
    path: Path, axes: tuple[str, str, str], x: FloatArray, y: FloatArray
) -> dict[str, Any]:
    """Return axes of the program, and what it does not hold: reference, what is not in the map, border."""
    first = nearest_zero(x, y)
    known = map_identity(path, axes=axes[:2], compensates=axes[2], first=first)
    return {**known, "axes": axes[:2], "compensates": axes[2]}


# ---- text of the HAL component that applies a map in LinuxCNC: a Python program with its data ----
# The program runs under the system's Python, which has LinuxCNC's module ``hal`` and nothing of
# metrosep. It does not apply the map while the machine is off or not homed: LinuxCNC counts steps of
# ``eoffset-counts`` and forgets those made then, so the component holds the offset cleared until both
# are true, and only then sends the whole correction.

LETTERS = "XYZUVW"
"""Linear axes of LinuxCNC."""

_PROGRAM = '''\
#!/usr/bin/python3
"""Correction map {first}, {second} -> {third}, written by metrosep: a component for LinuxCNC's HAL.

{third} gets the correction c = -e at the commanded {first} and {second}, as an external offset; bilinear
between the nodes, that of the nearest edge outside. In a HAL file, after motmod is loaded:

{hal}

In the INI file:

{ini}
"""

import sys
import time
from bisect import bisect_right

AXES = ("{first}", "{second}", "{third}")
COUNT_MM = {count}
PERIOD_S = {period}
AV_RATIO = {ratio}
X_MM = (
{columns}
)
Y_MM = (
{rows}
)
# one line for each of Y_MM, one entry for each of X_MM; entries are the correction in counts
COUNTS = (
{entries}
)
# SHA-256 of this file with 64 zeros here; metrosep reads it no more when a number was changed
CHECKSUM = "{checksum}"

CLEAR_S = 0.05
FAULT_S = 1.0


def cell(nodes, position):
    """Return the node below a position and its fraction of the cell, clamped."""
    i = min(max(bisect_right(nodes, position) - 1, 0), len(nodes) - 2)
    fraction = (position - nodes[i]) / (nodes[i + 1] - nodes[i])
    return i, min(max(fraction, 0.0), 1.0)


def correction(x, y):
    """Return the correction in counts at a commanded position in mm."""
    i, s = cell(X_MM, x)
    j, t = cell(Y_MM, y)
    low, high = COUNTS[j], COUNTS[j + 1]
    below = (1.0 - s) * low[i] + s * low[i + 1]
    above = (1.0 - s) * high[i] + s * high[i + 1]
    return round((1.0 - t) * below + t * above)


def main():
    import hal

    part = hal.component("comp-map")
    for pin in ("x", "y", "requested"):
        part.newpin(pin, hal.HAL_FLOAT, hal.HAL_IN)
    for pin in ("machine-on", "homed"):
        part.newpin(pin, hal.HAL_BIT, hal.HAL_IN)
    part.newpin("scale", hal.HAL_FLOAT, hal.HAL_OUT)
    part.newpin("counts", hal.HAL_S32, hal.HAL_OUT)
    for pin in ("enable", "clear", "active", "fault"):
        part.newpin(pin, hal.HAL_BIT, hal.HAL_OUT)
    part["scale"], part["enable"], part["clear"] = COUNT_MM, True, True
    part.ready()
    cleared_at = agreed_at = time.monotonic()
    sent = (0, 0)
    while True:
        time.sleep(PERIOD_S)
        now = time.monotonic()
        if not (part["machine-on"] and part["homed"]):
            part["active"], part["fault"], part["clear"], part["counts"] = False, False, True, 0
            cleared_at, sent = now, (0, 0)
            continue
        if not part["active"]:
            if now - cleared_at < CLEAR_S or part["requested"] != 0.0:
                continue
            part["clear"] = False
            time.sleep(CLEAR_S)
            part["active"], agreed_at = True, time.monotonic()
            continue
        wanted = part["requested"] / COUNT_MM
        if min(abs(wanted - counts) for counts in sent) < 0.6:
            agreed_at = now
        elif now - agreed_at > FAULT_S:
            part["fault"] = True
        x, y = part["x"], part["y"]
        if x - x == 0.0 and y - y == 0.0:
            sent = (correction(x, y), sent[0])
            part["counts"] = sent[0]
        else:
            part["fault"] = True


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(0)
'''
"""To be filled with the names of the axes and the numbers by `str.format`."""

_NUMBER = r"-?\d{1,9}(?:\.\d{1,20})?"
_OPEN = "0" * 64
"""What stands in place of the checksum while it is taken."""
_AXES = re.compile(rf'AXES = \("([{LETTERS}])", "([{LETTERS}])", "([{LETTERS}])"\)')
_CHECKSUM = re.compile(r'CHECKSUM = "[0-9a-f]{64}"')


def _broken(path: Path, reason: str, **more: Any) -> CorruptFileError:
    """Return the error of a program that is not as it was written."""
    hint = "write the map again; nothing in this file may be changed"
    return CorruptFileError(path, reason, **more, hint=hint)


@dataclass(frozen=True, slots=True)
class Grid:
    """What is written into the program."""

    # of (str, str, str): the two that are looked up, the one that is corrected
    axes: tuple[str, str, str]
    count: Decimal  # mm: length of a count
    period: Decimal  # s: between two look-ups
    ratio: Decimal  # OFFSET_AV_RATIO
    x: tuple[Decimal, ...]  # mm: positions of columns and rows
    y: tuple[Decimal, ...]
    counts: tuple[tuple[int, ...], ...]  # of tuple of int: corrections, rows y

    def hal_lines(self) -> list[str]:
        """Return the lines of a HAL file that run and connect the component."""
        first, second, third = (a.lower() for a in self.axes)
        return [
            "loadusr -Wn comp-map /usr/bin/python3 <this file>",
            f"net comp-map-x axis.{first}.pos-cmd => comp-map.x",
            f"net comp-map-y axis.{second}.pos-cmd => comp-map.y",
            "net comp-map-on motion.motion-enabled => comp-map.machine-on",
            "net comp-map-homed motion.is-all-homed => comp-map.homed",
            f"net comp-map-requested axis.{third}.eoffset-request => comp-map.requested",
            f"net comp-map-scale comp-map.scale => axis.{third}.eoffset-scale",
            f"net comp-map-counts comp-map.counts => axis.{third}.eoffset-counts",
            f"net comp-map-enable comp-map.enable => axis.{third}.eoffset-enable",
            f"net comp-map-clear comp-map.clear => axis.{third}.eoffset-clear",
        ]

    def ini_lines(self) -> list[str]:
        """Return the lines of the INI file that let the axis take an offset."""
        return [f"[AXIS_{self.axes[2]}]", f"OFFSET_AV_RATIO = {_short(self.ratio)}"]

    def text(self) -> str:
        """Return the program."""
        text = _PROGRAM.format(
            first=self.axes[0],
            second=self.axes[1],
            third=self.axes[2],
            hal=_indented(self.hal_lines()),
            ini=_indented(self.ini_lines()),
            count=_short(self.count),
            period=_short(self.period),
            ratio=_short(self.ratio),
            columns=_indented(f"{_short(v)}," for v in self.x),
            rows=_indented(f"{_short(v)}," for v in self.y),
            entries=_indented(f"({', '.join(map(str, row))})," for row in self.counts),
            checksum=_OPEN,
        )
        return text.replace(_OPEN, hashlib.sha256(text.encode("ascii")).hexdigest())


def printed(value: float, decimals: int) -> Decimal:
    """Return a number rounded to a number of decimals."""
    return Decimal(f"{value:.{decimals}f}")


def _short(value: Decimal) -> str:
    """Return it without trailing zeros and without an exponent."""
    text = f"{value:f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text


def _indented(lines: Iterable[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)


def grid_of(data: bytes, path: Path) -> Grid:
    """Return what a program holds; the rest of it must be the program that metrosep writes."""
    lines = decoded(data, path, "HAL component of metrosep").split("\n")
    axes = next((m for m in map(_AXES.fullmatch, lines) if m), None)
    if axes is None:
        raise _broken(path, "no line AXES = (...) of a map in it")
    entries = _block(lines, "COUNTS", r"    \((-?\d{1,15}(?:, -?\d{1,15})+)\),", path)
    grid = Grid(
        axes=(axes[1], axes[2], axes[3]),
        count=_value(lines, "COUNT_MM", path),
        period=_value(lines, "PERIOD_S", path),
        ratio=_value(lines, "AV_RATIO", path),
        x=_rising(lines, "X_MM", path),
        y=_rising(lines, "Y_MM", path),
        counts=tuple(tuple(int(v) for v in row.split(", ")) for _, row in entries),
    )
    for number, row in zip((n for n, _ in entries), grid.counts, strict=True):
        if len(row) != len(grid.x):
            raise _broken(path, f"line {number}: {len(row)} entries, X_MM has {len(grid.x)}")
    if len(grid.counts) != len(grid.y):
        raise _broken(path, f"COUNTS has {len(grid.counts)} rows, Y_MM has {len(grid.y)}")
    _require_program(lines, grid.text().split("\n"), path)
    return grid


def _require_program(found: Sequence[str], wanted: Sequence[str], path: Path) -> None:
    for number, (line, right) in enumerate(zip(found, wanted, strict=False), start=1):
        if line != right and _CHECKSUM.fullmatch(line):
            raise _broken(
                path,
                "the numbers are not those that were written: some were changed or exchanged",
                field="CHECKSUM",
                expected=right[12:28],
                found=line[12:28],
            )
        if line != right:
            raise _broken(
                path,
                f"line {number} is not that of the program",
                expected=repr(right[:80]),
                found=repr(line[:80]),
            )
    if len(found) != len(wanted):
        raise _broken(
            path,
            "the program is longer or shorter",
            expected=f"{len(wanted)} lines",
            found=len(found),
        )


def _value(lines: Sequence[str], name: str, path: Path) -> Decimal:
    for line in lines:
        match = re.fullmatch(rf"{name} = ({_NUMBER})", line)
        if match and Decimal(match[1]) > 0:
            return Decimal(match[1])
    raise _broken(path, f"no line {name} = <a number above zero>")


def _block(lines: Sequence[str], name: str, pattern: str, path: Path) -> list[tuple[int, str]]:
    """Return number and inside of each line of a tuple."""
    opening = f"{name} = ("
    if opening not in lines or ")" not in lines[lines.index(opening) :]:
        raise _broken(path, f"no lines {opening} ... ) in it")
    start = lines.index(opening) + 1
    found = []
    for number, line in enumerate(lines[start : lines.index(")", start)], start=start + 1):
        match = re.fullmatch(pattern, line)
        if match is None:
            raise _broken(path, f"line {number} is not an entry of {name}", found=repr(line[:60]))
        found.append((number, match[1]))
    if len(found) < 2:
        raise _broken(path, f"{name} needs at least 2 entries")
    return found


def _rising(lines: Sequence[str], name: str, path: Path) -> tuple[Decimal, ...]:
    entries = _block(lines, name, rf"    ({_NUMBER}),", path)
    values = [Decimal(text) for _, text in entries]
    for i in range(1, len(values)):
        if values[i] <= values[i - 1]:
            raise _broken(path, f"line {entries[i][0]}: the position does not rise")
    return tuple(values)

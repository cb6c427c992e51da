"""Text of a chain of lincurves in HAL: cut a table into curves, write the commands, read them back.

The reader takes no other wiring than the one that was proven on the controller: it makes the commands
again from the numbers that it found, and refuses a file in which any word differs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from metrosep.core.errors import CorruptFileError

__all__ = [
    "DECIMALS",
    "MAX_CURVES",
    "MAX_POINTS",
    "POINTS_PER_CURVE",
    "THREAD",
    "UNIT",
    "Chain",
    "cut",
    "hal_lines",
    "parsed",
]

POINTS_PER_CURVE = 16
"""Points of one lincurve."""
MAX_CURVES = 64
"""Personalities that LinuxCNC 2.9 takes for one component; the 65th keeps it from loading."""
MAX_POINTS = MAX_CURVES * (POINTS_PER_CURVE - 1) + 1
"""Neighbouring curves share a point."""

DECIMALS = 10
"""Decimals of a millimetre in the file: 0.1 pm."""
UNIT = 10**DECIMALS
"""Units in which entries are whole numbers, per millimetre."""

_NUMBER = re.compile(r"[+-]?(\d{1,12}(\.\d{0,30})?|\.\d{1,30})")
THREAD = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,39}")
"""Name of a thread in HAL."""

Curve = tuple[tuple[Decimal, Decimal], ...]


@dataclass(frozen=True, slots=True)
class Chain:
    """What the file says."""

    # of tuple of (Decimal, Decimal), mm: points of each lincurve; degrees of an axis that turns
    curves: tuple[Curve, ...]
    source: int  # joints that are looked up and corrected
    target: int
    thread: str  # servo thread

    def knots(self) -> list[tuple[Decimal, Decimal]]:
        """Return the points of the sum of the curves, mm."""
        found = list(self.curves[0])
        for curve in self.curves[1:]:
            before = found[-1][1]
            found += [(x, before + y) for x, y in curve[1:]]
        return found


def cut(x: Sequence[int], y: Sequence[int]) -> tuple[Curve, ...]:
    """Return the curves: the first as it is, every other one from the zero at its first point."""
    step = POINTS_PER_CURVE - 1
    curves = []
    for start in range(0, len(x) - 1, step):
        stop = min(start + step, len(x) - 1)
        zero = y[start] if start else 0
        points = range(start, stop + 1)
        curves.append(tuple((Decimal(x[i]) / UNIT, Decimal(y[i] - zero) / UNIT) for i in points))
    return tuple(curves)


def hal_lines(chain: Chain) -> list[str]:
    """Return the file without its comments: values, order in the thread, wiring."""
    n = len(chain.curves)
    curves = [f"comp-{i}" for i in range(n)]
    sums = [f"comp-sum-{i}" for i in range(1, n)]
    sizes = ",".join(str(len(c)) for c in chain.curves)
    order = ["comp-fb", "motion-command-handler", "motion-controller", *curves, *sums, "comp-cmd"]
    value = f"{sums[-1]}.out" if sums else f"{curves[0]}.out"
    lines = [
        f"loadrt lincurve names={','.join(curves)} personality={sizes}",
        f"loadrt sum2 names={','.join([*sums, 'comp-cmd', 'comp-fb'])}",
        "setp comp-fb.gain1 -1",
    ]
    for name, curve in zip(curves, chain.curves, strict=True):
        for i, (x, y) in enumerate(curve):
            lines.append(f"setp {name}.x-val-{i:02d} {_printed(x)}")
            lines.append(f"setp {name}.y-val-{i:02d} {_printed(y)}")
    lines += [f"addf {name} {chain.thread}" for name in order]
    lines.append(f"net comp-position joint.{chain.source}.pos-cmd")
    lines += [f"net comp-position {name}.in" for name in curves]
    for i in range(1, n):
        before = f"{curves[0]}.out" if i == 1 else f"comp-sum-{i - 1}.out"
        lines.append(f"net comp-below-{i} {before} comp-sum-{i}.in0")
        lines.append(f"net comp-piece-{i} comp-{i}.out comp-sum-{i}.in1")
    return [
        *lines,
        f"net comp-value {value} comp-cmd.in1 comp-fb.in1",
        f"net comp-motor joint.{chain.target}.motor-pos-cmd comp-cmd.in0",
        "net comp-drive comp-cmd.out",
        "net comp-encoder comp-fb.in0",
        f"net comp-feedback comp-fb.out joint.{chain.target}.motor-pos-fb",
    ]


def _printed(value: Decimal) -> str:
    return f"{value:.{DECIMALS}f}"


def parsed(data: bytes, path: Path) -> Chain:
    """Return what the file says; the wiring must be, word for word, that of `hal_lines`."""
    rows = _rows(data, path)
    chain = Chain(
        _curves(rows, path),
        int(_found(rows, r"net comp-position joint\.(\d{1,2})\.pos-cmd", path)),
        int(_found(rows, r"net comp-motor joint\.(\d{1,2})\.motor-pos-cmd comp-cmd\.in0", path)),
        _found(rows, rf"addf comp-fb ({THREAD.pattern})", path),
    )
    wanted = hal_lines(chain)
    for (number, text), line in zip(rows, wanted, strict=False):
        if _plain(text) != _plain(line):
            raise _damaged(path, number, text, line)
    if len(rows) != len(wanted):
        number, text = rows[len(wanted)] if len(rows) > len(wanted) else (rows[-1][0] + 1, "")
        raise _damaged(path, number, text, wanted[len(rows)] if len(rows) < len(wanted) else "")
    return chain


def _plain(line: str) -> list[str]:
    """Return the words of a line, numbers in one spelling."""
    words = line.split()
    if words[0] == "setp" and len(words) == 3 and _NUMBER.fullmatch(words[2]):
        words[2] = _printed(Decimal(words[2]))
    return words


def _damaged(path: Path, number: int, found: str, wanted: str) -> CorruptFileError:
    return CorruptFileError(
        path,
        f"line {number} is not that of a lincurve chain",
        expected=repr(wanted[:80]) if wanted else "the end",
        found=repr(found[:80]) if found else "the end",
        hint="write the table again; only comments may be changed in this file",
    )


def _rows(data: bytes, path: Path) -> list[tuple[int, str]]:
    """Return the lines that are neither blank nor comments, each with its number."""
    hint = "this is no HAL file of metrosep, or it was converted; LinuxCNC wants ASCII and LF"
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(path, "not ASCII text", offset=exc.start, hint=hint) from None
    if "\\" in text:
        line = text[: text.index("\\")].count("\n") + 1
        raise CorruptFileError(
            path,
            f"line {line} holds a backslash: HAL joins that line with the next, comments too",
            hint="take it out, or write the table again",
        )
    if not text.endswith("\n") or not text.replace("\n", " ").isprintable():
        raise CorruptFileError(path, "cut in a line, or with control characters", hint=hint)
    lines = [(i, line.partition("#")[0].strip()) for i, line in enumerate(text.split("\n"), 1)]
    rows = [(i, line) for i, line in lines if line]
    if not rows:
        raise CorruptFileError(path, "no HAL command in it", hint=hint)
    return rows


def _found(rows: Sequence[tuple[int, str]], pattern: str, path: Path) -> str:
    for _, line in rows:
        match = re.fullmatch(pattern, " ".join(line.split()))
        if match:
            return match[1]
    raise CorruptFileError(
        path,
        "a line of the wiring is missing",
        expected=pattern.replace("\\", ""),
        hint="write the table again",
    )


def _curves(rows: Sequence[tuple[int, str]], path: Path) -> tuple[Curve, ...]:
    """Return the points of the curves in their order, checked to be a chain."""
    sizes = _found(rows, r"loadrt lincurve names=\S+ personality=(\d{1,2}(?:,\d{1,2})*)", path)
    counts = [int(s) for s in sizes.split(",")]
    if len(counts) > MAX_CURVES or not all(2 <= c <= POINTS_PER_CURVE for c in counts):
        raise CorruptFileError(
            path,
            "LinuxCNC would not load these curves or change them",
            field="personality",
            expected=f"at most {MAX_CURVES} numbers from 2 to {POINTS_PER_CURVE}",
            found=sizes[:80],
            hint="write the table again",
        )
    values: dict[str, tuple[int, Decimal]] = {}
    for number, line in rows:
        words = line.split()
        if words[0] != "setp" or len(words) != 3 or "-val-" not in words[1]:
            continue
        if not _NUMBER.fullmatch(words[2]) or words[1] in values:
            raise _damaged(path, number, line, f"setp {words[1]} <a number, once>")
        values[words[1]] = number, Decimal(words[2])
    curves = []
    for k, count in enumerate(counts):
        curves.append(tuple(_point(values, k, i, path) for i in range(count)))
    _check_chain(curves, values, path)
    return tuple(curves)


def _point(
    values: dict[str, tuple[int, Decimal]], curve: int, i: int, path: Path
) -> tuple[Decimal, Decimal]:
    x, y = (f"comp-{curve}.{axis}-val-{i:02d}" for axis in "xy")
    for name in (x, y):
        if name not in values:
            raise CorruptFileError(
                path, f"{name} is not set: it would be 0", hint="write the table again"
            )
    return values[x][1], values[y][1]


def _check_chain(
    curves: Sequence[Curve],
    values: dict[str, tuple[int, Decimal]],
    path: Path,
) -> None:
    for k, curve in enumerate(curves):
        for i in range(1, len(curve)):
            if curve[i][0] <= curve[i - 1][0]:
                line = values[f"comp-{k}.x-val-{i:02d}"][0]
                raise CorruptFileError(
                    path, f"line {line}: the position does not rise", hint="write the table again"
                )
        if k and (curve[0][0] != curves[k - 1][-1][0] or curve[0][1] != 0):
            line = values[f"comp-{k}.x-val-00"][0]
            raise CorruptFileError(
                path,
                f"line {line}: curve comp-{k} does not start at zero where comp-{k - 1} ends",
                hint="write the table again",
            )

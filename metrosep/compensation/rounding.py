"""Entries as the integers of a controller: rounded in place, or as increments that do not drift.

A controller that adds up increments (Fanuc, Mitsubishi) adds up their rounding too. So the curve
itself is rounded, and the increments are the differences of the rounded curve: their sum is off by
half a step at most, wherever one looks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.limits import Finding
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.units import format_length

IntArray = NDArray[np.int64]

_COARSE = 10.0
"""Steps that the span of the values must hold at least (specification, check 6)."""

_EXACT = 2.0**53
"""Beyond this a double no longer counts by ones."""

_TRIALS = 1000
"""Magnifications that are tried for one that is enough."""


@dataclass(frozen=True, slots=True, eq=False)
class Rounded:
    """Values as integers of a controller; frozen.

    Parameters
    ----------
    entries : ndarray of int64, shape (n,) or (n - 1,)
        What the file holds; increments are one fewer than the values.
    values : ndarray, shape (n,), m
        What the controller makes of them.
    step : float, m
        Smallest change of the values: unit times magnification.
    error : float, m
        Largest deviation of `values` from what was asked.
    findings : tuple of Finding
        What is out of range or too coarse; empty if nothing is wrong.
    """

    entries: IntArray
    values: FloatArray
    step: float
    error: float
    findings: tuple[Finding, ...] = ()

    @property
    def audit(self) -> dict[str, Any]:
        """Plain values with units in the keys, for sidecars and reports."""
        return {
            "n_entries": int(self.entries.size),
            "smallest_entry": int(self.entries.min()),
            "largest_entry": int(self.entries.max()),
            "step_nm": self.step * 1e9,
            "rounding_nm": self.error * 1e9,
            "rounding_pv_nm": self.step * 1e9,
            "definition": "largest |rounded - value|; half a step where nothing is out of range",
            "findings": [f"{f.level}: {f.problem}; {f.fix}" for f in self.findings],
        }


def round_entries(
    values: ArrayLike, unit: float | str, *, limits: tuple[int, int] | None = None
) -> Rounded:
    """Return values as whole numbers of a unit.

    Parameters
    ----------
    values : array_like, shape (n,), m
        Corrections or errors in the sign that the controller takes.
    unit : float or str, m
        What one unit of an entry is, such as 1/16 count.
    limits : tuple of (int, int), optional
        Smallest and largest entry.

    Returns
    -------
    Rounded
        Entries, what they stand for, and what is wrong with them.

    Raises
    ------
    DataError
        If the unit is not positive or the limits are not in order.
    TooFewSamplesError
        If there is no value.
    InvalidSamplesError
        If a value is not finite, or needs more digits than a double has.

    Notes
    -----
    A half is rounded to the even number. A unit above a tenth of the P-V of the values is an
    error among the findings (specification section 8, check 6); `require_findings` refuses.

    Examples
    --------
    >>> round_entries([0.0, 0.24e-6, -0.5e-6], 1e-7).entries.tolist()
    [0, 2, -5]
    """
    unit = numbers.positive(unit, "the unit of an entry", dimension="length")
    wanted = _wanted(values)
    low, high = _ordered(limits)
    entries = _whole(wanted, unit)
    findings = _coarse(wanted, unit)
    bad = np.flatnonzero((entries < low) | (entries > high))
    if bad.size:
        i = int(bad[0])
        findings.append(
            Finding.error(
                f"entry {i} is {entries[i]}, allowed are {low} to {high} ({bad.size} of "
                f"{entries.size} entries are out of range)",
                "use a larger unit or remove alignment from the error",
            )
        )
    return _rounded(entries, float(unit) * entries.astype(np.float64), wanted, unit, findings)


def round_increments(
    values: ArrayLike,
    unit: float | str,
    magnification: int = 1,
    limits: tuple[int, int] | None = (-128, 127),
    *,
    positions: ArrayLike | None = None,
) -> Rounded:
    """Return the increments from value to value that a controller adds up.

    Parameters
    ----------
    values : array_like, shape (n,), m
        Corrections or errors in the sign that the controller takes, n >= 2; what the controller
        makes of them begins with the first of them, rounded.
    unit : float or str, m
        Detection unit.
    magnification : int, optional
        Units for one entry (Fanuc 3623, Mitsubishi scale factor).
    limits : tuple of (int, int), optional
        Smallest and largest increment, (-7, 7) for older Fanuc controllers.
    positions : array_like, shape (n,), m, optional
        For messages.

    Returns
    -------
    Rounded
        n - 1 increments; `values` are their running sum, off by half a step at most.

    Raises
    ------
    DataError
        If unit or magnification is not positive, limits are not in order, or lengths differ.
    TooFewSamplesError
        If there are fewer than 2 values.
    InvalidSamplesError
        If a value is not finite, or needs more digits than a double has.

    Notes
    -----
    The curve is rounded, then differenced. Rounding each increment lets the errors add up: for
    a slope of 0.4 step an interval, rounded increments stay 0 for ever.
    An increment out of range is an error among the findings; nothing is cut to the range.

    Examples
    --------
    >>> import numpy as np
    >>> round_increments(np.arange(6) * 0.4e-6, 1e-6).entries.tolist()
    [0, 1, 0, 1, 0]
    """
    unit = numbers.positive(unit, "the unit of an entry", dimension="length")
    scale = numbers.count(magnification, "the magnification")
    wanted = _wanted(values, at_least=2)
    low, high = _ordered(limits)
    step = unit * scale
    curve = _whole(wanted, step)
    entries = np.diff(curve)
    findings = _coarse(wanted, step)
    bad = np.flatnonzero((entries < low) | (entries > high))
    if bad.size:
        findings.append(_out_of_range(entries, bad, (low, high), (unit, scale), positions, wanted))
    return _rounded(entries, float(step) * curve.astype(np.float64), wanted, step, findings)


def _wanted(values: ArrayLike, at_least: int = 1) -> FloatArray:
    wanted = frozen_float(values, name="values", ndim=1, min_size=at_least)
    bad = np.flatnonzero(~np.isfinite(wanted))
    if bad.size:
        raise InvalidSamplesError(
            f"value {int(bad[0])} is {wanted[int(bad[0])]}: an entry cannot hold that; narrow the "
            "positions to what was measured"
        )
    return wanted


def _ordered(limits: tuple[int, int] | None) -> tuple[int, int]:
    low, high = limits or (-(2**63), 2**63 - 1)
    if low > high:
        raise DataError(f"limits must be (smallest, largest), got {limits!r}")
    return int(low), int(high)


def _whole(wanted: FloatArray, step: float) -> IntArray:
    counts = wanted / step
    if float(np.abs(counts).max()) >= _EXACT:
        i = int(np.abs(counts).argmax())
        raise InvalidSamplesError(
            f"value {i} is {counts[i]:.3g} steps of {format_length(step)}, more than an exact number "
            "holds: check the units"
        )
    return np.rint(counts).astype(np.int64)


def _coarse(wanted: FloatArray, step: float) -> list[Finding]:
    span = float(np.ptp(wanted))
    if step * _COARSE <= span * (1.0 + 1e-12) or span == 0.0:
        return []
    return [
        Finding.error(
            f"one step of an entry is {format_length(step)}, the values span {format_length(span)}: "
            f"fewer than {_COARSE:.0f} steps",
            "use a smaller unit or magnification, or another carrier",
        )
    ]


def _out_of_range(
    entries: IntArray,
    bad: NDArray[np.intp],
    limits: tuple[int, int],
    step: tuple[float, int],
    positions: ArrayLike | None,
    wanted: FloatArray,
) -> Finding:
    i = int(bad[0])
    where = ""
    if positions is not None:
        p = np.asarray(positions, dtype=np.float64)
        if p.shape != wanted.shape:
            raise DataError(f"{p.size} positions for {wanted.size} values")
        where = f" from {p[i] * 1e3:.9g} to {p[i + 1] * 1e3:.9g} mm"
    low, high = limits
    shares = [_share(int(e), low, high) for e in entries[bad]]
    worst = int(entries[bad[int(np.argmax(shares))]])
    enough = _enough(wanted, step, limits, max(shares))
    larger = f"a magnification of {enough}" if enough else "a larger magnification"
    return Finding.error(
        f"interval {i}{where} needs an increment of {entries[i]}, allowed are {low} to {high} "
        f"({bad.size} of {entries.size} are out of range, the worst is {worst})",
        f"use {larger} (coarser steps) or a finer interval between the points",
    )


def _share(entry: int, low: int, high: int) -> float:
    """Return how many times its bound an entry is that is out of range."""
    bound = high if entry > high else low
    return entry / bound if bound != 0 and (bound > 0) == (entry > high) else math.inf


def _enough(
    wanted: FloatArray, step: tuple[float, int], limits: tuple[int, int], share: float
) -> int | None:
    """Return the smallest magnification with which all increments are in range, None if unknown."""
    if not share < _EXACT:
        return None
    unit, now = step
    # rounding adds one step at most to an increment: it takes little more than the quotient
    first = max(now + 1, math.ceil(share * now))
    more = first // max(1, min(-limits[0], limits[1]) - 1)
    for trial in range(first, first + min(more, _TRIALS) + 2):
        increments = np.diff(_whole(wanted, unit * trial))
        if (increments >= limits[0]).all() and (increments <= limits[1]).all():
            return trial
    return None


def _rounded(
    entries: IntArray, values: FloatArray, wanted: FloatArray, step: float, findings: list[Finding]
) -> Rounded:
    entries.setflags(write=False)
    values.setflags(write=False)
    error = float(np.abs(values - wanted).max())
    return Rounded(entries, values, step, error, tuple(findings))

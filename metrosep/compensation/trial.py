"""A table with one bump of known sign and size, for controllers whose sign is not documented.

Loaded instead of the real table and driven past an indicator, it shows in one pass whether the
controller adds the correction, subtracts it, mirrors the positions, or does nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from metrosep.compensation.area_errors import (
    ErrorMap,
    format_along,
    format_amount,
    format_position,
    format_span,
    is_rotary,
)
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, TableError
from metrosep.core.provenance import Step
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length

Third = Literal["auto", "first", "middle", "last"]
Verdict = Literal["right", "wrong"]

_PEAK = {"first": 0.25, "middle": 0.4, "last": 0.25}
"""Place of the peak in its part: the near flank is steeper than the far one."""

_SLOPE = 1e-3
"""Slope of a correction beyond which it is no longer metrology (as in `limits`)."""

_CLEAR = 0.2
"""Share of the amplitude by which a reading may be off and still be clear."""

_REVERSE = 0.3
"""Height of the reverse column over the forward one: neither 1/2 nor 1, so that swapped columns are
told from a table that is scaled by half."""

_BOUNDS = {"first": (0, 2, 2), "middle": (2, 3, 4), "last": (4, 6, 6)}
"""Where the bump begins and ends, and where its third ends, in sixths of the travel: never across
its middle, so that a mirrored table is flat where the peak is expected."""

_NODE = 1e-9
"""Share of the travel by which rounding may miss a node."""

_CLUES = (
    (0.5, "half of it: the table is scaled by half (radius for diameter, a unit or a count)"),
    (2.0, "twice of it: the table is scaled by two (diameter for radius, a unit or a count)"),
    (_REVERSE, "the height of the reverse column: the columns are swapped"),
)


@dataclass(frozen=True, slots=True, eq=False)
class TrialTable:
    """A bump to be driven past an indicator; frozen.

    Parameters
    ----------
    table : CompensationTable
        To be written in place of the real one; never for cutting.
    position : float, m
        Commanded position of the peak.
    amplitude : float, m
        Correction there when moving in + direction.
    amplitude_reverse : float, m
        The same in - direction.
    mirror : float, m
        Commanded position where a table with mirrored positions has its peak; the right one is 0 there.
    instruction : str
        What to do.
    if_right, if_wrong : str
        What must be seen.
    """

    table: CompensationTable
    position: float
    amplitude: float
    amplitude_reverse: float
    mirror: float
    instruction: str
    if_right: str
    if_wrong: str

    def judge(self, change: float, u: float = 0.0, *, at_mirror: float | None = None) -> Verdict:
        """Return whether a reading says that the sign is right.

        Parameters
        ----------
        change : float, m
            Reading at the peak with the table minus without, moving in + direction; + is a place
            of the corrected axis further in +.
        u : float, m, optional
            Standard uncertainty of that change.
        at_mirror : float, m, optional
            The same at `mirror`, where nothing must be seen.

        Returns
        -------
        {"right", "wrong"}
            The sign as written is that of the controller, or the opposite one.

        Raises
        ------
        DataError
            If the change is neither clearly the amplitude nor its negative: the table is not
            active, scaled, its columns are swapped or its positions mirrored; the message says which
            of these fits.

        Notes
        -----
        Clear is a reading within a fifth of the amplitude of one of the two, widened by nothing: two
        standard uncertainties must fit into that fifth.
        """
        axis, corrected = self.table.axis, self.table.compensates
        kind = _kind(corrected)
        change = numbers.quantity(change, "change", kind)
        u = numbers.not_negative(u, "u", dimension=kind)
        if at_mirror is not None:
            at_mirror = numbers.quantity(at_mirror, "at_mirror", kind)
        room = _CLEAR * abs(self.amplitude) - 2.0 * u
        if room <= 0.0:
            raise DataError(
                f"u = {format_amount(corrected, u)} is too large for a bump of "
                f"{format_amount(corrected, self.amplitude)}: "
                "average more readings or use a larger bump"
            )
        if at_mirror is not None and abs(at_mirror) > room:
            raise DataError(
                f"the indicator changed by {format_amount(corrected, at_mirror)} at "
                f"{format_span(axis, self.mirror, digits=6)}, where "
                "nothing was expected: the positions of the table are mirrored or shifted"
            )
        if abs(change - self.amplitude) <= room:
            return "right"
        if abs(change + self.amplitude) <= room:
            return "wrong"
        raise DataError(
            f"the indicator changed by {format_amount(corrected, change)}, expected was "
            f"{format_amount(corrected, self.amplitude)} (right) or "
            f"{format_amount(corrected, -self.amplitude)} (wrong): "
            + self._clue(change / self.amplitude)
        )

    def _clue(self, share: float) -> str:
        """Return what a reading of a share of the amplitude points to."""
        if abs(share) <= 0.1:
            return (
                "the table is not active, or its positions are mirrored or shifted (look at "
                f"{format_span(self.table.axis, self.mirror, digits=6)})"
            )
        for height, words in _CLUES:
            swapped = height != _REVERSE or self.amplitude_reverse != self.amplitude
            if swapped and abs(abs(share) - height) <= 0.25 * height:
                return words + ("" if share > 0.0 else ", and the sign is wrong")
        return "the table is not active, its unit is another, or its positions are shifted or mirrored"


def trial_table(
    table: CompensationTable,
    amplitude: float | str,
    *,
    third: Third = "auto",
    slope_max: float = _SLOPE,
) -> TrialTable:
    """Return a table with one lopsided bump at the positions of a real one.

    Parameters
    ----------
    table : CompensationTable
        The real one: its positions, axes and reference are kept, its corrections are not.
    amplitude : float or str, m
        Correction at the peak, with its sign; some ten times what the indicator resolves.
    third : {"auto", "first", "middle", "last"}, optional
        Part of the travel that holds the bump; "auto" takes the first of last, first and middle that
        has an entry and not the reference.
    slope_max : float, optional
        Largest slope of the flanks in m per m.

    Returns
    -------
    TrialTable
        Table, where to look, and what must be seen.

    Raises
    ------
    DataError
        If the amplitude is zero or not finite, `third` is unknown or `slope_max` not positive.
    TableError
        If the reference lies in the third, no entry does, or the flanks are too steep.

    Notes
    -----
    The peak lies a quarter into its part, and no part reaches over the middle of the travel ("middle"
    is the sixth before it): a mirrored table shows nothing where the peak is expected, and the peak
    where nothing is. Where the real table has a reverse column, that of the trial is 0.3 as high:
    swapped columns show, and are distinguished from a table scaled by half. Source of the dry-run is the
    error that the bump cancels.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.compensation import CompensationTable
    >>> real = CompensationTable(np.arange(13) * 5e-3, np.zeros(13), None, "X", "Z", 0.0)
    >>> trial = trial_table(real, 5e-6)
    >>> round(trial.position * 1e3, 6), int((trial.table.forward != 0.0).sum())
    (45.0, 3)
    """
    amplitude = _amplitude(amplitude, _kind(table.compensates))
    numbers.positive(slope_max, "slope_max")
    p = table.positions
    first, last, share = _part(table, third)
    shape, peak = _bump(p, first, last, share)
    _check_slope(table, shape, amplitude, slope_max)
    forward = amplitude * shape
    split = table.reverse is not None
    reverse = _REVERSE * forward if split else None
    bumped = replace(
        table,
        forward=forward,
        reverse=reverse,
        u=None,
        covariances={},
        interpolation_error=0.0,
        removed="offset",
        made_over=None,
        is_exact_inverse=False,
        offset_removed=0.0,
        source_sha256=(),
        history=(
            Step("trial_table", {"amplitude_nm": amplitude * 1e9, "peak_mm": p[peak] * 1e3}),
        ),
    )
    bumped = replace(bumped, source=_cancelled(bumped))
    return _described(bumped, float(p[peak]), amplitude)


def _kind(axis: str) -> str:
    """Return what corrections of an axis are: lengths, or angles where it turns."""
    return "angle" if is_rotary(axis) else "length"


def _amplitude(value: float | str, kind: str = "length") -> float:
    """Return the height of a bump in m or rad."""
    amplitude = numbers.quantity(value, "the amplitude", kind)
    if amplitude == 0.0:
        raise DataError(
            f"the amplitude must be {'an' if kind == 'angle' else 'a'} {kind} other than zero"
        )
    return amplitude


def _part(table: CompensationTable, third: str) -> tuple[float, float, float]:
    low, high = table.span
    zero, p = table.reference, table.positions
    room = _NODE * (high - low)
    free = True
    numbers.choice(third, "third", ("auto", *_BOUNDS))
    for name in ("last", "first", "middle") if third == "auto" else (third,):
        first, last, end = (low + (high - low) * k / 6 for k in _BOUNDS[name])
        free = not first + room < zero < end - room
        if free and bool(((p > first + room) & (p < last - room)).any()):
            return first, last, _PEAK[name]
    if third == "auto" or free:
        raise TableError(
            f"no entry lies {'within a third' if third == 'auto' else 'in the ' + third + ' third'} of the "
            f"travel, {format_along(table.axis, low)} to {format_along(table.axis, high)}, away from its ends, its middle and the "
            "reference: use a table with more entries"
            + ("" if third == "auto" else ", or another third")
        )
    raise TableError(
        f"the reference {format_along(table.axis, zero)} lies in the {third} third, where the correction "
        "must stay zero: take another third"
    )


def _bump(p: FloatArray, first: float, last: float, share: float) -> tuple[FloatArray, int]:
    """Return the bump of height 1 at the entries, and the entry of its peak."""
    room = _NODE * (p[-1] - p[0])
    outside = (p <= first + room) | (p >= last - room)
    inside = np.flatnonzero(~outside)
    wanted = first + share * (last - first)
    peak = int(inside[int(np.abs(p[inside] - wanted).argmin())])
    shape = np.interp(p, [first, p[peak], last], [0.0, 1.0, 0.0])
    shape[outside] = 0.0
    return shape, peak


def _check_slope(
    table: CompensationTable, shape: FloatArray, amplitude: float, slope_max: float
) -> None:
    steepest = float(np.abs(np.diff(shape) / np.diff(table.positions)).max())
    if abs(amplitude) * steepest > slope_max * (1.0 + 1e-9):
        raise TableError(
            f"a bump of {format_amount(table.compensates, amplitude)} slopes "
            f"{abs(amplitude) * steepest:.3g} {'rad' if is_rotary(table.compensates) else 'm'} per "
            f"{'rad' if is_rotary(table.axis) else 'm'} "
            f"between the entries, allowed are {slope_max:.3g}: use at most "
            f"{format_amount(table.compensates, slope_max / steepest)}"
        )


def _cancelled(table: CompensationTable) -> RunSet:
    """Return the error that the bump cancels, for the dry-run of the file."""
    x = np.union1d(table.positions, 0.5 * (table.positions[1:] + table.positions[:-1]))
    runs = [Run(x, -table.correction(x, 1), run_id="forward")]
    if table.reverse is not None:
        runs.append(Run(x[::-1], -table.correction(x[::-1], -1), run_id="reverse"))
    return RunSet(runs)


def _described(table: CompensationTable, position: float, amplitude: float) -> TrialTable:
    back = amplitude if table.reverse is None else _REVERSE * amplitude
    low, high = table.span
    where = format_span(table.axis, position, digits=6)
    seen, flipped, backwards = (
        _signed(table.compensates, v) for v in (amplitude, -amplitude, back)
    )
    mirror = low + high - position
    mirrored = format_span(table.axis, mirror, digits=6)
    first, last = (format_span(table.axis, p, digits=6) for p in (low, high))
    both = "" if back == amplitude else f"; in - direction {_REVERSE:g} of it, {backwards}"
    return TrialTable(
        table=table,
        position=position,
        amplitude=float(amplitude),
        amplitude_reverse=float(back),
        mirror=float(mirror),
        instruction=(
            f"Without tool and part, set an indicator on axis {table.compensates}, + for places "
            f"further in +{table.compensates}. Drive {table.axis} in + direction from "
            f"{first.partition(' ')[0]} to {last}, once without and once with the trial table, "
            f"and take the difference (with minus without) at {where} and at {mirrored}."
        ),
        if_right=f"Sign right: the indicator shows {seen} at {where} and 0 elsewhere{both}.",
        if_wrong=(
            f"Sign wrong: it shows {flipped} at {where}; change the sign and repeat. A bump at "
            f"{mirrored} means mirrored positions, none at all that the table is not active."
        ),
    )


def _signed(axis: str, value: float) -> str:
    return ("+" if value > 0 else "") + format_amount(axis, value)


# ---- A map with one bump to try on the machine, where the sign of a controller is not documented ----
# The bump stands in one quarter of the map, nearer to one corner in both axes: a wrong sign shows as
# a negative reading, mirrored or exchanged axes as a bump in another place.

_PLACES = ((0.3, 0.8), (0.8, 0.3), (0.3, 0.2), (0.8, 0.7))
"""Shares of the two travels at which the bump may stand: never the same share of both."""

_REACH = 0.15
"""Half the width of the bump over each travel, at least one interval."""


@dataclass(frozen=True, slots=True)
class TrialMap:
    """A map with one bump, and what must be seen.

    Parameters
    ----------
    table : CompensationMap
        Zero but for the bump; it keeps axes and positions of the real one.
    place : tuple of (float, float), m or rad
        Its peak.
    amplitude : float, m
        Correction there.
    instruction, if_right, if_wrong : str
        What to do, and what the indicator then shows.
    """

    table: CompensationMap
    place: tuple[float, float]
    amplitude: float
    instruction: str
    if_right: str
    if_wrong: str


@described_by(trial_table, errors=False)
def trial_map(table: CompensationMap, amplitude: float | str) -> TrialMap:
    """Return a map with one bump at the positions of a real one.

    Returns
    -------
    TrialMap
        The map is a product of one function of each axis, so that every carrier of maps holds it.

    Raises
    ------
    DataError
        If the amplitude is not a finite length other than zero.
    TableError
        If the map has fewer than five positions along an axis.

    Examples
    --------
    >>> import numpy as np
    >>> real = CompensationMap(np.arange(11.0), np.arange(6.0), np.zeros((6, 11)))
    >>> trial = trial_map(real, 2e-6)
    >>> trial.place, float(trial.table.correction(*trial.place)[0])
    ((3.0, 4.0), 2e-06)
    """
    amplitude = _amplitude(amplitude)
    if min(table.x.size, table.y.size) < 5:
        raise TableError("a trial needs at least 5 positions along each axis of the map")
    for share_x, share_y in _PLACES:
        (px, f), (py, g) = _peak(table.x, share_x), _peak(table.y, share_y)
        place, values = (px, py), amplitude * np.outer(g, f)
        made = replace(
            table,
            values=values,
            u=None,
            interpolation_error=None,
            offset_removed=0.0,
            is_exact_inverse=True,
            source=None,
            history=(*table.history, Step("trial_map", {"amplitude_m": float(amplitude)})),
        )
        if float(made.correction(*table.reference)[0]) == 0.0:
            own = ErrorMap(made.x, made.y, -made.values)
            return _maps_described(replace(made, source=own), place, float(amplitude))
    raise TableError("no place of the map lies apart from its reference")  # pragma: no cover


def _peak(positions: FloatArray, share: float) -> tuple[float, FloatArray]:
    low, high = float(positions[0]), float(positions[-1])
    inner = positions[1:-1]
    top = float(inner[np.argmin(np.abs(inner - (low + share * (high - low))))])
    reach = max(_REACH * (high - low), 1.000001 * float(np.diff(positions).max()))
    shape = np.maximum(1.0 - np.abs(positions - top) / reach, 0.0)
    shape[[0, -1]] = 0.0
    return top, shape


def _maps_described(
    table: CompensationMap, place: tuple[float, float], amplitude: float
) -> TrialMap:
    a, b = table.axes
    where = f"{a} = {format_position(a, place[0])}, {b} = {format_position(b, place[1])}"
    mirrored = [
        format_position(axis, float(p[0] + p[-1] - at))
        for axis, p, at in ((a, table.x, place[0]), (b, table.y, place[1]))
    ]
    seen = f"{amplitude * 1e6:+.4g} um"
    return TrialMap(
        table=table,
        place=place,
        amplitude=amplitude,
        instruction=(
            f"Without tool and part, set an indicator on axis {table.compensates}, + for places "
            f"further in +{table.compensates}. Drive to {where}, once without and once with the "
            "trial map, and take the difference (with minus without)."
        ),
        if_right=(f"Sign right: the indicator shows {seen} at {where}, and it falls to 0 around."),
        if_wrong=(
            f"Sign wrong: it shows {-amplitude * 1e6:+.4g} um there. A bump at {a} = {mirrored[0]} "
            f"or {b} = {mirrored[1]} means a mirrored axis, none at all that the map is not active; "
            f"the largest correction is {format_length(abs(amplitude))}."
        ),
    )

"""A map with one bump to try on the machine, where the sign of a controller is not documented.

The bump stands in one quarter of the map, nearer to one corner in both axes: a wrong sign shows as
a negative reading, mirrored or exchanged axes as a bump in another place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from metrosep.compensation.area_errors import ErrorMap, format_position
from metrosep.compensation.maps import CompensationMap
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TableError
from metrosep.core.provenance import Step
from metrosep.core.units import format_length

__all__ = ["TrialMap", "trial_map"]


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


def trial_map(table: CompensationMap, amplitude: float) -> TrialMap:
    """Return a map with one bump at the positions of a real one.

    Parameters
    ----------
    table : CompensationMap
        The real one: its positions, axes and reference are kept, its corrections are not.
    amplitude : float, m
        Correction at the peak, with its sign; some ten times what the indicator resolves.

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
    if isinstance(amplitude, bool | str) or not math.isfinite(amplitude) or amplitude == 0.0:
        raise DataError(f"the amplitude must be a length other than zero in m, got {amplitude!r}")
    if min(table.x.size, table.y.size) < 5:
        raise TableError("a trial needs at least 5 positions along each axis of the map")
    for share_x, share_y in _PLACES:
        place, values = _bump(table, share_x, share_y, amplitude)
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
            return _described(replace(made, source=own), place, float(amplitude))
    raise TableError("no place of the map lies apart from its reference")  # pragma: no cover


def _bump(
    table: CompensationMap, share_x: float, share_y: float, amplitude: float
) -> tuple[tuple[float, float], FloatArray]:
    (px, f), (py, g) = (_peak(p, s) for p, s in ((table.x, share_x), (table.y, share_y)))
    return (px, py), amplitude * np.outer(g, f)


def _peak(positions: FloatArray, share: float) -> tuple[float, FloatArray]:
    low, high = float(positions[0]), float(positions[-1])
    inner = positions[1:-1]
    top = float(inner[np.argmin(np.abs(inner - (low + share * (high - low))))])
    reach = max(_REACH * (high - low), 1.000001 * float(np.diff(positions).max()))
    shape = np.maximum(1.0 - np.abs(positions - top) / reach, 0.0)
    shape[[0, -1]] = 0.0
    return top, shape


def _described(table: CompensationMap, place: tuple[float, float], amplitude: float) -> TrialMap:
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

"""Numbers that mean "not measured": -9999, 99999.99, the limits of converters.

None is removed, and none is accepted in silence. See ``data_formats/delimited/SPEC.md``.
"""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["marker_of"]

_MARKERS = frozenset(
    {
        32767.0,
        -32768.0,
        -32767.0,
        65535.0,
        2147483647.0,
        -2147483648.0,
        -2147483647.0,
        4294967295.0,
    }
)
"""Limits of the integers of converters."""
_NULLS = frozenset({-999.25})
"""What logs of wells write for "not measured": reported also where it stands once."""
_BEYOND = 1e20
_FAR = 5.0
"""A value of marker shape further away than so many times the spread of the others is refused."""
_VERY_FAR = 20.0
"""Any value that repeats exactly, so at least twice, and is further away than that is reported."""
_REPEATED = 2
_NEAR = 0.5
"""A value of marker shape that repeats is reported from so many spreads on: numbers of a measurement
leave no gap of half their spread below an extreme that two of them share to the last digit."""


def _has_marker_shape(value: float) -> bool:
    digits = f"{abs(value):.12g}".replace(".", "")
    nines = len(digits) >= 3 and set(digits) == {"9"}
    return nines or value in _MARKERS or abs(value) >= _BEYOND


def marker_of(values: FloatArray) -> tuple[float, float, bool] | None:
    """Return a value that means "not measured", its distance in spreads, and whether that is sure.

    Extremes of the shape of a marker are set aside in turn; what is left tells the spread R. Such a
    value further than 5 R away is sure; one that repeats, beyond 0.5 R, and any other that repeats,
    beyond 20 R, are not.
    """
    finite = np.isfinite(values)
    rest = values if finite.all() else values[finite]
    del finite
    most = rest.size / 2
    aside: list[float] = []
    near: tuple[float, float, bool] | None = None
    while rest.size >= _FEWEST:
        extremes = (float(rest.max()), float(rest.min()))
        counts = {e: int(np.count_nonzero(rest == e)) for e in extremes}
        shaped = [e for e in extremes if _has_marker_shape(e) and counts[e] <= most]
        if not shaped or len(aside) == _MOST_MARKERS:
            repeated = [
                e
                for e in extremes
                if (counts[e] >= _REPEATED or e in _NULLS) and counts[e] <= most
            ]
            found = next((e for e in repeated if _distance(e, rest[rest != e]) > _VERY_FAR), None)
            return near if found is None else (found, _distance(found, rest[rest != found]), False)
        aside.append(shaped[0])
        rest = rest[rest != shaped[0]]
        for value in aside:
            if (ratio := _distance(value, rest)) > _FAR:
                return value, ratio, True
            if ratio > _NEAR and near is None and np.count_nonzero(values == value) > 1:
                near = (value, ratio, False)
    return near


_FEWEST = 3
_MOST_MARKERS = 4


def _distance(value: float, rest: FloatArray) -> float:
    """Return how many times the spread of the others a value lies away; 0 where they hardly differ."""
    if rest.size < _FEWEST or np.unique(rest[:1000]).size < _FEWEST:
        return 0.0
    low, high = float(rest.min()), float(rest.max())
    return min(abs(value - low), abs(value - high)) / (high - low)

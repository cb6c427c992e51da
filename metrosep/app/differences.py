"""Differences of two measurements that lie on the same grid; nothing is interpolated."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

__all__ = ["difference_of", "grid_words"]

_SAME = 1e-6
"""Of a step: positions nearer than this are the same."""


def difference_of(a: Any, b: Any) -> Surface | Profile:
    """Return b minus a, sample by sample.

    Examples
    --------
    >>> difference_of(Surface([[1.0, 5.0]], 1.0, 1.0), Surface([[3.0, 5.0]], 1.0, 1.0)).z.tolist()
    [[2.0, 0.0]]
    """
    kinds = [type(v).__name__ for v in (a, b)]
    if kinds[0] != kinds[1] or not isinstance(a, Surface | Profile):
        raise DataError(
            f"one is a {kinds[0]} and the other a {kinds[1]}: they have no difference; take two maps "
            "or two profiles"
        )
    reason = grid_words(a, b)
    if reason:
        raise DataError(
            f"the grids differ, so nothing is subtracted: {reason}; measure on the same grid, or "
            "compare the numbers only"
        )
    z = b.z - a.z
    if np.isnan(z).all():
        raise TooFewSamplesError("no sample is measured in both: there is no difference to show")
    if isinstance(a, Surface):
        return Surface(z, b.dx, b.dy, origin=b.origin)
    return Profile(b.x, z)


def grid_words(a: Any, b: Any) -> str:
    """Return what differs between the grids of two measurements of one kind."""
    if a.z.shape != b.z.shape:
        sizes = (" x ".join(map(str, v.z.shape[::-1])) for v in (a, b))
        return "{} and {} samples".format(*sizes)
    if isinstance(a, Profile):
        apart = float(np.abs(b.x - a.x).max())
        step = float(np.abs(np.diff(a.x)).min()) if a.x.size > 1 else 1.0
        return "" if apart <= _SAME * step else f"positions up to {format_length(apart)} apart"
    for name, n in (("dx", a.z.shape[1]), ("dy", a.z.shape[0])):
        one, two = getattr(a, name), getattr(b, name)
        if (one is None) != (two is None):
            return f"{name} is known of one map only"
        if one is not None and abs(two - one) * n > _SAME * n * one:
            return f"{name} is {format_length(one)} and {format_length(two)}"
    for axis, step in ((0, a.dx), (1, a.dy)):
        apart = abs(b.origin[axis] - a.origin[axis])
        if apart > _SAME * (1.0 if step is None else step) * max(a.z.shape):
            return f"the {'xy'[axis]} of their first pixels is {format_length(apart)} apart"
    return ""

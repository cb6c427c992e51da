"""A map or profile on another grid; heights between pixels as `core.sections` reads them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, Example, OptionError, TooFewSamplesError
from metrosep.core.numbers import choice, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.sections import Reading, heights_at, is_calibrated
from metrosep.core.surface import Surface

_METHODS = ("lanczos", "bilinear", "nearest")

_MOST_SAMPLES = 10_000_000
"""Largest number of samples along an axis; a step that needs more is a slip of the unit."""


def resample(
    obj: Surface | Profile,
    onto: Surface | Profile | None = None,
    *,
    step: float | str | None = None,
    method: Reading = "lanczos",
) -> Surface | Profile:
    """Return the heights of a map or profile on another grid.

    Parameters
    ----------
    obj : Surface or Profile
        A map needs lateral steps.
    onto : Surface or Profile, optional
        Whose grid is wanted, of the same kind; its heights do not matter.
    step : float (m) or str with unit, optional
        In place of `onto`: one step along every axis, from the first sample on.
    method : {"lanczos", "bilinear", "nearest"}, optional
        How heights of a map are read; a profile is always interpolated along a straight line.

    Returns
    -------
    Surface or Profile
        NaN outside what was measured and beside gaps. Nothing is filtered: waves shorter than two of
        the new steps must be removed before.

    Raises
    ------
    OptionError
        If neither or both of `onto` and `step` are given, or the kinds differ.
    DataError
        If a map has no lateral steps, or the step is longer than what was measured.

    Examples
    --------
    >>> line = Profile([0.0, 1.0, 2.0], [0.0, 2.0, 0.0])
    >>> resample(line, step=0.5).z.tolist()
    [0.0, 1.0, 2.0, 1.0, 0.0]
    """
    if (onto is None) == (step is None):
        raise OptionError("resample needs either the grid of another object (onto=) or a step=")
    given: Any = obj
    if not isinstance(given, Surface | Profile):
        raise OptionError(f"resample takes a Surface or a Profile, got {type(given).__name__}")
    kind = Surface if isinstance(obj, Surface) else Profile
    if onto is not None and not isinstance(onto, kind):
        raise OptionError(f"a {kind.__name__} cannot be resampled onto a {type(onto).__name__}")
    choice(method, "method", _METHODS)
    pitch = None if step is None else positive(step, "step", dimension="length")
    if isinstance(obj, Profile):
        for one in (obj, onto):
            if isinstance(one, Profile):
                one.require_metres()
        x = onto.x if isinstance(onto, Profile) else _grid(obj.x[0], obj.x[-1], pitch)
        z = np.interp(x, obj.x, obj.z, left=np.nan, right=np.nan)
        note = Step("resample", {"samples": int(x.size), "reading": "linear"})
        return Profile(x, z, metadata=obj.metadata, history=(*obj.history, note))
    if not is_calibrated(obj):
        raise DataError(
            "a map without lateral steps cannot be resampled; read the file with lateral_step=..."
        ).hinting(lateral_step=Example("3 um"))
    if isinstance(onto, Surface):
        if not is_calibrated(onto):
            raise DataError("the map that gives the grid has no lateral steps")
        dx, dy, origin, shape = onto.dx, onto.dy, onto.origin, onto.shape
        xs, ys = (origin[k] + (dx, dy)[k] * np.arange(shape[1 - k]) for k in (0, 1))  # type: ignore[operator]
    else:
        dx = dy = pitch
        origin = obj.origin
        ends = [
            o + d * (n - 1) for o, d, n in zip(origin, _steps(obj), obj.shape[::-1], strict=True)
        ]
        xs, ys = (_grid(o, e, pitch) for o, e in zip(origin, ends, strict=True))
    columns, rows = np.meshgrid(xs, ys)
    (x0, y0), (sx, sy) = obj.origin, _steps(obj)
    at = ((rows.ravel() - y0) / sy, (columns.ravel() - x0) / sx)
    heights, share = heights_at(obj, *at, method)
    note = Step("resample", {"dx_m": dx, "dy_m": dy, "reading": method, "bilinear_share": share})
    return Surface(
        heights.reshape(rows.shape), dx, dy, origin=origin, metadata=obj.metadata,
        history=(*obj.history, note),
    )  # fmt: skip


def _grid(start: float, stop: float, step: float | None) -> FloatArray:
    """Return positions from the first sample on, none beyond the last one."""
    pitch = float(step or 0.0)
    n = math.floor((stop - start) / pitch * (1.0 + 1e-12) + 1e-9) + 1
    if n < 2:
        raise TooFewSamplesError(
            f"step = {pitch:.6g} m is longer than what was measured, {stop - start:.6g} m"
        )
    if n > _MOST_SAMPLES:
        raise DataError(f"step = {pitch:.6g} m gives {n} samples; is it in m?")
    return np.asarray(start + pitch * np.arange(n))


def _steps(surface: Surface) -> tuple[float, float]:
    """Return the lateral steps of a calibrated map."""
    return float(surface.dx or 1.0), float(surface.dy or 1.0)

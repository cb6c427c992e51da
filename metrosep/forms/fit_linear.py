"""The part of `fit` that needs no iteration: forms that are linear in all that is free.

A polynomial or Zernike form with unknown coefficients is solved by its own engine (moments of the
map, orthogonal factors of a list); a known form with piston and both tilts free by the moments of
degree 1 of what it leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.forms.base import Form
from metrosep.forms.freedoms import Freedoms
from metrosep.forms.linear import LinearFit, LinearForm
from metrosep.forms.placement import Placement
from metrosep.forms.points import Points
from metrosep.forms.robust import (
    Robust,
    Weigh,
    robust_fit,
    robust_variance,
    spread,
    trimmed_start,
)

__all__ = ["Answer", "solve_level", "solve_linear", "sum_of_squares"]

_LEVELS = ("piston", "tilt_x", "tilt_y")


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a fit found."""

    form: Form  # with its parameters
    rigid: dict[str, float]  # to float: rigid-body freedoms
    cov: FloatArray  # shape (p, p): covariance in the order of the freedoms
    residual: FloatArray  # shape of the points' z, m: what is left; NaN outside the domain
    n: int  # points inside the domain
    squares: float  # m^2: sum of the squared residuals


def solve_linear(
    points: Points, form: Form, freedoms: Freedoms, robust: Robust | None
) -> Answer | None:
    """Return the answer of a form whose coefficients are all that is free, else None."""
    if not isinstance(form, LinearForm) or freedoms.shape != tuple(form.parameters):
        return None
    if freedoms.rigid or freedoms.held:
        return None
    if robust is not None:
        return _robust(points, form, robust)
    fit, residual = _once(points, form, None)
    n, squares = fit.n_valid, max(fit.residual_sum, 0.0)
    return Answer(fit.form, {}, _covariance(fit), residual, n, squares)


def solve_level(
    points: Points, placed: Placement, freedoms: Freedoms, robust: Robust | None
) -> Answer | None:
    """Return piston and tilt of a known form on a map where nothing else is free, else None."""
    if points.z.shape[0] < 2 or freedoms.names != _LEVELS or robust is not None:
        return None
    if (placed.tilt, placed.direction) != ("plane", "vertical") or not points.is_uniform:
        return None
    try:
        return _levelled(points, placed)
    except DegenerateFitError:  # the general solver names the freedoms that are not determined
        return None


def sum_of_squares(residual: FloatArray) -> tuple[int, float]:
    """Return the number of points that are not NaN, and the sum of their squares."""
    squares, n = 0.0, 0
    for part in np.array_split(residual.ravel(), max(1, residual.size >> 16)):
        good = part[~np.isnan(part)]
        squares += float(good @ good)
        n += int(good.size)
    return n, squares


def _levelled(points: Points, placed: Placement) -> Answer:
    """Return piston and tilt of a known form on a map."""
    from metrosep.forms.polynomial import Polynomial

    bare = Placement(
        placed.form, {k: v for k, v in placed.rigid.items() if k not in _LEVELS}, placed.tilt
    )
    left = points.z
    if placed.form.parameters:  # a plane holds nothing that is not fitted
        left = points.over_blocks(bare.deviation)
    fit, residual = Polynomial(1).fit_map(points.x, points.y, left)
    c = fit.form.parameters
    rigid = dict(
        zip(_LEVELS, (float(c[k] or 0.0) for k in ("c_0_0", "c_1_0", "c_0_1")), strict=True)
    )
    n, squares = fit.n_valid, max(fit.residual_sum, 0.0)
    return Answer(placed.form, {**bare.rigid, **rigid}, _covariance(fit), residual, n, squares)


def _once(
    points: Points, form: LinearForm, weights: FloatArray | None
) -> tuple[LinearFit, FloatArray]:
    if points.z.shape[0] > 1 and not points.is_scattered:
        return form.fit_map(points.x, points.y, points.z, weights=weights)
    y = points.y if points.is_scattered else np.broadcast_to(points.y, points.x.shape)
    flat = None if weights is None else weights[0]
    fit, residual = form.fit_list(points.x, y, points.z[0], weights=flat)
    return fit, residual[None, :]


def _robust(points: Points, form: LinearForm, rule: Robust) -> Answer:
    """Return the MM-estimate: trimmed start of a sample, then weights of all points."""
    least, residual = _once(points, form, None)
    form = least.form  # its domain stays, whatever the weights
    x, y, z = points.sample()
    left = z - form.height(x, y)
    inside = ~np.isnan(left)
    change = trimmed_start(form.basis(x, y)[:, inside], left[inside])
    values = {
        k: float(v or 0.0) + float(d)
        for (k, v), d in zip(form.parameters.items(), change, strict=True)
    }
    trimmed = Placement(form.with_parameters(**values), {})
    residual = np.where(np.isnan(residual), np.nan, points.over_blocks(trimmed.deviation))

    def refit(
        last: tuple[LinearFit, FloatArray], weigh: Weigh
    ) -> tuple[tuple[LinearFit, FloatArray], float]:
        fit, fresh = _once(points, form, weigh(last[1]))
        n, squares = sum_of_squares(fresh - last[1])
        return (fit, fresh), float(np.sqrt(squares / n))

    (fit, residual), scale = robust_fit(
        (least, residual),
        lambda found: spread(found[1]),
        refit,
        rule,
        largest=points.largest,
        name=form.name,
    )
    flat = residual[~np.isnan(residual)]
    cov = robust_variance(flat, scale, rule, len(form.parameters)) * least.inverse
    n, squares = sum_of_squares(residual)
    return Answer(fit.form, {}, cov, residual, n, squares)


def _covariance(fit: LinearFit) -> FloatArray:
    """Return the covariance; NaN where there are no degrees of freedom."""
    if fit.n_valid <= fit.inverse.shape[0]:
        return np.full(fit.inverse.shape, np.nan)
    return fit.covariance

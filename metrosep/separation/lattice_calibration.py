"""2-D self-calibration: errors of a stage and of a grid plate from views of the same plate.

``reading(site) = nominal + plate(mark) + stage(site) + placement``: the plate is measured as placed,
turned by quarter turns, and shifted by whole pitches; every placement has an unknown translation
and rotation. Both errors are unknown. Least squares on the lattice, whose null space is computed
from the design. The stage error is what the stage adds to a reading (indication minus true
position): the correction to add to its readings is the negative. Arrays are (n_y, n_x, 2), last
axis x and y component; rows grow with y, columns with x; quarter turns count from x to y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError
from metrosep.core.quantity import Quantity
from metrosep.separation._grid_solution import Repeats, moved_between
from metrosep.separation._lattice_fit import Lattice, better_turns
from metrosep.separation._lattice_views import (
    GridView,
    checked_size,
    parsed_views,
    refuse_inseparable,
)
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable
from metrosep.separation.planner_checks import positive

__all__ = ["GridView", "grid_calibration"]


_TERMS = ("translation x", "translation y", "rotation", "scale")


def grid_calibration(
    views: Mapping[str, ArrayLike] | Sequence[GridView],
    *,
    pitch: float,
    repeats: Repeats = "relaid",
    u_reading: float | None = None,
) -> Separation:
    """Return the errors of a stage and of a grid plate from views of the plate.

    Parameters
    ----------
    views : mapping of str to array_like, or sequence of GridView
        Readings under the names ``initial``, ``rotated`` (a quarter turn from x to y) and
        ``shifted`` (one pitch along +x), or views with turns and shifts of their own.
    pitch : float, m
        Pitch of the lattice.
    repeats : {"relaid", "passes"}, optional
        Whether the plate was placed anew for each repeat of a view, with a translation and rotation
        of its own, or stayed where it lay.
    u_reading : float, m, optional
        Standard uncertainty of one reading as it is believed; a message tells if the residuals
        exceed it.

    Returns
    -------
    Separation
        Parts ``stage`` and ``plate``, (n_y, n_x, 2), with their translation, rotation and scale
        removed by least squares; NaN where a site or mark is not determined.

    Raises
    ------
    DataError
        If shapes differ, a turn or shift is not whole, pitch or `u_reading` are not usable,
        `repeats` is unknown, or the lattice is too large or too small.
    InvalidSamplesError
        If readings are not real numbers.
    NotSeparableError
        If the views lack a quarter turn or a translation, or leave more undetermined than
        translation, rotation and scale; the message names what is missing.
    UnitError
        If the readings are larger than the pitch: they must be deviations in m.

    Notes
    -----
    Null space: translation and rotation of each part (the placements are free), and the scale: a
    stage that reads too long on a plate that is too short gives the same readings in every view.
    No length enters, so none comes out; calibrate one distance of the plate. u is from the
    covariance of the fit with the noise of its residuals; it grows slowly with the lattice. Where
    all repeats of a view read the same marks, both kinds of `repeats` give the same parts; a plate
    that was placed anew and is said to have stayed makes noise of its placements (told).

    References
    ----------
    .. [1] J. Ye, M. Takac, C. N. Berglund, G. Owen, R. F. Pease, Precision Eng. 20 (1997).
    .. [2] M. R. Raugh, Precision Eng. 7 (1985).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> stage = 1e-7 * rng.standard_normal((5, 5, 2))
    >>> shifted = stage.copy()
    >>> shifted[:, 0] = np.nan  # perfect plate, moved one pitch along x
    >>> found = grid_calibration(
    ...     {"initial": stage, "rotated": stage, "shifted": shifted}, pitch=1e-2)
    >>> bool(abs(found.plate).max() < 1e-15)
    True
    """
    if repeats not in ("relaid", "passes"):
        raise DataError(f"repeats is 'relaid' or 'passes', got {repeats!r}")
    step = positive(pitch, "pitch", "m")
    stated = None if u_reading is None else positive(u_reading, "u_reading", "m", zero=True)
    parsed = parsed_views(views)
    size = checked_size(parsed, step)
    refuse_inseparable(parsed)
    with one_blas_thread():
        fit = Lattice(parsed, size, repeats == "relaid")
        other = better_turns(parsed, size, fit.sigma, repeats == "relaid")
    dof = fit.n_readings - fit.rank
    sigma = fit.sigma
    text = "standard deviation of one reading"
    noise = (
        Quantity(sigma, "m", f"{text}, from the views", u=sigma / math.sqrt(2 * dof), symbol="s")
        if dof > 0
        else Quantity(math.nan, "m", f"{text}; not known", symbol="s")
    )
    if dof <= 0 and stated is not None:
        sigma = stated
        noise = Quantity(sigma, "m", f"{text}, as stated", symbol="s")
    n_y, n_x = size
    return Separation(
        "grid_calibration",
        {"stage": fit.parts[0], "plate": fit.parts[1]},
        {"stage": fit.uncertainty(0, sigma), "plate": fit.uncertainty(1, sigma)},
        {"stage": "m", "plate": "m"},
        {"x": _centred(n_x, step), "y": _centred(n_y, step)},
        unseen_terms() + fit.unseen(),
        noise,
        audit={
            "placements": [[v.turns, v.shift[0], v.shift[1]] for v, _ in parsed],
            "pitch_mm": step * 1e3,
            "repeats": repeats,
            "n_readings": fit.n_readings,
            "degrees_of_freedom": dof,
            "null_space_dimension": fit.null_dimension,
            "removed_from_both_parts": list(_TERMS),
            "scale_ppm": None,
            "sum_of_scales_ppm": fit.sum_of_scales / step * 1e6,
            "residual_rms_nm": math.sqrt(fit.squares / fit.n_readings) * 1e9,
        },
        messages=_messages(fit, sigma, stated, step, parsed, other),
    )  # fmt: skip


def unseen_terms() -> tuple[Unobservable, ...]:
    """Return what no set of views determines."""
    reason = "placements are free, and no length enters: a long stage on a short plate reads alike"
    return tuple(Unobservable(part, "term", _TERMS, reason) for part in ("stage", "plate"))


def _centred(n: int, pitch: float) -> FloatArray:
    return np.asarray((np.arange(n) - (n - 1) / 2) * pitch, dtype=np.float64)


def _messages(
    fit: Lattice,
    sigma: float,
    u_reading: float | None,
    pitch: float,
    views: list[tuple[GridView, FloatArray]],
    other: tuple[list[int], float] | None,
) -> tuple[str, ...]:
    total = fit.sum_of_scales / pitch * 1e6
    scale = (
        f"the scale of stage and plate is not recoverable, only their sum ({total:.4g} ppm): "
        "calibrate one distance of the plate"
    )
    out = [scale]
    for part, lost in zip(("stage sites", "plate marks"), fit.lost, strict=True):
        if lost:
            out.append(f"{lost} {part} are not determined by these views: NaN")
    dof = fit.n_readings - fit.rank
    if moved_between(fit.squares, dof, *fit.moved):
        out.append(
            "repeats of a view differ by translation and rotation by more than their noise: the plate "
            "was placed anew between them; give repeats = 'relaid', as stated noise and u are too large"
        )
    if math.isnan(sigma):
        out.append("no redundancy and no u_reading: the uncertainty is not known (NaN)")
    elif u_reading is not None and sigma > 1.5 * u_reading:
        out.append(
            f"the residuals scatter by {sigma * 1e9:.3g} nm, more than the stated "
            f"{u_reading * 1e9:.3g} nm: the plate bends with its placement, a turn or a shift is "
            "not what it was said to be, or the stage drifts"
        )
    if other is not None:
        named = " and ".join(
            f"view {i} turned by {-90 * views[i - 1][0].turns:+d} degrees instead of "
            f"{90 * views[i - 1][0].turns:+d}"
            for i in other[0]
        )
        out.append(
            f"the residuals of {sigma * 1e9:.3g} nm fall to {other[1] * 1e9:.3g} nm with {named}: "
            "check the sense of the turn (positive from x towards y); as stated, the result is wrong"
        )
    return tuple(out)

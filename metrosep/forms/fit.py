"""Fit an ideal surface to a measurement: rigid-body freedoms and shape parameters together.

The deviation is measured minus ideal (error = actual - nominal). What is linear is solved at once;
the rest by Levenberg-Marquardt with analytic derivatives, for a large map first on 20 000 of its
points. Sources: any text on nonlinear least squares; Forbes 1991 (NPL DITC 140/89) on
least-squares best-fit geometric elements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core._arrays import CheckedArray, FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, Example
from metrosep.core.numbers import LEAST, choice, without_rounding
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import PIXEL, format_length
from metrosep.forms._correlated import NoiseModel
from metrosep.forms.base import RIGID, Direction, Form, Freedoms, Placement, Tilt, choose_freedoms
from metrosep.forms.conic import curvature_name, curvature_of, is_flat
from metrosep.forms.iterate import find
from metrosep.forms.linear import Answer, Robust, spread
from metrosep.forms.points import Points, PointSet, points_of, require_scale
from metrosep.forms.polynomial import Polynomial
from metrosep.forms.result import FitResult


def fit(
    obj: Surface | Profile | PointSet,
    form: Form | str,
    *,
    free: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    robust: Robust | None = None,
    tilt: Tilt = "plane",
    direction: Direction = "vertical",
    centre: tuple[float, float] | None = None,
    start: Mapping[str, float] | None = None,
    max_iterations: int = 100,
    noise: NoiseModel | None = None,
) -> FitResult:
    """Return the form that leaves the smallest sum of squared deviations.

    Parameters
    ----------
    obj : Surface, Profile or PointSet
        Measurement; NaN is omitted. A profile is the line y = 0 and need not be uniform.
    form : Form or str
        Ideal surface, or its name and parameters as a text ("sphere", "conic: R=50 mm"). Parameters that
        are None are found, and those named in `free`.
    free : sequence of str, optional
        Rigid-body freedoms ("piston", "tilt_x", "tilt_y", "shift_x", "shift_y", "rotation_z") and
        names of parameters. Piston and tilt if omitted; for a linear form without coefficients
        that holds piston or tilt itself only these.
    fixed : mapping of str to float, optional
        Freedoms and parameters held at a value, SI.
    robust : {"tukey", "huber"}, optional
        Weigh outliers down; least squares if omitted.
    tilt : {"plane", "rotation"}, optional
        Add a plane, or turn the form as a rigid body.
    direction : {"vertical", "normal"}, optional
        Of the deviation; "normal" is the distance to the nearest point of the form.
    centre : tuple of (float, float), optional, m
        Origin of the form in the coordinates of `obj`. If omitted: the coordinates as they are,
        but for a form with a vertex the middle of what was measured, if a map declares no origin.
    start : mapping of str to float, optional
        Where to begin, instead of the guess from the data.
    max_iterations : int, optional
        Of the nonlinear iteration.
    noise : StationaryNoise, optional
        Model of `metrosep.parameters` (white, correlated, from a PSD): `u` is then made from it, not
        from the residual. The fit itself stays least squares.

    Returns
    -------
    FitResult
        ``.params``, ``.u``, ``.cov``, ``.residual``, ``.rms``, ``.report()``.

    Raises
    ------
    DataError
        If a name, an option or the object is not one that can be used.
    TooFewSamplesError
        If nothing was measured.
    DegenerateFitError
        If there are fewer points than freedoms, or the points cannot tell freedoms apart.
    NotConvergedError
        If the iteration does not settle.

    Notes
    -----
    O(n) in time, blocks of 16 000 points in memory. A radius is looked for as its curvature 1/R, so
    that a flat part has an answer, R = inf. A conic constant that the points do not know to 1, and
    the angle of a cylinder not known to 1 rad, is held, with a warning. The covariance is made from
    the correlation of the residual when it is asked for; with a robust rule the residual is
    winsorised.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> from metrosep.forms import Sphere, fit
    >>> x = np.linspace(-5e-3, 5e-3, 201)
    >>> found = fit(Profile(x, 1e-6 + 2e-4 * x + Sphere(R=50e-3)(x)), Sphere())
    >>> round(found.params["R"], 9), round(found.params["tilt_x"], 9)
    (0.05, 0.0002)
    """
    form = _form(form)
    choice(tilt, "tilt", ("plane", "rotation"))
    choice(direction, "direction", ("vertical", "normal"))
    if robust is not None:
        choice(robust, "robust", ("tukey", "huber"))
    points = points_of(obj, centre=centre, middle=form.has_centre)
    lines = () if points.is_scattered else (("x", points.x.size), ("y", points.y.size))
    same = "".join(name for name, n in lines if n == 1)
    if isinstance(form, Polynomial) and same:
        form = form.for_profile() if same == "y" else form.for_column()
    form, freedoms = choose_freedoms(form, free, {} if fixed is None else fixed, same=same)
    with one_blas_thread():
        answer, placed, n_iterations, freedoms = find(
            points,
            form,
            freedoms,
            {} if start is None else start,
            robust,
            tilt=tilt,
            direction=direction,
            max_iterations=max_iterations,
        )
        result = _result(obj, points, freedoms, placed, answer, robust, n_iterations=n_iterations)
        return result if noise is None else _with_noise(result, noise)


def _without_scale(what: str, instead: str) -> DataError:
    """Return the error of an option that no map without scale can have."""
    return DataError(
        f"{what}, and the file does not say how large a pixel of the map is: {instead}, or read the "
        "file with lateral_step=..."
    ).hinting(lateral_step=Example("3 um"))


def _form(given: Form | str) -> Form:
    if isinstance(given, str):
        from metrosep.forms.catalogue import form_from_text

        given = form_from_text(given)
    if not isinstance(given, Form):
        raise DataError(
            f"form must be a metrosep form such as Sphere(), got {type(given).__name__}"
        )
    return given


def _with_noise(result: FitResult, noise: NoiseModel) -> FitResult:
    """Return the result with a noise model, which is asked for its covariance now."""
    if not callable(getattr(noise, "autocovariance", None)):
        raise DataError(
            "noise= is a model with a covariance against lag, such as WhiteNoise(2e-9) or "
            f"CorrelatedNoise(...) of metrosep.parameters, got {noise!r}"
        )
    if isinstance(result.source, PointSet):
        raise DataError("the points of a list have no lags: noise= is for maps and profiles")
    return replace(result, covariance_of_noise=noise.autocovariance(result.source))


def remove(
    obj: Surface | Profile | PointSet, form: Form | str, **options: object
) -> Surface | Profile | PointSet:
    """Return what is left of a measurement after the best-fit form.

    Parameters
    ----------
    obj : Surface, Profile or PointSet
        Measurement.
    form : Form or str
        Ideal surface, as for `fit`.
    **options : object
        Of `fit`.

    Returns
    -------
    Surface, Profile or PointSet
        Measured minus ideal, with the fit in its history.

    Notes
    -----
    A plane or a polynomial is taken off a map without lateral steps, too: what it leaves does not
    depend on them.
    """
    if isinstance(obj, Surface) and None in (obj.dx, obj.dy):
        return over_pixels(obj, form, **options).residual
    return fit(obj, form, **options).residual  # type: ignore[arg-type]


def over_pixels(surface: Surface, form: Form | str, **options: Any) -> FitResult:
    """Return the fit to a map without scale of a form that leaves the same at every scale; refuse others.

    Of the answer the residual holds, and what it was fitted to; parameters count pixels as m.
    """
    form = _form(form)
    polynomial = isinstance(form, Polynomial) and not any(
        v is not None for v in form.parameters.values()
    )
    if isinstance(form, Polynomial) and form.basis_name == "power":
        polynomial = polynomial and not any(form.centre or ())
    elif isinstance(form, Polynomial):
        polynomial = polynomial and form.half_width is None
    if not (form.name == "plane" or polynomial):
        require_scale(surface)
    if polynomial and options.get("tilt", "plane") != "plane":
        raise _without_scale('tilt "rotation" turns the form in space', 'take tilt "plane"')
    if options.get("direction") == "normal":
        raise _without_scale(
            'direction "normal" counts heights and places alike', 'take "vertical"'
        )
    if options.get("centre") is not None:
        raise _without_scale("centre is a length", "leave it out")
    for name, value in (options.get("fixed") or {}).items():
        if value != 0.0 and name not in ("piston", "c_0_0", "L_0_0", "T_0_0"):
            what = "an angle" if name.startswith("tilt") else "a value"
            raise _without_scale(
                f"{name} is fixed at {what} other than zero", "hold it at zero or leave it free"
            )
    result = fit(Surface(surface.z, 1.0, 1.0), form, **options)
    found = result.residual.history[-1]
    kept = ("removed", "tilt", "direction", "robust")
    facts = {k: v for k, v in found.parameters.items() if k in kept}  # values are per pixel
    left = Surface(
        result.residual.z,
        surface.dx,
        surface.dy,
        origin=surface.origin,
        metadata=surface.metadata,
        history=(*surface.history, Step(found.name, {**facts, "over": PIXEL})),
    )
    return replace(result, residual=left)


def _result(
    obj: Surface | Profile | PointSet,
    points: Points,
    freedoms: Freedoms,
    placed: Placement,
    answer: Answer,
    robust: str | None,
    *,
    n_iterations: int = 0,
) -> FitResult:
    names, n = freedoms.names, answer.n
    residual, rms = _left(answer, points.z)
    shape = {k: float(v) for k, v in placed.form.parameters.items() if v is not None}
    rigid = {k: placed.get(k) for k in RIGID if k in freedoms.rigid or k in freedoms.held}
    # a sag of less than the last digit of the heights is none: the radius is infinite
    digit = np.finfo(float).eps * points.largest
    shape.update(
        {
            k: np.inf
            for k in placed.form.radii
            if is_flat(shape[k]) or (k in names and 0.5 * points.radius**2 < digit * abs(shape[k]))
        }
    )
    bent = {curvature_name(k): curvature_of(shape[k]) for k in placed.form.radii if k in names}
    params = {**rigid, **shape, **bent}
    step = Step(
        f"fit {placed.form.name}",
        {
            "removed": ", ".join(names) or "nothing free",
            "tilt": placed.tilt,
            "direction": placed.direction,
            **({"robust": robust} if robust else {}),
            **{f"{k}": v for k, v in shape.items()},
        },
    )
    history = (*obj.history, step)
    left: Surface | Profile | PointSet
    if isinstance(obj, Profile):
        left = Profile(obj.x, residual[0], metadata=obj.metadata, history=history)
    elif isinstance(obj, PointSet):
        left = PointSet(obj.x, obj.y, residual[0], metadata=obj.metadata, history=history)
    else:
        left = Surface(
            residual.view(CheckedArray),
            obj.dx,
            obj.dy,
            origin=obj.origin,
            metadata=obj.metadata,
            history=history,
        )
    outside = 0 if placed.form.is_everywhere else points.n_valid - n
    notes = [*freedoms.notes, *points.notes]
    if robust is not None:
        good = spread(residual.ravel())
        notes.append(
            f"{robust} weights: the good points spread by {format_length(good)}, the RMS is that "
            "of all points"
        )
    if outside:
        notes.append(
            f"{outside} of {points.n_valid} valid points lie outside the domain of the "
            f"{placed.form.name} and are omitted"
        )
    return FitResult(
        form=placed.form,
        params=params,
        names=names,
        white=answer.cov,
        residual=left,
        rms=rms,
        n_points=n,
        centre=points.centre,
        placement=placed,
        units={**RIGID, **placed.form.units_of(), **dict.fromkeys(bent, "1/m")},
        found_warnings=(
            *freedoms.warnings,
            *fit_warnings(points, placed, names, answer.cov, rms),
        ),
        notes=tuple(notes),
        n_iterations=n_iterations,
        robust=robust,
        source=obj,
    )


def _left(answer: Answer, z: FloatArray) -> tuple[FloatArray, float]:
    """Return what the form leaves and its RMS: zeros where that is rounding of the heights."""
    residual, rms = answer.residual, float(np.sqrt(answer.squares / answer.n))
    size = max(abs(float(of.reduce(z, axis=None))) for of in (np.fmin, np.fmax))
    size = max(size, LEAST)  # what a form leaves of zeros is 1e-120
    if without_rounding(rms, size) == 0.0:
        most = max(abs(float(of.reduce(residual, axis=None))) for of in (np.fmin, np.fmax))
        if without_rounding(most, size) == 0.0:
            return np.where(np.isnan(residual), np.nan, 0.0), 0.0
    return residual, rms


# ---- what a fit should tell its user: freedoms that hang together, periods, a tilt that is not a plane ----

_STRONG = 0.99
"""Correlation above which two parameters are hardly told apart."""
_LEAST_TILT = 1e-12
"""m, of the difference between a plane and a turned form: no instrument measures less."""

_TILT_SHARE = 0.1
"""Of the residual: a tilt whose kind matters more than this is named."""


def fit_warnings(
    points: Points, placed: Placement, names: Sequence[str], cov: FloatArray, rms: float
) -> tuple[str, ...]:
    """Return the warnings of a fit, one sentence each."""
    found = [*_tied(names, cov), *_periods(placed, names), *_kind_of_tilt(points, placed, rms)]
    return tuple(found)


def _tied(names: Sequence[str], cov: FloatArray) -> list[str]:
    sd = np.sqrt(np.diag(cov))
    if not sd.size or not np.isfinite(sd).all() or not (sd > 0.0).all():
        return []
    r = cov / np.outer(sd, sd)
    pairs = [
        (abs(r[i, j]), f"{names[i]} and {names[j]} are strongly correlated ({r[i, j]:+.4f})")
        for i in range(len(names))
        for j in range(i)
        if abs(r[i, j]) > _STRONG
    ]
    pairs.sort(key=lambda pair: -pair[0])
    return [
        f"{text}: these data cannot distinguish them well; hold one of them if its value is known"
        for _, text in pairs[:5]
    ]


def _periods(placed: Placement, names: Sequence[str]) -> list[str]:
    period = placed.form.period
    if period is None:
        return []
    return [
        f"{name} is known only up to whole periods of {format_length(period[axis])}"
        for axis, name in enumerate(("shift_x", "shift_y"))
        if name in names
    ]


def _kind_of_tilt(points: Points, placed: Placement, rms: float) -> list[str]:
    """Warn where turning the form and adding a plane differ by more than the residual tells."""
    tx, ty = placed.get("tilt_x"), placed.get("tilt_y")
    if placed.tilt == "rotation" or not (tx or ty):
        return []
    x, y, _ = points.sample(1000)
    sx, sy = x - placed.get("shift_x"), y - placed.get("shift_y")
    height = placed.form.height(sx, sy)
    gx, gy = placed.form.slopes(sx, sy)
    difference = (tx * gx + ty * gy) * height
    difference = difference[~np.isnan(difference)]
    if difference.size == 0:
        return []
    largest = float(np.ptp(difference))
    if largest <= max(_TILT_SHARE * rms, _LEAST_TILT):
        return []
    return [
        (
            f"a tilt of {np.hypot(tx, ty) * 1e3:.3g} mrad was taken as a plane; a part that is really "
            f"tilted differs from that by up to {format_length(largest)} (looks like coma): "
            "use tilt='rotation' for it"
        )
    ]

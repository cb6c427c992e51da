"""The sum model of a plane fitted to measured maps, and the coupling it cannot describe.

``z(x, y) = piston + f(x) + g(y) + beta x + alpha y`` by least squares over the measured points;
f and g without mean and line. What remains is noise plus coupling of x and y. The F test asks
whether it is more than noise. Error = actual - nominal; rows grow with y, columns with x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface

__all__ = ["Interaction", "PlaneFit", "fit_plane_model"]

FloatArray = NDArray[np.float64]

_DEGREE = 2
"""Degrees in x and in y of the smooth coupling that a single map is tested for."""

_LEVEL = 0.05
"""Probability below which coupling counts as found."""


@dataclass(frozen=True, slots=True)
class Interaction:
    """How much of a map is neither f(x) nor g(y), and whether that is more than noise.

    Parameters
    ----------
    share : float
        Part of the variance of the map about its plane that the sum model does not describe,
        0 to 1, noise included.
    rms : float, m
        RMS of the coupling, the expected share of the noise taken off; 0 where noise explains all.
    f, p : float
        F statistic and the probability of a larger one without coupling.
    dof : tuple of (float, float)
        Degrees of freedom of coupling and noise.
    noise_from : str
        ``"repeats"``, ``"u_reading"``, or ``"residual of smooth terms"`` where only smooth
        coupling is tested, because one map cannot tell rough coupling from noise.
    """

    share: float
    rms: float
    f: float
    p: float
    dof: tuple[float, float]
    noise_from: str


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """Sum model of a plane and what it leaves.

    Parameters
    ----------
    along_x, along_y : Profile, m
        f(x) and g(y), mean and line removed; NaN where a column or row was not measured.
    u_x, u_y : Profile, m
        Their standard uncertainties.
    alpha, beta : Quantity, rad
        Slopes along y and along x.
    model, residual : Surface, m
        Sum of all terms; map minus model (mean of the repeats).
    interaction : Interaction
        Coupling of x and y.
    noise : Quantity, m
        Standard deviation of one reading.
    audit : mapping
        What was done.
    messages : tuple of str
        What the user should know.
    """

    along_x: Profile
    along_y: Profile
    u_x: Profile
    u_y: Profile
    alpha: Quantity
    beta: Quantity
    model: Surface
    residual: Surface
    interaction: Interaction
    noise: Quantity
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "audit", freeze_mapping(self.audit))


def fit_plane_model(
    maps: Surface | ArrayLike,
    *,
    dx: float | None = None,
    dy: float | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
    u_reading: float | None = None,
) -> PlaneFit:
    """Return the two axis errors that a map of a plane consists of, and its coupling.

    Parameters
    ----------
    maps : Surface, list of Surface, or array_like, shape (n_y, n_x) or (n_repeats, n_y, n_x), m
        Error of the plane; NaN where not measured. Lines on a grid are a map with NaN between.
    dx, dy : float, m, optional
        Steps, for plain arrays.
    origin : tuple of (float, float), m, optional
        Position of the first sample, for plain arrays.
    u_reading : float, m, optional
        Standard uncertainty of one reading, where there are no repeats.

    Returns
    -------
    PlaneFit
        f, g, slopes, residual, `interaction`.

    Raises
    ------
    DataError
        If maps differ in shape or steps, or the steps are missing.
    NotSeparableError
        If the measured rows and columns fall into groups that share no point.
    TooFewSamplesError
        If fewer than 3 rows or columns are measured, or no point is left to test.

    Notes
    -----
    Repeats must share one zero: take the mean off each map first if each has its own.
    Noise comes from the repeats (pure error); else from `u_reading` (infinite degrees of freedom);
    else the smooth coupling ``P_i(x) P_j(y)``, i, j = 1, 2, is tested against the rest of the
    residual. Null space: piston of f against g (both are free of mean); the split of a rigid tilt
    between axes and artefact.

    References
    ----------
    .. [1] A. Kono et al., Int. J. Mach. Tools Manuf. 48 (2008), eq. 3.
    .. [2] H. Scheffe, The Analysis of Variance, 1959, ch. 4: two-way layout with interaction.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> x, y = np.arange(10.0) - 4.5, np.arange(8.0) - 3.5
    >>> z = 1e-9 * (x**2 + y[:, np.newaxis] ** 3 + rng.standard_normal((3, 8, 10)))
    >>> fit = fit_plane_model(z, dx=1e-3, dy=1e-3)
    >>> fit.interaction.p > 0.05
    True
    """
    stack, step_x, step_y, corner, history = _stack(maps, dx, dy, origin)
    count = (~np.isnan(stack)).sum(axis=0)
    rows, columns = count.any(axis=1), count.any(axis=0)
    if rows.sum() < 3 or columns.sum() < 3:
        raise TooFewSamplesError(
            f"the map has {int(rows.sum())} measured rows and {int(columns.sum())} columns; the "
            "sum model needs at least 3 of each"
        )
    mean = np.divide(
        np.nansum(stack, axis=0), count, out=np.full(count.shape, np.nan), where=count > 0
    )
    inner = np.ix_(rows, columns)
    x = corner[0] + step_x * np.arange(count.shape[1])
    y = corner[1] + step_y * np.arange(count.shape[0])
    with one_blas_thread():
        g, f, inverse = _two_way(mean[inner], count[inner])
    model = g[:, np.newaxis] + f
    residual = mean[inner] - model
    test, noise = _interaction(stack[:, *inner], mean[inner], count[inner], residual, u_reading)
    scale = noise.value
    n_y = g.size
    parts = [
        _lined(f, inverse[n_y:, n_y:], x, columns, scale),
        _lined(g, inverse[:n_y, :n_y], y, rows, scale),
    ]
    full = np.full(count.shape, np.nan)
    full[inner] = model
    left = np.full(count.shape, np.nan)
    left[inner] = residual
    history = (*history, Step("fit_plane_model", {"n_repeats": int(stack.shape[0])}))
    surfaces = [Surface(m, step_x, step_y, origin=corner, history=history) for m in (full, left)]
    slopes = [
        Quantity(
            part[2], "rad", f"slope of the plane along {axis}, least squares", u=part[3], symbol=s
        )
        for part, axis, s in zip(parts, "xy", ("beta", "alpha"), strict=True)
    ]
    return PlaneFit(
        Profile(x, parts[0][0]),
        Profile(y, parts[1][0]),
        Profile(x, parts[0][1]),
        Profile(y, parts[1][1]),
        slopes[1],
        slopes[0],
        surfaces[0],
        surfaces[1],
        test,
        noise,
        {
            "model": "piston + f(x) + g(y) + beta x + alpha y",
            "n_repeats": int(stack.shape[0]),
            "n_not_measured": int(np.isnan(stack).sum()),
            "noise_from": test.noise_from,
        },
        (
            *_words(test, noise, int((~rows).sum()), int((~columns).sum())),
            *_own_zeros(stack, mean, noise.value),
        ),
    )


def _words(test: Interaction, noise: Quantity, n_rows: int, n_columns: int) -> tuple[str, ...]:
    out = []
    where = f"F = {test.f:.3g} with {test.dof[0]:.0f} and {test.dof[1]:.0f} degrees of freedom"
    if test.p < _LEVEL:
        out.append(
            f"x and y are coupled by {test.rms * 1e9:.3g} nm RMS ({where}, p = {test.p:.2g}): a sum "
            "of two tables cannot correct this part, use a 2-D table"
        )
    else:
        out.append(f"no coupling of x and y was found ({where}, p = {test.p:.2g})")
    if test.noise_from.startswith("residual"):
        out.append(
            "one map without u_reading: only smooth coupling is tested, rough coupling counts as "
            f"noise (sd {noise.value * 1e9:.3g} nm); measure the plane twice"
        )
    if n_rows or n_columns:
        out.append(f"{n_rows} rows and {n_columns} columns were not measured: NaN there")
    return tuple(out)


def _own_zeros(stack: FloatArray, mean: FloatArray, noise: float) -> tuple[str, ...]:
    """Say if the repeats differ by more than half the noise in their zero."""
    zeros = [float(np.nanmean(z - mean)) for z in stack if not np.isnan(z).all()]
    spread = float(np.std(zeros, ddof=1)) if len(zeros) > 1 else 0.0
    if spread <= max(0.5 * noise, 1e-18):
        return ()
    text = (
        f"the repeats differ in their zero by {spread * 1e9:.3g} nm (sd), which counts as noise "
        "and hides coupling: take the mean off each map first"
    )
    return (text,)


def _stack(
    maps: Surface | ArrayLike,
    dx: float | None,
    dy: float | None,
    origin: tuple[float, float],
) -> tuple[FloatArray, float, float, tuple[float, float], tuple[Step, ...]]:
    history: tuple[Step, ...] = ()
    items: list[Surface] = (
        [maps]
        if isinstance(maps, Surface)
        else list(maps)
        if isinstance(maps, (list, tuple)) and any(isinstance(m, Surface) for m in maps)
        else []
    )
    if items:
        if not all(isinstance(m, Surface) for m in items):
            raise DataError("give all maps as surfaces or all as arrays, not mixed")
        if len({(m.shape, m.dx, m.dy, m.origin) for m in items}) > 1:
            raise DataError(
                "the maps differ in shape, steps or origin; resample them onto one grid"
            )
        if dx is not None or dy is not None:
            raise DataError("surfaces bring their own steps; leave dx and dy out")
        dx, dy, origin = items[0].dx, items[0].dy, items[0].origin
        history = tuple(s for m in items for s in m.history)
        values = np.stack([m.z for m in items])
    else:
        try:
            values = np.array(maps, dtype=np.float64)
        except (TypeError, ValueError) as exc:
            raise DataError(f"maps must be numbers of one shape in m: {exc}") from None
    if values.ndim == 2:
        values = values[np.newaxis]
    if values.ndim != 3:
        raise DataError(
            f"maps must have the shape (n_y, n_x) or (repeats, n_y, n_x), got {values.shape}"
        )
    if np.isinf(values).any():
        raise DataError("a map is infinite somewhere; write NaN where nothing was measured")
    if dx is None or dy is None or not (dx > 0.0 and dy > 0.0):
        raise DataError("the map needs positive steps dx and dy in m")
    return values, float(dx), float(dy), (float(origin[0]), float(origin[1])), history


def _two_way(z: FloatArray, count: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows' and columns' effects by weighted least squares, and the inverse of the normal matrix."""
    n_y = z.shape[0]
    weights = count.astype(np.float64)
    matrix = np.block(
        [[np.diag(weights.sum(axis=1)), weights], [weights.T, np.diag(weights.sum(axis=0))]]
    )
    filled = np.where(count > 0, z, 0.0) * weights
    right = np.concatenate([filled.sum(axis=1), filled.sum(axis=0)])
    values, vectors = np.linalg.eigh(matrix)
    free = values < 1e-9 * values[-1]
    if free.sum() > 1:
        raise NotSeparableError(
            f"the measured points fall into {int(free.sum())} groups that share no row or column; "
            "measure lines that cross them"
        )
    inverse = (vectors[:, ~free] / values[~free]) @ vectors[:, ~free].T
    solution = inverse @ right
    return solution[:n_y], solution[n_y:], inverse


def _lined(
    values: FloatArray,
    covariance: FloatArray,
    positions: FloatArray,
    used: NDArray[np.bool_],
    noise: float,
) -> tuple[FloatArray, FloatArray, float, float]:
    """Effect and its sd without mean and line, the slope and its sd."""
    at = positions[used] - positions[used].mean()
    line = np.column_stack([np.ones(at.size), at / np.abs(at).max()])
    solve = np.linalg.pinv(line)
    rest = np.eye(at.size) - line @ solve
    error, u = (np.full(positions.size, np.nan) for _ in range(2))
    error[used] = rest @ values
    spread = np.einsum("ij,jk,ik->i", rest, covariance, rest, optimize=True)
    u[used] = noise * np.sqrt(np.maximum(spread, 0.0))
    row = solve[1] / np.abs(at).max()
    return (
        error,
        u,
        float(row @ values),
        noise * math.sqrt(max(float(row @ covariance @ row), 0.0)),
    )


def _interaction(
    stack: FloatArray,
    mean: FloatArray,
    count: NDArray[np.int64],
    residual: FloatArray,
    u_reading: float | None,
) -> tuple[Interaction, Quantity]:
    from scipy import stats

    measured = count > 0
    weights = count[measured].astype(np.float64)
    left = residual[measured]
    squares = float(weights @ left**2)
    dof = int(measured.sum()) - sum(mean.shape) + 1
    if dof < 1:
        raise TooFewSamplesError(
            "every measured point is used up by f and g; measure more crossings of rows and columns"
        )
    spare = int(count.sum() - measured.sum())
    share = squares / max(_about_plane(mean, count), np.finfo(float).tiny)
    if spare:
        source, noise_dof = "repeats", float(spare)
        variance = float(np.nansum((stack - mean) ** 2)) / spare
    elif u_reading is not None:
        if not (math.isfinite(u_reading) and u_reading > 0.0):
            raise DataError(f"u_reading is {u_reading} m; it must be positive and finite")
        source, noise_dof, variance = "u_reading", math.inf, float(u_reading) ** 2
    else:
        source = "residual of smooth terms"
        squares_smooth, n_smooth = _smooth_coupling(mean, measured, left)
        noise_dof = float(dof - n_smooth)
        if noise_dof < 1:
            raise TooFewSamplesError(
                "one small map cannot tell coupling from noise; give repeats or u_reading"
            )
        variance = max(squares - squares_smooth, 0.0) / noise_dof
        squares, dof = squares_smooth, n_smooth
    f = squares / dof / variance if variance > 0.0 else (math.inf if squares > 0.0 else 0.0)
    law = stats.f if math.isfinite(noise_dof) else None
    p = float(law.sf(f, dof, noise_dof)) if law else float(stats.chi2.sf(f * dof, dof))
    rms = math.sqrt(max(squares - dof * variance, 0.0) / float(weights.sum()))
    u_noise = math.sqrt(variance / (2.0 * noise_dof)) if math.isfinite(noise_dof) else None
    noise = Quantity(
        math.sqrt(variance), "m", f"standard deviation of one reading, from {source}",
        u=u_noise, symbol="s",
    )  # fmt: skip
    return Interaction(share, rms, f, p, (float(dof), noise_dof), source), noise


def _about_plane(mean: FloatArray, count: NDArray[np.int64]) -> float:
    rows, columns = np.nonzero(count)
    root = np.sqrt(count[rows, columns])
    basis = np.column_stack([np.ones(rows.size), rows, columns]) * root[:, np.newaxis]
    z = mean[rows, columns] * root
    rest = z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]
    return float(rest @ rest)


def _smooth_coupling(
    mean: FloatArray, measured: NDArray[np.bool_], left: FloatArray
) -> tuple[float, int]:
    """Sum of squares that products of low polynomials take out of the residual, and their number."""
    from numpy.polynomial import legendre

    rows, columns = np.nonzero(measured)
    n_y, n_x = mean.shape
    p_y = legendre.legvander(2.0 * np.arange(n_y) / (n_y - 1) - 1.0, _DEGREE)[:, 1:]
    p_x = legendre.legvander(2.0 * np.arange(n_x) / (n_x - 1) - 1.0, _DEGREE)[:, 1:]
    terms = []
    for i in range(_DEGREE):
        for j in range(_DEGREE):
            product = np.where(measured, np.outer(p_y[:, i], p_x[:, j]), np.nan)
            g, f, _ = _two_way(product, measured.astype(np.int64))
            terms.append((product - g[:, np.newaxis] - f)[rows, columns])
    basis, sizes, _ = np.linalg.svd(np.column_stack(terms), full_matrices=False)
    kept = sizes > 1e-9 * sizes[0]
    taken = basis[:, kept].T @ left
    return float(taken @ taken), int(kept.sum())

"""The sum model of a plane fitted to measured maps, and the coupling it cannot describe.

``z(x, y) = piston + f(x) + g(y) + beta x + alpha y`` by least squares over the measured points;
f and g without mean and line. What remains is noise plus coupling of x and y. The F test asks
whether it is more than noise. Error = actual - nominal; rows grow with y, columns with x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import positive, real
from metrosep.core.options import Option
from metrosep.core.profile import Profile, html_table
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_engineering
from metrosep.separation._readings import (
    known_parts,
    part_of,
    real_numbers,
)
from metrosep.separation.contract import (
    U_READING,
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    StoredResult,
    Unobservable,
    settle,
)
from metrosep.separation.planes._grid_solution import PLACE, TableGrid, moved_between, repeats_of

_LEVEL = 0.05
"""Probability below which coupling counts as found."""


@dataclass(frozen=True, slots=True)
class Interaction(StoredResult):
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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneFit(StoredResult):
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

    def _rows(self) -> dict[str, str]:
        test = self.interaction
        return {
            "along x": described(self.along_x.z, self.u_x.z),
            "along y": described(self.along_y.z, self.u_y.z),
            "coupling": f"{format_engineering(test.rms, 'm')} RMS, p = {test.p:.2g}",
        }

    def __repr__(self) -> str:
        n_y, n_x = self.model.shape
        rows = "; ".join(f"{name} {text}" for name, text in self._rows().items())
        return f"PlaneFit({n_y} x {n_x} points; {rows})"

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = self._rows()
        rows.update({"alpha": str(self.alpha), "beta": str(self.beta), "noise": str(self.noise)})
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table("Sum model of a plane", rows)


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
        If maps differ in shape or steps, or steps, origin or `u_reading` are not usable.
    InvalidSamplesError
        If the maps are not real numbers.
    NotSeparableError
        If the measured rows and columns fall into groups that share no point.
    TooFewSamplesError
        If fewer than 3 rows or columns are measured, or no point is left to test.

    Notes
    -----
    Repeats must share zero and tilt: take the mean, or the plane, off each map first if each was set
    up anew; a message tells when they differ. Without its plane a map has no alpha and no beta.
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
    if u_reading is not None:
        u_reading = positive(u_reading, "u_reading", dimension="length")
    stack, step_x, step_y, corner, history = plane_stack(maps, dx, dy, origin)
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
        g, f, inverse = two_way(mean[inner], count[inner])
    model = g[:, np.newaxis] + f
    residual = mean[inner] - model
    test, noise = coupling(stack[:, *inner], mean[inner], count[inner], residual, u_reading)
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
    fitted, rest = (
        Surface(m, step_x, step_y, origin=corner, history=history) for m in (full, left)
    )
    beta, alpha = (
        Quantity(
            part[2], "rad", f"slope of the plane along {axis}, least squares", u=part[3], symbol=s
        )
        for part, axis, s in zip(parts, "xy", ("beta", "alpha"), strict=True)
    )
    return PlaneFit(
        Profile(x, parts[0][0]),
        Profile(y, parts[1][0]),
        Profile(x, parts[0][1]),
        Profile(y, parts[1][1]),
        alpha,
        beta,
        fitted,
        rest,
        test,
        noise,
        {
            "model": "piston + f(x) + g(y) + beta x + alpha y",
            "n_repeats": int(stack.shape[0]),
            "n_not_measured": int(np.isnan(stack).sum()),
            "noise_from": test.noise_from,
        },
        (
            *_messages(test, noise, int((~rows).sum()), int((~columns).sum())),
            *_own_zeros(stack, mean, noise.value),
            *_own_tilts(stack, mean),
        ),
    )


def _messages(test: Interaction, noise: Quantity, n_rows: int, n_columns: int) -> tuple[str, ...]:
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


def _own_tilts(stack: FloatArray, mean: FloatArray) -> tuple[str, ...]:
    """Say if the repeats differ in tilt by more than the rest of the noise."""
    rows, columns = np.nonzero(~np.isnan(mean))
    about = (stack - mean)[:, rows, columns]
    at = np.column_stack([np.ones(rows.size), columns - columns.mean(), rows - rows.mean()])
    share, squares, n, widest = 0.0, 0.0, 0, 0.0
    for repeat in about:
        seen = ~np.isnan(repeat)
        if seen.sum() <= at.shape[1]:
            continue
        level = repeat[seen] - repeat[seen].mean()
        tilt = at[seen] @ np.linalg.lstsq(at[seen], level, rcond=None)[0]
        share += float(tilt @ tilt)
        squares += float(level @ level)
        n += 1
        widest = max(widest, float(np.ptp(tilt)))
    dof = int((~np.isnan(about)).sum()) - rows.size - (n - 1)
    if n < 2 or not moved_between(squares, dof, share, 2 * (n - 1)) or widest < 1e-18:
        return ()
    text = (
        f"the repeats differ in tilt by up to {widest * 1e9:.3g} nm over the map, which counts as noise "
        "and hides coupling: if the plane was set up anew each time, take the plane off each map first "
        "(alpha and beta are then not known)"
    )
    return (text,)


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


# ---- coupling of x and y: what f(x) + g(y) leaves, tested against the noise ---------------------

_DEGREE = 2
"""Degrees in x and in y of the smooth coupling that a single map is tested for."""


def two_way(z: FloatArray, count: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
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


def coupling(
    stack: FloatArray,
    mean: FloatArray,
    count: NDArray[np.int64],
    residual: FloatArray,
    u_reading: float | None,
) -> tuple[Interaction, Quantity]:
    """Return what f and g leave of the plane, beside the noise, and the noise."""
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
        variance = u_reading**2
        source, noise_dof = "u_reading", math.inf
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
            g, f, _ = two_way(product, measured.astype(np.int64))
            terms.append((product - g[:, np.newaxis] - f)[rows, columns])
    basis, sizes, _ = np.linalg.svd(np.column_stack(terms), full_matrices=False)
    kept = sizes > 1e-9 * sizes[0]
    taken = basis[:, kept].T @ left
    return float(taken @ taken), int(kept.sum())


# ---- private helper: maps of a plane in any form as one stack of arrays with steps -------------


def plane_stack(
    maps: Surface | ArrayLike,
    dx: float | None,
    dy: float | None,
    origin: tuple[float, float],
) -> tuple[FloatArray, float, float, tuple[float, float], tuple[Step, ...]]:
    """Return the stack of maps with their steps, origin and history."""
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
        values = np.array(real_numbers(maps, "maps"), dtype=np.float64)
    if values.ndim == 2:
        values = values[np.newaxis]
    if values.ndim != 3:
        raise DataError(
            f"maps must have the shape (n_y, n_x) or (repeats, n_y, n_x), got {values.shape}"
        )
    if np.isinf(values).any():
        raise DataError("a map is infinite somewhere; write NaN where nothing was measured")
    step_x, step_y = plane_steps(dx, dy)
    return values, step_x, step_y, plane_origin(origin), history


def plane_steps(dx: float | None, dy: float | None) -> tuple[float, float]:
    """Return positive steps; say which is missing or no number."""
    if dx is None or dy is None:
        raise DataError("the grid needs positive steps dx and dy in m")
    return positive(dx, "dx", dimension="length"), positive(dy, "dy", dimension="length")


def plane_origin(origin: tuple[float, float]) -> tuple[float, float]:
    """Return the position (x, y) as two finite numbers."""
    try:
        x, y = (real(v, "origin", dimension="length") for v in origin)
    except (TypeError, ValueError, InvalidSamplesError):
        raise DataError(f"origin must be two finite numbers (x, y) in m, got {origin!r}") from None
    return x, y


def described(values: FloatArray, u: FloatArray) -> str:
    """Return peak to valley and typical standard uncertainty as a text."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "not determined"
    text = f"P-V {format_engineering(float(np.ptp(known)), 'm')}"
    sure = u[np.isfinite(u)]
    if not sure.size:
        return f"{text}, u not known"
    return f"{text}, u {format_engineering(float(np.sqrt(np.mean(sure**2))), 'm', digits=2)}"


# ---- `PlaneModel`: maps of an XY plane separated into the errors of its two axes (Kono 2008, eq. 3) ----
# ``z(x, y) = e(x) + e(y) + alpha (y - y0) + beta (x - x0) + coupling(x, y)``: the machine's share is
# the sum model, what it leaves is the coupling. Error = actual - nominal; rows grow with y.

_LINE = "mean and line of an axis are the piston and the tilt of the map: alpha and beta hold them"
_SUM = "what depends on x alone or on y alone is the errors of the axes by definition"
_TILT = "axis and artefact tilt alike; measure the alignment against another reference"
_UNITS = {"coupling": "m", "along_x": "m", "along_y": "m", "alpha": "rad", "beta": "rad"}


class PlaneOfTable(NamedMethod):
    """`fit_plane_model` by its name."""

    name = "fit_plane_model"
    what = "errors of the two axes of a measured plane, their alignment and their coupling"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {**PLACE, "z": "length", "repeat": "label?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "zero": Option(
            "text",
            choices=("shared", "own"),
            help="own: each repeat has a zero of its own, which is taken off first",
        ),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> PlaneFit:
        """Return the model of the plane that the rows of a table show."""
        rest, grid = dict(options), TableGrid(data)
        own = rest.pop("zero", "shared") == "own"
        maps = [grid.filled(data.values["z"], rows, what) for what, rows in repeats_of(data)]
        if own:
            maps = [m - np.nanmean(m) for m in maps]
        corner = (float(grid.x[0]), float(grid.y[0]))
        return fit_plane_model(np.array(maps), origin=corner, **grid.steps, **rest)


@dataclass(frozen=True, slots=True)
class PlaneModel(RecordedMethod):
    """Sum model of an XY plane on a grid of steps dx and dy.

    Readings (n_y, n_x) or (M, n_y, n_x) in m, or a Surface on this grid; NaN = not measured. Parts:
    ``along_x`` (n_x,) and ``along_y`` (n_y,) in m, the slopes ``alpha`` (along y) and ``beta`` (along x)
    in rad, and ``coupling`` (n_y, n_x) in m, what is neither a function of x nor of y; the F test of
    the coupling is in the audit. `fit_plane_model` does the work. The coupling has
    ``u^2 = s^2 (1/M - h)``, h the leverage of the sum model at the point:
    ``s^2 (1 - 1/n_x) (1 - 1/n_y) / M`` on a whole map. Of one map without `u_reading` smooth coupling
    alone is distinguished from noise.

    Parameters
    ----------
    dx, dy : float, m
        Steps of the columns and rows.
    origin : tuple of (float, float), m, optional
        x and y of the first sample; where alpha and beta add nothing.

    Raises
    ------
    DataError
        If a step is not positive or the origin is not a pair of finite numbers.

    Examples
    --------
    >>> method = PlaneModel(1e-3, 1e-3)
    >>> z = method.simulate({}, {"along_x": [0.0, 1e-9, 0.0], "along_y": [1e-9, 0.0, 1e-9]})
    >>> (z * 1e9).tolist()
    [[1.0, 2.0, 1.0], [0.0, 1.0, 0.0], [1.0, 2.0, 1.0]]
    """

    dx: float
    dy: float
    origin: tuple[float, float] = (0.0, 0.0)

    name = "plane_model"
    truth_parts = ("coupling",)
    error_parts = ("along_x", "along_y", "alpha", "beta")

    def __post_init__(self) -> None:
        dx, dy = plane_steps(self.dx, self.dy)
        settle(self, dx=dx, dy=dy, origin=plane_origin(self.origin))

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        shape = _shape(parts)
        x, y = self.dx * np.arange(shape[1]), self.dy * np.arange(shape[0])
        slope_x, slope_y = (part_of(parts, n, (), self.name) for n in ("beta", "alpha"))
        along_x = part_of(parts, "along_x", shape[1:], self.name) + slope_x * x
        along_y = part_of(parts, "along_y", shape[:1], self.name) + slope_y * y
        coupling = part_of(parts, "coupling", shape, self.name)
        return np.asarray(coupling + along_x + along_y[:, np.newaxis])

    def null_space(self) -> tuple[Unobservable, ...]:
        return (
            Unobservable("along_x", "polynomial", (0, 1), _LINE),
            Unobservable("along_y", "polynomial", (0, 1), _LINE),
            Unobservable("coupling", "term", ("functions of x", "functions of y"), _SUM),
            Unobservable("alpha", "term", ("tilt of the artefact along y",), _TILT),
            Unobservable("beta", "term", ("tilt of the artefact along x",), _TILT),
        )

    def _solved(
        self, readings: ArrayLike | Surface, stated: float | None, history: History
    ) -> Separation:
        if isinstance(readings, Surface):
            grid = (readings.dx, readings.dy, tuple(readings.origin))
            if grid != (self.dx, self.dy, tuple(self.origin)):
                raise DataError(
                    f"{self.name}: the surface has steps and origin {grid}, the method "
                    f"{(self.dx, self.dy, self.origin)}; resample it or set the method up for it"
                )
            history = (*readings.history, *history)
            readings = readings.z
        fit = fit_plane_model(
            readings, dx=self.dx, dy=self.dy, origin=self.origin, u_reading=stated
        )
        stack = plane_stack(readings, self.dx, self.dy, self.origin)[0]
        return self._result(fit, _left_share((~np.isnan(stack)).sum(axis=0)), history)

    def _result(self, fit: PlaneFit, share: FloatArray, history: tuple[Step, ...]) -> Separation:
        test = fit.interaction
        parts = {
            "coupling": fit.residual.z,
            "along_x": fit.along_x.z,
            "along_y": fit.along_y.z,
            "alpha": np.array(fit.alpha.value),
            "beta": np.array(fit.beta.value),
        }
        u = {
            "coupling": fit.noise.value * np.sqrt(share),
            "along_x": fit.u_x.z,
            "along_y": fit.u_y.z,
            "alpha": np.array(fit.alpha.u),
            "beta": np.array(fit.beta.u),
        }
        return Separation(
            self.name,
            parts,
            u,
            _UNITS,
            {"x": fit.along_x.x, "y": fit.along_y.x},
            self.null_space(),
            noise=fit.noise,
            audit={
                **fit.audit,
                "coupling_rms_nm": test.rms * 1e9,
                "coupling_f": test.f,
                "coupling_p": test.p,
                "degrees_of_freedom": [d if math.isfinite(d) else None for d in test.dof],
            },
            messages=fit.messages,
            history=(*history, Step(self.name, {"dx_m": self.dx, "dy_m": self.dy})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the map as it is: repeats of maps are in front."""
        return model


def _shape(parts: Mapping[str, FloatArray]) -> tuple[int, int]:
    """Return rows and columns as the parts tell them."""
    if "coupling" in parts and parts["coupling"].ndim == 2:
        n_y, n_x = parts["coupling"].shape
        return n_y, n_x
    if "along_x" in parts and "along_y" in parts:
        return parts["along_y"].size, parts["along_x"].size
    raise DataError(
        "plane_model: a map needs the coupling, shape (n_y, n_x), or both along_x and along_y; give "
        "the missing one as zeros"
    )


def _left_share(count: NDArray[np.int64]) -> FloatArray:
    """Return the share of a unit variance that the sum model leaves at each point."""
    rows, columns = count.any(axis=1), count.any(axis=0)
    inner = np.ix_(rows, columns)
    with one_blas_thread():
        inverse = two_way(np.zeros(count[inner].shape), count[inner])[2]
    n_y = int(rows.sum())
    own = np.diag(inverse)
    lever = own[:n_y, np.newaxis] + own[n_y:] + 2.0 * inverse[:n_y, n_y:]
    share = np.full(count.shape, np.nan)
    with np.errstate(divide="ignore"):
        share[inner] = np.maximum(1.0 / count[inner] - lever, 0.0)
    share[count == 0] = np.nan
    return share

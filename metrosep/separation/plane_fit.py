"""The sum model of a plane fitted to measured maps, and the coupling it cannot describe.

``z(x, y) = piston + f(x) + g(y) + beta x + alpha y`` by least squares over the measured points;
f and g without mean and line. What remains is noise plus coupling of x and y. The F test asks
whether it is more than noise. Error = actual - nominal; rows grow with y, columns with x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import TooFewSamplesError
from metrosep.core.profile import Profile, html_table
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_engineering
from metrosep.separation._grid_solution import moved_between
from metrosep.separation._plane_coupling import Interaction, coupling, two_way
from metrosep.separation._plane_input import described, plane_stack
from metrosep.separation._result_values import plain, reduced

__all__ = ["Interaction", "PlaneFit", "fit_plane_model"]


_LEVEL = 0.05
"""Probability below which coupling counts as found."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
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

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            One key for each field; profiles as ``x``, ``z``; surfaces with steps and origin.
        """
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        found["interaction"] = asdict(self.interaction)
        return {name: plain(value) for name, value in found.items()}

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
            *_own_tilts(stack, mean),
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

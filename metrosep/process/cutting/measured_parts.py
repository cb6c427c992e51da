"""What a measured part tells: how much of each cause of a budget it shows, and how the tool stands.

Errors are actual minus nominal along z. specs/cutting-path.md, section 10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.core.units import format_ends, format_length
from metrosep.forms.base import Form
from metrosep.forms.points import points_of
from metrosep.process._plain import Frozen
from metrosep.process._setting_equations import FACTORS, known_form
from metrosep.process.cutting.budgets import TINY, CutBudget
from metrosep.process.cutting.edge_errors import edge_error
from metrosep.process.nose import RoundNose, Sense
from metrosep.process.tool_settings import ToolSetting

_NEAR, _HALF = 0.05, 0.5
"""Of an amount: what certificates and maps of first order are known to; of the variance of a part."""
_LARGEST_GAP = math.radians(60.0)
"""Azimuth without a point, from which a ring is not measured round its axis."""


@dataclass(frozen=True, slots=True, eq=False)
class CauseFit(Frozen):
    """How much of each cause of a budget a measured part shows.

    Parameters
    ----------
    amounts : mapping of str to float
        By cause: 1 where the part shows the map as it was predicted, 0 where it shows none of it; NaN
        where the map is lost in piston and tilt.
    u : mapping of str to float
        Standard uncertainties, from the scatter about the fit.
    correlation : ndarray, shape (k, k)
        Of the amounts that are known, in their order.
    explained : float
        Share of the variance of the part, without piston and tilt, that the maps explain.
    residual : float, m
        RMS of what they do not, cusps and noise included.
    messages : tuple of str
        What to know.
    """

    amounts: Mapping[str, float]
    u: Mapping[str, float]
    correlation: FloatArray
    explained: float
    residual: float
    messages: tuple[str, ...] = ()

    @property
    def unlikely(self) -> tuple[str, ...]:
        """Causes whose amount is neither 0 nor 1, by more than U (k = 2) and 0.05."""
        return tuple(
            name
            for name, a in self.amounts.items()
            if min(abs(a), abs(a - 1.0)) > max(2.0 * self.u[name], _NEAR)
        )

    def shows(self, name: str) -> bool:
        """Return whether a cause is there as predicted, or nothing tells of it.

        Parameters
        ----------
        name : str
            Of the cause.

        Returns
        -------
        bool
            False where the amount is off 1 by more than U (k = 2) and 0.05.

        Raises
        ------
        DataError
            If no cause has that name.
        """
        numbers.choice(name, "cause", tuple(self.amounts))
        return not abs(self.amounts[name] - 1.0) > max(2.0 * self.u[name], _NEAR)

    @property
    def is_plausible(self) -> bool:
        """Whether each cause is there or not there, and together they explain half of the variance."""
        return not self.unlikely and not self.explained < _HALF


def fit_causes(found: CutBudget, error: ArrayLike, x: ArrayLike, y: ArrayLike) -> CauseFit:
    """Return how much of each cause of a budget a measured part shows.

    Parameters
    ----------
    found : CutBudget
        At the places of the part.
    error : array_like, shape (n,), m
        Measured minus nominal at these places; NaN is not measured.
    x, y : array_like, shape (n,), m
        The places.

    Returns
    -------
    CauseFit
        Amounts with their uncertainties, beside piston and two tilts.

    Raises
    ------
    DataError
        If lengths differ.
    TooFewSamplesError
        If there are fewer than three places for each cause.
    DegenerateFitError
        If two maps are the same on this part.

    Notes
    -----
    Least squares of the error on the maps, piston and tilts, without the cusps of the full cut where that
    leaves less: a map that resolves them may sample them in step with its pixels. The uncertainties take what is left for
    independent from place to place: draw places further apart than waves and cusps are long.
    """
    causes = found.budget.contributions
    z = np.asarray(error, dtype=np.float64)
    if any(c.map is None or c.map.shape != z.shape for c in causes):
        raise DataError(f"the part has {z.size} places; the budget must be at the same ones")
    maps = np.array([c.map for c in causes], dtype=np.float64)
    on = np.isfinite(z) & np.isfinite(maps).all(axis=0)
    if int(on.sum()) < 3 * (len(causes) + 3):
        raise TooFewSamplesError(
            f"{int(on.sum())} places for {len(causes)} causes, piston and tilt: measure more"
        )
    at = np.stack([np.asarray(v, dtype=np.float64)[on] for v in (x, y)], axis=1)
    size = float(np.abs(at).max())
    plane = np.column_stack([np.ones(at.shape[0]), at / size])

    def flat(v: FloatArray) -> FloatArray:
        return np.asarray(v - plane @ np.linalg.lstsq(plane, v, rcond=None)[0])

    columns = np.stack([flat(m[on]) for m in maps], axis=1)
    rms = np.sqrt(np.mean(columns**2, axis=0))
    seen = np.flatnonzero(rms > TINY)
    amounts, u = ({c.name: math.nan for c in causes} for _ in range(2))
    said = [
        f"{causes[i].name} is lost in piston and tilt on this part: nothing tells how much of it there is"
        for i in range(len(causes))
        if i not in seen
    ]
    # where the map resolves the cusps of the feed they are taken off: they are no form, and not random
    marks = flat(np.where(np.isfinite(found.mean), found.full.error - found.mean, 0.0)[on])
    bare, rest, correlation = flat(z[on]), flat(z[on]), np.empty((0, 0))
    if seen.size:
        matrix = columns[:, seen] / rms[seen]
        _, sizes_of, mixed = np.linalg.svd(matrix, full_matrices=False)
        if sizes_of[-1] * 1e7 < sizes_of[0]:
            same = [
                causes[i].name for i, v in zip(seen, np.abs(mixed[-1]), strict=True) if v > 0.1
            ]
            raise DegenerateFitError(
                f"{' and '.join(same)} leave the same map on this part, or one that the others make up: leave "
                "one of them out of the budget"
            )
        tried = []
        for target in (bare, bare - marks):
            solved, *_ = np.linalg.lstsq(matrix, target, rcond=None)
            tried.append((target, solved, target - matrix @ solved))
        resolved = bool(tried[1][2] @ tried[1][2] < tried[0][2] @ tried[0][2])
        bare, solved, rest = tried[int(resolved)]
        if resolved:
            said.append("the map shows the cusps of the feed; they were taken off before the fit")
        inverse = np.linalg.inv(matrix.T @ matrix)
        cov = inverse * float(rest @ rest) / max(1, bare.size - seen.size - 3)
        sizes = np.sqrt(np.diag(cov))
        correlation = inverse / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
        for k, i in enumerate(seen.tolist()):
            amounts[causes[i].name] = float(solved[k] / rms[i])
            u[causes[i].name] = float(sizes[k] / rms[i])
        pairs = _alike([causes[i].name for i in seen], correlation)
        if pairs:
            said.append(f"hard to distinguish on this part: {', '.join(pairs)}")
    explained = 1.0 - float(rest @ rest) / float(bare @ bare) if bare.any() else math.nan
    fit = CauseFit(amounts, u, correlation, explained, float(np.sqrt(np.mean(rest**2))))
    if fit.unlikely:
        shown = ", ".join(f"{amounts[n]:.3g} (u {u[n]:.2g}) of {n}" for n in fit.unlikely)
        said.append(
            f"the part shows {shown}, where 1 is all of it and 0 none: a sign, centre or orientation of the map, "
            "or a cause that is not in the budget"
        )
    if explained < _HALF:
        said.append(
            f"the causes explain {100.0 * explained:.3g} % of the variance of the part: the amounts say little. "
            "Look at what is left, and at centre and orientation of the map"
        )
    return replace(fit, messages=tuple(said))


def _alike(names: Sequence[str], correlation: FloatArray) -> list[str]:
    """Return the pairs of names that a part can hardly distinguish, with their correlation."""
    return [
        f"{a} and {b} ({correlation[i, j]:.3f})"
        for i, a in enumerate(names)
        for j, b in enumerate(names[:i])
        if abs(correlation[i, j]) > _ALIKE
    ]


# ---- a measured part tells which errors of tool and setting explain it --------------------------

_PLANE = ("piston", "tilt_x", "tilt_y")
_TOOL: Mapping[str, float] = {"dx": 1e-7, "dy": 1e-7, "dR": 1e-6, "yaw": 1e-4, "rake": 1e-4}
"""What can be free, with the step of its derivative: m or rad."""
_LARGEST = {"dx": 1e-3, "dy": 1e-3, "dR": 1e-3, "yaw": 0.3, "rake": 0.3}
_STEPS, _SETTLED = 12, 1e-4
"""Gauss-Newton steps; of the standard uncertainties, by which the last one may move."""
_ALIKE = 0.98
_NO_EFFECT = 1e-10
"""m: what the largest value of a free one changes is rounding below that."""
_MOST_POINTS = 1500


@dataclass(frozen=True, slots=True, eq=False)
class EdgeFit(Frozen):
    """Errors of tool and setting that explain a measured part.

    Parameters
    ----------
    values : mapping of str to float, m or rad
        Of what was free.
    u : mapping of str to float, m or rad
        Standard uncertainties, from the scatter about the fit.
    correlation : ndarray, shape (k, k)
        In the order of `values`.
    setting : ToolSetting
        dx, dy and dR with their covariance.
    nose : RoundNose
        The tool as it cuts: with the yaw and rake that were found.
    residual : float, m
        RMS of what is not explained, cusps and noise included.
    explained : float
        Share of the variance of the part, without piston and tilt, that the tool explains.
    messages : tuple of str
        What to know.
    """

    values: Mapping[str, float]
    u: Mapping[str, float]
    correlation: FloatArray
    setting: ToolSetting
    nose: RoundNose
    residual: float
    explained: float
    messages: tuple[str, ...] = field(default=())


def identify_edge(
    measured: Surface,
    form: Form,
    *,
    nose: RoundNose,
    sense: Sense | None = None,
    free: Sequence[str] = ("piston", "tilt_x", "tilt_y", "dx", "dy", "dR"),
    region: tuple[float, float] | None = None,
    centre: tuple[float, float] | None = None,
    points: int = _MOST_POINTS,
    seed: int = 0,
) -> EdgeFit:
    """Return the errors of tool and setting that explain a measured part, edge and rake as they are.

    Parameters
    ----------
    measured : Surface
        Heights of the part as it was cut.
    form : Form
        The surface wanted.
    nose : RoundNose
        What the program was made for.
    sense : {"counterclockwise", "clockwise"}, optional
        How the tool went round the part, seen from above; needed with rake, yaw or dy.
    free : sequence of str, optional
        Of piston, tilt_x, tilt_y, dx, dy, dR, yaw and rake.
    region : tuple of (float, float), m, optional
        Inner and outer radius of the points that count.
    centre : tuple of (float, float), m, optional
        Where the spindle axis is in the coordinates of the map; if omitted at x = y = 0, of a map that
        declares no origin in the middle of what was measured.
    points : int, optional
        How many at most, drawn from the valid ones.
    seed : int, optional
        Of the draw.

    Returns
    -------
    EdgeFit
        Values, uncertainties, the setting and the tool to make a path for.

    Raises
    ------
    DataError
        If a name is not known or nothing of the tool is free, the map does not go round the axis and no
        centre is given, or as of `edge_error`.
    TooFewSamplesError
        If there are fewer points than free values.
    DegenerateFitError
        If two free values do the same to this part.

    Notes
    -----
    Gauss-Newton on `edge_error` with derivatives by differences. A shift of the map and dx look alike on
    many parts: the axis must be where the map says.

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> torus, nose = Toric(Rb=110e-3, Rd=70e-3), RoundNose(0.6e-3)
    >>> y, x = np.mgrid[-2e-3:2e-3:25j, -2e-3:2e-3:25j]
    >>> e = edge_error(torus, x, y, nose=nose, setting=ToolSetting(dx=2e-6), sense="clockwise")
    >>> part = Surface(torus(x, y) + e, dx=4e-3 / 24, dy=4e-3 / 24, origin=(-2e-3, -2e-3))
    >>> found = identify_edge(part, torus, nose=nose, sense="clockwise", region=(0.2e-3, 2e-3))
    >>> round(found.values["dx"] * 1e6, 6)
    2.0
    """
    form = known_form(form)
    names = [numbers.choice(n, "free", (*_PLANE, *_TOOL)) for n in free]
    tool = [n for n in names if n in _TOOL]
    if not tool or len(set(names)) < len(names):
        raise DataError(
            f"free must name values of the tool, each once: {', '.join(_TOOL)}; got {list(free)}"
        )
    if sense is None and ("dy" in tool or "yaw" in tool):
        raise DataError(
            'dy and yaw are free: give sense="counterclockwise" or sense="clockwise" (how the tool went '
            "round the part, seen from above)"
        )
    x, y, z, notes = drawn_points(measured, region, points, seed, centre)
    if x.size < 3 * len(names):
        raise TooFewSamplesError(
            f"{x.size} points for {len(names)} free values: measure more, or free less"
        )
    error = z - form(x, y)
    defined = np.isfinite(error)
    x, y, error = x[defined], y[defined], error[defined]
    size = float(np.hypot(x, y).max())
    plane = {"piston": np.ones(x.size), "tilt_x": x / size, "tilt_y": y / size}

    def modelled(at: Mapping[str, float]) -> FloatArray:
        dx, dy, dR = (at.get(n, 0.0) for n in FACTORS)
        setting, actual = ToolSetting(dx, dy, dR), _turned(nose, at)
        return edge_error(form, x, y, nose=nose, actual=actual, setting=setting, sense=sense)

    values = dict.fromkeys(tool, 0.0)
    solved, cov, rest = _solved(names, values, plane, modelled, error)
    left = [plane[n] for n in names if n in plane]
    bare = (
        error - np.linalg.lstsq(np.stack(left, 1), error, rcond=None)[0] @ left if left else error
    )
    explained = 1.0 - float(np.var(rest) / np.var(bare)) if np.var(bare) > 0.0 else math.nan
    sizes = np.sqrt(np.diag(cov))
    correlation = cov / np.outer(sizes, sizes)
    u = dict(zip(names, sizes.tolist(), strict=True))
    for n in ("tilt_x", "tilt_y"):
        if n in solved:
            solved[n], u[n] = solved[n] / size, u[n] / size
    known: Any = {n: solved.get(n, 0.0) for n in FACTORS}
    setting = ToolSetting(**known, **{f"u_{n}": u.get(n, 0.0) for n in FACTORS})
    said = [*notes]
    pairs = _alike(names, correlation)
    if pairs:
        said.append(f"can hardly be distinguished on this part: {', '.join(pairs)}")
    return EdgeFit(
        {n: float(solved[n]) for n in names}, u, correlation, setting, _turned(nose, solved),
        float(np.sqrt(np.mean(rest**2))), explained, tuple(said),
    )  # fmt: skip


def _turned(nose: RoundNose, at: Mapping[str, float]) -> RoundNose:
    """Return a nose with the yaw and rake of the values added to its own."""
    return replace(nose, yaw=nose.yaw + at.get("yaw", 0.0), rake=nose.rake + at.get("rake", 0.0))


def drawn_points(
    measured: Surface,
    region: tuple[float, float] | None,
    points: int,
    seed: int,
    centre: tuple[float, float] | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[str, ...]]:
    """Return positions and heights of measured points within a ring, and where its axis was taken."""
    found = points_of(measured, centre=centre, middle=True)
    columns = [np.concatenate(v) for v in zip(*found.valid_blocks(), strict=True)]
    x, y, z = columns
    rho = np.hypot(x, y)
    low, high = (0.0, math.inf) if region is None else region
    inside = np.flatnonzero((rho >= low) & (rho <= high))
    around = np.sort(np.arctan2(y[inside], x[inside]))
    gap = float(np.diff(around, append=around[:1] + 2.0 * np.pi).max(initial=0.0))
    if centre is None and (not inside.size or gap > _LARGEST_GAP):
        a, b = (format_length(v) for v in found.centre)
        part = f"a gap of {math.degrees(gap):.3g} degrees" if inside.size else "no point"
        raise DataError(
            f"the map has {part} in the ring that the program cuts about the axis, x = {a}, y = {b}, from "
            f"{format_ends(low, high, between=' to ')}: give the place of the spindle axis on the map, "
            "centre, or measure all round; a list of points that was cut short leaves such a ring too"
            if math.isfinite(high)
            else f"the map has {part} about the axis, x = {a}, y = {b}: give the place of the spindle axis "
            "on the map, centre, or measure all round"
        )
    most = numbers.count(points, "points", least=10)
    if inside.size > most:
        inside = np.sort(np.random.default_rng(seed).choice(inside, most, replace=False))
    return x[inside], y[inside], z[inside], found.notes


def _solved(
    names: Sequence[str],
    values: dict[str, float],
    plane: Mapping[str, FloatArray],
    modelled: Callable[[Mapping[str, float]], FloatArray],
    error: FloatArray,
) -> tuple[dict[str, float], FloatArray, FloatArray]:
    """Return values of all names, their covariance, and what is left."""
    solved = dict.fromkeys(names, 0.0)
    cov, rest = np.empty((0, 0)), error
    for _ in range(_STEPS):
        here = modelled(values)
        columns = []
        for n in names:
            if n in plane:
                columns.append(plane[n])
                continue
            h = _TOOL[n]
            columns.append(
                (modelled({**values, n: values[n] + h}) - modelled({**values, n: values[n] - h}))
                / (2 * h)
            )
        matrix = np.stack(columns, axis=1)
        norm = np.linalg.norm(matrix, axis=0)
        for n, column in zip(names, columns, strict=True):
            if n in _TOOL and float(np.abs(column).max()) * _LARGEST[n] < _NO_EFFECT:
                raise DegenerateFitError(
                    f"{n} changes nothing on this part: leave it out of free, or measure a part without "
                    "symmetry"
                )
        if np.linalg.cond(matrix / norm) > 1e7:
            raise DegenerateFitError(
                f"this part does not tell all of {', '.join(names)} apart: free fewer of them, or measure a part "
                "without symmetry"
            )
        target = error - here
        step, *_ = np.linalg.lstsq(matrix / norm, target, rcond=None)
        change = step / norm
        rest = target - matrix @ change
        variance = float(rest @ rest) / max(1, error.size - len(names))
        cov = variance * np.linalg.inv((matrix / norm).T @ (matrix / norm)) / np.outer(norm, norm)
        moved = 0.0
        for n, delta, u in zip(
            names, change.tolist(), np.sqrt(np.diag(cov)).tolist(), strict=True
        ):
            if n in plane:
                solved[n] = delta
            else:
                values[n] = float(np.clip(values[n] + delta, -_LARGEST[n], _LARGEST[n]))
                moved = max(moved, abs(delta) / max(u, 1e-3 * _TOOL[n]))
        if moved < _SETTLED:
            break
    return {**solved, **values}, cov, rest

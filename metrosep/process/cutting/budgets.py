"""The error budget on the cut surface: each cause where it cuts, their sum, and the full cut beside it.

A deviation (eX, e_azimuth, eZ) of the tip at a time t acts at the contact of that moment as

    eZ - sX eX - ((X + x) sY - y sX) e_azimuth,

with the slopes there along machine x and y, and a deviation eY across the radius, towards growing
azimuth, as -sY eY. Edge and setting act as `edge_error` says. The full cut has everything in it at
once: where it contradicts the sum of the maps, trust the cut. Errors are actual minus nominal along z.
specs/cutting-path.md, equation (22) and section 10.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
)
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import Frozen, complete, frozen
from metrosep.process._setting_equations import FACTORS, known_form
from metrosep.process.cutting.edge_errors import edge_error
from metrosep.process.cutting.programs import TurningProgram
from metrosep.process.cutting.virtual_part import (
    Across,
    VirtualPart,
    heights_cut,
    part_of,
    virtual_cut,
)
from metrosep.process.nose import RoundNose, Sense
from metrosep.process.predictions import Contribution, ErrorBudget
from metrosep.process.setting_maps import positions
from metrosep.process.tips import Edge, tips
from metrosep.process.tool_settings import ToolSetting

_SHARE = 0.01
"""Of the total: a sum of maps that is off by more is not trusted."""
TINY = 2e-11
"""m: below that nothing is said."""
_PER_FEED = 24
"""Places over one feed, for a mean without cusps."""


@dataclass(frozen=True, slots=True, eq=False)
class PathDeviation(Frozen):
    """By how much the tip leaves the commanded course, from a log or a model.

    Parameters
    ----------
    t : ndarray, shape (n,), s
        Times, as of the program, growing.
    X, azimuth, Z : ndarray, shape (n,), m, rad and m
        Actual minus commanded: of the radius, of the azimuth of the tip on the part, of the height.
    Y : ndarray, shape (n,), m, optional
        Of the place across the radius, positive towards growing azimuth; the tool keeps its direction.
    u : PathDeviation, optional
        What one standard uncertainty of the deviation adds to it, at all times together; if omitted
        nobody knows it.

    Raises
    ------
    DataError
        If lengths differ.
    InvalidSamplesError
        If a value is NaN, or times do not grow.
    """

    t: FloatArray
    X: FloatArray
    azimuth: FloatArray
    Z: FloatArray
    Y: FloatArray | None = None
    u: PathDeviation | None = None

    def __post_init__(self) -> None:
        Frozen.__post_init__(self)
        if self.Y is None:
            object.__setattr__(self, "Y", frozen(np.zeros(np.size(self.t))))
        for name in ("t", "X", "azimuth", "Z", "Y"):
            complete(getattr(self, name), name, "a deviation has no gaps")
            if getattr(self, name).size != self.t.size:
                raise DataError(
                    f"{name} has {getattr(self, name).size} samples, t has {self.t.size}"
                )
        if (np.diff(self.t) <= 0.0).any():
            raise InvalidSamplesError("times of a deviation must grow")
        if self.u is not None and not isinstance(self.u, PathDeviation):
            raise DataError(f"u must be a PathDeviation, got {type(self.u).__name__}")

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the deviations of X, azimuth, Z and Y at times, linear between the samples.

        Parameters
        ----------
        t : ndarray, s
            NaN stays NaN.

        Returns
        -------
        tuple of ndarray, m, rad, m and m
            NaN outside the samples.
        """
        x, azimuth, z, y = (
            np.interp(t, self.t, v, left=math.nan, right=math.nan)
            for v in (self.X, self.azimuth, self.Z, np.asarray(self.Y))
        )
        return x, azimuth, z, y


@dataclass(frozen=True, slots=True, eq=False)
class CutBudget(Frozen):
    """Causes of form error at places of the part, their sum, and the full cut.

    Parameters
    ----------
    budget : ErrorBudget
        Maps by cause: "program" (interpolation and digits), "tool" (edge), "tool setting", and the deviations
        by their names, "follow-up" or terms of the machine.
    full : VirtualPart
        Cut with everything in it, cusps included.
    cusps : ndarray, m
        What the feed alone leaves, no form error; in the shape of the places.
    mean : ndarray, m
        Error of the full cut without cusps: over a feed on either side of each place, less what the
        cusps leave there on the mean. A setting moves the cusps; the mean does not see it.
    disagreement : float, m
        Largest difference of `mean` from the sum of the maps.
    messages : tuple of str
        What to know.
    """

    budget: ErrorBudget
    full: VirtualPart
    cusps: FloatArray
    mean: FloatArray
    disagreement: float
    messages: tuple[str, ...] = ()

    @property
    def total(self) -> FloatArray:
        """Sum of the maps, m, without cusps."""
        return np.asarray(_sum_of(self.budget.contributions))

    @property
    def cusp(self) -> float:
        """P-V of the cusps, m."""
        return float(np.nanmax(self.cusps) - np.nanmin(self.cusps))


def cut_budget(
    program: TurningProgram,
    nose: RoundNose,
    x: ArrayLike,
    y: ArrayLike = 0.0,
    *,
    form: Form,
    actual: RoundNose | None = None,
    setting: ToolSetting | None = None,
    deviation: PathDeviation | Mapping[str, PathDeviation] | None = None,
) -> CutBudget:
    """Return the error of a part cause by cause, and the full cut that checks the sum.

    Parameters
    ----------
    program : TurningProgram
        Of the tip, such as `read_program` returns: with its interpolation and its digits.
    nose : RoundNose
        What the program was made for; its measured waviness counts as an error of the tool.
    x, y : array_like, m
        Places on the part that broadcast.
    form : Form
        The surface wanted.
    actual : RoundNose, optional
        The tool that cuts, if it is not `nose`.
    setting : ToolSetting, optional
        How far it stands off; with uncertainties the map of the setting has modes.
    deviation : PathDeviation or mapping of str to PathDeviation, optional
        What the axes do beside their command, from a log of the dry run ("follow-up"); or several by their
        names, such as `machine_deviations` gives, each a cause of its own.

    Returns
    -------
    CutBudget
        Causes, sum, cusps, full cut.

    Raises
    ------
    DataError
        If the program is one of cut points, or cuts none of the places, or the log does not cover it.
    LimitError
        If an edge would cut beyond its window.

    Notes
    -----
    The map "program" is the deviation of the commanded height from the tip path at the moment that
    decides; what X and C do wrong together with it is in it, because the tip path is taken where the tip
    is. Uncertainties of the setting and of deviations are modes of first order, and not in the full cut.

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> from metrosep.process import TurningJob
    >>> torus, nose = Toric(Rb=110e-3, Rd=70e-3), RoundNose(0.6e-3)
    >>> job = TurningJob(torus, 3e-3, 10e-6, rpm=60, core=2.8e-3, nose=nose, sense="clockwise")
    >>> program = job.program(job.path(step=0.05, interpolation="linear"))
    >>> found = cut_budget(program, nose, [2.9e-3], form=torus, setting=ToolSetting(dx=1e-6))
    >>> [c.name for c in found.budget.contributions]
    ['program', 'tool setting']
    """
    form = known_form(form)
    deviations = _by_name(deviation)
    for name, moves in deviations.items():
        _require_whole(name, moves, program)
        if moves.u is not None:
            _require_whole(f"u of {name}", moves.u, program)
    xs, ys = positions(x, y)
    plain = replace(nose, edge=None)
    base = virtual_cut(program, plain, xs, ys, form=form)
    edge, sense = Edge.of(plain, program.sense), program.sense
    known = np.isfinite(base.t)
    X, azimuth, Z = (np.full(known.shape, math.nan) for _ in range(3))
    X[known], azimuth[known], Z[known] = program.at(base.t[known])
    ideal = tips(form, X[known], azimuth[known], edge, strict=True)
    off = np.full(known.shape, math.nan)
    off[known] = Z[known] - ideal.z
    causes = [Contribution("program", map=off)]
    cusps = base.error - off
    tool = actual if actual is not None else nose
    alone = _over_a_feed(program, plain, xs, ys, form, None)
    if tool != plain:
        # as the feed leaves it: waves of the edge as short as the feed are cut to their mean over it
        found = _over_a_feed(program, tool, xs, ys, form, None) - alone
        causes.append(Contribution("tool", map=np.where(known, found, math.nan)))
    said = [*base.messages]
    if setting is not None:
        causes.append(_setting(form, xs, ys, known, tool, setting, sense))
        if unknown := [n for n in FACTORS if getattr(setting, f"u_{n}") == math.inf]:
            said.append(
                f"{', '.join(unknown)} is not determined (its u is infinite): the u of the tool setting does "
                "not count it"
            )
    course, across = program, None
    if deviations:
        turn = edge.by_azimuth(X[known], ideal.psi, ideal.along_x, ideal.along_y)
        for name, moves in deviations.items():
            maps = []
            for own in (moves,) if moves.u is None else (moves, moves.u):
                eX, ea, eZ, eY = own.at(base.t[known])
                acts = np.full(known.shape, math.nan)
                acts[known] = eZ - ideal.along_x * eX - ideal.along_y * eY - turn * ea
                maps.append(acts)
            cov = None if moves.u is None else np.eye(1)
            modes = None if moves.u is None else maps[1][None]
            causes.append(Contribution(name, map=maps[0], modes=modes, cov=cov))
        course, across = _moved(program, list(deviations.values()))
    full = part_of(course, tool, xs, ys, form, setting, across)
    total = _sum_of(causes)
    with_all = _over_a_feed(course, tool, xs, ys, form, setting, across)
    mean = with_all - (alone - off)
    difference = mean - total
    both = np.isfinite(difference)
    worst = float(np.abs(difference[both]).max()) if both.any() else math.nan
    size = float(np.abs(total[both]).max()) if both.any() else math.nan
    if worst > max(_SHARE * size, TINY):
        said.append(
            f"the full cut differs from the sum of the causes by up to {format_length(worst)} of "
            f"{format_length(size)}: trust the cut"
        )
    return CutBudget(ErrorBudget(causes), full, cusps, mean, worst, tuple(said))


def _sum_of(causes: Sequence[Contribution]) -> FloatArray:
    """Return the sum of the maps; every cause here has one."""
    return np.asarray(np.sum(np.array([c.map for c in causes], dtype=np.float64), axis=0))


def _over_a_feed(
    program: TurningProgram,
    nose: RoundNose,
    x: FloatArray,
    y: FloatArray,
    form: Form,
    setting: ToolSetting | None,
    across: Across | None = None,
) -> FloatArray:
    """Return the error that is left on the mean over one feed about each place."""
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    steps = program.feed * ((np.arange(_PER_FEED) + 0.5) / _PER_FEED - 0.5)
    at = np.abs(rho + steps.reshape(-1, *(1,) * rho.ndim))
    x, y = at * np.cos(theta), at * np.sin(theta)
    # the places themselves were asked with all turns
    z, _ = heights_cut(program, nose, x.ravel(), y.ravel(), setting, across)
    return np.asarray((z.reshape(x.shape) - form.height(x, y)).mean(axis=0))


def _setting(
    form: Form,
    x: FloatArray,
    y: FloatArray,
    known: Any,
    tool: RoundNose,
    setting: ToolSetting,
    sense: Sense,
) -> Contribution:
    """Return the error of the setting, with what its uncertainty can do."""

    def error(values: ToolSetting) -> FloatArray:
        found = np.full(known.shape, math.nan)
        found[known] = edge_error(
            form, x[known], y[known], nose=tool, actual=tool, setting=values, sense=sense
        )
        return found

    cov = setting.covariance
    sizes = np.zeros(3) if cov is None else np.sqrt(np.diag(cov))
    used = [i for i in range(3) if 0.0 < sizes[i] < math.inf]
    if cov is None or not used:
        return Contribution("tool setting", map=error(setting))
    modes = []
    for i in used:
        steps = np.zeros(3)
        steps[i] = sizes[i]
        ahead, behind = (error(ToolSetting(*setting.values + w * steps)) for w in (1.0, -1.0))
        modes.append((ahead - behind) / (2.0 * sizes[i]))
    return Contribution(
        "tool setting", map=error(setting), modes=np.stack(modes), cov=cov[np.ix_(used, used)]
    )


def _by_name(
    deviation: PathDeviation | Mapping[str, PathDeviation] | None,
) -> dict[str, PathDeviation]:
    """Return deviations by the names of their causes."""
    if deviation is None:
        return {}
    if isinstance(deviation, PathDeviation):
        return {"follow-up": deviation}
    named: Any = deviation
    if not isinstance(named, Mapping) or not all(
        isinstance(v, PathDeviation) for v in named.values()
    ):
        raise DataError("deviation must be a PathDeviation, or several of them by their names")
    if taken := set(deviation) & {"program", "tool", "tool setting"}:
        raise DataError(f"a deviation is named {min(taken)}, as another cause is: rename it")
    return dict(deviation)


def _require_whole(name: str, deviation: PathDeviation, program: TurningProgram) -> None:
    """Refuse a log that does not hold the entire program."""
    (a, b), (first, last) = ((float(v[0]), float(v[-1])) for v in (deviation.t, program.t))
    if a > first or b < last:
        share = max(0.0, min(b, last) - max(a, first)) / program.duration
        raise DataError(
            f"{name}: the log runs from {a:.6g} s to {b:.6g} s, the program from {first:.6g} s to {last:.6g} s: "
            f"the log covers {100.0 * share:.3g} % of it, and what it does not cover is not zero; its time "
            "begins with that of the program: shift it, or give a log of the whole program"
        )


def _moved(
    program: TurningProgram, deviations: Sequence[PathDeviation]
) -> tuple[TurningProgram, Across | None]:
    """Return the course of the tip with its deviations, at the times of all; and what is across the radius."""
    inside = [d.t[(d.t > program.t[0]) & (d.t < program.t[-1])] for d in deviations]
    t = np.unique(np.concatenate([program.t, *inside]))
    t = t[np.append(True, np.diff(t) > 1e-9 * program.duration / len(program))]
    X, azimuth, Z = program.at(t)
    dX, da, dZ, dY = np.sum([d.at(t) for d in deviations], axis=0)
    joined = "linear" if program.interpolation == "linear" else "spline"
    course = TurningProgram(X + dX, azimuth + da, Z + dZ, t, "tip", joined)  # type: ignore[arg-type]
    return course, ((t, dY) if dY.any() else None)

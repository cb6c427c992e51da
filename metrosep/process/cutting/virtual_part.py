"""The virtual part: the surface that an edge leaves when it runs a program, turn by turn.

    z(rho, theta) = min over turns of [ Z(t) + z(psi) ],
    azimuth(t) + atan2(y(psi), X(t) + x(psi)) = theta,  (X + x)^2 + y^2 = rho^2,

where (x, y, z) is the point of the edge that passes over the place of the part. Each place asks the
turns; nothing is drawn into pixels, so the result is exact for the course of the program.
specs/cutting-path.md, equation (17). Only geometry: no burr, elastic recovery, edge radius or wear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.units import format_ends, format_length
from metrosep.forms.base import Form
from metrosep.process._plain import Frozen
from metrosep.process._setting_equations import known_form
from metrosep.process.cutting.programs import AxisCourse, TurningProgram
from metrosep.process.nose import RoundNose
from metrosep.process.setting_maps import positions
from metrosep.process.tips import Edge, near_contacts, tips
from metrosep.process.tool_settings import ToolSetting

Across = tuple[FloatArray, FloatArray]
"""s and m: times, and how far the tip is then off the plane of its azimuth, towards a larger one."""
_TURN = 2.0 * math.pi
_BLOCK = 1 << 14
"""Places that are worked on at once, sorted by radius: the turns they ask stay in the cache."""
_COARSE, _SIDE = 9, 2
"""Turns that are tried first, and turns on either side of the best that are tried at last."""
_PASSES, _ROUGH_PASSES, _SETTLED = 12, 2, 1e-14
"""For the place on the edge; m, of y, by which another pass must move it."""
_AROUND = 90
"""Tips of a turn that tell how far its contacts reach."""
_SAMPLE, _LOWER = 1000, 1e-12
"""Places that ask all turns, and how much lower than the turns that were asked is a fault, m."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class VirtualPart(Frozen):
    """A part as it is cut; arrays in the shape of the places asked for.

    Parameters
    ----------
    rho, theta : ndarray, m and rad
        Places on the part.
    z : ndarray, m
        Height that is left; NaN where no turn cuts, or the turns do not lie on both sides.
    error : ndarray, m
        z minus the surface wanted: positive is material left. NaN where no surface is given.
    turn : ndarray
        Turns of the program from its first point to the moment that decided.
    psi : ndarray, rad
        Angle on the edge that decided, from the tip, positive outwards.
    t : ndarray, s
        When that was.
    messages : tuple of str, optional
        What to know.
    """

    rho: FloatArray
    theta: FloatArray
    z: FloatArray
    error: FloatArray
    turn: FloatArray
    psi: FloatArray
    t: FloatArray
    messages: tuple[str, ...] = ()

    def __repr__(self) -> str:
        known = self.error[np.isfinite(self.error)]
        shown = f", P-V {format_length(float(np.ptp(known)))}" if known.size else ""
        return f"VirtualPart({self.z.size} places{shown})"

    @property
    def peak_to_valley(self) -> float:
        """Largest minus smallest error, cusps included, m; NaN without one."""
        known = self.error[np.isfinite(self.error)]
        return float(np.ptp(known)) if known.size else math.nan


def virtual_cut(
    program: TurningProgram,
    nose: RoundNose,
    x: ArrayLike,
    y: ArrayLike = 0.0,
    *,
    form: Form | None = None,
    setting: ToolSetting | None = None,
) -> VirtualPart:
    """Return the part that a tool leaves when it runs a program.

    Parameters
    ----------
    program : TurningProgram
        Of the tip, with what the control does between its points.
    nose : RoundNose
        The tool that cuts: with its rake, yaw, window and waviness as they are.
    x, y : array_like, m
        Places on the part that broadcast.
    form : Form, optional
        The surface wanted, for the error.
    setting : ToolSetting, optional
        How far the tool stands off, and how much larger its radius is.

    Returns
    -------
    VirtualPart
        Height, error, and which moment and place of the edge decided.

    Raises
    ------
    DataError
        If the program is one of cut points, the nose is none, or nothing of the part is cut.
    InvalidSamplesError
        If a place is not a finite number, or they do not broadcast.
    UnitError
        If a place cannot be in metres.

    Notes
    -----
    Of all turns that may reach a place some are tried, then those beside the lowest, then two on each
    side with all digits, walking on while the lowest lies at the end. A thousand places ask all turns
    as a check; if one of them is lower anywhere, all places ask all turns. An edge does not cut beyond
    its window. A place that the first or the last turn decides is NaN: the next one would decide it.

    Examples
    --------
    >>> turn = np.arange(-12.0, 40.0, 0.05) * 2.0 * np.pi
    >>> flat = TurningProgram(1e-3 - 20e-6 * turn / (2 * np.pi), turn, 0 * turn, turn - turn[0], "tip")
    >>> cut = virtual_cut(flat, RoundNose(0.5e-3), np.linspace(0.5e-3, 0.52e-3, 401))
    >>> round(float(np.ptp(cut.z)) * 1e9, 1)  # 20 um squared over 8 times 0.5 mm
    100.0
    """
    return part_of(program, nose, x, y, form, setting, None)


def part_of(
    program: TurningProgram,
    nose: RoundNose,
    x: ArrayLike,
    y: ArrayLike,
    form: Form | None,
    setting: ToolSetting | None,
    across: Across | None,
) -> VirtualPart:
    """Return the part as `virtual_cut` does, of a tip that also leaves the plane of its azimuth."""
    if not isinstance(program, TurningProgram):
        raise DataError(f"the program must be a TurningProgram, got {type(program).__name__}")
    if program.quantity != "tip":
        raise DataError(
            "this is a program of cut points, points of the surface: no tool runs it as it stands; make "
            "a tip path with the nose of the tool, TurningJob(..., nose=RoundNose(...)).program(path)"
        )
    surface = None if form is None else known_form(form)
    edge = Edge.of(nose, program.sense, setting)
    xs, ys = positions(x, y)
    rho, theta = np.hypot(xs, ys).ravel(), np.arctan2(ys, xs).ravel()
    order = np.argsort(rho, kind="stable")
    sweep = _Sweep(program, edge, across)
    found, lone = _swept(sweep, rho, theta, order)
    said: list[str] = []
    if sweep.is_wrong(rho, theta, found[0]):
        for block in sweep.blocks(rho[order]):
            part = order[block]
            found[:, part], _ = sweep.cut(rho[part], theta[part], everywhere=True)
        said.append("turns far from the contact decide too: all turns were asked at every place")
    z, psi, t, turned = found
    lost = int(np.isnan(z).sum())
    if lost == z.size:
        raise DataError(
            "the program cuts none of these places: it runs from X = "
            f"{format_ends(float(program.X[0]), float(program.X[-1]), between=' to ')}"
        )
    if lost:
        said.append(
            f"{lost} of {z.size} places have no height: no turn cuts them, or no turn lies beyond them "
            f"({lone} at the first or last turn)"
        )
    backwards = np.isfinite(z) & (turned < 0.0)
    if backwards.any():
        said.append(
            f"within {format_length(float(rho[backwards].max()))} of the spindle axis the edge cuts "
            "beyond the axis, where it runs backwards, flank first"
        )
    error = np.full(z.shape, np.nan)
    if surface is not None:
        error = z - surface.height(rho * np.cos(theta), rho * np.sin(theta))
    return VirtualPart(
        rho.reshape(xs.shape), theta.reshape(xs.shape), z.reshape(xs.shape),
        error.reshape(xs.shape), np.abs(turned).reshape(xs.shape), psi.reshape(xs.shape),
        t.reshape(xs.shape), tuple(said),
    )  # fmt: skip


def touched_radii(program: TurningProgram, nose: RoundNose, form: Form) -> tuple[float, float]:
    """Return the radii between which contacts of every azimuth lie, one turn off each end."""
    gone = np.abs(program.azimuth - program.azimuth[0])
    ends = []
    for low, high in ((_TURN, 2.0 * _TURN), (gone[-1] - 2.0 * _TURN, gone[-1] - _TURN)):
        on = np.flatnonzero((gone >= low) & (gone <= high))
        on = on if on.size else np.arange(len(program))
        on = on[:: max(1, on.size // _AROUND)]
        made = tips(
            form, program.X[on], program.azimuth[on], Edge.of(nose, program.sense), strict=False
        )
        known = np.abs(made.rho[np.isfinite(made.rho)])
        if not known.size:
            raise DataError("the tool touches nothing of the form at an end of the program")
        ends.append((float(known.min()), float(known.max())))
    (a, b), (c, d) = ends
    # the inner end counts from its furthest contact, the outer one to its nearest
    low, high = (d, a) if a + b > c + d else (b, c)
    return (low, high) if low < high else (min(a, c), max(b, d))


def heights_cut(
    program: TurningProgram,
    nose: RoundNose,
    x: FloatArray,
    y: FloatArray,
    setting: ToolSetting | None = None,
    across: Across | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return heights of flat places and turns from the first point, as `virtual_cut` does without asking all turns."""
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    sweep = _Sweep(program, Edge.of(nose, program.sense, setting), across)
    found, _ = _swept(sweep, rho, theta, np.argsort(rho, kind="stable"))
    return found[0], np.abs(found[3])


def touching_heights(
    program: TurningProgram,
    nose: RoundNose,
    part: VirtualPart,
    form: Form,
    setting: ToolSetting | None = None,
) -> FloatArray:
    """Return what the same course of X and C leaves where the edge fits and always touches; NaN if unknown."""
    sweep = _Sweep(program, Edge.of(nose, program.sense, setting))
    rho, theta, z = part.rho.ravel(), part.theta.ravel(), np.full(part.z.size, np.nan)
    cut = np.flatnonzero(np.isfinite(part.z))
    cut = cut[np.argsort(rho[cut], kind="stable")]
    # beyond the axis the place has the azimuth of the tip and half a turn
    azimuth = np.interp(part.t.ravel(), program.t, program.azimuth)
    side = np.where(np.cos(azimuth - theta) < 0.0, -1.0, 1.0)
    for block in sweep.blocks(rho[cut]):
        at = cut[block]
        z[at] = sweep.touching(form, rho[at], theta[at], side[at], azimuth[at])
    return z.reshape(part.z.shape)


def _swept(
    sweep: _Sweep, rho: FloatArray, theta: FloatArray, order: NDArray[np.intp]
) -> tuple[FloatArray, int]:
    """Return rows z, psi, t, signed turns of places, and how many lie at the end of the turns."""
    found, lone = np.full((4, rho.size), np.nan), 0
    for block in sweep.blocks(rho[order]):
        part = order[block]
        found[:, part], few = sweep.cut(rho[part], theta[part])
        lone += few
    return found, lone


class _Sweep:
    """An edge on its way along a program."""

    def __init__(self, program: TurningProgram, edge: Edge, across: Across | None = None) -> None:
        self._edge = edge
        self._across = across
        self._whole = program
        # from the rim to the centre, so that turns are counted inwards
        self._is_inward = bool(program.X[0] >= program.X[-1])
        turns = np.arange(math.ceil(program.turns) + 1, dtype=np.float64)
        starts = _first_beyond(program.azimuth, _TURN * turns)
        starts[-1] = len(program) - 1
        starts = np.unique(np.minimum(starts, len(program) - 1))
        self._starts = starts
        low = np.minimum.reduceat(program.X, starts[:-1])
        high = np.maximum.reduceat(program.X, starts[:-1])
        if not self._is_inward:
            low, high = low[::-1], high[::-1]
        # a turn reaches on to the first point of the next one
        low = np.minimum(low, np.append(low[1:], program.X[-1 if self._is_inward else 0]))
        self._low = np.minimum.accumulate(low)
        self._high = np.maximum.accumulate(high[::-1])[::-1]
        self._reach = _reach(program, edge)
        self._course: AxisCourse | None = None

    def blocks(self, rho: FloatArray) -> Iterator[slice]:
        """Yield parts of growing radii: so many places at most, and so near that few turns reach them."""
        first = 0
        while first < rho.size:
            last = int(np.searchsorted(rho, rho[first] + self._reach, side="right"))
            last = min(max(last, first + 1), first + _BLOCK)
            yield slice(first, last)
            first = last

    def _turns(self, rho: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return from which turn to which (exclusive), from the first point, the edge may reach radii."""
        # turns whose smallest X is not above rho + reach, and whose largest is not below rho - reach
        first = np.searchsorted(-self._low, -(rho + self._reach), side="left") - 1
        last = np.searchsorted(-self._high, -(rho - self._reach), side="right") + 1
        count = self._low.size
        first, last = np.maximum(first, 0), np.minimum(last, count)
        if not self._is_inward:
            first, last = count - last, count - first
        return first, last

    def _piece(self, rho: FloatArray) -> AxisCourse | None:
        """Return the course of all turns that may reach radii."""
        starts, ends = self._turns(np.array([rho.min(), rho.max()]))
        first, last = int(starts.min()), int(ends.max())
        if first >= last:
            return None
        part = slice(int(self._starts[first]), int(self._starts[last]) + 1)
        course = self._course
        if course is None or course.first != part.start or course.t.size != part.stop - part.start:
            self._course = course = None  # its memory, before the next one is made
            self._course = course = AxisCourse.of(self._whole, part)
        return course

    def cut(
        self, rho: FloatArray, theta: FloatArray, *, everywhere: bool = False
    ) -> tuple[FloatArray, int]:
        """Return rows z, psi, t and signed turns, and how many places lie at the end of the turns."""
        found = np.full((4, rho.size), np.nan)
        course = self._piece(rho)
        if course is None:
            return found, 0
        lone = np.zeros(rho.size, dtype=bool)
        for side in (1.0, -1.0):
            which = np.arange(rho.size)
            if side < 0.0:
                # beyond the axis: only edges that reach over it
                nearest = float(course.values[0].min())
                which = np.flatnonzero(rho + nearest <= self._reach)
                if not which.size:
                    break
            rows, ends = self._lowest(
                course, rho[which], theta[which], side, everywhere=everywhere
            )
            lower = ~(found[0, which] <= rows[0]) & np.isfinite(rows[0])
            chosen = which[lower]
            found[:, chosen] = rows[:, lower]
            lone[chosen] = ends[lower]
        found[:, lone] = np.nan
        return found, int(lone.sum())

    def touching(
        self,
        form: Form,
        rho: FloatArray,
        theta: FloatArray,
        side: FloatArray,
        azimuth: FloatArray,
    ) -> FloatArray:
        """Return the lowest passage of an edge that fits and touches the form, by turns near those at azimuths."""
        course = self._piece(rho)
        if course is None:
            return np.full(rho.size, np.nan)
        start = np.where(side > 0.0, theta, theta + math.pi)
        start = start + _TURN * np.rint((azimuth - start) / _TURN)

        def tried(on: NDArray[np.intp], turns: int) -> FloatArray:
            moment = start[on] + _TURN * turns
            return self._height(course, rho[on], moment, side[on], _PASSES, form)[0]

        everywhere = np.arange(rho.size)
        z = tried(everywhere, 0)
        for way in (1, -1):
            on, turns = everywhere, 0
            while on.size:  # two turns on each side, walking on while they are lower
                turns += way
                height = tried(on, turns)
                lower = height < z[on]
                z[on[lower]] = height[lower]
                on = on if abs(turns) < _SIDE else on[lower]
        return np.where(np.isinf(z), np.nan, z)

    def _lowest(
        self,
        course: AxisCourse,
        rho: FloatArray,
        theta: FloatArray,
        side: float,
        *,
        everywhere: bool,
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return rows z, psi, t, signed turns of the deciding moment; whether it is at an end."""
        azimuth = course.values[1]
        start = theta if side > 0.0 else theta + math.pi  # azimuth of the tip, but for the lean
        # turns of the place that lie within the piece, one more at each end for the lean of the edge
        ends = np.sort(azimuth[[0, -1]])
        low = np.ceil((ends[0] - start) / _TURN).astype(np.int64) - 1
        high = np.floor((ends[1] - start) / _TURN).astype(np.int64) + 1
        # of them those that reach the place itself: a row of turns that mostly miss it would be tried in vain
        first, last = (self._whole.azimuth[self._starts[i]] for i in self._turns(side * rho))
        near, far = np.minimum(first, last), np.maximum(first, last)
        low = np.maximum(low, np.floor((near - start) / _TURN).astype(np.int64) - 1)
        high = np.minimum(high, np.ceil((far - start) / _TURN).astype(np.int64) + 1)
        high = np.maximum(low, high)

        def tried(k: NDArray[np.int64], passes: int) -> tuple[FloatArray, FloatArray, FloatArray]:
            return self._height(course, rho, start + _TURN * k, side, passes)

        if everywhere:
            best = low.copy()
            least = np.full(rho.size, np.inf)
            for step in range(int((high - low).max()) + 1):
                k = np.minimum(low + step, high)
                height = tried(k, _PASSES)[0]
                best, least = np.where(height < least, k, best), np.fmin(height, least)
        else:
            best = self._near(tried, low, high)
        z, psi, at = tried(best, _PASSES)

        def take(k: NDArray[np.int64]) -> bool:
            """Keep what is lower at other turns."""
            nonlocal best, z, psi, at
            height, angle, when = tried(k, _PASSES)
            lower = height < z
            z, psi, at = np.where(lower, (height, angle, when), (z, psi, at))
            best = np.where(lower, k, best)
            return bool(lower.any())

        if not everywhere:
            middle = best
            for offset in range(1, _SIDE + 1):
                take(middle + offset)
                take(middle - offset)
            while take(best + 1) | take(best - 1):  # walk on while a neighbour is lower
                pass
        z = np.where(np.isinf(z), np.nan, z)
        # a neighbour that is no moment of the program at all: the place is not between two turns
        whole = np.sort(self._whole.azimuth[[0, -1]])
        inside = (start + _TURN * (best - 1) >= whole[0]) & (
            start + _TURN * (best + 1) <= whole[1]
        )
        i, s = course.at_azimuth(np.where(np.isfinite(at), at, azimuth[0]))
        t = course.t[i] + s * (course.t[i + 1] - course.t[i])
        turned = side * (np.abs(at - self._whole.azimuth[0]) / _TURN)
        return np.stack([z, psi, t, turned]), ~inside

    def _near(
        self,
        tried: Callable[[NDArray[np.int64], int], tuple[FloatArray, ...]],
        low: NDArray[np.int64],
        high: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return turns near the lowest: some over all of them, then finer beside the best."""
        span = high - low
        best, least = low.copy(), np.full(low.size, np.inf)
        for share in np.linspace(0.0, 1.0, _COARSE):
            k = low + np.rint(share * span).astype(np.int64)
            height = tried(k, _ROUGH_PASSES)[0]
            best, least = np.where(height < least, k, best), np.fmin(height, least)
        stride = math.ceil(float(span.max(initial=1)) / (_COARSE - 1))
        while stride > 1:
            stride = (stride + 1) // 2
            for sign in (1, -1):
                k = np.clip(best + sign * stride, low, high)
                height = tried(k, _ROUGH_PASSES)[0]
                best, least = np.where(height < least, k, best), np.fmin(height, least)
        return best

    def _height(
        self,
        course: AxisCourse,
        rho: FloatArray,
        turns: FloatArray,
        side: float | FloatArray,
        passes: int,
        form: Form | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the height at which the edge of a turn passes, its angle, and the tip's azimuth then.

        With a form the tip is where the edge touches it, not where the program has it.
        """
        edge, azimuth = self._edge, course.values[1]
        if edge.is_flat and self._across is None:
            passes = 1
        y = np.full(rho.shape, edge.dy)
        psi, at = np.zeros(rho.shape), turns
        i, s = np.zeros(rho.shape, dtype=np.intp), y
        for _ in range(passes):
            with np.errstate(invalid="ignore", divide="ignore"):
                along = side * np.sqrt((rho - y) * (rho + y))
                at = turns - np.arctan(y / along)
            i, s = course.at_azimuth(at)
            psi = edge.angle_at(along - course.value(0, i, s))
            moved = edge.point(psi)[1]
            if self._across is not None:
                t = course.t[i] + s * (course.t[i + 1] - course.t[i])
                moved = moved + np.interp(t, *self._across)
            still = np.abs(moved - y) > _SETTLED
            y = moved
            if not still.any():
                break
        low, high = np.sort(azimuth[[0, -1]])
        cuts = (psi >= edge.low) & (psi <= edge.high) & (at >= low) & (at <= high)
        if form is None:
            stands = course.value(2, i, s)
        else:
            stands = np.full(rho.shape, np.nan)
            if not cuts.any():
                return np.full(rho.shape, np.inf), psi, at
            stands[cuts] = _touching(form, course.value(0, i, s)[cuts], at[cuts], edge, psi[cuts])
        height = np.where(cuts, stands + edge.point(psi)[2], np.inf)
        return height, psi, at

    def is_wrong(self, rho: FloatArray, theta: FloatArray, z: FloatArray) -> bool:
        """Return whether a turn that was not asked is lower at some of a thousand places."""
        known = np.flatnonzero(np.isfinite(z))
        if not known.size:
            return False
        sample = known[np.linspace(0, known.size - 1, min(_SAMPLE, known.size)).astype(np.int64)]
        order = sample[np.argsort(rho[sample])]
        for block in self.blocks(rho[order]):
            part = order[block]
            found, _ = self.cut(rho[part], theta[part], everywhere=True)
            if (found[0] < z[part] - _LOWER).any():
                return True
        return False


def _touching(
    form: Form, x: FloatArray, phi: FloatArray, edge: Edge, psi: FloatArray
) -> FloatArray:
    """Return heights of tips whose edge stands at angles over places that it touches nearby, where it fits."""
    # where the edge would touch the slopes of those places
    px, py, _ = edge.point(psi)
    c, s = np.cos(phi), np.sin(phi)
    tx, ty = form.slopes((x + px) * c - py * s, (x + px) * s + py * c)
    start = np.arctan2(c * tx + s * ty, edge.up + edge.lean * (c * ty - s * tx))
    psi, found = near_contacts(form, x, phi, edge, start)
    px, py, pz = edge.point(psi)
    z = form.height((x + px) * c - py * s, (x + px) * s + py * c) - pz
    rest = np.flatnonzero(~found)
    if rest.size:
        z[rest] = tips(form, x[rest], phi[rest], edge, strict=False).z
    return np.asarray(z)


def _first_beyond(azimuth: FloatArray, turned: FloatArray) -> NDArray[np.intp]:
    """Return the first points at which an azimuth, growing or falling, has turned so far."""
    if azimuth[-1] > azimuth[0]:
        return np.asarray(np.searchsorted(azimuth, azimuth[0] + turned))
    # a view from behind, where it grows
    behind = np.searchsorted(azimuth[::-1], azimuth[0] - turned, side="right")
    return np.asarray(azimuth.size - behind)


def _reach(program: TurningProgram, edge: Edge) -> float:
    """Return how far beside the tip the edge can still be the lowest, m."""
    far = edge.reach(float(program.Z.max() - program.Z.min()))
    low, high = max(-far, edge.low), min(far, edge.high)
    ends = edge.point(np.array([low, high]))[0]
    # on a flat the turns beside a place still meet above it
    return float(np.abs(ends).max()) + abs(edge.dx) + program.feed

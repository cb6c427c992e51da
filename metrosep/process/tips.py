"""The tip path: where the tip of a round nose stands so that its edge just touches the surface.

Machine frame at the tool: x radial outwards, y towards growing azimuth, z out of the material; the
programmed tip is the lowest point of the nominal edge. Where the points of the edge lie from it says
`nose`: with negative rake the higher ones run ahead. The tip height

    Z(X, phi) = max over psi of S(P(psi)) - z(psi),  P = the point of the edge on the part,

is the lowest that cuts nothing of the surface S, whatever its shape. At the contact
``tan psi = sX / (kz + sigma sY ky)`` with the slopes there along machine x and y, for a round edge
without yaw.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError, LimitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import Frozen, finite_positions, same_places
from metrosep.process._setting_equations import known_form
from metrosep.process.nose import (
    EdgeProfile,
    RoundNose,
    checked_nose,
    signed_sense,
    smallest_length,
)
from metrosep.process.setting_maps import plausible_places

if TYPE_CHECKING:
    from metrosep.process.tool_settings import ToolSetting

_SAMPLES = 40
"""Samples of the edge per radius of the nose, as many as the mesh of `gouge_check` has."""
_PER_LENGTH = 4
"""Samples within the smallest lateral length of the form, where it has one."""
_BLOCK = 1 << 20
"""Points of the edge that are worked on at once."""
_CLOSE = 1e-11
"""rad: of the contact; the height is then right to R psi^2, 1e-25 m."""
_LEVEL = 1e-13
"""Of the slope of S(P) - z by R psi at the contact: rounding of the slopes."""
_ON_AXIS = 1e-12
"""m: a contact that near to the spindle axis is on it."""
_ALIKE = 1e-10
"""m: contacts whose heights differ by less are there at once."""
_MOST_STEPS, _ANGLE_STEPS = 60, 6
_TINY_ANGLE = 1e-9
"""rad: after a step of Newton's as short the next one is lost in rounding."""
_ANCHORS = 8
"""Of moments along a course every so many are searched all along the edge; those between start from them."""
_NEAR, _SETTLED, _PROBE = 0.02, 1e-5, 1e-4
"""rad: how far Newton may go from where it starts; its last step, R psi^2 / 2 is 0.05 pm; of its difference."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TipPath(Frozen):
    """Heights of the tip and where the edge touches; read-only arrays of equal length.

    Parameters
    ----------
    X, azimuth : ndarray, shape (n,), m and rad
        Programmed place of the tip.
    z : ndarray, shape (n,), m
        Programmed height of the tip, out of the material.
    psi : ndarray, shape (n,), rad
        Angle of the contact on the edge from the tip, positive outwards.
    rho, theta : ndarray, shape (n,), m and rad
        The contact on the part; rho < 0 is a contact beyond the spindle axis.
    along_x, along_y : ndarray, shape (n,)
        Slopes of the surface there along machine x and y.
    contacts : ndarray of int, shape (n,)
        How many points of the edge touch, to 0.1 nm; where it is more than one the contact jumps, and
        material stays between them. 0 where there is no tip.
    step : float, m
        Between the points of the edge that are tried: a narrower peak may be missed.
    messages : tuple of str, optional
        What to know.
    """

    X: FloatArray
    azimuth: FloatArray
    z: FloatArray
    psi: FloatArray
    rho: FloatArray
    theta: FloatArray
    along_x: FloatArray
    along_y: FloatArray
    contacts: NDArray[np.int64]
    step: float
    messages: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"TipPath({self.z.size} tips, contacts up to {np.degrees(np.nanmax(np.abs(self.psi))):.4g} deg)"


def tip_path(
    form: Form,
    X: ArrayLike,
    azimuth: ArrayLike,
    *,
    nose: RoundNose,
    sense: Literal["counterclockwise", "clockwise"] | None = None,
    strict: bool = True,
) -> TipPath:
    """Return the heights at which the tip of a round nose just touches a surface.

    Parameters
    ----------
    form : Form
        The surface wanted, with the spindle axis at its origin; where it is not defined is air.
    X : array_like, m
        Radius at which the tip stands.
    azimuth : array_like, rad
        Azimuth of the tip on the part; broadcasts with X.
    nose : RoundNose
        Radius, rake and sharp window.
    sense : {"counterclockwise", "clockwise"}, optional
        How the tool goes round the part, seen from above; needed where the nose has rake.
    strict : bool, optional
        Whether a contact beyond the window, or none at all, is refused; otherwise it is NaN, with a
        message for the window.

    Returns
    -------
    TipPath
        Tips and contacts.

    Raises
    ------
    DataError
        If the form or the nose is none, or the nose has rake and the sense is not known.
    InvalidSamplesError
        If a position is not a finite number, the positions do not broadcast, or the edge is off the
        surface altogether.
    LimitError
        If the contact lies beyond the window of the nose.
    UnitError
        If a radius cannot be in metres.

    Notes
    -----
    The edge is tried at steps of R/40, or of a quarter of the smallest lateral length of the form
    where it has one, and the greatest sample is refined. Where the nose does not fit into a hollow
    the path stays above it and material is left: see `gouge_check`. Only geometry: no burr, elastic
    recovery, edge radius or wear.

    Examples
    --------
    >>> from metrosep.forms import Sphere
    >>> found = tip_path(Sphere(R=35e-3), [8e-3], 0.7, nose=RoundNose(0.6e-3))
    >>> round(found.z.item() * 1e6, 6)
    943.162134
    """
    form = known_form(form)
    edge = Edge.of(nose, sense)
    given = {"X": np.atleast_1d(finite_positions(X, "X"))}
    places = same_places(**given, azimuth=finite_positions(azimuth, "azimuth"))
    x, phi = (np.array(a, dtype=np.float64).ravel() for a in places)
    plausible_places(x, "X")
    return tips(form, x, phi, edge, strict=strict)


@dataclass(frozen=True, slots=True)
class Edge:
    """An edge in the machine frame, its tip off the programmed place by dx and dy."""

    radius: float
    up: float = 1.0  # along z, for each m of rise
    lean: float = 0.0  # behind the tip as the tool travels, for each m of rise, times sigma
    low: float = -0.5 * math.pi
    high: float = 0.5 * math.pi
    yaw: float = 0.0
    profile: EdgeProfile | None = None
    swivel: float = 0.0
    dx: float = 0.0
    dy: float = 0.0

    @classmethod
    def of(cls, nose: RoundNose, sense: str | None, setting: ToolSetting | None = None) -> Edge:
        """Return the edge of a nose as it is set, or raise DataError where its sense must be known."""
        checked_nose(nose)
        why = ""
        if nose.rake:
            why = f"a nose with a rake of {math.degrees(nose.rake):.4g} degrees"
        elif nose.yaw:
            why = f"a nose with a yaw of {math.degrees(nose.yaw):.4g} degrees"
        elif setting is not None and setting.dy:
            why = f"a tool that stands {format_length(setting.dy)} off the axis"
        sign = signed_sense(sense, why)
        up, lean = nose.tilt
        made = cls(nose.radius, up, sign * lean, *nose.limits, nose.yaw, nose.edge, nose.swivel)
        return made if setting is None else made.set_to(setting)

    def set_to(self, setting: ToolSetting) -> Edge:
        """Return the edge off by dx and dy, its radius off by dR, the tip kept."""
        dx, dy = self.dx + setting.dx, self.dy + setting.dy
        return replace(self, radius=self.radius + setting.dR, dx=dx, dy=dy)

    @property
    def is_flat(self) -> bool:
        """Whether it stays in a plane of constant y."""
        return self.lean == 0.0 and self.yaw == 0.0

    def point(self, psi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and z of points of the edge, m from the programmed tip."""
        x, up = self.radius * np.sin(psi), 2.0 * self.radius * np.sin(0.5 * psi) ** 2
        if self.profile is not None:
            wave = self.profile.at(psi + self.swivel)
            x, up = x + wave * np.sin(psi), up - wave * np.cos(psi)
        y = -self.lean * up
        if self.yaw:
            c, s = math.cos(self.yaw), math.sin(self.yaw)
            x, y = c * x - s * y, s * x + c * y
        return self.dx + x, self.dy + y, self.up * up

    def tangent(self, psi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the derivatives of `point` by psi, m."""
        x, up = self.radius * np.cos(psi), self.radius * np.sin(psi)
        if self.profile is not None:
            wave, slope = (f(psi + self.swivel) for f in (self.profile.at, self.profile.slope))
            x = x + wave * np.cos(psi) + slope * np.sin(psi)
            up = up + wave * np.sin(psi) - slope * np.cos(psi)
        y = -self.lean * up
        if self.yaw:
            c, s = math.cos(self.yaw), math.sin(self.yaw)
            x, y = c * x - s * y, s * x + c * y
        return x, y, self.up * up

    def angle_at(self, x: FloatArray) -> FloatArray:
        """Return the angle at which the edge stands at x from the programmed tip; NaN if nowhere."""
        with np.errstate(invalid="ignore"):
            psi = np.arcsin((x - self.dx) / self.radius)
        if self.profile is None and not self.yaw:
            return np.asarray(psi)
        for _ in range(
            _ANGLE_STEPS
        ):  # the first guess is off by what waviness and yaw do, some mrad
            step = (self.point(psi)[0] - x) / self.tangent(psi)[0]
            psi = psi - step
            if not (np.abs(step) > _TINY_ANGLE).any():
                break
        return np.asarray(psi)

    def by_setting(self, made: TipPath) -> FloatArray:
        """Return the change of the cut height at contacts with dx, dy and dR, shape (3, n)."""
        c = self.up + self.lean * made.along_y
        return np.stack([-made.along_x, -made.along_y, c - np.hypot(c, made.along_x)])

    def by_azimuth(
        self, x: FloatArray, psi: FloatArray, along_x: FloatArray, along_y: FloatArray
    ) -> FloatArray:
        """Return dZ/dphi of tips at X by their contacts, (X + x) sY - y sX: the envelope theorem."""
        px, py, _ = self.point(psi)
        return np.asarray((x + px) * along_y - py * along_x)

    def reach(self, relief: float) -> float:
        """Return the angle on either side beyond which the edge has risen by more than twice a relief."""
        # the relief of a mesh is too small by what lies between its points, hence twice
        rise = 2.0 * relief
        if self.profile is not None:
            rise += 2.0 * float(np.abs(self.profile.deviation).max())
        share = rise / (self.radius * self.up)
        return math.pi if share >= 1.0 else math.acos(1.0 - share)

    def own_curvature(self, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
        """Return the second derivative of the round edge by x as it is swept at these slopes, 1/m."""
        c = self.up + self.lean * along_y
        return np.asarray(np.hypot(c, along_x) ** 3 / (self.radius * c * c))


def tips(
    form: Form,
    x: FloatArray,
    phi: FloatArray,
    edge: Edge,
    *,
    strict: bool,
    step: float | None = None,
) -> TipPath:
    """Return the tips at flat arrays of places; steps of R/40 unless a length is given."""
    usual = edge.radius / _SAMPLES
    step = min(usual, _finest(form, edge), usual if step is None else step)
    reach = _reach(form, float(np.abs(x).max(initial=0.0)), edge)
    seen, columns = _Seen(form, x, phi, edge), np.empty((6, x.size))
    contacts = np.zeros(x.size, dtype=np.int64)
    for part, rows, counts in _walk(form, x, phi, edge, step, reach, seen, strict=strict):
        columns[:, part], contacts[part] = rows, counts
    z, psi, rho, theta, along_x, along_y = columns
    return TipPath(x, phi, z, psi, rho, theta, along_x, along_y, contacts, step, seen.messages())


def tips_along(form: Form, x: FloatArray, phi: FloatArray, edge: Edge, *, strict: bool) -> TipPath:
    """Return what `tips` does at places that follow one another closely; contacts of most by Newton from others'.

    Every eighth is searched all along the edge. Between two that touch once, and alike, Newton starts from
    their contacts; wherever it does not settle on a maximum nearby the edge is searched too.
    """
    n, ends = x.size, np.unique(np.append(np.arange(0, x.size, _ANCHORS), x.size - 1))
    if n <= 2 * _ANCHORS:
        return tips(form, x, phi, edge, strict=strict)
    known = tips(form, x[ends], phi[ends], edge, strict=strict)
    sure = known.contacts == 1
    psi = np.interp(np.arange(n), ends, np.where(sure, known.psi, np.nan))
    psi, found = near_contacts(form, x, phi, edge, psi)
    found[ends] = False
    rows = np.full((6, n), np.nan)
    at = np.flatnonzero(found)
    rows[:, at] = _rows(
        form, x[at], phi[at], edge, psi[at], _gap(form, x[at], phi[at], edge, psi[at])
    )
    contacts = found.astype(np.int64)
    found[ends] = True
    rest = np.flatnonzero(~found)
    searched = [(ends, known)]
    if rest.size:
        searched.append((rest, tips(form, x[rest], phi[rest], edge, strict=strict)))
    for which, made in searched:
        rows[:, which] = made.z, made.psi, made.rho, made.theta, made.along_x, made.along_y
        contacts[which] = made.contacts
    z, angle, rho, theta, along_x, along_y = rows
    said = dict.fromkeys(m for _, made in searched for m in made.messages)
    return TipPath(
        x, phi, z, angle, rho, theta, along_x, along_y, contacts, known.step, tuple(said)
    )


def near_contacts(
    form: Form, x: FloatArray, phi: FloatArray, edge: Edge, psi: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return where S(P) - z is stationary near angles of the edge, and whether that is a maximum within it."""
    start = psi
    with np.errstate(invalid="ignore", divide="ignore"):
        here = _rise(form, x, phi, edge, psi)
        bend = (_rise(form, x, phi, edge, psi + _PROBE) - here) / _PROBE
        step = -here / bend
        psi = psi + step
        for _ in range(2):
            step = -_rise(form, x, phi, edge, psi) / bend
            psi = psi + step
        inside = (psi > edge.low + _PROBE) & (psi < edge.high - _PROBE)
        return psi, inside & (bend < 0.0) & (np.abs(step) < _SETTLED) & (
            np.abs(psi - start) < _NEAR
        )


def tip_heights(
    form: Form, x: FloatArray, phi: FloatArray, edge: Edge, *, rates: bool = False
) -> tuple[FloatArray, FloatArray | None, tuple[str, ...]]:
    """Return heights, dZ/dX and dZ/dphi if wanted, and messages; no more memory than that."""
    step = min(edge.radius / _SAMPLES, _finest(form, edge))
    reach = _reach(form, float(np.abs(x).max(initial=0.0)), edge)
    seen, z = _Seen(form, x, phi, edge), np.empty(x.size)
    slopes = np.empty((2, x.size)) if rates else None
    for part, rows, _ in _walk(form, x, phi, edge, step, reach, seen, strict=True):
        z[part] = rows[0]
        if slopes is not None:
            slopes[:, part] = rows[4], edge.by_azimuth(x[part], rows[1], rows[4], rows[5])
    return z, slopes, seen.messages()


def _finest(form: Form, edge: Edge) -> float:
    """Return how close points of the edge must lie for the form and the waviness, m."""
    width = smallest_length(form) / _PER_LENGTH
    if edge.profile is not None:
        width = min(width, 0.5 * edge.radius * float(np.diff(edge.profile.angle).min()))
    return width


def _walk(
    form: Form,
    x: FloatArray,
    phi: FloatArray,
    edge: Edge,
    step: float,
    reach: float,
    seen: _Seen,
    *,
    strict: bool,
) -> Iterator[tuple[slice, FloatArray, NDArray[np.int64]]]:
    """Yield rows z, psi, rho, theta, sX, sY and the number of contacts, some tips at a time."""
    rows = max(1, _BLOCK // (2 + math.ceil((edge.high - edge.low) * edge.radius / step)))
    for first in range(0, x.size, rows):
        part = slice(first, first + rows)
        found, beyond, border, contacts = _touched(form, x[part], phi[part], edge, step, reach)
        seen.take(first, found, beyond, border, contacts, strict=strict)
        found[:, beyond] = np.nan
        contacts[beyond] = 0
        yield part, found, contacts


class _Seen:
    """What is to be said of tips that were found piece by piece."""

    def __init__(self, form: Form, x: FloatArray, phi: FloatArray, edge: Edge) -> None:
        self._form, self._x, self._phi, self._edge = form, x, phi, edge
        self._found: dict[str, tuple[int, int]] = {}
        self._furthest = 0.0

    def take(
        self,
        first: int,
        rows: FloatArray,
        beyond: NDArray[np.bool_],
        border: NDArray[np.bool_],
        contacts: NDArray[np.int64],
        *,
        strict: bool,
    ) -> None:
        """Note what is to be said of a piece, or refuse it."""
        air = np.isnan(rows[0])
        if strict and air.any():
            raise InvalidSamplesError(
                f"the {self._form.name} has no height below the tip at "
                f"{self._place(first + int(np.argmax(air)))}: end the path before, give a form "
                "that goes on, or, where this is before the rim, a smaller lead_in such as 3"
            )
        for name, which in (("beyond", beyond), ("border", border), ("jumps", contacts > 1)):
            if which.any():
                count, at = self._found.get(name, (0, first + int(np.argmax(which))))
                self._found[name] = count + int(which.sum()), at
        if strict and "beyond" in self._found:
            raise LimitError(self._beyond())
        self._furthest = max(self._furthest, float(-np.fmin.reduce(rows[2], initial=0.0)))

    def messages(self) -> tuple[str, ...]:
        """Return what is to be known."""
        said = [self._beyond()] if "beyond" in self._found else []
        if "border" in self._found:
            count, at = self._found["border"]
            said.append(
                f"at {count} tips, the first at {self._place(at)}, the nose touches the border of the "
                f"{self._form.name}: air was assumed beyond it"
            )
        if "jumps" in self._found:
            count, at = self._found["jumps"]
            said.append(
                f"the nose touches at two places at once at {count} tips, the first at "
                f"{self._place(at)}: the contact jumps, and material stays between them"
            )
        if self._furthest > _ON_AXIS:
            said.append(
                f"within {format_length(self._furthest)} of the spindle axis the edge touches beyond "
                "the axis, where it runs backwards, flank first"
            )
        return tuple(said)

    def _beyond(self) -> str:
        count, at = self._found["beyond"]
        low, high = math.degrees(self._edge.low), math.degrees(self._edge.high)
        return (
            f"the surface touches the nose beyond its sharp window from {low:.4g} to {high:.4g} degrees "
            f"at {count} tips, the first at {self._place(at)}: take a nose with a wider window"
        )

    def _place(self, at: int) -> str:
        return _place(self._x, self._phi, at)


def _place(x: FloatArray, phi: FloatArray, at: int) -> str:
    return f"X = {format_length(float(x[at]))}, azimuth {math.degrees(float(phi[at])) % 360.0:.4g} degrees"


def _reach(form: Form, outer: float, edge: Edge) -> float:
    """Return the angle on either side beyond which no contact can lie, because the surface is not that high."""
    # F(psi) = S - z(psi) beats F(0) only while z(psi) is below the relief
    rho = np.linspace(0.0, outer + edge.radius, 97)[:, None]
    turn = np.arange(61) * (2.0 * math.pi / 61.0)
    heights = form.height((rho * np.cos(turn)).ravel(), (rho * np.sin(turn)).ravel())
    if np.isnan(heights).all():
        return math.pi
    return edge.reach(float(np.nanmax(heights) - np.nanmin(heights)))


def _touched(
    form: Form, x: FloatArray, phi: FloatArray, edge: Edge, step: float, reach: float
) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
    """Return rows z, psi, rho, theta, sX, sY; whether beyond the window; on a border; contacts."""
    tried = _tried(edge, step, reach)
    found = _gaps(form, x[:, None], phi[:, None], edge, tried)
    best = np.argmax(found, axis=1)
    lost = np.isnan(form.height(x * np.cos(phi), x * np.sin(phi)))
    # an end of what was tried that is no end of the edge: look at the whole edge there
    ends = (best == 0) & (tried[0] > edge.low) | (best == tried.size - 1) & (tried[-1] < edge.high)
    short = ends | lost & ((tried[0] > edge.low) | (tried[-1] < edge.high))
    near = _highest(form, x, phi, edge, tried, found, ~short)
    if short.any():
        tried = _tried(edge, step, math.pi)
        at = np.flatnonzero(short)
        again = _gaps(form, x[at, None], phi[at, None], edge, tried)
        for whole, part in zip(
            near, _highest(form, x[at], phi[at], edge, tried, again), strict=True
        ):
            whole[at] = part
    psi, height, border, contacts = near
    rows = _rows(form, x, phi, edge, psi, height)
    air = np.isnan(rows[0])
    # the last angle of a whole nose is vertical: no slope reaches it
    beyond = (edge.high - psi <= _CLOSE) | (psi - edge.low <= _CLOSE)
    return rows, beyond, border & ~air, np.where(air, 0, contacts)


def _rows(
    form: Form, x: FloatArray, phi: FloatArray, edge: Edge, psi: FloatArray, height: FloatArray
) -> FloatArray:
    """Return rows z, psi, rho, theta, sX, sY of contacts."""
    px, py, _ = edge.point(psi)
    c, s = np.cos(phi), np.sin(phi)
    slopes = form.slopes((x + px) * c - py * s, (x + px) * s + py * c)
    z = np.where(np.isneginf(height), np.nan, height)
    rho = np.copysign(np.hypot(x + px, py), x + px)
    theta = phi + np.arctan(py / np.where(x + px == 0.0, math.inf, x + px))
    along = c * slopes[0] + s * slopes[1], c * slopes[1] - s * slopes[0]
    return np.stack([z, psi, rho, theta, *along])


def _highest(
    form: Form,
    x: FloatArray,
    phi: FloatArray,
    edge: Edge,
    tried: FloatArray,
    found: FloatArray,
    wanted: NDArray[np.bool_] | None = None,
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.int64]]:
    """Return where S(P) - z is greatest, its value, whether on a border, and how many reach it."""
    best = np.argmax(found, axis=1)
    top = found[np.arange(x.size), best]
    psi, border = _refined(form, x, phi, edge, *_beside(tried, best))
    height = np.where(np.isneginf(top), -np.inf, _gap(form, x, phi, edge, psi))
    contacts = np.ones(x.size, dtype=np.int64)
    rising, falling = found[:, 1:-1] >= found[:, :-2], found[:, 1:-1] > found[:, 2:]
    with np.errstate(invalid="ignore"):
        bend = np.abs(found[:, :-2] + found[:, 2:] - 2.0 * found[:, 1:-1])
        # between samples a hill is higher than its sample by an eighth of the second difference
        may = rising & falling & (found[:, 1:-1] + 0.5 * bend >= top[:, None])
    several = may.sum(axis=1) > 1
    if wanted is not None:
        several &= wanted
    # every hill of every such tip at once: rows in order, the hills of a tip beside each other
    rows, hills = np.nonzero(may & several[:, None])
    if rows.size:
        hills = hills + 1
        at = (x[rows], phi[rows])
        angles, on = _refined(form, *at, edge, *_beside(tried, hills))
        heights = _gap(form, *at, edge, angles)
        starts = np.flatnonzero(np.diff(rows, prepend=-1))
        tips = rows[starts]
        highest = np.maximum.reduceat(heights, starts)
        of = np.repeat(np.arange(tips.size), np.diff(starts, append=rows.size))
        is_first = heights == highest[of]
        first = np.flatnonzero(is_first)[np.searchsorted(of[is_first], np.arange(tips.size))]
        higher = highest > height[tips]
        which, place = tips[higher], first[higher]
        psi[which], height[which], border[which] = angles[place], heights[place], on[place]
        level = (heights >= height[rows] - _ALIKE) & (np.abs(angles - psi[rows]) > 1e-6)
        contacts[tips] = 1 + np.add.reduceat(level.astype(np.int64), starts)
    return psi, height, border, contacts


def _tried(edge: Edge, step: float, reach: float) -> FloatArray:
    low, high = max(-reach, edge.low), min(reach, edge.high)
    n = max(8, math.ceil((high - low) * edge.radius / step))
    return np.linspace(low, high, n + 1)


def _beside(
    tried: FloatArray, best: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the angles of samples, and of those ahead of and behind them."""
    return tried[best], tried[np.minimum(best + 1, tried.size - 1)], tried[np.maximum(best - 1, 0)]


def _gap(form: Form, x: FloatArray, phi: FloatArray, edge: Edge, psi: FloatArray) -> FloatArray:
    """Return S(P) - z of one point of the edge for each tip, -inf in the air."""
    px, py, pz = edge.point(psi)
    c, s = np.cos(phi), np.sin(phi)
    height = form.height((x + px) * c - py * s, (x + px) * s + py * c)
    return np.where(np.isnan(height), -np.inf, height - pz)


def _gaps(form: Form, x: FloatArray, phi: FloatArray, edge: Edge, psi: FloatArray) -> FloatArray:
    """Return S(P) - z of points of the edge, -inf in the air."""
    px, py, pz = edge.point(psi)
    c, s = np.cos(phi), np.sin(phi)
    along = x + px
    at = np.broadcast_arrays(along * c - py * s, along * s + py * c)
    height = form.height(at[0].ravel(), at[1].ravel()).reshape(at[0].shape)
    return np.where(np.isnan(height), -np.inf, height - pz)


def _refined(
    form: Form,
    x: FloatArray,
    phi: FloatArray,
    edge: Edge,
    start: FloatArray,
    ahead: FloatArray,
    behind: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the angle where S(P) - z is stationary beside the greatest sample, and if on a border."""

    def rise(psi: FloatArray) -> FloatArray:
        return _rise(form, x, phi, edge, psi)

    inner = rise(start)
    up = inner > 0.0
    near, far = start.copy(), np.where(up, ahead, behind)
    # `near` lies on the surface and F rises from it towards `far`, where it must fall or end
    d_near, d_far = np.abs(inner), -np.where(up, 1.0, -1.0) * rise(far)
    d_far = np.where(d_far > 0.0, d_far, np.nan)
    psi = near.copy()
    off = np.isnan(rise(far))
    for step in range(_MOST_STEPS):
        if not ((np.abs(far - near) > _CLOSE) & (d_near > _LEVEL)).any():
            break
        share = d_near / (d_near + d_far)
        plain = np.isnan(share) | (step % 3 == 2)
        psi = near + np.where(plain, 0.5, share) * (far - near)
        now = np.where(up, 1.0, -1.0) * rise(psi)
        ahead_of = now > 0.0
        off = np.where(ahead_of, off, np.isnan(now))
        near, d_near = np.where(ahead_of, psi, near), np.where(ahead_of, now, d_near)
        far = np.where(ahead_of, far, psi)
        d_far = np.where(ahead_of, d_far, np.where(now < 0.0, -now, np.nan))
        exact = now == 0.0
        near, far = np.where(exact, psi, near), np.where(exact, psi, far)
    return near, off & (d_near > math.sqrt(_CLOSE))


def _rise(form: Form, x: FloatArray, phi: FloatArray, edge: Edge, psi: FloatArray) -> FloatArray:
    """Return (1/R) dF/dpsi of F = S(P) - z: (sX x' + sY y' - z') / R."""
    c, s = np.cos(phi), np.sin(phi)
    px, py, _ = edge.point(psi)
    ex, ey, ez = edge.tangent(psi)
    tx, ty = form.slopes((x + px) * c - py * s, (x + px) * s + py * c)
    sx, sy = c * tx + s * ty, c * ty - s * tx
    return np.asarray((sx * ex + sy * ey - ez) / edge.radius)


class TipSurface:
    """The heights of the tip as a function of its place on the part, with its gradient."""

    def __init__(self, form: Form, edge: Edge) -> None:
        self._form, self._edge = form, edge

    def __call__(self, x: ArrayLike, y: ArrayLike = 0.0) -> FloatArray:
        """Return the height of the tip."""
        found, shape = self._tips(x, y)
        return np.asarray(found.z.reshape(shape))

    def gradient(self, x: ArrayLike, y: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return dZ/dx and dZ/dy of the tip."""
        found, shape = self._tips(x, y)
        turn = self._edge.by_azimuth(found.X, found.psi, found.along_x, found.along_y)
        with np.errstate(divide="ignore", invalid="ignore"):
            across = np.where(found.X == 0.0, found.along_y, turn / found.X)
        c, s = np.cos(found.azimuth), np.sin(found.azimuth)
        along = found.along_x
        return (c * along - s * across).reshape(shape), (s * along + c * across).reshape(shape)

    def _tips(self, x: ArrayLike, y: ArrayLike) -> tuple[TipPath, tuple[int, ...]]:
        xs, ys = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        rho, phi = np.hypot(xs, ys).ravel(), np.arctan2(ys, xs).ravel()
        return tips(self._form, rho, phi, self._edge, strict=True), xs.shape

"""The tip path: where the tip of a round nose stands so that its edge just touches the surface.

Machine frame at the tool: x radial outwards, y towards growing azimuth, z out of the material; the
programmed tip is the lowest point of the edge. A point of the edge lies at the angle psi from it,

    x = R sin psi,  y = -sigma w sin gamma,  z = w cos gamma,  w = R (1 - cos psi),

with the rake gamma and sigma = +1 where the tool goes round the part counter-clockwise, -1 where it
goes clockwise: with negative rake the higher points of the edge run ahead. The tip height

    Z(X, phi) = max over psi of S(P(psi)) - z(psi),  P = the point of the edge on the part,

is the lowest that cuts nothing of the surface S, whatever its shape. At the contact
``tan psi = sX / (cos gamma + sigma sY sin gamma)`` with the slopes there along machine x and y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import Frozen, finite_positions, same_places
from metrosep.process._setting_equations import known_form
from metrosep.process.nose import RoundNose, checked_nose, signed_sense, smallest_length
from metrosep.process.setting_maps import plausible_places

__all__ = ["TipPath", "TipSurface", "tip_path"]

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
_MOST_STEPS = 60


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
        If a position is no finite number, the positions do not broadcast, or the edge is off the
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
    """A round edge in the machine frame, its tip off the programmed place by dx and dy."""

    radius: float
    rake: float = 0.0
    sign: float = 1.0
    half: float = 0.5 * math.pi
    dx: float = 0.0
    dy: float = 0.0

    @classmethod
    def of(cls, nose: RoundNose, sense: str | None) -> Edge:
        """Return the edge of a nose, or raise DataError where its sense must be known."""
        checked_nose(nose)
        half = 0.5 * (math.pi if nose.window is None else nose.window)
        return cls(nose.radius, nose.rake, signed_sense(sense, nose.rake), half)

    def point(self, psi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and z of points of the edge, m from the programmed tip."""
        up = 2.0 * self.radius * np.sin(0.5 * psi) ** 2
        lean = self.sign * math.sin(self.rake)
        return self.dx + self.radius * np.sin(psi), self.dy - lean * up, up * math.cos(self.rake)

    def by_setting(self, made: TipPath) -> FloatArray:
        """Return the change of the cut height at contacts with dx, dy and dR, shape (3, n)."""
        c = math.cos(self.rake) + self.sign * math.sin(self.rake) * made.along_y
        return np.stack([-made.along_x, -made.along_y, c - np.hypot(c, made.along_x)])


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
    width = smallest_length(form) / _PER_LENGTH
    step = min(edge.radius / _SAMPLES, width, edge.radius if step is None else step)
    reach = _reach(form, float(np.abs(x).max(initial=0.0)), edge)
    columns = np.empty((6, x.size))
    beyond, border = np.zeros(x.size, dtype=bool), np.zeros(x.size, dtype=bool)
    rows = max(1, _BLOCK // (2 * math.ceil(edge.half * edge.radius / step) + 1))
    for first in range(0, x.size, rows):
        part = slice(first, first + rows)
        columns[:, part], beyond[part], border[part] = _touched(
            form, x[part], phi[part], edge, step, reach
        )
    z, psi, rho, theta, along_x, along_y = columns
    air = np.flatnonzero(np.isnan(z))
    if air.size and strict:
        raise InvalidSamplesError(
            f"the {form.name} has no height below the tip at {_place(x, phi, air[0])}: end the path "
            "before, or give a form that goes on"
        )
    said = []
    if beyond.any():
        at = int(np.flatnonzero(beyond)[0])
        text = (
            f"the surface touches the nose beyond its sharp window of {math.degrees(2 * edge.half):.4g} "
            f"degrees at {int(beyond.sum())} tips, the first at {_place(x, phi, at)}: take a nose "
            "with a wider window"
        )
        if strict:
            raise LimitError(text)
        said.append(text)
        columns[:, beyond] = np.nan
    if border.any():
        said.append(
            f"at {int(border.sum())} tips, the first at {_place(x, phi, np.flatnonzero(border)[0])}, "
            f"the nose touches the border of the {form.name}: air was assumed beyond it"
        )
    furthest = float(-np.fmin.reduce(rho, initial=0.0))
    if furthest > _ON_AXIS:
        said.append(
            f"within {format_length(furthest)} of the spindle axis the edge touches beyond the axis, "
            "where it runs backwards, flank first"
        )
    return TipPath(x, phi, z, psi, rho, theta, along_x, along_y, step, tuple(said))


def _place(x: FloatArray, phi: FloatArray, at: int) -> str:
    return f"X = {format_length(float(x[at]))}, azimuth {math.degrees(float(phi[at])):.4g} degrees"


def _reach(form: Form, outer: float, edge: Edge) -> float:
    """Return the angle beyond which no contact can lie, because the surface is not that high."""
    # F(psi) = S - z(psi) beats F(0) only while z(psi) is below the relief; the relief of a mesh is
    # too small by what lies between its points, hence twice
    rho = np.linspace(0.0, outer + edge.radius, 97)[:, None]
    turn = np.arange(61) * (2.0 * math.pi / 61.0)
    heights = form.height((rho * np.cos(turn)).ravel(), (rho * np.sin(turn)).ravel())
    if np.isnan(heights).all():
        return edge.half
    relief = 2.0 * float(np.nanmax(heights) - np.nanmin(heights))
    share = relief / (edge.radius * math.cos(edge.rake))
    return edge.half if share >= 1.0 else min(edge.half, math.acos(1.0 - share))


def _touched(
    form: Form, x: FloatArray, phi: FloatArray, edge: Edge, step: float, reach: float
) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return rows z, psi, rho, theta, sX, sY; whether beyond the window; whether on a border."""
    tried = _tried(edge, step, reach)
    found = _gaps(form, x[:, None], phi[:, None], edge, tried)
    best = np.argmax(found, axis=1)
    lost = np.isnan(form.height(x * np.cos(phi), x * np.sin(phi)))
    short = (reach < edge.half) & (lost | (best == 0) | (best == tried.size - 1))
    start, ahead, behind = tried[best], *_beside(tried, best)
    top = found[np.arange(x.size), best]
    if short.any():
        tried = _tried(edge, step, edge.half)
        found = _gaps(form, x[short, None], phi[short, None], edge, tried)
        again = np.argmax(found, axis=1)
        best = best.copy()
        best[short] = again
        start[short], top[short] = tried[again], found[np.arange(again.size), again]
        ahead[short], behind[short] = _beside(tried, again)
    psi, border = _refined(form, x, phi, edge, start, ahead, behind)
    px, py, pz = edge.point(psi)
    c, s = np.cos(phi), np.sin(phi)
    height, slopes, _ = form.expansion(
        (x + px) * c - py * s, (x + px) * s + py * c, [], slopes=True
    )
    if slopes is None:  # pragma: no cover - slopes=True promises them
        raise DataError(f"{form.name} gives no slopes")
    z = np.where(np.isneginf(top), np.nan, height - pz)
    rho = np.copysign(np.hypot(x + px, py), x + px)
    theta = phi + np.arctan(py / np.where(x + px == 0.0, math.inf, x + px))
    rows = (z, psi, rho, theta, c * slopes[0] + s * slopes[1], c * slopes[1] - s * slopes[0])
    # the last angle of a whole nose is vertical: no slope reaches it
    return np.stack(rows), edge.half - np.abs(psi) <= _CLOSE, border & ~np.isnan(z)


def _tried(edge: Edge, step: float, reach: float) -> FloatArray:
    n = max(4, math.ceil(reach * edge.radius / step))
    return np.linspace(-reach, reach, 2 * n + 1)


def _beside(tried: FloatArray, best: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    return tried[np.minimum(best + 1, tried.size - 1)], tried[np.maximum(best - 1, 0)]


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
    c, s = np.cos(phi), np.sin(phi)
    lean = edge.sign * math.sin(edge.rake)

    def rise(psi: FloatArray) -> FloatArray:
        # (1/R) dF/dpsi = sX cos psi - sin psi (cos gamma + sigma sY sin gamma)
        px, py, _ = edge.point(psi)
        tx, ty = form.slopes((x + px) * c - py * s, (x + px) * s + py * c)
        sx, sy = c * tx + s * ty, c * ty - s * tx
        return sx * np.cos(psi) - np.sin(psi) * (math.cos(edge.rake) + lean * sy)

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
        px, py, _ = self._edge.point(found.psi)
        # dZ/dX = sX and dZ/dphi = (X + x) sY - y sX, by the envelope theorem
        turn = (found.X + px) * found.along_y - py * found.along_x
        with np.errstate(divide="ignore", invalid="ignore"):
            across = np.where(found.X == 0.0, found.along_y, turn / found.X)
        c, s = np.cos(found.azimuth), np.sin(found.azimuth)
        along = found.along_x
        return (c * along - s * across).reshape(shape), (s * along + c * across).reshape(shape)

    def _tips(self, x: ArrayLike, y: ArrayLike) -> tuple[TipPath, tuple[int, ...]]:
        xs, ys = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        rho, phi = np.hypot(xs, ys).ravel(), np.arctan2(ys, xs).ravel()
        return tips(self._form, rho, phi, self._edge, strict=True), xs.shape

"""Whether a nose fits a surface: hollows along rho, descent along the cut, the sharp window.

Slopes are dz/drho at constant azimuth, and (1/rho) dz/dtheta along the cut; z points out of the
material. Each check says where it is worst, whether or not it fails.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, LimitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import Frozen
from metrosep.process._setting_equations import bent, known_form, polar_gradient
from metrosep.process.nose import RoundNose, Sense, checked_nose, smallest_length
from metrosep.process.setting_maps import map_extent, polar_axes
from metrosep.process.tips import Edge, tips

Travel = Literal["growing", "falling", "both"]

_MOST, _USUAL, _FEWEST_AZIMUTHS = 5_000_000, 300_000, 12
"""Points of a mesh at most, and where 12 azimuths are enough to stay below."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Share of the azimuth step by which each radius is turned: no two come to lie on a line."""
_BLOCK = 1 << 17
_SECTORS, _MOST_HOLLOWS, _SEARCHED = 12, 12, 2
"""Of a turn, hollows that are looked at for what stays in them, and those whose deepest azimuth is sought."""
_TIPS, _LEVELS, _PER_RADIUS = 17, 4, 80
"""Tips between which the contact jumps, each level 16 times closer; samples of the edge for them."""
_MOST_TURNS, _CLOSEST = 10, 2.5e-3
"""Steps about the axis to the deepest azimuth, down to that of the nose radius."""
_HALVINGS, _SETTLED = 20, 0.01
"""Of the step of a derivative, from 1e-3 R down, until half of it agrees within 1 %."""


@dataclass(frozen=True, slots=True)
class NoseCheck(Frozen):
    """Whether a nose fits a surface, and where it fits worst.

    Parameters
    ----------
    ok : bool
        Whether it fits everywhere on the mesh.
    worst, limit : float
        The value at the worst place and what is allowed; m for curvature, rad for angles.
    unit : str
        Of both.
    rho, theta : float
        Worst place on the workpiece, m and rad.
    n_bad : int
        Points of the mesh that do not fit.
    messages : tuple of str
        In plain words.
    audit : mapping
        Mesh and nose.
    left : float, m
        Greatest height that stays where the nose cannot reach; 0 where it fits. With rake the greater of
        both ways of the tool.
    step : float, m
        Radial step of the mesh; NaN where hollows are not what is checked.

    Examples
    --------
    >>> from metrosep.forms import Sphere
    >>> gouge_check(Sphere(R=0.5e-3), RoundNose(1e-3), radius=0.2e-3).ok
    False
    """

    ok: bool
    worst: float
    limit: float
    unit: str
    rho: float
    theta: float
    n_bad: int
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)
    left: float = 0.0
    step: float = math.nan

    def require(self) -> None:
        """Raise the first message as an error unless the nose fits.

        Raises
        ------
        LimitError
            If it does not.
        """
        if not self.ok:
            raise LimitError(self.messages[0])


def gouge_check(
    form: Form,
    nose: RoundNose,
    *,
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    n_rho: int | None = None,
    n_theta: int | None = None,
) -> NoseCheck:
    """Return whether the nose fits into every hollow of the surface along rho.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    nose : RoundNose
        Radius and rake.
    radius : float, m, optional
        Of the workpiece; 500 um with a message if neither it nor a region is given.
    region : tuple of (float, float), m, optional
        Inner and outer radius instead.
    n_rho, n_theta : int, optional
        Of the mesh that is searched; by default from the nose and the form, see Notes.

    Returns
    -------
    NoseCheck
        ``worst`` is the concave radius of curvature at the worst place (infinite without hollows),
        ``limit`` the tip radius of the projected nose, ``left`` the greatest height that stays above
        the surface where the nose cannot reach it, ``step`` the radial step of the mesh. A mesh
        that is coarser than a quarter of the smallest length of the form is not ok.

    Raises
    ------
    DataError
        If the form or the region is not usable, or nothing is defined.
    TooFewSamplesError
        If the mesh has too few points.
    UnitError
        If the radius cannot be in metres.

    Notes
    -----
    The edge touches along a line where ``z_rr < e''``, with ``e'' = (c^2 + z_r^2)^(3/2) / (R c^2)``
    and ``c = cos(rake) +- z_t sin(rake)`` for the two ways of the tool, z_t the slope along the cut;
    the worse of both counts. Where that holds everywhere the nose touches nowhere else, however far:
    the slope of the nose outruns that of the surface on both sides of the contact.

    z_rr is taken twice. A central difference of the slopes, with a step of a thousandth of the nose
    radius, halved until half of it agrees; and the difference of the slopes over each radial step,
    which no kink between two points can escape. The radial step is R/40 or less, and an eighth of
    the smallest lateral length where the form knows one (period, pixel), up to five million points;
    azimuths are at least 12 and turn by the golden angle from radius to radius. What is
    narrower lies between two points and is not seen; the messages say how wide that is for a form
    that does not repeat. NaN (off the surface) is omitted with a message.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> round(gouge_check(grid, RoundNose(1e-3), radius=500e-6).worst * 1e3, 2)
    5.07
    """
    form = known_form(form)
    checked_nose(nose)
    inner, outer, said = map_extent(radius, region)
    length = smallest_length(form)
    n_rho, n_theta = _fine_mesh(outer - inner, nose, length, n_rho, n_theta)
    rho, theta = polar_axes((inner, outer), n_rho, n_theta)
    step = (outer - inner) / (n_rho - 1)
    theta += (np.mod(_GOLDEN * np.arange(n_rho), 1.0) * 2.0 * math.pi / n_theta)[:, None]
    rho, theta = rho.ravel(), theta.ravel()
    blocks = [slice(k, k + _BLOCK) for k in range(0, rho.size, _BLOCK)]
    share = np.concatenate([_share(form, nose, rho[k], theta[k], step) for k in blocks])
    known = _defined(share, rho, form, said)
    at = int(np.nanargmax(np.where(known, share, np.nan)))
    where, hollow, resolved = _sharpest(form, float(rho[at]), float(theta[at]), step)
    worst = 1.0 / hollow if hollow > 0.0 else math.inf
    bad = int(np.count_nonzero(share[known] >= 1.0))
    coarse = step > 0.25 * length
    left = 0.0
    place: list[float] = []
    if bad:
        shape = n_rho, n_theta
        mesh = rho.reshape(shape), theta.reshape(shape), share.reshape(shape)
        left, *place = _left(form, nose, mesh, step)
        size = format_length(worst) if resolved else "0 (a kink)"
        first = (
            f"the nose gouges: its tip radius {format_length(nose.tip_radius)} is larger than the "
            f"concave radius {size} of the {form.name} at {_place(where, theta[at])} ({bad} points "
            f"of the mesh); a path that gouges nothing leaves up to {format_length(left)}, at "
            f"{_place(*place)}; take a smaller nose"
        )
        said.insert(0, first)
    elif coarse:
        first = (
            f"not judged: the radial step of the mesh, {format_length(step)}, is more than a quarter "
            f"of the smallest length of the {form.name}, {format_length(length)}; give a larger "
            "n_rho, or a narrower region"
        )
        said.insert(0, first)
    elif form.period is None:
        arc = 2.0 * math.pi * outer / n_theta
        said.append(
            f"hollows narrower than {format_length(step)} along rho, or than {format_length(arc)} "
            "along the cut, may not be seen"
        )
    audit = {**_audit(form, nose, (inner, outer), n_rho, n_theta), "step_um": step * 1e6}
    if place:
        audit |= {"left_at_rho_um": place[0] * 1e6, "left_at_azimuth_deg": math.degrees(place[1])}
    return NoseCheck(
        not (bad or coarse), worst, nose.tip_radius, "m", where, float(theta[at]), bad, tuple(said),
        audit, left, step,
    )  # fmt: skip


def _fine_mesh(
    extent: float, nose: RoundNose, length: float, n_rho: int | None, n_theta: int | None
) -> tuple[int, int]:
    """Return radii and azimuths that see hollows as wide as the step, as many as are affordable."""
    if n_rho is None:
        usual = max(extent / 2000.0, nose.radius / 400.0)
        step = min(nose.radius / 40.0, length / 8.0, usual)
        n_rho = min(math.ceil(extent / step), _MOST // _FEWEST_AZIMUTHS) + 1
    if n_theta is None:
        n_theta = min(360, max(_FEWEST_AZIMUTHS, _USUAL // numbers.count(n_rho, "n_rho", least=2)))
    return n_rho, n_theta


def _share(
    form: Form, nose: RoundNose, rho: FloatArray, theta: FloatArray, step: float
) -> FloatArray:
    """Return z_rr over what the nose has there, the worse of both ways of the tool."""
    slope, across = polar_gradient(form, rho, theta)
    h = 1e-3 * nose.radius
    second, open_ = bent(form, rho, theta, h), np.arange(rho.size)
    for _ in range(_HALVINGS):
        h *= 0.5
        finer = bent(form, rho[open_], theta[open_], h)
        change = finer - second[open_]
        settled = ~(np.abs(change) > _SETTLED * np.maximum(np.abs(finer), _SETTLED / nose.radius))
        # the error of a central difference falls by four with half the step
        second[open_] = np.where(settled, finer + change / 3.0, finer)
        open_ = open_[~settled]
        if not open_.size:
            break
    second = np.maximum(second, bent(form, rho, theta, step))
    own = [Edge.of(nose, way).own_curvature(slope, across) for way in get_args(Sense)]
    return np.asarray(second / np.min(own, axis=0))


def _sharpest(form: Form, rho: float, theta: float, step: float) -> tuple[float, float, bool]:
    """Return place and size of the largest concave curvature within a step, and whether it settles."""
    width, last, settled = step, -math.inf, 0
    for _ in range(_HALVINGS + 20):
        width *= 0.5
        tried = rho + width * np.array([-0.5, 0.0, 0.5])
        angle = np.full(3, theta)
        slope = polar_gradient(form, tried, angle)[0]
        found = bent(form, tried, angle, width) / np.hypot(1.0, slope) ** 3
        if np.isnan(found).all():
            return rho, max(last, 0.0), True
        best = int(np.nanargmax(found))
        rho, now = float(tried[best]), float(found[best])
        settled = settled + 1 if abs(now - last) <= 1e-6 * abs(now) else 0
        last = now
        if settled == 2 or now <= 0.0:
            break
    return rho, last, settled == 2 or last <= 0.0


def _left(
    form: Form, nose: RoundNose, mesh: tuple[FloatArray, FloatArray, FloatArray], step: float
) -> tuple[float, float, float]:
    """Return the greatest height that stays when the tool cuts nothing of the surface, m, and its place."""
    rho, theta, share = mesh
    at = _hollows(share, step, nose)
    rho, theta = rho.ravel()[at], theta.ravel()[at]
    best = (0.0, float(rho[0]), float(theta[0]))
    turn = 2.0 * math.pi / share.shape[1]
    ways = get_args(Sense) if nose.needs_sense else get_args(Sense)[:1]
    for edge in (Edge.of(nose, way) for way in ways):
        found = _bridged(form, edge, rho, theta)
        chosen = np.argsort(-found[0])[:_SEARCHED]
        found, width = found[:, chosen], np.full(chosen.size, turn)
        for _ in range(_MOST_TURNS):
            around = found[2] + np.outer([-1.0, -0.5, 0.5, 1.0], width)
            beside = np.tile(found[1], 4)
            made = _bridged(form, edge, beside, around.ravel()).reshape(3, 4, -1)
            top = np.argmax(made[0], axis=0)
            made = made[:, top, np.arange(top.size)]
            higher = made[0] > found[0]
            found = np.where(higher, made, found)
            width = np.where(higher, width, 0.25 * width)
            if not (width * found[1] > _CLOSEST * edge.radius).any():
                break
        best = max(best, *zip(*found.tolist(), strict=True))
    return best


def _hollows(share: FloatArray, step: float, nose: RoundNose) -> NDArray[np.intp]:
    """Return mesh points amid the hollows that leave most: by width, and by what is missing to the nose."""
    n_rho, n_theta = share.shape
    excess = np.zeros((n_theta, n_rho + 1))  # each azimuth ends with a point that fits
    excess[:, :-1] = np.fmax(share.T - 1.0, 0.0)
    inside = np.concatenate([[False], excess.ravel() > 0.0, [False]])
    if not inside.any():  # a share of exactly 1
        return np.array([np.nanargmax(share)])
    turns = np.diff(inside.astype(np.int8))
    begin, end = np.flatnonzero(turns == 1), np.flatnonzero(turns == -1)
    total = np.concatenate([[0.0], np.cumsum(excess.ravel())])
    score = (total[end] - total[begin]) * (end - begin)
    column, row = np.divmod((begin + end - 1) // 2, n_rho + 1)
    cells: dict[tuple[int, int], int] = {}
    wide = max(1, round(0.25 * nose.radius / step)), max(1, n_theta // _SECTORS)
    for k in np.argsort(-score, kind="stable"):
        cells.setdefault(
            (int(row[k]) // wide[0], int(column[k]) // wide[1]), int(row[k] * n_theta + column[k])
        )
        if len(cells) == _MOST_HOLLOWS:
            break
    return np.array(list(cells.values()))


def _bridged(form: Form, edge: Edge, rho: FloatArray, theta: FloatArray) -> FloatArray:
    """Return the greatest height under the edge that bridges hollows at places, and where: rows m, m, rad.

    The lowest tips that cut nothing touch on one side of a hollow, or on the other; where the contact
    jumps the edge stands on both, and no other passes lower between.
    """
    slope, across = polar_gradient(form, rho, theta)
    x, y, _ = edge.point(np.arctan2(slope, edge.up + edge.lean * across))
    phi = theta - np.arctan2(y, rho)
    low, high = rho - x - edge.radius, rho - x + edge.radius
    shares = np.linspace(0.0, 1.0, _TIPS)
    row, step = np.arange(rho.size), edge.radius / _PER_RADIUS
    k, lost, best = row, row < 0, np.zeros((3, rho.size))
    X, made = low[:, None], None
    for level in range(_LEVELS):
        X = low[:, None] + np.outer(high - low, shares)
        made = tips(form, X.ravel(), np.repeat(phi, _TIPS), edge, strict=False, step=step)
        touched = made.rho.reshape(X.shape)
        if level:
            jump = np.diff(touched, axis=1)
        else:
            jump = np.where(
                (touched[:, :-1] < rho[:, None]) & (touched[:, 1:] > rho[:, None]), 1.0, 0.0
            )
        k = np.argmax(np.where(np.isnan(jump), 0.0, jump), axis=1)
        lost = ~(jump[row, k] > 0.0)
        low, high = X[row, k], X[row, k + 1]
    assert made is not None  # noqa: S101  # there is a level
    z, rise, psi = (v.reshape(X.shape) for v in (made.z, made.along_x, made.psi))
    (za, zb), (sa, sb) = ((v[row, k], v[row, k + 1]) for v in (z, rise))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.clip((za - zb + sb * (high - low)) / ((sb - sa) * (high - low)), 0.0, 1.0)
    X0 = low + np.where(np.isnan(share), 0.5, share) * (high - low)
    stands = tips(form, X0, phi, edge, strict=False, step=step).z
    begin, end = psi[row, k], psi[row, k + 1]
    for _ in range(3):
        at = begin + np.outer(shares, end - begin)
        ex, ey, ez = edge.point(at)
        c, s = np.cos(phi), np.sin(phi)
        px, py = (X0 + ex) * c - ey * s, (X0 + ex) * s + ey * c
        under = stands + ez - form.height(px.ravel(), py.ravel()).reshape(px.shape)
        k = np.argmax(np.where(np.isnan(under), -np.inf, under), axis=0)
        best = np.stack([v[k, row] for v in (under, np.hypot(px, py), np.arctan2(py, px))])
        begin, end = at[np.maximum(k - 1, 0), row], at[np.minimum(k + 1, _TIPS - 1), row]
    # the azimuth near that of the place, so that steps about it stay small
    best[2] = theta + np.remainder(best[2] - theta + math.pi, 2.0 * math.pi) - math.pi
    best[0, lost | np.isnan(best[0])] = 0.0
    return np.where(np.isnan(best), np.stack([rho, rho, theta]), best)


@described_by(gouge_check)
def clearance_check(
    form: Form,
    nose: RoundNose,
    *,
    travel: Travel = "both",
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    n_rho: int = 401,
    n_theta: int = 360,
) -> NoseCheck:
    """Return whether the flank clears the surface where the tool goes down along the cut.

    Parameters
    ----------
    travel : {"growing", "falling", "both"}, optional
        Whether the tool runs towards growing or falling azimuth of the workpiece.
    n_rho, n_theta : int, optional
        Of the mesh that is searched.

    Returns
    -------
    NoseCheck
        ``worst`` is the steepest descent along the cut and ``limit`` the clearance angle, rad.

    Raises
    ------
    DataError
        If the nose has no clearance angle, or the direction is unknown; else as of `gouge_check`.

    Notes
    -----
    Descent is ``-sigma sY``, with ``sY = (1/rho) dz/dtheta`` and sigma = +1 towards growing azimuth. The
    flank lies behind the edge, over what was just cut, so it rubs where the surface falls more steeply
    than it: a cylindrical flank where ``tan(clearance) <= -sigma sY``, a conical one where
    ``tan(clearance) sqrt(c^2 + sX^2) <= -sigma sY``, ``c = kz + sigma sY ky``. A flank is long: its
    heel may touch a hollow that its beginning clears.

    Examples
    --------
    >>> import math
    >>> from metrosep.forms import SineGrid
    >>> nose = RoundNose(1e-3, clearance=math.radians(10))
    >>> clearance_check(SineGrid(amplitude=50e-9, wavelength=100e-6), nose, radius=500e-6).ok
    True
    """
    checked_nose(nose)
    if nose.clearance is None:
        raise DataError("the nose has no clearance angle: give RoundNose(..., clearance=...)")
    numbers.choice(travel, "travel", get_args(Travel))
    form, rho, theta, said, audit = _mesh(form, nose, radius, region, n_rho, n_theta)
    slope, along = polar_gradient(form, rho, theta)
    up, lean = nose.tilt
    ways = {"both": (1.0, -1.0), "growing": (1.0,), "falling": (-1.0,)}[travel]
    falls = []
    for way in ways:
        normal = np.hypot(up + way * lean * along, slope) if nose.flank == "conical" else 1.0
        falls.append(-way * along / normal)
    descent = np.max(falls, axis=0)
    known = _defined(descent, rho, form, said)
    return _steepest(
        np.arctan(descent), known, rho, theta, nose.clearance, said, {**audit, "travel": travel},
        f"the flank rubs on the {form.name}: it falls along the cut by", "its clearance",
    )  # fmt: skip


@described_by(clearance_check)
def window_check(
    form: Form,
    nose: RoundNose,
    *,
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    n_rho: int = 401,
    n_theta: int = 360,
) -> NoseCheck:
    """Return whether the surface touches the nose only where it is sharp.

    Returns
    -------
    NoseCheck
        ``worst`` is the angle on the nose of the furthest contact and ``limit`` half the window, rad.

    Raises
    ------
    DataError
        If the nose has no window; else as of `gouge_check`.

    Notes
    -----
    The contact lies at ``tan(psi) = z_r / (kz +- z_t ky)``, with rake further round the nose than the
    slope; the worse of both ways of the tool counts. Yaw is omitted; `tip_path` has it.

    Examples
    --------
    >>> import math
    >>> from metrosep.forms import Sphere
    >>> nose = RoundNose(0.2e-3, window=math.radians(60))
    >>> window_check(Sphere(R=5e-3), nose, radius=3e-3).ok
    False
    """
    checked_nose(nose)
    if nose.window is None:
        raise DataError("the nose has no window: give RoundNose(..., window=...)")
    form, rho, theta, said, audit = _mesh(form, nose, radius, region, n_rho, n_theta)
    slope, across = polar_gradient(form, rho, theta)
    known = _defined(slope, rho, form, said)
    up, lean = nose.tilt
    psi = np.arctan2(slope, up - np.abs(across * lean))
    low, high = nose.limits
    share = np.where(known, psi / np.where(psi > 0.0, high, low), 0.0)
    limit = high if psi[int(np.argmax(share))] > 0.0 else -low
    angle = np.where(known, share * limit, np.nan)
    return _steepest(
        angle, known, rho, theta, limit, said, audit,
        f"the {form.name} touches the nose beyond its window: the contact lies at",
        "half the window" if -low == high else "the window ends at",
    )  # fmt: skip


def _steepest(
    angle: FloatArray,
    known: NDArray[np.bool_],
    rho: FloatArray,
    theta: FloatArray,
    limit: float,
    said: list[str],
    audit: dict[str, Any],
    what: str,
    against: str,
) -> NoseCheck:
    at = int(np.nanargmax(np.where(known, angle, np.nan)))
    worst = float(angle[at])
    bad = int(np.count_nonzero(angle[known] >= limit))
    if bad:
        said.insert(
            0,
            f"{what} {math.degrees(worst):.4g} degrees at {_place(rho[at], theta[at])}, "
            f"{against} is {math.degrees(limit):.4g} degrees ({bad} points of the mesh)",
        )
    where = float(rho[at]), float(theta[at])
    return NoseCheck(not bad, worst, limit, "rad", *where, bad, tuple(said), audit)


def _mesh(
    form: Form,
    nose: RoundNose,
    radius: float | None,
    region: tuple[float, float] | None,
    n_rho: int,
    n_theta: int,
) -> tuple[Form, FloatArray, FloatArray, list[str], dict[str, Any]]:
    form = known_form(form)
    checked_nose(nose)
    inner, outer, said = map_extent(radius, region)
    rho, theta = polar_axes((inner, outer), n_rho, n_theta)
    audit = _audit(form, nose, (inner, outer), n_rho, n_theta)
    return form, rho.ravel(), theta.ravel(), said, audit


def _audit(
    form: Form, nose: RoundNose, region: tuple[float, float], n_rho: int, n_theta: int
) -> dict[str, Any]:
    return {
        "form": repr(form),
        "nose_radius_mm": nose.radius * 1e3,
        "rake_deg": math.degrees(nose.rake),
        "inner_um": region[0] * 1e6,
        "outer_um": region[1] * 1e6,
        "n_rho": n_rho,
        "n_theta": n_theta,
    }


def _defined(
    values: FloatArray, rho: FloatArray, form: Form, said: list[str]
) -> NDArray[np.bool_]:
    """Return where values are known, and say how many are not."""
    known = np.isfinite(values)
    if not known.any():
        raise DataError(f"the {form.name} is not defined anywhere on the region")
    if not known.all():
        first = format_length(float(rho[~known][0]))
        said.append(
            f"{int(np.count_nonzero(~known))} points are not judged because the {form.name} is not "
            f"defined there, the first at rho = {first}"
        )
    return known


def _place(rho: float, theta: float) -> str:
    return f"rho = {format_length(float(rho))}, azimuth {math.degrees(theta):.4g} degrees"

"""Corrections of a tool path: what is added to Z (and X) at the position (X, C) of a block.

Sign: error e = actual - nominal, positive where the part is too high (z out of the material); the
correction c = -e is added to the commanded Z. `error_correction` turns a measured error over; a
table, a compensation map or a function given as it is holds corrections already.

Part coordinates: the point under the tool at radius X (signed) and spindle angle C is
x = X cos(s C + C0), y = X sin(s C + C0), with s = `c_sense` = +1 or -1 and C0 = `c_zero`. The sense
is a property of the machine and of how the map was placed: a wrong one mirrors the correction.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.table import CompensationTable
from metrosep.controllers.gcode.contact import Lookup, NosePath, RadialForm
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface


@dataclass(frozen=True, slots=True)
class PathCorrection:
    """What is added to a path.

    Parameters
    ----------
    z : callable
        Returns the amount to add to Z in m, from X (radius, signed, m) and C (rad), equally long
        arrays; NaN where nothing was measured, infinite beyond the map.
    x : callable or None
        The same for X (radius, m); None where X is left alone.
    needs_c : bool
        Whether C matters; if not, C may be absent in the path.
    pitch : float or None, m
        Distance on the part over which the correction may bend; for densification.
    held : callable or None
        As `z`, but beyond the map the value at its edge; None where that is not known.
    audit : mapping
        Origin: kind, hash, sign convention, sense and zero of C; goes into the sidecar.
    reach : str
        How far what was measured reaches from the spindle axis, for messages; empty if unknown.
    nose : NosePath or None
        The path that the nose has over the nominal form, which Z of a program is compared with.
    """

    z: Lookup
    x: Lookup | None = None
    needs_c: bool = True
    pitch: float | None = None
    held: Lookup | None = None
    audit: Mapping[str, Any] = field(default_factory=dict)
    reach: str = ""
    nose: NosePath | None = None


class _Area(Protocol):
    def correction(self, x: ArrayLike, y: ArrayLike) -> FloatArray: ...


def error_correction(
    error: Surface | Profile | Callable[..., ArrayLike],
    *,
    c_sense: int = 1,
    c_zero: float = 0.0,
    centre: tuple[float, float] | Literal["middle"] = (0.0, 0.0),
    slope: Callable[[FloatArray, FloatArray], ArrayLike] | None = None,
    move_x: bool = False,
    nose: float | str = 0.0,
    form: RadialForm | None = None,
) -> PathCorrection:
    """Return the correction c = -e of a measured error of the part.

    Parameters
    ----------
    error : Surface, Profile or callable
        e = actual - nominal in m: a map over part coordinates (x, y);
        a profile over the radius X (signed as in the path), the same at every C; or a function
        e(x, y) of part coordinates in m.
    c_sense : {1, -1}, optional
        +1 if the point under the tool moves to larger polar angle of the map when C rises.
    c_zero : float, rad, optional
        Polar angle of the map under the tool at C = 0.
    centre : tuple of (float, float), m, or "middle", optional
        Where the spindle axis is in the coordinates of the map.
    slope : callable, optional
        dz/dX of the nominal form from (X in m, C in rad), dimensionless, if `error` was measured
        along the normal of the surface; None if along z.
    move_x : bool, optional
        With `slope`: shift the tool along the normal, X as well as Z.
    nose : float, m, optional
        Radius of the nose, where the path is that of its tip (its lowest point, under its centre; no imaginary
        corner) or centre: the error is looked up where the nose touches `form`. 0 for points of the surface.
    form : Form, optional
        Nominal form about the spindle axis, needed with `nose`.

    Returns
    -------
    PathCorrection
        Bilinear between the points of a map, linear between those of a profile. What was not
        measured and reaches the border of a map is beyond the map; gaps within it stay NaN.

    Raises
    ------
    DataError
        If `c_sense` is neither 1 nor -1, `c_zero` or `centre` is not finite, `move_x` is asked for without a
        slope, `nose` is below zero, has no form or goes with `slope`, or `error` is none of these.
    InvalidSamplesError
        If a map has no lateral step, fewer than two rows or columns, or no value at all.

    Notes
    -----
    With t = atan(dz/dX) the normal out of the material is (-sin t, cos t). Moving Z alone by c_z
    moves the surface along its normal by c_z cos t, hence c_z = -e_n / cos t. Moving both,
    (c_x, c_z) = -e_n (-sin t, cos t). A slope around the circumference is not taken into account:
    Z alone then lacks a second-order part, e_n (dz/(r dC))^2 / 2.

    A nose of radius r touches the part at X_c where its tip or centre stands at X = X_c - r sin t(X_c).
    Looked up at X, an error of wavelength w would leave 2 pi r sin t / w of itself.

    Examples
    --------
    >>> import numpy as np
    >>> tilt = Surface([[0.0, 2e-9], [0.0, 2e-9]], dx=2e-3, dy=2e-3, origin=(-1e-3, -1e-3))
    >>> c = error_correction(tilt)
    >>> (1e9 * c.z(np.array([0.5e-3, 0.5e-3]), np.array([0.0, np.pi]))).round(6).tolist()
    [-1.5, -0.5]
    """
    c_zero = _checked_sense(c_sense, c_zero)
    if move_x and slope is None:
        raise DataError("to move X the slope of the form is needed; give slope=")
    lookup, edge, audit, pitch, around = _error_lookup(error)

    def placed(found: Lookup) -> Lookup:
        def at(x: FloatArray, c: FloatArray) -> FloatArray:
            if not around:
                return found(x, c)
            angle = c_sense * c + c_zero
            return found(x * np.cos(angle) + middle[0], x * np.sin(angle) + middle[1])

        return at

    middle = _centre(error, centre)
    nose = numbers.not_negative(nose, "nose", dimension="length")
    path = None
    made = (placed(lookup), None if edge is None else placed(edge))
    if nose > 0.0:
        if form is None or slope is not None:
            raise DataError(
                "nose goes with form, the nominal form of the part, and not with slope"
            )
        path = NosePath(form, nose, c_sense if around else 0, c_zero if around else 0.0)
        own, held_at = made
        made = (path.at(own), None if held_at is None else path.at(held_at, own))

    audit |= {
        "sign": "error e = actual - nominal; correction c = -e is added to Z",
        "normal_to_surface": slope is not None,
    }
    if nose > 0.0:
        audit |= {"nose_m": nose, "form": repr(form)}
    if around:
        audit |= {"c_sense": c_sense, "c_zero_rad": float(c_zero), "centre_m": list(middle)}
    if slope is None:
        held = None if made[1] is None else _negated(made[1])
        z = _negated(made[0])
        correction = PathCorrection(z, needs_c=around, pitch=pitch, held=held, audit=audit)
    else:
        correction = nose_correction(
            made[0], slope, move_x=move_x, needs_c=around, pitch=pitch, audit=audit
        )
    return replace(correction, reach=_reach(error, middle), nose=path)


def _reach(error: object, middle: tuple[float, float]) -> str:
    """Return how far the measured area of a map reaches from the spindle axis, as a clause."""
    if not isinstance(error, Surface):
        return ""
    measured = np.isfinite(error.z)
    ends = [
        [1e3 * (step * k + start - at) for k in np.flatnonzero(measured.any(axis=axis))[[0, -1]]]
        for axis, step, start, at in zip(
            (0, 1),
            cast("tuple[float, float]", (error.dx, error.dy)),
            error.origin,
            middle,
            strict=True,
        )
    ]
    (x0, x1), (y0, y1) = ends
    text = (
        f"it was measured from {x0:.5g} to {x1:.5g} mm in x and {y0:.5g} to {y1:.5g} mm in y of the "
        "spindle axis"
    )
    if any(abs(low + high) > (high - low) / 2 for low, high in ends):
        text += "; if the axis is in the middle of the map, say centre='middle'"
    return text


def _centre(error: object, centre: tuple[float, float] | Literal["middle"]) -> tuple[float, float]:
    if isinstance(centre, str):
        if centre != "middle":
            raise DataError(f"centre is {centre!r}; give (x, y) in m or 'middle'")
        if not isinstance(error, Surface) or error.dx is None or error.dy is None:
            raise DataError("only a map has a middle; give centre=(x, y) in m")
        rows, columns = error.shape
        return (
            error.origin[0] + (columns - 1) * error.dx / 2,
            error.origin[1] + (rows - 1) * error.dy / 2,
        )
    if not all(math.isfinite(v) for v in centre):
        raise DataError(f"centre is {centre!r}; give (x, y) in m or 'middle'")
    return float(centre[0]), float(centre[1])


def _negated(error: Lookup) -> Lookup:
    return lambda x, c: -error(x, c)


def nose_correction(
    error: Lookup,
    slope: Callable[[FloatArray, FloatArray], ArrayLike],
    *,
    move_x: bool = False,
    needs_c: bool = True,
    pitch: float | None = None,
    audit: Mapping[str, Any] | None = None,
) -> PathCorrection:
    """Return the correction of an error that was measured along the normal of the surface.

    Parameters
    ----------
    error : callable
        e_n in m from (X in m, C in rad).
    slope : callable
        dz/dX of the nominal form at the same place.
    move_x : bool, optional
        Move X too, along the normal.
    needs_c : bool, optional
        Whether C matters.
    pitch : float, m, optional
        Distance over which the error may bend.
    audit : mapping, optional
        Origin.

    Returns
    -------
    PathCorrection
        c_z = -e_n / cos t alone, or c_z = -e_n cos t with c_x = e_n sin t, t = atan(slope).

    Notes
    -----
    See `error_correction`. The specification's pair c_z = -e_n / cos t with c_x = -e_n sin t moves
    the surface by -e_n cos 2t of what is wanted, plus a part along the surface: it holds only
    where t is small.

    Examples
    --------
    >>> import numpy as np
    >>> c = nose_correction(lambda x, c: np.full(x.size, 1e-9), lambda x, c: np.ones(x.size))
    >>> float(round(c.z(np.zeros(1), np.zeros(1))[0] * 1e9, 6))
    -1.414214
    """

    def steep(x: FloatArray, c: FloatArray) -> FloatArray:
        return np.arctan(np.asarray(slope(x, c), dtype=np.float64))

    pitch = None if pitch is None else numbers.positive(pitch, "pitch", dimension="length")
    if not move_x:
        return PathCorrection(
            lambda x, c: -error(x, c) / np.cos(steep(x, c)),
            needs_c=needs_c,
            pitch=pitch,
            audit=dict(audit or {}),
        )
    return PathCorrection(
        lambda x, c: -error(x, c) * np.cos(steep(x, c)),
        x=lambda x, c: np.where(
            np.isfinite(e := error(x, c)), np.nan_to_num(e) * np.sin(steep(x, c)), e
        ),
        needs_c=needs_c,
        pitch=pitch,
        audit=dict(audit or {}),
    )


def as_path_correction(
    correction: object, *, c_sense: int | None = None, c_zero: float | None = None
) -> PathCorrection:
    """Return a correction in the form that a path needs.

    Parameters
    ----------
    correction : PathCorrection, CompensationTable, object with ``correction(x, y)``, or callable
        A table over X, the same in both directions; a map over part coordinates (x, y); or a
        function c(X, C) of X in m and C in rad that returns m. All hold corrections, not errors.
    c_sense, c_zero : int and float, optional
        For a map over part coordinates, as in `error_correction`; refused for everything else,
        which holds its own or needs none.

    Returns
    -------
    PathCorrection
        Itself, if it is one.

    Raises
    ------
    DataError
        If it is an error (a Surface, a Profile), a table or map of another axis or
        direction-dependent, or none of these; if `c_sense` or `c_zero` is given for what is not a map, or
        cannot be.

    Examples
    --------
    >>> import numpy as np
    >>> as_path_correction(lambda x, c: 1e-9 * np.cos(c)).needs_c
    True
    """
    if isinstance(correction, Surface | Profile):
        raise DataError(
            f"a {type(correction).__name__} holds an error, not a correction; give "
            "error_correction(it), which turns the sign over, with c_sense and c_zero"
        )
    is_map = hasattr(correction, "correction") and not isinstance(correction, CompensationTable)
    if not is_map and not (c_sense is None and c_zero is None):
        raise DataError(
            f"c_sense and c_zero are for a map with correction(x, y), not for a {type(correction).__name__}; "
            "what error_correction made holds its own: give them there"
        )
    if isinstance(correction, PathCorrection):
        return correction
    if isinstance(correction, CompensationTable):
        return _of_table(correction)
    if hasattr(correction, "correction"):
        return _of_area(
            cast(_Area, correction),
            1 if c_sense is None else c_sense,
            0.0 if c_zero is None else c_zero,
        )
    if callable(correction):
        return PathCorrection(
            lambda x, c: np.asarray(correction(x, c), dtype=np.float64),
            audit={"kind": "function c(X, C)", "sign": "added to Z as it is"},
        )
    raise DataError(
        f"a {type(correction).__name__} is not a correction; give a table, a map, a function c(X, C) or "
        "error_correction(map of the error)"
    )


def _of_table(table: CompensationTable) -> PathCorrection:
    if table.axis.upper() != "X" or table.compensates.upper() != "Z":
        raise DataError(
            f"the table is for {table.axis} -> {table.compensates}; a path needs X -> Z, or let the "
            "controller carry it"
        )
    if table.reverse is not None and not np.array_equal(table.reverse, table.forward):
        raise DataError(
            "the table has a column for each direction, a path has one point for both; make the table "
            'with direction="both"'
        )
    first, last = table.span

    def held(x: FloatArray, _c: FloatArray) -> FloatArray:
        return table.correction(x)

    def z(x: FloatArray, _c: FloatArray) -> FloatArray:
        found = table.correction(x)
        return np.where((x < first) | (x > last), np.inf, found)

    audit = {
        "kind": "compensation table X -> Z",
        "sign": "correction c = -e is added to Z",
        "sha256": _hash(table.positions, table.forward),
    }
    pitch = float(np.diff(table.positions).min())
    return PathCorrection(z, needs_c=False, pitch=pitch, held=held, audit=audit)


def _of_area(area: _Area, c_sense: int, c_zero: float) -> PathCorrection:
    c_zero = _checked_sense(c_sense, c_zero)
    axes = [str(a).upper() for a in getattr(area, "axes", ("X", "Y"))][:2]
    if axes not in (["X", "Y"], ["X", "C"]):
        raise DataError(
            f"the map is over {' and '.join(axes)}; a path needs one over the part, X and Y, or over X and C"
        )
    moved = str(getattr(area, "compensates", "Z")).upper()
    if moved != "Z":
        raise DataError(f"the map corrects {moved}; a path needs one that corrects Z")
    turning = axes[1] == "C"
    span = getattr(area, "span", None)
    if turning and span is not None and span[1][1] - span[1][0] > _MOST_TURNS * 2.0 * math.pi:
        raise DataError(
            f"the map spans {span[1][1] - span[1][0]:.6g} rad of C, more than {_MOST_TURNS} turns: are its "
            "angles in degrees? they are in rad"
        )

    def places(x: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = c_sense * c + c_zero
        if not turning:
            return x * np.cos(angle), x * np.sin(angle)
        return x, angle if span is None else _within_a_turn(angle, span[1])

    def held(x: FloatArray, c: FloatArray) -> FloatArray:
        found = np.asarray(area.correction(*places(x, c)), dtype=np.float64)
        return found if found.ndim == 0 else found.reshape(x.shape)

    def z(x: FloatArray, c: FloatArray) -> FloatArray:
        at = places(x, c)
        found = held(x, c)
        if span is None:
            return found
        beyond = np.zeros(x.shape, dtype=bool)
        for place, (first, last) in zip(at, span, strict=True):
            room = _EDGE * (last - first)
            beyond |= (place < first - room) | (place > last + room)
        return np.where(beyond, np.inf, found)

    audit: dict[str, Any] = {
        "kind": f"compensation map over {axes[0]} and {axes[1]}",
        "sign": "correction c = -e is added to Z",
        "c_sense": c_sense,
        "c_zero_rad": float(c_zero),
    }
    nodes = [getattr(area, name, None) for name in ("x", "y", "values")]
    if span is None or any(n is None for n in nodes):
        return PathCorrection(z, held=None if span is None else held, audit=audit)
    audit["sha256"] = _hash(*(np.asarray(n, dtype=np.float64) for n in nodes))
    steps = [float(np.diff(np.asarray(n)).min()) for n in nodes[:2]]
    reach = max(abs(v) for v in span[0])
    pitch = min(steps[0], steps[1] * (reach if turning else 1.0))
    return PathCorrection(z, pitch=pitch or None, held=held, audit=audit)


def _within_a_turn(angle: FloatArray, span: tuple[float, float]) -> FloatArray:
    """Return angles in the turn that begins where the map does; a map of several turns as they are."""
    first, last = span
    if last - first > 2.0 * math.pi * (1.0 + _EDGE):
        return angle
    turned = np.mod(angle - first, 2.0 * math.pi)
    # rounding must not put the first place of the map at the end of the turn, beyond a partial one
    return np.asarray(first + np.where(turned > 2.0 * math.pi * (1.0 - _EDGE), 0.0, turned))


def _checked_sense(c_sense: int, c_zero: float) -> float:
    """Return the angle at C = 0, both being right."""
    if c_sense not in (1, -1):
        raise DataError(f"c_sense is {c_sense!r}; it is 1 or -1")
    return numbers.quantity(c_zero, "c_zero", "angle")


def _error_lookup(
    error: object,
) -> tuple[Lookup, Lookup | None, dict[str, Any], float | None, bool]:
    """Return lookup, lookup held at the edge, origin, pitch, and whether it is over the part."""
    if isinstance(error, Surface):
        if error.dx is None or error.dy is None:
            raise InvalidSamplesError(
                "the map has no lateral step, so nobody knows where its points lie on the part; give "
                "its steps when it is read"
            )
        if min(error.shape) < 2:
            raise InvalidSamplesError(f"a map of {error.shape} points; at least 2 x 2 are needed")
        if not np.isfinite(error.z).any():
            raise InvalidSamplesError("the map holds no measured value")
        audit = {
            "kind": "map of the error over part coordinates",
            "sha256": _hash(error.z, np.array([error.dx, error.dy, *error.origin])),
            "shape": list(error.shape),
            "pv_m": error.peak_to_valley(),
        }
        return _bilinear(error), _bilinear(error, hold=True), audit, min(error.dx, error.dy), True
    if isinstance(error, Profile):
        error.require_metres()
        x, z = np.asarray(error.x), np.asarray(error.z)
        good = np.isfinite(z)
        if np.count_nonzero(good) < 2:
            raise InvalidSamplesError("the profile holds fewer than two measured values")
        audit = {"kind": "profile of the error over X", "sha256": _hash(x, z)}
        ends = np.flatnonzero(good)[
            [0, -1]
        ]  # unmeasured ends are beyond the profile, gaps are not
        x, z = x[ends[0] : ends[1] + 1], z[ends[0] : ends[1] + 1]
        return _linear(x, z, np.inf, np.inf), _linear(x, z), audit, float(np.diff(x).min()), False
    if callable(error):
        return (
            lambda x, y: np.asarray(error(x, y), dtype=np.float64),
            None,
            {"kind": "function e(x, y) of part coordinates"},
            None,
            True,
        )
    raise DataError(
        f"a {type(error).__name__} is not a map of an error; give a Surface, a Profile or a function e(x, y)"
    )


def _linear(
    x: FloatArray, z: FloatArray, left: float | None = None, right: float | None = None
) -> Lookup:
    """Return the interpolation of a profile: infinite outside, NaN beside a gap."""

    def at(place: FloatArray, _c: FloatArray) -> FloatArray:
        return np.asarray(np.interp(place, x, z, left=left, right=right))

    return at


def _bilinear(surface: Surface, *, hold: bool = False) -> Lookup:
    """Return the interpolation of a map: infinite beyond what was measured, NaN beside a gap."""
    rows, columns = surface.shape
    dx, dy = cast(float, surface.dx), cast(float, surface.dy)
    x0, y0 = surface.origin
    flat = _with_edge(surface.z, hold=hold).ravel()

    def at(x: FloatArray, y: FloatArray) -> FloatArray:
        u, v = (x - x0) / dx, (y - y0) / dy
        outside = (u < -_EDGE) | (u > columns - 1 + _EDGE) | (v < -_EDGE) | (v > rows - 1 + _EDGE)
        u, v = np.clip(_snapped(u), 0, columns - 1), np.clip(_snapped(v), 0, rows - 1)
        i = np.minimum(u.astype(np.int64), columns - 2)
        j = np.minimum(v.astype(np.int64), rows - 2)
        u -= i
        v -= j
        k = j * columns + i
        total = np.zeros(x.shape)
        corners = (
            (0, (1 - u) * (1 - v)),
            (1, u * (1 - v)),
            (columns, (1 - u) * v),
            (columns + 1, u * v),
        )
        with np.errstate(invalid="ignore"):  # a corner of weight zero does not count
            for step, weight in corners:
                total += np.where(weight == 0.0, 0.0, flat[k + step] * weight)
        if not hold:
            total[outside] = np.inf
        return total

    return at


def _snapped(u: FloatArray) -> FloatArray:
    """Return places with those beside a node by rounding only put on it."""
    node = np.rint(u)
    return np.where(np.abs(u - node) < _EDGE, node, u)


def _with_edge(z: FloatArray, *, hold: bool) -> FloatArray:
    """Return the map with what lies around the measured part told from gaps within it.

    Pixels that were not measured and reach the border of the map (corners around a round part) are
    beyond the map: infinite, or the nearest measured value for `hold`. Gaps within stay NaN.
    """
    gaps = np.isnan(z)
    if not gaps.any():
        return np.ascontiguousarray(z)
    from scipy import ndimage

    labels, _ = ndimage.label(gaps)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    outer = gaps & np.isin(labels, np.unique(border[border > 0]))
    filled = np.array(z)
    if hold:
        nearest = ndimage.distance_transform_edt(gaps, return_distances=False, return_indices=True)
        filled[outer] = z[tuple(nearest)][outer]
    else:
        filled[outer] = np.inf
    return filled


_MOST_TURNS = 20

_EDGE = 1e-9
"""Share of a step by which rounding may miss a node or leave the map (4.5 mm / 0.5 mm in binary)."""


def _hash(*arrays: NDArray[Any]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


# ---- where a correction bends between two points of a path, and the points in between that it needs ----
# A controller moves on straight lines between points, so between two blocks the correction that acts
# is the chord of c, off by up to ``|c''|`` d^2 / 8 at a distance d. Where that exceeds a tolerance the
# block is split into 2, 4, 8 ... parts along the same line in X, C and Z.
#
# A move is looked at on an even grid and on the same grid shifted by an irrational share of a step,
# so that a correction in step with the grid is seen too: every half pixel of a map (0.05 mm where
# nothing says how fast it bends) and every 5 degrees of C at most, at least in `FEWEST` steps.

IntArray = NDArray[np.int64]

MAX_PARTS = 4096
"""Most parts of one block; a path that needs more was never meant for this correction."""

MAX_LOOKS = 1 << 15
"""Most steps in which one move is looked at; a longer one cannot be judged."""

FEWEST = 2
_SHIFT = (3.0 - 5.0**0.5) / 2.0
"""Golden section: the share of a step furthest from every fraction."""

_TURN = np.pi / 36.0
_PITCH = 0.1e-3
_AT_ONCE = 50_000
"""Samples that are held together; few, so that they stay in the cache."""


def chord_errors(lookup: Lookup, ends: FloatArray, pitch: float | None = None) -> FloatArray:
    """Return how far the correction on the way of each move is from its chord.

    Examples
    --------
    >>> ends = np.array([[0.0], [0.0], [2e-3], [0.0]])
    >>> chord_errors(lambda x, c: x**2, ends).tolist()
    [1e-06]
    """
    left = np.zeros(ends.shape[1])
    for size, some in _groups(ends, pitch):
        left[some] = _deviation(_sampled(lookup, ends[:, some], size), 1)
    left[_wanted(ends, pitch) > MAX_LOOKS] = np.inf
    return left


def part_counts(
    lookup: Lookup, ends: FloatArray, tolerance: float, pitch: float | None
) -> tuple[IntArray, FloatArray]:
    """Return into how many equal parts each move is split, and the deviation that is left.

    Examples
    --------
    >>> ends = np.array([[0.0], [0.0], [2e-3], [0.0]])
    >>> parts, left = part_counts(lambda x, c: x**2, ends, 1e-7, None)
    >>> parts.tolist(), left.round(12).tolist()
    ([4], [6.25e-08])
    """
    n = ends.shape[1]
    parts, left = np.ones(n, dtype=np.int64), np.zeros(n)
    for size, some in _groups(ends, pitch):
        _split(lookup, ends[:, some], tolerance, size, some, parts, left)
    left[_wanted(ends, pitch) > MAX_LOOKS] = np.inf
    return parts, left


def _groups(ends: FloatArray, pitch: float | None) -> list[tuple[int, IntArray]]:
    """Return moves that are looked at in equally many steps, not too many at once."""
    steps = 2 ** np.ceil(np.log2(np.clip(_wanted(ends, pitch), FEWEST, MAX_LOOKS)))
    steps = steps.astype(np.int64)
    found = []
    for size in np.unique(steps).tolist():
        chosen = np.flatnonzero(steps == size)
        found += [(size, s) for s in np.array_split(chosen, 1 + chosen.size * size // _AT_ONCE)]
    return found


def _wanted(ends: FloatArray, pitch: float | None) -> FloatArray:
    """Return how many steps each move asks for."""
    radius = np.maximum(np.abs(ends[0]), np.abs(ends[2]))
    turned = np.abs(np.nan_to_num(ends[3] - ends[1]))
    length = np.hypot(ends[2] - ends[0], radius * turned)
    return np.asarray(np.maximum(2.0 * length / (pitch or _PITCH), turned / _TURN))


def _split(
    lookup: Lookup,
    ends: FloatArray,
    tolerance: float,
    size: int,
    where: IntArray,
    parts: IntArray,
    left: FloatArray,
) -> None:
    """Choose the fewest parts for moves that are looked at in equally many steps."""
    values = _sampled(lookup, ends, size)
    open_ = np.arange(where.size)
    count = 1
    while open_.size:
        deviation = _deviation(values[open_], count)
        parts[where[open_]] = count
        left[where[open_]] = deviation
        open_ = open_[deviation > tolerance]  # a gap (NaN) stays one in any number of parts
        count *= 2
        if count > MAX_PARTS:
            return
        if open_.size and 2 * count > size:
            for some in np.array_split(open_, 1 + open_.size * 2 * size // _AT_ONCE):
                _split(lookup, ends[:, some], tolerance, 2 * size, where[some], parts, left)
            return


def _deviation(values: FloatArray, count: int) -> FloatArray:
    """Return the largest distance of samples from the chords of `count` equal parts."""
    moves, size = values.shape[0], values.shape[1] // 2
    even, shifted = values[:, : size + 1], values[:, size + 1 :]
    step = size // count
    low, high = even[:, :-1:step, None], even[:, step::step, None]
    worst = np.zeros(moves)
    for inner, shift in ((even[:, :-1], 0.0), (shifted, _SHIFT)):
        share = (np.arange(step) + shift) / step
        away = (high - low) * share
        away += low
        away -= inner.reshape(moves, count, step)
        worst = np.maximum(worst, np.abs(away, out=away).max(axis=(1, 2)))
    return worst


def _sampled(lookup: Lookup, ends: FloatArray, size: int) -> FloatArray:
    """Return the correction on the even grid, ends included, and on the shifted one after it."""
    grid = np.arange(size + 1)
    share = np.concatenate([grid, grid[:-1] + _SHIFT]) / size
    x = ends[0][:, None] + (ends[2] - ends[0])[:, None] * share
    c = ends[1][:, None] + (ends[3] - ends[1])[:, None] * share
    values = lookup(x.ravel(), c.ravel())
    return np.asarray(values, dtype=np.float64).reshape(x.shape)

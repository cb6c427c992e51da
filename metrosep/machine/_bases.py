"""Private: the shapes that `calibrate` gives an error motion along its axis, and the curve it finds.

Of a linear axis Legendre polynomials over the places that were run, minus their value at home:
errors are zero there. The slope of a straightness is squareness and frame, so those begin at order 2.
Of a full turn harmonics: radial and tilt motion from 2 (1 is where the ball stands), axial and
angular motion from 1. Curves that part maps show (`_part_curves`) have no home: they are plain
polynomials over the range that was cut. Of a part of a turn polynomials made orthogonal to what an axis that stands
elsewhere does: 1, cos q, sin q for radial and tilt motion, 1 for the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.machine.elements import Element
from metrosep.machine.terms import positions_array

if TYPE_CHECKING:
    from metrosep.machine._reading_problem import ReadingSet

_LARGEST_GAP = math.radians(75.0)  # between places: of a full turn, by steps of 60 deg or less
_PLACES = 721  # over a range, of a bow
_ANCHORS = 16  # places inside from which a change is taken
_OWN = 1e-2  # of a shape: what orthogonality must leave of it
_DROPPED = 1e-6  # of the largest part of a null direction


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Shapes of one term over its axis."""

    kind: str  # "legendre", "fourier", "arc" or "constant"
    orders: tuple[int, ...]
    low: float = 0.0
    high: float = 1.0
    home: float | None = 0.0  # where a motion is zero; None: over the range in the mean
    off: FloatArray | None = None  # of an arc: amounts of the functions that are taken out, (m, k)
    tilting: bool = False
    fitted: int | None = None
    """Leading columns that were fitted; those behind stay past the ends what they are there."""

    @property
    def labels(self) -> list[str]:
        """Return what tells the columns of the term from one another."""
        if self.kind == "constant":
            return [""]
        if self.kind == "fourier":
            return [f" {f}{n}" for n in self.orders for f in ("cos", "sin")]
        return [f" order {n}" for n in self.orders]

    def to_dict(self) -> dict[str, Any]:
        """Return what it takes to evaluate the shapes: kind, orders, and of polynomials their range."""
        found: dict[str, Any] = {"basis": self.kind, "orders": [v.strip() for v in self.labels]}
        if self.kind != "constant":
            found["position_unit"] = "m" if self.kind == "legendre" else "rad"
        if self.kind in ("legendre", "arc"):
            found |= {"low": self.low, "high": self.high}
        if self.kind == "legendre":
            found["home"] = self.home
        if self.off is not None:
            found["off"] = self.off.tolist()
        return found

    def at(self, x: FloatArray) -> FloatArray:
        """Return the shapes at positions, shape (..., m)."""
        found = self._at(x)
        if self.fitted is not None and self.kind != "fourier":
            # what was read says nothing of them outside, and high orders would grow without limit
            held = self._at(np.clip(x, self.low, self.high))
            found = np.concatenate([found[..., : self.fitted], held[..., self.fitted :]], axis=-1)
        return found

    def _at(self, x: FloatArray) -> FloatArray:
        if self.kind == "constant":
            return np.ones((*np.shape(x), 1))
        if self.kind == "fourier":
            parts = [f(n * x) for n in self.orders for f in (np.cos, np.sin)]
            return np.stack(parts, axis=-1)
        found = self.legendre(x)
        if self.kind == "legendre" and self.home is None:
            beyond = np.abs(2.0 * np.asarray(x) - self.low - self.high) > (1.0 + 1e-9) * (
                self.high - self.low
            )
            return np.where(beyond[..., None], math.nan, found)
        if self.kind == "legendre":
            return found - self.legendre(np.asarray(self.home))
        return np.asarray(found - _fixed(x, self.tilting) @ np.asarray(self.off).T)

    def legendre(self, x: FloatArray) -> FloatArray:
        """Return the plain polynomials at positions, shape (..., m); NaN over an axis that stands still."""
        with np.errstate(invalid="ignore", divide="ignore"):
            scaled = (2.0 * np.asarray(x) - self.low - self.high) / (self.high - self.low)
        whole = np.asarray(np.polynomial.legendre.legvander(scaled, max(self.orders)))
        shape = (*np.shape(x), len(self.orders))
        return np.asarray(whole[..., list(self.orders)].reshape(shape), dtype=np.float64)


def _fixed(x: FloatArray, tilting: bool) -> FloatArray:
    """Return what an axis of rotation that stands elsewhere does, shape (..., k)."""
    parts = [np.ones(np.shape(x))] + ([np.cos(x), np.sin(x)] if tilting else [])
    return np.stack(parts, axis=-1)


def basis_of(
    element: Element, term: str, places: FloatArray, degree: int | None, home: float
) -> Basis | None:
    """Return the shapes of a term for the places that were run; None where none is left."""
    if term in element.location_errors:
        return Basis("constant", (0,))
    low, high = min(float(places.min()), home), max(float(places.max()), home)
    n_places = np.unique(np.round(places, 9)).size
    letter = term[1]
    if element.kind == "rotary":
        tilting = first_harmonic(element, term) == 2
        wanted = 2 if degree is None else degree
        if _is_full_turn(places):
            n_places = np.unique(np.round(np.mod(places, 2.0 * np.pi), 9)).size
            orders = tuple(range(first_harmonic(element, term), wanted + 1))
            _refuse_few(term, n_places, 2 * wanted + 1, degree)
            return Basis("fourier", orders) if orders else None
        return _arc(term, tilting, (low, high), wanted, n_places, degree)
    wanted = min(3, n_places - 1) if degree is None else degree
    _refuse_few(term, n_places, wanted + 1, degree)
    first = 2 if letter in "XYZ" and letter != along_of(element) else 1
    orders = tuple(range(first, wanted + 1))
    return Basis("legendre", orders, low, high, home) if orders else None


def along_of(element: Element) -> str:
    """Return the letter of the direction of an axis."""
    return "XYZ"[int(np.argmax(np.abs(element.direction)))]


def first_harmonic(element: Element, term: str) -> int:
    """Return 2 for radial and tilt motion, of which harmonic 1 is where the ball or part sits, else 1."""
    along = along_of(element)
    return 1 if term[1] in (along, {"X": "A", "Y": "B", "Z": "C"}[along]) else 2


def _is_full_turn(places: FloatArray) -> bool:
    """Return whether places go round the circle without a larger gap than a coarse step."""
    at = np.unique(np.mod(places, 2.0 * np.pi))
    gaps = np.diff(np.append(at, at[0] + 2.0 * np.pi))
    return bool(gaps.max() <= _LARGEST_GAP)


def _arc(
    term: str,
    tilting: bool,
    ends: tuple[float, float],
    wanted: int,
    n_places: int,
    degree: int | None,
) -> Basis | None:
    _refuse_few(term, n_places, wanted + 1, degree)
    orders = tuple(range(3 if tilting else 1, wanted + 1))
    if not orders:
        return None
    low, high = ends
    nodes, weights = np.polynomial.legendre.leggauss(64)  # orthogonal by the integral over the arc
    x, root = 0.5 * (high - low) * nodes + 0.5 * (high + low), np.sqrt(weights)[:, None]
    plain, fixed = Basis("arc", orders, low, high).legendre(x), _fixed(x, tilting)
    off = np.linalg.lstsq(root * fixed, root * plain, rcond=None)[0].T
    left = root * (plain - fixed @ off.T)
    keep = np.linalg.norm(left, axis=0) > _OWN * np.linalg.norm(root * plain, axis=0)
    kept = tuple(n for n, k in zip(orders, keep, strict=True) if k)
    return Basis("arc", kept, low, high, off=off[keep], tilting=tilting) if kept else None


def further_orders(basis: Basis, top: int) -> Basis | None:
    """Return the shapes of a curve beyond its orders, up to top."""
    if basis.kind == "arc":
        whole = _arc("", basis.tilting, (basis.low, basis.high), top, top + 1, None)
    else:
        whole = replace(basis, orders=tuple(range(1, top + 1)))
    if whole is None:
        return None
    chosen = np.array([n > max(basis.orders) for n in whole.orders])
    orders = tuple(n for n in whole.orders if n > max(basis.orders))
    off = None if whole.off is None else whole.off[chosen]
    return replace(whole, orders=orders, off=off) if orders else None


def _refuse_few(term: str, n_places: int, needed: int, degree: int | None) -> None:
    if degree is not None and n_places < needed:
        raise TooFewSamplesError(
            f"{term} with degree {degree} needs {needed} places of its axis, the readings have "
            f"{n_places}; orders could not be distinguished"
        )


@dataclass(frozen=True, slots=True, eq=False)
class CurveTerm:
    """Error motion over the position of its axis, as readings determined it.

    Parameters
    ----------
    coefficients : ndarray, shape (m,), m or rad
        Of its shapes, those of further orders behind those that were fitted.
    cov : ndarray, shape (m, m)
        Their covariance.
    basis : Basis
        The shapes.
    """

    coefficients: FloatArray
    cov: FloatArray
    basis: Basis

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions, in the shape of x; past its ends the orders that were fitted go on."""
        return np.asarray(self.basis.at(positions_array(x, "position")) @ self.coefficients)

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return its standard uncertainty at positions, in the shape of x."""
        shapes = self.basis.at(positions_array(x, "position"))
        square = np.sum((shapes @ self.cov) * shapes, axis=-1)
        return np.asarray(np.sqrt(np.maximum(square, 0.0) + self.past(x) ** 2))

    def past(self, x: ArrayLike) -> FloatArray:
        """Return what the further orders may change by past the ends: the RMS change over such a way inside."""
        at, own = positions_array(x, "position"), self.basis
        found = np.zeros(at.shape)
        if own.fitted is None or own.kind == "fourier":
            return found
        way = np.minimum(np.abs(at - np.clip(at, own.low, own.high)), own.high - own.low)
        far = way > 0.0
        begin = own.low + (own.high - own.low - way[far, None]) * np.linspace(0.0, 1.0, _ANCHORS)
        steps = (own.at(begin + way[far, None]) - own.at(begin))[..., own.fitted :]
        c = self.coefficients[own.fitted :]
        square = self.cov[own.fitted :, own.fitted :] + np.outer(c, c)
        found[far] = np.sqrt(
            np.maximum(np.sum((steps @ square) * steps, axis=-1).mean(axis=-1), 0.0)
        )
        return found

    @property
    def value(self) -> float:
        """NaN: a curve has no single amount."""
        return math.nan

    def slope(
        self,
        method: str = "least-squares",
        span: tuple[float, float] | None = None,
        *,
        at: float | None = None,
    ) -> tuple[float, float]:
        """Return the slope of a stated line through the curve, and its standard uncertainty.

        Parameters
        ----------
        method : {"least-squares", "end-points", "area", "tangent"}, optional
            ``"area"`` weighs with the distance from the axis of the part, as a map does.
        span : tuple of (float, float), optional
            Positions between which the line is laid; the whole range that was seen if omitted.
        at : float, optional
            Position of the axis of the part (``"area"``) or where the tangent lies.

        Returns
        -------
        tuple of (float, float), m/m or rad/m
            Slope per metre of axis position, and its u.

        Raises
        ------
        DataError
            An unknown method, `at` is missing, or the curve belongs to an axis of rotation.

        Notes
        -----
        The slope of a straightness and a squareness are one number, that of a stated line; for a
        curve with a bow the lines differ.
        """
        row = self._line(method, span, at)[0]
        return float(row @ self.coefficients), math.sqrt(max(float(row @ self.cov @ row), 0.0))

    def bow(self, method: str = "least-squares", span: tuple[float, float] | None = None) -> float:
        """Return the P-V of the curve about the line of `slope`, m or rad."""
        low, high = self._line(method, span, None)[1]
        x = np.linspace(low, high, _PLACES)
        return float(np.ptp(self.evaluate(x) - self.slope(method, span)[0] * x))

    def _line(
        self,
        method: str,
        span: tuple[float, float] | None,
        at: float | None,
    ) -> tuple[FloatArray, tuple[float, float]]:
        """Return the slope as a sum over the coefficients, and the range of the line."""
        basis = self.basis
        numbers.choice(method, "the line", ("least-squares", "end-points", "area", "tangent"))
        if basis.kind != "legendre":
            raise DataError("an axis of rotation has no slope over its position")
        low, high = (basis.low, basis.high) if span is None else span
        if not low < high:
            raise DataError(f"a line lies between two positions, low before high, got {span!r}")
        if (at is None) == (method in ("area", "tangent")):
            raise DataError(f"at goes with area and tangent, and they need it; method is {method}")
        place = 0.0 if at is None else float(at)
        if method == "end-points":
            ends = basis.at(np.array([low, high]))
            return (ends[1] - ends[0]) / (high - low), (low, high)
        if method == "tangent":
            step = 1e-3 * (high - low)
            x = place + step * np.array([-2.0, -1.0, 1.0, 2.0])
            beside = replace(basis, fitted=None).at(x)  # of an end too, where further orders stop
            five_point = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * step)
            return np.asarray(five_point @ beside), (low, high)
        nodes, weights = np.polynomial.legendre.leggauss(64)
        x = 0.5 * (high - low) * nodes + 0.5 * (high + low)
        if method == "area":
            weights = weights * np.abs(x - place)
        far = x - float(weights @ x / weights.sum())
        return np.asarray((weights * far) @ basis.at(x) / float(weights @ far**2)), (
            low,
            high,
        )


@dataclass(frozen=True, slots=True, eq=False)
class UnseenTerm:
    """Error that the readings do not determine: NaN, with infinite uncertainty."""

    value: float = math.nan
    u: float = math.inf

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return NaN in the shape of x."""
        return np.full(np.shape(x), math.nan)

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return infinity in the shape of x."""
        return np.full(np.shape(x), math.inf)


def null_sentences(
    directions: FloatArray, names: Sequence[str]
) -> tuple[tuple[str, ...], list[set[str]]]:
    """Return a sentence for each null direction (columns, scaled), and the names in each.

    Reduced row echelon form: each direction has one name that no other has.
    """
    rows = directions.T.copy()
    pivots: list[int] = []
    for i in range(rows.shape[0]):
        free = np.abs(rows[i:]).copy()
        free[:, pivots] = 0.0
        at, pivot = np.unravel_index(int(np.argmax(free)), free.shape)
        rows[[i, i + int(at)]] = rows[[i + int(at), i]]
        rows[i] /= rows[i, pivot]
        for k in range(rows.shape[0]):
            if k != i:
                rows[k] -= rows[k, pivot] * rows[i]
        pivots.append(int(pivot))
    sentences, members = [], []
    for row in rows:
        chosen = [j for j in np.argsort(-np.abs(row)) if abs(row[j]) > _DROPPED]
        members.append({names[j] for j in chosen})
        if len(chosen) == 1:
            sentences.append(f"{names[chosen[0]]}: no reading depends on it")
            continue
        listed = ", ".join(names[j] for j in chosen)
        sentences.append(f"{listed}: not separable; the readings see only what they do together")
    return tuple(sentences), members


# ---- the profile of a straightedge or square, place by place, that several sets share -----------


@dataclass(frozen=True, slots=True, eq=False)
class ArtefactForm:
    """Shapes of the profile of an artefact at the places of one set."""

    orders: tuple[int, ...]
    columns: FloatArray  # (n, m)
    place: FloatArray  # (n,), along the artefact, m


_PLACE = 1e-7  # m: places that are nearer are one


def forms_of(
    sets: Sequence[ReadingSet], labels: Sequence[str], points: Sequence[FloatArray]
) -> dict[int, ArtefactForm]:
    """Return the shapes of the profiles, by set: all that its places can hold, in rising order."""
    by_owner: dict[str, list[int]] = {}
    for i, (reading, label) in enumerate(zip(sets, labels, strict=True)):
        if "form" in reading.unknown:
            by_owner.setdefault(reading.artefact or label, []).append(i)
    found = {}
    for owner, mine in by_owner.items():
        _require_reversal(owner, [sets[i] for i in mine])
        joined = np.concatenate([points[i] for i in mine])
        axis = int(np.argmax(np.ptp(joined, axis=0)))
        keys = np.round(joined[:, axis] / _PLACE).astype(np.int64)
        places, which = np.unique(keys, return_inverse=True)
        if places.size < 3:
            raise TooFewSamplesError(
                f"the profile of {owner} needs 3 places along it or more, its sets have {places.size}"
            )
        # discrete Legendre polynomials: a basis of whatever the places hold, smooth ones first
        scaled: FloatArray = 2.0 * (places - places[0]) / float(places[-1] - places[0]) - 1.0
        whole = np.polynomial.legendre.legvander(scaled, places.size - 1)
        basis = np.linalg.qr(whole)[0] * np.sqrt(places.size)
        basis = basis * np.sign(basis[-1])
        first = 0
        if all("offset" in sets[i].unknown for i in mine):
            first = 2 if all("slope" in sets[i].unknown for i in mine) else 1
        begin = 0
        for i in mine:
            n = points[i].shape[0]
            rows = which[begin : begin + n]
            begin += n
            orders = tuple(range(first, places.size))
            along = np.asarray(places[rows] * _PLACE, dtype=np.float64)
            found[i] = ArtefactForm(orders, np.asarray(basis[rows][:, first:]), along)
    return found


def _require_reversal(owner: str, sets: Sequence[ReadingSet]) -> None:
    """Refuse an unknown profile that was read from one side only."""
    ways = np.array([getattr(s.instrument, "direction", (0.0, 0.0, 0.0)) for s in sets])
    if not np.any(ways @ ways[0] < 0.0):
        raise DataError(
            f"{owner} was read from one side only, so its form and the error of the axis are one thing; "
            "read it reversed too (the direction turned round, the same artefact), or take its known form off the readings"
        )

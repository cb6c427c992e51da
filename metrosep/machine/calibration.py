"""Calibration of a whole machine: error motions and location errors from readings of instruments.

Each set of readings is ``y = g(errors, unknowns of its set-up) + noise``: the columns are those of
`Chain.read`, so whatever an instrument reads can be put together. What is only a convention is not
fitted (`metrosep.machine._bases`); what the readings cannot tell apart is named, and the terms in it
are NaN. Noise: white, and drift common to all sets, learnt from the readings (machines.md, eq. 17).
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
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_engineering, format_length
from metrosep.machine._bases import Basis, CurveTerm, UnseenTerm, basis_of, null_sentences
from metrosep.machine._drift_noise import Fit, Gls, Stream, diagonal_of_inverse, inverse_times
from metrosep.machine.chains import Chain, Positions
from metrosep.machine.elements import Element, element_terms, term_unit
from metrosep.machine.instruments import Instrument, read, seen
from metrosep.machine.terms import ConstantTerm, ErrorTerm, positions_array

__all__ = ["Calibration", "ReadingSet", "calibrate", "plan_calibration"]

_NULL = 1e-9
"""Of the largest singular value of columns of unit length: below, a direction is not determined."""

_PRIOR = {"m": 5e-6, "rad": 30e-6, "1": math.inf}
"""A direction with a larger standard uncertainty is reported: the readings hardly determine it."""

_STEPS, _SETTLED = 20, 1e-10
_HUBER, _GROSS, _REFUSED, _ROUNDS = 1.5, 6.0, 4.0, 10
_LARGEST = {"m": 1e-2, "rad": 1e-2}
_CONTRADICTS, _STRONGEST = 10.0, 10.0
_CHANCE = 1e-4
"""Of the next orders of an axis to be in the residuals by accident, where an order is added."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadingSet:
    """Readings of one instrument in one set-up, in the order of time.

    Parameters
    ----------
    instrument : Instrument
        What read; its own place may be a guess where it is `unknown`.
    q : mapping of str to array_like, shape (n,) or (), m or rad
        Axis positions of each reading.
    values : array_like, shape (n,) or (n, 3), m or rad
        Deviations from nominal, or whole readings with `total`. NaN where none was taken.
    tool : array_like, shape (3,), m, optional
        Tool point in the frame of the tool.
    unknown : sequence of str, optional
        What of the set-up is not known, of ``instrument.unknowns``.
    name : str, optional
        For messages.
    u : float, optional
        Standard uncertainty of one reading by its noise, m or rad; from the readings if omitted.
    total : bool, optional
        Whether the values hold the nominal reading too.

    Raises
    ------
    DataError
        An unknown is none of the instrument, or every reading is NaN.
    InvalidSamplesError
        Positions and readings are not of one length.
    UnitError
        Deviations are beyond 10 mm or 10 mrad.
    """

    instrument: Instrument
    q: Positions
    values: ArrayLike
    tool: ArrayLike = (0.0, 0.0, 0.0)
    unknown: Sequence[str] = ()
    name: str = ""
    u: float | None = None
    total: bool = False

    def __post_init__(self) -> None:
        kind = self.instrument
        if not isinstance(kind, Instrument):
            raise DataError(f"a ReadingSet needs an instrument, got {kind!r}")
        named = (self.unknown,) if isinstance(self.unknown, str) else tuple(self.unknown)
        for name in named:
            numbers.choice(name, f"unknown of a {type(kind).__name__}", kind.unknowns)
        values = positions_array(self.values, f"readings of {self.label}")
        k = kind.n_readings
        if values.ndim != (1 if k == 1 else 2) or (k > 1 and values.shape[-1] != k):
            raise InvalidSamplesError(
                f"readings of {self.label} have shape {values.shape}; a {type(kind).__name__} gives "
                f"(n,{f' {k}' if k > 1 else ''})"
            )
        values = values.reshape(-1, k)
        q = {a: positions_array(v, f"position of axis {a!r}") for a, v in self.q.items()}
        for axis, at in q.items():
            if at.shape not in ((), values.shape[:1]):
                raise InvalidSamplesError(
                    f"{self.label}: {axis} has shape {at.shape} for {values.shape[0]} readings"
                )
            if np.isnan(at).any():
                raise InvalidSamplesError(f"{self.label}: a position of {axis} is NaN")
        finite = np.isfinite(values)
        if not finite.any():
            raise DataError(f"{self.label}: every reading is NaN")
        unit = "rad" if kind.is_angle else "m"
        if not self.total and float(np.abs(values[finite]).max()) > _LARGEST[unit]:
            raise UnitError(
                f"{self.label}: readings reach {float(np.abs(values[finite]).max()):.4g} {unit}; they "
                f"are deviations in {unit}; give total=True for readings that hold the nominal too"
            )
        if self.u is not None:
            object.__setattr__(self, "u", numbers.positive(self.u, f"u of {self.label}"))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "q", freeze_mapping(q))
        object.__setattr__(self, "unknown", named)

    @property
    def label(self) -> str:
        """Name for messages."""
        return self.name or type(self.instrument).__name__.lower()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration:
    """Errors of a machine found from readings, and how far to trust them.

    Parameters
    ----------
    chain : Chain
        The machine.
    errors : mapping of str to ErrorTerm
        Found terms: ``.value`` and ``.u`` of location errors, ``.evaluate`` and ``.sd`` of motions;
        NaN where the readings do not determine the term.
    fitted : mapping of str to ErrorTerm
        The smallest errors that explain the readings: right for the tools and the places that were
        read, whatever is NaN in `errors`.
    names : tuple of str
        Coefficients: term, then order or harmonic.
    coefficients : ndarray, shape (p,)
        Their values, m or rad.
    covariance : ndarray, shape (p, p)
        Their covariance.
    null : tuple of str
        What the readings cannot tell apart, a sentence each.
    condition : float
        Of the columns of unit length, null directions left out.
    unknowns : mapping of str to mapping
        By set and name what was found of the set-up: ``(values, u)``.
    residuals : mapping of str to ndarray
        By set, readings minus model; NaN where refused or not read.
    refused : mapping of str to int
        Number of readings that contradict the others, by set.
    noise : mapping of str to float
        By set the standard deviation of white noise, m or rad.
    bases : mapping of str to Basis
        Shapes of each term.
    blind : ndarray, shape (p, k)
        Directions of the coefficients that no reading sees.
    messages : tuple of str
        Home, gauge, noise, what was not seen.
    audit : mapping
        Numbers with units in the keys.
    """

    chain: Chain
    errors: Mapping[str, ErrorTerm]
    fitted: Mapping[str, ErrorTerm]
    names: tuple[str, ...]
    coefficients: FloatArray
    covariance: FloatArray
    null: tuple[str, ...]
    condition: float
    unknowns: Mapping[str, Mapping[str, tuple[FloatArray, FloatArray]]]
    residuals: Mapping[str, FloatArray]
    refused: Mapping[str, int]
    noise: Mapping[str, float]
    bases: Mapping[str, Basis] = field(repr=False)
    blind: FloatArray = field(repr=False)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def read(
        self, instrument: Instrument, q: Positions, *, tool: ArrayLike = (0.0, 0.0, 0.0)
    ) -> FloatArray:
        """Return what an instrument would read on the machine as found.

        Parameters
        ----------
        instrument : Instrument
            Any, also one that took no part.
        q : mapping of str to array_like, m or rad
            Axis positions.
        tool : array_like, shape (3,) or (..., 3), m, optional
            Tool point.

        Returns
        -------
        ndarray, shape (...) or (..., 3), m or rad
            Deviation from nominal, by `fitted`.
        """
        return read(self.chain, instrument, q, self.fitted, tool=tool)

    def u_at(self, q: Positions, *, tool: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
        """Return the standard uncertainty of the error of the tool point.

        Parameters
        ----------
        q : mapping of str to array_like, m or rad
            Axis positions.
        tool : array_like, shape (3,) or (..., 3), m, optional
            Tool point.

        Returns
        -------
        ndarray, shape (..., 3), m
            Workpiece X, Y, Z; infinite where the error depends on what the readings do not tell.
        """
        J = _columns(self.chain, self.bases, q, tool)
        u = np.sqrt(np.maximum(np.einsum("...ij,jk,...ik->...i", J, self.covariance, J), 0.0))
        if self.blind.shape[1]:
            part = np.linalg.norm(J @ self.blind, axis=-1)
            u[part > 1e-6 * np.linalg.norm(J, axis=-1)] = math.inf
        return np.asarray(u)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, units in the keys or beside the values.

        Returns
        -------
        dict
            Keys ``machine``, ``terms``, ``null``, ``condition``, ``noise``, ``refused``,
            ``messages``, ``audit``.
        """
        terms = {}
        for name, term in self.errors.items():
            mine = [i for i, n in enumerate(self.names) if n.split(" ")[0] == name]
            u = np.sqrt(np.diag(self.covariance))[mine]
            known = not isinstance(term, UnseenTerm)
            terms[name] = {
                "unit": term_unit(self.chain, name),
                "basis": self.bases[name].kind,
                "orders": [self.names[i][len(name) + 1 :] for i in mine],
                "values": self.coefficients[mine].tolist() if known else None,
                "u": u.tolist() if known else None,
            }
        return {
            "machine": self.chain.name,
            "terms": terms,
            "null": list(self.null),
            "condition": self.condition,
            "noise": dict(self.noise),
            "refused": dict(self.refused),
            "messages": list(self.messages),
            "audit": dict(self.audit),
        }

    def report(self) -> str:
        """Return the result as text: a line for each term, what is not determined, messages.

        Returns
        -------
        str
            For people.
        """
        lines = []
        for name, term in self.errors.items():
            unit = term_unit(self.chain, name)
            if isinstance(term, UnseenTerm):
                lines.append(f"{name:8s} not determined")
            elif isinstance(term, ConstantTerm):
                u = format_engineering(term.u, unit, digits=2)
                lines.append(f"{name:8s} {format_engineering(term.value, unit)} (u = {u})")
            else:
                basis = self.bases[name]
                x = np.linspace(basis.low, basis.high, 201)
                if basis.kind == "fourier":
                    x = np.linspace(0.0, 2.0 * np.pi, 361)
                span = format_engineering(float(np.ptp(term.evaluate(x))), unit)
                u = format_engineering(float(np.max(term.sd(x))), unit, digits=2)
                lines.append(f"{name:8s} P-V {span} over the places (u at most {u})")
        return "\n".join([*lines, *self.null, *self.messages])

    def __repr__(self) -> str:
        found = sum(not isinstance(t, UnseenTerm) for t in self.errors.values())
        return (
            f"Calibration({self.chain.name}: {found} of {len(self.errors)} terms, "
            f"{len(self.null)} directions not determined)"
        )


def calibrate(
    chain: Chain,
    sets: Sequence[ReadingSet],
    *,
    degrees: int | Mapping[str, int] | None = None,
    terms: Sequence[str] | None = None,
    home: Mapping[str, float] | None = None,
    robust: bool = True,
) -> Calibration:
    """Return the errors of a machine that explain readings of one or several instruments.

    Parameters
    ----------
    chain : Chain
        The machine.
    sets : sequence of ReadingSet
        One for each set-up, each with its readings in the order of time.
    degrees : int or mapping of str to int, optional
        Highest order of the polynomials (linear axes, part turns) or harmonics (full turns), by
        axis or term. If omitted 3 and 2, and more as long as the residuals hold the next order.
    terms : sequence of str, optional
        Error terms that may be at work; all of the axes that moved if omitted.
    home : mapping of str to float, m or rad, optional
        Positions at which the motions of linear axes are zero by definition; 0.
    robust : bool, optional
        Whether readings that contradict the others are refused.

    Returns
    -------
    Calibration
        Errors with covariance, null directions by name, residuals, noise.

    Raises
    ------
    DataError
        No set, a term is unknown or its axis did not move, or a set whose noise is stated
        contradicts the others; the message names it and its largest residual.
    TooFewSamplesError
        Fewer readings than unknowns, or fewer places of an axis than a degree needs.
    NotConvergedError
        Stations or balls do not settle in 20 steps.

    Notes
    -----
    Motions of a linear axis are zero at home; slopes of straightness are in squareness and in the
    frame of the instrument. See `metrosep.machine._bases` for rotary axes. Columns have unit length
    before directions below 1e-9 of the largest are called null [1]_. Readings are refused beyond 4
    standard deviations of what all others, their drift included, predict. Where the noise of a set is stated
    and its residuals are larger by more than chance (1 %), all u are raised by the Birge ratio.

    References
    ----------
    .. [1] machines.md, sections 5 and 6.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> from metrosep.machine.instruments import Displacement
    >>> mill = presets("mill_xyz")
    >>> x = np.linspace(0.0, 0.5, 21)
    >>> q = {"X": x, "Y": 0.0, "Z": 0.0}
    >>> values = mill.read(Displacement(direction=(0, 0, 1)), q, {"EZX": lambda x: 8e-6 * x**2})
    >>> line = ReadingSet(Displacement(direction=(0, 0, 1)), q, values, unknown=("offset", "slope"))
    >>> found = calibrate(mill, [line], terms=["EZX"], degrees=2)
    >>> round(np.ptp(found.errors["EZX"].evaluate(x) - found.errors["EZX"].evaluate(x)[-1] * x / 0.5) * 1e9)
    500
    """
    if isinstance(sets, ReadingSet) or not sets:
        raise DataError("sets is a list of ReadingSet, one for each set-up")
    homes = dict(home or {})
    bases = _bases(chain, sets, degrees, terms, homes)
    if not bases:
        raise DataError(
            "no term is left to find: the axes did not move, or the degrees are too low"
        )
    with one_blas_thread():
        problem = _Problem(chain, bases, list(sets))
        found = _fitted(problem, robust, homes)
        for _ in range(_ROUNDS):
            raised = {a: n for a, n in found.lacking.items() if not _is_stated(a, chain, degrees)}
            if not raised:
                break
            bases = {n: _raised(problem, n, raised, homes) for n in bases}
            problem = _Problem(chain, bases, list(sets))
            found = _fitted(problem, robust, homes)
        return _result(problem, found, homes)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The fit of a problem, and what its residuals still hold."""

    fit: Fit
    system: _System
    current: list[Instrument]
    lacking: Mapping[str, int]


def _fitted(problem: _Problem, robust: bool, homes: Mapping[str, float]) -> _Found:
    current, good = problem.start(robust)
    fit, system, good = problem.settled(current, good, robust)
    lacking = problem.lacking(current, good, system, fit, homes)
    return _Found(fit, system, current, lacking)


def _bases(
    chain: Chain,
    sets: Sequence[ReadingSet],
    degrees: int | Mapping[str, int] | None,
    terms: Sequence[str] | None,
    homes: Mapping[str, float],
) -> dict[str, Basis]:
    """Return the shapes of each term that may be at work."""
    wanted = chain.terms if terms is None else chain.known_terms(terms)
    of_axis = degrees if isinstance(degrees, Mapping) else {}
    for key in of_axis:
        if key not in chain.axes and key not in chain.terms:
            raise DataError(f"degrees names {key!r}, which is neither an axis nor a term")
    for axis in homes:
        if axis not in chain.axes:
            raise DataError(f"home names {axis!r}; axes are {', '.join(chain.axes)}")
    found = {}
    for element in chain.elements:
        places = _places(element, sets)
        for term in element_terms(element):
            if term not in wanted:
                continue
            if places is None:
                if terms is not None:
                    raise DataError(f"{term}: axis {element.name} did not move in any set")
                continue
            degree = of_axis.get(term, of_axis.get(element.name))
            if degree is None and not isinstance(degrees, Mapping):
                degree = degrees
            checked = (
                None if degree is None else numbers.count(degree, f"degree of {term}", least=1)
            )
            basis = basis_of(element, term, places, checked, homes.get(element.name, 0.0))
            if basis is not None:
                found[term] = basis
    return found


def _places(element: Element, sets: Sequence[ReadingSet]) -> FloatArray | None:
    """Return the places of an axis in all sets; None where it never moved."""
    listed = [np.ravel(np.asarray(s.q[element.name])) for s in sets if element.name in s.q]
    if element.kind == "fixed" or not listed:
        return None
    places = np.concatenate(listed)
    moved = float(np.ptp(places)) > 1e-9 or element.kind == "rotary"
    return places if moved else None


def _columns(
    chain: Chain, bases: Mapping[str, Basis], q: Positions, tool: ArrayLike, *, turns: bool = False
) -> FloatArray:
    """Return the derivative of E (or of W) by the coefficients, shape (..., 3, p)."""
    names = [n for n in bases if n in chain.terms]
    J = chain.turn_jacobian(q, terms=names) if turns else chain.jacobian(q, tool=tool, terms=names)
    homes = {t: e.name for e in chain.elements for t in element_terms(e)}
    parts = []
    shape = J.shape[:-2]
    for name, basis in bases.items():
        if name not in names:
            parts.append(np.zeros((*shape, 3, len(basis.labels))))
            continue
        x = np.broadcast_to(np.asarray(q[homes[name]], dtype=np.float64), shape)
        parts.append(J[..., names.index(name), None] * basis.at(x)[..., None, :])
    return np.concatenate(parts, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """The linear problem about the current set-ups; rows of all sets one after another."""

    X: FloatArray
    y: FloatArray
    sizes: FloatArray
    V: FloatArray  # directions that are determined, (p, r), scaled columns
    blind: FloatArray  # those that are not, (p, k)
    singular: FloatArray
    streams: list[Stream]
    rows: list[FloatArray]  # by set, where its good readings stand: indices into (n, k) raveled
    ends: list[int]


class _Problem:
    """Columns of all sets: coefficients of the terms, then unknowns of the set-ups."""

    def __init__(self, chain: Chain, bases: Mapping[str, Basis], sets: list[ReadingSet]) -> None:
        self.chain, self.bases, self.sets = chain, bases, sets
        self.names = [f"{n}{label}" for n, b in bases.items() for label in b.labels]
        self.units = [term_unit(chain, n) for n, b in bases.items() for _ in b.labels]
        self.n_terms = len(self.names)
        self.unknown_at: list[dict[str, slice]] = []
        labels = _labels(sets)
        self.labels = labels
        for reading, label in zip(sets, labels, strict=True):
            at = {}
            for name in reading.unknown:
                k = reading.instrument.unknowns[name]
                at[name] = slice(len(self.names), len(self.names) + k)
                ends = [f" {a}" for a in "xyz"] if k == 3 else [""]
                self.names += [f"{name}{end} of {label}" for end in ends]
                one = "1" if name == "slope" else "rad" if reading.instrument.is_angle else "m"
                self.units += [one] * k
            self.unknown_at.append(at)
        self.parts = [self._fixed(s) for s in sets]

    def _fixed(self, reading: ReadingSet) -> tuple[Any, FloatArray, FloatArray]:
        """Return view, columns of E (or W) and readings with their nominal, of one set."""
        part, at, lever, view = seen(self.chain, reading.instrument, reading.q, reading.tool)
        columns = _columns(part, self.bases, at, lever, turns=reading.instrument.is_angle)
        values = np.asarray(reading.values)
        n = values.shape[0]
        view = replace(
            view,
            point=np.broadcast_to(view.point, (n, 3)),
            turn=np.broadcast_to(view.turn, (n, 3, 3)),
        )
        columns = np.broadcast_to(columns, (n, *columns.shape[-2:]))
        whole = values if reading.total else values + reading.instrument.nominal(view)
        return view, columns, whole

    def assembled(self, current: list[Instrument], good: list[Any]) -> _System:
        """Return the linear problem about the current set-ups."""
        blocks, rests, streams, rows, ends, at = [], [], [], [], [], 0
        for k, instrument in enumerate(current):
            view, columns, whole = self.parts[k]
            n, m = whole.shape
            block = np.zeros((n, m, len(self.names)))
            block[..., : self.n_terms] = instrument.of_errors(view) @ columns
            for name, where in self.unknown_at[k].items():
                block[..., where] = instrument.of_unknown(name, view)
            rest = whole - instrument.nominal(view)
            chosen = []
            for c in range(m):
                index = np.flatnonzero(good[k][:, c])
                chosen.append(index * m + c)
                rows_of = np.arange(at, at + index.size)
                streams.append(Stream(rows_of, index.astype(np.float64), k))
                blocks.append(block[index, c])
                rests.append(rest[index, c])
                at += index.size
            rows.append(np.concatenate(chosen))
            ends.append(at)
        X, y = np.concatenate(blocks), np.concatenate(rests)
        sizes = np.linalg.norm(X, axis=0)
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        _, singular, directions = np.linalg.svd(np.linalg.qr(X / sizes, mode="r"))
        singular = np.append(singular, np.zeros(len(self.names) - singular.size))
        known = singular > _NULL * singular[0]
        if X.shape[0] <= int(known.sum()):
            raise TooFewSamplesError(
                f"{X.shape[0]} readings for {int(known.sum())} unknowns that they could tell; "
                "take more, or lower the degrees"
            )
        V, blind = directions[known].T, directions[~known].T
        return _System(X, y, sizes, V, blind, singular, streams, rows, ends)

    def start(self, robust: bool) -> tuple[list[Instrument], list[Any]]:
        """Return set-ups where the readings put them, and the readings that are not grossly wrong."""
        current = [s.instrument for s in self.sets]
        good = [np.isfinite(np.asarray(s.values)) for s in self.sets]
        current = self.placed(current, good, _least)
        if robust:
            current = self.placed(current, good, _huber)
            good = self.without_gross(self.assembled(current, good), good)
        return current, good

    def placed(
        self, current: list[Instrument], good: list[Any], solve: Callable[[_System], FloatArray]
    ) -> list[Instrument]:
        """Return the set-ups where the readings put them (Gauss-Newton)."""
        for _ in range(_STEPS):
            current, moved = self._moved(current, solve(self.assembled(current, good)))
            if moved < _SETTLED:
                return current
        worst = max(self.sets, key=lambda s: len(s.unknown)).label
        raise NotConvergedError(
            f"{worst}: the set-up does not settle in {_STEPS} steps; start closer than 50 mm, or take "
            "more places"
        )

    def _moved(
        self, current: list[Instrument], beta: FloatArray
    ) -> tuple[list[Instrument], float]:
        """Return the set-ups moved by what was found of them, and the largest move in m."""
        new, largest = [], 0.0
        for k, instrument in enumerate(current):
            placed = instrument
            for name, where in self.unknown_at[k].items():
                if not _is_place(placed, name):
                    continue
                by = beta[where]
                placed = placed.moved(name, by)
                largest = max(largest, float(np.abs(by).max()))
            new.append(placed)
        return new, largest

    def without_gross(self, system: _System, good: list[Any]) -> list[Any]:
        """Return which readings are left when gross contradictions are taken out."""
        beta = _huber(system)
        rest = system.y - system.X @ beta
        kept = [g.copy() for g in good]
        begin = 0
        for k, end in enumerate(system.ends):
            part = rest[begin:end]
            scale = 1.4826 * float(np.median(np.abs(part)))
            floor = 1e-9 * float(np.abs(system.y[begin:end]).max(initial=0.0))
            bad = np.abs(part) > _GROSS * max(scale, floor)
            kept[k].reshape(-1)[system.rows[k][bad]] = False
            begin = end
        return kept

    def settled(
        self, current: list[Instrument], good: list[Any], robust: bool
    ) -> tuple[Fit, _System, list[Any]]:
        """Return the fit with its noise when no further reading is refused, and what is left."""
        stated = [s.u for s in self.sets]
        for _ in range(_ROUNDS):
            system = self.assembled(current, good)
            Z = (system.X / system.sizes) @ system.V
            fit = Gls(Z, system.y, system.streams, stated).best()
            t = _deleted(Z, system, fit)
            # robust: one bad reading must not hide another, nor hide behind a scale of its making
            scale = 1.4826 * float(np.median(np.abs(t)))
            bad = np.abs(t) > _REFUSED * max(scale, 1.0)
            if not robust or not bad.any():
                break
            begin = 0
            good = [g.copy() for g in good]
            for k, end in enumerate(system.ends):
                good[k].reshape(-1)[system.rows[k][bad[begin:end]]] = False
                begin = end
        return fit, system, good  # type: ignore[possibly-undefined]

    def lacking(
        self,
        current: list[Instrument],
        good: list[Any],
        system: _System,
        fit: Fit,
        homes: Mapping[str, float],
    ) -> dict[str, int]:
        """Return axes whose next order the residuals hold beyond chance, and that order (score test)."""
        from scipy.stats import chi2 as chi2_of

        more = {}
        for name, basis in self.bases.items():
            further = _next(self, name, basis, homes)
            if further is not None:
                more[name] = further
        if not more:
            return {}
        wider = _Problem(self.chain, more, self.sets)
        X = wider.assembled(current, good).X[:, : wider.n_terms]
        Z = (system.X / system.sizes) @ system.V
        rest = system.y - Z @ fit.beta
        whole = np.column_stack([X, Z, rest])
        solved = np.empty_like(whole)
        for stream in system.streams:
            rows = stream.rows
            part, _ = inverse_times(whole[rows], stream.index, fit.a, fit.tau)
            solved[rows] = part / fit.scales[stream.which] ** 2
        k = wider.n_terms
        across = Z.T @ solved[:, :k]
        information = X.T @ solved[:, :k] - across.T @ fit.cov @ across
        score = X.T @ solved[:, -1]
        axes = [_axis(self.chain, name.split(" ")[0]) for name in wider.names[:k]]
        found = {}
        for axis in dict.fromkeys(axes):
            mine = [i for i, a in enumerate(axes) if a == axis]
            own = information[np.ix_(mine, mine)]
            size = np.sqrt(np.maximum(np.diag(own), 1e-300))
            values, vectors = np.linalg.eigh(own / np.outer(size, size))
            kept = values > 1e-6 * max(values.max(), 1.0)
            parts = vectors[:, kept].T @ (score[mine] / size)
            size_of = float(np.sum(parts**2 / values[kept]))
            if kept.any() and chi2_of.sf(size_of, int(kept.sum())) < _CHANCE:
                orders = [max(more[n].orders) for n in more if _axis(self.chain, n) == axis]
                found[axis] = max(orders)
        return found


def _axis(chain: Chain, term: str) -> str:
    return next(e.name for e in chain.elements if term in element_terms(e))


def _is_stated(axis: str, chain: Chain, degrees: int | Mapping[str, int] | None) -> bool:
    """Return whether the degree of an axis was given by the caller."""
    if not isinstance(degrees, Mapping):
        return degrees is not None
    return axis in degrees or any(_axis(chain, t) == axis for t in degrees if t in chain.terms)


def _next(problem: _Problem, term: str, basis: Basis, homes: Mapping[str, float]) -> Basis | None:
    """Return the next order of a term alone; None where it has none or the places do not show it."""
    if basis.kind == "constant":
        return None
    whole = _of_degree(problem, term, max(basis.orders) + 1, homes)
    if whole is None:
        return None
    last = tuple(n for n in whole.orders if n > max(basis.orders))
    if not last:
        return None
    return replace(whole, orders=last, off=None if whole.off is None else whole.off[-len(last) :])


def _of_degree(
    problem: _Problem, term: str, degree: int, homes: Mapping[str, float]
) -> Basis | None:
    element = next(e for e in problem.chain.elements if term in element_terms(e))
    places = _places(element, problem.sets)
    if places is None:
        return None
    try:
        return basis_of(element, term, places, degree, homes.get(element.name, 0.0))
    except TooFewSamplesError:
        return None


def _raised(
    problem: _Problem, term: str, raised: Mapping[str, int], homes: Mapping[str, float]
) -> Basis:
    """Return the shapes of a term with the order that its axis needs."""
    basis, axis = problem.bases[term], _axis(problem.chain, term)
    if basis.kind == "constant" or axis not in raised:
        return basis
    return _of_degree(problem, term, raised[axis], homes) or basis


def _labels(sets: Sequence[ReadingSet]) -> list[str]:
    """Return a name for each set; those that share one are numbered."""
    names = [s.label for s in sets]
    return [
        f"{n} {names[: i + 1].count(n)}" if names.count(n) > 1 else n for i, n in enumerate(names)
    ]


def _is_place(instrument: Instrument, name: str) -> bool:
    """Return whether an unknown is a place, which the direction of the reading depends on."""
    return name in ("station", "ball") and hasattr(instrument, "_away")


def _least(system: _System) -> FloatArray:
    """Return the least-squares solution of smallest scaled size."""
    scaled = (system.X / system.sizes) @ system.V
    found = np.linalg.lstsq(scaled, system.y, rcond=None)[0]
    return np.asarray(system.V @ found / system.sizes)


def _huber(system: _System) -> FloatArray:
    """Return the solution with Huber weights, each set with its own robust scale."""
    scaled = (system.X / system.sizes) @ system.V
    Q, R = np.linalg.qr(scaled, mode="reduced")
    free = np.sqrt(np.maximum(1.0 - np.sum(Q**2, axis=1), 1e-6))
    weights = np.ones(system.y.size)
    found = np.zeros(Q.shape[1])
    for _ in range(20):
        weighted = Q * weights[:, None]
        found = np.linalg.solve(weighted.T @ Q, weighted.T @ system.y)
        rest, begin, new = system.y - Q @ found, 0, np.ones(system.y.size)
        for end in system.ends:
            part = np.abs(rest[begin:end]) / free[begin:end]
            scale = max(1.4826 * float(np.median(part)), 1e-30)
            new[begin:end] = np.minimum(1.0, _HUBER * scale / np.maximum(part, 1e-30))
            begin = end
        settled = np.abs(new - weights).max() < 1e-3
        weights = new
        if settled:
            break
    return np.asarray(system.V @ np.linalg.solve(R, found) / system.sizes)


def _deleted(Z: FloatArray, system: _System, fit: Fit) -> FloatArray:
    """Return each residual over the spread that all other readings, their drift too, give it."""
    rest = system.y - Z @ fit.beta
    t = np.empty(rest.size)
    for stream in system.streams:
        if not stream.rows.size:
            continue
        s = fit.scales[stream.which]
        both = np.column_stack([rest[stream.rows], Z[stream.rows]])
        solved, _ = inverse_times(both, stream.index, fit.a, fit.tau)
        solved /= s**2
        own = diagonal_of_inverse(stream.index, fit.a, fit.tau) / s**2
        own -= np.sum((solved[:, 1:] @ fit.cov) * solved[:, 1:], axis=1)
        t[stream.rows] = solved[:, 0] / np.sqrt(np.maximum(own, 1e-12 / s**2))
    return t


def _result(problem: _Problem, found: _Found, homes: Mapping[str, float]) -> Calibration:
    chain, fit, system, current = problem.chain, found.fit, found.system, found.current
    sets = problem.sets
    beta = system.V @ fit.beta / system.sizes
    cov = (system.V @ fit.cov @ system.V.T) / np.outer(system.sizes, system.sizes)
    rest = system.y - system.X @ beta
    residuals, noise, refused, chi2, n_stated = {}, {}, {}, 0.0, 0
    begin = 0
    for k, (reading, label) in enumerate(zip(sets, problem.labels, strict=True)):
        end = system.ends[k]
        values = np.full(np.asarray(reading.values).shape, math.nan)
        values.reshape(-1)[system.rows[k]] = rest[begin:end]
        residuals[label] = values[:, 0] if reading.instrument.n_readings == 1 else values
        refused[label] = int(np.isfinite(np.asarray(reading.values)).sum()) - (end - begin)
        noise[label] = float(fit.scales[k])
        if reading.u is not None:
            part = float(np.sum((rest[begin:end] / reading.u) ** 2))
            chi2, n_stated = chi2 + part / (1.0 + fit.a**2), n_stated + end - begin
            # a drift of many times the noise is no drift: it is what the model cannot follow
            if part > _CONTRADICTS * (end - begin) * (1.0 + min(fit.a, _STRONGEST) ** 2):
                worst = float(np.nanmax(np.abs(values)))
                raise DataError(
                    f"{label} contradicts the other sets or the model: its residuals are "
                    f"{math.sqrt(part / (end - begin)):.3g} times the stated noise, the largest "
                    f"{worst:.3g}; check its unit, its sign, its tool point and its set-up"
                )
        begin = end
    messages = [_gauge(chain, homes)]
    messages += [
        f"the readings hold more of {axis} than its orders: order {order} is there beyond chance; give a "
        f"higher degree ({axis}={order}), u does not contain what is missing"
        for axis, order in found.lacking.items()
    ]
    share = fit.beta.size * n_stated / max(system.y.size, 1)
    if n_stated:
        from scipy.stats import chi2 as chi2_of

        free = max(n_stated - share, 1.0)
        if chi2_of.sf(chi2, free) < 0.01:
            birge = math.sqrt(chi2 / free)
            cov = cov * birge**2
            messages.append(
                f"the model lacks something: residuals are {birge:.3g} times the stated noise; all u "
                "are raised by it"
            )
    p = problem.n_terms
    blind = system.blind / system.sizes[:, None]
    null, members = null_sentences(system.blind, problem.names)
    unseen = {name.split(" ")[0] for group in members for name in group}
    null = (*null, *_hardly(problem, cov))
    errors, fitted = _terms(problem, beta, cov, unseen)
    unknowns: dict[str, Mapping[str, tuple[FloatArray, FloatArray]]] = {}
    u = np.sqrt(np.maximum(np.diag(cov), 0.0))
    for k, label in enumerate(problem.labels):
        of_set = {}
        for name, where in problem.unknown_at[k].items():
            place = getattr(current[k], name, None) if _is_place(current[k], name) else None
            of_set[name] = (beta[where] if place is None else np.asarray(place), u[where])
        if of_set:
            unknowns[label] = freeze_mapping(of_set)
    if fit.judged and not fit.white:
        messages.append(
            f"drift is {fit.a:.2g} times the white noise, over {fit.tau:.2g} readings; u contains it"
        )
    elif not fit.judged:
        messages.append(
            "fewer than 30 readings in each series: drift cannot be judged, u is white"
        )
    messages += [
        f"{label}: {n} readings contradict the others and were refused"
        for label, n in refused.items()
        if n
    ]
    missing = sum(int((~np.isfinite(np.asarray(s.values))).sum()) for s in sets)
    if missing:
        messages.append(f"{missing} readings are NaN and were left out")
    known = system.singular[system.singular > _NULL * system.singular[0]]
    return Calibration(
        chain=chain,
        errors=freeze_mapping(errors),
        fitted=freeze_mapping(fitted),
        names=tuple(problem.names[:p]),
        coefficients=beta[:p],
        covariance=cov[:p, :p],
        null=null,
        condition=float(known[0] / known[-1]),
        unknowns=freeze_mapping(unknowns),
        residuals=freeze_mapping(residuals),
        refused=freeze_mapping(refused),
        noise=freeze_mapping(noise),
        bases=freeze_mapping(dict(problem.bases)),
        blind=blind[:p],
        messages=tuple(messages),
        audit=freeze_mapping(
            {
                "readings": int(system.y.size),
                "unknowns": len(problem.names),
                "rank": int(known.size),
                "drift_to_white": fit.a,
                "drift_readings": fit.tau,
                "home": {a: homes.get(a, 0.0) for a in chain.axes},
            }
        ),
    )


def _terms(
    problem: _Problem, beta: FloatArray, cov: FloatArray, unseen: set[str]
) -> tuple[dict[str, ErrorTerm], dict[str, ErrorTerm]]:
    """Return terms, NaN where not determined, and the smallest that explain the readings."""
    errors: dict[str, ErrorTerm] = {}
    fitted: dict[str, ErrorTerm] = {}
    at = 0
    for name, basis in problem.bases.items():
        mine = slice(at, at + len(basis.labels))
        at = mine.stop
        term: ErrorTerm
        if basis.kind == "constant":
            term = ConstantTerm(
                float(beta[mine][0]), u=math.sqrt(max(float(cov[mine, mine][0, 0]), 0.0))
            )
        else:
            term = CurveTerm(beta[mine], cov[mine, mine], basis)
        unit = term_unit(problem.chain, name)
        largest = float(np.abs(beta[mine]).max())
        if largest > _LARGEST[unit]:
            raise DataError(
                f"{name} would be {format_engineering(largest, unit)}, which no machine has: check the "
                "machine, the units and the tool points of the readings, or lower the degrees"
            )
        fitted[name] = term
        errors[name] = UnseenTerm() if name in unseen else term
    return errors, fitted


def _hardly(problem: _Problem, cov: FloatArray) -> tuple[str, ...]:
    """Return a sentence for each direction whose u is beyond what any machine would have."""
    p = problem.n_terms
    prior = np.array([_PRIOR[unit] for unit in problem.units[:p]])
    values, vectors = np.linalg.eigh(cov[:p, :p] / np.outer(prior, prior))
    sentences = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        if value <= 1.0:
            break
        part = np.abs(vector)
        chosen = [problem.names[i] for i in np.argsort(-part) if part[i] > 0.3 * part.max()]
        sentences.append(
            f"{', '.join(chosen)}: hardly separable by these readings; u is {math.sqrt(value):.2g} times "
            f"what a machine has ({format_length(_PRIOR['m'])}, 30 urad)"
        )
    return tuple(sentences)


def _gauge(chain: Chain, homes: Mapping[str, float]) -> str:
    moved = [a for a, v in homes.items() if v != 0.0]
    where = ", ".join(f"{a} = {homes[a]:g}" for a in moved) if moved else "all axes at zero"
    return (
        f"errors of linear axes are zero at home ({where}); slopes of straightness are in squareness "
        f"and in the frame of the instrument; squareness is that of least-squares lines"
    )


# ---- which set-up would add most -------------------------------------------------------------------


def plan_calibration(
    chain: Chain,
    candidates: Sequence[ReadingSet],
    *,
    volume: Positions,
    tools: Sequence[ArrayLike] = ((0.0, 0.0, 0.0),),
    noise: float = 1e-7,
    degrees: int | Mapping[str, int] | None = None,
    most: int | None = None,
) -> list[tuple[str, float]]:
    """Return set-ups in the order in which each adds most to what is known of a working volume.

    Parameters
    ----------
    chain : Chain
        The machine.
    candidates : sequence of ReadingSet
        Possible set-ups; their values are not looked at (zeros will do).
    volume : mapping of str to array_like, m or rad
        Places at which the error shall be known.
    tools : sequence of array_like, shape (3,), m, optional
        Tool points in use.
    noise : float, m or rad, optional
        Standard uncertainty of one reading where a set states none.
    degrees : int or mapping of str to int, optional
        As for `calibrate`.
    most : int, optional
        How many set-ups; all of them if omitted.

    Returns
    -------
    list of (str, float)
        Name of the set-up and the RMS over volume and tools of the standard uncertainty of the
        error vector once it is done too, m.

    Raises
    ------
    DataError
        No candidate, or no term is left.

    Notes
    -----
    Information of a set-up: ``A'A / s^2`` with its unknowns projected off (eq. 18 of [1]_); a prior of 5 um
    and 30 urad for each coefficient keeps the first steps finite.

    References
    ----------
    .. [1] machines.md, section 6.
    """
    if not candidates:
        raise DataError("no candidate is given")
    bases = _bases(chain, candidates, degrees, None, {})
    if not bases:
        raise DataError("no term is left to find: the axes do not move in any candidate")
    problem = _Problem(chain, bases, list(candidates))
    p = problem.n_terms
    everything = [np.isfinite(np.asarray(s.values)) for s in candidates]
    system = problem.assembled([s.instrument for s in candidates], everything)
    information, begin = [], 0
    for k, (reading, end) in enumerate(zip(candidates, system.ends, strict=True)):
        rows = system.X[begin:end]
        own = [
            i for where in problem.unknown_at[k].values() for i in range(where.start, where.stop)
        ]
        A = rows[:, :p]
        if own:
            Q = np.linalg.qr(rows[:, own] / system.sizes[own])[0]
            A = A - Q @ (Q.T @ A)
        information.append(A.T @ A / (reading.u or noise) ** 2)
        begin = end
    J = [_columns(chain, bases, volume, tool) for tool in tools]
    wanted = np.concatenate([j.reshape(-1, p) for j in J])
    square = wanted.T @ wanted / (wanted.shape[0] / 3)
    prior = np.array([_PRIOR[unit] for unit in problem.units[:p]])
    total = np.diag(1.0 / prior**2)
    left, order = list(range(len(candidates))), []
    for _ in range(min(len(left), most or len(left))):
        sizes = [float(np.trace(np.linalg.solve(total + information[k], square))) for k in left]
        best = left.pop(int(np.argmin(sizes)))
        total = total + information[best]
        order.append((problem.labels[best], math.sqrt(min(sizes))))
    return order

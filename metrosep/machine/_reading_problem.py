"""Private: readings of all set-ups as one linear problem, its noise, and what it still lacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.machine._bases import Basis, basis_of, forms_of
from metrosep.machine._drift_noise import (
    Fit,
    Gls,
    Stream,
    degrees_of,
    diagonal_of_inverse,
    inverse_times,
)
from metrosep.machine.chains import Chain, Positions
from metrosep.machine.elements import Element, element_terms, term_unit
from metrosep.machine.instruments import Instrument, seen
from metrosep.machine.terms import positions_array

NULL = 1e-5
"""Of the largest singular value of columns of unit length: below, a direction is not determined. Positions
that are typed to 1 um over 100 mm break an exact null by 3e-6; what is above it has u of 1e5 times the noise."""


_STEPS, _SETTLED = 20, 1e-10
_SEEN = 1e-6
"""Of the largest column of a place: what is below would be known to a million times the noise."""
_HUBER, _GROSS, _REFUSED = 1.5, 6.0, 4.0
_OWN_NOISE = 30
"""Readings of each series of a set (the three of a nest) from which on each has a noise of its own: with 15
that coefficients leave over it is known to 18 %. Below it the series of a set share one."""
_SHORT = 60
"""Readings of a set from which on those that fit best know their own scatter."""
_ONE_BALL = 5e-3
"""m: poses that a control steers to a ball are no further apart, whatever its kinematics."""
_NEAR = 50e-3
"""m: a ball that is to be found is stated no worse, else the set-up or a unit is another one."""
ROUNDS = 10
LARGEST = {"m": 1e-2, "rad": 1e-2}
"""A reading or an error beyond it is of no machine: its unit, or the machine, is another one."""
_CHANCE = 1e-4
"""Of the next orders of an axis to be in the residuals by accident, where an order is added."""
_LOWEST = (1, 2, 3)
"""Orders at which a term begins."""


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
    resolution : float, optional
        Step of the display, m or rad; the one that all readings are whole numbers of if omitted.
    artefact : str, optional
        Name of the straightedge or square whose profile is the unknown ``form``, or of the bar whose
        error of length is the unknown ``length``: sets that name the same one share it, a profile place
        by place along it. Height out of its surface, towards the tool, raises
        the reading. Read it in one set-up with the direction u and reversed with -u: then the profile
        and the straightness are told apart. With an unknown slope in its sets the profile has none.

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
    resolution: float | None = None
    artefact: str = ""

    def __post_init__(self) -> None:
        kind = self.instrument
        if not isinstance(kind, Instrument):
            raise DataError(f"a ReadingSet needs an instrument, got {kind!r}")
        named = (self.unknown,) if isinstance(self.unknown, str) else tuple(self.unknown)
        for name in named:
            numbers.choice(name, f"unknown of a {type(kind).__name__}", kind.unknowns)
        if self.artefact and not {"form", "length"} & set(named):
            of = "".join(
                f"add {n} to its unknown, or " for n in ("form", "length") if n in kind.unknowns
            )
            raise DataError(
                f"{self.label}: artefact {self.artefact!r} is named, but nothing of it is unknown, so nothing is "
                f"shared: {of}leave the artefact out"
            )
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
            lost = np.flatnonzero(np.isnan(np.atleast_1d(at)))
            if lost.size:
                more = f" and at {lost.size - 1} more" if lost.size > 1 else ""
                raise InvalidSamplesError(
                    f"{self.label}: the position of {axis} is missing (NaN) at reading {lost[0] + 1}{more}; "
                    "give it, or take the row out"
                )
        finite = np.isfinite(values)
        if not finite.any():
            raise DataError(f"{self.label}: every reading is NaN")
        unit = "rad" if kind.is_angle else "m"
        if not self.total and float(np.abs(values[finite]).max()) > LARGEST[unit]:
            raise UnitError(
                f"{self.label}: readings reach {float(np.abs(values[finite]).max()):.4g} {unit}; they "
                f"are deviations in {unit}; check the unit of the column, or state that they hold the nominal too "
                "(total = true in a file)"
            )
        if self.u is not None:
            object.__setattr__(self, "u", numbers.positive(self.u, f"u of {self.label}"))
        if self.resolution is not None:
            step = numbers.positive(self.resolution, f"resolution of {self.label}")
            object.__setattr__(self, "resolution", step)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "q", freeze_mapping(q))
        object.__setattr__(self, "unknown", named)

    @property
    def label(self) -> str:
        """Name for messages."""
        return self.name or type(self.instrument).__name__.lower()

    @property
    def step(self) -> float:
        """Step of the display, m or rad; 0 where all readings are one and nothing states it."""
        return resolution_of(self.values) if self.resolution is None else self.resolution


def bases_of(
    chain: Chain,
    sets: Sequence[ReadingSet],
    degrees: int | Mapping[str, int] | None,
    terms: Sequence[str] | None,
    homes: Mapping[str, float],
) -> dict[str, Basis]:
    """Return the shapes of each term that may be at work; of no order where its degree holds none."""
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
        places = places_of(element, sets)
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
            found[term] = Basis("none", ()) if basis is None else basis
    return found


def places_of(element: Element, sets: Sequence[ReadingSet]) -> FloatArray | None:
    """Return the places of an axis in all sets; None where it never moved."""
    listed = [np.ravel(np.asarray(s.q[element.name])) for s in sets if element.name in s.q]
    if element.kind == "fixed" or not listed:
        return None
    places = np.concatenate(listed)
    moved = float(np.ptp(places)) > 1e-9 or element.kind == "rotary"
    return places if moved else None


def columns_of(
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


@dataclass(frozen=True, eq=False)
class System:
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

    @cached_property
    def design(self) -> FloatArray:
        """Scaled columns of the directions that are determined, shape (n, r)."""
        return np.asarray((self.X / self.sizes) @ self.V)

    @cached_property
    def of_groups(self) -> list[NDArray[np.intp]]:
        """Rows of each group of streams with one scale of noise."""
        count = 1 + max(s.group for s in self.streams)
        nothing = np.zeros(0, dtype=np.intp)
        return [
            np.concatenate([nothing, *(s.rows for s in self.streams if s.group == i)])
            for i in range(count)
        ]

    def readings_at(
        self, good: Sequence[NDArray[np.bool_]], rows: NDArray[np.intp], value: bool
    ) -> list[Any]:
        """Return which readings are used, with those of some rows set."""
        found = [g.copy() for g in good]
        begin = 0
        for k, end in enumerate(self.ends):
            mine = rows[(rows >= begin) & (rows < end)] - begin
            found[k].reshape(-1)[self.rows[k][mine]] = value
            begin = end
        return found


class Problem:
    """Columns of all sets: coefficients of the terms, then unknowns of the set-ups."""

    def __init__(self, chain: Chain, bases: Mapping[str, Basis], sets: list[ReadingSet]) -> None:
        self.chain, self.sets, self.wanted = chain, sets, bases
        self.bases = bases = {n: b for n, b in bases.items() if b.orders}
        self.names = [f"{n}{label}" for n, b in bases.items() for label in b.labels]
        self.units = [term_unit(chain, n) for n, b in bases.items() for _ in b.labels]
        self.n_terms = len(self.names)
        self.unknown_at: list[dict[str, slice]] = []
        self._structural: FloatArray | None = None
        self.groups = _groups(sets)
        self.stated = [sets[k].u for k, _ in self.groups]
        labels = _labels(sets)
        self.labels = labels
        self.steps = np.array([s.step for s in sets])
        self.parts = [self._fixed(s) for s in sets]
        self.forms = forms_of(sets, labels, [part[0].point for part in self.parts])
        shared: dict[str, slice] = {}
        for i, (reading, label) in enumerate(zip(sets, labels, strict=True)):
            at = {}
            for name in reading.unknown:
                if name == "form":
                    owner = reading.artefact or label
                    if owner not in shared:
                        orders = self.forms[i].orders
                        shared[owner] = slice(len(self.names), len(self.names) + len(orders))
                        self.names += [f"form order {n} of {owner}" for n in orders]
                        self.units += ["m"] * len(orders)
                    at[name] = shared[owner]
                    continue
                if name == "length" and reading.artefact:
                    bar = f"length of {reading.artefact}"
                    if bar not in shared:
                        shared[bar] = slice(len(self.names), len(self.names) + 1)
                        self.names.append(bar)
                        self.units.append("m")
                    at[name] = shared[bar]
                    continue
                k = reading.instrument.unknowns[name]
                at[name] = slice(len(self.names), len(self.names) + k)
                ends = {1: [""], 2: [" 1", " 2"], 3: [f" {a}" for a in "xyz"]}[k]
                self.names += [f"{name}{end} of {label}" for end in ends]
                plain = name in ("slope", "beam")
                one = "1" if plain else "rad" if reading.instrument.is_angle else "m"
                self.units += [one] * k
            self.unknown_at.append(at)

    def _fixed(
        self, reading: ReadingSet, by: ArrayLike = 0.0
    ) -> tuple[Any, FloatArray, FloatArray]:
        """Return view, columns of E (or W) and readings with their nominal, of one set, its tool point moved."""
        tool = np.asarray(reading.tool) + by
        part, at, lever, view = seen(self.chain, reading.instrument, reading.q, tool)
        columns = columns_of(part, self.bases, at, lever, turns=reading.instrument.is_angle)
        values = np.asarray(reading.values)
        n = values.shape[0]
        view = replace(
            view,
            point=np.broadcast_to(view.point, (n, 3)),
            turn=np.broadcast_to(view.turn, (n, 3, 3)),
        )
        _refuse_scattered(reading, view.point)
        columns = np.broadcast_to(columns, (n, *columns.shape[-2:]))
        whole = values if reading.total else values + reading.instrument.nominal(view)
        return view, columns, whole

    def block(self, k: int, instrument: Instrument) -> tuple[FloatArray, FloatArray]:
        """Return columns (n, m, p) and readings less their nominal (n, m) of one set."""
        view, columns, whole = self.parts[k]
        block = np.zeros((*whole.shape, len(self.names)))
        block[..., : self.n_terms] = instrument.of_errors(view) @ columns
        for name, where in self.unknown_at[k].items():
            form = self.forms[k].columns[:, None, :] if name == "form" else None
            block[..., where] = instrument.of_unknown(name, view) if form is None else form
        return block, whole - instrument.nominal(view)

    def with_tool(
        self, k: int, instrument: Instrument, beta: FloatArray, by: FloatArray
    ) -> FloatArray:
        """Return what a set would read, shape (n, m), with its tool point moved."""
        view, columns, _ = self._fixed(self.sets[k], by)
        E = columns @ beta[: self.n_terms]
        read = np.einsum("nmi,ni->nm", instrument.of_errors(view), E)
        return np.asarray(read + instrument.nominal(view))

    def assembled(self, current: list[Instrument], good: list[Any]) -> System:
        """Return the linear problem about the current set-ups."""
        blocks, rests, streams, rows, ends, at = [], [], [], [], [], 0
        for k, instrument in enumerate(current):
            block, rest = self.block(k, instrument)
            m = rest.shape[1]
            chosen = []
            for c in range(m):
                index = np.flatnonzero(good[k][:, c])
                chosen.append(index * m + c)
                rows_of = np.arange(at, at + index.size)
                group = next(
                    i
                    for i, (which, series) in enumerate(self.groups)
                    if which == k and c in series
                )
                streams.append(Stream(rows_of, index.astype(np.float64), k, group))
                blocks.append(block[index, c])
                rests.append(rest[index, c])
                at += index.size
            rows.append(np.concatenate(chosen))
            ends.append(at)
        X, y = np.concatenate(blocks), np.concatenate(rests)
        self._without_rounding(X)
        sizes = np.linalg.norm(X, axis=0)
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        scaled = X / sizes
        if self._structural is not None:
            # what the set-ups as they were given cannot tell, the ones found tell by rounding only
            fixed = np.linalg.qr(self._structural * sizes[:, None])[0]
            scaled = scaled - (scaled @ fixed) @ fixed.T
        _, singular, directions = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
        singular = np.append(singular, np.zeros(len(self.names) - singular.size))
        known = singular > NULL * singular[0]
        if self._structural is None:
            self._structural = directions[~known].T / sizes[:, None]
        if X.shape[0] <= int(known.sum()):
            raise TooFewSamplesError(
                f"{X.shape[0]} readings for {int(known.sum())} unknowns that they could tell; "
                "take more, or lower the degrees"
            )
        V, blind = directions[known].T, directions[~known].T
        return System(X, y, sizes, V, blind, singular, streams, rows, ends)

    def _without_rounding(self, X: FloatArray) -> None:
        """Set columns to zero that are rounding: a ball across the plane of a circle, a term across the readings."""
        own = X[:, : self.n_terms]
        whole = sum(np.sum(columns**2, axis=(0, 1)) for _, columns, _ in self.parts)
        own[:, np.sum(own**2, axis=0) < _SEEN**2 * whole] = 0.0
        for at in self.unknown_at:
            for where in at.values():
                if where.stop - where.start == 3:
                    size = np.linalg.norm(X[:, where], axis=0)
                    X[:, where][:, size < _SEEN * size.max()] = 0.0

    def noise_of(self, k: int, fit: Fit) -> float:
        """Return the noise of one reading of a set, the RMS over its series."""
        parts = [
            (len(series), float(s) ** 2)
            for (which, series), s in zip(self.groups, fit.scales, strict=True)
            if which == k
        ]
        return math.sqrt(sum(n * v for n, v in parts) / sum(n for n, _ in parts))

    def alike(self, system: System) -> list[NDArray[np.intp]]:
        """Return by stream which readings are one number at one place, as whole numbers from 0."""
        found, begin = [], 0
        for stream in system.streams:
            if stream.rows.size and stream.rows[0] in (0, *system.ends):
                begin = 0  # the first column of a set
            reading = self.sets[stream.which]
            n, m = np.asarray(reading.values).shape
            at = system.rows[stream.which][begin : begin + stream.rows.size]
            begin += stream.rows.size
            listed = [np.broadcast_to(v, (n,))[at // m] for v in reading.q.values()]
            values = np.asarray(reading.values).ravel()[at]
            # 1e-9 m or rad is one place; the step is far above the rounding of its multiples
            keys = np.column_stack([*(np.round(v, 9) for v in listed), np.round(values, 12)])
            found.append(np.unique(keys, axis=0, return_inverse=True)[1].ravel())
        return found

    def start(self, robust: bool) -> tuple[list[Instrument], list[Any]]:
        """Return set-ups where the readings put them, and the readings that are not grossly wrong."""
        current = [s.instrument for s in self.sets]
        good = [np.isfinite(np.asarray(s.values)) for s in self.sets]
        try:
            current = self.placed(current, good, _least)
        except (NotConvergedError, UnitError):  # a place is far from where it was stated
            self._structural = None
            current = [self._alone(k, i, good[k]) for k, i in enumerate(current)]
            current = self.placed(current, good, _least)
        if robust:
            current = self.placed(current, good, _huber)
            good = self.without_gross(self.assembled(current, good), good)
        return current, good

    def placed(
        self, current: list[Instrument], good: list[Any], solve: Callable[[System], FloatArray]
    ) -> list[Instrument]:
        """Return the set-ups where the readings put them (Gauss-Newton)."""
        moved: Sequence[float] = ()
        for _ in range(_STEPS):
            beta = solve(self.assembled(current, good))
            current, moved = zip(  # type: ignore[assignment]
                *(self._moved(k, i, beta) for k, i in enumerate(current)), strict=True
            )
            if max(moved) < _SETTLED:
                return list(current)
        raise NotConvergedError(
            f"{self.labels[int(np.argmax(moved))]}: the set-up does not settle in {_STEPS} steps; start closer "
            "than 50 mm, or take more places"
        )

    def _moved(self, k: int, instrument: Instrument, beta: FloatArray) -> tuple[Instrument, float]:
        """Return one set-up moved by what was found of it, and the largest move in m."""
        largest = 0.0
        for name, where in self.unknown_at[k].items():
            if is_place(instrument, name):
                instrument = instrument.moved(name, beta[where])
                largest = max(largest, float(np.abs(beta[where]).max()))
        return instrument, largest

    def _alone(self, k: int, instrument: Instrument, good: NDArray[np.bool_]) -> Instrument:
        """Return a set-up where its readings put it on a machine without errors."""
        places = [n for n in self.unknown_at[k] if is_place(instrument, n)]
        if not places:
            return instrument
        own = np.concatenate([np.arange(at.start, at.stop) for at in self.unknown_at[k].values()])
        beta, off = np.zeros(len(self.names)), math.inf
        try:
            for _ in range(_STEPS):
                block, rest = self.block(k, instrument)
                X, y = block[good][:, own], rest[good]
                beta[own] = np.linalg.lstsq(X, y, rcond=NULL)[0]
                off = float(np.sqrt(np.mean((y - X @ beta[own]) ** 2)))
                instrument, moved = self._moved(k, instrument, beta)
                if moved < _SETTLED:
                    break
        except UnitError:  # beyond any machine
            off = math.inf
        if off > LARGEST["m"]:
            raise DataError(
                f"{self.labels[k]}: there is no {places[0]} from which the nominal machine would be read like this; "
                "check the unit and the sign of its readings and positions, whether they hold the nominal (total), "
                f"and the {places[0]} that is stated"
            )
        return instrument

    def without_gross(self, system: System, good: list[Any]) -> list[Any]:
        """Return which readings are left when gross contradictions are removed."""
        beta = _huber(system)
        rest = np.abs(system.y - system.X @ beta)
        used = np.sum(np.linalg.qr(system.design)[0] ** 2, axis=1)
        gross = []
        for (k, _), rows in zip(self.groups, system.of_groups, strict=True):
            if not rows.size:
                continue
            part = rest[rows]
            scale = 1.4826 * float(np.median(part))
            floor = 1e-9 * float(np.abs(system.y[rows]).max())
            bad = part > max(_GROSS * max(scale, floor), self.steps[k])
            # more than half of those that the unknowns leave over cannot be told from the others
            most = int(max(part.size - float(used[rows].sum()), 0.0) / 2.0)
            bad[np.argsort(part, kind="stable")[: part.size - most]] = False
            gross.append(rows[bad])
        return system.readings_at(good, np.concatenate(gross), False)

    def _with_likely(self, current: list[Instrument], good: list[Any]) -> list[Any]:
        """Return the readings with those of short sets that the rest cannot call wrong, nearest first.

        The scatter of those that fit best says little: by few degrees one must be very far off. As
        readings come back the limit falls (Hadi and Simonoff, J. Am. Stat. Assoc. 88 (1993) 1264).
        """
        good = [g.copy() for g in good]
        open_to = [
            np.isfinite(np.asarray(s.values)) & ~g for s, g in zip(self.sets, good, strict=True)
        ]
        open_to = [o if o.shape[0] < _SHORT else np.zeros_like(o) for o in open_to]
        for _ in range(sum(int(o.sum()) for o in open_to)):
            system = self.assembled(current, good)
            fit = Gls(system.design, system.y, system.streams, self.stated).plain()
            degrees = degrees_of(system.design, system.streams, fit, self.stated)
            wider = self.assembled(current, [g | o for g, o in zip(good, open_to, strict=True)])
            Z = (wider.X / system.sizes) @ system.V
            off = np.abs(wider.y - Z @ fit.beta)
            shift = np.sum((Z @ fit.cov) * Z, axis=1)
            is_open = np.concatenate(
                [o.reshape(-1)[r] for o, r in zip(open_to, wider.rows, strict=True)]
            )
            back = []
            for i, of_group in enumerate(wider.of_groups):
                rows = of_group[is_open[of_group]]
                if not rows.size:
                    continue
                t = off[rows] / np.sqrt(fit.scales[i] ** 2 + shift[rows])
                nearest = int(np.argmin(t))
                step = self.steps[self.groups[i][0]]
                if t[nearest] <= limit_of(degrees[i]) or off[rows[nearest]] <= step:
                    back.append(rows[nearest])
            if not back:
                break
            good = wider.readings_at(good, np.array(back), True)
            open_to = wider.readings_at(open_to, np.array(back), False)
        return good

    def settled(
        self, current: list[Instrument], good: list[Any], robust: bool
    ) -> tuple[Fit, System, list[Any]]:
        """Return the fit with its noise when no further reading is refused, and what is left."""
        stated = self.stated
        if robust:
            good = self._with_likely(current, good)
        for _ in range(ROUNDS):
            system = self.assembled(current, good)
            Z = system.design
            fit = Gls(Z, system.y, system.streams, stated).best()
            t = _deleted(Z, system, fit)
            degrees = degrees_of(Z, system.streams, fit, stated)
            rest = system.y - Z @ fit.beta
            # robust: one bad reading must not hide another, nor hide behind a scale of its making
            scale = max(1.4826 * float(np.median(np.abs(t))), 1.0)
            bad = np.zeros(t.size, dtype=bool)
            for i, mine in enumerate(system.of_groups):
                if not mine.size:
                    continue
                of_all = np.abs(t[mine])
                if stated[i] is None:
                    of_all = of_all * _scale_without(Z[mine], rest[mine], i, fit, degrees[i])
                # off by a digit of the display is no contradiction
                bad[mine] = (of_all > scale * limit_of(degrees[i] - 1.0)) & (
                    np.abs(rest[mine]) > self.steps[self.groups[i][0]]
                )
            if not robust or not bad.any():
                break
            good = system.readings_at(good, np.flatnonzero(bad), False)
        else:  # readings were refused in the last round too: fit what is left
            system = self.assembled(current, good)
            fit = Gls(system.design, system.y, system.streams, stated).best()
        return fit, system, good

    def lacking(
        self,
        current: list[Instrument],
        good: list[Any],
        system: System,
        fit: Fit,
        homes: Mapping[str, float],
    ) -> dict[str, int]:
        """Return axes whose next order the residuals hold beyond chance, and that order (score test)."""
        from scipy.stats import chi2 as chi2_of

        more = {}
        for name, basis in self.wanted.items():
            further = _next(self, name, basis, homes)
            if further is not None:
                more[name] = further
        if not more:
            return {}
        wider = Problem(self.chain, more, self.sets)
        X = wider.assembled(current, good).X[:, : wider.n_terms]
        Z = system.design
        rest = system.y - Z @ fit.beta
        whole = np.column_stack([X, Z, rest])
        solved = np.empty_like(whole)
        for stream in system.streams:
            rows = stream.rows
            part, _ = inverse_times(whole[rows], stream.index, fit.a, fit.tau)
            solved[rows] = part / fit.scales[stream.group] ** 2
        k = wider.n_terms
        across = Z.T @ solved[:, :k]
        plain = X.T @ solved[:, :k]
        information = plain - across.T @ fit.cov @ across
        # what the fitted orders hold already shows by rounding only
        new = np.diag(information) > _SEEN * np.diag(plain)
        score = X.T @ solved[:, -1]
        axes = [axis_of_term(self.chain, name.split(" ")[0]) for name in wider.names[:k]]
        found = {}
        for axis in dict.fromkeys(axes):
            mine = [i for i, a in enumerate(axes) if a == axis and new[i]]
            if not mine:
                continue
            own = information[np.ix_(mine, mine)]
            size = np.sqrt(np.diag(own))
            values, vectors = np.linalg.eigh(own / np.outer(size, size))
            kept = values > 1e-6 * max(values.max(), 1.0)
            parts = vectors[:, kept].T @ (score[mine] / size)
            size_of = float(np.sum(parts**2 / values[kept]))
            if kept.any() and chi2_of.sf(size_of, int(kept.sum())) < _CHANCE:
                orders = [max(more[n].orders) for n in more if axis_of_term(self.chain, n) == axis]
                found[axis] = max(orders)
        return found


def _refuse_scattered(reading: ReadingSet, point: FloatArray) -> None:
    """Refuse poses that do not take a nest to one ball: columns, units or the machine are others."""
    ball = getattr(reading.instrument, "ball", None)
    is_nest = reading.instrument.n_readings == 3
    if not is_nest or (ball is None and "ball" not in reading.unknown):
        return
    is_known = ball is not None and "ball" not in reading.unknown
    centre = np.asarray(ball) if is_known else np.median(point, axis=0)
    off = np.linalg.norm(point - centre, axis=-1)
    if off.max() > _ONE_BALL:
        i = int(np.argmax(off))
        from_what = "the ball" if is_known else "the place of most others"
        raise DataError(
            f"{reading.label}: the axes do not take the tool to one ball of the workpiece: at reading "
            f"{i + 1} it stands {format_length(float(off[i]))} from {from_what}; check units and order of the "
            "columns of the axes, the tool, and whether the machine is this one"
        )
    beside = 0.0 if ball is None else float(np.linalg.norm(centre - np.asarray(ball)))
    if beside > _NEAR:
        where = ", ".join(format_length(float(v)) for v in centre)
        raise DataError(
            f"{reading.label}: the axes take the tool to {where}, which is {format_length(beside)} from the ball "
            "that the set-up states; check the unit of the columns of the axes, the tool and the ball, or leave "
            "the ball out where nothing is known of it"
        )


def resolution_of(values: ArrayLike) -> float:
    """Return the step that all differences of readings are multiples of (Euclid); 0 where all are one."""
    listed = np.asarray(values, dtype=np.float64).ravel()
    listed = np.unique(listed[np.isfinite(listed)])
    rounding = 1e-14 * float(np.abs(listed).max(initial=0.0))
    gaps = np.diff(listed)
    gaps = gaps[gaps > rounding]
    if not gaps.size:
        return 0.0
    step = float(gaps.min())
    while step > rounding:
        left = np.abs(gaps - np.rint(gaps / step) * step)
        more = left[left > 1e-3 * step]
        if not more.size:
            return step
        step = float(more.min())
    return rounding


def places_seen(sets: Sequence[ReadingSet]) -> int:
    """Return the number of readings when those at one place of a set are counted once."""
    total = 0
    for reading in sets:
        n, k = np.asarray(reading.values).shape
        listed = [np.broadcast_to(v, (n,)) for v in reading.q.values()]
        places = np.round(np.column_stack(listed or [np.zeros(n)]), 9)
        total += k * int(np.unique(places, axis=0).shape[0])
    return total


def axis_of_term(chain: Chain, term: str) -> str:
    return next(e.name for e in chain.elements if term in element_terms(e))


def is_stated(axis: str, chain: Chain, degrees: int | Mapping[str, int] | None) -> bool:
    """Return whether the degree of an axis was given by the caller."""
    if not isinstance(degrees, Mapping):
        return degrees is not None
    return axis in degrees or any(
        axis_of_term(chain, t) == axis for t in degrees if t in chain.terms
    )


def _next(problem: Problem, term: str, basis: Basis, homes: Mapping[str, float]) -> Basis | None:
    """Return the next order of a term alone; None where it has none or the places do not show it."""
    if basis.kind == "constant":
        return None
    if not basis.orders:
        return lowest_of(problem, term, homes)
    whole = _of_degree(problem, term, max(basis.orders) + 1, homes)
    if whole is None:
        return None
    last = tuple(n for n in whole.orders if n > max(basis.orders))
    if not last:
        return None
    return replace(whole, orders=last, off=None if whole.off is None else whole.off[-len(last) :])


def lowest_of(problem: Problem, term: str, homes: Mapping[str, float]) -> Basis | None:
    """Return the lowest order of a term that has none yet; None where the places do not show it."""
    tried = (_of_degree(problem, term, n, homes) for n in _LOWEST)
    return next((basis for basis in tried if basis is not None), None)


def _of_degree(
    problem: Problem, term: str, degree: int, homes: Mapping[str, float]
) -> Basis | None:
    element = next(e for e in problem.chain.elements if term in element_terms(e))
    places = places_of(element, problem.sets)
    if places is None:
        return None
    try:
        return basis_of(element, term, places, degree, homes.get(element.name, 0.0))
    except TooFewSamplesError:
        return None


def with_order(
    problem: Problem, term: str, raised: Mapping[str, int], homes: Mapping[str, float]
) -> Basis:
    """Return the shapes of a term with the order that its axis needs."""
    basis, axis = problem.wanted[term], axis_of_term(problem.chain, term)
    if basis.kind == "constant" or axis not in raised:
        return basis
    return _of_degree(problem, term, raised[axis], homes) or basis


def _groups(sets: Sequence[ReadingSet]) -> list[tuple[int, tuple[int, ...]]]:
    """Return the series that share a scale of noise: their set, and their columns of its readings."""
    found: list[tuple[int, tuple[int, ...]]] = []
    for k, reading in enumerate(sets):
        values = np.asarray(reading.values)
        counts = np.isfinite(values).sum(axis=0)
        # a channel that stands has no noise of its own to learn: it would outweigh all others
        own = counts.min() >= _OWN_NOISE and bool(
            (np.nanmax(values, 0) > np.nanmin(values, 0)).all()
        )
        if reading.u is None and own:
            found += [(k, (c,)) for c in range(counts.size)]
        else:
            found.append((k, tuple(range(counts.size))))
    return found


def _labels(sets: Sequence[ReadingSet]) -> list[str]:
    """Return a name for each set; those that share one are numbered."""
    names = [s.label for s in sets]
    return [
        f"{n} {names[: i + 1].count(n)}" if names.count(n) > 1 else n for i, n in enumerate(names)
    ]


def is_place(instrument: Instrument, name: str) -> bool:
    """Return whether an unknown is a place, which the direction of the reading depends on."""
    return name in ("station", "ball") and hasattr(instrument, "_away")


def _least(system: System) -> FloatArray:
    """Return the least-squares solution of smallest scaled size."""
    found = np.linalg.lstsq(system.design, system.y, rcond=None)[0]
    return np.asarray(system.V @ found / system.sizes)


def _huber(system: System) -> FloatArray:
    """Return the solution with Huber weights, each group with its own robust scale."""
    Q, R = np.linalg.qr(system.design, mode="reduced")
    free = np.sqrt(np.maximum(1.0 - np.sum(Q**2, axis=1), 1e-6))
    weights = np.ones(system.y.size)
    found = np.zeros(Q.shape[1])
    for _ in range(20):
        weighted = Q * weights[:, None]
        found = np.linalg.solve(weighted.T @ Q, weighted.T @ system.y)
        rest, new = system.y - Q @ found, np.ones(system.y.size)
        for rows in system.of_groups:
            if not rows.size:
                continue
            part = np.abs(rest[rows]) / free[rows]
            scale = max(1.4826 * float(np.median(part)), 1e-30)
            new[rows] = np.minimum(1.0, _HUBER * scale / np.maximum(part, 1e-30))
        settled = np.abs(new - weights).max() < 1e-3
        weights = new
        if settled:
            break
    return np.asarray(system.V @ np.linalg.solve(R, found) / system.sizes)


def limit_of(degrees: float) -> float:
    """Return how many standard deviations of so many degrees are as unlikely as four that are known."""
    from scipy.stats import t as student

    chance = 0.5 * math.erfc(_REFUSED / math.sqrt(2.0))
    return float(student.isf(chance, degrees)) if degrees > 0.0 else math.inf


def _scale_without(
    Z: FloatArray, rest: FloatArray, i: int, fit: Fit, degrees: float
) -> FloatArray:
    """Return the scale of a group over that which it would have without each of its readings."""
    w = 1.0 / (fit.scales[i] ** 2 * (1.0 + fit.a**2))
    moves = Z @ fit.cov * w
    own = np.sum(moves * Z, axis=1)
    e = rest / np.maximum(1.0 - own, 1e-12)
    square = float(rest @ rest)
    # the others of the set, with the coefficients that the reading no longer moves
    left = square + 2.0 * e * (moves @ (Z.T @ rest))
    left += e**2 * (np.sum((moves @ (Z.T @ Z)) * moves, axis=1) - 1.0)
    floor = 1e-12 * square + 1e-36
    ratio = (
        (square + floor) / np.maximum(left, floor) * max(degrees - 1.0, 0.0) / max(degrees, 1.0)
    )
    return np.asarray(np.sqrt(ratio))


def _deleted(Z: FloatArray, system: System, fit: Fit) -> FloatArray:
    """Return each residual over the spread that all other readings, their drift too, give it."""
    rest = system.y - Z @ fit.beta
    t = np.empty(rest.size)
    for stream in system.streams:
        if not stream.rows.size:
            continue
        s = fit.scales[stream.group]
        both = np.column_stack([rest[stream.rows], Z[stream.rows]])
        solved, _ = inverse_times(both, stream.index, fit.a, fit.tau)
        solved /= s**2
        own = diagonal_of_inverse(stream.index, fit.a, fit.tau) / s**2
        own -= np.sum((solved[:, 1:] @ fit.cov) * solved[:, 1:], axis=1)
        t[stream.rows] = solved[:, 0] / np.sqrt(np.maximum(own, 1e-12 / s**2))
    return t

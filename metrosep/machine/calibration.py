"""Calibration of a whole machine: error motions and location errors from readings of instruments.

Each set of readings is ``y = g(errors, unknowns of its set-up) + noise``: the columns are those of
`Chain.read`, so whatever an instrument reads can be put together. What is only a convention is not
fitted (`metrosep.machine._bases`); what the readings cannot tell apart is named, and the terms in it
are NaN. Noise: white, and drift common to all sets, learnt from the readings (machines.md, eq. 17).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_engineering, format_length
from metrosep.machine._bases import Basis, CurveTerm, UnseenTerm, null_sentences
from metrosep.machine._drift_noise import (
    LARGEST_DRIFT,
    Fit,
    few_readings_covariance,
    rounding_covariance,
)
from metrosep.machine._lack_of_fit import beyond_orders, lack_of_fit
from metrosep.machine._model_choice import (
    channels_that_stand,
    exchanged_channels,
    factors_of_sets,
    harmonics_alike,
    lines_left,
    raised_degrees,
    repeated_rows,
    sets_that_add_nothing,
    shapes_left,
    tools_else,
    unequal_noise,
)
from metrosep.machine._reading_problem import (
    LARGEST,
    NULL,
    ROUNDS,
    Problem,
    ReadingSet,
    System,
    axis_of_term,
    bases_of,
    columns_of,
    is_place,
    is_stated,
    lowest_of,
    with_order,
)
from metrosep.machine.chains import Chain, Positions
from metrosep.machine.elements import term_unit
from metrosep.machine.instruments import Instrument, read
from metrosep.machine.terms import ConstantTerm, ErrorTerm

LARGEST_ERROR = {"m": 5e-6, "rad": 30e-6, "1": math.inf}
"""A direction with a larger standard uncertainty is reported: the readings hardly determine it."""

_LOUDER = 4.0
"""Times the noise of the other sets of an instrument: one in a thousand of sets of ten readings."""

_FINE = 1e-12  # m or rad: finer steps are those of numbers, not of a display

_CONTRADICTS, _STRONGEST = 10.0, 10.0


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
        Of the columns of unit length, null directions omitted.
    unknowns : mapping of str to mapping
        By set and name what was found of the set-up: ``(values, u)``; of ``form`` the profile of the
        artefact at the places of the set.
    residuals : mapping of str to ndarray
        By set, readings minus model; NaN where refused or not read.
    refused : mapping of str to int
        Number of readings that contradict the others, by set.
    noise : mapping of str to float
        By set the standard deviation of white noise, m or rad; of three readings the RMS.
    bases : mapping of str to Basis
        Shapes of each term.
    blind : ndarray, shape (p, k)
        Directions of the coefficients that no reading sees.
    sets : mapping of str to ReadingSet
        What was read, by set.
    messages : tuple of str
        Home, gauge, noise, what was not seen.
    audit : mapping
        Numbers with units in the keys.
    beyond : tuple of (mapping of str to Basis, ndarray), optional
        Shapes of each term with the orders that were not fitted behind the others, and the covariance of all
        their coefficients: u of curves and of places.
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
    sets: Mapping[str, ReadingSet] = field(repr=False)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)
    beyond: tuple[Mapping[str, Basis], FloatArray] | None = field(default=None, repr=False)

    def __getitem__(self, term: str) -> ErrorTerm:
        """Return the found error of a term; see `errors`."""
        if term not in self.errors:
            raise DataError(f"{term!r} was not asked for; there are {', '.join(self.errors)}")
        return self.errors[term]

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
        bases, cov = self.beyond or (self.bases, self.covariance)
        J = columns_of(self.chain, bases, q, tool)
        square = np.einsum("...ij,jk,...ik->...i", J, cov, J)
        past = {
            n: c.past(q[axis_of_term(self.chain, n)])
            for n, c in self.fitted.items()
            if isinstance(c, CurveTerm)
        }
        past = {n: away for n, away in past.items() if away.any()}
        if past:
            arms = self.chain.jacobian(q, tool=tool, terms=[*past])
            of_terms = np.stack(np.broadcast_arrays(*past.values()), axis=-1)
            square = square + np.sum((arms * of_terms[..., None, :]) ** 2, axis=-1)
        u = np.sqrt(np.maximum(square, 0.0))
        if self.blind.shape[1]:
            J = columns_of(self.chain, self.bases, q, tool)
            part = np.linalg.norm(J @ self.blind, axis=-1)
            u[part > 1e-6 * np.linalg.norm(J, axis=-1)] = math.inf
        return np.asarray(u)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, units in the keys or beside the values.

        Returns
        -------
        dict
            Keys ``machine``, ``terms``, ``null``, ``condition``, ``noise``, ``refused``,
            ``messages``, ``audit``. Of a curve ``values`` are those of all its orders: the first ``fitted``
            of them were fitted, the others are what the readings say of orders beyond. Polynomials lie
            between ``low`` and ``high`` (``position_unit``), less their value at ``home``; of an arc
            less ``off`` times 1 (and cos, sin). Past the ends the others keep their value at the end.
        """
        terms = {}
        for name, term in self.errors.items():
            found, basis = self.fitted[name], self.bases[name]
            if isinstance(found, CurveTerm):
                basis, values, u = found.basis, found.coefficients, np.sqrt(np.diag(found.cov))
            else:
                mine = [self.names.index(name)]
                values, u = self.coefficients[mine], np.sqrt(np.diag(self.covariance))[mine]
            known = not isinstance(term, UnseenTerm)
            terms[name] = {
                "unit": term_unit(self.chain, name),
                **basis.to_dict(),
                "fitted": len(self.bases[name].labels),
                "values": values.tolist() if known else None,
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
        axis or term. If omitted 3 and 2, and more where the residuals hold the next order, or where the
        readings are likelier by more than further coefficients cost.
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
    before directions below 1e-5 of the largest are called null (1e-9 in [1]_, which positions that are
    rounded to 1 um would pass). Readings are refused beyond 4
    standard deviations of what all others, their drift included, predict; with few of them beyond the
    value of Student's t that is as unlikely (33 with 3 degrees of freedom). Where the noise of a set is
    not stated u is such that 2 u hold 95.45 % by Student's t with the degrees of its set. Where the noise of a set is stated
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
    bases = bases_of(chain, sets, degrees, terms, homes)
    if not any(b.orders for b in bases.values()):
        raise DataError(
            "no term is left to find: the axes did not move, or the degrees are too low"
        )
    with one_blas_thread():
        problem = Problem(chain, bases, list(sets))
        found = _fitted(problem, robust, homes)
        free = [a for a in chain.axes if not is_stated(a, chain, degrees)]
        for _ in range(ROUNDS):
            raised = {a: n for a, n in found.lacking.items() if a in free}
            raised = raised or found.raised(problem, free, homes)
            if not raised:
                break
            bases = {n: with_order(problem, n, raised, homes) for n in bases}
            problem = Problem(chain, bases, list(sets))
            found = _fitted(problem, robust, homes)
        return _result(problem, found, homes)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """The fit of a problem, and what its residuals still hold."""

    fit: Fit
    system: System
    current: list[Instrument]
    good: list[Any]
    lacking: Mapping[str, int]

    def raised(
        self, problem: Problem, axes: Sequence[str], homes: Mapping[str, float]
    ) -> dict[str, int]:
        """Return the axes whose curves must be of a higher degree, by likelihood."""
        return raised_degrees(problem, self.current, self.good, self.system, self.fit, axes, homes)


def _fitted(problem: Problem, robust: bool, homes: Mapping[str, float]) -> _Found:
    current, good = problem.start(robust)
    fit, system, good = problem.settled(current, good, robust)
    lacking = problem.lacking(current, good, system, fit, homes)
    return _Found(fit, system, current, good, lacking)


def _result(problem: Problem, found: _Found, homes: Mapping[str, float]) -> Calibration:
    chain, fit, system, current = problem.chain, found.fit, found.system, found.current
    sets = problem.sets
    beta = system.V @ fit.beta / system.sizes
    of_digits = rounding_covariance(
        system.design, system.streams, fit, problem.steps, problem.alike(system)
    )
    of_few = few_readings_covariance(system.design, system.streams, fit, problem.stated)
    left = beyond_orders(problem, current, found.good, system, fit)
    spread, size = left.cov.copy(), beta.size
    to_all = system.V / system.sizes[:, None]
    spread[:size, :size] += to_all @ (of_digits + of_few) @ to_all.T
    rest = system.y - system.X @ beta
    off = left.mean
    model = system.X @ off[:size] + left.columns @ off[size:]
    beta = beta + off[:size]
    exchanged = exchanged_channels(problem, current)
    residuals, noise, refused, chi2, n_stated = {}, {}, {}, 0.0, 0
    begin = 0
    for k, (reading, label) in enumerate(zip(sets, problem.labels, strict=True)):
        end = system.ends[k]
        values = np.full(np.asarray(reading.values).shape, math.nan)
        values.reshape(-1)[system.rows[k]] = (rest - model)[begin:end]
        residuals[label] = values[:, 0] if reading.instrument.n_readings == 1 else values
        refused[label] = int(np.isfinite(np.asarray(reading.values)).sum()) - (end - begin)
        noise[label] = problem.noise_of(k, fit)
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
                    + "".join(f". {said}" for said in exchanged)
                )
        begin = end
    messages = [*exchanged, _gauge(chain, homes), *_shapeless(problem, homes)]
    messages += [
        f"the readings hold more of {axis} than its orders: order {order} is there beyond chance; give a "
        f"higher degree ({axis}={order}); u of the curves contains what is missing"
        for axis, order in found.lacking.items()
    ]
    messages += harmonics_alike(problem)
    messages += sets_that_add_nothing(problem, system)
    messages += channels_that_stand(sets, problem.labels)
    if not exchanged:  # else what is left is the exchange
        messages += lines_left(problem, system, fit)
        lacks, judged = lack_of_fit(problem, current, found.good)
        messages += lacks
        messages += shapes_left(problem, system, fit, judged)
        messages += factors_of_sets(problem, system, fit)
        messages += tools_else(problem, current, system, fit)
        messages += unequal_noise(problem, system, fit)
    messages += repeated_rows(sets, problem.labels, [*noise.values()])
    messages += _louder(sets, problem.labels, noise)
    messages += _coarse(problem, noise)
    share = fit.beta.size * n_stated / max(system.y.size, 1)
    if n_stated:
        from scipy.stats import chi2 as chi2_of

        free = max(n_stated - share, 1.0)
        if chi2_of.sf(chi2, free) < 0.01:
            birge = math.sqrt(chi2 / free)
            spread = spread * birge**2
            messages.append(
                f"the model lacks something: residuals are {birge:.3g} times the stated noise; all u "
                "are raised by it"
            )
    p, cov = problem.n_terms, spread[: beta.size, : beta.size]
    blind = system.blind / system.sizes[:, None]
    null, members = null_sentences(system.blind, problem.names)
    unseen = {name.split(" ")[0] for group in members for name in group}
    sums = _sums(problem, members, blind, beta, cov)
    null = (
        *(n + sums.get(i, "") for i, n in enumerate(null)),
        *hardly_known(problem.names[:p], problem.units[:p], cov[:p, :p]),
    )
    every = np.append(beta, off[size:])
    curves = {
        n: CurveTerm(every[own], spread[np.ix_(own, own)], left.bases[n])
        for n, own in left.at.items()
    }
    errors, fitted = terms_found(chain, problem.bases, beta, cov, unseen, curves)
    of_terms = np.concatenate([*left.at.values()])
    unknowns: dict[str, Mapping[str, tuple[FloatArray, FloatArray]]] = {}
    u = np.sqrt(np.maximum(np.diag(cov), 0.0))
    for k, label in enumerate(problem.labels):
        of_set = {}
        for name, where in problem.unknown_at[k].items():
            if name == "form":
                shapes = problem.forms[k].columns
                square = np.einsum("ij,jk,ik->i", shapes, cov[where, where], shapes)
                of_set[name] = (shapes @ beta[where], np.sqrt(np.maximum(square, 0.0)))
                continue
            place = getattr(current[k], name, None) if is_place(current[k], name) else None
            of_set[name] = (
                beta[where] if place is None else np.asarray(place) + off[where],
                u[where],
            )
        if of_set:
            unknowns[label] = freeze_mapping(of_set)
    if fit.judged and not fit.white:
        messages.append(
            f"drift is {fit.a:.2g} times the white noise, over {fit.tau:.2g} readings; u contains it"
            + (
                ". So large a drift is mostly something else: a term that was not asked for, two columns that "
                "changed places, or the sign of one"
                if fit.a > 0.99 * LARGEST_DRIFT
                else ""
            )
        )
    elif not fit.judged:
        several = any(s.instrument.n_readings > 1 and s.u is None for s in sets)
        messages.append(
            "fewer than 30 readings in each series: drift cannot be judged, u is white"
            + (", and the three readings of a set share one noise" if several else "")
        )
    messages += [
        f"{label}: {n} readings contradict the others and were refused"
        for label, n in refused.items()
        if n
    ]
    missing = sum(int((~np.isfinite(np.asarray(s.values))).sum()) for s in sets)
    if missing:
        messages.append(f"{missing} readings are NaN and were omitted")
    known = system.singular[system.singular > NULL * system.singular[0]]
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
        sets=freeze_mapping(dict(zip(problem.labels, sets, strict=True))),
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
        beyond=(freeze_mapping(dict(left.bases)), spread[np.ix_(of_terms, of_terms)]),
    )


def terms_found(
    chain: Chain,
    bases: Mapping[str, Basis],
    beta: FloatArray,
    cov: FloatArray,
    unseen: set[str],
    curves: Mapping[str, CurveTerm],
    most: Mapping[str, float] = LARGEST,
) -> tuple[dict[str, ErrorTerm], dict[str, ErrorTerm]]:
    """Return terms, NaN where not determined, and the smallest that explain the readings."""
    errors: dict[str, ErrorTerm] = {}
    fitted: dict[str, ErrorTerm] = {}
    at = 0
    for name, basis in bases.items():
        mine = slice(at, at + len(basis.labels))
        at = mine.stop
        term: ErrorTerm
        if basis.kind == "constant":
            term = ConstantTerm(
                float(beta[mine][0]), u=math.sqrt(max(float(cov[mine, mine][0, 0]), 0.0))
            )
        else:
            term = curves.get(name) or CurveTerm(beta[mine], cov[mine, mine], basis)
        unit = term_unit(chain, name)
        largest = float(np.abs(beta[mine]).max())
        if largest > most[unit]:
            raise DataError(
                f"{name} would be {format_engineering(largest, unit)}, which no machine has: check the "
                "machine, the units, the forms of parts and the tool points of readings, or lower the degrees"
            )
        fitted[name] = term
        errors[name] = UnseenTerm() if name in unseen else term
    return errors, fitted


def hardly_known(names: Sequence[str], units: Sequence[str], cov: FloatArray) -> tuple[str, ...]:
    """Return a sentence for each direction whose u is beyond what any machine would have."""
    prior = np.array([LARGEST_ERROR[unit] for unit in units])
    values, vectors = np.linalg.eigh(cov / np.outer(prior, prior))
    sentences = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        if value <= 1.0:
            break
        part = np.abs(vector)
        chosen = [names[i] for i in np.argsort(-part) if part[i] > 0.3 * part.max()]
        sentences.append(
            f"{', '.join(chosen)}: hardly separable by these readings; u is {math.sqrt(value):.2g} times "
            f"what a machine has ({format_length(LARGEST_ERROR['m'])}, 30 urad)"
        )
    return tuple(sentences)


def _louder(
    sets: Sequence[ReadingSet], labels: Sequence[str], noise: Mapping[str, float]
) -> list[str]:
    """Return a sentence for each set whose residuals are far larger than those of its kind."""
    said = []
    for reading, label in zip(sets, labels, strict=True):
        kind = type(reading.instrument)
        others = [
            noise[other]
            for s, other in zip(sets, labels, strict=True)
            if type(s.instrument) is kind and other != label
        ]
        if len(others) > 1 and noise[label] > _LOUDER * float(np.median(others)) > 0.0:
            said.append(
                f"{label}: its residuals are {noise[label] / float(np.median(others)):.2g} times those of the "
                f"other {kind.__name__.lower()} sets; check its signs, its place and its poses"
            )
    return said


def _coarse(problem: Problem, noise: Mapping[str, float]) -> list[str]:
    """Return a sentence for each set whose display is coarser than its scatter, or whose step is not known."""
    said = []
    for reading, label, step in zip(problem.sets, problem.labels, problem.steps, strict=True):
        values = np.asarray(reading.values)
        unit = "rad" if reading.instrument.is_angle else "m"
        if step > 0.0 and noise[label] < step / math.sqrt(12.0) and step > _FINE:
            said.append(
                f"{label}: its readings scatter by less than their digit of {format_engineering(float(step), unit)}; "
                "u contains step/sqrt(12) of each, and repeats that show the same digit count once"
            )
        elif step == 0.0 and values.size > 1 and values.any():
            said.append(
                f"{label}: all readings are one value, so the step of the display is not known and u does not "
                "contain it; give its resolution"
            )
    return said


def _gauge(chain: Chain, homes: Mapping[str, float]) -> str:
    moved = [a for a, v in homes.items() if v != 0.0]
    where = ", ".join(f"{a} = {homes[a]:g}" for a in moved) if moved else "all axes at zero"
    return (
        f"errors of linear axes are zero at home ({where}); slopes of straightness are in squareness "
        f"and in the frame of the instrument; squareness is that of least-squares lines"
    )


def _sums(
    problem: Problem,
    members: Sequence[set[str]],
    blind: FloatArray,
    beta: FloatArray,
    cov: FloatArray,
) -> dict[int, str]:
    """Return by null direction of two terms the sum of them that the readings determine, and its u."""
    said = {}
    for i, group in enumerate(members):
        at = sorted(problem.names.index(n) for n in group)
        if (
            len(at) != 2
            or at[1] >= problem.n_terms
            or problem.units[at[0]] != problem.units[at[1]]
        ):
            continue
        U, singular, _ = np.linalg.svd(blind[at])
        if singular.size > 1 and singular[1] > NULL * singular[0]:
            continue  # each moves by itself in another direction
        c = U[:, 1] / U[0, 1]
        value, u = float(c @ beta[at]), math.sqrt(max(float(c @ cov[np.ix_(at, at)] @ c), 0.0))
        # 1 but for typed positions
        size = "" if abs(abs(c[1]) - 1.0) < 1e-3 else f"{abs(c[1]):.4g} "
        first, second = (problem.names[k] for k in at)
        unit = problem.units[at[0]]
        said[i] = (
            f": {first} {'+' if c[1] > 0.0 else '-'} {size}{second} is "
            f"{format_engineering(value, unit)} (u = {format_engineering(u, unit, digits=2)})"
        )
    return said


def _shapeless(problem: Problem, homes: Mapping[str, float]) -> list[str]:
    """Return a sentence for each axis with terms that its degree gives no shape: they are zero in the fit."""
    found: dict[str, list[str]] = {}
    for term, basis in problem.wanted.items():
        if not basis.orders:
            found.setdefault(axis_of_term(problem.chain, term), []).append(term)
    said = []
    for axis, terms in found.items():
        lowest = [b.orders[0] for t in terms if (b := lowest_of(problem, t, homes)) is not None]
        ask = (
            f"give a degree of {axis} ({axis}={max(lowest)}) to fit them"
            if lowest
            else f"more places of {axis} would show them"
        )
        said.append(
            f"{', '.join(terms)}: taken as zero, because the orders that were fitted are what the place and "
            f"the direction of {axis} do; {ask}"
        )
    return said


# ---- which set-up would add most -------------------------------------------------------------------


def plan_calibration(
    chain: Chain,
    candidates: Sequence[ReadingSet],
    *,
    volume: Positions,
    tools: Sequence[ArrayLike] = ((0.0, 0.0, 0.0),),
    noise: float = 1e-7,
    degrees: int | Mapping[str, int] | None = None,
    terms: Sequence[str] | None = None,
    done: Sequence[ReadingSet] = (),
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
    terms : sequence of str, optional
        As for `calibrate`.
    done : sequence of ReadingSet, optional
        What has been read already: the question is what candidates add to it.
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
    Information of a set-up: ``A'A / s^2``; unknowns of all set-ups are free (eq. 18 of [1]_, and the profile of an
    artefact that several share is one unknown); a prior of 5 um and 30 urad for each coefficient keeps
    the first steps finite. Noise is white.

    References
    ----------
    .. [1] machines.md, section 6.
    """
    if not candidates:
        raise DataError("no candidate is given")
    everything = [*candidates, *done]
    bases = bases_of(chain, everything, degrees, terms, {})
    if not any(b.orders for b in bases.values()):
        raise DataError("no term is left to find: the axes do not move in any candidate")
    problem = Problem(chain, bases, everything)
    p = problem.n_terms
    information = []
    for k, reading in enumerate(everything):
        good = np.isfinite(np.asarray(reading.values))
        rows = problem.block(k, reading.instrument)[0][good]
        information.append(rows.T @ rows / (reading.u or noise) ** 2)
    J = [columns_of(chain, problem.bases, volume, tool) for tool in tools]
    wanted = np.concatenate([j.reshape(-1, p) for j in J])
    square = wanted.T @ wanted / (wanted.shape[0] / 3)
    prior = np.array([LARGEST_ERROR[unit] for unit in problem.units[:p]])
    total = np.zeros((len(problem.names),) * 2)
    total[range(p), range(p)] = 1.0 / prior**2
    total += sum(information[len(candidates) :])
    left, order = list(range(len(candidates))), []
    for _ in range(min(len(left), most or len(left))):
        sizes = [_spread(total + information[k], p, square) for k in left]
        best = left.pop(int(np.argmin(sizes)))
        total = total + information[best]
        order.append((problem.labels[best], math.sqrt(min(sizes))))
    return order


def _spread(information: FloatArray, p: int, square: FloatArray) -> float:
    """Return the mean variance over the volume when unknowns of the set-ups (behind p) are free."""
    used = np.flatnonzero(np.diag(information)[p:] > 0.0) + p
    own = information[np.ix_(used, used)]
    size = np.sqrt(np.diag(own))
    values, vectors = np.linalg.eigh(own / np.outer(size, size))
    known = values > NULL * values.max(
        initial=0.0
    )  # of squares: what set-ups cannot tell apart takes nothing
    across = (information[:p][:, used] / size) @ (vectors[:, known] / np.sqrt(values[known]))
    rest = information[:p, :p] - across @ across.T
    scale = np.sqrt(np.diag(information)[:p])
    inverse = np.linalg.inv(rest / np.outer(scale, scale)) / np.outer(scale, scale)
    return float(np.sum(inverse * square))

"""Error terms as functions of temperatures, learnt from a record of readings beside thermometers.

A reading follows ``y(t) = y0 + sum_k g_k (x_k(t) - x_k,ref)``. The input ``x_k`` is the temperature of
a sensor, or the same behind a lag of first order, ``tau x' = T - x`` (exact for parabolas between
the samples; the machine is settled when the record begins). Which sensors and which time constants is
decided by prediction: whole blocks of time are left out and foretold from the others. Noise is white
plus drift, as everywhere in this package (`metrosep.machine._drift_noise`).

`error = actual - nominal` of the tool against the work, in the directions of the machine. Only changes
are known: an error is zero at the reference temperatures, and nothing is extrapolated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_engineering
from metrosep.machine._thermal_choice import (
    BLOCKS,
    Inputs,
    Reading,
    Record,
    Settled,
    by_log_lag,
    celsius,
    kelvins,
    lagged,
    times_of,
)
from metrosep.machine.elements import axis_of
from metrosep.machine.error_sets import ErrorSet, as_error_set
from metrosep.machine.terms import ConstantTerm, ErrorTerm, SumTerm, TableTerm, is_angle

_MARGIN = 1e-9  # of the range that was seen: rounding
_NOISE = 4.0  # standard deviations of a sensor by which its range is not beyond it


@dataclass(frozen=True, slots=True, eq=False)
class ThermalTerm:
    """One reading as a function of temperatures.

    Parameters
    ----------
    name : str
        Of the reading.
    unit : {"m", "rad"}
        Of its values.
    term : str or None
        ISO 230-1 name of the error that it is; None where it has none.
    place : float or None, m or rad
        Position of the axis of `term` at which it was read; None where the error is one for all.
    sensors : tuple of str
        Thermometers that it follows; empty where none foretells it.
    lags : tuple of float, s
        Time constant behind each; 0 follows at once.
    gains : ndarray, shape (k,), m/K or rad/K
        Change per kelvin.
    covariance : ndarray, shape (k + m, k + m)
        Of the gains, then of the natural logarithms of the m time constants above 0.
    reference : tuple of float, K
        Temperature of each sensor at which the error is zero.
    seen : tuple of (float, float)
        Least and greatest value of each input in the record.
    jitter : tuple of float, K
        Noise of each input from one sample to the next, by second differences.
    left : float, m or rad
        Standard deviation of the drift that the temperatures do not explain.
    """

    name: str
    unit: str
    term: str | None
    place: float | None
    sensors: tuple[str, ...]
    lags: tuple[float, ...]
    gains: FloatArray
    covariance: FloatArray
    reference: tuple[float, ...]
    seen: tuple[tuple[float, float], ...]
    jitter: tuple[float, ...]
    left: float

    def evaluate(
        self,
        temperatures: Mapping[str, ArrayLike | str],
        t: ArrayLike | None = None,
        *,
        beyond: str = "refuse",
    ) -> FloatArray:
        """Return the error at temperatures that have settled, or over a history of them.

        Parameters
        ----------
        temperatures : mapping of str to array_like, shape () or (n,), K
            By sensor, in the unit of the record; further sensors are ignored.
        t : array_like, shape (n,), s, optional
            Times of a history that begins settled. Without it every temperature has settled.
        beyond : {"refuse", "nan"}, optional
            What to do where an input lies outside what the record has seen.

        Returns
        -------
        ndarray, shape () or (n,), m or rad
            Actual minus nominal, zero at the reference temperatures.

        Raises
        ------
        DataError
            A sensor is missing.
        UnitError
            A temperature is not one in K.
        LimitError
            An input lies outside what the record has seen; nothing is extrapolated.
        InvalidSamplesError
            Times do not rise, or lengths differ.
        """
        numbers.choice(beyond, "beyond", ("refuse", "nan"))
        away, _ = self._inputs(temperatures, t, beyond)
        return np.asarray(away @ self.gains)

    @described_by(evaluate)
    def sd(
        self,
        temperatures: Mapping[str, ArrayLike | str],
        t: ArrayLike | None = None,
        *,
        beyond: str = "refuse",
    ) -> FloatArray:
        """Return the standard uncertainty: of gains, lags and sensors, and the drift that is left.

        Returns
        -------
        ndarray, shape () or (n,), m or rad
            One standard deviation.
        """
        numbers.choice(beyond, "beyond", ("refuse", "nan"))
        return self._spread(*self._inputs(temperatures, t, beyond))

    def at_end(
        self, temperatures: Mapping[str, ArrayLike | str], t: ArrayLike | None = None
    ) -> tuple[float, float]:
        """Return the error at the end of a history, whose earlier part may go beyond what was seen.

        Parameters
        ----------
        temperatures : mapping of str to array_like or str, K
            As of `evaluate`.
        t : array_like, shape (n,), s, optional
            Times of the history.

        Returns
        -------
        tuple of (float, float), m or rad
            The error and its standard uncertainty.
        """
        away, turned = self._inputs(temperatures, t, "end")
        return _last(away @ self.gains), _last(self._spread(away, turned))

    def _spread(self, away: FloatArray, turned: FloatArray) -> FloatArray:
        columns = np.concatenate([away, turned * self.gains], axis=-1)
        dynamic = [i for i, lag in enumerate(self.lags) if lag > 0.0]
        k = len(self.lags)
        columns = columns[..., [*range(k), *(k + i for i in dynamic)]]
        variance = np.einsum("...i,ij,...j->...", columns, self.covariance, columns)
        noise = float(np.sum((self.gains * np.asarray(self.jitter)) ** 2))
        return np.asarray(np.sqrt(np.maximum(variance, 0.0) + noise + self.left**2))

    def _inputs(
        self, temperatures: Mapping[str, ArrayLike | str], t: ArrayLike | None, beyond: str
    ) -> tuple[FloatArray, FloatArray]:
        """Return the inputs from their reference, and their derivative by the logarithm of the lag."""
        for name in self.sensors:
            if name not in temperatures:
                raise DataError(
                    f"{self.name} follows the sensor {name!r}, which is not given; given are "
                    f"{', '.join(temperatures) or 'none'}"
                )
        given = [kelvins(temperatures[n], n) for n in self.sensors]
        if t is None:
            shape = np.broadcast_shapes(*(g.shape for g in given), ())
            x = [np.broadcast_to(g, shape) for g in given]
            turned = [np.zeros(shape) for _ in given]
        else:
            times = times_of(t)
            shape = times.shape
            x, turned = [], []
            for name, values, lag in zip(self.sensors, given, self.lags, strict=True):
                if values.shape != times.shape or not np.isfinite(values).all():
                    raise InvalidSamplesError(
                        f"the history of {name!r} must be {times.size} finite temperatures, one for each "
                        f"time, got shape {values.shape}"
                    )
                x.append(lagged(times, values, lag))
                turned.append(by_log_lag(times, values, lag))
        columns = []
        for name, values, (low, high), zero, noise in zip(
            self.sensors, x, self.seen, self.reference, self.jitter, strict=True
        ):
            margin = max(_MARGIN * (high - low), _NOISE * noise)
            outside = np.atleast_1d(~((values >= low - margin) & (values <= high + margin)))
            if beyond == "end":
                outside[:-1] = False
            outside = outside.reshape(np.shape(values))
            if outside.any() and beyond != "nan":
                worst = float(values[outside].flat[0])
                raise LimitError(
                    f"{self.name}: the sensor {name!r} at {celsius(worst)} lies outside {celsius(low)} to "
                    f"{celsius(high)}, which the record has seen; nothing is extrapolated: record a "
                    "warm-up that covers it"
                )
            columns.append(np.where(outside, np.nan, values - zero))
        if not columns:
            return np.zeros((*shape, 0)), np.zeros((*shape, 0))
        return np.stack(columns, axis=-1), np.stack(turned, axis=-1)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, SI, of which `ThermalFit.from_dict` makes the term again.

        Returns
        -------
        dict
            A key for each parameter.
        """
        return {
            "name": self.name, "unit": self.unit, "term": self.term, "place": self.place,
            "sensors": list(self.sensors), "lags_s": list(self.lags), "gains": self.gains.tolist(),
            "covariance": self.covariance.tolist(), "reference": list(self.reference),
            "seen": [list(s) for s in self.seen], "jitter": list(self.jitter), "left": self.left,
        }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ThermalFit:
    """Readings as functions of temperatures, and how well they are foretold.

    Parameters
    ----------
    terms : mapping of str to ThermalTerm
        By reading.
    predicted : mapping of str to float, m or rad
        Root mean square of what is left of each block of time, foretold from the others.
    drift : mapping of str to float, m or rad
        The same where no temperature is used: by the mean of the other blocks.
    scores : mapping of str to tuple of float, m or rad
        Predicted RMS with 0, 1, 2 ... sensors.
    correlation : ndarray, shape (r, r)
        Of the residuals of the readings at equal times.
    t : ndarray, shape (n,), s
        Times of the record.
    readings, residuals : mapping of str to ndarray, shape (n,), m or rad
        What was read, and what is left of it; NaN where it took no part.
    messages : tuple of str
        What the user should know.
    audit : mapping
        Blocks, time constants tried.
    """

    terms: Mapping[str, ThermalTerm]
    predicted: Mapping[str, float]
    drift: Mapping[str, float]
    scores: Mapping[str, tuple[float, ...]]
    correlation: FloatArray
    t: FloatArray = field(default_factory=lambda: np.zeros(0))
    readings: Mapping[str, FloatArray] = field(default_factory=dict)
    residuals: Mapping[str, FloatArray] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def errors(
        self,
        temperatures: Mapping[str, ArrayLike | str],
        t: ArrayLike | None = None,
        *,
        onto: ErrorSet | Mapping[str, Any] | None = None,
    ) -> ErrorSet:
        """Return the errors of the machine at temperatures, as chains and tables take them.

        Parameters
        ----------
        temperatures : mapping of str to array_like, shape () or (n,), K
            That have settled; with `t` a history, whose end counts.
        t : array_like, shape (n,), s, optional
            Times of the history.
        onto : ErrorSet or mapping, optional
            Errors at the reference temperatures, to which these are added.

        Returns
        -------
        ErrorSet
            A constant for each reading that is an error of the machine; a table over the axis where
            it was read at several places.

        Raises
        ------
        DataError
            No reading is an error of the machine, or as of `ThermalTerm.evaluate`.
        LimitError
            An input lies outside what the record has seen.
        """
        if t is None and any(np.ndim(v) for v in temperatures.values() if not isinstance(v, str)):
            raise DataError(
                "temperatures that have settled are one number for each sensor; several are a history and "
                "need t, their times"
            )
        places: dict[str, list[ThermalTerm]] = {}
        for part in self.terms.values():
            if part.term is not None:
                places.setdefault(part.term, []).append(part)
        if not places:
            raise DataError(
                f"none of the readings {', '.join(self.terms)} is an error of a machine: name the term of "
                'each, terms={"EZ0C": "EZZ"}'
            )
        found: dict[str, Any] = {}
        for term, parts in places.items():
            here, u = zip(*(p.at_end(temperatures, t) for p in parts), strict=True)
            if parts[0].place is None:
                found[term] = ConstantTerm(here[0], u[0])
                continue
            order = sorted(range(len(parts)), key=lambda i: parts[i].place or 0.0)
            found[term] = TableTerm(
                [parts[i].place or 0.0 for i in order], [here[i] for i in order], [u[i] for i in order]
            )  # fmt: skip
        related = {}
        names = list(self.terms)
        for one, two in _pairs([n for n in names if self.terms[n].place is None]):
            first, second = self.terms[one].term, self.terms[two].term
            r = float(self.correlation[names.index(one), names.index(two)])
            if first is not None and second is not None and r != 0.0:
                related[(first, second)] = r
        if onto is None:
            return ErrorSet(found, correlations=related)
        given = as_error_set(onto)
        both: dict[str, ErrorTerm] = dict(given.terms)
        for term, value in found.items():
            both[term] = SumTerm((both[term], value)) if term in both else value
        kept = {p: r for p, r in related.items() if not set(p) & set(given.terms)}
        kept |= {p: r for p, r in given.correlations.items() if not set(p) & set(found)}
        return ErrorSet(both, correlations=kept)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, SI; the record itself is omitted.

        Returns
        -------
        dict
            Keys ``terms``, ``predicted``, ``drift``, ``scores``, ``correlation``, ``messages``,
            ``audit``.
        """
        return {
            "terms": [v.to_dict() for v in self.terms.values()],
            "predicted": dict(self.predicted),
            "drift": dict(self.drift),
            "scores": {k: list(v) for k, v in self.scores.items()},
            "correlation": self.correlation.tolist(),
            "messages": list(self.messages),
            "audit": dict(self.audit),
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> ThermalFit:
        """Return the fit that `to_dict` stored, without its record.

        Parameters
        ----------
        document : mapping
            What `to_dict` returned.

        Returns
        -------
        ThermalFit
            Ready for `errors`.

        Raises
        ------
        DataError
            A key is missing or of another kind.
        """
        try:
            terms = [
                ThermalTerm(
                    str(d["name"]), str(d["unit"]), d["term"], d["place"], tuple(d["sensors"]),
                    tuple(d["lags_s"]), np.array(d["gains"], dtype=np.float64),
                    np.array(d["covariance"], dtype=np.float64).reshape((len(d["covariance"]),) * 2),
                    tuple(d["reference"]), tuple((s[0], s[1]) for s in d["seen"]),
                    tuple(d["jitter"]), float(d["left"]),
                )
                for d in document["terms"]
            ]  # fmt: skip
            return cls(
                terms=freeze_mapping({d.name: d for d in terms}),
                predicted=dict(document["predicted"]),
                drift=dict(document["drift"]),
                scores={k: tuple(v) for k, v in document["scores"].items()},
                correlation=np.array(document["correlation"], dtype=np.float64),
                messages=tuple(document["messages"]),
                audit=dict(document["audit"]),
            )
        except (KeyError, TypeError, ValueError, IndexError) as exc:
            raise DataError(
                f"not a stored fit of 'metrosep thermal' ({type(exc).__name__}: {exc}); fit the record again"
            ) from None

    def report(self) -> str:
        """Return the result as text: a line for each reading, then messages.

        Returns
        -------
        str
            For people.
        """
        lines = []
        for name, term in self.terms.items():
            unit = term.unit
            u = np.sqrt(np.diag(term.covariance))
            parts = []
            for i, (sensor, lag) in enumerate(zip(term.sensors, term.lags, strict=True)):
                gain = format_engineering(float(term.gains[i]), unit) + "/K"
                spread = format_engineering(float(u[i]), unit, digits=2) + "/K"
                behind = f" behind {format_engineering(lag, 's')}" if lag else ""
                parts.append(f"{gain} of {sensor}{behind} (u = {spread})")
            what = " + ".join(parts) or "no temperature foretells it"
            lines.append(f"{name:8s} {what}")
            lines.append(
                f"{'':8s} left of blocks foretold from the others: "
                f"{format_engineering(self.predicted[name], unit)} RMS of "
                f"{format_engineering(self.drift[name], unit)}"
            )
        return "\n".join([*lines, *self.messages])

    def __repr__(self) -> str:
        listed = ", ".join(f"{n}: {'+'.join(v.sensors) or 'none'}" for n, v in self.terms.items())
        return f"ThermalFit({listed})"


def fit_thermal(
    t: ArrayLike,
    temperatures: Mapping[str, ArrayLike | str],
    readings: Mapping[str, ArrayLike],
    *,
    terms: Mapping[str, str | tuple[str, float]] | None = None,
    lags: Sequence[float] | None = None,
    blocks: int = BLOCKS,
    most: int = 3,
    reference: Mapping[str, float | str] | None = None,
    angular: Sequence[str] = (),
) -> ThermalFit:
    """Return readings as functions of temperatures, chosen by how well they foretell.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Times, strictly rising. The machine has settled when they begin.
    temperatures : mapping of str to array_like, shape (n,), K
        By sensor. Between known temperatures a straight line stands for NaN, and is said.
    readings : mapping of str to array_like, shape (n,), m or rad
        Displacements or tilts of tool against work (ISO 230-3), by name; NaN where not read.
    terms : mapping of str to str or (str, float), optional
        Which error of the machine a reading is, ``{"EZ0C": "EZZ"}``, and at which position of its
        axis where it differs, ``{"near": ("EXX", 0.05), "far": ("EXX", 0.45)}``. Left out: the
        readings whose names are ISO 230-1 names.
    lags : sequence of float, s, optional
        Time constants to try beside 0; if omitted from two samples to half of the record.
    blocks : int, optional
        Into how many blocks of equal time the record is cut, at least 3.
    most : int, optional
        Largest number of sensors of a reading.
    reference : mapping of str to float or str, K, optional
        Temperatures at which the errors are zero; those at the beginning if omitted.
    angular : sequence of str, optional
        Readings in rad that have no term.

    Returns
    -------
    ThermalFit
        A `ThermalTerm` for each reading, predicted RMS, messages.

    Raises
    ------
    DataError
        A name is unknown or nothing is given, or a reference lies outside what was seen.
    UnitError
        Temperatures are not in K.
    InvalidSamplesError
        Times do not rise, lengths differ, or a number is not finite.
    TooFewSamplesError
        A block holds too few readings.

    Notes
    -----
    Every sensor takes part with one time constant at most. Sensors are added one by one; of the
    numbers of sensors the smallest is taken whose squared prediction errors are not larger than the
    best by more than one standard error of their differences over the blocks (one-standard-error
    rule [2]_). Time constants are then refined by generalised least squares, and their uncertainty
    is part of that of the error. Where the left-out blocks are foretold worse than the uncertainty
    says, it is raised by the ratio.

    References
    ----------
    .. [1] ISO 230-3:2020, thermal tests.
    .. [2] L. Breiman et al., *Classification and Regression Trees*, 1984, section 3.4.3.

    Examples
    --------
    >>> t = np.arange(0.0, 36000.0, 60.0)
    >>> spindle = 293.15 + 5.0 * np.sin(t / 4000.0) ** 2
    >>> noise = 1e-8 * np.random.default_rng(1).normal(size=t.size)
    >>> fit = fit_thermal(t, {"spindle": spindle}, {"EZZ": -2e-6 * (spindle - 293.15) + noise})
    >>> round(float(fit.terms["EZZ"].evaluate({"spindle": "23 degC"})) * 1e6, 1)
    -6.0
    """
    record = Record(t, temperatures, readings, blocks)
    named = _named_terms(terms, record.readings, angular)
    tried = record.lags_to_try(lags)
    numbers.count(most, "most", least=1)
    zero = _reference(reference, record)
    table = Inputs(record, tried)
    found, scores, predicted, drift, residuals = {}, {}, {}, {}, {}
    said = list(record.messages)
    for name in record.readings:
        problem = Reading(record, table, name, most)
        unit = "rad" if name in named.angles else "m"
        fit = problem.settled()
        found[name] = _term(name, unit, named, fit, record, zero)
        scores[name] = problem.scores
        predicted[name], drift[name] = fit.predicted, problem.scores[0]
        residuals[name] = fit.residual
        said += [f"{name}: {m}" for m in fit.messages]
    said.append(
        "errors are changes from "
        + ", ".join(f"{n} = {celsius(v)}" for n, v in zero.items())
        + "; the machine was taken for settled when the record began"
    )
    return ThermalFit(
        terms=freeze_mapping(found),
        predicted=freeze_mapping(predicted),
        drift=freeze_mapping(drift),
        scores=freeze_mapping(scores),
        correlation=_correlation(list(residuals.values())),
        t=record.t,
        readings=freeze_mapping(record.readings),
        residuals=freeze_mapping(residuals),
        messages=tuple(said),
        audit=freeze_mapping(
            {
                "blocks": blocks,
                "lags_tried_s": list(tried),
                "n": int(record.t.size),
                "span_h": float(np.ptp(record.t)) / 3600.0,
            }
        ),
    )


# ---- names, references ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Named:
    """Which error each reading is, where, and which readings are angles."""

    terms: Mapping[str, tuple[str, float | None]]
    angles: frozenset[str]


def _named_terms(
    terms: Mapping[str, str | tuple[str, float]] | None,
    readings: Mapping[str, FloatArray],
    angular: Sequence[str],
) -> _Named:
    found: dict[str, tuple[str, float | None]] = {}
    for name in terms or {}:
        numbers.choice(name, "reading in terms", readings)
    for name in angular:
        numbers.choice(name, "reading in angular", readings)
    for name in readings:
        if terms is not None and name in terms:
            given = terms[name]
            term, place = (given, None) if isinstance(given, str) else given
            axis = axis_of(term)
            if place is not None:
                place = numbers.real(place, f"place of {name}")
                if axis is None:
                    raise DataError(
                        f"{name}: {term} is a constant of the machine, it has no place"
                    )
            found[name] = (term, place)
            continue
        if terms is None and names_a_motion(name):
            found[name] = (name, None)
    by_term: dict[str, list[float | None]] = {}
    for term, place in found.values():
        by_term.setdefault(term, []).append(place)
    for term, places in by_term.items():
        if len(set(places)) < len(places) or (len(places) > 1) == (None in places):
            raise DataError(
                f"{term}: give it once, or at two or more different places of its axis each with its place, "
                f"such as {{'near': ('{term}', 0.05), 'far': ('{term}', 0.45)}}"
            )
    angles = {n for n, (term, _) in found.items() if is_angle(term)} | set(angular)
    for name, (term, _) in found.items():
        if name in angular and not is_angle(term):
            raise DataError(f"{name} is in rad, and {term} is a length")
    return _Named(freeze_mapping(found), frozenset(angles))


def names_a_motion(name: str) -> bool:
    """Return whether a reading has the name of an error motion.

    EX0C, a displacement of ISO 230-3, is a location error by its name, whose sense is that of the line
    and not of the tool: it is never taken for one.
    """
    try:
        return axis_of(name) is not None
    except DataError:
        return False


def _reference(given: Mapping[str, float | str] | None, record: Record) -> dict[str, float]:
    zero = {}
    for name in given or {}:
        numbers.choice(name, "sensor in reference", record.temperatures)
    for name, values in record.temperatures.items():
        seen = values[record.known]
        stated = seen[0] if given is None or name not in given else given[name]
        value = float(kelvins(stated, f"reference of {name}"))
        if not seen.min() - 1e-9 <= value <= seen.max() + 1e-9:
            raise DataError(
                f"the reference of {name} is {celsius(value)}, outside {celsius(float(seen.min()))} to "
                f"{celsius(float(seen.max()))} of the record: the error is not known there"
            )
        zero[name] = value
    return zero


def _term(
    name: str, unit: str, named: _Named, fit: Settled, record: Record, zero: Mapping[str, float]
) -> ThermalTerm:
    used = record.known & np.isfinite(fit.residual)
    seen, jitter = [], []
    for sensor, lag in zip(fit.sensors, fit.lags, strict=True):
        x = lagged(record.t, record.temperatures[sensor], lag)[used]
        jitter.append(math.sqrt(float(np.mean(np.diff(x, 2) ** 2)) / 6.0))
        seen.append((min(float(x.min()), zero[sensor]), max(float(x.max()), zero[sensor])))
    term, place = named.terms.get(name, (None, None))
    return ThermalTerm(
        name, unit, term, place, fit.sensors, fit.lags, fit.gains, fit.covariance,
        tuple(zero[s] for s in fit.sensors), tuple(seen), tuple(jitter),
        fit.left,
    )  # fmt: skip


def _correlation(residuals: Sequence[FloatArray]) -> FloatArray:
    """Return the correlation of residuals over the rows that all of them have."""
    both = np.stack(residuals)
    common = both[:, np.isfinite(both).all(axis=0)]
    if common.shape[1] < 2:
        return np.eye(len(residuals))
    common = common - common.mean(axis=1, keepdims=True)
    size = np.linalg.norm(common, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    found = (common / size[:, None]) @ (common / size[:, None]).T
    np.fill_diagonal(found, 1.0)
    return np.asarray(np.clip(found, -1.0, 1.0))


def _pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    return [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]


def _last(values: FloatArray) -> float:
    return float(np.atleast_1d(values)[-1])

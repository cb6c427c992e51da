"""`JointSeparation`: the joint separator for runs that are read at the same positions.

``reading_r(x) = forward(x) or reverse(x) + slope (x - middle) + offset_r + artefact(x)``, and noise
in time. Error = actual - nominal; both curves have no line over the range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation._checked_numbers import checked_count
from metrosep.separation._method_parts import known_parts, part_of, stated_u
from metrosep.separation._readings import as_numbers
from metrosep.separation._result_values import plain
from metrosep.separation.base import ErrorEstimate
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.entry import separate
from metrosep.separation.null_space import Unobservable
from metrosep.separation.options import metres

__all__ = ["JointSeparation"]


_WAYS = {"forward": 1, "reverse": -1}

_LINE = "the offset of each run is free, and the line is the alignment: slope holds it"
_TIED = (
    "what is tied to position at every feedrate is geometry here: form of the artefact, ball "
    "passage, cogging, a temperature that follows the position; a reversal tells the artefact"
)
_LOCKED = (
    "the feedrates move a vibration by less than the resolution of the fastest run: one that is "
    "locked to the start of the runs looks like the error; use feedrates further apart"
)
_ONE_FEED = (
    "at one feedrate a vibration locked to the start of the runs looks like the error at its "
    "wavelength; add runs at another feedrate"
)
_ARTEFACT = "it adds to the error at every feedrate alike; measure it by a reversal"
_OFFSET = (
    "zero of the sensor, mean of the error and lost motion share the level of a run; a fixed datum "
    "would tell them"
)
_TILT = (
    "a tilted artefact and a tilted axis read alike; measure the tilt against another reference"
)
_NOT_RUN = "no run goes this way; add runs in this direction"

_SAMPLES_PER_WAVE = 2.5
"""Shortest wavelength in pitches, as `separate_joint` has it."""

_MORE_THAN_STATED = 1.5
"""Scatter over the stated uncertainty from which it is told."""


@dataclass(frozen=True, slots=True)
class JointSeparation(SeparationMethod):
    """Runs of one axis at several feedrates, triggered by position.

    Parameters
    ----------
    x : tuple of float, m
        Positions of the readings, rising, the same for all runs; they are the evaluation range.
    feeds : tuple of float, m/s
        Of each run, > 0.
    directions : tuple of {"forward", "reverse"}, optional
        Of each run; all forward if omitted.
    shortest : float, m, optional
        Shortest wavelength of the model; chosen by evidence if omitted.
    min_feeds : int, optional
        Feedrates that each direction needs; 1 accepts that random vibration is only averaged.

    Raises
    ------
    NotSeparableError
        If a direction has fewer feedrates than `min_feeds`.
    InvalidSamplesError
        If the positions do not rise, or a feed is not positive.
    TooFewSamplesError
        If there are fewer than three positions.
    UnitError
        If `shortest` cannot be meant in m.
    DataError
        If there are no runs, or a direction is unknown or not stated for each run.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 30e-3, 121)
    >>> method = JointSeparation(tuple(x.tolist()), (0.05, 0.08, 0.05, 0.08))
    >>> wave = 2e-7 * np.cos(2 * np.pi * x / 7.5e-3)
    >>> noise = 2e-9 * np.random.default_rng(1).standard_normal((4, x.size))
    >>> found = method.separate(method.simulate({"slope": 1e-5}, {"forward": wave}) + noise)
    >>> bool(np.std(found.forward - wave) < 10e-9), bool(np.isnan(found.artefact).all())
    (True, True)
    """

    x: tuple[float, ...]
    feeds: tuple[float, ...]
    directions: tuple[str, ...] | None = None
    shortest: float | None = None
    min_feeds: int = 2

    name: ClassVar[str] = "joint"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact", "slope", "offset")
    error_parts: ClassVar[tuple[str, ...]] = ("forward", "reverse")

    def __post_init__(self) -> None:
        at = frozen_float(self.x, name="x", ndim=1, min_size=3)
        if not (np.diff(at) > 0.0).all():
            raise InvalidSamplesError(
                f"{self.name}: the positions must be finite and rising, whatever the direction of "
                "the runs; reverse rows are given in the same order"
            )
        frozen_float(self.feeds, name="feeds", ndim=1, min_size=1)
        metres(self.shortest, "shortest")
        least = checked_count(self.min_feeds, "min_feeds")
        ways = self._ways()
        if len(ways) != len(self.feeds) or not set(ways) <= set(_WAYS):
            raise DataError(
                f"{self.name}: directions are 'forward' or 'reverse', one for each of the "
                f"{len(self.feeds)} feeds, got {self.directions!r}"
            )
        runs = self._runs(np.zeros((len(self.feeds), len(self.x))))
        for way, sign in self._measured().items():
            feeds = runs.select(direction=sign).feeds
            if len(feeds) < least:
                raise NotSeparableError(
                    f"{self.name}: the {way} runs have {len(feeds)} feedrate(s), {least} are needed:"
                    " a vibration and an error of the same wavelength look alike at one feedrate; "
                    "add runs at another, or accept averaging with min_feeds=1"
                )

    def _ways(self) -> tuple[str, ...]:
        return ("forward",) * len(self.feeds) if self.directions is None else self.directions

    def _measured(self) -> dict[str, int]:
        return {way: sign for way, sign in _WAYS.items() if way in self._ways()}

    def _runs(self, readings: FloatArray) -> RunSet:
        x = np.array(self.x, dtype=np.float64)
        runs = []
        for i, (row, feed, way) in enumerate(zip(readings, self.feeds, self._ways(), strict=True)):
            if not (math.isfinite(feed) and feed > 0.0):
                raise InvalidSamplesError(
                    f"{self.name}: the feed of run {i} is {feed} m/s; it must be positive and finite"
                )
            step = _WAYS[way]
            at, z = x[::step], row[::step]
            runs.append(Run(at, z, t=np.abs(at - at[0]) / feed, feed=feed, run_id=f"{i}"))
        return RunSet(runs)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like
            ``artefact``, shape (n_x,), m: its form; ``slope``, scalar, rad: its alignment, zero in
            the middle of the range; ``offset``, shape (n_runs,), m: level of each run.
        errors : mapping of str to array_like, shape (n_x,), m
            ``forward`` and ``reverse``: the error at the positions, by direction of travel.

        Returns
        -------
        ndarray, shape (n_runs, n_x), m
            Readings in the order of the positions, whatever the direction.

        Raises
        ------
        DataError
            If a part is unknown, none is given, of another shape, or of a direction without runs.
        """
        parts = known_parts(self, truth, errors)
        x = np.array(self.x, dtype=np.float64)
        curves = {way: part_of(parts, way, x.shape, self.name) for way in _WAYS}
        for way in set(_WAYS) - set(self._measured()):
            if np.isfinite(curves[way]).all() and curves[way].any():
                raise DataError(f"{self.name}: no run goes {way}, so its error is not measured")
        artefact = part_of(parts, "artefact", x.shape, self.name)
        offset = part_of(parts, "offset", (len(self.feeds),), self.name)
        tilt = part_of(parts, "slope", (), self.name) * (x - 0.5 * (x[0] + x[-1]))
        moved = np.array([curves[way] for way in self._ways()])
        return np.asarray(moved + artefact + tilt + offset[:, np.newaxis])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what runs at these feedrates cannot tell.

        Returns
        -------
        tuple of Unobservable
            Offset and line, what is tied to position, wavelengths at which a locked vibration is
            not told from the error, wavelengths too short for the pitch, the artefact, the offsets,
            and a direction without runs.
        """
        found = []
        for way in _WAYS:
            if way not in self._measured():
                found.append(Unobservable(way, "term", ("all of it",), _NOT_RUN))
                continue
            found += [
                Unobservable(way, "polynomial", (0, 1), _LINE),
                Unobservable(way, "term", ("tied to position",), _TIED),
                *self._wavelengths(way),
            ]
        return (
            *found,
            Unobservable("artefact", "term", ("all of it",), _ARTEFACT),
            Unobservable("offset", "term", ("all of it",), _OFFSET),
            Unobservable("slope", "term", ("tilt of the artefact",), _TILT),
        )

    def _wavelengths(self, way: str) -> tuple[Unobservable, Unobservable]:
        feeds = [f for f, w in zip(self.feeds, self._ways(), strict=True) if w == way]
        travel = self.x[-1] - self.x[0]
        pitch = travel / (len(self.x) - 1)
        runs = self._runs(np.zeros((len(self.feeds), len(self.x))))
        several = len(runs.select(direction=_WAYS[way]).feeds) > 1
        blind = travel * (1.0 - min(feeds) / max(feeds)) if several else 0.0
        locked = (
            Unobservable(way, "wavelength", (f"{format_length(blind)} and longer",), _LOCKED)
            if blind > 0.0
            else Unobservable(way, "wavelength", ("every wavelength",), _ONE_FEED)
        )
        floor = _SAMPLES_PER_WAVE * pitch if self.shortest is None else self.shortest
        short = Unobservable(
            way,
            "wavelength",
            (f"shorter than {format_length(floor)}",),
            "not in the model: the pitch of the readings or `shortest` bounds it; without evidence "
            "it ends at longer ones, see shortest_wavelength_mm in the audit",
        )
        return locked, short

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the error of each direction and the alignment.

        Parameters
        ----------
        readings : array_like, shape (n_runs, n_x), m
            Rows in the order of the feeds, columns in that of the positions; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading. It replaces nothing: the noise model of the fit
            gives u. A scatter well beyond it is told.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``forward``, ``reverse`` (n_x,) without their line, NaN where no run of that
            direction was measured; ``slope``, the mean of the directions; ``artefact`` and
            ``offset``, NaN. The lost motion, which the offsets hide, is in the audit only.

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are no numbers, infinite, or of another shape.
        NotUniformError, TooFewSamplesError
            If the positions are too uneven, or a run has fewer than 32 readings.
        UnitError
            If `shortest` is no wavelength that the positions can show.

        Notes
        -----
        ``separate(runs, method="joint")`` does the work; it also takes runs sampled in time, which
        have positions of their own, and has the options for drift, lines, lag and probes. The
        noise is the RMS of the residuals over ``n - p`` readings, p the effective parameters; u of
        the parts holds its correlation in time, so is not that of white noise.
        """
        stated = stated_u(u_reading, "m")
        array = self._checked(readings)
        x = np.array(self.x, dtype=np.float64)
        estimate = separate(
            self._runs(array),
            start=float(x[0]),
            length=float(x[-1] - x[0]),
            shortest=self.shortest,
            min_feeds=self.min_feeds,
        )
        blank = np.full(x.size, np.nan)
        offset = np.full(len(self.feeds), np.nan)
        slope = estimate.slope
        parts = {"artefact": blank, "offset": offset, "slope": np.array(slope.value)}
        u = {"artefact": blank, "offset": offset}
        u["slope"] = np.array(math.nan if slope.u is None else slope.u)
        for way, sign in _WAYS.items():
            seen = ~np.isnan(array[[w == way for w in self._ways()]]).all(axis=0)
            known = seen & (way in self._measured())
            parts[way] = np.where(known, estimate.evaluate(x, direction=sign), np.nan)
            u[way] = np.where(known, estimate.sd(x, direction=sign), np.nan)
        noise = _noise(estimate, int((~np.isnan(array)).sum()))
        return Separation(
            self.name,
            parts,
            u,
            {**dict.fromkeys(parts, "m"), "slope": "rad"},
            {"x": x},
            self.null_space(),
            noise=noise,
            audit=_audit(estimate, stated),
            messages=(*estimate.messages, *_doubts(noise, stated)),
            history=(*history, *estimate.history),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further runs."""
        return model

    def _checked(self, readings: ArrayLike) -> FloatArray:
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        shape = (len(self.feeds), len(self.x))
        if array.shape != shape:
            raise InvalidSamplesError(
                f"{self.name}: there are {shape[0]} runs and {shape[1]} positions; the readings "
                f"need the shape {shape}, got {array.shape}"
            )
        if np.isinf(array).any():
            run, i = np.argwhere(np.isinf(array))[0]
            raise InvalidSamplesError(
                f"{self.name}: reading {i} of run {run} is infinite; what was not measured is NaN"
            )
        return array


def _noise(estimate: ErrorEstimate, n_readings: int) -> Quantity:
    audits = [estimate.audit] if len(estimate.directions) == 1 else list(estimate.audit.values())
    free = n_readings - sum(float(a["effective_parameters"]) for a in audits)
    value = estimate.residual_rms * math.sqrt(n_readings / free) if free > 0.0 else math.nan
    text = "standard deviation of one reading about the estimate, vibration included (type A)"
    return Quantity(value, "m", text, symbol="s")


def _audit(estimate: ErrorEstimate, stated: float | None) -> dict[str, Any]:
    audit: dict[str, Any] = plain(estimate.audit)
    audit["residual_rms_nm"] = estimate.residual_rms * 1e9
    if stated is not None:
        audit["u_reading_stated_nm"] = stated * 1e9
    if estimate.lost_motion is not None:
        audit["lost_motion_nm"] = estimate.lost_motion.value * 1e9
        if estimate.lost_motion.u is not None:
            audit["u_lost_motion_nm"] = estimate.lost_motion.u * 1e9
    return audit


def _doubts(noise: Quantity, stated: float | None) -> tuple[str, ...]:
    if stated is None or not noise.value > _MORE_THAN_STATED * stated:
        return ()
    told = (
        f"the readings scatter by {format_length(noise.value)} about the estimate, u_reading says "
        f"{format_length(stated)}: there is vibration, or u_reading holds too little"
    )
    return (told,)

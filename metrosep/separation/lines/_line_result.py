"""What methods with probes in a row share, from readings to a `Separation`.

Noise, zero, null space, audit, messages; readings that known parts produce.
"""

from __future__ import annotations

import math
import sys
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FormatMismatchError, NotSeparableError, UnitError
from metrosep.core.methods import Readings
from metrosep.core.numbers import not_negative
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._readings import NOISE_UNKNOWN, checked_readings, known_parts
from metrosep.separation.contract import (
    U_READING,
    Parts,
    Separation,
    SeparationMethod,
    Unobservable,
    as_rows,
    as_stated,
    not_known,
    type_a,
)
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.lines._line_found import Found, solve
from metrosep.separation.lines._line_problem import (
    PARABOLA,
    Problem,
    Row,
    Sensor,
    check_overlap,
    check_size,
    check_steps,
    checked_sensor,
    has_end_waves,
    interpolation,
    null_space_of,
    pooled_noise,
    positions,
    problem_of,
    transfer_of,
)


def step_option() -> Any:
    """Return the option of the spacing of rows of probes."""
    what = "between the positions of the carriage, and between the samples of the form"
    return option(kind="size", required=False, help=what)


def smoothing_option() -> Any:
    """Return the option of the penalty of generalised least squares."""
    return option(1e-3, kind="number", help="weight of the penalty of generalised and combined")


class ProbeRowMethod(SeparationMethod):
    """Probes in a row on one carriage; derived classes say where they sit."""

    over = "x"
    roles: ClassVar[Mapping[str, str]] = {"pitch": "angle?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "u_pitch": Option("angle", help="standard uncertainty of one reading of the pitch"),
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Separation:
        """Return the parts of probes on one carriage, with or without an angle sensor."""
        if data.position is None and "step" not in options:
            raise FormatMismatchError(
                'the positions of the carriage are needed: x = "x_mm" in [input], or step = "10 mm"'
            )
        rest = dict(options)
        if data.position is not None:
            rest["x"] = data.position
        if "pitch" in data.extra:
            rest["pitch"] = data.extra["pitch"].mean(axis=0)
        if isinstance(rest.get("distance"), tuple):
            rest["distance"] = one_or_two(rest["distance"])
        found: Separation = getattr(sys.modules[cls.__module__], cls.name)(
            as_rows(data.values), **rest
        )
        return found

    method: str
    smoothing: float
    _probe_names: ClassVar[tuple[str, ...]] = ()  # probe 1, 2, ... if empty
    _normed: ClassVar[bool] = False  # whether the transfer is that of orthonormal combinations

    @property
    @abstractmethod
    def _row(self) -> Row:
        """Offsets, step and what is known of the probes."""

    @property
    def _zero(self) -> tuple[float, float] | None:
        """Known zero difference of three probes and its standard uncertainty, m."""
        return None

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        row, parts = self._row, known_parts(self, truth, errors)
        n = _n_positions(row, parts, self.name)
        o = np.array(row.offsets)
        readings = np.zeros((o.size, n))
        if "artefact" in parts:
            grid = (o[0] + row.step * np.arange(n + row.span)).astype(np.float64)
            at = [interpolation(grid, row.step * np.arange(n) + v) for v in o]
            readings += np.array([p @ parts["artefact"] for p in at])
        nothing = np.zeros(n)
        readings += parts.get("straightness", nothing) + o[:, None] * parts.get("pitch", nothing)
        if "zero" in parts and np.isfinite(parts["zero"]).all():
            w = row.weights
            readings += (w * float(parts["zero"]) / (w @ w))[:, None]
        return readings

    def transfer(self, wavelengths: ArrayLike) -> FloatArray:
        """Return what is left of a unit wave when the carriage has cancelled.

        Parameters
        ----------
        wavelengths : array_like, shape (k,), m
            Above zero.

        Returns
        -------
        ndarray, shape (k,)
            0 where the wave is not seen; the class says what becomes of the noise.
        """
        row = self._row
        lengths = np.asarray(wavelengths, dtype=np.float64)
        nuisance = np.column_stack([np.ones(len(row.offsets)), row.offsets])
        size = 1.0 if self._normed else float(np.linalg.norm(row.weights))
        return size * transfer_of(row.offsets, nuisance if row.pitch else nuisance[:, :1], lengths)

    def null_space(self) -> tuple[Unobservable, ...]:
        row = self._row
        return null_space_of(row, 2 if row.pitch and not row.zero_known else 1, pitch_part=True)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        x: ArrayLike | None = None,
        pitch: ArrayLike | None = None,
        u_pitch: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return artefact and straightness, and pitch and zero where they are determined.

        Parameters
        ----------
        readings : array_like, shape (n_probes, n) or (n_probes, R, n), m
            From the trailing to the leading probe; or R passes. NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; from passes or redundancy if omitted.
        x : array_like, shape (n,), m, optional
            Positions of the carriage, rising; steps from zero if omitted.
        pitch : array_like, shape (n,), rad, optional
            Readings of an angle sensor on the carriage, positive where the leading end reads more;
            with `u_pitch`, and not with "sequential". It determines the parabola and the zero.
        u_pitch : float, rad, optional
            Standard uncertainty of one of them; needed with `pitch`.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            ``.artefact`` over ``coordinates["x"]``, least-squares line (and parabola, where it is
            not known) removed; ``.straightness`` and ``.pitch`` over
            ``coordinates["carriage_x"]``, such that all add up to the readings.

        Raises
        ------
        DataError
            If the pitch, `u_reading` or `u_pitch` cannot be used.
        InvalidSamplesError, NotUniformError, TooFewSamplesError
            If readings or positions cannot be used.
        NotSeparableError
            If gaps leave no chain, the positions leave samples open, or the pitch runs opposite to
            that of the probes.
        UnitError
            If the probes are farther apart than the carriage travels, or the pitch readings vary
            more than 3 times (of three probes, also less than 0.3 times) what the probes see.
        """
        row = self._row
        names = self._probe_names or tuple(f"probe {j + 1}" for j in range(len(row.offsets)))
        array = checked_readings(readings, names=names, minimum=3, what=self.name)
        n = array.shape[2]
        check_size(n + row.span, self.name)
        at = positions(x, row.step, n, self.name)
        sequential = self.method == "sequential"
        if sequential:
            check_steps(row, at, self.name)
        check_overlap(row, at, self.name)
        if sequential and pitch is not None:
            raise DataError(
                f"{self.name}: sums of readings have no place for a pitch sensor; use "
                "method='least_squares', 'generalised' or 'combined' with pitch"
            )
        noise = _stated_noise(array, row, u_reading)
        sensor = checked_sensor(pitch, u_pitch, n)
        clean = array
        if self._zero is not None:  # the smallest zeros that have this difference
            w = row.weights
            clean = np.asarray(array - (w * self._zero[0] / (w @ w))[:, None, None])
        problem = problem_of(row, at, clean, sensor, noise.value)
        if sensor is not None:
            check_angle(self.name, row, at, clean, sensor)
        degree = 1 if sensor is not None or row.zero_known or not row.pitch else 2
        found = solve(problem, method=self.method, smoothing=self.smoothing, degree=degree)
        most = problem.stations.most
        if math.isnan(noise.value) and found.freedom > 0:
            noise = _noise_of_rest(found, most)
        scale = noise.value / math.sqrt(most)
        parts, u = _scaled(found, scale, with_pitch=row.pitch or sensor is not None)
        shared = found.through * scale
        if row.pitch:
            bent = _add_zero(parts, u, self._zero, found, scale, problem)
            shared = np.column_stack([shared, bent])
        gap = lost_samples(parts["artefact"], found)
        null_space = null_space_of(row, degree, pitch_part=sensor is None) + gap
        return Separation(
            self.name,
            parts,
            u,
            {k: "rad" if k == "pitch" else "m" for k in parts},
            {"x": problem.grid, "carriage_x": at},
            null_space,
            noise=noise,
            audit=self._audit(problem, found, array.shape[1], degree),
            messages=(
                *noise_messages(found, noise, scale, self.method),
                *reading_messages(array, problem),
                *null_space_messages(
                    self.name, self.method, row, null_space, at, degree, found, parts["artefact"]
                ),
            ),
            history=(*history, Step(self.name, {"method": self.method})),
            modes=(
                {"straightness": CovarianceModes.of(at, shared)}
                if np.isfinite(shared).all() and shared.any()
                else {}
            ),
        )

    def _audit(self, problem: Problem, found: Found, repeats: int, degree: int) -> dict[str, Any]:
        row = problem.row
        o = np.array(row.offsets)
        audit: dict[str, Any] = {
            "method": self.method,
            "offsets_mm": (o * 1e3).tolist(),
            "step_mm": row.step * 1e3,
            "n_positions": int(problem.x.size),
            "n_positions_used": int(found.used.stop - found.used.start),
            "n_repeats": int(repeats),
            "passes_per_position": passes_per_position(problem),
            "n_artefact": int(problem.grid.size),
            "degrees_of_freedom": int(found.freedom),
            "removed": "least squares: "
            + ("offset, line" if degree < 2 else "offset, line, parabola"),
        }
        if self.method in ("generalised", "combined"):
            audit["smoothing"] = self.smoothing
        if row.shifts is None:
            audit["interpolation"] = "spline of degree 5"
        if row.pitch:
            audit["sag_of_zero_error"] = _sag(row, float(np.ptp(problem.grid)))
        if self._zero is not None:
            audit["zero_nm"], audit["u_zero_nm"] = (v * 1e9 for v in self._zero)
        if problem.n_sensors > o.size:
            audit["pitch_sensor"] = True
        return audit


def _n_positions(row: Row, parts: Mapping[str, FloatArray], what: str) -> int:
    counts = {k: v.size for k, v in parts.items() if k in ("straightness", "pitch")}
    if "artefact" in parts:
        counts["artefact"] = parts["artefact"].size - row.span
    if len(set(counts.values())) != 1 or min(counts.values()) < 2:
        sizes = ", ".join(f"{k} {v.size}" for k, v in parts.items())
        raise DataError(
            f"{what}: for n >= 2 carriage positions straightness and pitch have n values, the artefact "
            f"n + {row.span}; got {sizes}"
        )
    return next(iter(counts.values()))


def _sag(row: Row, length: float) -> float:
    """Return the sag over a length into which a zero difference of 1 bends the artefact."""
    o = row.offsets
    return float(length**2 / (4.0 * (o[1] - o[0]) * (o[2] - o[0])))


def _stated_noise(readings: FloatArray, row: Row, u_reading: float | None) -> Quantity:
    """Return the noise of one reading, stated or from the passes; NaN if neither."""
    if u_reading is not None:
        value = not_negative(u_reading, "u_reading", dimension="length")
        return as_stated(value, "m")
    o = np.array(row.offsets)
    nuisance = np.column_stack([np.ones(o.size), o]) if row.pitch else np.ones((o.size, 1))
    value, freedom = pooled_noise(readings, nuisance)
    if math.isnan(value):
        return not_known("m")
    text = (
        f"standard deviation of one reading, pooled from {readings.shape[1]} repeats, straightness "
        "and pitch of each repeat removed (type A)"
    )
    return type_a(value, "m", text, freedom)


def _noise_of_rest(found: Found, most: int) -> Quantity:
    """Return the noise of one reading from what least squares leaves of redundant rows."""
    one = math.sqrt(found.rest_least / found.freedom * most)
    text = f"standard deviation of one reading, from {found.freedom} redundant rows (type A)"
    return type_a(one, "m", text, found.freedom)


def _scaled(
    found: Found, scale: float, *, with_pitch: bool
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    named = {"artefact": found.artefact, "straightness": found.straightness}
    if with_pitch:
        named["pitch"] = found.pitch
    parts = {k: v for k, (v, _) in named.items()}
    return parts, {
        k: np.where(np.isnan(parts[k]), np.nan, w * scale) for k, (_, w) in named.items()
    }


def _add_zero(
    parts: dict[str, FloatArray],
    u: dict[str, FloatArray],
    zero: tuple[float, float] | None,
    found: Found,
    scale: float,
    problem: Problem,
) -> FloatArray:
    """Add the zero difference as a part, and the parabola of its uncertainty where it was given.

    Return that of the straightness, m.
    """
    row, n = problem.row, len(problem.row.offsets)
    if n == 3:
        w = np.append(row.weights, np.zeros(problem.n_sensors - n))
        if zero is not None:
            parts["zero"], u["zero"] = np.array(zero[0]), np.array(zero[1])
        else:
            parts["zero"], u["zero"] = _zero_difference(found, w, scale)
    if zero is None or zero[1] == 0.0:
        return np.zeros(problem.x.size)
    d1 = row.offsets[1] - row.offsets[0]
    q = zero[1] / (d1 * (row.offsets[2] - row.offsets[0]))
    known = ~np.isnan(parts["artefact"])
    centre = float(np.mean(problem.grid[known]))
    square = (problem.grid - centre) ** 2
    t = problem.x - centre
    o = np.array(row.offsets)
    a = np.linalg.lstsq(np.column_stack([np.ones(n), o]), o**2, rcond=None)[0]
    bent = {
        "artefact": square - float(np.mean(square[known])),
        "straightness": -(t**2) - a[0] + float(np.mean(square[known])),
        "pitch": -2.0 * t - a[1],
    }
    for name, curve in bent.items():
        u[name] = np.sqrt(u[name] ** 2 + (q * curve) ** 2)
    return np.asarray(q * bent["straightness"])


def _zero_difference(found: Found, w: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Return the zero difference and its uncertainty; NaN where a hidden artefact changes it."""
    hidden = np.abs(w @ found.zeros_hidden).max(initial=0.0)
    if not found.zeros_cov.any() or hidden > 1e-6 * np.abs(w).max():
        return np.array(np.nan), np.array(np.nan)
    spread = math.sqrt(max(float(w @ found.zeros_cov @ w), 0.0))
    return np.array(w @ found.zeros), np.array(spread * scale)


# ---- whether an angle sensor on the carriage tells of the pitch that the probes see ------------

OPPOSITE = -0.8
"""A correlation below this between the pitch sensor and the pitch of the probes is a sign error."""

ALIKE = 0.8
"""Above this correlation the ratio of both is that of their units."""

SIGNIFICANT = 4.0
"""The pitch must exceed its uncertainty by this factor before it is judged."""

RATIO = (0.3, 3.0)
"""Outside this ratio of the sensor to the probes a unit or a distance is wrong."""


def check_angle(what: str, row: Row, x: FloatArray, readings: FloatArray, sensor: Sensor) -> None:
    """Refuse a sensor that runs opposite to the pitch of the probes, or in another unit."""
    seen = _pitch_of(row, x, readings)
    both = ~np.isnan(seen) & ~np.isnan(sensor.values)
    if both.sum() < 5:
        return
    line = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, x.size)[both], 1)
    probes, angle = (
        v[both] - line @ np.linalg.lstsq(line, v[both], rcond=None)[0]
        for v in (seen, sensor.values)
    )
    sizes = float(np.linalg.norm(probes)), float(np.linalg.norm(angle))
    if not (sizes[0] > 0.0 and float(np.std(angle)) > SIGNIFICANT * sensor.u):
        return
    alike, ratio = float(probes @ angle) / (sizes[0] * sizes[1]), sizes[1] / sizes[0]
    if ratio > RATIO[1] or (row.pitch and ratio < RATIO[0] and alike > ALIKE):
        raise UnitError(
            f"{what}: the pitch readings vary {ratio:.3g} times as much as the probes see it; give "
            "pitch in rad, readings and distances in m, and the sensor on the same carriage"
        )
    if row.pitch and alike < OPPOSITE:
        raise NotSeparableError(
            f"{what}: the pitch readings run opposite to the pitch that the probes see "
            f"(correlation {alike:.2f}): positive is where the leading probe (larger x) reads "
            "more; pass -pitch"
        )


def _pitch_of(row: Row, x: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the pitch that the probes see; of two probes the slope between them, form and all."""
    if not row.pitch:
        count = (~np.isnan(readings[1] - readings[0])).sum(axis=0)
        total = np.nansum(readings[1] - readings[0], axis=0)
        distance = row.offsets[1] - row.offsets[0]
        return np.where(count > 0, total / np.maximum(count, 1) / distance, np.nan)
    free = replace(row, zero_known=False)
    problem = problem_of(free, x, readings, None, 0.0)
    return solve(problem, method="least_squares", smoothing=0.0, degree=2).pitch[0]


# ---- messages of a result of probes in a row: gaps, counts, units, null space -----

LARGE_RANGE = 10e-3
"""Readings of a straightness probe that span more, m, were hardly given in m."""


def lost_samples(artefact: FloatArray, found: Found) -> tuple[Unobservable, ...]:
    """Return the samples that are NaN, with the reason."""
    lost = np.flatnonzero(np.isnan(artefact))
    if lost.size == 0:
        return ()
    reasons = []
    if lost.size > found.n_unread:
        reasons.append(
            "readings that were not measured cut the chain, and offset and line of its pieces are "
            "not connected: the longest piece is returned; measure the gap again"
        )
    if found.n_unread:
        reasons.append(
            "no probe read these samples together with the others: take a step as coarse as the "
            "positions, or measure there"
        )
    return (Unobservable("artefact", "samples", tuple(int(i) for i in lost), "; ".join(reasons)),)


def passes_per_position(problem: Problem) -> list[int]:
    """Return the least and the largest number of passes that a position rests on."""
    whole = problem.stations.valid[: problem.n_probes].all(axis=0)
    count = np.zeros(problem.x.size, dtype=np.intp)
    count[problem.stations.at[whole]] = problem.stations.count[whole]
    return [int(count.min()), int(count.max())]


def noise_messages(found: Found, noise: Quantity, scale: float, method: str) -> list[str]:
    """Return messages about the noise, and a misfit of redundant rows."""
    if math.isnan(noise.value):
        return [NOISE_UNKNOWN]
    if found.freedom <= 0 or scale == 0.0:
        return []
    ratio = math.sqrt(found.rest / found.freedom) / scale
    if ratio <= 1.0 + 2.0 / math.sqrt(2.0 * found.freedom):
        return []
    return [
        f"the redundant rows scatter {ratio:.3g} times more than the noise of a reading says "
        f"({found.freedom} degrees of freedom): a probe drifts, a distance or sign is wrong"
        + ("" if method == "least_squares" else ", or the smoothing is too strong")
    ]


def reading_messages(readings: FloatArray, problem: Problem) -> list[str]:
    """Return warnings about the unit, and what became of passes that lack a reading."""
    out = []
    span = float(np.nanmax(readings) - np.nanmin(readings))
    if span > LARGE_RANGE:
        out.append(
            f"the readings span {span:.3g} m; they are taken in m: 5 um is 5e-6. Check the unit"
        )
    low, high = passes_per_position(problem)
    missing = np.isnan(readings)
    if readings.shape[1] > 1 and missing.any():
        torn = int((missing.any(axis=0) & ~missing.all(axis=0)).sum())
        text = f"the positions rest on {low} to {high} passes, and u follows these counts"
        if torn:
            text += (
                f"; in {torn} cases a pass is missing a probe: as each pass has its own straightness and "
                "pitch, the rest of that pass counts there only where it is free of them"
            )
        out.append(text)
    if problem.stations.n_lost_angles:
        out.append(
            f"at {problem.stations.n_lost_angles} positions the angle was omitted: it is the mean of "
            "all passes, and a pass lacks a probe there"
        )
    return out


def null_space_messages(
    name: str,
    method: str,
    row: Row,
    null_space: tuple[Unobservable, ...],
    x: FloatArray,
    degree: int,
    found: Found,
    artefact: FloatArray,
) -> list[str]:
    """Return what these probes do not see."""
    out = []
    if degree == 2:
        length = float(x[-1] - x[0]) + row.offsets[-1] - row.offsets[0]
        keep = "pass zero=0.0 to keep the parabola, " if name == "three_point" else ""
        out.append(
            "the parabola is not known and omitted: a zero error of 1 nm would be a sag of "
            f"{format_length(_sag(row, length) * 1e-9)} over {format_length(length)}; {keep}{PARABOLA}"
        )
    for item in null_space:
        if item.kind == "wavelength":
            named = ", ".join(format_length(float(w)) for w in item.indices[:4])
            more = " ..." if len(item.indices) > 4 else ""
            out.append(f"the wavelengths {named}{more} are suppressed by these probe distances")
    if has_end_waves(row) and method == "least_squares":
        out.append(
            "waves that die away from the ends are not determined by these distances and removed by "
            "least squares: the ends are uncertain; method='generalised' takes the smoothest curve"
        )
    lost = int(np.isnan(artefact).sum())
    if found.n_unread:
        out.append(f"{found.n_unread} samples were read by no probe in a usable row and are NaN")
    if lost > found.n_unread:
        out.append(f"{lost - found.n_unread} samples are not connected with the rest and left NaN")
    return out


def one_or_two(given: tuple[float, ...]) -> float | tuple[float, ...]:
    """Return the distance of three probes, or both where they differ."""
    if len(given) not in (1, 2) or min(given) <= 0.0:
        raise DataError(
            "three probes have one distance, or two that differ, above zero; got "
            + ", ".join(f"{d * 1e3:g} mm" for d in given)
        )
    return given[0] if len(given) == 1 else given

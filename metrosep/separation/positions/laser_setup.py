"""Readings of a laser interferometer, corrected for air, dead path, cosine, Abbe offset and temperature.

Each correction is added to the reading. A source of uncertainty acts on several corrections at once
(one thermometer on wavelength and dead path): its contributions are added with their signs, then the
sources in quadrature (JCGM 100, 5.1 and 5.2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, OptionError
from metrosep.core.inputs import RoleColumns
from metrosep.core.numbers import real
from metrosep.core.options import Option, options_of
from metrosep.core.quantity import Quantity
from metrosep.core.readable import typed_number
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.optics.air import AirIndex, air_index
from metrosep.optics.air_options import AIR, U_AIR, WET
from metrosep.separation.contract import NamedMethod, Separation, Unobservable
from metrosep.separation.positions.laser_options import (
    AIR_KEYS,
    RESET,
    SETUP,
    SOFTWARE,
    SURROUNDINGS,
    LaserOptions,
    require_small,
)

__all__ = [
    "AirOnce", "LaserCorrections", "LaserPositions", "LaserReadings", "LaserSetup", "laser_positions",
    "setup_of",
]  # fmt: skip

_REFERENCE = 293.15
"""K; lengths are stated at 20 degC (ISO 1)."""

_LONGEST = 200.0
"""m; no axis is longer, but one in mm passed as m is."""


@dataclass(frozen=True, slots=True)
class LaserSetup(LaserOptions):
    """How a laser interferometer stood and what its software assumed.

    Parameters
    ----------
    wavelength, u_wavelength, equation : optional
        Of the light (m, relative), and which equation of the air.
    software, software_index : optional
        What the software of the laser assumed of the air.
    positive, zero : optional
        Where the reflector goes while the reading rises; position where the reading was set to 0 (m).
    dead_path, u_dead_path, air_change : optional
        Length (m); largest change of the index since zero, where its air is not known.
    beam_angle, u_beam_angle, spot_walk, u_spot_walk, walk_travel, misalignment : optional
        Angle between beam and motion (rad), or the walk of the returned spot (m) over a travel (m).
    pitch_offset, u_pitch_offset, u_pitch, pitch_limit : optional
        Abbe offset (m) and what is known of the pitch (rad) beside its column.
    yaw_offset, u_yaw_offset, u_yaw, yaw_limit : optional
        The same for the yaw.
    expansion, u_expansion, part_temperature, u_part_temperature : optional
        Of part or scale (1/K, K).
    u_reading : optional
        Standard uncertainty of one reading (m).
    air : mapping, optional
        ``temperature``, ``pressure``, ``humidity`` (or ``dew_point``, ``vapour_pressure``), ``co2``,
        their ``u_...``, and the same with ``software_`` and ``reset_`` before them.

    Raises
    ------
    OptionError
        If an option is not of its kind, or options contradict each other.
    InvalidSamplesError
        If a value is out of its range.

    Notes
    -----
    Each option is declared in `metrosep ops laser_positions`; numbers in SI or texts with a unit.

    Examples
    --------
    >>> setup = LaserSetup(software="vacuum", dead_path="200 mm", positive="away", air={
    ...     "temperature": "21 degC", "pressure": "1005 hPa", "humidity": "45 %",
    ...     "reset_temperature": "20 degC"})
    >>> found = setup.correct([0.5])
    >>> {k: f"{1e6 * v[0]:.3f} um" for k, v in found.corrections.items()}
    {'wavelength': '-134.094 um', 'dead_path': '0.188 um'}
    """

    def index(self, **columns: ArrayLike) -> AirIndex:
        """Return the refractive index of the air during the readings.

        Parameters
        ----------
        **columns : array_like, shape (n,)
            ``temperature`` (K), ``pressure`` (Pa), ``humidity`` (1), ``dew_point`` (K),
            ``vapour_pressure`` (Pa), ``co2`` (1) where they were recorded; else those of `air`.

        Returns
        -------
        AirIndex
            With uncertainty.

        Raises
        ------
        OptionError
            If the air is not stated, or stated twice.
        """
        twice = [k for k in columns if k in self.air]
        if twice:
            raise OptionError(f"{twice[0]} is a column and an option; give one of them")
        given = {k: v for k, v in self.air.items() if k in AIR or k in U_AIR}
        return air_index(self.wavelength, equation=self.equation, **{**given, **columns})

    def correct(self, reading: ArrayLike, **columns: ArrayLike) -> LaserCorrections:
        """Return what is to be added to readings.

        Parameters
        ----------
        reading : array_like, shape (n,), m
            Displacement since the reading was set to zero, as displayed; NaN where not measured.
        **columns : array_like, shape (n,)
            As for `index`, and ``part_temperature`` (K), ``pitch``, ``yaw`` (rad) where recorded.

        Returns
        -------
        LaserCorrections
            Each correction and each contribution to its uncertainty.

        Raises
        ------
        OptionError
            If something that a correction needs is not stated, or is stated twice.
        InvalidSamplesError
            If lengths of columns differ, or an angle is too large.

        Notes
        -----
        With reading R, index n now, n_0 at zero, n_s of the software, dead path D, s = 1 where
        positive is away, -1 towards, in this order::

            wavelength  R (n_s / n - 1)
            dead_path   -s D (n - n_0) / n
            cosine      L m,    m = 1 / cos(theta) - 1 + u^2 / 2, or a^2 / 4 of a limit a
            pitch, yaw  h (angle - angle at zero)
            expansion   -alpha (T - 20 degC) L

        The beam within a cone of half-angle a: theta^2 is rectangular from 0 to a^2, so that m has
        the mean a^2 / 4 and u = a^2 / (4 sqrt 3) (JCGM 100, F.2.4.4: the correction for a cosine is
        not zero though its angle is).
        """
        r = np.atleast_1d(frozen_float(np.ravel(np.asarray(reading)), name="reading", ndim=1))
        if np.isfinite(r).any() and float(np.nanmax(np.abs(r))) > _LONGEST:
            raise InvalidSamplesError(
                f"a reading is {float(np.nanmax(np.abs(r))):.6g} m; pass m (divide mm by 1000)"
            )
        arrays = {k: np.broadcast_to(_column(k, v, r.size), r.shape) for k, v in columns.items()}
        at_air = {k: v for k, v in arrays.items() if k in AIR}
        air = self.index(**at_air)
        book = _Book(r.shape)
        book.messages += air.messages
        start = _at_zero(r)
        length = r + self._wavelength(book, r, air)
        if self.dead_path:
            length = length + self._dead_path(book, air, at_air, start)
        length = length + self._cosine(book, length)
        for name in ("pitch", "yaw"):
            self._abbe(book, name, arrays.get(name), start)
        self._expansion(book, length, arrays.get("part_temperature"))
        if self.u_reading is not None:
            book.add("reading", "reading", self.u_reading)
        made = LaserCorrections(book.values, book.sources, air, r, book.told())
        lost = int((np.isfinite(r) & ~np.isfinite(made.total)).sum())
        if lost:
            text = (
                f"{lost} of {r.size} readings have no air, pitch or temperature beside them: NaN"
            )
            made = replace(made, messages=(*made.messages, text))
        return made

    def corrected(self, runs: RunSet) -> tuple[RunSet, LaserCorrections]:
        """Return runs with corrected errors, and the corrections over the longest run.

        Parameters
        ----------
        runs : RunSet
            Errors ``actual - nominal`` along the travel, read by the laser.

        Returns
        -------
        tuple of (RunSet, LaserCorrections)
            The runs with each correction added; and what was added to the run with the longest travel.

        Raises
        ------
        OptionError
            As for `correct`; also where a correction needs a column, such as pitch.
        """
        made = [self.correct(run.x + run.z - self.zero) for run in runs]
        new = [
            Run(
                run.x,
                run.z + c.total,
                t=run.t,
                feed=run.feed,
                run_id=run.run_id,
                metadata=run.metadata,
            )
            for run, c in zip(runs, made, strict=True)
        ]
        far = max(made, key=lambda c: float(np.nanmax(np.abs(c.reading))))
        return RunSet(new, metadata=runs.metadata, history=runs.history), far

    # ---- one correction each; the algebra is in the notes of `correct` ----

    def _software_index(self, air: AirIndex) -> Any:
        own = {k.removeprefix("software_"): v for k, v in self.air.items() if k in SOFTWARE}
        ways = [self.software is not None, self.software_index is not None, bool(own)]
        if sum(ways) != 1:
            raise OptionError(
                'say once what the software of the laser assumed of the air: software = "vacuum" or '
                '"same air", or software_index, or software_temperature, software_pressure and '
                "software_humidity"
            )
        if self.software_index is not None:
            return self.software_index
        if self.software is not None:
            return 1.0 if self.software == "vacuum" else air.n
        co2 = {k: v for k, v in self.air.items() if k == "co2"}
        return air_index(self.wavelength, equation=self.equation, **own, **co2).n

    def _wavelength(self, book: _Book, r: FloatArray, air: AirIndex) -> Any:
        assumed = self._software_index(air)
        value = r * (assumed / air.n - 1.0)
        book.correct("wavelength", value)
        for source, term in air.terms.items():
            book.add(_AIR_SOURCE(source), "wavelength", -r * assumed / air.n**2 * term)
        if self.u_wavelength is None:
            book.silent.append("u_wavelength")
        else:
            book.add("laser wavelength", "wavelength", r * self.u_wavelength)
        return value

    def _dead_path(
        self, book: _Book, air: AirIndex, columns: Mapping[str, FloatArray], start: int
    ) -> Any:
        own = {k.removeprefix("reset_"): v for k, v in self.air.items() if k in RESET}
        path = float(self.dead_path)
        if self.air_change is not None:
            if own:
                raise OptionError(
                    "air_change and reset_... contradict each other; give one of them"
                )
            book.correct("dead_path", 0.0)
            book.add("air since zero", "dead_path", path * self.air_change / math.sqrt(3.0))
            return 0.0
        if not own and not columns:
            raise OptionError(
                "the dead path needs the air where the reading was set to zero: give "
                'reset_temperature, reset_pressure, ..., or air_change = "1 ppm" as the most it changed'
            )
        if self.positive is None:
            raise OptionError(
                'the sign of the dead path needs positive = "away" or "towards": where the reflector '
                "goes while the reading rises"
            )
        sign = 1.0 if self.positive == "away" else -1.0
        now = {k: v for k, v in self.air.items() if k in AIR or k in U_AIR}
        now |= {k: v[start] for k, v in columns.items()}
        if any(k in own for k in WET):
            now = {k: v for k, v in now.items() if k.removeprefix("u_") not in WET}
        before = air_index(self.wavelength, equation=self.equation, **{**now, **own})
        if not np.isfinite(before.n):
            raise InvalidSamplesError(
                "the air was not measured where the reading is nearest to zero; give reset_temperature, "
                "reset_pressure and reset_humidity, which the dead path counts from"
            )
        value = -sign * path * (air.n - before.n) / air.n
        book.correct("dead_path", value)
        for source, term in air.terms.items():
            # the same sensors then and now: what they share falls out; so does the equation's error
            common = before.terms.get(source, 0.0)
            if source == "equation":
                common = term
            slope = before.n / air.n**2 * term - common / air.n
            book.add(_AIR_SOURCE(source), "dead_path", -sign * path * slope)
        if self.u_dead_path is None:
            book.silent.append("u_dead_path")
        else:
            book.add("length of dead path", "dead_path", value / path * self.u_dead_path)
        return value

    def _cosine(self, book: _Book, length: FloatArray) -> Any:
        if self.beam_angle is None and self.spot_walk is None:
            return 0.0
        angle, u = self.beam_angle, self.u_beam_angle
        if angle is None:
            known = length[np.isfinite(length)]
            travel = self.walk_travel or (float(np.ptp(known)) if known.size else 0.0)
            if travel <= 0.0:
                raise OptionError(
                    "spot_walk needs walk_travel: the travel over which the spot walks"
                )
            angle = self.spot_walk / (2.0 * travel)  # a retroreflector returns twice its offset
            u = None if self.u_spot_walk is None else self.u_spot_walk / (2.0 * travel)
            require_small("spot_walk over its travel", angle)
        angle = abs(angle)
        if self.misalignment == "limit":
            if u is not None:
                raise OptionError(
                    'an uncertainty of the beam belongs to misalignment = "measured"; a limit has none'
                )
            mean, u_mean = angle**2 / 4.0, angle**2 / (4.0 * math.sqrt(3.0))
        else:
            if u is None:
                book.silent.append("u_beam_angle" if self.spot_walk is None else "u_spot_walk")
            spread = u or 0.0
            mean = 1.0 / math.cos(angle) - 1.0 + spread**2 / 2.0
            u_mean = math.hypot(angle * spread, spread**2 / math.sqrt(2.0))
        book.correct("cosine", mean * length)
        book.add("direction of the beam", "cosine", u_mean * length)
        return mean * length

    def _abbe(self, book: _Book, name: str, angle: FloatArray | None, start: int) -> None:
        offset, u_offset = getattr(self, f"{name}_offset"), getattr(self, f"u_{name}_offset")
        limit, u_angle = getattr(self, f"{name}_limit"), getattr(self, f"u_{name}")
        if offset is None:
            if angle is not None or limit is not None or u_offset is not None:
                raise OptionError(
                    f"{name}_offset is needed: from the beam to the point of interest, with its sign"
                )
            return
        if (angle is None) == (limit is None):
            raise OptionError(
                f"{name}_offset needs the {name}: its column, or {name}_limit where it was not measured"
                + (", not both" if limit is not None else "")
            )
        if angle is None:
            book.correct(name, 0.0)
            book.add(name, name, abs(offset) * limit / math.sqrt(3.0))
            return
        known = angle[np.isfinite(angle)]
        require_small(name, float(np.ptp(known)) if known.size else 0.0)
        if not np.isfinite(angle[start]):
            raise InvalidSamplesError(
                f"{name} was not measured where the reading is nearest to zero; it counts from there"
            )
        turn = angle - angle[start]
        book.correct(name, offset * turn)
        for source, stated, value in (
            (f"{name} offset", u_offset, turn),
            (name, u_angle, offset * np.ones_like(turn)),
        ):
            if stated is None:
                book.silent.append(f"u_{source.replace(' ', '_')}")
            else:
                book.add(source, name, value * stated)

    def _expansion(self, book: _Book, length: FloatArray, column: FloatArray | None) -> None:
        if self.expansion is None:
            if column is not None or self.part_temperature is not None:
                raise OptionError(
                    'part_temperature needs expansion, such as "11.5 ppm/K" for steel'
                )
            return
        if (column is None) == (self.part_temperature is None):
            raise OptionError(
                "expansion needs part_temperature: a column or an option, one of them"
            )
        t = self.part_temperature if column is None else column
        _require_temperature(t)
        over = np.asarray(t) - _REFERENCE
        book.correct("expansion", -self.expansion * over * length)
        for source, stated, slope in (
            ("temperature of the part", self.u_part_temperature, -self.expansion * length),
            ("coefficient of expansion", self.u_expansion, -over * length),
        ):
            if stated is None:
                name = "u_expansion" if source.startswith("co") else "u_part_temperature"
                book.silent.append(name)
            else:
                book.add(source, "expansion", slope * stated)


def _AIR_SOURCE(name: str) -> str:  # noqa: N802
    return "equation for the air" if name == "equation" else f"{name.replace('_', ' ')} of the air"


def _require_temperature(t: Any) -> None:
    values = np.asarray(t, dtype=np.float64)
    wrong = values[(values < 233.15) | (values > 373.15)]
    if wrong.size:
        raise InvalidSamplesError(
            f"part_temperature = {float(wrong.flat[0]):.6g} K is not that of a part; a bare number is in "
            "K: 20 degC is '20 degC' or 293.15"
        )


def _column(name: str, values: Any, size: int) -> FloatArray:
    if name not in (*AIR, "part_temperature", "pitch", "yaw"):
        raise OptionError(f"{name!r} is not a column of a laser setup")
    array = np.asarray(values, dtype=np.float64)
    if array.ndim > 1 or array.size not in (1, size):
        raise InvalidSamplesError(f"{name} has {array.size} values for {size} readings")
    return array


def _at_zero(r: FloatArray) -> int:
    """Return the index of the first reading that is as near to zero as any, to 1e-3 of the largest."""
    size = np.where(np.isfinite(r), np.abs(r), np.inf)
    largest = float(np.max(size, initial=0.0, where=np.isfinite(size)))
    return int(np.argmax(size <= float(size.min()) + 1e-3 * largest))


class _Book:
    """Corrections and contributions to their uncertainty while they are made."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape
        self.values: dict[str, FloatArray] = {}
        self.sources: dict[str, dict[str, FloatArray]] = {}  # by source, then by correction
        self.silent: list[str] = []
        self.messages: tuple[str, ...] = ()

    def correct(self, name: str, value: Any) -> None:
        self.values[name] = np.broadcast_to(np.asarray(value, dtype=np.float64), self.shape)

    def add(self, source: str, name: str, value: Any) -> None:
        at = self.sources.setdefault(source, {})
        at[name] = np.broadcast_to(np.asarray(value, dtype=np.float64), self.shape)

    def told(self) -> tuple[str, ...]:
        if not self.silent:
            return self.messages
        names = ", ".join(self.silent)
        return (*self.messages, f"not stated: {names}; the uncertainty does not hold them")


@dataclass(frozen=True, slots=True, eq=False)
class LaserCorrections:
    """What is added to readings of a laser, with its uncertainty.

    Parameters
    ----------
    corrections : mapping of str to ndarray, shape (n,), m
        By name: wavelength, dead_path, cosine, pitch, yaw, expansion, as far as they were stated.
    contributions : mapping of str to mapping of str to ndarray, shape (n,), m
        By source, then by correction: standard uncertainty with the sign of its sensitivity.
    air : AirIndex
        Index of the air during the readings.
    reading : ndarray, shape (n,), m
        What was corrected.
    messages : tuple of str
        What the user should know.
    """

    corrections: Mapping[str, FloatArray]
    contributions: Mapping[str, Mapping[str, FloatArray]]
    air: AirIndex
    reading: FloatArray
    messages: tuple[str, ...] = ()

    @property
    def total(self) -> FloatArray:
        """Sum of all corrections, m."""
        return np.asarray(sum(self.corrections.values()))

    @property
    def u(self) -> FloatArray:
        """Standard uncertainty of the corrected reading, m."""
        return np.asarray(
            np.sqrt(sum(sum(c.values()) ** 2 for c in self.contributions.values()))
        )

    def u_of(self, name: str) -> FloatArray:
        """Return the standard uncertainty of one correction.

        Parameters
        ----------
        name : str
            One of `corrections`.

        Returns
        -------
        ndarray, shape (n,), m
            Of all sources that act on it; NaN where none was stated.
        """
        own = [c[name] ** 2 for c in self.contributions.values() if name in c]
        return np.sqrt(sum(own)) if own else np.full_like(self.reading, np.nan)

    def budget(self, at: int | None = None) -> dict[str, float]:
        """Return the contribution of each source at one reading.

        Parameters
        ----------
        at : int, optional
            Index of the reading; the largest if omitted.

        Returns
        -------
        dict of str to float, m
            Standard uncertainty, largest first.
        """
        i = self.farthest if at is None else at
        found = {k: abs(float(sum(c.values())[i])) for k, c in self.contributions.items()}  # type: ignore[index]
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @property
    def farthest(self) -> int:
        """Index of the largest reading."""
        size = np.where(np.isfinite(self.reading), np.abs(self.reading), -1.0)
        return int(np.argmax(size))

    def quantities(self) -> dict[str, Quantity]:
        """Return the corrections at the largest reading, their sum and the index of air.

        Returns
        -------
        dict of str to Quantity
            ``correction.wavelength`` ..., ``correction.total`` and ``n``, with u.
        """
        i = self.farthest
        at = f"at the reading {format_length(float(self.reading[i]))}"
        each = {k: (v, self.u_of(k)) for k, v in self.corrections.items()}
        found = {
            f"correction.{k}": Quantity(
                float(v[i]),
                "m",
                f"{_WHAT[k]}, {at}",
                u=None if np.isnan(u[i]) else float(u[i]),
                symbol=k.replace("_", " "),
            )
            for k, (v, u) in {**each, "total": (self.total, self.u)}.items()
        }
        return {**found, "n": _index_quantity(self.air, i)}

    def summary(self) -> str:
        """Return one sentence: the sum of the corrections at the largest reading, with u.

        Returns
        -------
        str
            For messages.
        """
        i = self.farthest
        parts = ", ".join(
            f"{k.replace('_', ' ')} {format_length(float(v[i]), digits=3)}"
            for k, v in self.corrections.items()
        )
        return (
            f"corrections of the laser at its largest reading ({format_length(float(self.reading[i]))}): "
            f"{parts}; standard uncertainty {format_length(float(self.u[i]), digits=2)}, common to all runs"
        )


_WHAT = {
    "wavelength": "correction for the wavelength in the air that was",
    "dead_path": "correction for the change of the air in the dead path",
    "cosine": "correction for the angle between beam and motion",
    "pitch": "correction for the Abbe offset times pitch",
    "yaw": "correction for the Abbe offset times yaw",
    "expansion": "correction of the length to 20 degC",
    "total": "sum of the corrections, added to the reading; u that of the corrected reading",
}


def _index_quantity(air: AirIndex, at: int = 0) -> Quantity:
    n, u = (np.ravel(v)[at if np.ndim(v) else 0] for v in (air.n, air.u))
    text = f"refractive index of air ({air.equation}) for {air.wavelength * 1e9:.7g} nm in vacuum"
    return Quantity(float(n), "1", text, u=float(u), symbol="n")


@dataclass(frozen=True, slots=True, eq=False)
class LaserReadings:
    """Corrected readings of a laser over positions, or the air alone.

    Parameters
    ----------
    air : AirIndex
        Index of the air.
    made : LaserCorrections or None
        What was added; None where no reading was given.
    separation : Separation or None
        Errors as read and corrected, and each correction, over positions.
    table : mapping
        The input with corrected readings, for ``iso230_2`` and others.
    messages : tuple of str
        What the user should know.
    """

    air: AirIndex
    made: LaserCorrections | None = None
    separation: Separation | None = None
    table: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def quantities(self) -> dict[str, Quantity]:
        """Return what was found, by metric.

        Returns
        -------
        dict of str to Quantity
            Those of the corrections; of air alone its index and the wavelength in it.
        """
        if self.made is not None:
            return self.made.quantities()
        n = _index_quantity(self.air)
        in_air = Quantity(
            n.value and self.air.wavelength / n.value, "m", "wavelength in this air",
            u=self.air.wavelength * (n.u or 0.0) / n.value**2, symbol="wavelength",
        )  # fmt: skip
        return {"n": n, "wavelength": in_air}


def laser_positions(
    position: ArrayLike,
    reading: ArrayLike,
    *,
    setup: LaserSetup,
    values: str = "position",
    approach: ArrayLike | None = None,
    **columns: ArrayLike,
) -> LaserReadings:
    """Return the errors of positions that a laser read, corrected.

    Parameters
    ----------
    position : array_like, shape (n,), m
        Nominal positions (targets), in the order of measuring.
    reading : array_like, shape (n,) or (k, n), m
        Positions as the laser displayed them, one row for each of k runs.
    setup : LaserSetup
        How it stood.
    values : {"position", "deviation"}, optional
        Whether readings are positions, or positions minus nominal.
    approach : array_like, shape (n,), optional
        Directions (texts); the table of the result repeats them.
    **columns : array_like, shape (n,)
        As for `LaserSetup.correct`.

    Returns
    -------
    LaserReadings
        With parts ``error`` (or ``error_1`` ...), ``as_read`` and each correction.

    Raises
    ------
    InvalidSamplesError
        If shapes differ, a position is NaN, or readings do not look like `values`.
    OptionError
        As for `LaserSetup.correct`.

    Examples
    --------
    >>> air = {"temperature": "20 degC", "pressure": "1000 hPa", "humidity": "50 %"}
    >>> found = laser_positions([0.0, 0.5], [0.0, 0.50014], values="position",
    ...                         setup=LaserSetup(software="vacuum", air=air))
    >>> (found.separation.error * 1e6).round(2).tolist()
    [0.0, 6.09]
    """
    from metrosep.separation.positions.positioning import as_positions

    x = frozen_float(position, name="position", ndim=1)
    if np.isnan(x).any():
        raise InvalidSamplesError("a position is NaN; a target is a command and must be known")
    rows = np.atleast_2d(np.asarray(reading, dtype=np.float64))
    if rows.shape[1] != x.size:
        raise InvalidSamplesError(f"{rows.shape[1]} readings stand at {x.size} positions")
    if np.isinf(rows).any():
        raise InvalidSamplesError(
            "a reading is infinite; leave it empty where it was not measured"
        )
    data = RoleColumns({"target": x, "readings": rows}, "", ())
    rows = np.asarray(as_positions(data, values).values["readings"])
    n_known = np.isfinite(rows).sum(axis=0)
    mean = np.where(n_known > 0, np.nansum(rows, axis=0) / np.maximum(n_known, 1), np.nan)
    made = setup.correct(mean - setup.zero, **columns)
    errors = rows - x
    names = ["error"] if len(rows) == 1 else [f"error_{i + 1}" for i in range(len(rows))]
    parts = {n: e + made.total for n, e in zip(names, errors, strict=True)}
    u = dict.fromkeys(names, made.u)
    parts |= {"as_read": mean - x, **made.corrections}
    read_u = math.nan if setup.u_reading is None else setup.u_reading
    u |= {"as_read": np.full(x.size, read_u), **{k: made.u_of(k) for k in made.corrections}}
    separation = Separation(
        "laser_positions", parts, u, dict.fromkeys(parts, "m"), {"x": x}, _UNSEEN,
        audit=_audit(setup, made), messages=made.messages,
    )  # fmt: skip
    table: dict[str, Any] = {"target_m": x}
    if approach is not None:
        table["direction"] = [str(d) for d in np.asarray(approach)]
    table |= {f"run{i + 1}_m": r + made.total for i, r in enumerate(rows)}
    return LaserReadings(made.air, made, separation, table, made.messages)


_UNSEEN = (
    Unobservable(
        "error", "term", ("constant",),
        "the reading is zero where it was set to zero: an error there moves all others",
    ),
    Unobservable(
        "error", "term", ("air along the beam",),
        "sensors at one place do not see a gradient or turbulence: place them beside the beam, average",
    ),
)  # fmt: skip


def _audit(setup: LaserSetup, made: LaserCorrections) -> dict[str, Any]:
    """Return what was done, plain."""
    i = made.farthest
    n = np.broadcast_to(np.asarray(made.air.n), made.reading.shape)
    stated = {
        k: getattr(setup, k) for k in options_of(LaserSetup) if getattr(setup, k) is not None
    }
    return {
        **{k: _shown(v, SETUP[k]) for k, v in {**stated, **setup.air}.items()},
        "refractive_index": f"{float(n[i]):.9f}",
        "budget_at_largest_reading_m": made.budget(),
    }


def _shown(value: Any, known: Option) -> Any:
    from metrosep.core.options import KINDS

    dimension = KINDS[known.kind].dimension
    if isinstance(value, str) or dimension is None or np.ndim(value):
        return value
    return typed_number(float(value), dimension, digits=7)


def setup_of(options: Mapping[str, Any]) -> LaserSetup:
    """Return the set-up that the keys of a step say."""
    air = {k: v for k, v in options.items() if k in SURROUNDINGS}
    return LaserSetup(**{k: v for k, v in options.items() if k not in air}, air=air)


class LaserPositions(NamedMethod):
    """`laser_positions` by its name."""

    name: ClassVar[str] = "laser_positions"
    what: ClassVar[str] = (
        "positions read by a laser, corrected for air, dead path, cosine, Abbe, heat"
    )
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "position": "length", "readings": "length*", "approach": "label?",
        "temperature": "temperature?", "pressure": "pressure?", "humidity": "share?",
        "dew_point": "temperature?", "vapour_pressure": "pressure?", "co2": "share?",
        "part_temperature": "temperature?", "pitch": "angle?", "yaw": "angle?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = {
        "values": Option(
            "text", choices=("position", "deviation"), default="position",
            help="what the readings are: positions, or positions minus nominal",
        ),
        **SETUP,
    }  # fmt: skip

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> LaserReadings:
        """Return the corrected readings of a table."""
        rest = dict(options)
        columns = dict(data.values)
        position, reading = columns.pop("position"), columns.pop("readings")
        values = rest.pop("values", "position")
        return laser_positions(position, reading, setup=setup_of(rest), values=values, **columns)


class AirOnce(NamedMethod):
    """`air` by its name: the index of air, and the corrections of one reading."""

    name: ClassVar[str] = "air"
    what: ClassVar[str] = "refractive index of air, and what it does to one reading of a laser"
    reads: ClassVar = "nothing"
    arguments: ClassVar[Mapping[str, Option]] = AIR_KEYS

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> LaserReadings:
        """Return the air, and the corrections where a reading was given."""
        rest = dict(options)
        reading = rest.pop("reading", None)
        angles = {k: rest.pop(k) for k in ("pitch", "yaw") if k in rest}
        setup = setup_of(rest)
        if reading is None:
            used = [
                k for k in (*angles, *rest) if k not in (*AIR, *U_AIR, "wavelength", "equation")
            ]
            if used:
                raise DataError(f'{used[0]} needs a reading that it acts on: reading = "500 mm"')
            air = setup.index()
            return LaserReadings(air, messages=air.messages)
        reading = real(reading, "reading", dimension="length")
        # angles count from zero, where the reading is zero too
        columns = {k: [0.0, v] for k, v in angles.items()}
        both = setup.correct([0.0, reading], **columns)
        cut = {k: v[1:] for k, v in both.corrections.items()}
        sources = {s: {k: v[1:] for k, v in c.items()} for s, c in both.contributions.items()}
        made = LaserCorrections(cut, sources, both.air, both.reading[1:], both.messages)
        return LaserReadings(made.air, made, messages=made.messages)

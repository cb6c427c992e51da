"""Readings of a laser interferometer, corrected for air, dead path, cosine, Abbe offset and temperature.

Each correction is added to the reading. A source of uncertainty acts on several corrections at once
(one thermometer on wavelength and dead path): its contributions are added with their signs, then the
sources in quadrature (JCGM 100, 5.1 and 5.2).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, OptionError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import choice, real
from metrosep.core.options import KINDS, Option, checked
from metrosep.core.provenance import freeze_mapping
from metrosep.core.readable import did_you_mean, typed_number
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length, parse_quantity
from metrosep.optics.air import AirIndex, air_index
from metrosep.optics.air_options import AIR, U_AIR, WET
from metrosep.separation.contract import NamedMethod, Separation, Unobservable
from metrosep.separation.positions.laser_options import AIR_KEYS, READ_AS, SETUP
from metrosep.separation.positions.positioning import as_positions

_REFERENCE = 293.15
"""K; lengths are stated at 20 degC (ISO 1)."""

_LARGEST_ANGLE = 20e-3
"""rad; a beam or a carriage that is further off is a wrong unit. Below, the cubes that the algebra
leaves out are under 1.4e-6 of an Abbe offset."""

_LONGEST = 200.0
"""m; no axis is longer, but one in mm passed as m is."""

_APART = (0.02, 1e-3)
"""Share of the travel, and m; no axis is further off, and air is 0.03 %."""

_LINE = 86
"""Letters of a description between its brackets; what is more is cut."""

_NEAR_ZERO = 1e-3
"""Of the largest reading; the first reading this near to the smallest counts as the zero."""


class LaserSetup:
    """How a laser interferometer stood, what its software assumed and which air there was.

    Parameters
    ----------
    **options
        As ``metrosep ops laser_positions`` lists them; numbers in SI (temperatures in K) or texts
        with a unit.

    Raises
    ------
    OptionError
        If an option is unknown or not of its kind.
    InvalidSamplesError
        If a value is out of its range.

    Examples
    --------
    >>> setup = LaserSetup(software="vacuum", dead_path="200 mm", positive="away",
    ...                    temperature="21 degC", pressure="1005 hPa", humidity="45 %",
    ...                    reset_temperature="20 degC")
    >>> found = setup.correct([0.5])
    >>> {k: f"{1e6 * v[0]:.3f} um" for k, v in found.corrections.items()}
    {'wavelength': '-134.094 um', 'dead_path': '0.188 um'}
    """

    __slots__ = ("options",)

    def __init__(self, **options: Any) -> None:
        given: dict[str, Any] = {}
        for name, value in options.items():
            if name not in SETUP:
                raise OptionError(f"a laser set-up has no {name!r}.{did_you_mean(name, SETUP)}")
            if value is not None:
                given[name] = checked(SETUP[name], value, name)
        self.options = freeze_mapping(given)
        for name in ("beam_angle", "pitch_limit", "yaw_limit"):
            _require_small(name, self[name] or 0.0)
        if self["beam_angle"] is not None and self["spot_walk"] is not None:
            raise OptionError("beam_angle and spot_walk say the same; give one of them")

    def __getitem__(self, name: str) -> Any:
        """Return an option in SI; its default, or None, where it was not stated."""
        usual = SETUP[name].default
        if name in self.options or usual is None:
            return self.options.get(name)
        dimension = KINDS[SETUP[name].kind].dimension
        return usual if dimension is None else parse_quantity(usual, dimension=dimension)

    def __eq__(self, other: object) -> bool:
        return self.options == other.options if isinstance(other, LaserSetup) else NotImplemented

    def __hash__(self) -> int:
        return hash(frozenset(self.options.items()))

    def __repr__(self) -> str:
        said = []
        for name, value in self.options.items():
            dimension = KINDS[SETUP[name].kind].dimension
            if dimension is None or not isinstance(value, float):
                said.append(f"{name}={value!r}")
            else:
                said.append(f"{name}={typed_number(value, dimension)!r}")
        text = ", ".join(said)
        return f"LaserSetup({text if len(text) <= _LINE else text[: _LINE - 3] + '...'})"

    def correct(self, reading: ArrayLike, **columns: ArrayLike) -> LaserCorrections:
        """Return what is to be added to readings.

        Parameters
        ----------
        reading : array_like, shape (n,), m
            Displacement since the reading was set to zero, as displayed; NaN where not measured.
        **columns : array_like, shape (n,)
            What was recorded, in place of options: ``temperature`` (K), ``pressure`` (Pa),
            ``humidity`` (1), ``dew_point`` (K), ``vapour_pressure`` (Pa), ``co2`` (1),
            ``part_temperature`` (K); and ``pitch``, ``yaw`` (rad).

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
        positive is away, -1 towards; L is the length after the corrections before::

            wavelength  R (n_s / n - 1)
            dead_path   -s D (n - n_0) / n
            cosine      L m,    m = 1 / cos(theta) - 1 + u^2 / 2, or a^2 / 4 of a limit a
            pitch, yaw  h (angle - angle at zero)
            expansion   L / (1 + alpha (T - 20 degC)) - L

        The beam within a cone of half-angle a: theta^2 is rectangular from 0 to a^2, so that m has
        the mean a^2 / 4 and u = a^2 / (4 sqrt 3) (JCGM 100, F.2.4.4: the correction for a cosine is
        not zero though its angle is).
        """
        r = np.atleast_1d(frozen_float(np.ravel(np.asarray(reading)), name="reading", ndim=1))
        largest = float(np.max(np.abs(r), initial=0.0, where=np.isfinite(r)))
        if largest > _LONGEST:
            raise InvalidSamplesError(f"a reading is {largest:.6g} m; pass m (divide mm by 1000)")
        at = {k: np.broadcast_to(_column(k, v, r.size), r.shape) for k, v in columns.items()}
        size = np.where(np.isfinite(r), np.abs(r), np.inf)
        start = int(np.argmax(size <= float(size.min()) + _NEAR_ZERO * largest))
        columns_of_air = {k: v for k, v in at.items() if k in AIR}
        book = _Book(r, self._index(columns_of_air))
        self._wavelength(book)
        self._dead_path(book, columns_of_air, start)
        self._cosine(book)
        for name in ("pitch", "yaw"):
            self._abbe(book, name, at.get(name), start)
        self._expansion(book, at.get("part_temperature"))
        if self["u_reading"] is not None:
            book.add("reading", "reading", self["u_reading"])
        return book.made()

    def corrected(
        self, runs: RunSet, *, values: str = "deviation"
    ) -> tuple[RunSet, LaserCorrections]:
        """Return runs with corrected errors, and the corrections of the run that reaches farthest.

        Parameters
        ----------
        runs : RunSet
            Errors ``actual - nominal`` along the travel, or positions, read by the laser. ``metadata["air"]`` of a
            run may hold columns as of `correct`, or one value of each.
        values : {"deviation", "position"}, optional
            What the readings are: errors, or positions that the laser displayed.

        Returns
        -------
        tuple of (RunSet, LaserCorrections)
            Positions, times and feeds are kept.

        Raises
        ------
        OptionError
            As for `correct`; also where a correction needs a column, such as pitch.
        InvalidSamplesError
            If readings do not look like `values`.
        """
        choice(values, "values", ("deviation", "position"))
        for i, run in enumerate(runs):
            _require_kind(run, values, run.run_id or str(i + 1))
        errors = [run.z - run.x if values == "position" else run.z for run in runs]
        made = [
            self.correct(run.x + e - self["zero"], **run.metadata.get("air", {}))
            for run, e in zip(runs, errors, strict=True)
        ]
        new = [
            Run(r.x, e + c.total, t=r.t, feed=r.feed, run_id=r.run_id, metadata=r.metadata)
            for r, e, c in zip(runs, errors, made, strict=True)
        ]
        far = max(made, key=lambda c: float(np.nanmax(np.abs(c.reading))))
        return RunSet(new, metadata=runs.metadata, history=runs.history), far

    # ---- one correction each; the algebra is in the notes of `correct` ----

    def _stated(self, names: Iterable[str], prefix: str = "") -> dict[str, Any]:
        """Return options by their names without the prefix."""
        found = {k: self.options.get(f"{prefix}{k}") for k in names}
        return {k: v for k, v in found.items() if v is not None}

    def _index(self, columns: Mapping[str, Any]) -> AirIndex:
        """Return the index of the air during the readings."""
        twice = [k for k in columns if k in self.options]
        if twice:
            raise OptionError(f"{twice[0]} is a column and an option; give one of them")
        return self._air({**self._stated((*AIR, *U_AIR)), **columns})

    def _air(self, given: Mapping[str, Any]) -> AirIndex:
        return air_index(self["wavelength"], equation=self["equation"], **given)

    def _software_index(self, air: AirIndex) -> Any:
        own = self._stated(AIR, "software_")
        index, word = self["software_index"], self["software"]
        if (index is not None) + (word is not None) + bool(own) != 1:
            raise OptionError(
                'say once what the software of the laser assumed of the air: software ("vacuum" '
                'or "same air"), or software_index, or software_temperature, software_pressure and '
                "software_humidity"
            )
        for name in ("temperature", "pressure") if own else ():
            if name not in own:
                raise OptionError(f"software_{name} is needed beside software_{next(iter(own))}")
        if own:
            return self._air({**own, **self._stated(["co2"])}).n
        return index if index is not None else 1.0 if word == "vacuum" else air.n

    def _wavelength(self, book: _Book) -> None:
        n = book.air.n
        assumed = self._software_index(book.air)
        for source, term in book.air.terms.items():
            book.add(_of_air(source), "wavelength", -book.reading * assumed / n**2 * term)
        book.add(
            "laser wavelength", "wavelength", book.reading, self["u_wavelength"], "u_wavelength"
        )
        book.correct("wavelength", book.reading * (assumed / n - 1.0))

    def _dead_path(self, book: _Book, columns: Mapping[str, FloatArray], start: int) -> None:
        path, change, own = self["dead_path"], self["air_change"], self._stated(AIR, "reset_")
        if not path:
            return
        if change is not None:
            if own:
                raise OptionError(
                    "air_change and reset_... contradict each other; give one of them"
                )
            book.add("air since zero", "dead_path", path * change / math.sqrt(3.0))
            book.correct("dead_path", 0.0)
            return
        if not own and not columns:
            raise OptionError(
                "the dead path needs the air where the reading was set to zero: give "
                'reset_temperature, reset_pressure, ..., or air_change = "1 ppm" as the most it changed'
            )
        if self["positive"] is None:
            raise OptionError(
                'the sign of the dead path needs positive ("away" or "towards"): where the reflector '
                "goes while the reading rises"
            )
        sign = 1.0 if self["positive"] == "away" else -1.0
        given = {**self._stated((*AIR, *U_AIR)), **{k: v[start] for k, v in columns.items()}}
        if any(k in own for k in WET):
            given = {k: v for k, v in given.items() if k.removeprefix("u_") not in WET}
        air, before = book.air, self._air({**given, **own})
        if not np.isfinite(before.n):
            raise InvalidSamplesError(
                "the air was not measured where the reading is nearest to zero; give reset_temperature, "
                "reset_pressure and reset_humidity, which the dead path counts from"
            )
        value = -sign * path * (air.n - before.n) / air.n
        for source, term in air.terms.items():
            # the same sensors then and now, and the same equation: what they share falls out
            common = term if source == "equation" else before.terms.get(source, 0.0)
            slope = before.n / air.n**2 * term - common / air.n
            book.add(_of_air(source), "dead_path", -sign * path * slope)
        book.add(
            "length of dead path", "dead_path", value / path, self["u_dead_path"], "u_dead_path"
        )
        book.correct("dead_path", value)

    def _cosine(self, book: _Book) -> None:
        angle, u, name = self["beam_angle"], self["u_beam_angle"], "u_beam_angle"
        if self["spot_walk"] is not None:
            known = book.reading[np.isfinite(book.reading)]
            travel = self["walk_travel"] or (float(np.ptp(known)) if known.size else 0.0)
            if travel <= 0.0:
                raise OptionError(
                    "spot_walk needs walk_travel: the travel over which the spot walks"
                )
            # a retroreflector returns the beam at twice its offset
            angle, u, name = (
                self["spot_walk"] / (2.0 * travel), self["u_spot_walk"], "u_spot_walk",
            )  # fmt: skip
            u = None if u is None else u / (2.0 * travel)
            _require_small("spot_walk over its travel", angle)
        if angle is None:
            return
        if self["misalignment"] == "limit":
            if u is not None:
                raise OptionError(f'{name} belongs to misalignment = "measured"; a limit has none')
            mean, u_mean = angle**2 / 4.0, angle**2 / (4.0 * math.sqrt(3.0))
        else:
            mean, u_mean = 1.0 / math.cos(angle) - 1.0, None
            if u is not None:
                mean += u**2 / 2.0
                u_mean = math.hypot(angle * u, u**2 / math.sqrt(2.0))
        book.add("direction of the beam", "cosine", book.length, u_mean, name)
        book.correct("cosine", mean * book.length)

    def _abbe(self, book: _Book, name: str, angle: FloatArray | None, start: int) -> None:
        offset, limit = self[f"{name}_offset"], self[f"{name}_limit"]
        if offset is None:
            if angle is not None or limit is not None or self[f"u_{name}_offset"] is not None:
                raise OptionError(
                    f"{name}_offset is needed: from the beam to the point of interest, with its sign"
                )
            return
        if (angle is None) == (limit is None):
            raise OptionError(
                f"{name}_offset needs the {name}: its column, or {name}_limit where it was not measured"
                + ("" if limit is None else ", not both")
            )
        if angle is None:
            book.add(name, name, abs(offset) * limit / math.sqrt(3.0))
            book.correct(name, 0.0)
            return
        if not np.isfinite(angle[start]):
            raise InvalidSamplesError(
                f"{name} was not measured where the reading is nearest to zero; it counts from there"
            )
        turn = angle - angle[start]
        _require_small(name, float(np.max(np.abs(turn), initial=0.0, where=np.isfinite(turn))))
        book.add(f"{name} offset", name, turn, self[f"u_{name}_offset"], f"u_{name}_offset")
        book.add(name, name, offset, self[f"u_{name}"], f"u_{name}")
        book.correct(name, offset * turn)

    def _expansion(self, book: _Book, column: FloatArray | None) -> None:
        alpha, stated = self["expansion"], self["part_temperature"]
        if alpha is None:
            if column is not None or stated is not None:
                raise OptionError(
                    'part_temperature needs expansion, such as "11.5 ppm/K" for steel'
                )
            return
        if (column is None) == (stated is None):
            raise OptionError(
                "expansion needs part_temperature: a column or an option, one of them"
            )
        t = np.asarray(stated if column is None else column)
        wrong = t[(t < 233.15) | (t > 373.15)]
        if wrong.size:
            raise InvalidSamplesError(
                f"part_temperature is {float(wrong.flat[0]):.6g} K, not that of a part; a bare number "
                "is in K: 20 degC is '20 degC' or 293.15"
            )
        over, length = t - _REFERENCE, book.length
        book.add(
            "temperature of the part", "expansion", -alpha * length, self["u_part_temperature"],
            "u_part_temperature",
        )  # fmt: skip
        book.add("expansion", "expansion", -over * length, self["u_expansion"], "u_expansion")
        book.correct("expansion", -alpha * over / (1.0 + alpha * over) * length)


def _of_air(name: str) -> str:
    return "equation for the air" if name == "equation" else f"{name.replace('_', ' ')} of the air"


def _require_small(name: str, angle: float) -> None:
    if abs(angle) > _LARGEST_ANGLE:
        raise InvalidSamplesError(
            f"{name} is {angle:.4g} rad, more than {_LARGEST_ANGLE:g} rad; check its unit "
            "(a bare number is in rad)"
        )


_LIKE_POSITIONS, _LIKE_ERRORS = 0.1, 0.5
"""Readings whose slope over the positions is this near to 1 are positions, below the second errors:
an axis that is wrong by a tenth of its travel is broken, not measured."""


def _require_kind(run: Run, values: str, name: str) -> None:
    """Refuse readings that are not what they are stated to be."""
    known = np.isfinite(run.z)
    x = run.x[known] - float(run.x[known].mean())
    slope = float(x @ run.z[known]) / float(x @ x)
    if values == "deviation" and abs(slope) > _LIKE_ERRORS:
        raise InvalidSamplesError(
            f"the readings of run {name} look like positions, not like errors: they change by {slope:.4g} "
            'times the position; say values = "position" in the step laser_setup'
        ).hinting(values="position")
    if values == "position" and abs(slope - 1.0) > _LIKE_POSITIONS:
        raise InvalidSamplesError(
            f"the readings of run {name} do not look like positions: they change by {slope:.4g} times the "
            "position, and it must be 1; if they are errors (actual minus nominal) leave values = "
            '"position" out, if they fall while the position rises change the sign of one of them'
        ).hinting(values=None)


def _column(name: str, values: Any, size: int) -> FloatArray:
    if name not in (*AIR, "part_temperature", "pitch", "yaw"):
        raise OptionError(f"{name!r} is not a column of a laser set-up")
    array = np.asarray(values, dtype=np.float64)
    if array.ndim > 1 or array.size not in (1, size):
        raise InvalidSamplesError(f"{name} has {array.size} values for {size} readings")
    return array


class _Book:
    """Corrections and contributions to their uncertainty while they are made."""

    def __init__(self, reading: FloatArray, air: AirIndex) -> None:
        self.reading, self.air = reading, air
        self.length = reading  # with the corrections up to now
        self.values: dict[str, FloatArray] = {}
        self.sources: dict[str, dict[str, FloatArray]] = {}  # by source, then by correction
        self.silent: list[str] = []

    def correct(self, name: str, value: Any) -> None:
        self.values[name] = np.broadcast_to(
            np.asarray(value, dtype=np.float64), self.reading.shape
        )
        self.length = self.length + value

    def add(
        self, source: str, name: str, slope: Any, u: float | None = 1.0, option: str = ""
    ) -> None:
        """Note slope times u; an option without a value is named in a message."""
        if u is None:
            self.silent.append(option)
            return
        value = np.broadcast_to(np.asarray(slope * u, dtype=np.float64), self.reading.shape)
        self.sources.setdefault(source, {})[name] = value

    def made(self) -> LaserCorrections:
        told = list(self.air.messages)
        if self.silent:
            names = ", ".join(self.silent)
            told.append(f"not stated: {names}: not in the uncertainty")
        found = LaserCorrections(self.values, self.sources, self.air, self.reading)
        lost = int((np.isfinite(self.reading) & ~np.isfinite(found.total)).sum())
        if lost and lost == np.isfinite(self.reading).sum():
            raise InvalidSamplesError(
                "no reading has air (and angle, temperature) beside it: nothing can be corrected; look "
                "for empty columns"
            )
        if lost:
            told.append(
                f"{lost} of {self.reading.size} readings have no air, angle or temperature beside "
                "them: not corrected, NaN"
            )
        return replace(found, messages=tuple(told))


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
        sources = (sum(c.values()) for c in self.contributions.values())
        return np.asarray(np.sqrt(sum(np.square(s) for s in sources)))

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
        own = [np.square(c[name]) for c in self.contributions.values() if name in c]
        return np.sqrt(sum(own)) if own else np.full_like(self.reading, np.nan)

    @property
    def farthest(self) -> int:
        """Index of the largest reading."""
        return int(np.argmax(np.where(np.isfinite(self.total), np.abs(self.reading), -1.0)))

    def budget(self) -> dict[str, float]:
        """Return the standard uncertainty in m from each source at the largest reading, largest first."""
        i = self.farthest
        found = {
            k: abs(math.fsum(v[i] for v in c.values())) for k, c in self.contributions.items()
        }
        return dict(sorted(found.items(), key=lambda item: -item[1]))


@dataclass(frozen=True, slots=True, eq=False)
class LaserReadings:
    """Corrected readings of a laser over positions, or of one, or the air alone.

    Parameters
    ----------
    air : AirIndex
        Index of the air.
    made : LaserCorrections or None
        What was added; None where no reading was given.
    separation : Separation or None
        Errors as read and corrected, and each correction, over positions.
    table : mapping
        Targets, directions and corrected readings: columns for ``iso230_2`` and others.
    messages : tuple of str
        What the user should know.
    """

    air: AirIndex
    made: LaserCorrections | None = None
    separation: Separation | None = None
    table: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()


def laser_positions(
    position: ArrayLike,
    readings: ArrayLike,
    *,
    setup: LaserSetup,
    values: str = "position",
    approach: ArrayLike | None = None,
    run: ArrayLike | None = None,
    **columns: ArrayLike,
) -> LaserReadings:
    """Return the errors of positions that a laser read, corrected.

    Parameters
    ----------
    position : array_like, shape (n,), m
        Nominal positions (targets), in the order of measuring.
    readings : array_like, shape (n,) or (k, n), m
        Positions as the laser displayed them, one row for each of k runs.
    setup : LaserSetup
        How it stood.
    approach : array_like, shape (n,), optional
        Directions (texts); the table of the result repeats them.
    run : array_like, shape (n,), optional
        Which run each of the readings belongs to, where the runs stand below each other.
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
    >>> room = LaserSetup(software="vacuum", temperature="20 degC", pressure="1000 hPa", humidity="50 %")
    >>> found = laser_positions([0.0, 0.5], [0.0, 0.50014], setup=room)
    >>> (found.separation.error * 1e6).round(2).tolist()
    [0.0, 6.09]
    """
    x = frozen_float(position, name="position", ndim=1)
    if np.isnan(x).any():
        raise InvalidSamplesError("a position is NaN; a target is a command and must be known")
    rows = frozen_float(np.atleast_2d(readings), name="readings", ndim=2)
    if rows.shape[1] != x.size:
        raise InvalidSamplesError(f"there are {rows.shape[1]} readings for {x.size} positions")
    data = RoleColumns({"target": x, "readings": rows}, "", ())
    rows = np.asarray(as_positions(data, values).values["readings"])
    _require_alike(x, rows, setup["zero"])
    known = np.isfinite(rows).sum(axis=0)
    mean = np.where(known > 0, np.nansum(rows, axis=0) / np.maximum(known, 1), np.nan)
    made = setup.correct(mean - setup["zero"], **columns)
    names = ["error"] if len(rows) == 1 else [f"error_{i + 1}" for i in range(len(rows))]
    parts = {n: r - x + made.total for n, r in zip(names, rows, strict=True)}
    parts |= {"as_read": mean - x, **made.corrections}
    unknown = np.full(x.size, np.nan if setup["u_reading"] is None else setup["u_reading"])
    u = {**dict.fromkeys(names, made.u), "as_read": unknown}
    u |= {k: made.u_of(k) for k in made.corrections}
    separation = Separation(
        "laser_positions", parts, u, dict.fromkeys(parts, "m"), {"x": x}, _UNSEEN,
        audit={k: _shown(v, SETUP[k]) for k, v in setup.options.items()}, messages=made.messages,
    )  # fmt: skip
    table = _run_columns(x, rows + made.total, approach, run)
    return LaserReadings(made.air, made, separation, table, made.messages)


def _require_alike(x: FloatArray, rows: FloatArray, zero: float) -> None:
    """Refuse readings that cannot be those of the positions: another unit, the other sign."""
    apart = np.abs(rows - x)
    largest = float(np.max(apart, initial=0.0, where=np.isfinite(apart)))
    if largest > _APART[0] * float(np.max(np.abs(x - zero), initial=0.0)) + _APART[1]:
        raise InvalidSamplesError(
            f"a reading is {format_length(largest)} from its position; check the units, whether the "
            "reading falls while the position rises, and zero (where the reading was set to zero)"
        )


def _run_columns(x: FloatArray, rows: FloatArray, approach: Any, run: Any) -> dict[str, Any]:
    """Return targets, directions and a column for each run."""
    ways = [""] * x.size if approach is None else [str(d) for d in np.asarray(approach)]
    if run is not None:
        if len(rows) > 1:
            raise InvalidSamplesError("run tells runs of one column apart; name one of readings")
        marks = [str(r) for r in np.asarray(run)]
        keys = list(zip(x.tolist(), ways, strict=True))
        places = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        number = {mark: i for i, mark in enumerate(dict.fromkeys(marks))}
        wide, seen = np.full((len(number), len(places)), np.nan), set()
        for key, mark, z in zip(keys, marks, rows[0], strict=True):
            if (key, mark) in seen:
                raise InvalidSamplesError(
                    f"run {mark} holds the target {format_length(key[0])} {key[1]} twice; name the "
                    "column of directions, approach"
                )
            seen.add((key, mark))
            wide[number[mark], places[key]] = z
        x, ways, rows = np.array([p[0] for p in places]), [p[1] for p in places], wide
    found: dict[str, Any] = {"target_m": x, **({} if approach is None else {"direction": ways})}
    return found | {f"run{i + 1}_m": r for i, r in enumerate(rows)}


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


def _shown(value: Any, known: Option) -> Any:
    """Return an option as a person writes it."""
    dimension = KINDS[known.kind].dimension
    return value if dimension is None else typed_number(float(value), dimension, digits=7)


class LaserPositions(NamedMethod):
    """`laser_positions` by its name."""

    name = "laser_positions"
    what = "positions read by a laser, corrected for air, dead path, cosine, Abbe, heat"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "position": "length", "readings": "length*", "approach": "label?", "run": "label?",
        "temperature": "temperature?", "pressure": "pressure?", "humidity": "share?",
        "dew_point": "temperature?", "vapour_pressure": "pressure?", "co2": "share?",
        "part_temperature": "temperature?", "pitch": "angle?", "yaw": "angle?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = {
        "values": replace(READ_AS, default="position"),
        **SETUP,
    }  # fmt: skip

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> LaserReadings:
        """Return the corrected readings of a table."""
        rest = dict(options)
        values = rest.pop("values", "position")
        return laser_positions(setup=LaserSetup(**rest), values=values, **data.values)


class AirOnce(NamedMethod):
    """`air` by its name: the index of air, and the corrections of one reading."""

    name = "air"
    what = "refractive index of air, and what it does to one reading of a laser"
    reads = "nothing"
    arguments: ClassVar[Mapping[str, Option]] = AIR_KEYS

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> LaserReadings:
        """Return the air, and the corrections where a reading was given."""
        rest = dict(options)
        reading = rest.pop("reading", None)
        angles = {k: rest.pop(k) for k in ("pitch", "yaw") if k in rest}
        setup = LaserSetup(**rest)
        if reading is None:
            used = [
                k for k in (*angles, *rest) if k not in (*AIR, *U_AIR, "wavelength", "equation")
            ]
            if used:
                raise DataError(f'{used[0]} needs a reading that it acts on: reading = "500 mm"')
            known = {k: v for k, v in rest.items() if k in AIR or k in U_AIR}
            air = air_index(setup["wavelength"], equation=setup["equation"], **known)
            return LaserReadings(air, messages=air.messages)
        # angles count from zero, where the reading is zero too
        reading = real(reading, "reading", dimension="length")
        made = setup.correct([0.0, reading], **{k: [0.0, v] for k, v in angles.items()})
        return LaserReadings(made.air, made, messages=made.messages)

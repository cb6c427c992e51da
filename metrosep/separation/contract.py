"""The contract of every separation: simulate, separate, correct, and a stated null space.

A method is an object that holds how the set-up is built (angles, distances, radii). It turns known
parts into the readings they would give (`simulate`), readings into parts (`separate`), and takes
the machine's share out of readings (`correct`). What it cannot see is listed by `null_space`.
"""

from __future__ import annotations

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import ComplexArray, FloatArray, as_float
from metrosep.core.errors import DataError, FormatMismatchError
from metrosep.core.methods import Method, Readings
from metrosep.core.numbers import not_negative
from metrosep.core.options import Option
from metrosep.core.profile import html_table
from metrosep.core.provenance import Step, freeze_mapping, history_as_dicts
from metrosep.core.public import PublicObject, shortened
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_engineering, format_length
from metrosep.separation._readings import plain, reduced, require_turn
from metrosep.separation.covariance import CovarianceModes

if TYPE_CHECKING:
    import pandas as pd

History = tuple[Step, ...]
Parts = Mapping[str, ArrayLike]
"""Parts of a simulation by name."""

_COORDINATE_UNITS = {"angle": "rad", "time": "s"}
"""All other coordinates are lengths in m."""

_UNKNOWN_NOISE = Quantity(
    math.nan, "m", "standard deviation of one reading; not known", symbol="s"
)


def _frozen(items: Mapping[str, Any], dtype: type) -> Mapping[str, Any]:
    out = {}
    for name, values in items.items():
        array: NDArray[Any] = np.array(values, dtype=dtype)
        array.flags.writeable = False
        out[name] = array
    return MappingProxyType(out)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Separation(PublicObject):
    """Parts into which readings were separated, with what is known about them.

    Every part is also an attribute: ``result.artefact`` is ``result.parts["artefact"]``.

    Parameters
    ----------
    method : str
        Name of the method.
    parts : mapping of str to array_like
        Each part, SI; NaN where the readings do not determine it.
    u : mapping of str to array_like
        Standard uncertainty of each part, of the same shape; NaN where it is not known.
    units : mapping of str to str
        SI unit of each part.
    coordinates : mapping of str to array_like
        What the samples of the parts are sampled over, such as ``{"angle": ...}`` in rad,
        ``{"time": ...}`` in s or ``{"x": ...}`` in m.
    null_space : tuple of Unobservable
        What the method cannot see.
    noise : Quantity, optional
        Standard deviation of one reading: found from repeats or redundancy, or as stated.
    harmonics, harmonics_u : mapping of str to array_like, optional
        Complex coefficients c_k, k = 0 ... K, of ``sum_k Re(c_k exp(j k angle))``, NaN where
        suppressed, and the standard uncertainty of their real and imaginary parts each.
    audit : mapping, optional
        What was done: plain values, keys with unit suffixes.
    messages : tuple of str, optional
        What the user should know, in plain words.
    history : tuple of Step, optional
        From the files on.
    modes : mapping of str to CovarianceModes, optional
        What the errors of a part at different positions have in common, of parts that were made of
        estimates, and of the straightness that probes in a row show.

    Raises
    ------
    DataError
        If a part lacks its uncertainty or unit, or their shapes differ.

    Examples
    --------
    >>> result = Separation("example", {"artefact": [1e-9, 2e-9]}, {"artefact": [0.0, 0.0]},
    ...                     {"artefact": "m"}, {"x": [0.0, 1e-3]}, ())
    >>> result.artefact.tolist()
    [1e-09, 2e-09]
    """

    method: str
    parts: Mapping[str, FloatArray]
    u: Mapping[str, FloatArray]
    units: Mapping[str, str]
    coordinates: Mapping[str, FloatArray]
    null_space: tuple[Unobservable, ...]
    noise: Quantity = _UNKNOWN_NOISE
    harmonics: Mapping[str, ComplexArray] = field(default_factory=dict)
    harmonics_u: Mapping[str, FloatArray] = field(default_factory=dict)
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    history: tuple[Step, ...] = ()
    modes: Mapping[str, CovarianceModes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("parts", "u", "coordinates", "harmonics_u"):
            object.__setattr__(self, name, _frozen(getattr(self, name), np.float64))
        object.__setattr__(self, "harmonics", _frozen(self.harmonics, np.complex128))
        for name in ("units", "audit", "modes"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name, values in self.parts.items():
            if name not in self.u or name not in self.units:
                raise DataError(f"the part {name!r} needs an uncertainty and a unit")
            if self.u[name].shape != values.shape:
                raise DataError(
                    f"the part {name!r} has the shape {values.shape}, its uncertainty "
                    f"{self.u[name].shape}"
                )

    def __getattr__(self, name: str) -> FloatArray:
        parts = {} if name.startswith("_") else object.__getattribute__(self, "parts")
        if name in parts:
            values: FloatArray = parts[name]
            return values
        known = ", ".join(parts)
        raise AttributeError(f"a Separation has no attribute {name!r}; its parts are {known}")

    def __reduce__(self) -> tuple[Any, ...]:
        return Separation.from_dict, (self.to_dict(),)

    @property
    def suppressed(self) -> list[int]:
        """Undulations per revolution that are not observable, of any part, rising."""
        return suppressed_harmonics(self.null_space)

    def covariance(self, part: str) -> FloatArray:
        """Return the covariance of a part between its positions.

        Parameters
        ----------
        part : str
            Name of the part.

        Returns
        -------
        ndarray, shape (n, n), square of the unit of the part
            Its diagonal is ``u[part]**2``; NaN where that is NaN.

        Raises
        ------
        DataError
            If the part does not exist, or only its uncertainty is known.
        """
        if part not in self.parts:
            raise DataError(f"there is no part {part!r}; there are {', '.join(self.parts)}")
        if part not in self.modes:
            raise DataError(
                f"the covariance of {part!r} is not known, only its uncertainty at each position; "
                "it is known where a reversal is made of estimates of repeated runs, and of the "
                "straightness of probes in a row"
            )
        own = self.u[part]
        x = next(v for v in self.coordinates.values() if v.shape == own.shape)
        return self.modes[part].covariance(x, own)

    def with_type_b(self, terms: Mapping[str, float], *, part: str | None = None) -> Separation:
        """Return the same parts with further standard uncertainties combined in quadrature.

        Harmonics take each term whole: all of an unknown form may lie in one of them.

        Parameters
        ----------
        terms : mapping of str to float
            Name and standard uncertainty of each term, in the unit of the part: form of the
            artefact, linearity of the sensor, index angle, temperature.
        part : str, optional
            Which part they concern; all if omitted.

        Returns
        -------
        Separation
            With larger `u`, the terms in ``audit["type_b"]``.

        Raises
        ------
        DataError
            If the part does not exist, or a term is negative or not finite.
        """
        names = list(self.parts) if part is None else [part]
        for name in names:
            if name not in self.parts:
                raise DataError(f"there is no part {name!r}; there are {', '.join(self.parts)}")
        for label, value in terms.items():
            if not (math.isfinite(value) and value >= 0.0):
                raise DataError(f"the standard uncertainty {label!r} is {value}; it must be >= 0")
        total = math.fsum(value**2 for value in terms.values())
        u = {n: np.sqrt(v**2 + total) if n in names else v for n, v in self.u.items()}
        spread = {
            n: np.sqrt(v**2 + total) if n in names else v for n, v in self.harmonics_u.items()
        }
        before = dict(self.audit.get("type_b", {}))
        for name in names:
            unit = self.units[name]
            before[name] = {
                **before.get(name, {}),
                **{f"{k} / {unit}": float(v) for k, v in terms.items()},
            }
        return replace(self, u=u, harmonics_u=spread, audit={**self.audit, "type_b": before})

    def to_frame(self) -> pd.DataFrame:
        """Return each coordinate, and after it the parts over it with their u, as columns in SI.

        Where coordinates have different lengths, the shorter columns end in NaN.

        Raises
        ------
        DataError
            If the parts are maps: take ``parts`` instead.
        """
        import pandas as pd

        columns: dict[str, FloatArray] = {}
        left = {k: v for k, v in self.parts.items() if v.ndim > 0}
        if any(v.ndim > 1 for v in left.values()):
            raise DataError("parts that are maps have no table; use .parts and .u")
        for name, positions in self.coordinates.items():
            columns[f"{name}_{_COORDINATE_UNITS.get(name, 'm')}"] = positions
            for part in [k for k, v in left.items() if v.shape == positions.shape]:
                columns[f"{part}_{self.units[part]}"] = left.pop(part)
                columns[f"u_{part}_{self.units[part]}"] = self.u[part]
        return pd.DataFrame({k: pd.Series(v) for k, v in columns.items()})

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values for JSON (NaN as None), readable by `from_dict`."""
        return {
            "method": self.method,
            "parts": {k: plain(v) for k, v in self.parts.items()},
            "u": {k: plain(v) for k, v in self.u.items()},
            "units": dict(self.units),
            "coordinates": {k: plain(v) for k, v in self.coordinates.items()},
            "null_space": [item.to_dict() for item in self.null_space],
            "noise": self.noise.to_dict(),
            "harmonics": {
                k: {"real": plain(v.real), "imag": plain(v.imag)}
                for k, v in self.harmonics.items()
            },
            "harmonics_u": {k: plain(v) for k, v in self.harmonics_u.items()},
            "audit": plain(self.audit),
            "messages": list(self.messages),
            "history": history_as_dicts(self.history),
            **(
                {"covariance": {k: m.to_dict() for k, m in self.modes.items()}}
                if self.modes
                else {}
            ),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Separation:
        """Return the separation that `to_dict` wrote.

        Parameters
        ----------
        data : mapping
            Its plain values.

        Returns
        -------
        Separation
            With the same numbers.

        Raises
        ------
        DataError
            If a key is missing or of the wrong kind.
        """
        try:
            noise = data["noise"]
            return cls(
                str(data["method"]),
                {k: _array(v) for k, v in data["parts"].items()},
                {k: _array(v) for k, v in data["u"].items()},
                data["units"],
                {k: _array(v) for k, v in data["coordinates"].items()},
                tuple(Unobservable.from_dict(item) for item in data["null_space"]),
                Quantity(
                    math.nan if noise["value"] is None else float(noise["value"]),
                    noise["unit"],
                    noise["definition"],
                    u=noise["u"],
                    symbol=noise["symbol"],
                ),
                {
                    k: _array(v["real"]) + 1j * _array(v["imag"])
                    for k, v in data["harmonics"].items()
                },
                {k: _array(v) for k, v in data["harmonics_u"].items()},
                data["audit"],
                tuple(data["messages"]),
                tuple(Step(s["step"], s["parameters"], s["version"]) for s in data["history"]),
                {k: CovarianceModes.from_dict(m) for k, m in data.get("covariance", {}).items()},
            )
        except (KeyError, TypeError, ValueError, AttributeError) as exc:
            raise DataError(
                f"this is not a stored separation ({type(exc).__name__}: {exc})"
            ) from exc

    def _rows(self) -> dict[str, str]:
        rows = {name: self._one_line(name) for name in self.parts}
        rows.update({f"not seen {i + 1}": str(item) for i, item in enumerate(self.null_space)})
        return rows

    def _one_line(self, name: str) -> str:
        """Return P-V (or the value of a single number) and the usual uncertainty of a point."""
        unit = self.units[name]
        values, of_points, _ = about_what_is_seen(self, name)
        known = values[np.isfinite(values)]
        if known.size == 0:
            return "not determined"
        u = of_points[np.isfinite(of_points)]
        of_a_point = "" if values.ndim == 0 else " of a point"
        told = "u not known"
        if u.size:
            mean = math.sqrt(float(np.mean(u**2)))
            told = f"u{of_a_point} {format_engineering(mean, unit, digits=2)}"
        if values.ndim == 0:
            return f"{format_engineering(float(values), unit)}, {told}"
        return f"P-V {format_engineering(float(np.ptp(known)), unit)}, {told}"

    def __repr__(self) -> str:
        parts = "; ".join(f"{k} {v}" for k, v in self._rows().items() if k in self.parts)
        n = len(self.null_space)
        return shortened(
            f"Separation({self.method}: {parts}; {n} null-space term{'' if n == 1 else 's'})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = self._rows()
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table(f"Separation: {self.method}", rows)


U_READING: Mapping[str, Option] = {
    "u_reading": Option("uncertainty", help="standard uncertainty of one reading")
}
"""What most methods are told of their readings, where repeats do not show it."""


class NamedMethod(Method):
    """A method of this package; it makes what the plain function of its name makes."""

    function: ClassVar[str] = ""
    """Name of the plain function, where it is not that of the method."""

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> Any:
        """Return what the plain function makes of curves, maps, results or columns by their role."""
        function = getattr(sys.modules[cls.__module__], cls.function or cls.name)
        if cls.reads == "results":
            if cls.readings and len(data.items) != 2:
                both = " and ".join(cls.readings)
                raise DataError(f"two results are needed, {both}; got {len(data.items)}")
            return function(*data.items, **options)
        if cls.reads == "maps":
            maps = tuple(data)
            return function(*maps, **options) if cls.readings else function(list(maps), **options)
        if cls.reads == "table":
            needed = [data.values[role] for role, kind in cls.roles.items() if "?" not in kind]
            further = {r: v for r, v in data.values.items() if "?" in cls.roles.get(r, "")}
            return function(*needed, **further, **options)
        place = {} if cls.over == "any" else {cls.over: data.position}
        if cls.over == "angle":
            over_turn(data)
        values = data.values if cls.readings else [as_rows(data.values)]
        return function(*values, **place, **options)


def over_turn(data: Readings) -> None:
    """Refuse readings that do not lie at equal angles over one revolution."""
    if data.position is None:
        raise FormatMismatchError(
            'the angle of each sample is needed: name its column, angle = "angle_deg"'
        )
    require_turn(data.position)


def over_line(data: Readings) -> FloatArray:
    """Return the positions of readings, which must be there."""
    if data.position is None:
        raise FormatMismatchError('positions are needed: name their column, x = "x_mm"')
    return data.position


def as_rows(values: Any) -> Any:
    """Return readings without the axis of repeats where there is one repeat only."""
    return values[:, 0] if values.shape[1] == 1 else values


class SeparationMethod(NamedMethod, ABC):
    """A way to separate readings of one set-up; frozen dataclasses implement it."""

    truth_parts: ClassVar[tuple[str, ...]]
    """Parts that belong to what is measured: artefact, part, surface."""

    error_parts: ClassVar[tuple[str, ...]]
    """Parts that belong to the machine or the instrument."""

    @abstractmethod
    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        """Return the noise-free readings that given parts produce.

        Parameters
        ----------
        truth : mapping of str to array_like
            `truth_parts`; a missing one is zero.
        errors : mapping of str to array_like
            `error_parts`; a missing one is zero.

        Returns
        -------
        ndarray, shape (n_readings, ...)
            First axis: the set-ups or sensors, in the order that `separate` expects.

        Raises
        ------
        DataError
            If a part is unknown, or neither truth nor errors are given.
        """

    @abstractmethod
    def separate(self, readings: ArrayLike, *, u_reading: float | None = None) -> Separation:
        """Return the parts that readings consist of.

        Parameters
        ----------
        readings : array_like, shape (n_readings, ...)
            As `simulate` returns them; NaN = not measured.
        u_reading : float, optional
            Standard uncertainty of one reading, for methods without redundancy.

        Returns
        -------
        Separation
            Parts, uncertainties, null space, audit.

        Raises
        ------
        DataError
            If the readings cannot be used.
        """

    @abstractmethod
    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what this set-up cannot see; empty where everything is determined."""

    def correct(self, readings: ArrayLike) -> FloatArray:
        """Return the readings without the machine's share, as far as it is determined.

        Parameters
        ----------
        readings : array_like, shape (n_readings, ...)
            As for `separate`, with its repeats.

        Returns
        -------
        ndarray, of the shape of the readings
            Readings minus what the separated machine errors would read, which is the same for
            every repeat.

        Raises
        ------
        DataError
            If the readings cannot be used.
        """
        found = self.separate(readings)
        array = as_float(readings)
        errors = {name: found.parts[name] for name in self.error_parts if name in found.parts}
        return array - self._like_readings(self.simulate({}, errors), array)

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return what `simulate` gives so that it broadcasts to readings with their repeats."""
        return model[:, None] if readings.ndim == model.ndim + 1 else model


def _array(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64)


# ---- `Unobservable`: what a separation cannot see, as data that every result carries -----------
# Each method has a null space: changes of artefact and machine that leave all its readings as they
# are. No evaluation can recover them, so they are named here and set NaN, never filled.

Kind = Literal["harmonic", "angular order", "polynomial", "term", "wavelength", "samples"]


@dataclass(frozen=True, slots=True)
class Unobservable:
    """One share of a part that the readings do not determine.

    Parameters
    ----------
    part : str
        Which part of the result it concerns, such as ``"artefact"``.
    kind : {"harmonic", "angular order", "polynomial", "term", "wavelength", "samples"}
        What `indices` counts: undulations per revolution, orders of a map about its centre,
        degrees of a polynomial, named terms, wavelengths in m, or samples.
    indices : tuple of (int, float or str)
        Which ones.
    reason : str
        Why, in plain words, and what would make them observable.
    as_it_lies : bool, optional
        Whether the part holds whatever of it the set-up happened to have, such as the line along which
        an artefact was put down; its extremes are then taken without it. Else it is defined, or NaN.

    Examples
    --------
    >>> Unobservable("artefact", "harmonic", (7, 9), "these probe angles sum to zero there")
    Unobservable(part='artefact', kind='harmonic', indices=(7, 9), reason='these probe ...')
    """

    part: str
    kind: Kind
    indices: tuple[int | float | str, ...]
    reason: str
    as_it_lies: bool = field(default=False, repr=False)

    def __str__(self) -> str:
        shown = ", ".join(_named(i, self.kind) for i in self.indices[:12])
        more = f", ... ({len(self.indices)} in all)" if len(self.indices) > 12 else ""
        plural = self.kind + ("s" if len(self.indices) > 1 and self.kind != "samples" else "")
        return f"{self.part}: {plural} {shown}{more} not observable: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: ``part``, ``kind``, ``indices``, ``reason``, ``as_it_lies`` where it is."""
        found = {**asdict(self), "indices": list(self.indices)}
        return found if self.as_it_lies else {k: found[k] for k in found if k != "as_it_lies"}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Unobservable:
        """Return what `to_dict` wrote.

        Parameters
        ----------
        data : mapping
            Its keys.
        """
        lies = bool(data.get("as_it_lies", False))
        return cls(data["part"], data["kind"], tuple(data["indices"]), data["reason"], lies)


def about_what_is_seen(
    found: Separation, name: str
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Return a part, its u and perhaps its covariance; a curve as it lies less what nobody sees of it.

    With R what takes the polynomial off, the covariance is ``R C R^T``.
    """
    values, u = found.parts[name], found.u[name]
    unseen = [i.indices for i in found.null_space if i.part == name and i.as_it_lies]
    degree = max((int(k) for indices in unseen for k in indices), default=-1)
    known = np.isfinite(values)
    if degree < 0 or known.sum() <= degree + 1:
        return values, u, None
    x = next(v for v in found.coordinates.values() if v.shape == values.shape)[known]
    t = (2.0 * x - x[0] - x[-1]) / (x[-1] - x[0])
    Q = np.linalg.qr(np.polynomial.legendre.legvander(t, degree))[0]

    def rest(columns: FloatArray) -> FloatArray:
        return np.asarray(columns - Q @ (Q.T @ columns))

    about = values.copy()
    about[known] = rest(values[known])
    if name not in found.modes:
        return about, u, None
    whole, at = np.full((values.size,) * 2, math.nan), np.ix_(known, known)
    whole[at] = rest(rest(found.covariance(name)[at]).T)
    return about, np.sqrt(np.maximum(np.diag(whole), 0.0)), whole


def suppressed_harmonics(null_space: Iterable[Unobservable], part: str | None = None) -> list[int]:
    """Return the undulations per revolution that are not observable.

    Parameters
    ----------
    null_space : iterable of Unobservable
        Of a result.
    part : str, optional
        Of one part only; of any part if omitted.

    Returns
    -------
    list of int
        Rising, without doubles.
    """
    found = {
        int(i)
        for item in null_space
        if item.kind == "harmonic" and part in (None, item.part)
        for i in item.indices
    }
    return sorted(found)


def _named(index: int | float | str, kind: str) -> str:
    if kind == "wavelength" and not isinstance(index, str):
        return format_length(float(index))
    return f"{index:.6g}" if isinstance(index, float) else str(index)


# ---- what method classes and the functions that call them share: the contract, docstrings, settings


class RecordedMethod(SeparationMethod):
    """A method whose results carry the history of the readings."""

    @property
    def _dimension(self) -> str | None:
        """What the readings are; None for units that have no name of their own here."""
        return self.dimension

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        """Return the parts of readings, with the checked uncertainty; or `separate` is overridden."""
        raise NotImplementedError

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: History = (),
    ) -> Separation:
        """Return the parts that readings consist of.

        Parameters
        ----------
        readings : array_like
            As `simulate` returns them, or with the repeats as a second axis; NaN = not measured.
        u_reading : float, optional
            Standard uncertainty of one reading; the scatter of the repeats, or of what is
            redundant, if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts, uncertainties, null space, audit.

        Raises
        ------
        InvalidSamplesError
            If the readings are not numbers, infinite, or of another shape.
        TooFewSamplesError
            If too few samples were measured.
        NotSeparableError
            If what was measured in the set-ups does not overlap.
        DataError
            If `u_reading` is negative or no number, or the readings look like another unit.
        """
        stated = u_reading
        if stated is not None:
            stated = not_negative(stated, "u_reading", dimension=self._dimension)
        return self._solved(readings, stated, history)


class StoredResult(PublicObject):
    """A result of fields: read-only, and it can be copied and stored as plain values."""

    __slots__ = ()
    _stored: ClassVar[tuple[str, ...]] = ()  # what `to_dict` holds; all fields if empty

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):  # type: ignore[arg-type]
            value = getattr(self, name)
            if isinstance(value, dict):
                object.__setattr__(self, name, freeze_mapping(value))

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None: arrays as lists, large tables omitted."""
        names = self._stored or [f.name for f in fields(self)]  # type: ignore[arg-type]
        return {name: _plain(getattr(self, name)) for name in names}


def _plain(value: Any) -> Any:
    """Return plain values of anything; a result that is a mapping, too, says them itself."""
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return plain(value)


def type_a(value: float, unit: str, text: str, freedom: float) -> Quantity:
    """Return a standard deviation that was found, with its own uncertainty from the freedom."""
    return Quantity(value, unit, text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def as_stated(value: float, unit: str, of: str = "reading") -> Quantity:
    """Return a standard uncertainty of one reading that was stated."""
    return Quantity(value, unit, f"standard uncertainty of one {of}, as stated", symbol="s")


def not_known(unit: str, of: str = "reading") -> Quantity:
    """Return the noise of one reading where nothing shows it: NaN."""
    return Quantity(math.nan, unit, f"standard deviation of one {of}; not known", symbol="s")


def pooled(
    squares: float,
    freedom: float,
    stated: float | None,
    text: str,
    unit: str = "m",
    of: str = "reading",
) -> Quantity:
    """Return the noise of one reading: as stated, pooled from the squares left, or not known."""
    if stated is not None:
        return as_stated(stated, unit, of)
    if freedom < 1.0:
        return not_known(unit, of)
    return type_a(math.sqrt(squares / freedom), unit, text, freedom)


def settle(method: object, /, **values: Any) -> None:
    """Set checked values on the fields of a frozen dataclass."""
    for name, value in values.items():
        object.__setattr__(method, name, value)

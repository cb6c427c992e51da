"""What method classes and the functions that call them share: the contract, docstrings, settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from metrosep.core.numbers import not_negative
from metrosep.core.provenance import freeze_mapping
from metrosep.core.public import PublicObject
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import plain, reduced
from metrosep.separation.contract import History, Separation, SeparationMethod


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

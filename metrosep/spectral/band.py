"""`Band`: the wavelengths between two limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

from metrosep.core.errors import DataError
from metrosep.core.units import format_length
from metrosep.spectral._checks import real_number

__all__ = ["Band"]


@dataclass(frozen=True, slots=True)
class Band:
    """Wavelengths ``shortest <= wavelength <= longest``; an open side is None.

    Parameters
    ----------
    shortest, longest : float or None, optional, m
        Limits, positive and finite, in this order.

    Raises
    ------
    DataError
        If a limit is not positive and finite, or they are not in order.

    Examples
    --------
    >>> Band(2.5e-6, 0.8e-3)
    Band(2.5 um ... 800 um)
    >>> Band(shortest=2.5e-6)
    Band(2.5 um ... )
    """

    shortest: float | None = None
    longest: float | None = None

    def __post_init__(self) -> None:
        for name in ("shortest", "longest"):
            value = getattr(self, name)
            if value is None:
                continue
            number = real_number(value, f"the {name} wavelength of a band")
            if not (math.isfinite(number) and number > 0.0):
                raise DataError(
                    f"the {name} wavelength of a band must be positive and finite, got {value} m"
                )
            object.__setattr__(self, name, number)
        if (
            self.shortest is not None
            and self.longest is not None
            and not self.shortest < self.longest
        ):
            raise DataError(
                f"a band runs from its shortest to its longest wavelength, got "
                f"{format_length(self.shortest)} to {format_length(self.longest)}"
            )

    def __repr__(self) -> str:
        low, high = ("" if v is None else format_length(v) for v in (self.shortest, self.longest))
        return f"Band({low} ... {high})"

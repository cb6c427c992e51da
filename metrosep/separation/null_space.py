"""`Unobservable`: what a separation cannot see, as data that every result carries.

Each method has a null space: changes of artefact and machine that leave all its readings as they
are. No evaluation can recover them, so they are named here and set NaN, never filled.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from metrosep.core.units import format_length

__all__ = ["Unobservable", "suppressed_harmonics"]

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

    Examples
    --------
    >>> Unobservable("artefact", "harmonic", (7, 9), "these probe angles sum to zero there")
    Unobservable(part='artefact', kind='harmonic', indices=(7, 9), reason='these probe ...')
    """

    part: str
    kind: Kind
    indices: tuple[int | float | str, ...]
    reason: str

    def __str__(self) -> str:
        shown = ", ".join(_named(i, self.kind) for i in self.indices[:12])
        more = f", ... ({len(self.indices)} in all)" if len(self.indices) > 12 else ""
        plural = self.kind + ("s" if len(self.indices) > 1 and self.kind != "samples" else "")
        return f"{self.part}: {plural} {shown}{more} not observable: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON.

        Returns
        -------
        dict
            Keys ``part``, ``kind``, ``indices``, ``reason``.
        """
        return {
            "part": self.part,
            "kind": self.kind,
            "indices": list(self.indices),
            "reason": self.reason,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Unobservable:
        """Return what `to_dict` wrote.

        Parameters
        ----------
        data : mapping
            Its keys.

        Returns
        -------
        Unobservable
            Equal to the one that was written.
        """
        return cls(data["part"], data["kind"], tuple(data["indices"]), data["reason"])


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

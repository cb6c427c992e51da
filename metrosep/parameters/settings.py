"""Default settings: setting classes of ISO 21920-3:2021 and the cutoff rule of ISO 4288:1996.

ISO 21920-3 takes cutoff, section and evaluation length, S filter, step and tip from the tolerance
limit on the drawing. ISO 4288 took the cutoff from the measured value, by iteration. Lengths in m.
Entries are recalled except where `SettingClass.read` names them; check against a bought copy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from metrosep.core.errors import DataError, NotConvergedError
from metrosep.core.units import format_length
from metrosep.spectral._checks import real_number

__all__ = ["SETTING_CLASSES", "SettingClass", "setting_class", "settle_cutoff", "suggested_cutoff"]

_ROUNDING = 1e-9
"""Relative; a limit of 2 um given as 2.0000000000000002e-6 is still 2 um."""


@dataclass(frozen=True, slots=True)
class SettingClass:
    """A setting class of ISO 21920-3.

    Parameters
    ----------
    name : str
        "Sc1" to "Sc5".
    Ra_max, Rz_max : float, m
        Largest tolerance limit of the class; infinite for Sc5.
    nic : float, m
        Cutoff of the L (lambda c) filter, and section length.
    le : float, m
        Evaluation length.
    nis : float, m
        Cutoff of the S (lambda s) filter.
    max_dx : float, m
        Largest step.
    tip_radius : float, m
        Nominal radius of the stylus tip.
    sections : int
        Section lengths in the evaluation length.
    read : tuple of str
        Fields that were read in a public source; the others are recalled.
    """

    name: str
    Ra_max: float
    Rz_max: float
    nic: float
    le: float
    nis: float
    max_dx: float
    tip_radius: float
    sections: int = 5
    read: tuple[str, ...] = ("Ra_max", "Rz_max", "nis", "tip_radius")


SETTING_CLASSES = (
    SettingClass("Sc1", 0.02e-6, 0.16e-6, 0.08e-3, 0.4e-3, 2.5e-6, 0.5e-6, 2e-6),
    SettingClass("Sc2", 0.1e-6, 0.8e-6, 0.25e-3, 1.25e-3, 2.5e-6, 0.5e-6, 2e-6),
    SettingClass("Sc3", 2e-6, 16e-6, 0.8e-3, 4e-3, 2.5e-6, 0.5e-6, 2e-6),
    SettingClass("Sc4", 10e-6, 80e-6, 2.5e-3, 12.5e-3, 8e-6, 1.5e-6, 5e-6),
    SettingClass("Sc5", math.inf, math.inf, 8e-3, 40e-3, 25e-6, 5e-6, 10e-6),
)
"""The classes, finest first."""

_CUTOFFS_4288: dict[str, tuple[tuple[float, float], ...]] = {
    "Ra": ((0.02e-6, 0.08e-3), (0.1e-6, 0.25e-3), (2e-6, 0.8e-3), (10e-6, 2.5e-3), (80e-6, 8e-3)),
    "Rz": ((0.1e-6, 0.08e-3), (0.5e-6, 0.25e-3), (10e-6, 0.8e-3), (50e-6, 2.5e-3), (200e-6, 8e-3)),
    "RSm": (
        (0.04e-3, 0.08e-3),
        (0.13e-3, 0.25e-3),
        (0.4e-3, 0.8e-3),
        (1.3e-3, 2.5e-3),
        (4e-3, 8e-3),
    ),
}
"""ISO 4288:1996, tables 1 to 3 (recalled): largest measured value and its cutoff."""


def setting_class(*, Ra: float | None = None, Rz: float | None = None) -> SettingClass:
    """Return the setting class for a tolerance limit.

    Parameters
    ----------
    Ra, Rz : float, m, > 0, optional
        Upper tolerance limit of exactly one of them, from the drawing and not from a measurement.

    Returns
    -------
    SettingClass
        The finest class whose limit is not exceeded.

    Raises
    ------
    DataError
        If none or both are given, or the limit is not finite and positive.

    References
    ----------
    .. [1] ISO 21920-3:2021, default settings (limits, nis and tip read in public sources, the rest
       recalled).

    Examples
    --------
    >>> found = setting_class(Ra=5e-9)
    >>> found.name, found.nic, found.le
    ('Sc1', 8e-05, 0.0004)
    """
    if (Ra is None) == (Rz is None):
        raise DataError("give the tolerance limit of one parameter, Ra or Rz")
    limit = _positive("Ra" if Rz is None else "Rz", Ra if Rz is None else Rz)
    for found in SETTING_CLASSES[:-1]:
        largest = found.Ra_max if Rz is None else found.Rz_max
        if limit <= largest * (1.0 + _ROUNDING):
            return found
    return SETTING_CLASSES[-1]


def suggested_cutoff(symbol: Literal["Ra", "Rz", "RSm"], value: float) -> float:
    """Return the cutoff that ISO 4288:1996 asks for at a measured value.

    Parameters
    ----------
    symbol : {"Ra", "Rz", "RSm"}
        "RSm" for periodic profiles, else "Ra" or "Rz".
    value : float, m, > 0
        What was measured with some cutoff.

    Returns
    -------
    float
        Cutoff and sampling length, m. Where it is not the one that was used, filter with it and
        measure again until it is; the standard then also tries the next shorter one.

    Raises
    ------
    DataError
        If the symbol is unknown, the value is not finite and positive, or no cutoff covers it.

    References
    ----------
    .. [1] ISO 4288:1996, tables 1 to 3 and clause 7.2 (recalled).

    Examples
    --------
    >>> suggested_cutoff("Rz", 18.5e-6)
    0.0025
    """
    table = _CUTOFFS_4288.get(symbol)
    if table is None:
        raise DataError(f"the cutoff follows from {', '.join(_CUTOFFS_4288)}, got {symbol!r}")
    measured = _positive(symbol, value)
    for largest, cutoff in table:
        if measured <= largest * (1.0 + _ROUNDING):
            return cutoff
    raise DataError(
        f"{symbol} = {format_length(measured)} is above {format_length(table[-1][0])}, the last "
        "entry of ISO 4288; choose the cutoff yourself and state it"
    )


def settle_cutoff(
    symbol: Literal["Ra", "Rz", "RSm"], measure: Callable[[float], float], *, start: float = 0.8e-3
) -> float:
    """Return the cutoff that agrees with the value measured with it, after ISO 4288:1996.

    Parameters
    ----------
    symbol : {"Ra", "Rz", "RSm"}
        "RSm" for periodic profiles, else "Ra" or "Rz".
    measure : callable
        Takes a cutoff in m, filters with it, returns the parameter in m.
    start : float, m, optional
        First cutoff: 0.08, 0.25, 0.8, 2.5 or 8 mm.

    Returns
    -------
    float
        Cutoff in m.

    Raises
    ------
    DataError
        If an argument is unknown, or a measured value is not covered.
    NotConvergedError
        If two cutoffs each ask for another one: the standard has no answer then.

    Notes
    -----
    For a non-periodic profile the standard then tries the next shorter cutoff once; do that with
    `suggested_cutoff` where it matters.

    References
    ----------
    .. [1] ISO 4288:1996, clause 7.2 (recalled).

    Examples
    --------
    >>> settle_cutoff("Ra", lambda cutoff: 3e-6 if cutoff > 1e-3 else 2.5e-6)
    0.0025
    """
    _positive("start", start)
    if symbol not in _CUTOFFS_4288:
        suggested_cutoff(symbol, start)  # says which symbols there are
    cutoffs = [c for _, c in _CUTOFFS_4288[symbol]]
    cutoff = min(cutoffs, key=lambda c: abs(c - start))
    if abs(cutoff - start) > _ROUNDING * start:
        known = ", ".join(format_length(c) for c in cutoffs)
        raise DataError(f"start must be one of {known}, got {format_length(start)}")
    tried: list[float] = []
    while cutoff not in tried:
        tried.append(cutoff)
        cutoff = suggested_cutoff(symbol, measure(cutoff))
        if cutoff == tried[-1]:
            return cutoff
    raise NotConvergedError(
        f"the cutoffs {', '.join(format_length(c) for c in (*tried, cutoff))} ask for each other; "
        "take the cutoff from the drawing (ISO 21920-3) or state your own"
    )


def _positive(name: str, value: float | None) -> float:
    number = real_number(value, name, "finite and positive, in m")
    if not (math.isfinite(number) and number > 0.0):
        raise DataError(f"{name} must be finite and positive, in m, got {value}")
    return number

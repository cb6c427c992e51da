"""What is asked of probes in a row: probes, estimator, zero; numbers as callers give them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import DataError
from metrosep.separation._line_probes import Row

METHODS = ("sequential", "generalised", "combined", "least_squares")

_SPELLINGS = {
    "generalized": "generalised",
    "least-squares": "least_squares",
    "ls": "least_squares",
}


@dataclass(frozen=True, slots=True)
class Zero:
    """A known zero difference of three probes and its standard uncertainty, m."""

    value: float
    u: float


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be evaluated and how."""

    name: str  # of the method, for messages
    row: Row  # probes
    method: str  # estimator
    smoothing: float  # weight of the penalty of the generalised estimator
    zero: Zero | None = None  # known zero difference


def number(value: Any, name: str, unit: str = "m") -> float:
    """Return one number, or refuse what is none."""
    try:
        return float(value) if not isinstance(value, (str, bytes)) else float("none")
    except (TypeError, ValueError):
        raise DataError(f"{name} must be one number in {unit}, got {value!r}") from None


def method_named(name: Any, known: tuple[str, ...], what: str) -> str:
    """Return the name of an estimator, spelt in one way."""
    word = name.lower() if isinstance(name, str) else ""
    word = _SPELLINGS.get(word, word)
    if word not in known:
        raise DataError(f"{what} has no method {name!r}; it has {', '.join(known)}")
    return word


def checked_smoothing(value: Any, what: str) -> float:
    """Return the weight of the penalty, or refuse it."""
    weight = number(value, f"{what}: smoothing", "1")
    if not 0.0 < weight < float("inf"):
        raise DataError(f"{what}: smoothing is {value}; it must be above zero")
    return weight

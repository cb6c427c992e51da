"""Polynomials in Horner form as text, and what the text computes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["UNSIGNED", "Printed", "horner", "parsed_horner"]


UNSIGNED = r"\d{1,300}(?:\.\d{1,300})?"
"""Decimals without sign and exponent."""


@dataclass(frozen=True, slots=True)
class Printed:
    """A polynomial as its text has it."""

    coefficients: FloatArray  # shape (degree + 1,): of 1, x, x^2 ... in the units of the text
    low: float  # where the position is held, in the unit of x
    high: float

    @property
    def largest_term(self) -> float:
        """Largest absolute term at the farther end of the range, in the unit of y; inf if too large."""
        far = max(abs(self.low), abs(self.high))
        with np.errstate(over="ignore", invalid="ignore"):
            terms = np.abs(self.coefficients) * far ** np.arange(self.coefficients.size)
        terms = np.where(self.coefficients == 0.0, 0.0, terms)  # 0 times inf
        return float(terms.max())

    def at(self, x: FloatArray) -> FloatArray:
        """Return the value at positions, as the text computes it."""
        held = np.clip(x, self.low, self.high)
        y = np.full(held.shape, self.coefficients[-1])
        for c in self.coefficients[-2::-1]:
            y = c + held * y
        return np.asarray(y)


def horner(numbers: Sequence[str], x: str) -> str:
    """Return a polynomial in Horner form without a minus in front of a coefficient.

    Examples
    --------
    >>> horner(["0.5", "-2", "3"], "x")
    '0.5-x*(2-x*(3))'
    """
    text, sign = numbers[0], "+"
    for number in numbers[1:]:
        wanted = "-" if number.startswith("-") else "+"
        text += f"{'+' if wanted == sign else '-'}{x}*({number.lstrip('-')}"
        sign = wanted
    return text + ")" * (len(numbers) - 1)


def parsed_horner(text: str, x: str) -> FloatArray | None:
    """Return the coefficients of a Horner form, None if it is none.

    Examples
    --------
    >>> parsed_horner("0.5-x*(2-x*(3))", "x").tolist()
    [0.5, -2.0, 3.0]
    """
    first = re.match(rf"-?{UNSIGNED}", text)
    if first is None:
        return None
    found, sign, at = [float(first[0])], 1.0, first.end()
    term = re.compile(rf"([+-]){re.escape(x)}\*\(({UNSIGNED})")
    while (match := term.match(text, at)) is not None:
        sign = -sign if match[1] == "-" else sign
        found.append(sign * float(match[2]))
        at = match.end()
    return np.array(found) if text[at:] == ")" * (len(found) - 1) else None

"""What record 2 of an ``.smd`` software gauge states: expected values and cut-offs.

Lines ``PARAMETER_VALUE symbol value unit uncertainty`` and ``PROFILE_FILTER Gaussian LS 2.5 um LC
0.8 mm``; several of the latter add up. The word after the value is the unit where it is no number
or exactly ``1``; any other number there is the uncertainty of a pure number. What stands between
``/*`` and ``*/`` is a comment.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from difflib import get_close_matches

from metrosep.core.errors import DataError, UnitError
from metrosep.core.units import parse_unit

__all__ = ["Expectation", "GaugeSettings", "expectations"]

_SYMBOL = re.compile(r"[A-Za-z][\w()]*")
_LENGTH = r"([-+.\dEe]+)\s*([^\s\d.]\w*)"
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_VALUE, _FILTER = "PARAMETER_VALUE", "PROFILE_FILTER"
_CUTOFFS = ("LC", "LS")
_PURE = {"1": 1.0, "-": 1.0, "none": 1.0, "%": 0.01}

_ALIKE = 0.8
"""Similarity (`difflib`) from which another keyword is told as a slip: three letters of fifteen."""

_LARGEST = 30
"""Powers of ten that a value may have: more is none."""

_SAME = 1e-9
"""Relative difference up to which two cut-offs are one: 0.8 mm and 800 um."""


@dataclass(frozen=True, slots=True)
class Expectation:
    """A value that a software gauge expects.

    Parameters
    ----------
    symbol : str
        Such as ``"Ra"``.
    value : float
        In SI.
    half_digit : float
        Half of the last printed digit, in SI.
    u : float or None
        Uncertainty as printed, in SI; None where it is not given or zero.
    printed : str
        Value and unit as the file has them.
    dimension : str, optional
        Of the unit: ``"length"``, ``"number"``, ``"angle"``, ...; empty where it is not known.
    problem : str, optional
        Why it cannot be compared, such as a unit that is not known.
    """

    symbol: str
    value: float
    half_digit: float
    u: float | None
    printed: str
    dimension: str = ""
    problem: str = ""

    @property
    def is_placeholder(self) -> bool:
        """Whether it is a zero that states nothing: a length, or without decimals."""
        exponent = int(Decimal(self.printed.partition(" ")[0]).as_tuple().exponent)
        return self.value == 0.0 and (self.dimension != "number" or exponent >= 0)


@dataclass(frozen=True, slots=True)
class GaugeSettings:
    """What the file says about the evaluation."""

    lambda_c: float | None = None  # m: cut-offs; None where they are not given
    lambda_s: float | None = None
    # sentences on lines that seem to state a value or a filter and were not taken: a keyword with
    # a slip, a value within a comment
    unread: tuple[str, ...] = ()


def expectations(lines: Iterable[str]) -> tuple[tuple[Expectation, ...], GaugeSettings]:
    """Return the expected values and settings that record 2 of an ``.smd`` file states.

    Examples
    --------
    >>> expected, _ = expectations(["PARAMETER_VALUE Ra 0.4213 um 0.0002"])
    >>> round(expected[0].value, 10), round(expected[0].u, 11)
    (4.213e-07, 2e-10)
    """
    found: list[Expectation] = []
    filters: list[str] = []
    unread: list[str] = []
    whole = "\n".join(lines)
    # a comment leaves its line ends, so that each line keeps its place
    outside = _COMMENT.sub(lambda c: "\n" * c.group().count("\n"), whole)
    for raw, plain in zip(whole.split("\n"), outside.split("\n"), strict=True):
        text = plain.strip()
        keyword = _keyword(text)
        if keyword == _VALUE:
            found.append(_expectation(text))
        elif keyword == _FILTER:
            filters.append(text)
        elif (meant := _meant(text)) and _states(text, meant):
            unread.append(f"the line {text!r} was not taken: write {meant} if that is meant")
        elif _keyword(raw) == _VALUE:
            unread.append(f"the line {raw.strip()!r} stands in a comment and was not compared")
    symbols = [e.symbol for e in found]
    twice = sorted({s for s in symbols if symbols.count(s) > 1})
    if twice:
        raise DataError(f"the file expects two values of {', '.join(twice)}; keep one of them")
    cutoffs = _cutoffs(filters)
    return tuple(found), GaugeSettings(cutoffs.get("LC"), cutoffs.get("LS"), tuple(unread))


def _keyword(text: str) -> str:
    return text.upper().split()[0] if text.strip() else ""


def _meant(text: str) -> str:
    """Return the keyword that the first words of a line seem to be a slip of."""
    words = text.upper().split()
    for word in (*words[:1], "_".join(words[:2])):
        if close := get_close_matches(word, (_VALUE, _FILTER), 1, _ALIKE):
            return close[0]
    return ""


def _states(text: str, meant: str) -> bool:
    """Whether a line states something behind its first words; a heading does not."""
    words = text.upper().split()
    if meant == _FILTER:
        return any(word.startswith(tuple(_CUTOFFS)) for word in words[1:])
    return any(_is_number(word) for word in words[1:4])


def _expectation(text: str) -> Expectation:
    words = text.split()[1:]
    if len(words) < 2 or _SYMBOL.fullmatch(words[0]) is None:
        raise DataError(f"expected PARAMETER_VALUE symbol value unit uncertainty, found {text!r}")
    symbol, number, rest = words[0], words[1], words[2:]
    try:
        printed = Decimal(number)
    except InvalidOperation:
        raise DataError(f"the value in {text!r} is no number") from None
    if not printed.is_finite() or printed.adjusted() > _LARGEST:
        raise DataError(f"the value in {text!r} is not finite")
    # "Psk 0.0888 1" states the unit of a pure number, "Psk 0.0888 0.01" its uncertainty
    stated = rest.pop(0) if rest and (rest[0] == "1" or not _is_number(rest[0])) else ""
    if len(rest) > 1:
        raise DataError(f"expected PARAMETER_VALUE symbol value unit uncertainty, found {text!r}")
    try:
        factor, dimension = _unit(stated or "1", text)
        problem = ""
    except DataError as error:  # of this value, not of the others
        factor, dimension, problem = 1.0, "", str(error)
    u = _uncertainty(rest[0], text) * factor if rest else 0.0
    half = 0.5 * 10.0 ** int(printed.as_tuple().exponent)
    return Expectation(
        symbol=symbol,
        value=float(printed) * factor,
        half_digit=half * factor,
        u=u or None,
        printed=f"{number} {stated}".strip(),
        dimension=dimension,
        problem=problem,
    )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _uncertainty(word: str, text: str) -> float:
    u = float(word) if _is_number(word) else math.nan
    if not math.isfinite(u):
        raise DataError(f"the uncertainty {word!r} in {text!r} is no finite number")
    if u < 0.0:
        raise DataError(f"the uncertainty {word!r} in {text!r} is negative: it must be 0 or more")
    return u


def _unit(unit: str, text: str) -> tuple[float, str]:
    """Return factor to SI and dimension of a unit."""
    if unit.lower() in _PURE:
        return _PURE[unit.lower()], "number"
    try:
        found = parse_unit(unit)
    except UnitError as error:
        raise DataError(f"the unit in {text!r} is not known: {error}") from None
    return found.factor, found.dimension


def _cutoff(number: str, unit: str, text: str) -> float:
    factor, dimension = _unit(unit, text)
    if not _is_number(number) or dimension != "length":
        raise DataError(f"the cut-off {number} {unit} in {text!r} is no length")
    cutoff = float(number) * factor
    if not 0.0 < cutoff < math.inf:
        raise DataError(f"the cut-off {number} {unit} in {text!r} is not positive and finite")
    return cutoff


def _cutoffs(lines: Iterable[str]) -> dict[str, float]:
    """Return the cut-offs of all filter lines, in m."""
    found: dict[str, tuple[float, str]] = {}
    for text in lines:
        words = text.split(maxsplit=2)
        if len(words) > 1 and "gauss" not in words[1].lower():
            raise DataError(f"the file asks for the filter {words[1]}; only Gaussian is defined")
        for key, value in _stated(words[2] if len(words) > 2 else "", text):
            before, where = found.setdefault(key, (value, text))
            if not math.isclose(before, value, rel_tol=_SAME):
                raise DataError(
                    f"the file states two cut-offs {key}: {where!r} and {text!r}; keep one of them"
                )
    return {key: value for key, (value, _) in found.items()}


def _stated(rest: str, text: str) -> Iterator[tuple[str, float]]:
    """Yield the cut-offs that stand behind the name of a filter."""
    for key in _CUTOFFS:
        for place in re.finditer(rf"\b{key}(?![A-Za-z_])\s*=?\s*", rest, re.IGNORECASE):
            if re.match(r"(none|off)\b", rest[place.end() :], re.IGNORECASE):
                continue
            part = re.match(_LENGTH, rest[place.end() :])
            if part is None:
                raise DataError(f"the cut-off {key} in {text!r} has no number with a unit")
            yield key, _cutoff(part[1], part[2], text)

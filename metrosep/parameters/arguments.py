"""Parameters with arguments, as they are written in names: ``Rmr(0.5 um)``, ``Sdc(20 %, 80 %)``.

One grammar for profiles, maps, recipes, checks and Monte Carlo. A length needs its unit; a ratio is
a percentage or a number from 0 to 1. Ratios count the samples at or above a height; heights are
those of the profile or map itself, 0 at the mean line (profiles) or at the mean of the map.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import DataError
from metrosep.core.readable import near_words
from metrosep.core.units import format_length, parse_quantity

_CALL = re.compile(r"\s*([A-Za-z]\w*)\s*\((.*)\)\s*", re.DOTALL)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_COMMA = re.compile(r"\d+,\d+(?:[eE][-+]?\d+)?\s*[^\W\d]\w*")
"""One length with a decimal comma, or a ratio and a length: 0,5 um."""
_DIGITS = 12


@dataclass(frozen=True, slots=True)
class Function:
    """A parameter with arguments; `evaluate` takes what the parameters share, and the arguments."""

    symbol: str  # of a profile without its kind
    takes: tuple[str, ...]  # "ratio" or "length"
    unit: str
    text: str  # with {0}, {1} for the arguments
    evaluate: Callable[..., float]


@dataclass(frozen=True, slots=True)
class Call:
    """A function with its arguments in SI."""

    name: str  # in the one spelling
    function: Function
    arguments: tuple[float, ...]

    @property
    def text(self) -> str:
        return self.function.text.format(*_written(self.function.takes, self.arguments))

    def value(self, work: Any) -> float:
        return float(self.function.evaluate(work, *self.arguments))


_RATIO = "material ratio at the height {0}: share of samples at or above it"
_BELOW = "material ratio {1} below the height of the ratio {0}"
_DIFFERENCE = "height between the material ratios {0} and {1}"
_MATERIAL = "material volume above the height of the ratio {0}, per unit of area"
_VOID = "void volume below the height of the ratio {0}, per unit of area"


def _ratio_below(work: Any, p: float, dc: float) -> float:
    return float(work.curve.ratio(work.curve.height(p) - dc))


def _from_peak(work: Any, p: float) -> float:
    return float(work.curve.height(p) - work.curve.heights[0])


PROFILE = (
    Function("mr", ("length",), "1", _RATIO, lambda w, c: w.curve.ratio(c)),
    Function("mr", ("ratio", "length"), "1", _BELOW, _ratio_below),
    Function("mc", ("length",), "1", _RATIO, lambda w, c: w.curve.ratio(c)),
    Function("cm", ("ratio",), "m", "height at the ratio {0}, from the highest peak", _from_peak),
    Function(
        "dc", ("ratio", "ratio"), "m", _DIFFERENCE, lambda w, p, q: w.curve.height_difference(p, q)
    ),
    Function("vm", ("ratio",), "m", _MATERIAL, lambda w, p: w.curve.material_volume(p)),
    Function("vv", ("ratio",), "m", _VOID, lambda w, p: w.curve.void_volume(p)),
)
"""Of profiles, without the kind; ISO 21920-2:2021, 4.5 (recalled; Rcm as Mueller et al. read it)."""

AREAL = (
    Function("Smr", ("length",), "1", _RATIO, lambda w, c: w.curve.ratio(c)),
    Function("Smr", ("ratio", "length"), "1", _BELOW, _ratio_below),
    Function("Smc", ("ratio",), "m", "height at the ratio {0}", lambda w, p: w.curve.height(p)),
    Function(
        "Sdc", ("ratio", "ratio"), "m", _DIFFERENCE, lambda w, p, q: w.curve.height_difference(p, q)
    ),
    Function("Vm", ("ratio",), "m", _MATERIAL, lambda w, p: w.curve.material_volume(p)),
    Function("Vv", ("ratio",), "m", _VOID, lambda w, p: w.curve.void_volume(p)),
    Function(
        "Sha", ("ratio",), "m^2", "mean area of closed hills at the ratio {0}",
        lambda w, p: w.hills_at(p).mean_area,
    ),
    Function(
        "Sda", ("ratio",), "m^2", "mean area of closed dales at the ratio {0}",
        lambda w, p: w.dales_at(p).mean_area,
    ),
    Function(
        "Shv", ("ratio",), "m^3", "mean volume of closed hills above the ratio {0}",
        lambda w, p: w.hills_at(p).mean_volume,
    ),
    Function(
        "Sdv", ("ratio",), "m^3", "mean volume of closed dales below the ratio {0}",
        lambda w, p: w.dales_at(p).mean_volume,
    ),
)  # fmt: skip
"""Of maps; ISO 25178-2:2021 (recalled)."""


def is_call(name: str) -> bool:
    """Return whether a name is written with arguments."""
    return "(" in name


def call_of(name: str, functions: Sequence[Function], kind: str = "") -> Call:
    """Return the function and its arguments that a name such as ``Rmr(5 %, 1 um)`` means.

    `kind` stands before the symbols of `functions`: P, W or R of profiles.
    """
    symbol, texts = _parts(name)
    named = [f for f in functions if kind + f.symbol == symbol]
    if not named:
        raise unknown([name], [_form(f, kind) for f in functions], "a parameter with arguments")
    read = [_argument(text, name) for text in texts]
    takes = tuple(dimension for dimension, _ in read)
    for function in named:
        if _fits(takes, function.takes):
            values = tuple(value for _, value in read)
            written = ", ".join(_written(function.takes, values))
            return Call(f"{symbol}({written})", function, values)
    raise DataError(f"{name}: {_wrong(named, kind, takes)}")


def canonical(name: str, functions: Sequence[Function], kind: str = "") -> str:
    """Return the one spelling of a name with arguments; the name itself where it is none."""
    try:
        return call_of(name, functions, kind).name if is_call(name) else name
    except DataError:
        return name


def unknown(names: Iterable[str], known: Iterable[str], what: str) -> DataError:
    """Return the error of names that are not known, with the nearest three to each."""
    offered = list(known)
    texts = []
    for name in names:
        near = near_words(name, offered, 3, 0.3)
        texts.append(f"{name} (nearest: {', '.join(near)})" if near else name)
    return DataError(
        f"{', '.join(texts)}: not offered as {what}; offered are {', '.join(offered)}"
    )


def _parts(name: str) -> tuple[str, list[str]]:
    found = _CALL.fullmatch(name)
    if found is None:
        raise DataError(f"{name!r} is not a symbol with arguments, such as Rdc(20 %, 80 %)")
    if _COMMA.fullmatch(inside := found[2].strip()):
        first, second = inside.split(",")
        two = f", or {found[1]}({100 * int(first)} %, {second}) for two arguments"
        raise DataError(
            f"{name}: the comma may be a decimal comma; write {found[1]}({first}.{second})"
            f"{two if int(first) <= 1 else ''}"
        )
    return found[1], [text.strip() for text in found[2].split(",")]


def _argument(text: str, name: str) -> tuple[str, float]:
    """Return the dimension and the value of an argument."""
    if _NUMBER.fullmatch(text):
        value = float(text)
        if value != 0.0 and not 0.0 <= value <= 1.0:
            raise DataError(
                f"{name}: {text} needs a unit; a length is written as {text} um, a ratio as "
                f"{text} % or a number from 0 to 1"
            )
        return "number", value
    if text.endswith("%") and _NUMBER.fullmatch(share := text[:-1].strip()):
        ratio = float(share) / 100.0
        if not 0.0 <= ratio <= 1.0:
            raise DataError(f"{name}: a material ratio lies between 0 % and 100 %, got {text}")
        return "ratio", ratio
    try:
        return "length", parse_quantity(text, dimension="length", name=name)
    except DataError as exc:
        raise DataError(f"{name}: {exc}") from None


def _fits(given: tuple[str, ...], wanted: tuple[str, ...]) -> bool:
    return len(given) == len(wanted) and all(
        g == w or (g == "number" and w == "ratio") for g, w in zip(given, wanted, strict=True)
    )


def _written(takes: Sequence[str], values: Sequence[float]) -> list[str]:
    return [
        f"{100.0 * v:.{_DIGITS}g} %" if t == "ratio" else format_length(v, digits=_DIGITS)
        for t, v in zip(takes, values, strict=True)
    ]


_EXAMPLES = {"ratio": "20 %", "length": "0.5 um"}


def _form(function: Function, kind: str) -> str:
    return f"{kind}{function.symbol}({', '.join(_EXAMPLES[t] for t in function.takes)})"


def _wrong(named: Sequence[Function], kind: str, takes: tuple[str, ...]) -> str:
    """Return what arguments the functions of one symbol take."""
    text = "it is written as " + " or ".join(_form(f, kind) for f in named)
    if named[0].symbol == "mc" and takes in (("ratio",), ("number",)):
        text += f"; the height at a ratio is {kind}cm, from the highest peak"
    if named[0].symbol in ("mr", "Smr") and takes == ("number",):
        text += "; a length needs its unit"
    return text

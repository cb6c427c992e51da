"""SI numbers as a reader wants them: one readable unit for a row, four digits.

Used where results are printed: the command line and the reports. Nothing here is read back.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from metrosep.core.units import format_length, parse_unit

PREFIXED = {"m": "length", "rad": "angle", "s": "time"}
_SMALL = 0.1
"""A number of metres below it reads better in a smaller unit."""

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_IN_SI = re.compile(rf"(?<![\w.^/])({NUMBER}) (m/s|m|rad)(?![\w/^*])")
_LONG = re.compile(r"(?<![\w.])-?\d+\.\d{9,}(?:[eE][-+]?\d+)?(?!\w)")
_ABOUT_SI = re.compile(
    r"[;,] \w+ (?:are|is) in (?:m/s|m|rad)(?: \([^()]*\))?(?=[;,.]|$)"
    r"| \((?:\w+ (?:is|are) (?:in )?(?:m/s|m|rad|s)(?:, )?(?:\w+ (?:m/s|m|rad|s)(?:, )?)*)+(?: here)?\)"
)


def typeset(text: str) -> str:
    """Return a text for a page or a picture: a true micro sign in its units, which are typed as um.

    Examples
    --------
    >>> typeset("1.4 um to 2 um, 5 urad; um"), typeset("um")
    ('1.4 µm to 2 µm, 5 µrad; um', 'µm')
    """
    if text in ("um", "urad", "us"):
        return f"µ{text[1:]}"
    return re.sub(r"(?<=\d )u(?=(?:m|rad|s)\b)", "µ", text)


def readable_unit(values: Sequence[float | None], unit: str) -> tuple[str, float]:
    """Return the unit in which the largest of some values reads well.

    Examples
    --------
    >>> readable_unit([2.7e-7, 2e-8], "m"), readable_unit([1.7e-10], "m/s")
    (('nm', 1e-09), ('pm/s', 1e-12))
    """
    known = [abs(v) for v in values if v is not None and math.isfinite(v)]
    largest = max(known, default=0.0)
    base, slash, per = unit.partition("/")
    if base not in PREFIXED or (slash and not per) or largest == 0.0:
        return unit, 1.0
    if base == "m":
        name = format_length(largest).split()[1]
    elif base == "rad":
        name = _of(largest, ((1.0, "rad"), (1e-3, "mrad"), (1e-6, "urad"), (0.0, "nrad")))
    else:
        name = _of(largest, ((1.0, "s"), (1e-3, "ms"), (0.0, "us")))
    return f"{name}{slash}{per}", parse_unit(name).factor


def _of(largest: float, steps: Sequence[tuple[float, str]]) -> str:
    return next(name for low, name in steps if largest >= low)


def digits_of(value: float, digits: int = 4) -> str:
    """Return a number with so many significant digits, and no exponent where it is of common size.

    Examples
    --------
    >>> digits_of(4800.000000000001), digits_of(0.000123456), digits_of(12345.6)
    ('4800', '0.0001235', '12346')
    """
    if 10.0**digits <= abs(value) < 1e7:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def value_text(value: float | None, unit: str, u: float | None = None) -> str:
    """Return a value with its unit and standard uncertainty.

    Examples
    --------
    >>> value_text(1.748e-10, "m/s"), value_text(7.9561e-8, "m", 3.912e-9)
    ('174.8 pm/s', '79.6 nm (u = 3.9 nm)')
    """
    if value is None or not math.isfinite(value):
        return "not known"
    name, factor = readable_unit([value], unit)
    tail = "" if name == "1" else f" {name}"
    if u is None or not math.isfinite(u):
        return f"{digits_of(value / factor)}{tail}"
    own, own_factor = readable_unit([u], unit) if u > 0.0 else (name, factor)
    spread = "" if own == "1" else f" {own}"
    text = digits_of(value / factor)
    if 0.0 < u < abs(value):
        text = f"{value / factor:.{min(max(1 - math.floor(math.log10(u / factor)), 0), 9)}f}"
    return f"{text}{tail} (u = {digits_of(float(f'{u / own_factor:.2g}'))}{spread})"


_DEGREE = math.pi / 180.0
_STEPS = {
    "angle": ((_DEGREE, "deg"), (1e-6, "urad"), (1e-9, "nrad")),
    "time": ((3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"), (1e-6, "us")),
    "frequency": ((1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz")),
    "speed": ((1.0 / 6e4, "mm/min"),),
    "temperature difference": ((1.0, "K"), (1e-3, "mK")),
    "pressure": ((100.0, "hPa"), (1.0, "Pa")),
    "share": ((0.01, "%"), (1e-6, "ppm")),
    "coefficient of expansion": ((1e-6, "ppm/K"),),
}
_LEAST = {"deg": 0.02, "h": 2.0, "min": 2.0, "MHz": 1.0, "kHz": 1.0}
"""Below so much of a unit the next smaller one is taken."""


def typed_number(value: float, dimension: str, *, digits: int = 4) -> str:
    """Return a number in SI with the unit in which a person would type it.

    Examples
    --------
    >>> typed_number(0.02, "length"), typed_number(0.08, "speed")
    ('20 mm', '4800 mm/min')
    >>> typed_number(0.0, "length"), typed_number(5e-8, "angle"), typed_number(3600.0, "time")
    ('0 nm', '50 nrad', '60 min')
    """
    if dimension == "length":
        return "0 nm" if value == 0.0 else format_length(value, digits=digits)
    if dimension == "temperature":
        return f"{digits_of(value - 273.15, max(digits, 5))} degC"
    steps = _STEPS[dimension]
    size = abs(value)
    factor, unit = steps[-1]
    if value == 0.0:
        factor, unit = steps[0] if dimension != "time" else (1.0, "s")
    else:
        for each in steps:
            if size >= _LEAST.get(each[1], 1.0) * each[0] * (1.0 - 1e-9):
                factor, unit = each
                break
    return f"{digits_of(value / factor, digits)} {unit}"


def readable_text(message: str) -> str:
    """Return a message of the library with numbers in m, rad and m/s in readable units.

    Examples
    --------
    >>> readable_text("v_max = 0.08 m/s is below v_min = 0.15 m/s; an offset of 0.000558 m")
    'v_max = 4800 mm/min is below v_min = 9000 mm/min; an offset of 558 um'
    """

    def replaced(found: re.Match[str]) -> str:
        value, unit = float(found.group(1)), found.group(2)
        if unit == "m/s":
            return f"{digits_of(value * 6e4, 6)} mm/min"
        if unit == "m" and (value == 0.0 or abs(value) >= _SMALL):
            return found.group()
        name, factor = readable_unit([value], unit)
        return f"{digits_of(value / factor)} {name}"

    words = _IN_SI.sub(replaced, _ABOUT_SI.sub("", message))
    return _LONG.sub(lambda found: digits_of(float(found.group())), words)


def said_value(value: object) -> str:
    """Return what was typed into a recipe or a page, for a message: no word of Python.

    Examples
    --------
    >>> said_value(True), said_value(None), said_value("x")
    ('true', 'nothing', "'x'")
    """
    if value is None:
        return "nothing"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def did_you_mean(word: object, known: Iterable[object]) -> str:
    """Return the question whether the nearest known word was meant, after a blank; empty where none is near."""
    near = nearest(word, known)
    return f' Did you mean "{near}"?' if near else ""


def nearest(word: object, known: Iterable[object], alike: float = 0.6) -> str:
    """Return the known word that is like another one, whatever the capitals; empty where none is near."""
    return next(iter(near_words(word, known, 1, alike)), "")


def near_words(word: object, known: Iterable[object], most: int, alike: float) -> list[str]:
    """Return the known words that are at least so much like another one, 0 to 1, the nearest first."""
    import difflib

    names = {str(k).casefold(): str(k) for k in reversed(list(known))}
    text = str(word).casefold()
    near = difflib.get_close_matches(text, names, most, alike) if len(text) <= _LONGEST else []
    return [names[n] for n in near]


_LONGEST = 200
"""Characters of a word that is compared; what is longer is a text."""

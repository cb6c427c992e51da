"""Units at the edge: text with a unit in, SI floats inside, text with a unit out.

Inside metrosep a number has no unit of its own: it is in m, rad, s, V, Hz, K or 1 (SI). Here
live the only table of unit names and the only functions that read or print them. Both micro
signs (U+00B5 and U+03BC) are accepted and printed as "u".
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from metrosep.core.errors import UnitError


class Unit(NamedTuple):
    """A unit: its name, its dimension and the factor to SI.

    Parameters
    ----------
    name : str
        Canonical spelling.
    dimension : str
        One of ``length``, ``angle``, ``time``, ``speed``, ``acceleration``, ``voltage``, ``frequency``,
        ``torque``, ``sensitivity`` (m/V), ``number``; of air and parts ``temperature``, ``temperature
        difference``, ``pressure``, ``share``, ``coefficient of expansion``.
    factor : float
        Value in SI of one such unit.
    """

    name: str
    dimension: str
    factor: float

    @property
    def zero(self) -> float:
        """What the zero of its scale is in SI: 273.15 K for degC as a temperature, else 0."""
        return _ZEROS.get(self.name, 0.0) if self.dimension == "temperature" else 0.0


_INCH = 0.0254
_DEGREE = math.pi / 180.0

_TABLE: dict[str, tuple[str, float]] = {
    "pm": ("length", 1e-12),
    "angstrom": ("length", 1e-10),
    "nm": ("length", 1e-9),
    "um": ("length", 1e-6),
    "mm": ("length", 1e-3),
    "cm": ("length", 1e-2),
    "m": ("length", 1.0),
    "in": ("length", _INCH),
    "mil": ("length", _INCH * 1e-3),
    "uin": ("length", _INCH * 1e-6),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e-3),
    "urad": ("angle", 1e-6),
    "nrad": ("angle", 1e-9),
    "deg": ("angle", _DEGREE),
    "arcmin": ("angle", _DEGREE / 60.0),
    "arcsec": ("angle", _DEGREE / 3600.0),
    "ns": ("time", 1e-9),
    "us": ("time", 1e-6),
    "ms": ("time", 1e-3),
    "s": ("time", 1.0),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "Hz": ("frequency", 1.0),
    "kHz": ("frequency", 1e3),
    "MHz": ("frequency", 1e6),
    "rpm": ("frequency", 1.0 / 60.0),  # rotational frequency, ISO 80000-3
    "m/s": ("speed", 1.0),
    "mm/s": ("speed", 1e-3),
    "um/s": ("speed", 1e-6),
    "m/min": ("speed", 1.0 / 60.0),
    "mm/min": ("speed", 1e-3 / 60.0),
    "in/min": ("speed", _INCH / 60.0),
    "m/s2": ("acceleration", 1.0),
    "mm/s2": ("acceleration", 1e-3),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "uV": ("voltage", 1e-6),
    "N m": ("torque", 1.0),
    "N mm": ("torque", 1e-3),
    "mNm": ("torque", 1e-3),
    "kNm": ("torque", 1e3),
    "1": ("number", 1.0),
    "%": ("number", 0.01),
}

_SURROUNDINGS: dict[str, dict[str, float]] = {
    "temperature": {"degC": 1.0, "K": 1.0, "degF": 5.0 / 9.0},
    "temperature difference": {"K": 1.0, "mK": 1e-3, "degC": 1.0, "degF": 5.0 / 9.0},
    "pressure": {
        "hPa": 100.0, "Pa": 1.0, "kPa": 1e3, "mbar": 100.0, "bar": 1e5, "mmHg": 133.322387415,
        "inHg": 3386.388640341,
    },
    "share": {"%": 0.01, "ppm": 1e-6, "ppb": 1e-9},
    "coefficient of expansion": {"ppm/K": 1e-6, "1/K": 1.0},
}  # fmt: skip
"""Units of air and parts by what is measured in them. They are known only where one of these is asked
for: a header such as ``temp_degC`` of any other table stays a name."""

SURROUNDINGS = frozenset(_SURROUNDINGS)
"""Dimensions of air and parts."""

_ZEROS = {"degC": 273.15, "degF": 459.67 * 5.0 / 9.0}

_SURROUNDING_NAMES = {
    "C": "degC", "°C": "degC", "℃": "degC", "deg C": "degC", "deg_C": "degC", "celsius": "degC",
    "°F": "degF", "deg F": "degF", "kelvin": "K", "mb": "mbar", "millibar": "mbar",
    "Torr": "mmHg", "torr": "mmHg", "pascal": "Pa", "% RH": "%", "%RH": "%", "% rh": "%", "percent": "%",
    "pct": "%",
    "umol/mol": "ppm", "/K": "1/K", "K-1": "1/K", "K^-1": "1/K", "1/degC": "1/K", "/degC": "1/K",
    "1/°C": "1/K", "um/m/K": "ppm/K", "um/(m K)": "ppm/K", "um/(m*K)": "ppm/K", "um/m K": "ppm/K",
    "um/m/degC": "ppm/K", "ppm/degC": "ppm/K", "ppm/°C": "ppm/K", "um/m/°C": "ppm/K",
}  # fmt: skip

_LENGTHS = {"um": "micro", "nm": "nano", "mm": "milli", "cm": "centi", "m": ""}
_METRES = "meter meters metre metres mètre mètres metro metri metros"
_SPELLED = {
    "um": "micron microns mikrometer micra micras micrón micrones micrómetro micrómetros 微米 ミクロン "
    "マイクロメートル мкм mkm mum mu",
    "nm": "nanómetro nanómetros 纳米 奈米 ナノメートル нм",
    "mm": "milimetro milimetros milímetro milímetros 毫米 ミリ ミリメートル мм",
    "cm": "zentimeter centímetro centímetros 厘米 センチ センチメートル",
    "m": "米 メートル",
    "in": "inch inches zoll pouce pouces pollice pollici pulgada pulgadas 英寸 インチ",
    "deg": "degree degrees Grad degré degrés grado gradi grados 度",
    "rad": "radian radians Radiant radianti radiane radián radianes 弧度 ラジアン",
    "arcsec": "asec arcsecond arcseconds bogensekunde bogensekunden 角秒 秒角",
    "s": "sec second seconds sekunde sekunden seconde secondes secondi segundos 秒",
    "ms": "msec millisecond milliseconds millisekunde millisekunden milliseconde millisecondes millisecondi "
    "milisegundo milisegundos 毫秒 ミリ秒",
    "us": "microsecond microseconds mikrosekunde mikrosekunden microsecondes microsecondi microsegundos 微秒 "
    "マイクロ秒",
    "min": "minutes minuten minuti minutos 分钟",
    "h": "hours stunden heures horas 小时",
    "V": "volt volts v 伏 伏特 ボルト",
    "mV": "mv millivolt millivolts 毫伏 ミリボルト",
    "Hz": "hz hertz 赫兹 ヘルツ",
}
"""Words for units in the seven languages, in small letters; grad is also the 400th part of a turn."""

_ALIASES = {
    **{p + w: unit for unit, p in _LENGTHS.items() for w in _METRES.split()},
    **{w: unit for unit, words in _SPELLED.items() for w in words.split()},
    "thou": "mil",
    "mils": "mil",
    '"': "in",
    "uinch": "uin",
    "microinch": "uin",
    "°": "deg",
    "khz": "kHz",
    **dict.fromkeys(
        (
            "1/min", "/min", "min-1", "min^-1", "min⁻¹", "r/min", "rev/min", "rev_per_min", "U/min",
            "Upm", "tr/min", "giri/min", "转/分", "回/分",
        ),
        "rpm",
    ),
    **dict.fromkeys(("1/s", "s-1", "s^-1", "s⁻¹", "r/s", "rev/s", "rev_per_s", "U/s"), "Hz"),
    "Nm": "N m",
    "N·m": "N m",
    "N*m": "N m",
    "N.m": "N m",
    "Nmm": "N mm",
    "mm_min": "mm/min",
    "mm_per_min": "mm/min",
    "mmpm": "mm/min",
    "mm/minute": "mm/min",
    "mm/s^2": "mm/s2",
    "m/s^2": "m/s2",
    "mm_s": "mm/s",
    "mm_per_s": "mm/s",
    "um_s": "um/s",
    "um_per_s": "um/s",
    "m_s": "m/s",
    "m_per_s": "m/s",
    "m_min": "m/min",
    "m_per_min": "m/min",
    "in_min": "in/min",
    "in_per_min": "in/min",
    "ipm": "in/min",
    "å": "angstrom",
    "Å": "angstrom",
    "-": "1",
    "″": "in", "毫米/分": "mm/min", "N·mm": "N mm", "N*mm": "N mm", "N.mm": "N mm",
}  # fmt: skip

FOREIGN_SPELLINGS = frozenset(
    w for w in _ALIASES if not w.isascii() and len(w) > 1 and w.isalpha()
)
"""Units as Russian, Chinese and Japanese headers write them; they also show in which code page those are."""

_DECIMAL = {
    factor: round(math.log10(factor))
    for _, factor in _TABLE.values()
    if factor == float(f"1e{round(math.log10(factor))}")
}
"""Power of ten of each factor that is one."""

_POWER = re.compile(
    r"(?:1\s*[eE]|[eE]|(?:1?\s*[x*×·]\s*)?10(?:\^|\*\*)?)\s*([+-]?\d{1,2})\s*[*×·]?\s*([^\d\s].*)"
)
"""A power of ten times a unit: 10^-6 m, E-6 m, 1e-3 mm."""

_LONGEST = 6
"""Characters of an exponent; a longer one is zero or infinite anyway."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_QUANTITY = re.compile(rf"^\s*({_NUMBER})\s*(.*?)\s*$")
_NOT_SUFFIXES = frozenset({"1", "-", "%", "min", "h", "v", "sec"})
"""Units that end a header by accident more often than on purpose: z_min is a minimum."""

_BRACKETED = re.compile(r"^(.*?)\s*[\[\(]\s*([^\[\]\(\)]+?)\s*[\]\)]\s*$")


_WORD = 3
"""Letters from which a spelling is a word of any case: deg, Sec, Micron; but Mm, nM, MS are symbols."""

_SYMBOLS = frozenset(
    [
        "pm",
        "nm",
        "um",
        "mm",
        "cm",
        "mil",
        "uin",
        "rad",
        "mrad",
        "urad",
        "nrad",
        "min",
        "hz",
        "khz",
        "mhz",
    ]
)
"""Spellings of three letters and more, or of two, that are symbols all the same."""

_UPPER = {
    "MM": "mm", "UM": "um", "CM": "cm", "IN": "in", "HZ": "Hz", "KHZ": "kHz", "MIN": "min",
    "MM/MIN": "mm/min", "M/MIN": "m/min", "IN/MIN": "in/min", "MM/S": "mm/s", "RAD": "rad",
}  # fmt: skip
"""Text of machines has no small letters; NM, M, S, MS and PM stay refused: they mean something else."""

_MEANS = {
    "Mm": "megametre", "MM": "megametre", "Nm": "newton metre", "NM": "nautical mile", "nM": "nanomolar",
    "mM": "millimolar", "uM": "micromolar", "UM": "nothing in the SI", "M": "mega or molar",
    "Pm": "petametre", "PM": "nothing in the SI", "S": "siemens", "mS": "millisiemens",
    "MS": "megasiemens", "uS": "microsiemens", "Ms": "megasecond", "US": "nothing in the SI",
    "MV": "megavolt", "Mv": "nothing in the SI", "H": "henry", "Cm": "nothing in the SI",
    "mHz": "millihertz",
}  # fmt: skip
"""What a symbol with other capitals means, for the message."""


def _canonical(text: str) -> str:
    """Return the spelling of a unit; the case of symbols counts, that of words does not."""
    if text.strip() in ("µ", "μ"):
        return "um"
    name = text.strip().replace("µ", "u").replace("μ", "u")
    if name in _TABLE:
        return name
    if name in _ALIASES:
        return _ALIASES[name]
    if name in _UPPER:
        return _UPPER[name]
    power = _POWER.fullmatch(name)
    if power is not None and (of := _canonical(power[2])) in _TABLE:
        dimension, factor = _TABLE[of]
        whole = factor * float(f"1e{power[1]}")
        same = (
            n
            for n, (d, f) in _TABLE.items()
            if d == dimension and math.isclose(f, whole, rel_tol=1e-12)
        )
        return next(same, name)
    lowered = name.lower()
    if len(lowered) >= _WORD and lowered not in _SYMBOLS:
        if lowered in _ALIASES:
            return _ALIASES[lowered]
        if lowered in _TABLE and "/" not in lowered:
            return lowered
    return name


def likely_meaning(text: str) -> str | None:
    """Return what is unusual about a text that a reader of another case would take for a unit.

    Examples
    --------
    >>> likely_meaning("x [Mm]")
    "'Mm' is megametre, not mm"
    """
    match = _BRACKETED.match(text.strip())
    name = match.group(2) if match else re.split(r"[\s_/]", text.strip())[-1]
    name = name.replace("µ", "u").replace("μ", "u")
    meant = next((t for t in _TABLE if t.lower() == name.lower()), None)
    if meant is None or _canonical(name) in _TABLE:
        return None
    return f"{name!r} is {_MEANS.get(name, 'no unit')}, not {meant}"


def parse_unit(text: str, *, dimension: str | None = None) -> Unit:
    """Return the unit that a text names.

    Examples
    --------
    >>> parse_unit("µm").factor
    1e-06
    """
    if dimension in _SURROUNDINGS:
        return _surrounding(text, dimension)
    name = _canonical(text)
    if name not in _TABLE:
        known = ", ".join(n for n, (d, _) in _TABLE.items() if dimension in (None, d))
        odd = likely_meaning(text)
        why = f" ({odd}: capitals count)" if odd else ""
        raise UnitError(f"unknown unit {text!r}{why}; known are {known}")
    unit = Unit(name, *_TABLE[name])
    if dimension is not None and unit.dimension != dimension:
        raise UnitError(
            f"unit {text!r} is {_a(unit.dimension)}, but {_a(dimension)} is needed here, "
            f"such as {_example(dimension)}"
        )
    return unit


def _surrounding(text: str, dimension: str) -> Unit:
    """Return a unit of air or parts, of the dimension that is asked for."""
    name = text.strip().replace("µ", "u").replace("μ", "u")
    name = _SURROUNDING_NAMES.get(name, _SURROUNDING_NAMES.get(name.lower(), name))
    known = _SURROUNDINGS[dimension]
    if name in known:
        return Unit(name, dimension, known[name])
    other = next((d for d, units in _SURROUNDINGS.items() if name in units), None)
    if other is None and _canonical(text) in _TABLE:
        other = _TABLE[_canonical(text)][0]
    is_what = f"unit {text!r} is {_a(other)}" if other else f"unknown unit {text!r}"
    raise UnitError(f"{is_what}; {_a(dimension)} is needed here, in {_example(dimension)}")


def surrounding_header(header: str, dimension: str) -> Unit | None:
    """Return the unit of air or parts that ends the header of a column, such as ``p [hPa]``, ``T_degC``.

    Examples
    --------
    >>> surrounding_header("air pressure [hPa]", "pressure").factor, surrounding_header("T", "pressure")
    (100.0, None)
    """
    text = header.strip()
    match = _BRACKETED.match(text)
    pieces = re.split(r"[\s_]+", text)
    tails = [match.group(2)] if match else []
    tails += ["_".join(pieces[-n:]) for n in (2, 1) if len(pieces) > n]
    for tail in tails:
        try:
            return _surrounding(tail, dimension)
        except UnitError:
            continue
    return None


PIXEL = "px"
"""Unit of places and sizes on a map that count its pixels; a file is never in it."""

TYPICAL = {
    "length": "1.2 mm", "angle": "0.1 deg", "time": "2 ms", "frequency": "1 kHz",
    "speed": "4800 mm/min", "acceleration": "2 m/s2", "voltage": "2.5 V", "torque": "1 N m",
    "number": "5 %", "temperature": "20.3 degC", "temperature difference": "0.1 K",
    "pressure": "1013 hPa", "share": "45 %", "coefficient of expansion": "11.5 ppm/K",
}  # fmt: skip
"""A quantity of each dimension as a person writes it, for messages."""


def _a(dimension: str) -> str:
    return f"an {dimension}" if dimension[:1] in "aeio" else f"a {dimension}"


def _example(dimension: str) -> str:
    if dimension in _SURROUNDINGS:
        return ", ".join(map(repr, _SURROUNDINGS[dimension]))
    return ", ".join(repr(n) for n, (d, _) in list(_TABLE.items()) if d == dimension) or "none"


def parse_quantity(value: str | float, *, dimension: str, name: str = "value") -> float:
    """Return a quantity in SI from text such as ``"1.2 mm"``.

    Examples
    --------
    >>> parse_quantity("250 um", dimension="length")
    0.00025
    """
    if not isinstance(value, str):
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise UnitError(
                f"{name} is {value!r}; give a number in SI or text with a unit, such as {TYPICAL[dimension]!r}"
            ) from None
        if not math.isfinite(number):
            raise UnitError(f"{name} is {number}; a finite {dimension} is needed")
        return number
    match = _QUANTITY.match(value)
    if match is None:
        raise UnitError(
            f"{name} {value!r} is not a number with a unit; write it like {TYPICAL[dimension]!r} "
            f"(units: {_example(dimension)})"
        )
    digits, unit_text = match.groups()
    comma = re.match(r",\d+\s*(.*)", unit_text)
    if comma is not None:
        raise UnitError(
            f"{name} {value!r} has a decimal comma; write a point, such as "
            f"{value.replace(',', '.', 1).strip()!r}"
        ) from None
    if not unit_text:
        raise UnitError(
            f"{name} {value!r} has no unit; write it with one of {_example(dimension)}"
        )
    if unit_text == PIXEL:
        raise UnitError(
            f"{name} {value!r} counts pixels of a map, as only what is drawn on it may; write it like "
            f"{TYPICAL[dimension]!r}"
        )
    try:
        unit = parse_unit(unit_text, dimension=dimension)
    except UnitError as error:
        raise UnitError(f"{name} = {value!r}: {error}") from None
    number = _scaled(digits, unit.factor) + unit.zero
    if not math.isfinite(number):
        raise UnitError(f"{name} {value!r} is not finite")
    return number


_PIXELS = re.compile(rf"\s*({_NUMBER})\s*(?:px|pixels?)\s*")


class Pixels(float):
    """A place or size on a map in its pixels, 0 being the centre of the first one; elsewhere it is a float.

    Examples
    --------
    >>> parse_lateral("120 px"), parse_lateral("120 um")
    (120 px, 0.00012)
    """

    __slots__ = ()

    def __repr__(self) -> str:
        """Return it as it is typed."""
        return f"{float(self):.12g} {PIXEL}"

    __str__ = __repr__


def with_px(value: Any) -> Any:
    """Return a value in which px are texts, "120 px", as JSON and a history hold them: there a number is in SI."""
    if isinstance(value, Mapping):
        return {k: with_px(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(map(with_px, value)) if type(value) in (list, tuple) else value
    return str(value) if isinstance(value, Pixels) else value


def parse_lateral(value: str | float, *, name: str = "value") -> float:
    """Return a place or size on a map: a length in SI, or `Pixels` of a text such as ``"120 px"``."""
    match = _PIXELS.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return parse_quantity(value, dimension="length", name=name)
    found = Pixels(match[1])
    if not math.isfinite(found):
        raise UnitError(f"{name} {value!r} is not finite")
    return found


def unit_dimension(text: str) -> str | None:
    """Return what a text with a unit measures; None where it has no unit that is known.

    Examples
    --------
    >>> unit_dimension("15 deg"), unit_dimension("1e-3 m"), unit_dimension("3")
    ('angle', 'length', None)
    """
    match = _QUANTITY.match(text)
    try:
        return parse_unit(match.group(2)).dimension if match and match.group(2) else None
    except UnitError:
        return None


def _scaled(digits: str, factor: float) -> float:
    """Return a typed number times a factor: the float nearest to it where the factor is a power of ten.

    12 * 1e-9 is 1.2000000000000002e-08, since 1e-9 is rounded before the product is.
    """
    power = _DECIMAL.get(factor)
    mantissa, _, exponent = digits.lower().partition("e")
    if power is None or len(exponent) > _LONGEST:
        return float(digits) * factor
    return float(f"{mantissa}e{int(exponent or 0) + power}")


def parse_sensitivity(text: str) -> float:
    """Return a sensor's sensitivity in m/V from text such as ``"2.5 um/V"``.

    Examples
    --------
    >>> round(parse_sensitivity("-2.5 um/V") * 1e6, 9)
    -2.5
    """
    match = _QUANTITY.match(text)
    if match is None or match.group(2).count("/") != 1:
        raise UnitError(
            f"sensitivity {text!r} is not a length per voltage; write it like '2.5 um/V'"
        )
    numerator, denominator = match.group(2).split("/")
    factor = (
        parse_unit(numerator, dimension="length").factor
        / parse_unit(denominator, dimension="voltage").factor
    )
    value = float(match.group(1)) * factor
    if value == 0.0 or not math.isfinite(value):
        raise UnitError(f"sensitivity {text!r} must be finite and not zero")
    return value


def column_unit(header: str) -> tuple[str, Unit | None]:
    """Return the bare name of a column and the unit that its header declares.

    Examples
    --------
    >>> column_unit("feed_mm_min")
    ('feed', Unit(name='mm/min', dimension='speed', factor=1.6666666666666667e-05))
    >>> column_unit("probe1")
    ('probe1', None)
    """
    text = header.strip()
    match = _BRACKETED.match(text)
    if match is not None and _canonical(match.group(2)) in _TABLE:
        return match.group(1).strip(" _"), parse_unit(match.group(2))
    pieces = text.split("_")
    for n_suffix in (3, 2, 1):
        if len(pieces) > n_suffix:
            suffix = "_".join(pieces[-n_suffix:])
            if _canonical(suffix) in _TABLE and suffix not in _NOT_SUFFIXES:
                return "_".join(pieces[:-n_suffix]), parse_unit(suffix)
    return text, None


_LENGTH_STEPS = ((1e-9, "pm", 1e-12), (1e-6, "nm", 1e-9), (1e-3, "um", 1e-6), (1.0, "mm", 1e-3))


def format_length(value: float | None, *, digits: int = 4) -> str:
    """Return a length in m, or pixels, as text with a readable unit.

    Examples
    --------
    >>> format_length(1.25e-6), format_length(Pixels(120))
    ('1.25 um', '120 px')
    """
    if value is None or math.isnan(value):
        return "not known"
    if isinstance(value, Pixels):
        return f"{_plain_digits(value, digits)} {PIXEL}"
    size = abs(value)
    if size == 0.0:
        return "0 m"
    for limit, name, factor in _LENGTH_STEPS:
        if size < limit:
            return f"{_plain_digits(value / factor, digits)} {name}"
    return f"{_plain_digits(value, digits)} m"


def format_ends(low: float, high: float, *, digits: int = 4, between: str = " ... ") -> str:
    """Return two ends of a range in m as text with one unit, that of the larger end.

    An end below a thousandth of that unit keeps its own.

    Examples
    --------
    >>> format_ends(0.0, 50e-3), format_ends(-80e-9, 1.2e-6, between=" to ")
    ('0 ... 50 mm', '-0.08 to 1.2 um')
    """
    if isinstance(low, Pixels):
        return f"{_plain_digits(low, digits)}{between}{format_length(high, digits=digits)}"
    small, size = sorted((abs(low), abs(high)))
    factor, name = next(
        ((f, n) for limit, n, f in _LENGTH_STEPS if 0.0 < size < limit), (1.0, "m")
    )
    if math.isnan(low + high) or 0.0 < small < 1e-3 * factor:
        return f"{format_length(low, digits=digits)}{between}{format_length(high, digits=digits)}"
    ends = [_plain_digits(v / factor, digits) if v else "0" for v in (low, high)]
    return f"{ends[0]}{between}{ends[1]} {name}"


def format_engineering(value: float, unit: str, *, digits: int = 4) -> str:
    """Return a value with its unit name; lengths, angles and times get a readable prefix.

    Examples
    --------
    >>> format_engineering(0.5, "V"), format_engineering(-1.6e-4, "rad"), format_engineering(4e-4, "s")
    ('0.5 V', '-160 urad', '400 us')
    """
    if math.isnan(value):
        return "not known"
    if unit == "m":
        return format_length(value, digits=digits)
    if unit == "rad" and 0.0 < abs(value) < 1e-3:
        factor, unit = (1e-6, "urad") if abs(value) >= 1e-6 else (1e-9, "nrad")
        value /= factor
    if unit == "s" and 0.0 < abs(value) < 1.0:
        limits = ((1e-6, "ns", 1e-9), (1e-3, "us", 1e-6), (1.0, "ms", 1e-3))
        unit, factor = next((n, f) for limit, n, f in limits if abs(value) < limit)
        value /= factor
    return f"{_plain_digits(value, digits)} {'' if unit == '1' else unit}".rstrip()


def _plain_digits(value: float, digits: int) -> str:
    """Return significant digits without an exponent where the number is of ordinary size."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text

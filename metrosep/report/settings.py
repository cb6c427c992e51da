"""What a separation did, as rows of a report: every number with its unit, four digits.

A key of the audit tells the unit by its suffix (``travel_mm``); a key of the step tells its
dimension by the kind of its field, and is stored in SI.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from metrosep.core.readable import digits_of, readable_unit
from metrosep.core.units import parse_unit
from metrosep.recipe.key_values import shown
from metrosep.recipe.schema import Field

__all__ = ["in_words", "setting", "settings", "step_parameters", "typeset"]

Fields = Mapping[str, Field]

_UNITS = {
    "_nm_per_m_per_min": "nm per m/min",
    "_nm_per_revolution": "nm per revolution",
    "_nm2_per_hz": "nm²/Hz",
    "_mm_per_min": "mm/min",
    "_rev_per_s": "rev/s",
    "_nm2": "nm²",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_pm": "pm",
    "_mrad": "mrad",
    "_urad": "µrad",
    "_nrad": "nrad",
    "_rad": "rad",
    "_deg": "deg",
    "_ppm": "ppm",
    "_khz": "kHz",
    "_hz": "Hz",
    "_min": "min",
    "_ms": "ms",
    "_us": "µs",
    "_h": "h",
    "_m": "m",
    "_s": "s",
    "_si": "SI",
}
"""By suffix, the longer ones first where one ends like another."""

_SCALED = ("length", "angle")
_LEAST, _MOST = 0.1, 1e4
"""Outside of these a length or an angle gets another unit than that of its key."""

_MOST_ITEMS, _MOST_TABLES = 12, 4


def settings(audit: Mapping[str, Any], fields: Fields) -> list[tuple[str, str]]:
    """Return what was done, as rows."""
    return [setting(k, v, fields) for k, v in sorted(audit.items())]


def setting(key: str, value: Any, fields: Fields) -> tuple[str, str]:
    """Return one entry of an audit in words.

    Examples
    --------
    >>> setting("travel_mm", 600.0, {}), setting("distance", [0.02], {"distance": Field("lengths")})
    (('travel', '600 mm'), ('distance', '20 mm'))
    >>> setting("wavelength_um", 123000.0, {}), setting("n_repeats", 6, {})
    (('wavelength', '123 mm'), ('number of repeats', '6'))
    """
    suffix = next((s for s in _UNITS if key.endswith(s)), "")
    base = key.removesuffix(suffix)
    unit = _UNITS.get(suffix, "")
    if base in fields and unit == "rad" and _is_number(value):
        return in_words(base), typeset(shown(value, fields[base]))
    if suffix:
        return in_words(base), _text(value, unit)
    if key in fields:
        return in_words(key), typeset(_shortened(value, lambda v: shown(v, fields[key])))
    return in_words(key), _text(value, "")


def step_parameters(parameters: Mapping[str, Any], fields: Fields) -> str:
    """Return the parameters of a step in one line.

    Examples
    --------
    >>> step_parameters({"u_reading": 1e-9, "kmax": 30}, {"u_reading": Field("uncertainty")})
    'kmax = 30; u_reading = 1 nm'
    """
    texts = []
    for key, value in sorted(parameters.items()):
        suffix = next((s for s in _UNITS if key.endswith(s)), "")
        if key in fields:
            text = typeset(shown(value, fields[key]))
        elif suffix and value is not None:
            text = _text(value, _UNITS[suffix])
        else:
            text, suffix = _text(value, ""), ""
        texts.append(f"{key if key in fields else key.removesuffix(suffix)} = {text}")
    return "; ".join(texts) or "–"


def in_words(key: str) -> str:
    """Return a key without its underscores.

    Examples
    --------
    >>> in_words("n_samples"), in_words("u_reading"), in_words("noise_source")
    ('number of samples', 'u reading', 'noise source')
    """
    words = "number of " + key[2:] if key.startswith("n_") else key
    words = words.replace("number of not_", "readings not_")
    return words.replace("_", " ")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: Any, unit: str) -> str:
    if _is_number(value):
        number, name = _scaled([float(value)], unit)
        whole = isinstance(value, int) and number == [value]
        return f"{value if whole else _digits(number[0])} {name}".strip()
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        pairs = [(k, *setting(str(k), v, {})) for k, v in value.items()]
        texts = [f"{w} {_text(value[k], unit) if unit else t}" for k, w, t in pairs]
        return ", ".join(texts) or "none"
    if isinstance(value, list | tuple):
        return _list(value, unit)
    return str(value)


def _list(values: Sequence[Any], unit: str) -> str:
    if not values:
        return "none"
    if all(v is None or _is_number(v) for v in values):
        known = [float(v) for v in values if v is not None]
        numbers, name = _scaled(known, unit)
        each = iter(numbers)
        shortened = ["–" if v is None else _digits(next(each)) for v in values]
        tail = f" {name}" if name else ""
        if len(shortened) > _MOST_ITEMS:
            return f"{', '.join(shortened[:_MOST_ITEMS])}{tail}, … ({len(shortened)} in all)"
        return ", ".join(shortened) + tail
    between = "; " if any(isinstance(v, Mapping) for v in values) else ", "
    most = _MOST_TABLES if between == "; " else _MOST_ITEMS
    texts = [_text(v, unit) for v in values[:most]]
    nested = any(isinstance(v, list | tuple) for v in values)
    texts = [f"({t})" if nested else t for t in texts]
    rest = f"{between}… ({len(values)} in all)" if len(values) > most else ""
    return between.join(texts) + rest


def _shortened(value: Any, text: Any) -> str:
    if isinstance(value, list | tuple) and len(value) > _MOST_ITEMS:
        return f"{text(value[:_MOST_ITEMS])}, … ({len(value)} in all)"
    return str(text(value))


def _scaled(values: Sequence[float], unit: str) -> tuple[list[float], str]:
    """Return numbers in a unit in which the largest of them reads well."""
    plain = unit.replace("µ", "u")
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    if not unit or largest == 0.0 or _LEAST <= largest < _MOST or " " in unit or "²" in unit:
        return list(values), unit
    if plain in ("mm/min", "Hz", "kHz", "ppm", "SI", "deg", "rev/s"):
        return list(values), unit
    known = parse_unit(plain)
    if known.dimension not in _SCALED:
        return list(values), unit
    si = "m" if known.dimension == "length" else "rad"
    name, factor = readable_unit([largest * known.factor], si)
    return [v * known.factor / factor for v in values], typeset(name)


def _digits(value: float) -> str:
    return digits_of(value).replace("-", "−") if math.isfinite(value) else "–"


def typeset(text: str) -> str:
    """Return a text with a true micro sign in its units.

    Examples
    --------
    >>> typeset("1.4 um to 2 um, 5 urad; um"), typeset("um")
    ('1.4 µm to 2 µm, 5 µrad; um', 'µm')
    """
    if text in ("um", "urad", "us"):
        return f"µ{text[1:]}"
    return re.sub(r"(?<=\d )u(?=(?:m|rad|s)\b)", "µ", text)

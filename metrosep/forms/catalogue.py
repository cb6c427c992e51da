"""Forms by name and text, as a command line or a recipe writes them.

``"plane"``, ``"conic: R=50 mm, k=-1.2"``, ``"polynomial: degree=5"``, ``"zernike: terms=36, order=fringe"``,
``"expression: a*x**2 + b; a=1 SI, b"``. A parameter without a value, or left out, is found by the fit.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from metrosep.core.errors import DataError, UnitError
from metrosep.core.readable import did_you_mean
from metrosep.core.units import parse_quantity
from metrosep.forms.base import Form

_NUMBER = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*")
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")
_MINUS = "\u2212"
_SI = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*SI\s*$")
_DIMENSIONS = {"m": "length", "rad": "angle"}
_PER = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\d.eE])\s*"
    r"(?:1?\s*/\s*([a-zA-Zµμ]+)\s*(?:\^|\*\*)?\s*(\d+|[⁰¹²³⁴-⁹]+)?"
    r"|([a-zA-Zµμ]+)\s*(?:\^|\*\*)?\s*[-⁻](\d+|[⁰¹²³⁴-⁹]+))\s*"
)
"""A number per a power of a length: "2e-7 /mm^3", "2e-7 mm^-3"."""


def form_names() -> tuple[str, ...]:
    """Return the names that `form_from_text` knows."""
    return tuple(sorted(_BUILDERS))


def form_from_text(text: str) -> Form:
    """Return the form that a text describes.

    Parameters
    ----------
    text : str
        Name, and after a colon ``key=value`` pairs separated by commas. Lengths and angles carry
        units, coefficients of an asphere too (``a4=2e-7 /mm^3``); a value in another unit is
        given as ``1.5e3 SI``.

    Returns
    -------
    Form
        With None for each parameter that was not given.

    Raises
    ------
    DataError
        If the name or a key is not known, or a value does not fit.

    Examples
    --------
    >>> form_from_text("conic: R=50 mm, k=-1.2")
    Conic(R=0.05, k=-1.2)
    """
    name, _, rest = text.replace(_MINUS, "-").partition(":")
    key = name.strip().lower().replace("-", "_").replace(" ", "_")
    if key not in _BUILDERS:
        hint = did_you_mean(key, form_names())
        raise DataError(
            f"there is no form {name.strip()!r}; there are: {', '.join(form_names())}.{hint}"
        )
    if key == "expression":
        return _expression(rest)
    return _BUILDERS[key](_pairs(rest, text))


def parameter_value(text: str, unit: str, name: str) -> float:
    """Return the value of a parameter in SI."""
    text = text.replace(_MINUS, "-")
    match = _SI.match(text)
    if match is not None:
        return float(match[1])
    if unit in _DIMENSIONS:
        return parse_quantity(text.strip(), dimension=_DIMENSIONS[unit], name=name)
    try:
        if unit in ("1", ""):
            share = text.strip().endswith("%")
            return parse_quantity(text.strip(), dimension="number") if share else float(text)
    except (ValueError, UnitError):
        raise UnitError(
            f"{name} is {text!r}; a pure number is needed, such as 0.01 or 1 %"
        ) from None
    raise UnitError(
        f"{name} is in {unit or 'SI'}: write {text.split(maxsplit=1)[0]} SI if it is that"
    )


def _per_length(text: str, power: int, name: str) -> float:
    """Return a coefficient in m^-power, of "200 SI" or "2e-7 /mm^3"."""
    match = _PER.fullmatch(text)
    if match is None:
        if _SI.match(text):
            return parameter_value(text, "", name)
        wanted = "/mm" if power == 1 else f"/mm^{power}"
        of_si = f"SI behind a number in {'1/m' if power == 1 else f'm^-{power}'}"
        if _NUMBER.fullmatch(text):
            raise UnitError(
                f"{name} is {text!r}: give its unit, such as {text.strip()} {wanted}, or {of_si}"
            )
        raise UnitError(
            f"{name} is {text!r}: write a number per length{'' if power == 1 else f' to the power {power}'}, "
            f"such as 2e-7 {wanted}, without blanks in it, or {of_si}; a length is a coefficient only with "
            "norm_radius="
        )
    number, above = match[1], match[2] or match[4]
    below = int((match[3] or match[5] or "1").translate(_RAISED))
    if below != power:
        raise UnitError(
            f"{name} is {text!r}: the coefficient of r^{power + 1} is a length to the power {-power}, "
            f"not {-below}"
        )
    return float(number) / parse_quantity(f"1 {above}", dimension="length", name=name) ** power


def _pairs(rest: str, text: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for part in filter(None, (p.strip() for p in rest.split(","))):
        key, _, value = (p.strip() for p in part.partition("="))
        if "=" in value:
            raise DataError(f"{text!r}: {part!r} holds two values: a comma stands between values")
        if not key or not value:
            hint = ""
            if part[:1].isdigit() and pairs:
                hint = "; numbers have a decimal point, and several powers are written terms=4 6 8"
            elif part[:1].isdigit():
                hint = f"; name the value, such as R={part}"
            raise DataError(
                f"{text!r}: expected key=value between the commas, found {part!r}{hint}"
            )
        if key in pairs:
            raise DataError(f"{text!r}: {key} is given twice")
        pairs[key] = value
    return pairs


def _take(pairs: dict[str, str], units: Mapping[str, str], form: str) -> dict[str, float]:
    """Return the values of known keys; refuse others."""
    unknown = sorted(set(pairs) - set(units))
    if unknown:
        raise DataError(
            f"{form} has no {', '.join(unknown)}; it has: {', '.join(units) or 'no parameters'}"
        )
    return {k: parameter_value(v, units[k], f"{k} of {form}") for k, v in pairs.items()}


def _simple(module: str, cls: str) -> Callable[[dict[str, str]], Form]:
    def build(pairs: dict[str, str]) -> Form:
        import importlib

        form = getattr(importlib.import_module(f"metrosep.forms.{module}"), cls)
        units = form().units
        made: Form = form(**_take(pairs, units, form.name))
        return made

    return build


def _asphere(pairs: dict[str, str]) -> Form:
    from metrosep.forms.conic import Asphere

    norm = pairs.pop("norm_radius", None)
    given = [k for k in pairs if re.fullmatch(r"[aA]\d+", k)]
    terms = {int(k[1:]): pairs.pop(k) for k in given}
    Asphere(coefficients=dict.fromkeys(terms))  # powers first: the unit follows from them
    words = pairs.pop("terms", "").split()
    if not all(re.fullmatch(r"a?\d+", w) for w in words):
        raise DataError(f"asphere: terms are powers such as 4 6 8, got {' '.join(words)!r}")
    free = [int(w.lstrip("a")) for w in words]
    if len({*terms, *free}) < len(given) + len(free):
        twice = ", ".join([*sorted(given), *(["terms"] if free else [])])
        raise DataError(f"asphere: one power is given twice in {twice}: keep one")
    values: dict[int, float | None] = dict.fromkeys(free)
    for power, v in terms.items():
        k = f"a{power}"
        values[power] = (
            _per_length(v, power - 1, k) if norm is None else parameter_value(v, "m", k)
        )
    unknown = sorted(set(pairs) - {"R", "k"})
    if unknown:
        raise DataError(
            f"asphere has no {', '.join(unknown)}; it has: R, k, norm_radius, terms, and coefficients "
            "such as a4=2e-7 /mm^3"
        )
    head = _take(pairs, {"R": "m", "k": "1"}, "asphere")
    return Asphere(
        R=head.get("R"),
        k=head.get("k", 0.0),
        coefficients=values,
        norm_radius=None if norm is None else parameter_value(norm, "m", "norm_radius"),
    )


def _sine_grid(pairs: dict[str, str]) -> Form:
    from metrosep.forms.sine_grid import SineGrid

    units = SineGrid(amplitude_y=None, wavelength_y=None).units
    return SineGrid(**_take(pairs, units, "sine grid"))


def _options(pairs: dict[str, str], form: str, **known: Callable[[str], Any]) -> dict[str, Any]:
    unknown = sorted(set(pairs) - set(known))
    if unknown:
        raise DataError(f"{form} has no {', '.join(unknown)}; it has: {', '.join(known)}")
    found = {}
    for key, value in pairs.items():
        try:
            found[key] = known[key](value)
        except ValueError:
            raise DataError(f"{form}: {key} is {value!r}, which it cannot be") from None
    return found


def _polynomial(pairs: dict[str, str]) -> Form:
    from metrosep.forms.polynomial import Polynomial

    given = _options(pairs, "polynomial", degree=int, kind=str, basis=str)
    if "degree" not in given:
        raise DataError("a polynomial needs its degree: polynomial: degree=5")
    return Polynomial(given.pop("degree"), **given)


def _zernike(pairs: dict[str, str]) -> Form:
    from metrosep.forms.zernike import Zernike

    given = _options(
        pairs,
        "zernike",
        terms=int,
        order=str,
        normalisation=str,
        radius=lambda v: parameter_value(v, "m", "radius"),
    )
    return Zernike(**{"terms": 36, **given})


def _qforbes(pairs: dict[str, str]) -> Form:
    from metrosep.forms.qforbes import QForbes

    radius = pairs.pop("radius", None)
    count = pairs.pop("terms", "5")
    if not count.isdecimal() or not int(count):
        raise DataError(f"qforbes: terms is a number of terms, 1 or more, got {count!r}")
    kind = pairs.pop("kind", "bfs")
    head = _take(pairs, {"R": "m", "k": "1"}, "qforbes")
    if radius is None:
        raise DataError("a Q form needs the radius of its aperture: qforbes: radius=10 mm, ...")
    norm = parameter_value(radius, "m", "radius")
    return QForbes(**head, kind=kind, coefficients=(None,) * int(count), radius=norm)  # type: ignore[arg-type]


def _expression(rest: str) -> Form:
    from metrosep.forms.expression import Expression

    formula, _, tail = rest.partition(";")
    values: dict[str, float | None] = {}
    for part in filter(None, (p.strip() for p in tail.split(","))):
        key, mark, value = part.partition("=")
        try:
            values[key.strip()] = parameter_value(value, "1", key.strip()) if mark else None
        except UnitError:
            raise DataError(f"expression: {part!r} must be a number in SI") from None
    options: dict[str, Any] = dict(values)
    return Expression(formula.strip(), **options)


_BUILDERS: dict[str, Callable[[dict[str, str]], Form]] = {
    "plane": _simple("conic", "Plane"),
    "sphere": _simple("conic", "Sphere"),
    "cylinder": _simple("conic", "Cylinder"),
    "conic": _simple("conic", "Conic"),
    "asphere": _asphere,
    "toric": _simple("toric", "Toric"),
    "biconic": _simple("toric", "Biconic"),
    "sine_grid": _sine_grid,
    "polynomial": _polynomial,
    "zernike": _zernike,
    "qforbes": _qforbes,
    "expression": lambda _pairs: _expression(""),
}

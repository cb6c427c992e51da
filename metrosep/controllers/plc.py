"""A polynomial as text for a PLC: IEC 61131-3 structured text, or a Turbo PMAC PLC program.

The file computes what is ADDED to the command at a position: ``y = s c(x) + offset`` with the
correction c = -e, whatever the fit states (`PolynomialFit.quantity`), where s = -1 if a positive y
moves the tool against the corrected axis. Position is held at the ends of the domain, as a
polynomial is good for nothing outside of it. Horner form, decimals without exponent, no signs in
front of a coefficient but the first.

Reference: the dual-servo paper, equation 1 (y = a0 + a1 x + a2 x^2, y in um, x in mm, fed to the
machine's controller; its piezo moves against Z).
"""

from __future__ import annotations

import os
import re
import sys
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import legendre

from metrosep.compensation.limits import Finding
from metrosep.compensation.polynomial import PolynomialFit
from metrosep.controllers._facts import facts_of, settled
from metrosep.controllers._grammar import (
    IEC_WORDS,
    Line,
    Text,
    Word,
    damaged,
    decimal,
    decoded,
    joined,
    scaled,
    unscaled,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    load_sidecar,
    one_way,
)
from metrosep.controllers.options import Option, flag, pick, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, LimitError, TableError
from metrosep.core.units import format_ends, format_length

_PLACES = {"m": 0, "mm": 3, "um": 6, "nm": 9}
"""Decimal places from m."""

_FEMTOMETRE = 15
"""Decimals of the domain's ends in m."""

_FARTHEST = 1e6
"""No axis is as long, in m."""

_LARGEST = 1e30
"""Of a term in m: terms may cancel, but beyond this nothing is left of a double's digits."""

_SHORTEST = 1e-9
"""Share of the position that a range must have."""


_POINTS = 2001
_COARSE = 0.1
"""Digits that cost more than this share of the corrections' span are refused."""

_STATED = ("x_unit", "y_unit", "actuator_sign", "offset")
"""Options that are never guessed when a file is read."""

UNSIGNED = r"\d{1,300}(?:\.\d{1,300})?"
"""Decimals without sign and exponent."""

IDENTIFIER = r"[A-Za-z][A-Za-z0-9_]{0,30}"
"""A name of structured text: no underscore in front, at most 31 characters."""

_NUMBER = Word(f"-?{UNSIGNED}", float)
_NAME, _VARIABLE = Word(IDENTIFIER, str.lower), Word(r"P\d{1,4}", str.upper)
_EXPRESSION = Word(".+?")

_COMMON = (
    pick("actuator_sign", "-1 if a positive y moves the tool against the corrected axis (a piezo opposite to Z)", (1, -1), required=True),
    Option("stroke", "largest y that the actuator can do", "length", positive=True),
    flag("unipolar", "the actuator takes no negative y"),
    Option("offset", "constant added to y, so that an actuator can go both ways", "length",
           default=0.0),
    whole("digits", "significant digits of a coefficient", 3, 17, default=9),
    pick("x_unit", "unit of the position in the PLC", ("m", "mm", "um"), default="mm"),
    pick("y_unit", "unit of y in the PLC", ("mm", "um", "nm"), default="um"),
)  # fmt: skip


class _Polynomial(Dialect):
    """What the two texts have in common."""

    options: ClassVar[tuple[Option, ...]] = _COMMON
    comment: ClassVar[tuple[str, str]]
    mantissa: ClassVar[int]
    layout: ClassVar[tuple[Line, ...]]
    """Lines without comments; a word that is in several of them is the same in all."""
    mixed: ClassVar[Mapping[str, str]]
    """Refusal where it is not, by the word."""
    longest: ClassVar[int] = sys.maxsize
    """Characters of a line."""

    @abstractmethod
    def _stated(self, **options: Any) -> dict[str, Any]:
        """Return the words that the options state, checked."""

    def encode(self, table: PolynomialFit, **options: Any) -> Encoded:
        _require_finite(table)
        x_places, y_places = _PLACES[options["x_unit"]], _PLACES[options["y_unit"]]
        sign = options["actuator_sign"] * (-1 if table.quantity == "error" else 1)
        scale = 10.0 ** (y_places - x_places * np.arange(table.degree + 1))
        exact = sign * table.coefficients * scale
        exact[0] += options["offset"] * 10.0**y_places
        low, high = (scaled(round(end, _FEMTOMETRE), x_places) for end in table.domain)
        far = max(abs(float(low)), abs(float(high)))
        share = np.abs(exact) * far ** np.arange(exact.size)
        exact[share < 10.0 ** -(options["digits"] + 3) * share.max()] = 0.0  # less than a digit
        numbers = [decimal(float(c), options["digits"]) for c in exact]
        printed = Printed(np.array([float(n) for n in numbers]), float(low), float(high))
        x = np.linspace(*table.domain, _POINTS)
        y = sign * table.evaluate(x) + options["offset"]
        text = [f"{self.comment[0]} {line} {self.comment[1]}".rstrip() for line in
                _comments(table, options, y)]  # fmt: skip
        low, high, *numbers = (self._number(n) for n in (low, high, *numbers))
        words = {**self._stated(**options), "low": low, "high": high}
        words["polynomial"] = horner(numbers, words["Ph"])
        lines = [line.write(**words) for line in self.layout]
        if max(map(len, lines)) > self.longest:
            raise LimitError(
                f"the expression has {max(map(len, lines))} characters, PMAC takes {self.longest} a line; "
                "use fewer digits= or a lower degree"
            )
        data = joined([*text, *lines])
        series = _exact_legendre(self._read(data, Path(os.devnull), options)[0])
        u = 2.0 * (x - x[0]) / (x[-1] - x[0]) - 1.0
        cost = float(np.abs(legendre.legval(u, series) / 10.0**y_places - y).max())
        rounding = self._rounding(printed) / 10.0**y_places
        return Encoded(
            data=data,
            quantisation=cost,
            findings=tuple(_warnings(y, cost + rounding, options)),
            notes={
                "y_range_m": [float(y.min()), float(y.max())],
                "quantity_of_the_fit": table.quantity,
                "rounding_of_the_controller_m": rounding,
            },
        )

    def _number(self, text: str) -> str:
        """Return a decimal as the language has it."""
        return text

    def _rounding(self, printed: Printed) -> float:
        """Return a bound of what the arithmetic of the controller rounds, in the unit of y."""
        far = max(abs(printed.low), abs(printed.high))
        powers = np.arange(printed.coefficients.size)
        terms = np.abs(printed.coefficients) * far**powers
        return float((2.0 * powers + 2.0) @ terms * 2.0**-self.mantissa)

    def decode(self, data: bytes, path: Path, **options: Any) -> PolynomialFit:
        """Return the correction that the text computes."""
        printed, known = self._read(data, path, options)
        x_places, y_places = _PLACES[known["x_unit"]], _PLACES[known["y_unit"]]
        full = _exact_legendre(printed) / 10.0**y_places
        full[0] -= known["offset"]
        beside = load_sidecar(path).get("table")
        residual = beside.get("residual_rms_m") if isinstance(beside, dict) else None
        return PolynomialFit(
            legendre_coefficients=known["actuator_sign"] * full,
            cov=None,
            cov_source="unknown: the file of a PLC tells none",
            domain=(unscaled(repr(printed.low), x_places), unscaled(repr(printed.high), x_places)),
            quantity="compensation",
            residual_rms=float("nan") if residual is None else float(residual),
            chosen_by="file",
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the controller adds to the corrected axis, with the printed digits."""
        printed, known = self._read(data, path, options)
        x_scale, y_scale = (10.0 ** _PLACES[known[u]] for u in ("x_unit", "y_unit"))

        def at(position: FloatArray) -> FloatArray:
            y = printed.at(position * x_scale) / y_scale
            return np.asarray(known["actuator_sign"] * (y - known["offset"]))

        return one_way(at)

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[Printed, dict[str, Any]]:
        opening, closing = (re.escape(c) for c in self.comment)
        pattern = re.compile(rf"{opening}(.*?){closing or '$'}")
        lines = decoded(data, path, "text of a PLC").splitlines()
        comments = [m[1] for line in lines for m in pattern.finditer(line)]
        code = [
            (i, re.sub(r"\s+", " ", pattern.sub("", line)).strip())
            for i, line in enumerate(lines, start=1)
        ]
        known = settled(self.options, options, path, file=facts_of(comments, path), needed=_STATED)
        printed = self._parsed([(i, text) for i, text in code if text], path)
        _require_usable(printed, known, path)
        return printed, known

    def _parsed(self, code: list[tuple[int, str]], path: Path) -> Printed:
        """Return the polynomial of numbered lines without comments and blanks."""
        text = Text(path, code, "text of a PLC")
        lines = [text.take(line) for line in self.layout]
        text.end()
        words: dict[str, Any] = {}
        for name, value in (pair for found in lines for pair in found.items()):
            if words.setdefault(name, value) != value:
                raise damaged(path, self.mixed[name].format(words[name], value))
        h = words.setdefault("Ph", "h")
        variables = [words[n] for n in ("Ph", "Px", "Py") if n in words]
        if len(set(variables)) < len(variables):
            raise damaged(path, self.mixed["Ph"].format(h))
        series = parsed_horner(words["polynomial"].replace(" ", ""), h)
        if series is None:
            raise damaged(
                path,
                "the expression is not a polynomial in Horner form",
                field="expression",
                expected=f"a0+{h}*(a1+{h}*(a2))",
                found=repr(words["polynomial"][:60]),
            )
        return Printed(series, words["low"], words["high"])


def _require_usable(printed: Printed, known: Mapping[str, Any], path: Path) -> None:
    """Refuse a range that no axis has, and terms that no controller can hold."""
    far = max(abs(printed.low), abs(printed.high))
    within = far / 10.0 ** _PLACES[known["x_unit"]] <= _FARTHEST
    if not (within and printed.high - printed.low > _SHORTEST * far):
        raise damaged(
            path,
            "the range of the position is empty, or longer than any axis",
            field="limits of x",
            expected=f"rising, within {_FARTHEST:g} m",
            found=f"{printed.low:g} ... {printed.high:g}",
        )
    largest = printed.largest_term / 10.0 ** _PLACES[known["y_unit"]]
    if not largest <= _LARGEST:
        raise damaged(
            path,
            "a term of the polynomial is larger than any axis allows",
            field="coefficients",
            expected=f"terms within {_LARGEST:g} m",
            found=f"{largest:g} m",
        )


def _exact_legendre(printed: Printed) -> FloatArray:
    """Return the Legendre coefficients on the range of the text, each rounded only once.

    Powers about a far zero cancel: in floating point the sum lost more than the printed digits.
    """
    low, high = Fraction(printed.low), Fraction(printed.high)
    middle, half = (high + low) / 2, (high - low) / 2
    series = [Fraction(0)]
    for c in printed.coefficients[::-1]:  # Horner: series (middle + half u) + c
        times = [middle * a for a in series] + [Fraction(0)]
        for k, a in enumerate(series):  # (2k+1) u P_k = (k+1) P_(k+1) + k P_(k-1)
            times[k + 1] += half * a * Fraction(k + 1, 2 * k + 1)
            if k:
                times[k - 1] += half * a * Fraction(k, 2 * k + 1)
        series = times
        series[0] += Fraction(float(c))
    return np.array([float(a) for a in series[: printed.coefficients.size]])


def _require_finite(fit: PolynomialFit) -> None:
    if fit.quantity not in ("error", "compensation"):
        raise TableError(
            f"the polynomial states quantity={fit.quantity!r}; it must state 'error' or "
            "'compensation': the sign follows from it"
        )
    if not (np.isfinite(fit.legendre_coefficients).all() and np.isfinite(fit.domain).all()):
        raise TableError(
            "a coefficient or the domain of the polynomial is not finite: fit it again"
        )


def _comments(fit: PolynomialFit, options: Mapping[str, Any], y: FloatArray) -> list[str]:
    against = options["actuator_sign"] < 0
    source = "minus the fitted error" if fit.quantity == "error" else "the fitted correction"
    return [
        "metrosep: y is what is ADDED to the command of the actuator at position x",
        f"the correction of the axis is {source}; a positive y moves the tool "
        + ("AGAINST the axis, so that y is minus the correction" if against else "with the axis"),
        (
            f"x in {options['x_unit']}, held at the ends of its range; y in {options['y_unit']}, "
            f"{format_length(float(y.min()), digits=6)} to {format_length(float(y.max()), digits=6)}"
        ),
        f"x_unit = {options['x_unit']}",
        f"y_unit = {options['y_unit']}",
        f"actuator_sign = {options['actuator_sign']}",
        f"offset = {scaled(options['offset'], 9)} nm",
    ]


def _warnings(y: FloatArray, cost: float, options: Mapping[str, Any]) -> Iterator[Finding]:
    stroke, low, high = options["stroke"], float(y.min()), float(y.max())
    if stroke is not None and max(abs(low), abs(high)) > stroke:
        yield Finding.error(
            f"y reaches {format_ends(low, high)}, the stroke is {format_length(stroke)}",
            "remove alignment from the error, change offset=, or use an actuator with more stroke",
            "stroke",
        )
    if options["unipolar"] and low < 0.0:
        yield Finding.error(
            f"y falls to {format_length(low)}, the actuator takes no negative y",
            f"say offset= of at least {format_length(options['offset'] - low)}",
            "stroke",
        )
    if cost > _COARSE * float(np.ptp(y)) and cost > 0.0:
        yield Finding.error(
            f"printed digits and the controller's arithmetic cost up to {format_length(cost)}, "
            f"the corrections span {format_length(float(np.ptp(y)))}",
            "say more digits=, a lower degree, or put the zero of x near the domain",
            "quantisation",
        )


class PLCStructuredText(_Polynomial):
    """Writer and reader of IEC 61131-3 structured text; see the module."""

    info = DialectInfo(
        id="plc-st",
        title="Polynomial for a PLC, structured text (IEC 61131-3)",
        entry="coefficients of y, which is added to the command: y = actuator_sign * -e + offset",
        units="x in mm, y in um unless said otherwise; named in a comment",
        outside="held at the ends of the domain (LIMIT)",
        sign_status="stated by the user: actuator_sign, no default; y is added by your program",
        activation=(
            "import the file as a function; no library is needed",
            (
                "call it in the motion task with the position of the axis and add what it returns to the "
                "set position, or to the actuator, in the unit its comment names"
            ),
            (
                "before cutting: command a position with a known error and see that the sensor moves "
                "towards zero; if not, actuator_sign is the other one"
            ),
        ),
        sign="stated",
        carries="polynomial",
        directions="one",
        resolution="digits of the coefficients; LREAL arithmetic",
        reference_rule="none: the constant is that of the fit, plus offset",
        suffix=".st",
        example={"actuator_sign": 1},
        page="plc",
    )
    comment = ("(*", "*)")
    mantissa = 53

    options = (
        *_COMMON,
        Option("function", "name of the function", "text", default="MetrosepCorrection"),
    )

    layout = tuple(
        Line(line, loose=True, name=_NAME, unit=Word("", str, " (* {} *)".format), low=_NUMBER,
             high=_NUMBER, polynomial=_EXPRESSION)
        for line in (
            "FUNCTION {name} : LREAL", "VAR_INPUT", "x : LREAL;{unit}", "END_VAR", "VAR", "h : LREAL;",
            "END_VAR", "h := LIMIT({low}, x, {high});", "{name} := {polynomial};", "END_FUNCTION",
        )
    )  # fmt: skip
    mixed: ClassVar[Mapping[str, str]] = {
        "name": "the function {} assigns to {}: it returns nothing"
    }

    def _stated(self, **options: Any) -> dict[str, Any]:
        """Return the name of the function, its variable and its unit."""
        function = options["function"]
        if not re.fullmatch(IDENTIFIER, function) or f" {function.upper()} " in f" X H{IEC_WORDS}":
            raise DataError(
                f"plc-st: function={function!r} is not an identifier that is free: letters, digits and _, no word, "
                "type or function of IEC 61131-3"
            )
        return {"name": function, "Ph": "h", "unit": options["x_unit"]}

    def _number(self, text: str) -> str:
        """Return an LREAL, which has a point."""
        return text if "." in text else f"{text}.0"


class PLCTurboPMAC(_Polynomial):
    """Writer and reader of Turbo PMAC PLC programs; see the module."""

    info = replace(
        PLCStructuredText.info,
        id="plc-pmac",
        title="Polynomial for a Turbo PMAC PLC program",
        outside="held at the ends of the domain",
        activation=(
            (
                "have another program write the position of the axis into the variable of x, in the unit "
                "the comment names"
            ),
            "send the file with a program that strips comments (everything behind a semicolon)",
            "set I5 so that PLC programs run, and ENABLE PLC with the number of the file",
            "list the program back and compare it: PMAC keeps 48-bit floating point numbers",
            (
                "have the actuator's program add the variable of y; before cutting, command a position "
                "with a known error and see that the sensor moves towards zero"
            ),
        ),
        resolution="digits of the coefficients; 48-bit arithmetic",
        suffix=".plc",
    )
    comment = (";", "")
    mantissa = 35

    options = (
        *_COMMON,
        whole("plc", "number of the PLC program", 0, 31, default=10),
        whole("x_variable", "P-variable of x", 0, 8191, default=100),
        whole("y_variable", "P-variable of y", 0, 8191, default=101),
        whole("held_variable", "P-variable for the held position", 0, 8191, default=102),
    )  # fmt: skip

    layout = tuple(
        Line(line, loose=True, n=Word(r"\d{1,2}"), low=_NUMBER, high=_NUMBER, Ph=_VARIABLE, Px=_VARIABLE,
             Py=_VARIABLE, polynomial=Word(".+", str.upper))
        for line in (
            "OPEN PLC~{n} CLEAR", "{Ph}={Px}", "IF~({Ph}<{low})", "{Ph}={low}", "END|IF",
            "IF~({Ph}>{high})", "{Ph}={high}", "END|IF", "{Py}={polynomial}", "CLOSE",
        )
    )  # fmt: skip
    mixed: ClassVar[Mapping[str, str]] = {
        "Ph": "position, {0} and y are mixed up in the program",
        **dict.fromkeys(("low", "high"), "a limit of the position differs from what it is set to"),
    }
    longest = 200  # characters that PMAC surely takes

    def _stated(self, **options: Any) -> dict[str, Any]:
        """Return the variables and the number of the program."""
        names = {k: f"P{options[n]}" for k, n in
                 (("Px", "x_variable"), ("Py", "y_variable"), ("Ph", "held_variable"))}  # fmt: skip
        if len(set(names.values())) < 3:
            raise DataError(
                f"plc-pmac: x, y and the held position need three variables, not {', '.join(names.values())}"
            )
        return {**names, "n": options["plc"]}


# ---- polynomials in Horner form as text, and what the text computes ----------------------------


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

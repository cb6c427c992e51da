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
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import legendre

from metrosep.compensation.limits import Finding
from metrosep.compensation.polynomial import PolynomialFit
from metrosep.controllers._plain_text import ascii_lines, decimal, facts_of, resolved, scaled
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    load_sidecar,
    one_way,
)
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["PLCStructuredText", "PLCTurboPMAC"]

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

_AGAIN = "the file was edited: write it again"

_POINTS = 2001
_COARSE = 0.1
"""Digits that cost more than this share of the corrections' span are refused."""

_TOLD = ("x_unit", "y_unit", "actuator_sign", "offset")
"""Options that are never guessed when a file is read."""

_LINE = 200
"""Characters of a line that PMAC surely takes."""


_COMMON = (
    Option(
        "actuator_sign",
        "-1 if a positive y moves the tool against the corrected axis (a piezo opposite to Z)",
        "choice",
        required=True,
        choices=(1, -1),
    ),
    Option("stroke", "largest y that the actuator can do", "length", positive=True),
    Option("unipolar", "the actuator takes no negative y", "flag", default=False),
    Option("offset", "constant added to y, so that an actuator can go both ways", "length",
           default=0.0),
    Option("digits", "significant digits of a coefficient", "integer", default=9, lowest=3,
           highest=17),
    Option("x_unit", "unit of the position in the PLC", "choice", default="mm",
           choices=("m", "mm", "um")),
    Option("y_unit", "unit of y in the PLC", "choice", default="um", choices=("mm", "um", "nm")),
)  # fmt: skip


class _Polynomial(Dialect):
    """What the two texts have in common."""

    options: ClassVar[tuple[Option, ...]] = _COMMON
    comment: ClassVar[tuple[str, str]]
    mantissa: ClassVar[int]

    @abstractmethod
    def _body(self, numbers: Sequence[str], **options: Any) -> list[str]:
        """Return the lines without comments."""

    @abstractmethod
    def _parsed(self, code: list[tuple[int, str]], path: Path) -> Printed:
        """Return the polynomial of numbered lines without comments and blanks."""

    def encode(self, table: PolynomialFit, **options: Any) -> Encoded:
        """Return the text."""
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
        text += self._body([low, high, *numbers], **options)
        data = ("\n".join(text) + "\n").encode("ascii")
        series = _exact_legendre(self._read(data, Path(os.devnull), options)[0])
        u = 2.0 * (x - x[0]) / (x[-1] - x[0]) - 1.0
        cost = float(np.abs(legendre.legval(u, series) / 10.0**y_places - y).max())
        rounding = self._rounding(printed) / 10.0**y_places
        return Encoded(
            data=data,
            quantisation=cost,
            findings=_doubts(y, cost + rounding, options),
            notes={
                "y_range_m": [float(y.min()), float(y.max())],
                "quantity_of_the_fit": table.quantity,
                "rounding_of_the_controller_m": rounding,
            },
        )

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
            domain=(_metres(printed.low, x_places), _metres(printed.high, x_places)),
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
        lines = ascii_lines(data, path, "text of a PLC")
        comments = [m[1] for line in lines for m in pattern.finditer(line)]
        code = [
            (i, re.sub(r"\s+", " ", pattern.sub("", line)).strip())
            for i, line in enumerate(lines, start=1)
        ]
        known = resolved(options, facts_of(comments, path), path, self.options, _TOLD)
        printed = self._parsed([(i, text) for i, text in code if text], path)
        _require_usable(printed, known, path)
        return printed, known


def _require_usable(printed: Printed, known: Mapping[str, Any], path: Path) -> None:
    """Refuse a range that no axis has, and terms that no controller can hold."""
    far = max(abs(printed.low), abs(printed.high))
    within = far / 10.0 ** _PLACES[known["x_unit"]] <= _FARTHEST
    if not (within and printed.high - printed.low > _SHORTEST * far):
        raise CorruptFileError(
            path,
            "the range of the position is empty, or longer than any axis",
            field="limits of x",
            expected=f"rising, within {_FARTHEST:g} m",
            found=f"{printed.low:g} ... {printed.high:g}",
            hint=_AGAIN,
        )
    largest = printed.largest_term / 10.0 ** _PLACES[known["y_unit"]]
    if not largest <= _LARGEST:
        raise CorruptFileError(
            path,
            "a term of the polynomial is larger than any axis allows",
            field="coefficients",
            expected=f"terms within {_LARGEST:g} m",
            found=f"{largest:g} m",
            hint=_AGAIN,
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


def _metres(value: float, places: int) -> float:
    return float(Decimal(repr(value)).scaleb(-places))


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


def _doubts(y: FloatArray, cost: float, options: Mapping[str, Any]) -> tuple[Finding, ...]:
    found = []
    stroke, low, high = options["stroke"], float(y.min()), float(y.max())
    if stroke is not None and max(abs(low), abs(high)) > stroke:
        found.append(
            Finding(
                "error",
                f"y reaches {format_length(low)} ... {format_length(high)}, the stroke is "
                f"{format_length(stroke)}",
                "remove alignment from the error, change offset=, or use an actuator with more stroke",
                "stroke",
            )
        )
    if options["unipolar"] and low < 0.0:
        found.append(
            Finding(
                "error",
                f"y falls to {format_length(low)}, the actuator takes no negative y",
                f"say offset= of at least {format_length(options['offset'] - low)}",
                "stroke",
            )
        )
    if cost > _COARSE * float(np.ptp(y)) and cost > 0.0:
        found.append(
            Finding(
                "error",
                f"printed digits and the controller's arithmetic cost up to {format_length(cost)}, "
                f"the corrections span {format_length(float(np.ptp(y)))}",
                "say more digits=, a lower degree, or put the zero of x near the domain",
                "quantisation",
            )
        )
    return tuple(found)


def _full(pattern: str, line: tuple[int, str] | None, path: Path, expected: str) -> re.Match[str]:
    """Return the match of a whole line, and refuse another line."""
    text = "" if line is None else line[1]
    match = re.fullmatch(pattern, text, re.IGNORECASE)
    if match is None:
        where = "the end of the file" if line is None else f"line {line[0]}"
        raise CorruptFileError(
            path,
            f"{where} is not what this text holds there",
            expected=expected,
            found=repr(text[:60]),
            hint="write the file again",
        )
    return match


def _matched(
    code: list[tuple[int, str]], rows: Sequence[tuple[str, str]], path: Path
) -> list[re.Match[str]]:
    padded = [*code, *[None] * max(len(rows) - len(code), 0)]
    found = [
        _full(pattern, line, path, expected)
        for (pattern, expected), line in zip(rows, padded, strict=False)
    ]
    if len(code) > len(rows):
        _full("", code[len(rows)], path, "the end of the file")
    return found


def _polynomial(text: str, x: str, path: Path) -> FloatArray:
    found = parsed_horner(text.replace(" ", ""), x)
    if found is None:
        raise CorruptFileError(
            path,
            "the expression is no polynomial in Horner form",
            field="expression",
            expected=f"a0+{x}*(a1+{x}*(a2))",
            found=repr(text[:60]),
            hint=_AGAIN,
        )
    return found


class PLCStructuredText(_Polynomial):
    """Writer and reader of IEC 61131-3 structured text; see the module."""

    info = DialectInfo(
        id="plc-st",
        title="Polynomial for a PLC, structured text (IEC 61131-3)",
        entry="coefficients of y, which is added to the command: y = actuator_sign * -e + offset",
        units="x in mm, y in um unless said otherwise; named in a comment",
        max_points=None,
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

    def _body(self, numbers: Sequence[str], **options: Any) -> list[str]:
        """Return a function of one LREAL."""
        function = options["function"]
        if not re.fullmatch(IDENTIFIER, function) or function.upper() in RESERVED:
            raise DataError(
                f"plc-st: function={function!r} is no identifier that is free: letters, digits and _, no word, "
                "type or function of IEC 61131-3"
            )
        low, high, *coefficients = (n if "." in n else f"{n}.0" for n in numbers)
        return [
            f"FUNCTION {function} : LREAL",
            "VAR_INPUT",
            f"x : LREAL; (* {options['x_unit']} *)",
            "END_VAR",
            "VAR",
            "h : LREAL;",
            "END_VAR",
            f"h := LIMIT({low}, x, {high});",
            f"{function} := {horner(coefficients, 'h')};",
            "END_FUNCTION",
        ]

    def _parsed(self, code: list[tuple[int, str]], path: Path) -> Printed:
        """Return the polynomial of a function that was written here."""
        name = f"({IDENTIFIER})"
        rows = [
            (rf"FUNCTION {name} ?: ?LREAL", "FUNCTION name : LREAL"),
            ("VAR_INPUT", "VAR_INPUT"),
            (r"x ?: ?LREAL ?;", "x : LREAL;"),
            ("END_VAR", "END_VAR"),
            ("VAR", "VAR"),
            (r"h ?: ?LREAL ?;", "h : LREAL;"),
            ("END_VAR", "END_VAR"),
            (
                rf"h ?:= ?LIMIT ?\( ?(-?{UNSIGNED}) ?, ?x ?, ?(-?{UNSIGNED}) ?\) ?;",
                "h := LIMIT(low, x, high);",
            ),
            (rf"{name} ?:= ?(.+?) ?;", "name := polynomial;"),
            ("END_FUNCTION", "END_FUNCTION"),
        ]
        found = _matched(code, rows, path)
        if found[0][1].lower() != found[8][1].lower():
            raise CorruptFileError(
                path,
                f"the function {found[0][1]} assigns to {found[8][1]}: it returns nothing",
                hint=_AGAIN,
            )
        return Printed(_polynomial(found[8][2], "h", path), float(found[7][1]), float(found[7][2]))


class PLCTurboPMAC(_Polynomial):
    """Writer and reader of Turbo PMAC PLC programs; see the module."""

    info = DialectInfo(
        id="plc-pmac",
        title="Polynomial for a Turbo PMAC PLC program",
        entry="coefficients of y, which is added to the command: y = actuator_sign * -e + offset",
        units="x in mm, y in um unless said otherwise; named in a comment",
        max_points=None,
        outside="held at the ends of the domain",
        sign_status="stated by the user: actuator_sign, no default; y is added by your program",
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
        sign="stated",
        carries="polynomial",
        directions="one",
        resolution="digits of the coefficients; 48-bit arithmetic",
        reference_rule="none: the constant is that of the fit, plus offset",
        suffix=".plc",
        example={"actuator_sign": 1},
        page="plc",
    )
    comment = (";", "")
    mantissa = 35

    options = (
        *_COMMON,
        Option("plc", "number of the PLC program", "integer", default=10, lowest=0, highest=31),
        Option("x_variable", "P-variable of x", "integer", default=100, lowest=0, highest=8191),
        Option("y_variable", "P-variable of y", "integer", default=101, lowest=0, highest=8191),
        Option("held_variable", "P-variable for the held position", "integer", default=102,
               lowest=0, highest=8191),
    )  # fmt: skip

    def _body(self, numbers: Sequence[str], **options: Any) -> list[str]:
        """Return a PLC program."""
        names = ("x_variable", "y_variable", "held_variable")
        x, y, h = (f"P{options[n]}" for n in names)
        if len({x, y, h}) < 3:
            raise DataError(f"plc-pmac: x, y and the held position need three variables, not {x}, "
                            f"{y}, {h}")  # fmt: skip
        low, high, *coefficients = numbers
        line = f"{y}={horner(coefficients, h)}"
        if len(line) > _LINE:
            raise LimitError(
                f"the expression has {len(line)} characters, PMAC takes {_LINE} a line; use fewer "
                "digits= or a lower degree"
            )
        return [
            f"OPEN PLC {options['plc']} CLEAR",
            f"{h}={x}",
            f"IF ({h}<{low})",
            f"{h}={low}",
            "ENDIF",
            f"IF ({h}>{high})",
            f"{h}={high}",
            "ENDIF",
            line,
            "CLOSE",
        ]

    def _parsed(self, code: list[tuple[int, str]], path: Path) -> Printed:
        """Return the polynomial of a program that was written here."""
        number, variable = rf"(-?{UNSIGNED})", r"(P\d{1,4})"
        rows = [
            (r"OPEN PLC ?(\d{1,2}) CLEAR", "OPEN PLC n CLEAR"),
            (f"{variable} ?= ?{variable}", "Ph=Px"),
            (rf"IF ?\( ?{variable} ?< ?{number} ?\)", "IF (Ph<low)"),
            (f"{variable} ?= ?{number}", "Ph=low"),
            ("END ?IF", "ENDIF"),
            (rf"IF ?\( ?{variable} ?> ?{number} ?\)", "IF (Ph>high)"),
            (f"{variable} ?= ?{number}", "Ph=high"),
            ("END ?IF", "ENDIF"),
            (f"{variable} ?= ?(.+)", "Py=polynomial"),
            ("CLOSE", "CLOSE"),
        ]
        found = _matched(code, rows, path)
        held = found[1][1].upper()
        if any(found[i][1].upper() != held for i in (2, 3, 5, 6)) or (
            len({held, found[1][2].upper(), found[8][1].upper()}) < 3
        ):
            raise CorruptFileError(
                path,
                f"position, {held} and y are mixed up in the program",
                hint=_AGAIN,
            )
        if float(found[2][2]) != float(found[3][2]) or float(found[5][2]) != float(found[6][2]):
            raise CorruptFileError(
                path,
                "a limit of the position differs from what it is set to",
                hint=_AGAIN,
            )
        return Printed(
            _polynomial(found[8][2].upper(), held, path), float(found[2][2]), float(found[5][2])
        )


# ---- polynomials in Horner form as text, and what the text computes ----------------------------

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


# ---- names of structured text after IEC 61131-3: what is an identifier, and which ones are taken ----

IDENTIFIER = r"[A-Za-z][A-Za-z0-9_]{0,30}"
"""Pattern of a name: no underscore in front, at most 31 characters."""

RESERVED = frozenset(
    [
        "X",
        "H",
        "ACTION",
        "AND",
        "ANY",
        "ARRAY",
        "AT",
        "BEGIN",
        "BY",
        "CASE",
        "CLASS",
        "CONFIGURATION",
        "CONSTANT",
        "CONTINUE",
        "DO",
        "ELSE",
        "ELSIF",
        "END",
        "END_ACTION",
        "END_CASE",
        "END_CLASS",
        "END_CONFIGURATION",
        "END_FOR",
        "END_FUNCTION",
        "END_FUNCTION_BLOCK",
        "END_IF",
        "END_INTERFACE",
        "END_METHOD",
        "END_NAMESPACE",
        "END_PROGRAM",
        "END_REPEAT",
        "END_RESOURCE",
        "END_STEP",
        "END_STRUCT",
        "END_TRANSITION",
        "END_TYPE",
        "END_VAR",
        "END_WHILE",
        "EN",
        "ENO",
        "EXIT",
        "EXTENDS",
        "EXTERNAL",
        "FALSE",
        "FINAL",
        "FOR",
        "FROM",
        "FUNCTION",
        "FUNCTION_BLOCK",
        "F_EDGE",
        "R_EDGE",
        "IF",
        "IMPLEMENTS",
        "INITIAL_STEP",
        "INTERFACE",
        "INTERNAL",
        "JMP",
        "METHOD",
        "MOD",
        "NAMESPACE",
        "NON_RETAIN",
        "NOT",
        "NULL",
        "OF",
        "ON",
        "OR",
        "OVERLAP",
        "OVERRIDE",
        "PERSISTENT",
        "POINTER",
        "PRIORITY",
        "PRIVATE",
        "PROGRAM",
        "PROPERTY",
        "PROTECTED",
        "PUBLIC",
        "READ_ONLY",
        "READ_WRITE",
        "REF",
        "REF_TO",
        "REFERENCE",
        "REPEAT",
        "RESOURCE",
        "RETAIN",
        "RETURN",
        "SINGLE",
        "STEP",
        "STRUCT",
        "SUPER",
        "TASK",
        "THEN",
        "THIS",
        "TO",
        "TRANSITION",
        "TRUE",
        "TYPE",
        "UNION",
        "UNTIL",
        "USING",
        "VAR",
        "VAR_ACCESS",
        "VAR_CONFIG",
        "VAR_EXTERNAL",
        "VAR_GLOBAL",
        "VAR_INPUT",
        "VAR_IN_OUT",
        "VAR_OUTPUT",
        "VAR_STAT",
        "VAR_TEMP",
        "WHILE",
        "WITH",
        "XOR",
        "BOOL",
        "BYTE",
        "CHAR",
        "DATE",
        "DATE_AND_TIME",
        "DINT",
        "DT",
        "DWORD",
        "INT",
        "LDATE",
        "LDT",
        "LINT",
        "LREAL",
        "LTIME",
        "LTOD",
        "LWORD",
        "REAL",
        "SINT",
        "STRING",
        "TIME",
        "TIME_OF_DAY",
        "TOD",
        "UDINT",
        "UINT",
        "ULINT",
        "USINT",
        "WCHAR",
        "WORD",
        "WSTRING",
        "ANY_NUM",
        "ANY_REAL",
        "ANY_INT",
        "ANY_BIT",
        "ABS",
        "ACOS",
        "ADD",
        "ASIN",
        "ATAN",
        "ATAN2",
        "CONCAT",
        "COS",
        "CTD",
        "CTU",
        "CTUD",
        "DELETE",
        "DIV",
        "EQ",
        "EXP",
        "EXPT",
        "FIND",
        "F_TRIG",
        "GE",
        "GT",
        "INSERT",
        "LE",
        "LEFT",
        "LEN",
        "LIMIT",
        "LN",
        "LOG",
        "LT",
        "MAX",
        "MID",
        "MIN",
        "MOVE",
        "MUL",
        "MUX",
        "NE",
        "REPLACE",
        "RIGHT",
        "ROL",
        "ROR",
        "RS",
        "R_TRIG",
        "SEL",
        "SHL",
        "SHR",
        "SIN",
        "SIZEOF",
        "ADR",
        "SQRT",
        "SR",
        "SUB",
        "TAN",
        "TOF",
        "TON",
        "TP",
        "TRUNC",
    ]
)
"""Names that a function of structured text cannot have: words, types, functions and blocks of IEC 61131-3."""

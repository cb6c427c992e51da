"""The grammar of controllers' text: a line is declared once, and printed and strictly read from it.

A line is a template with words in braces; a word says what it looks like, how it is read and how it
is printed. `Text` takes the lines of a file one after the other and refuses what does not belong there
with file, line, what was expected and what was found.

>>> word = Line("N{number}A{axis}P{value}", number=WHOLE, axis=WHOLE, value=INTEGER)
>>> word.write(number=3620, axis=1, value=-40), word.read("N3620A1P-40")["value"]
('N3620A1P-40', -40)
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError

AGAIN = "it was cut short, edited or mixed up: write the table again"


def damaged(path: Path, reason: str, **more: Any) -> CorruptFileError:
    """Return the error of a file that is not as it was written."""
    return CorruptFileError(path, reason, **{"hint": AGAIN, **more})


# ---- numbers as text ----------------------------------------------------------------------------


def fixed(value: float, decimals: int) -> str:
    """Return a decimal without exponent, and without the sign of a zero."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def short(value: float, decimals: int, *, at_least: int = 0) -> str:
    """Return a decimal without exponent and without needless zeros.

    Examples
    --------
    >>> short(0.003, 9), short(5.0, 9, at_least=1)
    ('0.003', '5.0')
    """
    whole, _, rest = fixed(value, decimals).partition(".")
    rest = rest.rstrip("0").ljust(at_least, "0")
    return f"{whole}.{rest}" if rest else whole


def decimal(value: float, digits: int = 17) -> str:
    """Return a number as a decimal without exponent, with the fewest digits up to `digits`.

    Examples
    --------
    >>> decimal(1.2e-7), decimal(-0.0), decimal(4e6)
    ('0.00000012', '0', '4000000')
    """
    return scaled(Decimal(repr(float(value)) if digits >= 17 else f"{value:.{digits}g}"), 0)


def scaled(value: float | Decimal, places: int) -> str:
    """Return a number times ten to a power as an exact decimal without exponent.

    Examples
    --------
    >>> scaled(1e-8, 9)
    '10'
    """
    number = value if isinstance(value, Decimal) else Decimal(repr(float(value)))
    text = format(number.scaleb(places), "f")
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text


def unscaled(text: str, places: int) -> float:
    """Return a printed number over ten to a power: exact, unlike a division."""
    return float(Decimal(text).scaleb(-places))


def mm_text(value: float | Decimal) -> str:
    """Return a length in mm, exact, without exponent."""
    return scaled(value, 3)


def mm_value(text: str) -> float:
    """Return a length that is printed in mm."""
    return unscaled(text, 3)


def deg_text(value: float) -> str:
    """Return an angle in degrees, without exponent, to twelve digits.

    Examples
    --------
    >>> deg_text(math.radians(1e-4)), deg_text(math.tau)
    ('0.0001', '360')
    """
    return decimal(math.degrees(value), 12)


def deg_value(text: str) -> float:
    """Return an angle that is printed in degrees."""
    return math.radians(float(text))


# ---- lines --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Word:
    """A value in a line: what it looks like, how it is read and how it is printed."""

    pattern: str
    read: Callable[[str], Any] = str
    write: Callable[[Any], str] = str


WHOLE = Word(r"\d{1,9}", int)
INTEGER = Word(r"-?\d{1,9}", int)
NUMBER = Word(r"-?\d+(?:\.\d+)?", float)
REAL = Word(r"[+-]?(?:\d+\.?\d*|\.\d+)", float)
MM = Word(r"-?\d+\.?\d*", mm_value, mm_text)
DEG = Word(r"-?\d+\.?\d*", deg_value, deg_text)
SIGN = Word(r"[+-]", lambda w: 1 if w == "+" else -1, lambda v: "+" if v > 0 else "-")
AXIS = Word(r"[A-Z]\d?")


LARGEST = 1e12
"""No position, distance or entry of a file is as large, in any unit."""


def is_real(text: str) -> bool:
    """Return whether a text is a decimal of a size that a file may hold."""
    return bool(re.fullmatch(REAL.pattern, text, re.ASCII)) and abs(float(text)) <= LARGEST


def choice(*values: int) -> Word:
    """Return the word of a few whole numbers."""
    return Word("|".join(map(str, values)), int)


def row_of(word: Word, between: str = " ") -> Word:
    """Return the word of several values with a text between them."""
    one = f"(?:{word.pattern})"
    return Word(
        f"{one}(?:{re.escape(between)}{one})*",
        lambda text: [word.read(w) for w in text.split(between)],
        lambda values: between.join(map(word.write, values)),
    )


class Line:
    """One line of a format; words that are not given are whole numbers.

    A loose one takes capitals and small letters, and blanks before and behind a sign; ``~`` is a blank
    that may be missing, ``|`` one that may be there, what is in ``[]`` may be missing.
    """

    def __init__(self, template: str, *, loose: bool = False, **words: Word) -> None:
        """Take a template such as ``WGC {generator} {cycles}`` and what its words are."""
        parts = re.split(r"\{(\w+)\}", template)
        self.names = parts[1::2]
        self.words = {name: words.get(name, WHOLE) for name in self.names}
        literal = _loose if loose else re.escape
        pattern = "".join(
            f"({self.words[p].pattern})" if i % 2 else literal(p) for i, p in enumerate(parts)
        )
        self.pattern = re.compile(pattern, re.ASCII | (re.IGNORECASE if loose else 0))
        self.template = re.sub(r"[\[\]|]", "", template).replace("~", " ") if loose else template

    def write(self, **values: Any) -> str:
        """Return the line."""
        return self.template.format(**{n: w.write(values[n]) for n, w in self.words.items()})

    def read(self, text: str) -> dict[str, Any] | None:
        """Return the values of a line, None of another one."""
        found = self.pattern.fullmatch(text)
        if found is None:
            return None
        words = zip(self.names, found.groups(), strict=True)
        return {n: None if w is None else self.words[n].read(w) for n, w in words}

    def __str__(self) -> str:
        """Return the line with the names of its words."""
        plain = {"": "", ".*": "..."}
        return self.template.format(**{n: plain.get(w.pattern, n) for n, w in self.words.items()})


def _loose(text: str) -> str:
    """Return the pattern of a text between words, as a person may type it."""
    signs = {"~": r"\s*", "|": r"\s*", " ": r"\s+", "[": "(?:", "]": ")?"}
    parts = re.split(r"( *(?::=|[,;:=()<>]) *)", text)
    return "".join(
        rf"\s*{re.escape(part.strip())}\s*"
        if i % 2
        else "".join(signs.get(c, re.escape(c)) for c in part)
        for i, part in enumerate(parts)
    )


class Text:
    """The lines of a file, taken one after the other."""

    def __init__(self, path: Path, rows: Sequence[tuple[int, str]], what: str, hint: str = AGAIN):
        """Take the numbered lines that count, and what they are lines of."""
        self.path, self.rows, self.what, self.hint, self.at = path, list(rows), what, hint, 0

    def __bool__(self) -> bool:
        """Return whether there are lines left."""
        return self.at < len(self.rows)

    def wrong(self, expected: object, *, ahead: int = 0, hint: str = "") -> CorruptFileError:
        """Return the error of the line that is next."""
        number, found = (
            self.rows[self.at + ahead] if self.at + ahead < len(self.rows) else (0, "the end")
        )
        where = f"line {number}" if number else "the end of the file"
        return CorruptFileError(
            self.path,
            f"{where} is not what belongs there in a {self.what}",
            expected=expected,
            found=repr(found[:60]) if number else "nothing",
            hint=hint or self.hint,
        )

    def take(self, line: Line, **wanted: Any) -> dict[str, Any]:
        """Return the values of the next line, and refuse another one or other values of some words."""
        found = line.read(self.rows[self.at][1]) if self else None
        if found is None or any(found[n] != v for n, v in wanted.items()):
            filled = ", ".join(f"{n} {v}" for n, v in wanted.items())
            raise self.wrong(f"{line}{filled and f' with {filled}'}")
        self.at += 1
        return found

    def many(self, line: Line) -> list[dict[str, Any]]:
        """Return the values of the next lines of this kind, as many as there are."""
        found = []
        while self and (values := line.read(self.rows[self.at][1])) is not None:
            found.append(values)
            self.at += 1
        return found

    def table(self, line: Line, key: str) -> dict[Any, dict[str, Any]]:
        """Return all lines that are left by one of their words, which must differ."""
        found: dict[Any, dict[str, Any]] = {}
        while self:
            values = line.read(self.rows[self.at][1])
            if values is None or values[key] in found:
                raise self.wrong(f"{line}, each {key} once")
            found[values[key]] = {**values, "line": self.rows[self.at][0]}
            self.at += 1
        return found

    def end(self) -> None:
        """Refuse lines that are left."""
        if self:
            raise self.wrong("the end of the file")


def decoded(data: bytes, path: Path, what: str, *, encoding: str = "ascii") -> str:
    """Return the text of a file."""
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as exc:
        name = "ASCII" if encoding == "ascii" else "UTF-8"
        raise CorruptFileError(
            path, f"not {name} text", offset=exc.start, hint=f"this is not a {what}"
        ) from None


def require_last_end(text: str, path: Path) -> None:
    """Refuse a text whose last line has no end: it may have been cut within a number."""
    if not text.endswith(("\n", "\r")):
        raise CorruptFileError(
            path,
            "the last line has no end: the file was cut short",
            hint="write it again; if you typed it yourself, end the last line",
        )


def ascii_lines(data: bytes, path: Path, what: str) -> list[str]:
    """Return the lines of a text, and refuse control characters and one that was cut."""
    text = decoded(data, path, what)
    if re.search(r"[^\t\r\n -~]|\r(?!\n)", text):
        raise CorruptFileError(path, "it holds control characters", hint=f"this is not a {what}")
    require_last_end(text, path)
    return text.replace("\r\n", "\n").split("\n")[:-1]


def code_rows(lines: Iterable[str], mark: str) -> tuple[list[tuple[int, str]], list[str]]:
    """Return the numbered lines without comments and blanks, and the comments behind a mark."""
    rows, comments = [], []
    for number, line in enumerate(lines, start=1):
        code, found, comment = line.partition(mark)
        if found:
            comments.append(comment)
        if code.strip():
            rows.append((number, code.strip()))
    return rows, comments


def joined(lines: Iterable[str], end: str = "\n") -> bytes:
    """Return the bytes of a file."""
    return (end.join(lines) + end).encode("ascii")


# ---- names ----

IEC_WORDS = (
    " ABS ACOS ACTION ADD ADR AND AND_THEN ANY ANY_BIT ANY_INT ANY_NUM ANY_REAL ARRAY ASIN "
    "AT ATAN ATAN2 BEGIN BIT BOOL BY BYTE CAL CASE CHAR CLASS CONCAT CONFIGURATION CONSTANT "
    "CONTINUE COS CTD CTU CTUD DATE DATE_AND_TIME DELETE DINT DIV DO DT DWORD ELSE ELSIF EN "
    "END END_ACTION END_CASE END_CLASS END_CONFIGURATION END_FOR END_FUNCTION "
    "END_FUNCTION_BLOCK END_IF END_INTERFACE END_METHOD END_NAMESPACE END_PROGRAM "
    "END_PROPERTY END_REPEAT END_RESOURCE END_STEP END_STRUCT END_TRANSITION END_TYPE "
    "END_UNION END_VAR END_WHILE ENO EQ EXIT EXP EXPT EXTENDS EXTERNAL FALSE FINAL FIND FOR "
    "FROM FUNCTION FUNCTION_BLOCK F_EDGE F_TRIG GE GT IF IMPLEMENTS INITIAL_STEP INSERT INT "
    "INTERFACE INTERNAL JMP LDATE LDT LE LEFT LEN LIMIT LINT LN LOG LREAL LT LTIME LTOD "
    "LWORD MAX METHOD MID MIN MOD MOVE MUL MUX NAMESPACE NE NON_RETAIN NOT NULL OF ON OR "
    "OR_ELSE OVERLAP OVERRIDE PERSISTENT POINTER PRIORITY PRIVATE PROGRAM PROPERTY PROTECTED "
    "PUBLIC READ_ONLY READ_WRITE REAL REF REFERENCE REF_TO REPEAT REPLACE RESOURCE RET "
    "RETAIN RETURN RIGHT ROL ROR RS R_EDGE R_TRIG SEL SHL SHR SIN SINGLE SINT SIZEOF SQRT SR "
    "STEP STRING STRUCT SUB SUPER TAN TASK THEN THIS TIME TIME_OF_DAY TO TOD TOF TON TP "
    "TRANSITION TRUE TRUNC TYPE UDINT UINT ULINT UNION UNTIL USING USINT VAR VAR_ACCESS "
    "VAR_CONFIG VAR_EXTERNAL VAR_GLOBAL VAR_INPUT VAR_INST VAR_IN_OUT VAR_OUTPUT VAR_STAT "
    "VAR_TEMP WCHAR WHILE WITH WORD WSTRING XOR "
)
"""Words, types, functions and blocks of IEC 61131-3 with the additions of TwinCAT: no name may be one."""


# ---- positions and sizes as they are read --------------------------------------------------------


def require_rising(
    positions: FloatArray, path: Path, what: str, hint: str, first: int = 1
) -> None:
    """Refuse positions that do not rise; `what` names an entry, `first` is the number of the first."""
    falling = np.flatnonzero(np.diff(positions) <= 0)
    if falling.size:
        raise CorruptFileError(
            path, f"{what} {int(falling[0]) + 1 + first}: the position does not rise", hint=hint
        )

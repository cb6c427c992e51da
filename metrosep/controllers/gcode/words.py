"""Words of a G-code block; every byte is kept, so that only what is meant to change changes.

A block is cut into tokens whose texts, joined, are the block again: words (a letter and a number),
comments ``( )`` and ``;``, white space, ``%``, the slash of an optional block. What is none of
these (variables, expressions, control words, decimal commas) is refused by name, because a program
that computes its positions cannot be corrected from its text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError

__all__ = ["Token", "decimals_of", "format_number", "refuse_block", "shape_of", "tokenize"]

Kind = Literal["word", "comment", "space", "percent", "slash", "call"]

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_TOKEN = re.compile(
    r"(?P<comment>\([^()\r\n]*\)|;[^\r\n]*)"
    r"|(?P<call>(?:CYCLE832|COMPCAD|COMPCURV|COMPON|COMPOF|COMPSURF|SOFT|BRISK)\b(?:\s*\([^()\r\n]*\))?)"
    r"|(?P<word>[A-Za-z][ \t]*" + _NUMBER + r")"
    r"|(?P<space>[ \t\r\n\f]+)"
    r"|(?P<percent>%)"
    r"|(?P<slash>/)"
    r"|(?P<program>:\d+)",
    re.IGNORECASE,
)
_COMPUTED = re.compile(
    r"#|\[|=|\$|<|\b(?:IF|WHILE|GOTO|GOTOF|GOTOB|DO\d*|END\d*|FOR|REPEAT|CALL|SUB|ENDSUB|RETURN|PROC"
    r"|DEF|LOOP)\b",
    re.IGNORECASE,
)
_DIGITS = str.maketrans("", "", "0123456789.+-")


@dataclass(frozen=True, slots=True)
class Token:
    """A piece of a block."""

    # {"word", "comment", "space", "percent", "slash", "call"}: what it is; "call" is a named
    # setting of smoothing such as ``CYCLE832(...)``
    kind: Kind
    text: str  # its characters
    start: int  # where it begins in the block
    letter: str = ""  # of a word, upper case; otherwise empty
    number: str = ""  # of a word, as it is written; otherwise empty

    @property
    def value(self) -> float:
        """Number of a word."""
        return float(self.number)

    @property
    def end(self) -> int:
        """Where it ends in the block."""
        return self.start + len(self.text)


def tokenize(block: str, line: int = 0) -> tuple[Token, ...]:
    """Cut a block into tokens whose texts joined are the block.

    Examples
    --------
    >>> [t.text for t in tokenize("N10 g1X1.5(to it)Z-.25")]
    ['N10', ' ', 'g1', 'X1.5', '(to it)', 'Z-.25']
    """
    found: list[Token] = []
    at = 0
    while at < len(block):
        match = _TOKEN.match(block, at)
        if match is None:
            raise _refused(block, at, line)
        kind, text = match.lastgroup, match.group()
        if kind == "word" or kind == "program":
            letter = "O" if kind == "program" else text[0].upper()
            found.append(Token("word", text, at, letter, text[1:].strip()))
        else:
            found.append(Token(kind, text, at))  # type: ignore[arg-type]
        at = match.end()
    _refuse_split_numbers(found, block, line)
    return tuple(found)


def shape_of(block: str) -> str:
    """Return the block without its digits, points and signs.

    Examples
    --------
    >>> shape_of("N10 X1.5 Z-.25")
    'N X Z'
    """
    return block.translate(_DIGITS)


def decimals_of(number: str) -> int:
    """Return how many digits stand after the point.

    Examples
    --------
    >>> decimals_of("-1.250"), decimals_of("3")
    (3, 0)
    """
    return len(number) - number.find(".") - 1 if "." in number else 0


def format_number(value: float, decimals: int) -> str:
    """Return a number with that many digits after the point, never an exponent or minus zero.

    Examples
    --------
    >>> format_number(-4e-9, 6), format_number(1.25, 3)
    ('0.000000', '1.250')
    """
    text = f"{value:.{decimals}f}"
    return text[1:] if text[0] == "-" and not text.strip("-0.") else text


def refuse_block(line: int, what: str, why: str, way_out: str) -> UnsupportedFeatureError:
    """Return the error for a block that cannot be rewritten."""
    return UnsupportedFeatureError(f"line {line}: {what}: {why}; {way_out}")


def _refused(block: str, at: int, line: int) -> Exception:
    rest = block[at:].strip()[:30]
    computed = _COMPUTED.search(block, max(0, at - 8))
    if computed is not None:
        return refuse_block(
            line,
            f"{rest!r}",
            "variables, expressions and control words compute positions that the text does not show",
            "post-process the path to plain numbers",
        )
    if block[at] == ",":
        why = "a comma is neither a decimal point nor a chamfer that can be corrected"
        return refuse_block(line, f"{rest!r}", why, "write numbers with a decimal point")
    return CorruptFileError(
        f"line {line}",
        f"{rest!r} is no word of G-code (a letter and a number)",
        hint="post-process the path to plain words",
    )


def _refuse_split_numbers(tokens: list[Token], block: str, line: int) -> None:
    """Refuse an exponent, which controllers read as a word E."""
    for before, after in pairwise(tokens):
        if after.letter == "E" and before.kind == "word":
            raise refuse_block(
                line,
                before.text + after.text,
                "controllers take no exponents",
                "write the number out",
            )

"""Split one linear move into equal parts along the same line, each with its own correction.

The first part keeps every other word of the block (number, mode, comment); the parts that follow
hold axis words only, the last of them the X and C of the original, digit for digit. In inverse time
(G93) every part carries F times the number of parts, so that the whole takes as long as before.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrosep.controllers.gcode_words import (
    Token,
    decimals_of,
    format_number,
    refuse_block,
    tokenize,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError

__all__ = ["split_block"]

_DEGREE_DIGITS = 7
_FEED_DIGITS = 6
_MODES = frozenset({"0", "00", "1", "01", "93", "94", "95", "90", "21", "20"})


def split_block(
    original: str,
    corrected: str,
    *,
    start: FloatArray,
    end: FloatArray,
    parts: int,
    digits: int,
    inverse_time: bool,
    correct: Callable[[FloatArray, FloatArray], FloatArray],
    line: int,
    rollover: bool = False,
) -> tuple[str, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return the blocks that replace one, and the points that were added."""
    tokens = tokenize(original, line)
    _require_plain(tokens, line)
    words = {t.letter: t for t in tokens if t.kind == "word"}
    if inverse_time and "F" not in words:
        why = "in inverse time (G93) every block needs an F word"
        raise refuse_block(line, "a block to be split", why, "add F")
    share = np.arange(1, parts) / parts
    x, c, z = (start[:, None] + (end - start)[:, None] * share).tolist()
    x_digits = max(digits, decimals_of(words["X"].number) if "X" in words else 0)
    c_digits = max(_DEGREE_DIGITS, decimals_of(words["C"].number) if "C" in words else 0)
    x_text = [format_number(v, x_digits) for v in x]
    c = [v % 360.0 for v in c] if rollover else c
    c_text = [format_number(v, c_digits) for v in c] if "C" in words else []
    x = np.array([float(t) for t in x_text]) if "X" in words else np.full(parts - 1, end[0])
    c = np.array([float(t) for t in c_text]) if "C" in words else np.full(parts - 1, end[1])
    z = np.array(z) + correct(x, c)
    if not np.isfinite(z).all():
        raise InvalidSamplesError(
            f"line {line}: between its ends the move crosses what was not measured (NaN), or leaves the "
            "map; measure it there or shorten the path"
        )
    z_text = [format_number(v, digits) for v in z]
    feed = format_number(words["F"].value * parts, _FEED_DIGITS) if inverse_time else ""
    eol = original[len(original.rstrip("\r\n")) :] or "\n"
    last = {t.letter: t.number for t in tokenize(corrected, line) if t.kind == "word"}
    lower = words["X" if "X" in words else "C" if "C" in words else "Z"].text[0].islower()
    first = {"X": x_text[0], "Z": z_text[0], "F": feed} | ({"C": c_text[0]} if c_text else {})
    blocks = [_first(tokens, {k: v for k, v in first.items() if v}).rstrip("\r\n")]
    blocks += [
        _more(
            {"X": x_text[i], "C": c_text[i] if c_text else "", "Z": z_text[i], "F": feed},
            words,
            lower,
        )
        for i in range(1, parts - 1)
    ]
    final = {k: last.get(k, "") for k in "XC"} | {"Z": last.get("Z", ""), "F": feed}
    if not final["Z"]:  # the end needs no Z of its own, but the points before it have changed Z
        final["Z"] = format_number(float(end[2] + correct(end[:1], end[1:2])[0]), digits)
    blocks.append(_more(final, words, lower))
    text = eol.join(blocks) + original[len(original.rstrip("\r\n")) :]
    return text, (z, x, c, np.full(parts - 1, float(digits)))


def _require_plain(tokens: tuple[Token, ...], line: int) -> None:
    for token in tokens:
        if token.kind in ("space", "comment"):
            continue
        plain = token.letter in "NXCZFS" or (token.letter == "G" and token.number in _MODES)
        if token.kind != "word" or not plain:
            raise refuse_block(
                line,
                token.text,
                "the block has to be split, and this must not happen before its end",
                "put it into a block of its own, or raise the tolerance",
            )


def _first(tokens: tuple[Token, ...], numbers: dict[str, str]) -> str:
    """Return the block with other numbers; Z is added after the last axis word if it has none."""
    letters = {t.letter for t in tokens}
    axis = [i for i, t in enumerate(tokens) if t.letter and t.letter in "XCZ"][-1]
    pieces = []
    for i, token in enumerate(tokens):
        text = token.text
        if token.letter in numbers:
            text = text[: len(text) - len(token.number)] + numbers[token.letter]
        pieces.append(text)
        if i == axis and "Z" not in letters:
            gap = " " if i == 0 or tokens[i - 1].kind == "space" else ""
            pieces.append(gap + ("z" if token.text[0].islower() else "Z") + numbers["Z"])
    return "".join(pieces)


def _more(numbers: dict[str, str], words: dict[str, Token], lower: bool) -> str:
    found = [
        letter + numbers[letter]
        for letter in "XCZF"
        if numbers[letter] and (letter in words or letter == "Z")
    ]
    text = " ".join(found)
    return text.lower() if lower else text

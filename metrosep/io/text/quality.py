"""Words that call a row bad, behind it or in a column of a status, and numbers that mean "not measured".

There is one list of them. What true, no or 1 means depends on the name of its column: no under
``valid`` is bad, under ``outlier`` it is good, under ``coolant`` it says nothing about the row.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.io.text._compiled import different
from metrosep.io.text.dialect import bare_unit, is_other_unit
from metrosep.io.text.encoding import BEYOND

if TYPE_CHECKING:
    from metrosep.io.source import RawFile
    from metrosep.io.text.table import Column

_BAD_TEXT = """
ng nok nio bad wrong error errors err fail failed failure fault faulty outlier outliers reject rejected
invalid void ignore ignored discard discarded delete deleted exclude excluded skip skipped drop dropped
spike glitch artefact artifact suspect uncertain damaged broken scrap alarm overflow overrange
overload saturated saturation clipped lost fehler fehlerhaft ungültig ungueltig ausreisser ausreißer
ausschuss schlecht defekt verworfen gestört störung übersteuert gesättigt alarme faux fausse erreur mauvais
mauvaise invalide aberrant aberrante rejet rejeté rebut saturé errore errato sbagliato scarto scartato
malo mala erróneo erroneo inválido rechazado atípico fallo descartado fout ongeldig fel ogiltig błąd chyba
"""
_BAD = frozenset((*_BAD_TEXT.split(), "doubtful"))
"""Words that call a row bad."""
_OTHER = frozenset(("repeat", "repeated", "redo", "scaled", "times", "double", "doubled", "half"))
"""Words that may make the numbers of a row others than they are."""
_NOT = frozenset(
    (
        "no",
        "not",
        "non",
        "nicht",
        "kein",
        "keine",
        "ohne",
        "mal",
        "pas",
        "niet",
        "ej",
        "nie",
        "ne",
        "without",
    )
)
_GOOD_TEXT = """
ok io good valid pass passed accepted fine trusted usable use used signal reading data measured contact
gültig gueltig gut verwendet verwenden messwert gemessen kontakt valide bon bonne buono buona valido
válido bueno buena geldig giltig goed
"""
_GOOD = frozenset(_GOOD_TEXT.split())
"""Words that call a row good; behind a not they call it bad."""
_BAD_WITHIN = re.compile(
    "無効|不良|異常|外れ|除外|エラー|无效|無效|异常|错|坏|粗大|剔除|不合格|오류|무효|불량|ошиб|неверн|брак|выброс"
)
_GOOD_WITHIN = re.compile("有効|有效|合格|正常|유효|정상|годн|верно")
"""The same where words are not set apart, or have many endings."""
_TRUE = frozenset(
    (
        "true",
        "yes",
        "y",
        "ja",
        "j",
        "wahr",
        "oui",
        "o",
        "vrai",
        "sì",
        "si",
        "sí",
        "s",
        "vero",
        "verdadero",
        "x",
        "1",
        "はい",
        "是",
        "真",
    )
)
_FALSE = frozenset(
    ("false", "no", "n", "nein", "falsch", "non", "faux", "falso", "0", "いいえ", "否", "假")
)
_TRUTH = _TRUE | _FALSE
_CHANGED = _BAD | _OTHER | _NOT | {"falsch"}
"""Words in a remark that may change what its row says."""
_APART = re.compile(r"[^\w/\u00b0%'\u2019]+|_")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_FEW = 4
"""Words of the longest status; what is longer is a text about something."""


def _words(text: str) -> list[str]:
    """Return the words of a text in lower case, n.g. as ng too."""
    plain = unicodedata.normalize("NFKC", text)
    joined = re.sub(r"(?<=\b\w)\.(?=\w\b)", "", plain).replace(".", " ")
    return [w.casefold() for w in _APART.split(joined) if w]


def changes_row(remark: str) -> bool:
    """Whether a remark may change what its row says: by a digit, a unit, or a word that calls it bad."""
    text = unicodedata.normalize("NFKC", remark).strip("#% ")
    words = [w for t in (text, text.replace(".", "")) for w in _APART.split(t) if w]  # n.g. too
    if any(map(str.isdigit, text)) or bare_unit(text) or is_other_unit(text):
        return True
    if _BAD_WITHIN.search(text.casefold()):
        return True
    if any(w.casefold() in _CHANGED for w in words):
        return True
    # "in" is an inch where it stands alone only
    return any(w != "in" and (bare_unit(w) or (len(w) > 1 and is_other_unit(w))) for w in words)


def says_bad(text: str) -> bool:
    """Whether a status calls its row bad; no error and not bad do not."""
    return text.strip().casefold() in BEYOND or _sign(_words(text)) < 0


def truth_of_name(name: str) -> bool | None:
    """Return whether true in a column of this name means a good row; None where it says nothing."""
    sign = _sign(_words(_CAMEL.sub(" ", name)))
    return None if sign == 0 else sign > 0


def is_truth(name: str, values: FloatArray | None) -> bool:
    """Return whether a column of numbers holds only 0 and 1, and its name says which is a good row."""
    return (
        values is not None
        and truth_of_name(name) is not None
        and bool(np.isin(values, (0.0, 1.0)).all())
    )


def _sign(words: Sequence[str]) -> int:
    """Return -1 for words that call a row bad, 1 for good, 0 for neither; a not turns them round."""
    if len(words) > _FEW:
        return 0
    text = " ".join(words)
    bad = any(w in _BAD for w in words) or _BAD_WITHIN.search(text) is not None
    good = any(w in _GOOD for w in words) or _GOOD_WITHIN.search(text) is not None
    turned = any(w in _NOT for w in words) or "free" in words
    sign = -1 if bad else int(good)
    return -sign if turned else sign


def bad_rows(
    name: str, labels: Sequence[str] | None, values: FloatArray | None
) -> tuple[NDArray[np.intp], str]:
    """Return the rows that a column calls bad, and the field of the first."""
    means_good = truth_of_name(name)
    if labels is None:
        if not is_truth(name, values):
            return np.empty(0, dtype=np.intp), ""
        at = np.flatnonzero(values == float(not means_good))
        return at, f"{0 if means_good else 1}"
    kinds = {t: t.strip().strip('"').casefold() for t in different(labels)}
    if {t for t in kinds.values() if t} <= _TRUTH:
        wanted = _FALSE if means_good else _TRUE
        bad = {t for t, plain in kinds.items() if means_good is not None and plain in wanted}
    else:
        bad = {t for t in kinds if says_bad(t)}
    at = np.flatnonzero([t in bad for t in labels]) if bad else np.empty(0, dtype=np.intp)
    return at, labels[at[0]] if at.size else ""


# ---- numbers that mean "not measured": -9999, 99999.99, the limits of converters ----------------
# None is removed, and none is accepted in silence. See ``data_formats/delimited/SPEC.md``.

_MARKERS = frozenset(
    {
        32767.0,
        -32768.0,
        -32767.0,
        65535.0,
        2147483647.0,
        -2147483648.0,
        -2147483647.0,
        4294967295.0,
    }
)
"""Limits of the integers of converters."""
_NULLS = frozenset({-999.25})
"""What logs of wells write for "not measured": reported also where it stands once."""
_BEYOND = 1e20
_FAR = 5.0
"""A value of marker shape further away than so many times the spread of the others is refused."""
_VERY_FAR = 20.0
"""Any value that repeats exactly, so at least twice, and is further away than that is reported."""
_REPEATED = 2
_NEAR = 0.5
"""A value of marker shape that repeats is reported from so many spreads on: numbers of a measurement
leave no gap of half their spread below an extreme that two of them share to the last digit."""


def _has_marker_shape(value: float) -> bool:
    digits = f"{abs(value):.12g}".replace(".", "")
    nines = len(digits) >= 3 and set(digits) == {"9"}
    return nines or value in _MARKERS or abs(value) >= _BEYOND


def marker_of(values: FloatArray) -> tuple[float, float, bool] | None:
    """Return a value that means "not measured", its distance in spreads, and whether that is sure.

    Extremes of the shape of a marker are set aside in turn; what is left tells the spread R. Such a
    value further than 5 R away is sure; one that repeats, beyond 0.5 R, and any other that repeats,
    beyond 20 R, are not.
    """
    ends = (values.max(initial=0.0), values.min(initial=0.0))  # NaN where any value is
    rest = values if np.isfinite(ends).all() else values[np.isfinite(values)]
    most = rest.size / 2
    aside: list[float] = []
    near: tuple[float, float, bool] | None = None
    while rest.size >= _FEWEST_LEFT:
        extremes = (float(rest.max()), float(rest.min()))
        counts = {e: int(np.count_nonzero(rest == e)) for e in extremes}
        shaped = [e for e in extremes if _has_marker_shape(e) and counts[e] <= most]
        if not shaped or len(aside) == _MOST_MARKERS:
            repeated = [
                e
                for e in extremes
                if (counts[e] >= _REPEATED or e in _NULLS) and counts[e] <= most
            ]
            found = next((e for e in repeated if _distance(e, rest[rest != e]) > _VERY_FAR), None)
            return near if found is None else (found, _distance(found, rest[rest != found]), False)
        aside.append(shaped[0])
        rest = rest[rest != shaped[0]]
        for value in aside:
            if (ratio := _distance(value, rest)) > _FAR:
                return value, ratio, True
            if ratio > _NEAR and near is None and np.count_nonzero(values == value) > 1:
                near = (value, ratio, False)
    return near


_FEWEST_LEFT = 3
_MOST_MARKERS = 4


def _distance(value: float, rest: FloatArray) -> float:
    """Return how many times the spread of the others a value lies away; 0 where they hardly differ."""
    if rest.size < _FEWEST_LEFT or np.unique(rest[:1000]).size < _FEWEST_LEFT:
        return 0.0
    low, high = float(rest.min()), float(rest.max())
    return min(abs(value - low), abs(value - high)) / (high - low)


_MOST_RANGES = 100
"""Groups of lines that a message names; nobody types more of them."""


def marked_bad(file: RawFile, columns: Sequence[Column], lines: NDArray[np.int64]) -> list[str]:
    """Return a warning for each column that calls some rows bad; they are read like the others."""
    found = []
    for column in columns:
        if column.unit is not None:
            continue
        at, text = bad_rows(column.name, column.labels, column.values)
        if not at.size:
            continue
        said = (
            f"column {column.name!r} says {text!r} in {at.size} row(s) (first: line {int(lines[at[0]])}), which "
            "were read like the others; "
        )
        if at.size == len(lines):
            found.append(f"{said}that is every row: ask what it means before you use the numbers")
            continue
        most = (
            "if that means that these were not measured well, " if 2 * at.size > len(lines) else ""
        )
        first = np.flatnonzero(np.diff(at, prepend=-2) > 1)
        if first.size > _MOST_RANGES:
            found.append(f"{said}{most}delete these rows in the file, {first.size} groups of them")
            continue
        found.append(f"{said}{most}leave them out with {file.without_lines(*lines[at].tolist())}")
    return found


def where_it_turns(file: RawFile, positions: FloatArray, lines: NDArray[np.int64]) -> str:
    """Return which lines to omit where positions turn or repeat, for a message."""
    steps = np.sign(np.diff(positions))
    if not steps.size or not steps[0] or lines.size != positions.size or np.isnan(steps).any():
        return ""
    wrong = np.flatnonzero(steps != steps[0])
    if not wrong.size:
        return ""
    first, rest = wrong[0] + 1, steps[wrong[0] + 1 :]
    is_back = rest.size > 0 and rest[0] != steps[0] and np.ptp(rest) == 0
    if (
        is_back and 2 * first >= lines.size
    ):  # else most of the rows are what is called the way back
        out = np.arange(first, lines.size)
        what = "what follows, the way back,"
    else:  # what does not lie beyond all before it, or, where that is less, before all behind it
        way = positions if np.sum(steps) > 0 else -positions
        least = np.minimum.accumulate(way[::-1])[::-1]
        turned = (way[1:] <= np.maximum.accumulate(way)[:-1], way[:-1] >= least[1:])
        found = [np.flatnonzero(t) + k for t, k in zip(turned, (1, 0), strict=True)]
        out = min(found, key=len)
        what = "that line" if out.size == 1 else f"the {out.size} lines that turn back or repeat"
    line = lines[first if len(out) > 1 else out[0]]
    option = file.without_lines(*lines[out].tolist())
    return f" (line {int(line)}); leave {what} out with {option}"

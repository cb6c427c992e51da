"""Tables in every dialect with one habit or one damage: the same values, or the line is named.

The truth is known by construction: the numbers are `float` of the digits that were written, the
line of the damage is where it was put. No reader of ours takes part in making a file.
"""

import random
import re

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.check import check_file
from metrosep.io.stream import open_stream

UM = 1e-6
CASES = 12
"""Dialects that are drawn for each damage."""
MANY = 220
"""The same for the ten thousand files of `make test-slow`."""
NAMES = {
    "en": [("x", "z"), ("Position", "Height"), ("travel", "error"), ("Target", "Reading")],
    "de": [("Position", "Abweichung"), ("Strecke", "Höhe"), ("Verfahrweg", "Messwert")],
    "fr": [("position", "écart"), ("abscisse", "erreur"), ("course", "rectitude")],
    "it": [("posizione", "scostamento"), ("corsa", "rettilineità")],
    "es": [("posición", "desviación"), ("recorrido", "altura")],
    "zh": [("位置", "偏差"), ("距离", "高度"), ("行程", "误差")],
    "ja": [("位置", "偏差"), ("距離", "高さ"), ("座標", "誤差")],
}


class Drawn:
    """A table as lines, with what a reader must make of it."""

    def __init__(self, seed, *, recording=False):
        draw = self.draw = random.Random(seed)  # noqa: S311  a reproducible draw, no secret
        self.separator = draw.choice([",", ";", "\t", " ", "|"])
        self.decimal = draw.choice([".", "."] + ([","] if self.separator != "," else []))
        language = draw.choice(list(NAMES)) if not recording else "en"
        page = {"zh": "gb18030", "ja": "cp932"}.get(language, "cp1252")
        self.encoding = draw.choice(["utf-8", "utf-8-sig", "utf-16", page])
        self.end = draw.choice(["\n", "\r\n", "\r"])
        self.quote = '"' if draw.random() < 0.3 else ""
        self.form = draw.choice(["{:.4f}", "{!r}", "{:.5e}"])
        n = draw.randint(24, 70)
        self.first, self.second = ("t", "z") if recording else draw.choice(NAMES[language])
        self.first_unit = "s" if recording else "mm"
        x = [round(0.05 * (i + 1), 6) for i in range(n)]
        z = [round(draw.gauss(0.0, 3.0), 4) for _ in range(n)]
        self.swapped = draw.random() < 0.5 and not recording
        pairs = [(self.number(a), self.number(b)) for a, b in zip(x, z, strict=True)]
        self.rows = [self.row(*p) for p in pairs]
        self.x = [float(a.replace(",", ".")) for a, _ in pairs]
        self.z = [float(b.replace(",", ".")) for _, b in pairs]
        self.pairs = pairs
        self.top = self.header()
        self.bottom = []
        self.closed = True

    def number(self, value):
        return self.form.format(value).replace(".", self.decimal)

    def row(self, *fields):
        fields = fields[::-1] if self.swapped else fields
        return self.separator.join(f"{self.quote}{f}{self.quote}" for f in fields)

    def header(self):
        style = self.draw.choice(["suffix", "bracket", "rows"])
        if self.separator == " ":
            style = "suffix"
        units = [self.first_unit, "um"]
        if style == "rows":
            return [self.row(self.first, self.second), self.row(*units)]
        mark = "{}_{}" if style == "suffix" else "{} [{}]"
        return [self.row(mark.format(self.first, units[0]), mark.format(self.second, units[1]))]

    def line(self, row):
        """Line of a row in the file, from 1."""
        return len(self.top) + row + 1

    def anywhere(self):
        return self.draw.randint(2, len(self.rows) - 3)

    def write(self, folder):
        path = folder / "table.csv"
        text = "\n".join([*self.top, *self.rows, *self.bottom]) + "\n" * self.closed
        path.write_bytes(text.replace("\n", self.end).encode(self.encoding))
        return path


def one_more_separator(t):
    t.rows[t.anywhere()] += t.separator


def more_separators_in_the_first_rows(t):
    k = t.anywhere()
    t.rows[:k] = [r + t.separator for r in t.rows[:k]]


def more_separators_in_the_last_rows(t):
    k = t.anywhere()
    t.rows[k:] = [r + t.separator for r in t.rows[k:]]


def separators_at_every_end(t):
    t.rows = [r + t.separator for r in t.rows]
    t.top = [r + t.separator for r in t.top]


def names_repeated(t):
    t.rows.insert(t.anywhere(), t.top[0])


def header_repeated_whole(t):
    k = t.anywhere()
    t.rows[k:k] = t.top


def comment_inside(t):
    t.rows.insert(t.anywhere(), "# pause 0.5, 1.5")


def blank_line_inside(t):
    t.rows.insert(t.anywhere(), "")


def blank_lines_at_the_end(t):
    t.bottom = ["", ""]


def text_below(t):
    t.bottom = ["end of measurement"]


def mean_below(t):
    t.bottom = [t.separator.join(["Mean", t.number(0.3125)])]


def declaration_above(t):
    if t.separator != " ":
        t.top.insert(0, f"sep={t.separator}")


def comment_above(t):
    t.top[:0] = ["# made on a Monday", "% by hand"]


def titles_above(t):
    t.top[:0] = t.draw.choice(
        [
            ["Instrument: probe 7", "Date: 2026-03-05", "Operator: M. Smith"],
            ["Machine;M3", "Sclr,0.156", "Serial 4711"],
            ["Straightness of the X axis", "Company Ltd", "Part no. 12-77"],
        ]
    )


def units_repeated(t):
    if len(t.top) == 2:
        t.rows.insert(t.anywhere(), t.top[1])


def words_in_rules_below(t):
    t.bottom = ["--- end ---"]


def remark_behind_a_row(t):
    t.rows[t.anywhere()] += " # operator leaned on the table"


def thousands_marked(t):
    """From 985 to beyond 1,000 by steps of 5; a comma between fields leaves no mark for groups."""
    other = {".": ",", ",": "."}[t.decimal]
    if t.separator == other and not t.quote:
        return
    t.z = [985.0 + 5 * i for i in range(len(t.rows))]
    texts = [f"{v:.0f}" if v < 1000 else f"1{other}{v - 1000:03.0f}" for v in t.z]
    t.rows = [t.row(a, text) for (a, _), text in zip(t.pairs, texts, strict=True)]


def row_of_separators(t):
    if t.separator != " ":
        k = t.anywhere()
        t.rows[k] = t.separator
        del t.x[k], t.z[k]


def unicode_minus(t):
    if t.encoding.startswith("utf"):
        t.rows = [r.replace("-", "\u2212") for r in t.rows]


def nothing(_t):
    pass


def _missing(word):
    def damage(t):
        k = t.anywhere()
        if word or t.quote or t.separator != " ":
            t.rows[k] = t.row(t.pairs[k][0], word)
            t.z[k] = np.nan

    damage.__name__ = f"missing_{word or 'empty'}"
    return damage


def _refused(change):
    """Make a damage from a change of one row; the line of it must be named."""

    def damage(t):
        k = t.anywhere()
        t.rows[k] = change(t, k)
        return t.line(k)

    damage.__name__ = change.__name__
    return damage


@_refused
def field_lost(t, k):
    return t.number(t.x[k])


@_refused
def field_too_many(t, k):
    return t.rows[k] + t.separator + t.number(1.5)


@_refused
def first_separator_doubled(t, k):
    twice = t.separator * 2 if t.separator != " " else f" {t.number(1.0)} "
    return t.rows[k].replace(t.separator, twice, 1)


@_refused
def text_inside(_t, _k):
    return "operator changed the part"


@_refused
def letter_for_zero(t, k):
    return t.row(t.number(t.x[k]), "1.O5")


@_refused
def letter_in_the_first_field(t, k):
    return t.row(t.number(t.x[k]), t.number(1.0)).replace("1", "l", 1).replace("0", "O", 1)


@_refused
def other_decimal_mark(t, _k):
    other = {".": ",", ",": "."}[t.decimal]
    return t.row(t.number(7.5), f"1{other}25")


@_refused
def odd_quote(t, k):
    return t.rows[k] + '"'


@_refused
def unknown_word(t, k):
    return t.row(t.number(t.x[k]), "E4711")


@_refused
def saturated(t, k):
    return t.row(t.number(t.x[k]), "99999" + t.decimal + "99")


@_refused
def far_marker(t, k):
    return t.row(t.number(t.x[k]), "1e99")


def other_units_inside(t):
    k = t.anywhere()
    t.rows.insert(k, t.row("in", "nm"))
    return t.line(k)


def other_names_inside(t):
    k = t.anywhere()
    t.rows.insert(k, t.row("q_mm", "w_um"))
    return t.line(k)


def marker_in_every_seventh_row(t):
    for k in range(3, len(t.rows), 7):
        t.rows[k] = t.row(t.number(t.x[k]), "-9999")
    return t.line(3)


def cut_in_the_last_row(t):
    t.rows[-1] = t.rows[-1][:3]
    t.closed = False
    return t.line(len(t.rows) - 1)


SAME = [
    nothing, one_more_separator, more_separators_in_the_first_rows,
    more_separators_in_the_last_rows, separators_at_every_end, names_repeated,
    header_repeated_whole, comment_inside, blank_line_inside, blank_lines_at_the_end, text_below,
    mean_below, declaration_above, comment_above, unicode_minus, _missing("nan"), _missing("N/A"),
    _missing("#N/A"), _missing("#NV"), _missing("---"), _missing("nodata"), _missing("overflow"),
    _missing("inf"), _missing("OL"), _missing(""), titles_above, units_repeated,
    words_in_rules_below, remark_behind_a_row, thousands_marked, row_of_separators,
]  # fmt: skip
REFUSED = [
    field_lost, field_too_many, first_separator_doubled, text_inside, letter_for_zero,
    letter_in_the_first_field, other_decimal_mark, odd_quote, unknown_word, saturated, far_marker,
    other_units_inside, other_names_inside, marker_in_every_seventh_row, cut_in_the_last_row,
]  # fmt: skip
EITHER = {more_separators_in_the_first_rows, more_separators_in_the_last_rows}
"""Which rows are the odd ones follows from where the change lies."""
WARNED = {
    one_more_separator, names_repeated, header_repeated_whole, text_below, mean_below,
    words_in_rules_below, remark_behind_a_row,
}  # fmt: skip
BEYOND = ("overflow", "inf", "OL")
EITHER |= {
    units_repeated,
    thousands_marked,
    row_of_separators,
    *(d for d in SAME if d.__name__[8:] in BEYOND),
}


def streamed(path):
    with open_stream(path) as stream:
        parts = list(stream.chunks(20))
        return {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}, stream


def close_to(found, expected, unit):
    np.testing.assert_array_equal(np.asarray(found), np.array(expected) * unit)


@pytest.mark.parametrize("damage", SAME, ids=lambda d: d.__name__)
@pytest.mark.parametrize("seed", range(CASES))
def test_a_habit_of_writing_changes_no_value_and_loses_no_row(tmp_path, damage, seed):
    table = Drawn(f"{damage.__name__} {seed}")
    damage(table)
    path = table.write(tmp_path)

    profile = ms.read(path)
    (run,) = ms.read_runs(path, x=f"{table.first}:mm", z=f"{table.second}:um")

    close_to(profile.x, table.x, 1e-3)
    close_to(profile.z, table.z, UM)
    assert any(n.startswith(table.second) for n in profile.metadata["header"]["columns"])
    close_to(run.z, table.z, UM)
    lines = profile.metadata["lines"]
    n_lines = len(table.top) + len(table.rows) + len(table.bottom)
    assert lines["data"] == len(table.z) + (damage is row_of_separators and table.separator != " ")
    assert sum(n for k, n in lines.items() if k not in ("total", "listed")) == n_lines
    said = " ".join(profile.metadata["warnings"])
    is_odd = damage in WARNED and not (table.separator == " " and "separator" in damage.__name__)
    assert ("line " in said) == is_odd or damage in EITHER
    assert not [f for f in check_file(path) if f.level == "error"]


@pytest.mark.parametrize("damage", SAME, ids=lambda d: d.__name__)
@pytest.mark.parametrize("seed", range(4))
def test_a_long_recording_is_read_in_chunks_with_the_same_values(tmp_path, damage, seed):
    table = Drawn(f"{damage.__name__} {seed} stream", recording=True)
    table.encoding = "utf-8" if table.encoding == "utf-16" else table.encoding
    damage(table)
    if damage is row_of_separators:
        pytest.skip("a clock without a time is refused where it is streamed")
    path = table.write(tmp_path)

    chunks, stream = streamed(path)
    whole = ms.read(path)

    name = next(n for n in chunks if n.startswith("z"))
    close_to(chunks[name], table.z, UM)
    close_to(whole[name], table.z, UM)
    assert len(stream.warnings) == len(whole.metadata["warnings"])


@pytest.mark.parametrize("damage", REFUSED, ids=lambda d: d.__name__)
@pytest.mark.parametrize("seed", range(CASES))
def test_a_damaged_row_is_named_by_its_line(tmp_path, damage, seed):
    table = Drawn(f"{damage.__name__} {seed}", recording=seed % 4 == 3)
    table.encoding = "utf-8" if table.encoding == "utf-16" else table.encoding
    line = damage(table)
    path = table.write(tmp_path)
    first = f"{table.first}:{table.first_unit}"

    doors = [
        lambda: ms.read(path),
        lambda: (
            ms.read_runs(path, x="z:um", z="z:um", time=first)
            if table.first == "t"
            else ms.read_runs(path, x=first, z=f"{table.second}:um")
        ),
        lambda: streamed(path),
    ]
    for door in doors:
        with pytest.raises(ms.errors.MetrosepError) as caught:
            door()
        assert re.search(rf"\bline {line}\b", str(caught.value)), str(caught.value)
    (finding,) = check_file(path)
    assert finding.level == "error"
    assert re.search(rf"\bline {line}\b", f"{finding.problem} {finding.fix}")


@pytest.mark.slow
@pytest.mark.parametrize("damage", [*SAME, *REFUSED], ids=lambda d: d.__name__)
def test_of_ten_thousand_files_none_is_read_wrong_in_silence(tmp_path, damage):
    wrong = []
    for seed in range(MANY):
        table = Drawn(f"{damage.__name__} {seed} of many")
        line = damage(table)
        path = table.write(tmp_path)
        try:
            profile = ms.read(path)
        except ms.errors.MetrosepError as error:
            if damage in SAME or re.search(rf"\bline {line}\b", str(error)) is None:
                wrong.append((seed, str(error)))
            continue
        x, z = np.array(table.x) * 1e-3, np.array(table.z) * UM
        is_same = np.array_equal(profile.x, x) and np.array_equal(profile.z, z, equal_nan=True)
        if damage in REFUSED or not is_same:
            wrong.append((seed, path.read_bytes()[:200]))
    assert wrong == []

"""Cells without a value, as spreadsheets and people of seven languages write them, wherever they stand in a row."""

import math

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.source import open_file
from metrosep.io.text.table import read_table

N = 40
X = [0.25 * k for k in range(N)]
Z = [round(1.7 * math.sin(0.37 * k) + 0.03 * k, 4) for k in range(N)]
TIGHT = 1e-15
"""Metres: far below a digit that the files hold."""
AT = 7
"""Row without a reading; it stands in line 9."""

ERRORS = {
    "German": ["#NV", "#WERT!", "#BEZUG!", "#ZAHL!", "#NAME?"],
    "French": ["#N/A", "#VALEUR!", "#NOM?", "#NOMBRE!", "#NUL!"],
    "Italian": ["#N/D", "#VALORE!", "#RIF!", "#NOME?", "#NULLO!"],
    "Spanish": ["#N/D", "#¡VALOR!", "#¡REF!", "#¿NOMBRE?", "#¡NUM!", "#¡NULO!", "#¡DIV/0!"],
    "new functions and other programs": ["#CALC!", "#SPILL!", "#ERROR!", "#FIELD!", "Err:502"],
}
WORDS = [
    "--.---", "**.**", "--,--", "＊＊＊", "–", "—", "－－－",
    "ungültig", "k.A.", "n.d.", "invalide", "non valide", "mancante", "no válido", "s/d",
    "无", "缺失", "无效", "欠測", "欠損", "無効", "なし",
]  # fmt: skip
LAYOUTS = {
    "heights first": ("z [um];x [mm]", lambda x, z: f"{z};{x}"),
    "heights first, tabs": ("z [um]\tx [mm]", lambda x, z: f"{z}\t{x}"),
    "heights first, quotes": ('"z [um]","x [mm]"', lambda x, z: f'"{z}","{x}"'),
    "heights last": ("x [mm];z [um]", lambda x, z: f"{x};{z}"),
}


def rows(layout, word):
    top, row = LAYOUTS[layout]
    zipped = enumerate(zip(X, Z, strict=True))
    return "\n".join([top, *(row(x, word if k == AT else z) for k, (x, z) in zipped)]) + "\n"


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("word", [*sorted({w for own in ERRORS.values() for w in own}), *WORDS])
def test_a_cell_without_a_value_is_nan_in_any_column(put, word, layout):
    found = ms.read(put(rows(layout, word)))

    z = [math.nan if k == AT else 1e-6 * v for k, v in enumerate(Z)]
    np.testing.assert_allclose(found.x, [1e-3 * v for v in X], rtol=0.0, atol=TIGHT)
    np.testing.assert_allclose(found.z, z, rtol=0.0, atol=TIGHT)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("word", ["#####", "#NEVER!"])
def test_a_cell_that_no_list_knows_is_refused_with_its_line(put, word, layout):
    """A cell of a spreadsheet that is too narrow for its number is printed as ####."""
    with pytest.raises(ms.errors.ReadError, match="line 9.*" + word):
        ms.read(put(rows(layout, word)))


@pytest.mark.parametrize("mark", ["%", "#", "!", "//"])
def test_the_mark_of_a_comment_in_the_place_of_a_number_is_reported(put, mark):
    found = ms.read(put(rows("heights first", mark)))

    assert found.z.size == N - 1
    assert "(first: line 9) begin with the mark of a comment" in " ".join(
        found.metadata["warnings"]
    )


def test_a_comment_between_numbers_that_blanks_separate_is_one(put):
    text = "x_mm z_um\n" + "".join(
        f"{x} {z}\n" + "# 5\n" * (k == AT) for k, (x, z) in enumerate(zip(X, Z, strict=True))
    )
    found = ms.read(put(text))

    assert found.z.size == N
    assert found.metadata["warnings"] == ()


@pytest.mark.parametrize(
    ("top", "mark"),
    [
        (";Abweichung [µm]", ";"),
        (";Abweichung µm", ";"),
        (";z_um", ";"),
        ("\tz [um]", "\t"),
        (",z [um]", ","),
        (" ; z [um]", " ; "),
    ],
)
def test_names_behind_a_column_without_one_are_those_of_the_others(put, top, mark):
    path = put("\n".join([top, *(f"{x}{mark}{z}" for x, z in zip(X, Z, strict=True))]) + "\n")

    with pytest.raises(ms.errors.UnitError, match=r"column 'column1' \(x\) declares no unit"):
        ms.read(path)
    found = ms.read(path, x="column1:mm")
    np.testing.assert_allclose(found.x, [1e-3 * v for v in X], rtol=0.0, atol=TIGHT)
    np.testing.assert_allclose(found.z, [1e-6 * v for v in Z], rtol=0.0, atol=TIGHT)


def test_a_number_of_rows_without_a_name_between_blanks_and_semicolons(put):
    rows_of_three = (f"{k} ; {x} ; {z}" for k, (x, z) in enumerate(zip(X, Z, strict=True)))
    found = ms.read(put("\n".join([" ; x [mm] ; z [um]", *rows_of_three]) + "\n"))

    np.testing.assert_allclose(found.x, [1e-3 * v for v in X], rtol=0.0, atol=TIGHT)
    np.testing.assert_allclose(found.z, [1e-6 * v for v in Z], rtol=0.0, atol=TIGHT)


def numbers_in_groups(mark):
    top = "{}(μm);{}(nm)"
    row = lambda k: f"{10 * k:,d};{1400 + k / 8:,.3f}".replace(",", mark).replace(".", ",")  # noqa: E731
    return top, [row(k) for k in range(300)]


@pytest.mark.parametrize(("x", "z"), [("位置", "高度"), ("x", "z")])
@pytest.mark.parametrize("mark", ["\u00a0", "\u202f"])
def test_groups_of_thousands_of_a_chinese_program(put, x, z, mark):
    """In GB18030 a blank between groups has four bytes, and two of them are digits."""
    top, rows_of_both = numbers_in_groups(mark)
    top = top.format(x, z) if x == "位置" else "x_um;z_nm"
    found = ms.read(put("\n".join([top, *rows_of_both, ""]).encode("gb18030")))

    np.testing.assert_allclose(found.x, [1e-5 * k for k in range(300)], rtol=0.0, atol=TIGHT)
    z = [1e-9 * (1400 + k / 8) for k in range(300)]
    np.testing.assert_allclose(found.z, z, rtol=0.0, atol=TIGHT)


@pytest.mark.parametrize("encoding", ["gb18030", "cp932", "utf-8"])
def test_dates_of_chinese_and_japanese_spreadsheets(put, encoding):
    names = "时间;电压(V)" if encoding == "gb18030" else "時刻;プローブ(V)"
    rows_of_both = [f"2026年3月5日 23:59:{59 - 39 + k:02d}.500;{z}" for k, z in enumerate(Z)]
    found = ms.read(put("\n".join([names, *rows_of_both, ""]).encode(encoding)))

    (values,) = found.channels.values()
    assert values.tolist() == Z
    np.testing.assert_allclose(np.diff(found.t), 1.0, rtol=0.0, atol=1e-12)  # s; stamps are of ns


@pytest.mark.parametrize(
    ("names", "encoding"),
    [
        ("Weg [mm];Höhe [µm]", "cp850"),
        ("Позиция, мм;Высота, мкм", "koi8_r"),
        ("位置[mm];高さ[μm]", "iso2022_jp"),
    ],
)
def test_the_encoding_that_the_message_names_reads_the_units(put, names, encoding):
    rows_of_both = (f"{x};{z}" for x, z in zip(X, Z, strict=True))
    path = put("\n".join([names, *rows_of_both, ""]).encode(encoding))

    with pytest.raises(ms.errors.UnitError, match=f"give encoding='{encoding}'"):
        ms.read(path)
    found = ms.read(path, encoding=encoding)
    np.testing.assert_allclose(found.z, [1e-6 * v for v in Z], rtol=0.0, atol=TIGHT)


@pytest.mark.parametrize("written", ["({})", "{}-", "- {}", "\u2212\u2009{}", "\u00ad{}", "{} -"])
def test_a_minus_of_bookkeepers_is_not_offered_as_missing(put, written):
    """Who followed such a hint would lose each number below zero, and no other."""
    text = rows("heights last", written.format("0.25"))

    with pytest.raises(ms.errors.ReadError, match=r"line 9.*write it as -0\.25") as caught:
        ms.read(put(text))
    assert "missing=" not in str(caught.value)


SUMMARY = "Ra [um];Rz [um]\n12.5;0.9\n"
"""What an instrument prints beside a profile; its numbers would go on with the positions of the profile."""


def option_of(message, name):
    start = message.index(f"{name}='") + len(name) + 2
    return {name: message[start : message.index("'", start)]}


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (rows("heights last", "0.5") + "\n" + SUMMARY, "skip_lines"),
        (rows("heights last", "0.5") + "\n" + SUMMARY + "\nEnd of report\n", "skip_lines"),
        (SUMMARY + "\n" + rows("heights last", "0.5"), "skip_rows"),
    ],
)
def test_a_table_beside_the_profile_is_left_out_by_the_option_that_the_message_names(
    put, text, name
):
    path = put(text)
    with pytest.raises(ms.errors.ReadError, match="another table begins") as caught:
        ms.read(path)
    found = ms.read(path, **option_of(str(caught.value), name))

    assert found.x.size == N
    z = [0.5e-6 if k == AT else 1e-6 * v for k, v in enumerate(Z)]
    np.testing.assert_allclose(found.z, z, rtol=0.0, atol=TIGHT)


def test_all_titles_of_blocks_are_left_out_at_once(put):
    """Each was refused in its turn: who had forty pages pasted forty hints."""
    block = rows("heights last", "0.5")
    path = put("".join(f"Page {k} of 4\n{block}\n" for k in range(1, 5)))

    with pytest.raises(
        ms.errors.ReadError, match=r"'Page 2 of 4' \(and 2 more like it\)"
    ) as caught:
        ms.read(path)
    lines = option_of(str(caught.value), "skip_lines")
    runs = ms.read_runs(path, x="x [mm]", z="z [um]", run="blocks", **lines)

    assert [r.x.size for r in runs] == [N] * 4


def test_a_count_below_the_rows_of_a_database_is_no_row(put):
    found = ms.read(put(rows("heights last", "0.5") + "\n(40 rows affected)\n"))

    assert found.x.size == N


@pytest.mark.parametrize(
    "name", ["Second", "Seconds", "sec", "Sekunden", "Secondes", "secondi", "秒"]
)
def test_a_column_called_after_seconds_is_a_time(put, name):
    """A Siglent oscilloscope: Second,Value; a unit of lengths was asked for, and a time became a place."""
    body = "".join(f"{4e-6 * k:.6e},{z}\n" for k, z in enumerate(Z))
    found = ms.read(put(f"Record Length,Analog:40\nVertical Units,CH1:V\n{name},Value\n{body}"))

    np.testing.assert_allclose(found.t, [4e-6 * k for k in range(N)], rtol=0.0, atol=1e-12)
    assert found.channels["Value"].tolist() == Z


def test_a_smallest_value_is_no_minute(put):
    text = "\n".join(
        ["x_mm;Min;Max", *(f"{x};{z};{z + 1}" for x, z in zip(X, Z, strict=True)), ""]
    )

    with pytest.raises(ms.errors.ReadError, match="none is a time"):
        ms.read(put(text))


def test_a_title_of_units_is_left_out_by_the_option_that_the_message_names(put):
    path = put("nm um\n" + rows("heights last", "0.5"))
    with pytest.raises(ms.errors.ReadError, match=r"line 1 with .* if it is a title") as caught:
        ms.read(path)
    found = ms.read(path, **option_of(str(caught.value), "skip_lines"))

    np.testing.assert_allclose(found.x, [1e-3 * v for v in X], rtol=0.0, atol=TIGHT)


def test_groups_of_two_digits_are_named(put):
    text = "x [µm];z [nm]\n" + "".join(f"{k};1,{k:02d},000.50\n" for k in range(N))

    with pytest.raises(ms.errors.ReadError, match="lakh"):
        ms.read(put(text))


# ---- what looks alike and is something else -----------------------------------------------------


@pytest.mark.parametrize("remark", ["#STOP!", "#PAUSE?", "#ACHTUNG!;Öl", "# STOP!"])
@pytest.mark.parametrize("place", [0, 1, AT, N + 1])
def test_a_remark_in_capitals_is_none_of_the_errors_of_a_spreadsheet(put, remark, place):
    lines = ["x [mm];z [um]", *(f"{x};{z}" for x, z in zip(X, Z, strict=True))]
    found = ms.read(put("\n".join([*lines[:place], remark, *lines[place:], ""])))

    np.testing.assert_allclose(found.x, [1e-3 * v for v in X], rtol=0.0, atol=TIGHT)
    np.testing.assert_allclose(found.z, [1e-6 * v for v in Z], rtol=0.0, atol=TIGHT)


def test_a_sign_among_the_numbers_of_one_column_is_reported(put):
    """It may be a remark, or the cell of a program in Swedish, without which all rows behind it move."""
    text = "\n".join(
        ["z [um]", *(f"{z}\n#VÄRDEFEL!" if k == AT else f"{z}" for k, z in enumerate(Z)), ""]
    )
    found = ms.read(put(text), lateral_step="1 mm")

    assert found.z.size == N
    assert "begin with the mark of a comment" in " ".join(found.metadata["warnings"])


@pytest.mark.parametrize("names", ["First;Second;Third", "First;Second;Third\num;um;um"])
def test_the_second_of_three_is_no_clock(put, names):
    rows_of_three = [f"{x};{1.1 * x:.3f};{z}" for x, z in zip(X, Z, strict=True)]
    with pytest.raises(ms.errors.FormatMismatchError, match="none is a time"):
        ms.read(put("\n".join([names, *rows_of_three, ""])))


@pytest.mark.parametrize("remark", ["# Durchmesser·Öse", "# 5 Äê", "# ·Öffnung 3"])
@pytest.mark.parametrize("unit", ["µm", "°C"])
def test_a_western_unit_speaks_against_two_bytes_for_a_word(put, remark, unit):
    """In GB18030 the bytes of ·Ö are the word for a minute, those of µm a rare plant."""
    rows_of_both = [f"{x};{z}" for x, z in zip(X, Z, strict=True)]
    path = put("\n".join([remark, f"x [mm];z [{unit}]", *rows_of_both, ""]).encode("cp1252"))
    _, found = read_table(open_file(path)).columns

    assert found.name == f"z [{unit}]"


@pytest.mark.parametrize("end", ["", "\t"])
@pytest.mark.parametrize(
    "names", [("x [mm]", "z [um]"), ("Weg_mm", "Höhe_um"), ("x_mm", "z_um", "Note")]
)
def test_names_that_are_set_in_by_a_tab_are_those_of_their_columns(put, names, end):
    note = "\tno" if len(names) > 2 else ""
    rows_of_all = [f"{x}\t{z}{note}" for x, z in zip(X, Z, strict=True)]
    found = ms.read(put("\n".join(["\t" + "\t".join(names) + end, *rows_of_all, ""])))

    np.testing.assert_allclose(found.x, [1e-3 * v for v in X], rtol=0.0, atol=TIGHT)
    np.testing.assert_allclose(found.z, [1e-6 * v for v in Z], rtol=0.0, atol=TIGHT)


@pytest.mark.parametrize("mark", ["\t", ";", "|"])
@pytest.mark.parametrize("names", [("x [mm]", "z [um]", "remark"), ("z_um", "remark")])
def test_names_that_fit_with_and_without_the_first_column_are_refused(put, mark, names):
    """Either the row number has no name and no row has a remark, or the names are set in: heights would be places."""
    rows_of_all = [
        mark.join(map(str, (k, x, z)[: len(names)]))
        for k, (x, z) in enumerate(zip(X, Z, strict=True))
    ]
    with pytest.raises(ms.errors.MetrosepError, match="line 1"):
        ms.read(put("\n".join([mark + mark.join(names), *rows_of_all, ""])))


def test_a_row_of_units_says_more_than_a_name(put):
    """The second of two probes, and a clock whose program writes what it counts below its name."""
    rows_of_three = [f"{x};{x / 2};{z}" for x, z in zip(X, Z, strict=True)]
    path = put("\n".join(["Weg;Second;Seconds", "mm;um;ms", *rows_of_three, ""]))
    units = [c.unit.name for c in read_table(open_file(path)).columns]

    assert units == ["mm", "um", "ms"]

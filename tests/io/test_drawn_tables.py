"""Tables that are drawn for a person: frames of bars and dashes, rows that are named #1, #2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.errors import ReadError
from metrosep.io.source import open_file
from metrosep.io.text.table import read_table

X = np.array([0.0, 0.5, 1.0, 1.5, 2.0])  # mm
Z = np.array([0.123, -0.234, 0.345, 0.456, -0.321])  # um, no two alike
PM = 1e-12
"""Numbers are those of the text, times a power of ten."""


def _read(tmp_path: Path, text: str) -> tuple[np.ndarray, np.ndarray, ms.Profile]:
    path = tmp_path / "drawn.txt"
    path.write_text(text, encoding="utf-8")
    profile = ms.read(path)
    assert isinstance(profile, ms.Profile)
    return profile.x * 1e3, profile.z * 1e6, profile


def _rows(left: str = "| ", mark: str = " | ", right: str = " |") -> list[str]:
    return [f"{left}{x}{mark}{z}{right}" for x, z in zip(X, Z, strict=True)]


RULE = "+------+--------+"
FRAMES = {
    "frame": [RULE, "| x_mm | z_um |", RULE, *_rows(), RULE],
    "grid": [
        RULE,
        "| x_mm | z_um |",
        "+======+=======+",
        *(s for r in _rows() for s in (r, RULE)),
    ],
    "markdown": ["| x_mm | z_um |", "|---|--:|", *_rows()],
    "database": [" x_mm | z_um", "------+------", *_rows(" ", right=""), "(5 rows)"],
    "box": ["┌──────┬──────┐", "│ x_mm │ z_um │", "├──────┼──────┤"]
    + [r.replace("|", "│") for r in _rows()]
    + ["└──────┴──────┘"],
    "comma": ["╔═════╦═════╗", "║ x_mm ║ z_um ║", "╠═════╬═════╣"]
    + [r.replace("|", "║").replace(".", ",") for r in _rows()],
    "numbered": [f"#{k};{r}" for k, r in enumerate(["", *_rows("", ";", "")]) if r],
    "numbered under a comment": ["# LogPro 3", "# nr;x_mm;z_um"]
    + [f"#{k};{r}" for k, r in enumerate(_rows("", ";", ""), start=1)],
}


@pytest.mark.parametrize("drawn", [k for k in FRAMES if k != "numbered"])
def test_a_drawn_table_is_read_with_every_row(tmp_path: Path, drawn: str) -> None:
    x, z, profile = _read(tmp_path, "\n".join(FRAMES[drawn]) + "\n")

    np.testing.assert_array_equal(x, X)
    np.testing.assert_allclose(z, Z, rtol=0, atol=PM)
    n_rules = sum(not s.strip("+-=:| ┌─┬┐├┼┤└┴┘╔═╦╗╠╬╣") for s in FRAMES[drawn])
    assert profile.metadata["lines"].get("rule", 0) == n_rules
    lines = profile.metadata["lines"]
    assert lines["data"] == X.size
    assert lines["total"] == len(FRAMES[drawn])


def test_rows_named_by_number_need_no_header(tmp_path: Path) -> None:
    path = tmp_path / "numbered.csv"
    path.write_text("\n".join(FRAMES["numbered"]) + "\n", encoding="utf-8")

    profile = ms.read(path, unit="mm")

    assert isinstance(profile, ms.Profile)
    np.testing.assert_allclose(profile.x * 1e3, X, rtol=0, atol=PM)
    np.testing.assert_allclose(profile.z * 1e3, Z, rtol=0, atol=PM)


def test_comments_with_numbers_are_no_rows(tmp_path: Path) -> None:
    """Only counted rows are: a comment above a table may hold numbers too."""
    text = "#1;9;9\n#2;9;9\n#3;9;9\nx_mm;z_um\n" + "\n".join(_rows("", ";", "")) + "\n"

    x, _, _ = _read(tmp_path, text)

    np.testing.assert_array_equal(x, X)


def test_a_gap_in_the_numbers_of_rows_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "gap.csv"
    path.write_text("#1;0.0;1\n#2;0.5;2\n#4;1.5;3\n", encoding="utf-8")

    with pytest.raises(ReadError):
        ms.read(path, unit="mm")


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("| 1.0 | 0.345 |", "| 1.0  0.345 |"), ("| 1.5 | 0.456 |", "| 1.5 | 0.456 | 7 |")],
)
def test_a_damaged_row_of_a_frame_is_named(tmp_path: Path, wrong: str, right: str) -> None:
    lines = FRAMES["frame"]
    number = lines.index(wrong) + 1

    with pytest.raises(ReadError, match=f"line {number}"):
        _read(tmp_path, "\n".join(lines).replace(wrong, right) + "\n")


def test_an_empty_cell_of_a_frame_is_not_measured(tmp_path: Path) -> None:
    text = "\n".join(FRAMES["grid"]).replace("0.345", "     ") + "\n"

    _, z, _ = _read(tmp_path, text)

    assert np.isnan(z).tolist() == [False, False, True, False, False]


def test_lines_drawn_between_samples_are_no_lost_samples(tmp_path: Path) -> None:
    path = tmp_path / "grid.txt"
    path.write_text("\n".join(FRAMES["grid"]) + "\n", encoding="utf-8")

    recording = ms.read(path, sampling_rate="1 kHz")

    assert not [w for w in recording.metadata["warnings"] if "holds no sample" in w]


def test_a_second_position_that_is_not_used_is_reported(tmp_path: Path) -> None:
    rows = [f"{k // 30},{k % 30},{k // 30 * 5},{k % 7}" for k in range(120)]
    path = tmp_path / "lines.csv"
    path.write_text("run,x_mm,y_mm,z_um\n" + "\n".join(rows) + "\n", encoding="utf-8")

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="run")

    assert [w for w in runs.metadata["warnings"] if "'y_mm' goes from 0 to 15 mm" in w]


def test_a_message_on_bad_rows_stays_short(tmp_path: Path) -> None:
    rows = [f"{k},{k % 9},{'ok' if k % 2 else 'bad'}" for k in range(3000)]
    path = tmp_path / "alternate.csv"
    path.write_text("x_mm,z_um,status\n" + "\n".join(rows) + "\n", encoding="utf-8")

    (said,) = (w for w in ms.read(path).metadata["warnings"] if "status" in w)

    assert "1500 groups" in said
    assert len(said) < 400


def test_a_feed_with_a_comma_and_no_proof_is_refused(tmp_path: Path) -> None:
    """1,234 mm/min may be 1.234 or 1234: the unit behind it has a stroke in it."""
    rows = [f"{k};1,23{k} mm/min" for k in range(5)]
    path = tmp_path / "feed.csv"
    path.write_text("t_s;feed\n" + "\n".join(rows) + "\n", encoding="utf-8")

    with pytest.raises(ReadError, match=r"1\.230 or 1230"):
        ms.read(path)


@pytest.mark.parametrize("mark", ["\u2009", "\u2019", "\u202f"])
def test_groups_between_thin_blanks_are_groups(tmp_path: Path, mark: str) -> None:
    text = "x_mm;z_um\n" + "".join(f"{k};1{mark}{k}34,5\n" for k in range(5))

    _, z, _ = _read(tmp_path, text)

    np.testing.assert_allclose(z, 1034.5 + 100.0 * np.arange(5), rtol=0, atol=1e-9)


def test_rows_that_all_begin_with_a_typeset_minus_have_one_decimal_mark(tmp_path: Path) -> None:
    text = "x_mm;z_um\n" + "".join(f"{k};\u2212{k}.5\n" for k in range(5))

    _, z, _ = _read(tmp_path, text)

    np.testing.assert_allclose(z, -0.5 - np.arange(5), rtol=0, atol=PM)


def test_an_empty_column_between_named_ones_needs_no_name(tmp_path: Path) -> None:
    text = "Position,,Height\nmm,,um\n" + "".join(f"{k},,{k}.5\n" for k in range(5))

    x, z, _ = _read(tmp_path, text)

    np.testing.assert_allclose(x, np.arange(5), rtol=0, atol=PM)
    np.testing.assert_allclose(z, 0.5 + np.arange(5), rtol=0, atol=PM)


CELLS = "".join(f"|{x}|{z}|\n" for x, z in zip(X, Z, strict=True)) * 4
BARS = {
    "names without bars": ("a_um|x_mm|z_um|b_um\n", 1),
    "names of a database": (" a_um | x_mm | z_um | b_um\n------+------+------+------\n", 1),
    "no names": ("", 1),
    "names in bars": ("|x_mm|z_um|\n", 0),
    "a rule": ("+----+----+\n", 0),
}


@pytest.mark.parametrize("above", BARS)
@pytest.mark.parametrize("n_rows", [5, 20])
def test_bars_are_a_frame_where_one_was_drawn_else_empty_cells(put, above, n_rows) -> None:
    head, column = BARS[above]
    rows = "\n".join(CELLS.split("\n")[:n_rows]) + "\n"
    table = read_table(open_file(put(head + rows, "drawn.txt")))

    assert table.columns[0].values is not None
    assert np.isnan(table.columns[0].values).all() == bool(column)
    np.testing.assert_array_equal(table.columns[column].values, np.tile(X, 4)[:n_rows])
    np.testing.assert_array_equal(table.columns[column + 1].values, np.tile(Z, 4)[:n_rows])


@pytest.mark.parametrize(("between", "said"), [(["# pause"], True), (["+----+----+"], False)])
def test_a_frame_does_not_hide_a_line_that_stands_between_samples(tmp_path, between, said):
    """Three lines of the frame lie outside the rows: they explain no gap within."""
    rule = "+----+----+"
    rows = [f"| {z} | {x} |" for x, z in zip(X, Z, strict=True)]
    text = [rule, "| z_um | w_um |", rule, *rows[:2], *between, *rows[2:], rule]
    path = tmp_path / "drawn.txt"
    path.write_text("\n".join(text) + "\n")
    found = ms.read(path, sampling_rate="100 Hz")
    assert np.abs(found.channels["z_um"] * 1e6 - Z).max() < PM
    assert any("stands between the rows" in w for w in found.metadata["warnings"]) is said


_HEIGHTS = [[round(0.1 * i - 0.03 * k, 2) for k in range(15)] for i in range(20)]
"""Heights of a tilted map in um: no row equals another, none its mirror image."""


@pytest.mark.parametrize("mark", ["\t", ";", ","])
@pytest.mark.parametrize("word", ["---", "___", "-------"])
@pytest.mark.parametrize("n_lost", [1, 3])
def test_rows_of_dashes_at_the_top_of_a_map_are_asked_for_and_kept(tmp_path, mark, word, n_lost):
    rows = [mark.join(map(str, row)) for row in _HEIGHTS]
    rows[:n_lost] = [mark.join([word] * 15)] * n_lost
    file = tmp_path / "map.txt"
    file.write_text("\n".join(rows) + "\n")
    with pytest.raises(ReadError, match=rf"line 1 .*missing='{word}'"):
        ms.read(file, unit="um", lateral_step="1 mm", decimal=".")
    found = ms.read(file, unit="um", lateral_step="1 mm", decimal=".", missing=word)
    assert found.z.shape == (20, 15)
    assert np.isnan(found.z).sum() == 15 * n_lost
    assert found.z[n_lost, 2] == pytest.approx(1e-6 * _HEIGHTS[n_lost][2], abs=1e-15)


@pytest.mark.parametrize(
    ("names", "lost"),
    [
        ("z1_um\tz2_um", ["---\t---"] * 3),
        ("z1_um;z2_um", ["-----;-----"]),
        ("z1_um  z2_um", ["--- ---"]),
        ("z_um", ["---"]),
        ("z_um", ["-----"] * 2),
        ("z1_um\tz2_um", ["___\t___"]),
    ],
)
def test_samples_not_measured_below_the_names_are_never_a_rule(tmp_path, names, lost):
    mark = next((m for m in "\t; " if m in names), "\n")
    rows = [
        mark.join(["0.25", "-0.5"][: len(names.split(mark.strip(" ") or None))]) for _ in range(30)
    ]
    rows = ["0.25"] * 30 if names == "z_um" else rows
    file = tmp_path / "p.txt"
    file.write_text("\n".join([names, *lost, *rows]) + "\n")
    with pytest.raises(ReadError, match=r"line [23] .*skip_lines="):
        ms.read(file, sampling_rate=1000.0, channel=names.split()[0].split(";")[0])
    word = lost[0].replace(";", " ").split()[0]
    found = ms.read(
        file, sampling_rate=1000.0, missing=word, channel=names.split()[0].split(";")[0]
    )
    values = next(iter(found.channels.values())) if isinstance(found, ms.Recording) else found.z
    assert values.shape[-1] == 30 + len(lost)
    assert np.isnan(np.ravel(values)[: len(lost)]).all()


@pytest.mark.parametrize(
    "head",
    [
        "x_mm;z_um\n=====;=====",
        "x_mm | z_um\n---|---",
        "x_mm  z_um\n----  ----",
        "x_mm\theight_um\n----\t---------",
        "x_mm\tz_um\n--------------",
        "-----------\nx_mm\tz_um",
    ],
)
def test_a_line_under_the_names_is_a_rule_once(tmp_path, head):
    mark = next(m for m in ("|", ";", "\t", "  ") if m in head)
    rows = [f"{i}.5{mark}{i * i}.25" for i in range(12)]
    file = tmp_path / "p.txt"
    file.write_text("\n".join([head, *rows]) + "\n")
    found = ms.read(file)
    assert found.z.shape == (12,)
    assert found.metadata["lines"]["rule"] == 1

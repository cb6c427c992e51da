"""Tables long enough for the compiled parser: every writing gives the bits of float, every odd row is named."""

import random
import re

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.text import _rows

N = 15_000
"""Rows of more than 256 KiB, from which the compiled parser reads."""
AT = 11_001
"""Index of the row that is changed; its line is two further."""
MOST = 100
"""Rows at most that are read one by one: those about an end of the table."""

DRAW = random.Random(25)  # noqa: S311  a reproducible draw, no secret
X = [f"{0.001 * k:.3f}" for k in range(N)]
Z = [f"{DRAW.gauss(0.0, 3.0):.{DRAW.choice((3, 9, 16))}f}" for _ in range(N)]


def comma(text):
    return text.replace(".", ",")


def quoted(text):
    return f'"{text}"'


# name: separator, how a field is written, how the second one is
WRITTEN = {
    "plain": (",", str, str),
    "quoted": (",", quoted, quoted),
    "one quoted": (",", str, quoted),
    "semicolon": (";", comma, comma),
    "semicolon quoted": (";", lambda t: quoted(comma(t)), lambda t: quoted(comma(t))),
    "commas in quotes": (",", lambda t: quoted(comma(t)), lambda t: quoted(comma(t))),
    "tab quoted": ("\t", quoted, quoted),
    "pipe one quoted": ("|", quoted, str),
    "blank": (" ", str, str),
}
ODD = {
    "field lost": lambda x, z, mark: x,
    "field too many": lambda x, z, mark: f"{x}{mark}{z}{mark}{z}",
    "quote lost": lambda x, z, mark: f'"{x}{mark}{z}',
    "text behind a quote": lambda x, z, mark: f'"{x}"5{mark}{z}',
    "letter": lambda x, z, mark: f"{x}{mark}1O",
    "row lost": lambda x, z, mark: "removed by hand",
}


def write(path, how, odd=None, z=Z):
    mark, first, second = WRITTEN[how]
    rows = [f"{first(a)}{mark}{second(b)}" for a, b in zip(X, z, strict=True)]
    if odd is not None:
        rows[AT] = ODD[odd](first(X[AT]), second(z[AT]), mark)
    path.write_text(mark.join(map(first, ("x_mm", "z_um"))) + "\n" + "\n".join(rows) + "\n")
    assert path.stat().st_size > 2**18
    return path


@pytest.mark.parametrize("how", WRITTEN)
def test_numbers_have_the_bits_of_float(tmp_path, how):
    found = ms.read(write(tmp_path / "long.txt", how))

    assert found.x.tolist() == (np.array(list(map(float, X))) * 1e-3).tolist()
    assert found.z.tolist() == (np.array(list(map(float, Z))) * 1e-6).tolist()
    assert found.metadata["warnings"] == ()
    assert found.metadata["lines"]["data"] == N


@pytest.mark.parametrize("how", ["plain", "quoted", "one quoted", "commas in quotes"])
@pytest.mark.parametrize("odd", ODD)
def test_one_odd_row_is_named(tmp_path, how, odd):
    with pytest.raises(ms.errors.ReadError) as caught:
        ms.read(write(tmp_path / "long.txt", how, odd))

    assert re.search(rf"\bline {AT + 2}\b", str(caught.value)), str(caught.value)


@pytest.mark.parametrize(
    ("how", "word"),
    [
        ("plain", ""),
        ("quoted", "NaN"),
        ("one quoted", ""),
        ("semicolon quoted", "#NV"),
        ("pipe one quoted", "---"),
    ],
)
def test_words_for_not_measured_are_nan_in_their_row_only(tmp_path, how, word):
    z = [word if k % 1000 == 1 else v for k, v in enumerate(Z)]
    found = ms.read(write(tmp_path / "long.txt", how, z=z))

    assert np.flatnonzero(np.isnan(found.z)).tolist() == list(range(1, N, 1000))
    assert found.metadata["lines"]["data"] == N


def test_labels_stay_with_their_rows(tmp_path):
    path = tmp_path / "long.csv"
    names = [f"lauf {1 + 3 * k // N}" for k in range(N)]
    rows = [f"{r},{a},{b}" for r, a, b in zip(names, X * 2, Z, strict=False)]
    path.write_text("run,x_mm,z_um\n" + "\n".join(rows) + "\n")

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="run")

    assert [(r.run_id, len(r)) for r in runs] == [(f"lauf {k}", N // 3) for k in (1, 2, 3)]
    assert runs[2].z[0] == float(Z[2 * N // 3]) * 1e-6


@pytest.mark.parametrize("how", ["quoted", "one quoted", "semicolon quoted", "commas in quotes"])
def test_quotes_cost_no_loop_over_the_fields(tmp_path, monkeypatch, how):
    """Line by line the table took five times the processor time, and the compiled parser reads quotes."""
    by_line = []
    really = _rows.Body._line_by_line

    def watched(rows, text, first, *, last):
        by_line.append(text.count("\n"))
        return really(rows, text, first, last=last)

    monkeypatch.setattr(_rows.Body, "_line_by_line", watched)
    ms.read(write(tmp_path / "long.txt", how))

    assert sum(by_line) <= MOST


def test_a_quote_far_from_every_line_of_the_sample_is_a_quote(tmp_path):
    rows = [f"{x},{z}" for x, z in zip(X[:11_000], Z, strict=False)]
    rows[5_500] = ",".join(map(quoted, rows[5_500].split(",")))
    path = tmp_path / "a.csv"
    path.write_text("x_mm,z_um\n" + "\n".join(rows) + "\n")

    read = ms.read(path)
    assert read.x[5_500] == float(X[5_500]) * 1e-3
    assert read.z[5_500] == float(Z[5_500]) * 1e-6
    assert read.metadata["lines"]["data"] == len(rows)


@pytest.mark.parametrize("part", [2**20, 2**22])
def test_a_field_over_several_lines_may_lie_anywhere(tmp_path, part):
    path, wide = tmp_path / "a.csv", "w" * 300
    n = part // len(wide) + 400
    rows = [f"{0.01 * k:.2f},{k % 97},{wide}" for k in range(n)]
    at = 1 + "\n".join(["t_s,z_um,note", *rows]).encode()[:part].count(b"\n")
    for k in (
        at - 2,
        at - 1,
        at,
    ):  # rows before and behind the end of a part, and the one across it
        odd = f'{0.01 * k:.2f},{k % 97},"{wide}\nsecond, line\n{wide}"'
        path.write_text("\n".join(["t_s,z_um,note", *rows[:k], odd, *rows[k + 1 :]]) + "\n")

        read = ms.read(path)
        assert np.array_equal(read.channels["z_um"], np.arange(n) % 97 * 1e-6)
        assert np.array_equal(read.t, np.array([float(f"{0.01 * i:.2f}") for i in range(n)]))
        assert read.metadata["lines"]["data"] == n + 2


WORDS = ("OVER", "-inf", "OL", "Infinity", "---", "NaN")


@pytest.mark.parametrize("how", ["plain", "quoted", "blank", "pipe one quoted"])
def test_words_beyond_the_range_are_counted_in_a_long_table(tmp_path, how):
    z = [WORDS[k // 50 % 6] if k % 50 == 1 else v for k, v in enumerate(Z)]
    found = ms.read(write(tmp_path / "long.txt", how, z=z))

    rows = range(1, N, 50)
    beyond = [k for k in rows if k // 50 % 6 < 4]
    assert np.flatnonzero(np.isnan(found.z)).tolist() == list(rows)
    (said,) = found.metadata["warnings"]
    assert said.startswith(f"{len(beyond)} fields such as 'OVER' (first: line 3)")


@pytest.mark.parametrize("how", ["plain", "blank"])
def test_a_number_beyond_all_floats_is_no_such_word(tmp_path, how):
    z = ["inf" if k % 50 == 1 else v for k, v in enumerate(Z)]
    z[AT] = "1e999"
    with pytest.raises(ms.errors.ReadError, match=rf"line {AT + 2}\b"):
        ms.read(write(tmp_path / "long.txt", how, z=z))


@pytest.mark.parametrize(
    "odd", [None, "2026-03-05 14:0O:00.000", "", "2026-03-05 14:00:00.5", "a, b"]
)
def test_stamps_of_one_width_stay_in_their_rows(tmp_path, odd):
    start = np.datetime64("2026-03-05T14:00:00.000")
    stamps = [str(start + np.timedelta64(5 * k, "ms")).replace("T", " ") for k in range(N)]
    if odd is not None:
        stamps[AT] = odd
    path = tmp_path / "long.csv"
    path.write_text("time,z_um\n" + "".join(f"{t},{z}\n" for t, z in zip(stamps, Z, strict=True)))

    if odd is None:
        found = ms.read(path)
        assert found.t.tolist() == pytest.approx([0.005 * k for k in range(N)], abs=1e-12)
        assert found.channels["z_um"].tolist() == [float(z) * 1e-6 for z in Z]
    else:
        with pytest.raises(ms.errors.ReadError, match=rf"\b{AT + 2}\b"):
            ms.read(path)


@pytest.mark.parametrize("first", [False, True], ids=["behind", "in front"])
@pytest.mark.parametrize(
    "name",
    ["run", "direction", "Datum", "id", "Part no", "No remark", "Error code", "Sensor", "Probe",
     "position remark"],
)  # fmt: skip
def test_a_first_word_far_below_the_first_rows_makes_a_column_of_words(put, name, first):
    def row(*fields):
        own, x, z = fields
        return ",".join((own, x, z) if first else (x, z, own))

    rows = [row("chatter" if k in (3200, 5999) else "", f"{k}", f"{k % 7}.5") for k in range(6000)]
    profile = ms.read(put("\n".join([row(name, "x_um", "z_um"), *rows]) + "\n", "late.csv"))
    assert profile.x.tolist() == pytest.approx([k * 1e-6 for k in range(6000)], abs=1e-15)
    assert profile.z[-1] == pytest.approx(0.5e-6, abs=1e-15)


@pytest.mark.parametrize("name", ["position", "z height", "Feed", "temp 2"])
def test_a_word_in_a_column_of_numbers_is_refused_though_all_above_is_empty(put, name):
    rows = [f"{k},{k % 7}.5,{'chatter' if k == 3200 else ''}" for k in range(6000)]
    with pytest.raises(ms.errors.CorruptFileError, match="line 3202"):
        ms.read(put("\n".join([f"x_um,z_um,{name}", *rows]) + "\n", "late.csv"))

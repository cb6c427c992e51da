"""The quick way through a block of rows gives what line by line gives: the same numbers, the same refusals."""

from __future__ import annotations

import datetime as dt
import random
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.source import RawFile
from metrosep.io.stream import open_stream
from metrosep.io.text import _compiled, _rows
from metrosep.io.text.table import read_table
from metrosep.io.text.times import Entries, moments

TABLES = 60
ODD = (
    "", "NaN", "n/a", "#N/A", "OL", "inf", "1O5", "x", '"', "1,2,3", "1.2.3", "12,345", "1.234.567", "1'234",
    "1'23", "1e5", "1d3", "1E+400", "\u22125", "5 6", " 7 ", "1_000", "1,000.5", "1.000,5", "-1,234.50",
    "01,234", "1234,567.8", "1,234.5e3", ";", "# dust", "%", "//", "1 234.5", "1,234'567.8",
)  # fmt: skip
NS = 1e-9
"""A clock is counted in whole ns; only the last step to seconds rounds."""
START = dt.datetime(2026, 3, 5, 23, 59)


def _table(draw: random.Random) -> bytes:
    separator = draw.choice(";\t |,")
    decimal = "." if separator == "," else draw.choice(".,")
    quote = draw.choice(["", '"'])
    group = draw.choice(["'", {".": ",", ",": "."}[decimal]])
    kinds = [
        "x",
        *draw.choices(["z", "grouped", "label", "clock", "moment"], k=draw.choice([1, 2])),
    ]

    def field(kind: str, i: int) -> str:
        at = START + dt.timedelta(seconds=0.5 * i)
        number = {"x": i * 0.125, "z": draw.gauss(0, 3), "grouped": draw.gauss(0, 1e6)}.get(
            kind, 0.0
        )
        text = f"{number:,.3f}" if kind == "grouped" else f"{number:.3f}"
        return {
            "label": draw.choice(["ok", "ng", "run.1"]),
            "clock": f"{at:%H:%M:%S}{decimal}{at.microsecond // 1000:03d}",
            "moment": f"{at:%d.%m.%Y %H:%M:%S}",
        }.get(kind, text.replace(",", "g").replace(".", decimal).replace("g", group))

    rows = [[field(k, i) for k in kinds] for i in range(30)]
    for _ in range(draw.choice([0, 0, 0, 1, 2])):
        draw.choice(rows)[draw.randrange(len(kinds))] = draw.choice(ODD)
    lines = [separator.join(f"{quote}{f}{quote}" for f in row) for row in rows]
    k = draw.randrange(len(lines))
    lines[k] += draw.choice([""] * 9 + [separator, " # remark", "\n; pause", "\ntext"])
    return ("\n".join(lines) + "\n").encode()


def _outcome(content: bytes) -> object:
    try:
        table = read_table(RawFile(Path("table.csv"), content))
    except ms.errors.MetrosepError as exc:
        return f"{type(exc).__name__}: {exc}"
    columns = [
        (c.name, None if c.values is None else c.values.tobytes(), tuple(c.labels or ()))
        for c in table.columns
    ]
    return columns, table.lines.tolist(), dict(table.ledger), table.warnings


def test_both_ways_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    draw = random.Random(11)  # noqa: S311
    tables = [_table(draw) for _ in range(TABLES)]
    quick = _rows.Body._fast
    taken = []

    def counted(self, *args):
        taken.append(found := quick(self, *args))
        return found

    monkeypatch.setattr(_compiled, "_LONG", 0)
    monkeypatch.setattr(_compiled, "_PIECE", 32)  # marks of thousands on the edges of pieces
    monkeypatch.setattr(_rows.Body, "_fast", counted)
    found = [_outcome(t) for t in tables]
    monkeypatch.setattr(_rows.Body, "_fast", lambda *_: None)
    expected = [_outcome(t) for t in tables]

    for content, one, other in zip(tables, found, expected, strict=True):
        assert one == other, content[:200]
    assert sum(t is not None for t in taken) > TABLES // 5


@pytest.mark.parametrize(
    "form", ["%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%m/%d/%Y %I:%M:%S %p"]
)
def test_dates_read_at_once_are_those_of_the_calendar(form: str) -> None:
    """Through midnight, the end of February and noon; with one empty entry."""
    step = dt.timedelta(seconds=4321)
    start = dt.datetime(2028, 2, 28, 10, 30)
    texts = [(start + i * step).strftime(form) for i in range(60)]
    texts[7] = ""

    found = moments(texts, np.arange(60), "here")

    assert found is not None
    assert found.start.startswith("2028-02-28T10:30:00")
    expected = np.where(np.arange(60) == 7, np.nan, 4321.0 * np.arange(60))
    np.testing.assert_allclose(found.seconds, expected, rtol=0, atol=NS)


def test_a_date_that_is_none_is_not_read(tmp_path: Path) -> None:
    assert not Entries(["2026-03-05 1O:00:00"]).is_known.any()
    path = tmp_path / "dates.csv"
    path.write_text("time,z_um\n" + "".join(f"2026-02-{d:02d},{d}\n" for d in range(20, 32)))

    with pytest.raises(ms.errors.AmbiguousFormatError, match="line 11"):
        ms.read(path)


def test_a_chunked_clock_counts_like_a_whole_one(tmp_path: Path) -> None:
    rows = [f"{START + dt.timedelta(seconds=i):%d.%m.%Y;%H:%M:%S};{i % 7}" for i in range(300)]
    path = tmp_path / "clock.csv"
    path.write_text("Datum;Uhrzeit;z_um\n" + "\n".join(rows) + "\n")

    with open_stream(path) as stream:
        parts = [next(iter(c.values())) for c in stream.chunks(64)]

    np.testing.assert_allclose(np.concatenate(parts), np.arange(300.0), rtol=0, atol=NS)


def test_a_short_row_between_blanks_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A parser of columns would fill it with nothing, and the row has words."""
    monkeypatch.setattr(_compiled, "_LONG", 0)
    rows = [f"{START + dt.timedelta(seconds=i):%Y-%m-%d %H:%M:%S} {i}.5 ok" for i in range(50)]
    rows[20] = rows[20].removesuffix(" ok")
    path = tmp_path / "blanks.txt"
    path.write_text("\n".join(rows) + "\n")

    with pytest.raises(ms.errors.ReadError, match="line 21"):
        ms.read(path, unit="mm")


ROWS = 400_000
"""Rows of more than one part of a file (4 MiB), in which a column holds few words."""


def _status(i: int) -> str:
    return "cut" if i % 7 else "air" if i < 350_000 else "retract"


def test_a_column_of_few_words_is_kept_as_these_and_reads_like_a_list(tmp_path: Path) -> None:
    """A word that stands late only, after the part in which the others were met, is told too."""
    path = tmp_path / "status.csv"
    body = "".join(f"{i * 0.001:.3f},{i % 11 / 7:.5f},{_status(i)}\n" for i in range(ROWS))
    path.write_text("x_mm,z_um,state\n" + body)

    state = read_table(RawFile(path))["state"].labels

    assert state is not None
    assert not isinstance(state, list | tuple)
    assert _compiled.different(state) == ("air", "cut", "retract")
    assert list(state) == [_status(i) for i in range(ROWS)]
    assert (state[7], state[-1], len(state)) == ("air", _status(ROWS - 1), ROWS)
    assert list(state[350_000:350_008]) == [_status(i) for i in range(350_000, 350_008)]
    assert np.array(state)[349_999:350_001].tolist() == [_status(349_999), _status(350_000)]
    assert "retract" in state
    assert "" not in state
    (chosen,) = (ms.read(path, x="x_mm", z="z_um", channel=c) for c in ("retract",))
    assert chosen.x.size == sum(_status(i) == "retract" for i in range(ROWS))

"""Recordings in chunks: the same numbers as the whole, damage named, memory bounded."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.stream import open_stream
from metrosep.io.text import table as text_table

PM = 1e-12


@pytest.fixture
def table(tmp_path, rng):
    """Write a table of three columns in a dialect; return its path and the numbers in SI."""

    def make(n=5000, *, separator=",", decimal=".", end="\n", trailing="", name="long.csv"):
        t = np.arange(n) * 1e-3
        gap = np.round(rng.standard_normal(n), 6)
        angle = np.round(rng.uniform(0, 360, n), 4)
        rows = [
            f"{a!r}{separator}{b!r}{separator}{c!r}{trailing}"
            for a, b, c in zip(t.tolist(), gap.tolist(), angle.tolist(), strict=True)
        ]
        body = end.join(rows).replace(".", decimal)
        path = tmp_path / name
        head = separator.join(["t_s", "gap_um", "angle_deg"]) + trailing + end
        path.write_bytes((head + body + end).encode())
        return path, {"t_s": t, "gap_um": gap * 1e-6, "angle_deg": np.deg2rad(angle)}

    return make


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(text_table, "_BLOCK", 1000)


def gathered(stream, size):
    parts = list(stream.chunks(size))
    assert all(len(v) == size for p in parts[:-1] for v in p.values())
    return {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize(
    "dialect",
    [
        {},
        {"separator": ";", "decimal": ","},
        {"separator": "\t", "end": "\r\n"},
        {"separator": ";", "trailing": ";;"},
        {"separator": " "},
    ],
    ids=["csv", "decimal comma", "tabs CRLF", "trailing separators", "spaces"],
)
@pytest.mark.parametrize("size", [7, 100_000])
def test_chunks_are_the_whole(table, dialect, size):
    path, truth = table(800, **dialect)

    with open_stream(path) as stream:
        assert stream.time_step == pytest.approx(1e-3, rel=1e-9, abs=0.0)
        found = gathered(stream, size)

    assert list(found) == list(truth)
    for name, values in truth.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-14, atol=PM)
    whole = ms.read(path)
    np.testing.assert_array_equal(found["gap_um"], whole["gap_um"])


@pytest.mark.usefixtures("small_blocks")
def test_chosen_channels_in_the_order_asked_for(table):
    path, truth = table(50)

    with open_stream(path, channels=["angle_deg", "gap_um"]) as stream:
        found = gathered(stream, 20)

    assert list(found) == ["angle_deg", "gap_um"]
    np.testing.assert_allclose(found["gap_um"], truth["gap_um"], rtol=1e-14)


@pytest.mark.usefixtures("small_blocks")
def test_empty_fields_comments_and_blank_lines_far_below(table):
    path, truth = table(500)
    lines = path.read_text().split("\n")
    t, _, angle = lines[400].split(",")
    lines[400] = f"{t},,{angle}"
    lines.insert(300, "# marker")
    lines.insert(200, "")
    path.write_text("\n".join(lines))

    with open_stream(path) as stream:
        found = gathered(stream, 64)

    expected = truth["gap_um"].copy()
    expected[399] = np.nan
    np.testing.assert_allclose(found["gap_um"], expected, rtol=1e-14)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda row: row.replace("0", "O", 1), "not a number"),
        (lambda row: row + ",1", "another number of fields"),
        (lambda row: row.split(",")[0], "another number of fields"),
        (lambda row: row.replace(",", ",,", 1).rsplit(",", 1)[0], "0"),
    ],
    ids=["letter", "field too many", "fields missing", "shifted"],
)
def test_damage_far_below_is_named_by_its_line(table, damage, message):
    path, _ = table(500)
    lines = path.read_text().split("\n")
    lines[450] = damage(lines[450])
    path.write_text("\n".join(lines))

    with open_stream(path) as stream:
        if message == "0":
            found = gathered(stream, 64)
            assert np.isnan(found["gap_um"][449])
            return
        with pytest.raises(ms.errors.CorruptFileError, match=message) as caught:
            list(stream.chunks(64))

    assert "line 451" in str(caught.value)


@pytest.mark.usefixtures("small_blocks")
def test_rows_that_balance_each_other_are_not_accepted(table):
    """One field too many in one row and one too few in the next: the count of the block is right."""
    path, _ = table(500)
    lines = path.read_text().split("\n")
    lines[450] += ",9"
    lines[451] = lines[451].rsplit(",", 1)[0]
    path.write_text("\n".join(lines))

    with open_stream(path) as stream, pytest.raises(ms.errors.CorruptFileError, match="line 451"):
        list(stream.chunks(64))


@pytest.mark.usefixtures("small_blocks")
def test_a_file_cut_in_a_row_is_refused_at_its_end(table):
    path, _ = table(500)
    data = path.read_bytes()
    path.write_bytes(data[: data[:-1].rfind(b",")])

    with (
        open_stream(path) as stream,
        pytest.raises(ms.errors.CorruptFileError, match="middle of a row"),
    ):
        list(stream.chunks(64))


def test_declared_unit_and_rate(tmp_path):
    path = tmp_path / "plain.txt"
    path.write_text("1 10\n2 20\n4 40\n")

    with open_stream(path, unit={"column2": "mm"}, sampling_rate="2 kHz") as stream:
        (chunk,) = stream.chunks()

    assert stream.time_step == pytest.approx(0.5e-3, rel=1e-9, abs=0.0)
    np.testing.assert_array_equal(chunk["column1"], [1.0, 2.0, 4.0])
    np.testing.assert_allclose(chunk["column2"], [0.01, 0.02, 0.04], rtol=1e-15)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"channels": ["gapp"]}, "FormatMismatchError", "no channel 'gapp'; the channels are t_s"),
        ({"unit": {"gap_um": "mm"}}, "FormatMismatchError", "is in um by the file"),
        ({"unit": {"nothing": "mm"}}, "FormatMismatchError", "no channel 'nothing'"),
        ({"sampling_rate": "0 Hz"}, "DataError", "must be positive"),
        ({"format": "metropro"}, "UnsupportedFeatureError", "not read in chunks"),
    ],
)
def test_what_cannot_be_is_refused(table, options, error, message):
    path, _ = table(10)

    with pytest.raises(getattr(ms.errors, error), match=message):
        open_stream(path, **options)


def test_columns_of_words_are_no_channels(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text("run,z_um\na,1\nb,2\n")

    with open_stream(path) as stream:
        assert stream.channels == ("z_um",)
        assert gathered(stream, 1)["z_um"].tolist() == [1e-6, 2e-6]
    assert "column 'run' holds words" in stream.warnings[-1]
    with pytest.raises(ms.errors.FormatMismatchError, match="no channel 'run'"):
        open_stream(path, channels=["run"])


MOMENTS = {
    "ISO 8601": [f"2026-03-05T23:59:{58 + k // 4:02d}.{250 * (k % 4):03d}" for k in range(8)],
    "day.month.year": [f"05.03.2026 14:07:{k:02d}" for k in range(40)],
    "names of months": [f"5-Mar-2026 14:{k // 60:02d}:{k % 60:02d}" for k in range(300)],
    "a clock past midnight twice": [
        f"{(k // 60) % 24:02d}:{k % 60:02d}:00" for k in range(1380, 1380 + 2 * 1440, 7)
    ],
    "elapsed": [f"{k}:{(k * 7) % 60:02d}:00.5" for k in range(100, 140)],
    "with a word": ["n/a" if k == 5 else f"2026-03-05 14:07:{k:02d}" for k in range(30)],
}


@pytest.mark.parametrize("name", MOMENTS)
@pytest.mark.parametrize("size", [3, 1000])
def test_moments_in_chunks_are_those_of_the_whole(tmp_path, monkeypatch, name, size):
    monkeypatch.setattr("metrosep.io.text._rows._PART", 64)  # many small blocks
    rows = [f"{t},{k % 7}" for k, t in enumerate(MOMENTS[name])]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,z_um", *rows]) + "\n")
    known = [r for r, t in zip(rows, MOMENTS[name], strict=True) if t != "n/a"]
    whole_path = tmp_path / "whole.csv"
    whole_path.write_text("\n".join(["time,z_um", *known]) + "\n")

    with open_stream(path) as stream:
        chunks = gathered(stream, size)

    given = chunks["time"][np.isfinite(chunks["time"])]
    assert given.tolist() == ms.read(whole_path).t.tolist()
    assert given.size == len(known)


def test_a_day_beside_a_clock_counts_in_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr("metrosep.io.text._rows._PART", 64)
    rows = [f"{5 + k // 6:02d}.03.2026;{4 * (k % 6):02d}:00:00;{k}" for k in range(24)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["Datum;Uhrzeit;z_um", *rows]) + "\n")

    with open_stream(path) as stream:
        chunks = gathered(stream, 5)

    assert stream.time_step == pytest.approx(14400.0, rel=0.0, abs=1e-9)  # whole seconds
    assert chunks["Uhrzeit"].tolist() == ms.read(path).t.tolist()
    assert chunks["Uhrzeit"] == pytest.approx(14400.0 * np.arange(24), rel=0.0, abs=1e-9)


def test_a_day_that_may_be_a_month_is_refused_where_its_time_is_read(tmp_path):
    rows = [f"{1 + k % 9}/{2 + k % 5}/2026 14:07:{k:02d},{k}" for k in range(30)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,z_um", *rows]) + "\n")

    with (
        open_stream(path) as stream,
        pytest.raises(ms.errors.ReadError, match=r"line 2.*day/month or month/day"),
    ):
        gathered(stream, 10)
    with open_stream(path, channels=["z_um"]) as stream:
        assert gathered(stream, 10)["z_um"].size == 30


def test_chunk_without_samples_is_refused(table):
    path, _ = table(10)

    with open_stream(path) as stream, pytest.raises(ms.errors.DataError, match="at least one"):
        next(iter(stream.chunks(0)))


def test_time_that_is_counted_by_rows_is_refused_where_their_own_numbers_have_a_gap(
    tmp_path,
):
    """The row after number 49 was taken 31 ms after it, not 1 ms: in a later piece, too."""
    path = tmp_path / "gap.csv"
    numbers = [k if k < 50_000 else k + 30 for k in range(60_000)]
    path.write_text("n,z_um\n" + "".join(f"{k},{k % 7}.5\n" for k in numbers))
    with (
        pytest.raises(
            ms.errors.FormatMismatchError, match=r"line 50002: column 'n'.* 49999 to 50030"
        ),
        open_stream(path, sampling_rate="1 kHz") as stream,
    ):
        list(stream.chunks(1000))
    with open_stream(path, channels=["z_um"], sampling_rate="1 kHz") as stream:
        assert sum(part["z_um"].size for part in stream.chunks(1000)) == 60_000
    assert any("49999 to 50030" in said for said in stream.warnings)
    path.write_text("n,z_um\n" + "".join(f"{10 * k},{k % 7}.5\n" for k in range(600)))
    with open_stream(path, sampling_rate="1 kHz") as stream:  # every tenth is no gap
        assert sum(part["z_um"].size for part in stream.chunks(100)) == 600
    assert stream.warnings == ()

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


def test_labels_are_refused(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text("run,z_um\na,1\nb,2\n")

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'run' holds text"):
        open_stream(path)


def test_chunk_without_samples_is_refused(table):
    path, _ = table(10)

    with open_stream(path) as stream, pytest.raises(ms.errors.DataError, match="at least one"):
        next(iter(stream.chunks(0)))

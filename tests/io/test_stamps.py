"""Stamps of loggers through the door: the seconds are those a calendar says, or the file is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

import metrosep as ms
from metrosep.errors import ReadError
from metrosep.io.stream import open_stream

NS = 1e-9
"""Stamps are whole nanoseconds."""
Z = (1.25, 1.5, 1.75, 1.7, 1.1)  # um


def _seconds(put, stamps):
    rows = "".join(f"{t},{z}\n" for t, z in zip(stamps, Z, strict=False))
    recording = ms.read(put("time,probe_um\n" + rows))
    assert isinstance(recording, ms.Recording)
    return [float(t) for t in recording.t]


DAY = 86400.0
READ = {
    "the day rises, no other order has such months": (
        ["25-03-28 12:00:00", "25-03-29 12:00:00", "25-04-01 12:00:00"],
        [0.0, DAY, 4 * DAY],
    ),
    "even steps over midnight": (
        ["25-03-01 23:59:58", "25-03-01 23:59:59", "25-03-02 00:00:00", "25-03-02 00:00:01"],
        [0.0, 1.0, 2.0, 3.0],
    ),
    "the year first with points": (
        ["26.03.31 23:59:58", "26.03.31 23:59:59", "26.04.01 00:00:00", "26.04.01 00:00:01"],
        [0.0, 1.0, 2.0, 3.0],
    ),
    "a year that is no day": (["32.12.31 23:59:59", "33.01.01 00:00:00"], [0.0, 1.0]),
    "the day first with points": (
        ["05.03.26 23:59:58", "05.03.26 23:59:59", "06.03.26 00:00:00", "06.03.26 00:00:01"],
        [0.0, 1.0, 2.0, 3.0],
    ),
    "all of one day": (["25-03-01 12:00:00", "25-03-01 12:00:01"], [0.0, 1.0]),
    "summer time begins": (
        ["2025-03-30T01:59:58+01:00", "2025-03-30T01:59:59+01:00", "2025-03-30T03:00:00+02:00"],
        [0.0, 1.0, 2.0],
    ),
    "summer time ends": (
        ["2025-10-26T02:59:58+02:00", "2025-10-26T02:59:59+0200", "2025-10-26T02:00:00+01:00"],
        [0.0, 1.0, 2.0],
    ),
    "west of Greenwich, minutes too": (
        ["2025-01-01T00:00:00-03:30", "2025-01-01T03:30:01Z", "2025-01-01T03:30:02Z"],
        [0.0, 1.0, 2.0],
    ),
    "a century ends": (["31.12.99 23:59:59", "01.01.00 00:00:00"], [0.0, 1.0]),
    "without marks": (["20261130T235959Z", "20261201T000000Z"], [0.0, 1.0]),
    "without marks, with a zone": (
        ["20261129T101500.250+0100", "20261129T091500.750Z"],
        [0.0, 0.5],
    ),
    "without marks, hours of the zone alone": (
        ["20261129T101500.250+01", "20261129T064500.750-0230", "20261129t091501z"],
        [0.0, 0.5, 0.75],
    ),
    "with marks, hours of the zone alone": (
        ["2026-11-29T10:15:00+01", "2026-11-29t09:15:01z"],
        [0.0, 1.0],
    ),
    "without marks and seconds": (["20261129T1015", "20261129T1016"], [0.0, 60.0]),
    "a leap second": (["2016-12-31 23:59:59", "2016-12-31 23:59:60"], [0.0, 1.0]),
    "noon": (["1 March 2025 12:59:59 PM", "1 March 2025 01:00:00 PM"], [0.0, 1.0]),
}


@pytest.mark.parametrize("name", READ)
def test_seconds_are_those_of_the_calendar(put, name):
    stamps, seconds = READ[name]
    assert _seconds(put, stamps) == pytest.approx(seconds, abs=NS)


REFUSED = {
    "year or day first": (
        ["25-03-01 12:00:00", "25-03-02 12:00:00", "25-03-03 12:00:00"],
        "begin with the year.*sampling_rate=",
    ),
    "year or day first with points": (["26.03.01", "26.03.02", "26.03.03"], "begin with the year"),
    "zone in some rows": (
        ["2025-03-01T12:00:00Z", "2025-03-01T12:00:01", "2025-03-01T12:00:02Z"],
        "line 3: .*only some state their offset",
    ),
    "before any clock": (["2000-01-01 00:00:00", "1600-01-01 00:00:00"], "line 3: .*1900 to 2149"),
    "no such day, without marks": (
        ["20260228T101500", "20260231T101500"],
        "line 3: no order of day",
    ),
    "hour 25, without marks": (
        ["20260228T231500", "20260228T251500"],
        "line 3: .*not a time of day",
    ),
    "hour 25": (["2025-03-01 12:00:00", "2025-03-01 25:59:58"], "line 3: .*not a time of day"),
    "minute 75": (["12:15:58", "12:75:58"], "line 3: .*not a time of day"),
    "second 73": (["12:15:58", "12:15:73"], "line 3: .*not a time of day"),
    "13 PM": (["2025-03-01 12:59:59 PM", "2025-03-01 13:00:00 PM"], "line 3: .*not a time of day"),
    "69 is 1969, 68 is 2068": (
        ["31.12.68 23:59:59", "01.01.69 00:00:00"],
        "line 3: .*falls back by 3.15576e\\+09 s",
    ),
    "no month": (["29 May 2025 12:00:00", "30 Mayonnaise 2025 12:00:00"], "line 3: no order"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_no_calendar_says_is_refused_with_the_line(put, name):
    stamps, reason = REFUSED[name]
    with pytest.raises(ReadError) as refused:
        _seconds(put, stamps)
    assert re.search(reason, str(refused.value)), refused.value


def test_a_year_of_two_digits_is_no_matter_of_the_clock_of_the_computer(put):
    """A file of 2031 on a computer of 2026 is not one of 1931."""
    text = "time,probe_um\n05.03.31 12:00:00,1\n05.03.31 12:00:01,2\n"
    assert ms.read(put(text)).metadata["header"]["clocks"]["time"] == "2031-03-05T12:00:00"


def test_a_stream_does_not_take_a_year_for_a_day(put):
    rows = [f"26.03.{d:02d} {h:02d}:00:00,{h}" for d in (5, 6) for h in (22, 23)]
    path = put("time,probe_um\n" + "\n".join(rows) + "\n")
    with open_stream(path) as stream, pytest.raises(ReadError, match=r"line 4: .*with the year"):
        list(stream.chunks(10))


def test_a_clock_beside_dates_of_unknown_order_is_not_read_without_them(put):
    rows = "25-03-01,12:00:00,1\n25-03-02,12:00:01,2\n25-03-04,12:00:02,3\n"
    with pytest.raises(ReadError, match=r"line 2: .*begin with the year"):
        ms.read(put("date,time,probe_um\n" + rows))


COUNTS = {
    "FILETIME": ("FILETIME", 133_500_000_000_000_001, 0, 1e-7, None),
    "ns since 1970": ("timestamp", 1_772_719_629_500_000_001, 0, 1e-9, None),
    "ns that the caller declares": ("timestamp", 1_772_719_629_500_000_001, 0, 1e-9, "ns"),
    "us in the name": ("t_us", 1_772_719_629_500_001, 0, 1e-6, None),
    "ms that the caller declares": ("timestamp", 1_772_719_629_501, 0, 1e-3, "ms"),
    "decimal s": ("timestamp", 1_772_719_629_123_457, 6, 1e-6, "s"),
    "s to the ns in the name": ("t_s", 1_772_719_629_123_456_789, 9, 1e-9, None),
    "s since 1904": ("timestamp", 3_855_600_000_250_001, 6, 1e-6, None),
}
"""Name, first count, how many of its digits are decimals, s of a count, the unit that the caller gives."""


@pytest.mark.parametrize("kind", COUNTS)
def test_a_count_from_a_date_keeps_all_its_digits(kind, put):
    name, start, decimals, tick, unit = COUNTS[kind]
    counts = [0, 3, 5, 100_007, 100_008, 200_001]  # no multiples of what a float of them resolves
    texts = [str(start + k) for k in counts]
    if decimals:
        texts = [f"{t[:-decimals]}.{t[-decimals:]}" for t in texts]
    text = f"{name};z_um\n" + "".join(f"{t};{z}\n" for t, z in zip(texts, (*Z, 1.2), strict=True))

    read = ms.read(put(text), **({"time": f"{name}:{unit}"} if unit else {}))

    assert [float(t) for t in read.t] == pytest.approx(
        [k * tick for k in counts], rel=1e-15, abs=0.0
    )
    said = " ".join(read.metadata["warnings"])
    assert "since" in said or f"first row, which is at {texts[0]}" in said


def test_a_time_from_the_start_of_a_logger_stays(put):
    read = ms.read(put("t_s;z_um\n" + "".join(f"{5.5 + k};{z}\n" for k, z in enumerate(Z))))

    assert [float(t) for t in read.t] == [5.5, 6.5, 7.5, 8.5, 9.5]
    assert read.metadata["warnings"] == ()


def test_a_stream_over_new_year_does_not_fall_by_thirty_years(tmp_path):
    days = ["25.12.31 23:59:58", "25.12.31 23:59:59", "26.01.01 00:00:00", "26.01.01 00:00:01"]
    path = tmp_path / "ny.csv"
    path.write_text("Zeit;z_um\n" + "".join(f"{d};{k}.5\n" for k, d in enumerate(days)))
    assert list(ms.read(path).t) == [0.0, 1.0, 2.0, 3.0]
    with open_stream(path) as stream, pytest.raises(ReadError, match=r"line 4: .*with the year"):
        list(stream.chunks(10))


@pytest.mark.parametrize("digits", [9, 6, 3, 0])
def test_runs_keep_every_digit_of_a_count_from_a_date(tmp_path, digits):
    unit = {9: "s", 6: "ms", 3: "us", 0: "ns"}[digits]
    ns = [1_767_225_600_123_456_789 + 1_000_037 * k + (k % 7) for k in range(60)]
    path = tmp_path / "runs.csv"
    rows = []
    for k, count in enumerate(ns):
        whole, rest = divmod(count, 10**digits)
        stamp = f"{whole}.{rest:0{digits}d}" if digits else f"{whole}"
        rows.append(f"{k // 30};{stamp};{k % 30};{k % 7}")
    path.write_text("\n".join([f"run;time_{unit};x_mm;z_um", *rows]) + "\n")

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="run", time=f"time_{unit}")

    t = np.concatenate([r.t for r in runs])
    np.testing.assert_allclose(t, [(v - ns[0]) * 1e-9 for v in ns], rtol=0.0, atol=1e-15)
    assert any("counts from a date" in w for w in runs.metadata["warnings"])

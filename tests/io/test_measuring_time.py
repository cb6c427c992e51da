"""Dates of measuring: those of the samples, of a real file, and none where writers have no clock."""

import pytest

import metrosep as ms
from metrosep.io.own_notes import measured_at, moment_of


@pytest.mark.parametrize(
    ("sample", "date"),
    [
        ("sdf/samples/binary-bcr-type1.sdf", "2026-01-03T12:00:00"),
        ("x3p/samples/ascii-offset.x3p", "2026-01-03T00:00:00"),
        ("digital-surf/samples/dos-micro.sur", "2026-01-03T09:15:30"),
        ("metropro/samples/format1.dat", "2026-01-03T00:00:00+00:00"),
        ("zygo-xyz/samples/calibrated.xyz", "2026-01-03T00:00:00+00:00"),
        ("plu/samples/bare.plu", "2026-01-03T09:15:30+00:00"),
    ],
)
def test_samples_state_their_date(repository, sample, date):
    options = {"row_order": "top row first"} if sample.endswith(".xyz") else {}

    assert measured_at(ms.read(repository / "data_formats" / sample, **options).metadata) == date


@pytest.mark.parametrize("name", ["a.sdf", "a.x3p", "a.sur"])
def test_files_without_a_clock_have_no_date(tmp_path, name):
    ms.write(ms.Surface([[0.0, 1e-9], [2e-9, 0.0]], 1e-6, 1e-6), tmp_path / name)
    assert measured_at(ms.read(tmp_path / name).metadata) is None


@pytest.mark.parametrize(
    "header",
    [{}, {"CreateDate": "no date"}, {"CreateDate": "310220261200"}, {"CreateDate": None}],
)
def test_what_is_no_date_is_none(header):
    assert measured_at({"format": "sdf", "header": header}) is None


def test_a_reader_of_another_package_may_say_it_itself():
    assert measured_at({"measured_at": "2026-01-03 10:00", "format": "x"}) == "2026-01-03T10:00:00"
    assert measured_at({"measured_at": "yesterday"}) is None
    assert measured_at({}) is None


def test_an_offset_counts():
    assert moment_of("2026-01-03T00:30:00+02:00").isoformat() == "2026-01-02T22:30:00"

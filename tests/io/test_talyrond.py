"""Roundness worksheets: the real one, what must be declared, undulations by hand, damage."""

import math
import zipfile

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.check import describe
from metrosep.io.containers.worksheets import talyrond
from metrosep.io.declared import Match
from metrosep.io.source import RawFile

UM = 1e-6
DOUBLE = 1e-12  # relative; a product of two doubles


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "talyrond" / "samples"


@pytest.fixture
def real(corpus):
    return corpus / "round" / "talyrond_profile.xlsx"


def test_real_trace_as_openpyxl_reads_it(real):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(real, data_only=True, read_only=True)
    rows = list(book.worksheets[0].iter_rows(values_only=True))
    book.close()
    truth = np.array([row[:2] for row in rows], dtype=float)

    profile = ms.read(real, unit="um", radius="10 mm")

    assert len(profile) == 3600
    assert profile.n_invalid == 0
    np.testing.assert_allclose(profile.z, truth[:, 1] * UM, rtol=DOUBLE)
    np.testing.assert_allclose(profile.x, np.deg2rad(truth[:, 0]) * 0.01, rtol=DOUBLE)
    assert profile.metadata["is_closed"]
    assert profile.metadata["angle_step_rad"] == pytest.approx(math.tau / 3600, rel=1e-9, abs=0.0)


def test_real_column_is_a_deviation_and_no_radius(real):
    """Its mean is zero and one undulation per revolution carries it: a part out of centre."""
    profile = ms.read(real, unit="um", radius="10 mm")

    amplitudes = 2 * np.abs(np.fft.rfft(profile.z)) / len(profile)

    assert abs(profile.metadata["mean_deviation_m"]) < 1e-12
    assert amplitudes[1] == pytest.approx(201.373 * UM, abs=0.001 * UM)
    assert amplitudes[2:].max() < 0.005 * amplitudes[1]


def test_unit_and_radius_are_never_guessed(real):
    with pytest.raises(ms.errors.UnitError, match="unit='um'"):
        ms.read(real, radius="10 mm")
    with pytest.raises(ms.errors.FormatMismatchError, match=r"P-V 406\.3 um.*radius='25 mm'"):
        ms.read(real, unit="um")
    with pytest.raises(ms.errors.UnitError, match="deg"):
        ms.read(real, unit="deg", radius="10 mm")


@pytest.mark.parametrize("radius", [0.0, -1.0, "-2 mm"])
def test_radius_must_be_positive(samples, radius):
    with pytest.raises(ms.errors.DataError, match="positive"):
        ms.read(samples / "turn.xlsx", unit="um", radius=radius)


def test_radius_scales_positions_only(samples):
    small, large = (ms.read(samples / "turn.xlsx", unit="um", radius=r) for r in ("1 mm", "3 mm"))

    np.testing.assert_allclose(large.x, 3 * small.x, rtol=DOUBLE)
    np.testing.assert_array_equal(large.z, small.z)
    assert small.metadata["radius_declared_m"] == 1e-3


def test_half_a_turn_is_not_closed(samples, tmp_path):
    path = tmp_path / "half.xlsx"
    with zipfile.ZipFile(samples / "turn.xlsx") as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            text = old.read(name).decode()
            if "sheet1" in name:
                text = text[: text.index('<row r="5">')] + "</sheetData></worksheet>"
            new.writestr(name, text)

    profile = ms.read(path, unit="um", radius="1 mm")

    assert len(profile) == 4
    assert not profile.metadata["is_closed"]


def test_other_workbooks_are_not_traces(corpus, repository):
    for path in (
        corpus / "st" / "mitutoyo_mock.xlsx",
        corpus / "st" / "mitutoyo_2_mock.xlsx",
        repository / "data_formats" / "mitutoyo-xlsx" / "samples" / "plain.xlsx",
    ):
        assert talyrond.sniff(RawFile(path, path.read_bytes()[:65536])) is Match.NO
        with pytest.raises(ms.errors.ReadError):
            ms.read(path, format="talyrond", unit="um", radius="1 mm")


def test_lateral_step_is_refused(samples):
    with pytest.raises(ms.errors.ReadError, match="takes no lateral_step"):
        ms.read(samples / "turn.xlsx", unit="um", radius="1 mm", lateral_step="1 um")


def test_nist_circle_list_beside_it_is_a_plain_table(corpus):
    found = describe(corpus / "round" / "cir2d30.csv")

    assert (found["format"], found["kind"], found["shape"]) == ("delimited", "table", [500, 3])


def test_damage(samples, survives_damage):
    survives_damage(talyrond, samples / "turn.xlsx", every=11, unit="um", radius="1 mm")

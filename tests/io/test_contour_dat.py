"""Contour DAT: the real file, order of the points, counts that are hints, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.point_lists import contour_dat

NM = 1e-9
DOUBLE = 1e-12  # relative; a factor of 1e-3
MANIFEST = 1e-6  # relative; digits of the manifest


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "contour-dat" / "samples"


def test_real_file_as_the_manifest_gives_it(corpus):
    path = corpus / "upm" / "1021-contour.DAT"
    truth = np.loadtxt(path, delimiter=",", skiprows=2) * 1e-3

    profile = ms.read(path)

    assert len(profile) == 12001
    assert profile.n_invalid == 0
    assert profile.dx == pytest.approx(1e-6, rel=MANIFEST, abs=0.0)
    assert profile.peak_to_valley() == pytest.approx(5407985 * NM, rel=MANIFEST, abs=0.0)
    assert profile.rms() == pytest.approx(1691867 * NM, rel=MANIFEST, abs=0.0)
    np.testing.assert_allclose(profile.z[::-1], truth[:, 1], rtol=DOUBLE)
    assert profile.z[0] != profile.z[-1]  # so that a file that was not turned would be seen
    assert profile.metadata["point_order_in_file"] == "largest x first"


def test_step_override_is_recorded(samples):
    profile = ms.read(samples / "falling.dat", lateral_step="2 um")

    assert profile.dx == pytest.approx(2e-6, rel=DOUBLE, abs=0.0)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(
        0.25e-3, rel=DOUBLE, abs=0.0
    )
    assert profile.metadata["lateral_step_override_m"] == 2e-6


def test_unit_and_channel_are_refused(samples):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(samples / "falling.dat", unit="um")
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'height'"):
        ms.read(samples / "falling.dat", channel="slope")


def test_height_not_measured(samples, put):
    text = (samples / "falling.dat").read_text().replace("8.000000000000000", "nan")

    profile = ms.read(put(text))

    assert np.flatnonzero(np.isnan(profile.z)).tolist() == [1]


@pytest.mark.parametrize(
    "text",
    [
        "mm\n3\n1 2\n2 3\n",
        "x\n3\n1, 2\n2, 3\n",
        "mm\n3.5\n1, 2\n2, 3\n",
        "mm, um\n3\n1, 2\n",
        "s\n3\n1, 2\n2, 3\n",
        "mm\n3\n1, 2, 3\n",
        "mm\n2\n1,2\n2,3\n",
        "mm\n2\n1, 2\n2, 3\n",
        "mm\n3\n",
    ],
)
def test_similar_text_is_not_a_contour(text):
    assert contour_dat.sniff(RawFile(Path("contour.DAT"), text.encode())) is Match.NO


def test_plain_table_gives_the_same_numbers(corpus):
    path = corpus / "upm" / "1021-contour.DAT"

    ours, table = ms.read(path), ms.read(path, format="delimited")

    assert ours.metadata["format"] == "contour-dat"
    np.testing.assert_array_equal(ours.x, table.x)
    np.testing.assert_array_equal(ours.z, table.z)


def test_other_text_named_as_a_contour_is_a_mismatch(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="line 1"):
        ms.read(put("x,z\n1,2\n"), format="contour-dat")


def test_damage(samples, survives_damage):
    survives_damage(contour_dat, samples / "falling.dat")

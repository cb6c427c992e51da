"""Gwyddion ASCII: real exports in two languages, order of the rows, decimal comma, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text import gwyddion_ascii

NM = 1e-9
DOUBLE = 1e-12  # relative; a product of two doubles
MANIFEST = 1e-6  # relative; digits of the manifest


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "gwyddion-ascii" / "samples"


@pytest.mark.parametrize("language", ["english", "german"])
def test_real_file_as_the_manifest_gives_it(corpus, language):
    path = corpus / "st" / f"gwyddion-export-{language}.txt"

    surface = ms.read(path)

    assert surface.shape == (4, 3)
    assert surface.n_invalid == 0
    assert surface.dx == pytest.approx(4.113333333333333e-6, rel=DOUBLE, abs=0.0)
    assert surface.dy == pytest.approx(5678.9 * NM / 4, rel=DOUBLE, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(1.5e10 * NM, rel=MANIFEST, abs=0.0)
    assert surface.rms() == pytest.approx(4.705752e9 * NM, rel=MANIFEST, abs=0.0)
    np.testing.assert_array_equal(surface.z[::-1], np.loadtxt(path, comments="#"))
    assert surface.metadata["title"] == "My Channel Name"


def test_top_row_of_the_file_has_the_largest_y(samples):
    surface = ms.read(samples / "english.txt")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (1, 0)
    assert np.isnan(surface.z[0, 1])
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_step_override_is_recorded(samples):
    surface = ms.read(samples / "english.txt", lateral_step=("1 um", "3 um"))

    assert (surface.dx, surface.dy) == (1e-6, 3e-6)
    assert surface.metadata["lateral_step_in_file_m"] == pytest.approx(
        (2e-6, 0.5e-6), rel=DOUBLE, abs=0.0
    )


def test_unit_contradicting_the_file_is_refused(samples):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(samples / "english.txt", unit="um")


def test_words_of_the_file_are_the_keys_of_the_header(samples):
    header = ms.read(samples / "german-comma.txt").metadata["header"]

    assert header == {
        "Kanal": "made up",
        "Breite": "6,0 µm",
        "Höhe": "1000 nm",
        "Werteinheiten": "nm",
    }


@pytest.mark.parametrize("width", ["0 um", "nan um"])
def test_width_that_is_no_size_is_never_a_step(samples, put, width):
    text = (samples / "english.txt").read_text().replace("6 µm", width)

    if width == "0 um":
        assert ms.read(put(text)).dx is None
    else:
        assert gwyddion_ascii.sniff(RawFile(Path("a.txt"), text.encode())) is Match.NO


def test_map_of_kilometres_is_refused(samples, put):
    text = (samples / "english.txt").read_text().replace("6 µm", "6000 m")

    with pytest.raises(ms.errors.CorruptFileError, match="Width"):
        ms.read(put(text))


@pytest.mark.parametrize(
    "text",
    [
        "# a: b\n# c: d\n# e: f\n# g: h\n1 2 3\n",
        "# Channel: x\n# Width: 1 um\n# Height: 1 um\n1 2 3\n",
        "# Channel: x\n# Width: 1 um\n# Height: 1 um\n# Value units: m\nx y z\n",
        "# Channel: x\n# Width: 1 um\n# Height: 1 um\n# Value units: m\n",
        "# t: 1\n# w: 1 um\n# h: 2 um\n# n: 3\n1 2\n",
    ],
)
def test_other_text_with_comments_is_not_an_export(text):
    assert gwyddion_ascii.sniff(RawFile(Path("a.txt"), text.encode())) is Match.NO


def test_damage(samples, survives_damage):
    survives_damage(gwyddion_ascii, samples / "english.txt")
    survives_damage(gwyddion_ascii, samples / "german-comma.txt")

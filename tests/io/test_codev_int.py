"""Code V interferograms: real file, scale, orientation, headers that lie, and the writer."""

import re
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.registry import identify
from metrosep.io.source import RawFile
from metrosep.io.text import codev_int
from metrosep.io.text.codev_int import int_bytes, quantisation_step

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
FM = 1e-15
ROUNDING = 1e-9  # relative: the scale is written with 15 digits


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "codev-int" / "samples"


@pytest.fixture
def edited(folder, put):
    """Write the plain sample with one text replaced and return its path."""

    def write(old, new):
        text = (folder / "surface.int").read_text(encoding="ascii")
        assert old in text
        return put(text.replace(old, new, 1), "edited.int")

    return write


def mini_reader(data):
    """Return heights in um, top row first, as the format's description says; no metrosep in it."""
    lines = [t for t in data.decode("ascii").split("\n") if not t.startswith("!")]
    words = lines[1].split()
    nx, ny = int(words[1]), int(words[2])
    values = {k: float(words[words.index(k) + 1]) for k in ("WVL", "SSZ", "NDA")}
    raw = np.array(" ".join(lines[2:]).split(), dtype=np.int64)
    assert raw.min() >= -32768
    assert raw.max() <= 32767
    heights = raw * values["WVL"] / values["SSZ"]
    heights[raw == values["NDA"]] = np.nan
    return heights.reshape(ny, nx), words[3]


def test_real_file_as_the_manifest_gives_it(corpus):
    path = corpus / "prysm" / "valid_codev_int_file.int"

    surface = ms.read(path)

    assert identify(path).id == "codev-int"
    assert surface.shape == (256, 256)
    assert surface.n_invalid == 14105
    assert (surface.dx, surface.dy) == (None, None)
    assert surface.peak_to_valley() == pytest.approx(54.5454 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(10.88324 * NM, rel=REL, abs=0.0)


def test_rows_of_the_real_file_are_turned(corpus):
    path = corpus / "prysm" / "valid_codev_int_file.int"
    raw = np.array(path.read_text().split("-32768\n", 1)[1].split(), dtype=int).reshape(256, 256)

    z = ms.read(path).z

    expected = np.where(raw == -32768, np.nan, raw * (0.6328e-6 / 65536))
    np.testing.assert_allclose(z[::-1], expected, rtol=0, atol=FM)
    assert not np.array_equal(z, z[::-1], equal_nan=True)


def test_top_row_of_the_file_has_the_largest_y(folder):
    surface = ms.read(folder / "surface.int")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (0, 3)
    assert np.isnan(surface.z[2, 3])
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_wavefront_is_recorded_and_not_halved(folder, edited):
    surface, wavefront = ms.read(folder / "surface.int"), ms.read(edited(" SUR ", " WFR "))

    np.testing.assert_array_equal(wavefront.z, surface.z)
    assert surface.metadata["data_kind"] == "surface"
    assert wavefront.metadata["data_kind"] == "wavefront"


def test_scale_and_header_are_recorded(folder):
    metadata = ms.read(folder / "surface.int").metadata

    assert metadata["wavelength_m"] == pytest.approx(632.8 * NM, abs=FM)
    assert metadata["counts_per_wave"] == 65536.0
    assert metadata["height_per_count_m"] == pytest.approx(0.6328e-6 / 65536, abs=1e-21)
    assert metadata["header"]["comments"] == ["planted bump"]
    assert metadata["header"]["NDA"] == "-32768"


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("SSZ 65536.000000", "SSZ 0", "SSZ"),
        ("SSZ 65536.000000", "SSZ nan", "SSZ"),
        ("SSZ 65536.000000", "SSZ -1", "SSZ"),
        ("WVL 0.6328", "WVL 0", "WVL"),
        ("WVL 0.6328", "WVL inf", "WVL"),
        (" WVL 0.6328", "", "WVL"),
        ("NDA -32768", "NDA", "NDA"),
        ("GRD 4 3", "GRD 4 x", "two whole numbers"),
        ("GRD 4 3", "GRD 0 3", "GRD nx"),
        ("GRD 4 3", "GRD 4 4", "do not fill the grid"),
        ("GRD 4 3", "GRD 4 2", "do not fill the grid"),
        (" 9000 ", " 9000.5 ", "not a whole number"),
        (" 9000 ", " 9OO0 ", "'9OO0'"),
        (" 9000 ", " nan ", "not a whole number"),
    ],
)
def test_text_that_lies_is_a_corrupt_file(edited, old, new, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(edited(old, new))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("GRD 4 3 SUR", "ZRN 36 SUR", "Zernike"),
        (" SUR ", " SUR XSC -1 ", "'XSC'"),
        (" SUR ", " ", "unnamed kind"),
    ],
)
def test_what_is_not_read_is_named(edited, old, new, match):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match=match):
        ms.read(edited(old, new))


@pytest.mark.parametrize(
    "text", ["1 2 3\n4 5 6\n", "! a\ntitle\n1 2 3\n", "title\nGRD 4 3\n1 2\n", "\0\1\2"]
)
def test_other_text_is_not_taken_for_it(put, text):
    assert codev_int.sniff(RawFile(Path("surface.int"), text.encode())) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="is not a Code V"):
        ms.read(put(text), format="codev-int")


def test_damaged_files_are_refused_or_read(folder, survives_damage):
    survives_damage(codev_int, folder / "surface.int")


def test_written_grid_is_within_half_a_step_for_an_independent_reader(bump):
    step = quantisation_step(bump)

    heights, kind = mini_reader(int_bytes(bump))

    assert kind == "SUR"
    middle = (np.nanmax(bump.z) + np.nanmin(bump.z)) / 2
    error = heights[::-1] * 1e-6 + middle - bump.z
    assert np.nanmax(np.abs(error)) <= step / 2 * (1 + ROUNDING)
    np.testing.assert_array_equal(np.isnan(heights[::-1]), np.isnan(bump.z))
    assert step == pytest.approx((90 * NM + NM / 3) / 65534, rel=ROUNDING, abs=0.0)


def test_written_grid_uses_the_whole_range_of_16_bits(bump):
    body = int_bytes(bump).partition(b"GRD ")[2].splitlines()[1:]
    counts = [int(v) for line in body for v in line.split()]

    assert max(counts) == 32767
    assert min(c for c in counts if c != -32768) == -32767


def test_written_grid_is_read_back_by_metrosep(bump, put):
    path = put(int_bytes(bump, wavelength=1.55e-6, kind="WFR", title="bump 7"), "bump.int")

    back = ms.read(path, lateral_step=(bump.dx, bump.dy))

    assert back.peak_to_valley() == pytest.approx(bump.peak_to_valley(), rel=ROUNDING, abs=0.0)
    assert np.unravel_index(np.nanargmax(back.z), back.shape) == (0, 4)
    assert back.metadata["data_kind"] == "wavefront"
    assert back.metadata["wavelength_m"] == pytest.approx(1.55e-6, rel=ROUNDING, abs=0.0)
    assert back.metadata["header"]["title"].startswith("bump 7 (step 1.37842 pm)")


def test_a_map_far_from_zero_comes_back_at_its_height_and_place(bump, tmp_path):
    """Counts hold the relief only; who looks for a thickness or a sag needs the height of count 0 too."""
    far = ms.Surface(bump.z - 4e-6, bump.dx, bump.dy, origin=(1e-3, -2e-3))
    path = tmp_path / "far.int"
    ms.write(far, path)

    back = ms.read(path)

    half = quantisation_step(far) / 2 * (1 + ROUNDING)
    np.testing.assert_allclose(back.z, far.z, rtol=0.0, atol=half)
    assert (back.origin, back.dx, back.dy) == ((1e-3, -2e-3), bump.dx, bump.dy)
    words = path.read_bytes().replace(b"written by metrosep", b"written by somebody")
    other = ms.read(_put(tmp_path, words), lateral_step=(bump.dx, bump.dy))
    assert np.nanmax(other.z) == pytest.approx(-np.nanmin(other.z), rel=0.0, abs=2 * half)
    assert other.origin == (0.0, 0.0)


def _put(folder, content):
    path = folder / "other.int"
    path.write_bytes(content)
    return path


def test_lateral_steps_in_our_own_comments_are_read_back_and_those_of_others_are_not(put):
    own = int_bytes(ms.Surface(np.arange(12.0).reshape(3, 4) * NM, dx=1.5e-6, dy=2.5e-7))
    back = ms.read(put(own, "own.int"))
    other = ms.read(put(own.replace(b"written by metrosep", b"written by somebody"), "b.int"))

    assert (back.dx, back.dy) == (1.5e-6, 2.5e-7)
    assert (other.dx, other.dy) == (None, None)


def test_same_surface_gives_the_same_bytes_in_records_of_80(bump):
    data = int_bytes(bump)

    assert data == int_bytes(bump)
    assert max(len(line) for line in data.splitlines()) <= 80
    assert re.search(rb"! height of count 0: \S+ m\n", data)


def test_flat_surface_is_written_as_zeros():
    heights, _ = mini_reader(int_bytes(ms.Surface(np.full((2, 3), 5e-9))))

    assert np.array_equal(heights, np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"kind": "FIL"}, "'SUR' or 'WFR'"),
        ({"wavelength": 0.6328}, "10 nm to 1 mm"),
        ({"wavelength": float("nan")}, "10 nm to 1 mm"),
        ({"title": "!"}, "does not fit"),
        ({"title": "two\nlines"}, "does not fit"),
        ({"title": "x" * 49}, "does not fit"),
    ],
)
def test_what_does_not_fit_the_format_is_not_written(bump, options, match):
    with pytest.raises(ms.errors.WriteError, match=match):
        int_bytes(bump, **options)


def test_nothing_measured_is_not_written():
    with pytest.raises(ms.errors.WriteError, match="nothing was measured"):
        int_bytes(ms.Surface(np.full((2, 2), np.nan)))


def test_a_program_that_divides_by_the_wavelength_reads_the_same_heights(tmp_path):
    """prysm 0.21 computes 1000 / WVL / SSZ nm per count, the manual says 1000 WVL / SSZ."""
    z = np.arange(25.0).reshape(5, 5) ** 2 * NM
    z[4, 0] = np.nan
    text = ms.write(ms.Surface(z, 1e-6, 1e-6), tmp_path / "map.int").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("!")]
    words = lines[1].split()
    wvl, ssz, nda = (float(words[words.index(key) + 1]) for key in ("WVL", "SSZ", "NDA"))
    counts = np.array([float(v) for line in lines[2:] for v in line.split()]).reshape(5, 5)
    counts[counts == nda] = np.nan

    for nm_per_count in (1000 * wvl / ssz, 1000 / wvl / ssz):
        heights = counts[::-1] * nm_per_count * NM
        half = 0.5 * 576 * NM / 65534
        np.testing.assert_allclose(heights - heights[0, 0] + z[0, 0], z, rtol=0, atol=2.1 * half)


def test_a_title_with_an_exclamation_mark_would_hide_the_grid(tmp_path):
    surface = ms.Surface(np.arange(4.0).reshape(2, 2) * NM, 1e-6, 1e-6)

    with pytest.raises(ms.errors.WriteError, match="without !"):
        ms.write(surface, tmp_path / "map.int", title="part 3! odd")

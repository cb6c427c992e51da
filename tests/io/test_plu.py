"""PLu files: real file, the eight bytes before the heights, layers, orientation, headers that lie."""

import struct
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps.profilers import plu
from metrosep.io.registry import identify, structure
from metrosep.io.source import RawFile, open_file

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
SINGLE = 1e-7  # a number that the file keeps in single precision
EXACT = 1e-12  # double precision after one multiplication


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "plu" / "samples"


@pytest.fixture
def patched(folder, put):
    """Write a sample with fields of the header or of the first layer changed; return its path."""
    codes = {name: (offset, code) for offset, code, name in structure("plu").layout}
    codes |= {
        name: (500 + offset, code) for offset, code, name in structure("plu", "layer").layout
    }

    def write(name="topography.plu", **fields):
        data = bytearray((folder / name).read_bytes())
        for field, value in fields.items():
            offset, code = codes[field]
            struct.pack_into("<" + code, data, offset, value)
        return put(bytes(data), "patched.plu")

    return write


def test_real_file_as_an_independent_reader_gives_it(corpus):
    path = corpus / "st" / "plu-1.plu"

    surface = ms.read(path)

    assert identify(path).id == "plu"
    assert surface.shape == (576, 768)
    assert surface.n_invalid == 0
    assert surface.dx == pytest.approx(1.6600000858306884e-06, rel=REL, abs=0.0)
    assert surface.dy == pytest.approx(1.6600000858306884e-06, rel=REL, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(10015.62 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(2834.391 * NM, rel=REL, abs=0.0)


def test_heights_of_the_real_file_begin_after_the_counts(corpus):
    """A peer begins 8 bytes early: the counts become heights and the map is shifted by two points."""
    path = corpus / "st" / "plu-1.plu"
    data = path.read_bytes()
    assert struct.unpack_from("<II", data, 500) == (576, 768)
    raw = np.array(struct.unpack_from(f"<{576 * 768}f", data, 508)).reshape(576, 768)

    z = ms.read(path).z

    np.testing.assert_allclose(z[::-1], raw * 1e-6, rtol=EXACT, atol=0)
    assert np.abs(z).min() > 1e-6  # a count seen as a float would be a height of zero


def test_top_row_of_the_file_has_the_largest_y(folder):
    surface = ms.read(folder / "topography.plu")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (2, 0)
    assert surface.z[2, 0] == pytest.approx(90.5e-6, rel=EXACT, abs=0.0)
    assert np.isnan(surface.z[2, 3])
    assert surface.n_invalid == 1
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_steps_differ(folder):
    surface = ms.read(folder / "topography.plu")

    assert (surface.dx, surface.dy) == pytest.approx((1.66e-6, 2.5e-6), rel=SINGLE, abs=0.0)


def test_layers_are_channels_with_sizes_of_their_own(folder):
    path = folder / "layers.plu"

    assert plu.channels(open_file(path)) == ("layer 1", "layer 2")
    assert ms.read(path).shape == (3, 4)
    assert ms.read(path, channel="layer 2").shape == (3, 2)
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'layer 1', 'layer 2'"):
        ms.read(path, channel="layer 3")


def test_every_field_is_in_the_header(folder):
    metadata = ms.read(folder / "topography.plu").metadata

    names = {n for _, _, n in structure("plu").layout} | {
        n for _, _, n in structure("plu", "layer").layout
    }
    assert set(metadata["header"]) == names | {"minimum_um", "maximum_um"}
    assert metadata["header"]["comment"] == "planted bump, 5 µm"
    assert metadata["position_m"] == pytest.approx(
        (-52.5e-6, -6042.5e-6, 142.5e-6), rel=EXACT, abs=0.0
    )


def test_fields_of_the_table_do_not_overlap():
    ends = [offset + struct.calcsize("<" + code) for offset, code, _ in structure("plu").layout]

    assert all(end <= structure("plu").layout[i + 1][0] for i, end in enumerate(ends[:-1]))
    assert ends[-1] == 500


def test_lateral_step_override_stands_beside_the_own_value(folder):
    surface = ms.read(folder / "topography.plu", lateral_step=("10 um", 20e-6))

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), rel=EXACT, abs=0.0)
    own = surface.metadata["lateral_step_in_file_m"]
    assert own == pytest.approx((1.66e-6, 2.5e-6), rel=SINGLE, abs=0.0)


def test_profile_without_step_needs_one(patched):
    path = patched("profile.plu", um_per_pixel_x=0.0)

    with pytest.raises(ms.errors.UnitError, match="lateral_step="):
        ms.read(path)
    assert ms.read(path, lateral_step="1 um").dx == pytest.approx(1e-6, rel=EXACT, abs=0.0)


def test_unit_is_refused_since_the_format_has_one(folder):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(folder / "topography.plu", unit="um")


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"layer_rows": 2**31, "layer_columns": 2**31}, "more than 268435456"),
        ({"layer_rows": 0}, "layer_rows"),
        ({"layer_columns": 0}, "layer_columns"),
        ({"layer_columns": 400}, "does not fit"),
        ({"n_layers": 2}, "does not fit|no size|more than"),
        ({"um_per_pixel_x": -1.0}, "um_per_pixel_x"),
        ({"um_per_pixel_y": float("inf")}, "um_per_pixel_y"),
        ({"type": 2}, "several profiles"),
        ({"type": 1}, "the profile has 3 rows"),
    ],
)
def test_header_that_lies_is_a_read_error(patched, fields, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(patched(**fields))


@pytest.mark.parametrize(("rows", "columns"), [(4, 3), (3, 3)])
def test_layer_that_contradicts_the_header_is_a_warning(patched, rows, columns):
    surface = ms.read(patched(layer_rows=rows, layer_columns=columns))

    assert f"{rows} x {columns} points" in surface.metadata["warnings"][0]
    assert "3 x 4 (rows x columns)" in surface.metadata["warnings"][0]


def test_counts_of_the_header_of_the_real_file_are_rows_and_columns(corpus):
    surface = ms.read(corpus / "st" / "plu-1.plu")

    header = surface.metadata["header"]
    for kind in ("calibration_", "area_", "", "layer_"):
        assert (header[f"{kind}rows"], header[f"{kind}columns"]) == surface.shape
    assert surface.metadata["warnings"] == ()


def test_text_with_a_date_is_not_taken(folder, put):
    data = (folder / "topography.plu").read_bytes()

    assert plu.sniff(RawFile(Path("x.csv"), data)) is Match.YES
    assert plu.sniff(RawFile(Path("x.plu"), data[:300])) is Match.NO
    assert (
        plu.sniff(RawFile(Path("x.plu"), b"Fri Mar 10 16:35:59 2023\nx,y\n" + b"1,2\n" * 200))
        is Match.NO
    )
    with pytest.raises(ms.errors.FormatMismatchError, match="a date"):
        ms.read(put("x,y\n1,2\n", "a.plu"), format="plu")


@pytest.mark.parametrize("name", ["topography.plu", "layers.plu", "profile.plu"])
def test_damage_is_a_measurement_or_a_read_error(folder, survives_damage, name):
    survives_damage(plu, folder / name)

"""Mx maps (made here, no real file): units, graph, converters, marker, damage."""

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.io.containers.interferometers import datx
from metrosep.io.containers.native import native_bytes

RTOL = 1e-12  # one multiplication in double precision
ROWS = [[9.0, 1.0, 2.0], [3.0, 4.0, -5.0]]
TEXT = h5py.string_dtype()  # of any length, as other programs write it


def converter(category, base, step):
    record = [("c", TEXT), ("b", TEXT), ("p", h5py.vlen_dtype(np.float64))]
    return np.array([(category, base, np.array([0.0, step, 0.0, 0.0]))], dtype=record)


@pytest.fixture
def make(tmp_path):
    """Write a file with the given maps and return its path."""

    def write(maps=None, graph=None, general=None, **changes):
        path = tmp_path / "map.datx"
        facts = {
            "Unit": np.array(["NanoMeters"], dtype=TEXT),
            "No Data": np.array([2147483640.0]),
            "X Converter": converter("LateralCat", "Pixels", 1e-6),
            "Y Converter": converter("LateralCat", "Pixels", 1e-6),
        }
        with h5py.File(path, "w") as handle:
            if graph is not None:
                row = [("Source", TEXT), ("Link", TEXT), ("Destination", TEXT)]
                handle["MetaData"] = np.array(graph, dtype=row)
            handle.create_group("Attributes/{A}").attrs.update(general or {})
            for name, rows in (maps or {"{S}": ROWS}).items():
                data = handle.create_dataset(f"Data/Surface/{name}", data=np.asarray(rows))
                for key, value in {**facts, **changes}.items():
                    if value is not None:
                        data.attrs[key] = value
        return path

    return write


@pytest.fixture
def read():
    """Read a path as datx, also where the graph is missing."""
    return lambda path, **options: ms.read(path, format="datx", **options)


@pytest.mark.parametrize(
    ("unit", "factor"), [("NanoMeters", 1e-9), ("MicroMeters", 1e-6), ("Meters", 1.0)]
)
def test_unit_of_the_file_is_used(make, read, unit, factor):
    obj = read(make(Unit=np.array([unit], dtype=TEXT)))

    np.testing.assert_allclose(obj.z, np.array(ROWS)[::-1] * factor, rtol=RTOL, atol=0)
    assert obj.metadata["unit_in_file"] == unit


def test_fringes_need_scale_factor_obliquity_and_wavelength(make, read):
    path = make(
        Unit=np.array(["Fringes"], dtype=TEXT),
        Wavelength=np.array([633e-9]),
        **{"Interferometric Scale Factor": [0.5], "Obliquity Factor": [1.1]},
    )

    obj = read(path)

    assert obj.z[1, 0] == pytest.approx(9.0 * 0.5 * 1.1 * 633e-9, rel=RTOL, abs=0.0)
    assert obj.metadata["height_per_unit_m"] == pytest.approx(
        0.5 * 1.1 * 633e-9, rel=RTOL, abs=0.0
    )


def test_fringes_and_nanometres_of_one_relief_give_the_same_heights(make, read):
    relief = np.array([[120.0, -35.0, 0.5], [7.0, 300.0, -80.0]])  # nm
    wavelength, scale_factor = 633e-9, 0.5
    in_nm = read(make({"{S}": relief}))
    path = make(
        {"{S}": relief * 1e-9 / (scale_factor * wavelength)},
        Unit=np.array(["Fringes"], dtype=TEXT),
        Wavelength=[wavelength],
        **{"Interferometric Scale Factor": [scale_factor], "Obliquity Factor": [1.0]},
    )

    in_fringes = read(path)

    np.testing.assert_allclose(in_fringes.z, in_nm.z, rtol=RTOL, atol=0)
    with h5py.File(path, "r+") as handle:  # the trap: the same numbers taken for nm
        handle["Data/Surface/{S}"].attrs["Unit"] = np.array(["NanoMeters"], dtype=TEXT)
    ratio = in_fringes.z / read(path).z
    np.testing.assert_allclose(ratio, wavelength / 2 / 1e-9, rtol=RTOL)


@pytest.mark.parametrize(
    ("name", "value"),
    [("Wavelength", 633.0), ("Interferometric Scale Factor", 0.0), ("Obliquity Factor", np.nan)],
)
def test_unusable_scale_of_fringes_is_refused(make, read, name, value):
    good = {"Wavelength": 633e-9, "Interferometric Scale Factor": 0.5, "Obliquity Factor": 1.0}
    factors = {k: np.array([v]) for k, v in {**good, name: value}.items()}

    with pytest.raises(ms.errors.CorruptFileError, match=name):
        read(make(Unit=np.array(["Fringes"], dtype=TEXT), **factors))


def test_unknown_unit_is_refused(make, read):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'Radians'"):
        read(make(Unit=np.array(["Radians"], dtype=TEXT)))


@pytest.mark.parametrize(
    ("marker", "invalid"),
    [
        (2147483640.0, [2147483640.0, 2147483647.0, np.nan, np.inf]),
        (1e6, [1e6, 2e6]),
        (1.7976931348623157e308, [1.7976931348623157e308]),
        (-1.0, [-1.0]),
    ],
)
def test_marker_is_not_a_height(make, read, marker, invalid):
    rows = [[5.0, -2.0, *invalid]]

    obj = read(make({"{S}": rows}, **{"No Data": np.array([marker])}))

    np.testing.assert_array_equal(np.isfinite(obj.z[0]), [True, True] + [False] * len(invalid))


def test_missing_marker_is_warned_of(make, read):
    warnings = read(make(**{"No Data": None})).metadata["warnings"]

    assert any("No Data" in w for w in warnings)


def test_first_row_of_the_file_is_taken_as_the_top(make, read):
    obj = read(make())

    assert np.unravel_index(obj.z.argmax(), obj.shape) == (1, 0)
    assert obj.metadata["row_order_in_file"] == "top row first"
    assert obj.metadata["orientation_evidence"] == "peer"


def test_steps_may_differ_and_are_replaced(make, read):
    path = make(**{"Y Converter": converter("LateralCat", "Pixels", 3e-6)})

    obj, replaced = read(path), read(path, lateral_step="5 um")

    assert (obj.dx, obj.dy) == pytest.approx((1e-6, 3e-6), rel=1e-9, abs=0.0)
    assert (replaced.dx, replaced.dy) == pytest.approx((5e-6, 5e-6), rel=1e-9, abs=0.0)
    assert replaced.metadata["lateral_step_in_file_m"] == pytest.approx(
        (1e-6, 3e-6), rel=1e-9, abs=0.0
    )


@pytest.mark.parametrize(
    "other",
    [
        None,
        converter("LateralCat", "Pixels", 0.0),
        converter("AngularCat", "Pixels", 1e-6),
        np.array([1.0, 2.0]),
    ],
)
def test_converter_of_another_kind_is_not_calibrated(make, read, other):
    obj = read(make(**{"X Converter": other}))

    assert (obj.dx, obj.dy) == (None, pytest.approx(1e-6, rel=1e-9, abs=0.0))


def test_negative_step_is_refused(make, read):
    with pytest.raises(ms.errors.CorruptFileError, match="X Converter"):
        read(make(**{"X Converter": converter("LateralCat", "Pixels", -1e-6)}))


def test_other_resolution_is_warned_of(make, read):
    general = {"Data Context.Lateral Resolution:Value": np.array([2e-6])}

    warnings = read(make(general=general)).metadata["warnings"]

    assert any("Lateral Resolution 2e-06 m" in w for w in warnings)


def test_graph_leads_to_the_surface(make):
    maps = {"{A}": [[1.0, 2.0]], "{B}": ROWS, "{C}": [[5.0, 6.0]]}
    graph = [
        ("Root", "Measurement", "{M}"),
        ("{M}", "Attributes", "{X}"),
        ("{M}", "Surface", "{N}"),
        ("{N}", "Path", "/Data/Surface/{B}"),
        ("{B}", "Root", "Root"),
    ]
    path = make(maps, graph)

    assert ms.io.read.channels(path) == ("{B}", "{A}", "{C}")
    assert ms.read(path).shape == (2, 3)
    assert ms.read(path, channel="{C}").z[0, 1] == pytest.approx(6e-9, rel=1e-9, abs=0.0)


def test_surface_node_without_path_is_its_own_name(make):
    graph = [("Root", "Measurement", "{M}"), ("{M}", "Surface", "{B}")]
    path = make({"{A}": [[1.0, 2.0]], "{B}": ROWS}, graph)

    assert ms.io.read.channels(path) == ("{B}", "{A}")


def test_several_surfaces_without_graph_are_warned_of(make, read):
    obj = read(make({"{B}": ROWS, "{A}": [[1.0, 2.0]]}))

    assert obj.shape == (1, 2)
    assert any("channel=" in w for w in obj.metadata["warnings"])


def test_file_without_surface_is_refused(make, read, tmp_path):
    path = tmp_path / "none.datx"
    with h5py.File(path, "w") as handle:
        handle["MetaData"] = np.array([1.0])

    with pytest.raises(ms.errors.CorruptFileError, match="holds no surface"):
        read(path)


def test_copy_in_own_hdf5_is_not_taken_for_mx(make, read, put):
    obj = read(make(general={"Surface": "MetaData Attributes"}))

    copied = ms.read(put(native_bytes(obj), "copy.h5"))

    assert copied.metadata["source"]["format"] == "datx"


@pytest.mark.slow
def test_damage_is_refused_or_harmless(make, survives_damage):
    survives_damage(datx, make(), every=251)


def test_a_flipped_byte_of_the_mark_for_not_measured_is_no_height(repository, put):
    """Heights bear no checksum: a byte of the marker in the map, or of the one beside it, may flip."""
    whole = (repository / "data_formats/datx/samples/nanometres.datx").read_bytes()
    marker = np.float64(np.finfo(np.float64).max).tobytes()
    places = [i for i in range(len(whole)) if whole.startswith(marker, i)]
    assert len(places) == 2

    for at in (place + byte for place in places for byte in (1, 6, 7)):
        content = bytearray(whole)
        content[at] ^= 0xFF
        try:
            heights = ms.read(put(bytes(content), "flipped.datx")).z
        except ms.errors.ReadError:
            continue
        assert float(np.nanmax(np.abs(heights))) < 1.0, at


def test_a_good_copy_over_a_damaged_file_is_read(repository, put):
    """The library keeps what it knows of an open file: a damaged one must not stay open."""
    whole = (repository / "data_formats/datx/samples/fringes.datx").read_bytes()
    damaged = bytearray(whole)
    damaged[120] ^= 0xFF  # in the signature of a tree: the file opens, its groups do not
    path = put(bytes(damaged), "map.datx")
    with pytest.raises(ms.errors.ReadError, match="signature"):
        ms.read(path)

    path.write_bytes(whole)

    assert ms.read(path).n_invalid >= 0

"""The last resort: a stand-in for SurfaceTopography, and the package itself where it is installed."""

import importlib.machinery
import sys
import types

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import read as via

NM = 1e-9
TOP = "top row first"
CONTENT = b"\x89ZMG\x00\x01\x02\x03 not known to any reader of metrosep"


class StandIn:
    """A reader of the other package: x is the first index, undefined points are masked."""

    heights_nm = np.ma.masked_invalid([[1.0, 2.0], [3.0, np.nan], [5.0, 60.0]])
    unit = "um"
    fails = False

    def __init__(self, path):
        if self.fails:
            raise MemoryError("claimed 10 TB")
        self.path = path
        self.channels = [types.SimpleNamespace(name="Height"), types.SimpleNamespace(name="2nd")]

    @classmethod
    def format(cls):
        return "zmg"

    def topography(self, channel_index):
        scale = 1e-3 * (channel_index + 1)
        return types.SimpleNamespace(
            heights=lambda: self.heights_nm * scale,
            unit=self.unit,
            pixel_size=(1.5, 2.5),
            info={"instrument": {"name": "VK-X"}},
            dim=2,
        )


@pytest.fixture
def package(monkeypatch):
    """Put a stand-in in the place of the package."""
    main = types.ModuleType("SurfaceTopography")
    main.__version__ = "9.9"
    main.__spec__ = importlib.machinery.ModuleSpec("SurfaceTopography", None)
    inner = types.ModuleType("SurfaceTopography.IO")
    reader = type("Reader", (StandIn,), {})
    inner.readers = [reader]
    monkeypatch.setitem(sys.modules, "SurfaceTopography", main)
    monkeypatch.setitem(sys.modules, "SurfaceTopography.IO", inner)
    return reader


@pytest.fixture
def unknown(tmp_path):
    path = tmp_path / "tool.zmg"
    path.write_bytes(CONTENT)
    return path


@pytest.mark.usefixtures("package")
def test_map_is_turned_to_rows_of_y_and_marked(unknown):
    surface = ms.read(unknown, row_order=TOP)

    truth = np.array([[2.0, np.nan, 60.0], [1.0, 3.0, 5.0]]) * NM  # row 0: smallest y
    np.testing.assert_allclose(surface.z, truth, rtol=1e-12)
    assert (surface.dx, surface.dy) == pytest.approx((1.5e-6, 2.5e-6), rel=1e-12, abs=0.0)
    assert surface.metadata["via"] == "SurfaceTopography 9.9"
    assert "not verified" in surface.metadata["warnings"][0]
    assert surface.history[0].parameters["format"] == "via-zmg"


@pytest.mark.usefixtures("package")
def test_second_channel_and_own_step(unknown):
    surface = ms.read(unknown, channel="2nd", lateral_step="3 um", row_order=TOP)

    assert surface.z[0, 2] == pytest.approx(120.0 * NM, rel=1e-9, abs=0.0)
    assert (surface.dx, surface.dy) == (3e-6, 3e-6)


def test_unit_that_is_not_known_is_refused(package, unknown):
    package.unit = None

    with pytest.raises(ms.errors.UnitError, match="no unit of length"):
        ms.read(unknown)


def test_whatever_the_package_raises_is_one_sentence(package, unknown):
    package.fails = True

    with pytest.raises(ms.errors.CorruptFileError, match=r"cannot read it .claimed 10 TB"):
        ms.read(unknown)


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"channel": "third"}, "no SurfaceTopography channel 'third'; there is 'Height', '2nd'"),
        ({"unit": "nm"}, "takes no unit"),
        ({"max_pixels": 3}, "takes no max_pixels"),
    ],
)
def test_what_it_cannot_do_is_refused(unknown, options, message):
    with pytest.raises(ms.errors.ReadError, match=message):
        ms.read(unknown, **options)


@pytest.mark.usefixtures("package")
def test_other_suffixes_do_not_reach_it(tmp_path):
    """Its NanoFocus reader is wrong by 10^6, and its text reader takes anything."""
    path = tmp_path / "map.nms"
    path.write_bytes(CONTENT)

    with pytest.raises(ms.errors.UnknownFormatError):
        ms.read(path)


def test_missing_package_is_named(monkeypatch, unknown):
    monkeypatch.setattr(via.importlib.util, "find_spec", lambda _name: None)

    with pytest.raises(ms.errors.UnsupportedFeatureError, match=r"metrosep\[exotic\]"):
        ms.read(unknown)


@pytest.mark.usefixtures("package")
def test_a_map_that_may_be_mirrored_is_refused_until_its_rows_are_declared(unknown):
    """The user of a map whose orientation nobody proved must say it, in one of two words."""
    with pytest.raises(ms.errors.AmbiguousFormatError, match="mirrored map") as caught:
        ms.read(unknown)
    for word in ("top row first", "smallest y first"):
        assert f"row_order={word!r}" in str(caught.value) or f"or {word!r}" in str(caught.value)

    top, bottom = (ms.read(unknown, row_order=o) for o in (TOP, "smallest y first"))
    np.testing.assert_array_equal(top.z, bottom.z[::-1])
    assert top.metadata["orientation_evidence"] == "stated"
    with pytest.raises(ms.errors.ReadError, match="row_order = 'upside down' is unknown"):
        ms.read(unknown, row_order="upside down")


def test_a_format_whose_rows_are_known_is_turned_and_says_why(package, tmp_path):
    package.format = classmethod(lambda _cls: "mdt")
    path = tmp_path / "map.mdt"
    path.write_bytes(CONTENT)
    with pytest.raises(ms.errors.AmbiguousFormatError, match=r"SurfaceTopography 9\.9"):
        ms.read(path)  # another version may turn it otherwise
    sys.modules["SurfaceTopography"].__version__ = "1.27.1"

    surface = ms.read(path)

    np.testing.assert_allclose(surface.z[1], np.array([1.0, 3.0, 5.0]) * NM, rtol=1e-12)
    assert surface.metadata["orientation_evidence"] == "peer"
    assert any("top" in w for w in surface.metadata["warnings"])


@pytest.mark.peer
@pytest.mark.parametrize(
    ("name", "reader", "order"),
    [
        ("x3p-2.x3p", "x3p", "smallest y first"),
        ("sur-2.sur", "sur", TOP),
        ("bcrf-1.bcrf", "bcr", TOP),
        ("al3d-1.al3d", "al3d", TOP),
        ("plu-1.plu", "plu", TOP),
        ("opd-1.opd", "opd", TOP),
        ("metropro-1.dat", "metropro", TOP),
        ("di-3.di", "di", TOP),
        ("stp-1.stp", "wsxm", TOP),
    ],
)
def test_the_real_package_gives_what_the_own_reader_gives(
    corpus, monkeypatch, name, reader, order
):
    """Orientation, unit and steps: files that both read; how the rows lie differs by the reader."""
    pytest.importorskip("SurfaceTopography", reason="metrosep[exotic] is not installed")
    (path,) = corpus.glob(f"*/{name}")
    monkeypatch.setitem(via.SUFFIXES, path.suffix, reader)
    monkeypatch.setattr("metrosep.io.registry._choose", lambda _file, _candidates: None)
    other = ms.read(path, row_order=order)
    monkeypatch.undo()
    own = ms.read(path)

    assert other.metadata["via"].startswith("SurfaceTopography 1")
    both = np.isfinite(other.z) & np.isfinite(own.z)
    assert np.corrcoef(other.z[both], own.z[both])[0, 1] > 0.9999
    assert (other.dx, other.dy) == pytest.approx((own.dx, own.dy), rel=1e-4, abs=0.0)

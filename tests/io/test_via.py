"""The last resort: a stand-in for SurfaceTopography, and the package itself where it is installed."""

import importlib.machinery
import sys
import types

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import via

NM = 1e-9
CONTENT = b"\x89VK6\x00\x01\x02\x03 not known to any reader of metrosep"


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
        return "vk"

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
    path = tmp_path / "tool.vk6"
    path.write_bytes(CONTENT)
    return path


@pytest.mark.usefixtures("package")
def test_map_is_turned_to_rows_of_y_and_marked(unknown):
    surface = ms.read(unknown)

    truth = np.array([[1.0, 3.0, 5.0], [2.0, np.nan, 60.0]]) * NM
    np.testing.assert_allclose(surface.z, truth, rtol=1e-12)
    assert (surface.dx, surface.dy) == pytest.approx((1.5e-6, 2.5e-6), rel=1e-12, abs=0.0)
    assert surface.metadata["via"] == "SurfaceTopography 9.9"
    assert "not verified" in surface.metadata["warnings"][0]
    assert surface.history[0].parameters["format"] == "via-vk"


@pytest.mark.usefixtures("package")
def test_second_channel_and_own_step(unknown):
    surface = ms.read(unknown, channel="2nd", lateral_step="3 um")

    assert surface.z[1, 2] == pytest.approx(120.0 * NM, rel=1e-9, abs=0.0)
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


@pytest.mark.peer
def test_the_real_package_gives_what_the_own_reader_gives(corpus, tmp_path, monkeypatch):
    """Orientation, unit and steps: a file that both read, under a suffix that only it knows."""
    pytest.importorskip("SurfaceTopography", reason="metrosep[exotic] is not installed")
    monkeypatch.setitem(via.SUFFIXES, ".x3p", "x3p")
    monkeypatch.setattr("metrosep.io.registry._choose", lambda _file, _candidates: None)
    other = ms.read(corpus / "st" / "x3p-2.x3p")
    monkeypatch.undo()
    own = ms.read(corpus / "st" / "x3p-2.x3p")

    assert other.metadata["via"].startswith("SurfaceTopography 1")
    np.testing.assert_allclose(other.z, own.z, rtol=1e-12)
    assert (other.dx, other.dy) == pytest.approx((own.dx, own.dy), rel=1e-9, abs=0.0)

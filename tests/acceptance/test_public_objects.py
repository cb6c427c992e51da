"""Every public object draws itself, becomes a table, is saved bit for bit, and is compared by its values."""

import inspect

import numpy as np
import pytest

import metrosep as ms
from metrosep.compensation import CompensationTable
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    MetrosepError,
    UnsupportedFeatureError,
)
from metrosep.core.public import PublicObject, same
from metrosep.io.frames import _FRAMES, _LABELLED
from metrosep.parameters import areal_parameters
from metrosep.plot.objects import _PICTURES
from metrosep.recipe import Recipe
from metrosep.separation.contract import Separation

NM = 1e-9


def surface(seed=0):
    rng = np.random.default_rng(seed)
    z = 5 * NM * rng.standard_normal((12, 17))
    z[3, 4] = np.nan
    return ms.Surface(z, 2e-6, 3e-6, origin=(1e-3, 0.0), metadata={"operator": "Mia"})


def runs():
    x = np.linspace(0.0, 20e-3, 201)
    each = [
        ms.Run(x[::d], 30 * NM * np.sin(x[::d] / 2e-3), feed=f, run_id=f"{f}{d}")
        for f in (0.02, 0.04)
        for d in (1, -1)
    ]
    return ms.RunSet(each)


def objects():
    """Return one object of each public class, by its class."""
    made = {}
    made["Surface"] = s = surface()
    made["Profile"] = ms.Profile(
        np.linspace(0, 1e-3, 9), [0, 1e-9, np.nan, 0, 3e-9, 0, 0, 1e-9, 0]
    )
    made["Recording"] = ms.Recording(
        [0.0, 0.5, 1.0], {"gap": [1e-6, 2e-6, 3e-6]}, units={"gap": "m"}
    )
    made["RunSet"] = several = runs()
    made["Run"] = several.runs[0]
    made["Quantity"] = ms.Quantity(2e-9, "m", "a height", 1e-10)
    made["ParameterTable"] = areal_parameters(s)
    made["FitResult"] = ms.forms.fit(s, ms.forms.Plane())
    made["ErrorEstimate"] = ms.separation.separate(several, method="mean")
    made["Separation"] = Separation(
        "example", {"artefact": [1e-9, 2e-9]}, {"artefact": [0.0, 1e-10]}, {"artefact": "m"},
        {"x": [0.0, 1e-3]}, (),
    )  # fmt: skip
    made["CompensationTable"] = CompensationTable(
        np.array([0.0, 1e-3, 2e-3]), [0.0, -3e-9, 5e-9], [1e-9, 0.0, 4e-9], "X", "Z", 0.0
    )
    return made


OBJECTS = objects()
EXAMPLES = pytest.mark.parametrize("obj", OBJECTS.values(), ids=OBJECTS)


def test_every_public_class_is_listed_with_what_it_can_do():
    import metrosep.batch.index
    import metrosep.compensation.maps
    import metrosep.machine.sensitivity
    import metrosep.optics.wavefronts
    import metrosep.process.path_points
    import metrosep.process.tool_settings
    import metrosep.recipe.result  # noqa: F401

    inherited = {c.__name__ for c in _children(PublicObject)}
    known = set(_PICTURES) | set(_FRAMES) | set(_LABELLED)
    assert known <= inherited
    assert set(OBJECTS) <= inherited


def _known(obj, table):
    return any(c.__name__ in table for c in type(obj).__mro__)


def _children(cls):
    for child in cls.__subclasses__():
        yield child
        yield from _children(child)


@EXAMPLES
def test_an_object_comes_back_bit_for_bit(obj, tmp_path):
    path = obj.save(tmp_path / "o.h5")
    back = ms.load(path)
    assert type(back) is type(obj)
    assert back.identical(obj)
    assert back == obj
    assert hash(back) == hash(obj)
    assert repr(back) == repr(obj)
    assert path.read_bytes() == obj.save(tmp_path / "again.h5").read_bytes()


@EXAMPLES
def test_it_says_what_it_is_in_one_line_and_in_a_notebook(obj):
    assert type(obj).__name__.removeprefix("Areal") in repr(obj).partition("\n")[
        0
    ] or "fit" in repr(obj)
    assert len(repr(obj).partition("\n")[0]) <= 120
    html = getattr(obj, "_repr_html_", None)
    assert html is None or "<script" not in html()
    assert obj != "something else"
    assert not obj.equals(None)


@EXAMPLES
def test_it_is_a_table(obj):
    frame = obj.to_frame()
    assert len(frame) > 0
    assert len(set(frame.columns)) == len(frame.columns)


@EXAMPLES
def test_it_draws_itself_with_units_on_its_axes(obj):
    import matplotlib as mpl
    from matplotlib.axes import Axes

    before = dict(mpl.rcParams)
    if not _known(obj, _PICTURES):
        with pytest.raises(DataError, match="no picture"):
            obj.plot()
        return
    axes = obj.plot()
    assert dict(mpl.rcParams) == before
    several = [axes] if isinstance(axes, Axes) else axes.axes
    assert any("/" in a.get_ylabel() for a in several)


@EXAMPLES
def test_it_has_labelled_axes_where_it_has_axes(obj):
    pytest.importorskip("xarray")
    if not _known(obj, _LABELLED):
        with pytest.raises(DataError, match="no axes"):
            obj.to_xarray()
        return
    made = obj.to_xarray()
    assert made.size if hasattr(made, "size") else made.sizes


def test_without_xarray_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(UnsupportedFeatureError, match=r"metrosep\[xarray\]"):
        surface().to_xarray()


# ---- arithmetic ---------------------------------------------------------------------------------


def test_maps_subtract_with_a_history_that_names_both():
    a, b = surface(1), surface(2)
    d = a - b
    np.testing.assert_array_equal(d.z, a.z - b.z)
    assert (d.dx, d.dy, d.origin) == (a.dx, a.dy, a.origin)
    step = d.history[-1]
    assert step.name == "subtract"
    assert step.parameters["left"] != step.parameters["right"]
    np.testing.assert_array_equal((b - a).z, -(a - b).z)
    np.testing.assert_array_equal((a - "1 nm").z, a.z - 1 * NM)
    np.testing.assert_array_equal(("1 nm" + a).z, 1 * NM + a.z)
    np.testing.assert_array_equal((1 * NM - a).z, 1 * NM - a.z)
    assert (2 * a - a).allclose(a, atol="0.001 pm")
    assert not a.allclose(b, atol="0.1 nm")


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (ms.Surface(np.zeros((12, 16)), 2e-6, 3e-6, origin=(1e-3, 0.0)), "samples"),
        (ms.Surface(np.zeros((12, 17)), 2.01e-6, 3e-6, origin=(1e-3, 0.0)), "steps; resample"),
        (ms.Surface(np.zeros((12, 17)), 2e-6, 3e-6), "steps; resample"),
        (ms.Surface(np.zeros((12, 17)), origin=(1e-3, 0.0)), "lateral step"),
    ],
)
def test_grids_that_differ_do_not_combine(other, says):
    with pytest.raises(DataError, match=says):
        surface() - other


def test_numpy_reads_a_map_and_keeps_it_an_object_where_that_has_a_meaning():
    s = surface()
    assert np.asarray(s).shape == s.shape
    assert np.nanmax(s) == np.nanmax(s.z)
    assert isinstance(np.abs(s), ms.Surface)
    assert isinstance(np.subtract(s, s), ms.Surface)
    assert type(np.sin(s)) is np.ndarray
    assert type(s.z * 2) is np.ndarray
    with pytest.raises(TypeError):
        s * s
    with pytest.raises(MetrosepError):
        s - "1 deg"


def test_a_sign_that_flips_flips_every_entry():
    table = OBJECTS["CompensationTable"]
    turned = -table
    np.testing.assert_array_equal(turned.forward, -table.forward)
    np.testing.assert_array_equal(turned.reverse, -table.reverse)
    np.testing.assert_array_equal((table + turned).forward, 0.0 * table.forward)
    other = CompensationTable(np.array([0.0, 1e-3, 3e-3]), [0.0, 0.0, 1e-9], None, "X", "Z", 0.0)
    with pytest.raises(DataError, match="positions of the two differ"):
        table + other


def test_quantities_add_their_uncertainties_in_squares():
    a, b = ms.Quantity(5e-6, "m", "a", 3e-9), ms.Quantity(2e-6, "m", "b", 4e-9)
    d = a - b
    assert d.value == pytest.approx(3e-6, abs=1e-20)
    assert d.u == pytest.approx(5e-9, abs=1e-20)
    assert float(-2 * a) == -10e-6
    assert (-2 * a).u == pytest.approx(6e-9, abs=1e-20)
    with pytest.raises(DataError, match="like quantities"):
        a + ms.Quantity(1.0, "rad", "c")


def test_equality_is_of_values_and_sees_one_bit():
    a, b = surface(), surface()
    assert a == b
    assert len({a, b}) == 1
    z = np.array(a.z)
    z[0, 0] = np.nextafter(z[0, 0], 1.0)
    assert a != ms.Surface(z, a.dx, a.dy, origin=a.origin, metadata=a.metadata)
    assert a != ms.Surface(a.z, a.dx, a.dy)
    other = ms.Surface(a.z, a.dx, a.dy, origin=a.origin, metadata={"operator": "Max"})
    assert a == other
    assert not a.identical(other)
    assert same((1.0, {"a": np.nan}), (1.0, {"a": np.nan}))


def test_limits_of_a_picture_take_units():
    axes = surface().plot(vmin="-5 nm", vmax="5 nm", unit="nm")
    assert axes.images[0].get_clim() == pytest.approx((-5.0, 5.0), abs=1e-9)
    with pytest.raises(MetrosepError, match="vmin"):
        surface().plot(vmin="-5 deg")
    with pytest.raises(MetrosepError, match="colour"):
        surface().plot(colour="red")


# ---- files --------------------------------------------------------------------------------------


def test_a_file_that_was_cut_off_or_is_another_one_is_one_sentence(tmp_path):
    path = surface().save(tmp_path / "o.h5")
    whole = path.read_bytes()
    for n in (0, 100, len(whole) // 2, len(whole) - 8):
        (tmp_path / "cut.h5").write_bytes(whole[:n])
        with pytest.raises(CorruptFileError):
            ms.load(tmp_path / "cut.h5")
    ms.write(surface(), tmp_path / "map.sdf")
    with pytest.raises(CorruptFileError):
        ms.load(tmp_path / "map.sdf")
    with pytest.raises(FileNotFoundError):
        ms.load(tmp_path / "gone.h5")


@pytest.mark.parametrize(
    "name", ["os:system", "metrosep.cli.main:main", "metrosep.core.surface:Gone"]
)
def test_a_file_makes_no_class_that_is_not_an_object_of_this_package(tmp_path, name):
    import h5py

    path = surface().save(tmp_path / "o.h5")
    with h5py.File(path, "r+") as file:
        text = bytes(file["content"][()]).decode().replace("metrosep.core.surface:Surface", name)
        del file["content"]
        file.create_dataset("content", data=np.frombuffer(text.encode(), dtype=np.uint8))
    with pytest.raises(UnsupportedFeatureError, match="does not have"):
        ms.load(path)


@pytest.mark.parametrize("name", ["content", "array_0"])
def test_what_a_file_holds_lies_in_the_file_itself(tmp_path, name):
    import h5py

    path, beside = surface().save(tmp_path / "s.h5"), tmp_path / "other.h5"
    with h5py.File(path, "r+") as file, h5py.File(beside, "w") as other:
        other[name] = file[name][()]
        del file[name]
        file[name] = h5py.ExternalLink(str(beside), name)
    with pytest.raises(CorruptFileError, match=f"{name} is not stored in the file itself"):
        ms.load(path)


def test_a_claim_beyond_any_file_is_damage(tmp_path):
    path = surface().save(tmp_path / "s.h5")
    data = bytearray(path.read_bytes())
    data[55] ^= 1  # the address of the end of the file, in the superblock
    path.write_bytes(data)
    with pytest.raises(CorruptFileError, match="damaged or cut off"):
        ms.load(path)


def test_a_newer_schema_is_named_with_both_versions(tmp_path):
    import h5py

    path = surface().save(tmp_path / "o.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["metrosep_schema"] = "metrosep.object/9"
    with pytest.raises(UnsupportedFeatureError, match=r"object/9.*object/1"):
        ms.load(path)


# ---- results ---------------------------------------------------------------------------------------


def test_a_result_is_a_table_and_a_picture(tmp_path):
    ms.write(surface(), tmp_path / "part.sdf")
    text = 'metrosep = 1\n[input]\n[[step]]\nop = "form"\nform = "plane"\n'
    result = Recipe.parse(text).run(tmp_path / "part.sdf")
    assert "residual" in set(result.to_frame()["metric"].str.partition(".")[0])
    assert result.plot() is not None


def test_help_shows_what_every_object_can_do():
    for name in ("plot", "to_frame", "to_xarray", "save", "equals", "identical"):
        assert inspect.getdoc(getattr(ms.Surface, name))


def test_errors_are_those_of_python_too():
    import pickle

    from metrosep.core import errors

    natives = {
        "FileMissingError": FileNotFoundError, "UnsupportedFeatureError": NotImplementedError,
        "DataError": ValueError, "OptionError": TypeError, "RecipeMissingError": FileNotFoundError,
    }  # fmt: skip
    for name, native in natives.items():
        kind = getattr(errors, name)
        made = kind("the sentence")
        assert isinstance(made, native)
        assert isinstance(made, MetrosepError)
        assert str(pickle.loads(pickle.dumps(made))) == "the sentence"  # noqa: S301

"""Every public object draws itself, becomes a table, is saved bit for bit, and is compared by its values."""

import copy
import dataclasses
import errno
import functools
import importlib
import inspect
import json
import os
import pickle
import pkgutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.batch import run_batch
from metrosep.compensation import CompensationMap, CompensationTable
from metrosep.core import errors, numbers
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    MetrosepError,
    UnsupportedFeatureError,
)
from metrosep.core.public import PublicObject, same
from metrosep.io.frames import _FRAMES, _LABELLED
from metrosep.optics import wavefront
from metrosep.parameters import areal_parameters
from metrosep.plot.objects import _PICTURES
from metrosep.process import SpiralPath
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


@functools.cache
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
    x, y = np.linspace(0.0, 0.1, 5), np.linspace(0.0, 0.06, 4)
    made["CompensationMap"] = CompensationMap(x, y, 1e-6 * (x[None, :] + 2.0 * y[:, None]))
    lathe = ms.machine.presets("fts_lathe", radius=20e-3)
    toric = ms.forms.Toric(Rb=265e-3, Rd=132.5e-3)
    errors = {"EXX": "1 um", "EYX": "1 um"}
    made["SensitivityTable"] = ms.machine.rank(lathe, toric, radius=20e-3, errors=errors)
    made["Wavefront"] = wavefront(ms.forms.Sphere(R=50e-3), radius=1e-3, mode="reflect")
    made["SpiralPath"] = SpiralPath(500e-6, 20e-6, distribution="CAL", step=30e-6)
    made["ToolSetting"] = ms.process.ToolSetting(dx="0.25 um", u_dx="0.05 um")
    made["Result"], made["BatchReport"] = _made_by_recipe(s)
    return made


def _made_by_recipe(measured):
    """Return the result of a recipe, and the report of a batch of two files."""
    with tempfile.TemporaryDirectory() as folder:
        parts = Path(folder) / "parts"
        parts.mkdir()
        for name in "ab":
            ms.write(measured, parts / f"{name}.sdf")
        recipe = Recipe.parse(_RECIPE)
        report = run_batch(recipe, parts, out=Path(folder) / "out", scheduler="serial")
        return recipe.run(parts / "a.sdf"), report


_RECIPE = """metrosep = 1
[input]
files = "*.sdf"
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sq", "Sz"]
[[check]]
metric = "Sq"
upper = "80 nm"
U = "2 nm"
"""


def test_every_public_class_is_listed_with_what_it_can_do():
    import metrosep.batch.index
    import metrosep.compensation.maps
    import metrosep.machine.sensitivity
    import metrosep.optics.wavefronts
    import metrosep.parameters.form_result
    import metrosep.process.path_points
    import metrosep.process.tool_settings
    import metrosep.recipe.result
    import metrosep.separation.positions.positioning_result  # noqa: F401

    inherited = {c.__name__ for c in _children(PublicObject)}
    known = set(_PICTURES) | set(_FRAMES) | set(_LABELLED)
    assert known <= inherited
    assert set(objects()) <= inherited


def exported():
    """Return the classes that the packages export, by name; errors apart."""
    found = {}
    packages = [m.name for m in pkgutil.iter_modules(ms.__path__) if m.ispkg]
    for package in ["metrosep", *(f"metrosep.{name}" for name in packages)]:
        module = importlib.import_module(package)
        for name in getattr(module, "__all__", ()):
            known = getattr(module, name)
            if inspect.isclass(known) and not issubclass(known, BaseException):
                found.setdefault(known, f"{package.removeprefix('metrosep.')}.{name}")
    return found


# classes that are neither objects of the table nor frozen records with a line of their own
REASONS = {
    "forms.Form": "a base: what a form is",
    "forms.LinearForm": "a base: what a form is",
    "forms.Polynomial": "a declaration: its degree and kind are typed",
    "forms.Zernike": "a declaration: its terms and order are typed",
    "machine.ErrorTerm": "a protocol",
    "parameters.Budget": "a sheet that is read from a file and filled; its table is to_frame",
    "parameters.Noise": "a base: what a noise is",
    "parameters.StationaryNoise": "a base: what a noise is",
    "separation.SeparationMethod": "a base: what a method is",
    "separation.LaserSetup": "a set-up that corrects readings; what it gives is LaserCorrections",
    "spectral.BinnedMean": "takes samples as they come; its result is asked of it",
    "spectral.StreamedPsd": "takes samples as they come; its result is a Psd",
}


def test_every_exported_class_has_the_contract_or_is_a_record_or_says_why_not():
    lacking = {}
    for known, name in exported().items():
        frozen = dataclasses.is_dataclass(known) and known.__dataclass_params__.frozen
        frozen |= issubclass(known, tuple) and hasattr(known, "_fields")
        if issubclass(known, PublicObject):
            assert known.__eq__ is not object.__eq__, name
            assert known.__repr__ is not object.__repr__, name
            for what in ("plot", "to_frame", "to_xarray", "save", "equals", "identical"):
                assert callable(getattr(known, what)), (name, what)
        elif not frozen or known.__repr__ is object.__repr__:
            lacking[name] = REASONS.get(name)
    assert lacking == REASONS
    assert len(exported()) > 200


def _known(obj, table):
    return any(c.__name__ in table for c in type(obj).__mro__)


def _children(cls):
    for child in cls.__subclasses__():
        yield child
        yield from _children(child)


# class: columns of to_frame that it must have (none: any), whether it draws, has axes, and subtracts
TABLE = {
    "Surface": (("x_mm", "y_mm", "z_nm"), True, True, True),
    "Profile": (("x_mm", "z_nm"), True, True, True),
    "Recording": (("t_s",), True, True, False),
    "Run": (("x_mm", "z_nm"), True, True, False),
    "RunSet": (("run", "x_mm", "z_nm"), True, True, False),
    "Quantity": (("value", "u", "unit"), False, False, True),
    "ParameterTable": (("value", "u", "unit"), True, False, True),
    "FitResult": (("value", "unit"), True, True, False),
    "ErrorEstimate": (("x_mm", "error_nm", "u_nm", "direction"), True, True, True),
    "Separation": ((), True, True, False),
    "CompensationTable": (("position_mm", "forward_nm", "reverse_nm"), True, True, False),
    "CompensationMap": (("x_mm", "y_mm", "correction_nm"), True, True, False),
    "SensitivityTable": ((), True, False, False),
    "Wavefront": (("x_mm", "y_mm", "opd_nm"), True, True, False),
    "SpiralPath": (("theta_deg", "rho_mm", "x_mm", "y_mm"), True, False, False),
    "ToolSetting": (("field", "value"), True, False, False),
    "Result": (("name", "value", "unit", "U", "k"), True, False, False),
    "BatchReport": (("unit", "status"), True, False, False),
}  # fmt: skip
WALK = pytest.mark.parametrize("name", TABLE)
# whose picture has no one axis of values: what is said of it
UNSCALED = {
    "SpiralPath": "shows places x and y in mm",
    "Result": "first page of its report",
    "BatchReport": "counts units by status",
}


def _scaled(obj):
    """Require that a picture follows a unit and limits, or says what it shows and refuses them."""
    kind, low = type(obj).__name__, -5.0
    if kind in UNSCALED:
        with pytest.raises(
            errors.OptionError, match=UNSCALED[kind] + ".*does not take unit, vmin"
        ):
            obj.plot(unit="pm", vmin="-5 nm", vmax="7 nm")
        return
    if kind == "SensitivityTable":  # bars on a logarithmic scale
        with pytest.raises(DataError, match="must be above zero: the bars"):
            obj.plot(vmin="-5 nm")
        low = 5.0
    before = _values(_single(obj.plot(unit="nm", vmin=f"{low} nm", vmax="7 nm")))
    axes = _single(obj.plot(unit="pm", vmin=f"{low} nm", vmax="7 nm"))
    with pytest.raises(DataError, match=r"vmin = .* must be less than vmax"):
        obj.plot(vmin="9 nm", vmax="8 nm")
    with pytest.raises(errors.UnitError):
        obj.plot(unit="kg")
    mesh = [m for m in (*axes.images, *axes.collections) if m.get_array() is not None]
    ends = mesh[0].get_clim() if mesh else axes.get_ylim()
    label = mesh[0].colorbar.ax.get_ylabel() if mesh else axes.get_ylabel()
    if kind == "SensitivityTable":
        ends, label = axes.get_xlim(), axes.get_xlabel()
    assert ends == pytest.approx((low * 1e3, 7000.0), rel=1e-9, abs=0.0)  # pm
    assert "/ pm" in label
    np.testing.assert_allclose(_values(axes), 1e3 * before, rtol=1e-9)


def _single(drawn):
    return drawn.axes[0] if hasattr(drawn, "subfigures") else drawn


def _values(axes):
    """Return the values that are drawn: of colours, curves or bars."""
    for mesh in (*axes.images, *axes.collections):
        if mesh.get_array() is not None:
            return np.ma.filled(mesh.get_array(), 0.0).ravel()
    bars = [p.get_width() if axes.get_xscale() == "log" else p.get_height() for p in axes.patches]
    curves = sorted(axes.lines, key=lambda c: -len(c.get_xdata()))
    return np.array(bars) if bars else np.asarray(curves[0].get_ydata())


def test_values_of_several_units_have_no_scale_in_common():
    both = ms.Recording(
        [0.0, 1.0],
        {"gap": [1e-6, 2e-6], "trigger": [0.0, 5.0]},
        units={"gap": "m", "trigger": "V"},
    )
    assert both.plot() is not None
    with pytest.raises(
        errors.OptionError, match=r"gap \(m\), trigger \(V\) share no unit.*channel="
    ):
        both.plot(vmax="3 um")
    axes = both.plot(channel="gap", unit="nm", vmin=0.0, vmax="3 um")
    assert axes.get_ylim() == pytest.approx((0.0, 3000.0), abs=0.0)
    assert axes.get_ylabel() == "reading / nm"
    np.testing.assert_allclose(axes.lines[0].get_ydata(), [1000.0, 2000.0], rtol=1e-12)


@pytest.mark.parametrize("name", [n for n in TABLE if n != "ParameterTable"])
def test_a_frozen_object_says_so(name):
    obj = objects()[name]
    field = next(iter(obj.__dataclass_fields__))
    for attribute, says in (
        (field, f"{field} is a field of it"),
        ("nonsense", "it has no 'nonsen"),
    ):
        with pytest.raises(AttributeError, match=rf"a {name} does not change, and {says}"):
            setattr(obj, attribute, 1)
        with pytest.raises(AttributeError, match="does not change"):
            delattr(obj, attribute)


def test_the_table_of_the_contract_is_walked_whole():
    assert set(TABLE) == set(objects())


@WALK
def test_an_object_comes_back_bit_for_bit(name, tmp_path):
    obj = objects()[name]
    path = obj.save(tmp_path / "o.h5")
    back = ms.load(path)
    assert type(back) is type(obj)
    assert back == obj
    # the folder that a batch wrote into is a place of one machine, and is not stored
    assert back.identical(obj) or name == "BatchReport"
    assert hash(back) == hash(obj)
    assert repr(back) == repr(obj)
    assert path.read_bytes() == obj.save(tmp_path / "again.h5").read_bytes()
    for again in (pickle.loads(pickle.dumps(obj)), copy.deepcopy(obj)):  # noqa: S301
        assert again.identical(obj)


@WALK
def test_it_says_what_it_is_in_one_line_and_in_a_notebook(name):
    obj = objects()[name]
    assert repr(obj).startswith(f"{name}(")
    assert "\n" not in repr(obj)
    assert len(repr(obj)) <= 100
    html = obj._repr_html_()
    assert name in html or "table" in html
    assert "<script" not in html
    assert obj != "something else"
    assert not obj.equals(None)


def test_a_line_with_much_to_say_is_cut_at_a_word():
    many = ms.Recording([0.0, 1.0], {f"channel_{i}": [0.0, 1.0] for i in range(30)})
    assert len(repr(many)) <= 100
    assert repr(many).endswith(" ...)")
    assert len(repr(ms.Quantity(1.0, "m", "a very long definition " * 9))) <= 100


@WALK
def test_it_is_a_table(name):
    frame = objects()[name].to_frame()
    assert len(frame) > 0
    assert len(set(frame.columns)) == len(frame.columns)
    assert set(TABLE[name][0]) <= {*frame.columns, *frame.index.names}


@WALK
def test_it_draws_itself_with_units_on_its_axes(name):
    import matplotlib as mpl
    from matplotlib.axes import Axes

    before = dict(mpl.rcParams)
    obj, draws = objects()[name], TABLE[name][1]
    assert draws == _known(obj, _PICTURES)
    if not draws:
        with pytest.raises(DataError, match="no picture"):
            obj.plot()
        return
    axes = obj.plot()
    own = mpl.figure.Figure().subplots()
    if name == "Result":  # a figure of several panels: axes are never left empty
        with pytest.raises(errors.OptionError, match="call plot without ax"):
            obj.plot(own)
    else:
        assert obj.plot(own) is own
        assert own.has_data()
    assert dict(mpl.rcParams) == before
    _scaled(obj)
    several = [axes] if isinstance(axes, Axes) else axes.axes
    # bars that lie have their unit on the abscissa
    assert any(
        "/" in (a.get_xlabel() if name == "SensitivityTable" else a.get_ylabel()) for a in several
    )


@WALK
def test_it_has_labelled_axes_where_it_has_axes(name):
    pytest.importorskip("xarray")
    obj = objects()[name]
    if not TABLE[name][2]:
        with pytest.raises(DataError, match="no axes"):
            obj.to_xarray()
        return
    made = obj.to_xarray()
    assert made.size if hasattr(made, "size") else made.sizes


@WALK
def test_it_subtracts_only_where_a_difference_has_a_meaning(name):
    obj = objects()[name]
    if TABLE[name][3]:
        assert obj - obj is not None
    else:
        with pytest.raises(TypeError):
            obj - obj
    with pytest.raises(TypeError):
        obj - None


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
    table = objects()["CompensationTable"]
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


def test_a_product_with_a_quantity_has_another_unit_and_is_refused():
    q, share = ms.Quantity(2e-3, "m", "a length", 1e-4), ms.Quantity(2.0, "1", "a share")
    tilt = ms.Quantity(1e-3, "rad", "a tilt")
    for product in (
        lambda: q * q, lambda: q / q, lambda: q * share, lambda: surface() * q, lambda: q * surface(),
        lambda: surface() / tilt,
    ):  # fmt: skip
        with pytest.raises(TypeError):
            product()
    assert (surface() * share).z[0, 0] == 2.0 * surface().z[0, 0]
    assert (surface() - q).z[0, 0] == surface().z[0, 0] - 2e-3
    with pytest.raises(errors.UnitError, match=r"added must .* got a quantity in rad"):
        surface() + tilt
    with pytest.raises(errors.UnitError, match=r"radius must be .* got a quantity in rad"):
        ms.Surface(np.zeros((9, 9)), 1e-6, 1e-6).circle_section((0.0, 0.0), tilt)
    with pytest.raises(DataError, match="divided by zero"):
        q / 0
    with pytest.raises(DataError, match=r"float\(q\)"):
        f"{q:.3f}"
    assert f"{q:>30}" == str(q).rjust(30)


class OfPint:
    """Speaks as a quantity of pint does: 350 micrometres."""

    units = "micrometer"

    def __float__(self):
        raise TypeError("has a unit")

    def m_as(self, unit):
        if unit != "m":
            raise ValueError(f"cannot convert from 'micrometer' to '{unit}'")
        return 350.0 / 1e6

    def __str__(self):
        return "350 micrometer"


def test_a_quantity_of_pint_is_taken_by_its_unit():
    assert ms.Surface(np.zeros((2, 2)), OfPint(), "0.35 mm").dx == 0.35e-3
    with pytest.raises(errors.UnitError, match="350 micrometer"):
        numbers.quantity(OfPint(), "tilt", "angle")
    with pytest.raises(errors.UnitError, match="a factor must be a number"):
        surface() * OfPint()


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


@pytest.mark.parametrize("kind", ["spectrum", "psd"])
@pytest.mark.parametrize("option", [{"unit": "kg"}, {"vmin": "0 nm"}, {"vmax": "5 nm"}])
def test_a_picture_with_a_scale_of_its_own_takes_no_other(kind, option):
    with pytest.raises(errors.OptionError, match=f"own scale.*{next(iter(option))}"):
        objects()["ErrorEstimate"].plot(kind, **option)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda s, p: s.plot("psd"), "a Surface has one picture; plot does not take 'psd'"),
        (lambda s, p: s.plot(unit="s"), "a length is needed"),
        (lambda s, p: s.filter("roughness", cutoff="10 um"), "is of profiles, and this is a map"),
        (lambda s, p: p.filter("roughness", cutoff="10 um"), "does not take cutoff.*lambda_c"),
        (lambda s, p: p.filter("primary"), "needs lambda_s"),
        (lambda s, p: s.parameters("Sq", kind="P"), "does not take kind"),
        (lambda s, p: p.parameters(names=["Pt"]), "symbols themselves"),
        (lambda s, p: s.remove_form("plane", bogus=1), "remove_form does not take bogus.*tilt"),
        (lambda s, p: s.step_height(bogus=1), "step_height does not take bogus"),
        (lambda s, p: s.resample(bogus=1), "resample does not take bogus"),
    ],
)
def test_options_that_are_not_there_are_refused_in_one_sentence(call, said):
    with pytest.raises(DataError, match=said) as caught:
        call(surface(), objects()["Profile"])
    assert "()" not in str(caught.value).replace("parameters()", "")  # no Python of ours
    assert "argument" not in str(caught.value)


def test_the_centre_of_a_mask_may_be_an_array():
    s = tilted()
    kept = s.mask("circle", diameter="20 um", centre=np.array([30e-6, 20e-6]))
    assert kept == s.mask("circle", diameter=20e-6, centre=(30e-6, 20e-6))
    assert 0 < kept.n_invalid < kept.z.size


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


NATIVES = {
    "FileMissingError": (errors.ReadError, FileNotFoundError),
    "FileAccessError": (errors.ReadError, PermissionError),
    "WriteError": (MetrosepError, OSError),
    "CorruptFileError": (errors.ReadError, ValueError),
    "UnknownFormatError": (errors.ReadError, ValueError),
    "UnsupportedFeatureError": (errors.ReadError, NotImplementedError),
    "DataError": (MetrosepError, ValueError),
    "OptionError": (DataError, TypeError),
    "NameNotFoundError": (DataError, KeyError),
    "RecipeMissingError": (errors.RecipeError, FileNotFoundError),
}


@pytest.mark.parametrize("name", NATIVES)
def test_errors_are_those_of_python_too(name):
    kind = getattr(errors, name)
    extra = ("bad bytes",) if name == "CorruptFileError" else ()
    made = kind("the sentence", *extra)
    sentence = str(made)
    for again in (made, pickle.loads(pickle.dumps(made)), copy.copy(made)):  # noqa: S301
        assert isinstance(again, NATIVES[name])
        assert isinstance(again, NATIVES[name][1])
        assert str(again) == sentence  # not "[Errno 2] None: 'x'", and no quotes of a KeyError
        assert again.args == made.args
        if isinstance(made, FileNotFoundError | PermissionError):
            assert (again.errno, again.filename) == (made.errno, made.filename)


def test_an_error_of_a_file_carries_its_name_through_a_pickle():
    made = errors.FileMissingError("x.dat: no such file", "x.dat")
    again = pickle.loads(pickle.dumps(made))  # noqa: S301
    assert (again.errno, again.filename, str(again)) == (2, "x.dat", "x.dat: no such file")


def test_an_error_of_writing_says_what_the_system_said(tmp_path):
    missing = tmp_path / "none" / "p.h5"
    with pytest.raises(errors.WriteError, match="does not exist; create it") as caught:
        objects()["Profile"].save(missing)
    for error in (caught.value, pickle.loads(pickle.dumps(caught.value))):  # noqa: S301
        assert (error.errno, error.filename) == (errno.ENOENT, str(missing))
        assert error.strerror == os.strerror(errno.ENOENT)
        assert str(error).startswith(f"{missing}: the folder")
    with pytest.raises(errors.WriteError, match="is a folder") as caught:
        objects()["Profile"].save(tmp_path)
    assert caught.value.errno == errno.EISDIR
    long = tmp_path / ("x" * 300)
    with pytest.raises(errors.WriteError, match=r"cannot be written \(") as caught:
        objects()["Profile"].save(long)
    assert (caught.value.errno, caught.value.filename) == (errno.ENAMETOOLONG, str(long))
    assert errors.WriteError("a refusal of our own").errno is None


@pytest.mark.parametrize("name", ["nope.json", "nope.h5"])
def test_what_is_not_there_to_load_is_missing(tmp_path, name):
    with pytest.raises(FileNotFoundError, match="no such file; check the name") as caught:
        ms.load(tmp_path / name)
    assert caught.value.filename == str(tmp_path / name)


def test_equals_leaves_out_metadata_of_what_an_object_holds():
    x = np.linspace(0.0, 1e-3, 11)

    def runs(operator, height=0.0):
        return ms.RunSet([ms.Run(x, x * 1e-6 + height, metadata={"operator": operator})])

    one, other = runs("Ann"), runs("Bob")
    assert one[0] == other[0]
    assert one.equals(other)
    assert one == other
    assert not one.identical(other)
    assert one.identical(runs("Ann"))
    assert one != runs("Ann", 1e-12)


def test_files_of_a_saved_result_are_paths(tmp_path):
    text = 'metrosep = 1\n[input]\n[[step]]\nop = "form"\nform = "plane"\n'
    ms.write(tilted(), tmp_path / "part.x3p")
    result = Recipe.parse(text).run(tmp_path / "part.x3p", out=tmp_path / "out")
    again = ms.load(result.save(tmp_path / "r.h5"))
    assert again == result
    assert result.files
    assert again.files == tuple(Path(f.name) for f in result.files)  # folders are of one machine


def test_names_that_are_not_there_are_key_errors(tmp_path):
    for where in (objects()["Recording"], objects()["ParameterTable"]):
        with pytest.raises(KeyError, match=r"gap|Sq"):
            where["Zzz"]
    with pytest.raises(OSError, match="does not exist"):
        ms.write(surface(), tmp_path / "gone" / "map.sdf")


# ---- what people guess --------------------------------------------------------------------------


def tilted():
    y, x = np.mgrid[0:60, 0:80]
    return ms.Surface(2e-4 * 1e-6 * x + 30 * NM * ((x - 50) ** 2 + (y - 20) ** 2 < 25), 1e-6, 1e-6)


def test_level_and_form_are_the_fit():
    s = tilted()
    fitted = ms.forms.fit(s, ms.forms.Plane()).residual
    assert s.level() == fitted
    assert s.remove_form("plane") == fitted
    assert s.remove_form(ms.forms.Plane()) == fitted
    line = ms.Profile(np.arange(9.0), 2.0 * np.arange(9.0) + 1.0)
    np.testing.assert_allclose(line.level().z, 0.0, atol=1e-12)


def test_filter_names_a_function_of_filters():
    s = tilted().level()
    assert s.filter(nesting_index="20 um") == ms.filters.gaussian(s, nesting_index="20 um")
    assert s.filter("opening", radius="3 um") == ms.filters.opening(s, radius="3 um")
    with pytest.raises(DataError, match="filter is one of gaussian"):
        s.filter("median")
    with pytest.raises(TypeError):
        s.filter(wavelength="20 um")


def test_mask_takes_shapes_with_units_and_says_what_it_left():
    s = tilted()
    inside = s.mask("circle", diameter="10 um", centre=("50 um", "20 um"))
    assert inside.z.size - inside.n_invalid == 81  # pixels of x^2 + y^2 <= 25
    outside = s.mask("circle", diameter=10e-6, centre=(50e-6, 20e-6), outside=False)
    assert np.isnan(outside.z[20, 50])
    assert inside.n_invalid + outside.n_invalid == s.z.size
    with pytest.raises(DataError, match="needs diameter"):
        s.mask("circle", radius="5 um")


def test_crop_keeps_the_places():
    s = tilted()
    part = s.crop(x=("10 um", "19 um"), y=(5e-6, "7.5 um"))
    assert part.shape == (3, 10)
    assert part.origin == pytest.approx((10e-6, 5e-6), abs=1e-15)
    np.testing.assert_array_equal(part.z, s.z[5:8, 10:20])
    with pytest.raises(DataError, match="no pixel between"):
        s.crop(x=("1 mm", "2 mm"))
    with pytest.raises(DataError, match="lateral step"):
        ms.Surface(s.z).crop(x=(0, 1))
    assert len(ms.Profile(np.arange(9) * 1e-3, np.zeros(9)).crop("1 mm", "3 mm")) == 3


def test_parameters_and_step_height_are_the_functions():
    s = tilted().level()
    assert s.parameters("Sq", "Sz") == areal_parameters(s, names=("Sq", "Sz"))
    x = np.arange(-150, 150.5, 0.5) * 1e-6
    groove = ms.Profile(x, np.where(abs(x) < 45e-6, -1e-6, 0.0))
    assert groove.step_height(width="100 um").height == pytest.approx(-1e-6, abs=1e-12)
    assert groove.parameters("Pt")["Pt"].value == pytest.approx(1e-6, abs=1e-12)


def test_a_section_across_a_wave_is_damped_as_its_formula_says():
    n, length = 11, 17.0
    y, _ = np.mgrid[0:200, 0:60]
    s = ms.Surface(np.cos(2 * np.pi * (y - 100) / length), 1e-6, 1e-6)
    along = s.section(("10 um", "100 um"), ("50 um", "100 um"), width="10 um")
    gain = np.sin(np.pi * n / length) / (n * np.sin(np.pi / length))
    assert gain == pytest.approx(0.442877, abs=1e-6)
    np.testing.assert_allclose(along.z, gain, atol=1e-12)
    assert along.history[-1].parameters["lines"] == n


def test_a_band_lies_about_its_line_and_half_of_it_may_be_missing():
    z = np.zeros((21, 30))
    z[12] = 1.0  # two rows above the line
    z[13:] = np.nan
    s = ms.Surface(z, 1.0, 1.0)
    # rows 6 to 14; 13 and 14 are missing, and 6 and 7 with them
    band = s.section((5.0, 10.0), (20.0, 10.0), width=8.0)
    np.testing.assert_allclose(band.z, 1.0 / 5.0, atol=1e-12)
    empty = s.section((5.0, 15.0), (20.0, 15.0), width=6.0)  # rows 12 to 18; one is there
    assert np.isnan(empty.z).all()


def test_a_circle_runs_from_x_to_y_and_finds_planted_harmonics():
    j, i = np.mgrid[0:300, 0:300]
    angle = np.arctan2(j - 140.0, i - 150.0)
    s = ms.Surface(2 * NM * i - 1 * NM * j + 3 * NM * np.cos(3 * angle), 1e-6, 1e-6)
    around = s.circle_section(("150 um", "140 um"), "100 um")
    c = 2.0 * np.fft.fft(around.z) / len(around)
    assert len(around) == 629
    assert abs(c[1]) == pytest.approx(223.606797 * NM, abs=1e-6 * NM)
    assert np.degrees(np.angle(c[1])) == pytest.approx(26.565051, abs=1e-5)
    assert abs(c[3]) == pytest.approx(3.0 * NM, abs=1e-4 * NM)


def test_a_resampled_map_is_the_wave_on_the_other_grid():
    def wave(x, y):
        return 5 * NM * np.sin(x / 4e-6) * np.cos(y / 7e-6)

    y, x = np.mgrid[0:80, 0:120] * 1e-6
    s = ms.Surface(wave(x, y), 1e-6, 1e-6)
    finer = s.resample(step="0.7 um")
    v, u = np.mgrid[0 : finer.shape[0], 0 : finer.shape[1]] * 0.7e-6
    inner = (slice(8, -8), slice(8, -8))
    np.testing.assert_allclose(finer.z[inner], wave(u, v)[inner], atol=0.02 * NM)
    assert s.resample(s) == s
    moved = ms.Surface(np.zeros((20, 30)), 1e-6, 1e-6, origin=(20.5e-6, 30e-6))
    onto = s.resample(moved)
    assert (onto - moved).shape == (20, 30)
    v, u = np.mgrid[0:20, 0:30] * 1e-6
    np.testing.assert_allclose(onto.z, wave(u + 20.5e-6, v + 30e-6), atol=0.02 * NM)
    with pytest.raises(DataError, match="onto"):
        s.resample()
    with pytest.raises(MetrosepError, match="how large a pixel"):
        ms.Surface(s.z).section(("1 um", "1 um"), ("9 um", "1 um"))


# ---- differences of results ---------------------------------------------------------------------


def test_two_estimates_subtract_with_u_in_squares():
    first = objects()["ErrorEstimate"]
    several = [
        ms.Run(r.x, 2.0 * r.z + k * NM * np.sin(r.x), feed=r.feed, run_id=f"{k}{r.run_id}")
        for k in (1, 2)
        for r in runs()
    ]
    second = ms.separation.separate(ms.RunSet(several), method="mean")
    found = second - first
    x = found.coordinates["x"]
    for way, d in (("forward", 1), ("reverse", -1)):
        expected = second.evaluate(x, direction=d) - first.evaluate(x, direction=d)
        np.testing.assert_array_equal(found.parts[way], expected)
        u = np.hypot(first.sd(x, direction=d), second.sd(x, direction=d))
        np.testing.assert_array_equal(found.u[way], u)
    assert found.parts["forward"].max() > 0.0 > (first - second).parts["forward"].min()


def test_two_tables_of_parameters_subtract_with_u():
    a = surface(1).parameters("Sq", "Sz").with_uncertainties({"Sq": 3e-9})
    b = surface(2).parameters("Sq", "Sa").with_uncertainties({"Sq": 4e-9})
    found = a - b
    assert found["Sq"].value == pytest.approx(a["Sq"].value - b["Sq"].value, abs=1e-20)
    assert found["Sq"].u == pytest.approx(5e-9, abs=1e-20)
    assert set(found) == {"Sq"}
    assert set(found.unavailable) == {"Sz", "Sa"}


# ---- figures take objects and documents ---------------------------------------------------------


def test_figures_of_a_result_take_the_object_and_the_document():
    joint = ms.separation.separate(runs(), method="mean")
    for draw in (joint.plot, lambda: ms.plot.table_plot(objects()["CompensationTable"])):
        assert draw() is not None
    table = objects()["CompensationTable"]
    document = {"table": table.to_dict()}
    drawn = [ms.plot.table_plot(o).lines[0].get_ydata() for o in (table, document)]
    np.testing.assert_array_equal(*drawn)
    parts = objects()["Separation"]
    stored = {"separation": parts.to_dict()}
    for given in (parts, stored):
        assert ms.plot.parts_plot(given) is not None
        assert ms.plot.separation_parts(given) is not None
    with pytest.raises(DataError, match="got int"):
        ms.plot.spectrum(3)
    with pytest.raises(DataError, match="spectr"):
        joint.plot("colour")


def test_a_result_is_its_document(tmp_path):
    result = objects()["Result"]
    path = result.save(tmp_path / "result.json")
    back = ms.load(path)
    assert back.document == json.loads(result.to_json())
    assert back.plot() is not None


def others(examples):
    rng = np.random.default_rng(5)
    runs = ms.read_runs(
        examples / "straightness/runs.csv",
        x="x_mm",
        z="z_um",
        feed="feed_mm_min",
        run="run",
        time="t_ms",
    )
    mean = ms.separation.separate(runs, start="0 mm", length="45 mm", method="mean")
    targets = np.arange(6) * 0.02
    reached = [targets[:, None] + rng.normal(size=(6, 5)) * 1e-6 for _ in range(2)]
    profile = ms.Profile(np.arange(20) * 1e-3, rng.normal(size=20) * 1e-6)
    return {
        "table of a mean": ms.compensation.CompensationTable.from_error(
            mean, positions="1 mm", axis="X", compensates="Z"
        ),
        "positioning test": ms.separation.iso230_2(targets, *reached),
        "form deviation": ms.parameters.form_deviation(
            profile, kind="straightness", reference="MZ"
        ),
        "machine": ms.machine.presets("fts_lathe", radius="20 mm"),
    }


def test_machines_tests_and_tables_of_every_method_are_saved_and_say_who_they_are_in_a_line(
    tmp_path, repository
):
    for name, obj in others(repository / "examples").items():
        assert ms.load(obj.save(tmp_path / "o.h5")) == obj, name
        assert len(repr(obj)) <= 100, name
        assert "\n" not in repr(obj), name
        assert obj._repr_html_(), name
        if name != "machine":
            assert len(obj.to_frame())
            assert obj.plot() is not None, name

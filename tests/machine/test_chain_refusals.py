"""Slips that numpy or Python would take for numbers, names or tables: each is a clear refusal."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.machine.chains import Chain, presets
from metrosep.machine.elements import Element, axis_of, from_paper, import_errors, to_paper
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.terms import FourierTerm, PolynomialTerm, TableTerm, as_term

TABLE = Element("T", "workpiece", "fixed")
Q = {"C": 0.0, "X": 0.01, "FTS": 0.0}
LATHE = presets("fts_lathe", radius=0.02)


def slide(name, direction=(1, 0, 0), **options):
    return Element(name, "tool", "linear", direction=direction, **options)


# positions and amounts --------------------------------------------------------------------------

NO_NUMBERS = [
    None,
    True,
    "0.01",
    b"0.01",
    np.datetime64("2020-01-01"),
    [0.01, None],
    [[1], [1, 2]],
]
NO_NUMBERS += [[True, 0.01], 1j, np.array(["1"]), {"a": 1}]


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
def test_positions_that_are_no_numbers(value):
    for exact in (False, True):
        with pytest.raises(InvalidSamplesError, match="position of axis 'X' must be real numbers"):
            LATHE.volumetric_error({**Q, "X": value}, {"EXX": 1e-6}, exact=exact)
    with pytest.raises(InvalidSamplesError, match="real numbers"):
        LATHE.jacobian({**Q, "X": value})
    with pytest.raises(InvalidSamplesError, match="real numbers"):
        ErrorSet({"EXX": np.sin}).at({"X": value})
    with pytest.raises(InvalidSamplesError, match="real numbers"):
        FourierTerm([1e-6], [0.01], [0.0]).evaluate(value)


def test_tool_points_and_positions_that_are_no_numbers():
    for tool in ([0, 0, "1"], [True, 0.0, 0.0], None, [0.0, 0.0, None]):
        with pytest.raises(InvalidSamplesError, match="tool point"):
            LATHE.jacobian(Q, tool=tool)
    with pytest.raises(InvalidSamplesError, match="infinite"):
        ErrorSet({"EXX": np.sin}).at({"X": np.inf})
    for q in (None, 3, ["X"]):
        for call in (ErrorSet({"EXX": np.sin}).at, ErrorSet({"EXX": np.sin}).u_at):
            with pytest.raises(DataError, match="mapping of axis names"):
                call(q)


@pytest.mark.parametrize("value", [0.01, np.float32(0.01), np.array(0.01), 1, np.int8(1), np.nan])
def test_positions_that_are_numbers_pass(value):
    assert LATHE.volumetric_error({**Q, "X": value}, {"EXX": 1e-6}).shape == (3,)


@pytest.mark.parametrize(
    "value", [True, np.True_, "1e-6", b"1e-6", np.datetime64("2020-01-01"), 1j], ids=repr
)
def test_amounts_that_are_no_numbers(value):
    with pytest.raises(DataError, match="EXX"):
        LATHE.volumetric_error(Q, {"EXX": value})
    for make in (
        lambda: as_term(1e-6, u=value),
        lambda: ErrorSet({"EXX": 0.0}, u={"EXX": value}),
        lambda: TableTerm([0.0, 1.0], [0.0, 1e-6], u=value),
        lambda: TableTerm([0.0, value], [0.0, 1e-6]),
        lambda: FourierTerm([value], [0.01], [0.0]),
        lambda: PolynomialTerm([0.0, value]),
        lambda: ErrorSet({"EXX": 0.0, "EYX": 0.0}, correlations={("EXX", "EYX"): value}),
    ):
        with pytest.raises(DataError):
            make()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("EXX", 5.0, "5 m.*5 um are 5e-6"),
        ("EXX", -2.0, "2 m"),
        ("EBC", 1.5, "1.5 rad.*degrees"),
        ("B0Z", 2.0, "2 rad"),
        ("EB0Z", 2.0, "2 rad"),
        ("EXX", lambda x: 5.0 + 0 * x, "5 m"),
        ("EBC", PolynomialTerm([1.5]), "1.5 rad"),
        ("EXX", TableTerm([0.0, 0.02], [0.0, 4.0]), "2 m"),
    ],
)
def test_amounts_in_another_unit(name, value, message):
    chain = Chain([*LATHE.elements[:1], slide("X", location_errors={name: (0, 0, 0, 0, 1, 0)})
                   if "0" in name else LATHE.elements[1], *LATHE.elements[2:]])  # fmt: skip
    with pytest.raises(UnitError, match=message) as raised:
        chain.volumetric_error(Q, {name: value})
    assert name in str(raised.value)


def test_uncertainties_in_another_unit_and_amounts_at_the_limit():
    with pytest.raises(UnitError, match=r"'EBC'.*u is 2 rad"):
        ErrorSet({"EBC": 0.0}, u={"EBC": 2.0})
    with pytest.raises(UnitError, match="u of error term 'EXX' is 2 m"):
        ErrorSet({"EXX": TableTerm([0.0, 1.0], [0.0, 0.0], u=2.0)}).u_at({"X": 0.5})
    assert ErrorSet({"EXX": 1.0, "EBC": -1.0}).names == ("EXX", "EBC")


def test_functions_that_return_no_numbers():
    for wrong in (lambda x: "a", lambda x: None, lambda x: x > 0, lambda x: [None] * len(x)):
        with pytest.raises(InvalidSamplesError, match="returned"):
            LATHE.volumetric_error({**Q, "X": [0.01]}, {"EXX": wrong})


# sets -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("values", [[1], None, "EXX", 5, {("EXX",): 1e-6}, {3: 1e-6}])
def test_values_that_are_no_mapping_of_names(values):
    with pytest.raises(DataError, match=r"mapping|not an ISO 230-1 name"):
        ErrorSet(values)
    with pytest.raises(DataError, match=r"mapping|not an ISO 230-1 name"):
        LATHE.volumetric_error(Q, values)


@pytest.mark.parametrize("u", [5, [1], "EXX", None])
def test_uncertainties_that_are_no_mapping(u):
    with pytest.raises(DataError, match="u is a mapping"):
        ErrorSet({"EXX": 0.0}, u=u)
    with pytest.raises(DataError, match=r"'EXX'.*u must be a number.*got None"):
        ErrorSet({"EXX": 0.0}, u={"EXX": None})


@pytest.mark.parametrize(
    ("correlations", "message"),
    [
        ({("EXX", "EYX"): "0.5"}, "must be a number"),
        ({("EXX", "EYX"): None}, "must be a number"),
        ({("EXX", "EYX"): np.array([0.5])}, "must be a number"),
        ({("EXX", "EYX"): True}, "must be a number"),
        ({("EXX",): 0.5}, "pair of two terms"),
        ({("EXX", "EYX", "EXX"): 0.5}, "pair of two terms"),
        ({"EXX": 0.5}, "pair of two terms"),
        ({5: 0.5}, "pair of two terms"),
        ({("EXX", 3): 0.5}, "3 is not a term"),
        ([("EXX", "EYX")], "mapping of pairs"),
        (0.5, "mapping of pairs"),
    ],
)
def test_correlations_that_are_wrong(correlations, message):
    with pytest.raises(DataError, match=message):
        ErrorSet({"EXX": 0.0, "EYX": 0.0}, correlations=correlations)


def test_names_wanted_are_a_sequence():
    errors = ErrorSet({"EXX": 0.0})
    for wanted in (5, "EXX", [3]):
        with pytest.raises(DataError, match=r"names|not a term"):
            errors.covariance(wanted)
        with pytest.raises(DataError, match=r"names|not a term"):
            errors.at({"X": 0.0}, names=wanted)


@pytest.mark.parametrize("name", [3, None, True, ("EXX",), b"EXX"])
def test_names_that_are_no_text(name):
    for call in (axis_of, to_paper, from_paper):
        with pytest.raises(DataError, match=r"name|paper"):
            call(name)
    with pytest.raises(DataError):
        LATHE.jacobian(Q, terms=[name])


def test_errors_to_import_are_a_mapping():
    for errors in ([1], None, "dxy", 3):
        with pytest.raises(DataError, match="mapping"):
            import_errors(errors)


# elements and chains ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": 1}, "axis name"),
        ({"name": None}, "axis name"),
        ({"kind": ["linear"]}, "one of linear"),
        ({"direction": ("1", "0", "0")}, "3 numbers"),
        ({"direction": (True, 0, 0)}, "3 numbers"),
        ({"direction": None}, "3 numbers"),
        ({"direction": {"X": 1}}, "3 numbers"),
        ({"location": (0, 0, "5")}, "3 numbers"),
        ({"location": "123"}, "3 numbers"),
        ({"kind": "fixed", "angle": "0.1"}, "angle"),
        ({"kind": "fixed", "angle": True}, "angle"),
        ({"kind": "fixed", "angle": (0.1,)}, "angle"),
        ({"parked": 1}, "parked"),
        ({"parallel_to": 5}, "parallel_to"),
        ({"parallel_to": "X"}, "itself"),
        ({"errors": {"X": 1}}, "errors"),
        ({"errors": 5}, "errors"),
        ({"errors": [1]}, "errors"),
        ({"errors": [["X"]]}, "errors"),
        ({"location_errors": 5}, "location_errors"),
        ({"location_errors": ["C0Y"]}, "location_errors"),
        ({"location_errors": {3: (0, 0, 0, 0, 0, 1)}}, "C0Y"),
        ({"location_errors": {"C0X": (0, 0, 0, 0, 0, True)}}, "6 numbers"),
        ({"location_errors": {"C0X": (0, 0, 0, 0, 0, 0)}}, "does nothing"),
        ({"location_errors": {"X0X": (1, 0, 0, 0, 0, 0)}}, "does nothing"),
        ({"location_errors": {"Z0X": (0, 0, 1, 0, 0, 0)}}, "does nothing"),
        ({"location_errors": {"A0X": (0, 0, 0, 1, 0, 0)}}, "does nothing"),
        ({"kind": "rotary", "location_errors": {"C0X": (0,) * 6}}, "does nothing"),
    ],
)
def test_elements_that_cannot_be(options, message):
    base = {"name": "X", "branch": "tool", "kind": "linear", "direction": (1, 0, 0)}
    with pytest.raises(DataError, match=message):
        Element(**{**base, **options})


def test_location_errors_that_act():
    # a shift of a rotary axis acts; so does a tilt of a slide that also lists a shift
    c = Element("C", "tool", "rotary", location_errors={"X0C": (1, 0, 0, 0, 0, 0)})
    x = slide("X", location_errors={"C0X": (1e-3, 0, 0, 0, 0, 1)})
    chain = Chain([TABLE, c, x])
    assert np.abs(chain.jacobian({"C": 0.3, "X": 0.1}, terms=["X0C"])).max() == 1.0
    assert np.abs(chain.jacobian({"C": 0.3, "X": 0.1}, terms=["C0X"])).max() > 0.09


@pytest.mark.parametrize("elements", [None, 3, "abc", [None], {"X": 1}])
def test_chains_of_other_things(elements):
    with pytest.raises(DataError, match=r"Element objects|sequence of elements"):
        Chain(elements)


@pytest.mark.parametrize("terms", [5, None, 2.0, [5], [None]])
def test_terms_that_are_no_names(terms):
    with pytest.raises(DataError, match=r"not an error term|names of error terms"):
        LATHE.known_terms(terms)
    if terms is not None:
        with pytest.raises(DataError, match=r"not an error term|names of error terms"):
            LATHE.jacobian(Q, terms=terms)


def test_chains_have_a_hash():
    again = presets("fts_lathe", radius=0.02)
    assert again == LATHE
    assert hash(again) == hash(LATHE)
    assert len({again, LATHE, presets("mill_xyz")}) == 2


def test_names_in_a_chain_belong_to_its_axes():
    with pytest.raises(DataError, match=r"'B0Q' .*no axis 'Q'"):
        Chain([TABLE, slide("X", location_errors={"B0Q": (0, 0, 0, 0, 1, 0)})])
    for other in ("Q", "T"):
        with pytest.raises(DataError, match=f"parallel_to = '{other}'"):
            Chain([TABLE, slide("X", parallel_to=other)])
    turning = Element("A", "tool", "rotary", direction=(1, 0, 0))
    with pytest.raises(DataError, match=r"parallel_to = 'A'.*rotary"):
        Chain([TABLE, turning, slide("X", parallel_to="A")])


# parallel axes ----------------------------------------------------------------------------------


def quarter(name, branch="tool", axis=(0, 0, 1)):
    return Element(name, branch, "fixed", direction=axis, angle=np.pi / 2)


def test_axes_are_parallel_as_they_stand_not_as_they_are_written():
    # behind a quarter turn about Z, a slide along its own Y runs along X of the bed
    with pytest.raises(DataError, match="parallel_to = 'X' in 'U'"):
        Chain([TABLE, slide("X"), quarter("F"), slide("U", (0, 1, 0))])
    w = Element("W", "workpiece", "linear", direction=(0, 1, 0))
    with pytest.raises(DataError, match="parallel_to = 'W' in 'X'"):
        Chain([quarter("F", "workpiece"), w, slide("X")])
    chain = Chain([TABLE, slide("X"), quarter("F"), slide("U", (0, 1, 0), parallel_to="X")])
    step = chain.transform({"X": 0.0, "U": 0.1})[:3, 3]
    assert np.abs(step - [-0.1, 0.0, 0.0]).max() < 1e-16
    # and one along its own X runs along Y: no repetition
    crossed = Chain([TABLE, slide("X"), quarter("F"), slide("U")])
    assert np.abs(crossed.transform({"X": 0.0, "U": 0.1})[:3, 3] - [0.0, 0.1, 0.0]).max() < 1e-16


def test_three_axes_in_a_row_may_repeat_each_other():
    chain = Chain([TABLE, slide("X"), slide("U", parallel_to="X"), slide("P", parallel_to="U")])
    assert chain.axes == ("X", "U", "P")
    chain = Chain([TABLE, slide("X"), slide("U", parallel_to="X"), slide("P", parallel_to="X")])
    assert chain.axes == ("X", "U", "P")
    with pytest.raises(DataError, match="parallel_to"):
        Chain([TABLE, slide("X"), slide("U", parallel_to="X"), slide("P")])


# presets ----------------------------------------------------------------------------------------


def test_choices_of_presets_that_are_wrong():
    for choice in (["fixed"], {}, 3, None, "Fixed"):
        if choice is None:
            assert presets("sts_lathe", spindle_errors=None).name == "sts_lathe"
            continue
        with pytest.raises(DataError, match="spindle_errors is"):
            presets("sts_lathe", spindle_errors=choice)
    for name in (3, ["fts_lathe"], {}):
        with pytest.raises(DataError, match="no preset chain"):
            presets(name)


def test_parameters_in_mm_are_refused():
    for radius in (20, 20.0, np.int64(20)):
        with pytest.raises(UnitError, match=r"radius of fts_lathe is 20(\.0)? m.*20 mm are 0\.02"):
            presets("fts_lathe", radius=radius)
    with pytest.raises(UnitError, match=r"pivot_height of five_axis is -50.0 m"):
        presets("five_axis", pivot_height=-50)
    for radius in (1, np.int64(3), np.float32(0.02), np.array(0.02)):
        assert presets("fts_lathe", radius=radius).name == "fts_lathe"
    for radius in (True, "0.02", None, np.nan, np.array([0.02]), 1j):
        with pytest.raises(DataError, match=r"radius of fts_lathe|radius .* has no unit"):
            presets("fts_lathe", radius=radius)


# files ------------------------------------------------------------------------------------------

W = '[[element]]\nname = "W"\nbranch = "workpiece"\nkind = "fixed"\n'
X = '[[element]]\nname = "X"\nbranch = "tool"\nkind = "linear"\ndirection = "+X"\n'


def load(tmp_path, text, encoding="utf-8", **parameters):
    path = tmp_path / "bench.toml"
    path.write_bytes(text.encode(encoding))
    return Chain.from_toml(path, **parameters)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("parameters = 3\n" + W + X, "parameters"),
        ('parameters = "r"\n' + W + X, "parameters"),
        ('parameters = ["radius"]\n' + W + X, "parameters"),
        ("name = [1]\n" + W + X, "name"),
        ("description = 5\n" + W + X, "description"),
        pytest.param("a = " + "[" * 100_000 + "]" * 100_000 + "\n" + W + X, "nested", id="deep"),
        (W + X + "location_m = " + "[" * 400 + "]" * 400, "location"),
        (W + X + "location_errors = 5", "location_errors"),
        (W + X + 'location_errors = "B0X"', "location_errors"),
        (W + X + "location_errors = [1, 2]", "location_errors"),
        (W + X + 'location_errors = ["B0X", "B0X"]', "twice"),
        (W + X + 'location_errors = ["B0Q"]', "no axis 'Q'"),
        (W + X + 'location_errors = ["Z0X"]', "does nothing"),
        (W + X + "location_errors = { B0X = { B = true } }", "must be a number, got True"),
        (W + X + "errors = { X = 1 }", "errors"),
        (W + X + 'errors = [["X"]]', "errors"),
        (W + X + "errors = [1]", "errors"),
        (W + X + "parallel_to = 5", "parallel_to"),
        (W + X + 'parallel_to = "Q"', "parallel_to"),
        (W + X + 'parallel_to = "X"', "parallel_to"),
        (W + X.replace('"+X"', '["1", "0", "0"]'), "direction"),
        (W + X.replace('"+X"', "[true, 0, 0]"), "direction"),
        (W + "angle_deg = [90]\n" + X, "angle"),
        (W + X + "location_mm = 5", "location"),
    ],
)
def test_files_that_are_wrong(tmp_path, text, message):
    with pytest.raises(DataError, match=message) as raised:
        load(tmp_path, text)
    assert "bench.toml" in str(raised.value)
    assert len(str(raised.value)) < 1000


def test_files_with_a_byte_order_mark_and_numpy_parameters(tmp_path):
    text = '[parameters]\nreach = "reach in m"\n' + W + X + 'location_m = ["reach", 0, "-reach"]\n'
    chain = load(tmp_path, text, encoding="utf-8-sig", reach=np.int64(3))
    assert tuple(chain.elements[1].location) == (3.0, 0.0, -3.0)

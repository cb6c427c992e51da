"""Differences of results, recipes and tables: by hand, with planted signs, and with bad input."""

import copy
import math

import pytest

from metrosep.core.errors import DataError, RecipeError, UnitError
from metrosep.report.compare import compare_documents, compare_recipes
from metrosep.report.comparison import compare_tables

ROUNDING = 1e-21  # m, of a few subtractions of numbers near 1e-7


def _entry(metric="pv", value=100e-9, **more):
    return {"metric": metric, "name": metric, "unit": "m", "value": value, "u": None} | more


def _result(*entries, **more):
    return {
        "schema": "metrosep.result/1",
        "characteristics": list(entries),
        "verdict": None,
    } | more


def _table(forward=(0.0, 1e-9, 2e-9), **more):
    table = {
        "axis": "X",
        "compensates": "Z",
        "sign": "correction c = -e",
        "positions_m": [0.0, 0.01, 0.02],
        "forward_m": list(forward),
        "reverse_m": None,
    }
    return {"schema": "metrosep.table/1", "controller": "linuxcnc", "table": table | more}


def _only(comparison):
    (row,) = comparison.rows
    return row


def test_the_difference_is_b_minus_a_and_u_adds_in_squares():
    a, b = _entry(value=100e-9, U=3e-9), _entry(value=96e-9, U=4e-9)

    row = _only(compare_documents(_result(a), _result(b)))

    assert row.difference == pytest.approx(-4e-9, abs=ROUNDING)
    assert pytest.approx(5e-9, abs=ROUNDING) == row.U
    assert row.exceeds is False
    assert not row.equal


@pytest.mark.parametrize(("step", "exceeds"), [(4.9e-9, False), (5.1e-9, True), (-5.1e-9, True)])
def test_the_difference_exceeds_its_u_on_both_sides(step, exceeds):
    a, b = _entry(U=3e-9), _entry(value=100e-9 + step, U=4e-9)

    assert _only(compare_documents(_result(a), _result(b))).exceeds is exceeds


def test_a_standard_uncertainty_counts_twice():
    row = _only(compare_documents(_result(_entry(u=1e-9)), _result(_entry(u=1e-9))))

    assert pytest.approx(math.sqrt(8.0) * 1e-9, abs=ROUNDING) == row.U


def test_a_standard_uncertainty_of_few_degrees_of_freedom_counts_by_student():
    # t(0.977249868; 10) = 2.2837 and t(0.977249868; 2) = 4.5265
    a, b = _entry(u=1e-9, dof=10.0), _entry(u=1e-9, dof=2.0, value=0.0)
    row = _only(compare_documents(_result(a), _result(_entry(U=0.0))))
    assert pytest.approx(2.2837e-9, abs=1e-13) == row.U
    row = _only(compare_documents(_result(a), _result(b)))
    assert pytest.approx(math.hypot(2.2837e-9, 4.5265e-9), abs=1e-13) == row.U
    none = _entry(u=1e-9, dof=0.0)
    assert _only(compare_documents(_result(none), _result(none))).U is None


def test_without_u_on_one_side_nothing_is_said_about_exceeding():
    row = _only(compare_documents(_result(_entry(U=1e-9)), _result(_entry(value=0.0))))

    assert (row.U, row.exceeds) == (None, None)


@pytest.mark.parametrize(
    ("tolerance", "equal"), [("3 nm", False), ("5 nm", True), (5e-9, True), ("U", True)]
)
def test_a_tolerance_is_a_length_or_u(tolerance, equal):
    a, b = _result(_entry(U=3e-9)), _result(_entry(value=96e-9, U=4e-9))

    assert compare_documents(a, b, tolerances={"pv": tolerance}).equal is equal
    assert compare_documents(a, b, tolerances={"*": tolerance}).equal is equal


def test_a_tolerance_of_u_that_is_not_known_allows_nothing():
    found = compare_documents(
        _result(_entry()), _result(_entry(value=96e-9)), tolerances={"*": "U"}
    )

    assert not found.equal
    assert "U is not known" in _only(found).message


def test_a_change_of_verdict_is_a_difference_whatever_the_tolerance():
    a, b = _entry(verdict="accept"), _entry(value=100.1e-9, verdict="inconclusive")

    found = compare_documents(_result(a), _result(b), tolerances={"pv": "1 nm"})

    assert not found.equal
    assert _only(found).message == "verdict accept became inconclusive"


def test_the_verdict_over_all_checks_counts_too():
    a, b = _result(_entry(), verdict="accept"), _result(_entry(), verdict="reject")

    found = compare_documents(a, b)

    assert not found.equal
    assert "accept" in found.messages[0]


@pytest.mark.parametrize(
    ("a", "b", "equal", "message"),
    [
        (None, None, True, ""),
        (math.nan, None, True, ""),
        (None, 1e-9, False, "not known in A"),
        (1e-9, math.nan, False, "not known in B"),
    ],
)
def test_values_that_are_not_known(a, b, equal, message):
    row = _only(compare_documents(_result(_entry(value=a)), _result(_entry(value=b))))

    assert (row.equal, row.message, row.difference) == (equal, message, None)


def test_units_that_differ_are_not_subtracted():
    row = _only(compare_documents(_result(_entry()), _result(_entry(unit="rad"))))

    assert (row.difference, row.equal) == (None, False)
    assert "m and rad" in row.message


def test_a_metric_of_one_side_only_is_a_difference():
    found = compare_documents(_result(_entry("pv"), _entry("rms")), _result(_entry("pv")))

    assert [(r.metric, r.equal, r.message) for r in found.rows] == [
        ("pv", True, ""),
        ("rms", False, "only in A"),
    ]


def test_two_checks_of_one_metric_are_matched_by_name():
    first, second = _entry(name="inner", value=1e-9), _entry(name="outer", value=2e-9)

    assert compare_documents(_result(first, second), _result(second, first)).equal


def _with_curve(sign):
    plots = {"x_mm": [0.0, 1.0, 2.0], "estimate_nm": [0.0, sign * 50.0, 0.0]}
    return _result(_entry(value=50e-9), plots=plots)


def test_a_turned_sign_of_the_same_pv_is_found():
    found = compare_documents(_with_curve(1), _with_curve(-1))

    assert [r.equal for r in found.rows] == [True, False]
    assert found.rows[1].difference == pytest.approx(100e-9, abs=ROUNDING)


def test_gaps_on_one_side_are_a_difference():
    b = _with_curve(1)
    b["plots"]["estimate_nm"][2] = None

    row = compare_documents(_with_curve(1), b).rows[1]

    assert (row.equal, row.difference) == (False, 0.0)
    assert "1 entries are known on one side only" in row.message


def test_curves_at_other_positions_are_not_subtracted():
    b = _with_curve(1)
    b["plots"]["x_mm"][2] = 2.5

    row = compare_documents(_with_curve(1), b).rows[1]

    assert (row.equal, row.difference) == (False, None)


def test_what_else_differs_is_told_and_does_not_count():
    recipe_a, recipe_b = ({"text": f'metrosep = 1\nupper = "{v} nm"\n'} for v in (5, 6))
    a = _result(_entry(), recipe=recipe_a, inputs=[{"name": "a", "sha256": "1" * 64}])
    b = _result(_entry(), recipe=recipe_b, inputs=[{"name": "b", "sha256": "2" * 64}])
    a["versions"], b["versions"] = {"numpy": "2.0"}, {"numpy": "2.1"}

    found = compare_documents(a, b)

    assert found.equal
    assert found.recipe[-2:] == ('-upper = "5 nm"', '+upper = "6 nm"')
    assert len(found.inputs) == 2
    assert found.versions == ("numpy: 2.0 and 2.1",)


def test_a_real_result_equals_itself_and_nothing_is_changed(document):
    before = copy.deepcopy(document)

    found = compare_documents(document, copy.deepcopy(document))

    assert found.equal
    assert {"table", "table.reverse"} <= {r.metric for r in found.rows}
    assert document == before
    assert found.to_dict()["schema"] == "metrosep.comparison/1"


def test_results_without_anything_to_compare_are_not_called_equal():
    assert not compare_documents(_result(), _result()).equal


@pytest.mark.parametrize("bad", [{}, {"schema": "other"}, [], None, "text"])
def test_what_is_no_result_is_refused(bad):
    with pytest.raises(DataError, match="B is not a result"):
        compare_documents(_result(), bad)


@pytest.mark.parametrize(
    "damage",
    [
        {"characteristics": {"pv": 1}},
        {"characteristics": ["pv"]},
        {"characteristics": [{"value": "1"}]},
        {"characteristics": [{"value": True}]},
        {"recipe": "text"},
        {"verdict": 3},
    ],
)
def test_a_damaged_result_is_refused(damage):
    with pytest.raises(DataError, match="damaged"):
        compare_documents(_result(_entry()), _result() | damage)


@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf, True, [1.0]])
def test_a_tolerance_that_is_none_is_refused(bad):
    with pytest.raises(DataError, match="tolerance of pv"):
        compare_documents(_result(_entry()), _result(_entry()), tolerances={"pv": bad})


@pytest.mark.parametrize("bad", ["5", "5 mrad", "nm"])
def test_a_tolerance_of_another_dimension_is_refused(bad):
    with pytest.raises(UnitError):
        compare_documents(_result(_entry()), _result(_entry()), tolerances={"pv": bad})


def test_a_tolerance_of_no_value_is_refused():
    with pytest.raises(DataError, match=r"'PV'.*pv"):
        compare_documents(_result(_entry()), _result(_entry()), tolerances={"PV": "1 nm"})


def test_tables_are_compared_entry_by_entry():
    found = compare_tables(_table(), _table((0.0, -1e-9, 2e-9)), tolerances={"table": "2.1 nm"})

    assert found.equal
    assert _only(found).difference == pytest.approx(2e-9, abs=ROUNDING)
    assert not compare_tables(_table(), _table((0.0, -1e-9, 2e-9))).equal


@pytest.mark.parametrize(
    "other", [{"axis": "Y"}, {"compensates": "X"}, {"sign": "error e"}], ids=str
)
def test_tables_of_another_axis_or_sign_are_refused(other):
    with pytest.raises(DataError, match=next(iter(other))):
        compare_tables(_table(), _table(**other))


def test_tables_at_other_positions_are_different():
    found = compare_tables(_table(), _table(positions_m=[0.0, 0.01, 0.03]))

    assert not found.equal
    assert "positions differ" in _only(found).message


def test_a_reverse_column_of_one_table_only_is_a_difference():
    found = compare_tables(_table(), _table(reverse_m=[0.0, 1e-9, 2e-9]))

    assert [(r.metric, r.equal) for r in found.rows] == [("table", True), ("table.reverse", False)]


@pytest.mark.parametrize("bad", [{}, {"schema": "metrosep.table/1"}, _result()])
def test_what_is_no_sidecar_is_refused(bad):
    with pytest.raises(DataError, match="A is not the sidecar"):
        compare_tables(bad, _table())


RECIPE = 'metrosep = 1\n[[step]]\nop = "form"\nform = "plane"\n[view]\nzoom = 2\n'


def test_recipes_are_compared_by_key():
    found = compare_recipes(RECIPE, RECIPE.replace("plane", "sphere"))

    assert not found.equal
    assert found.other == ("step[1].form: 'plane' and 'sphere'",)
    assert '+form = "sphere"' in found.recipe


@pytest.mark.parametrize(
    "same",
    [RECIPE + "# end\n", RECIPE.replace("zoom = 2", "zoom = 3"), RECIPE.replace(" = ", "=")],
)
def test_comments_spaces_and_the_view_make_no_other_recipe(same):
    found = compare_recipes(RECIPE, same)

    assert found.equal
    assert found.messages


def test_an_added_step_and_another_type_are_told():
    found = compare_recipes(
        "a = 1\n[[step]]\nop = 'x'\n", "a = 1.0\n[[step]]\nop = 'x'\n[[step]]\n"
    )

    assert found.other == ("a: 1 and 1.0", "step[2]: {} only in B")


def test_what_is_no_toml_is_refused():
    with pytest.raises(RecipeError, match=r"mine\.toml is not TOML"):
        compare_recipes("a = ", "", names=("mine.toml", "b"))


@pytest.mark.parametrize("allowed", ["Smr1", "Smrk1"])
def test_the_symbols_of_two_editions_are_one_parameter(allowed):
    old = _result(_entry("Smr1", 0.1571, unit="1"))
    new = _result(_entry("Smrk1", 0.1575, unit="1"))

    row = _only(compare_documents(old, new, tolerances={allowed: 0.001}))

    assert row.message == ""
    assert row.difference == pytest.approx(4e-4, rel=1e-9, abs=0.0)

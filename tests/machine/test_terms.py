"""Error terms and sets: values, uncertainties, correlations, what `separate` returns, TOML files."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.machine.chains import Chain, presets
from metrosep.machine.error_sets import ErrorSet, as_error_set
from metrosep.machine.terms import (
    CallableTerm,
    ConstantTerm,
    ErrorTerm,
    FourierTerm,
    PolynomialTerm,
    TableTerm,
    as_term,
)

X = np.linspace(-0.1, 0.2, 31)
EXACT = 1e-18  # m; rounding of terms of some um

MILL = {"X": X, "Y": 0.1, "Z": 0.2}


def on_the_mill(term, name="EZX"):
    return presets("mill_xyz").volumetric_error(MILL, {name: term})[:, 2]


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        (2e-6, 2e-6 + 0 * X),
        (ConstantTerm(-2e-6), -2e-6 + 0 * X),
        (PolynomialTerm([1e-6, -2e-5, 3e-4]), 1e-6 - 2e-5 * X + 3e-4 * X * X),
        (
            FourierTerm([1e-6, 2e-7], [0.07, 0.01], [0.3, -1.0], mean=5e-7),
            5e-7
            + 1e-6 * np.cos(2 * np.pi * X / 0.07 + 0.3)
            + 2e-7 * np.cos(2 * np.pi * X / 0.01 - 1.0),
        ),
        (TableTerm([-0.1, 0.0, 0.2], [1e-6, 0.0, 4e-6]), np.where(X < 0, -1e-5 * X, 2e-5 * X)),
        (lambda x: 1e-5 * x, 1e-5 * X),
        (CallableTerm(lambda x: 1e-6), 1e-6 + 0 * X),
    ],
)
def test_every_kind_of_term_moves_the_tool(term, expected):
    assert np.abs(on_the_mill(term) - expected).max() < EXACT
    assert np.abs(on_the_mill(as_term(term)) - expected).max() < EXACT


@pytest.mark.parametrize(
    "term",
    [
        ConstantTerm(1e-6, u=2e-7),
        PolynomialTerm([0.0, 1e-6], u=2e-7),
        FourierTerm([1e-6], [0.1], [0.0], u=2e-7),
        TableTerm([-1.0, 1.0], [0.0, 1e-6], u=2e-7),
        CallableTerm(np.sin, u=2e-7),
    ],
)
def test_uncertainty_of_a_term_is_the_one_given(term):
    assert isinstance(term, ErrorTerm)
    assert (term.sd(X) == 2e-7).all()
    assert term.sd(X).shape == X.shape
    assert term.evaluate(0.1).shape == ()
    assert term.evaluate(np.zeros((2, 3))).shape == (2, 3)
    assert pickle.loads(pickle.dumps(term)) == term  # noqa: S301


def test_uncertainty_of_a_polynomial_is_propagated():
    covariance = np.array([[4e-14, -1e-13], [-1e-13, 9e-12]])
    term = PolynomialTerm([0.0, 1e-6], u=1e-7, covariance=covariance)
    expected = np.sqrt(1e-14 + 4e-14 - 2e-13 * X + 9e-12 * X * X)
    assert np.abs(term.sd(X) - expected).max() < EXACT


def test_uncertainty_of_a_table_is_interpolated():
    term = TableTerm([0.0, 0.1], [0.0, 0.0], u=[1e-7, 3e-7])
    assert term.sd(0.05) == pytest.approx(2e-7, abs=EXACT)


def test_the_ends_of_a_table_are_rounded():
    term = TableTerm([0.0, 0.3], [1e-6, 4e-6], u=[1e-8, 2e-8])
    assert 3 * 0.1 > 0.3
    assert term.evaluate(3 * 0.1) == 4e-6
    assert term.sd([3 * 0.1, -2e-10]).tolist() == [2e-8, 1e-8]
    for outside in (0.3 + 4e-10, -4e-10):  # beyond 1e-9 of the span
        with pytest.raises(DataError, match="outside the error table"):
            term.evaluate(outside)


def test_a_run_polynomial_is_not_left():
    from metrosep.process.straightness_runs import run_polynomial

    x = np.linspace(0.0, 0.1, 101)
    runs = [ms.Profile(x, 1e-6 * x)] * 2
    errors = {"EZX": run_polynomial(runs, quantity="error", degree=1)}
    chain = presets("mill_xyz")
    assert chain.volumetric_error({"X": 0.1, "Y": 0.0, "Z": 0.0}, errors)[2] == pytest.approx(
        1e-7, abs=EXACT
    )
    with pytest.raises(LimitError, match="not extrapolated"):
        chain.volumetric_error({"X": 0.11, "Y": 0.0, "Z": 0.0}, errors)


def test_numbers_of_a_plain_mapping_are_exact():
    chain = presets("mill_xyz")
    q = {"X": 0.1, "Y": 0.0, "Z": 0.0}
    assert (chain.volumetric_covariance(q, {"EXX": 1e-6}) == 0).all()
    with_u = chain.volumetric_covariance(q, {"EXX": ConstantTerm(1e-6, u=1e-7)})
    assert with_u[0, 0] == pytest.approx(1e-14, abs=1e-26)
    assert "exact" in Chain.volumetric_covariance.__doc__


def test_what_separate_returns_is_a_term():
    x = np.linspace(0, 0.1, 400)
    truth = 1e-6 * np.cos(2 * np.pi * x / 0.02 + 0.4)
    rng = np.random.default_rng(3)
    runs = ms.RunSet([ms.Profile(x, truth + 5e-9 * rng.standard_normal(400)) for _ in range(4)])
    estimate = ms.separation.separate(runs, method="mean")
    assert isinstance(estimate, ErrorTerm)
    errors = ErrorSet({"EZX": estimate, "EYX": 0.0}, u={"EYX": 1e-8})
    chain = presets("mill_xyz")
    inside = x[20:-20]
    q = {"X": inside, "Y": 0.0, "Z": 0.0}
    got = chain.volumetric_error(q, errors)
    assert (got[:, 2] == estimate.evaluate(inside)).all()
    # sign: the reading of the tool against the table comes back as it is
    assert np.corrcoef(got[:, 2], truth[20:-20])[0, 1] > 0.9
    u = np.sqrt(chain.volumetric_covariance(q, errors)[:, 2, 2])
    assert np.abs(u - estimate.sd(inside)).max() < EXACT


def test_covariance_by_hand():
    errors = ErrorSet(
        {"EXX": 1e-6, "ECX": 0.0, "EYX": 0.0},
        u={"EXX": 2e-7, "ECX": 1e-6},
        correlations={("ECX", "EXX"): -0.5},
    )
    got = errors.covariance(["ECX", "EXX"])
    assert np.abs(got - [[1e-12, -1e-13], [-1e-13, 4e-14]]).max() < 1e-27
    assert (errors.covariance()[2] == 0).all()
    assert (np.diag(errors.correlation()) == 1).all()
    at = errors.covariance(["ECX", "EXX"], {"X": X})
    assert at.shape in {(2, 2), (X.size, 2, 2)}
    assert np.abs(at - got).max() < 1e-27


def test_uncertainty_that_depends_on_the_position_needs_it():
    errors = ErrorSet({"EXX": TableTerm([0.0, 0.1], [0.0, 0.0], u=[1e-7, 3e-7])})
    with pytest.raises(DataError, match="'EXX' depends on the position; give q"):
        errors.covariance()
    got = errors.covariance(q={"X": [0.0, 0.05]})
    assert np.abs(got[:, 0, 0] - [1e-14, 4e-14]).max() < 1e-27


def test_values_at_positions():
    errors = ErrorSet({"EXX": lambda x: 2e-3 * x, "B0Z": 1e-6}, u={"EXX": 1e-7})
    got = errors.at({"X": np.array([[1.0, np.nan]])})
    assert got["EXX"].shape == (1, 2)
    assert got["EXX"][0, 0] == 2e-3
    assert np.isnan(got["EXX"][0, 1])
    assert got["B0Z"] == 1e-6
    assert (errors.u_at({"X": [0.0, 1.0]})["EXX"] == 1e-7).all()


def test_sets_cannot_be_changed_from_outside():
    values = {"EXX": 1e-6}
    errors = ErrorSet(values)
    values["EXX"] = 2.0
    assert errors.values["EXX"] == 1e-6
    with pytest.raises(TypeError):
        errors.values["EXX"] = 1.0
    assert as_error_set(errors) is errors
    assert pickle.loads(pickle.dumps(errors)).names == ("EXX",)  # noqa: S301


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ConstantTerm(np.nan), "finite number, got nan"),
        (lambda: ConstantTerm(1e-6, u=-1.0), "zero or more"),
        (lambda: ConstantTerm(1j), "must be a number, got 1j"),
        (lambda: ConstantTerm("1 um"), "must be a number, got '1 um'"),
        (lambda: PolynomialTerm([1.0, np.nan]), "coefficients hold NaN at index 1"),
        (lambda: PolynomialTerm([1.0], covariance=np.eye(2)), r"\(1, 1\)"),
        (lambda: PolynomialTerm([1.0, 2.0], covariance=[[1, 2], [2, 1]]), "negative"),
        (lambda: PolynomialTerm([1.0, 2.0], covariance=[[1, 1], [0, 1]]), "symmetric"),
        (lambda: FourierTerm([1.0], [0.0], [0.0]), "positive"),
        (lambda: FourierTerm([1.0, 2.0], [1.0], [0.0]), "equally long"),
        (lambda: TableTerm([0.0], [1.0]), "two or more"),
        (lambda: TableTerm([0.0, 1.0], [1.0]), "got 2 and 1"),
        (lambda: TableTerm([0.0, 1.0], [1.0, np.nan]), "NaN at index 1"),
        (lambda: TableTerm([0.0, 1.0, 0.5], [0.0, 0.0, 0.0]), "must rise, got 1.0 then 0.5"),
        (lambda: TableTerm([0.0, 1.0], [0.0, np.inf]), "infinite"),
        (lambda: TableTerm([0.0, 1.0], [0.0, 1.0], u=[0.0, -1.0]), ">= 0"),
        (lambda: CallableTerm(3.0), "needs a function"),
        (lambda: as_term([1.0, 2.0]), "TableTerm"),
        (lambda: as_term(None), "NoneType"),
        (lambda: as_term(ConstantTerm(1.0), u=1.0), "of its own"),
        (lambda: ErrorSet({"dxx": 1.0}), "EXX"),
        (lambda: ErrorSet({"EXX": "1 mrad"}), "'EXX'.*angle"),
        (lambda: ErrorSet({"EXX": 1.0}, u={"EYX": 1.0}), "'EYX' belongs to no term"),
        (
            lambda: ErrorSet({"EXX": 1e-6}, correlations={("EXX", "EYX"): 0.1}),
            "'EYX' is not a term",
        ),
        (lambda: ErrorSet({"EXX": 1e-6}, correlations={("EXX", "EXX"): 0.1}), "once"),
        (
            lambda: ErrorSet({"EXX": 0, "EYX": 0}, correlations={("EXX", "EYX"): 1.1}),
            "between -1 and 1",
        ),
        (lambda: as_error_set([1.0]), "mapping"),
    ],
)
def test_terms_that_cannot_be(make, message):
    with pytest.raises((DataError, InvalidSamplesError), match=message):
        make()


def test_amounts_are_numbers_in_si_or_texts_with_their_unit():
    errors = ErrorSet({"EXX": "2 um", "ECC": "10 urad"}, u={"EXX": "100 nm"})
    assert errors.terms["EXX"] == ConstantTerm(2e-6, u=1e-7)
    assert (errors.values["ECC"], errors.u["EXX"]) == (1e-5, 1e-7)
    assert (
        presets("fts_lathe", radius="20 mm").elements == presets("fts_lathe", radius=0.02).elements
    )


def test_correlations_that_contradict_each_other():
    pairs = {("EXX", "EYX"): 0.9, ("EYX", "EZX"): 0.9, ("EXX", "EZX"): -0.9}
    with pytest.raises(DataError, match="contradict"):
        ErrorSet({"EXX": 0.0, "EYX": 0.0, "EZX": 0.0}, correlations=pairs)


@pytest.mark.parametrize(
    ("term", "name", "message"),
    [
        (
            TableTerm([0.0, 0.1], [0.0, 1e-6]),
            "EZX",
            r"position -0\.1 lies outside .*\(0 to 0\.1\)",
        ),
        (CallableTerm(lambda x: np.where(x > 0.095, np.nan, x)), "EZX", "not known at X = 0.1"),
        (CallableTerm(lambda x: x[:2]), "EZX", "shape"),
        (CallableTerm(lambda x: x), "B0Z", "a location error is a constant"),
    ],
)
def test_terms_that_cannot_be_evaluated(term, name, message):
    with pytest.raises((DataError, InvalidSamplesError), match=message):
        on_the_mill(term, name)


TOML = """
name = "bench"
[parameters]
height = "height of the probe in m"
[[element]]
name = "X"
branch = "workpiece"
kind = "linear"
direction = "-X"
location_mm = [10, 0, -5]
errors_of = "tool"
[[element]]
name = "head"
branch = "tool"
kind = "fixed"
direction = [0, 1, 0]
angle_deg = 90
location_m = [0, "-height", "height"]
errors = "A"
"""


def test_chain_of_a_file(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(TOML, encoding="utf-8")
    chain = Chain.from_toml(path, height=0.3)
    assert chain.name == "bench"
    assert chain.terms == ("EXX", "EYX", "EZX", "EAX", "EBX", "ECX", "EAhead")
    pose = chain.transform({"X": 0.2}, tool=(0.0, 0.0, 0.1))
    # head turned by 90 degrees about Y: its z is the machine's x
    expected = [0.1 - 0.01 + 0.2, -0.3, 0.3 + 0.005]
    assert np.abs(pose[:3, 3] - expected).max() < 1e-15
    assert chain.volumetric_error({"X": 0.2}, {"EAhead": 1e-6}).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "bench"', "name = bench", "is not a TOML file"),
        ("location_mm", "location", "a unit belongs to the key: location_m, location_mm"),
        ("location_mm", "location_inch", "a unit belongs to the key"),
        ("angle_deg", "angel_deg", "unknown key 'angel_deg'.*known"),
        ('direction = "-X"', 'direction = "-W"', r"element 1 \(X\).*'-W' is none of"),
        ('direction = "-X"', "direction = [1, 1, 0]", r"element 1 \(X\).*length 1\.41"),
        ('direction = "-X"\n', "", "'direction' is missing"),
        ('branch = "tool"', 'branch = "bed"', r"element 2 \(head\).*one of tool, workpiece"),
        ('branch = "tool"', 'branch = "workpiece"', "does not close.*'tool'"),
        ('kind = "fixed"', 'kind = "glued"', "one of linear, rotary, fixed, got 'glued'"),
        ('name = "head"\n', "", "'name' must be a text"),
        ('"-height"', '"-width"', "'-width' is not a parameter; the chain has height"),
        ("[10, 0, -5]", '["height", 0, 0]', "SI; use the key without a prefix"),
        ("[10, 0, -5]", "[10, 0]", "3 finite numbers"),
        ("[10, 0, -5]", "[10, 0, true]", "must be a number, got True"),
        ("[10, 0, -5]", "[10, 0, nan]", "3 finite numbers"),
        ("location_mm", "location_m = [0, 0, 0]\nlocation_mm", "given twice"),
        ('errors = "A"', 'errors = "Q"', "known directions"),
        ('errors = "A"', "errors = 3", r"element 2 \(head\)"),
        ("[[element]]", "[[elements]]", "unknown key 'elements'"),
        ('errors_of = "tool"', "location_errors = { C0X = { Q = 1 } }", "unknown key 'Q'"),
        ('errors_of = "tool"', 'location_errors = ["skew"]', "unknown key|C0Y"),
        ('errors_of = "tool"', "parked = 1", "parked"),
    ],
)
def test_files_that_are_wrong(tmp_path, old, new, message):
    path = tmp_path / "bench.toml"
    assert old in TOML
    path.write_text(TOML.replace(old, new), encoding="utf-8")
    with pytest.raises((DataError, InvalidSamplesError), match=message) as raised:
        Chain.from_toml(path, height=0.3)
    assert "bench.toml" in str(raised.value)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, r"'height' is missing \(height of the probe in m\)"),
        ({"height": np.nan}, "'height' must be a finite number, got nan"),
        ({"height": 0.3, "width": 1.0}, "no parameter 'width'; it has height"),
        ({"height": "300 mm"}, "'height' must be a number, got '300 mm'"),
    ],
)
def test_parameters_that_are_wrong(tmp_path, parameters, message):
    path = tmp_path / "bench.toml"
    path.write_text(TOML, encoding="utf-8")
    with pytest.raises(DataError, match=message):
        Chain.from_toml(path, **parameters)


def test_file_that_is_missing_or_binary(tmp_path):
    with pytest.raises(FileNotFoundError):
        Chain.from_toml(tmp_path / "none.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match=r"b\.toml: line 1 is not UTF-8; save"):
        Chain.from_toml(tmp_path / "b.toml")


@pytest.mark.parametrize("table", [{}, {"element": []}, {"element": "X"}, {"element": [3]}, 3])
def test_tables_that_are_wrong(table):
    with pytest.raises(DataError, match=r"element|table"):
        Chain.from_dict(table)


def test_a_table_of_a_full_turn_is_looked_up_modulo_the_turn(tmp_path):
    """C-90 is C270 and C370 is C10; a table that does not close says nothing beyond its ends."""
    from metrosep.io.term_files import read_term_table

    file = tmp_path / "c.csv"
    rows = [f"{c},{20 * np.sin(np.radians(c)):.6f},{c / 360}" for c in range(0, 361, 5)]
    file.write_text("\n".join(["c_deg,EXC_um,EYC_um", *rows]) + "\n")
    held = read_term_table(file, {"C": "angle"})
    asked = np.radians([-90.0, 370.0, 730.0, -360.0])
    wanted = 20e-6 * np.sin(asked)
    assert held["EXC"][0].evaluate(asked) == pytest.approx(wanted, abs=1e-11)
    with pytest.raises(DataError, match="nothing is extrapolated"):
        held["EYC"][0].evaluate(np.radians(-90.0))
    with pytest.raises(InvalidSamplesError, match="end as it begins"):
        TableTerm([0.0, 1.0], [0.0, 1e-6], period=1.0)

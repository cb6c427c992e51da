"""Polynomials for PLCs: the paper's equation, an evaluator of the text in the test, signs, damage."""

import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.polynomial import Polynomial, legendre

from metrosep import Profile, controllers
from metrosep.compensation import fit_polynomial
from metrosep.compensation.polynomial import PolynomialFit
from metrosep.controllers.options import checked_options
from metrosep.controllers.plc import PLCStructuredText, PLCTurboPMAC
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    TableError,
)

DIALECTS = {"plc-st": PLCStructuredText, "plc-pmac": PLCTurboPMAC}
NOWHERE = Path("/nonexistent/x.st")
OF_THE_ENDS = 1e-15
"""m; the ends of the range are printed in femtometres."""
IN_DOUBLE = 1e-9
"""Relative; 17 Legendre terms of one sign and size lose 1e-14."""
ROUNDING = 1e-18
"""m; a polynomial of 10 um in double."""
PRINTED = 1e-14
"""m; nine digits of 10 um."""

PAPER_UM = [0.3389, 0.48246, -0.00605]
"""Dual-servo paper, equation 1, signs of papers.md: y in um over x in mm, 0 ... 40 mm."""

HAND_ST = """(* x_unit = mm *)
(* y_unit = um *)
(* actuator_sign = 1 *)
(* offset = 0 nm *)
FUNCTION Axis_Z : LREAL
VAR_INPUT
  x : LREAL; (* mm *)
END_VAR
VAR
  h : LREAL;
END_VAR
h := LIMIT(0.0, x, 40.0);
Axis_Z := 0.3389 + h*(0.48246 - h*(0.00605));
END_FUNCTION
"""
HAND_PMAC = """; x_unit = mm
; y_unit = um
; actuator_sign = 1
; offset = 0 nm
OPEN PLC 10 CLEAR
P102=P100
IF (P102<0)
P102=0
ENDIF
IF (P102>40)
P102=40
ENDIF
P101=0.3389+P102*(0.48246-P102*(0.00605)) ; y
CLOSE
"""
HAND = {"plc-st": HAND_ST, "plc-pmac": HAND_PMAC}


def evaluate(name, text, x):
    """Run the text as its language says, exactly, in its own units; no code of the library."""
    if name == "plc-st":
        code = re.sub(r"\(\*.*?\*\)", "", text)
        low, high = re.search(r"LIMIT\((\S+), x, (\S+)\);", code).groups()
        right = re.search(r"\n\w+ := ([^;L]+);\nEND_FUNCTION", code)[1]
        variable = "h"
    else:
        code = re.sub(r";.*", "", text)
        variable = re.search(r"\n(P\d+)=(P\d+)\n", code)[1]
        low = re.search(rf"IF \({variable}<(\S+)\)\n{variable}=\1\nENDIF", code)[1]
        high = re.search(rf"IF \({variable}>(\S+)\)\n{variable}=\1\nENDIF", code)[1]
        right = re.search(r"\nP\d+=([^\n]+)\nCLOSE", code)[1]
    held = min(max(Fraction(x), Fraction(low)), Fraction(high))
    return float(value(re.sub(r"\s", "", right).replace(variable, "q"), held))


def value(text, q):
    """Return a0 + q*(a1 + ...) by taking it apart from the left."""
    first, sign, inner = re.fullmatch(r"(-?\d+(?:\.\d+)?)(?:([+-])q\*\((.*)\))?", text).groups()
    if sign is None:
        return Fraction(first)
    return Fraction(first) + (q if sign == "+" else -q) * value(inner, q)


def fit_of(powers, domain, quantity="compensation"):
    """Return a fit of power coefficients in SI."""
    series = Polynomial(powers).convert(kind=legendre.Legendre, domain=domain, window=[-1, 1])
    coefficients = np.zeros(len(powers))
    coefficients[: series.coef.size] = series.coef
    return PolynomialFit(coefficients, None, "given", domain, quantity, 0.0)


def paper(quantity="compensation"):
    sign = 1.0 if quantity == "compensation" else -1.0
    return fit_of(sign * np.array(PAPER_UM) * 1e-6 * 1e3 ** np.arange(3), (0.0, 40e-3), quantity)


def encode(name, fit, **options):
    options = {"actuator_sign": 1, **options}
    dialect = DIALECTS[name]()
    return dialect.encode(fit, **checked_options(options, dialect.options, name))


def bare(data):
    text = re.sub(r"\(\*.*?\*\)|;.*$" if b"OPEN" in data else r"\(\*.*?\*\)", "", data.decode(),
                  flags=re.MULTILINE)  # fmt: skip
    return [re.sub(r"\s", "", line) for line in text.splitlines() if line.strip()]


@pytest.mark.parametrize("name", DIALECTS)
def test_equation_of_the_paper(name):
    encoded = encode(name, paper(), **({"function": "Axis_Z"} if name == "plc-st" else {}))

    assert bare(encoded.data) == bare(HAND[name].encode())
    for x, y in ((0.0, 0.3389), (39.873, 9.957), (10.0, 4.5585), (-3.0, 0.3389), (50.0, 9.9573)):
        assert evaluate(name, encoded.data.decode(), x) == pytest.approx(y, abs=5e-4)
    low, high = encoded.notes["y_range_m"]
    assert high - low == pytest.approx(9.6185e-6, abs=1e-10)  # papers.md, P-V
    assert encoded.quantisation <= ROUNDING


@pytest.mark.parametrize("name", DIALECTS)
def test_hand_made_text_reads_as_the_paper(name):
    fit = DIALECTS[name]().decode(HAND[name].encode(), NOWHERE)

    np.testing.assert_allclose(
        fit.coefficients, np.array(PAPER_UM) * [1e-6, 1e-3, 1.0], atol=1e-15, rtol=1e-12
    )
    assert fit.domain == (0.0, 0.04)
    assert fit.quantity == "compensation"


@pytest.mark.parametrize("name", DIALECTS)
def test_error_and_compensation_give_the_same_text(name):
    """The file always gives what is added."""
    one, other = (encode(name, paper(q)).data for q in ("compensation", "error"))

    assert bare(one) == bare(other)
    assert b"minus the fitted error" in other


@pytest.mark.parametrize("name", DIALECTS)
def test_piezo_against_the_axis(name):
    """A fitted error e and a piezo that moves the tool by -y: y = e takes it away."""
    error = fit_of([1e-6, 2e-3], (0.0, 10e-3), "error")
    encoded = encode(name, error, actuator_sign=-1, offset="3 um")

    y = evaluate(name, encoded.data.decode(), 4.0)  # um

    assert y == pytest.approx(1 + 2 * 4 + 3, abs=1e-9)
    tool = -(y - 3)
    assert tool + (1 + 2 * 4) == pytest.approx(0.0, abs=1e-9)
    look = DIALECTS[name]().lookup(encoded.data, NOWHERE)
    assert look(4e-3) == pytest.approx(-9e-6, abs=PRINTED)
    fit = DIALECTS[name]().decode(encoded.data, NOWHERE)
    np.testing.assert_allclose(fit.evaluate([4e-3]), [-9e-6], atol=PRINTED, rtol=0)


@pytest.mark.parametrize("name", DIALECTS)
def test_written_with_dry_run(name, tmp_path):
    x = np.linspace(-10e-3, 40e-3, 401)
    error = 2e-6 + 3e-5 * x - 4e-3 * x**2 + 0.08 * x**3 + 20e-9 * np.sin(x / 1e-3)
    measured = Profile(x, error)
    fit = fit_polynomial(measured, degree=3)
    path = tmp_path / "x.plc"

    result = controllers.write(fit, path, name, verified_against=measured, actuator_sign=1)

    assert result.passed
    assert result.after_pv < 60e-9  # the ripple of 40 nm P-V and its share in the fit
    assert result.wrong_sign_pv > 1.9 * result.before_pv
    back = controllers.read(path, name)
    assert back.residual_rms == fit.residual_rms
    np.testing.assert_allclose(back.evaluate(x), -fit.evaluate(x), atol=PRINTED, rtol=0)
    look = controllers.simulate(path, name)
    seen = [evaluate(name, path.read_text(), v) for v in x[::40] * 1e3]
    np.testing.assert_allclose(look(x[::40], -1), np.array(seen) * 1e-6, atol=ROUNDING, rtol=0)
    with pytest.raises(SignCheckFailedError):
        controllers.write(
            fit, tmp_path / "y.plc", name, verified_against=Profile(x, -error), actuator_sign=1
        )
    assert "quantity_of_the_fit" in json.loads((tmp_path / "x.plc.json").read_text())


@pytest.mark.parametrize("name", DIALECTS)
def test_lookup_holds_the_ends_in_both_directions(name):
    look = DIALECTS[name]().lookup(HAND[name].encode(), NOWHERE)

    seen = look(np.array([-1.0, 0.0, 0.04, 1.0]), np.array([1, -1, 1, -1]))

    end = 0.3389e-6 + 0.48246e-6 * 40 - 0.00605e-6 * 1600
    np.testing.assert_allclose(seen, [0.3389e-6, 0.3389e-6, end, end], atol=ROUNDING, rtol=0)
    with pytest.raises(DataError, match="direction"):
        look(0.0, 0)


@given(
    start=st.floats(-0.3, 0.3),
    length=st.floats(1e-4, 0.5),
    degree=st.integers(0, 5),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-9, 1e-4),
    name=st.sampled_from(sorted(DIALECTS)),
    error=st.booleans(),
    against=st.booleans(),
    digits=st.integers(5, 12),
    offset=st.floats(-1e-5, 1e-5),
)
@settings(derandomize=True, deadline=None, max_examples=80)
def test_round_trip_is_within_the_printed_digits(
    start, length, degree, seed, size, name, error, against, digits, offset
):
    rng = np.random.default_rng(seed)
    domain = (start, start + length)
    fit = PolynomialFit(
        size * rng.uniform(-1, 1, degree + 1), None, "", domain,
        "error" if error else "compensation", 0.0,
    )  # fmt: skip
    s = -1 if against else 1

    encoded = encode(name, fit, actuator_sign=s, digits=digits, offset=offset)

    # terms cancel where the domain is far from zero: what they are made of bounds the rounding
    powers = fit.coefficients * max(abs(d) for d in domain) ** np.arange(degree + 1)
    terms = np.abs(powers).sum() + abs(offset)
    assert encoded.quantisation <= terms * 10.0 ** (1 - digits) + 1e-11 * terms
    x = np.linspace(*domain, 7)[1:-1]
    wanted = (-1 if error else 1) * fit.evaluate(x)
    y = np.array([evaluate(name, encoded.data.decode(), v * 1e3) for v in x]) * 1e-6
    bound = encoded.quantisation * 1.1 + 1e-11 * terms
    assert np.abs(s * (y - offset) - wanted).max() <= bound
    back = DIALECTS[name]().decode(encoded.data, NOWHERE)
    assert np.abs(back.evaluate(x) - wanted).max() <= bound
    assert "e" not in "".join(re.findall(r"[\d.]e", encoded.data.decode()))


@pytest.mark.parametrize("name", DIALECTS)
def test_stroke_and_unipolar_actuators(name):
    """Dual-servo paper: 16.6 um at 10 V; the other sign needs 9.28 um of offset (papers.md)."""
    negated = fit_of(-np.array(PAPER_UM) * [1e-6, 1e-3, 1.0] + [2 * 0.3389e-6, 0, 0], (0.0, 40e-3))

    assert encode(name, paper(), stroke="16.6 um", unipolar=True).findings == ()
    short = encode(name, paper(), stroke="9 um").findings
    assert [(f.level, f.check) for f in short] == [("error", "stroke")]
    below = encode(name, negated, unipolar=True).findings
    assert [f.check for f in below] == ["stroke"]
    assert "9.28 um" in below[0].fix
    assert encode(name, negated, unipolar=True, offset="9.29 um", stroke="16.6 um").findings == ()


@pytest.mark.parametrize("name", DIALECTS)
def test_stroke_refuses_to_write(name, tmp_path):
    x = np.linspace(0.0, 40e-3, 101)
    measured = Profile(x, -paper().evaluate(x))

    with pytest.raises(LimitError, match=r"stroke is 9 um.*waive='stroke'"):
        controllers.write(
            paper(),
            tmp_path / "x",
            name,
            stroke="9 um",
            verified_against=measured,
            actuator_sign=1,
        )
    assert list(tmp_path.iterdir()) == []


def test_too_few_digits_far_from_zero_are_found():
    far = PolynomialFit(
        np.array([0.0, 1.2345678e-6, 1.7654321e-6]), None, "", (1.0, 1.01), "error", 0.0
    )

    assert "quantisation" in [f.check for f in encode("plc-st", far, digits=4).findings]
    assert encode("plc-st", far, digits=12).findings == ()
    # 35 bits of PMAC are fewer than 12 digits, with terms of 10^4 times the correction
    assert encode("plc-pmac", far, digits=12).notes["rounding_of_the_controller_m"] > 1e-12


@pytest.mark.parametrize(
    ("name", "options", "kind", "text"),
    [
        ("plc-st", {"function": "1st"}, DataError, "no identifier"),
        ("plc-st", {"function": "END_VAR"}, DataError, "no identifier"),
        ("plc-st", {"function": "h"}, DataError, "no identifier"),
        ("plc-st", {"function": "a*)b"}, DataError, "no identifier"),
        ("plc-st", {"digits": 2}, DataError, "digits"),
        ("plc-st", {"x_unit": "inch"}, DataError, "x_unit"),
        ("plc-st", {"actuator_sign": 0}, DataError, "actuator_sign"),
        ("plc-st", {"stroke": "-1 um"}, DataError, "stroke"),
        ("plc-pmac", {"x_variable": 102}, DataError, "three variables"),
        ("plc-pmac", {"plc": 32}, DataError, "plc"),
    ],
)
def test_bad_options(name, options, kind, text):
    with pytest.raises(kind, match=text):
        encode(name, paper(), **options)


def test_line_too_long_for_pmac_is_refused():
    rng = np.random.default_rng(7)
    long = fit_of(rng.uniform(1, 2, 12), (0.0, 1.0))

    with pytest.raises(LimitError, match="characters"):
        encode("plc-pmac", long, digits=17)
    assert encode("plc-st", long, digits=17).data


def test_fit_must_state_what_it_is():
    for bad in (
        PolynomialFit(np.array([1e-6]), None, "", (0.0, 1.0), "form", 0.0),
        PolynomialFit(np.array([np.nan]), None, "", (0.0, 1.0), "error", 0.0),
        PolynomialFit(np.array([1e-6]), None, "", (0.0, np.inf), "error", 0.0),
    ):
        with pytest.raises(TableError):
            encode("plc-st", bad)


def test_units_are_never_guessed():
    for line in ("x_unit = mm", "y_unit = um", "offset = 0 nm", "actuator_sign = 1"):
        text = HAND_ST.replace(f"(* {line} *)\n", "")
        with pytest.raises(DataError, match=line.split()[0]):
            PLCStructuredText().decode(text.encode(), NOWHERE)
    told = PLCStructuredText().decode(text.encode(), NOWHERE, actuator_sign=-1)
    assert told.coefficients[0] == pytest.approx(-0.3389e-6, abs=ROUNDING)


def test_other_units():
    encoded = encode("plc-st", paper(), x_unit="um", y_unit="nm", digits=12)

    text = encoded.data.decode()
    assert "h := LIMIT(0.0, x, 40000.0);" in text
    assert evaluate("plc-st", text, 10000.0) == pytest.approx(4558.5, abs=1e-6)
    assert PLCStructuredText().decode(encoded.data, NOWHERE).domain == (0.0, 0.04)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("plc-st", "END_FUNCTION\n", ""),
        ("plc-st", "END_FUNCTION\n", "END_FUNCTION\nx := 1.0;\n"),
        ("plc-st", "Axis_Z :=", "Axis_Y :="),
        ("plc-st", "0.00605)", "0.00605"),
        ("plc-st", "0.00605)", "6.05E-3)"),
        ("plc-st", "h*(0.48246", "x*(0.48246"),
        ("plc-st", "- h*", "* h*"),
        ("plc-st", "LIMIT(0.0, x, 40.0)", "LIMIT(40.0, x, 0.0)"),
        ("plc-st", "LIMIT(0.0, x, 40.0)", "LIMIT(x, 0.0, 40.0)"),
        ("plc-st", "LIMIT(0.0, x, 40.0)", "x"),
        ("plc-st", "x : LREAL", "x : REAL"),
        ("plc-st", "x_unit = mm", "x_unit = yd"),
        ("plc-pmac", "CLOSE\n", ""),
        ("plc-pmac", "P102=40", "P102=41"),
        ("plc-pmac", "P102=0", "P103=0"),
        ("plc-pmac", "P102=P100", "P102=P102"),
        ("plc-pmac", "P101=0", "P100=0"),
        ("plc-pmac", "(0.48246-P102", "(0.48246-P103"),
        ("plc-pmac", "(P102<0)", "(P102>0)"),
        ("plc-pmac", "ENDIF\nP101", "P101"),
        ("plc-pmac", "(0.00605)", "(0.00605"),
        ("plc-pmac", "OPEN PLC 10 CLEAR", "OPEN PLC 10"),
    ],
)
def test_every_damage_is_named(name, old, new):
    assert old in HAND[name]

    with pytest.raises(CorruptFileError):
        DIALECTS[name]().decode(HAND[name].replace(old, new, 1).encode(), NOWHERE)


@pytest.mark.parametrize("name", DIALECTS)
def test_every_cut_file_is_refused(name):
    whole = HAND[name].rstrip("\n")
    for length in range(len(whole)):
        with pytest.raises((CorruptFileError, DataError)):
            DIALECTS[name]().decode(whole[:length].encode(), NOWHERE)


@pytest.mark.parametrize("name", DIALECTS)
def test_sign_of_the_actuator_is_asked_for(name, tmp_path):
    """It was 1 by default: of a piezo opposed to the axis the error doubled."""
    x = np.linspace(0.0, 40e-3, 101)
    measured = Profile(x, -paper().evaluate(x))

    with pytest.raises(DataError, match="cannot be written without actuator_sign="):
        controllers.write(paper(), tmp_path / "x", name, verified_against=measured)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", DIALECTS)
def test_comment_of_the_offset_that_was_dropped_is_asked_for(name):
    text = encode(name, paper(), offset="5 um").data.decode()
    text = "".join(x for x in text.splitlines(True) if "offset =" not in x)

    with pytest.raises(DataError, match=r"tells offset \("):
        DIALECTS[name]().lookup(text.encode(), NOWHERE)


@pytest.mark.parametrize("name", DIALECTS)
def test_comments_that_are_contradicted_or_doubled_are_refused(name):
    data = encode(name, paper(), offset="5 um").data

    for key, value in (("actuator_sign", -1), ("y_unit", "nm"), ("offset", 0.0)):
        with pytest.raises(DataError, match=rf"{key}=.*{key}="):
            DIALECTS[name]().decode(data, NOWHERE, **{key: value})
    line = next(x for x in data.splitlines(True) if b"y_unit =" in x)
    with pytest.raises(CorruptFileError, match="two comments state y_unit"):
        DIALECTS[name]().decode(line + data, NOWHERE)


@pytest.mark.parametrize(
    "words", ["SIN", "INT", "Real", "bool", "Abs", "LIMIT", "while", "TON", "MIN", "string", "_x"]
)
def test_names_that_the_language_takes_are_refused(words):
    with pytest.raises(DataError, match="no identifier"):
        encode("plc-st", paper(), function=words)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("LIMIT(0.0", "LIMIT(-" + "9" * 280 + ".0"),
        ("40.0)", "9" * 280 + ".0)"),
        ("40.0)", "9" * 12 + ".0)"),
        ("40.0)", "0.0)"),
        ("LIMIT(0.0, x, 40.0)", "LIMIT(40.0, x, 40.00000001)"),
        ("0.00605", "9" * 280 + ".0"),
        ("0.00605", "9" * 60 + ".0"),
    ],
)
def test_numbers_that_no_machine_has_are_refused(old, new):
    """They ended in a TypeError of NumPy, or in warnings."""
    assert old in HAND_ST
    data = HAND_ST.replace(old, new, 1).encode()

    for reader in (PLCStructuredText().decode, PLCStructuredText().lookup):
        with pytest.raises(CorruptFileError, match="any axis"):
            reader(data, NOWHERE)


@pytest.mark.parametrize("seed", range(20))
def test_a_text_of_high_degree_is_read_as_it_computes_whatever_the_processor(seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(-0.045, 0.0)
    fit = PolynomialFit(
        1e-7 * rng.standard_normal(17), None, "given", (start, start + 0.045), "compensation", 0.0
    )

    encoded = encode("plc-st", fit)
    text = encoded.data
    read = DIALECTS["plc-st"]().decode(text, NOWHERE)

    x_mm = 1e3 * np.linspace(*fit.domain, 9)[1:-1]
    exact_um = np.array([evaluate("plc-st", text.decode(), float(x)) for x in x_mm])
    coefficients = [float(c) for c in re.findall(r"\d+\.\d+(?=[)+-])", bare(text)[-2])]
    terms_um = np.abs(coefficients) @ np.abs(x_mm) ** np.arange(17)[:, None]
    in_double_um = (
        2.0**-52 * terms_um + 1e6 * ROUNDING
    )  # a decimal and its place, each rounded once
    assert np.all(np.abs(1e6 * read.correction(1e-3 * x_mm) - exact_um) <= in_double_um)
    x = np.linspace(*fit.domain, 501)
    lost = np.abs(read.correction(x) - fit.correction(x)).max()
    assert lost <= encoded.quantisation * (1.0 + IN_DOUBLE) + OF_THE_ENDS

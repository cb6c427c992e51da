"""Units: factors, refusals, headers."""

import math

import pytest

from metrosep.core.units import (
    column_unit,
    format_ends,
    format_length,
    parse_quantity,
    parse_sensitivity,
    parse_unit,
)
from metrosep.errors import UnitError

ROUNDING = 1e-15


@pytest.mark.parametrize(
    ("text", "dimension", "si"),
    [
        ("1.2 mm", "length", 1.2e-3),
        ("250um", "length", 250e-6),
        ("3 µm", "length", 3e-6),
        ("3 μm", "length", 3e-6),
        ("-4e2 nm", "length", -4e-7),
        ("1 in", "length", 0.0254),
        ("2 uin", "length", 5.08e-8),
        ("7200 mm/min", "speed", 0.12),
        ("1 arcsec", "angle", math.pi / 648000),
        ("1 deg", "angle", math.pi / 180),
        ("2 ms", "time", 2e-3),
        ("10 kHz", "frequency", 1e4),
    ],
)
def test_quantities(text, dimension, si):
    assert parse_quantity(text, dimension=dimension) == pytest.approx(si, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("text", ["1.2", "mm", "", "1,2 mm", "one mm", "1.2 furlong"])
def test_text_without_a_known_unit_is_refused(text):
    with pytest.raises(UnitError):
        parse_quantity(text, dimension="length")


def test_wrong_dimension_names_what_is_needed():
    with pytest.raises(UnitError, match=r"'s' is a time, but a length is needed"):
        parse_quantity("1 s", dimension="length")


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_bare_numbers_must_be_finite(value):
    with pytest.raises(UnitError, match="finite"):
        parse_quantity(value, dimension="length", name="start")


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        ("10^-6 m", 1e-6), ("10-6 m", 1e-6), ("E-6 m", 1e-6), ("1e-3 mm", 1e-6), ("1E-9 m", 1e-9),
        ("10**-3 rad", 1e-3), ("x10^-3 s", 1e-3), ("μm", 1e-6), ("мкм", 1e-6), ("мм", 1e-3),
        ("微米", 1e-6), ("毫米", 1e-3), ("纳米", 1e-9), ("ミリ", 1e-3), ("ナノメートル", 1e-9),
        ("mNm", 1e-3), ("kNm", 1e3), ("″", 0.0254), ("度", math.pi / 180),
        ("Mikrometer", 1e-6), ("Micromètres", 1e-6), ("nanometri", 1e-9), ("micrómetros", 1e-6), ("micras", 1e-6),
        ("Zentimeter", 1e-2), ("厘米", 1e-2), ("センチメートル", 1e-2), ("Grad", math.pi / 180), ("Sekunden", 1.0),
        ("millisecondes", 1e-3), ("分钟", 60.0), ("ミリ秒", 1e-3), ("pulgadas", 0.0254),
    ],
)  # fmt: skip
def test_units_of_other_countries_and_powers_of_ten(text, factor):
    assert parse_unit(text).factor == pytest.approx(factor, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("text", ["grad", "10^-7 m", "E-6 Mm", "106 m", "E99 m", "10 mm"])
def test_a_power_of_ten_that_makes_no_unit_is_refused(text):
    with pytest.raises(UnitError):
        parse_unit(text)


def test_case_tells_metre_from_mega():
    assert parse_unit("mV").factor == 1e-3
    with pytest.raises(UnitError):
        parse_unit("MM/hour")


def test_sensitivity_keeps_its_sign():
    assert parse_sensitivity("-2.5 um/V") == pytest.approx(-2.5e-6, rel=ROUNDING, abs=0.0)
    assert parse_sensitivity("1.66 um/V") == pytest.approx(1.66e-6, rel=ROUNDING, abs=0.0)
    assert parse_sensitivity("2 nm/mV") == pytest.approx(2e-6, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("text", ["2.5 um", "2.5 V/um", "0 um/V", "um/V", "2.5"])
def test_sensitivity_must_be_length_per_voltage(text):
    with pytest.raises(UnitError):
        parse_sensitivity(text)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("x_mm", "x", "mm"),
        ("feed_mm_min", "feed", "mm/min"),
        ("feed_mm_per_min", "feed", "mm/min"),
        ("Height (nm)", "Height", "nm"),
        ("z [µm]", "z", "um"),
        ("probe1", "probe1", None),
        ("X_(microns)", "X", "um"),
        ("y1", "y1", None),
        ("z_min", "z_min", None),
        ("t (min)", "t", "min"),
        ("mm", "mm", None),
    ],
)
def test_headers(header, name, unit):
    found, declared = column_unit(header)

    assert found == name
    assert (declared.name if declared else None) == unit


def test_lengths_print_with_a_readable_prefix():
    assert [format_length(v) for v in (0.0, 3e-10, 2.5e-7, -1e-6, 45e-3, 1.5)] == [
        "0 m",
        "300 pm",
        "250 nm",
        "-1 um",
        "45 mm",
        "1.5 m",
    ]
    assert format_length(None) == "not known"
    assert format_length(math.nan) == "not known"


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (400e-12, 2, "400 pm"),
        (437e-9, 2, "440 nm"),
        (-123e-9, 1, "-100 nm"),
        (999.96e-9, 4, "1000 nm"),
    ],
)
def test_few_digits_of_hundreds_have_no_exponent(value, digits, text):
    assert format_length(value, digits=digits) == text


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("Mm", "megametre, not mm"),
        ("NM", "nautical mile, not nm"),
        ("nM", "nanomolar, not nm"),
        ("MS", "megasiemens, not ms"),
        ("mS", "millisiemens, not ms"),
        ("S", "siemens, not s"),
        ("MV", "megavolt, not mV"),
        ("Pm", "petametre, not pm"),
        ("mHz", "millihertz, not MHz"),
    ],
)
def test_a_symbol_with_other_capitals_is_another_unit(text, means):
    """SI Brochure, 9th edition, 5.2: symbols are case-sensitive."""
    with pytest.raises(UnitError, match=means):
        parse_unit(text)
    assert column_unit(f"z_{text}") == (f"z_{text}", None)
    assert column_unit(f"z [{text}]") == (f"z [{text}]", None)


@pytest.mark.parametrize("text", ["Nm", "N m", "N·m", "N*m", "N.m"])
def test_newton_metre_is_a_torque_and_no_length(text):
    assert parse_unit(text)[1:] == ("torque", 1.0)
    with pytest.raises(UnitError, match="is a torque, but a length is needed"):
        parse_quantity(f"3 {text}", dimension="length")


@pytest.mark.parametrize(
    ("text", "name"),
    [("Micron", "um"), ("INCH", "in"), ("Deg", "deg"), ("SEC", "s"), ("MM", "mm")],
)
def test_words_in_any_case_and_the_capitals_of_machines(text, name):
    assert parse_unit(text).name == name


@pytest.mark.parametrize(
    "text",
    ["rpm", "RPM", "1/min", "U/min", "r/min", "rev/min", "min-1", "min^-1", "tr/min", "转/分"],
)
def test_turns_per_minute_are_a_frequency(text):
    assert parse_quantity(f"1200 {text}", dimension="frequency") == pytest.approx(
        20.0, rel=1e-15, abs=0.0
    )
    assert column_unit(f"n [{text}]")[1].dimension == "frequency"


def test_turns_per_minute_are_no_time_and_no_feed():
    with pytest.raises(UnitError, match="is a frequency"):
        parse_unit("1/min", dimension="time")
    with pytest.raises(UnitError, match="is a frequency"):
        parse_unit("rpm", dimension="speed")


@pytest.mark.parametrize(
    ("text", "point"), [("1,5 mm", "1.5 mm"), ("-0,35 um", "-0.35 um"), ("2,5", "2.5")]
)
def test_a_decimal_comma_is_named(text, point):
    with pytest.raises(UnitError, match=f"decimal comma; write a point, such as '{point}'"):
        parse_quantity(text, dimension="length", name="dx")


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (0.0, 50e-3, "0 ... 50 mm"),
        (-80.07e-9, 95.6e-9, "-80.07 ... 95.6 nm"),
        (10e-3, 0.0, "10 ... 0 mm"),
        (-3e-3, 1.2, "-0.003 ... 1.2 m"),
        (0.0, 0.0, "0 ... 0 m"),
        (2e-9, 0.8, "2 nm ... 800 mm"),  # in one unit the lower end would be unreadable
    ],
)
def test_both_ends_of_a_range_have_one_unit(low, high, text):
    assert format_ends(low, high) == text

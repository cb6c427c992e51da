"""Numbers with units and verdicts, as printed."""

import pytest

from metrosep.core.errors import DataError
from metrosep.report.text import decimals_for, length, number, readable_unit, span, stamp


def test_micro_and_minus_are_typeset():
    assert length(-1.25e-6) == "−1.25 µm"


def test_an_unknown_length_says_so():
    assert length(None) == "not known"


def test_both_ends_of_a_span_have_one_unit():
    assert span(-5.615e-3, 50.615e-3) == "−5.615 mm … 50.615 mm"


@pytest.mark.parametrize(
    ("value", "unit", "name", "factor"),
    [
        (2.7e-7, "m", "nm", 1e-9),
        (-1.5e-6, "m", "µm", 1e-6),
        (1.3e-6, "rad", "µrad", 1e-6),
        (2e-3, "rad", "mrad", 1e-3),
        (2e-4, "s", "µs", 1e-6),
        (0.0, "m", "m", 1.0),
        (3.0, "1", "1", 1.0),
    ],
)
def test_the_unit_fits_the_largest_value(value, unit, name, factor):
    assert readable_unit([value, None, value / 10.0], unit) == (name, factor)


@pytest.mark.parametrize(
    ("u", "largest", "decimals"),
    [(0.0046, 0.97, 4), (22.0, 271.0, 0), (1.5, 10.0, 1), (None, 2.0, 3), (None, 0.0, 0)],
)
def test_the_uncertainty_is_printed_with_two_digits(u, largest, decimals):
    assert decimals_for(u, largest) == decimals


def test_a_missing_number_is_a_dash():
    assert number(None, 1.0, 2) == "–"


def test_every_verdict_differs_without_colour():
    stamps = [stamp(v) for v in ("accept", "reject", "inconclusive", None)]

    assert len({s.word for s in stamps}) == 4
    assert len({s.symbol for s in stamps}) == 4


def test_white_letters_are_legible_on_every_stamp():
    def linear(c):
        return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4

    for verdict in ("accept", "reject", "inconclusive", None):
        colour = stamp(verdict).colour
        red, green, blue = (linear(int(colour[i : i + 2], 16) / 255) for i in (1, 3, 5))
        contrast = 1.05 / (0.2126 * red + 0.7152 * green + 0.0722 * blue + 0.05)
        assert contrast >= 4.5  # WCAG 2.1, level AA


def test_an_unknown_verdict_is_refused():
    with pytest.raises(DataError, match="expected 'accept'"):
        stamp("ok")


@pytest.mark.parametrize(
    ("value", "factor", "decimals", "wanted"),
    [
        (-1e-12, 1e-9, 1, "0.0"),
        (-1e-24, 1.0, 0, "0"),
        (-0.0, 1.0, 2, "0.00"),
        (-6e-11, 1e-9, 1, "\u22120.1"),
        (-1e-24, 1.0, 12, "\u22121.00e\u221224"),
    ],
)
def test_zero_has_no_minus(value, factor, decimals, wanted):
    assert number(value, factor, decimals) == wanted

"""Facts of a machine: checked, converted, asked for by name."""

import pytest

from metrosep.controllers.options import Option, checked_limits, checked_options, split_machine
from metrosep.errors import DataError

COUNT = Option("count", "length of one count", "length", required=True, positive=True)
MOTOR = Option("motor", "number of the motor", "integer", default=1, lowest=1, highest=32)
SIGN = Option("encoder", "sign of the encoder", "choice", choices=(1, -1))
DESIRED = Option("desired", "use the desired position", "flag", default=True)
NAME = Option("name", "name of the axis", "text", default="X")
KNOWN = (COUNT, MOTOR, SIGN, DESIRED, NAME)


def test_texts_and_numbers_mean_the_same():
    typed = checked_options({"count": "10 nm", "motor": "2", "encoder": "-1"}, KNOWN, "pmac")
    coded = checked_options({"count": 1e-8, "motor": 2, "encoder": -1}, KNOWN, "pmac")

    assert typed == coded
    assert typed == {"count": 1e-8, "motor": 2, "encoder": -1, "desired": True, "name": "X"}


@pytest.mark.parametrize(("word", "sign"), [("+", 1), ("-", -1), ("+1", 1), (" -1 ", -1)])
def test_a_sign_can_be_typed(word, sign):
    assert SIGN.checked(word, "x") == sign


def test_a_missing_fact_is_asked_for_by_name():
    with pytest.raises(
        DataError,
        match=r"pmac cannot be written without count= \(length of one count\)$",
    ):
        checked_options({}, KNOWN, "pmac")
    assert checked_options({}, KNOWN, "pmac", partial=True) == {}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": "10"}, "count"),
        ({"count": "10 s"}, "'s' is a time"),
        ({"count": 0.0}, "above zero"),
        ({"count": -1e-8}, "above zero"),
        ({"count": float("nan")}, "finite number"),
        ({"count": True}, "count must be a number in m"),
        ({"count": [1e-8]}, "count must be a number in m"),
        ({"count": 1e-8, "motor": 1.5}, "whole number"),
        ({"count": 1e-8, "motor": "two"}, "whole number"),
        ({"count": 1e-8, "motor": True}, "whole number"),
        ({"count": 1e-8, "motor": 33}, r"must lie in 1 \.\.\. 32"),
        ({"count": 1e-8, "motor": float("inf")}, "whole number"),
        ({"count": 1e-8, "encoder": 0}, "one of 1, -1"),
        ({"count": 1e-8, "encoder": True}, "one of 1, -1"),
        ({"count": 1e-8, "desired": "maybe"}, "true or false"),
        ({"count": 1e-8, "name": ""}, "printable text"),
        ({"count": 1e-8, "name": "X\nDELETE"}, "printable text"),
        ({"count": 1e-8, "counts": 3}, "unknown machine limit 'counts'"),
    ],
)
def test_a_wrong_value_is_refused(given, message):
    with pytest.raises(DataError, match=message):
        checked_options(given, KNOWN, "pmac")


def test_options_and_limits_are_told_apart():
    options, limits = split_machine({"count": 1e-8, "stroke": 5e-6}, KNOWN, "pmac")

    assert options == {"count": 1e-8}
    assert limits == {"stroke": 5e-6}


def test_limits_take_texts():
    found = checked_limits({"stroke": "5 um", "feed": "60 mm/min", "max_points": "7"}, "pmac")

    assert found["stroke"] == pytest.approx(5e-6, abs=1e-18)
    assert found["feed"] == pytest.approx(1e-3, abs=1e-15)
    assert found["max_points"] == 7
    with pytest.raises(DataError, match="stroke"):
        checked_limits({"stroke": "5 s"}, "pmac")

"""The order of names with numbers in them."""

from __future__ import annotations

from metrosep.core._arrays import by_number


def test_numbers_count_by_their_value():
    names = ["run10.csv", "run9.csv", "run.csv", "run9b.csv", "10.csv", "9.csv", "a2b10", "a2b9"]
    assert sorted(names, key=by_number) == [
        "9.csv", "10.csv", "a2b9", "a2b10", "run9.csv", "run9b.csv", "run10.csv", "run.csv",
    ]  # fmt: skip


def test_digits_that_are_no_decimal_number_are_text():
    assert by_number("x²") == [(0, 0, "x²")]

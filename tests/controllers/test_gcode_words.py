"""Tokens of a block: every byte is kept, and what is not a word is named."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from metrosep.controllers.gcode.state import (
    decimals_of,
    format_number,
    shape_of,
    tokenize,
)
from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError

WORDS = st.builds(
    lambda letter, gap, sign, number: letter + gap + sign + number,
    st.sampled_from("GMXYZCFNSTxyzc"),
    st.sampled_from(["", " ", "\t"]),
    st.sampled_from(["", "+", "-"]),
    st.sampled_from(["0", "1.5", ".25", "12.", "00071", "3.1415926535"]),
)
OTHER = st.sampled_from([" ", "\t", "(to X5 and back)", "()", "%", "/", "\r\n"])


@given(st.lists(WORDS | OTHER, max_size=12), st.sampled_from(["", "; end X5", "\n"]))
def test_texts_joined_are_the_block(pieces, end):
    block = "".join(pieces) + end

    tokens = tokenize(block)

    assert "".join(t.text for t in tokens) == block
    assert [t.start for t in tokens] == [
        sum(len(u.text) for u in tokens[:i]) for i in range(len(tokens))
    ]


def test_words_have_letter_and_number_as_written():
    words = [t for t in tokenize("n10 g01 x-1.50 Z +.25(X9)") if t.kind == "word"]

    assert [(w.letter, w.number) for w in words] == [
        ("N", "10"),
        ("G", "01"),
        ("X", "-1.50"),
        ("Z", "+.25"),
    ]


@pytest.mark.parametrize(
    ("block", "part"),
    [
        ("X#1", "#"),
        ("#1=5", "#1"),
        ("X[1+2]", r"\["),
        ("IF [1 EQ 1] GOTO 5", "IF"),
        ("WHILE", "WHILE"),
        ("GOTO 5", "GOTO"),
        ("X=R1", "=R1"),
        ("X1e-3", "exponent"),
        ("X1,5", "decimal point"),
    ],
)
def test_computed_positions_are_refused_with_line_and_way_out(block, part):
    with pytest.raises(UnsupportedFeatureError, match=rf"line 7: .*{part}.*; "):
        tokenize(block, 7)


@pytest.mark.parametrize("block", ["X1 2", "(open", "X", "G1 X1 ?", "\xe4 X1"])
def test_what_is_no_word_is_refused(block):
    with pytest.raises(CorruptFileError, match="line 7"):
        tokenize(block, 7)


def test_shape_has_no_digits():
    assert shape_of("N10 X-1.5Z+.2\n") == "N XZ\n"
    assert shape_of("N11 X1.25Z7\n") == "N XZ\n"


def test_numbers_have_a_point_and_no_minus_zero():
    assert format_number(-1e-9, 6) == "0.000000"
    assert format_number(-1.2345678, 6) == "-1.234568"
    assert format_number(1e6, 7) == "1000000.0000000"
    assert decimals_of("12") == 0
    assert decimals_of("-12.") == 0
    assert decimals_of("-.120") == 3

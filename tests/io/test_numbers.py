"""Numbers in text, all at once: the same bits as Python's own float, and the same refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metrosep.core.errors import CorruptFileError
from metrosep.io.source import open_file
from metrosep.io.text.numbers import parse_decimals, parse_numbers


def floats(n: int = 60_000) -> np.ndarray:
    """Floats of random bits from 1e-39 to 1e39, of both signs."""
    chance = np.random.default_rng(20261122)
    some = chance.integers(0, 2**63, size=40 * n).view(np.float64)
    some = some[(some > 1e-39) & (some < 1e39)][: n // 4]
    heights = 1e-8 * chance.standard_normal(n - some.size)
    return np.concatenate([some, heights]) * chance.choice([-1.0, 1.0], n)


def same_bits(found: np.ndarray | None, texts: list[str]) -> bool:
    assert found is not None
    wanted = np.array([float(t) for t in texts])
    missing = np.isnan(wanted)
    return np.array_equal(np.isnan(found), missing) and np.array_equal(
        found[~missing].view(np.int64), wanted[~missing].view(np.int64)
    )


@pytest.mark.parametrize("form", ["%.16e", "%.15e", "%.8e", "%.1e"])
def test_every_number_of_a_shape_has_the_bits_of_float(form):
    texts = [form % v for v in floats()]
    assert same_bits(parse_decimals(" ".join(texts).encode()), texts)


def test_shortest_texts_of_heights_come_back_to_the_bit():
    heights = 1e-8 * np.random.default_rng(1).standard_normal(50_000)
    texts = [repr(v) for v in heights.tolist()]
    found = parse_decimals(("\r\n\t ".join(texts) + "\n").encode())
    assert same_bits(found, texts)
    assert np.array_equal(found, heights)


def test_halves_of_a_unit_in_the_last_place_are_rounded_to_even():
    """Whole numbers beyond 2^53 lie on or beside ties; there the sum of two floats cannot tell."""
    whole = 2**53 + np.arange(20_000)
    texts = [f"{v // 10**15}.{v % 10**15:015d}e+15" for v in whole.tolist()]
    found = parse_decimals((" 1.5e+00" * 8 + " ").join(texts).encode())  # not too many at once
    assert found is not None
    assert same_bits(found[::9], texts)


def test_zeros_signs_and_other_shapes_among_them():
    odd = [
        "0.0",
        "-0.0",
        "+1.5e+01",
        "-0.000e+00",
        "7",
        "1e-3",
        ".5",
        "12.5e-03",
        "1.25E-7",
        "nan",
    ]
    texts = [*odd, *["1.25e-08"] * 200]
    found = parse_decimals(" ".join(texts).encode())
    assert same_bits(found, texts)
    assert np.signbit(found[[1, 3]]).all()


def test_a_third_not_measured_is_read_all_at_once():
    texts = ["nan" if i % 3 == 0 else f"{1e-9 * (i + 1):.16e}" for i in range(30_000)]
    assert same_bits(parse_decimals("\n".join(texts).encode()), texts)


@pytest.mark.parametrize(
    "bad",
    ["1.2e-0x", "1.2e--05", "1..2e-05", "1.2ee-05", "a.2e-05", "1.2e-05\x01", "-.e-05", "0x1p-3",
     "1_0.0e+00", "inf", "1.2e-05e-05", "\N{ARABIC-INDIC DIGIT ONE}.2e-05", "--1.2e-05"],
)  # fmt: skip
def test_what_is_no_number_is_left_to_the_slow_way(bad):
    """None: the caller's other way names the offset, or knows the word."""
    texts = ["1.25e-08"] * 500 + [bad] + ["1.25e-08"] * 500
    assert parse_decimals(" ".join(texts).encode()) is None


def test_empty_text_holds_no_numbers():
    assert parse_decimals(b"").size == 0
    assert parse_decimals(b" \r\n").size == 0


def test_a_damaged_long_text_is_refused_with_its_offset(tmp_path: Path):
    texts = ["1.2345678901234567e-08"] * 2000
    before = len(" ".join(texts[:1000])) + 1
    text = " ".join([*texts[:1000], "1.23x-08", *texts]).encode()
    target = tmp_path / "map.txt"
    target.write_bytes(text)
    with pytest.raises(CorruptFileError, match=rf"(?s){before + 7}.*1\.23x-08"):
        parse_numbers(open_file(target), text, offset=7)


def test_words_for_not_measured_are_nan_in_a_long_text(tmp_path: Path):
    texts = ["1.2345678901234567e-08", "BAD"] * 2000
    target = tmp_path / "map.txt"
    target.write_bytes(b" ")
    found = parse_numbers(open_file(target), " ".join(texts).encode(), missing=(b"BAD", b"bad"))
    assert np.isnan(found[1::2]).all()
    assert (found[::2] == 1.2345678901234567e-08).all()


def test_a_text_of_many_pieces_is_cut_between_its_numbers():
    texts = [repr(v) for v in (1e-9 * np.random.default_rng(2).standard_normal(100_000)).tolist()]
    text = " ".join(texts).encode()
    assert len(text) > 5 * (1 << 18)
    assert same_bits(parse_decimals(text), texts)

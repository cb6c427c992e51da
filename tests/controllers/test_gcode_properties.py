"""What holds for every path: nothing but Z moves, and it moves by c to half of the last digit."""

from __future__ import annotations

import math
import re
import tempfile
from pathlib import Path

import numpy as np
from controllers.program_marks import unmarked
from hypothesis import given, settings, strategies as st

from metrosep.controllers.gcode.paths import rewrite_path

HALF = 0.5e-6 * (1 + 1e-6)
"""Half of the last digit with 6 digits, mm; the share is binary rounding."""

NUMBERS = st.integers(-9_999_999, 9_999_999).map(lambda i: i / 1e5)
WORDS = st.lists(st.sampled_from("XCZ"), min_size=1, max_size=3, unique=True)
GAPS = st.sampled_from(["", " ", "\t"])


@st.composite
def blocks(draw):
    """A block: axis words in any order, case and spacing, with other words around them."""
    gap = draw(GAPS)
    words = [f"{letter}{draw(NUMBERS):.5f}" for letter in draw(WORDS)]
    before = draw(st.sampled_from(["", "N7", "G1", "N3 G01", "G0"]))
    after = draw(st.sampled_from(["", "F100.", "(X1 Z2)", "; Z3"]))
    text = gap.join([*([before] if before else []), *words, *([after] if after else [])])
    return text.lower() if draw(st.booleans()) else text


OTHER = st.sampled_from(["", "(comment Z5)", "M8", "G4 P0.1", "F20.5", "S100", "N5"])
PROGRAMS = st.lists(blocks() | OTHER, min_size=1, max_size=12).map(
    lambda lines: "\n".join(["G21 G90", "G0 X1.00000 C2.00000 Z3.00000", "G93 F5", *lines]) + "\n"
)
AMOUNTS = st.tuples(st.floats(-4e-5, 4e-5), st.floats(-4e-5, 4e-5), st.floats(0.0, 7.0))


def wave(amounts):
    a, b, phase = amounts
    return lambda x, c: a * np.cos(c + phase) + b * np.sin(x / 7e-3)


def rewritten(program: str, correction, **options) -> str:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "in.nc"
        source.write_text(program)
        rewrite_path(source, Path(folder) / "out.nc", correction, **options)
        return unmarked((Path(folder) / "out.nc").read_text())


def positions(text: str) -> np.ndarray:
    at = {"X": math.nan, "C": math.nan, "Z": math.nan}
    found = []
    for line in text.splitlines():
        for letter, number in re.findall(
            r"([XCZ])([-+.\d]+)", re.sub(r"\(.*?\)|;.*", "", line).upper()
        ):
            at[letter] = float(number)
        found.append([at["X"], at["C"], at["Z"]])
    return np.array(found)


def without_z(text: str) -> str:
    """The program without Z words and the white space before them."""
    return "\n".join(
        re.sub(r"(?i)[ \t]*z[-+.\d]+(?=[^()]*(\(|;|$))", "", line)
        if "(comment" not in line
        else line
        for line in text.splitlines()
    )


@settings(max_examples=150, deadline=None)
@given(PROGRAMS)
def test_no_correction_changes_no_byte(program):
    assert rewritten(program, lambda x, c: 0.0 * x) == program


@settings(max_examples=150, deadline=None)
@given(PROGRAMS, AMOUNTS)
def test_z_moves_by_the_correction_and_nothing_else_does(program, amounts):
    text = rewritten(program, wave(amounts))

    before, after = positions(program)[1:], positions(text)[1:]
    wanted = 1e3 * wave(amounts)(before[:, 0] * 1e-3, np.deg2rad(before[:, 1]))
    assert np.array_equal(before[:, :2], after[:, :2])
    assert np.abs(after[:, 2] - before[:, 2] - wanted).max() <= HALF + 1e-11
    assert without_z(text) == without_z(program)


@settings(max_examples=25, deadline=None)
@given(PROGRAMS, AMOUNTS, AMOUNTS)
def test_corrections_add_up(program, first, second):
    both = lambda x, c: wave(first)(x, c) + wave(second)(x, c)  # noqa: E731

    # four amounts of 40 um may add up to more than the usual stroke of 100 um
    once = positions(rewritten(program, both, stroke=1e-3))[1:, 2]
    twice = positions(rewritten(rewritten(program, wave(first)), wave(second)))[1:, 2]

    assert np.abs(once - twice).max() <= 3 * HALF + 1e-11


@settings(max_examples=25, deadline=None)
@given(PROGRAMS, AMOUNTS)
def test_splitting_keeps_the_ends_and_the_line_between_them(program, amounts):
    program = program.replace("G93", "G94")
    plain = positions(rewritten(program, wave(amounts)))[1:]
    split = positions(rewritten(program, wave(amounts), tolerance=1e-6))

    kept = [row.tolist() for row in split]
    at = 0
    for row in plain.tolist():  # every point of the unsplit path is met, in order
        while not np.abs(np.subtract(kept[at], row)).max() <= 2 * HALF:
            at += 1
    assert at <= len(kept)

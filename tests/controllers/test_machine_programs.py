"""Programs in words of all axes: bodies moved about lines in space cut what a plain reader finds in them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from metrosep.controllers.gcode.machine_programs import is_program, rewrite_machine_program
from metrosep.core.errors import (
    DataError,
    LimitError,
    ReadError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.machine import TableTerm, presets

NM = 1e-9
H = 0.08  # m: table above the axis of A
TOOL = (0.01, -0.005, -0.12)
ZERO = {"X": 0.02, "Z": 0.15, "C": np.radians(10.0)}
LINES = {"Y0A": 11e-6, "Z0A": -6e-6, "B0A": 20e-6, "C0A": -15e-6, "X0C": 9e-6, "A0C": -13e-6}
CURVES = {
    "EXX": lambda x: 20e-6 * np.sin(9 * x),
    "EBX": lambda x: 30e-6 * x**2,
    "EZC": lambda c: 6e-6 * np.sin(2 * c),
    "EAC": lambda c: 9e-6 * np.cos(c),
}
PROGRAM = """%
O7
(a pocket)
G21 G90 G94
N5 G0 A-30. C20.
N6 G0 X10. Y20. Z5. S8000 M3
N1 G1 X52.5 F800
N2 G1 Y-15. A-42. (both)
N3 Z5.5 C95.125
N4 X10. Y0. Z8. A-25. C60.
N9 G0 Z90.
M5
M30
%
"""


def turn(axis, angle):
    k = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def actual(q, *, errors):
    """Return the tool point on the table and its axis: A turns about a line, C about a line on it."""
    n = LINES if errors else dict.fromkeys(LINES, 0.0)
    at = {k: f(q[k[2]]) if errors else 0.0 for k, f in CURVES.items()}
    # the table: each body turns about its own line, wherever that is
    a_at, a_along = np.array([0, n["Y0A"], n["Z0A"]]), np.array([1.0, n["C0A"], -n["B0A"]])
    c_at, c_along = np.array([n["X0C"], 0, 0]), np.array([0.0, -n["A0C"], 1.0])
    # errors of C are those of the tool against the table: the table goes the other way
    dz, wa = -at["EZC"], -at["EAC"]
    R_c = turn((1, 0, 0), wa) @ turn(c_along, -q["C"]) @ turn((1, 0, 0), n["A0C"])
    p_c = c_at + np.array([0, 0, dz])
    R_a = turn(a_along, -q["A"]) @ turn((0, 1, 0), n["B0A"]) @ turn((0, 0, 1), n["C0A"])
    p_a = a_at + np.array([0, -q["Y"], 0])
    R_t = turn((0, 1, 0), at["EBX"])
    tool = np.array([q["X"] + at["EXX"], 0, 0]) + R_t @ (np.array([0, 0, q["Z"]]) + TOOL)
    on_a = R_a.T @ (tool - p_a) - np.array([0, 0, H])
    return R_c.T @ (on_a - p_c), R_c.T @ (R_a.T @ (R_t @ (0, 0, 1)))


def read(text):
    """Return the words in force after each block with an axis word, and whether it is a feed move."""
    held, mode, found = {}, 0, []
    for line in text.splitlines():
        words = re.findall(r"([A-Z])([-+]?[0-9.]+)", re.sub(r"\([^)]*\)", "", line.upper()))
        for letter, number in words:
            if letter == "G" and float(number) < 2:
                mode = int(float(number))
            if letter in "XYZAC":
                held[letter] = float(number)
        if any(letter in "XYZAC" for letter, _ in words):
            found.append((mode == 1, dict(held)))
    return found


def machine(words):
    si = {k: np.radians(v) if k in "AC" else v * 1e-3 for k, v in words.items()}
    return {k: v + ZERO.get(k, 0.0) for k, v in si.items()}


def missed(original, corrected, parts):
    """Return distances in m, and angles in rad, between what is cut and the nominal way."""
    nominal, done = read(original), read(corrected)
    off, away, at = [], [], 0
    for k, (is_feed, words) in enumerate(nominal):
        n = parts[k]
        before, at = done[at - 1][1] if at else None, at + n
        if not is_feed or before is None:
            continue
        for i in range(n):
            begin, end = before if i == 0 else done[at - n + i - 1][1], done[at - n + i][1]
            for share in (0.0, 0.17, 0.5, 0.83, 1.0):
                command = {a: begin[a] + (end[a] - begin[a]) * share for a in "XYZAC"}
                whole = (i + share) / n
                past = nominal[k - 1][1]
                wanted = {a: past[a] + (words[a] - past[a]) * whole for a in "XYZAC"}
                p, d = actual(machine(command), errors=True)
                p0, d0 = actual(machine(wanted), errors=False)
                off.append(np.linalg.norm(p - p0))
                away.append(np.linalg.norm(d - d0))
    return np.array(off), np.array(away)


def corrected(folder, text=PROGRAM, errors=None, **options):
    source, target = folder / "in.nc", folder / "out.nc"
    source.write_text(text, newline="")
    chain = presets("five_axis", pivot_height=H)
    given = {"tool": TOOL, "zero": ZERO, **options}
    found = rewrite_machine_program(
        source, target, chain, {**LINES, **CURVES} if errors is None else errors, **given
    )
    return found, target.read_bytes().decode()


def test_the_tool_goes_where_the_program_says_at_each_block_and_between(tmp_path):
    n = len(read(PROGRAM))
    before, turned = missed(PROGRAM, PROGRAM, [1] * n)
    found, text = corrected(tmp_path, tolerance=20 * NM)
    # blocks of the original have numbers, added ones have none
    moves = [v for v in text.splitlines() if re.match(r"(N\d+ .*)?[XYZAC][-\d]", v)]
    starts = [i for i, v in enumerate(moves) if v[0] == "N"]
    parts = np.diff([*starts, len(moves)]).tolist()
    assert len(parts) == n
    assert len(moves) == n + found.audit["n_added"] > n + 4
    off, away = missed(PROGRAM, text, parts)
    assert np.sqrt(np.mean(before**2)) > 15e-6
    assert off.max() < 21 * NM  # looks at 16 places of a part see 0.98 of a parabola
    assert np.sqrt(np.mean(away**2)) < 0.02 * np.sqrt(np.mean(turned**2))
    assert found.audit["chord_error_m"] <= 20 * NM


def test_without_a_tolerance_blocks_are_right_at_their_ends(tmp_path):
    found, text = corrected(tmp_path)
    assert found.audit["n_added"] == 0
    assert len(text.splitlines()) == len(PROGRAM.splitlines()) + 1  # the mark
    for (_, words), (_, nominal) in zip(read(text)[1:], read(PROGRAM)[1:], strict=True):
        p, d = actual(machine(words), errors=True)
        p0, d0 = actual(machine(nominal), errors=False)
        assert np.linalg.norm(p - p0) < 3 * NM  # 1 nm in X, Y, Z and 1 nrad at 0.2 m as written
        assert np.linalg.norm(d - d0) < 5e-9
    assert "misses its nominal way by up to" in " ".join(found.messages)
    for line in ("(a pocket)", "M30", "O7"):
        assert line in text.splitlines()


def minus(f):
    return lambda x: -f(x)


def test_a_wrong_sense_of_the_errors_makes_it_worse(tmp_path):
    turned = {k: -v for k, v in LINES.items()} | {k: minus(f) for k, f in CURVES.items()}
    _, text = corrected(tmp_path, errors=turned)
    n = len(read(PROGRAM))
    before, _ = missed(PROGRAM, PROGRAM, [1] * n)
    off, _ = missed(PROGRAM, text, [1] * n)
    assert off.mean() > 1.8 * before.mean()


def test_parts_of_a_block_in_inverse_time_take_as_long_as_the_block(tmp_path):
    text = "G21 G90 G93\nG0 X0. Y0. Z0. A-30. C0.\nG1 X80. C90. F2.5\n"
    found, out = corrected(tmp_path, text, tolerance=50 * NM)
    n = found.audit["n_added"] + 1
    feeds = [float(f) for f in re.findall(r"F([\d.]+)", out)]
    assert n > 2
    assert len(feeds) == n
    assert sum(1.0 / f for f in feeds) == pytest.approx(1.0 / 2.5, abs=1e-6)


def test_a_program_in_inch_with_lower_case_and_windows_line_ends(tmp_path):
    text = "g20 g90\r\ng0x1.y0.z.5a-30.c0.\r\ng1x2.5f30.\r\n"
    _, out = corrected(tmp_path, text)
    assert out.count("\r\n") == 4
    last = out.splitlines()[-1]
    assert re.fullmatch(r"g1(?=x[\d.]+y)([a-z][-\d.]+)+f30\.", last)  # inserted, no blanks
    words = read(out)[-1][1]
    q = {k: np.radians(v) if k in "AC" else v * 25.4e-3 for k, v in words.items()}
    wanted = {"X": 2.5 * 25.4e-3, "Y": 0.0, "Z": 0.5 * 25.4e-3, "A": np.radians(-30), "C": 0.0}
    p, _ = actual({k: v + ZERO.get(k, 0.0) for k, v in q.items()}, errors=True)
    p0, _ = actual({k: v + ZERO.get(k, 0.0) for k, v in wanted.items()}, errors=False)
    assert np.linalg.norm(p - p0) < 3 * NM


HEAD = "G21 G90\nG0 X0. Y0. Z0. A-30. C0.\n"


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        (HEAD + "G2 X10. I5. J0.\n", UnsupportedFeatureError, "line 3: G2: an arc"),
        (HEAD + "G43.5 H1\n", UnsupportedFeatureError, "I, J, K a direction of the tool"),
        (HEAD + "G43.4 H1\nG1 X5. F9.\n", UnsupportedFeatureError, "no Y word was given so far"),
        (HEAD + "G68.2 X0 Y0\n", UnsupportedFeatureError, "the plane is tilted"),
        (HEAD + "G1 B10.\n", UnsupportedFeatureError, "the axes of the machine are X, Y, Z, A, C"),
        (HEAD + "G91 G1 X1.\n", UnsupportedFeatureError, "incremental"),
        (HEAD + "G1 X1. X2.\n", UnsupportedFeatureError, "twice in one block"),
        ("G21 G90\nG1 X1. Y0. Z0.\n", UnsupportedFeatureError, "no A word was given so far"),
        ("G90 G0 X0 Y0 Z0 A0 C0\n", UnsupportedFeatureError, "neither G20"),
        (HEAD + "G1 X50. C200. F500\n", UnsupportedFeatureError, "turns an axis by 200 deg"),
        (HEAD + "G1 X50. C90. M8\n", UnsupportedFeatureError, "before its end"),
        ("G21 G90\nM3\n", DataError, "holds no move"),
    ],
)  # fmt: skip
def test_a_program_whose_text_does_not_say_where_the_axes_stand_is_refused(
    tmp_path, text, error, said
):
    with pytest.raises(error, match=re.escape(said)):
        corrected(tmp_path, text, tolerance=20 * NM)
    assert not (tmp_path / "out.nc").exists()


def test_limits_marks_and_files_in_the_way(tmp_path):
    with pytest.raises(LimitError, match="line 8: the correction of Y is"):
        corrected(tmp_path, stroke=5e-6)
    with pytest.raises(LimitError, match=r"deg, the limit is 0\.573 deg"):
        corrected(tmp_path, errors={"EAA": 0.02}, stroke=1.0)
    with pytest.raises(DataError, match="zero names 'B'"):
        corrected(tmp_path, zero={"B": 1.0})
    corrected(tmp_path)
    with pytest.raises(DataError, match="holds a correction already"):
        rewrite_machine_program(
            tmp_path / "out.nc", tmp_path / "twice.nc", presets("five_axis", pivot_height=H), LINES
        )
    (tmp_path / "out.nc").write_text("mine")
    with pytest.raises(WriteError, match="exists"):
        corrected(tmp_path)
    with pytest.raises(DataError, match="FTS of the machine has no letter"):
        rewrite_machine_program(
            tmp_path / "in.nc", tmp_path / "f.nc", presets("fts_lathe", radius=0.02), {"EXX": 1e-6}
        )


def test_a_program_and_a_list_are_told_apart_by_their_first_line(tmp_path):
    for name, text, wanted in (
        ("a", PROGRAM, True), ("b", ";made\nN1 G0 X1\n", True), ("c", "# x\nX_mm,Y_mm\n1,2\n", False),
        ("d", "1,2,3\n", False), ("e", "", False), ("f", "X;Y;Z\n1;2;3\n", False),
    ):  # fmt: skip
        (tmp_path / name).write_text(text)
        assert is_program(tmp_path / name) is wanted, name


@pytest.mark.parametrize("phase", [4.66, 5.0, 0.18, 3.61])
def test_a_wave_in_step_with_the_looks_is_seen(tmp_path, phase):
    """0.1 um of 0.5 mm over 64 mm: the way that was written, by its own text, keeps 50 nm."""
    x = np.arange(64 * 40 + 1) / 40e3
    wave = TableTerm(x, 1e-7 * np.sin(2 * np.pi * x / 0.5e-3 + phase))
    source = tmp_path / "in.nc"
    source.write_text("G21 G90\nG0 X0 Y0 Z0\nG1 X64 F500\n")
    found = rewrite_machine_program(
        source, tmp_path / "out.nc", presets("mill_xyz"), {"EYX": wave}, tolerance=50 * NM
    )
    way = [v for _, v in read(found.target.read_text()) if "Y" in v]
    dense = np.linspace(0.0, 64.0, 200_001)
    y = np.interp(dense, [v["X"] for v in way], [v["Y"] for v in way]) * 1e-3
    off = np.abs(y + wave.evaluate(dense * 1e-3))
    assert off.max() < 52 * NM
    assert found.audit["chord_error_m"] == pytest.approx(off.max(), abs=2 * NM)


def test_the_tolerance_is_that_of_the_digits_which_are_written(tmp_path):
    text = "G21 G90\nG0 X0 Y0 Z0 A0 C0\nG1 X10 Y7 C20 F100\n"
    with pytest.raises(LimitError, match="resolution"):
        corrected(tmp_path, text, tolerance=10 * NM, resolution=1e-6)


TURN = "G21 G90\nG0 X0 Y0 Z0 A0 C0\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (TURN + "G1 C90 F360\n", "line 3: a feed move of axes of rotation alone"),
        (TURN + "G93 G1 X5 C9\n", "line 3: a feed move: in inverse time"),
        (TURN + "G7\nX5\n", "changes between radius and diameter"),
        ("G91 G28 Z0\n" + TURN.replace("G90", ""), "a move in G91"),
        ("G91 X1\n" + TURN, "incremental words"),
    ],
)
def test_a_feed_or_a_word_of_another_meaning_is_refused(tmp_path, text, said):
    with pytest.raises(UnsupportedFeatureError, match=said):
        corrected(tmp_path, text)


def test_home_before_the_first_position_may_be_incremental(tmp_path):
    found, text = corrected(tmp_path, "G91 G28 Z0\n" + TURN + "G1 X5 F100\n")
    assert text.splitlines()[1] == "G91 G28 Z0"
    assert found.n_points == 2


def test_a_turn_in_inverse_time_is_corrected(tmp_path):
    assert corrected(tmp_path, TURN + "G93 G1 C90 F2\n")[0].n_changed == 2


@pytest.mark.parametrize("odd", ["\x85", "\x0b", "\x1c"])
def test_a_comment_with_a_character_that_ends_no_line(tmp_path, odd):
    source = tmp_path / "in.nc"
    text = f"G21 G90\n(a{odd}b)\nG0 X0 Y0 Z0 A0 C0\nG1 X10 C90 F100\n"
    source.write_bytes(text.encode("latin-1"))
    found = rewrite_machine_program(
        source, tmp_path / "out.nc", presets("five_axis", pivot_height=H), CURVES, tolerance=1e-6
    )
    assert found.audit["n_added"] > 0
    assert f"(a{odd}b)".encode("latin-1") in found.target.read_bytes()


def test_a_block_that_cannot_be_read_is_none_of_a_list(tmp_path):
    file = tmp_path / "a.nc"
    for text, wanted in (("N10 G1 X=5 Y3\n", True), ("X_mm,Y_mm\n1,2\n", False)):
        file.write_text(text)
        assert is_program(file) is wanted


# ---- long programs ---------------------------------------------------------------------------------


def long_program(blocks, *, turns):
    """A path of short blocks with what stands between them; some turn alone under G94."""
    rng = np.random.default_rng(blocks)
    lines = ["%", "", "G21 G90 G94 G0 X10 Y5 Z30 A-20 C0", "M3 S900", "G1 F90"]
    at = {"X": 10.0, "Y": 5.0, "Z": 30.0, "A": -20.0, "C": 0.0}
    for i in range(blocks):
        moved = "AC" if turns and i % 5 == 2 else "XYZC" if i % 3 else "YA"
        for axis in moved:
            at[axis] = float(np.clip(at[axis] + 6.0 * rng.normal(), -40, 40))
        lines.append(" ".join(f"{a}{at[a]:.3f}" for a in moved))
        lines += {7: ["", "M8"], 11: ["G0 Z41.", "G1"]}.get(i % 13, [])
    return "\r\n".join([*lines, "; end", "M30"])


def in_small_parts(monkeypatch, poses, size):
    monkeypatch.setattr("metrosep.controllers.gcode.machine_programs.AT_ONCE", poses)
    monkeypatch.setattr("metrosep.controllers.gcode.columns._BYTES", size)


@pytest.mark.parametrize("between", [0, 1, 9])
@pytest.mark.parametrize("poses", [2, 7])
def test_a_program_in_parts_is_that_of_one_piece(tmp_path, monkeypatch, poses, between):
    """Turns that are timed, blocks that are split and comments lie across the borders of the parts."""
    options = {"tolerance": 20 * NM, "rotary_feed": "linear"}
    text = long_program(40, turns=True)
    text = text.replace("\r\n", "\r\n" + "; on the way\r\n" * between)
    found, whole = corrected(tmp_path, text, **options)
    assert found.audit["n_added"] > 20
    assert found.audit["n_inverse_time"] > 6
    assert ";METROSEP" in whole  # the comment that says how comments begin stands last
    in_small_parts(monkeypatch, poses, 300)
    again, parts = corrected(tmp_path, text, overwrite=True, **options)
    assert parts == whole
    assert again.n_points == found.n_points
    assert again.messages == found.messages
    assert again.after == pytest.approx(found.after, abs=1e-3 * NM)
    for axis, ends in found.correction.items():
        assert again.correction[axis] == pytest.approx(ends, abs=1e-3 * NM)


def test_a_jump_between_two_parts_is_seen(tmp_path, monkeypatch):
    """The largest step of A from pose to pose lies between the last pose of a part and the first of the next."""
    text = "G21 G90 G94\nG0 X0 Y0 Z30 A-20 C0\nG1 X1 F100\nX2\nC90 X3\nX4\n"
    options = {"max_step": 5e-6}
    with pytest.raises(DataError, match=r"jumps by .* between poses 2 and 3"):
        corrected(tmp_path, text, **options)
    in_small_parts(monkeypatch, 3, 300)
    with pytest.raises(DataError, match=r"jumps by .* between poses 2 and 3"):
        corrected(tmp_path, text, overwrite=True, **options)


def test_memory_does_not_grow_with_the_program(tmp_path, monkeypatch):
    import tracemalloc

    in_small_parts(monkeypatch, 30, 500)
    peaks = []
    for blocks in (60, 240):
        text = long_program(blocks, turns=False)
        tracemalloc.start()
        corrected(tmp_path, text, overwrite=True, stroke=1e-3, rotary_feed="all")
        peaks.append(tracemalloc.get_traced_memory()[1] - 3 * len(text))  # texts of this test
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_a_program_that_changes_while_it_is_read_is_refused(tmp_path, monkeypatch):
    from metrosep.controllers.gcode import machine_programs

    def slow(*given, **options):
        (tmp_path / "in.nc").write_text(PROGRAM.replace("X52.5", "X52.6"))
        return words(*given, **options)

    words = machine_programs.MachineWords
    monkeypatch.setattr(machine_programs, "MachineWords", slow)
    with pytest.raises(ReadError, match="changed while it was read"):
        corrected(tmp_path)
    assert not (tmp_path / "out.nc").exists()

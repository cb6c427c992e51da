"""What words mean beside positions of axes: F where axes turn, places on the part, diameters."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from metrosep.cli.main import main
from metrosep.controllers.gcode.machine_programs import rewrite_machine_program
from metrosep.core.errors import UnitError, UnsupportedFeatureError
from metrosep.machine import presets

pytestmark = pytest.mark.usefixtures("without_figures")

NM = 1e-9
H, TOOL = 0.08, (0.01, -0.005, -0.12)
ZERO = {"X": 0.02, "Z": 0.15, "C": np.radians(10.0)}
LINES = {"Y0A": 11e-6, "Z0A": -6e-6, "B0A": 20e-6, "X0C": 9e-6, "A0C": -13e-6, "B0C": 8e-6}
SPIN = {**LINES, "EXC": lambda c: 8e-6 * np.cos(2 * c), "EZA": lambda a: 9e-6 * np.sin(a)}
HEAD = "G21 G90 G94\nG0 X0. Y0. Z0. A-20. C0.\n"


def quaternion(axis, angle):
    k = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return np.append(np.cos(angle / 2), np.sin(angle / 2) * k)


def turned(q, v):
    """Return a vector turned by a quaternion."""
    w, u = q[0], q[1:]
    return v + 2.0 * np.cross(u, np.cross(u, v) + w * v)


def back(q):
    return q * [1, -1, -1, -1]


def tip(q, *, errors):
    """Return the tool point on the table: lines in space that the bodies of A and C turn about."""
    n = LINES if errors else dict.fromkeys(LINES, 0.0)
    a_along, c_along = np.array([1.0, 0.0, -n["B0A"]]), np.array([n["B0C"], -n["A0C"], 1.0])
    p = np.array([q["X"], q["Y"], q["Z"]]) + TOOL - [0, n["Y0A"], n["Z0A"]]
    p = turned(back(quaternion(a_along, -q["A"])), p)
    p = turned(back(quaternion((0, 1, 0), n["B0A"])), p)  # A at zero lies as it was set
    p = p - [n["X0C"], 0, H]
    p = turned(back(quaternion(c_along, -q["C"])), p)
    p = turned(back(quaternion((1, 0, 0), n["A0C"])), p)
    return turned(back(quaternion((0, 1, 0), n["B0C"])), p)


def axes_of(words):
    si = {k: np.radians(v) if k in "AC" else v * 1e-3 for k, v in words.items()}
    return {k: si.get(k, 0.0) + ZERO.get(k, 0.0) for k in "XYZAC"}


def control(words):
    """Return where a control puts the axes for a place on the part: the nominal machine, solved."""
    zero = axes_of({})
    place = tip({**zero, **{k: zero[k] + words[k] * 1e-3 for k in "XYZ"}}, errors=False)
    q = axes_of({**words, "X": 0.0, "Y": 0.0, "Z": 0.0})
    here = tip(q, errors=False)
    ways = np.array([tip({**q, k: q[k] + 1.0}, errors=False) - here for k in "XYZ"]).T
    for k, by in zip("XYZ", np.linalg.solve(ways, place - here), strict=True):
        q[k] += by
    return q, place


def moves(text):
    """Return words in force after each block that moves, with the minutes it takes (LinuxCNC's F)."""
    held, mode, inverse, feed, found = {}, 0, False, None, []
    for line in text.splitlines():
        words = dict(re.findall(r"([A-FH-Z])([-+]?[0-9.]+)", line))
        for g in re.findall(r"G([0-9.]+)", line):
            mode = int(g) if g in ("0", "1") else mode
            inverse = {"93": True, "94": False}.get(g, inverse)
        feed = float(words["F"]) if "F" in words else None if inverse else feed
        new = {**held, **{k: float(v) for k, v in words.items() if k in "XYZAC"}}
        if new != held or any(k in words for k in "XYZAC"):
            way = [new[k] - held.get(k, 0.0) for k in "XYZ" if k in new]
            turn = [new[k] - held.get(k, 0.0) for k in "AC" if k in new]
            length = np.linalg.norm(way) if np.any(way) else np.linalg.norm(turn)
            minutes = 0.0 if not mode else 1.0 / feed if inverse else length / feed
            found.append((mode == 1, new, minutes))
        held = new
    return found


def corrected(folder, text, machine=None, errors=None, **options):
    source, target = folder / "in.nc", folder / "out.nc"
    source.write_text(text, newline="")
    given = {"tool": TOOL, "zero": ZERO, **options}
    found = rewrite_machine_program(
        source, target, machine or presets("five_axis", pivot_height=H),
        LINES if errors is None else errors, **given,
    )  # fmt: skip
    return found, target.read_bytes().decode()


TURNS = (
    HEAD
    + "N1 G1 X10. F200\nN2 C90. F360\nN3 G94 A-25. C95.\nN4 X30.\nN5 G1 C10. M8\nN6 X0. F100\n"
)


def test_a_turn_takes_as_long_as_its_f_says(tmp_path):
    """F is along the linear axes while one moves: the turn would be made at once, and is timed instead."""
    found, text = corrected(tmp_path, TURNS, errors=SPIN, rotary_feed="linear")
    before, after = moves(TURNS), moves(text)
    assert len(before) == len(after)
    for (_, _, nominal), (_, _, actual) in zip(before, after, strict=True):
        assert actual == pytest.approx(nominal, rel=2e-3, abs=1e-9)  # 20 um of 10 mm
    assert before[2][2] == pytest.approx(0.25, abs=1e-12)
    assert found.audit["n_inverse_time"] == 3
    lines = text.splitlines()
    assert [v for v in lines if v.startswith("G94 F")] == ["G94 F360", "G94 F360"]
    assert lines[4].startswith("N2 G93 ")
    assert lines[5].startswith("N3 G93 ")
    assert "M8" in next(v for v in lines if v.startswith("N5 G93"))


def test_parts_of_a_timed_turn_share_its_time(tmp_path):
    _, text = corrected(
        tmp_path, "g21g90g94\ng0x60.y0.z0.a-20.c0.\ng1c90.f360\nx61.\n",
        rotary_feed="linear", tolerance=50 * NM, errors=SPIN,
    )  # fmt: skip
    times = [t for feed, _, t in moves(text.upper()) if feed]
    assert len(times) > 3
    assert sum(times[:-1]) == pytest.approx(0.25, abs=1e-5)
    assert "g94 f360" in text


def test_a_feed_along_all_axes_stays_as_it_is(tmp_path):
    found, text = corrected(tmp_path, TURNS, errors=SPIN, rotary_feed="all")
    assert "G93" not in text
    assert found.audit["n_inverse_time"] == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "G1 C90. F360\n", "rotary_feed='linear' if it is so"),
        (HEAD + "G1 X0.01 C90. F360\n", "with hardly any way of linear axes"),
    ],
)
def test_the_meaning_of_f_is_asked_for_where_it_matters(tmp_path, text, said):
    with pytest.raises(UnsupportedFeatureError, match=re.escape(said)):
        corrected(tmp_path, text, errors=SPIN)


@pytest.mark.parametrize("head", ["G21 G90\n", "G21 G90 G95\n", "G21 G90 G94 F5\nG93\nG94\n"])
def test_a_turn_without_a_feed_in_minutes_is_refused(tmp_path, head):
    text = head + "G0 X0. Y0. Z0. A-20. C0.\nG1 C90.\n"
    with pytest.raises(UnsupportedFeatureError, match=r"no F of G94 tells how long"):
        corrected(tmp_path, text, rotary_feed="linear", errors=SPIN)


@pytest.mark.parametrize(
    ("tail", "said"),
    [
        ("G1 C90. F360 M30\n", "G94 would stand behind the end"),
        ("G1 C90. X0.00005 F360\nM30\n", "lets the turn take 0.0083 ms"),
    ],
)
def test_a_turn_that_no_control_makes_so_is_refused(tmp_path, tail, said):
    with pytest.raises(UnsupportedFeatureError, match=re.escape(said)):
        corrected(tmp_path, HEAD + tail, rotary_feed="linear", errors=SPIN)


PART = """G21 G90 G94
G0 X0. Y0. Z60. A-30. C20.
G43.4 H3 Z50.
G0 X12. Y-8. Z20.
G1 X15. Y2. Z14. A-42. C75. F300
X9. C110.
G1 A-35. C60.
G49
G91 G28 Z0
M30
"""


def test_places_on_the_part_are_met_by_the_control_that_turns_them_into_axes(tmp_path):
    found, text = corrected(tmp_path, PART, tolerance=20 * NM, rotary_feed="linear")
    assert "places on the part" in " ".join(found.messages)
    before, after = moves(PART)[2:-1], moves(text)[2:-1]
    place, mixed, last = 0.0, [], None
    for _, words, _ in before:
        q, wanted = control(words)
        place = max(place, np.linalg.norm(tip(q, errors=True) - wanted))
        last = wanted
    assert place > 10e-6
    ends = [tip(control(w)[0], errors=True) for _, w, _ in after]
    for _, words, _ in before:
        mixed.append(min(np.linalg.norm(e - control(words)[1]) for e in ends))
    assert max(mixed) < 3 * NM
    # the last move turns about a point of the part: each of its parts must stay there
    for _, words, _ in after[-3:]:
        assert np.linalg.norm(tip(control(words)[0], errors=True) - last) < 25 * NM
    turn = [t for feed, _, t in after if feed]
    assert sum(turn) == pytest.approx(sum(t for f, _, t in before if f), rel=1e-3, abs=0.0)
    assert text.count("G93") == 1
    assert "G43.4 H3 Z50." in text.splitlines()


def test_places_on_the_part_are_not_taken_for_axes(tmp_path):
    """The same words without G43.4 are another path: 10 um and more apart."""
    _, text = corrected(tmp_path, PART, rotary_feed="linear")
    _, plain = corrected(tmp_path / "..", PART.replace("G43.4 H3 ", "").replace("G49\n", ""), rotary_feed="linear", overwrite=True)  # fmt: skip
    a, b = (next(v for v in t.splitlines() if re.match("X(9|8.99)", v)) for t in (text, plain))
    words = [float(re.search(r"X([-\d.]+)", line).group(1)) for line in (a, b)]
    assert abs(words[0] - words[1]) > 0.002


def test_a_feed_after_the_length_was_taken_away_and_another_length_are_refused(tmp_path):
    for tail, said in (
        ("G49\nG1 X1. Y1. Z1.\n", "G49 or D0 took the length"),
        ("G43.4 H4\n", "tool length changes"),
    ):
        with pytest.raises(UnsupportedFeatureError, match=said):
            corrected(tmp_path, PART.split("G49", maxsplit=1)[0] + tail, rotary_feed="all")


SIEMENS = """G54 G90 G94 G17
T1 D1
M6
G0 X0 Y0 Z60 A-30 C20
TRAORI
D1
ORIAXES
G0 X12 Y-8 Z20
G1 X15 Y2 Z14 A-42 C75 F300
X9 C110
G1 A-35 C60
TRAFOOF
G0 Z200 D0
M30
"""


def by_command_line(folder, text, capsys, *more):
    """Correct a program through the door; return its exit code, what was said, and the lines written."""
    (folder / "in.mpf").write_text(text, newline="")
    errors = [
        f'{k} = "{v * 1e6:.9g} {"um" if k[0] in "XYZ" else "urad"}"' for k, v in LINES.items()
    ]
    (folder / "lines.toml").write_text("\n".join(errors) + "\n")
    said = ["path", str(folder / "in.mpf"), "--machine", "five_axis", "--pivot-height", "80 mm"]
    said += ["--error", str(folder / "lines.toml"), "--tool", "10 mm,-5 mm,-120 mm"]
    for axis, value in (("X", "20 mm"), ("Z", "150 mm"), ("C", "10 deg")):
        said += ["--zero", f"{axis}={value}"]
    said += [] if "--path-unit" in more else ["--path-unit", "mm"]
    said += ["--rotary-feed", "linear", "--tolerance", "20 nm", *more]
    with pytest.raises(SystemExit) as stop:
        main([*said, "-o", str(folder / "out.mpf"), "--force"])
    out = folder / "out.mpf"
    return stop.value.code, capsys.readouterr().err, out.read_text() if out.exists() else ""


def test_a_siemens_program_with_traori_is_corrected_where_the_tool_cuts(tmp_path, capsys):
    code, err, text = by_command_line(tmp_path, SIEMENS, capsys)
    assert code == 0, err
    assert "D1: the lengths of this edge" in err
    assert "places on the part" in err
    lines = text.splitlines()
    kept = ("T1 D1", "TRAORI", "D1", "ORIAXES", "TRAFOOF", "G0 Z200 D0", "M30")
    assert [v for v in lines if v in kept] == list(kept)

    def on_part(program):
        return moves(HEAD + program.partition("ORIAXES\n")[2].partition("TRAFOOF")[0])[1:]

    before, after = on_part(SIEMENS), on_part(text)
    # a copy of the path that takes no word for a place on the part would be 100 mm away
    for (_, words, _), (_, given, _) in zip(before[:1], after[:1], strict=True):
        assert 1e-3 < max(abs(given[k] - words[k]) for k in "XYZ") < 0.1
    ends = [tip(control(w)[0], errors=True) for _, w, _ in after]
    for _, words, _ in before:
        wanted = control(words)[1]
        assert np.linalg.norm(tip(control(words)[0], errors=True) - wanted) > 5e-6
        assert min(np.linalg.norm(e - wanted) for e in ends) < 3 * NM
    # without TRAORI the words are axes: the rapid before it, and it is corrected as such
    q, given = axes_of({"X": 0, "Y": 0, "Z": 60, "A": -30, "C": 20}), moves(text)[0][1]
    assert np.linalg.norm(tip(axes_of(given), errors=True) - tip(q, errors=False)) < 3 * NM


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("X9 C110\n", "D2\nX9 C110\n", "line 10: D2: another edge of the tool has other lengths"),
        ("T1 D1\n", "T1\n", ""),  # D1 before the first cut, after the position: it is stated anew
        ("T1 D1\nM6\n", "", ""),
        ("X9 C110\n", "D1\nX9 C110\n", ""),
        ("D1\nORIAXES\n", "", ""),
        ("T1 D1\nM6\n", "D3\n", ""),
        ("X9 C110\n", "D0\nX9 C110\n", "line 11: a feed move: G49 or D0 took the length"),
        ("X9 C110\n", "D1.5\nX9 C110\n", "line 10: D1.5: nobody can say"),
        (
            "G0 X12 Y-8 Z20\nG1 X15 Y2 Z14 A",
            "D2\nG1 X15 A",
            "begin with a rapid move to a stated Y",
        ),
    ],
)
def test_one_edge_of_the_tool_in_a_path(tmp_path, capsys, old, new, said):
    assert old in SIEMENS
    code, err, text = by_command_line(tmp_path, SIEMENS.replace(old, new, 1), capsys)
    if said:
        assert code != 0
        assert said in err
        assert text == ""
    else:
        assert code == 0, err


LATHE = "G21 G90 G94\nG0 X40. Z1. C0.\nG1 Z0. F10\nX10. C180.\n"


def curve(x):
    return 2e-5 * x + 3e-6 * np.cos(200 * x)


def test_diameters_of_a_lathe_are_corrected_by_twice_the_error_of_the_radius(tmp_path):
    chain, errors = presets("sts_lathe"), {"EXX": curve, "EZX": lambda x: -1e-4 * x, "EYX": 1e-6}
    given = {"machine": chain, "errors": errors, "zero": {}, "tool": (0, 0, 0)}
    with pytest.raises(UnitError, match="diameter=True"):
        corrected(tmp_path, LATHE, **given)
    for option, head, share in (
        (True, "", 0.5), (False, "", 1.0), (None, "G7\n", 0.5), (None, "G8\n", 1.0),
    ):  # fmt: skip
        given["overwrite"] = True
        found, text = corrected(tmp_path, head + LATHE, diameter=option, **given)
        ends = zip(moves(LATHE), moves(text), strict=True)
        for (_, nominal, _), (_, words, _) in ends:
            x = words["X"] * 1e-3 * share
            assert abs(x + curve(x) - nominal["X"] * 1e-3 * share) < 2 * NM
            assert abs((words["Z"] - nominal["Z"]) * 1e-3 - 1e-4 * x) < 2 * NM
        assert "do not move the tool across their plane" in " ".join(found.messages)


def test_the_options_by_the_command_line(tmp_path, capsys):
    (tmp_path / "constants.toml").write_text('EXX = "2 um"\n')
    (tmp_path / "in.nc").write_text(LATHE)
    said = ["path", str(tmp_path / "in.nc"), "--machine", "sts_lathe", "--error"]
    said += [str(tmp_path / "constants.toml"), "-o", str(tmp_path / "o.nc")]
    with pytest.raises(SystemExit):
        main(said)
    assert "give --diameter or --radius" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main([*said, "--diameter", "--rotary-feed", "all", "--json"])
    assert stop.value.code == 0
    found = json.loads(capsys.readouterr().out)
    assert found["correction_si"]["X"] == pytest.approx([-2e-6, -2e-6], abs=1e-15)
    assert "X39.996" in (tmp_path / "o.nc").read_text()


@pytest.mark.parametrize(("unit", "like"), [("G710", "G21"), ("G71", "G21"), ("G700", "G20")])
def test_units_of_a_siemens_program(tmp_path, capsys, unit, like):
    body = " G90 G94\nG0 X0. Y0. Z0. A-20. C0.\nG1 X0.5 Y-1.25 F50\nX1.5 A-30. F40\nM30\n"
    written = []
    for name, word in (("own", unit), ("usual", like)):
        (tmp_path / name).mkdir()
        code, err, text = by_command_line(
            tmp_path / name, word + body, capsys, "--path-unit", "inch" if like == "G20" else "mm"
        )
        assert code == 0, err
        assert "F is taken" not in err  # the turn takes the time that it took: F is not read
        written.append(text.replace(word, "unit", 1))
    assert written[0] == written[1]
    assert written[0] != "unit" + body  # something was corrected


@pytest.mark.parametrize(
    ("word", "said"),
    [("G70", "G70: F stays in the basic unit"), ("G71 P10 Q20", "cycle"), ("G70 P1 Q2", "cycle")],
)
def test_g70_of_unknown_feed_and_cycles_of_lathes_are_refused(tmp_path, capsys, word, said):
    text = f"{word}\nG90 G94\nG0 X0. Y0. Z0. A-20. C0.\nG1 X1. F50\nM30\n"
    code, err, written = by_command_line(tmp_path, text, capsys)
    assert code == 4
    assert said in err
    assert written == ""


def test_g71_beside_an_edge_is_a_unit_and_its_f_is_asked_for_where_it_is_used(tmp_path):
    head = "G17 G71 G90 G94 G54 D1\nG0 X0. Y0. Z0. A-20. C0.\n"
    found, text = corrected(tmp_path, head + "G1 X1. F50\nM30\n", rotary_feed="linear")
    assert "F is taken" not in " ".join(found.messages)  # no F is read
    _, like = corrected(
        tmp_path, head.replace("G71", "G710") + "G1 X1. F50\nM30\n",
        rotary_feed="linear", overwrite=True,
    )  # fmt: skip
    assert text == like.replace("G710", "G71")
    turn = head + "G1 X1. C30. F50\nC90. F360\nM30\n"
    given = {"rotary_feed": "linear", "overwrite": True}
    with pytest.raises(UnsupportedFeatureError, match=r"G71 leaves the unit of F to the control"):
        corrected(tmp_path, turn, errors=SPIN, **given)
    found, _ = corrected(tmp_path, turn, errors=SPIN, unit="mm", **given)
    assert "F is taken to be in mm/min" in " ".join(found.messages)


def test_a_program_without_a_unit_hears_of_g71(tmp_path):
    with pytest.raises(UnsupportedFeatureError, match=r"G710 or G71 of Sinumerik"):
        corrected(tmp_path, "G90 G94\nG0 X0. Y0. Z0. A-20. C0.\n")

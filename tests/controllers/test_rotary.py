"""Axes that turn: files of each dialect through a parser of its documents, over three turns and both directions."""

import json
import re

import numpy as np
import pytest
from controllers.turning import ARCSEC, error, over_three_turns, table

from metrosep import Run, RunSet, controllers
from metrosep.compensation import CompensationMap, CompensationTable, trial_table
from metrosep.errors import MetrosepError, SignCheckFailedError, TableError

HALF = 0.5 * (1 + 1e-6)
"""Half an entry, and the rounding of doubles."""


def made_of(forward, positions, axis="C", reverse=None):
    return CompensationTable(positions, forward, reverse, axis, axis, 0.0, is_exact_inverse=True)


def net_step(made, radians_a_radian=1e-5):
    """Return a table whose error does not come back after a turn."""
    return made_of(made.forward + made.positions * radians_a_radian, made.positions)


def write(made, path, name, **options):
    controllers.write(
        made, path, name, sign_confirmed=True, **{"verified_against": error, **options}
    )
    return path


# ---- Fanuc: 3620 to 3625, increments that add up to 0 over a turn ------------------------------------

DETECTION = np.deg2rad(1e-4)
FANUC = {"detection_unit": "0.0001 deg", "largest": 127}


def fanuc_words(text):
    """Return parameters and points of a file, by number; points from 10000 on."""
    pairs = (line[1:].split("P") for line in text.splitlines() if line.startswith("N"))
    return {int(n.split("A")[0]): int(v) for n, v in pairs}


def fanuc_added(words, degrees, direction=1, increment=1e-3):
    """Return pulses (detection units) output from the reference at 0 on: those of 3620 + 1 ... + n, repeated."""
    step, n0 = words[3624] * increment, words[3620]
    back = direction < 0 and 3626 in words
    start = words[3626] + 1 if back else n0 + 1
    pulses = words[3627] if back else 0.0
    inside = degrees % 360.0
    for k in range(words[3622] - n0):
        share = min(max(inside / step - k, 0.0), 1.0)
        pulses += words[3623] * words[10000 + start + k] * share
    return pulses


def test_fanuc_integers_are_those_of_the_specification(tmp_path):
    """A turn of 360 deg, intervals of 45 deg, point 60 at the reference: values at 61 to 68, sum 0."""
    path = write(table(step=45), tmp_path / "c.txt", "fanuc", reference_number=60, **FANUC)

    words = fanuc_words(path.read_text())
    assert [words[p] for p in range(3620, 3626)] == [60, 60, 68, 1, 45000, 360000]
    assert [words[10000 + p] for p in range(61, 69)] == [-2, 11, 3, 8, 24, 11, -25, -30]
    assert words[10060] == words[10068]
    assert "DETECTION UNIT 0.0001 DEG" in path.read_text()


@pytest.mark.parametrize("magnification", [1, 3])
def test_fanuc_round_trip_over_three_turns(tmp_path, magnification):
    made = table(step=10)
    path = write(
        made, tmp_path / "c.txt", "fanuc", magnification=magnification, increment="0.001 deg", **FANUC
    )  # fmt: skip
    words, lookup = fanuc_words(path.read_text()), controllers.simulate(path, "fanuc")
    unit = DETECTION * magnification

    parsed = lambda degrees, direction: fanuc_added(words, degrees, direction) * DETECTION  # noqa: E731
    assert over_three_turns(parsed, made, unit) < HALF
    ours = lambda degrees, direction: lookup(np.deg2rad(degrees), direction)  # noqa: E731
    assert over_three_turns(ours, made, unit) < HALF
    assert sum(words[10000 + p] for p in range(1, 37)) == 0


def test_fanuc_lists_of_both_directions_over_three_turns(tmp_path):
    made = table(lag=2.3, step=15)
    path = write(
        made,
        tmp_path / "c.txt",
        "fanuc",
        bidirectional=True,
        verified_against=None,
        allow_unverified=True,
        **FANUC,
    )
    words, lookup = fanuc_words(path.read_text()), controllers.simulate(path, "fanuc")

    # 2.3" ahead = 6.389 units of 0.0001 deg; the lists are points 0 to 24 and 25 to 49
    assert (words[3626], words[3627]) == (25, -6)
    parsed = lambda degrees, way: fanuc_added(words, degrees, way) * DETECTION  # noqa: E731
    assert over_three_turns(parsed, made, DETECTION) < HALF
    ours = lambda degrees, way: lookup(np.deg2rad(degrees), way)  # noqa: E731
    assert over_three_turns(ours, made, DETECTION) < HALF


def test_trial_of_an_axis_that_turns_is_told_in_angles(tmp_path):
    trial = trial_table(table(lag=2.3, step=10), "20 arcsec")
    path = tmp_path / "t.txt"
    controllers.write(trial, path, "fanuc", bidirectional=True, **FANUC)
    words = fanuc_words(path.read_text())
    peak = np.degrees(trial.position)

    assert "from 0 to 360 deg, once without and once with the trial table" in trial.instruction
    assert f"at {peak:.6g} deg" in trial.instruction
    assert "+96.96 urad" in trial.if_right  # 20"
    for way, height in ((1, 20.0), (-1, 6.0)):  # 0.3 as high in - direction
        seen = fanuc_added(words, peak, way) * DETECTION / ARCSEC
        assert seen == pytest.approx(height, rel=0, abs=0.2)
    assert trial.judge("20 arcsec") == "right"
    assert trial.judge("-20 arcsec") == "wrong"
    with pytest.raises(MetrosepError, match=r"an angle is needed"):
        trial_table(table(), "5 um")


def test_fanuc_takes_an_interval_in_degrees_and_no_length(tmp_path):
    path = write(table(step=10), tmp_path / "c.txt", "fanuc", interval="20 deg", **FANUC)
    assert fanuc_words(path.read_text())[3624] == 20000
    sidecar = json.loads((tmp_path / "c.txt.json").read_text())["options"]
    assert sidecar["interval"] == pytest.approx(np.deg2rad(20), rel=1e-12, abs=1e-15)

    bad = tmp_path / "bad.txt"
    with pytest.raises(MetrosepError, match=r"interval='5 mm'.*C turns"):
        write(table(step=10), bad, "fanuc", interval="5 mm", **FANUC)
    with pytest.raises(MetrosepError, match=r"detection_unit='100 nm'.*C turns"):
        write(table(), bad, "fanuc", detection_unit="100 nm", largest=127)
    with pytest.raises(MetrosepError, match=r"one turn is 2.11764706 intervals of 170 deg"):
        write(table(step=10), bad, "fanuc", interval="170 deg", **FANUC)
    straight = CompensationTable([0.0, 0.1, 0.2], [0.0, 1e-6, 0.0], None, "X", "X", 0.0)
    with pytest.raises(MetrosepError, match=r"detection_unit='0.0001 deg'.*X does not turn"):
        write(straight, bad, "fanuc", **FANUC)
    assert not bad.exists()


def test_fanuc_refuses_what_adds_up_or_begins_elsewhere(tmp_path):
    made, bad = table(), tmp_path / "bad.txt"
    with pytest.raises(TableError, match=r"differs by 12\.96 arcsec"):
        write(net_step(made), bad, "fanuc", **FANUC)
    later = made_of(-error(made.positions + np.pi), made.positions + np.pi)
    with pytest.raises(TableError, match=r"must begin at 0 deg here and begins at 180 deg"):
        write(later, bad, "fanuc", **FANUC)
    assert not bad.exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("N10003P", "N10003P1", "sum 0"),
        ("N3625A1P360000", "N3625A1P180000", "not the travel of one turn"),
        ("N3624A1P30000", "N3624A1P20000", "do not fit"),
        ("N3625A1P360000\n", "", "do not fit|points|reference"),
    ],
)
def test_fanuc_refuses_a_damaged_turn(tmp_path, old, new, words):
    path = write(table(), tmp_path / "c.txt", "fanuc", **FANUC)
    text = path.read_text()
    assert old in text
    (tmp_path / "c.txt.json").unlink()
    path.write_text(text.replace(old, new, 1))
    if new:
        with pytest.raises(MetrosepError, match=words):
            controllers.read(path, "fanuc")
    else:  # without 3625 it is the table of part of a turn, whose first point is another one
        found = controllers.read(path, "fanuc")
        assert found.positions[0] == pytest.approx(-np.deg2rad(30), rel=0, abs=1e-9)


def test_fanuc_part_of_a_turn_is_an_ordinary_table(tmp_path):
    angles = np.deg2rad(np.linspace(-90, 90, 19))
    made = made_of(-error(angles), angles, "B")
    path = write(made, tmp_path / "b.txt", "fanuc", **FANUC)
    words = fanuc_words(path.read_text())

    assert 3625 not in words
    lookup = controllers.simulate(path, "fanuc")
    for degrees in np.linspace(-180, 180, 61):
        step, pulses = words[3624] * 1e-3, 0.0
        for point in range(words[3621], words[3622] + 1):
            low = (point - words[3620] - 1) * step
            share = min(max((degrees - low) / step, 0.0), 1.0)
            pulses += words[10000 + point] * (share if low > -1e-9 else share - 1.0)
        wanted = made.correction(np.deg2rad(degrees))[0]
        assert abs(pulses * DETECTION - wanted) < HALF * DETECTION
        assert abs(float(lookup(np.deg2rad(degrees))) - wanted) < HALF * DETECTION
    findings = json.loads((tmp_path / "b.txt.json").read_text())["findings"]
    assert any("part of a turn" in f["problem"] for f in findings)


def test_fanuc_wrong_sign_is_refused_by_runs_over_angle(tmp_path):
    made = made_of(-table().forward, table().positions)
    with pytest.raises(MetrosepError, match=r"larger"):
        write(made, tmp_path / "c.txt", "fanuc", **FANUC)
    assert list(tmp_path.iterdir()) == []


def test_fanuc_table_without_a_sidecar_says_that_it_turns(tmp_path):
    path = write(table(), tmp_path / "c.txt", "fanuc", **FANUC)
    (tmp_path / "c.txt.json").unlink()
    back = controllers.read(path, "fanuc")
    assert (back.axis, back.compensates) == ("C", "C")
    assert float(np.abs(back.forward - table().forward).max()) < HALF * DETECTION
    # the comment lost too: units are asked for, and an angle says that the axis turns
    path.write_text("%\n" + path.read_text().split("\n", 1)[1])
    with pytest.raises(MetrosepError, match=r"detection_unit"):
        controllers.read(path, "fanuc")
    told = {"increment": "0.001 deg", "reference_position": "0 deg", "entry_sign": -1}
    again = controllers.read(path, "fanuc", detection_unit="0.0001 deg", **told)
    assert float(np.abs(again.forward - back.forward).max()) < 1e-12 * ARCSEC


# ---- TwinCAT Tc2_MC2: degrees, Modulo from 0 to 360, a structure for each direction -------------------

NINTH = np.deg2rad(1e-9)
"""The ninth decimal of a degree."""


def st_tables(text):
    """Return positions, corrections (deg), direction and modulo of each table, as an ST reader sees them."""
    found = {}
    for name, body in re.findall(
        r"(\w+) : ARRAY\[1\.\.\d+\] OF \w+ := \[(.*?)\];", text, re.DOTALL
    ):
        rows = re.findall(r"Position := (\S+), Compensation := (\S+)\)", body)
        head = re.search(rf"{name}Parameter : \w+ := \((.*?)\);", text)[1]
        facts = dict(re.findall(r"(\w+) := ([\w.-]+)", head))
        assert int(facts["NoOfTableElements"]) == len(rows)
        p, c = np.array(rows, dtype=float).T
        assert (p[0], p[-1]) == (float(facts["MinPosition"]), float(facts["MaxPosition"]))
        way = facts.get("Direction", "WorkDirectionBoth")
        found[way] = (p, c, facts.get("Modulo") == "TRUE")
    return found


def st_added(tables, degrees, direction=1):
    """Return what is added in that direction of work, in rad."""
    names = {"WorkDirectionBoth", f"WorkDirection{'Positive' if direction > 0 else 'Negative'}"}
    total = 0.0
    for way, (p, c, modulo) in tables.items():
        if way in names:
            total += np.deg2rad(np.interp(degrees % 360.0 if modulo else degrees, p, c))
    return total


@pytest.mark.parametrize(("lag", "more"), [(0.0, {}), (2.3, {"bidirectional": True})])
def test_twincat_over_three_turns(tmp_path, lag, more):
    made = table(lag=lag)
    path = tmp_path / "c.txt"
    controllers.write(made, path, "twincat", modulo=True, allow_unverified=True, **more)
    tables, lookup = st_tables(path.read_text()), controllers.simulate(path, "twincat")

    assert all(modulo for _, _, modulo in tables.values())
    assert all((p[0], p[-1]) == (0.0, 360.0) for p, _, _ in tables.values())
    parsed = lambda degrees, way: st_added(tables, degrees, way)  # noqa: E731
    assert over_three_turns(parsed, made, NINTH) < HALF + 1e-3
    ours = lambda degrees, way: lookup(np.deg2rad(degrees), way)  # noqa: E731
    assert over_three_turns(ours, made, NINTH) < HALF + 1e-3


def test_twincat_is_judged_by_runs_over_angle(tmp_path):
    done = controllers.write(
        table(step=5), tmp_path / "c.txt", "twincat", modulo=True, verified_against=error
    )
    assert done.passed
    assert done.after_pv < 0.01 * done.before_pv < 0.01 * done.wrong_sign_pv
    wrong = made_of(-table().forward, table().positions)
    with pytest.raises(MetrosepError, match=r"larger"):
        controllers.write(wrong, tmp_path / "w.txt", "twincat", verified_against=error)


def test_twincat_part_of_a_turn_holds_its_ends(tmp_path):
    angles = np.deg2rad(np.linspace(-90, 90, 19))
    made = made_of(-error(angles), angles, "B")
    path = tmp_path / "b.txt"
    controllers.write(made, path, "twincat", allow_unverified=True)
    tables, lookup = st_tables(path.read_text()), controllers.simulate(path, "twincat")

    assert not any(modulo for _, _, modulo in tables.values())
    for degrees in np.linspace(-180, 180, 61):
        wanted = made.correction(np.deg2rad(degrees))[0]
        assert abs(st_added(tables, degrees) - wanted) < HALF * NINTH * 1.01
        assert abs(float(lookup(np.deg2rad(degrees))) - wanted) < HALF * NINTH * 1.01


def test_twincat_refuses_what_does_not_close(tmp_path):
    made, bad = table(), tmp_path / "bad.txt"
    with pytest.raises(TableError, match=r"differs by 12\.96 arcsec"):
        controllers.write(net_step(made), bad, "twincat", modulo=True)
    later = made_of(-error(made.positions + np.pi), made.positions - np.pi)
    with pytest.raises(TableError, match=r"must begin at 0 deg here and begins at -180 deg"):
        controllers.write(later, bad, "twincat", modulo=True)
    with pytest.raises(MetrosepError, match=r"interval='5 mm'.*C turns"):
        controllers.write(made, bad, "twincat", modulo=True, interval="5 mm")
    straight = CompensationTable([0.0, 0.1, 0.2], [0.0, 1e-6, 0.0], None, "X", "X", 0.0)
    with pytest.raises(TableError, match=r"X is linear"):
        controllers.write(straight, bad, "twincat", modulo=True)
    assert not bad.exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Position := 360.000000000, Compensation := 0.", "Position := 360.000000000, Compensation := 1.",
         "first value equal"),
        ("WorkDirectionNegative", "WorkDirectionPositive", "both directions"),
        ("in deg,", "in mm,", "modulo table|sidecar"),
    ],
)  # fmt: skip
def test_twincat_refuses_a_damaged_turn(tmp_path, old, new, words):
    path = tmp_path / "c.txt"
    options = {"modulo": True, "bidirectional": True, "allow_unverified": True}
    controllers.write(table(lag=2.3), path, "twincat", **options)
    text = path.read_text()
    assert old in text
    (tmp_path / "c.txt.json").unlink()
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(MetrosepError, match=words):
        controllers.read(path, "twincat")


def test_twincat_tables_of_a_linear_axis_for_each_direction(tmp_path):
    x = np.linspace(0, 0.05, 11)
    ahead = 2e-6 * np.sin(x / 0.011)
    made = CompensationTable(x, ahead, ahead + 0.7e-6, "X", "X", 0.0, is_exact_inverse=True)
    with pytest.raises(TableError, match=r"bidirectional=True"):
        controllers.write(made, tmp_path / "x.txt", "twincat")
    path = tmp_path / "x.txt"
    controllers.write(made, path, "twincat", bidirectional=True, allow_unverified=True)
    tables = st_tables(path.read_text())
    assert {*tables} == {"WorkDirectionPositive", "WorkDirectionNegative"}
    p, c, modulo = tables["WorkDirectionNegative"]
    assert not modulo
    assert float(np.abs(c * 1e-3 - made.reverse).max()) < 0.51e-12
    back = controllers.read(path, "twincat")
    assert float(np.abs(back.reverse - made.reverse).max()) < 0.51e-12
    assert float(np.abs(p * 1e-3 - x).max()) < 0.51e-12


# ---- Turbo PMAC: counts, span of one turn, the last entry 0, rolled over -----------------------------

COUNT = np.deg2rad(1e-4)
SIXTEENTH = COUNT / 16


def pmac_numbers(text):
    """Return the words of the DEFINE line and the entries: comments are stripped, as a sender does."""
    plain = " ".join(line.partition(";")[0] for line in text.splitlines())
    found = re.search(r"DEFINE (?:BL)?COMP (\S+) ([-\d ]+?) I", plain)
    return found[1].split(","), [int(v) for v in found[2].split()]


def pmac_added(define, entries, degrees, count_deg=1e-4):
    """Return sixteenths of a count at a position: taken modulo the span, linear, 0 at zero."""
    span, n = int(define[-1]), len(entries)
    assert int(define[0]) == n
    at = (degrees / count_deg) % span / (span / n)
    return float(np.interp(at, np.arange(n + 1), [0, *entries]))


def test_pmac_integers_are_those_of_the_specification(tmp_path):
    path = tmp_path / "c.pmc"
    controllers.write(
        table(), path, "pmac", count="0.0001 deg", source_motor=4, verified_against=error
    )
    define, entries = pmac_numbers(path.read_text())

    assert define == ["12", "#4D", "#4", "3600000"]
    assert entries == [-74, 26, 144, 182, 196, 313, 565, 820, 880, 664, 294, 0]
    assert "; count = 0.0001 deg" in path.read_text()
    findings = json.loads((tmp_path / "c.pmc.json").read_text())["findings"]
    assert any("3600000 counts" in f["problem"] and "Ixx27" in f["fix"] for f in findings)


@pytest.mark.parametrize(("sign", "zero"), [(1, "0 deg"), (-1, "0 deg"), (1, "30 deg")])
def test_pmac_over_three_turns(tmp_path, sign, zero):
    made = table(step=10)
    home = np.deg2rad(float(zero.split()[0]))
    if home:  # zero where the motor reads zero, over the turn from there
        angles = made.positions + home
        made = made_of(-(error(angles) - error(home)), angles)
    path = tmp_path / "c.pmc"
    controllers.write(
        made, path, "pmac", count="0.0001 deg", source_motor=4, source_sign=sign, motor_zero=zero,
        allow_unverified=True,
    )  # fmt: skip
    define, entries = pmac_numbers(path.read_text())
    lookup = controllers.simulate(path, "pmac")

    for degrees in np.linspace(-360, 720, 433):
        place = (degrees - np.degrees(home)) % 360.0 + np.degrees(home)
        wanted = made.correction(np.deg2rad(place))[0]
        motor = sign * (degrees - np.degrees(home))
        parsed = sign * pmac_added(define, entries, motor) * SIXTEENTH
        assert abs(parsed - wanted) < HALF * SIXTEENTH
        for way in (1, -1):
            assert abs(float(lookup(np.deg2rad(degrees), way)) - wanted) < HALF * SIXTEENTH


def test_pmac_without_sidecar_or_comments_is_read_by_the_units_that_are_typed(tmp_path):
    path = tmp_path / "c.pmc"
    controllers.write(table(), path, "pmac", count="0.0001 deg", allow_unverified=True)
    (tmp_path / "c.pmc.json").unlink()
    back = controllers.read(path, "pmac")
    assert (back.axis, back.compensates) == ("C", "C")
    assert float(np.abs(back.forward - table().forward).max()) < HALF * SIXTEENTH
    code = "\n".join(r for r in path.read_text().splitlines() if not r.startswith(";"))
    path.write_text(code + "\n")
    told = {"source_sign": 1, "motor_zero": "0 deg", "count": "0.0001 deg"}
    again = controllers.read(path, "pmac", **told)
    assert again.axis == "C"
    assert float(np.abs(again.positions - back.positions).max()) < 1e-12
    assert float(np.abs(again.forward - back.forward).max()) < 1e-12 * ARCSEC


def test_pmac_refuses_what_does_not_close_or_is_of_the_other_kind(tmp_path):
    made, bad = table(), tmp_path / "bad.pmc"
    with pytest.raises(TableError, match=r"differs by 12\.96 arcsec"):
        controllers.write(net_step(made), bad, "pmac", count="0.0001 deg")
    with pytest.raises(MetrosepError, match=r"span='40 mm'.*C turns"):
        controllers.write(made, bad, "pmac", count="0.0001 deg", span="40 mm")
    with pytest.raises(TableError, match=r"one turn of C is 1090909\.09 counts"):
        controllers.write(made, bad, "pmac", count="0.00033 deg")
    assert not bad.exists()


def test_pmac_table_over_an_axis_that_turns_of_one_that_does_not(tmp_path):
    """Wobble of a table: X over C, counts of 0.0001 deg and of 10 nm."""
    angles = np.deg2rad(np.arange(0, 361, 20))
    values = 2e-6 * (np.sin(angles) + 0.4 * np.sin(2 * angles))
    values[-1] = values[0]
    made = CompensationTable(angles, values, None, "C", "X", 0.0)
    path = tmp_path / "c.pmc"
    options = {
        "count": "10 nm",
        "source_count": "0.0001 deg",
        "source_motor": 4,
        "target_motor": 1,
    }
    controllers.write(made, path, "pmac", allow_unverified=True, **options)
    define, entries = pmac_numbers(path.read_text())
    lookup, unit = controllers.simulate(path, "pmac"), 1e-8 / 16

    assert define == ["18", "#4D", "#1", "3600000"]
    assert "; count = 10 nm" in path.read_text()
    for degrees in np.linspace(-360, 720, 433):
        wanted = made.correction(np.deg2rad(degrees % 360.0))[0]
        assert abs(pmac_added(define, entries, degrees) * unit - wanted) < HALF * unit
        assert abs(float(lookup(np.deg2rad(degrees))) - wanted) < HALF * unit
    (tmp_path / "c.pmc.json").unlink()
    back = controllers.read(path, "pmac")
    assert (back.axis, back.compensates) == ("C", "X")
    assert back.positions[-1] == pytest.approx(2 * np.pi, rel=0, abs=1e-9)


def test_pmac_lost_motion_of_an_axis_that_turns(tmp_path):
    angles = np.deg2rad(np.arange(0, 361, 15))
    lost = ARCSEC * (5 + 2 * np.sin(angles))
    lost[-1] = lost[0]
    made = made_of(0 * angles, angles, "C", reverse=-lost)
    path = tmp_path / "c.pmc"
    controllers.write(
        made, path, "pmac-backlash", count="0.0001 deg", motor=4, allow_unverified=True
    )
    define, entries = pmac_numbers(path.read_text())
    base = int(re.search(r"I486=(\d+)", path.read_text())[1])
    lookup = controllers.simulate(path, "pmac-backlash")
    for degrees in np.linspace(-360, 720, 217):
        wanted = -np.interp(degrees % 360.0, np.degrees(angles), lost)
        taken = -(base + pmac_added(define, entries, degrees)) * SIXTEENTH
        assert abs(taken - wanted) < 1.01 * SIXTEENTH  # base and entry are rounded apart
        assert abs(float(lookup(np.deg2rad(degrees), -1)) - wanted) < 1.01 * SIXTEENTH
        assert float(lookup(np.deg2rad(degrees), 1)) == 0.0


def test_pmac_plane_over_an_axis_that_turns(tmp_path):
    x, c = np.arange(0, 0.101, 0.02), np.deg2rad(np.arange(0, 361, 30))
    values = 2e-6 * np.outer(np.sin(c) + 0.3 * (1 - np.cos(2 * c)), 1 + 3 * x)
    values[-1] = values[0]
    made = CompensationMap(x, c, values, ("X", "C"), "Z", (0.0, 0.0))
    path = tmp_path / "m.pmc"
    options = {"count": "10 nm", "x_count": "20 nm", "y_count": "0.0001 deg", "x_span": "120 mm"}
    controllers.write(
        made, path, "pmac-plane", allow_unverified=True, x_motor=1, y_motor=4, target_motor=3,
        **options,
    )  # fmt: skip
    define, entries = pmac_numbers(path.read_text())
    assert define == ["12.6", "#1D", "#4D", "#3", "6000000", "3600000"]
    grid = np.reshape([0, *entries], (13, 7))
    lookup, unit = controllers.simulate(path, "pmac-plane"), 1e-8 / 16
    for degrees in np.linspace(-360, 720, 109):
        for along in (0.0, 0.011, 0.064, 0.1):
            wanted = float(made.correction(along, np.deg2rad(degrees % 360.0))[0])
            rows = [np.interp(along / 0.02, np.arange(7), row) for row in grid]
            seen = float(np.interp(degrees % 360.0 / 30, np.arange(13), rows)) * unit
            assert abs(seen - wanted) < HALF * unit
            assert abs(float(lookup(along, np.deg2rad(degrees))) - wanted) < HALF * unit
    (tmp_path / "m.pmc.json").unlink()
    back = controllers.read(path, "pmac-plane")
    assert back.axes == ("X", "C")
    assert back.y[-1] == pytest.approx(2 * np.pi, rel=0, abs=1e-9)
    open_map = CompensationMap(x, c, values + 1e-7 * c[:, None], ("X", "C"), "Z", (0.0, 0.0))
    with pytest.raises(
        TableError, match=r"fills the span of 360 deg.*differ there by 628.*the same"
    ):
        controllers.write(open_map, path, "pmac-plane", overwrite=True, **options)


# ---- HEIDENHAIN: degrees, entries from 0 to 360 only ------------------------------------------------

LAST = np.deg2rad(1e-4)
"""The fourth decimal of a degree."""


def com_rows(text):
    """Return name, columns and rows of numbers of a table, by the widths 6, 16, 16, 16 ..."""
    lines = text.split("\r\n")
    cut = lambda line: [line[:6], *(line[i : i + 16] for i in range(6, max(len(line), 54), 16))]  # noqa: E731
    cells = [[c.strip() for c in cut(line)] for line in lines[1:-2]]
    rows = [[float(c) if c else None for c in row] for row in cells[1:]]
    return lines[0].split()[1], cells[0], rows


def com_added(rows, degrees, direction=1, column=3):
    """Return minus the error of the table: straight between lines, the turn repeated."""
    at = [r[1] for r in rows]
    back = direction < 0 and rows[0][2] is not None
    values = [r[2] if back else r[column] for r in rows]
    turn = at[-1] - at[0] == 360.0
    return -float(np.interp(degrees % 360.0 if turn else degrees, at, values))


@pytest.mark.parametrize("lag", [0.0, 2.3])
def test_heidenhain_over_three_turns(tmp_path, lag):
    made = table(lag=lag, step=10)
    path = tmp_path / "c.com"
    controllers.write(made, path, "heidenhain", sign_confirmed=True, allow_unverified=True)
    name, titles, rows = com_rows(path.read_bytes().decode())
    lookup = controllers.simulate(path, "heidenhain")

    assert (name, titles[3]) == ("C_C.COM", "C")
    assert [r[1] for r in rows] == list(range(0, 361, 10))
    parsed = lambda degrees, way: np.deg2rad(com_added(rows, degrees, way))  # noqa: E731
    assert over_three_turns(parsed, made, LAST) < HALF
    ours = lambda degrees, way: lookup(np.deg2rad(degrees), way)  # noqa: E731
    assert over_three_turns(ours, made, LAST) < HALF


def test_heidenhain_is_judged_by_runs_over_angle(tmp_path):
    options = {"resolution": "0.00001 deg", "sign_confirmed": True, "verified_against": error}
    done = controllers.write(table(step=5), tmp_path / "c.com", "heidenhain", **options)
    assert done.passed
    wrong = made_of(-table().forward, table().positions)
    with pytest.raises(MetrosepError, match=r"larger"):
        controllers.write(wrong, tmp_path / "w.com", "heidenhain", **options)


def test_heidenhain_part_of_a_turn_and_a_linear_column_over_it(tmp_path):
    """C over its own angle and the wobble of X over C: one file, degrees and millimetres."""
    angles = np.deg2rad(np.arange(20, 201, 20))
    own = made_of(-(error(angles) - error(angles[0])), angles)
    own = CompensationTable(angles, own.forward, None, "C", "C", float(angles[0]))
    wobble = 2e-6 * np.sin(angles - angles[0])
    across = CompensationTable(angles, wobble, None, "C", "X", float(angles[0]))
    path = tmp_path / "c.com"
    controllers.write(
        [own, across], path, "heidenhain", sign_confirmed=True, allow_unverified=True
    )
    _, titles, rows = com_rows(path.read_bytes().decode())
    assert titles == ["NR", "AXISPOS", "BACKLASH", "C", "X"]
    for column, made, unit in ((3, own, np.deg2rad(1)), (4, across, 1e-3)):
        lookup = controllers.simulate(path, "heidenhain", column=made.compensates)
        for degrees in np.linspace(-30, 400, 87):
            wanted = float(made.correction(np.deg2rad(degrees))[0])
            seen = com_added(rows, degrees, 1, column) * unit
            assert abs(seen - wanted) < HALF * unit * 1e-4
            assert abs(float(lookup(np.deg2rad(degrees))) - wanted) < HALF * unit * 1e-4


def test_heidenhain_refuses_positions_beyond_a_turn_and_what_does_not_close(tmp_path):
    made, bad = table(), tmp_path / "bad.com"
    options = {"sign_confirmed": True}
    below = made_of(made.forward, made.positions - np.pi)
    with pytest.raises(
        TableError, match=r"lie from 0 to 360 deg, this table covers -180 \.\.\. 180"
    ):
        controllers.write(below, bad, "heidenhain", **options)
    with pytest.raises(TableError, match=r"differs by 12\.96 arcsec"):
        controllers.write(net_step(made), bad, "heidenhain", **options)
    with pytest.raises(MetrosepError, match=r"resolution='10 nm'.*C turns"):
        controllers.write(made, bad, "heidenhain", resolution="10 nm", **options)
    assert not bad.exists()
    path = tmp_path / "c.com"
    controllers.write(made, path, "heidenhain", allow_unverified=True, **options)
    text = path.read_bytes().decode()
    (tmp_path / "c.com.json").unlink()
    last = text.split("\r\n")[-3]
    path.write_bytes(text.replace(last, last.removesuffix("0.0000") + "0.0007").encode())
    with pytest.raises(MetrosepError, match=r"0 and 360 deg differ"):
        controllers.read(path, "heidenhain", entry_sign=1)
    head = text.split("\r\n")[:2]
    rows = [f"{i:<6}{at:<32}{0.001 * i:.4f}" for i, at in enumerate(("-30.0000", "0.0000"))]
    path.write_bytes("\r\n".join([*head, *rows, "[END]", ""]).encode())
    with pytest.raises(MetrosepError, match=r"lie from 0 to 360"):
        controllers.read(path, "heidenhain", entry_sign=1)


# ---- Aerotech: only if the unit is stated; Mitsubishi: not at all ------------------------------------

AEROTECH = {
    "row_axis": 2,
    "column_axis": 4,
    "corrected_axis": 4,
    "column_sign": 1,
    "corrected_sign": 1,
}


def cal(text):
    """Return first line, keys and rows of numbers of a 2-D table, comments left out."""
    lines = [line.partition(";")[0].split() for line in text.splitlines()]
    lines = [line for line in lines if line]
    keys = dict(word.split("=") for word in lines[1][1:])
    return lines[0][1:], keys, np.array(lines[2:-1], dtype=float)


def test_aerotech_asks_for_the_unit_and_keeps_it(tmp_path):
    made = table(step=10)
    path = tmp_path / "c.cal"
    with pytest.raises(TableError, match=r"C turns, and no document.*position_unit=deg"):
        controllers.write(made, path, "aerotech-line", **AEROTECH)
    assert not path.exists()
    options = {**AEROTECH, "position_unit": "deg", "decimals": 6}
    controllers.write(made, path, "aerotech-line", verified_against=error, **options)

    head, keys, rows = cal(path.read_text())
    assert (keys["POSUNIT"], keys["CORUNIT"]) == ("PRIMARY", "PRIMARY/1000")
    assert [float(head[5]), int(head[6])] == [10.0, 37]
    column = rows[0][0::2]  # the axis is that of the columns: its value is the first of each pair
    lookup = controllers.simulate(path, "aerotech-line")
    unit = np.deg2rad(1e-9)
    for degrees in np.linspace(0, 360, 145):  # beyond the ends the value of the nearest one holds
        wanted = made.correction(np.deg2rad(degrees))[0]
        seen = np.deg2rad(1e-3 * np.interp(degrees, np.arange(0, 361, 10), column))
        assert abs(seen - wanted) < HALF * unit * 1.01
        assert abs(float(lookup(np.deg2rad(degrees), -1)) - wanted) < HALF * unit * 1.01
    assert json.loads((tmp_path / "c.cal.json").read_text())["options"]["position_unit"] == "deg"
    (tmp_path / "c.cal.json").unlink()
    back = controllers.read(path, "aerotech-line")
    assert (back.axis, back.compensates) == ("C", "C")


def test_aerotech_of_a_linear_axis_over_one_that_turns_and_the_other_way(tmp_path):
    angles = np.deg2rad(np.arange(0, 181, 20))
    wobble = CompensationTable(angles, 2e-6 * np.sin(angles), None, "C", "X", 0.0)
    path = tmp_path / "c.cal"
    options = {**AEROTECH, "corrected_axis": 1, "position_unit": "deg", "allow_unverified": True}
    controllers.write(wobble, path, "aerotech-line", **options)
    _, keys, rows = cal(path.read_text())
    assert (keys["POSUNIT"], keys["CORUNIT"]) == ("PRIMARY", "METRIC/1000")
    assert float(np.abs(rows[0].reshape(-1, 3)[:, 2] * 1e-6 - wobble.forward).max()) < 0.51e-10
    assert (
        float(np.abs(controllers.read(path, "aerotech-line").forward - wobble.forward).max())
        < 1e-10
    )
    straight = CompensationTable([0.0, 0.1, 0.2], [0.0, 1e-6, 0.0], None, "X", "X", 0.0)
    with pytest.raises(MetrosepError, match=r"position_unit=deg is for axes that turn"):
        controllers.write(straight, path, "aerotech-line", **{**AEROTECH, "position_unit": "deg"})
    mixed = CompensationMap([0.0, 0.1], [0.0, 1.0], np.zeros((2, 2)), ("X", "C"), "Z")
    numbers = {
        "row_axis": 2,
        "column_axis": 1,
        "corrected_axis": 3,
        "row_sign": 1,
        "column_sign": 1,
    }
    with pytest.raises(TableError, match=r"one of X and C turns"):
        controllers.write(
            mixed, path, "aerotech", corrected_sign=1, position_unit="deg", **numbers
        )


def test_mitsubishi_says_that_its_rotary_rule_was_not_found(tmp_path):
    with pytest.raises(
        TableError, match=r"C turns, and the rotary rule was not found in public pages"
    ):
        controllers.write(table(), tmp_path / "c.txt", "mitsubishi", output_unit="100 nm")
    assert list(tmp_path.iterdir()) == []


# ---- LinuxCNC: no modulo; the joint counts on beyond 360 deg -----------------------------------------


def test_linuxcnc_asks_for_the_travel_of_an_axis_that_may_turn_on(tmp_path):
    made, path = table(step=10), tmp_path / "c.comp"
    options = {"joint_type": "angular", "allow_unverified": True}
    with pytest.raises(MetrosepError, match=r"no modulo.*travel_low= and travel_high="):
        controllers.write(made, path, "linuxcnc", **options)
    with pytest.raises(
        MetrosepError, match=r"cover 0 deg \.\.\. 360 deg, the travel is 0 deg \.\.\. 720 deg"
    ):
        controllers.write(
            made, path, "linuxcnc", travel_low="0 deg", travel_high="720 deg", **options
        )
    with pytest.raises(MetrosepError, match=r"travel_high.*angle"):
        controllers.write(
            made, path, "linuxcnc", travel_low="0 deg", travel_high="300 mm", **options
        )
    assert not path.exists()
    controllers.write(made, path, "linuxcnc", travel_low="0 deg", travel_high="360 deg", **options)
    lookup = controllers.simulate(path, "linuxcnc")
    rows = np.array([line.split() for line in path.read_text().splitlines()], dtype=float)
    for degrees in np.linspace(-360, 720, 217):  # the ends hold
        wanted = made.correction(np.deg2rad(degrees))[0]
        seen = np.deg2rad(np.interp(degrees, rows[:, 0], rows[:, 0] - rows[:, 1]))
        assert abs(seen - wanted) < np.deg2rad(1e-10)
        assert abs(float(lookup(np.deg2rad(degrees))) - wanted) < np.deg2rad(1e-10)


def test_linuxcnc_part_of_a_turn_needs_no_travel(tmp_path):
    angles = np.deg2rad(np.linspace(-90, 90, 19))
    made = made_of(-error(angles), angles, "B")
    path = tmp_path / "b.comp"
    controllers.write(made, path, "linuxcnc", joint_type="angular", allow_unverified=True)
    assert controllers.read(path, "linuxcnc").axis == "B"


# ---- the dry-run: runs over angle, beyond one turn ----------------------------------------------------

MODULO = {
    "fanuc": ("c.txt", {**FANUC, "interval": "5 deg"}),
    "twincat": ("c.txt", {"modulo": True}),
    "isg-axis": ("c.lis", {"axis_number": 4, "modulo": True}),
    "pmac": ("c.pmc", {"count": "0.0001 deg"}),
    "heidenhain": ("c.com", {"resolution": "0.00001 deg"}),
    "sinumerik-enc": ("c.INI", {"machine_axis": "C1", "turns": True, "modulo": True}),
}


def runs_over_angle(first, last, n=5):
    """Return runs in both directions with noise of 0.05 arcsec, and a drift of each of 0.1 arcsec."""
    rng, angles = np.random.default_rng(7), np.deg2rad(np.arange(first, last + 0.5, 2.0))
    runs = []
    for k in range(n):
        for way in (1, -1):
            at = angles[::way]
            noise = rng.normal(0.0, 0.05, at.size) + 0.1 * rng.normal()
            runs.append(Run(at, error(at) + noise * ARCSEC, run_id=f"{k}{way:+d}"))
    return RunSet(runs)


@pytest.mark.parametrize("name", MODULO)
def test_dry_run_over_one_turn_and_beyond_the_table(tmp_path, name):
    """Runs from -90 to 450 deg: beyond the table the file repeats, so the error shrinks there too."""
    file, options = MODULO[name]
    path, runs = tmp_path / file, runs_over_angle(-90, 450)
    done = controllers.write(
        table(step=5), path, name, verified_against=runs, sign_confirmed=True, **options
    )
    assert done.passed
    assert done.after_pv < 0.1 * done.before_pv
    wrong = made_of(-table(step=5).forward, table(step=5).positions)
    with pytest.raises(SignCheckFailedError):
        controllers.write(
            wrong,
            tmp_path / f"w{file}",
            name,
            verified_against=runs,
            sign_confirmed=True,
            **options,
        )
    assert not (tmp_path / f"w{file}").exists()


def enc_words(text):
    """Return entries (deg), first, last and modulo of an ENC_COMP table; an entry is the error."""
    found = dict(re.findall(r"\$AA_ENC_COMP(\w*\[[^\]]+\])=(\S+)", text))
    entries = [float(v) for k, v in found.items() if k.startswith("[")]
    facts = {k.split("[")[0]: float(v) for k, v in found.items() if not k.startswith("[")}
    return entries, facts["_MIN"], facts["_MAX"], facts["_IS_MODULO"] == 1


def test_sinumerik_over_three_turns(tmp_path):
    made, path = table(step=10), tmp_path / "c.INI"
    options = {"machine_axis": "C1", "turns": True, "modulo": True}
    controllers.write(made, path, "sinumerik-enc", allow_unverified=True, **options)
    entries, low, high, modulo = enc_words(path.read_text())
    lookup = controllers.simulate(path, "sinumerik-enc")

    assert (low, high, modulo, len(entries)) == (0.0, 360.0, True, 37)
    assert entries[0] == entries[-1]
    at = np.linspace(low, high, len(entries))
    parsed = lambda degrees, _: -np.deg2rad(np.interp(degrees % 360.0, at, entries))  # noqa: E731
    assert over_three_turns(parsed, made, NINTH) < HALF + 1e-3
    ours = lambda degrees, way: lookup(np.deg2rad(degrees), way)  # noqa: E731
    assert over_three_turns(ours, made, NINTH) < HALF + 1e-3

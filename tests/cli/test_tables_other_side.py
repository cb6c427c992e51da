"""Tables of awkward lists, read as their control reads them by code of its own, on a machine made of numpy."""

import re

import numpy as np
import pytest

UM = 1e-3
"""A micrometre in mm."""
ARCSEC = 1.0 / 3600.0
"""An arc second in degrees."""
NOISE = 0.02
"""Standard deviation of a reading in um or arcsec; the mean of five cycles has half of that."""
LEFT = 6.0 * NOISE
"""What may be left P-V of a line of some dozen means of five readings, in um or arcsec."""

COLUMNS = ["--direction", "dir", "--readings", "r1,r2,r3,r4,r5"]
SENSE = ["--deviation", "reached-minus-target"]


def written(path, targets, error, *, unit, seed):
    """Write a list of five cycles; `error` is of (position, direction), in the unit of the readings."""
    rng = np.random.default_rng(seed)
    size = {"mm": "um", "deg": "arcsec"}[unit]
    lines = [f"target_{unit},dir," + ",".join(f"r{k}_{size}" for k in range(1, 6))]
    for way in (1, -1):
        for target in targets[::way]:
            readings = error(target, way) + rng.normal(0.0, NOISE, 5)
            fields = ",".join(f"{r:.4f}" for r in readings)
            lines.append(f"{target:.4f},{'+' if way > 0 else '-'},{fields}")
    path.write_text("\n".join(lines) + "\n")
    names = ",".join(f"r{k}_{size}" for k in range(1, 6))
    return [path, "--target", f"target_{unit}", "--direction", "dir", "--readings", names, *SENSE]


def left(correction, error, positions, scale):
    """Return P-V of each direction and the mean of reverse - forward of what is left, in um or arcsec."""
    ways = []
    for way in (1, -1):
        c = np.asarray(correction(positions, way))
        ways.append(c / scale + error(positions + c, way))
    return max(np.ptp(w) for w in ways), float(np.mean(ways[1] - ways[0]))


# ---- Turbo PMAC: entries in 1/16 count, one spacing from the zero of the motor on, modulo the span


def pmac(text, count):
    code = re.sub(r";.*", "", text)
    n, span, entries = re.search(r"DEFINE COMP (\d+),#1D,#1,(\d+)\s([-\d\s]+?)I51", code).groups()
    values = np.array([0, *map(int, entries.split())])
    assert values.size == int(n) + 1
    nodes = np.arange(int(n) + 1) * int(span) / int(n)
    return lambda p, way: (
        np.interp(np.mod(np.asarray(p) / count, int(span)), nodes, values) / 16 * count
    )


def travelled(p, way):
    return (
        -0.012 * p
        + 2 * np.sin(2 * np.pi * (p - 20) / 170)
        + 0.7 * np.sin(p / 23)
        - 1.1 * (way < 0)
    )


def test_a_table_of_the_machine_that_rolls_over_is_added_below_zero_too(tmp_path, metrosep):
    count = 1e-4
    zeroed = lambda p: 0.6 * (-0.012 * p + 2 * np.sin(2 * np.pi * (p - 20) / 170))  # noqa: E731
    at = np.arange(1, 26) * 20.0  # over 500 mm; the machine runs from -100 to 200 mm
    place = np.where(at > 200, at - 500, at)
    inside = (place >= -60) & (place <= 180)
    entries = np.where(
        inside, np.round(-16 * (zeroed(place) - zeroed(0.0)) * UM / count), 0
    ).astype(int)
    old = tmp_path / "old.pmc"
    old.write_text(
        f"#1 DELETE COMP\n#1 DEFINE COMP 25,#1D,#1,5000000\n{' '.join(map(str, entries))}\nI51=1\n"
    )
    before = pmac(old.read_text(), count)

    def seen(p, way):
        c = float(before(p, way))
        return c / UM + travelled(p + c, way)

    words = written(tmp_path / "run.csv", np.arange(-100.0, 201.0, 10.0), seen, unit="mm", seed=1)
    out = tmp_path / "new.pmc"
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--active", old, "--format", "pmac", "--machine", "count=100 nm",
        "-o", out,
    )  # fmt: skip
    assert code == 0, told
    assert ", -100 ... 200 mm," in told  # not the span of 500 mm
    positions = np.linspace(-100.0, 200.0, 1501)
    old_rest, _ = left(before, travelled, positions, UM)
    rest, _ = left(pmac(out.read_text(), count), travelled, positions, UM)
    assert old_rest > 6.0  # um: the old table is bad
    assert rest < LEFT + 0.05  # um: 50 nm of lines between the entries


# ---- controls that hold a table for each direction when they are told to


def twincat(text):
    found = []
    for body, structure in re.findall(
        r"TableElement := \[(.*?)\];.*?TableParameter := \((.*?)\);", text, re.DOTALL
    ):
        rows = np.array(re.findall(r"Position := (\S+), Compensation := (\S+)\)", body), float)
        way = re.search(r"WorkDirection(\w+)", structure)
        found.append((rows, "Both" if way is None else way[1], "Modulo := TRUE" in structure))

    def at(p, way):
        total = np.zeros(np.shape(p))
        for rows, which, turns in found:
            if which in ("Both", "Positive" if way > 0 else "Negative"):
                place = np.mod(p, 360.0) if turns else p
                total += np.interp(place, rows[:, 0], rows[:, 1])
        return total

    return at


def fanuc(text, unit, zero):
    words = {int(n): int(v) for n, v in re.findall(r"N(\d+)(?:A\d+)?P(-?\d+)", text)}
    number, low, high, larger, interval = (words[3620 + k] for k in range(5))

    def line(first, last, reference):
        steps = np.array([words[10000 + n] for n in range(first, last + 1)]) * unit * larger
        places = zero + interval * 1e-3 * (np.arange(first - 1, last + 1) - reference)
        curve = np.concatenate([[0.0], np.cumsum(steps)])
        return places, curve - np.interp(zero, places, curve)

    ahead = line(low, high, number)
    back = ahead
    if 3626 in words:
        first = words[3626]
        places, curve = line(first, first + high - low, first + number - low)
        back = places, curve + words[3627] * unit
    return lambda p, way: np.interp(p, *(ahead if way > 0 else back))


def lossy(p, way):
    return 2.5 * np.sin(2 * np.pi * (p + 7) / 190) + 0.011 * p - (1.3 + 0.002 * p) * (way < 0)


@pytest.mark.parametrize("control", ["twincat", "fanuc"])
def test_a_control_with_a_list_for_each_direction_gets_both(control, tmp_path, metrosep):
    targets = np.arange(-120.0, 181.0, 10.0)
    words = written(tmp_path / "run.csv", targets, lossy, unit="mm", seed=2)
    out = tmp_path / "x.txt"
    machine = ["bidirectional=True"]
    if control == "fanuc":
        machine += ["detection_unit=10 nm", "largest=127", "--sign-confirmed"]
    flags = [w for m in machine for w in (("--machine", m) if "=" in m else (m,))]
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--format", control, *flags, "-o", out
    )
    assert code == 0, told
    assert "is not in the table" not in told
    text = out.read_text()
    correction = twincat(text) if control == "twincat" else fanuc(text, 1e-5, 0.0)
    positions = np.linspace(-120.0, 180.0, 1201)
    rest, lost = left(correction, lossy, positions, UM)
    assert rest < LEFT + 0.1  # um: lines between the entries
    assert abs(lost) < NOISE


# ---- one zero of a list and a grid of one's own


@pytest.mark.parametrize(("reference", "spacing"), [(-107.67, 1.11), (-98.3, 1.25)])
def test_the_reference_is_an_entry_of_every_spacing(reference, spacing, tmp_path, metrosep):
    targets = np.array([-120.5, -117.2, -112.9, *np.sort([reference, -103.1]), -95.4, -90.8, -84.1, -78.3, -71.9, -66.2, -60.5])  # fmt: skip
    words = written(tmp_path / "run.csv", targets, lossy, unit="mm", seed=3)
    out = tmp_path / "x.txt"
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--format", "fanuc", "--reference", f"{reference} mm",
        "--spacing", f"{spacing} mm", "--machine", "detection_unit=10 nm", "--machine", "largest=127",
        "--sign-confirmed", "-o", out,
    )  # fmt: skip
    assert code == 0, told
    low, high = reference % spacing - 121.0, -61.7
    positions = np.linspace(low + 1.2, high, 1201)
    correction = fanuc(out.read_text(), 1e-5, reference)
    before = max(np.ptp(lossy(positions, way)) for way in (1, -1))
    rest, _ = left(correction, lossy, positions, UM)
    assert rest < 0.1 * before + LEFT
    assert abs(float(correction(reference, 1))) < 1e-12  # mm


def test_a_format_that_takes_any_positions_keeps_its_ends(tmp_path, metrosep):
    targets = np.array([-120.0, -113.2, -104.9, -98.3, -88.1, -80.4, -71.8, -60.0])
    words = written(tmp_path / "run.csv", targets, lossy, unit="mm", seed=9)
    out = tmp_path / "x.comp"
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--reference", "-98.3 mm", "--spacing", "5 mm", "-o", out
    )
    assert code == 0, told
    nominal, ahead, _ = np.loadtxt(out, unpack=True)
    assert np.array_equal(nominal, np.sort([*np.arange(-120.0, -59.0, 5.0), -98.3]))
    assert ahead[nominal == -98.3] == -98.3


# ---- one turn, whose readings at 0 and 360 degrees are never the same number


def rotary(p, way):
    a = np.radians(p)
    return 9 * np.sin(a + 0.4) + 4 * np.cos(2 * a) + 2.5 * np.sin(3 * a + 1) - 3.0 * (way < 0)


def sinumerik(text, name):
    rows = {int(i): float(v) for i, v in re.findall(rf"\$A._{name}\[0,(\d+)[^\]]*\]=(\S+)", text)}
    step, low, high, turns = (
        float(re.search(rf"_{name}_{w}\[0[^\]]*\]=(\S+)", text)[1]) for w in ("STEP", "MIN", "MAX", "IS_MODULO")
    )  # fmt: skip
    places = low + step * np.arange(len(rows))
    values = [rows[i] for i in range(len(rows))]
    assert turns == 1
    assert high == places[-1]
    return lambda p, way: -np.interp(low + np.mod(np.asarray(p) - low, high - low), places, values)


TURNING = {
    "twincat": (["modulo=True"], twincat),
    "sinumerik-enc": (
        ["machine_axis=C1", "modulo=True", "turns=True"],
        lambda t: sinumerik(t, "ENC_COMP"),
    ),
    "pmac": (["count=0.0001 deg"], lambda t: pmac(t, 1e-4)),
}


@pytest.mark.parametrize("reference", [0, 90])
@pytest.mark.parametrize("control", TURNING)
def test_a_turn_with_noise_at_its_ends_is_closed(control, reference, tmp_path, metrosep):
    if control == "pmac" and reference:
        pytest.skip("the zero of a PMAC's motor is the zero of its table")
    targets = np.arange(0.0, 361.0, 15.0)
    words = written(tmp_path / "run.csv", targets, rotary, unit="deg", seed=4)
    machine, reader = TURNING[control]
    out = tmp_path / "c.txt"
    code, _, told = metrosep(
        "table", *words, "--axis", "C", "--format", control, "--reference", f"{reference} deg",
        *[w for m in machine for w in ("--machine", m)], "-o", out,
    )  # fmt: skip
    assert code == 0, told
    assert "0 and 360 deg are one place" in told
    positions = np.linspace(-360.0, 720.0, 4321)
    rest, _ = left(reader(out.read_text()), rotary, positions, ARCSEC)
    assert rest < LEFT + 0.7  # arcsec: lines over 15 degrees of the third harmonic


def test_a_turn_that_does_not_come_back_is_refused(tmp_path, metrosep):
    drifting = lambda p, way: rotary(p, way) + p / 360.0 * 20 * NOISE  # noqa: E731
    targets = np.arange(0.0, 361.0, 15.0)
    words = written(tmp_path / "run.csv", targets, drifting, unit="deg", seed=5)
    code, _, told = metrosep(
        "table", *words, "--axis", "C", "--format", "twincat", "--machine", "modulo=True", "-o", tmp_path / "c.txt",
    )  # fmt: skip
    assert code == 2
    assert "the values at 0 and 360 deg must be the same" in told
    assert not (tmp_path / "c.txt").exists()


# ---- a unit typed wrong: an error of millimetres


def test_micrometres_read_as_millimetres_are_refused(tmp_path, metrosep):
    targets = np.arange(-120.0, 181.0, 20.0)
    words = written(tmp_path / "run.csv", targets, lossy, unit="mm", seed=6)
    text = (tmp_path / "run.csv").read_text().replace("_um", "_mm")
    (tmp_path / "run.csv").write_text(text)
    words = [str(w).replace("_um", "_mm") for w in words]
    out = tmp_path / "x.comp"
    code, _, told = metrosep("table", *words, "--axis", "X", "-o", out)
    assert code == 1
    assert (
        "check the units of the readings; if they are right, state the stroke of the axis" in told
    )
    assert not out.exists()
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--machine", "stroke=10 mm", "-o", out
    )
    assert code == 0, told


# ---- a file of the control alone, which does not say where its axis is referenced


@pytest.mark.parametrize(("way", "grade"), [(1, "accepted"), (-1, "refused")])
def test_a_file_without_sidecar_is_judged_from_where_it_is_zero(way, grade, tmp_path, metrosep):
    zero = lossy(0.0, 1)
    nodes = np.arange(-100.0, 201.0, 12.5)
    body = "".join(
        f"$AA_ENC_COMP[0,{i},X1]={way * (lossy(p, 1) - zero) * UM:.6f}\n"
        for i, p in enumerate(nodes)
    )
    ends = "".join(
        f"$AA_ENC_COMP_{name}[0,X1]={value}\n"
        for name, value in (("STEP", 12.5), ("MIN", -100.0), ("MAX", 200.0), ("IS_MODULO", 0))
    )
    file = tmp_path / "eec.ini"
    file.write_text(f"%_N_AX_EEC_INI\nCHANDATA(1)\n{body}{ends}M17\n")
    run, *words = written(tmp_path / "run.csv", nodes, lossy, unit="mm", seed=7)
    code, out, told = metrosep(
        "verify", file, "--against", run, *words, "--format", "sinumerik-enc"
    )
    assert code == (0 if way > 0 else 1), told
    assert grade in out + told
    assert "zero of the machine moves" not in out + told


# ---- Turbo PMAC: lost motion in a table of its own


def test_a_backlash_table_alone_names_the_table_that_it_belongs_to(tmp_path, metrosep):
    rising = lambda p, way: lossy(p, 1) + (1.3 + 0.002 * p) * (way < 0)  # noqa: E731
    words = written(
        tmp_path / "run.csv", np.arange(-120.0, 181.0, 20.0), rising, unit="mm", seed=8
    )
    size = ["--axis", "X", "--machine", "count=100 nm"]
    out, ahead = tmp_path / "back.pmc", tmp_path / "ahead.pmc"
    code, _, told = metrosep("table", *words, *size, "--format", "pmac-backlash", "-o", out)
    assert code == 1
    assert "this file alone leaves the error of one direction as it is" in told
    assert 'name their file in --machine "comp=...' in told
    forward = ["--format", "pmac", "--table-direction", "forward", "-o", ahead]
    code, _, told = metrosep("table", *words, *size, *forward)
    assert code == 0, told
    both = ["--format", "pmac-backlash", "--machine", f"comp={ahead}", "-o", out]
    code, _, told = metrosep("table", *words, *size, *both)
    assert code == 0, told


def test_a_turn_stays_one_whose_reference_is_no_multiple_of_the_spacing(tmp_path, metrosep):
    """Counted from 10 deg on, entries every 15 deg would end at 355: no turn, and a jump where C rolls over."""
    places = np.arange(0.0, 361.0, 2.0)
    rows = [f"{p},{rotary(p, 1) + 0.01 * k:.4f},{k}" for k in range(3) for p in places]
    (tmp_path / "c.csv").write_text("\n".join(["c_deg,z_um,run", *rows]) + "\n")
    out = tmp_path / "c.txt"
    code, _, told = metrosep(
        "table", tmp_path / "c.csv", "--x", "c_deg", "--z", "z_um", "--run", "run", "--method", "mean", "--axis", "C",
        "--compensates", "Z", "--format", "csv", "--reference", "10 deg", "--spacing", "15 deg", "-o", out,
    )  # fmt: skip
    assert code in (0, 3), told
    assert "0 ... 360 deg, 26 entries" in told  # and the reference


@pytest.mark.parametrize(("spacing", "is_said"), [(25.0, True), (1.0, False)])
def test_what_the_entries_do_not_reach_is_said(spacing, is_said, tmp_path, metrosep):
    """Entries every 25 mm from 7.3 mm on end at 82.3 mm; of 100 mm that were measured 17.7 mm are not corrected."""
    error = lambda p, way: 5.0 * np.sin(2 * np.pi * p / 170) + 0.03 * p  # noqa: E731
    words = written(tmp_path / "run.csv", np.arange(0.0, 101.0, 5.0), error, unit="mm", seed=7)
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--reference", "7.3 mm", "--spacing", f"{spacing} mm",
        "--format", "sinumerik-enc", "--machine", "machine_axis=X1", "-o", tmp_path / "x.ini",
    )  # fmt: skip
    assert code == 0, told
    said = "the entries reach over 7.3 ... 82.3 mm, the error is known over 0 ... 100 mm"
    assert (said in told) is is_said


# ---- files of a control that were active, as others write them


AT = np.arange(-210.0, 331.0, 20.0)
"""Nodes of an old file; the reference 0 mm lies between two of them."""


def believed(p, way):
    """The error in mm as somebody once had it: six tenths of its size, and a slope that is wrong."""
    return UM * (0.6 * lossy(p, way) - 0.008 * p)


def old_enc():
    rows = "".join(f"$AA_ENC_COMP[0,{k},AX1]={believed(p, 1):.6f}\r\n" for k, p in enumerate(AT))
    ends = "".join(
        f"$AA_ENC_COMP_{k}[0,AX1]={v}\r\n"
        for k, v in (("STEP", 20), ("MIN", -210), ("MAX", 330), ("IS_MODULO", 0))
    )
    return f"%_N_AX1_EEC_INI\r\n;$PATH=/_N_CEC_DIR\r\nCHANDATA(1)\r\n{rows}{ends}M17\r\n"


def old_com():
    """A table whose columns have the widths of another control, and a column of another axis."""
    titles = f"{'NR':8}{'AXISPOS':12}{'BACKLASH':12}{'X':12}Z"
    rows = [
        f"{k:<8d}{p:<+12.4f}{believed(p, -1):<+12.4f}{believed(p, 1):<+12.4f}{1e-4 * k:+.4f}"
        for k, p in enumerate(AT)
    ]
    return "\r\n".join(["BEGIN XACHSE.COM MM", titles, *rows, "[END]", ""])


def old_gvl():
    """A list of variables as an engineer types it: an attribute, remarks, from 0 on, whole numbers, own names."""
    rows = [f"\t(Position:={p:.0f}, Compensation:={-believed(p, 1):.6f})" for p in AT]
    rows[0] += ", // home side"
    body = rows[0] + "\n" + ",\n".join(rows[1:])
    return (
        "{attribute 'qualified_only'}\nVAR_GLOBAL CONSTANT\n\taComp : ARRAY [0..27] OF "
        f"ST_PositionCompensationTableElement := [\n{body}\n\t];\n\tstComp : "
        "ST_PositionCompensationTableParameter := (\n\t\tNoOfTableElements := 28, MinPosition := -210,\n"
        "\t\tMaxPosition := 330.0, Direction := E_WorkDirection.WorkDirectionBoth );\nEND_VAR\n"
    )


def enc(text):
    rows = {int(i): float(v) for i, v in re.findall(r"_COMP\[0,(\d+),AX1\]=(\S+)", text)}
    step, low = (float(re.search(rf"_{w}\[0,AX1\]=(\S+)", text)[1]) for w in ("STEP", "MIN"))
    places = low + step * np.arange(len(rows))
    return lambda p, way: -np.interp(p, places, [rows[i] for i in range(len(rows))])


def com(text):
    rows = np.array([line.split()[1:4] for line in text.splitlines() if line[:1].isdigit()], float)
    return lambda p, way: -np.interp(p, rows[:, 0], rows[:, 2 if way > 0 else 1])


@pytest.mark.parametrize(
    ("control", "old", "lookup", "more"),
    [
        ("sinumerik-enc", old_enc, enc, ["machine_axis=AX1"]),
        ("heidenhain", old_com, com, ["looked_up_axis=X"]),
        ("twincat", old_gvl, twincat, []),
    ],
)
def test_a_file_of_the_control_that_was_active_is_added_to(
    control, old, lookup, more, tmp_path, metrosep
):
    file, out = tmp_path / "old.txt", tmp_path / "new.txt"
    file.write_bytes(old().encode("ascii"))
    was = lambda p, way: (  # noqa: E731
        np.interp(p, AT, -believed(AT, way if control == "heidenhain" else 1))
    )

    def seen(p, way):
        c = float(was(p, way))
        return c / UM + lossy(p + c, way)

    targets = np.array([*AT[:11], 0.0, *AT[11:]])
    words = written(tmp_path / "run.csv", targets, seen, unit="mm", seed=11)
    flags = [w for m in more for w in ("--machine", m)]
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--reference", "0 mm", "--spacing", "20 mm", "--format", control, *flags,
        "--sign-confirmed", "--active", file, "-o", out,
    )  # fmt: skip
    assert code == 0, told
    correction = lookup(out.read_text())
    positions = np.linspace(-200.0, 320.0, 1201)
    if control == "heidenhain":
        before, rest = (left(c, lossy, positions, UM)[0] for c in (was, correction))
    else:  # one column: the middle of both directions
        before, rest = (
            np.ptp(
                sum(c(positions, 1) / UM + lossy(positions + c(positions, 1), w) for w in (1, -1))
                / 2
            )
            for c in (was, correction)
        )
    assert before > 3.0  # um
    assert rest < LEFT + 0.4  # um: lines between entries 20 mm apart, of a wave of 190 mm
    if control == "sinumerik-enc":
        assert (
            abs(float(correction(0.0, 1))) < 1e-9
        )  # mm: the axis does not jump when it is referenced
        assert "was subtracted so that the correction is zero at the reference 0 m" in told


# ---- mistakes of the one who wrote the list


@pytest.mark.parametrize(
    ("targets", "readings", "units"),
    [
        ("mm", "um", "mm and um, or m and mm"),
        ("in", "mm", "inches and mm"),
        ("mm", "in", "inches and mm"),
    ],
)
@pytest.mark.parametrize("sense", [[], SENSE])
def test_readings_with_the_numbers_of_the_targets_in_another_unit_are_refused(
    targets, readings, units, sense, tmp_path, metrosep
):
    """Positions in mm below a title in um were taken for deviations: a table of -999 um/m was accepted."""
    rng = np.random.default_rng(5)
    lines = [f"target_{targets},dir," + ",".join(f"r{k}_{readings}" for k in range(3))]
    for p in np.arange(-118.0, 395.0, 27.0):
        values = p + UM * (lossy(p, 1) + rng.normal(0.0, NOISE, 3))
        lines.append(f"{p:.3f},+," + ",".join(f"{v:.5f}" for v in values))
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    names = ",".join(f"r{k}_{readings}" for k in range(3))
    code, _, told = metrosep(
        "table", tmp_path / "run.csv", "--target", f"target_{targets}", "--direction", "dir", "--readings", names,
        *sense, "--axis", "X", "-o", tmp_path / "x.comp",
    )  # fmt: skip
    assert code == 4, told
    assert f"the unit of a column is wrong ({units})" in told
    assert not (tmp_path / "x.comp").exists()


def test_what_one_column_leaves_of_a_lost_motion_is_said(tmp_path, metrosep):
    """0.5 um of pitch and 6 um of lost motion: one column takes the pitch, which is little of both."""
    error = lambda p, way: 0.5 * np.sin(2 * np.pi * p / 170) - 6.0 * (way < 0)  # noqa: E731
    words = written(tmp_path / "run.csv", np.arange(0.0, 171.0, 10.0), error, unit="mm", seed=12)
    code, _, told = metrosep(
        "table", *words, "--axis", "X", "--format", "sinumerik-enc", "--machine", "machine_axis=X1", "-o",
        tmp_path / "x.ini",
    )  # fmt: skip
    assert code == 1
    stays = re.search(r"a lost motion \(reverse - forward\) of (-[\d.]+) nm stays", told)
    assert stays, told
    assert abs(float(stays[1]) + 6000.0) < 1e3 * NOISE
    assert "set it as the backlash of the control" in told

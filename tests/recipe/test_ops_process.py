"""Steps with models of the process: each gives what was planted, and refuses what says nothing."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    InvalidSamplesError,
    LimitError,
    MetrosepError,
    NameNotFoundError,
    RecipeError,
    TooFewSamplesError,
)

SURFACE = 'form = "sine_grid: amplitude=50 nm, wavelength=100 um"\n'
JOB = 'radius = "60 um"\nfeed = "2 um"\nrpm = 20\n'
STEP = 'length_step = "5 um"\n'
LOG = 'follow_up = "log.csv"\n'
ROLES = 'time = "t_s"\ncommand = "command_um"\nactual = "actual_um"\n'
CV, CA = -2e-3, -7.5e-4
"""Planted: the axis lags by 2 ms, and has no acceleration feedforward."""


def run(op, text, columns="", files=None):
    head = f"metrosep = 1\n[input]\n{columns}\n" if columns or files else "metrosep = 1\n"
    return ms.Recipe.parse(f'{head}[[step]]\nop = "{op}"\n{text}').run(files)


def found(result):
    return {c["metric"]: (c["value"], c["u"]) for c in result.document["characteristics"]}


def write(path, header, columns):
    rows = (",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([header, *rows]) + "\n", "ascii")
    return path


@pytest.fixture
def log(tmp_path, monkeypatch):
    """Write the dry run of a part of 60 um radius with another surface: two harmonics of the turn."""
    monkeypatch.chdir(tmp_path)
    w = 2 * np.pi * 20 / 60
    return dry_run(tmp_path, lambda t: 50e-9 * (np.sin(3 * w * t) + 0.4 * np.cos(w * t)))


def grid_command(t):
    """Return the height of the sine grid, which is even in y, on the spiral of the part."""
    turn = 2 * np.pi * 20 / 60 * t
    rho, k = 60e-6 - 2e-6 * turn / (2 * np.pi), 2 * np.pi / 100e-6
    return 50e-9 * (np.sin(k * rho * np.cos(turn)) + np.cos(k * rho * np.sin(turn)))


def dry_run(tmp_path, command):
    t = np.arange(0.0, 88.0, 0.02)

    h = 1e-4
    v = (command(t + h) - command(t - h)) / (2 * h)
    a = (command(t + h) - 2 * command(t) + command(t - h)) / h**2
    actual = command(t) + CV * v + CA * a
    return write(
        tmp_path / "log.csv", "t_s,command_um,actual_um", [t, 1e6 * command(t), 1e6 * actual]
    )


def test_follow_up_finds_the_planted_terms(log):
    values = found(run("follow_up", "", ROLES, [log]))

    assert values["cv"][0] == pytest.approx(CV, abs=2e-5)
    assert values["ca"][0] == pytest.approx(CA, abs=5e-6)
    assert values["acceleration.share"][0] + values["velocity.share"][0] == pytest.approx(
        1, abs=0.02
    )


def test_follow_up_takes_a_logged_error_with_its_sign(tmp_path, log):
    t, command, actual = np.loadtxt(log, delimiter=",", skiprows=1).T
    file = write(
        tmp_path / "fe.csv", "t_s,command_um,fe_nm", [t, command, 1e3 * (command - actual)]
    )
    columns = 'time = "t_s"\ncommand = "command_um"\nerror = "fe_nm"\n'

    right = found(run("follow_up", 'error_sign = "command-actual"\n', columns, [file]))
    wrong = found(run("follow_up", "", columns, [file]))

    assert right["ca"][0] == pytest.approx(CA, abs=5e-6)
    assert wrong["ca"][0] == pytest.approx(-CA, abs=5e-6)


def test_predict_adds_maps_and_makes_up_for_them(log):
    text = SURFACE + JOB + STEP + LOG + 'core = "4 um"\ndx = "-0.5 um"\nu_dx = "10 nm"\n'
    result = run("predict", text)
    values = found(result)

    # dx moves the sine along the radius: 2 A k |dx| along each axis, both axes at once on the map
    assert 31.4e-9 / 10 < values["tool setting.pv"][0] < 2 * 31.4e-9 / 10 * 1.05
    _, command, actual = np.loadtxt(log, delimiter=",", skiprows=1).T
    assert values["follow-up.pv"][0] == pytest.approx(1e-6 * np.ptp(actual - command), abs=2e-10)
    assert values["pointwise"][0] <= values["sum"][0]
    assert values["residual.dx"][0] == pytest.approx(
        values["tool setting.pv"][0] / 50, abs=2e-11
    )  # 10 nm of 0.5 um
    assert result.document["separation"]["audit"]["file log.csv"].startswith("SHA-256 ")


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
def test_log_lies_on_the_spiral_of_either_sense(log, sense):
    """A log has time only: it belongs to the path whichever way the part turns."""
    result = run("predict", SURFACE + JOB + STEP + LOG + f'core = "4 um"\nsense = "{sense}"\n')

    prediction = result.produced.prediction
    late = prediction.maps["follow-up"]
    t = (60e-6 - prediction.rho) / 2e-6 * 3.0
    time, command, actual = np.loadtxt(log, delimiter=",", skiprows=1).T
    known = np.isfinite(late)
    expected = np.interp(t[known], time, 1e-6 * (actual - command))
    assert np.abs(late[known] - expected).max() < 1e-11


def test_log_of_the_surface_corrects_the_program_and_another_does_not(tmp_path, log):
    """A log of another part must leave the program alone, and the result must say so."""
    text = SURFACE + JOB + STEP + LOG + 'core = "4 um"\n'
    other = run("predict", text)
    assert other.produced.program is None
    assert any("NOT corrected by the log" in m for m in other.document["messages"])

    dry_run(tmp_path, grid_command)
    right = run("predict", text)
    assert np.nanmax(np.abs(right.produced.program.change)) > 1e-9
    assert not any("NOT corrected" in m for m in right.document["messages"])

    dry_run(tmp_path, lambda t: -grid_command(t))
    turned = run("predict", text)
    assert turned.produced.program is None
    assert any("Z points into the material" in m for m in turned.document["messages"])


def test_another_surface_leaves_the_setting_to_be_made_up_for(log):
    text = SURFACE + JOB + STEP + 'core = "4 um"\ndx = "-0.5 um"\n'
    both, alone = (run("predict", text + t).produced.program.change for t in (LOG, ""))
    assert np.array_equal(both, alone, equal_nan=True)


@pytest.mark.parametrize("rpm", ['"20 rpm"', '"20"', '"20 1/min"', "20.0"])
def test_spindle_speed_takes_its_unit(rpm):
    values = found(run("predict", SURFACE + JOB.replace("= 20", f"= {rpm}") + STEP))
    assert values["time"][0] == pytest.approx(90.0, abs=1e-9)  # 30 turns at 20 a minute


def test_plan_gives_blocks_and_tolerances_of_the_setting():
    values = found(run("predict", SURFACE + JOB + 'tolerance = "2 nm"\n'))

    assert values["program.pv"][0] <= 2e-9
    assert values["n_blocks"][0] == pytest.approx(60 / 2 * 2 * np.pi / 0.34, abs=700)
    # one axis: 2 A k |dx|; the map adds the other: the allowed |dx| is at most that of one
    assert 0.3 * 2e-9 < values["allowed.dx"][0] * 2 * 50e-9 * 2 * np.pi / 100e-6 <= 2.02e-9


def test_a_pv_without_a_map_is_not_added_pointwise():
    result = run("predict", SURFACE + JOB + STEP + 'follow_up_pv = "13 nm"\nmeasured = "40 nm"\n')
    values = found(result)

    assert "pointwise" not in values
    assert values["sum"][0] == pytest.approx(values["program.pv"][0] + 13e-9, abs=1e-15)
    assert values["measured"][0] == 40e-9
    assert any("P-V only" in m for m in result.document["messages"])


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        (JOB + STEP + 'angle_step = "2 deg"\n', DataError, "give one of tolerance"),
        (JOB, DataError, "got none"),
        (JOB + STEP + 'dx = "1"\n', RecipeError, "has no unit"),
        (JOB + STEP + 'measured = "-3 nm"\n', RecipeError, "zero or more"),
        (JOB + STEP + 'distribution = "CA"\n', DataError, "belongs to the distribution CAL"),
        (JOB + STEP + 'dy = "80 um"\n', DataError, "dy = 80 um: nothing nearer"),
        (JOB + STEP + 'core = "70 um"\n', DataError, "core must lie"),
        (JOB + STEP + "gain = 0.5\n", DataError, "gain is the share"),
        (JOB + STEP + 'dx = "1 um"\ngain = 2\n', DataError, "gain must be between 0 and 1"),
        (JOB + STEP + 'log_time = "t_s"\n', DataError, "give its file"),
        (JOB + STEP + 'removed = "focus"\n', DataError, "'focus'"),
        (JOB + STEP + 'follow_up = "none.csv"\n', MetrosepError, "no such file"),
        (JOB + STEP + LOG + 'follow_up_pv = "3 nm"\n', DataError, "not both"),
        (JOB + STEP + LOG + 'log_time = "s"\n', FormatMismatchError, "no time column 's'"),
        (JOB.replace("60", "40") + STEP + LOG, DataError, "before the log ends"),
        (JOB.replace("= 20", '= "20 Hz"') + STEP, DataError, "not a number of turns per minute"),
        (JOB.replace("= 20", "= 0") + STEP, DataError, "rpm must be above zero, got 0"),
    ],
)
def test_predict_refuses(log, text, kind, words):
    with pytest.raises(kind, match=words):
        run("predict", SURFACE + text)


@pytest.mark.parametrize("step", [STEP, 'tolerance = "5 nm"\n'])
def test_surface_that_ends_before_the_part_is_named(step):
    with pytest.raises(InvalidSamplesError, match="height nan at x ="):
        run("predict", 'form = "sphere: R=50 um"\n' + JOB + step)


@pytest.mark.parametrize(
    ("text", "columns", "kind", "words"),
    [
        ("", 'command = "command_um"\nactual = "actual_um"\n', RecipeError, "time"),
        ("", ROLES.replace("t_s", "clock"), FormatMismatchError, "no time column"),
        ("", 'time = "t_s"\ncommand = "command_um"\n', NameNotFoundError, "'actual'"),
        ('spiral = ["60 um", "2 um"]\n', ROLES, DataError, "spindle speed"),
        ('spiral = ["60 um"]\nrpm = 20\n', ROLES, DataError, "two lengths"),
        ('spiral = ["20 um", "2 um"]\nrpm = 20\n', ROLES, DataError, "before the log ends"),
        ('terms = ["speed"]\n', ROLES, DataError, "'speed'"),
        ('delay = "2 ms"\nestimate_delay = true\n', ROLES, DataError, "one of them"),
        ('error_sign = "command-actual"\n', ROLES, DataError, "name its column"),
    ],
)
def test_follow_up_refuses(log, text, columns, kind, words):
    with pytest.raises(kind, match=words):
        run("follow_up", text, columns, [log])


def test_follow_up_of_three_samples_is_refused(tmp_path):
    file = write(tmp_path / "s.csv", "t_s,command_um,actual_um", np.ones((3, 3)) * [1, 2, 3])
    with pytest.raises(TooFewSamplesError, match="has 3"):
        run("follow_up", "", ROLES, [file])


STAGE = 'voltage = "voltage_V"\ndisplacement = "displacement_um"\n'


def test_calibration_of_a_line_and_its_loop(tmp_path):
    """Acceptance row 24: 16.6 um over 10 V is 1.66 um/V; a loop of 0.2 um is 1.2 % of it."""
    up = np.linspace(0.0, 10.0, 41)
    v = np.r_[up, up[-2::-1]]
    loop = 0.1 * 4 * (v / 10) * (1 - v / 10) * np.r_[-np.ones(41), np.ones(40)]
    file = write(tmp_path / "s.csv", "voltage_V,displacement_um", [v, 1.66 * v + loop])
    values = found(run("flexure_calibration", 'line = "end-point"\n', STAGE, [file]))

    assert values["sensitivity"][0] == pytest.approx(1.66e-6, abs=1e-15)
    assert values["nonlinearity"][0] == pytest.approx(0.0, abs=1e-9)
    assert values["hysteresis"][0] == pytest.approx(0.2 / 16.6, abs=1e-9)


def test_calibration_without_an_inverse_is_refused(tmp_path):
    rows = [[0, 1, 2, 3, 4, 5], [0, 1.6, 1.2, 4.8, 6, 8]]
    file = write(tmp_path / "s.csv", "voltage_V,displacement_um", rows)
    with pytest.raises(InvalidSamplesError, match="not monotone at 2 V"):
        run("flexure_calibration", "", STAGE, [file])


RUNS = 'readings = ["z_um"]\nx = "x_mm"\nrepeat = "run"\n'
SENSITIVITY = 'sensitivity = "1.66 um"\n'


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """Write three runs whose error is the negative of the paper's polynomial, a slope each."""
    monkeypatch.chdir(tmp_path)
    x = np.arange(0.0, 40.5, 1.0)
    z = -(0.3389 + 0.48246 * x - 0.00605 * x**2)
    columns = [np.repeat([1, 2, 3], x.size), np.tile(x, 3)]
    drift = np.concatenate([z + d * (x - 20) / 1e3 for d in (-1, 0, 1)])
    return write(tmp_path / "runs.csv", "run,x_mm,z_um", [*columns, drift])


def servo(runs, text):
    return run("dual_servo", text, RUNS, [runs])


def test_dual_servo_of_the_paper(runs):
    """Acceptance rows 25 and 27: P-V 9.6185 um, 2.42 um straightness, 0.2042 to 5.998 V."""
    result = servo(runs, 'quantity = "error"\ndegree = 2\n' + SENSITIVITY)
    values = found(result)

    for k, c in enumerate((-0.3389e-6, -0.48246e-3, 0.00605)):
        assert values[f"c{k}"][0] == pytest.approx(c, abs=1e-6 * abs(c))
    assert values["total"][0] == pytest.approx(9.6185e-6, abs=1e-9)
    assert values["straightness.end-point"][0] == pytest.approx(2.42e-6, abs=1e-9)
    assert values["voltage_min"][0] == pytest.approx(0.2042, abs=1e-4)
    assert values["voltage_max"][0] == pytest.approx(5.998, abs=1e-3)
    assert values["violations"][0] == 0


def test_dual_servo_of_the_other_sign_is_flagged(runs):
    text = 'quantity = "compensation"\ndegree = 2\n' + SENSITIVITY
    with pytest.raises(LimitError, match=r"negative voltage.*offset=.*are assumed"):
        servo(runs, text)
    result = servo(runs, text + "strict = false\n")
    values = found(result)

    assert values["voltage_min"][0] == pytest.approx(-5.998, abs=1e-3)
    assert values["violations"][0] >= 1
    assert any("does not keep a limit" in m for m in result.document["messages"])


def test_stroke_and_slew_are_checked(runs):
    text = 'quantity = "error"\ndegree = 2\ntravel = "8 um"\nspeed = "6000 mm/min"\nslew = 1\n'
    with pytest.raises(LimitError, match=r"stroke.*V/s"):
        servo(runs, text + SENSITIVITY)
    result = servo(runs, text + SENSITIVITY + "strict = false\n")
    words = " ".join(result.document["messages"])

    assert found(result)["violations"][0] == 2
    assert "stroke" in words or "travel" in words
    assert "V/s" in words


@pytest.mark.parametrize("limits", ["[0, 5]", '"0 V,5 V"', '["0 V", "5 V"]'])
def test_limits_and_sensitivity_take_their_units(runs, limits):
    """The table of the paper needs 0.2042 to 5.998 V: 5 V are not enough, and 6 V are."""
    text = 'quantity = "error"\ndegree = 2\nsensitivity = "1.66 um/V"\nlimits = '
    with pytest.raises(LimitError, match=r"lies outside 0 \.\.\. 5 V by 0\.99"):
        servo(runs, text + limits + "\n")
    assert found(servo(runs, text + limits.replace("5", "6") + "\n"))["violations"][0] == 0


def test_columns_of_a_sweep_are_named(tmp_path, runs):
    write(tmp_path / "sweep.csv", "u_V,d_um", [np.arange(0.0, 11.0), 1.66 * np.arange(0.0, 11.0)])
    text = 'quantity = "error"\ncalibration = "sweep.csv"\n'
    with pytest.raises(FormatMismatchError, match=r"voltage=.* and displacement="):
        servo(runs, text)
    with pytest.raises(FormatMismatchError, match=r"sweep: displacement="):
        servo(runs, text + 'voltage = "u_V"\n')


def test_table_is_as_fine_as_the_converter(runs):
    result = servo(runs, 'quantity = "error"\ndegree = 2\nbits = 4\n' + SENSITIVITY)

    steps = result.produced.table.voltage / (10.0 / 15)
    assert (
        min(
            abs(steps - np.rint(steps)).max(),
            abs(steps * 16 / 15 - np.rint(steps * 16 / 15)).max(),
        )
        < 1e-9
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "give either calibration"),
        (SENSITIVITY + "limits = [0]\n", "two voltages, got 1"),
        (SENSITIVITY + "limits = 10\n", "two voltages, got 1"),
        (SENSITIVITY + 'limits = ["0 V", "10 mm"]\n', "'10 mm' is not a voltage"),
        (SENSITIVITY + "limits = [true, 10]\n", "True is not a voltage"),
        (SENSITIVITY.replace("1.66 um", "1.66"), "has no unit"),
        (SENSITIVITY.replace("1.66 um", "-1 um/V"), "more than zero"),
        (SENSITIVITY + "limits = [10, 0]\n", "lower and the upper"),
        (SENSITIVITY + 'table_step = "1 nm"\n', "40000001 voltages"),
        (SENSITIVITY + 'table_step = "90 mm"\n', "gives 1 voltages"),
        (SENSITIVITY + 'before = "a.csv"\n', "only before is given"),
        (SENSITIVITY + 'voltage = "v"\n', "voltage belongs to calibration"),
        (SENSITIVITY + 'resolution = "5 nm"\n', "resolution belongs to at_rest"),
        (SENSITIVITY + 'lambda_s = "5 um"\n', "lambda_s belongs to before"),
        (SENSITIVITY + "degree = 2\nmax_degree = 4\n", "max_degree bounds a search"),
        (SENSITIVITY + "degree = 90\n", "degree must be a whole number from 0 to 20"),
        (SENSITIVITY + "bits = 0\n", "bits must be a whole number from 1 to 32"),
        ('calibration = "none.csv"\n', "no such file"),
    ],
)
def test_dual_servo_refuses(runs, text, words):
    with pytest.raises(MetrosepError, match=words):
        servo(runs, 'quantity = "error"\n' + text)


def test_dual_servo_needs_what_the_runs_hold(runs):
    with pytest.raises(RecipeError, match='needs the key "quantity"'):
        servo(runs, SENSITIVITY)


def test_tool_setting_says_what_to_enter(tmp_path):
    """A tool 2 um too far out cuts the form 2 um further out: it must come in by 2 um."""
    line = 4e-6 * np.arange(-50, 51)
    x, y = np.meshgrid(line, line)
    rho = np.hypot(x, y)
    k, scale = 2 * np.pi / 100e-6, 1.0 - 2e-6 / np.where(rho > 0, rho, np.inf)
    z = 50e-9 * (np.sin(k * scale * x) + np.cos(k * scale * y))
    ms.write(ms.Surface(np.where(rho > 20e-6, z, np.nan), 4e-6, 4e-6), tmp_path / "part.h5")
    result = run("tool_setting", SURFACE + 'free = ["dx"]\n', "", [tmp_path / "part.h5"])

    assert found(result)["dx"][0] == pytest.approx(2e-6, abs=2e-8)
    (words,) = (m for m in result.document["messages"] if m.startswith("correction: dx -"))
    assert float(words.split()[2]) == pytest.approx(-2.0, abs=0.02)


def test_tool_setting_refuses_a_flat(tmp_path):
    z = np.zeros((24, 24))
    ms.write(ms.Surface(z, 1e-5, 1e-5), tmp_path / "flat.x3p")
    text = 'form = "plane: a=0, b=0, c=0 nm"\n'
    with pytest.raises(MetrosepError):
        run("tool_setting", text, "", [tmp_path / "flat.x3p"])

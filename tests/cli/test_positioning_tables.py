"""Pitch tables from lists of a positioning test, by the command line alone; the machine is numpy."""

import json
import os
import re
import shlex

import numpy as np
import pytest

UM = 1e-3
"""A micrometre in mm, the unit of the lists and of LinuxCNC's file."""

TRAVEL = 400.0
TARGETS = np.array(
    [0, 13.7, 29, 51.3, 77, 96.1, 128, 155.9, 181, 214.6, 240, 271.2, 300, 333.3, 362, 400]
)
HOMED = 0.0001 * UM
"""0.1 nm: the exact inverse looks the error up 1.4 um beside the reference, where it slopes."""

LEFT = 0.03 * UM
"""30 nm: what two iterations may leave, P-V at the targets."""


def machine(position, direction):
    """Error in mm of an axis that stretches by 30 um/m and loses 3 um at a reversal."""
    straight = 30e-6 * position + 1.3 * UM * np.sin(2 * np.pi * position / 170 + 0.4)
    return straight + (0.0 if direction > 0 else -3 * UM + 2e-6 * position)


def trims(path):
    """Return LinuxCNC's lookup of a .comp of type 0: trim = nominal - actual, linear, ends held."""
    if path is None:
        return lambda p, direction: 0.0
    nominal, *actual = np.loadtxt(path, unpack=True)
    return lambda p, direction: np.interp(p, nominal, nominal - actual[direction < 0])


def reached(command, direction, comp):
    motor = command + comp(command, direction)
    return motor + machine(motor, direction)


def laser_file(path, comp, *, seed, cycles=5, sense=1.0, noise=0.005 * UM, warm=0.0, scale=1.0):
    """Write one row per reading, in the order in which the laser took them."""
    rng = np.random.default_rng(seed)
    lines = ["cycle;way;target_mm;deviation_um"]
    for k in range(cycles):
        for way, targets in (("up", TARGETS), ("down", TARGETS[::-1])):
            for target in targets:
                at = scale * (reached(target, 1 if way == "up" else -1, comp) - target)
                at += warm * target + rng.normal(0, noise)
                lines.append(f"{k + 1};{way};{target:.4f};{sense * at / UM:.5f}")
    path.write_text("\n".join(lines) + "\n")
    return path


NAMES = [
    "--target",
    "target_mm",
    "--direction",
    "way",
    "--readings",
    "deviation_um",
    "--axis",
    "X",
]
SENSE = ["--deviation", "reached-minus-target"]


def left_over(comp):
    """P-V in mm over both directions, of commands between the targets too."""
    p = np.concatenate([TARGETS, np.linspace(0, TRAVEL, 4001)])
    both = np.concatenate([reached(p, d, comp) - p for d in (1, -1)])
    return np.ptp(both), np.ptp(both.reshape(2, -1)[:, : TARGETS.size])


def test_two_iterations_close_the_axis_and_the_first_table_stays(tmp_path, metrosep):
    first = laser_file(
        tmp_path / "first.csv", trims(None), seed=1, scale=0.93
    )  # a laser with dead path
    out = tmp_path / "x.comp"
    code, _, told = metrosep("table", first, *NAMES, *SENSE, "-o", out)
    assert code == 0, told
    assert "X -> X (its own positioning), 0 ... 400 mm, 16 entries, slope" in told
    assert "no temperature is stated: 1 K is 11.5 um/m for steel" in told
    before, after = left_over(trims(None))[1], left_over(trims(out))[1]
    assert after < 0.1 * before

    second = laser_file(tmp_path / "second.csv", trims(out), seed=2)
    code, _, told = metrosep("table", second, *NAMES, *SENSE, "-o", out, "--force")
    assert code == 1, told
    assert f'--active "{out}"' in told
    old = out.read_bytes()
    add = ["--active", out, "-o", out, "--force"]
    code, _, told = metrosep("table", second, *NAMES, *SENSE, *add)
    assert code == 0, told
    assert "x.comp was active: this file holds it and what it left" in told
    assert (tmp_path / "x.comp.1").read_bytes() == old
    assert left_over(trims(out))[1] < LEFT
    sidecar = json.loads((tmp_path / "x.comp.json").read_text())
    assert sidecar["active"]["with_it_rms_m"] < sidecar["active"]["without_any_table_rms_m"]


def test_an_active_table_of_the_wrong_sign_is_named_and_overcome(tmp_path, metrosep):
    good = tmp_path / "good.comp"
    first = laser_file(tmp_path / "first.csv", trims(None), seed=3)
    assert metrosep("table", first, *NAMES, *SENSE, "-o", good)[0] == 0
    nominal, up, down = np.loadtxt(good, unpack=True)
    wrong = tmp_path / "wrong.comp"  # somebody else's file: no sidecar, the sign turned
    np.savetxt(wrong, np.c_[nominal, 2 * nominal - up, 2 * nominal - down], fmt="%.10f")
    assert left_over(trims(wrong))[1] > 1.8 * left_over(trims(None))[1]

    second = laser_file(tmp_path / "second.csv", trims(wrong), seed=4)
    out = tmp_path / "x.comp"
    code, _, told = metrosep("table", second, *NAMES, *SENSE, "--add-to", wrong, "-o", out)
    assert code == 0, told
    assert "wrong.comp made it worse, its sign or its axis is wrong" in told
    assert left_over(trims(out))[1] < 2 * LEFT  # one step from an error twice as large


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_sense_of_deviations_is_asked_for_and_obeyed(tmp_path, metrosep, sense):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=5, sense=sense)
    out = tmp_path / "x.comp"
    code, _, told = metrosep("table", file, *NAMES, "-o", out)
    assert code == 2
    assert "it is not assumed" in told
    assert not out.exists()
    word = "reached-minus-target" if sense > 0 else "target-minus-reached"
    assert metrosep("table", file, *NAMES, "--deviation", word, "-o", out)[0] == 0
    assert left_over(trims(out))[1] < 0.1 * left_over(trims(None))[1]


def test_a_warm_scale_is_corrected_to_20_degrees(tmp_path, metrosep):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=6, warm=10.6e-6 * 3.5)
    out = tmp_path / "x.comp"
    warm = ["--temperature", "23.5 degC", "--expansion", "10.6 ppm/K"]
    known = ["--u-temperature", "0.05 K", "--u-expansion", "0.1 ppm/K"]
    code, _, said = metrosep("table", file, *NAMES, *SENSE, *warm, *known, "-o", out)
    assert code == 0, said
    assert "37.1 um/m of the slope were taken off" in said
    assert left_over(trims(out))[1] < LEFT
    told = json.loads((tmp_path / "x.comp.json").read_text())["table"]["heat"]
    assert told["temperature"] == pytest.approx(296.65, rel=1e-12, abs=0)

    # the readings that made it are judged at 20 degC too, with or without saying it again
    code, _, said = metrosep("verify", out, "--against", file, *NAMES[:6], *SENSE)
    assert code == 0, said
    assert "each omitted once" in said
    # five runs share one wrong temperature: no number of them shows it, so its u counts in full
    vague = ["--u-temperature", "2 K", "-o", str(tmp_path / "y.comp")]
    code, _, said = metrosep("table", file, *NAMES, *SENSE, *warm, *vague)
    assert code == 3
    assert "more runs do not show it: measure the temperature better" in said

    # other readings, of a cooler day: their own temperature is asked for
    cool = laser_file(tmp_path / "b.csv", trims(None), seed=13, warm=-10.6e-6 * 1.5)
    against = ["verify", out, "--against", cool, *NAMES[:6], *SENSE]
    code, _, said = metrosep(*against)
    assert code == 2
    assert "the temperature of these readings is not stated" in said
    assert metrosep(*against, "--temperature", "18.5 degC", *warm[2:], *known)[0] == 0
    assert metrosep(*against, *warm, *known)[0] == 1  # not what it was: 53 um/m apart


@pytest.mark.parametrize("way", ["forward", "reverse", "middle"])
def test_the_zero_is_where_and_how_the_axis_is_homed(tmp_path, metrosep, way):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=7)
    out = tmp_path / "x.comp"
    home = ["--reference", "128 mm", "--reference-direction", way]
    assert metrosep("table", file, *NAMES, *SENSE, *home, "-o", out)[0] == 0
    up, down = (float(trims(out)(128.0, d)) for d in (1, -1))
    at = {"forward": up, "reverse": down, "middle": (up + down) / 2}[way]
    assert abs(at) < HOMED
    assert down - up == pytest.approx(3 * UM - 2e-6 * 128, rel=0.01, abs=0)


REFUSED = [
    (["--compensates", "Z"], "a positioning test is the error of X along itself", 2),
    (["--reference", "500 mm"], "the reference 500 mm lies outside the targets", 2),
    (["--temperature", "22 degC"], "expansion and temperature are needed together", 2),
    (["--temperature", "22", "--expansion", "11.5 ppm/K"], "unit", 2),
    (
        ["--already-corrected", "--temperature", "22 degC", "--expansion", "11 ppm/K"],
        "one of the two",
        2,
    ),
    (["--cycle", "way"], "mm occurs twice in cycle up", 4),
    (["--active", "nowhere.comp"], "nowhere.comp: no such file", 4),
]


@pytest.mark.parametrize(("more", "words", "code"), REFUSED)
def test_what_contradicts_the_list_is_refused_and_nothing_is_written(
    tmp_path, metrosep, more, words, code
):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=8)
    out = tmp_path / "x.comp"
    found, _, told = metrosep("table", file, *NAMES, *SENSE, *more, "-o", out)
    assert words in told
    assert found == code, told
    assert not out.exists()


def test_a_result_a_recipe_and_the_list_itself_give_the_same_bytes(tmp_path, metrosep):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=9)
    direct, later = tmp_path / "direct.comp", tmp_path / "later.comp"
    warm = ["--temperature", "21 degC", "--expansion", "11 ppm/K", "--reference", "29 mm"]
    assert metrosep("table", file, *NAMES, *SENSE, *warm, "-o", direct)[0] == 0
    columns = ["--column", "target=target_mm", "--column", "direction=way"]
    code, _, told = metrosep(
        "separate", file, "--method", "iso230_2", *columns, "--readings", "deviation_um",
        "--set", "values=deviation", "-o", tmp_path / "test",
    )  # fmt: skip
    assert code == 0, told
    assert metrosep("table", tmp_path / "test", "--axis", "X", *warm, "-o", later)[0] == 0
    assert later.read_bytes() == direct.read_bytes()

    recipe = tmp_path / "pitch.toml"
    recipe.write_text(
        """metrosep = 1
[input]
target = "target_mm"
direction = "way"
readings = ["deviation_um"]
[[step]]
op = "iso230_2"
values = "deviation"
[[output]]
kind = "table"
controller = "linuxcnc"
axis = "X"
compensates = "X"
reference = "29 mm"
temperature = "21 degC"
expansion = "11 ppm/K"
path = "x.comp"
"""
    )
    code, _, told = metrosep("run", recipe, file, "-o", tmp_path / "run")
    assert code == 0, told
    assert (tmp_path / "run" / "x.comp").read_bytes() == direct.read_bytes()
    assert "accepted" in told

    recipe.write_text(recipe.read_text().replace('compensates = "X"', 'compensates = "Z"'))
    code, _, told = metrosep("run", recipe, file, "-o", tmp_path / "other")
    assert code == 2
    assert "error of X along itself" in told


def test_verify_judges_the_new_file_by_readings_taken_with_the_old_one_active(tmp_path, metrosep):
    first = laser_file(tmp_path / "first.csv", trims(None), seed=10, scale=0.8)
    old, new = tmp_path / "old.comp", tmp_path / "new.comp"
    assert metrosep("table", first, *NAMES, *SENSE, "-o", old)[0] == 0
    second = laser_file(tmp_path / "second.csv", trims(old), seed=11)
    assert metrosep("table", second, *NAMES, *SENSE, "--active", old, "-o", new)[0] == 0
    third = laser_file(tmp_path / "third.csv", trims(old), seed=12)
    against = ["--against", third, *NAMES[:6], *SENSE]
    code, _, told = metrosep("verify", new, *against, "--active", old)
    assert code == 0, told
    # without --active the readings look like the error that the whole new table makes worse
    code, _, told = metrosep("verify", new, *against)
    assert code == 1, told


def test_readings_that_made_the_second_table_judge_it_with_each_left_out(tmp_path, metrosep):
    first = laser_file(tmp_path / "first.csv", trims(None), seed=10, scale=0.8)
    old, new = tmp_path / "old.comp", tmp_path / "new.comp"
    assert metrosep("table", first, *NAMES, *SENSE, "-o", old)[0] == 0
    second = laser_file(tmp_path / "second.csv", trims(old), seed=11)
    code, _, made = metrosep("table", second, *NAMES, *SENSE, "--active", old, "-o", new)
    assert code == 0, made
    against = ["--against", second, *NAMES[:6], *SENSE, "--active", old]
    code, _, told = metrosep("verify", new, *against)
    assert code == 0, told
    assert "judged on 5 runs, each omitted once" in told
    numbers = [line for line in made.splitlines() if line.startswith("RMS that repeats")]
    assert numbers[0] in told  # as it was judged when it was made
    sidecar = json.loads((tmp_path / "new.comp.json").read_text())
    del sidecar["active"]["increment"]  # a file of an earlier version
    (tmp_path / "new.comp.json").write_text(json.dumps(sidecar))
    code, _, told = metrosep("verify", new, *against)
    assert code == 3, told
    assert "what these readings added to that is not stored" in told


def test_a_trial_beside_an_active_table_is_that_table_and_one_bump(tmp_path, metrosep):
    first = laser_file(tmp_path / "first.csv", trims(None), seed=10, scale=0.8)
    old, trial = tmp_path / "old.comp", tmp_path / "trial.comp"
    assert metrosep("table", first, *NAMES, *SENSE, "-o", old)[0] == 0
    second = laser_file(tmp_path / "second.csv", trims(old), seed=11)
    call = ["table", second, *NAMES, *SENSE, "--active", old, "--trial", "5 um", "-o", trial]
    code, _, told = metrosep(*call)
    assert code == 0, told
    assert "'without the trial table' means with old.comp" in told
    assert "holds it and what it left" not in told
    for way, height in ((1, 5.0), (-1, 1.5)):
        bump = (trims(trial)(TARGETS, way) - trims(old)(TARGETS, way)) / UM
        assert bump.max() == pytest.approx(height, rel=0, abs=0.01)
        assert (np.abs(bump) < 0.01).sum() >= TARGETS.size // 2
        assert bump.min() > -0.01


def test_entries_between_the_targets_are_said_to_add_nothing(tmp_path, metrosep):
    file, out = laser_file(tmp_path / "first.csv", trims(None), seed=10), tmp_path / "x.comp"
    code, _, told = metrosep("table", file, *NAMES, *SENSE, "--spacing", "5 mm", "-o", out)
    assert code == 0, told
    assert "entries every 5 mm, targets about every 27.9 mm: between the targets nothing" in told
    code, _, told = metrosep("table", file, *NAMES, *SENSE, "-o", tmp_path / "y.comp")
    assert code == 0, told
    assert "nothing was measured" not in told


def test_a_spike_of_a_cycle_is_to_be_left_out_and_not_to_be_separated(tmp_path, metrosep):
    file, out = laser_file(tmp_path / "first.csv", trims(None), seed=10), tmp_path / "x.comp"
    rows = file.read_text().splitlines()
    i = next(k for k, r in enumerate(rows) if r.startswith("3;up;181"))
    cells = rows[i].split(";")
    rows[i] = ";".join([*cells[:3], f"{float(cells[3]) + 9:.5f}"])
    file.write_text("\n".join(rows) + "\n")
    code, _, told = metrosep("table", file, *NAMES, *SENSE, "-o", out)
    assert code == 1, told
    assert "at 181 mm" in told
    assert "leave that cycle out" in told
    assert "robust" not in told
    assert not out.exists()


def test_a_recipe_reads_no_active_table_outside_the_opened_folders(tmp_path):
    from metrosep.core.errors import RecipeError
    from metrosep.recipe import Recipe

    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    (outside / "x.comp").write_text("0 0 0\n1 1 1\n")
    text = """metrosep = 1
[input]
x = "x_mm"
z = "z_um"
[[step]]
op = "separate"
[[output]]
kind = "table"
controller = "linuxcnc"
axis = "X"
compensates = "X"
spacing = "1 mm"
active = "../out/x.comp"
path = "y.comp"
"""
    Recipe.parse(text, folder=inside)
    with pytest.raises(RecipeError, match=r"outside the folders that were opened"):
        Recipe.parse(text, folder=inside, admits=lambda path: inside in path.resolve().parents)


def turn_file(path, unit="deg"):
    """A table of 9 arcsec that turns, once around, both ways."""
    rng = np.random.default_rng(21)
    targets = np.arange(0, 361, 30)
    lines = [f"target_{unit},way,run,deviation_arcsec"]
    for run in range(5):
        for way, places in (("+", targets), ("-", targets[::-1])):
            for t in places:
                e = 9 * np.sin(np.radians(t + 23)) + (1.5 if way == "-" else 0.0)
                lines.append(f"{t},{way},{run},{e + rng.normal(0, 0.05):.4f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_an_axis_that_turns_is_not_taken_for_one_that_moves_along(tmp_path, metrosep):
    names = [
        "--direction", "way", "--cycle", "run", "--readings", "deviation_arcsec", *SENSE,
        "--target",
    ]  # fmt: skip
    turned, out = turn_file(tmp_path / "c.csv"), tmp_path / "c.comp"
    there = ["--machine", "travel_low=0 deg", "--machine", "travel_high=360 deg"]
    angular = [*there, "--machine", "joint_type=angular", "-o", out]
    code, _, told = metrosep("table", turned, *names, "target_deg", "--axis", "X", "-o", out)
    assert code == 2, told
    assert "the readings are angles, and the axis moves along" in told
    mixed = turn_file(tmp_path / "m.csv", unit="mm")
    code, _, told = metrosep("table", mixed, *names, "target_mm", "--axis", "C", *angular)
    assert code == 2, told
    assert "both be lengths, or both angles" in told
    assert not out.exists()

    code, _, told = metrosep("table", turned, *names, "target_deg", "--axis", "C", *angular)
    assert code == 0, told
    assert "0 ... 360 deg" in told
    nominal, up, down = np.loadtxt(out, unpack=True)  # degrees
    wanted = 9 * (np.sin(np.radians(nominal + 23)) - np.sin(np.radians(23)))
    scatter = 0.2  # arcsec: four times the noise of five readings, twice for the zero
    assert np.abs((up - nominal) * 3600 - wanted).max() < scatter
    assert np.abs((down - nominal) * 3600 - wanted - 1.5).max() < scatter
    again = ["--against", turned, *names, "target_deg"]
    code, _, told = metrosep("verify", out, *again)
    assert code == 0, told
    assert metrosep("verify", out, *again, *there)[0] == 0
    code, _, told = metrosep("verify", out, *again, "--machine", "travel_low=0 mm")
    assert code == 2, told
    assert "angle" in told


def test_runs_go_straight_into_a_table_by_the_same_way_as_through_a_result(tmp_path, metrosep):
    rng = np.random.default_rng(31)
    x = np.linspace(0, 250, 401)
    rows = ["x_mm;z_um;run;way"]
    for run in range(6):
        step = 1 if run % 2 == 0 else -1
        z = (machine(x, step) / UM + rng.normal(0, 0.01, x.size))[::step]
        rows += [f"{a:.4f};{b:.5f};{run};{step}" for a, b in zip(x[::step], z, strict=True)]
    file = tmp_path / "runs.csv"
    file.write_text("\n".join(rows) + "\n")
    how = [
        "--x",
        "x_mm",
        "--z",
        "z_um",
        "--run",
        "run",
        "--method",
        "mean",
        "--separator",
        "semicolon",
    ]
    table = ["--axis", "X", "--compensates", "X", "--spacing", "5 mm"]
    direct, later = tmp_path / "direct.comp", tmp_path / "later.comp"
    code, _, told = metrosep("table", file, *how, *table, "-o", direct)
    assert code == 0, told
    assert metrosep("separate", file, *how, "-o", tmp_path / "result")[0] == 0
    assert metrosep("table", tmp_path / "result", *table, "-o", later)[0] == 0
    assert direct.read_bytes() == later.read_bytes()
    nominal, up, down = np.loadtxt(direct, unpack=True)
    at_zero = float(machine(0.0, 1))
    assert np.abs(up - nominal - machine(up, 1) + at_zero).max() < 0.1 * UM
    assert np.abs(down - nominal - machine(down, -1) + at_zero).max() < 0.1 * UM


@pytest.mark.parametrize(
    "more", [["--x", "x_mm"], ["--method", "mean"], ["--separator", "comma"], ["--cycle", "run"]]
)
def test_options_of_readings_do_not_vanish_beside_a_result(tmp_path, metrosep, more):
    (tmp_path / "result.json").write_text('{"schema": "metrosep.result/1"}')
    code, _, told = metrosep(
        "table", tmp_path / "result.json", "--axis", "X", *more, "-o", tmp_path / "x.comp"
    )
    assert code == 2, told
    assert more[0] in told or "--z" in told


def test_the_second_iteration_keeps_the_zero_of_an_axis_homed_otherwise(tmp_path, metrosep):
    first = laser_file(tmp_path / "first.csv", trims(None), seed=14, scale=0.9)
    for way in ("reverse", "middle"):
        old, new = tmp_path / f"{way}.comp", tmp_path / f"{way}2.comp"
        home = ["--reference", "128 mm", "--reference-direction", way]
        assert metrosep("table", first, *NAMES, *SENSE, *home, "-o", old)[0] == 0
        second = laser_file(tmp_path / f"{way}.csv", trims(old), seed=15)
        more = [*home, "--active", old, "-o", new]
        code, _, told = metrosep("table", second, *NAMES, *SENSE, *more)
        assert code == 0, told
        assert left_over(trims(new))[1] < LEFT
        up, down = (float(trims(new)(128.0, d)) for d in (1, -1))
        assert abs({"reverse": down, "middle": (up + down) / 2}[way]) < HOMED
        # homed from the other side, the sum would move the zero of the machine
        code, _, told = metrosep(
            "table", second, *NAMES, *SENSE, *home[:2], "--active", old, "-o", tmp_path / "no.comp"
        )
        assert code == 2
        assert f"--reference-direction {way}" in told
        assert not (tmp_path / "no.comp").exists()


def test_what_an_active_table_did_is_told_at_20_degrees(tmp_path, metrosep):
    warm = ["--temperature", "24 degC", "--expansion", "10 ppm/K"]
    known = ["--u-temperature", "0.02 K", "--u-expansion", "0.02 ppm/K"]
    old, new = tmp_path / "old.comp", tmp_path / "new.comp"
    first = laser_file(tmp_path / "first.csv", trims(None), seed=16, warm=40e-6, scale=0.95)
    assert metrosep("table", first, *NAMES, *SENSE, *warm, *known, "-o", old)[0] == 0
    # a day so cold that the axis is nearly right without any table, and wrong with the right one
    second = laser_file(tmp_path / "second.csv", trims(old), seed=17, warm=-30e-6)
    cold = ["--temperature", "17 degC", *warm[2:], *known, "--active", old, "-o", new]
    code, _, told = metrosep("table", second, *NAMES, *SENSE, *cold)
    assert code == 0, told
    assert "old.comp was active" in told
    assert "made it worse" not in told
    beside = json.loads((tmp_path / "new.comp.json").read_text())["active"]
    assert beside["without_any_table_rms_m"] > 5 * beside["with_it_rms_m"]
    assert left_over(trims(new))[1] < LEFT
    # the sum would hold the cold day if its temperature were not asked for
    code, _, told = metrosep(
        "table", second, *NAMES, *SENSE, "--active", old, "-o", tmp_path / "no.comp"
    )
    assert code == 2
    assert "--already-corrected" in told
    assert not (tmp_path / "no.comp").exists()


def test_a_table_for_a_warm_shop_is_judged_there_whenever_the_readings_were_taken(
    tmp_path, metrosep
):
    known = ["--expansion", "10 ppm/K", "--u-temperature", "0.02 K", "--u-expansion", "0.02 ppm/K"]
    use = ["--temperature-use", "30 degC", "--workpiece-expansion", "0 ppm/K"]
    first = laser_file(tmp_path / "first.csv", trims(None), seed=18, warm=40e-6)
    out = tmp_path / "x.comp"
    warm = ["--temperature", "24 degC", *known, *use, "-o", out]
    assert metrosep("table", first, *NAMES, *SENSE, *warm)[0] == 0
    cool = laser_file(tmp_path / "cool.csv", trims(None), seed=19, warm=-20e-6)
    against = ["verify", out, "--against", cool, *NAMES[:6], *SENSE, "--temperature", "18 degC"]
    code, _, told = metrosep(*against, *known)
    assert code == 0, told


def turning(path, unit):
    """A list of an axis that turns, deviations in arcsec; `unit` is what its columns declare."""
    rng = np.random.default_rng(20)
    at, reads = unit
    lines = [f"target_{at},way,a_{reads},b_{reads},c_{reads}"]
    for way in ("up", "down"):
        for target in (0, 33, 61, 97, 130, 166, 201, 236, 270):
            error = 9 * np.sin(np.radians(target) + 0.4) + (0 if way == "up" else -4)
            three = error + rng.normal(0, 0.05, 3)
            lines.append(f"{target},{way}," + ",".join(f"{v:.4f}" for v in three))
    path.write_text("\n".join(lines) + "\n")
    columns = ",".join(f"{c}_{reads}" for c in "abc")
    names = ["--target", f"target_{at}", "--direction", "way", "--readings", columns, *SENSE]
    return [path, *names]


def test_angles_belong_to_axes_that_turn_and_lengths_to_the_others(tmp_path, metrosep):
    out = tmp_path / "b.comp"
    for units, axis, words in (
        (("deg", "arcsec"), "X", "the readings are angles, and the axis moves along"),
        (("mm", "um"), "B", "the readings are lengths, and the axis turns"),
        (("deg", "um"), "B", "must both be lengths, or both angles"),
    ):
        listed = turning(tmp_path / "a.csv", units)
        code, _, told = metrosep(
            "table", *listed, "--axis", axis, "--machine", "joint_type=angular", "-o", out
        )
        assert code == 2
        assert words in told
        assert not out.exists()
    listed = turning(tmp_path / "a.csv", ("deg", "arcsec"))
    more = ["--axis", "B", "--reference", "97 deg", "--format", "csv", "-o", tmp_path / "b.csv"]
    code, _, told = metrosep("table", *listed, *more)
    assert code == 0, told
    table = json.loads((tmp_path / "b.csv.json").read_text())["table"]
    assert table["reference_rad"] == pytest.approx(np.radians(97), rel=1e-12, abs=0)
    straight = turning(tmp_path / "l.csv", ("mm", "um"))
    code, _, told = metrosep("verify", tmp_path / "b.csv", "--against", *straight)
    assert code == 2
    assert "the axis turns" in told


@pytest.mark.parametrize(
    "heat", ["hot", {"temperature": [1], "expansion": 1e-5}, {"temperature": 293.0}]
)
def test_a_sidecar_with_damaged_temperatures_is_refused(tmp_path, metrosep, heat):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=21)
    old, new = tmp_path / "old.comp", tmp_path / "new.comp"
    assert metrosep("table", file, *NAMES, *SENSE, "-o", old)[0] == 0
    beside = tmp_path / "old.comp.json"
    told = json.loads(beside.read_text())
    told["table"]["heat"] = heat
    beside.write_text(json.dumps(told))
    code, _, told = metrosep("table", file, *NAMES, *SENSE, "--active", old, "-o", new)
    assert code == 4
    assert "'reference_direction' or 'heat' is damaged" in told
    code, _, told = metrosep("verify", old, "--against", file, *NAMES[:6], *SENSE)
    assert code == 4


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system here")
def test_an_active_table_that_is_a_pipe_is_refused_at_once(tmp_path, metrosep):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=22)
    os.mkfifo(tmp_path / "pipe")
    more = ["--active", tmp_path / "pipe", "-o", tmp_path / "x.comp"]
    code, _, told = metrosep("table", file, *NAMES, *SENSE, *more)
    assert code == 4
    assert "it is a device or a pipe" in told


def wide_file(path, left_out=()):
    """One row per target and direction with three cycles; some cells are empty."""
    rng = np.random.default_rng(23)
    lines = ["target_mm,way,a_um,b_um,c_um"]
    for way, d in (("up", 1), ("down", -1)):
        for i, target in enumerate(TARGETS):
            cells = [f"{machine(target, d) / UM + v:.4f}" for v in rng.normal(0, 0.005, 3)]
            for k in range(3):
                if (way, i, k) in left_out:
                    cells[k] = ""
            lines.append(f"{target},{way}," + ",".join(cells))
    path.write_text("\n".join(lines) + "\n")
    return [path, "--target", "target_mm", "--direction", "way", *SENSE, "--axis", "X"]


def test_an_empty_cell_leaves_its_target_out_of_the_comparison_and_no_more(tmp_path, metrosep):
    columns = ["--readings", "a_um,b_um,c_um"]
    rms = []
    for name, empty in (("all", ()), ("but", {("up", 4, 1)})):
        listed = wide_file(tmp_path / f"{name}.csv", empty)
        out = tmp_path / f"{name}.comp"
        code, _, told = metrosep("table", *listed, *columns, "-o", out)
        assert code == 0, told
        found = json.loads((tmp_path / f"{name}.comp.json").read_text())["verification"]
        rms.append([r["before_rms_m"] for r in found["residuals"]])
    # one of 16 targets less: the RMS of either direction changes by a few per cent, not by 20
    assert rms[1] == pytest.approx(rms[0], rel=0.06, abs=0)


def test_a_column_that_is_named_twice_is_not_a_second_cycle(tmp_path, metrosep):
    listed = wide_file(tmp_path / "a.csv")
    out = tmp_path / "x.comp"
    code, _, told = metrosep("table", *listed, "--readings", "a_um,a_um,a_um", "-o", out)
    assert code == 2
    assert "--readings names a_um twice" in told
    assert not out.exists()


def test_a_list_given_twice_is_refused_and_hints_are_those_of_the_command_line(tmp_path, metrosep):
    listed = wide_file(tmp_path / "a.csv")
    columns = ["--readings", "a_um,b_um,c_um"]
    out = tmp_path / "x.comp"
    out.write_text("0 0 0\n400 400 400\n")  # somebody else's, without a sidecar
    code, _, told = metrosep("table", *listed, *columns, "-o", out, "--force")
    assert code == 0, told
    assert "--active none" in told
    assert "active='none'" not in told
    twice = ["--against", listed[0], "--against", listed[0], *listed[1:-2], *columns]
    code, _, told = metrosep("verify", out, *twice)
    assert code == 2
    assert "named twice" in told


def test_equal_steps_are_told_for_they_hide_the_pitch(tmp_path, metrosep):
    rows = ["target_mm;way;cycle;deviation_um"]
    rng = np.random.default_rng(23)
    for cycle in range(5):
        for way in ("+", "-"):
            rows += [
                f"{t};{way};{cycle};{0.03 * t + rng.normal(0, 0.01):.4f}"
                for t in range(0, 401, 20)
            ]
    file = tmp_path / "equal.csv"
    file.write_text("\n".join(rows) + "\n")
    code, _, told = metrosep("table", file, *NAMES, *SENSE, "-o", tmp_path / "x.comp")
    assert code == 0, told
    assert "equal steps" in told
    uneven = laser_file(tmp_path / "a.csv", trims(None), seed=24)
    code, _, told = metrosep("table", uneven, *NAMES, *SENSE, "-o", tmp_path / "y.comp")
    assert code == 0, told
    assert "equal steps" not in told


def test_the_command_that_is_named_next_judges_a_second_list(tmp_path, monkeypatch, capsys):
    import shlex

    from metrosep.cli.main import main

    monkeypatch.chdir(tmp_path)
    file = laser_file(tmp_path / "list.csv", trims(None), seed=1)
    words = [*NAMES, "--deviation", "reached-minus-target", "--compensates", "X"]
    with pytest.raises(SystemExit) as ended:
        main(["table", str(file), *words, "-o", "x.comp"])
    assert ended.value.code == 0
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("next: metrosep verify x.comp --against NEW.csv")
    laser_file(tmp_path / "NEW.csv", trims(None), seed=2)
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(last.removeprefix("next: metrosep ")))
    assert ended.value.code == 0
    assert "dry-run reverse" in capsys.readouterr().err


def test_columns_of_a_list_that_are_missing_are_named_as_options_beside_those_of_the_file(
    tmp_path, metrosep
):
    file = tmp_path / "shop.csv"
    file.write_text("Soll [mm];Richtung;Lauf;Abweichung [um]\n0,0;+;1;0,1\n10,0;+;1;0,4\n")

    code, _, err = metrosep(
        "table", file, "--target", "Soll [mm]", "--axis", "X", "-o", tmp_path / "x.comp"
    )

    assert code == 2
    assert "'--direction' and '--readings'" in err
    assert "shop.csv has Soll [mm], Richtung, Lauf, Abweichung [um]" in err


@pytest.mark.parametrize(("word", "way"), [("forward", 1), ("reverse", -1)])
def test_a_list_of_one_direction_needs_no_column(tmp_path, metrosep, word, way):
    rng = np.random.default_rng(7)
    at = np.array([reached(t, way, trims(None)) - t for t in TARGETS])
    rows = at[:, None] + rng.normal(0.0, 0.005 * UM, (TARGETS.size, 4))
    lines = ["target_mm;a_um;b_um;c_um;d_um"]
    lines += [
        ";".join(f"{v:.5f}" for v in (t, *(r / UM))) for t, r in zip(TARGETS, rows, strict=True)
    ]
    listed, comp = tmp_path / "one.csv", tmp_path / "x.comp"
    listed.write_text("\n".join(lines) + "\n")
    call = [
        "table", str(listed), "--target", "target_mm", "--readings", "a_um,b_um,c_um,d_um",
        "--axis", "X", "--compensates", "X", *SENSE, "-o", str(comp),
    ]  # fmt: skip

    code, _, told = metrosep(*call)
    assert code == 2
    assert "a list of one direction: --direction forward, or reverse" in told
    code, _, told = metrosep(*call, "--direction", "sideways")
    assert code == 4  # what the file does not hold
    assert "has no direction column 'sideways'" in told
    home = ["--reference-direction", word, "--reference", "0 mm"]
    code, _, told = metrosep(*call, "--direction", word, *home)
    assert code == 0, told
    assert "lost motion is not known" in told
    left = np.array([reached(t, way, trims(comp)) - t for t in TARGETS])
    assert np.ptp(left) < LEFT < np.ptp(at)


@pytest.mark.parametrize("word", ["forward", "reverse"])
def test_one_direction_is_not_said_for_a_list_that_holds_both(tmp_path, metrosep, word):
    both = laser_file(tmp_path / "both.csv", trims(None), seed=5, cycles=2)
    call = [
        "--target",
        "target_mm",
        "--readings",
        "deviation_um",
        "--axis",
        "X",
        "--compensates",
        "X",
    ]
    call += [*SENSE, "--direction", word, "--reference-direction", word, "--reference", "0 mm"]
    comp = tmp_path / "x.comp"
    code, _, told = metrosep("table", both, *call, "-o", comp)
    assert code != 0
    assert "column 'way' tells the direction of each row" in told
    rows = [line.split(";") for line in both.read_text().splitlines()]
    mute = tmp_path / "mute.csv"
    mute.write_text("".join(f"{t};{z}\n" for _, _, t, z in rows))
    code, _, told = metrosep("table", mute, *call, "-o", comp)
    assert code != 0
    assert "may hold both directions" in told
    assert not comp.exists()
    # a column that agrees, and a cycle that is 1 in each row, are no reason to refuse
    way = "up" if word == "forward" else "down"
    one = tmp_path / "one.csv"
    one.write_text("".join(f"1;{';'.join(r[1:])}\n" for r in rows if r[0] == "2" and r[1] == way))
    one.write_text("cycle;way;target_mm;deviation_um\n" + one.read_text())
    code, _, told = metrosep("table", one, *call, "-o", comp)
    assert "tells the direction" not in told
    assert "may hold both" not in told


def test_a_list_without_any_name_is_answered_with_its_columns(tmp_path, metrosep):
    file = laser_file(tmp_path / "a.csv", trims(None), seed=3)
    code, _, told = metrosep("table", file, "-o", tmp_path / "x.comp")
    assert code == 2
    assert "a.csv has cycle, way, target_mm, deviation_um: name the columns" in told
    (tmp_path / "no.txt").write_text("no table at all\n")
    code, _, told = metrosep("table", tmp_path / "no.txt", "-o", tmp_path / "x.comp")
    assert code == 4
    assert "JSON" in told


def test_check_of_a_german_list_prints_the_command_that_makes_its_table(tmp_path, metrosep):
    """Cycles are columns of their own, "Lauf 1 [um]", below lines about the machine; decimal commas."""
    rows = [
        "Messung Achse X;Maschine M-9",
        "Temperatur;20,4",
        "",
        "Zielposition [mm];Richtung;Lauf 1 [µm];Lauf 2 [µm];Lauf 3 [µm]",
    ]
    rng = np.random.default_rng(4)
    for way, word in ((1, "+"), (-1, "-")):
        for t in TARGETS[::way]:
            reads = machine(t, way) / UM + rng.normal(0, 0.05, 3)
            rows.append(
                f"{t:.3f};{word};".replace(".", ",")
                + ";".join(f"{r:.2f}".replace(".", ",") for r in reads)
            )
    file = tmp_path / "laser.txt"
    file.write_bytes("\r\n".join([*rows, ""]).encode("cp1252"))
    _, told, _ = metrosep("check", file)
    (line,) = (x for x in told.splitlines() if "metrosep table" in x)
    words = shlex.split(line.partition("metrosep table ")[2])
    assert words[words.index("--readings") + 1] == "Lauf 1 [µm],Lauf 2 [µm],Lauf 3 [µm]"
    words[words.index("AXIS")], words[words.index("FILE")] = "X", str(tmp_path / "x.comp")
    words[words.index("SENSE")] = "reached-minus-target"
    code, _, told = metrosep("table", *words)
    assert code == 0, told
    trim = trims(tmp_path / "x.comp")
    for way in (1, -1):
        left = [reached(t, way, trim) - t for t in TARGETS]
        assert np.ptp(left) < 10 * LEFT  # the scatter of three readings of 50 nm, at 16 targets


def laser_of_a_known_error(path):
    """Write readings of 1.5 um sin(p/60) + 10 um/m p, and return the targets and that error in um."""
    p = np.arange(0, 401, 50)
    error, rng = 1.5 * np.sin(p / 60) + p / 100, np.random.default_rng(31)
    lines = ["cycle;way;target_mm;deviation_um"]
    for k in range(5):
        for way, order in (("up", range(9)), ("down", range(8, -1, -1))):
            noise = rng.normal(0, 0.005, 9)
            lines += [f"{k};{way};{p[i]};{error[i] + noise[i]:.4f}" for i in order]
    path.write_text("\n".join(lines) + "\n")
    return p, error


DUMP = """\
%
N0020P4
N3605A1P00000000A2P00000000
N3620 A1 P10 A2 P60
N3621A1P10A2P60
N3622A1P13A2P68
N3623A1P1A2P1
N3624A1P50000A2P50000
N3625A1P0A2P0
N3626A1P0A2P0
N3627A1P0A2P0
"""
"""What a control outputs of two axes, with parameters that do not act and one of something else."""


@pytest.mark.parametrize("axis", [1, 2])
def test_a_dump_of_several_axes_that_was_active_is_added_to(tmp_path, metrosep, axis):
    p, error = laser_of_a_known_error(tmp_path / "l.csv")
    own = {1: (5, -4, 3, -2), 2: (0, 3, -2, 1, 4, -5, 2, 1, -1)}
    first = {1: 10, 2: 60}
    lines = [f"N{10000 + first[a] + k}P{v}" for a in own for k, v in enumerate(own[a])]
    old, new = tmp_path / "old.txt", tmp_path / "new.txt"
    old.write_text(DUMP + "\n".join([*lines, "%"]) + "\n")
    facts = ["detection_unit=100 nm", "increment=1 um", "largest=127", "entry_sign=-1"]
    facts += ["reference_position=0 mm", f"axis_number={axis}", f"reference_number={first[axis]}"]
    machine = [w for f in facts for w in ("--machine", f)]
    more = ["--format", "fanuc", *machine, "--sign-confirmed", "--spacing", "50 mm"]
    more += ["--already-corrected", "--active", old, "-o", new]
    code, _, told = metrosep("table", tmp_path / "l.csv", *NAMES, *SENSE, *more)
    assert code == 0, told
    text = new.read_text()
    assert f"N3620A{axis}P{first[axis]}\n" in text
    entries = {
        int(n) - 10000: int(v) for n, v in re.findall(r"^N(1\d{4})P(-?\d+)$", text, re.MULTILINE)
    }
    # point 3620 + 1 is the section above the reference; units of 0.1 um, steps of 50 mm
    walked = np.cumsum([0, *(entries[first[axis] + k] for k in range(1, 9))])
    before = np.interp(p, 50.0 * np.arange(len(own[axis])), np.cumsum([0, *own[axis][1:]]))
    assert np.abs(walked / 10 - (before / 10 - error)).max() < 0.1, "um: one unit"

    code, _, told = metrosep("verify", old, "--against", tmp_path / "l.csv", "--format", "fanuc")
    assert code != 0
    assert "A1, A2" in told
    assert "axis_number=" in told


@pytest.mark.parametrize("between", [",\n  ", ", "], ids=["rows", "one line"])
def test_a_list_of_twincat_that_closes_on_its_last_row_is_added_to(tmp_path, metrosep, between):
    p, error = laser_of_a_known_error(tmp_path / "l.csv")
    held = np.array([0, 3, 1, 2, 6, 1, 3, 4, 3]) / 10
    rows = [
        f"(Position := {a}.0, Compensation := {c / 1e3:.4f})" for a, c in zip(p, held, strict=True)
    ]
    old, new = tmp_path / "old.TcGVL.txt", tmp_path / "new.TcGVL.txt"
    old.write_text(
        "VAR_GLOBAL\n  CompTable : ARRAY[1..9] OF ST_PositionCompensationTableElement := ["
        f"{'' if ' ' in between[:2] else chr(10)}{between.join(rows)}];\n"
        "  CompTableParameter : ST_PositionCompensationTableParameter := (MinPosition := 0.0, "
        "MaxPosition := 400.0, NoOfTableElements := 9);\nEND_VAR\n"
    )
    more = ["--format", "twincat", "--spacing", "50 mm", "--already-corrected"]
    more += ["--active", old, "-o", new]
    code, _, told = metrosep("table", tmp_path / "l.csv", *NAMES, *SENSE, *more)
    assert code == 0, told
    found = re.findall(r"Position := (-?[\d.]+), Compensation := (-?[\d.]+)\)", new.read_text())
    at, c = np.array(found, float).T
    assert np.array_equal(at, p)
    assert np.abs(1e3 * c - (held - error)).max() < 0.02, "um: noise of 5 nm, and 4.6 um of shift"


@pytest.mark.parametrize("moved", [0.0, 8e-5])  # inches of five decimals round by up to 0.13 um
def test_the_last_target_counts_where_it_lies_a_rounding_beyond_the_table(
    tmp_path, metrosep, moved
):
    out = tmp_path / "x.comp"
    first = laser_file(tmp_path / "first.csv", trims(None), seed=41)
    assert metrosep("table", first, *NAMES, *SENSE, "-o", out)[0] == 0
    rows = (tmp_path / "first.csv").read_text().splitlines()
    far = [row.replace(";400.0000;", f";{TRAVEL + moved:.5f};") for row in rows[1:]]
    second = tmp_path / "second.csv"
    second.write_text("\n".join([rows[0].replace("cycle", "lap"), *far]) + "\n")
    given = ["--against", second, *NAMES[:-2], *SENSE, "--cycle", "lap", "--json"]
    code, printed, told = metrosep("verify", out, *given)
    assert code == 0, told
    forward = next(d for d in json.loads(printed)["residuals"] if d["direction"] == "forward")
    errors = machine(TARGETS, 1)
    assert forward["before_pv_m"] == pytest.approx(
        np.ptp(errors) * 1e-3, abs=20e-9
    )  # 9 u of a P-V


def test_a_table_that_ends_between_targets_is_judged_up_to_its_end(tmp_path, metrosep):
    first = laser_file(tmp_path / "first.csv", trims(None), seed=42)
    out = tmp_path / "x.csv"
    spaced = ["--spacing", "38 mm", "--format", "csv", "--json", "-o", out]  # 0 ... 380 mm
    code, printed, told = metrosep("table", first, *NAMES, *SENSE, *spaced)
    assert code == 0, told
    assert np.loadtxt(out, delimiter=",", skiprows=1)[-1, 0] == 380.0
    end = np.interp(380.0, TARGETS, machine(TARGETS, 1))  # as the page has it: linear between
    errors = np.append(machine(TARGETS[TARGETS < 380.0], 1), end)
    judged = json.loads(printed)["verification"]["residuals"]
    forward = next(d for d in judged if d["direction"] == "forward")
    assert forward["before_pv_m"] == pytest.approx(np.ptp(errors) * 1e-3, abs=20e-9)

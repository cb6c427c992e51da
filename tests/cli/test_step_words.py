"""Messages of the library in the words of who typed: every key of every method, with its unit."""

import tomllib

import pytest

from metrosep.core.methods import METHODS
from metrosep.core.options import KINDS
from metrosep.recipe.step_help import step_words

SINGLE = ("length", "size", "uncertainty", "angle", "time", "speed", "frequency")
KEYS = [(op, key) for op, m in METHODS.items() for key in m.fields if key != "op"]
OPEN = ("any", "windows", "places", "pairs", "table", "column", "range", "limit")  # no single form
ROUNDING = 1e-5  # of a printed number of six digits


@pytest.mark.parametrize(("op", "key"), KEYS)
def test_every_key_is_written_as_its_recipe_takes_it(op, key):
    field = METHODS[op].fields[key]
    words = step_words(f"no {key}= was given", op)
    assert words.startswith(f"no {key} = "), words
    if field.choices or field.kind in OPEN:
        return
    toml = words.removeprefix("no ").removesuffix(" was given").replace("...", "1")
    value = tomllib.loads(toml)[key]
    if field.kind == "spacing":
        value = "1 mm"
    KINDS[field.kind].check(value, "value", False)  # refuses a wrong unit or kind

    option = step_words(f"no {key}= was given", op, command=True)
    assert option.startswith(f"no --set {key}=")


@pytest.mark.parametrize(
    ("op", "key"), [k for k in KEYS if METHODS[k[0]].fields[k[1]].kind in SINGLE]
)
def test_a_number_in_si_keeps_its_value(op, key):
    words = step_words(f"pass {key}=0.00123456 here", op)
    typed = tomllib.loads(words.removeprefix("pass ").removesuffix(" here"))[key]
    value = KINDS[METHODS[op].fields[key].kind].check(typed, "value", False)
    assert value == pytest.approx(0.00123456, abs=0.00123456 * ROUNDING)


@pytest.mark.parametrize(
    ("op", "message", "recipe", "option"),
    [
        ("three_point", "pass zero=0.0 to keep", 'pass zero = "0 nm" to keep', 'pass --set zero="0 nm" to keep'),
        ("multistep", "give eccentricity='free'", 'give eccentricity = "free"', "give --set eccentricity=free"),
        ("integrate_slopes", "say zero_known=True", "say zero_known = true", "say --set zero_known=true"),
        ("iso230_6_diagonals", "pass size=(X, Y, Z), the", 'pass size = ["... mm", "... mm", "... mm"], the',
         'pass --set size="... mm, ... mm, ... mm", the'),
        ("iso230_7", "needs angle= (rad)", 'needs angle = "COLUMN" in [input] (rad)', "needs --angle COLUMN (rad)"),
        ("three_point", "with pitch=, or", 'with pitch = "COLUMN" in [input], or', "with --column pitch=COLUMN, or"),
        ("three_flat", "give dx= in m as well", 'give lateral_step = "... um" in [input] as well',
         'give --lateral-step "... um" as well'),
        ("register_maps", "give start=(shift_x, shift_y, angle)",
         'give shift_x = "... mm", shift_y = "... mm" and angle = "... deg"',
         'give --set shift_x="... mm", --set shift_y="... mm" and --set angle="... deg"'),
        ("donaldson", "give repeats, or u_reading", 'give repeats, or u_reading = "... nm"',
         'give repeats, or --set u_reading="... nm"'),
        ("iso230_7", "set threshold=", "set threshold = ...", "give --set threshold=..."),
        ("integrate_slopes", 'name it, x = "x_mm"', 'name it, x = "x_mm"', "name it, --x x_mm"),
        ("three_flat", 'angles = ["90 deg"]', 'angles = ["90 deg"]', '--set angles="90 deg"'),
    ],
)  # fmt: skip
def test_arguments_become_keys_or_options(op, message, recipe, option):
    assert step_words(message, op) == recipe
    assert step_words(message, op, command=True) == option


@pytest.mark.parametrize(
    "message",
    ["twice k=1, kept", "p = 0.03", "see runs.select(direction=1)", "n_other=3", "a == b", "got m=(3, 4)"],
)  # fmt: skip
def test_what_is_no_key_stays(message):
    assert step_words(message, "evidence_table", command=True) == message
    assert step_words(message, "no such step") == message


def test_numbers_of_metres_and_speeds_become_readable():
    message = (
        "v_max = 0.08 m/s is below v_min = 0.15 m/s; speeds are in m/s (96 mm/s is 0.096 m/s)"
    )
    assert step_words(message, "plan_from_density") == (
        "v_max = 4800 mm/min is below v_min = 9000 mm/min"
    )
    assert "558 um, more" in step_words("fix it to 0.000558 m, more", "stitch")
    assert "over 2 m" in step_words("a sag over 2 m", "three_point")


def test_notes_name_the_option_or_the_key(metrosep, repository, tmp_path):
    file = repository / "examples" / "three_point" / "readings.csv"
    words = (file, "--method", "three_point", "--readings", "trailing_nm,middle_nm,leading_nm",
             "--x", "x_mm", "--set", "distance=10 mm")  # fmt: skip
    out = tmp_path / "out"
    code, _, err = metrosep("separate", *words, "-o", out)
    assert code == 0
    assert '--set zero="0 nm"' in err
    assert '--set u_reading="... nm"' in err
    assert "zero=0.0" not in err
    report = (out / "report.html").read_text("utf-8")
    assert "zero = &#34;0 nm&#34;" in report
    assert "zero=0.0" not in report

    _, text, _ = metrosep("separate", *words, "--print-recipe")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(text, "utf-8")
    _, _, err = metrosep("run", recipe, file, "-o", tmp_path / "other")
    assert 'zero = "0 nm"' in err
    assert "--set" not in err


def test_errors_name_the_option_or_the_key(metrosep, repository, tmp_path):
    file = repository / "examples" / "spindle" / "spindle.csv"
    words = (file, "--method", "iso230_7", "--readings", "gap_nm", "--time", "t_ms",
             "--column", "index=index_V", "--set", "threshold=100")  # fmt: skip
    code, _, err = metrosep("separate", *words)
    assert code == 4
    assert "--set threshold=" in err

    _, text, _ = metrosep("separate", *words, "--print-recipe")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(text, "utf-8")
    code, _, err = metrosep("run", recipe, file, "-o", tmp_path / "out")
    assert code == 4
    assert "threshold = ..." in err
    assert "--set" not in err


def test_null_space_is_told_once_for_several_parts(metrosep, repository):
    file = repository / "examples" / "reversal" / "donaldson.csv"
    code, _, err = metrosep(
        "separate", file, "--method", "donaldson", "--readings", "m1_nm,m2_nm",
        "--angle", "angle_deg", "--repeat", "revolution",
    )  # fmt: skip
    assert code == 0, err
    assert err.count("not seen:") == 1
    assert "not seen: artefact, spindle: terms offset, eccentricity" in err


@pytest.mark.parametrize(
    ("op", "words"),
    [
        ("filter", "start anew (refilter = true does it all the same)"),
        ("parameters", "start anew"),  # which has no such key
    ],
)
def test_a_way_out_of_python_is_said_where_the_step_has_it(op, words):
    library = "start anew (refilter=True in Python does it all the same)"
    assert step_words(library, op) == words

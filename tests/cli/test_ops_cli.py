"""Every named separation from the command line: options to recipe, numbers, refusals by option."""

import json
import tomllib

import pytest

from metrosep.core.methods import METHODS

REV = 'repeat = "revolution"'


REACHED = ",".join(f"reached_{i}_mm" for i in range(1, 6))
CALLS = {
    "multiprobe/recipe.toml": (
        ("readings.csv --method multiprobe --readings p0_nm,p1_nm,p2_nm,p3_nm --angle angle_deg "
        "--repeat revolution"),
        ["angles=0 deg,20.6 deg,47.8 deg,326.5 deg", "kmax=30"],
    ),
    "mirror_slopes/recipe.toml": (
        ("slopes.csv --method integrate_slopes --readings "
        "pass1_urad,pass2_urad,pass3_urad,pass4_urad --x x_mm"),
        ["method=spline"],
    ),
    "three_point/recipe.toml": (
        ("readings.csv --method three_point --readings trailing_nm,middle_nm,leading_nm --x x_mm "
        "--column pitch=pitch_urad"),
        ["distance=10 mm", "method=least_squares", "u_reading=1 nm", "u_pitch=0.05 urad"],
    ),
    "positioning/recipe.toml": (
        (f"runs.csv --method iso230_2 --readings {REACHED} --column target=target_mm "
        "--direction direction"),
        [],
    ),
    "positioning/diagonals.toml": (
        (f"diagonals.csv --method iso230_6_diagonals --readings {REACHED} "
        "--column target=target_mm --column diagonal=diagonal --direction direction"),
        ["size=500 mm,400 mm,300 mm"],
    ),
    "drift/recipe.toml": (
        "warm_up.csv --method iso230_3_drift --readings EX0C_um,EY0C_um,EZ0C_um --time t_s",
        ["kind=spindle", "windows=0 min..60 min,180 min..240 min", "span=60 min"],
    ),
    "drift/sequence.toml": (
        "sequence.csv --method joint_drift --readings reading_nm --time t_s --column label=master",
        ["degree=2"],
    ),
    "drift/speeds.toml": (
        ("speeds.csv --method speed_dependence --column speed=speed_rev_per_s "
        "--column amplitude=amplitude_nm"),
        [],
    ),
    "spindle/recipe.toml": (
        "spindle.csv --method iso230_7 --readings gap_nm --time t_ms --column index=index_V",
        ["direction=radial", "kmax=30"],
    ),
    "xy_plane/recipe.toml": (
        "plane.csv --method fit_plane_model --x x_mm --column y=y_mm --z z_um --repeat repeat",
        ["zero=own"],
    ),
    "feedrate_plan/recipe.toml": (
        ("density.csv --method plan_from_density --column frequency=frequency_hz "
        "--column psd=psd_nm2_per_hz"),
        ["v_min=4800 mm/min", "v_max=9600 mm/min", "n_runs=9", "length=70 mm",
         "wavelengths=20 mm,10 mm,5 mm,3.3 mm,2 mm"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_options_make_the_recipe_of_the_example(name, metrosep, repository):
    words, settings = CALLS[name]
    given = [w for s in settings for w in ("--set", s)]
    code, out, err = metrosep("separate", *words.split(), *given, "--print-recipe")

    assert code == 0, err
    made = tomllib.loads(out)
    wanted = tomllib.loads((repository / "examples" / name).read_text("utf-8"))
    wanted["input"].pop("files")
    assert made["input"] == wanted["input"]
    assert made["step"] == wanted["step"]


def test_positions_in_json(metrosep, repository):
    folder = repository / "examples" / "positioning"
    words, _ = CALLS["positioning/recipe.toml"]
    code, out, err = metrosep(
        "separate", *words.replace("runs.csv", str(folder / "runs.csv")).split(), "--json"
    )

    assert code == 0, err
    values = {c["metric"]: c for c in json.loads(out)["characteristics"]}
    truth = dict(r.split(",") for r in (folder / "truth.csv").read_text().splitlines()[1:])
    assert values["B_mean"]["value"] == pytest.approx(
        float(truth["reversal_um"]) * 1e-6, abs=4 * values["B_mean"]["u"]
    )


def test_values_are_printed_one_a_line(metrosep, repository):
    file = repository / "examples" / "drift" / "speeds.csv"
    words, _ = CALLS["drift/speeds.toml"]
    code, out, err = metrosep("separate", *words.replace("speeds.csv", str(file)).split())
    assert code == 0, err
    assert out == ""
    assert "c0: 17.60 nm (u = 240 pm)" in err


def test_a_folder_gets_table_report_and_result(metrosep, repository, tmp_path):
    file = repository / "examples" / "xy_plane" / "plane.csv"
    words, settings = CALLS["xy_plane/recipe.toml"]
    given = [w for s in settings for w in ("--set", s)]
    words = words.replace("plane.csv", str(file)).split()
    code, _, err = metrosep("separate", *words, *given, "-o", tmp_path / "out")
    assert code == 0, err
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == [
        "parts-model.h5", "parts-residual.h5", "parts-y.csv", "parts.csv", "report.html",
        "result.json",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("--method iso230_2 --column tgt=target_mm", "--column tgt: unknown key"),
        ("--method multiprobe --readings a,b,c --set kmax=3", 'needs the key "angles"'),
        ("--method multiprobe --readings a,b,c --set kmax=3 --set angles=1,2", "--set angles"),
        ("--method iso230_7 --readings a --set center=XYZ", "--set center"),
        ("--method multiprobe --readings a,b,c --set kmax=ten", "--set kmax: a number"),
        ("--method multistep --readings a,b --set steps=8,x", "--set steps: a number"),
        ("--method donaldson --readings a,b --x c", "--x is not read by --method donaldson"),
        ("--method two_point --readings a,b --angle c", "--angle is not read by"),
        ("--method three_flat --readings a", "--readings is not read by"),
        ("--method iso230_2 --unit mm", "--unit is not read by"),
        ("--method iso230_7 --readings a --z b", "--z belongs to repeated runs"),
        ("--method iso230_2 --feed b", "--column (target, direction, readings, cycle)"),
        ("--method three_flat --drift 1", "--drift belongs to repeated runs"),
        ("--x a --z b --column c=d", "--column belongs to a named separation"),
        ("--x a --z b --drift 4", "--drift"),
        ("--x a --z b --lines fast", "--lines"),
        ("--method kono --x x_mm --z z_um --run run --feed feed_mm_min --robust", "robust"),
    ],
)
def test_options_that_do_not_fit_are_refused_by_their_name(metrosep, repository, words, match):
    file = repository / "examples" / "straightness" / "runs.csv"
    code, out, err = metrosep("separate", file, *words.split())
    assert code in (2, 4)
    assert out == ""
    assert match in err
    assert err.count("error:") == 1


def test_options_of_the_joint_separation(metrosep):
    code, out, _ = metrosep(
        "separate", "r.csv", "--x", "x_mm", "--z", "z_um", "--drift", "1", "--lines", "50 Hz,100 Hz",
        "--robust", "--print-recipe",
    )  # fmt: skip
    assert code == 0
    step = tomllib.loads(out)["step"][0]
    assert (step["drift"], step["lines"], step["robust"]) == (1, ["50 Hz", "100 Hz"], True)
    _, out, _ = metrosep(
        "separate", "r.csv", "--x", "x_mm", "--z", "z_um", "--lines", "auto", "--print-recipe"
    )
    assert tomllib.loads(out)["step"][0]["lines"] == "auto"


def test_ops_fits_a_screen_and_names_the_columns(metrosep):
    code, out, _ = metrosep("ops")
    assert code == 0
    assert max(len(line) for line in out.splitlines()) <= 100
    assert "reads table; columns time, readings" in out
    code, out, _ = metrosep("ops", "--json")
    rows = {row["op"]: row for row in json.loads(out)}
    assert set(METHODS) < set(rows)
    assert rows["joint_drift"]["columns"] == {"time": "time?", "label": "label?"}
    for name, row in rows.items():
        assert 20 < len(row["what"]) <= 95, name


@pytest.fixture(scope="module")
def separated(tmp_path_factory):
    from pathlib import Path

    import metrosep as ms

    folder = Path(__file__).parents[2] / "examples" / "straightness"
    out = tmp_path_factory.mktemp("separated") / "out"
    text = (folder / "recipe.toml").read_text("utf-8")  # as it stands: tests/recipe/test_examples
    text = (
        text[: text.index("[[step]]")]
        + '[[step]]\nop = "separate"\nlength = "45 mm"\nshortest = "1 mm"\n'
    )
    ms.Recipe.parse(text).run(folder / "runs.csv", out=out)
    return out


PLAN = ("--v-min", "4800 mm/min", "--v-max", "9600 mm/min", "--runs", "6")


def test_plan_prints_feeds_and_what_they_promise(metrosep, separated):
    code, out, err = metrosep("plan", separated, *PLAN, "--wavelengths", "10 mm,5 mm")
    assert code == 0, err
    assert out == ""
    assert "run(s) at 4800 mm/min" in err
    assert "10 mm: sd" in err

    code, out, _ = metrosep(
        "plan", separated / "result.json", *PLAN, "--wavelengths", "5 mm..10 mm", "--json"
    )
    found = json.loads(out)
    assert code == 0
    assert sum(n for _, n in found["runs"]) == 6
    assert len(found["sd"]["sd_nm"]) > 10
    assert "charts" not in found


@pytest.mark.parametrize(
    ("words", "code", "match"),
    [
        (("--v-min", "4800 mm", "--v-max", "9600 mm/min", "--runs", "6", "--wavelengths", "5 mm"), 2, "--v-min"),
        ((*PLAN, "--wavelengths", "5 s"), 2, "--wavelengths"),
        ((*PLAN, "--wavelengths", "500 mm"), 2, "wave"),
        ((*PLAN[:4], "--wavelengths", "5 mm"), 2, "--runs"),
        ((*PLAN, "--wavelengths", "5 mm", "--min-ratio", "0.9"), 2, "--min-ratio"),
    ],
)  # fmt: skip
def test_plan_refuses(metrosep, separated, words, code, match):
    found, out, err = metrosep("plan", separated, *words)
    assert found == code
    assert out == ""
    assert match in err


def test_plan_speaks_of_its_options_and_in_mm_per_min(metrosep, separated):
    slow = ("--v-min", "9000 mm/min", "--v-max", "4800 mm/min", "--wavelengths", "5 mm")
    code, _, err = metrosep("plan", separated, *slow, "--runs", "6")
    assert code == 2
    assert "--v-max 4800 mm/min is below --v-min 9000 mm/min" in err
    assert "m/s" not in err

    code, _, err = metrosep("plan", separated, *PLAN[:4], "--runs", "0", "--wavelengths", "5 mm")
    assert "--runs must be a whole number from 1, got 0" in err
    assert "n_runs" not in err

"""Named separations from the command line: what is printed, written, refused."""

import json

import numpy as np
import pytest

from metrosep.core.methods import METHODS
from metrosep.recipe.pipeline import MEASURING as PIPELINE

N = 24
ANGLE = 2 * np.pi * np.arange(N) / N
BALL, SPINDLE = 50.0 * np.cos(3 * ANGLE + 0.3), 20.0 * np.sin(2 * ANGLE)


@pytest.fixture
def readings(tmp_path):
    file = tmp_path / "m.csv"
    rows = [
        f"{np.degrees(a):.9f},{b + s:.6f},{b - s:.6f}"
        for a, b, s in zip(ANGLE, BALL, SPINDLE, strict=True)
    ]
    file.write_text("\n".join(["angle_deg,m1_nm,m2_nm", *rows]) + "\n", "ascii")
    return file


NAMED = ("--method", "donaldson", "--readings", "m1_nm,m2_nm", "--angle", "angle_deg")


def test_json_holds_values_null_space_and_nothing_else_on_stdout(metrosep, readings):
    code, out, err = metrosep("separate", readings, *NAMED, "--set", "u_reading=1 nm", "--json")

    assert code == 0, err
    summary = json.loads(out)
    values = {c["metric"]: c["value"] for c in summary["characteristics"]}
    assert values["spindle.pv"] == pytest.approx(np.ptp(SPINDLE) * 1e-9, abs=1e-14)
    assert values["artefact.pv"] == pytest.approx(np.ptp(BALL) * 1e-9, abs=1e-14)
    assert summary["separation"]["null_space"][0]["indices"] == ["offset", "eccentricity"]
    assert summary["separation"]["noise"]["value"] == 1e-9


def test_folder_gets_parts_report_and_result(metrosep, readings, tmp_path):
    out = tmp_path / "out"
    code, _, err = metrosep("separate", readings, *NAMED, "-o", out)

    assert code == 0, err
    assert sorted(f.name for f in out.iterdir()) == ["parts.csv", "report.html", "result.json"]
    assert "not seen: artefact, spindle: terms offset, eccentricity" in err
    assert "u_reading" in err  # nothing tells the noise: it is said


def test_printed_recipe_does_the_same(metrosep, readings, tmp_path):
    _, text, _ = metrosep(
        "separate", readings, *NAMED, "--set", "u_index=0.1 deg", "--print-recipe"
    )
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(text, "utf-8")

    code, out, err = metrosep("run", recipe, readings, "-o", tmp_path / "out", "--json")

    assert code == 0, err
    assert json.loads(out)["separation"]["audit"]["u_index_rad"] == pytest.approx(
        np.radians(0.1), abs=1e-12
    )


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("--method", "donaldsen"), 'Did you mean "donaldson"'),
        ((*NAMED, "--z", "m1_nm"), "--z belongs to repeated runs"),
        ((*NAMED, "--set", "radius=2 mm"), 'unknown key "radius"'),
        ((*NAMED, "--set", "u_index=2 mm"), "u_index"),
        ((*NAMED, "--set", "u_index"), "NAME=VALUE"),
        (("--method", "joint", "--readings", "m1_nm"), "belongs to a named separation"),
        (("--x", "a", "--z", "b", "--angle", "c"), "--angle belongs to a named separation"),
        (("--x", "a", "--z", "b", "--set", "c=1"), "--set c: unknown key"),
    ],
)
def test_options_that_do_not_belong_are_refused(metrosep, readings, words, match):
    code, out, err = metrosep("separate", readings, *words)

    assert code == 2
    assert out == ""
    assert match in err
    assert err.count("error:") == 1


def test_missing_column_names_those_that_there_are(metrosep, readings):
    code, _, err = metrosep(
        "separate", readings, "--method", "donaldson", "--readings", "m1_nm,m3_nm"
    )
    assert code == 4
    assert "m2_nm" in err


def test_ops_lists_every_step(metrosep):
    code, out, _ = metrosep("ops")
    assert code == 0
    listed = {line.split(":")[0] for line in out.splitlines() if not line.startswith(" ")}
    assert listed == {
        "separate",
        "polynomial",
        "plan_feedrates",
        "laser_setup",
        *METHODS,
        *PIPELINE,
    }

    code, out, _ = metrosep("ops", "--json")
    rows = {row["op"]: row for row in json.loads(out)}
    assert rows["face_reversal"]["keys"]["radius"] == "size"


def test_one_step_is_explained_key_by_key(metrosep):
    code, out, _ = metrosep("ops", "multiprobe")
    assert code == 0
    whole = out.replace("\n        ", " ")  # a long entry goes on in the next line
    lines = {line.split(":")[0].strip(): line for line in whole.splitlines()}
    assert "needed" in lines["kmax"]
    assert "deg" in lines["angles"]

    code, _, err = metrosep("ops", "multprobe")
    assert code == 2
    assert 'Did you mean "multiprobe"' in err


def test_every_option_of_repeated_runs_can_be_set(metrosep, tmp_path):
    words = (
        "separate",
        "r.csv",
        "--x",
        "x_mm",
        "--z",
        "z_um",
        "--method",
        "kono",
        "--print-recipe",
    )
    code, out, _ = metrosep(*words, "--set", "norm=power", "--set", "feed=4800 mm/min")
    assert code == 0
    assert 'norm = "power"\nfeed = "4800 mm/min"' in out
    code, _, err = metrosep(*words[:-1], "--set", "norm=powr")
    assert code == 2
    assert "--set norm 'powr' is not one of amplitude, power, psd" in err
    code, _, err = metrosep(*words[:-1], "--min-feeds", "0")
    assert code in (2, 4)
    code, _, err = metrosep(*words, "--lag", "fit", "--set", "lag=1 ms")
    assert (code, "lag is given twice" in err) == (2, True)

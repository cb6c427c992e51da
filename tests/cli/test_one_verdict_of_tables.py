"""A table that its controller cannot hold is refused by every door, in one sentence, and judged by none."""

import json
import re

import numpy as np
import pytest
from contracts.recipes import mean_of_runs

PEAK_UM, AT_MM, WIDTH_MM = 2.0, 15.0, 4.0
"""An error of one bump, lopsided over the travel of 50 mm."""

CEC = 'input_axis = "AX1", output_axis = "AX3"'
PMAC = "source_motor = 1, target_motor = 3"
SURE = "sign_confirmed = true"

CASES = {
    "coverage": ("csv", 'travel_high = "60 mm"', "", "1 mm", r"the travel is 0 \.\.\. 60 mm"),
    "coarse step": ("pmac", f'{PMAC}, count = "5 um"', "", "1 mm", "rounding would dominate"),
    "entry": ("sinumerik-cec", f'{CEC}, value_limit = "1 um"', SURE, "1 mm", "MD32720"),
    "points": (
        "sinumerik-cec",
        f"{CEC}, points_limit = 20",
        SURE,
        "1 mm",
        "51 entries over X, a table holds 20",
    ),
    "digits": ("sinumerik-cec", f"{CEC}, decimals = 2", SURE, "1 mm", "rounding would dominate"),
    "axis": ("linuxcnc", "", "", "1 mm", "cross_axis"),
}
"""Controller, machine, another key, spacing, and what the refusal says."""


def recipe_of(case, spoilt=True):
    controller, machine, more, spacing, _ = CASES[case] if spoilt else ("csv", "", "", "1 mm", "")
    return f"""{mean_of_runs()}[[check]]
metric = "pv"
upper = "9 um"
[[output]]
kind = "table"
controller = "{controller}"
axis = "X"
compensates = "Z"
spacing = "{spacing}"
path = "t.out"
machine = {{ {machine} }}
{more}
"""


@pytest.fixture
def folder(tmp_path):
    """Four runs of one error, in a folder of their own."""
    rng = np.random.default_rng(7)
    x = np.linspace(0.0, 50.0, 101)
    rows = ["run,x_mm,z_um"]
    for run in range(4):
        z = PEAK_UM * np.exp(-(((x - AT_MM) / WIDTH_MM) ** 2)) + 2e-3 * rng.standard_normal(x.size)
        rows += [f"{run},{a:.6f},{b:.7f}" for a, b in zip(x, z, strict=True)]
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


def page(folder, text):
    """What the workbench shows beside the numbers, and in its tab of the table."""
    from metrosep.app.documents import Places
    from metrosep.app.server import Answers
    from metrosep.app.sessions import Session

    (folder / "shown.toml").write_text(text)
    session = Session(Places([folder]))
    session.open(str(folder / "shown.toml"))
    ask = Answers(session).answer
    return ask({"k": "metrics", "level": "full"})[0], ask({"k": "table"})[0]


@pytest.mark.parametrize("case", CASES)
def test_what_is_refused_at_writing_is_refused_by_every_door(metrosep, folder, case):
    reason, text = CASES[case][4], recipe_of(case)
    (folder / "r.toml").write_text(text)
    metrics, table = page(folder, text)
    worth = 2 if case == "axis" else 1

    assert metrics["verdict"] is None
    assert metrics["rows"]  # the numbers are shown all the same
    shown = reason.replace("cross_axis", "cross axis")  # the page has fields, not keys
    assert re.search(shown, metrics["refused"]), metrics["refused"]
    assert re.search(shown, table["refused"]["message"])
    out = folder / "out"
    code, _, err = metrosep("run", folder / "r.toml", folder / "runs.csv", "-o", out)
    assert code == worth
    assert re.search(reason, err), err
    assert not out.exists()
    code, _, err = metrosep(
        "batch", folder / "r.toml", folder, "-o", out, "--scheduler", "serial", "--json"
    )
    assert code == 6
    (row,) = json.loads((out / "index.json").read_text())["rows"]
    assert row["verdict"] is None
    assert re.search(reason, row["reason"])
    assert not list(out.rglob("t.out"))
    (folder / "plain.toml").write_text(text[: text.index("[[output]]")])
    assert metrosep("run", folder / "plain.toml", folder / "runs.csv", "-o", folder / "p")[0] == 0
    controller, machine, more, spacing, _ = CASES[case]
    facts = [f.replace(" ", "", 2).replace('"', "") for f in machine.split(", ") if f]
    code, _, err = metrosep(
        "table", folder / "p", "--format", controller, "--axis", "X", "--compensates", "Z", "--spacing",
        spacing, "-o", folder / "t.out", *(w for f in facts for w in ("--machine", f)),
        *(("--sign-confirmed",) if more else ()),
    )  # fmt: skip
    assert code == worth
    assert re.search(reason.replace("cross_axis", "cross.axis"), err), err
    assert not (folder / "t.out").exists()


def test_what_every_door_accepts(metrosep, folder):
    text = recipe_of("axis", spoilt=False)
    (folder / "r.toml").write_text(text)
    metrics, table = page(folder, text)

    assert metrics["verdict"] == "accept"
    assert "refused" not in metrics
    assert "refused" not in table
    assert metrosep("run", folder / "r.toml", folder / "runs.csv", "-o", folder / "out")[0] == 0
    assert (folder / "out" / "t.out").is_file()

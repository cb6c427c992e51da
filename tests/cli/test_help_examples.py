"""The calls that the help shows run on files of the kind that they name, and are accepted."""

import shlex
import shutil

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.examples import EXAMPLES

SLOW = {  # command, numbers of its examples
    "measure": (0,), "psd": (0,), "run": (0, 1), "batch": (0, 1), "separate": (0, 1), "plan": (0,),
    "calibrate": (0, 1), "table": (0,), "volume": (0,), "verify": (0,), "rank": (0, 1), "predict": (0,),
    "demo": (0,), "machine-tables": (0, 1), "path": (0, 1), "read": (0,), "report": (0, 1), "diff": (0, 1),
    "thermal": (0,), "verify-softgauge": (0,), "info": (), "ui": (0, 1), "listen": (0, 1, 2), "doctor": (0,),
    "completion": (0,),
}  # fmt: skip
"""Not run here: a second and more each, results of another example, an instrument or a page."""
FAST = [
    example
    for command, examples in EXAMPLES.items()
    for number, example in enumerate(examples)
    if number not in SLOW.get(command, ())
]


@pytest.fixture(scope="module")
def files(tmp_path_factory, repository):
    """Write each file once, by formulas; those that a call makes of another are made in order."""
    folder = tmp_path_factory.mktemp("examples")
    rng = np.random.default_rng(3)

    def write(name, head, rows):
        (folder / name).write_text(
            "\n".join([*head, *(",".join(map(str, r)) for r in rows)]) + "\n"
        )

    y, x = np.mgrid[-20:21, -20:21] * 0.2e-3
    r2 = x**2 + y**2
    ball = r2 / (50e-3 + np.sqrt(2500e-6 - r2)) + 1e-9 * np.sin(3000.0 * x)
    ms.write(ms.Surface(ball, 0.2e-3, 0.2e-3), folder / "part.x3p")
    there = [(t, "+") for t in range(0, 201, 20)]
    back = [(t, "-") for t in range(200, -1, -20)]
    error = lambda t, d: 0.02 * t + np.sin(t / 30.0) + 0.3 * (d == "-")  # noqa: E731
    rows = [(t, d, *(error(t, d) + rng.normal(0.0, 0.02, 3)).round(4)) for t, d in there + back]
    write("laser.csv", ["target_mm,dir,e1_um,e2_um,e3_um"], rows)
    groove = [(u, round(-500.0 * (250 <= u < 350) + rng.normal(), 3)) for u in range(600)]
    write("groove.csv", ["x_um,z_nm"], groove)
    turn = np.radians(np.arange(0, 360, 10))
    points = [
        (round(10 * np.cos(a) + 5e-4 * np.sin(3 * a), 6), round(10 * np.sin(a), 6), z)
        for z in (0, 5, 10)
        for a in turn
    ]
    write("points.csv", ["x_mm,y_mm,z_mm"], points)
    arc = [(v, *2 * (round(3 * np.sin(np.radians(2 * v)), 4),)) for v in range(360)]
    write("ballbar.csv", ["angle_deg,ccw_um,cw_um"], arc)
    shutil.copy(repository / "examples" / "straightness" / "recipe.toml", folder)
    rows = (repository / "examples" / "straightness" / "runs.csv").read_text("utf-8").splitlines()
    write("runs.csv", rows[:1], [r.split(",") for r in rows[1:2000]])
    rows = (repository / "examples" / "reversal" / "donaldson.csv").read_text("utf-8").splitlines()
    write("ball.csv", rows[:1], [r.split(",") for r in rows if r.startswith("1,")])
    write("slices.xyz", [], [(f"{i} {j} {0.1 * i}",) for i in range(9) for j in range(9)])
    ms.write(ms.Surface(ball, 0.2e-3, 0.2e-3), folder / "part.sdf")
    (folder / "part.sdf").rename(folder / "part.dat")
    return folder


def test_the_examples_of_the_help_are_accepted_on_files_of_their_kind(
    metrosep, files, monkeypatch
):
    """In the order of the help, where one reads what another wrote."""
    monkeypatch.chdir(files)
    refused = {}
    for example in FAST:
        if example.startswith("metrosep convert part.dat"):
            (files / "part.x3p").unlink()  # that it writes
        code, _, err = metrosep(*shlex.split(example.partition(" > ")[0])[1:])
        if code:
            refused[example] = err
    assert not refused
    assert len(FAST) > 20

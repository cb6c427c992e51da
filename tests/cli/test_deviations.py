"""A positioning test whose table holds deviations: the same result, and the other kind refused."""

import json

import numpy as np
import pytest

from metrosep.cli.main import main
from metrosep.core.errors import InvalidSamplesError
from metrosep.core.methods import RoleColumns
from metrosep.separation.positions.positioning import as_positions

SAME = 1e-12  # m: what the sum of target and deviation rounds
RUNS = 5
TARGET = np.arange(6) * 0.05
LEAD, LOST = 2e-5, 4e-6  # 20 um/m too long; backward reads 4 um higher


@pytest.fixture
def metrosep(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        return stop.value.code, out.out, out.err

    return call


@pytest.fixture
def tables(tmp_path):
    """The same test as positions in mm and as deviations in um."""
    noise = np.random.default_rng(7).normal(0.0, 3e-7, (2, TARGET.size, RUNS))
    rows = {"position": [], "deviation": []}
    for i, way in enumerate(("fwd", "bwd")):
        deviation = (LEAD * TARGET + i * LOST)[:, None] + noise[i]
        for t, d in zip(TARGET, deviation, strict=True):
            rows["position"].append([f"{t * 1e3:.3f}", way, *(f"{(t + v) * 1e3:.9f}" for v in d)])
            rows["deviation"].append([f"{t * 1e3:.3f}", way, *(f"{v * 1e6:.6f}" for v in d)])
    files = {}
    for kind, unit in (("position", "mm"), ("deviation", "um")):
        header = ["target_mm", "direction", *(f"r{i}_{unit}" for i in range(RUNS))]
        files[kind] = tmp_path / f"{kind}.csv"
        text = "\n".join(",".join(r) for r in [header, *rows[kind]]) + "\n"
        files[kind].write_text(text, "ascii")
    return files


def words(file, unit):
    columns = ",".join(f"r{i}_{unit}" for i in range(RUNS))
    return ("separate", file, "--method", "iso230_2", "--readings", columns, "--column",
            "target=target_mm", "--direction", "direction", "--json")  # fmt: skip


def test_deviations_give_the_values_of_the_positions(metrosep, tables):
    code, out, err = metrosep(*words(tables["position"], "mm"))
    assert code == 0, err
    wanted = {c["metric"]: c["value"] for c in json.loads(out)["characteristics"]}
    code, out, err = metrosep(*words(tables["deviation"], "um"), "--set", "values=deviation")
    assert code == 0, err
    found = {c["metric"]: c["value"] for c in json.loads(out)["characteristics"]}
    for key, value in wanted.items():
        assert found[key] == pytest.approx(value, abs=SAME), key
    assert wanted["B_mean"] == pytest.approx(-LOST, abs=5e-7)  # forward minus backward
    assert wanted["M"] == pytest.approx(LEAD * TARGET[-1], abs=5e-7)


def test_each_kind_taken_for_the_other_is_refused(metrosep, tables):
    code, _, err = metrosep(*words(tables["deviation"], "um"))
    assert code == 4
    assert "look like deviations" in err
    assert "--set values=deviation" in err
    code, _, err = metrosep(*words(tables["position"], "mm"), "--set", "values=deviation")
    assert code == 4
    assert "look like positions" in err
    code, _, err = metrosep(*words(tables["position"], "mm"), "--set", "values=error")
    assert code == 2
    assert "position, deviation" in err


def test_sign_shape_and_gaps_of_the_conversion():
    target = np.array([0.0, 0.1, 0.2])
    deviation = np.array([[1e-6, np.nan, 3e-6], [4e-6, 5e-6, 6e-6]])  # a row for each run
    reached = as_positions(
        RoleColumns({"target": target, "readings": deviation}, "a", ()), "deviation"
    )
    assert reached.values["readings"][1] == pytest.approx([4e-6, 0.1 + 5e-6, 0.2 + 6e-6], abs=SAME)
    assert np.isnan(reached.values["readings"][0, 1])
    assert deviation[1, 0] == 4e-6  # the input stays

    listed = {"target": target, "forward": deviation.T, "backward": np.empty((0, 0))}
    found = as_positions(RoleColumns(listed, "a", ()), "deviation")
    assert found.values["forward"][2] == pytest.approx([0.2 + 3e-6, 0.2 + 6e-6], abs=SAME)
    assert found.values["backward"].size == 0


def test_a_rotary_axis_speaks_of_degrees():
    data = RoleColumns(
        {"target": np.radians([0.0, 180.0, 360.0]), "readings": np.full((2, 3), 1e-5)},
        "a", (), units={"target": "rad"},
    )  # fmt: skip
    with pytest.raises(InvalidSamplesError, match="360 deg"):
        as_positions(data, "position")
    assert as_positions(data, "deviation").values["readings"].shape == (2, 3)

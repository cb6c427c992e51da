"""A travel that was measured part by part, from its readings to the written table, by the command line."""

import json

import numpy as np
import pytest

NOISE = 2.0
"""nm, of one reading."""


def error(x_mm):
    """Error in nm: a bump at one side, of one sign."""
    return 600.0 * np.exp(-(((x_mm - 27.0) / 9.0) ** 2)) + 60.0 * np.sin(2 * np.pi * x_mm / 31.0)


def parts_file(path, ends, *, repeats=3, sign=1.0):
    rng = np.random.default_rng(8)
    rows, k = ["run,feed_mm_min,x_mm,z_nm"], 0
    for low, high in ends:
        for _ in range(repeats):
            x = np.arange(low, high + 0.1, 0.5)
            z = sign * error(x) + rng.normal(0, 400) + rng.normal(0, 2) * x
            z += rng.normal(0, NOISE, x.size)
            rows += [f"r{k},1000,{a:.4f},{b:.3f}" for a, b in zip(x, z, strict=True)]
            k += 1
    path.write_text("\n".join(rows) + "\n")
    return path


ENDS = ((0, 45), (30, 75), (55, 100))
RANGE = ("--method", "mean", "--start", "0 mm", "--length", "100 mm")


def level(x, z):
    return z - np.polyval(np.polyfit(x, z, 1), x)


def test_a_travel_measured_part_by_part_becomes_a_table(tmp_path, metrosep):
    file, out, made = parts_file(tmp_path / "p.csv", ENDS), tmp_path / "o", tmp_path / "z.csv"
    code, _, told = metrosep("separate", file, *RANGE, "-o", out)
    assert code == 0, told
    call = ("--axis", "X", "--compensates", "Z", "--spacing", "1 mm", "--format", "csv")
    code, _, told = metrosep("table", out, *call, "-o", made)
    assert code == 0, told
    assert "9 runs are judged as 3 passes" in told
    lines = [line for line in made.read_text().splitlines() if not line.startswith("#")]
    assert lines[0].startswith("position_mm,correction_forward_um")
    x, c = np.array([[float(v) for v in line.split(",")[:2]] for line in lines[1:]]).T
    assert (x[0], x[-1]) == (0.0, 100.0)
    # correction = -error; the joints hold what the noise of 30 shared readings leaves
    assert np.abs(level(x, 1e3 * c + error(x))).max() < 6 * NOISE
    reading = ("--x", "x_mm", "--z", "z_nm", "--run", "run", "--feed", "feed_mm_min")
    new = parts_file(tmp_path / "new.csv", ENDS, sign=1.0)
    assert metrosep("verify", made, "--against", new, *reading)[0] == 0
    wrong = parts_file(tmp_path / "wrong.csv", ENDS, sign=-1.0)
    code, _, told = metrosep("verify", made, "--against", wrong, *reading)
    assert code == 1
    assert "reversed sign" in told


@pytest.mark.parametrize("repeats", [1, 2])
def test_too_few_passes_over_the_parts_are_no_proof(tmp_path, metrosep, repeats):
    file, out = parts_file(tmp_path / "p.csv", ENDS, repeats=repeats), tmp_path / "o"
    assert metrosep("separate", file, *RANGE, "-o", out)[0] == 0
    call = ("--axis", "X", "--compensates", "Z", "--spacing", "1 mm", "--format", "csv")
    code, _, told = metrosep("table", out, *call, "-o", tmp_path / "z.csv")
    assert code != 0
    assert "inconclusive" in told
    assert not (tmp_path / "z.csv").exists()


def test_what_an_active_table_did_is_not_the_offsets_of_the_parts(tmp_path, metrosep):
    """Each part begins at another zero, 400 nm apart: that says nothing of the table that was active."""
    call = ("--axis", "X", "--compensates", "Z", "--spacing", "1 mm", "--format", "csv")
    old, out = tmp_path / "old.csv", tmp_path / "o"
    assert metrosep("separate", parts_file(tmp_path / "p.csv", ENDS), *RANGE, "-o", out)[0] == 0
    assert metrosep("table", out, *call, "-o", old)[0] == 0
    left = parts_file(
        tmp_path / "left.csv", ENDS, sign=0.2
    )  # measured with it: a fifth is there yet
    assert metrosep("separate", left, *RANGE, "-o", tmp_path / "l")[0] == 0
    both = tmp_path / "both.csv"
    code, _, told = metrosep("table", tmp_path / "l", *call, "--active", old, "-o", both)
    assert code == 0, told
    beside = json.loads((tmp_path / "both.csv.json").read_text())["active"]
    x = np.linspace(0.0, 100.0, 401)
    rms = float(np.std(error(x)))
    # the lines of the parts are known to their mean, 2 nm/mm / sqrt(9) at 29 mm of standard deviation
    assert abs(1e9 * beside["with_it_rms_m"] - 0.2 * rms) < 30.0
    assert abs(1e9 * beside["without_any_table_rms_m"] - 1.2 * rms) < 30.0
    assert "made it worse" not in told

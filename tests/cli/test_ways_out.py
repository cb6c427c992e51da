"""A refusal names the true cause and what to type; what it names works. Files and errors are made by numpy."""

import json
import re
import shlex

import numpy as np
import pytest

TARGETS = np.arange(0.0, 101.0, 5.0)
NAMED = ["--target", "target_mm", "--direction", "dir", "--deviation", "reached-minus-target"]
NAMED += ["--readings", "e1_um,e2_um,e3_um,e4_um,e5_um", "--axis", "X"]


def listed(path, left, seed):
    """Write five cycles of a positioning test; `left` of position (mm) and direction in um."""
    rng = np.random.default_rng(seed)
    rows = ["target_mm,dir,e1_um,e2_um,e3_um,e4_um,e5_um"]
    for way, sign in (("fwd", 1), ("rev", -1)):
        for x in TARGETS[::sign]:
            read = left(x, sign) + rng.normal(0.0, 0.05, 5)
            rows.append(f"{x},{way}," + ",".join(f"{v:.4f}" for v in read))
    path.write_text("\n".join(rows) + "\n")
    return path


def whole(x, sign):
    return 3.0 * np.sin(2 * np.pi * x / 40) + 0.02 * x + (sign < 0) * 2.0


def rest(x, sign):
    return 0.8 * np.cos(2 * np.pi * x / 30) - (sign < 0) * 0.5


def sampled(path, ranges, rate=500.0):
    """Write runs over ranges in mm at three feeds; their readings are 2 um sin(2 pi x / 20 mm)."""
    rng = np.random.default_rng(4)
    rows = ["run,feed_mm_min,t_s,x_mm,z_um"]
    for k, (low, high) in enumerate(ranges):
        feed = (600, 900, 1200)[k // 2]
        t = np.arange(int((high - low) / (feed / 60) * rate)) / rate
        x = low + t * feed / 60
        z = 2.0 * np.sin(2 * np.pi * x / 20) + rng.normal(0.0, 0.03, t.size)
        rows += [
            f"{k + 1},{feed},{a:.4f},{b:.5f},{c:.4f}" for a, b, c in zip(t, x, z, strict=True)
        ]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("rate", [100.0, 400.0])
def test_a_range_that_one_run_alone_reaches_is_named_with_what_all_share(tmp_path, metrosep, rate):
    """Short runs are stored as they are, long ones as means of cells: both say the same."""
    file = sampled(tmp_path / "runs.csv", [(1.5, 60.0), *[(3.0, 60.0)] * 5], rate)
    table = [
        "--table",
        "linuxcnc=u.comp; spacing=0.4 mm",
        "--compensates",
        "Z",
        "--machine",
        "cross_axis=hal",
    ]
    call = ["separate", file, "--method", "mean", "-o", tmp_path / "out", *table]
    code, _, told = metrosep(*call, "--start", "1.5 mm", "--length", "58 mm")
    assert code == 3, told
    assert "without run 1 no run reaches 1.5 ... 3 mm; all runs share 3 ... 59." in told
    assert "folds" not in told
    way = shlex.split(
        re.search(r"separate with (--start .*?) and (--length \"[^\"]*\")", told).expand(r"\1 \2")
    )
    assert metrosep(*call, *way)[0] == 0


def test_readings_that_made_a_table_with_another_active_ask_for_it(tmp_path, metrosep):
    first = listed(tmp_path / "l1.csv", whole, 1)
    second, third = (listed(tmp_path / f"l{k}.csv", rest, k) for k in (2, 3))
    old, new = tmp_path / "s 1.comp", tmp_path / "s2.comp"
    assert metrosep("table", first, *NAMED, "-o", old)[0] == 0
    assert metrosep("table", second, *NAMED, "--active", old, "-o", new)[0] == 0
    call = ["verify", new, *NAMED[:-2], "--against"]
    code, _, told = metrosep(*call, second)
    assert code == 2
    assert "these readings made s2.comp while s 1.comp was active" in told
    assert "reverse column" not in told
    way = shlex.split(re.search(r"say (--active '[^']*')", told)[1])
    assert metrosep(*call, second, *way)[0] == 0
    code, _, told = metrosep(*call, third)  # which may have been taken with it or not
    assert code == 1
    assert f"if s 1.comp was active, as when the table was made, say --active '{old}'" in told
    assert metrosep(*call, third, *way)[0] == 0
    assert metrosep(*call, third, "--active", "none")[0] == 1


def test_the_file_that_was_active_is_found_under_the_name_that_force_gave_it(tmp_path, metrosep):
    table = tmp_path / "s.comp"
    second = listed(tmp_path / "l2.csv", rest, 2)
    assert metrosep("table", listed(tmp_path / "l1.csv", whole, 1), *NAMED, "-o", table)[0] == 0
    code, _, told = metrosep("table", second, *NAMED, "--active", table, "-o", table, "--force")
    assert code == 0, told
    _, _, told = metrosep("verify", table, *NAMED[:-2], "--against", second)
    assert f"say --active {table}.1" in told


def test_a_verdict_that_is_refused_is_printed_once(tmp_path, metrosep):
    table = tmp_path / "s.comp"
    assert metrosep("table", listed(tmp_path / "l1.csv", whole, 1), *NAMED, "-o", table)[0] == 0
    other = listed(tmp_path / "l2.csv", lambda x, sign: -whole(x, sign), 2)
    code, out, told = metrosep("verify", table, *NAMED[:-2], "--against", other)
    assert code == 1
    assert (out + told).count("the error is larger with the table than without it") == 1
    assert "reversed sign would shrink it" in told


def test_one_run_is_read_as_several_of_the_same_columns_are(tmp_path, metrosep):
    """Every sample of each file is in the result, under a name that tells the files apart."""
    several = sampled(tmp_path / "six.csv", [(0.0, 30.0)] * 6, 20.0)
    lines = several.read_text().splitlines(keepends=True)
    ones = []
    for k in (1, 3):
        ones.append(tmp_path / f"part {k}.csv")
        rows = [line for line in lines if line.startswith(f"{k},")]
        ones[-1].write_text(lines[0] + "".join(f"1,{row[2:]}" for row in rows))
    for files, names in ((ones[:1], ["1"]), (ones, ["part 1:1", "part 3:1"])):
        out = tmp_path / f"out{len(files)}"
        code, _, told = metrosep("separate", *files, "--method", "mean", "-o", out)
        assert code == 0, told
        stored = json.loads((out / "result.json").read_text())["runs"]
        assert [r["id"] for r in stored] == names
        for run, file in zip(stored, files, strict=True):
            z_um = np.loadtxt(file, delimiter=",", skiprows=1, usecols=4)
            # metres of the digits of the file
            assert run["z_m"] == pytest.approx(z_um * 1e-6, rel=0.0, abs=1e-15)
    assert metrosep("separate", *ones, "--method", "mean", "-o", out, "--x", "x_mm")[0] == 2

"""HEIDENHAIN files with a column for each corrected axis, by the command line and a recipe.

The file is read here by splitting its lines; an entry is the error in mm (positive: too far).
"""

import json
import textwrap

import numpy as np
import pytest

UM = 1e-3
"""A micrometre in mm."""

DIGIT = 0.1 * UM
"""Last digit of an entry: four decimals of a millimetre."""

AT = np.arange(0.0, 201.0, 20.0)


def pitch(x):
    return 20e-6 * x + 2 * UM * np.sin(2 * np.pi * x / 130)


def sag(x):
    return 6 * UM * (x / 200) * (1 - x / 200)


def columns(path):
    """Return titles and numbers of a .COM; BACKLASH may be empty."""
    lines = path.read_text().splitlines()
    titles = lines[1].split()
    rows = [line.split() for line in lines[2:-1]]
    return titles, np.array([[float(v) for v in r[1:]] for r in rows])


@pytest.fixture
def measured(tmp_path):
    """A laser list of X in one direction and runs of Z over X, five each."""
    rng = np.random.default_rng(4)
    rows = ["target_mm,direction,k1_um,k2_um,k3_um,k4_um,k5_um"]
    for p in AT:
        read = [pitch(p) / UM + rng.normal(0, 0.02) for _ in range(5)]
        rows.append(f"{p:.1f},up," + ",".join(f"{v:.5f}" for v in read))
    (tmp_path / "laser.csv").write_text("\n".join(rows) + "\n")
    rows = ["run,x_mm,z_um"]
    x = np.linspace(-1.0, 201.0, 810)
    for k in range(5):
        tilt = rng.normal(0, 0.5) + 0.01 * k * x
        rows += [
            f"{k + 1},{p:.5f},{z:.5f}"
            for p, z in zip(x, sag(x) / UM + tilt + rng.normal(0, 0.02, x.size), strict=True)
        ]
    (tmp_path / "z.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


LIST = ("--target", "target_mm", "--direction", "direction", "--readings", "k1_um,k2_um,k3_um,k4_um,k5_um")  # fmt: skip
COM = ("--format", "heidenhain", "--sign-confirmed")
RUNS = ("--x", "x_mm", "--z", "z_um", "--run", "run", "--axis", "X", "--compensates", "Z")


def own_file(folder, metrosep):
    out = folder / "x.com"
    how = ("--deviation", "reached-minus-target", "--axis", "X", "--spacing", "20 mm")
    code, _, told = metrosep("table", folder / "laser.csv", *LIST, *how, *COM, "-o", out)
    assert code == 0, told
    return out


def check(path):
    titles, v = columns(path)
    assert titles == ["NR", "AXISPOS", "BACKLASH", "X", "Z"]
    assert v[:, 0].tolist() == AT.tolist()
    exact = pitch(AT) - pitch(0.0)
    assert np.abs(v[:, 1] - exact).max() < 0.05 * UM + DIGIT  # noise of a mean of five, one digit
    line = np.polyfit(AT, v[:, 2] - sag(AT), 1)  # alignment: any line
    assert np.abs(v[:, 2] - sag(AT) - np.polyval(line, AT)).max() < 0.1 * UM + DIGIT


def test_a_straightness_becomes_a_column_beside_the_pitch_of_the_axis(measured, metrosep):
    first = own_file(measured, metrosep)
    one = first.read_bytes()
    out = measured / "both.com"
    more = ("--spacing", "20 mm", "--method", "mean", "--machine", f"beside={first}")
    code, _, told = metrosep("table", measured / "z.csv", *RUNS, *COM, *more, "-o", out)
    assert code == 0, told
    check(out)
    assert first.read_bytes() == one
    assert "switches off a table" not in told
    held = json.loads((measured / "both.com.json").read_text())["columns"]
    assert [held[a]["verification"]["grade"] for a in ("X", "Z")] == ["accepted"] * 2
    for column, how in (("X", ("laser.csv", *LIST, "--deviation", "reached-minus-target")), ("Z", ("z.csv", *RUNS[:6]))):  # fmt: skip
        words = ("--against", measured / how[0], *how[1:], "--machine", f"column={column}")
        code, _, told = metrosep("verify", out, *words)
        assert code == 0, told


def test_a_column_is_added_to_the_file_that_is_active_and_the_old_one_stays(measured, metrosep):
    out = own_file(measured, metrosep)
    one = out.read_bytes()
    more = ("--spacing", "1 mm", "--method", "mean")
    call = ("table", measured / "z.csv", *RUNS, *COM, *more, "-o", out, "--force")
    assert metrosep(*call)[0] == 1  # without beside= the table of X would be lost
    assert out.read_bytes() == one
    code, _, told = metrosep(*call, "--machine", f"beside={out}")
    assert code == 0, told
    check(out)  # every 20 mm, as the columns that were there
    assert (measured / "x.com.1").read_bytes() == one


def test_separate_and_a_recipe_write_the_same_columns(measured, metrosep):
    first = own_file(measured, metrosep)
    made = "heidenhain=both.com,axis=X,compensates=Z,spacing=20 mm,sign_confirmed=true,beside="
    code, _, told = metrosep(
        "separate", measured / "z.csv", *RUNS[:6], "--method", "mean", "--table", f"{made}{first}",
        "-o", measured / "one",
    )  # fmt: skip
    assert code == 0, told
    recipe = measured / "r.toml"
    recipe.write_text(
        textwrap.dedent("""
        metrosep = 1
        [input]
        x = "x_mm"
        z = "z_um"
        run = "run"
        [[step]]
        op = "separate"
        method = "mean"
        [[output]]
        kind = "table"
        controller = "heidenhain"
        axis = "X"
        compensates = "Z"
        spacing = "20 mm"
        path = "both.com"
        sign_confirmed = true
        machine = { beside = "x.com" }
        """)
    )
    code, _, told = metrosep("run", recipe, measured / "z.csv", "-o", measured / "two")
    assert code == 0, told
    check(measured / "one" / "both.com")
    data = [(measured / f / "both.com").read_bytes() for f in ("one", "two")]
    assert data[0] == data[1]


def test_columns_of_another_place_axis_or_controller_are_refused(measured, metrosep):
    first = own_file(measured, metrosep)
    out = measured / "both.com"
    call = ["table", measured / "z.csv", *RUNS, "--spacing", "20 mm", "--method", "mean"]
    beside = ["--machine", f"beside={first}", "-o", out]
    code, _, told = metrosep(*call, *beside, "--format", "linuxcnc", "--cross-axis", "hal")
    assert code == 2, told
    assert "linuxcnc holds one table in a file: leave beside= out" in told
    call[call.index("--axis") + 1] = "Y"
    code, _, told = metrosep(*call, *COM, *beside)
    assert code == 2, told
    assert "its columns are looked up over X, the new table over Y" in told
    (measured / "x.com.json").unlink()
    call[call.index("--axis") + 1] = "X"
    code, _, told = metrosep(*call, *COM, *beside)
    assert code == 2, told
    assert "with the sidecar that says how its columns were judged" in told
    short = (measured / "z.csv").read_text().splitlines()
    half = [short[0], *(r for r in short[1:] if float(r.split(",")[1]) < 120)]
    (measured / "z.csv").write_text("\n".join(half) + "\n")
    first = own_file(measured, lambda *w: metrosep(*w, "--force"))
    code, _, told = metrosep(*call, *COM, *beside)
    assert code == 2, told
    assert "the columns of x.com stand at 0 mm ... 200 mm" in told
    assert not out.exists()

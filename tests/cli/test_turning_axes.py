"""Tables of axes that turn, from continuous runs and lists, by the command line; angles in every word.

Files are read here as their formats say: the neutral CSV holds position, forward and reverse correction.
"""

import json
import re

import numpy as np
import pytest

ARCSEC = np.pi / 648000.0
NOISE = 0.05
"""arcsec or um, of one reading."""


def error(deg, way=1):
    """Error in arcsec: nothing that a straight line could take off."""
    a = np.radians(deg)
    return 9 * np.sin(a + 0.4) + 4 * np.cos(2 * a) + (1.5 if way < 0 else 0.0)


def runs_file(path, *, unit="deg", reads="arcsec", of=error, low=-2.0, high=362.0, runs=5, seed=2):
    """Write runs both ways, each with a zero of its own, taken at a steady rate."""
    rng = np.random.default_rng(seed)
    rows = [f"run,c_{unit},z_{reads}"]
    for k in range(runs):
        zero = rng.normal(0, 3)
        for way in (1, -1):
            at = np.linspace(low, high, 1500)[::way]
            z = of(at, way) + zero + rng.normal(0, NOISE, at.size)
            where = np.radians(at) if unit == "rad" else at
            rows += [f"{2 * k + (way < 0)},{w:.9f},{v:.5f}" for w, v in zip(where, z, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


def entries(path):
    """Return position, forward and reverse of a neutral CSV, with the units of its header."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = np.array([[float(v) for v in line.split(",")[:3]] for line in lines[1:]])
    return lines[0], rows


CALL = ("--x", "c_deg", "--z", "z_arcsec", "--run", "run", "--spacing", "5 deg", "--format", "csv")


def no_lengths(text):
    """Refuse a length anywhere in what is said."""
    found = re.findall(r"[^\n]*\b\d[\d.e+-]* ?(?:mm|nm|um|m)\b[^\n]*", text)
    assert found == []


def no_lengths_in_keys(value, path=""):
    if isinstance(value, list):
        for v in value:
            no_lengths_in_keys(v, path)
    if isinstance(value, dict):
        for k, v in value.items():
            assert not k.endswith(("_m", "_m2")), f"{path}.{k}"
            no_lengths_in_keys(v, f"{path}.{k}")


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_runs_of_a_turning_axis_become_its_table_in_angles(tmp_path, metrosep, unit):
    file, out = runs_file(tmp_path / "c.csv", unit=unit), tmp_path / "c-c.csv"
    call = [f"c_{unit}" if w == "c_deg" else w for w in CALL]
    code, _, told = metrosep("table", file, *call, "--axis", "C", "-o", out)
    assert code == 0, told
    no_lengths(told)
    assert "C -> C (its own positioning), 0 ... 360 deg, 73 entries" in told
    header, rows = entries(out)
    factor = {"rad": 1 / ARCSEC, "urad": 1e-6 / ARCSEC, "deg": 3600, "arcsec": 1.0}
    c = rows[:, 1:] * next(f for u, f in factor.items() if re.search(rf"_{u}\b", header.split(",")[1]))  # fmt: skip
    at = rows[:, 0] if "deg" in header.split(",")[0] else np.degrees(rows[:, 0])
    assert np.abs(at - np.arange(0, 361, 5)).max() < 1e-6
    for way, column in ((1, c[:, 0]), (-1, c[:, 1])):
        left = column + error(at, way) - error(0.0)
        assert np.abs(left).max() < 3 * NOISE  # means of five cells, minus those at zero
    sidecar = json.loads((tmp_path / "c-c.csv.json").read_text())
    no_lengths_in_keys(sidecar)
    assert sidecar["table"]["span_rad"][1] == pytest.approx(2 * np.pi, rel=0, abs=1e-9)

    again = ("verify", out, "--against", file, *call[:6])
    code, _, told = metrosep(*again)
    assert code == 0, told
    assert "each omitted once" in told
    no_lengths(told)
    other = runs_file(tmp_path / "d.csv", unit=unit, seed=9)
    code, printed, told = metrosep(*again[:3], other, *again[4:], "--json")
    assert code == 0, told
    no_lengths_in_keys(json.loads(printed))


def test_a_turning_table_of_the_wrong_sign_is_refused_in_angles(tmp_path, metrosep):
    file, out = runs_file(tmp_path / "c.csv"), tmp_path / "c-c.csv"
    assert metrosep("table", file, *CALL, "--axis", "C", "-o", out)[0] == 0
    wrong = runs_file(tmp_path / "w.csv", of=lambda d, way: -error(d, way), seed=5)
    code, _, told = metrosep("verify", out, "--against", wrong, *CALL[:6])
    assert code == 1, told
    assert "the reversed sign would shrink it" in told
    no_lengths(told)


def test_run_out_over_an_angle_is_a_table_of_lengths_over_degrees(tmp_path, metrosep):
    file, out = runs_file(tmp_path / "c.csv", reads="um"), tmp_path / "c-z.csv"
    call = [w.replace("arcsec", "um") for w in CALL]
    code, _, told = metrosep("table", file, *call, "--axis", "C", "-o", out)
    assert code == 2, told
    assert "Missing option '--compensates'; lengths over an angle" in told
    code, _, told = metrosep("table", file, *call, "--axis", "C", "--compensates", "Z", "-o", out)
    assert code == 0, told
    assert "C -> Z" in told
    assert "what the artefact itself does over one turn of C" in told
    sidecar = json.loads((tmp_path / "c-z.csv.json").read_text())
    table = sidecar["table"]
    at = np.degrees(table["positions_rad"])
    left = np.array(table["forward_m"]) * 1e6 + error(at) - error(0.0)
    assert np.abs(left).max() < 3 * NOISE
    assert "span_rad" in sidecar["verification"]
    assert "before_rms_m" in sidecar["verification"]["residuals"][0]
    code, _, told = metrosep("verify", out, "--against", file, *call[:6])
    assert code == 0, told


@pytest.mark.parametrize(
    ("reads", "axes", "said"),
    [
        ("arcsec", ("X",), "the readings are angles"),
        ("um", ("C", "C"), "the readings are lengths"),
        ("arcsec", ("C", "Z"), "say otherwise|onto another axis"),
    ],
)
def test_axes_that_do_not_fit_the_units_are_refused(tmp_path, metrosep, reads, axes, said):
    file, out = runs_file(tmp_path / "c.csv", reads=reads), tmp_path / "c.out.csv"
    call = [w.replace("arcsec", reads) for w in CALL]
    more = ["--axis", axes[0], *(["--compensates", axes[1]] if len(axes) > 1 else [])]
    code, _, told = metrosep("table", file, *call, *more, "-o", out)
    assert code == 2, told
    assert re.search(said, told), told
    assert not out.exists()


def test_separate_says_what_to_use_for_an_angle(tmp_path, metrosep):
    file = runs_file(tmp_path / "c.csv")
    code, _, told = metrosep("separate", file, *CALL[:6], "--method", "mean")
    assert code != 0
    assert f"metrosep table {file} --x c_deg --z z_arcsec --run" in told
    assert "--axis C --compensates C --spacing SPACING" in told
    code, _, told = metrosep(
        "table", file, *CALL, "--method", "joint", "--axis", "C", "-o", tmp_path / "o.csv"
    )
    assert code == 2
    assert "over an angle the runs are averaged" in told


@pytest.mark.parametrize("axes", [("X", "C"), ("C", "C"), ("C", "Z")])
def test_lengths_over_lengths_are_no_table_of_an_axis_that_turns(tmp_path, metrosep, axes):
    rng = np.random.default_rng(3)
    rows = ["run,x_mm,z_um"]
    for k in range(5):
        x = np.linspace(0, 100, 201)
        z = 3 * np.sin(x / 20) + rng.normal(0, 0.02, x.size)
        rows += [f"{k},{a:.4f},{b:.5f}" for a, b in zip(x, z, strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(rows) + "\n")
    read = (tmp_path / "r.csv", "--x", "x_mm", "--z", "z_um", "--run", "run", "--method", "mean")
    out = tmp_path / "z.csv"
    ways = (
        (
            "table",
            *read,
            "--axis",
            axes[0],
            "--compensates",
            axes[1],
            "--format",
            "csv",
            "-o",
            out,
        ),
        ("separate", *read, "--table", f"csv={out},axis={axes[0]},compensates={axes[1]}"),
    )
    for words in ways:
        code, _, told = metrosep(*words)
        assert code == 2, told
        assert "C turns, and the runs are lengths over lengths" in told
        assert not out.exists()


def test_a_sidecar_of_another_program_is_named_and_no_bug(tmp_path, metrosep):
    file, out = runs_file(tmp_path / "c.csv"), tmp_path / "c-c.csv"
    assert metrosep("table", file, *CALL, "--axis", "C", "-o", out)[0] == 0
    beside = tmp_path / "c-c.csv.json"
    sidecar = json.loads(beside.read_text())
    del sidecar["table"]["history"]
    beside.write_text(json.dumps(sidecar))
    code, _, told = metrosep("verify", out, "--against", file, *CALL[:6])
    assert code == 4, told
    assert "c-c.csv.json" in told
    assert "it is not the sidecar of a table" in told


def indexed_file(path, step, *, runs=4, seed=5):
    """Write runs both ways that stopped at indexed positions, with the rounding of the encoder."""
    rng = np.random.default_rng(seed)
    rows = ["run,c_deg,z_arcsec"]
    for k in range(runs):
        zero = rng.normal(0, 3)
        for way in (1, -1):
            at = np.arange(0.0, 360.5, step)[::way]
            z = error(at, way) + zero + rng.normal(0, NOISE, at.size)
            at = at + rng.normal(0, 1e-4, at.size)
            rows += [f"{2 * k + (way < 0)},{a:.5f},{v:.4f}" for a, v in zip(at, z, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(("step", "spacing"), [(30, 30), (20, 40), (15, 30)])
def test_readings_at_indexed_positions_become_the_table_at_these(
    tmp_path, metrosep, step, spacing
):
    file, out = indexed_file(tmp_path / "c.csv", step), tmp_path / "c-c.csv"
    call = (*CALL[:6], "--spacing", f"{spacing} deg", "--format", "csv", "--axis", "C")
    code, _, told = metrosep("table", file, *call, "-o", out)
    assert code == 0, told
    assert "targets stand at equal steps" in told  # nothing was read between them
    header, rows = entries(out)
    assert header.startswith("position_rad,correction_forward_urad,correction_reverse_urad")
    at, c = np.degrees(rows[:, 0]), rows[:, 1:] * 1e-6 / ARCSEC
    assert np.abs(at - np.arange(0, 361, spacing)).max() < 1e-3
    for way, column in ((1, c[:, 0]), (-1, c[:, 1])):
        assert np.abs(column + error(at, way) - error(0.0)).max() < 3 * NOISE
    assert metrosep("verify", out, "--against", file, *CALL[:6])[0] == 0


@pytest.mark.parametrize("spacing", [10, 15, 45])
def test_a_spacing_between_indexed_positions_names_one_that_works(tmp_path, metrosep, spacing):
    file = indexed_file(tmp_path / "c.csv", 30, runs=2)
    call = (*CALL[:6], "--spacing", f"{spacing} deg", "--format", "csv", "--axis", "C")
    code, _, told = metrosep("table", file, *call, "-o", tmp_path / "c-c.csv")
    assert code != 0
    assert "the 13 positions that were read are 0, 30, 60, 90, ... 360 deg" in told
    assert "take the spacing 30 deg or a multiple" in told
    assert not (tmp_path / "c-c.csv").exists()

"""Models from the command line: rank, predict, form --identify, separate --flexure; good and bad input."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main

TORIC = ("--form", "toric: Rb=265 mm, Rd=132.5 mm", "--radius", "20 mm")
GRID = "sine_grid: amplitude=50 nm, wavelength=100 um"
JOB = f'form = "{GRID}"\nradius = "60 um"\nfeed = "2 um"\nrpm = 20\nlength_step = "5 um"\n'
USAGE, DATA = 2, 4
"""Exit codes: a wrong option or key; data that cannot be used."""


@pytest.fixture
def metrosep(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        assert "Traceback" not in out.err
        assert "internal error" not in out.err
        return stop.value.code, out.out, out.err

    return call


@pytest.fixture
def job(tmp_path):
    def write(text):
        file = tmp_path / "process.toml"
        file.write_text(f'metrosep = 1\n[[step]]\nop = "predict"\n{text}', "utf-8")
        return file

    return write


@pytest.fixture
def turned(tmp_path):
    """Write a part turned with dx = 2 um and dy = -1 um: the exact cut."""
    line = 5e-6 * np.arange(-40, 41)
    x, y = np.meshgrid(line, line)
    rho, theta = np.maximum(np.hypot(x, y), 1e-6), np.arctan2(y, x)
    r, t = np.sqrt(rho**2 - 1e-12) - 2e-6, theta - np.arcsin(-1e-6 / rho)
    k = 2 * np.pi / 100e-6
    z = 50e-9 * (np.sin(k * r * np.cos(t)) + np.cos(k * r * np.sin(t)))
    z = z + 1e-9 * np.random.default_rng(3).standard_normal(z.shape)
    ms.write(ms.Surface(z, 5e-6, 5e-6), tmp_path / "turned.x3p")
    return tmp_path / "turned.x3p"


def values(out):
    return {c["metric"]: (c["value"], c["u"]) for c in json.loads(out)["characteristics"]}


def sweep(path, header="voltage_V,displacement_um", fall=None):
    v = np.r_[np.arange(11.0), np.arange(9.0, -1.0, -1.0)]
    d = 1.66 * v
    if fall is not None:
        d[v == fall] -= 2.0
    rows = (f"{a:g},{b:.4f}" for a, b in zip(v, d, strict=True))
    path.write_text("\n".join([header, *rows]) + "\n", "ascii")
    return path


def test_rank_prints_the_table_and_writes_a_report(metrosep, tmp_path):
    code, out, err = metrosep(
        "rank", "fts_lathe", *TORIC, "--error", "B0Z=0.001 deg", "--error", "EXX=1 um",
        "--error", "EZX=1 um", "-o", tmp_path / "out",
    )  # fmt: skip

    assert code == 0, err
    rows = [
        r.split()[0]
        for r in out.splitlines()
        if r.split() and r.split()[0] in ("B0Z", "EXX", "EZX")
    ]
    assert rows == ["B0Z", "EXX"]
    assert "82.3 nm" in out  # papers.md 4.3
    assert "not visible: EZX" in out  # a piston
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == [
        "parts.csv", "report.html", "result.json",
    ]  # fmt: skip


def test_rank_recipe_does_the_same(metrosep, tmp_path):
    words = ("rank", "fts_lathe", *TORIC, "--error", "Hzx=0.001 deg", "--response", "wavefront")
    code, text, _ = metrosep(*words, "--mode", "refract", "--n", "1.5", "--print-recipe")
    assert code == 0
    (tmp_path / "r.toml").write_text(text, "utf-8")

    _, direct, _ = metrosep(*words, "--mode", "refract", "--n", "1.5", "--json")
    _, again, _ = metrosep("run", tmp_path / "r.toml", "-o", tmp_path / "out", "--json")

    assert values(direct)["sq.B0Z"] == values(again)["sq.B0Z"]
    # thin refraction: (n - 1) of the form, 82.3 nm levelled; obliquity changes it by a few percent
    assert values(direct)["sq.B0Z"][0] == pytest.approx(0.5 * 82.3e-9, rel=0.05, abs=0.0)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("fts_lath", *TORIC, "--all-lengths", "1 um"), 'Did you mean "fts_lathe"'),
        (("none.toml", *TORIC, "--all-lengths", "1 um"), "no such file"),
        (("fts_lathe", *TORIC, "--error", "EXQ=1 um"), "'EXQ' is not an error term"),
        (("fts_lathe", *TORIC, "--error", "EXX=1"), "EXX '1' has no unit"),
        (("fts_lathe", *TORIC, "--error", "EXX"), "--error"),
        (("fts_lathe", *TORIC[:2], "--radius", "20", "--error", "EXX=1 um"), "--radius '20'"),
        (("fts_lathe", *TORIC[:2], "--error", "EXX=1 um"), "--radius"),
        (("fts_lathe", *TORIC), "no error is given"),
        (("fts_lathe", *TORIC, "--error", "EXX=1 um", "--removed", "foo"), "'foo'"),
        (("fts_lathe", *TORIC, "--error", "EXX=1 um", "--n", "1.5"), "wavefront"),
        (
            ("fts_lathe", "--form", "torus: R=1 mm", "--radius", "20 mm", "--error", "EXX=1 um"),
            "torus",
        ),
    ],
)
def test_rank_refuses(metrosep, words, part):
    code, out, err = metrosep("rank", *words)

    assert code == USAGE
    assert part in err
    assert out == ""


def test_rank_tells_where_the_surface_ends(metrosep):
    code, out, err = metrosep(
        "rank", "fts_lathe", *TORIC[:2], "--radius", "150 mm", "--error", "EXX=1 um"
    )

    assert code == 2
    assert out == ""
    assert "ends at a radius of 132.5 mm" in err  # Rd


def test_predict_writes_program_and_budget(metrosep, job, tmp_path):
    file = job(JOB + 'dx = "1 um"\nu_dx = "10 nm"\nfollow_up_pv = "3 nm"\n')
    code, out, err = metrosep("predict", file, "-o", tmp_path / "out", "--json")

    assert code == 0, err
    found = values(out)
    assert found["sum"][0] == pytest.approx(
        found["tool setting.pv"][0] + found["program.pv"][0] + 3e-9, abs=1e-15
    )
    names = {f.name for f in (tmp_path / "out").iterdir()}
    assert names == {"parts-budget.csv", "parts-program.csv", "report.html", "result.json"}


@pytest.mark.parametrize(
    ("text", "code", "part"),
    [
        (JOB + 'dx = "1"\n', USAGE, "has no unit"),
        (JOB + 'dy = "80 um"\n', USAGE, "dy = 80 um: nothing nearer"),  # all is core
        (JOB + 'core = "70 um"\n', USAGE, "core must lie"),
        (JOB + 'follow_up = "none.csv"\n', DATA, "no such file"),
        (JOB + 'follow_up = "log.csv"\n', DATA, "no time column"),
        (JOB.replace(GRID, "sphere: R=50 um"), DATA, "the form has the height nan"),
        (JOB.replace(GRID, "sphere"), USAGE, "no value for"),
        (JOB.replace("= 20", "= 0"), USAGE, "rpm must be above zero, got 0"),
    ],
)
def test_predict_refuses(metrosep, job, tmp_path, text, code, part):
    rows = "\n".join(f"{v},{v}" for v in range(30))
    (tmp_path / "log.csv").write_text(f"command_um,actual_um\n{rows}\n", "ascii")
    found, out, err = metrosep("predict", job(text))

    assert (found, out) == (code, "")
    assert part in err


def test_predict_needs_a_recipe_that_predicts(metrosep, tmp_path):
    file = tmp_path / "r.toml"
    file.write_text(
        'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "fts_lathe"\nradius = "20 mm"\n'
        'form = "plane"\n',
        "utf-8",
    )
    code, _, err = metrosep("predict", file)
    assert code == USAGE
    assert "'rank'" in err
    assert metrosep("predict", tmp_path / "none.toml")[0] == USAGE


def test_tool_setting_is_identified(metrosep, turned):
    code, out, err = metrosep("form", turned, "--identify", "tool", "--form", GRID, "--json")

    assert code == 0, err
    for name, true in (("dx", 2e-6), ("dy", -1e-6)):
        value, u = values(out)[name]
        assert abs(value - true) < 3.5 * u
        assert u < 20e-9


def test_machine_is_identified(metrosep, tmp_path):
    line = 1e-3 * np.arange(-20, 21)
    x, y = np.meshgrid(line, line)
    rho = np.hypot(x, y)
    z = 0.265 - np.sqrt((0.1325 + np.sqrt(0.1325**2 - y**2)) ** 2 - x**2)
    z = (
        z
        - np.radians(0.001) * (0.02 - rho)
        + 1e-9 * np.random.default_rng(1).standard_normal(x.shape)
    )
    ms.write(ms.Surface(np.where(rho <= 0.02, z, np.nan), 1e-3, 1e-3), tmp_path / "m.h5")
    words = ("identify", "fts_lathe", tmp_path / "m.h5", *TORIC, "--terms", "B0Z,EYX")
    code, out, err = metrosep(*words, "--json", "-o", tmp_path / "out")

    assert code == 0, err
    value, u = values(out)["B0Z"]
    assert abs(value - np.radians(0.001)) < 3.5 * u
    assert (tmp_path / "out" / "report.html").exists()

    code, _, err = metrosep(*words[:-1], "B0Z,NOPE")
    assert code == USAGE
    assert "'NOPE' is not an error term" in err
    assert "Missing argument 'FILE'" in metrosep("identify", "fts_lathe")[2]


@pytest.mark.parametrize(
    ("words", "code", "part"),
    [
        (("--identify", "tool", "--form", "sine_grid: amplitude=50 nm"), USAGE, "wavelength"),
        (("--identify", "tool", "--form", "plane"), DATA, "leave no trace"),
        (("--identify", "tool", "--form", GRID, "--terms", "EXX"), USAGE, "--terms"),
        (("--identify", "fts_lathe", "--form", GRID), USAGE, "needs the radius"),
        (("--identify", "none.toml", "--form", GRID), USAGE, "no such file"),
        (("--terms", "EXX", "--form", "plane"), USAGE, "--identify"),
    ],
)
def test_identify_refuses(metrosep, turned, words, code, part):
    found, _, err = metrosep("form", turned, *words)

    assert found == code
    assert part in err


def test_flexure_is_calibrated(metrosep, tmp_path):
    code, out, err = metrosep("separate", sweep(tmp_path / "s.csv"), "--flexure", "--json")

    assert code == 0, err
    assert values(out)["sensitivity"][0] == pytest.approx(1.66e-6, abs=1e-12)
    assert values(out)["hysteresis"][0] == pytest.approx(0.0, abs=1e-6)


def test_flexure_refuses(metrosep, tmp_path):
    code, _, err = metrosep("separate", sweep(tmp_path / "fall.csv", fall=4.0), "--flexure")
    assert code == DATA
    assert "not monotone at 4 V" in err

    plain = sweep(tmp_path / "plain.csv", header="voltage_V,displacement")
    code, _, err = metrosep(
        "separate", plain, "--flexure", "--column", "displacement=displacement"
    )
    assert code in (USAGE, DATA)
    assert "unit" in err

    code, _, err = metrosep("separate", plain, "--flexure", "--method", "donaldson")
    assert code == USAGE
    assert "--flexure" in err


def test_stroke_exceeded_is_said(metrosep, tmp_path):
    x = np.arange(0.0, 40.5, 1.0)
    rows = "\n".join(f"{r},{a:g},{-0.5 * a:.4f}" for r in (1, 2, 3) for a in x)
    (tmp_path / "runs.csv").write_text(f"run,x_mm,z_um\n{rows}\n", "ascii")
    (tmp_path / "r.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nreadings = ["z_um"]\nx = "x_mm"\nrepeat = "run"\n'
        '[[step]]\nop = "dual_servo"\nquantity = "error"\ndegree = 1\nsensitivity = "1.66 um"\n'
        '[[check]]\nmetric = "violations"\nupper = 0\nU = 0\n',
        "utf-8",
    )
    code, _, err = metrosep("run", "r.toml", "-o", "out")

    assert code == 1  # rejected: 20 um are beyond 16.6 um
    assert "does not keep a limit" in err


def test_voltages_beyond_a_limit_leave_with_code_1_and_write_nothing(
    metrosep, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    rows = [f"{run},{x},{1e-3 * x * (x - 40)}" for run in (1, 2) for x in range(41)]
    (tmp_path / "runs.csv").write_text("\n".join(["run,x_mm,z_um", *rows]) + "\n", "ascii")
    call = ["separate", "runs.csv", "--method", "dual_servo", "--readings", "z_um", "--x", "x_mm"]
    call += ["--repeat", "run", "--set", "quantity=compensation"]
    call += ["--set", "sensitivity=1.66 um/V", "-o", "out"]

    code, _, said = metrosep(*call)
    assert code == 1
    assert "--set offset=" in said
    assert not (tmp_path / "out").exists()
    assert metrosep(*call, "--set", "offset=2 um", "--set", "limits=0 V,10 V")[0] == 0


def test_keys_are_explained_with_freedoms_and_terms_that_exist(metrosep):
    for op, words in (
        ("tool_setting", "free: what is fitted, piston,dx,dy,dR"),
        ("identify", "terms: error terms that may be at work, EXX,EYX"),
        ("rank", "machine: a preset (five_axis, fts_lathe"),
        ("follow_up", "terms: what the error may depend on, velocity"),
    ):
        code, out, _ = metrosep("ops", op)
        assert code == 0
        assert words in out
        assert "piston,tilt\n" not in out


def test_a_curve_in_a_file(metrosep, tmp_path, monkeypatch):
    x = np.linspace(-30.0, 30.0, 601)
    rows = [f"{a:.3f},{b * 1e9:.6f}" for a, b in zip(x, 60e-9 * (x / 25.0) ** 2, strict=True)]
    (tmp_path / "slide.csv").write_text("\n".join(["x_mm,EZX_nm", *rows]) + "\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    words = ("rank", "sts_lathe", "--form", "plane", "--radius", "25 mm", "--removed", "piston")
    code, out, err = metrosep(*words, "--error", "EZX=table slide.csv", "-o", "one")
    assert code == 0, err
    assert "17.3" in out  # 60 nm / sqrt(12)
    inputs = json.loads((tmp_path / "one" / "result.json").read_text("utf-8"))["inputs"]
    assert [i["name"] for i in inputs] == ["slide.csv"]
    # a recipe finds it beside itself
    _, recipe, _ = metrosep(
        *words, "--error", "EZX=table slide.csv", "-o", "two", "--print-recipe"
    )
    (tmp_path / "rank.toml").write_text(recipe, "utf-8")
    monkeypatch.chdir(tmp_path.parent)
    assert metrosep("run", str(tmp_path / "rank.toml"), "-o", str(tmp_path / "two"))[0] == 0
    same = [(tmp_path / d / "parts.csv").read_bytes() for d in ("one", "two")]
    assert same[0] == same[1]
    assert "no such file" in metrosep(*words, "--error", "EZX=table gone.csv")[2].lower()
    monkeypatch.chdir(tmp_path)
    wrong = metrosep(*words, "--error", "EXX=table slide.csv")[2]
    assert "holds EZX, not EXX" in wrong


def test_five_axes_rank_where_they_are_locked(metrosep):
    five = ("rank", "five_axis", "--pivot-height", "80 mm", *TORIC, "--error", "B0C=5 urad")
    code, _, err = metrosep(*five)
    assert code == USAGE
    assert '--at "A=0 deg" --at "C=0 deg"' in err
    code, _, err = metrosep(*five, "--at", "A=0")
    assert code == USAGE
    assert "A '0' has no unit" in err
    locked = metrosep(*five, "--at", "A=0 deg", "--at", "C=0 deg")
    turned = metrosep(*five, "--at", "A=0 deg")
    assert (locked[0], turned[0]) == (0, 0)
    # a constant tilt of the table: of a part that stands still a shift and a plane, of one that turns a cone
    rows = [
        next(v for v in out.splitlines() if v.startswith("B0C")) for _, out, _ in (locked, turned)
    ]
    assert rows[0] != rows[1]
    assert metrosep(*five, "--at", "A=0 deg", "--print-recipe")[1].endswith(
        'at = { "A" = "0 deg" }\nerrors = { "B0C" = "5 urad" }\n'
    )


@pytest.mark.parametrize(("tool", "sq"), [("0 mm,7 mm,0 mm", 7.0), ("0 mm,-3 mm,-80 mm", 3.0)])
def test_rank_takes_the_tool_point(metrosep, tool, sq):
    # a roll of Y turns the tool about X: its height at the tool point is a times the offset in Y
    words = ("rank", "mill_xyz", "--form", "plane", "--radius", "20 mm", "--removed", "piston")
    code, out, _ = metrosep(*words, "--error", "EAY=wave 8 mm 1 urad", "--tool", tool, "--json")
    assert code == 0
    found = {c["metric"]: c["value"] for c in json.loads(out)["characteristics"]}["sq.EAY"]
    # a wave of amplitude 1 has an RMS of 1/sqrt(2); 1 %: the rim cuts the waves
    assert found == pytest.approx(sq * 1e-9 / np.sqrt(2.0), rel=0.01, abs=0.0)

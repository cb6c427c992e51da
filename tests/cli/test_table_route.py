"""From readings to a controller's file: every route gives the same bytes, and keeps what was there.

The readings are written here as text, from a formula; what the file does is looked up here, as the
controller's manual says, without our simulator.
"""

import html
import json
import re
import shutil

import numpy as np
import pytest

UM = 1e-6
COLUMNS = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")
AXES = ("--axis", "X", "--compensates", "X", "--spacing", "1.5 mm")
LOST_UM = 1.37
"""Reverse minus forward of the machine below."""


def error_um(x_mm):
    return 1.9 * np.sin(2 * np.pi * x_mm / 31.0 + 0.4) + 0.6 * np.cos(2 * np.pi * x_mm / 13.0)


def write_runs(path, *, samples=161, lost=LOST_UM, seed=5, ways=(1, -1, 1, -1)):
    """Two passes each way at three feedrates, 0 ... 60 mm, 20 nm of noise."""
    rng = np.random.default_rng(seed)
    rows = ["x_mm,z_um,feed_mm_min,run"]
    number = 0
    for feed in (310, 470, 730):
        for way in ways:
            x = np.linspace(0.0, 60.0, samples)[::way]
            z = error_um(x) + (lost if way < 0 else 0.0) + rng.normal(0, 0.02, x.size)
            rows += [f"{a:.6f},{b:.6f},{feed},{number}" for a, b in zip(x, z, strict=True)]
            number += 1
    path.write_text("\n".join(rows) + "\n")
    return path


def looked_up(path, x_mm, way):
    """What LinuxCNC adds to the command, by its manual: nominal minus the column, linear between."""
    nominal, forward, reverse = np.loadtxt(path).T
    return np.interp(x_mm, nominal, nominal - (forward if way > 0 else reverse))


@pytest.mark.parametrize(
    ("samples", "method"),
    [  # joint at every door: test_doors; many samples: test_every_door_gives_the_same_bytes_and_sidecar
        pytest.param(161, "joint", marks=pytest.mark.slow),
        pytest.param(2600, "mean", marks=pytest.mark.slow),
        (161, "mean"),
    ],
)
def test_separate_with_table_and_table_of_its_result_give_the_same_bytes(
    metrosep, tmp_path, samples, method
):
    ways = (1, -1, 1, -1) if samples < 2001 else (1, -1)  # more than a result keeps of one run
    runs = write_runs(tmp_path / "runs.csv", samples=samples, ways=ways)
    how = (*COLUMNS, "--method", method)
    a, b, c = tmp_path / "a.comp", tmp_path / "b.comp", tmp_path / "inside" / "c.comp"

    for call in (
        ("separate", runs, *how, "--table", f"linuxcnc={a}", *AXES),
        ("separate", runs, *how, "-o", tmp_path / "result"),
        ("table", tmp_path / "result", "-o", b, *AXES),
        ("separate", runs, *how, "-o", c.parent, "--table", "linuxcnc=c.comp", *AXES),
        ("table", c.parent, "-o", tmp_path / "d.comp", *AXES),
    ):
        code, _, err = metrosep(*call)
        assert code == 0, err

    files = [a, b, c, tmp_path / "d.comp"]
    assert len({f.read_bytes() for f in files}) == 1
    assert len({f.with_name(f.name + ".json").read_bytes() for f in files}) == 1
    x = np.linspace(2.0, 58.0, 57)
    added = 1e3 * np.array([looked_up(b, x, 1), looked_up(b, x, -1)])
    left = added + np.array([error_um(x), error_um(x) + LOST_UM])
    line = np.polyval(np.polyfit(x, left.mean(axis=0), 1), x)  # of both ways together
    # linear between entries: 1.5^2 / 8 times the bend; the mean of 3 runs keeps their noise
    assert np.abs(left - line).max() < 0.06 + (4 * 0.02 / np.sqrt(3) if method == "mean" else 0.0)


@pytest.mark.parametrize(
    ("column", "is_list"), [("", False), (",retargeted", False), (",Target_1", True)]
)
def test_runs_whose_columns_tell_are_parsed_once_and_a_list_is_known_by_a_word(
    metrosep, tmp_path, monkeypatch, column, is_list
):
    from metrosep.io.text import table

    parsed, parse = [], table.with_moments  # of every text that is read, once
    monkeypatch.setattr(table, "with_moments", lambda *a: (parsed.append(a[0].path), parse(*a))[1])
    text = write_runs(tmp_path / "rr.csv").read_text().splitlines()
    rows = [text[0] + column, *(row + (",0" if column else "") for row in text[1:])]
    (tmp_path / "rr.csv").write_text("\n".join(rows) + "\n")
    code, _, err = metrosep("table", tmp_path / "rr.csv", *AXES[:3], "Z", *AXES[4:], "--format", "csv",
                            "--method", "mean", "-o", tmp_path / "z.csv")  # fmt: skip
    assert (code, (tmp_path / "z.csv").exists()) == ((2, False) if is_list else (0, True)), err
    assert len(parsed) == 1 or is_list


def test_a_result_holds_the_runs_as_they_were_measured(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv", samples=2600)
    words = (*COLUMNS, "--method", "mean", "-o", tmp_path / "out")
    assert metrosep("separate", runs, *words)[0] == 0

    stored = json.loads((tmp_path / "out" / "result.json").read_text())["runs"]

    assert len(stored) == 12
    for i, run in enumerate(stored):
        way = (1, -1)[i % 2]
        assert run["direction"] == ("forward", "reverse")[i % 2]
        assert len(run["x_m"]) <= 2001
        assert sum(run["n"]) == 2600
        true = (error_um(np.array(run["x_m"]) * 1e3) + (LOST_UM if way < 0 else 0)) * UM
        away = np.array(run["z_m"]) - true
        assert abs(away.mean()) < 0.005 * UM  # not levelled
    assert len(json.dumps(stored, indent=1)) < 12 / 10 * 1.5e6


@pytest.mark.slow
def test_a_result_of_an_older_version_names_the_command_that_makes_it_again(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv", samples=301)
    out = tmp_path / "out"
    assert metrosep("separate", runs, *COLUMNS, "-o", out)[0] == 0
    document = json.loads((out / "result.json").read_text())
    del document["runs"]
    (out / "result.json").write_text(json.dumps(document))

    code, _, err = metrosep("table", out, "-o", tmp_path / "x.comp", *AXES)

    assert code == 4
    assert "run the separation again" in err
    assert not (tmp_path / "x.comp").exists()


FOREIGN = b"0 0 0\n15 15.004 15.004\n30 30 30\n"
"""A table that somebody else wrote, or that was changed since."""


@pytest.mark.parametrize("route", ["beside", "inside", "table", "map", "machine"])
@pytest.mark.parametrize("changed", [False, True])
def test_force_over_a_file_that_metrosep_did_not_write_says_so_and_keeps_it(
    metrosep, tmp_path, route, changed
):
    runs = write_runs(tmp_path / "one.csv", samples=161)
    how = (*COLUMNS, "--method", "mean")
    out, target = tmp_path / "out", tmp_path / "out" / "x.comp"
    out.mkdir()
    words = {
        "beside": ("separate", runs, *how, "--table", f"linuxcnc={target}", *AXES),
        "inside": ("separate", runs, *how, "-o", out, "--table", "linuxcnc=x.comp", *AXES),
        "table": ("table", runs, *how, "-o", target, *AXES),
    }
    if route == "map":
        n = np.linspace(0, 2 * np.pi, 12)
        rows = "\n".join(",".join(f"{v:.6f}" for v in np.sin(n) + np.cos(y)) for y in n)
        (tmp_path / "map.csv").write_text(rows + "\n")
        target = out / "m.csv"
        more = ("--unit", "um", "--lateral-step", "5 mm", "--spacing", "5 mm", "--over", "X,Y")
        words["map"] = ("table", tmp_path / "map.csv", *more, "--format", "csv-map", "-o", target, "--waive", "single")  # fmt: skip
    if route == "machine":
        (tmp_path / "m.toml").write_text(
            'name = "m"\n[[element]]\nname = "X"\nbranch = "tool"\nkind = "linear"\ndirection = "+X"\n'
            '[[element]]\nname = "table"\nbranch = "workpiece"\nkind = "fixed"\n'
        )
        (tmp_path / "x.csv").write_text("x_mm,EXX_um\n0,0\n10,3\n20,-2\n30,1\n")
        target = out / "x-x.csv"
        more = ("--over", "X", "--spacing", "10 mm", "--corrects", "X", "-o", out)
        words["machine"] = ("machine-tables", tmp_path / "m.toml", tmp_path / "x.csv", *more)
    call = (*words[route], "--force")
    if changed:
        code, _, err = metrosep(*call)
        assert code == 0, err
    target.write_bytes(FOREIGN)

    code, _, err = metrosep(*call)

    assert code == 0, err
    assert "was not written by metrosep or was changed since" in err
    assert target.read_bytes() != FOREIGN
    assert target.with_name(target.name + ".1").read_bytes() == FOREIGN


@pytest.mark.parametrize("route", ["beside", "inside", "recipe", "table"])
def test_a_rerun_leaves_the_table_that_a_machine_may_use(metrosep, tmp_path, route):
    first = write_runs(tmp_path / "one.csv", samples=161)
    other = write_runs(tmp_path / "two.csv", samples=161, seed=8)
    out = tmp_path / "out"
    how = (*COLUMNS, "--method", "mean")  # joint makes five more estimates for the check
    table = tmp_path / "x.comp" if route in ("beside", "table") else out / "x.comp"

    def again(runs, *more):
        if route == "beside":
            words = ("separate", runs, *how, "--table", f"linuxcnc={table}", *AXES)
        elif route == "inside":
            words = ("separate", runs, *how, "-o", out, "--table", "linuxcnc=x.comp", *AXES)
        elif route == "recipe":
            recipe = tmp_path / "recipe.toml"
            recipe.write_text(
                'metrosep = 1\n[input]\nx = "x_mm"\nz = "z_um"\nfeed = "feed_mm_min"\nrun = "run"\n'
                '[[step]]\nop = "separate"\nmethod = "mean"\n[[output]]\nkind = "table"\ncontroller = "linuxcnc"\n'
                'axis = "X"\ncompensates = "X"\nspacing = "1.5 mm"\npath = "x.comp"\n'
                'waive = ["active"]\n'
            )
            words = ("run", recipe, runs, "-o", out)
        else:
            shutil.rmtree(tmp_path / "result", ignore_errors=True)
            metrosep("separate", runs, *how, "-o", tmp_path / "result")
            words = ("table", tmp_path / "result", "-o", table, *AXES)
        waive = () if route == "recipe" else ("--waive", "active")
        return metrosep(*words, *waive, *more)

    code, _, err = again(first)
    assert code == 0, err
    sidecar = table.with_name("x.comp.json")
    held, beside = table.read_bytes(), sidecar.read_bytes()
    code, _, err = again(first)  # the same bytes: nothing is replaced
    assert code == 0, err
    result = out / "result.json"
    before = result.read_bytes() if result.exists() else None

    code, _, err = again(other)

    assert code == 2
    assert "exists already" in err
    assert "--force" in err
    assert (table.read_bytes(), sidecar.read_bytes()) == (held, beside)
    assert before is None or result.read_bytes() == before
    assert not list(table.parent.glob("x.comp.1*"))

    code, _, err = again(other, "--force")

    assert code == 0, err
    assert table.read_bytes() != held
    assert table.with_name("x.comp.1").read_bytes() == held
    assert table.with_name("x.comp.1.json").read_bytes() == beside


@pytest.mark.parametrize(("degree", "helps"), [(2, False), (8, True)])
def test_a_polynomial_that_does_not_help_says_so(metrosep, tmp_path, degree, helps):
    """Two periods of a wave: no parabola follows them, a polynomial of degree 8 does."""
    path = tmp_path / "runs.csv"
    rng = np.random.default_rng(3)
    rows = ["x_mm,z_um,feed_mm_min,run"]
    for number, feed in enumerate((310, 470, 730)):
        x = np.linspace(0.0, 60.0, 301)
        z = np.sin(2 * np.pi * x / 29.0) + rng.normal(0, 0.01, x.size)
        rows += [f"{a:.6f},{b:.6f},{feed},{number}" for a, b in zip(x, z, strict=True)]
    path.write_text("\n".join(rows) + "\n")

    code, _, err = metrosep("separate", path, *COLUMNS, "--poly", degree)

    assert code == 0, err
    x = np.linspace(0.0, 60.0, 601)
    wave = np.sin(2 * np.pi * x / 29.0)
    line = np.polyval(np.polyfit(x, wave, 1), x)
    rest = (wave - np.polyval(np.polyfit(x, wave, degree), x)).std() / (wave - line).std()
    assert (rest <= 0.7) == helps
    assert ("does not help" in err) == (not helps)
    if not helps:
        said = float(err.split("of the separated error ")[1].split(" %")[0])
        assert said == pytest.approx(100 * rest, abs=2.0)


@pytest.mark.slow
def test_the_demo_says_that_its_polynomial_does_not_help(metrosep, tmp_path):
    code, _, err = metrosep("demo", "-o", tmp_path / "demo")
    assert code == 0
    assert "the polynomial of degree 6 does not help" in err


@pytest.mark.parametrize("dialect", ["pmac", "pmac-plane", "pmac-backlash"])
def test_a_pmac_file_is_saved_by_hand_after_the_trial(tmp_path, dialect):
    from metrosep import controllers
    from metrosep.compensation import CompensationMap, CompensationTable

    x = np.linspace(0.0, 40e-3, 21)
    own = CompensationTable.from_error(
        lambda x: 2e-6 * np.sin(x / 7e-3), positions=x, axis="X", reference=0.0
    )
    split = CompensationTable(
        positions=x, forward=own.forward, reverse=own.forward - 1e-6, axis="X", compensates="X",
        reference=0.0, is_exact_inverse=True,
    )  # fmt: skip
    plane = CompensationMap.from_error(
        lambda x, y: 1e-4 * x * np.sin(y / 9e-3), x=x, y=x, reference=(0.0, 0.0)
    )
    made, more = {
        "pmac": (own, {"source_motor": 1, "target_motor": 1}),
        "pmac-plane": (plane, {"x_motor": 1, "y_motor": 2, "target_motor": 3}),
        "pmac-backlash": (split, {"motor": 1}),
    }[dialect]
    path = tmp_path / "table.pmc"

    controllers.write(made, path, dialect, count="10 nm", allow_unverified=True, **more)

    commands = [line.partition(";")[0].strip().upper() for line in path.read_text().splitlines()]
    assert "SAVE" not in commands
    assert [c for c in commands if c][-1] == "I51=1"
    steps = json.loads((tmp_path / "table.pmc.json").read_text())["activation"]
    assert [("after this trial" in step) for step in steps if "SAVE" in step] == [True]


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Runs of an axis, and a map, from which every dialect can write."""
    from metrosep import Surface, write

    folder = tmp_path_factory.mktemp("sources")
    for name, ways in {"forward": (1, 1), "both": (1, -1)}.items():
        write_runs(folder / f"{name}.csv", samples=121, lost=0.4, ways=ways)
    y, x = np.mgrid[0.0:40e-3:21j, 0.0:50e-3:26j]
    write(
        Surface(3e-6 * np.cos(x / 9e-3) * (1 + y / 0.05) + 1e-4 * y, 2e-3, 2e-3),
        folder / "map.x3p",
    )
    return folder


def _dialects():
    from metrosep import controllers

    return [info.id for info in controllers.describe()]


OF_ITS_OWN = {
    "nv200": "rate=1200",
    "pi-gcs": "rate=200",
    "rrf": "max_nodes=961",
    "plc-pmac": "digits=5",
}
"""What a dialect needs beside its example to hold the errors of these sources."""

WITHOUT_COMMENTS = {"linuxcnc", "csv", "csv-map", "heidenhain", "voltage", "pi-gcs", "nv200"}
"""Numbers or commands only: a comment of a .comp ends the table there, other readers take no lines but
theirs."""

PLANTED = {"plc-st": "coverage", "plc-pmac": "coverage"}
"""The finding that is planted: corrections above a stroke of 1 nm, or a travel beyond the runs where a
stroke shapes the file itself."""


@pytest.mark.parametrize("dialect", _dialects())
def test_every_warning_of_a_sidecar_is_on_the_terminal_and_in_the_report(
    metrosep, sources, tmp_path, dialect
):
    from metrosep.controllers.registry import find
    from metrosep.controllers.safety import CHECKS

    info = find(dialect).info
    planted = PLANTED.get(dialect, "stroke")
    fact = {"stroke": "stroke=1 nm", "coverage": "travel_high=99 mm"}[planted]
    example = [
        f"{k}={v}" for k, v in info.example.items() if k not in ("stroke", "rate", "digits")
    ]
    example += [OF_ITS_OWN[dialect]] if dialect in OF_ITS_OWN else []
    waive = [w for check in CHECKS for w in ("--waive", check)]
    name = f"table{info.suffix}"
    if info.carries == "map":
        machine = [w for v in (*example, fact) for w in ("--machine", v)]
        calls = [
            ("table", sources / "map.x3p", "--spacing", "2 mm", "--format", dialect, *machine, *waive,
             "--sign-confirmed", "-o", tmp_path / name)
        ]  # fmt: skip
    else:
        calls = [
            ("separate", sources / f"{runs}.csv", *COLUMNS, "--method", "mean", *waive,
             "--sign-confirmed", "-o", tmp_path, "--table",
             ",".join([f"{dialect}={name}", f"compensates={axis}", *shape, *example, fact]))
            for axis in "XZ"
            for runs in ("forward", "both")
            for shape in (["degree=9"] if info.carries == "polynomial" else ["spacing=1 mm"],)
        ]  # fmt: skip
    said = []
    for call in calls:
        code, _, err = metrosep(*call)
        said.append(err)
        if code == 0:
            break
    assert code == 0, "\n".join(said)

    # a file whose format has comments says by what it was made, wherever it is copied to
    data = (tmp_path / name).read_bytes().lower()
    assert (b"metrosep" in data) == (dialect not in WITHOUT_COMMENTS)
    findings = json.loads((tmp_path / f"{name}.json").read_text())["findings"]
    assert planted in [f["check"] for f in findings]
    for found in findings:
        assert (
            f"warning: {tmp_path / name if info.carries == 'map' else name}: {found['problem']}"
            in err
        )
        assert found["fix"] in err
    if info.carries != "map":
        report = html.unescape(re.sub(r"<[^>]*>", "", (tmp_path / "report.html").read_text()))
        for found in findings:
            for text in (found["problem"], found["fix"]):
                assert text[1:] in report  # a sentence of its own begins with a capital


def test_warnings_of_every_table_of_a_result_are_in_its_report(metrosep, tmp_path):
    """The first table covers the travel, the second does not; no reading went backwards."""
    runs = write_runs(tmp_path / "runs.csv", ways=(1, 1))
    out = tmp_path / "out"
    call = (
        "separate",
        runs,
        *COLUMNS,
        "--method",
        "mean",
        "--compensates",
        "X",
        "--spacing",
        "2 mm",
    )
    tables = ("--table", "csv=a.csv", "--table", "csv=b.csv,travel_high=99 mm,waive=coverage")

    code, printed, err = metrosep(*call, *tables, "-o", out, "--json")
    assert code == 0, err
    assert json.loads(printed)["files"]
    report = html.unescape(re.sub(r"<[^>]*>", "", (out / "report.html").read_text()))
    for name in ("a.csv", "b.csv"):
        sidecar = json.loads((out / f"{name}.json").read_text())
        checks = [f["check"] for f in sidecar["findings"]]
        assert ("coverage" in checks) == (name == "b.csv")
        for found in sidecar["findings"]:
            assert f"warning: {name}: {found['problem']}" in err
            assert f"{name}: {found['problem']}" in report  # the name of a file as it is
    assert "--waive coverage" in err


def test_a_hint_about_directions_works_in_the_command_that_prints_it(metrosep, tmp_path):
    """A controller with one column asks for one table of both ways; its entries are their mean."""
    runs = write_runs(tmp_path / "runs.csv")
    how = (*COLUMNS, "--method", "mean")
    assert metrosep("separate", runs, *how, "-o", tmp_path / "result")[0] == 0
    machine = ("--machine", "machine_axis=X1")
    separate = ("separate", runs, *how, "--table")
    for name, call in (
        ("a.ini", ("table", tmp_path / "result", "--format", "sinumerik-enc", "-o")),
        ("b.ini", separate),
    ):
        out = tmp_path / name
        target = f"sinumerik-enc={out}" if call is separate else out

        code, _, err = metrosep(*call, target, *AXES, *machine)
        assert code == 2
        assert "--table-direction both" in err
        assert not out.exists()

        code, _, err = metrosep(*call, target, *AXES, *machine, "--table-direction", "both")
        assert code == 0, err
        entries = re.findall(r"\$AA_ENC_COMP\[0,\d+,X1\]=(\S+)", out.read_text())
        error = 1e3 * np.array(entries, dtype=float)  # the control subtracts the entry
        x = 1.5 * np.arange(error.size)
        rest = error - error_um(x)
        line = np.polyval(np.polyfit(x, rest, 1), x)  # the alignment of the estimate
        assert np.abs(rest - line).max() < 0.03  # three times what 12 runs of 20 nm leave


@pytest.mark.slow
def test_the_waivers_that_a_refusal_names_are_taken_as_it_prints_them(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv")
    assert metrosep("separate", runs, *COLUMNS, "-o", tmp_path / "result")[0] == 0
    axes = ("--axis", "X", "--compensates", "X", "--spacing", "22 mm")
    call = ("table", tmp_path / "result", "-o", tmp_path / "x.csv", "--format", "csv", *axes)

    code, _, err = metrosep(*call)
    assert code == 1
    named = re.search(r'say --waive (?:"([^"]+)"|([\w-]+))\)', err)
    assert named, err

    code, _, err = metrosep(*call, "--waive", named.group(1) or named.group(2))
    assert code == 0, err
    assert (tmp_path / "x.csv").exists()


def test_verify_judges_the_travel_that_is_stated_as_its_refusal_asks(metrosep, tmp_path):
    """The table ends at 40 mm, where it holds 8 um; the machine goes on to 60 mm and has none."""
    x = np.arange(0.0, 40.1, 1.0)
    wedge = np.where(x > 30.0, 0.8 * (x - 30.0), 0.0)
    rows = [f"{a:.3f},{-w:.6f}" for a, w in zip(x, wedge, strict=True)]
    table = tmp_path / "x.csv"
    table.write_text("position_mm,correction_forward_um\n" + "\n".join(rows) + "\n")
    lines = ["x_mm,z_um,feed_mm_min,run"]
    rng = np.random.default_rng(9)
    for run in range(4):
        at = np.linspace(0.0, 60.0, 601)
        z = np.where((at > 30.0) & (at <= 40.0), 0.8 * (at - 30.0), 0.0)
        z = z + rng.normal(0.0, 0.02, at.size)
        lines += [f"{a:.4f},{b:.6f},400,{run}" for a, b in zip(at, z, strict=True)]
    runs = tmp_path / "runs.csv"
    runs.write_text("\n".join(lines) + "\n")
    call = ("verify", table, "--format", "csv", "--against", runs, *COLUMNS)

    code, _, err = metrosep(*call)
    assert code == 1
    assert '--machine "travel_low=..." and --machine "travel_high=..."' in err

    assert metrosep(*call, "--machine", "travel_high=40 mm")[0] == 0
    code, _, err = metrosep(*call, "--machine", "travel_high=40")
    assert code == 2
    assert "no unit" in err


def test_a_degree_is_refused_where_the_controller_holds_a_table(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv")
    made = ("separate", runs, *COLUMNS, "--method", "mean", "-o", tmp_path / "result")
    assert metrosep(*made)[0] == 0

    code, _, err = metrosep(
        "table", tmp_path / "result", "-o", tmp_path / "x.csv", "--format", "csv", *AXES,
        "--poly", "3",
    )  # fmt: skip

    assert code == 2
    assert "csv holds a table" in err
    assert not (tmp_path / "x.csv").exists()


# ---- several tables of one call, each with options of its own --------------------------------


def test_several_tables_of_one_call_each_have_options_of_their_own(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv")
    a, b, c = (tmp_path / name for name in ("x.comp", "x.csv", "fine.csv"))
    call = ("separate", runs, *COLUMNS, "--method", "mean", "--axis", "X", "--spacing", "1.5 mm")

    code, _, err = metrosep(
        *call,
        "--table", f"linuxcnc={a},compensates=Z,cross_axis=hal",
        "--table", f"csv={b},compensates=X,spacing=2 mm,reference=20 mm,travel_high=60 mm",
        "--table", f"csv={c},compensates=X,direction=both",
    )  # fmt: skip

    assert code == 0, err
    # LinuxCNC itself corrects a joint over itself only: this file is fed to HAL
    assert json.loads(a.with_name("x.comp.json").read_text())["table"]["compensates"] == "Z"
    assert np.loadtxt(a)[:, 0].tolist() == pytest.approx(np.arange(0, 60.1, 1.5), abs=1e-9)
    rows = np.genfromtxt(b, delimiter=",", comments="#", names=True)
    x = rows["position_mm"]
    assert x == pytest.approx(np.arange(0, 60.1, 2.0), abs=1e-9)
    at = np.flatnonzero(np.abs(x - 20.0) < 1e-9)
    assert rows["correction_forward_um"][at] == pytest.approx([0.0], abs=1e-9)
    # positioning keeps the lost motion: reverse needs 1.37 um less
    apart = rows["correction_reverse_um"] - rows["correction_forward_um"]
    assert apart.mean() == pytest.approx(-LOST_UM, abs=0.02)  # noise of 12 runs, 31 entries
    one = np.genfromtxt(c, delimiter=",", comments="#", names=True)
    assert one.size == 41
    assert "correction_reverse_um" not in one.dtype.names

    # what is written alone, or from the result, is the same file
    alone = tmp_path / "alone.csv"
    code, _, err = metrosep(
        *call[:-2], "--compensates", "X", "--reference", "20 mm", "--machine", "travel_high=60 mm",
        "--spacing", "2 mm", "--table", f"csv={alone}",
    )  # fmt: skip
    assert code == 0, err
    assert alone.read_bytes() == b.read_bytes()
    beside = [f.with_name(f.name + ".json").read_bytes() for f in (alone, b)]
    assert beside[0] == beside[1]
    inside = ("--table", "csv=x.csv,compensates=X,spacing=2 mm,reference=20 mm,travel_high=60 mm")
    code, _, err = metrosep(
        *call, *inside, "--table", "linuxcnc=x.comp,compensates=X", "-o", tmp_path / "out"
    )
    assert code == 0, err
    assert (tmp_path / "out" / "x.csv").read_bytes() == b.read_bytes()
    assert (tmp_path / "out" / "x.comp").exists()


def test_a_result_with_tables_of_two_axes_is_asked_which_one(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv", ways=(1, 1))
    call = (
        "separate",
        runs,
        *COLUMNS,
        "--method",
        "mean",
        "--spacing",
        "2 mm",
        "-o",
        tmp_path / "out",
    )
    tables = ("--table", "csv=a.csv,compensates=X", "--table", "csv=b.csv,compensates=Z")
    assert metrosep(*call, *tables)[0] == 0
    again = (
        "table",
        tmp_path / "out",
        "--format",
        "csv",
        "--spacing",
        "2 mm",
        "-o",
        tmp_path / "c.csv",
    )

    code, _, err = metrosep(*again)
    assert code == 2
    assert "X over X and Z over X" in err
    assert metrosep(*again, "--compensates", "Z")[0] == 0
    assert (tmp_path / "c.csv").read_bytes() == (tmp_path / "out" / "b.csv").read_bytes()


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("csv={}/b.csv,spcing=2 mm", "there is no option 'spcing'"),
        ("csv={}/b.csv,spacing=2 kg", "spacing"),
        ("csv={}/b.csv,spacing=2", "spacing"),
        ("csv={}/b.csv,reference=1 deg", "reference"),
        ("csv={}/b.csv,stroke=3", "stroke"),
        ("csv={}/b.csv,direction=up", "direction"),
        ("csv={}/b.csv,degree=3", "degree"),
        ("csv={}/b.csv,spacing=1 mm,spacing=2 mm", "twice"),
        ("linuxcnc={}/b.comp,cross_axis=hl", "cross_axis"),
        ("sinumerik-enc={}/b.ini", "machine_axis"),
        ("aerotech={}/b.cal", "maps over two axes"),
        ("nonesuch={}/b.csv", "unknown controller"),
        ("csv={}/b.csv,waive=nothing", "nothing"),
        ("csv={}/a.csv", "two outputs"),
    ],
)
def test_options_of_every_table_are_checked_before_a_reading_is_opened(
    metrosep, tmp_path, spec, said
):
    good = f"csv={tmp_path}/a.csv,spacing=2 mm"
    call = ("separate", tmp_path / "not-there.csv", *COLUMNS, "--compensates", "X")
    code, _, err = metrosep(*call, "--table", good, "--table", spec.format(tmp_path))

    assert code == 2
    assert said in err
    assert f"--table {spec.format(tmp_path).split(',')[0]}" in err
    assert err.count("error: ") == 1
    assert not list(tmp_path.iterdir())


def test_a_table_without_its_corrected_axis_is_asked_for_by_name(metrosep, tmp_path):
    call = ("separate", tmp_path / "not-there.csv", *COLUMNS)
    tables = ("--table", "csv=a.csv,compensates=Z", "--table", "csv=b.csv")

    code, _, err = metrosep(*call, *tables)

    assert code == 2
    assert "--table csv=b.csv" in err
    assert "which axis" in err


def test_a_table_in_the_way_is_refused_before_anything_is_separated(metrosep, tmp_path):
    call = ("separate", *COLUMNS, "--method", "mean", "--compensates", "X", "--spacing", "2 mm")
    runs = write_runs(tmp_path / "runs.csv")
    other = write_runs(tmp_path / "other.csv", seed=8)
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    tables = ("--table", f"csv={a}", "--table", f"csv={b}")
    assert metrosep(*call, runs, *tables)[0] == 0
    held = {f: f.read_bytes() for f in tmp_path.iterdir()}

    for again in (
        ("separate", *call[1:], other, *tables),  # other readings
        ("separate", *call[1:], runs, "--table", f"csv={tmp_path}/c.csv", "--table", f"linuxcnc={a}"),
    ):  # fmt: skip
        code, _, err = metrosep(*again)
        assert code == 2
        assert f"{a}: exists already" in err
        assert "--force" in err
        assert "separating" not in err
        assert {f: f.read_bytes() for f in tmp_path.iterdir()} == held
    assert metrosep(*call, runs, *tables)[0] == 0  # the same bytes are left
    assert {f: f.read_bytes() for f in tmp_path.iterdir()} == held


# ---- one result document, one table: from every door the same bytes and the same sidecar ------

SLOPE_UM_PER_MM = 0.043
"""Of the scale of the axis below: 2.58 um over its travel of 60 mm."""


@pytest.fixture(scope="module")
def axis_runs(tmp_path_factory):
    """Runs of an axis along itself with pitch, slope and lost motion; one run is off by 9 um."""
    folder = tmp_path_factory.mktemp("axis")
    rng = np.random.default_rng(11)
    for name, samples, runs in (("few", 241, 5), ("many", 2501, 3)):
        rows = ["x_mm,z_um,feed_mm_min,run"]
        for run in range(2 * runs):
            way = (1, -1)[run % 2]
            x = np.linspace(0.0, 60.0, samples)[::way]
            z = error_um(x) + SLOPE_UM_PER_MM * x + (LOST_UM if way < 0 else 0.0)
            z += rng.normal(0, 0.02, x.size) + 9.0 * (run == 2 and name == "few") * np.sin(x)
            rows += [f"{a:.6f},{b:.6f},{310 + run},{run}" for a, b in zip(x, z, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    return folder


DOORS = {
    "linuxcnc": ("few", "X", "linuxcnc", {"travel_high": "60 mm"}, "2 mm"),
    "csv-many-samples": ("many", "X", "csv", {}, "2.5 mm"),
    "pmac-cross": (
        "few", "Z", "pmac",
        {"count": "10 nm", "source_motor": "1", "target_motor": "3", "travel_low": "0 mm", "travel_high": "60 mm",
         "direction": "both"},
        "1.5 mm",
    ),
    "twincat": ("few", "X", "twincat", {"direction": "forward", "travel_high": "60 mm"}, "3 mm"),
    "csv-cross": ("few", "Y", "csv", {"reference": "20 mm"}, "2 mm"),
    "heidenhain": ("few", "X", "heidenhain", {"sign_confirmed": "true"}, "2 mm"),
    "plc-polynomial": ("few", "X", "plc-st", {"degree": "9", "actuator_sign": "-1"}, "2 mm"),
}  # fmt: skip


_OF_TABLE = {
    "direction": lambda v: ("--table-direction", v),
    "reference": lambda v: ("--reference", v),
    "degree": lambda v: ("--poly", v),
    "sign_confirmed": lambda _: ("--sign-confirmed",),
}
"""What shapes a table, as options of the command ``table``; other facts are of the machine."""


@pytest.mark.parametrize("case", DOORS)
def test_every_door_gives_the_same_bytes_and_sidecar(metrosep, axis_runs, tmp_path, case):
    from metrosep.app.documents import Places
    from metrosep.app.server import Answers
    from metrosep.app.sessions import Session

    name, axis, dialect, facts, spacing = DOORS[case]
    runs = tmp_path / "runs.csv"
    runs.write_bytes((axis_runs / f"{name}.csv").read_bytes())
    left_out = ("--exclude", "2") if name == "few" else ()
    how = (*COLUMNS, "--method", "mean", *left_out)
    machine = {k: v for k, v in facts.items() if k not in _OF_TABLE}
    shape = {k: facts[k] for k in _OF_TABLE if k in facts}
    waive = "inconclusive,pointless"

    def written(folder, *call):
        code, _, err = metrosep(*call)
        assert code == 0, err
        return (folder / "t.out").read_bytes(), json.loads((folder / "t.out.json").read_text())

    folders = {k: tmp_path / k for k in ("beside", "inside", "result", "table", "recipe")}
    folders["beside"].mkdir()
    folders["table"].mkdir()
    own = {"axis": "X", "compensates": axis, "spacing": spacing, **facts, "waive": waive}
    words = "".join(f",{k}={v}" for k, v in own.items())
    found = {}
    target = folders["beside"] / "t.out"
    found["beside"] = written(
        target.parent, "separate", runs, *how, "--table", f"{dialect}={target}{words}"
    )
    found["inside"] = written(
        folders["inside"], "separate", runs, *how, "-o", folders["inside"],
        "--table", f"{dialect}=t.out{words}",
    )  # fmt: skip
    assert metrosep("separate", runs, *how, "-o", folders["result"])[0] == 0
    found["table"] = written(
        folders["table"], "table", folders["result"], "--format", dialect,
        "-o", folders["table"] / "t.out", "--axis", "X", "--compensates", axis, "--spacing", spacing,
        *(w for k, v in machine.items() for w in ("--machine", f"{k}={v}")),
        *(w for k, v in shape.items() for w in _OF_TABLE[k](v)), "--waive", waive,
    )  # fmt: skip
    recipe = tmp_path / "recipe.toml"
    text = ", ".join(f'{k} = "{v}"' for k, v in machine.items())
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nx = "x_mm"\nz = "z_um"\nfeed = "feed_mm_min"\n'
        'run = "run"\n[[step]]\nop = "separate"\nmethod = "mean"\n'
        + ('exclude = ["2"]\n' if left_out else "")
        + f'[[output]]\nkind = "table"\ncontroller = "{dialect}"\naxis = "X"\ncompensates = "{axis}"\n'
        f'spacing = "{spacing}"\npath = "t.out"\nmachine = {{ {text} }}\nwaive = ["{waive}"]\n'
        + "".join(
            f"{k} = {repr(v) if k in ('direction', 'reference') else v}\n"
            for k, v in shape.items()
        )
    )
    found["recipe"] = written(folders["recipe"], "run", recipe, "-o", folders["recipe"])
    session = Session(Places([tmp_path]))
    session.open(str(recipe))
    ask = Answers(session).answer
    ask({"k": "table", "write": "t.out"})
    found["workbench"] = (
        (tmp_path / "t.out").read_bytes(),
        json.loads((tmp_path / "t.out.json").read_text()),
    )

    data, sidecar = found["beside"]
    for door, (other, beside) in found.items():
        assert other == data, door
        assert beside == sidecar, door
    assert bool(sidecar["table"].get("reverse_m")) == (
        dialect in ("linuxcnc", "csv", "heidenhain")
    )
    if (
        case == "csv-many-samples"
    ):  # the slope of the scale is in the table, and the right way round
        rows = np.genfromtxt(tmp_path / "t.out", delimiter=",", comments="#", names=True)
        x = rows["position_mm"]
        wanted = -(error_um(x) + SLOPE_UM_PER_MM * x - error_um(0.0))
        assert (
            np.abs(rows["correction_forward_um"] - wanted).max() < 0.06
        )  # mean of 3 runs of 20 nm
        gap = rows["correction_reverse_um"] - rows["correction_forward_um"]
        assert gap == pytest.approx(-LOST_UM, abs=0.09)

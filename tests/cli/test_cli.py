"""The command line: exit codes, one-line errors, nothing half-written."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import metrosep as ms
from metrosep.separation import machine_axis


@pytest.fixture(scope="module")
def runs_csv(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "runs.csv"
    axis = machine_axis(seed=9, length=30e-3)
    lines = ["run,feed_mm_min,x_mm,z_um"]
    for r in axis.runs:
        lines += [
            f"{r.run_id},{r.feed * 6e4:.0f},{x * 1e3:.4f},{z * 1e6:.5f}"
            for x, z in zip(r.x, r.z, strict=True)
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


COLUMNS = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")
RANGE = ("--start", "0 mm", "--length", "30 mm", "--shortest", "1 mm")
"""The same in all tests that need no other: the runs are then separated once."""


def one_line_error(err):
    lines = [line for line in err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, err
    assert "Traceback" not in err
    return lines[0]


def test_help_imports_no_numpy():
    code = (
        "import sys\nfrom metrosep.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'matplotlib', 'h5py', 'lmfit', 'skimage'}\n"
        "print('HEAVY', sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert "HEAVY []" in done.stdout
    assert "separate" in done.stdout


def test_separate_prints_json_on_stdout_and_the_rest_elsewhere(metrosep, runs_csv, monkeypatch):
    monkeypatch.setattr("metrosep.cli.jobs._AT_ONCE", 0.0)
    code, out, err = metrosep("separate", runs_csv, *COLUMNS, *RANGE, "--json")
    found = json.loads(out)

    assert code == 0
    assert found["method"] == "joint"
    assert found["stop_mm"] == pytest.approx(30.0, rel=1e-9, abs=0.0)
    assert 500 < found["pv_nm"] < 2500
    assert found["selected"]
    assert "separating 9 runs" in err


def test_separate_writes_table_report_and_result(metrosep, runs_csv, tmp_path):
    code, _, err = metrosep(
        "separate", runs_csv, *COLUMNS, *RANGE, "--table", "linuxcnc=x.comp", "--compensates", "X", "--spacing", "0.5 mm", "--poly", "2", "-o", tmp_path / "out",
    )  # fmt: skip

    assert code == 0, err
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["report.html", "result.json", "x.comp", "x.comp.json"]
    assert "dry-run forward" in err
    first = (tmp_path / "out" / "x.comp").read_text().splitlines()[0].split()
    assert len(first) == 3


def test_table_from_a_result_and_verify(metrosep, runs_csv, tmp_path):
    out = tmp_path / "out"
    code, _, _ = metrosep("separate", runs_csv, *COLUMNS, *RANGE, "-o", out)
    assert code == 0

    comp = tmp_path / "x.comp"
    code, _, err = metrosep(
        "table", out / "result.json", "--compensates", "X", "--spacing", "0.5 mm", "-o", comp
    )
    assert code == 0, err
    code, stdout, _ = metrosep("verify", comp, "--against", runs_csv, *COLUMNS, "--json")
    assert code == 0
    assert json.loads(stdout)["passed"] is True


def test_one_run_with_a_hole_does_not_refuse_the_table(metrosep, runs_csv, tmp_path):
    """30 readings of the third run (3.6 mm) were lost; the eight others have them."""
    lines = runs_csv.read_text().splitlines()
    run = lines[1 + (len(lines) - 1) * 5 // 18].split(",")[0]
    own = [i for i, line in enumerate(lines) if line.startswith(run + ",")]
    for i in own[len(own) // 2 : len(own) // 2 + 30]:
        lines[i] = lines[i].rsplit(",", 1)[0] + ","
    holed = tmp_path / "holed.csv"
    holed.write_text("\n".join(lines) + "\n")
    comp = tmp_path / "x.comp"
    made = ("--shortest", "1 mm", "--compensates", "X", "--spacing", "0.5 mm")

    code, _, err = metrosep("separate", holed, *COLUMNS, *made, "--table", f"linuxcnc={comp}")
    assert code == 0, err
    code, stdout, err = metrosep("verify", comp, "--against", holed, *COLUMNS, "--json")
    assert code == 0, err
    found = json.loads(stdout)
    assert found["passed"] is True
    assert f"{run}' was not measured between" in stdout
    assert "the 8 runs that were" in stdout


@pytest.mark.parametrize(("n", "lost", "direction"), [(101, 1, -1), (101, 4, 1), (4001, 4, -1)])
def test_wrong_entries_inside_a_hole_are_seen(metrosep, tmp_path, n, lost, direction):
    """400 nm too much from 44 to 51 mm, where some of nine runs were not measured."""
    x = np.linspace(0.0, 100e-3, n)
    e = 2e-6 * np.sin(2 * np.pi * x / 80e-3)
    lines = ["run,feed_mm_min,x_mm,z_um"]
    for i in range(9):
        hole = (i < lost) & (x > 40e-3) & (x < 55e-3)
        rows = [
            f"{i},600,{p * 1e3:.4f},{'' if h else f'{v * 1e6:.6f}'}"
            for p, v, h in zip(x, e, hole, strict=True)
        ]
        lines += rows[::direction]
    runs = tmp_path / "runs.csv"
    runs.write_text("\n".join(lines) + "\n")
    places = np.linspace(0.0, 100.0, 201)
    bump = np.where((places >= 44.0) & (places <= 51.0), 0.4e-3, 0.0)
    values = places + np.interp(places, x * 1e3, e * 1e3) + bump
    wrong = tmp_path / "wrong.comp"
    wrong.write_text("".join(f"{p} {v} {v}\n" for p, v in zip(places, values, strict=True)))

    code, out, err = metrosep(
        "verify", wrong, "--against", runs, *COLUMNS, "--machine", "linear_units=mm", "--json"
    )
    (residual,) = json.loads(out)["residuals"]

    # within the share that the ends of the bump have between two readings
    assert residual["after_rms_m"] == pytest.approx(np.std(bump) * 1e-3, rel=0.04, abs=0.0)
    said = f"there it is judged by the {9 - lost} runs that were"
    assert said in out
    if n == 101:
        code, out, err = metrosep(
            "table", runs, *COLUMNS, "--method", "mean", "--compensates", "X", "--axis", "X",
            "-o", tmp_path / "x.comp", "--json"
        )  # fmt: skip
        assert code in (0, 3), err
        assert said in out + err


@pytest.mark.parametrize(
    ("column", "axis"), [("y_mm", "Y"), ("Y-axis:mm", "Y"), ("x_mm", "X"), ("pos_mm", "X")]
)
def test_axis_of_the_positions_is_that_of_their_column(metrosep, tmp_path, column, axis):
    x = np.linspace(0.0, 30.0, 301)
    z = np.sin(x / 3.0)
    lines = [f"run,{column.partition(':')[0]},z_um"]
    lines += [f"{i},{p:.3f},{v:.5f}" for i in range(5) for p, v in zip(x, z, strict=True)]
    runs = tmp_path / "runs.csv"
    runs.write_text("\n".join(lines) + "\n")
    read = (runs, "--x", column, "--z", "z_um", "--run", "run", "--method", "mean")
    shape = ("--compensates", "Z", "--spacing", "1 mm")
    out, two = tmp_path / "out", tmp_path / "two.csv"

    code, _, err = metrosep("separate", *read, *shape, "--table", "csv=one.csv", "-o", out)
    assert code == 0, err
    assert metrosep("separate", *read, "-o", tmp_path / "plain")[0] == 0
    code, _, said = metrosep("table", tmp_path / "plain", *shape, "--format", "csv", "-o", two)
    assert code == 0, said

    for text, file in ((err, out / "one.csv"), (said, two)):
        assert f"table {axis} -> Z" in text
        assert (f"note: axis {axis}" in text) == (column != "x_mm")
        assert json.loads((file.parent / f"{file.name}.json").read_text())["table"]["axis"] == axis


def test_verify_rejects_a_flipped_table_with_code_1(metrosep, runs_csv, tmp_path):
    comp = tmp_path / "x.comp"
    code, _, _ = metrosep(
        "separate",
        runs_csv,
        *COLUMNS,
        *RANGE,
        "--table",
        f"linuxcnc={comp}",
        "--compensates",
        "X",
        "--spacing",
        "0.5 mm",
        "--machine",
        "travel_low=0 mm",
        "--machine",
        "travel_high=30 mm",
    )
    assert code == 0
    assert comp.exists()
    flipped = tmp_path / "flipped.comp"
    rows = [[float(v) for v in line.split()] for line in comp.read_text().splitlines()]
    flipped.write_text("".join(f"{p} {2 * p - f} {2 * p - r}\n" for p, f, r in rows))

    code, _, err = metrosep(
        "verify",
        flipped,
        "--against",
        runs_csv,
        *COLUMNS,
        "--machine",
        "linear_units=mm",
        "--machine",
        "travel_low=0 mm",
        "--machine",
        "travel_high=30 mm",
    )

    assert code == 1
    assert "the reversed sign would shrink it" in one_line_error(err)


def test_run_recipe_and_its_verdict_become_the_exit_code(metrosep, runs_csv, tmp_path):
    recipe = tmp_path / "r.toml"
    text = (
        'metrosep = 1\n[input]\nx = "x_mm"\nz = "z_um"\nfeed = "feed_mm_min"\nrun = "run"\n'
        '[[step]]\nop = "separate"\n[[check]]\nmetric = "pv"\nupper = "UPPER"\nU = "1 nm"\n'
    )
    recipe.write_text(text.replace("UPPER", "10 um"))
    assert metrosep("run", recipe, runs_csv, "-o", tmp_path / "a")[0] == 0
    recipe.write_text(text.replace("UPPER", "10 nm"))
    assert metrosep("run", recipe, runs_csv, "-o", tmp_path / "b")[0] == 1
    recipe.write_text(text.replace("UPPER", "10"))
    code, _, err = metrosep("run", recipe, runs_csv, "-o", tmp_path / "c")
    assert code == 2
    assert "r.toml:11" in one_line_error(err)
    assert not (tmp_path / "c").exists()


def test_info_of_a_metropro_file(metrosep, corpus):
    code, out, _ = metrosep("info", corpus / "st" / "metropro-1.dat", "--json")
    found = json.loads(out)

    assert code == 0
    assert set(found) == {
        "format", "kind", "shape", "dx_m", "dy_m", "n_invalid", "pv_nm", "sq_nm", "mean_nm",
        "sha256", "metadata",
    }  # fmt: skip
    assert found["pv_nm"] == pytest.approx(1363.056, abs=5e-4)
    assert found["sq_nm"] == pytest.approx(75.2882, abs=5e-5)
    assert found["dx_m"] == pytest.approx(1.09825e-6, abs=5e-12)


def test_convert_to_x3p_and_back(metrosep, corpus, tmp_path):
    target = tmp_path / "a.x3p"
    assert metrosep("convert", corpus / "st" / "metropro-1.dat", target)[0] == 0
    code, out, _ = metrosep("info", target, "--json")

    assert code == 0
    assert json.loads(out)["pv_nm"] == pytest.approx(1363.056, abs=5e-4)
    code, _, err = metrosep("convert", corpus / "st" / "metropro-1.dat", target)
    assert code == 2
    assert "exists already" in one_line_error(err)


def test_lists(metrosep):
    code, out, _ = metrosep("formats", "--json")
    assert code == 0
    assert {"metropro", "x3p", "delimited"} <= {f["id"] for f in json.loads(out)["formats"]}
    code, out, _ = metrosep("controllers", "--json")
    assert code == 0
    assert [c["id"] for c in json.loads(out)["controllers"]][:2] == ["linuxcnc", "csv"]
    assert "sign" in metrosep("controllers")[1]


def write(path, text):
    path.write_text(text)
    return path


def bad_files(folder):
    x = np.linspace(0, 30, 400)

    def rows(feeds, *, n=400, z="0.1", turn=False):
        lines = ["run,feed_mm_min,x_mm,z_um"]
        for i, feed in enumerate(feeds):
            for k in range(n):
                p = x[k] - (5.0 if turn and k == 200 else 0.0)
                lines.append(
                    f"{i},{feed},{p:.5f},{z if z != '0.1' else (k * 7919 % 13) * 0.01 + (i + feed * 1e-4) * (k % 7) * 1e-3}"
                )
        return "\n".join(lines) + "\n"

    return {
        "misnamed": write(folder / "misnamed.csv", rows([4800]).replace("z_um", "height_um")),
        "no unit": write(folder / "nounit.csv", rows([4800]).replace("z_um", "z")),
        "all NaN": write(folder / "nan.csv", rows([4800, 7200], z="")),
        "one feed": write(folder / "onefeed.csv", rows([7200, 7200])),
        "turning": write(folder / "turning.csv", rows([4800, 7200], turn=True)),
        "travel": write(
            folder / "travel.csv", rows([4800]) + rows([7200], n=200).split("\n", 1)[1].replace("\n0,", "\n1,").replace("0,7200", "1,7200", 1)
        ),
        "empty": write(folder / "empty.csv", ""),
        "truncated": write(folder / "truncated.csv", rows([4800, 7200])[:-14]),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "codes", "words"),
    [
        ("misnamed", (4,), "height_um"),
        ("no unit", (2, 4), "unit"),
        ("all NaN", (4,), "no reading"),
        ("one feed", (4,), "7200 mm/min"),
        ("turning", (4,), "monotonic"),
        ("travel", (4,), "different travels"),
        ("empty", (4,), "empty"),
        ("truncated", (4,), "truncated.csv"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(metrosep, tmp_path, name, codes, words):
    source = bad_files(tmp_path)[name]
    columns = list(COLUMNS)
    if name == "no unit":
        columns[3] = "z"

    code, out, err = metrosep(
        "separate",
        source,
        *columns,
        "--table",
        "linuxcnc=x.comp",
        "--compensates",
        "X",
        "-o",
        tmp_path / "out",
    )

    assert code in codes, err
    assert words in one_line_error(err)
    assert out == ""
    assert not (tmp_path / "out" / "result.json").exists()
    assert not (tmp_path / "out" / "x.comp").exists()


def test_binary_garbage_and_missing_file(metrosep, tmp_path):
    garbage = tmp_path / "g.csv"
    garbage.write_bytes(np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes())

    for path in (garbage, tmp_path / "none.csv", tmp_path):
        code, _, err = metrosep("info", path)
        assert code == 4
        assert str(path) in one_line_error(err)


def test_unwritable_folder(metrosep, runs_csv, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")

    code, _, err = metrosep("separate", runs_csv, *COLUMNS, "-o", blocked / "out")

    assert code == 2
    assert "is a file, not a folder" in one_line_error(err)


@pytest.mark.parametrize(
    "words",
    [
        ("separate",),
        ("nothing",),
        ("separate", "a.csv", "--x", "x"),
        ("run", "r.toml"),
        ("--bad",),
    ],
)
def test_usage_errors_are_one_line_with_code_2(metrosep, words):
    code, out, err = metrosep(*words)

    assert code == 2
    assert out == ""
    one_line_error(err)


def test_internal_errors_have_code_5_and_a_traceback_only_on_request(
    metrosep, runs_csv, monkeypatch
):
    def broken(*_args, **_kwargs):
        raise RuntimeError("boom")

    monkeypatch.setattr(metrosep_io_runs(), "read_runs", broken)
    code, _, err = metrosep("separate", runs_csv, *COLUMNS)
    assert code == 5
    assert "internal error (RuntimeError: boom)" in one_line_error(err)
    code, _, err = metrosep("-vv", "separate", runs_csv, *COLUMNS)
    assert code == 5
    assert "Traceback" in err


def metrosep_io_runs():
    import importlib

    return importlib.import_module("metrosep.io.runs")


def test_interrupt_has_code_130(metrosep, runs_csv, monkeypatch):
    def stop(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(metrosep_io_runs(), "read_runs", stop)
    code, _, err = metrosep("separate", runs_csv, *COLUMNS)

    assert code == 130
    assert "interrupted" in one_line_error(err)


def test_print_recipe_runs_as_a_recipe(metrosep, runs_csv, tmp_path):
    code, out, _ = metrosep(
        "separate", runs_csv, *COLUMNS, "--start", "0 mm", "--length", "30 mm", "--print-recipe"
    )
    assert code == 0
    recipe = tmp_path / "r.toml"
    recipe.write_text(out)

    assert metrosep("run", recipe, runs_csv, "-o", tmp_path / "out")[0] == 0


@pytest.mark.slow
def test_demo_end_to_end_as_a_process(tmp_path):
    """What a new user types; offline, well under a minute."""
    done = subprocess.run(
        [sys.executable, "-m", "metrosep", "demo", "-o", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "NO_COLOR": "1"},
    )

    assert done.returncode == 0, done.stderr
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == [
        "report.html",
        "result.json",
        "x-straightness.comp",
        "x-straightness.comp.json",
    ]
    assert "report   out/report.html" in done.stderr
    assert "table    out/x-straightness.comp" in done.stderr


@pytest.mark.parametrize("name", ["mit.csv", "mit.x3p", "mit.h5"])
def test_a_converted_profile_is_measured_as_the_export_itself(metrosep, corpus, tmp_path, name):
    """Rz as the instrument prints it, 18.485 um from its 4 sections; not filtered again."""
    export, target = corpus / "st" / "mitutoyo_2_mock.xlsx", tmp_path / name
    assert metrosep("convert", export, target)[0] == 0

    for path in (export, target):
        edition = ("--edition", "ISO 4287:1997", "--params", "Ra,Rz", "--json")
        code, out, _ = metrosep("measure", path, *edition)
        again, _, err = metrosep("measure", path, "--lambda-c", "2.5 mm", "--end", "cut", *edition)

        found = json.loads(out)
        assert code == 0
        assert found["rz_nm"] == pytest.approx(18485.0, abs=0.6)
        assert found["ra_nm"] == pytest.approx(3308.0, abs=0.6)
        assert found["evaluations"][0]["settings"]["sections"] == 4
        assert again == 2
        assert "filtering again" in err


def test_sections_that_were_asked_stay_and_the_cut_off_is_named(metrosep, corpus):
    export = corpus / "st" / "mitutoyo_2_mock.xlsx"

    _, out, _ = metrosep("measure", export, "--params", "Rz", "--sections", 5)

    assert "mean of 5 sections" in out
    assert "2.5 mm" in out


def test_convert_names_the_formats_that_lose_the_history(metrosep, tmp_path):
    wavy = ms.Surface(1e-8 * np.sin(np.arange(400.0).reshape(20, 20)), 1e-6, 1e-6)
    ms.write(ms.filters.gaussian(wavy, nesting_index=8e-6, band="short"), tmp_path / "a.x3p")
    ms.write(wavy, tmp_path / "plain.x3p")

    said = {
        (source, end): metrosep(
            "convert", tmp_path / f"{source}.x3p", tmp_path / f"{source}.{end}"
        )[2]
        for source in ("a", "plain")
        for end in ("sdf", "sur", "int", "csv", "xyz", "h5")
    }

    loud = {key for key, err in said.items() if "holds no history" in err}
    assert loud == {("a", "sdf"), ("a", "sur"), ("a", "int")}


def test_the_list_of_commands_says_the_first_sentence_of_each_and_loads_none(capfd):
    import click

    from metrosep.cli.main import cli

    context = click.Context(cli, info_name="metrosep")
    listed = cli.get_help(context)
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        first = " ".join(command.get_short_help_str(60).rstrip(".").partition(":")[0].split()[:4])
        assert f"  {name} " in listed
        assert first in " ".join(listed.split()), name


def test_a_command_that_is_nearly_one_is_named(metrosep):
    code, _, err = metrosep("measur", "x.h5")
    assert code == 2
    assert 'Did you mean "measure"?' in err

"""What the command line says: options instead of arguments, causes instead of bugs, codes that fit."""

import json
import os
import signal
import subprocess
import sys

import click
import pytest

from metrosep.cli.errors import as_options, exit_code_of, flags_of
from metrosep.cli.main import cli, main
from metrosep.core import errors
from metrosep.separation import machine_axis

COLUMNS = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")
ITSELF = ("--compensates", "X")


def write_runs(path, *, head="run,feed_mm_min,x_mm,z_um", feeds=(0.08, 0.12, 0.16)):
    lines = [head]
    for r in machine_axis(seed=9, length=30e-3, feeds=feeds).runs:
        lines += [
            f"{r.run_id},{r.feed * 6e4:.0f},{x * 1e3:.4f},{z * 1e6:.5f}"
            for x, z in zip(r.x, r.z, strict=True)
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def runs_csv(tmp_path_factory):
    return write_runs(tmp_path_factory.mktemp("cli") / "runs.csv")


@pytest.fixture
def failing(capsys):
    """Run a command line that must fail: (code, its one line)."""

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        captured = capsys.readouterr()
        lines = [line for line in captured.err.splitlines() if line.startswith("error:")]
        assert len(lines) == 1, captured.err
        assert "Traceback" not in captured.err
        assert captured.out == ""
        return stop.value.code, lines[0]

    return call


@pytest.mark.parametrize(
    ("message", "names", "wanted"),
    [
        ("say method='mean' or min_feeds=1", {"method", "min_feeds"}, "say --method mean or --min-feeds 1"),
        ("give scale='2.5 um/V'", {"scale"}, 'give --scale "2.5 um/V"'),
        ("declare separator= and decimal=", {"separator", "decimal"}, "declare --separator and --decimal"),
        ("give x=('pos', 'um') or unit=", {"x"}, "give --x pos:um"),
        ("write controller='csv'", {"table_"}, "write --table csv=FILE"),
        ("write controller='csv'", {"format_"}, "write --format csv"),
        ("say method='mean'", {"recipe"}, "say method='mean'"),
        ("column 'x=2' is not \"z=1\"; give z=", {"x", "z"}, "column 'x=2' is not \"z=1\"; give --z"),
        ("a.csv: x=3 is odd", {"method"}, "a.csv: x=3 is odd"),
        ("lower min_ratio.", {"min_ratio"}, "lower --min-ratio."),
        ("min_ratio is 2; 'min_ratio' min_ratios runs/min_ratio.csv min_ratio = 2", {"min_ratio"},
         "--min-ratio is 2; 'min_ratio' min_ratios runs/min_ratio.csv min_ratio = 2"),
        *[
            (kept, {"c_zero", "x_step"}, kept)
            for kept in (
                "runs.csv has no column c_zero; the columns are c_zero, x_mm",
                "the file c_zero.csv is missing, and c_zero.csv.json",
                "no file c_zero, x_step or c_zero.csv in runs", "column(s) c_zero and x_step are text",
                "give c_zero.csv, or c_zero-2.csv", "name one of: c_zero, x_step",
                "the column c_zero is 2; x_step is the position", "say 'c_zero', or \"x_step\"",
            )
        ],
        ("state x_step, c_zero or both; give repeats, or repeats or c_zero", {"c_zero", "x_step"},
         "state --x-step, --c-zero or both; give repeats, or repeats or c_zero"),
        ("c_zero and x_step are for a map; give repeats or c_zero", {"c_zero", "x_step"},
         "--c-zero and --x-step are for a map; give repeats or --c-zero"),
        ("n_runs is 1 with 0 run(s); raise n_runs, or form_text='plane'", {"n_runs": "--runs", "form_text": "--form"},
         "--runs is 1 with 0 run(s); raise --runs, or --form plane"),
        ("folder/method=a/b.csv: missing", {"scale"}, "folder/method=a/b.csv: missing"),
    ],
)  # fmt: skip
def test_arguments_become_options_of_the_command(message, names, wanted):
    assert as_options(message, names) == wanted


@pytest.mark.parametrize(
    ("message", "wanted"),
    [
        ("cannot be written without output_axis= (axis, AX3); table_index= (which)",
         'cannot be written without --machine "output_axis=..." (axis, AX3); --machine "table_index=..." (which)'),
        ("give it with --machine output_axis=...", "give it with --machine output_axis=..."),
        ('say --machine "turns=True"', 'say --machine "turns=True"'),
        ("give turns=True or turns=0", 'give --machine "turns=True" or turns=0'),
        ("write it with turns=True; turns=False is slow", 'write it with --machine "turns=True"; turns=False is slow'),
        ("the table is X -> Y, but output_axis=AX1", "the table is X -> Y, but output_axis=AX1"),
    ],
)  # fmt: skip
def test_a_fact_of_the_machine_is_an_option_where_the_error_hints_at_it(message, wanted):
    facts = ("output_axis", "table_index", "turns")
    assert as_options(message, {"machine", "waive"}, facts, ({"turns": True},)) == wanted


def test_columns_and_files_that_are_called_like_an_option_keep_their_names(failing, tmp_path):
    file = tmp_path / "max_filled.csv"
    file.write_text("max_filled,x_mm\n1,2\n2,3\n3,4\n")
    words = ("--set", "x=place", "--limit", "rms = 1 nm from 0.05 mm to 0.5 mm")
    code, line = failing("psd", file, *words)
    assert code == 4
    assert line.endswith(
        "max_filled.csv: has no x column 'place'; the columns are max_filled, x_mm"
    )
    assert "--max-filled" not in line


def test_a_flag_in_a_refusal_is_one_that_the_command_has():
    """Names of arguments are not those of options everywhere: n_runs is --runs."""
    context = click.Context(cli, info_name="metrosep")
    for name in ("plan", "psd", "convert", "measure", "check", "verify"):
        command = cli.get_command(context, name)
        flags = flags_of(command)
        said = as_options("; ".join(f"raise {p.name}" for p in command.params), flags)
        typed = {o for p in command.params for o in p.opts}
        assert {w.rstrip(";") for w in said.split() if w.startswith("--")} <= typed, name
    assert as_options("raise n_runs", flags_of(cli.get_command(context, "plan"))) == "raise --runs"


def test_every_fact_of_a_fix_is_an_option():
    said = as_options("raise rate=3", {"machine"}, ("rate",), None)
    assert said == 'raise --machine "rate=3"'
    assert as_options("rate=3 is too fast", {"machine"}, ("rate",)) == "rate=3 is too fast"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.SignCheckFailedError("x"), 1),
        (errors.LimitError("x"), 1),
        (errors.TableError("x"), 2),
        (errors.RecipeError("x"), 2),
        (errors.WriteError("x"), 2),
        (errors.UnitError("x"), 2),
        (errors.UnknownFormatError("x"), 4),
        (errors.InvalidSamplesError("x"), 4),
        (errors.NotSeparableError("x"), 4),
        (RuntimeError("x"), 5),
        (FileNotFoundError(2, "gone", "a.txt"), 5),
        (KeyboardInterrupt(), 130),
    ],
)
def test_codes_of_the_error_tree(error, code):
    assert exit_code_of(error) == code


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--length", "45"), "--length '45': value '45' has no unit"),
        (("--length", "0 mm"), "--length '0 mm': it must be positive and finite, got 0.0 m"),
        (("--method", "fourrier"), "--method 'fourrier' is not one of joint, kono, mean"),
        (("--lag", "often"), "--lag 'often'"),
        (("--poly", "2.5"), "--poly '2.5': a whole number"),
        (("--reference", "0 mm"), "--reference shapes a table: add --table"),
        (("--table", "x.comp"), "--table is written FORMAT=FILE"),
        (("--table", "fanuk=x.comp", "--compensates", "X", "-o", "out"), "--table fanuk=x.comp: unknown controller 'fanuk'"),
        (("--table", "fanuk=x.comp", "--compensates", "X"), "unknown controller 'fanuk'"),
        (("--table", "linuxcnc=a/x.comp", "--compensates", "X", "-o", "out"), "--table linuxcnc=a/x.comp: output path 'a/x.comp'"),
        (("--table", "linuxcnc=x.comp", "--compensates", "X", "--spacing", "1 nm", "-o", "out"), "use a coarser spacing"),
        (("--table", "linuxcnc=x.comp", "--compensates", "X", "--spacing", "1 nm"), "use a coarser spacing"),
        (("--table", "linuxcnc=x.comp", "--compensates", "Z", "-o", "out"), "--cross-axis hal"),
        (("--table", "linuxcnc=none/x.comp", "--compensates", "X"), "the folder"),
    ],
)  # fmt: skip
def test_wrong_options_are_named_and_leave_nothing(
    failing, runs_csv, tmp_path, monkeypatch, options, words
):
    monkeypatch.chdir(tmp_path)

    code, line = failing("separate", runs_csv, *COLUMNS, *options)

    assert code == 2
    assert words in line
    assert "command line:" not in line
    assert list(tmp_path.iterdir()) == []


def test_one_feedrate_says_which_options_help(failing, tmp_path):
    path = write_runs(tmp_path / "one.csv", feeds=(0.12,))

    code, line = failing("separate", path, *COLUMNS)

    assert code == 4
    assert "--method mean or --min-feeds 1" in line


def test_a_missing_unit_says_how_to_give_it(failing, tmp_path):
    path = write_runs(tmp_path / "r.csv", head="run,feed,pos,probe")

    code, line = failing("separate", path, "--x", "pos", "--z", "probe:um", "--run", "run")

    assert code == 2
    assert "--x pos:um" in line


def test_a_sensor_in_volts_is_scaled(capsys, tmp_path):
    path = write_runs(tmp_path / "r.csv", head="run,feed,pos,probe")
    columns = ("--x", "pos:mm", "--z", "probe:V", "--feed", "feed:mm/min", "--run", "run")
    found = []
    for scale in ("1 um/V", "2.5 um/V"):
        with pytest.raises(SystemExit) as stop:
            main(["separate", str(path), *columns, "--scale", scale, "--json"])
        assert stop.value.code == 0
        found.append(json.loads(capsys.readouterr().out)["pv_nm"])

    assert found[1] == pytest.approx(2.5 * found[0], rel=1e-6, abs=0.0)


def test_global_flags_work_behind_the_command(capsys, failing, tmp_path):
    missing = str(tmp_path / "none.csv")

    with pytest.raises(SystemExit) as stop:
        main(["info", missing, "-vv"])

    assert stop.value.code == 4
    assert "Traceback" in capsys.readouterr().err
    assert failing("info", missing, "-q")[0] == 4


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")  # noqa: PTH110
def test_a_full_standard_output_is_no_bug_of_ours():
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            [sys.executable, "-m", "metrosep", "formats"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip

    assert done.returncode == 2
    assert done.stderr.startswith("error: standard output cannot be written")
    assert len(done.stderr.splitlines()) == 1


def test_a_closed_pipe_ends_quietly():
    with subprocess.Popen(
        [sys.executable, "-m", "metrosep", "formats"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        process.stdout.close()
        said = process.stderr.read()

    assert process.returncode == 2
    assert said == b""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupted_run_leaves_nothing(runs_csv, tmp_path):
    with subprocess.Popen(
        [sys.executable, "-m", "metrosep", "separate", str(runs_csv), *COLUMNS,
         "--table", "linuxcnc=x.comp", "--compensates", "X", "-o", str(tmp_path / "out")],
        stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # noqa: PLW1509
    ) as process:  # fmt: skip
        for line in process.stderr:
            if "writing" in line:
                break
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()

    assert process.returncode == 130
    assert said.splitlines()[-1] == "error: interrupted; nothing half-written was left behind"
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def result_folder(runs_csv, tmp_path_factory):
    out = tmp_path_factory.mktemp("result")
    words = [
        "separate",
        str(runs_csv),
        *COLUMNS,
        "--shortest",
        "1 mm",  # the folds cost half
        "--table",
        "linuxcnc=x.comp",
        "--compensates",
        "X",
        "-o",
        str(out),
    ]
    with pytest.raises(SystemExit) as stop:
        main(["-q", *words])
    assert stop.value.code == 0
    return out


@pytest.mark.slow
def test_a_table_cut_short_is_not_verified(failing, runs_csv, result_folder, tmp_path):
    rows = (result_folder / "x.comp").read_text().splitlines(keepends=True)
    (tmp_path / "x.comp").write_text("".join(rows[:15]))
    sidecar = (result_folder / "x.comp.json").read_bytes()
    (tmp_path / "x.comp.json").write_bytes(sidecar)

    code, line = failing("verify", tmp_path / "x.comp", "--against", runs_csv, *COLUMNS)

    assert code == 4
    assert "not the table that its sidecar describes" in line


def test_the_span_of_a_dry_run_is_told(capsys, runs_csv, result_folder, tmp_path):
    rows = (result_folder / "x.comp").read_text().splitlines(keepends=True)
    short = tmp_path / "short.comp"
    short.write_text("".join(rows[:15]))
    ends = [float(rows[i].split()[0]) for i in (0, 14)]

    with pytest.raises(SystemExit):
        main(
            [
                "verify",
                str(short),
                "--against",
                str(runs_csv),
                *COLUMNS,
                "--machine",
                "linear_units=mm",
            ]
        )

    assert f"dry-run forward, {ends[0]:g} ... {ends[1]:g} mm: P-V" in capsys.readouterr().err


def test_an_existing_table_is_kept_unless_forced(failing, capsys, result_folder, tmp_path):
    target = tmp_path / "x.comp"
    target.write_text("mine")

    code, line = failing("table", result_folder, "-o", target, *ITSELF)

    assert code == 2
    assert "choose another name or give --force" in line
    assert target.read_text() == "mine"
    with pytest.raises(SystemExit) as stop:
        main(["table", str(result_folder), "-o", str(target), *ITSELF, "--force"])
    assert stop.value.code == 0
    assert target.read_text() != "mine"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"schema": "metrosep.result/1"}'])
def test_a_damaged_result_gives_no_table(failing, tmp_path, content):
    (tmp_path / "result.json").write_text(content)

    code, line = failing(
        "table", tmp_path / "result.json", "--compensates", "X", "-o", tmp_path / "x.comp"
    )

    assert code == 4
    assert "result.json" in line
    assert not (tmp_path / "x.comp").exists()

"""What can be known without data is refused before data are read, and all of it at once."""

import pytest

RUNS = "runs.csv"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [
        f"{r},{600 * (1 + r % 2)},{x / 10},{0.1 * ((x * 7 + r * r * x) % 5) + 0.01 * ((x * x + 3 * r) % 7)}"
        for r in range(4)
        for x in range(60)
    ]
    (tmp_path / RUNS).write_text("run,feed_mm_min,x_mm,z_um\n" + "\n".join(rows) + "\n", "utf-8")
    (tmp_path / "file").write_text("x", "utf-8")
    return tmp_path


def never_read(monkeypatch):
    def read(*_, **__):
        raise AssertionError("the data were read")

    monkeypatch.setattr("metrosep.io.runs.read_runs", read)


COLUMNS = ("--x", "x_mm", "--z", "z_um", "--run", "run", "--feed", "feed_mm_min")
SEPARATE = ("separate", RUNS, *COLUMNS, "--method", "mean", "--compensates", "Z")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--table", "csv=x.csv; spacng=1 mm"), 'Did you mean "spacing"?'),
        (("--table", "csv=gone/x.csv"), "the folder gone does not exist"),
        (("--table", "csv=file/x.csv"), "the folder file does not exist"),
        (("-o", "file/out"), "file is a file, not a folder"),
        (("--table", "csv=x.csv; spacing=1 deg"), "1 deg"),
        (("--table", "pmac=x.pmc"), "count"),
    ],
)
def test_a_wrong_option_costs_no_reading(metrosep, folder, monkeypatch, words, says):
    never_read(monkeypatch)
    code, out, err = metrosep(*SEPARATE, *words)
    assert code == 2
    assert says in err
    assert not out
    assert sorted(p.name for p in folder.iterdir()) == ["file", RUNS]


def test_options_of_one_table_stand_behind_it(metrosep, folder):
    found = [
        metrosep(*SEPARATE, "--print-recipe", "--table", text)[1]
        for text in ("csv=x.csv; spacing=0.5 mm; axis=X", 'csv=x.csv,spacing="0.5 mm",axis=X')
    ]
    assert 'spacing = "0.5 mm"' in found[0]
    assert found[0].replace('""', '"') == found[1].replace('"\\"', '"').replace('\\""', '"')


def test_all_missing_options_are_listed_with_the_columns_of_the_file(metrosep, folder):
    text = (folder / RUNS).read_text("utf-8").replace("x_mm,z_um", "a_mm,b_um")
    (folder / "runs_ab.csv").write_text(text, "utf-8")
    code, _, err = metrosep("separate", "runs_ab.csv", "--run", "run")
    assert code == 2
    assert "'--x' and '--z'; runs_ab.csv has run, feed_mm_min, a_mm, b_um" in err


def test_a_reference_that_no_run_reaches_is_refused_before_separating(metrosep, folder):
    code, _, err = metrosep(*SEPARATE, "--table", "csv=x.csv", "--reference", "900 mm")
    assert code == 2
    assert "outside the travel of the runs, X = 0 mm ... X = 5.9 mm" in err
    assert "separating" not in err


def test_the_last_line_names_the_next_command(metrosep, folder):
    err = metrosep("separate", RUNS, *COLUMNS, "--method", "mean", "-o", "out")[2]
    said = err.splitlines()[-1].removeprefix("next: metrosep ")
    assert said == "table out --compensates AXIS --format csv -o table.csv"
    for axis in "XZ":
        code, _, err = metrosep(*said.replace("AXIS", axis).split(), "--waive", "inconclusive")
        assert "corrects its own joint" not in err
        assert code != 2, err
        (folder / "table.csv").unlink(missing_ok=True)
        (folder / "table.csv.json").unlink(missing_ok=True)


def test_fields_of_the_report_are_stated_where_a_report_is_written(metrosep, folder):
    import numpy as np

    import metrosep as ms

    ms.write(ms.Surface(1e-9 * np.arange(400.0).reshape(20, 20) % 7, 1e-6, 1e-6), "a.sdf")
    stated = ("--report", "item.serial=A 12", "--report", "number=2026-7")
    code, _, err = metrosep("measure", "a.sdf", "--params", "Sq", "-o", "out", *stated)
    assert code == 0, err
    page = (folder / "out" / "report.html").read_text("utf-8")
    assert "A 12" in page
    assert "2026-7" in page
    assert "add -o DIR" in metrosep("measure", "a.sdf", *stated)[2]
    (folder / "b.toml").write_text(
        'metrosep = 1\n[input]\nfiles = "*.sdf"\n[[step]]\nop = "parameters"\nnames = ["Sq"]\n'
        '[report]\nnumber = "1"\n[[output]]\nkind = "report"\nformats = ["html"]\n',
        "utf-8",
    )
    code, _, err = metrosep("batch", "b.toml", ".", "-o", "qa", "--scheduler", "serial", *stated)
    assert code == 0, err
    pages = [p.read_text("utf-8") for p in (folder / "qa").rglob("report.html")]
    assert pages
    assert all("2026-7" in p for p in pages)


LIST = ("l.csv", "--target", "target_mm", "--direction", "dir", "--readings", "d1_um,d2_um")


@pytest.mark.parametrize(
    ("words", "lacks"),
    [
        (LIST[:3], ["direction", "readings", "axis"]),
        (LIST, ["deviation", "axis"]),
        ((*LIST, "--format", "pmac"), ["deviation", "machine count=...", "axis"]),
        ((RUNS, *COLUMNS[:2], "--format", "pmac"), ["z", "machine count=..."]),
        ((RUNS, *COLUMNS, "--format", "pmac"), ["machine count=...", "compensates"]),
    ],
)
def test_a_table_lists_all_that_its_call_lacks(metrosep, folder, words, lacks):
    rows = [f"{x},{way},{x / 100},{x / 90}" for way in ("fwd", "rev") for x in range(0, 101, 20)]
    (folder / "l.csv").write_text("target_mm,dir,d1_um,d2_um\n" + "\n".join(rows), "utf-8")
    code, _, err = metrosep("table", *words, "-o", "x.tab")
    assert code == 2
    s = "s" if len(lacks) > 1 else ""
    assert f"Missing option{s} " + " and ".join(f"'--{name}'" for name in lacks) in err
    assert "separating" not in err


def test_places_of_axes_and_facts_are_asked_for_together(metrosep, folder):
    (folder / "e.csv").write_text("x_mm,EXX_um\n0,0\n10,1\n", "utf-8")
    machine = ("five_axis", "e.csv", "--pivot-height", "80 mm", "--at", "Z=0 mm")
    for words, lacks in (
        (
            ("machine-tables", "--over", "X", "--spacing", "1 mm", "-o", "t", "--format", "pmac"),
            ("machine count=...", 'at "Y=0 mm"', 'at "A=0 deg"', 'at "C=0 deg"'),
        ),
        (
            ("volume", "--tolerance", "1 um"),
            ('span "Y=0 mm..400 mm"', 'span "Z=0 mm..400 mm"', 'at "A=0 deg"', 'at "C=0 deg"'),
        ),
    ):
        code, _, err = metrosep(words[0], *machine, *words[1:])
        assert code == 2
        assert "Missing options " + " and ".join(f"'--{name}'" for name in lacks) in err


def test_the_state_of_the_air_is_asked_for_at_once(metrosep):
    assert "temperature and pressure and humidity" in metrosep("air")[2]


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("table", "a", "--format", "csv", "--format=pmac", "-o", "b"), "--format"),
        (("separate", "a", "-o", "b", "--out", "c"), "--out"),
        (("measure", "a", "--params", "Sq", "--params", "Sz"), "--params"),
        (
            ("path", "a.nc", "--error", "b", "-o", "c", "--machine", "d", "--machine", "d"),
            "--machine",
        ),
    ],
)
def test_an_option_of_one_value_is_not_taken_twice(metrosep, words, option):
    code, _, err = metrosep(*words)
    assert code == 2
    assert f"{option} is given twice and takes one value" in err


def test_options_of_many_values_and_flags_repeat(metrosep, folder):
    again = (
        "--sign-confirmed",
        "--sign-confirmed",
        "--machine",
        "stroke=5 um",
        "--machine",
        "x=1 um",
    )
    err = metrosep("table", RUNS, *COLUMNS, *again, "-o", "x.tab")[2]
    assert "Missing option '--compensates'" in err


@pytest.mark.parametrize(("name", "near"), [("sq", "did you mean Sq?"), ("Sx", "nearest: ")])
def test_a_parameter_of_another_spelling_has_a_near_one(metrosep, folder, name, near):
    import numpy as np

    import metrosep as ms

    ms.write(ms.Surface(1e-9 * np.arange(400.0).reshape(20, 20) % 7, 1e-6, 1e-6), "a.sdf")
    code, _, err = metrosep("measure", "a.sdf", "--params", name)
    assert code == 2
    assert near in err


def test_columns_of_a_recording_are_named_where_they_are_asked_for(metrosep, folder):
    (folder / "a.csv").write_text("t_s,x_mm,z_nm\n0,0,1\n0.1,1,2\n0.2,2,3\n0.3,3,4\n", "utf-8")

    code, _, err = metrosep("separate", "a.csv", "-o", "out")

    assert code == 2
    assert "Missing options '--x' and '--z'; a.csv has t_s, x_mm, z_nm." in err

"""Tables in containers, at every door of the command line: what a stranger's workbook, database or array says.

Workbooks are written by openpyxl, databases by SQLite, tables by pyarrow, archives by NumPy: none of
it by metrosep. Truth is what the same rows give as CSV, or the row and cell that was damaged.
"""

import datetime as dt
import gzip
import io
import json
import math
import sqlite3
import time
import tracemalloc
import zipfile

import numpy as np
import openpyxl
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.io.stream import open_stream

pytestmark = pytest.mark.usefixtures("without_figures")

X = [0.5 * k for k in range(24)]
Z = [round(math.sin(0.7 * k) + 0.03 * k, 6) for k in range(24)]
NAMES = ("run", "x_mm", "z_um", "feed_mm_min")
RUNS = [
    (k + 1, x, round(z + 0.01 * k, 6), 3000.0 + 1000.0 * (k % 2))
    for k in range(4)
    for x, z in zip(X, Z, strict=True)
]
QUICK = 2.0  # seconds; what a hostile file may take at most
SMALL = 200e6  # bytes; what a hostile file may take at most


@pytest.fixture
def metrosep(capsys):
    """Run a command line in this process: (code, stdout, stderr)."""

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        return stop.value.code, out.out, out.err

    return call


@pytest.fixture
def book(tmp_path):
    """Write a workbook with openpyxl: sheets by name, each a list of rows."""

    def write(name="book.xlsx", change=None, **sheets):
        made = openpyxl.Workbook()
        made.remove(made.active)
        for title, rows in sheets.items():
            sheet = made.create_sheet(title)
            for row in rows:
                sheet.append(row)
        if change is not None:
            change(made)
        path = tmp_path / name
        made.save(path)
        return path

    return write


def profile(*above, rows=None):
    return [*above, ["x [mm]", "z [um]"], *(rows or zip(X, Z, strict=True))]


def container(kind, folder, names=NAMES, rows=RUNS):
    """Write rows of numbers in a container, by the program that owns it."""
    path = folder / f"runs.{kind}"
    columns = dict(zip(names, (list(c) for c in zip(*rows, strict=True)), strict=True))
    text = "\n".join([",".join(names), *(",".join(map(repr, r)) for r in rows)]) + "\n"
    if kind == "csv":
        path.write_text(text)
    elif kind == "csv.gz":
        path.write_bytes(gzip.compress(text.encode()))
    elif kind == "xlsx":
        made = openpyxl.Workbook()
        for row in (names, *rows):
            made.active.append(row)
        made.save(path)
    elif kind == "db":
        base = sqlite3.connect(path)
        base.execute(f"CREATE TABLE data ({', '.join(f'{n} REAL' for n in names)})")
        places = ", ".join("?" * len(names))
        base.executemany(f"INSERT INTO data VALUES ({places})", rows)  # noqa: S608
        base.commit()
        base.close()
    elif kind == "npz":
        np.savez(path, **{n: np.array(v) for n, v in columns.items()})
    else:
        pa = pytest.importorskip("pyarrow")
        from pyarrow import feather, parquet

        table = pa.table(columns)
        parquet.write_table(table, path) if kind == "parquet" else feather.write_feather(
            table, path
        )
    return path


CONTAINERS = ["csv.gz", "xlsx", "db", "parquet", "feather", "npz"]


@pytest.mark.parametrize("kind", CONTAINERS)
def test_a_profile_is_the_same_in_every_container(tmp_path, kind):
    rows = list(zip(X, Z, strict=True))
    plain = ms.read(container("csv", tmp_path, ("x_mm", "z_um"), rows))

    packed = ms.read(container(kind, tmp_path, ("x_mm", "z_um"), rows))

    assert packed.x.tolist() == plain.x.tolist()
    assert packed.z.tolist() == plain.z.tolist()
    assert packed.metadata["warnings"] == ()


@pytest.mark.parametrize("kind", CONTAINERS)
def test_check_info_and_separate_see_the_runs_of_every_container(tmp_path, metrosep, kind):
    path = container(kind, tmp_path)

    code, _, err = metrosep("info", path)
    assert code == 0, err
    code, out, err = metrosep("check", path)
    assert code == 0, err
    assert "holds 4 runs, distinguished by column 'run'" in out
    result = tmp_path / "out"
    words = [
        "--x",
        "x_mm",
        "--z",
        "z_um",
        "--run",
        "run",
        "--feed",
        "feed_mm_min",
        "--method",
        "mean",
    ]
    code, _, err = metrosep("separate", path, *words, "-o", result)
    assert code == 0, err
    assert len(ms.read_runs(path, x="x_mm", z="z_um", run="run", feed="feed_mm_min")) == 4


@pytest.mark.parametrize("kind", CONTAINERS)
def test_a_container_is_streamed_in_chunks(tmp_path, kind):
    path = container(kind, tmp_path, ("t_s", "gap_um"), list(zip(X, Z, strict=True)))

    with open_stream(path) as stream:
        parts = [part["gap_um"] for part in stream.chunks(10)]

    assert [len(p) for p in parts] == [10, 10, 4]
    assert np.concatenate(parts).tolist() == (np.array(Z) * 1e-6).tolist()
    assert stream.time_step == pytest.approx(0.5, rel=0.0, abs=1e-12)  # digits of the file


@pytest.mark.parametrize("verb", ["info", "check", "measure"])
def test_of_two_worksheets_none_is_chosen_in_silence(book, metrosep, verb):
    path = book(Gauges=[["no", "size"], [1, 25.0]], Straightness=profile())

    code, out, err = metrosep(verb, path)

    assert code != 0
    said = out + err
    assert "'Gauges' (2 numbers), 'Straightness' (48 numbers)" in said
    assert '--set "sheet=' in said
    code, _, err = metrosep(verb, path, "--set", "sheet=Straightness")
    assert code == 0, err


def test_the_sheet_is_chosen_by_the_same_option_in_every_door(book, tmp_path, metrosep):
    path = book(Log=[["n", "v"], [1, 2]], Runs=[NAMES, *RUNS])
    columns = [
        "--x",
        "x_mm",
        "--z",
        "z_um",
        "--run",
        "run",
        "--feed",
        "feed_mm_min",
        "--method",
        "mean",
    ]

    code, _, err = metrosep("separate", path, *columns, "-o", tmp_path / "a")
    assert code == 4
    assert "--sheet Runs" in err
    code, _, err = metrosep("separate", path, *columns, "--sheet", "Runs", "-o", tmp_path / "b")
    assert code == 0, err
    assert len(ms.read_runs(path, x="x_mm", z="z_um", run="run", sheet="Runs")) == 4
    with open_stream(path, sheet="Runs") as stream:
        assert stream.channels == NAMES
    recipe = tmp_path / "runs.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["book.xlsx"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\nsheet = "Runs"\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\n'
    )
    code, _, err = metrosep("run", recipe, "-o", tmp_path / "c")
    assert code == 0, err


def test_a_worksheet_that_is_not_there_is_named_with_those_that_are(book):
    path = book(Data=profile(), Info=[["a"], [1]])

    with pytest.raises(
        ms.errors.ReadError, match=r"no worksheet 'DTA'.*did you mean sheet='Data'"
    ):
        ms.read(path, sheet="DTA")


def test_a_hidden_worksheet_with_numbers_is_named_too(book):
    def hide(made):
        made["Old"].sheet_state = "veryHidden"

    path = book(change=hide, Old=profile(), New=profile())

    with pytest.raises(ms.errors.ReadError, match=r"'Old' \(48 numbers, hidden\)"):
        ms.read(path)
    assert any("is hidden" in w for w in ms.read(path, sheet="Old").metadata["warnings"])


def test_a_text_takes_no_sheet(put):
    with pytest.raises(ms.errors.ReadError, match="is a text, which has no worksheets"):
        ms.read(put("x_mm,z_um\n0,1\n1,2\n"), sheet="Data")


def test_title_empty_rows_and_footer_are_accounted_for(book):
    rows = profile(
        ["Straightness of X"], [], ["Operator", "K. Ito"], rows=list(zip(X, Z, strict=True))
    )
    path = book(Data=[*rows, [], ["Mean", float(np.mean(Z))]])

    read = ms.read(path)

    assert len(read) == len(X)
    lines = read.metadata["lines"]
    assert lines["total"] == len(rows) + 2
    assert lines["listed"]["footer"]["numbers"] == str(len(rows) + 2)


@pytest.mark.parametrize(
    ("value", "match"),
    [
        ("broken", r"book\.xlsx, worksheet 'Data': .*, line 9.*'broken'"),
        (
            dt.datetime(2026, 5, 1),
            r"worksheet 'Data': .*line 9",
        ),  # 1.5 that became the first of May
        (-9999.0, r"worksheet 'Data': column 'z \[um\]' holds -9999 .*line 9"),
    ],
)
def test_an_odd_cell_is_refused_with_sheet_and_row(book, value, match):
    path = book(change=lambda made: made["Data"].__setitem__("B9", value), Data=profile())

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(path)


def test_a_named_row_is_left_out(book):
    path = book(change=lambda made: made["Data"].__setitem__("B9", "broken"), Data=profile())

    assert len(ms.read(path, skip_lines="9")) == len(X) - 1


@pytest.mark.parametrize("sign", ["#DIV/0!", "#N/A", "#NUM!"])
def test_an_error_of_a_formula_is_not_measured(book, sign):
    path = book(change=lambda made: made["Data"].__setitem__("B9", sign), Data=profile())

    assert np.flatnonzero(np.isnan(ms.read(path).z)).tolist() == [7]


def test_a_formula_without_its_result_is_refused_with_its_cell(book):
    path = book(change=lambda made: made["Data"].__setitem__("B9", "=B8+1"), Data=profile())

    with pytest.raises(ms.errors.ReadError, match="cell B9 holds a formula without its result"):
        ms.read(path)


def test_a_number_in_merged_cells_is_refused(book):
    path = book(change=lambda made: made["Data"].merge_cells("B9:B10"), Data=profile())

    with pytest.raises(ms.errors.ReadError, match="merged cells B9:B10"):
        ms.read(path)


def test_a_merged_title_is_a_title(book):
    path = book(
        change=lambda made: made["Data"].merge_cells("A1:B1"), Data=profile(["Straightness of X"])
    )

    assert len(ms.read(path)) == len(X)


def test_hidden_rows_are_read_with_a_warning(book):
    def hide(made):
        made["Data"].row_dimensions[5].hidden = True

    read = ms.read(book(change=hide, Data=profile()))

    assert len(read) == len(X)
    assert "1 row(s) are hidden" in read.metadata["warnings"][0]


def test_numbers_as_texts_with_a_decimal_comma(book):
    rows = [[x, f"{z:.4f}".replace(".", ",")] for x, z in zip(X, Z, strict=True)]

    read = ms.read(book(Data=profile(rows=rows)))

    assert read.z == pytest.approx(np.round(Z, 4) * 1e-6, rel=0.0, abs=1e-20)  # one rounding
    assert "24 number(s) are kept as texts (first: cell B2" in read.metadata["warnings"][0]


def test_numbers_as_texts_of_which_nothing_shows_the_mark_are_asked_for(book, metrosep):
    rows = [[x, f"{k + 1},{500 + k}"] for k, x in enumerate(X)]
    path = book(Data=profile(rows=rows))

    code, _, err = metrosep("measure", path)

    assert code == 4
    assert "cell B2 holds the number '1,500' as a text" in err
    assert ms.read(path, decimal=",").z[0] == pytest.approx(1.5e-6, rel=0.0, abs=1e-20)
    assert ms.read(path, thousands=",").z[0] == pytest.approx(1.5e-3, rel=0.0, abs=1e-17)


def test_cells_with_dates_become_seconds(book):
    start = dt.datetime(2026, 3, 5, 23, 59, 58)
    rows = [[start + dt.timedelta(milliseconds=500 * k), z] for k, z in enumerate(Z)]

    read = ms.read(book(Data=[["time", "gap_nm"], *rows]))

    assert read.t == pytest.approx(
        0.5 * np.arange(24), rel=0.0, abs=2e-6
    )  # a day of this century has steps of 0.6 us
    assert read["gap_nm"].tolist() == (np.array(Z) * 1e-9).tolist()


def test_days_since_1904(book):
    start = dt.datetime(2026, 3, 5, 12, 0, 0)

    def since_1904(made):
        made.epoch = openpyxl.utils.datetime.CALENDAR_MAC_1904
        for k, z in enumerate(Z):
            made["Data"].append([start + dt.timedelta(seconds=k), z])

    read = ms.read(book(change=since_1904, Data=[["time", "gap_nm"]]))

    assert read.metadata["header"]["clocks"]["time"].startswith("2026-03-05T12:00:00")


def test_shared_texts_formulas_with_results_and_japanese_names(tmp_path):
    """XlsxWriter keeps texts in one list, and the result of a formula beside it."""
    xlsxwriter = pytest.importorskip("xlsxwriter")
    made = xlsxwriter.Workbook(tmp_path / "plain.xlsx")
    sheet = made.add_worksheet("Data")
    sheet.write_row(0, 0, ["Weg", "z [um]"])
    for k, (x, z) in enumerate(zip(X, Z, strict=True), start=1):
        sheet.write_number(k, 0, x)
        sheet.write_formula(k, 1, f"=A{k}*2", value=z)
    made.close()
    with (
        zipfile.ZipFile(tmp_path / "plain.xlsx") as old,
        zipfile.ZipFile(tmp_path / "spoken.xlsx", "w") as new,
    ):
        for name in old.namelist():
            spoken = "<t>位置 [mm]</t><rPh sb='0' eb='2'><t>イチ</t></rPh>".encode()
            new.writestr(name, old.read(name).replace(b"<t>Weg</t>", spoken))

    read = ms.read(tmp_path / "spoken.xlsx")

    assert read.metadata["header"]["columns"] == ("位置 [mm]", "z [um]")
    assert read.z.tolist() == (np.array(Z) * 1e-6).tolist()


def test_a_map_of_heights_in_a_worksheet(book):
    heights = np.arange(20.0).reshape(4, 5)

    read = ms.read(book(Map=heights.tolist()), unit="nm", lateral_step="3 um")

    assert read.z.tolist() == (heights * 1e-9).tolist()


def test_a_table_that_begins_in_the_middle_of_a_worksheet(book):
    rows = [[None, None, *row] for row in profile()]

    assert ms.read(book(Data=[[], [], *rows])).z.tolist() == (np.array(Z) * 1e-6).tolist()


def test_one_row_of_numbers_is_one_point_as_in_a_csv(book):
    read = ms.read(book(Data=[["x [mm]", "z [um]"], [1.0, 2.0]]))

    assert (read.x.tolist(), read.z.tolist()) == ([1e-3], [2e-6])


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"<html><body><table><tr><td>1</td></tr></table></body></html>", "is a web page"),
        (b"\xef\xbb\xbf<!DOCTYPE html>\n<table><tr><td>1</td></tr></table>", "is a web page"),
    ],
)
def test_a_web_page_called_xlsx_is_named(put, data, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(data, "export.xlsx"))


def test_a_csv_called_xlsx_is_read(put):
    assert len(ms.read(put("x_mm,z_um\n0,1\n1,2\n2,4\n", "export.xlsx"))) == 3


def sheet_of(path, body, folder, member="xl/worksheets/sheet1.xml"):
    """Replace the XML of a worksheet."""
    new = folder / "hostile.xlsx"
    with (
        zipfile.ZipFile(path) as old,
        zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED) as made,
    ):
        for name in old.namelist():
            made.writestr(name, body if name == member else old.read(name))
    return new


@pytest.mark.parametrize(
    "body",
    [
        "<worksheet><sheetData>" + "<row/>" * 400_000 + "</sheetData></worksheet>",
        '<worksheet><sheetData><row r="99999999"><c r="A99999999"><v>1</v></c></row></sheetData></worksheet>',
        '<worksheet><sheetData><row r="1"><c r="ZZZ1"><v>1</v></c></row></sheetData></worksheet>',
        '<worksheet><sheetData><row r="2"><c r="A2"><v>1</v></c></row><row r="1"/></sheetData></worksheet>',
        '<worksheet><sheetData><row r="1"><c r="A7"><v>1</v></c></row></sheetData></worksheet>',
        '<!DOCTYPE a [<!ENTITY b "1">]><worksheet><sheetData><row><c><v>&b;</v></c></row></sheetData></worksheet>',
        '<worksheet><sheetData><row r="1"><c r="A1"><v>nan</v></c></row></sheetData></worksheet>',
        " " * 2**24,
        '<worksheet><sheetData><row r="-1"/></sheetData></worksheet>',
    ],
)
def test_a_hostile_worksheet_is_refused_soon(book, tmp_path, body):
    path = sheet_of(book(Data=profile()), body, tmp_path)
    start = time.process_time()
    tracemalloc.start()

    with pytest.raises((ms.errors.ReadError, ms.errors.UnitError)):
        ms.read(path)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < SMALL
    assert time.process_time() - start < QUICK


# ---- SQLite ------------------------------------------------------------------------------------


@pytest.fixture
def base(tmp_path):
    """Write a database of statements."""

    def write(*statements, rows=()):
        path = tmp_path / "base.db"
        held = sqlite3.connect(path)
        for statement in statements:
            held.execute(statement)
        held.executemany("INSERT INTO data VALUES (?, ?)", rows)
        held.commit()
        held.close()
        return path

    return write


PLAIN = "CREATE TABLE data (x_mm, z_um)"
PROFILE = list(zip(X, Z, strict=True))


def test_nothing_is_written_beside_a_database(base):
    path = base(PLAIN, rows=PROFILE)
    before = path.read_bytes()

    ms.read(path)

    assert [p.name for p in path.parent.iterdir()] == ["base.db"]
    assert path.read_bytes() == before


def test_rows_that_still_lie_in_the_journal_are_not_lost_in_silence(tmp_path):
    path = tmp_path / "live.db"
    writer = sqlite3.connect(path)
    writer.execute("PRAGMA journal_mode = WAL")
    writer.execute(PLAIN)
    writer.executemany("INSERT INTO data VALUES (?, ?)", PROFILE)
    writer.commit()

    with pytest.raises(ms.errors.ReadError, match=r"live\.db-wal; close the program"):
        ms.read(path)
    writer.close()
    assert len(ms.read(path)) == len(X)


def test_views_and_triggers_do_not_run(base):
    endless = (
        "CREATE VIEW forever AS WITH RECURSIVE n(x_mm, z_um) AS "
        "(SELECT 1, 2 UNION ALL SELECT x_mm + 1, 2 FROM n) SELECT * FROM n"
    )
    trigger = "CREATE TRIGGER t AFTER INSERT ON data BEGIN DELETE FROM data WHERE x_mm = 0; END"
    path = base(PLAIN, endless, rows=PROFILE)
    held = sqlite3.connect(path)
    held.execute(trigger)
    held.commit()
    held.close()
    start = time.process_time()

    assert len(ms.read(path)) == len(X)
    assert time.process_time() - start < QUICK


def test_a_computed_column_makes_no_endless_text(base):
    path = base(PLAIN, rows=PROFILE)
    held = sqlite3.connect(path)
    held.execute("ALTER TABLE data ADD COLUMN c AS (hex(zeroblob(100000000)))")
    held.commit()
    held.close()

    with pytest.raises(ms.errors.ReadError, match="too big"):
        ms.read(path)


def test_null_is_not_measured_and_rows_keep_their_order(base):
    rows = [(x, None if k == 5 else z) for k, (x, z) in enumerate(PROFILE)]
    path = base(PLAIN, "CREATE INDEX i ON data (z_um, x_mm)", rows=rows[::-1])

    read = ms.read(path)

    assert np.flatnonzero(np.isnan(read.z)).tolist() == [5]
    assert read.z[0] == pytest.approx(Z[0] * 1e-6, rel=0.0, abs=1e-20)


def test_a_text_among_numbers_of_a_database_is_refused_with_its_line(base):
    rows = [(x, "broken" if k == 5 else z) for k, (x, z) in enumerate(PROFILE)]

    with pytest.raises(
        ms.errors.ReadError, match=r"table 'data' \(line 1 holds the names\).*line 7"
    ):
        ms.read(base(PLAIN, rows=rows))


def test_several_tables_are_asked_for(base, metrosep):
    path = base(PLAIN, "CREATE TABLE other (a)", "INSERT INTO other VALUES (1)", rows=PROFILE)

    code, _, err = metrosep("measure", path)

    assert code == 4
    assert "holds 2 tables with numbers: 'data' (2 columns), 'other' (1 columns)" in err
    code, _, err = metrosep("measure", path, "--set", "sheet=data")
    assert code == 0, err


# ---- Parquet, Feather and .npz ----------------------------------------------------------------


def test_columns_of_every_type_of_a_parquet_file(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    start = dt.datetime(2026, 3, 5, 14, 7, 9)
    stamps = [start + dt.timedelta(milliseconds=250 * k) for k in range(24)]
    table = pa.table(
        {
            "time": pa.array(stamps, pa.timestamp("us", tz="UTC")),
            "gap_nm": pa.array([None if k == 3 else z for k, z in enumerate(Z)], pa.float32()),
            "state": pa.array(["ok", "bad one"] * 12).dictionary_encode(),
            "n": pa.array(range(24), pa.int16()),
        }
    )
    parquet.write_table(table, tmp_path / "a.parquet")

    read = ms.read(tmp_path / "a.parquet")

    assert read.t == pytest.approx(0.25 * np.arange(24), rel=0.0, abs=1e-14)  # ns times 1e-9
    assert np.flatnonzero(np.isnan(read["gap_nm"])).tolist() == [3]
    assert read["gap_nm"][1] == np.float64(np.float32(Z[1])) * 1e-9


def test_columns_named_by_numbers_are_no_row(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pa.table({"0": X, "1": Z}), tmp_path / "a.parquet")

    read = ms.read(tmp_path / "a.parquet", x="column0:mm", z="column1:um")

    assert len(read) == len(X)


def test_lists_in_a_parquet_file_are_refused_by_name(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pa.table({"wave": [[1.0, 2.0], [3.0]]}), tmp_path / "a.parquet")

    with pytest.raises(ms.errors.ReadError, match="column 'wave' holds list"):
        ms.read(tmp_path / "a.parquet")


def test_without_pyarrow_the_extra_is_named(tmp_path, monkeypatch):
    path = container("parquet", tmp_path)

    def refuse(name):
        raise ImportError(name)

    monkeypatch.setattr("metrosep.io.containers.sheets.import_module", refuse)

    with pytest.raises(ms.errors.ReadError, match=r"metrosep\[parquet\]"):
        ms.read(path)


def test_objects_of_an_npz_are_never_unpickled(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "trap"), "w"))

    np.savez(tmp_path / "a.npz", x_mm=X, z_um=Z, notes=np.array([Trap()], dtype=object))

    read = ms.read(tmp_path / "a.npz")

    assert len(read) == len(X)
    assert not (tmp_path / "trap").exists()
    assert "array 'notes' was omitted" in read.metadata["warnings"][0]


def test_a_swollen_npz_is_refused_soon(tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.zeros(2**25))
    with zipfile.ZipFile(
        tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1
    ) as made:
        made.writestr("a.npy", stream.getvalue())
    start = time.process_time()

    with pytest.raises(ms.errors.ReadError, match="zip bomb"):
        ms.read(tmp_path / "bomb.npz")

    assert time.process_time() - start < QUICK


def test_json_of_info_names_the_sheet(book, metrosep):
    code, out, err = metrosep("info", book(Data=profile()), "--json")

    assert code == 0, err
    assert json.loads(out)["format"] == "worksheet"


def test_a_row_that_begins_like_a_comment_is_not_lost(base, book):
    rows = [[f"#{k}" if k % 7 == 3 else "ok", x, z] for k, (x, z) in enumerate(PROFILE)]
    path = base(
        "CREATE TABLE data (x_mm, z_um)", "CREATE TABLE marked (note, x_mm, z_um)", rows=[]
    )
    held = sqlite3.connect(path)
    held.executemany("INSERT INTO marked VALUES (?, ?, ?)", rows)
    held.commit()
    held.close()

    assert len(ms.read(path, x="x_mm", z="z_um")) == len(X)
    sheet = book(Data=[["note", "x_mm", "z_um"], *rows])
    assert len(ms.read(sheet, x="x_mm", z="z_um")) == len(X)


def test_a_remark_alone_in_its_row_is_a_comment(book):
    read = ms.read(book(Data=[["# by hand"], *profile()]))

    assert read.metadata["lines"]["listed"]["comment"]["texts"] == ("# by hand",)
    assert len(read) == len(X)


def test_columns_named_like_units_are_no_row_of_units(tmp_path):
    """A column s of a database may be a path; it was taken for seconds."""
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pa.table({"s": X, "V": Z}), tmp_path / "a.parquet")

    with pytest.raises(ms.errors.UnitError):
        ms.read(tmp_path / "a.parquet")
    assert len(ms.read(tmp_path / "a.parquet", x="columns:mm", z="columnV:um")) == len(X)


@pytest.mark.parametrize(
    ("texts", "z_nm"),
    [("1.100,5 1.200,5 1.300,5", 1100.5), ("1,100.5 1,200.5 1,300.5", 1100.5)],
)
def test_texts_with_both_marks_show_which_is_the_decimal_one(book, texts, z_nm):
    rows = [[x, t] for x, t in zip(X, texts.split(), strict=False)]

    read = ms.read(book(Data=[["x_mm", "z_nm"], *rows]))

    assert read.z[0] == pytest.approx(z_nm * 1e-9, rel=1e-15, abs=0.0)  # one rounding


def test_a_merged_label_is_one_label(book):
    rows = [[x, z, "A" if k == 0 else None] for k, (x, z) in enumerate(PROFILE)]
    path = book(
        change=lambda made: made["Data"].merge_cells("C2:C25"),
        Data=[["x_mm", "z_um", "part"], *rows],
    )

    assert len(ms.read(path, x="x_mm", z="z_um")) == len(X)


@pytest.mark.parametrize(
    ("arrays", "match"),
    [
        ({"d": np.zeros(3, dtype=[("x", "f8"), ("z", "f8")])}, "holds records"),
        ({"d": np.array([1j, 2j])}, "only real numbers"),
        ({"d": np.zeros((2, 2, 2))}, "one or two dimensions"),
        ({"d": np.array([])}, "holds no values"),
    ],
)
def test_arrays_that_are_not_read_are_named(tmp_path, arrays, match):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ms.errors.ReadError, match=f"no array in it holds numbers .*{match}"):
        ms.read(tmp_path / "a.npz")

    np.savez(tmp_path / "b.npz", x_mm=X, z_um=Z, **arrays)
    assert any(match in w for w in ms.read(tmp_path / "b.npz").metadata["warnings"])


@pytest.mark.parametrize("unit", ["Mm", "s", "kg"])
def test_a_wrong_unit_is_refused_with_the_sheet(book, unit):
    path = book(Data=[[f"x [{unit}]", "z [um]"], *PROFILE])

    with pytest.raises(ms.errors.MetrosepError, match="Data"):
        ms.read(path, x=f"x [{unit}]", z="z [um]")


def with_formula(path, cell, element):
    """Give a cell of a workbook another element, as its XML has it."""
    kept = path.with_name("other.xlsx")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(kept, "w") as new:
        for member in old.namelist():
            data = old.read(member)
            if member == "xl/worksheets/sheet1.xml":
                start = data.index(f'<c r="{cell}"'.encode())
                end = data.index(b"</c>", start) + 4
                data = data[:start] + element.encode() + data[end:]
            new.writestr(member, data)
    return kept


@pytest.mark.parametrize(
    "element",
    [
        '<c r="B5"><f>A5*2</f></c>',
        '<c r="B5"><f>A5*2</f><v></v></c>',
        '<c r="B5" t="str"><f>A5</f></c>',
    ],
)
def test_a_formula_without_its_result_is_refused_whatever_its_type(book, element):
    path = with_formula(book(a=profile()), "B5", element)

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="cell B5 holds a formula"):
        ms.read(path)


def test_a_formula_with_the_empty_text_as_its_result_is_an_empty_cell(book):
    path = with_formula(book(a=profile()), "B5", '<c r="B5" t="str"><f>""</f><v></v></c>')

    z = ms.read(path).z

    assert np.flatnonzero(np.isnan(z)).tolist() == [3]


def beside(cells):
    """Write cells beside the table of a workbook."""

    def change(made):
        for place, value in cells.items():
            made.active[place] = value

    return change


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ({"C5": "checked"}, "line 5: 'checked'"),
        ({"H5": "Operator: M. Smith"}, "line 5: 'Operator: M. Smith'"),
        ({"D2": "Mean", "E2": 0.5, "D3": "SD", "E3": 1.36}, "line 2: 'Mean 0.5'"),
        ({"D1": "Diagram of z"}, "column 'Diagram of z' holds no number"),
    ],
)
def test_what_stands_beside_the_table_of_a_worksheet_costs_no_row(book, cells, said):
    path = book(change=beside(cells), a=profile())

    found = ms.read(path)

    assert found.z.tolist() == (np.array(Z) * 1e-6).tolist()
    assert any(said in w for w in found.metadata["warnings"])


@pytest.mark.parametrize("cell", ["x1000", "in nm", "NG", "outlier", "E-3"])
def test_a_cell_beside_a_row_that_may_change_it_is_refused(book, cell):
    path = book(change=beside({"C5": cell}), a=profile())

    with pytest.raises(ms.errors.ReadError, match=r"line 5\b.*skip_lines='5'"):
        ms.read(path)


def test_numbers_beside_the_table_without_a_word_are_refused(book):
    path = book(change=beside({"D4": 0.5}), a=profile())

    with pytest.raises(ms.errors.ReadError, match="line 4"):
        ms.read(path)


def test_long_doubles_of_an_archive_are_numbers(tmp_path):
    path = tmp_path / "long.npz"
    np.savez(path, x_mm=np.array(X), z_um=np.array(Z, dtype=np.longdouble))

    assert ms.read(path).z.tolist() == (np.array(Z) * 1e-6).tolist()


def test_a_million_empty_rows_take_a_moment(book):
    path = book(change=beside({"A1048576": "end"}), a=profile())
    begun = time.process_time()

    found = ms.read(path)

    assert len(found) == len(Z)
    assert time.process_time() - begun < QUICK


def open_document(folder, rows):
    """Write an .ods sheet by hand: cells as (type, value, what is shown)."""
    spaces = " ".join(
        f'xmlns:{short}="urn:oasis:names:tc:opendocument:xmlns:{name}:1.0"'
        for short, name in (("office", "office"), ("table", "table"), ("text", "text"))
    )
    cells = "".join(
        "<table:table-row>"
        + "".join(
            f'<table:table-cell office:value-type="{kind}"'
            + (f' office:value="{value}"' if kind == "float" else "")
            + f"><text:p>{shown}</text:p></table:table-cell>"
            for kind, value, shown in row
        )
        + "</table:table-row>"
        for row in rows
    )
    path = folder / "book.ods"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        made.writestr(
            "content.xml",
            f"<office:document-content {spaces}><office:body><office:spreadsheet>"
            f'<table:table table:name="A">{cells}</table:table>'
            "</office:spreadsheet></office:body></office:document-content>",
        )
    return path


def test_a_number_that_is_shown_with_a_hash_is_a_number_and_an_error_is_none(tmp_path):
    rows = [[("string", "", n) for n in ("x_mm", "z_um")]]
    rows += [[("float", i, f"#{i}"), ("float", 0.1 * i, f"{0.1 * i:.1f}")] for i in range(8)]
    rows[4][1] = ("string", "", "#DIV/0!")
    rows[6][1] = ("float", 0, "#VALUE!")

    profile = ms.read(open_document(tmp_path, rows))

    assert profile.x.tolist() == pytest.approx([1e-3 * i for i in range(8)], rel=0.0, abs=1e-15)
    assert np.flatnonzero(np.isnan(profile.z)).tolist() == [3, 5]


def test_runs_that_are_named_with_a_hash_stay_apart_in_a_worksheet(tmp_path):
    rows = [[("string", "", n) for n in ("run", "x_mm", "z_um")]]
    rows += [
        [("string", "", run), ("float", i, i), ("float", 0.1 * i + k, 0.1 * i + k)]
        for k, run in enumerate(("#1", "#2", "B"))
        for i in range(5)
    ]

    runs = ms.read_runs(open_document(tmp_path, rows), x="x_mm", z="z_um", run="run")

    assert [r.run_id for r in runs] == ["#1", "#2", "B"]
    assert [len(r) for r in runs] == [5, 5, 5]
    assert runs[1].z[0] == pytest.approx(1e-6, rel=0.0, abs=1e-15)

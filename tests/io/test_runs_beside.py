"""Runs as columns beside each other, the sheet that most people keep: one column of places, one for each run."""

import json
import math

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.io.check import check_file

pytestmark = pytest.mark.usefixtures("without_figures")

N, RUNS = 81, 4
PLACES = [0.5 * k for k in range(N)]  # mm
TIGHT = 1e-15
"""Metres: far below a digit that the files hold."""


def reading(run, k):
    """Micrometres; each run has a level and a phase of its own, so none passes for another."""
    return round(1.3 * math.sin(0.11 * k) + 0.05 * math.sin(1.7 * k + run) + 0.01 * run, 4)


SHEETS = {  # names of the places and the runs, separator, decimal mark, encoding
    "English": ("Position [mm]", "Run {} [µm]", ",", ".", "utf-8"),
    "German": ("Weg [mm]", "Lauf {} [µm]", ";", ",", "cp1252"),
    "French": ("Déplacement (mm)", "Passe {} (µm)", ";", ",", "cp1252"),
    "Italian": ("Corsa (mm)", "{}. Ciclo (µm)", ";", ",", "latin-1"),
    "Spanish": ("Posición (mm)", "Ensayo_{}_um", "\t", ",", "utf-8-sig"),
    "Chinese": ("位置(mm)", "次数{}(μm)", ",", ".", "gb18030"),
    "Japanese": ("位置[mm]", "{}回[μm]", "\t", ".", "cp932"),
}


def sheet(language="German"):
    place, run, mark, decimal, encoding = SHEETS[language]
    top = [place, *(run.format(r + 1) for r in range(RUNS))]
    numbers = ([PLACES[k], *(reading(r, k) for r in range(RUNS))] for k in range(N))
    lines = [mark.join(str(v).replace(".", decimal) for v in row) for row in numbers]
    return "\n".join([mark.join(top), *lines, ""]).encode(encoding)


def is_as_written(runs):
    assert len(runs) == RUNS
    for r, run in enumerate(runs):
        np.testing.assert_allclose(run.x, [1e-3 * p for p in PLACES], rtol=0.0, atol=TIGHT)
        z = [1e-6 * reading(r, k) for k in range(N)]
        np.testing.assert_allclose(run.z, z, rtol=0.0, atol=TIGHT)


@pytest.mark.parametrize("language", SHEETS)
def test_each_column_called_after_a_run_is_a_run(put, language):
    is_as_written(ms.read(put(sheet(language))))


def test_the_order_that_check_prints_separates_them(put, tmp_path, capsys):
    path = put(sheet())
    (finding,) = check_file(path)
    assert finding.level == "note"
    assert "--x 'Weg [mm]' --z 'Lauf 1 [µm]' --run columns" in finding.fix

    words = ["--x", "Weg [mm]", "--z", "Lauf 1 [µm]", "--run", "columns", "--method", "mean"]
    with pytest.raises(SystemExit) as ended:
        main(["separate", str(path), *words, "-o", str(tmp_path / "out")])

    assert ended.value.code == 0, capsys.readouterr().err
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    found = {c["symbol"]: c["value"] for c in result["characteristics"]}
    mean = np.array([[reading(r, k) for k in range(N)] for r in range(RUNS)]).mean(axis=0) * 1e-6
    line = np.polynomial.Polynomial.fit(PLACES, mean, 1)(np.array(PLACES))
    spread = float(np.ptp(mean - line))
    assert found["PV"] == pytest.approx(spread, rel=0.05, abs=0.0)  # the ends may be left out


def test_a_run_in_another_unit_is_one_of_them(put):
    text = sheet().decode("cp1252").split("\n")
    rows = [row.split(";") for row in text[1:-1]]
    for row in rows:
        row[2] = str(round(1000 * float(row[2].replace(",", "."))))
    names = text[0].replace("Lauf 2 [µm]", "Lauf 2 [nm]")
    runs = ms.read(put("\n".join([names, *map(";".join, rows), ""])))

    assert len(runs) == RUNS
    assert runs[1].z[5] == pytest.approx(1e-9 * round(1000 * reading(1, 5)), rel=0.0, abs=TIGHT)


def test_names_without_a_unit_ask_for_one_that_holds_for_all(put):
    path = put(sheet().replace(b" [\xb5m]", b"").replace(b" [mm]", b""))
    (finding,) = check_file(path)
    assert "--x Weg:UNIT --z 'Lauf 1:UNIT' --run columns" in finding.fix

    is_as_written(ms.read_runs(path, x="Weg:mm", z="Lauf 1:um", run="columns"))


def test_runs_of_several_files_keep_their_names_apart(put):
    paths = [put(sheet(), f"{day}.csv") for day in ("mon", "tue")]
    runs = ms.read_runs(paths, x="Weg [mm]", z="Lauf 1 [µm]", run="columns")

    assert [r.run_id for r in runs][RUNS - 1 : RUNS + 1] == ["mon:Lauf 4", "tue:Lauf 1"]


def test_a_column_that_is_called_like_the_runs_is_never_left_out_in_silence(put):
    text = sheet().decode("cp1252")
    warm = text.replace("Lauf 3 [µm]", "Lauf 3 [°C]")
    rows = [row.split(";") for row in text.split("\n")[:-1]]
    empty = [row if k == 0 else [*row[:2], "", *row[3:]] for k, row in enumerate(rows)]
    for content, match in (
        (warm, "Lauf 3"),
        ("\n".join(map(";".join, empty)) + "\n", "Lauf 2.*remove that column"),
    ):
        with pytest.raises(ms.errors.MetrosepError, match=match):
            ms.read_runs(put(content), x="Weg [mm]", z="Lauf 1 [µm]", run="columns")


def test_two_probes_are_no_runs(put):
    """Numbers behind the name of a sensor tell sensors apart, not repeats."""
    text = sheet().decode("cp1252").replace("Lauf ", "Taster ")

    with pytest.raises(ms.errors.ReadError, match="name two with x= and z="):
        ms.read(put(text))
    with pytest.raises(ms.errors.ReadError, match="no column is called like"):
        ms.read_runs(
            put(
                text.replace("Taster 2", "Temp").replace("Taster 3", "a").replace("Taster 4", "b")
            ),
            x="Weg [mm]",
            z="Taster 1 [µm]",
            run="columns",
        )


@pytest.mark.parametrize("top", ["Taster 1 [mm];Taster 2 [um];Taster 3 [um]", ""])
def test_the_column_of_the_places_is_none_of_the_runs(put, top):
    """Columns without names are called column1 to column3: the first one holds the places, no error of 9 mm."""
    rows = [f"{k / 2};{k % 3 / 8};{k % 5 / 8}" for k in range(20)]
    x, z = ("Taster 1 [mm]", "Taster 2 [um]") if top else ("column1:mm", "column2:um")
    runs = ms.read_runs(put("\n".join([*filter(None, [top]), *rows, ""])), x=x, z=z, run="columns")

    assert [round(1e6 * float(r.z.max()), 6) for r in runs] == [0.25, 0.5]

"""Files of identified terms: what stands in them is read by plain splitting."""

import tomllib

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import DataError, InvalidSamplesError, MetrosepError
from metrosep.io.term_files import read_term_table, term_texts
from metrosep.machine.terms import ConstantTerm, TableTerm

pytestmark = pytest.mark.usefixtures("without_figures")

UM, URAD = 1e-6, 1e-6
KINDS = {"X": "length", "C": "angle"}


def test_uncertainties_are_written_beside_their_terms_and_come_back(tmp_path):
    place = [0.0, 0.1, 0.3]
    terms = {
        "EYX": TableTerm(place, [0.0, 2 * UM, -1 * UM], [0.1 * UM, 0.2 * UM, 0.4 * UM]),
        "EBX": TableTerm(place, [0.0, 3 * URAD, 5 * URAD]),  # nobody stated its u
        "EAX": TableTerm(place, [0.0, 1 * URAD, 1 * URAD], 0.5 * URAD),
    }
    (text,) = term_texts(terms, dict.fromkeys(terms, (0.0, 0.3)), set()).values()

    head, *rows = text.splitlines()
    table = dict(
        zip(head.split(","), np.array([r.split(",") for r in rows], float).T, strict=True)
    )
    x = table.pop("x_mm")
    assert set(table) == {"EYX_um", "EBX_urad", "EAX_urad", "u_EYX_um", "u_EAX_urad"}
    assert np.abs(table["u_EYX_um"] - np.interp(x, [0, 100, 300], [0.1, 0.2, 0.4])).max() < 1e-8
    assert np.abs(table["u_EAX_urad"] - 0.5).max() < 1e-8

    (tmp_path / "X.csv").write_text(text)
    back = read_term_table(tmp_path / "X.csv", KINDS)
    assert set(back) == set(terms)
    for name, (term, span) in back.items():
        assert span == pytest.approx((0.0, 0.3), abs=1e-12)
        for at in (0.0, 0.05, 0.2, 0.3):
            assert term.evaluate(at) == pytest.approx(terms[name].evaluate(at), abs=1e-14)
            assert term.sd(at) == pytest.approx(terms[name].sd(at), abs=1e-14)


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("x_mm,EXX_um,u_EYX_um\n0,1,1\n1,1,1\n", DataError, "uncertainty of a term that is not there"),
        ("x_mm,EXX_um,u_EXX_um,u_EXX_um\n0,1,1,1\n1,1,1,1\n", DataError, "there twice"),
        ("x_mm,EXX_um,u_EXX_um\n0,1,-1\n1,1,1\n", InvalidSamplesError, "u must be"),
        ("x_mm,EXX_um,u_EXC_urad\n0,1,1\n1,1,1\n", DataError, "is not an error of X"),
    ],
)  # fmt: skip
def test_uncertainties_that_belong_to_nothing_are_refused(tmp_path, text, error, said):
    (tmp_path / "X.csv").write_text(text)
    with pytest.raises(error, match=said):
        read_term_table(tmp_path / "X.csv", KINDS)


class Wave:
    def evaluate(self, x):
        return 5 * UM * np.sin(3 * np.asarray(x))

    def sd(self, x):
        return np.full(np.shape(x), 0.2 * UM)


def test_straight_lines_between_the_rows_follow_a_curve_and_its_corners():
    """What reads the file joins its rows by straight lines: they may miss the term by 0.1 nm."""
    corner = TableTerm([0.0, 0.1234567, 2.0], [0.0, 7 * UM, -3 * UM])
    terms = {"EZC": Wave(), "EXC": corner}
    (text,) = term_texts(terms, dict.fromkeys(terms, (0.0, 2.0)), {"C"}).values()

    head, *rows = text.splitlines()
    table = np.array([r.split(",") for r in rows], float).T
    at = np.linspace(0.0, 2.0, 20011)
    for name, term in terms.items():
        read = np.interp(np.degrees(at), table[0], table[head.split(",").index(f"{name}_um")]) * UM
        assert np.abs(read - term.evaluate(at)).max() < 0.15e-9


def test_constants_have_their_uncertainty_beside_them():
    terms = {"C0Y": ConstantTerm(12 * URAD, 0.5 * URAD), "X0C": ConstantTerm(-3 * UM)}
    (text,) = term_texts(terms, {}, set()).values()
    assert tomllib.loads(text) == {
        "C0Y": "12.000000 urad", "u_C0Y": "0.500000 urad", "X0C": "-3.000000 um"
    }  # fmt: skip


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8-sig", "utf-16"])
def test_a_table_of_a_spreadsheet_in_any_order_is_read_as_the_plain_one(tmp_path, encoding):
    """Semicolons, decimal commas, a remark, rows from the far end, units in brackets."""
    x = np.array([0.0, 2.5, 5.0, 10.0])
    e = np.array([0.25, -1.5, 0.75, 3.0])
    rows = [
        f"{a:.2f};{b:.3f};{abs(b) / 8:.4f}".replace(".", ",") for a, b in zip(x, e, strict=True)
    ]
    head = ["# Prüfling: Müller", "X [mm];EZX [µm];u_EZX [µm]"]
    rows = [r.replace("-", "−") if encoding == "utf-16" else r for r in reversed(rows)]
    (tmp_path / "down.csv").write_bytes("\r\n".join([*head, *rows, ""]).encode(encoding))
    term, span = read_term_table(tmp_path / "down.csv", KINDS)["EZX"]
    assert span == pytest.approx((0.0, 10e-3), abs=1e-15)
    asked = np.array([0.0, 1.25, 7.5, 10.0])
    assert term.evaluate(asked * 1e-3) == pytest.approx(UM * np.interp(asked, x, e), abs=1e-15)
    u = np.interp(asked, x, np.abs(e) / 8)
    assert term.sd(asked * 1e-3) == pytest.approx(UM * u, abs=1e-10)  # u is typed to 0.1 nm


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x_mm,EXX_um\n0,1\n1,NaN\n2,3\n", "line 3.*EXX_um.*not measured"),
        ("x_mm,EXX_um,EYX_um\n0,1,1\n1,2\n2,3,3\n3,4,4\n4,5,5\n", "line 3"),
        ("x_mm,EXX_um\n0,1\n2,2\n1,3\n", "line 4.*neither rise nor fall"),
        ("x_mm,EXX_um\n0,1\n2,2\n2,3\n", "line 4.*neither rise nor fall"),
        ("x_mm,EXX\n0,1\n2,2\n", "EXX.*no unit|unit.*EXX"),
        ("x_deg,EXX_um\n0,1\n2,2\n", "length"),
    ],
)
def test_a_table_that_is_not_one_is_refused_with_its_line(tmp_path, text, said):
    (tmp_path / "X.csv").write_text(text)
    with pytest.raises(MetrosepError, match=said):
        read_term_table(tmp_path / "X.csv", KINDS)


@pytest.mark.parametrize(
    "text",
    [
        "x_mm,EXX_um,EBX_urad\n0,0.25,-1.5\n10,-1.75,2\n",
        "x_mm;EXX_um;EBX_urad\n0,0;0,25;-1,5\n10,0;-1,75;2\n",
        "EXX_um\tEBX_urad\tx_mm\n0.25\t-1.5\t0\n-1.75\t2\t10\n",
        "EBX_urad;x_mm;EXX_um\n-1,5;0;0,25\n2;10;-1,75\n",
    ],
)
def test_marks_and_the_order_of_columns_do_not_matter(tmp_path, text):
    (tmp_path / "x.csv").write_text(text)
    found = read_term_table(tmp_path / "x.csv", KINDS)
    # a quarter of the way, by hand
    for name, value in (("EXX", -0.25e-6), ("EBX", -0.625e-6)):
        term, span = found[name]
        assert float(term.evaluate(2.5e-3)) == pytest.approx(value, abs=1e-15)
        assert span == pytest.approx((0.0, 0.01), abs=1e-15)


def test_a_place_that_was_not_measured_is_refused_by_its_line(tmp_path):
    (tmp_path / "x.csv").write_text("# of May\nx_mm,EXX_um\n0,0.25\n10,NaN\n20,1\n")
    with pytest.raises(DataError, match=r"x\.csv: line 4, EXX_um was not measured"):
        read_term_table(tmp_path / "x.csv", KINDS)


def test_what_the_reader_leaves_out_is_said_where_terms_are_used(tmp_path, monkeypatch, capsys):
    """A commented row and a mean below: the table is made of three rows, and command and step say so."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "X.csv").write_text("x_mm,EXX_um\n0,0\n#50,9\n100,1.5\n200,1.0\nMean,0.83\n")
    (tmp_path / "p.csv").write_text("X_mm,Y_mm,Z_mm\n100.0,5.0,0.0\n")
    words = ["path", "p.csv", "--machine", "mill_xyz", "--error", "X.csv", "-o", "q.csv"]
    with pytest.raises(SystemExit) as stop:
        main(words)
    told = capsys.readouterr().err
    assert stop.value.code == 0, told
    assert (tmp_path / "q.csv").read_text().splitlines()[-1].startswith("99.9985")
    assert "note: X.csv: 1 line(s) (first: line 3) begin with the mark of a comment" in told
    assert "note: X.csv: line 6 ('Mean,0.83')" in told

    text = """metrosep = 1
[[step]]
op = "rank"
form = "sphere: R=300 mm"
machine = "fts_lathe"
radius = "20 mm"
errors = { EXX = "table X.csv", EYX = "table X.csv" }
"""
    (tmp_path / "X.csv").write_text(
        "x_mm,EXX_um,EYX_um\n-50,0,0\n#50,9,9\n100,1.5,1\n200,1,0\nMean,0.8,0\n"
    )
    said = ms.Recipe.parse(text).run(None).document["messages"]
    marks = [m for m in said if "(first: line 3) begin with the mark of a comment" in m]
    assert len(marks) == 1, "one file of two terms is warned of once"
    assert any("line 6 ('Mean,0.8,0')" in m for m in said)

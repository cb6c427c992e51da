"""The dialog about a table: what it shows is what the reader did, and an answer stands in the recipe."""

import tomllib

import numpy as np
import openpyxl
import pytest

from metrosep.app.asking import Ask
from metrosep.app.documents import Places
from metrosep.app.first_lines import first_lines
from metrosep.app.opening import open_files, read_again
from metrosep.errors import ReadError

X = [0.5 * k for k in range(40)]
Z = [round(float(np.sin(0.7 * k)), 4) for k in range(40)]
ROWS = [f"{x},{z}" for x, z in zip(X, Z, strict=True)]


@pytest.fixture
def put(tmp_path, monkeypatch):
    """Write a file, or a workbook of sheets."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    def write(content):
        if isinstance(content, list):
            path = tmp_path / "a.csv"
            path.write_text("\n".join(content) + "\n", "utf-8")
            return path
        made = openpyxl.Workbook()
        made.remove(made.active)
        for title, rows in content.items():
            sheet = made.create_sheet(title)
            for row in rows:
                sheet.append(row)
        path = tmp_path / "a.xlsx"
        made.save(path)
        return path

    return write


def opened(path, **reading):
    return open_files(Places([path.parent]), [str(path)], reading)


def asked(path, **reading):
    with pytest.raises(Ask) as question:
        opened(path, **reading)
    return question.value


def input_of(session):
    return tomllib.loads(session.document.text)["input"]


def test_lines_roles_and_what_is_left_out_are_shown(put):
    path = put(
        [
            "Slide 7",
            "# by hand",
            "x,z,temp,b",
            "mm,um,,um",
            *(f"{r},20,1" for r in ROWS),
            "Mean,0.3,,",
        ]
    )

    sample = asked(path).sample

    assert [(one["number"], one["kind"]) for one in sample["lines"][:5]] == [
        (1, "preamble"), (2, "comment"), (3, "names"), (4, "units"), (5, "row"),
    ]  # fmt: skip
    assert sample["lines"][4]["text"] == f"{ROWS[0]},20,1"
    assert [(c["name"], c["unit"], c["role"]) for c in sample["columns"]] == [
        ("x", "mm", "position"), ("z", "um", "height"), ("temp", "", "temperature"), ("b", "um", ""),
    ]  # fmt: skip
    assert [(one["lines"], one["why"]) for one in sample["left"]] == [
        ("1", "text above the table"), ("2", "a comment"), ("45", "text below the table"),
    ]  # fmt: skip
    assert sample["n_rows"] == 40


def test_a_refused_line_is_shown_with_its_neighbours_and_its_answer_is_kept(put):
    path = put(["x_mm,z_um", *ROWS[:30], "14.75,broken", *ROWS[30:]])

    question = asked(path)

    assert [f["name"] for f in question.fields] == ["missing", "skip_lines"]
    assert [one["number"] for one in question.sample["lines"]][-5:] == [30, 31, 32, 33, 34]
    (line,) = [one for one in question.sample["lines"] if one["kind"] == "refused"]
    assert line == {"number": 32, "kind": "refused", "text": "14.75,broken"}
    session = opened(path, skip_lines="32")
    assert input_of(session)["skip_lines"] == "32"
    assert len(session.material.obj) == 40
    assert len(read_again(session, session.document.recipe).material.obj) == 40


def test_a_second_refused_line_is_proposed_beside_the_first(put):
    path = put(["x_mm,z_um", *ROWS[:30], "14.75,broken", *ROWS[30:], "20.0,torn", "20.5,0.1"])

    question = asked(path, skip_lines="32")

    choices = {f["name"]: f["choices"] for f in question.fields}
    assert choices["skip_lines"] == ["32,43"]
    assert len(opened(path, skip_lines="32,43").material.obj) == 41


def test_the_sheet_is_asked_for_and_kept(put):
    table = [["x_mm", "z_um"], *zip(X, Z, strict=True)]
    path = put({"Log": [["n", "v"], [1, 2]], "Data": table})

    question = asked(path)

    assert [(f["name"], f["choices"], f["value"]) for f in question.fields] == [
        ("sheet", ["Log", "Data"], "")
    ]
    session = opened(path, sheet="Data")
    assert input_of(session)["sheet"] == "Data"
    assert len(session.material.obj) == 40


def test_columns_of_the_chosen_sheet_are_asked_for(put):
    table = [["x", "z"], *zip(X, Z, strict=True)]
    path = put({"Log": [["n", "v"], [1, 2]], "Data": table})

    question = asked(path, sheet="Data")

    assert question.sample["part"] == "worksheet 'Data'"
    session = opened(path, sheet="Data", x="x", x_unit="mm", z="z", z_unit="um")
    assert session.material.obj.z == pytest.approx(np.array(Z) * 1e-6, rel=0.0, abs=1e-20)


def test_a_marker_is_asked_about(put):
    path = put(["x_mm,z_um", *ROWS[:30], "14.75,-9999", *ROWS[30:]])

    question = asked(path)

    assert [(f["name"], f["choices"]) for f in question.fields] == [("missing", ["-9999", "none"])]
    assert len(opened(path, missing="-9999").material.obj) == 41


def test_what_no_answer_would_settle_is_an_error(put, tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(range(256)) * 8)

    with pytest.raises(ReadError, match="no reader knows"):
        opened(path)
    assert first_lines(path, {}) == {}

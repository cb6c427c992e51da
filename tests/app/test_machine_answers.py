"""The page of a machine: terms with their words, what is not determined, charts of the document."""

import shutil

import pytest

from metrosep.app.documents import Places
from metrosep.app.machine_answers import machine
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError


def session_of(repository, folder, example, recipe="recipe.toml", change=lambda text: text):
    for file in (repository / "examples" / example).iterdir():
        shutil.copy(file, folder)
    path = folder / recipe
    path.write_text(change(path.read_text("utf-8")), "utf-8")
    session = Session(Places([folder]))
    session.open(str(path))
    return session


def ask(session):
    header, arrays = machine(session, {"k": "machine"}, lambda: False, [].append)
    assert arrays == {}
    return header


def test_terms_have_values_and_words(repository, tmp_path):
    found = ask(session_of(repository, tmp_path, "five_axis_calibration"))
    rows = {r["term"]: r for r in found["rows"]}

    assert rows["B0A"]["value"] == pytest.approx(16e-6, abs=2e-6)  # truth.csv, 4 u
    assert rows["EXC"]["kind"] == "P-V"
    assert rows["EXC"]["words"] == "radial motion of C in X"
    assert found["null"] == []
    assert {c["kind"] for c in found["charts"]} == {"curves", "bars", "maps"}


def test_what_is_not_determined_has_no_value_and_is_listed_once(repository, tmp_path):
    session = session_of(
        repository,
        tmp_path,
        "five_axis_calibration",
        change=lambda t: "\n".join(r for r in t.splitlines() if not r.startswith("terms = ")),
    )
    found = ask(session)

    rows = {r["term"]: r for r in found["rows"]}
    assert rows["EXX"]["value"] is None  # three balls do not see the scale of X
    assert any("EXX" in n for n in found["null"])
    assert not set(found["null"]) & set(found["messages"])


@pytest.mark.parametrize(
    ("example", "recipe"), [("five_axis_calibration", "circle.toml"), ("thermal", "recipe.toml")]
)
def test_circles_and_heat_have_charts_too(repository, tmp_path, example, recipe):
    found = ask(session_of(repository, tmp_path, example, recipe))
    assert found["charts"][0]["kind"] == "curves"
    assert found["messages"]
    assert found["verdict"] == "accept"


def test_what_is_refused_leaves_terms_and_pictures_and_no_verdict(repository, tmp_path):
    wrong = '\n[[check]]\nmetric = "nothing"\nupper = "1 um"\nU = "1 nm"\n'
    found = ask(session_of(repository, tmp_path, "thermal", change=lambda t: t + wrong))
    assert found["verdict"] is None
    assert "nothing" in found["messages"][0]
    assert found["charts"][0]["kind"] == "curves"


def test_other_recipes_have_no_page_of_a_machine(repository, tmp_path):
    session = session_of(repository, tmp_path, "drift")
    with pytest.raises(DataError, match="this one is iso230_3_drift"):
        ask(session)

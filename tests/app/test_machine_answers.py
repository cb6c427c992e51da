"""The page of a machine: terms with their words, what is not determined, charts of the document."""

import shutil

import numpy as np
import pytest

from metrosep.app.documents import Places
from metrosep.app.sessions import Session
from metrosep.app.table_answers import machine
from metrosep.core.errors import DataError


def session_of(repository, folder, example, recipe="recipe.toml", change=lambda text: text):
    for file in (repository / "examples" / example).iterdir():
        if file.is_file():
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
    session = session_of(
        repository, tmp_path, "five_axis_calibration", "circle.toml", lambda t: t + wrong
    )
    found = ask(session)
    assert found["verdict"] is None
    assert "nothing" in found["messages"][0]
    assert found["charts"][0]["kind"] == "curves"


def test_a_ballbar_lies_about_its_circle_with_the_angle_of_its_places(repository, tmp_path):
    """The first place of the yz file is +Y from the ball: 0 deg; the largest Z is at 90 deg."""
    found = ask(session_of(repository, tmp_path, "mill_instruments", "ballbar.toml"))
    (chart,) = [c for c in found["charts"] if c.get("closed")]
    assert chart["each"]
    titles = [p["title"] for p in chart["panels"]]
    assert titles[1] == "ballbar yz: angle from +Y to +Z"
    table = np.loadtxt(tmp_path / "ballbar_yz.csv", delimiter=",", skiprows=6)
    read = table[:, 3] - table[:, 3].mean()
    for row, degrees in ((0, 0.0), (int(np.argmax(table[:, 2])), 90.0)):
        curve = chart["panels"][1]["curves"][0]
        k = int(np.argmin(np.abs(np.degrees(curve["x"]) - degrees)))
        assert np.degrees(curve["x"][k]) == pytest.approx(degrees, abs=0.01)
        assert curve["y"][k] == pytest.approx(1e-6 * read[row], abs=1e-11)


def test_sections_of_traces_lie_about_a_circle_each(repository, tmp_path):
    # without u_reading no hundred cylindricities are drawn for u, and the picture is the same
    found = ask(
        session_of(
            repository,
            tmp_path,
            "roundness_traces",
            change=lambda t: t.replace('u_reading = "20 nm"\n', ""),
        )
    )
    (chart,) = found["charts"]
    assert (chart["closed"], chart["each"], len(chart["panels"])) == (True, True, 5)


def test_parts_over_a_turn_lie_about_a_circle(repository, tmp_path):
    found = ask(session_of(repository, tmp_path, "reversal"))
    chart = found["charts"][0]
    assert (chart["kind"], chart["closed"]) == ("curves", True)
    assert {"artefact ± 2 u", "spindle ± 2 u"} == {p["title"] for p in chart["panels"]}


def test_a_drift_has_curves_that_are_not_round(repository, tmp_path):
    found = ask(session_of(repository, tmp_path, "drift"))
    assert found["charts"]
    assert not any(c.get("closed") for c in found["charts"])


def test_a_ranking_has_a_page_of_its_own(repository, tmp_path):
    with pytest.raises(DataError, match="ranking has its own"):
        ask(session_of(repository, tmp_path, "fts_lathe"))

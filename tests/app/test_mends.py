"""What the page offers where something is refused: each button is an edit that `metrosep run` takes."""

import subprocess
import sys
import tomllib

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.mends import mends_of_edit
from metrosep.app.server import Answers
from metrosep.app.sessions import Session

CHECK = {"metric": "Sq", "upper": "1 um", "U": "1 nm"}


def opened(folder, step=None):
    y, x = np.mgrid[0:60, 0:90]
    ms.write(ms.Surface(20e-9 * np.cos(x / 3.0) + 1e-9 * y, step, step), folder / "part.h5")
    answers = Answers(Session(Places([folder])))
    answers.answer({"k": "open", "path": "part.h5"})
    return answers


def full(answers):
    return answers.answer({"k": "metrics", "level": "full"})[0]


def press(answers, mend, value=None):
    edits = [dict(e) for e in mend["edits"]]
    if mend["ask"]:
        edits[-1]["new"] = value
    answers.answer({"k": "edit", "edits": edits})


def test_a_map_without_scale_asks_for_it_and_every_reading_is_in_pixels_till_then(tmp_path):
    answers = opened(tmp_path)
    failed = full(answers)["failed"]
    assert not any(word in failed["message"] for word in ("None", "True", "='", "Surface("))
    scale, skip = failed["mends"]
    assert (scale["label"], scale["ask"]["hint"]) == ("Give the lateral step…", "such as 3 um")
    picture, _ = answers.answer({"k": "map"})
    section, _ = answers.answer({"k": "section", "a": [0.0, 10.0], "b": [30.0, 50.0]})
    assert (picture["unit"], section["unit"], section["length"]) == ("px", "px", 50.0)
    press(answers, skip)
    assert full(answers)["rows"]  # heights need no scale
    answers.answer({"k": "undo"})
    press(answers, scale, "3 um")
    assert "failed" not in full(answers)
    picture, _ = answers.answer({"k": "map"})
    section, _ = answers.answer({"k": "section", "a": [0.0, 30e-6], "b": [90e-6, 150e-6]})
    assert (picture["unit"], picture["extent"][2]) == ("m", pytest.approx(89.5 * 3e-6))
    assert section["length"] == pytest.approx(150e-6)


def test_the_page_judges_nothing_that_metrosep_run_refuses_and_offers_the_way_out(tmp_path):
    answers = opened(tmp_path, 3e-6)
    answers.answer({"k": "edit", "path": ["check", 0], "old": None, "new": CHECK})
    assert full(answers)["verdict"] == "accept"
    late = {"op": "filter", "cutoff": "30 um"}
    answers.answer({"k": "edit", "path": ["step", 2], "old": None, "new": late})
    header = full(answers)
    assert header["verdict"] is None
    assert "step 2 evaluates what step 3 (filter" in header["refused"]
    move, mark = header["mends"]
    assert (move["label"], mark["label"]) == (
        "Move step 2 to the end", "Set intermediate = true",
    )  # fmt: skip
    press(answers, move)
    assert full(answers)["verdict"] == "accept"
    text = answers.session.state()["recipe"]
    assert [s["op"] for s in tomllib.loads(text)["step"]] == ["form", "filter", "parameters"]
    (tmp_path / "r.toml").write_text(text)
    subprocess.run([sys.executable, "-m", "metrosep", "run", "r.toml", "part.h5", "-o", "out"],
                   cwd=tmp_path, check=True, capture_output=True)  # fmt: skip
    missing = {"metric": "Rq", "upper": "1 um", "U": "1 nm"}
    answers.answer({"k": "edit", "path": ["check", 1], "old": None, "new": missing})
    (remove,) = full(answers)["mends"]
    press(answers, remove)
    assert answers.session.state()["checks"] == [CHECK]


def test_a_button_of_a_refused_edit_makes_the_edit_with_what_it_lacked(tmp_path):
    session = opened(tmp_path, 3e-6).session
    _, document = session.need()
    step = {"op": "filter", "cutoff": "30 um"}
    edits = [Edit(("step", 2), None, step)]
    told = 'such a step needs band = "short", or threshold = 3'
    (mend,) = mends_of_edit(document, edits, told)
    assert mend["label"] == "Set band = short"
    session.edit([Edit(tuple(e["path"]), e["old"], e["new"]) for e in mend["edits"]])
    assert session.state()["steps"][2]["keys"]["band"] == "short"
    before = document.text
    assert mends_of_edit(document, edits, 'needs band = "sideways" or colour = "red"') == []
    assert document.text == before

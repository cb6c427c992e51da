"""What the page offers where something is refused: each button is an edit that `metrosep run` takes."""

import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from contracts.recipes import mean_of_runs

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.mends import mends_of_edit, mends_of_step
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, Example, MetrosepError

RUNS = f"""{mean_of_runs()}[[output]]
kind = "table"
controller = "csv"
axis = "X"
compensates = "Z"
spacing = "0.5 mm"
path = "z.csv"
machine = {{ max_points = 60 }}
"""
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
    assert full(answers)["rows"]  # a plane needs no scale
    edit = {"path": ["step", 0, "form"], "old": "plane", "new": "sphere"}
    answers.answer({"k": "edit", "edits": [edit]})
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
    assert (picture["unit"], picture["extent"][2]) == ("m", pytest.approx(89.5 * 3e-6, abs=0.0))
    assert section["length"] == pytest.approx(150e-6, abs=0.0)


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
        "Move step 2 to the end", "Switch intermediate on",
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


@pytest.mark.parametrize(
    "before",
    [
        '[[ check ]]\nmetric = "Sq"\nupper = "1 um"\nU = "1 nm"\n[[check]]\n',
        '# no [[check]] of Rq\n[[check]]\nmetric = "Sq"\nupper = "1 um"\nU = "1 nm"\n[[check]]\n',
        '[[check]]\nmetric = "Sq"\nupper = "1 um"\nU = "1 nm"\n# [[check]]\n[[ check ]]\n',
    ],
)
def test_the_limit_that_is_removed_is_the_refused_one_however_its_header_is_written(
    tmp_path, before
):
    y, x = np.mgrid[0:40, 0:50]
    ms.write(ms.Surface(20e-9 * np.cos(x / 3.0) + 1e-9 * y, 3e-6, 3e-6), tmp_path / "part.h5")
    head = 'metrosep = 1\n[input]\nfiles = ["part.h5"]\n[[step]]\nop = "parameters"\n'
    faulty = 'metric = "Rq"\nupper = "2 um"\nU = "1 nm"\n'
    (tmp_path / "r.toml").write_text(head + before + faulty)
    answers = Answers(Session(Places([tmp_path])))
    answers.answer({"k": "open", "path": "r.toml"})
    (remove,) = full(answers)["mends"]
    assert (remove["label"], remove["edits"][0]["path"]) == ("Remove this limit", ["check", 1])
    press(answers, remove)
    assert answers.session.state()["checks"] == [CHECK]
    assert full(answers)["verdict"] == "accept"


@pytest.mark.parametrize(
    ("typed", "step_m"),
    [("1e-3 m", 5e-6), ("2e3 um", 1e-5), ("+2 mm", 1e-5), ("0.5 mm", 2.5e-6), ("2", None),
     ("-2 mm", None), ("2 mm 3", None), ("2 s", None), ("nan mm", None)],
)  # fmt: skip
def test_a_known_length_is_read_as_everywhere_and_never_taken_for_a_pixel(tmp_path, typed, step_m):
    answers = opened(tmp_path)
    if step_m is None:
        for given in ({"known": typed}, {"step": typed}):
            with pytest.raises(MetrosepError):
                answers.answer({"k": "scale", "px": 200.0, **given})
        return
    step = answers.answer({"k": "scale", "known": typed, "px": 200.0})[0]["lateral_step"]
    answers.answer({"k": "edit", "path": ["input", "lateral_step"], "old": None, "new": step})
    picture, _ = answers.answer({"k": "map"})
    assert picture["extent"][2] == pytest.approx(89.5 * step_m, abs=0.0)
    with pytest.raises(MetrosepError, match="one of the two"):
        answers.answer({"k": "scale", "px": 200.0, "known": typed, "step": "1 um"})


def test_a_limit_of_no_step_and_one_without_unit_have_a_button_each(tmp_path):
    answers = opened(tmp_path, 3e-6)
    answers.answer(
        {"k": "edit", "path": ["check", 0], "old": None, "new": {**CHECK, "metric": "Sqq"}}
    )
    use, remove = full(answers)["mends"]
    assert (use["label"], remove["label"]) == ("Set metric = Sq", "Remove this limit")
    press(answers, use)
    assert full(answers)["verdict"] == "accept"
    answers.answer({"k": "edit", "path": ["check", 0, "upper"], "old": "1 um", "new": 180})
    give, _ = full(answers)["mends"]
    assert give["ask"]["hint"] == "such as 120 nm"
    press(answers, give, "180 nm")
    assert full(answers)["verdict"] == "accept"


GRAMMAR = re.compile(
    r"\w = [\"']|\b(?!k\b)\w+ = \d|= true|= false|\.toml:\d|\w=(?:[\"'\s]|$)|\[input\]|\bNone\b|\bTrue\b"
)


@pytest.mark.parametrize(
    "edits",
    [
        [("step", {"op": "filter", "lambda_c": "30 um"})],  # without a scale
        [("input", "3 um"), ("step", {"op": "step_height", "width": "9 um", "middle": "50 mm"})],
        [("input", "3 um"), ("step", {"op": "filter", "cutoff": "30 um"}), ("check", CHECK)],
        [("input", "3 um"), ("check", {**CHECK, "metric": "Sqq"})],
        [("input", "3 um"), ("check", {**CHECK, "upper": 180})],
        [("input", "3 um"), ("step", {"op": "form", "form": "sphere: R=0.01 mm"})],
    ],
)
def test_no_grammar_of_recipes_reaches_the_page(tmp_path, edits):
    answers = opened(tmp_path)
    for what, new in edits:
        path = {"input": ["input", "lateral_step"], "step": ["step", 2], "check": ["check", 0]}[
            what
        ]
        answers.answer({"k": "edit", "path": path, "old": None, "new": new})
    header = full(answers)
    said = [
        header.get("failed", {}).get("message", ""),
        header.get("refused", ""),
        *header["messages"],
    ]
    assert any(said)
    for text in said:
        assert not GRAMMAR.search(text), text


@pytest.mark.parametrize("typed", ["2 um, 3 um", "2 um x 3 um", "2um \u00d7 3um"])
def test_a_pixel_that_is_not_square_has_a_width_and_a_height(tmp_path, typed):
    """1 nm for each row is 1 nm over 3 um along y; the recipe runs alike at the command line."""
    answers = opened(tmp_path)
    step = answers.answer({"k": "scale", "px": 200.0, "step": typed})[0]["lateral_step"]
    made = {"k": "edit", "path": ["input", "lateral_step"], "old": None, "new": step}
    session = answers.answer(made)[0]["session"]
    picture, _ = answers.answer({"k": "map"})
    assert picture["extent"][2:] == pytest.approx([89.5 * 2e-6, 59.5 * 3e-6], abs=1e-15)
    recipe = tmp_path / "r.toml"
    recipe.write_text(session["recipe"])
    result = ms.Recipe.load(recipe).run(tmp_path / "part.h5")
    assert (result.produced.obj.dx, result.produced.obj.dy) == (2e-6, 3e-6)


def test_two_steps_that_are_none_are_refused(tmp_path):
    answers = opened(tmp_path)
    for typed, why in (
        ("2 um, 3 um, 4 um", "one step"),
        ("2, 3 um", "unit"),
        ("2 um, -3 um", "positive"),
    ):
        with pytest.raises(MetrosepError, match=why):
            answers.answer({"k": "scale", "px": 200.0, "step": typed})


def test_a_button_of_a_refused_edit_makes_the_edit_with_what_it_lacked(tmp_path):
    session = opened(tmp_path, 3e-6).session
    _, document = session.need()
    step = {"op": "filter", "cutoff": "30 um"}
    edits = [Edit(("step", 2), None, step)]
    (mend,) = mends_of_edit(document, edits, MetrosepError("...").hinting(band="short"))
    assert mend["label"] == "Set band = short"
    session.edit([Edit(tuple(e["path"]), e["old"], e["new"]) for e in mend["edits"]])
    assert session.state()["steps"][2]["keys"]["band"] == "short"
    before = document.text
    error = MetrosepError("...").hinting(band="sideways").hinting(colour="red")
    assert mends_of_edit(document, edits, error) == []
    assert document.text == before


def of_runs(folder, *, machine="max_points = 60", lost=0.0, **replaced):
    """Open four runs of a lopsided bump over 50 mm, without feedrate or time; every other one back."""
    x = np.linspace(0.0, 50.0, 501)
    z = 2.0 * np.exp(-(((x - 15.0) / 4.0) ** 2))
    noise = np.random.default_rng(3).normal(0.0, 2e-3, (10 if lost else 4, x.size))
    rows = []
    for r in range(len(noise)):
        back = bool(lost and r % 2)
        run = list(zip(x, z + noise[r] + lost * back, strict=True))
        rows += [f"{r},{a:.3f},{b:.6f}" for a, b in (reversed(run) if back else run)]
    (folder / "runs.csv").write_text("\n".join(["run,x_mm,z_um", *rows]) + "\n")
    text = RUNS.replace("max_points = 60", machine)
    for old, new in replaced.items():
        text = text.replace(f'{old} = "', f'{old} = "{new}"  # "')
    (folder / "r.toml").write_text(text)
    answers = Answers(Session(Places([folder])))
    answers.answer({"k": "open", "path": "r.toml"})
    return answers


def test_a_table_with_too_many_entries_is_mended_by_the_finest_round_spacing_that_fits(tmp_path):
    answers = of_runs(tmp_path)
    refused = answers.answer({"k": "table"})[0]["refused"]
    (mend,) = refused["mends"]
    assert (refused["check"], mend["label"]) == ("points", "Set spacing = 1 mm")  # 51 of 60
    press(answers, mend)
    header, _ = answers.answer({"k": "table"})
    assert "refused" not in header
    assert header["n_points"] == 51
    assert all("hint" not in finding for finding in header["facts"].get("findings", ()))


@pytest.mark.parametrize(
    ("given", "label"),
    [
        ({"spacing": "80 mm"}, "Set spacing = 0.5 mm"),
        ({"spacing": "1 nm"}, "Set spacing = 0.5 mm"),
        ({"spacing": "1 mm", "axis": 'X"\ndirection = "split'}, "Set direction = both"),
    ],
)
def test_a_table_that_cannot_be_sampled_gets_what_can(tmp_path, given, label):
    answers = of_runs(tmp_path, **given)
    (mend,) = answers.answer({"k": "table"})[0]["refused"]["mends"]
    assert mend["label"] == label
    press(answers, mend)
    header, _ = answers.answer({"k": "table"})
    assert header.get("refused", {"check": "points"})["check"] == "points"


FEED = 'feed = "1000 mm/min", '
SLOW = ['velocity_share = "0.2 mm/min"', 'acceleration_share = "0.02 mm/s2"']


@pytest.mark.parametrize(
    "limits", [SLOW[:1], SLOW[1:], SLOW], ids=["velocity", "acceleration", "both"]
)
def test_a_table_that_the_axis_cannot_follow_gets_the_feed_at_which_it_can(tmp_path, limits):
    answers = of_runs(tmp_path, machine=FEED + ", ".join(limits), spacing="1 mm")
    refused = answers.answer({"k": "table"})[0]["refused"]
    assert (
        refused["checks"] == ["velocity", "acceleration"]
        if len(limits) == 2
        else len(refused["checks"]) == 1
    )
    (mend,) = refused["mends"]
    press(answers, mend)
    assert "refused" not in answers.answer({"k": "table"})[0]
    feed = mend["edits"][0]["new"]
    assert mend["label"] == f"Set feed = {feed}"
    number = float(feed.removesuffix(" mm/min"))
    assert 100.0 < number < 999.0
    faster = {"path": mend["edits"][0]["path"], "old": feed, "new": f"{number + 2.0:g} mm/min"}
    answers.answer({"k": "edit", "edits": [faster]})  # it was the fastest of three digits
    assert answers.answer({"k": "table"})[0]["refused"]["mends"][0]["label"] == mend["label"]


def test_a_table_that_jumps_at_a_reversal_is_written_as_one_column(tmp_path):
    answers = of_runs(tmp_path, machine='reversal_jump = "0.1 um"', lost=0.5, spacing="1 mm")
    refused = answers.answer({"k": "table"})[0]["refused"]
    assert (refused["check"], "backlash parameter" in refused["message"]) == ("reversal", True)
    (mend,) = refused["mends"]
    assert mend["label"] == "Set direction = both"
    press(answers, mend)
    assert "refused" not in answers.answer({"k": "table"})[0]


def test_runs_that_a_method_cannot_separate_get_one_that_can_wherever_they_are_asked_for(tmp_path):
    answers = of_runs(tmp_path, method="joint")
    for kind in ("table", "curves", "waves"):
        with pytest.raises(MetrosepError) as caught:
            answers.answer({"k": kind, "level": "full"})
        (mend,) = answers.session.mends_of_runs(caught.value)  # no skip, no edit without effect
        assert mend["label"] == "Set method = mean"
    press(answers, mend)
    assert answers.answer({"k": "curves", "level": "full"})[0]["separated"]


def test_an_example_of_a_hint_is_asked_for_and_never_set(tmp_path):
    session = opened(tmp_path, 3e-6).session
    _, document = session.need()
    step = {"op": "filter", "kind": "gaussian"}
    edits = [Edit(("step", 0), document.recipe.steps[0], step)]
    error = MetrosepError("a gaussian filter needs a cut-off").hinting(cutoff=Example("25 um"))
    assert mends_of_edit(document, edits, error) == []  # nothing can be set without a person
    session.edit([Edit(("step", 2), None, {"op": "filter", "cutoff": "30 um"})])
    (ask, *_) = [m for m in mends_of_step(document, 2, error) if m["ask"]]
    assert ask["ask"]["hint"] == "such as 25 um"
    assert ask["edits"][-1]["new"] is None


@pytest.mark.parametrize(
    ("keys", "label"),
    [
        ({"op": "filter", "kind": "spline", "band": "stop", "cutoff": "30 um"}, "Set kind = gaussian"),
        ({"op": "psd", "limit": "rms = 5 nm from 10 um to 50 um", "estimate": "slopes", "detrend": "mean"},
         "Set detrend = plane"),
    ],
)  # fmt: skip
def test_what_an_error_carries_is_offered_where_a_step_is_refused(tmp_path, keys, label):
    session = opened(tmp_path, 3e-6).session
    _, document = session.need()
    steps = document.recipe.steps
    edits = [Edit(("step", len(steps)), None, keys)]
    with pytest.raises(MetrosepError) as refused:
        document.copy().edit(edits)
    hints = refused.value.hints
    assert [f"Set {k} = {v}" for hint in hints for k, v in hint.items()] == [label]


@pytest.mark.parametrize(
    ("request_", "needs"),
    [
        ({"k": "section", "b": [0.0, 1.0]}, "section needs the point a as [x, y], got nothing"),
        ({"k": "section", "a": [0.0, 1.0], "b": [2.0]}, r"section needs the point b as [x, y], got [2.0]"),
        ({"k": "spectrum", "a": [True, 1.0], "b": [2.0, 0.0]}, "spectrum needs the point a"),
        ({"k": "places", "what": "extremes", "radius": 1.0}, "places needs the point at"),
        ({"k": "places", "what": "extremes", "at": [3.0, 4.0]}, "places needs the number radius, got nothing"),
    ],
)  # fmt: skip
def test_a_request_that_lacks_a_place_says_which(tmp_path, request_, needs):
    answers = opened(tmp_path, 1e-6)
    with pytest.raises(DataError, match=re.escape(f"the request {needs}")):
        answers.answer(request_)

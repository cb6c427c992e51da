"""Numbers are judged by the recipe that made them, and known by file and recipe."""

import numpy as np
import pytest
from contracts.recipes import mean_of_runs

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.evaluations import Evaluations
from metrosep.app.server import Answers
from metrosep.app.sessions import Session

LIMIT = {"metric": "Sq", "upper": "1 um", "U": "1 nm"}


def part(path, height=0.5e-6):
    z = height * np.cos(np.arange(40) / 3.0)[None, :] * np.ones((30, 1))
    ms.write(ms.Surface(z, 1e-4, 1e-4), path)
    return path


@pytest.fixture
def answers(tmp_path):
    answers = Answers(Session(Places([tmp_path])))
    answers.answer({"k": "open", "path": str(part(tmp_path / "a.x3p"))})
    answers.answer({"k": "edit", "path": ["check", 0], "old": None, "new": LIMIT})
    return answers


def test_an_edit_that_comes_meanwhile_judges_nothing(answers, monkeypatch):
    before = answers.session.state()["hash"]
    usual = Evaluations.outcome

    def slow(self, *given, **options):
        found = usual(self, *given, **options)
        strict = {"metric": "Sa", "upper": "1 nm", "U": "0.1 nm"}
        answers.session.edit([Edit(("check", 0), LIMIT, strict)])
        return found

    monkeypatch.setattr(Evaluations, "outcome", slow)
    header, _ = answers.answer({"k": "metrics", "level": "full"})
    assert header["hash"] == before
    assert header["hash"] != answers.session.state()["hash"]
    assert header["verdict"] == "accept"
    assert [c["metric"] for c in header["checks"] if c["verdict"]] == ["Sq"]


def test_equal_recipes_of_other_files_have_other_marks(answers, tmp_path):
    first = answers.session.state()["hash"]
    (tmp_path / "b").mkdir()
    part(tmp_path / "b" / "a.x3p", 3e-6)
    answers.answer({"k": "open", "path": "b/a.x3p", "keep_recipe": True})
    state = answers.session.state()
    assert state["checks"] == [LIMIT]
    assert state["hash"] != first
    header, _ = answers.answer({"k": "metrics", "level": "full"})
    assert header["hash"] == state["hash"]
    assert header["verdict"] == "reject"


STEPS = mean_of_runs()
NO_UNCERTAINTY = """[[check]]
metric = "residual_rms"
upper = "1 um"
"""


@pytest.mark.parametrize(
    ("own", "base"),
    [
        (STEPS + NO_UNCERTAINTY, None),
        (STEPS + NO_UNCERTAINTY + '[view]\ntab = "report"\n', None),
        ('metrosep = 1\nextends = "base.toml"\n', STEPS + NO_UNCERTAINTY),
    ],
    ids=["own", "own with a view", "inherited"],
)
def test_a_limit_that_cannot_be_judged_leaves_the_numbers_of_runs(tmp_path, own, base):
    rng = np.random.default_rng(1)
    x = np.arange(0.0, 20.0, 0.05)
    rows = ["run,x_mm,z_um"]
    for k in range(3):
        z = np.cos(x) + 0.01 * rng.standard_normal(x.size)
        rows += [f"{k},{a:.3f},{b:.5f}" for a, b in zip(x, z, strict=True)]
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "r.toml").write_text(own)
    if base is not None:
        (tmp_path / "base.toml").write_text(base)
    answers = Answers(Session(Places([tmp_path])))
    answers.answer({"k": "open", "path": str(tmp_path / "r.toml")})
    for _ in range(2):  # what was shown without limits is never taken for what was judged
        header, _ = answers.answer({"k": "metrics", "level": "full"})
        assert "uncertainty" in header["refused"]
        assert header["verdict"] is None
        with pytest.raises(ms.errors.RecipeError, match="uncertainty of residual_rms"):
            answers.answer({"k": "report"})
    assert {r["symbol"] for r in header["rows"]} >= {"pv", "residual_rms"}


def test_a_section_beside_the_map_leaves_the_numbers_of_the_others(answers):
    sections = [
        {"kind": "line", "name": "beside", "a": "90 mm, 1 mm", "b": "95 mm, 1 mm"},
        {"kind": "line", "name": "on", "a": "1 mm, 1 mm", "b": "3 mm, 1 mm"},
    ]
    for k, section in enumerate(sections):
        answers.answer({"k": "edit", "path": ["section", k], "old": None, "new": section})
    header, _ = answers.answer({"k": "metrics", "level": "full"})
    rows = {row["symbol"]: row["value"] for row in header["rows"]}
    # a cosine of 0.5 um over 3 pixels: from pixel 10 to 30 it goes through both of its ends
    assert rows["section.on.Pt"] == pytest.approx(1e-6, abs=0.06e-6)
    assert not any(name.startswith("section.beside") for name in rows)
    assert "beside" in header["refused"]
    assert "wholly outside" in header["refused"]
    assert header["verdict"] is None  # as `metrosep run` refuses it

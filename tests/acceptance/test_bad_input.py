"""Bad input of a map, through the doors: one clear sentence at the key, the right code, nothing lost.

Rows that are elsewhere: shapes and the polygon that crosses itself in recipe/test_mask_shapes, the logo, the
number that belongs to other bytes and the missing font in report/test_certificate, objects that were cut off
in test_public_objects, graphics and the lost connection in tests/browser.
"""

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.cli.main import main

pytestmark = pytest.mark.usefixtures("without_figures")

HEAD = 'metrosep = 1\n[input]\nfiles = ["part.h5"]\n'
PARAMETERS = '[[step]]\nop = "parameters"\nnames = ["Sq"]\n'
BESIDE = {"shape": "circle", "diameter": "20 um", "centre": ["30 mm", "30 mm"]}


def circle(diameter, x="30 um", y="30 um"):
    return f'{{ shape = "circle", diameter = "{diameter}", centre = ["{x}", "{y}"] }}'


def mask(aperture):
    return f'[[step]]\nop = "mask"\naperture = {aperture}\n{PARAMETERS}'


def line(a, b):
    return f'{PARAMETERS}[[section]]\nkind = "line"\nname = "s"\na = {a}\nb = {b}\n'


STEP = f'[[step]]\nop = "step_height"\nupper = {circle("6 um")}\nlower = {circle("60 um", "130 um", "100 um")}\n'
SQUARE = ["0 um, 0 um", "9 um, 0 um"]


@pytest.fixture
def metrosep(capsys):
    """Run a command line: (code, stdout, stderr)."""

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main(list(words))
        return stop.value.code, *capsys.readouterr()

    return call


def part(folder, step=3e-6):
    y, x = np.mgrid[0:60, 0:90]
    ms.write(ms.Surface(20e-9 * np.cos(x / 3.0) + 1e-9 * y, step, step), folder / "part.h5")


@pytest.mark.parametrize(
    ("text", "step", "code", "says"),
    [
        (mask(f'{{ shape = "polygon", points = {SQUARE} }}'), 3e-6, 2, ("r.toml:6", "polygon")),
        (mask(circle("0 um")), 3e-6, 2, ("r.toml:6", "diameter")),
        (mask(circle("-3 um")), 3e-6, 2, ("r.toml:6", "diameter")),
        (mask(circle("20 um")), None, 2, ("r.toml:6", "how large a pixel", "120 px", "lateral_step = ")),
        (mask(circle("20 um", "30 mm")), 3e-6, 4, ("r.toml:5", "leaves nothing", "0 to 267 um in x")),
        (line(["9 um", "9 um"], ["9 um", "9 um"]), 3e-6, 2, ("r.toml:11", "the section has no length")),
        (line(["9 mm", "9 um"], ["10 mm", "9 um"]), 3e-6, 4, ("wholly outside",)),
        (line(["9 um", "9 um"], ["80 m", "9 um"]), 3e-6, 2, ("(80 m, 9 um)", "10000000 pixels")),
        (STEP, 3e-6, 4, ("the region upper holds 5 valid pixels, 10 are needed",)),
    ],
)  # fmt: skip
def test_a_map_is_refused_in_one_sentence_at_its_key(
    tmp_path, metrosep, monkeypatch, text, step, code, says
):
    monkeypatch.chdir(tmp_path)
    part(tmp_path, step)
    (tmp_path / "r.toml").write_text((HEAD + text).replace("'", '"'))
    found, _, err = metrosep("run", "r.toml", "part.h5", "-o", "out")
    assert found == code
    (said,) = [one for one in err.splitlines() if one.startswith("error: ")]
    assert all(word in said for word in says), said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["part.h5", "r.toml"]


def test_a_section_that_is_partly_outside_has_gaps_and_its_share_is_said(
    tmp_path, metrosep, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    part(tmp_path)
    text = HEAD + line(
        ["168 um", "90 um"], ["366 um", "90 um"]
    )  # the map ends at 267 um: half of it
    (tmp_path / "r.toml").write_text(text.replace("'", '"'))
    code, out, err = metrosep("run", "r.toml", "part.h5", "-o", "out")
    assert code == 0
    assert "49.3 %" in next(  # 33 of 67 samples, 3 um apart
        one for one in (out + err).splitlines() if "outside" in one or "not measured" in one
    )


def test_a_mask_that_removes_everything_is_kept_marked_and_the_map_before_is_shown(tmp_path):
    part(tmp_path)
    answers = Answers(Session(Places([tmp_path])))
    answers.answer({"k": "open", "path": "part.h5"})
    before, pixels = answers.answer({"k": "map", "level": "full", "stage": 0})
    step = {"op": "mask", "aperture": BESIDE}
    stored = answers.session.state()["steps"][1]["stored"]
    answers.answer({"k": "edit", "path": ["step", 1], "old": stored, "new": step})
    kept = answers.session.state()["steps"]
    at = next(i for i, s in enumerate(kept) if s["op"] == "mask")
    failed = answers.answer({"k": "metrics", "level": "full"})[0]["failed"]
    assert failed["index"] == at
    assert "leaves nothing" in failed["message"]
    after, still = answers.answer({"k": "map", "level": "full"})
    assert after["unit"] == before["unit"] == "m"
    for name, values in pixels.items():
        np.testing.assert_array_equal(still[name], values)

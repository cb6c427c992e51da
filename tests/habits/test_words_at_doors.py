"""No word of Python reaches the page or who typed a command: every request and every verb is refused.

The texts are those that the server sends and the commands print; what is wrong in them is said by
patterns that know nothing of how they are made.
"""

import contextlib
import importlib
import inspect
import io
import pkgutil
import re
import threading

import click
import numpy as np
import pytest
from contracts.recipes import mean_of_runs

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.server import KINDS, Answers, _Talk
from metrosep.app.sessions import Session
from metrosep.cli import main as command_line
from metrosep.controllers.registry import find, names
from metrosep.recipe.steps import ALL_STEPS

pytestmark = pytest.mark.slow

OF_RUNS = ("separate", "polynomial", "plan_feedrates", "laser_setup")
RUNS = f"""{mean_of_runs()}[[output]]
kind = "table"
controller = "csv"
axis = "X"
compensates = "Z"
spacing = "0.5 mm"
path = "z.csv"
"""
LINE = {"kind": "line", "a": ["0 mm", "0 mm"], "b": ["0.1 mm", "0 mm"]}
LIMIT = {"metric": "Sq", "upper": "1 um", "U": "1 nm"}
TABLE = {"kind": "table", "controller": "csv", "axis": "X", "compensates": "Z", "spacing": "1 mm",
         "path": "q.csv"}  # fmt: skip
BAD = (True, "x", "5", -1, ["a"], {"a": 1}, "1e400 m", "-3 um", 0.5, "")
REQUESTS = (
    {"level": "x"}, {"level": "full"}, {"index": 99}, {"a": [0, 0], "b": [0, 0]}, {"a": [-1, 0], "b": [1e9, 1]},
    {"path": "none.txt"}, {"path": "/dev/zero"}, {"path": 7}, {"stage": 99}, {"step": "x", "known": "y"},
    {"edits": [{"path": ["step", 9], "old": None, "new": None}]}, {"edits": [{"path": ["no"], "old": None, "new": 1}]},
    {"step": "-3 um"}, {"px": "a", "known": "1 mm"}, {"what": "nope", "path": "x"}, {"of": 3}, {"pin": "a"},
    {"what": "recipe", "path": "x/y/z.toml"}, {"draft": {"kind": "table"}}, {"against": "b"}, {"format": "nope"},
    {"draft": {**TABLE, "controller": "nope"}}, {"window": 3}, {"centre": [0, 0], "radius": -1}, {"machine": "nope"},
    {"direction": "up", "level": "full"},
)  # fmt: skip
TYPED = ("nonsense", "5", "-3 um", "a=b", "X")
LOADING = ("ui", "listen", "doctor", "demo")
"""Verbs that serve, look at this computer, or work without an input."""


def classes():
    """Return the public classes whose names no English word is."""
    found = {"ndarray", "NoneType", "PosixPath", "mappingproxy"}
    for module in pkgutil.iter_modules(ms.__path__):
        if not module.name.startswith("_"):
            public = importlib.import_module(f"metrosep.{module.name}")
            found |= {
                n for n in getattr(public, "__all__", ()) if inspect.isclass(getattr(public, n))
            }
    return sorted(n for n in found if re.search(r"[a-z][A-Z]|ndarray|NoneType|mappingproxy", n))


PYTHON = re.compile(
    r"\w=['\"]|\b(None|True|False|numpy|Traceback)\b|metrosep\.\w+\(|<class|internal error|\b("
    + "|".join(classes())
    + r")\b"
)


def texts(value, key=""):
    """Give the sentences of an answer: not what the recipe holds, nor where."""
    if isinstance(value, dict):
        for k, inner in value.items():
            if k not in ("recipe", "stored", "keys", "path", "old", "new"):
                yield from texts(inner, k)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from texts(inner, key)
    elif isinstance(value, str):
        yield value


class Page:
    """A page that asks a session; it keeps the sentences that have a word of Python."""

    def __init__(self, answers):
        self.answers, self.talk, self.odd, self.refused = (
            answers,
            _Talk(None, answers, {}, set()),
            {},
            0,
        )

    def ask(self, **message):
        header, _ = self.talk.framed(message, 1, threading.Event(), lambda *_: None)
        if header.get("ok") and message["k"] == "edit":
            self.answers.answer({"k": "undo"})
        said = [t for k in ("error", "failed", "refused", "mends") for t in texts(header.get(k))]
        self.refused += bool(said)
        self.odd |= {t: message for t in said if PYTHON.search(t)}
        return header

    def edit(self, path, new, old=None):
        return self.ask(k="edit", path=path, old=old, new=new)


def page_of(folder, kind):
    """Return a page on a map without scale, on one with it, on runs, or on nothing."""
    answers = Answers(Session(Places([folder])))
    if kind == "runs":
        x = np.linspace(0.0, 50.0, 501)
        noise = np.random.default_rng(3).normal(0.0, 2e-3, (4, x.size))
        z = 2.0 * np.exp(-(((x - 15.0) / 4.0) ** 2)) + noise
        rows = [f"{r},{a:.3f},{b:.6f}" for r in range(4) for a, b in zip(x, z[r], strict=True)]
        (folder / "runs.csv").write_text("\n".join(["run,x_mm,z_um", *rows]) + "\n")
        (folder / "r.toml").write_text(RUNS)
        answers.answer({"k": "open", "path": "r.toml"})
    elif kind != "nothing":
        y, x = np.mgrid[0:60, 0:90]
        step = None if kind == "pixels" else 3e-6
        ms.write(ms.Surface(20e-9 * np.cos(x / 3.0) + 1e-9 * y, step, step), folder / "part.h5")
        answers.answer({"k": "open", "path": "part.h5"})
    return Page(answers)


@pytest.mark.parametrize("kind", ["nothing", "pixels", "map", "runs"])
def test_no_request_is_refused_in_python(tmp_path, kind):
    page = page_of(tmp_path, kind)
    for request in (*KINDS, "nope"):
        for message in REQUESTS:
            page.ask(k=request, **message)
    assert page.refused > 300
    assert page.odd == {}


@pytest.mark.parametrize("kind", ["pixels", "map", "runs"])
def test_no_edit_is_refused_in_python(tmp_path, kind):
    page = page_of(tmp_path, kind)
    n = len(page.answers.session.state()["steps"])
    for op, fields in ALL_STEPS.items():
        if (op in OF_RUNS) == (kind == "runs"):
            for key in fields:
                for bad in BAD:
                    page.edit(["step", n], {"op": op, "op" if key == "op" else key: bad})
    for bad in BAD:
        for key in ("unit", "lateral_step", "row_order", "channel", "x", "z", "scale", "decimal"):
            page.edit(["input", key], bad, page.answers.session.state()["input"].get(key))
        for key in ("number", "measured", "temperature", "persons", "item", "nonsense"):
            page.edit(["report", key], bad)
        for key in ("metric", "upper", "U", "rule", "k"):
            page.edit(["check", 0], {**LIMIT, key: bad})
        for key in ("kind", "a", "b", "width", "name", "centre"):
            page.edit(["section", 0], {**LINE, key: bad})
        for key in (*TABLE, "machine", "direction", "waive", "reference"):
            page.edit(["output", 9], {**TABLE, key: bad})
    assert page.refused > 500
    assert page.odd == {}


def test_no_step_fails_on_a_map_in_python(tmp_path):
    for kind in ("pixels", "map"):
        (tmp_path / kind).mkdir()
        page = page_of(tmp_path / kind, kind)
        for step in (
            {"op": "filter", "cutoff": "30 um"}, {"op": "filter", "cutoff": "30 mm", "end": "cut"},
            {"op": "mask", "aperture": {"shape": "circle", "diameter": "1 um", "centre": ["9 mm", "9 mm"]}},
            {"op": "mask", "aperture": {"shape": "circle", "diameter": "50 um", "centre": "fit"}},
            {"op": "psd", "limit": "rms = 5 nm from 10 um to 50 um"}, {"op": "form", "form": "sphere: R=50 mm"}, {"op": "form", "form": "qforbes: radius=1 um"},
            {"op": "step_height", "upper": {"shape": "circle", "diameter": "1 um", "centre": ["9 mm", "9 mm"]},
             "lower": {"shape": "circle", "diameter": "1 um", "centre": ["9 mm", "9 mm"]}},
            {"op": "parameters", "names": ["Ra"]},
        ):  # fmt: skip
            page.answers.answer({"k": "edit", "path": ["step", 2], "old": None, "new": step})
            page.ask(k="metrics", level="full")
            page.answers.answer({"k": "undo"})
        assert page.odd == {}


def test_no_table_is_refused_in_python(tmp_path):
    page = page_of(tmp_path, "runs")
    for name in names():
        facts = {o.name: "10 nm" for o in find(name).options if o.required}
        for more in ({}, {"machine": facts}, {"machine": {"max_points": 2}}):
            for direction in ("auto", "both", "split", "reverse"):
                for axis in "XZ":
                    draft = {
                        **TABLE,
                        "controller": name,
                        "direction": direction,
                        "compensates": axis,
                        **more,
                    }
                    page.ask(k="table", draft=draft)
    assert page.refused > 300
    assert page.odd == {}


def said_by(words):
    """Return the lines of a command on standard error."""
    said = io.StringIO()
    with (
        contextlib.redirect_stderr(said),
        contextlib.redirect_stdout(io.StringIO()),
        pytest.raises(SystemExit),
    ):
        command_line.main(words)
    return said.getvalue().splitlines()


@pytest.mark.parametrize("verb", sorted(set(command_line._HOMES) - set(LOADING)))
def test_no_verb_is_refused_in_python(tmp_path, monkeypatch, verb):
    monkeypatch.chdir(tmp_path)
    for kind in ("map", "runs"):
        page_of(tmp_path, kind)
    (tmp_path / "bad.csv").write_text("a,b\n1,2\n3,x\n")
    (tmp_path / "none.csv").write_text("")
    (tmp_path / "t.csv").write_text("x,z\n1,2\n2,3\n3,4\n")
    files = ("runs.csv", "part.h5", "bad.csv", "none.csv", "gone.csv", "r.toml", "t.csv")
    calls = [
        [verb],
        *([verb, f] for f in files),
        *([verb, f, "t.csv"] for f in ("mill_xyz", "part.h5")),
    ]
    command = command_line.cli.get_command(click.Context(command_line.cli), verb)
    for option in command.params:
        if isinstance(option, click.Option) and not option.is_flag and option.name != "out":
            name = max(option.opts, key=len)
            calls += [[verb, f, name, bad] for f in ("runs.csv", "part.h5") for bad in TYPED]
            calls += [[verb, "mill_xyz", "t.csv", name, bad] for bad in TYPED]
    odd = {line: words for words in calls for line in said_by(words) if PYTHON.search(line)}
    assert odd == {}

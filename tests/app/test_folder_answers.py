"""The recipe of a session on every file of a folder."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, ReadError, WriteError

LIMIT = 1e-6
"""Upper limit of P-V: parts of 0.5 um and 2 um lie far on either side."""


def part(path, amplitude):
    z = amplitude / 2 * np.cos(2 * np.pi * np.arange(40) / 8)[None, :] * np.ones((30, 1))
    ms.write(ms.Surface(z, 1e-4, 1e-4), path)
    return path


@pytest.fixture
def folder(tmp_path):
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    for name, amplitude in (("good", 0.5e-6), ("bad", 2e-6), ("open", 0.4e-6)):
        part(inbox / f"{name}.x3p", amplitude)
    (inbox / "torn.x3p").write_bytes((inbox / "good.x3p").read_bytes()[:300])
    (inbox / "notes.txt").write_text("not a measurement")
    return inbox


def session_on(folder, *, limit=True):
    session = Session(Places([folder.parent]))
    answers = Answers(session)
    answers.answer({"k": "open", "path": str(folder / "open.x3p")})
    if limit:
        check = {"metric": "Sz", "upper": "1 um", "U": "10 nm"}
        answers.answer({"k": "edit", "path": ["check", 0], "old": None, "new": check})
    return answers


def test_each_file_is_judged_as_alone(folder, tmp_path):
    answers, told = session_on(folder), []
    header, _ = answers.answer(
        {"k": "run_folder", "folder": str(folder), "out": str(tmp_path / "qa"), "workers": 1},
        tell=told.append,
    )
    status = {row["unit"]: row["status"] for row in header["rows"]}
    assert status == {
        "bad.x3p": "rejected", "good.x3p": "accepted", "open.x3p": "accepted", "torn.x3p": "failed"
    }  # fmt: skip
    assert [t["batch"]["done"] for t in told if "batch" in t] == [1, 2, 3, 4]
    assert {t["batch"]["total"] for t in told if "batch" in t} == {4}
    alone, _ = answers.answer({"k": "metrics", "level": "full"})
    value = next(c["value"] for c in alone["checks"] if c["metric"] == "Sz")
    row = next(r for r in header["rows"] if r["unit"] == "open.x3p")
    assert next(c["value"] for c in row["characteristics"] if c["metric"] == "Sz") == value
    assert any(f.endswith("index.json") for f in header["files"])
    stored = json.loads((tmp_path / "qa" / row["link"]).read_text())
    assert stored["verdict"] == "accept"


def test_session_keeps_its_own_recipe(folder, tmp_path):
    answers = session_on(folder)
    before = answers.session.state()["recipe"]
    answers.answer(
        {
            "k": "run_folder",
            "folder": str(folder),
            "out": str(tmp_path / "qa"),
            "scheduler": "serial",
        }
    )
    assert answers.session.state()["recipe"] == before
    assert 'files = ["open.x3p"]' in before


def test_second_run_does_nothing_twice_and_a_list_writes_nothing(folder, tmp_path):
    answers = session_on(folder)
    ask = {
        "k": "run_folder",
        "folder": str(folder),
        "out": str(tmp_path / "qa"),
        "scheduler": "serial",
    }
    listed, _ = answers.answer({**ask, "dry_run": True})
    assert len(listed["rows"]) == 4
    assert not (tmp_path / "qa").exists()
    answers.answer(ask)
    again, _ = answers.answer(ask)
    assert sum(bool(r["skipped"]) for r in again["rows"]) >= 3


def test_stopping_keeps_what_is_done(folder, tmp_path):
    answers, told = session_on(folder), []
    header, _ = answers.answer(
        {
            "k": "run_folder",
            "folder": str(folder),
            "out": str(tmp_path / "qa"),
            "scheduler": "serial",
        },
        cancel=lambda: len(told) >= 1,
        tell=told.append,
    )
    assert header["stopped"]
    assert 1 <= len(header["rows"]) < 4
    assert list((tmp_path / "qa").rglob("result.json")) or list(
        (tmp_path / "qa").rglob("failed.json")
    )


@pytest.mark.parametrize(
    ("changed", "error", "words"),
    [
        ({"folder": "/"}, ReadError, "outside"),
        ({"folder": "nowhere"}, ReadError, "no such folder"),
        ({"out": "/elsewhere"}, WriteError, "outside"),
        ({"pattern": "../*.x3p"}, DataError, "pattern"),
        ({"pattern": "*.none"}, ReadError, "no file"),
        ({"workers": True}, DataError, "workers"),
        ({"out": None}, DataError, "out"),
    ],
)
def test_what_cannot_be_is_refused_in_words(folder, tmp_path, changed, error, words):
    answers = session_on(folder, limit=False)
    ask = {"k": "run_folder", "folder": str(folder), "out": str(tmp_path / "qa")}
    with pytest.raises(error, match=words):
        answers.answer({**ask, **changed})
    assert not (tmp_path / "qa").exists()


def test_files_that_hold_their_runs_are_not_pooled(tmp_path):
    # two machines whose errors cancel: together they would look perfect
    rng = np.random.default_rng(3)
    x = np.arange(0.0, 20.0, 0.05)
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    for name, sign in (("m1", 1.0), ("m2", -1.0)):
        rows = ["run,x_mm,z_um"]
        for k in range(3):
            z = sign * 2.0 * np.exp(-(((x - 8.0) / 3.0) ** 2)) + 0.002 * rng.standard_normal(
                x.size
            )
            rows += [f"{k},{a:.3f},{b:.5f}" for a, b in zip(x, z, strict=True)]
        (inbox / f"{name}.csv").write_text("\n".join(rows) + "\n")
    (inbox / "r.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["m1.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\n'
    )
    answers = Answers(Session(Places([tmp_path])))
    answers.answer({"k": "open", "path": str(inbox / "r.toml")})
    header, _ = answers.answer(
        {
            "k": "run_folder",
            "folder": str(inbox),
            "out": str(tmp_path / "qa"),
            "scheduler": "serial",
        }
    )
    values = {
        row["unit"]: next(c["value"] for c in row["characteristics"] if c["metric"] == "pv")
        for row in header["rows"]
    }
    assert set(values) == {"m1.csv", "m2.csv"}
    assert min(values.values()) > 1e-6

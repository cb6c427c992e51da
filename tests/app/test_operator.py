"""Operator mode without a browser: which file is taken, what is kept, and what is refused."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from metrosep.app.operator import Operation, make_operator_app
from metrosep.core.errors import DataError, ReadError
from metrosep.core.surface import Surface
from metrosep.io.write import write

RECIPE = """metrosep = 1
title = "Flat"
[input]
files = ["*.x3p"]
[[step]]
op = "parameters"
names = ["Sz"]
[[check]]
metric = "Sz"
upper = "100 nm"
U = "5 nm"
[operator]
reasons = ["dust", "scratch"]
"""
TOKEN = "secret"  # noqa: S105
SECONDS = 2.0
"""Longer than a file must rest."""


def part(inbox: Path, name: str, height: float, *, age: int = 0) -> Path:
    """Write a measurement of a height; `age` in seconds makes it older than others."""
    z = np.zeros((12, 15))
    z[3, 4] = height
    file = inbox / name
    write(Surface(z, 1e-6, 1e-6), file)
    at = file.stat().st_mtime_ns - age * 1_000_000_000
    os.utime(file, ns=(at, at))
    return file


class Shift:
    """An operation with a clock that the test turns."""

    def __init__(self, root: Path, text: str = RECIPE, **options: Any) -> None:
        self.now = 0.0
        self.inbox, self.out = root / "inbox", root / "out"
        self.inbox.mkdir(exist_ok=True)
        self.out.mkdir(exist_ok=True)
        (root / "flat.toml").write_text(text)
        self.of = Operation(
            root / "flat.toml", self.inbox, self.out, clock=lambda: self.now, **options
        )

    def rest(self) -> None:
        self.of.waiting()
        self.now += SECONDS

    def do(self, what: str, text: str = "") -> dict[str, Any]:
        return self.of.act({"do": what, "text": text})


@pytest.fixture
def shift(tmp_path: Path) -> Shift:
    made = Shift(tmp_path)
    made.do("name", "A. Weber")
    return made


def test_the_newest_whole_file_is_measured_and_filed(shift: Shift) -> None:
    part(shift.inbox, "old.x3p", 30e-9, age=60)
    part(shift.inbox, "new.x3p", 50e-9)
    shift.rest()
    state = shift.do("measure", "A-17")
    assert state["part"]["verdict"] == "accept"
    assert state["part"]["file"] == "new.x3p"
    document = json.loads((shift.out / "A-17" / "result.json").read_text())
    assert document["report"]["item"]["serial"] == "A-17"
    assert document["report"]["persons"]["measured"] == "A. Weber"
    kept = json.loads((shift.out / "A-17" / "operator.json").read_text())
    assert (kept["serial"], kept["operator"], kept["verdict"]) == ("A-17", "A. Weber", "accept")
    assert shift.do("next")["part"] is None
    assert shift.do("measure", "A-18")["part"]["file"] == "old.x3p"  # the other one is done


def test_a_file_that_still_grows_is_left_alone(shift: Shift) -> None:
    whole = part(shift.inbox, "a.x3p", 10e-9)
    content = whole.read_bytes()
    whole.write_bytes(content[:100])
    shift.rest()
    whole.write_bytes(content)
    with pytest.raises(DataError, match="No new measurement"):
        shift.do("measure", "1")
    shift.now += SECONDS
    assert shift.do("measure", "1")["part"]["verdict"] == "accept"


def test_what_is_no_file_of_the_inbox_is_not_taken(shift: Shift, tmp_path: Path) -> None:
    outside = part(tmp_path, "secret.x3p", 10e-9)
    (shift.inbox / "link.x3p").symlink_to(outside)
    os.mkfifo(shift.inbox / "pipe.x3p")
    (shift.inbox / "folder.x3p").mkdir()
    part(shift.inbox, "a.sdf", 10e-9)  # not what the recipe reads
    shift.rest()
    assert shift.of.waiting() == []


@pytest.mark.parametrize("height", [150e-9, 102e-9])
def test_a_part_that_is_not_accepted_needs_one_of_the_reasons(shift: Shift, height: float) -> None:
    part(shift.inbox, "a.x3p", height)
    shift.rest()
    found = shift.do("measure", "7")["part"]
    assert found["verdict"] == ("reject" if height > 105e-9 else "inconclusive")
    assert [r["metric"] for r in found["rows"]] == ["Sz"]
    for what, text, said in (
        ("next", "", "Say why"),
        ("reason", "bad mood", "Choose one"),
        ("measure", "8", "still shown"),
    ):
        with pytest.raises(DataError, match=said):
            shift.do(what, text)
    assert shift.do("reason", "scratch")["part"]["needs_reason"] is False
    assert json.loads((shift.out / "7" / "operator.json").read_text())["reason"] == "scratch"
    assert shift.do("next")["part"] is None


def test_a_serial_that_was_seen_is_a_second_measurement_after_a_new_start_too(
    shift: Shift, tmp_path: Path
) -> None:
    part(shift.inbox, "a.x3p", 10e-9)
    shift.rest()
    shift.do("measure", "7")
    again = Shift(tmp_path)
    again.do("name", "B. Ito")
    again.rest()
    assert again.of.waiting() == []  # what was measured yesterday is not measured again
    part(again.inbox, "b.x3p", 20e-9)
    again.rest()
    found = again.do("measure", "7")["part"]
    assert (found["number"], found["folder"]) == (2, "7_2")
    assert (again.out / "7" / "result.json").is_file()


@pytest.mark.parametrize("serial", ["", "../x", "a/b", ".hidden", "A 1", "x" * 65, "a\nb", "é"])
def test_a_serial_that_is_none_is_refused(shift: Shift, serial: str) -> None:
    part(shift.inbox, "a.x3p", 10e-9)
    shift.rest()
    with pytest.raises(DataError, match="is not a serial number"):
        shift.do("measure", serial)
    assert list(shift.out.iterdir()) == []


def test_a_pattern_that_lets_a_path_through_still_leads_nowhere(tmp_path: Path) -> None:
    shift = Shift(tmp_path, serial=".*")
    shift.do("name", "A")
    part(shift.inbox, "a.x3p", 10e-9)
    shift.rest()
    for serial in ("../../x", "..", "a/b"):
        with pytest.raises(DataError, match="name of a folder"):
            shift.do("measure", serial)


def test_nobody_measures_without_a_name_or_with_a_changed_recipe(
    shift: Shift, tmp_path: Path
) -> None:
    part(shift.inbox, "a.x3p", 150e-9)
    shift.rest()
    other = Shift(tmp_path)
    with pytest.raises(DataError, match="name first"):
        other.do("measure", "1")
    (tmp_path / "flat.toml").write_text(RECIPE.replace("100 nm", "900 nm"))
    with pytest.raises(DataError, match="changed since the start"):
        shift.do("measure", "1")
    assert list(shift.out.iterdir()) == []


def test_what_cannot_work_is_refused_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="judges nothing"):
        Shift(tmp_path, RECIPE[: RECIPE.index("[[check]]")])
    with pytest.raises(DataError, match="not a regular expression"):
        Shift(tmp_path, serial="(")
    with pytest.raises(DataError, match="same folder"):
        Operation(tmp_path / "flat.toml", tmp_path / "inbox", tmp_path / "inbox")
    with pytest.raises(ReadError, match="no such folder"):
        Operation(tmp_path / "flat.toml", tmp_path / "nothing", tmp_path / "out")


def test_the_application_has_no_other_way_in_or_out(shift: Shift) -> None:
    app = make_operator_app(shift.of, port=8899, token=TOKEN)
    client = TestClient(app, base_url="http://127.0.0.1:8899")
    assert client.get("/").status_code == 403
    page = client.get("/?token=secret")
    assert "Serial number" in page.text
    assert "default-src 'none'" in page.headers["content-security-policy"]
    assert client.get("/state").json()["operator"] == "A. Weber"  # by the cookie
    for path in ("/ws", "/upload", "/static/app.js", "/static/../server.py", "/static/index.html"):
        assert client.get(path).status_code == 404
    answer = client.post("/act", json={"do": "edit", "text": "x"})
    assert answer.status_code == 400
    assert "no request 'edit'" in answer.json()["message"]
    for body in (b"[]", b"{", b"x" * 20_000):
        assert client.post("/act", content=body).status_code == 400
    other = TestClient(app, base_url="http://evil.example:8899")
    assert other.get("/?token=secret").status_code == 403

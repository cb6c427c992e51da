"""Operator mode without a browser: which file is taken, what is kept, and what is refused."""

from __future__ import annotations

import asyncio
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from metrosep.app.operator import Operation, make_operator_app
from metrosep.core.errors import DataError, MetrosepError, ReadError
from metrosep.core.surface import Surface
from metrosep.io.write import write
from metrosep.recipe.recipe import Recipe

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
        """Ask as the page does: with the file that it shows now."""
        return self.of.act({"do": what, "text": text, "file": self.of.state()["file"]})

    def arrives(self, name: str, height: float, *, age: int = 0) -> dict[str, Any] | None:
        """Give what the page shows once a measurement is in the inbox and rests."""
        part(self.inbox, name, height, age=age)
        self.rest()
        shown: dict[str, Any] | None = self.of.state()["file"]
        return shown

    def measure(self, serial: str, shown: object) -> dict[str, Any]:
        return self.of.act({"do": "measure", "text": serial, "file": shown})

    def held(self, folder: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.out / folder / "operator.json").read_text())
        return found


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


@pytest.mark.parametrize("age", [-60, 60])
def test_the_file_that_the_page_showed_is_judged_whatever_arrives_next(
    shift: Shift, age: int
) -> None:
    shown = shift.arrives("A.x3p", 50e-9)
    later = shift.arrives("B.x3p", 180e-9, age=age)  # newer than A, and older
    assert later is not None
    assert later["name"] == ("B.x3p" if age < 0 else "A.x3p")
    assert shift.of.state()["waiting"] == 2
    found = shift.measure("SERIAL-A", shown)["part"]
    assert (found["file"], found["verdict"]) == ("A.x3p", "accept")
    assert shift.do("next")["file"]["name"] == "B.x3p"
    found = shift.do("measure", "SERIAL-B")["part"]
    assert (found["file"], found["verdict"]) == ("B.x3p", "reject")
    assert [shift.held(s)["file"] for s in ("SERIAL-A", "SERIAL-B")] == ["A.x3p", "B.x3p"]


def test_a_file_that_is_another_one_by_now_is_not_judged(shift: Shift) -> None:
    shown = shift.arrives("A.x3p", 50e-9)
    shift.arrives("A.x3p", 180e-9, age=-5)  # the next part, under the same name
    with pytest.raises(DataError, match=r"A\.x3p changed since it was shown.*scan again"):
        shift.measure("A", shown)
    shown = shift.of.state()["file"]
    (shift.inbox / "A.x3p").unlink()
    with pytest.raises(DataError, match="no longer there"):
        shift.measure("A", shown)
    shift.arrives("B.x3p", 50e-9)
    for nothing, said in ((None, "has just arrived"), ("B.x3p", "load it again"), ({}, "load")):
        with pytest.raises(DataError, match=said):
            shift.measure("A", nothing)
    assert list(shift.out.iterdir()) == []


def test_a_file_that_changes_while_it_is_measured_is_not_filed(
    shift: Shift, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = shift.arrives("A.x3p", 50e-9)
    run = Recipe.run

    def while_it_runs(*args: Any, **options: Any) -> Any:
        result = run(*args, **options)
        part(shift.inbox, "A.x3p", 180e-9, age=-5)
        return result

    monkeypatch.setattr(Recipe, "run", while_it_runs)
    with pytest.raises(DataError, match="changed while it was measured"):
        shift.measure("A", shown)
    assert list(shift.out.iterdir()) == []


def test_a_file_that_cannot_be_read_holds_up_no_part(tmp_path: Path) -> None:
    shift = Shift(tmp_path, RECIPE.replace('"*.x3p"', '"*"'))
    shift.do("name", "A")
    (shift.inbox / "notes.txt").write_text("hello\n")
    part(shift.inbox, "old.x3p", 50e-9, age=60)
    shift.rest()
    assert shift.of.state()["file"]["name"] == "notes.txt"
    with pytest.raises(MetrosepError, match=r"notes\.txt"):
        shift.do("measure", "7")
    assert list(shift.out.iterdir()) == []
    state = shift.of.state()
    assert (state["file"]["name"], state["failed"]) == ("old.x3p", ["notes.txt"])
    assert shift.do("measure", "7")["part"]["verdict"] == "accept"
    assert shift.do("next")["file"]["name"] == "notes.txt"  # left, and still named
    (shift.inbox / "old.x3p").replace(shift.inbox / "notes.txt")  # a measurement is taken
    shift.rest()
    assert shift.of.state()["failed"] == []


def test_files_that_the_recipe_does_not_take_are_named(tmp_path: Path) -> None:
    shift = Shift(tmp_path, RECIPE.replace('"*.x3p"', '"measured/map.x3p"'))
    shift.do("name", "A")
    assert "takes only" not in shift.of.state()["idle"]
    shift.arrives("D.x3p", 50e-9)
    said = r"No new measurement.*takes only map\.x3p.*D\.x3p"
    assert re.search(said, shift.of.state()["idle"])
    with pytest.raises(DataError, match=said):
        shift.do("measure", "7")


def test_a_reason_that_is_owed_is_owed_after_a_new_start(shift: Shift, tmp_path: Path) -> None:
    shift.arrives("a.x3p", 150e-9)
    before = shift.do("measure", "7")["part"]
    again = Shift(tmp_path)
    assert again.of.state()["part"] == before  # its rows too
    again.do("name", "B. Ito")
    again.arrives("b.x3p", 50e-9)
    for what, said in (("next", "Say why"), ("measure", "still shown")):
        with pytest.raises(DataError, match=said):
            again.do(what, "8")
    again.do("reason", "dust")
    held = again.held("7")
    assert (held["operator"], held["reason"]) == ("A. Weber", "dust")  # the one who measured it
    assert again.do("next")["part"] is None
    assert Shift(tmp_path).of.state()["part"] is None


def test_a_reason_is_not_taken_before_it_is_on_the_disk(
    shift: Shift, monkeypatch: pytest.MonkeyPatch
) -> None:
    shift.arrives("a.x3p", 150e-9)
    shift.do("measure", "7")
    monkeypatch.setattr("metrosep.app.operator.atomic_write", full_disk)
    with pytest.raises(OSError, match="No space"):
        shift.do("reason", "dust")
    assert shift.of.state()["part"]["needs_reason"]


def full_disk(*_: Any, **__: Any) -> None:
    raise OSError(28, "No space left on device")


def test_what_goes_wrong_is_said_in_a_sentence(
    shift: Shift, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = make_operator_app(shift.of, port=8899, token=TOKEN)
    client = TestClient(app, base_url="http://127.0.0.1:8899", raise_server_exceptions=False)
    client.get("/?token=secret")
    asked = {"do": "measure", "text": "7", "file": shift.arrives("a.x3p", 50e-9)}
    with monkeypatch.context() as patch:
        patch.setattr("metrosep.app.operator.atomic_write", full_disk)
        answer = client.post("/act", json=asked)
    assert answer.status_code == 500
    assert "No space left on device" in answer.json()["message"]
    assert list(shift.out.iterdir()) == []  # no half of a result
    assert shift.of.state()["failed"] == []  # the file is well

    def fault(*_: Any, **__: Any) -> None:
        raise ValueError("math domain error")

    with monkeypatch.context() as patch:
        patch.setattr(Recipe, "run", fault)
        answer = client.post("/act", json=asked)
    assert answer.status_code == 500
    assert "internal error (ValueError: math domain error)" in answer.json()["message"]
    for body, said in (
        (b'{"do": ["measure"]}', "no request ['measure']"),
        (b"{", "not JSON"),
        (b"\xff", "not JSON"),
        (b"[]", "an object"),
        (b"x" * 10_001, "10000 bytes"),
    ):
        answer = client.post("/act", content=body)
        assert answer.status_code == 400
        assert said in answer.json()["message"]
    assert client.post("/act", json=asked).json()["part"]["folder"] == "7"


def test_a_request_that_is_too_long_is_not_read_to_its_end(shift: Shift) -> None:
    app = make_operator_app(shift.of, port=8899, token=TOKEN)
    client = TestClient(app, base_url="http://127.0.0.1:8899")
    client.get("/?token=secret")
    cookies = "; ".join(f"{k}={v}" for k, v in client.cookies.items())
    read: list[int] = []

    async def receive() -> dict[str, Any]:
        read.append(4096)
        return {"type": "http.request", "body": b"x" * 4096, "more_body": len(read) < 100}

    async def send(_: Any) -> None:
        return None

    headers = [(b"host", b"127.0.0.1:8899"), (b"cookie", cookies.encode())]
    scope = {
        "type": "http", "method": "POST", "path": "/act", "query_string": b"", "headers": headers,
    }  # fmt: skip
    asyncio.run(app(scope, receive, send))
    assert sum(read) <= 3 * 4096


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


@pytest.mark.skipif(os.name == "nt", reason="links need a right there")
def test_a_link_that_is_laid_while_it_is_measured_is_not_read(
    shift: Shift, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outside = part(tmp_path, "secret.x3p", 50e-9)
    shown = shift.arrives("A.x3p", 50e-9)
    run, tried = Recipe.run, []

    def after_a_link(*args: Any, **options: Any) -> Any:
        (shift.inbox / "A.x3p").unlink()
        (shift.inbox / "A.x3p").symlink_to(outside)
        tried.append(1)
        return run(*args, **options)

    monkeypatch.setattr(Recipe, "run", after_a_link)
    with pytest.raises(MetrosepError, match="leads out of the folders"):
        shift.measure("A", shown)
    assert tried
    assert list(shift.out.iterdir()) == []


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


@pytest.mark.parametrize(
    "stated",
    [
        '[operator]\nreasons = ["dust"]\n',
        '[operator]  # [check]\nreasons = [\n  "[view]",\n  "dust",\n]\n',
        '[report]\nnumber = "7"\n[operator]\nreasons = ["dust"]\n[report.item]\nserial = "9"\n',
    ],
)
def test_what_an_operator_may_choose_from_is_outside_the_hash(stated: str) -> None:
    plain = RECIPE[: RECIPE.index("[operator]")]
    bare = Recipe.parse(plain).recorded
    assert Recipe.parse(plain + stated).recorded == bare
    assert Recipe.parse(plain.replace("[input]", stated + "[input]")).recorded == bare
    assert Recipe.parse(plain.replace("100 nm", "101 nm") + stated).recorded != bare
    inline = 'operator = {reasons = ["dust"]}\n'  # not a table of its own: it stays
    both = Recipe.parse(inline + plain + '[report]\nnumber = "7"\n').recorded
    assert both["text"] == inline + plain


def test_record_and_result_name_the_same_recipe(shift: Shift) -> None:
    shift.arrives("a.x3p", 50e-9)
    shift.do("measure", "7")
    result = json.loads((shift.out / "7" / "result.json").read_text())
    assert shift.held("7")["recipe_sha256"] == result["recipe"]["sha256"]
    assert result["recipe"]["sha256"].startswith(shift.of.state()["hash"])


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


def test_a_recipe_without_a_report_files_one_all_the_same(shift: Shift) -> None:
    part(shift.inbox, "a.x3p", 50e-9)
    shift.rest()
    shift.do("measure", "A-1")
    made = {path.name for path in (shift.out / "A-1").iterdir()}
    assert {"result.json", "operator.json"} < made
    assert [name for name in made if name.endswith(".html")]
    document = json.loads((shift.out / "A-1" / "result.json").read_text())
    assert document["recipe"]["sha256"] == shift.of.recipe.recorded["sha256"]


def test_what_a_halt_leaves_behind_takes_no_name_of_a_part(tmp_path: Path) -> None:
    """The server is killed while it measures: the part is the first of its name after the start."""
    made = Shift(tmp_path)
    made.do("name", "A. Weber")
    part(made.inbox, "a.x3p", 50e-9)
    made.rest()
    run = Recipe.run

    def killed(*_args: Any, **_options: Any) -> Any:
        os._exit(9)

    pid = os.fork()
    if pid == 0:
        Recipe.run = killed  # type: ignore[method-assign]
        try:
            made.do("measure", "CON-1")
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 9
    assert Recipe.run is run
    assert not (tmp_path / "out" / "CON-1").exists()
    foreign = tmp_path / "out" / ".measuring.0a1b2c-1f-00000000.tmp"  # of another machine
    foreign.mkdir()
    assert len(list((tmp_path / "out").iterdir())) == 2
    again = Shift(tmp_path)
    assert list((tmp_path / "out").iterdir()) == [foreign]
    again.do("name", "A. Weber")
    again.rest()
    state = again.do("measure", "CON-1")
    assert (state["part"]["folder"], state["part"]["number"]) == ("CON-1", 1)
    assert (tmp_path / "out" / "CON-1" / "result.json").is_file()


def test_a_second_start_leaves_alone_what_is_being_measured(tmp_path: Path) -> None:
    made = Shift(tmp_path)
    made.do("name", "A. Weber")
    part(made.inbox, "a.x3p", 50e-9)
    made.rest()
    run = Recipe.run

    def beside(self: Recipe, *args: Any, **options: Any) -> Any:
        Shift(tmp_path)
        assert len(list((tmp_path / "out").iterdir())) == 1
        return run(self, *args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recipe, "run", beside)
        assert made.do("measure", "CON-1")["part"]["folder"] == "CON-1"
    assert [one.name for one in (tmp_path / "out").iterdir()] == ["CON-1"]


def test_an_accepted_part_shows_its_values(shift: Shift) -> None:
    part(shift.inbox, "a.x3p", 50e-9)
    shift.rest()
    (row,) = shift.do("measure", "A-1")["part"]["rows"]
    assert (row["metric"], row["verdict"]) == ("Sz", "accept")
    assert row["value"] == pytest.approx(50e-9, abs=1e-12)

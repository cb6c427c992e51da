"""Two pages on one session, sets that are dropped, slow and full disks, and what a page may not."""

import json
import threading
import time

import numpy as np
import pytest
from starlette.testclient import TestClient

import metrosep as ms
from metrosep.app import server
from metrosep.app.documents import Places
from metrosep.app.opening import autosave_path
from metrosep.app.sessions import Keeper
from metrosep.app.wire import page_words, unpack
from metrosep.core.errors import WriteError

PORT, TOKEN = 8124, "s" * 43
HOST = {"host": f"127.0.0.1:{PORT}"}
SLOW = 2.0
"""Seconds of a slow disk."""


@pytest.fixture
def part(tmp_path):
    y, x = np.mgrid[0:40, 0:50] * 1e-3
    ms.write(ms.Surface(1e-4 * x + 1e-6 * np.cos(300 * y), 1e-3, 1e-3), tmp_path / "p.x3p")
    return tmp_path / "p.x3p"


def client(folder, *first, **more):
    places = Places([folder], **more)
    app = server.make_app(places, port=PORT, token=TOKEN, first=[str(f) for f in first])
    return TestClient(app, base_url=f"http://127.0.0.1:{PORT}")


class Page:
    def __init__(self, http):
        self.context = http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST)
        self.number, self.news = 0, []

    def __enter__(self):
        self.socket = self.context.__enter__()
        return self

    def __exit__(self, *problem):
        return self.context.__exit__(*problem)

    def send(self, k, **message):
        self.number += 1
        self.socket.send_text(json.dumps({"id": self.number, "k": k, **message}))
        return self.number

    def take(self):
        return unpack(self.socket.receive_bytes())[0]

    def ask(self, k, **message):
        """Return the answer; what came before it without an id is kept."""
        number = self.send(k, **message)
        while (header := self.take()).get("id") != number:
            self.news.append(header)
        return header

    def ok(self, k, **message):
        header = self.ask(k, **message)
        assert header["ok"], header
        return header

    def refused(self, k, **message):
        header = self.ask(k, **message)
        assert not header["ok"]
        return header["error"]["message"]

    def heard(self, k):
        """Return the next news of a kind."""
        for header in self.news:
            if header["k"] == k:
                self.news.remove(header)
                return header
        while (header := self.take())["k"] != k:
            pass
        return header


# ---- two pages ---------------------------------------------------------------------------------


def test_what_one_page_changes_the_other_shows(part):
    with client(part.parent, part) as http, Page(http) as one, Page(http) as two:
        said = one.ok("edit", path=["title"], old="p", new="by one")["session"]
        heard = two.heard("session")["session"]
        assert heard["title"] == "by one"
        assert heard["hash"] == said["hash"]
        two.ok("undo")
        assert one.heard("session")["session"]["title"] == "p"


def test_an_outdated_edit_is_refused_and_the_page_may_go_on(part):
    with client(part.parent, part) as http, Page(http) as one, Page(http) as two:
        one.ok("edit", path=["step", 0, "form"], old="plane", new="sphere: R=50 mm")
        words = two.refused("edit", path=["step", 0, "form"], old="plane", new="cylinder: R=50 mm")
        assert "sphere: R=50 mm" in words
        assert "reload the page" in words
        now = two.ok("hello")["session"]["recipe"]
        assert "sphere" in now
        two.ok("edit", path=["step", 0, "form"], old="sphere: R=50 mm", new="plane")


def test_a_file_that_one_page_opens_is_that_of_the_other(part):
    other = part.with_name("q.x3p")
    other.write_bytes(part.read_bytes())
    with client(part.parent, part) as http, Page(http) as one, Page(http) as two:
        one.ok("open", path=str(other))
        assert two.heard("session")["session"]["files"] == [str(other)]


def test_a_page_that_is_closed_disturbs_nobody(part):
    with client(part.parent, part) as http, Page(http) as one:
        with Page(http) as two:
            two.send("metrics", level="full")
        one.ok("edit", path=["title"], old="p", new="still here")


# ---- what is dropped ---------------------------------------------------------------------------


def drop(http, name, content, **headers):
    names = {"x-file-name": name, **{k.replace("_", "-"): v for k, v in headers.items()}}
    return http.post(f"/upload?token={TOKEN}", content=content, headers={**HOST, **names})


ROWS = {
    f"r{run}.csv": "x_mm,z_um\n" + "".join(f"{i / 10:g},{(i + run) % 7}\n" for i in range(100))
    for run in range(3)
}


def test_files_dropped_together_are_one_set(tmp_path):
    with client(tmp_path) as http, Page(http) as page:
        paths = [drop(http, n, t, x_set="abc").json()["path"] for n, t in ROWS.items()]
        refused = page.ask("open", paths=paths)
        fields = {f["name"]: f["value"] for f in refused["error"]["ask"]["fields"]}
        session = page.ok("open", paths=paths, reading=fields)["session"]
    assert session["kind"] == "runs"
    assert len(session["files"]) == 3


def test_one_name_twice_in_a_set_and_a_wrong_set_are_refused(tmp_path):
    with client(tmp_path) as http:
        assert drop(http, "a.csv", "1,2", x_set="abc").status_code == 200
        twice = drop(http, "a.csv", "1,2", x_set="abc")
        wrong = drop(http, "a.csv", "1,2", x_set="../up")
    assert (twice.status_code, wrong.status_code) == (400, 400)
    assert "already" in twice.json()["error"]["message"]
    assert "letters and digits" in wrong.json()["error"]["message"]


@pytest.mark.parametrize("stated", [True, False])
def test_an_upload_that_is_too_large_is_refused_and_nothing_of_it_stays(tmp_path, stated):
    pieces = b"x" * 1500 if stated else (b"x" * 500 for _ in range(3))
    with client(tmp_path, largest_upload=1000) as http:
        answer = drop(http, "big.x3p", pieces, x_set="abc")
        words = answer.json()["error"]["message"]
        again = drop(http, "big.x3p", b"small", x_set="abc")
    assert answer.status_code == 400
    assert "big.x3p" in words
    assert "metrosep ui FILE" in words
    assert again.status_code == 200  # its name is free: the part that came is gone


def test_an_upload_to_a_full_disk_is_told(tmp_path, monkeypatch):
    def full(*args, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("metrosep.app.documents.tempfile.mkdtemp", full)
    with client(tmp_path) as http:
        answer = drop(http, "a.csv", "1,2")
    assert answer.status_code == 400
    assert "No space left" in answer.json()["error"]["message"]


@pytest.mark.parametrize(
    "name", ["broken.x3p", "broken.sdf", "broken.csv", "broken.toml", "b.datx"]
)
def test_a_corrupt_upload_leaves_what_is_open(part, name):
    with client(part.parent, part) as http, Page(http) as page:
        before = page.ok("hello")["session"]
        path = drop(http, name, b"PK\x03\x04\xff\xfe\x00 no").json()["path"]
        words = page.refused("open", path=path)
        assert name in words
        assert page.ok("hello")["session"] == before


# ---- what goes wrong inside --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (MemoryError(), 4, "memory"),
        (RuntimeError("wheels came off"), 5, "wheels came off"),
        (OSError(5, "Input/output error"), 5, "Input/output"),
    ],
)
def test_the_page_hears_of_every_failure_and_goes_on(part, monkeypatch, error, code, words):
    def fails(*args):
        raise error

    monkeypatch.setattr("metrosep.app.metrics_answers.metrics", fails)
    with client(part.parent, part) as http, Page(http) as page:
        said = page.ask("metrics", level="full")["error"]
        assert (said["code"], words in said["message"]) == (code, True)
        assert "the recipe is kept" in said["message"]
        page.ok("edit", path=["title"], old="p", new="on")


# ---- the disk ----------------------------------------------------------------------------------


def with_disk(monkeypatch, write):
    monkeypatch.setattr("metrosep.app.sessions.Keeper", lambda: Keeper(write))


def test_a_slow_disk_delays_neither_edit_nor_pictures(part, monkeypatch):
    done = threading.Event()

    def slow(path, content):
        time.sleep(SLOW)
        path.write_bytes(content)
        done.set()

    with_disk(monkeypatch, slow)
    with client(part.parent, part) as http, Page(http) as page:
        page.ok("metrics", level="full")
        session = page.ok("edit", path=["title"], old="p", new="slow")["session"]
        page.ok("map", stage=-1, pixels=[50, 40], level="drag")
        page.ok("metrics", level="full")
        assert not done.is_set()  # all of it went on while the disk was busy
        assert session["keeping"] == "waiting"
        news = page.heard("saved")
        assert (news["keeping"], news["messages"]) == ("kept", [])
        assert news["saved_at"] is not None
    assert 'title = "slow"' in autosave_path(part).read_text()


def test_the_end_waits_for_a_slow_disk(part, monkeypatch):
    def slow(path, content):
        time.sleep(SLOW / 2)
        path.write_bytes(content)

    with_disk(monkeypatch, slow)
    with client(part.parent, part) as http, Page(http) as page:
        page.ok("edit", path=["title"], old="p", new="last words")
    assert "last words" in autosave_path(part).read_text()


def test_a_full_disk_is_said_and_the_work_goes_on(part, monkeypatch):
    full = [True]

    def write(path, content):
        if full[0]:
            raise WriteError(f"{path.name}: the disk is full")
        path.write_bytes(content)

    with_disk(monkeypatch, write)
    with client(part.parent, part) as http, Page(http) as page:
        session = page.ok("edit", path=["title"], old="p", new="one")["session"]
        assert session["title"] == "one"
        if session["keeping"] == "waiting":  # a busy computer
            session = page.heard("saved")
        assert session["keeping"] == "failed"
        assert any("not kept" in m and "full" in m for m in session["messages"])
        assert not autosave_path(part).exists()
        full[0] = False
        session = page.ok("edit", path=["title"], old="one", new="two")["session"]
        if session["keeping"] == "waiting":
            session = page.heard("saved")
        assert (session["keeping"], session["messages"]) == ("kept", [])


def test_a_disk_that_cannot_be_written_at_all(part, monkeypatch):
    with_disk(monkeypatch, lambda path, content: (_ for _ in ()).throw(OSError(30, "Read-only")))
    with client(part.parent, part) as http, Page(http) as page:
        session = page.ok("edit", path=["title"], old="p", new="one")["session"]
        if session["keeping"] == "waiting":
            session = page.heard("saved")
        assert any("Read-only" in m for m in session["messages"])
        page.ok("metrics", level="full")


# ---- words -------------------------------------------------------------------------------------


def test_a_step_that_fails_is_said_in_the_words_of_the_page(part):
    from metrosep.errors import MetrosepError
    from metrosep.recipe import Recipe

    short = {"op": "filter", "cutoff": "8 mm", "band": "short"}
    with client(part.parent, part) as http, Page(http) as page:
        edits = [
            {"path": ["step", 2], "old": None, "new": short},
            {"path": ["step", 3], "old": None, "new": short},
            {"path": ["step", 1, "intermediate"], "old": None, "new": True},
        ]
        page.ok("edit", edits=edits)
        failed = page.ok("metrics", level="full")["failed"]
        shown = page.ok("map", stage=3, pixels=[50, 40], level="full")
        page.ok("export", what="recipe", path="r.toml")
    with pytest.raises(MetrosepError) as told:
        Recipe.load(part.with_name("r.toml")).run([part])

    assert failed["index"] == 3
    assert "refilter = true does it all the same" in str(told.value)
    assert "refilter = true does it all the same" in failed["message"]
    assert "Python" not in failed["message"]
    assert shown["failed"] == 3  # the map before it, and the page says which step failed
    assert page_words(str(told.value)).endswith(failed["message"])


def test_a_separation_that_fails_is_said_as_the_command_line_says_it_without_keys(tmp_path):
    from metrosep.cli.jobs import recipe_words
    from metrosep.errors import MetrosepError
    from metrosep.recipe import Recipe

    rows = [f"{run},{i / 10:g},{(i * i + run) % 7}" for run in range(3) for i in range(200)]
    (tmp_path / "a.csv").write_text("run,x_mm,z_um\n" + "\n".join(rows))
    text = (
        'metrosep = 1\n[input]\nfiles = ["a.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        '[[step]]\nop = "separate"\nmethod = "joint"\n'
    )
    (tmp_path / "r.toml").write_text(text)
    with client(tmp_path, tmp_path / "r.toml") as http, Page(http) as page:
        words = page.refused("metrics", level="full")
    recipe = Recipe.load(tmp_path / "r.toml")
    with pytest.raises(MetrosepError) as told:
        recipe.run()
    said = recipe_words(recipe, str(told.value))
    assert words == page_words(said)
    assert " = " in said
    assert " = " not in words


def test_a_browser_may_come_before_the_server_is_at_work():
    """The address was once printed before anything listened: a quick browser was refused."""
    import socket

    from metrosep.cli.workbench import _listener

    with _listener(0) as listener, socket.create_connection(listener.getsockname(), timeout=5):
        pass

"""The server: who may talk to it, what it answers, and that nothing is lost."""

import json
import tomllib

import numpy as np
import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.opening import autosave_path, text_of_session
from metrosep.app.server import Answers, make_app
from metrosep.app.sessions import Session
from metrosep.app.wire import unpack

PORT, TOKEN = 8123, "t" * 43
HOST = {"host": f"127.0.0.1:{PORT}"}


@pytest.fixture
def part(tmp_path):
    """+3 um at (12, 30) mm on a tilted plane, 51 x 41 pixels of 1 mm; one hole."""
    x, y = np.meshgrid(np.arange(51) * 1e-3, np.arange(41) * 1e-3)
    z = 3e-6 * np.exp(-(((x - 12e-3) / 4e-3) ** 2) - ((y - 30e-3) / 4e-3) ** 2) + 1e-4 * x
    z[5, 40] = np.nan
    path = tmp_path / "part.x3p"
    ms.write(ms.Surface(z, 1e-3, 1e-3), path)
    return path


def client(folder, first=()):
    app = make_app(Places([folder]), port=PORT, token=TOKEN, first=first)
    return TestClient(app, base_url=f"http://127.0.0.1:{PORT}")


class Page:
    """The page: sends JSON, unpacks frames."""

    def __init__(self, socket):
        self.socket, self.number, self.news = socket, 0, []

    def ask(self, k, **message):
        self.number += 1
        self.socket.send_text(json.dumps({"id": self.number, "k": k, **message}))
        while "of" in (frame := unpack(self.socket.receive_bytes()))[0]:
            self.news.append(frame[0])
        header, arrays = frame
        assert header.get("id") == self.number
        return header, arrays

    def ok(self, k, **message):
        header, arrays = self.ask(k, **message)
        assert header["ok"], header
        return header, arrays

    def refused(self, k, **message):
        header, _ = self.ask(k, **message)
        assert not header["ok"]
        return header["error"]["message"]


@pytest.fixture
def page(part):
    with (
        client(part.parent, str(part)) as http,
        http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
    ):
        yield Page(socket)


# ---- who may talk ----------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/static/app.js", "/upload"])
@pytest.mark.parametrize(
    ("headers", "token"),
    [
        (HOST, None),
        (HOST, "wrong"),
        ({"host": "evil.example"}, TOKEN),
        ({"host": f"evil.example:{PORT}"}, TOKEN),
        ({"host": "127.0.0.1:9"}, TOKEN),
        ({**HOST, "origin": "http://evil.example"}, TOKEN),
        ({**HOST, "origin": "null"}, TOKEN),
    ],
)
def test_strangers_get_403(tmp_path, path, headers, token):
    with client(tmp_path) as http:
        query = "" if token is None else f"?token={token}"
        call = http.post if path == "/upload" else http.get
        answer = call(path + query, headers=headers)

    assert answer.status_code == 403
    assert TOKEN not in answer.text


@pytest.mark.parametrize(
    ("query", "headers"),
    [("", HOST), ("?token=no", HOST), (f"?token={TOKEN}", {**HOST, "origin": "http://a.b"})],
)
def test_a_stranger_gets_no_socket(tmp_path, query, headers):
    with (
        client(tmp_path) as http,
        pytest.raises(WebSocketDisconnect),
        http.websocket_connect(f"/ws{query}", headers=headers),
    ):
        pass


def test_the_cookie_serves_after_the_first_page(tmp_path):
    with client(tmp_path) as http:
        first = http.get(f"/?token={TOKEN}", headers=HOST)
        assert first.status_code == 200
        assert "httponly" in first.headers["set-cookie"].lower()
        assert "samesite=strict" in first.headers["set-cookie"].lower()
        assert "default-src 'none'" in first.headers["content-security-policy"]
        assert http.get("/", headers=HOST).status_code == 200


# ---- what it answers -------------------------------------------------------------------------


def test_the_page_gets_session_and_schema(page):
    header, _ = page.ok("hello")

    assert header["session"]["kind"] == "map"
    assert [s["op"] for s in header["session"]["steps"]] == ["form", "parameters"]
    assert {"mask", "form", "filter"} <= {s["op"] for s in header["schema"]["steps"]}


def test_the_map_shows_the_bump_where_it_is_and_the_hole_grey(page):
    header, arrays = page.ok(
        "map",
        stage=0,
        pixels=[51, 41],
        level="full",
        window=[-5e-4, -5e-4, 50.5e-3, 40.5e-3],
        range=[-1e-6, 4e-6],
    )

    index = arrays["index"]
    assert index.shape == (41, 51)
    row, column = np.unravel_index(index.argmax(), index.shape)
    assert (40 - row, column) == (30, 12)  # rows run down, y runs up
    assert index[40 - 5, 40] == 0
    assert np.count_nonzero(index == 0) == 1
    assert header["range"] == [-1e-6, 4e-6]


def test_the_section_gives_the_profile_through_the_bump(page):
    header, arrays = page.ok("section", stage=0, a=[0.0, 30e-3], b=[50e-3, 30e-3], columns=200)

    peak = arrays["distance"][np.nanargmax(arrays["high"])]
    assert peak == pytest.approx(12e-3, abs=0.5e-3)
    assert header["length"] == pytest.approx(50e-3, abs=1e-12)
    assert 2.5e-6 < header["pv"] < 3.5e-6


def test_metrics_of_full_data_are_those_of_the_recipe(page, part, tmp_path):
    header, _ = page.ok("metrics", level="full")
    page.ok("export", what="recipe", path="by-hand.toml")
    result = ms.Recipe.load(tmp_path / "by-hand.toml").run([part])

    assert header["is_preview"] is False
    rows = {r["symbol"]: r["value"] for r in header["rows"]}
    wanted = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    for symbol in ("Sa", "Sq", "Sz"):
        assert rows[symbol] == pytest.approx(wanted[symbol], abs=0.0, rel=1e-12)


def test_where_a_step_fails_the_map_before_it_is_shown_and_the_rows_stay(page):
    _, before = page.ok("map", level="full", pixels=[200, 200])
    rows = [r["symbol"] for r in page.ok("metrics", level="full")[0]["rows"]]
    sine = {"op": "form", "form": "sine-grid"}
    page.ok(
        "edit",
        edits=[
            {"path": ["step", 1], "old": {"op": "parameters"}, "new": sine},
            {"path": ["step", 2], "old": None, "new": {"op": "parameters"}},
        ],
    )
    for stage in (-1, 1, 2):
        header, arrays = page.ok("map", stage=stage, level="full", pixels=[200, 200])
        assert header["failed"] == 1
        np.testing.assert_array_equal(arrays["index"], before["index"])
    header, _ = page.ok("metrics", level="full")
    assert header["failed"]["index"] == 1
    assert "amplitude" in header["failed"]["message"]
    assert set(rows) == {r["symbol"] for r in header["rows"]}
    lost = next(r for r in header["rows"] if r["symbol"] == "Sq")
    assert lost["value"] is None
    assert lost["definition"] == "not evaluated, as step 2 failed"
    page.ok("section", stage=1, a=[0.0, 30e-3], b=[50e-3, 30e-3])


def test_result_of_the_page_is_that_of_the_command_line(page, part, tmp_path):
    page.ok(
        "edit", path=["check", 0], old=None, new={"metric": "Sq", "upper": "2 um", "U": "1 nm"}
    )
    page.ok("export", what="recipe", path="by-hand.toml")
    header, _ = page.ok("export", what="result", path="from-page")
    ms.Recipe.load(tmp_path / "by-hand.toml").run([part], out=tmp_path / "from-shell")

    assert header["verdict"] == "accept"
    first = json.loads((tmp_path / "from-page" / "result.json").read_text())
    second = json.loads((tmp_path / "from-shell" / "result.json").read_text())
    for document in (first, second):
        document["recipe"].pop("name")
        for key in ("started", "finished", "created"):
            document.pop(key, None)
    assert first == second


@pytest.mark.parametrize("name", ["gain=2.toml", "my gain = 2 mm.toml", "lambda_c.toml"])
def test_the_name_of_a_file_that_is_there_stays_as_it_is(page, tmp_path, name):
    path = str(tmp_path / name)
    page.ok("export", what="recipe", path=path)
    assert page.refused("export", what="recipe", path=path).startswith(f"{name}: exists already")
    missing = str(tmp_path / f"not {name}")
    assert page.refused("open", path=missing) == f"{missing}: there is no such file"


def test_an_edit_changes_the_recipe_and_undo_takes_it_back(page, part):
    before = page.ok("hello")[0]["session"]["recipe"]
    header, _ = page.ok("edit", path=["step", 0, "enabled"], old=None, new=False)

    session = header["session"]
    assert session["steps"][0]["enabled"] is False
    assert session["can_undo"]
    kept = text_of_session(autosave_path(part).read_bytes())[0]
    assert tomllib.loads(kept)["step"][0]["enabled"] is False
    assert page.ok("undo")[0]["session"]["recipe"] == before
    assert page.ok("redo")[0]["session"]["recipe"] == kept


def test_looking_leaves_no_file(part):
    with (
        client(part.parent, str(part)) as http,
        http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
    ):
        Page(socket).ok("metrics", level="full")

    assert [f.name for f in part.parent.iterdir()] == [part.name]


def test_an_autosaved_session_reopens(part):
    for _ in range(2):
        with (
            client(part.parent, str(part)) as http,
            http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
        ):
            page = Page(socket)
            session = page.ok("hello")[0]["session"]
            if session["title"] != "changed":
                page.ok("edit", path=["title"], old="part", new="changed")
    assert session["title"] == "changed"
    assert any("taken up again" in m for m in session["messages"])


def test_a_damaged_session_file_is_told_and_not_used(part):
    autosave_path(part).write_text("metrosep = 1\n[[step")
    with (
        client(part.parent, str(part)) as http,
        http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
    ):
        session = Page(socket).ok("hello")[0]["session"]

    assert any("is not used" in m for m in session["messages"])
    assert session["kind"] == "map"


def test_a_spectrum_of_a_section(page):
    header, arrays = page.ok(
        "spectrum", stage=0, a=[0.0, 10e-3], b=[50e-3, 10e-3], band=[2e-3, 20e-3]
    )

    assert arrays["wavelength"].size == arrays["amplitude"].size > 10
    assert header["inside"] >= 0.0


# ---- what it refuses -------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/etc/passwd", "../secret.x3p", "nothing.x3p", "", "a\0b"])
def test_files_elsewhere_are_refused(page, path, tmp_path):
    (tmp_path.parent / "secret.x3p").write_bytes(b"x")
    words = page.refused("open", path=path)
    assert "passwd" not in words or "outside" in words


def test_writing_elsewhere_is_refused(page):
    assert "outside" in page.refused("export", what="recipe", path="../../evil.toml")


@pytest.mark.parametrize(
    ("k", "message"),
    [
        ("edit", {"path": ["step", 0, "form"], "old": "plane", "new": "plan"}),
        ("edit", {"path": "step", "old": None, "new": 1}),
        ("edit", {"edits": [1]}),
        ("map", {"pixels": [0, 10]}),
        ("map", {"stage": 99}),
        ("map", {"stage": "last"}),
        ("map", {"window": [0, 0, float(0), "x"]}),
        ("section", {"a": [0, 0]}),
        ("section", {"a": [0, 0], "b": [0, 0]}),
        ("profile", {}),
        ("metrics", {"level": "best"}),
        ("export", {"what": "pdf", "path": "a.pdf"}),
        ("dance", {}),
        ("undo", {}),
    ],
)
def test_a_wrong_request_is_one_sentence_and_changes_nothing(page, k, message):
    before = page.ok("hello")[0]["session"]["recipe"]
    words = page.refused(k, **message)

    assert words
    assert "Traceback" not in words
    assert page.ok("hello")[0]["session"]["recipe"] == before


def test_what_is_no_request_is_answered_too(page):
    for text in ("", "[", "[]", "3", '{"k": 3}', "x" * 5_000_000):
        page.socket.send_text(text)
        header, _ = unpack(page.socket.receive_bytes())
        assert header["ok"] is False
    page.ok("hello")


def test_an_upload_is_opened_and_removed_at_the_end(part):
    http = client(part.parent)
    with http:
        answer = http.post(
            f"/upload?token={TOKEN}",
            content=part.read_bytes(),
            headers={**HOST, "x-file-name": "..%2F..%2Fmy part.x3p"},
        )
        assert answer.status_code == 200
        kept = answer.json()["path"]
        assert kept.endswith("my part.x3p")
        with http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket:
            session = Page(socket).ok("open", path=kept)[0]["session"]
        assert session["kind"] == "map"
    from pathlib import Path

    assert not Path(kept).exists()


@pytest.mark.parametrize("name", ["", "..", "/", "a\nb"])
def test_an_upload_needs_a_name(tmp_path, name):
    from urllib.parse import quote

    with client(tmp_path) as http:
        answer = http.post(
            f"/upload?token={TOKEN}", content=b"x", headers={**HOST, "x-file-name": quote(name)}
        )
    assert answer.status_code == 400


def test_a_corrupt_upload_is_told(part):
    http = client(part.parent)
    with http:
        answer = http.post(
            f"/upload?token={TOKEN}",
            content=b"PK\x03\x04 no",
            headers={**HOST, "x-file-name": "a.x3p"},
        )
        with http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket:
            page = Page(socket)
            words = page.refused("open", path=answer.json()["path"])
            assert "a.x3p" in words
            assert page.ok("hello")[0]["session"]["kind"] is None


# ---- nothing is left without an answer -------------------------------------------------------


@pytest.mark.parametrize("of", [[1], {"a": 1}, "x", None, True, 1.5, 10**30])
def test_cancel_of_what_is_no_request_leaves_the_connection(page, of):
    page.socket.send_text(json.dumps({"k": "cancel", "of": of}))
    assert page.ok("hello")[0]["session"]["kind"] == "map"


def test_an_answer_that_cannot_be_written_is_answered_by_an_error(page, monkeypatch):
    whole = Session.state
    monkeypatch.setattr(Session, "state", lambda self: {**whole(self), "made": object()})
    header, _ = page.ask("hello")
    assert not header["ok"]
    assert header["error"]["code"] == 5
    assert "internal error" in header["error"]["message"]
    assert "this is a bug in metrosep" in header["error"]["message"]
    monkeypatch.undo()
    page.ok("hello")


def test_an_array_that_no_frame_carries_is_answered_by_an_error(page, monkeypatch):
    monkeypatch.setattr(
        Answers, "answer", lambda *_: ({"k": "map", "ok": True}, {"a": np.array([1 + 2j])})
    )
    header, _ = page.ask("map")
    assert header["error"]["code"] == 5
    assert "complex" in header["error"]["message"]


def test_an_unexpected_error_of_ours_is_answered(page, monkeypatch):
    def fails(*_):
        raise AttributeError("no such thing")

    monkeypatch.setattr(Answers, "answer", fails)
    header, _ = page.ask("map")
    assert header["error"]["code"] == 5
    assert "internal error (AttributeError: no such thing)" in header["error"]["message"]


def test_an_error_while_an_error_is_told_is_answered(page, monkeypatch):
    def fails(*_):
        raise RuntimeError("words")

    monkeypatch.setattr(Session, "words", fails)
    header, _ = page.ask("edit", path=["title"], old="not this", new="x")
    assert header["error"]["code"] == 5


def test_a_view_with_a_date_opens(part):
    recipe = part.with_name("r.toml")
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["part.x3p"]\n[[step]]\nop = "form"\nform = "plane"\n'
        '[[step]]\nop = "parameters"\n[view]\nmade = 2026-11-22\n[view.more]\nat = 03:00:00\n'
    )
    with (
        client(part.parent, str(part)) as http,
        http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
    ):
        assert Page(socket).ok("open", path=str(recipe))[0]["session"]["view"] == {}


@pytest.mark.parametrize(
    "text", ['{"id": 1, "k": "\\ud800"}', '{"id": 1, "k": "open", "path": "\\ud800.x3p"}']
)
def test_a_text_that_is_no_unicode_is_answered(page, text):
    page.socket.send_text(text)
    header, _ = unpack(page.socket.receive_bytes())
    assert header["id"] == 1
    assert not header["ok"]
    page.ok("hello")


def test_a_message_nested_without_end_is_answered(page):
    page.socket.send_text("[" * 100_000)
    assert not unpack(page.socket.receive_bytes())[0]["ok"]
    page.ok("hello")

"""The report in the page is that of `metrosep run`: same document, same page, made from all data."""

import json

import numpy as np
import pytest
from starlette.testclient import TestClient

import metrosep as ms
from metrosep.app import export_answers as full_results
from metrosep.app.documents import Edit, Places
from metrosep.app.export_answers import report
from metrosep.app.server import make_app
from metrosep.app.sessions import Session
from metrosep.app.wire import unpack
from metrosep.core.errors import DataError, MetrosepError, WriteError
from metrosep.recipe.pipeline import CancelledError
from metrosep.report import render_html

RANK = (
    'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "fts_lathe"\nradius = "20 mm"\n'
    'form = "toric: Rb=265 mm, Rd=132.5 mm"\nerrors = { EXX = "1 um", B0Z = "1 arcsec" }\n'
)


@pytest.fixture
def part(tmp_path):
    """A tilted plane with a bump and a hole, larger than a preview."""
    y, x = np.mgrid[:520, :480] * 1e-4
    z = 3e-6 * np.exp(-(((x - 12e-3) / 4e-3) ** 2) - ((y - 30e-3) / 4e-3) ** 2) + 1e-4 * x
    z[100:120, 200:230] = np.nan
    z[3, 4] = 9e-6  # a peak that a mean of pixels would take away
    path = tmp_path / "part.x3p"
    ms.write(ms.Surface(z, 1e-4, 1e-4), path)
    return path


@pytest.fixture
def session(part):
    made = Session(Places([part.parent]))
    made.open(str(part))
    return made


def ask(session, cancel=lambda: False, **message):
    news = []
    header, arrays = report(session, {"k": "report", **message}, cancel, news.append)
    return header, arrays, [n["words"] for n in news]


def test_a_map_has_the_report_of_its_recipe_run_by_itself(session):
    header, arrays, _ = ask(session)
    opened, document = session.need()
    run = document.recipe.run(list(opened.files))

    assert bytes(arrays["html"]).decode() == render_html(run.document)
    assert header["hash"] == session.state()["hash"]
    assert "html" in header["formats"]


def test_the_document_is_byte_for_byte_that_of_the_run(session):
    session.edit([Edit(("check", 0), None, {"metric": "Sz", "upper": "12 um", "U": "10 nm"})])
    opened, document = session.need()
    own = full_results.full_result(session, lambda: False, lambda news: None)

    assert own.to_json() == document.recipe.run(list(opened.files)).to_json()
    assert json.loads(own.to_json())["characteristics"][0]["value"] > 6e-6  # the peak is in it


def test_it_is_made_once_until_the_recipe_changes(session, monkeypatch):
    import metrosep.report

    calls = []
    monkeypatch.setattr(
        metrosep.report, "render_html", lambda document: calls.append(1) or "<p>page</p>"
    )
    ask(session)
    ask(session)
    assert len(calls) == 1
    session.edit([Edit(("step", 0, "enabled"), None, False)])
    ask(session)
    assert len(calls) == 2
    session.undo()
    ask(session)
    assert len(calls) == 2


def test_a_ranking_has_its_report(tmp_path):
    (tmp_path / "rank.toml").write_text(RANK, "utf-8")
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "rank.toml"))
    _, arrays, news = ask(session)
    page = bytes(arrays["html"]).decode()

    assert "from EXX = 1 um" in page
    assert "1 arcsec" in page
    assert "making the report" in news


def test_it_is_written_inside_the_opened_folders_only(session, part):
    target = part.parent / "out.html"
    header, arrays, _ = ask(session, write=str(target))

    assert header["files"] == [str(target)]
    assert arrays == {}
    _, shown, _ = ask(session)
    assert target.read_bytes() == bytes(shown["html"])
    with pytest.raises(DataError, match="exists already"):
        ask(session, write=str(target))
    ask(session, write=str(target), overwrite=True)
    with pytest.raises(WriteError, match="outside the folders"):
        ask(session, write=str(part.parent.parent / "elsewhere.html"))
    with pytest.raises(DataError, match="no report format 'docx'"):
        ask(session, write=str(part.parent / "a.docx"), format="docx")


def test_every_registered_format_can_be_written(session, part):
    formats = ask(session)[0]["formats"]
    assert formats[0] == "html"
    for name in formats:
        target = part.parent / f"r.{name}"
        if name == "dcc":  # of an issued report only
            with pytest.raises(MetrosepError, match="a draft gives no digital certificate"):
                ask(session, write=str(target), format=name)
            assert not target.exists()
            continue
        ask(session, write=str(target), format=name)
        assert target.stat().st_size > 100


def test_a_failing_step_has_the_words_of_the_command_line(session):
    step = session.state()["steps"][1]["stored"]
    session.edit([Edit(("step", 1), step, {"op": "filter", "kind": "gaussian", "cutoff": "9 m"})])
    opened, document = session.need()
    try:
        document.recipe.run(list(opened.files))
    except MetrosepError as exc:
        words, kind = str(exc), type(exc)
        with pytest.raises(kind) as info:
            ask(session)
        assert str(info.value) == words
        assert "step 2" in words
    else:
        pytest.fail("the step was meant to fail")


def test_a_stop_leaves_nothing(session, part):
    with pytest.raises(CancelledError):
        ask(session, cancel=lambda: True)
    with pytest.raises(CancelledError):
        ask(session, cancel=lambda: True, write=str(part.parent / "never.html"))
    assert not (part.parent / "never.html").exists()


def test_nothing_open_is_refused(tmp_path):
    with pytest.raises(DataError, match="no file is open"):
        ask(Session(Places([tmp_path])))


def test_the_page_may_show_it_and_no_script_of_it_runs(part):
    """A frame by srcdoc takes the policy of the page: images and style of its own, nothing else."""
    app = make_app(Places([part.parent]), port=8123, token="t" * 43, first=[str(part)])
    with TestClient(app, base_url="http://127.0.0.1:8123") as http:
        head = {"host": "127.0.0.1:8123"}
        policy = http.get(f"/?token={'t' * 43}", headers=head).headers["content-security-policy"]
        with http.websocket_connect(f"/ws?token={'t' * 43}", headers=head) as socket:
            socket.send_text(json.dumps({"id": 1, "k": "report"}))
            while "of" in (frame := unpack(socket.receive_bytes()))[0]:
                pass
    rules = dict(r.strip().split(" ", 1) for r in policy.split(";"))
    page = bytes(frame[1]["html"]).decode()

    assert frame[0]["ok"], frame[0]
    assert "<script" not in page
    assert rules["script-src"] == "'self'"
    assert "data:" in rules["img-src"].split()
    assert "'unsafe-inline'" in rules["style-src"].split()
    assert "frame-src" not in rules  # default-src 'none': no frame may load an address


def test_a_head_written_beside_the_file_later_stands_in_the_next_report(part, session):
    pages = []
    for number in ("", 'number = "2026-0815"\n', 'number = "2026-0816"\n'):
        if number:
            part.with_name("part.report.toml").write_text(number)
        pages.append(bytes(ask(session)[1]["html"]).decode())
    assert ["2026-0815" in page for page in pages] == [False, True, False]
    assert "2026-0816" in pages[2]


REPORT = {"number": "2026-0815", "laboratory": {"name": "Laboratory of the test"}}


def test_what_the_recipe_states_for_a_report_stands_in_it_as_in_that_of_the_run(session, part):
    """[report] is outside the hash of a recipe: the page must not keep what was made without it."""
    before = bytes(ask(session)[1]["html"]).decode()
    session.edit([Edit(("report",), None, REPORT)])
    part.with_name("part.report.toml").write_text('customer = { name = "Customer of the test" }\n')
    opened, document = session.need()
    page = bytes(ask(session)[1]["html"]).decode()

    assert "2026-0815" not in before
    assert page == render_html(document.recipe.run(list(opened.files)).document)
    assert "2026-0815" in page
    assert "Customer of the test" in page


def test_runs_and_methods_too(tmp_path):
    x = np.linspace(0.0, 50.0, 101)
    rows = [f"{r},{a},{np.cos(a) + 0.01 * r}" for r in range(3) for a in x]
    (tmp_path / "runs.csv").write_text("run,x_mm,z_um\n" + "\n".join(rows) + "\n")
    head = 'metrosep = 1\n[report]\nnumber = "NO"\n'
    (tmp_path / "runs.toml").write_text(
        head + '[input]\nfiles = ["runs.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\n'
    )
    (tmp_path / "rank.toml").write_text(RANK.replace("metrosep = 1\n", head))
    for name in ("runs.toml", "rank.toml"):
        session = Session(Places([tmp_path]))
        session.open(str(tmp_path / name))
        for old, number in (("NO", "A-1"), ("A-1", "A-2")):
            session.edit([Edit(("report", "number"), old, number)])
            page = bytes(ask(session)[1]["html"]).decode()
            assert number in page, name
        files = list(session.opened.files)
        run = session.document.recipe.run(files or None)
        assert (
            full_results.full_result(session, lambda: False, lambda news: None).to_json()
            == run.to_json()
        )

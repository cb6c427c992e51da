"""The list of files: only what lies inside the opened folders, and nothing that would hang."""

import os
from pathlib import Path

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.app.documents import Places
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.core.errors import ReadError
from metrosep.io.write import write


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    inside = tmp_path / "data"
    (inside / "lot").mkdir(parents=True)
    write(Surface(np.arange(12.0).reshape(3, 4) * 1e-9, 1e-6, 1e-6), inside / "Part.x3p")
    (inside / "notes.bin").write_bytes(b"\x01\x02\x03 nothing that a reader knows")
    (inside / "r.toml").write_text("metrosep = 1\n")
    (inside / ".hidden").write_text("x")
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "far.txt").write_text("1 2\n3 4\n")
    (inside / "link.txt").symlink_to(secret / "far.txt")
    (inside / "away").symlink_to(secret)
    os.mkfifo(inside / "pipe")
    return inside


def answers(folder: Path) -> Answers:
    return Answers(Session(Places([folder])))


def names(header: dict) -> list[str]:
    return [row["name"] for row in header["rows"]]


def test_folders_come_first_and_files_have_their_kind(folder: Path) -> None:
    header, _ = answers(folder).answer({"k": "list"})
    assert names(header) == ["lot", "notes.bin", "Part.x3p", "r.toml"]
    assert [r["kind"] for r in header["rows"]] == ["folder", "", "x3p", "recipe"]
    assert header["rows"][2]["size"] == (folder / "Part.x3p").stat().st_size
    assert header["up"] is None
    below, _ = answers(folder).answer({"k": "list", "path": str(folder / "lot")})
    assert (below["rows"], below["up"]) == ([], str(folder))


def test_a_name_narrows_the_list(folder: Path) -> None:
    header, _ = answers(folder).answer({"k": "list", "text": "PAR"})
    assert names(header) == ["Part.x3p"]


@pytest.mark.parametrize("path", ["..", "away", "../secret", "/etc", "lot/../../secret"])
def test_nothing_outside_is_listed(folder: Path, path: str) -> None:
    with pytest.raises(ReadError, match="outside the folders"):
        answers(folder).answer({"k": "list", "path": path})
    with pytest.raises(ReadError, match="outside the folders"):
        answers(folder).answer({"k": "thumbnail", "path": f"{path}/far.txt"})


def test_a_pipe_is_neither_listed_nor_read(folder: Path) -> None:
    with pytest.raises(ReadError, match="not a regular file"):
        answers(folder).answer({"k": "thumbnail", "path": str(folder / "pipe")})


def test_a_long_folder_comes_in_parts(folder: Path) -> None:
    many = folder / "lot"
    for i in range(450):
        (many / f"p{i:04d}.toml").write_text("")
    page, seen = answers(folder), []
    for first in (0, 200, 400):
        header, _ = page.answer({"k": "list", "path": str(many), "from": first})
        seen += names(header)
    assert header["total"] == 450
    assert seen == [f"p{i:04d}.toml" for i in range(450)]


def test_pictures_are_png_of_what_was_measured(folder: Path) -> None:
    write(Profile(np.arange(50) * 1e-6, np.sin(np.arange(50.0)) * 1e-8), folder / "line.csv")
    for name, words in (("Part.x3p", "map, 4 × 3"), ("line.csv", "profile, 50 samples")):
        header, arrays = answers(folder).answer({"k": "thumbnail", "path": str(folder / name)})
        assert header["words"] == words
        assert bytes(arrays["png"][:8]) == b"\x89PNG\r\n\x1a\n"


def test_what_was_opened_is_offered_again_and_nothing_is_left_beside_it(folder: Path) -> None:
    before = sorted(folder.iterdir())
    page = answers(folder)
    page.answer({"k": "open", "path": str(folder / "Part.x3p")})
    assert sorted(folder.iterdir()) == before
    header, _ = answers(folder).answer({"k": "list"})
    assert header["recent"] == [[str(folder / "Part.x3p")]]
    other, _ = answers(folder / "lot").answer({"k": "list"})  # not inside what this start opened
    assert other["recent"] == []
    page.session.close()


def test_the_latest_of_a_folder_is_of_the_same_kind_and_no_link_out_of_it(folder: Path) -> None:
    page = answers(folder)
    page.answer({"k": "open", "path": str(folder / "Part.x3p")})
    here, _ = page.answer({"k": "latest", "of": "file"})
    newer = folder / "B.x3p"
    newer.write_bytes((folder / "Part.x3p").read_bytes())
    os.utime(newer, (4e9, 4e9))
    (folder / "C.x3p").symlink_to(folder.parent / "secret" / "far.txt")
    (folder / "z.toml").write_text("")
    there, _ = page.answer({"k": "latest", "of": "folder"})
    assert (here["path"], there["path"]) == (str(folder / "Part.x3p"), str(newer))
    assert (here["is_open"], there["is_open"]) == (True, False)
    same, _ = page.answer({"k": "latest", "of": "file"})
    assert same == here
    os.utime(folder / "Part.x3p", (3e9, 3e9))
    written, _ = page.answer({"k": "latest", "of": "file"})  # before *Follow* was chosen or after
    assert written["stamp"] != here["stamp"]
    assert not written["is_open"]
    page.session.close()


def test_a_name_that_is_not_utf8_is_shown_escaped_and_followed_past(folder: Path) -> None:
    from metrosep.app.wire import pack, unpack

    bad = os.fsencode(str(folder)) + b"/bad\xff.x3p"
    Path(os.fsdecode(bad)).write_bytes((folder / "Part.x3p").read_bytes())
    os.utime(bad, (4e9, 4e9))
    page = answers(folder)
    page.answer({"k": "open", "path": str(folder / "Part.x3p")})
    header, _ = unpack(pack(page.answer({"k": "list"})[0]))  # as it goes to the page
    assert "bad\\xff.x3p" in names(header)
    assert "Part.x3p" in names(header)
    newest, _ = page.answer({"k": "latest", "of": "folder"})
    assert newest["path"] == str(folder / "Part.x3p")
    with pytest.raises(ReadError, match=r"bad\\xff.x3p: there is no such file"):
        page.answer({"k": "thumbnail", "path": str(folder / "bad\\xff.x3p")})
    page.session.close()


@pytest.mark.parametrize("path", ["a" * 5000, "b/" * 3000, "lone \ud800"])
def test_a_path_that_cannot_be_is_refused_with_a_sentence(folder: Path, path: str) -> None:
    for request in ("list", "thumbnail", "open"):
        with pytest.raises(ReadError) as refused:
            answers(folder).answer({"k": request, "path": path})
        assert len(str(refused.value)) < 200
        str(refused.value).encode()


def test_the_list_begins_where_a_file_was_opened_last(folder: Path) -> None:
    """A new start has nothing open: the last folder is that of the latest file inside what may be opened."""
    file = folder / "lot" / "deep.x3p"
    file.write_bytes((folder / "Part.x3p").read_bytes())
    assert answers(folder).answer({"k": "list"})[0]["path"] == str(folder)
    first = answers(folder)
    first.answer({"k": "open", "paths": [str(file)]})
    assert answers(folder).answer({"k": "list"})[0]["path"] == str(folder / "lot")
    alone = folder / "empty"
    alone.mkdir()
    assert answers(alone).answer({"k": "list"})[0]["path"] == str(alone)  # that one lies outside

"""The session on disk: a slow or a full disk stops nobody, and is told."""

import threading

import pytest

from metrosep.app.keeping import Keeper
from metrosep.core.errors import WriteError

SOON = 10.0
"""Seconds within which a thread of a busy computer has done its work."""


def test_what_is_kept_is_on_the_disk(tmp_path):
    keeper = Keeper()
    keeper.keep(tmp_path / "a.toml", "one")
    assert keeper.wait(SOON)

    assert (tmp_path / "a.toml").read_text() == "one"
    assert keeper.saved_at is not None
    assert keeper.problem == ""


def test_what_was_there_is_put_aside_when_asked(tmp_path):
    target = tmp_path / "a.toml"
    target.write_text("of other files")
    keeper = Keeper()
    keeper.keep(target, "mine", aside=True)
    keeper.keep(target, "mine, later")
    assert keeper.wait(SOON)

    assert target.read_text() == "mine, later"
    assert (tmp_path / "a.toml.old").read_text() == "of other files"


def test_a_slow_disk_gets_the_latest_of_each_file_and_all_is_told(tmp_path):
    go, heard, written = threading.Event(), threading.Event(), []

    def slow(path, content):
        assert go.wait(SOON)
        written.append((path.name, content))

    keeper = Keeper(slow, heard.set)
    for text in "abc":
        keeper.keep(tmp_path / "first", text)
    keeper.keep(tmp_path / "second", "d")
    assert keeper.is_waiting
    assert keeper.saved_at is None
    go.set()
    assert keeper.wait(SOON)

    assert written == [("first", b"a"), ("first", b"c"), ("second", b"d")]
    assert heard.wait(SOON)


@pytest.mark.parametrize("error", [WriteError("the disk is full"), OSError(28, "no space")])
def test_a_full_disk_is_told_and_forgotten_when_there_is_room(tmp_path, error):
    full = [True]

    def write(path, content):
        if full[0]:
            raise error

    keeper = Keeper(write)
    keeper.keep(tmp_path / "a", "x")
    assert keeper.wait(SOON)
    assert "not kept" in keeper.problem
    assert keeper.saved_at is None
    full[0] = False
    keeper.keep(tmp_path / "a", "y")
    assert keeper.wait(SOON)
    assert keeper.problem == ""
    assert keeper.saved_at is not None

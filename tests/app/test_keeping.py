"""The session on disk: a slow or a full disk stops nobody, and is told."""

import threading

import pytest

from metrosep.app.sessions import Keeper
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


# ---- what could not be kept is tried again -----------------------------------------------------


class Disk:
    """A disk that can be full."""

    def __init__(self, full=True):
        self.full = full

    def write(self, path, content):
        if self.full:
            raise WriteError("the disk is full")
        path.write_bytes(content)


def until(condition):
    """Wait for something that another thread does."""
    stop = threading.Event()
    for _ in range(int(SOON / 0.01)):
        if condition():
            return True
        stop.wait(0.01)
    return False


def test_room_again_and_the_failed_text_is_kept_by_itself(tmp_path):
    disk, heard = Disk(), threading.Event()
    keeper = Keeper(disk.write, heard.set, again=0.05)
    keeper.keep(tmp_path / "a", "mine")
    assert keeper.wait(SOON)
    assert "not kept" in keeper.problem
    assert keeper.has_failed(tmp_path / "a")
    disk.full = False
    assert until((tmp_path / "a").exists)
    assert heard.wait(SOON)  # who shows the problem hears that it is gone
    assert (tmp_path / "a").read_text() == "mine"
    assert keeper.problem == ""
    assert keeper.saved_at is not None
    assert not keeper.has_failed(tmp_path / "a")


def test_a_disk_that_stays_full_is_told_once(tmp_path):
    disk, tries, told = Disk(), [], []

    def write(path, content):
        tries.append(path)
        disk.write(path, content)

    keeper = Keeper(write, lambda: told.append(1), again=0.01)
    keeper.keep(tmp_path / "a", "mine")
    assert until(lambda: len(tries) > 5)
    assert told == []  # the answer to the edit said it


def test_the_next_change_of_any_file_and_the_end_try_again(tmp_path):
    disk = Disk()
    keeper = Keeper(disk.write, again=1000)
    keeper.keep(tmp_path / "a", "of a")
    assert keeper.wait(SOON)
    disk.full = False
    keeper.begin(tmp_path / "b", None)
    keeper.keep(tmp_path / "b", "of b")
    assert keeper.wait(SOON)
    assert (tmp_path / "a").read_text() == "of a"
    assert (tmp_path / "b").read_text() == "of b"
    disk.full = True
    keeper.keep(tmp_path / "b", "the last")
    assert keeper.wait(SOON)
    assert not keeper.close(SOON)
    disk.full = False
    assert keeper.close(SOON)
    assert (tmp_path / "b").read_text() == "the last"


def test_a_newer_text_is_not_undone_by_an_older_one_that_failed(tmp_path):
    disk = Disk()
    keeper = Keeper(disk.write, again=1000)
    (tmp_path / "a").write_text("of other files")
    keeper.keep(tmp_path / "a", "old", aside=True)
    assert keeper.wait(SOON)
    disk.full = False
    keeper.keep(tmp_path / "a", "new")
    assert keeper.wait(SOON)
    assert keeper.close(SOON)
    assert (tmp_path / "a").read_text() == "new"
    assert (tmp_path / "a.old").read_text() == "of other files"
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a", "a.old"]


# ---- nothing of others is written over ---------------------------------------------------------


def test_each_that_is_put_aside_has_a_name_of_its_own(tmp_path):
    target = tmp_path / "a"
    for text in ("first", "second", "third"):
        target.write_text(text)
        keeper = Keeper()
        keeper.keep(target, "mine", aside=True)
        assert keeper.wait(SOON)
    found = {f.name: f.read_text() for f in tmp_path.iterdir()}
    assert found == {"a": "mine", "a.old": "first", "a.old.1": "second", "a.old.2": "third"}


def test_two_that_work_on_one_file_keep_both(tmp_path):
    target = tmp_path / "a"
    one, two, three = Keeper(), Keeper(), Keeper()
    for keeper in (one, two, three):
        keeper.begin(target, None)
    for turn in "xy":
        for name, keeper in (("one", one), ("two", two), ("three", three)):
            keeper.keep(target, name + turn)
            assert keeper.wait(SOON)
    found = {f.name: f.read_text() for f in tmp_path.iterdir()}
    assert found == {"a": "oney", "a.other-1": "twoy", "a.other-2": "threey"}
    assert one.notice == ""
    assert "another metrosep" in two.notice
    assert "a.other-1" in two.notice


def test_what_was_read_at_opening_may_be_written_over_and_nothing_newer(tmp_path):
    target = tmp_path / "a"
    target.write_bytes(b"left")
    one, two = Keeper(), Keeper()
    for keeper in (one, two):
        keeper.begin(target, b"left")
    one.keep(target, "one")
    two.keep(target, "two")
    assert one.wait(SOON)
    assert two.wait(SOON)
    assert target.read_text() == "one"
    assert (tmp_path / "a.other-1").read_text() == "two"

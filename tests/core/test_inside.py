"""Reads inside some folders: no way out by a link, whatever the path is called and whoever opens it."""

import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from metrosep.core.errors import ReadError
from metrosep.core.inside import carried, inside_of, keep_inside, reading_inside
from metrosep.io.containers import hdf5_worker

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")


@pytest.fixture
def folders(tmp_path):
    """Return a folder that is opened, with a link `l.txt` and a folder `sub` that lead out, and another."""
    opened, private = (tmp_path.resolve() / name for name in ("opened", "private"))
    opened.mkdir()
    private.mkdir()
    (private / "s.txt").write_text("secret")
    (opened / "l.txt").symlink_to(private / "s.txt")
    (opened / "own.txt").write_text("own")
    (opened / "ring").symlink_to("ring")
    (private / "back.txt").symlink_to(opened / "l.txt")
    return opened, private


def is_refused(read):
    try:
        read()
    except ReadError as exc:
        return "leads out of the folders" in str(exc)
    return False


def test_a_guard_ends_with_its_block_and_an_outer_one_holds_in_and_after_an_inner_one(folders):
    opened, private = folders
    with reading_inside([opened]):
        with reading_inside([private / "none"]):
            assert is_refused((opened / "l.txt").read_text)
        assert inside_of() == (str(opened),)
        assert is_refused((opened / "l.txt").read_text)
    assert inside_of() == ()
    assert (opened / "l.txt").read_text() == "secret"


@pytest.mark.parametrize(
    "name",
    ["l.txt", "./l.txt", "../opened/l.txt", "/proc/self/cwd/l.txt", "../private/back.txt",
     "/proc/thread-self/cwd/l.txt", "out/../s.txt", "/proc/self/cwd/out/../s.txt"],
)  # fmt: skip
def test_every_name_of_a_link_that_leads_out_is_refused(folders, monkeypatch, name):
    opened, private = folders
    (private / "below").mkdir()
    (opened / "out").symlink_to(private / "below")  # `..` of it is `private`, for the system
    monkeypatch.chdir(opened)
    if name.startswith("/proc") and not Path("/proc/self/cwd").exists():
        pytest.skip("no /proc here")
    assert Path(name).exists()
    with reading_inside([opened]):
        assert is_refused(lambda: open(name).close())  # noqa: PTH123
        assert Path("own.txt").read_text() == "own"
        assert (private / "s.txt").read_text() == "secret"  # named outside: not looked at
        with pytest.raises(OSError, match=r"[Ll]evels|[Ll]oop"):
            Path("ring").read_text()


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="the system lists no open folders")
def test_a_name_beside_an_open_folder_is_refused(folders):
    opened, _ = folders
    held = os.open(opened, os.O_RDONLY)
    try:
        with reading_inside([opened]):
            assert is_refused(lambda: os.close(os.open("l.txt", os.O_RDONLY, dir_fd=held)))
            assert is_refused(lambda: Path(f"/proc/self/fd/{held}/l.txt").read_text())
            os.close(os.open("own.txt", os.O_RDONLY, dir_fd=held))
    finally:
        os.close(held)


def test_a_thread_of_its_own_is_bound_too(folders):
    opened, _ = folders
    found = []

    def look(path):
        found.append(is_refused(path.read_text))

    with reading_inside([opened]):
        thread = threading.Thread(target=carried(look), args=(opened / "l.txt",))
        pool = ThreadPoolExecutor(1, initializer=keep_inside, initargs=(inside_of(),))
    thread.start()  # later: what held when it was made counts
    thread.join()
    with pool:
        pool.submit(look, opened / "l.txt").result()
    assert found == [True, True]
    assert inside_of() == ()


def test_threads_of_the_package_are_started_with_it(repository):
    """A new one must be bound: what opens no files for others stands here with its reason."""
    free = {"cli/main.py": "shows that it works", "batch/loop.py": "ends a process"}
    for path in (repository / "metrosep").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if path.relative_to(repository / "metrosep").as_posix() not in free:
            assert text.count("Thread(") == text.count("Thread(target=carried("), path


def test_the_process_of_hdf5_looks_again_before_it_opens(folders):
    """The parent has checked another file: a link was laid meanwhile."""
    opened, private = folders
    (opened / "m.h5").symlink_to(private / "s.txt")
    asked = [
        {"open": str(path), "bytes": 0, "seconds": 60}
        for path in (opened / "m.h5", private / "s.txt")
    ]
    done = subprocess.run(
        [sys.executable, "-P", hdf5_worker.__file__],
        input="".join(json.dumps(a) + "\n" for a in asked).encode(),
        capture_output=True,
        check=True,
    )
    link, plain = (json.loads(line)["error"] for line in done.stdout.splitlines())
    assert "became a link" in link
    assert "link" not in plain  # it was opened, and is not HDF5

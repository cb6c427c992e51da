"""Files written piece by piece: whole or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from metrosep.core.atomic import atomic_stream, atomic_write
from metrosep.core.errors import WriteError


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_target_appears_only_at_the_end(tmp_path):
    target = tmp_path / "a.nc"

    with atomic_stream(target) as stream:
        stream.write(b"one\n")
        stream.flush()
        assert not target.exists()
        stream.write(b"two\n")

    assert target.read_bytes() == b"one\ntwo\n"
    assert names(tmp_path) == ["a.nc"]


def write_then(path: Path, trouble: BaseException) -> None:
    with atomic_stream(path) as stream:
        stream.write(b"half")
        raise trouble


def test_failure_in_the_block_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "a.nc"
    target.write_bytes(b"old")

    with pytest.raises(ZeroDivisionError):
        write_then(target, ZeroDivisionError())

    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["a.nc"]


def test_interruption_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        write_then(tmp_path / "a.nc", KeyboardInterrupt())

    assert names(tmp_path) == []


def test_check_sees_the_whole_flushed_file_under_another_name(tmp_path):
    target = tmp_path / "a.nc"
    seen = []

    def check(path: Path) -> None:
        seen.append((path.read_bytes(), path.parent, target.exists()))

    with atomic_stream(target, check=check) as stream:
        stream.write(b"x" * 100_000)

    assert seen == [(b"x" * 100_000, tmp_path, False)]


def test_check_that_raises_stops_the_rename(tmp_path):
    target = tmp_path / "a.nc"
    target.write_bytes(b"old")

    def check(_path: Path) -> None:
        raise WriteError("not what was meant")

    with (
        pytest.raises(WriteError, match="not what was meant"),
        atomic_stream(target, check=check) as stream,
    ):
        stream.write(b"new")

    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["a.nc"]


def test_stream_can_be_read_back(tmp_path):
    with atomic_stream(tmp_path / "a.nc") as stream:
        stream.write(b"abc")
        stream.seek(1)
        assert stream.read() == b"bc"


def test_missing_folder_and_folder_as_name_are_refused(tmp_path):
    with (
        pytest.raises(WriteError, match="does not exist"),
        atomic_stream(tmp_path / "no" / "a.nc"),
    ):
        pass
    with pytest.raises(WriteError, match="is a folder"), atomic_stream(tmp_path):
        pass


def test_full_disk_is_a_write_error_and_leaves_nothing(tmp_path, monkeypatch):
    def full(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with (
        pytest.raises(WriteError, match="No space left"),
        atomic_stream(tmp_path / "a.nc") as stream,
    ):
        stream.write(b"abc")

    assert names(tmp_path) == []


def test_permissions_of_a_replaced_file_and_links_are_kept(tmp_path):
    real = tmp_path / "real.nc"
    atomic_write(real, b"old")
    real.chmod(0o640)
    link = tmp_path / "link.nc"
    link.symlink_to(real)

    with atomic_stream(link) as stream:
        stream.write(b"new")

    assert link.is_symlink()
    assert real.read_bytes() == b"new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640

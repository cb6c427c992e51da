"""Reasons and exit codes of failures: the same as `metrosep run` gives."""

from __future__ import annotations

import errno

import pytest

from metrosep.batch.index import exit_code
from metrosep.batch.units import Unit
from metrosep.batch.work import as_reason, exit_code_of, is_disk_full, worth_another_try
from metrosep.cli.errors import exit_code_of as code_of_run
from metrosep.core import errors

UNIT = Unit("mo/a.x3p", "/data/in/mo/a.x3p", ("/data/in/mo/a.x3p",), "a")
SET = Unit("s1", "/data/in/s1", ("/data/in/s1/r1.csv", "/data/in/s1/r2.csv"), "s1")


@pytest.mark.parametrize("name", [n for n in errors.__all__ if n != "CorruptFileError"])
def test_codes_are_those_of_run(name):
    error = getattr(errors, name)("words")
    assert exit_code_of(error) == code_of_run(error)


def test_a_full_disk_is_seen_behind_other_errors():
    behind = errors.WriteError("cannot be written")
    behind.__context__ = OSError(errno.ENOSPC, "No space left on device")
    behind.__suppress_context__ = True  # as `raise ... from None` leaves it
    assert is_disk_full(behind)
    assert worth_another_try(behind)
    assert not is_disk_full(OSError(errno.EACCES, "Permission denied"))
    assert not is_disk_full(ValueError("x"))


@pytest.mark.parametrize(
    ("error", "again"),
    [
        (errors.CorruptFileError("a.x3p", "cut"), False),
        (errors.UnknownFormatError("x"), False),
        (errors.InvalidSamplesError("x"), False),
        (errors.UnsupportedFeatureError("install y"), True),
        (PermissionError(errno.EACCES, "Permission denied"), True),
        (MemoryError(), True),
        (ZeroDivisionError("bug"), True),
    ],
)
def test_what_failed_by_its_content_is_not_tried_again(error, again):
    assert worth_another_try(error) is again


def test_reasons_are_one_line_without_machine_paths():
    assert (
        as_reason(errors.ReadError("/data/in/mo/a.x3p: cut\nshort"), UNIT) == "mo/a.x3p: cut short"
    )
    assert as_reason(errors.ReadError("/data/in/s1/r2.csv: cut"), SET) == "s1/r2.csv: cut"
    assert as_reason(errors.ReadError("/data/in/s1: no file"), SET) == "s1: no file"
    assert "No such" in as_reason(FileNotFoundError(errno.ENOENT, "No such file"), UNIT)
    assert "bug in metrosep" in as_reason(KeyError("x"), UNIT)


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        ([], 0),
        ([("accepted", 0), ("measured", 0)], 0),
        ([("accepted", 0), ("inconclusive", 3)], 3),
        ([("rejected", 1), ("inconclusive", 3)], 1),
        ([("rejected", 1), ("failed", 4)], 6),
        ([("refused", 4)], 6),
        ([("failed", 1)], 6),
        ([("failed", 4), ("failed", 5)], 5),
    ],
)
def test_the_worst_code_wins(rows, code):
    assert exit_code([{"status": s, "exit_code": c} for s, c in rows]) == code

"""The one table of exit codes."""

from __future__ import annotations

import pytest

from metrosep.core import errors
from metrosep.core.exit_codes import EXIT_CODES, INTERNAL, exit_code_of

WANTED = {
    "SignCheckFailedError": 1,
    "SignNotConfirmedError": 1,
    "PointlessTableError": 1,
    "InconclusiveTableError": 3,
    "LimitError": 1,
    "TableError": 2,
    "RecipeError": 2,
    "WriteError": 2,
    "UnitError": 2,
    "DataError": 2,
    "OptionError": 2,
    "OptionRangeError": 2,
    "ReadOptionError": 2,
    "ReadNameError": 4,
    "WriteOptionError": 2,
    "ReadError": 4,
    "FileMissingError": 4,
    "FileAccessError": 4,
    "NameNotFoundError": 2,
    "RecipeMissingError": 2,
    "UnknownFormatError": 4,
    "AmbiguousFormatError": 4,
    "FormatMismatchError": 4,
    "UnsupportedFeatureError": 4,
    "InvalidSamplesError": 4,
    "NotUniformError": 4,
    "TooFewSamplesError": 4,
    "FitError": 4,
    "DegenerateFitError": 4,
    "NotConvergedError": 4,
    "SeparationError": 4,
    "NotSeparableError": 4,
    "MetrosepError": INTERNAL,
}


@pytest.mark.parametrize(
    "name", [n for n in errors.__all__ if n not in ("CorruptFileError", "Example")]
)
def test_each_error_of_the_tree_has_its_code(name):
    assert exit_code_of(getattr(errors, name)("words")) == WANTED[name]


def test_a_corrupt_file_cannot_be_read():
    assert exit_code_of(errors.CorruptFileError("a.x3p", "cut")) == 4


def test_no_wide_kind_hides_a_narrow_one():
    kinds = [kind for kind, _ in EXIT_CODES]
    hidden = [
        (wide.__name__, narrow.__name__)
        for i, wide in enumerate(kinds)
        for narrow in kinds[i + 1 :]
        if issubclass(narrow, wide)
    ]
    assert hidden == []


def test_what_only_the_caller_knows_comes_after_the_table():
    more = ((OSError, 4), (errors.LimitError, 3))
    assert exit_code_of(OSError("gone")) == INTERNAL == 5
    assert exit_code_of(FileNotFoundError("gone"), more) == 4
    assert exit_code_of(errors.LimitError("x"), more) == 1

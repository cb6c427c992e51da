"""Exit codes of errors: one table for the command line, the rows of a batch and the workbench.

1 rejected (also: a table that would not shrink the error or exceeds a limit), 2 recipe or usage
error (also: an output that cannot be written), 3 inconclusive, 4 input unreadable or unusable, 5 internal error.
"""

from __future__ import annotations

from typing import TypeAlias

from metrosep.core import errors

Codes: TypeAlias = tuple[tuple[type[BaseException], int], ...]

INTERNAL = 5
"""Code of what metrosep did not raise on purpose."""

EXIT_CODES: Codes = (
    (errors.SignCheckFailedError, 1),
    (errors.PointlessTableError, 1),
    (errors.InconclusiveTableError, 3),
    (errors.SignNotConfirmedError, 1),
    (errors.LimitError, 1),
    (errors.TableError, 2),
    (errors.RecipeError, 2),
    (errors.WriteError, 2),
    (errors.UnitError, 2),
    (errors.OptionError, 2),
    (errors.OptionRangeError, 2),
    (errors.ReadError, 4),
    (errors.SeparationError, 4),
    (errors.FitError, 4),
    (errors.InvalidSamplesError, 4),
    (errors.NotUniformError, 4),
    (errors.TooFewSamplesError, 4),
    (errors.DataError, 2),
)
"""The first kind that fits counts: a narrow one stands before the wide one that it belongs to."""


def exit_code_of(error: BaseException, more: Codes = ()) -> int:
    """Return the exit code for an error.

    Examples
    --------
    >>> exit_code_of(errors.LimitError("too steep")), exit_code_of(errors.TableError("no entries"))
    (1, 2)
    >>> exit_code_of(OSError("gone")), exit_code_of(OSError("gone"), ((OSError, 4),))
    (5, 4)
    """
    return next((code for kind, code in (*EXIT_CODES, *more) if isinstance(error, kind)), INTERNAL)

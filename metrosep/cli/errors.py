"""Exit codes and one-line errors of the command line.

0 accepted, 1 rejected (also: a table that would not shrink the error), 2 usage or recipe error, 3
inconclusive, 4 input unreadable or unusable, 5 internal error, 130 interrupted.
"""

from __future__ import annotations

import sys
import traceback

from metrosep.core import errors

__all__ = ["EXIT_CODES", "exit_code_of", "report_error", "verdict_code"]

EXIT_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (errors.TableError, 1),
    (errors.RecipeError, 2),
    (errors.WriteError, 2),
    (errors.UnitError, 2),
    (errors.ReadError, 4),
    (errors.SeparationError, 4),
    (errors.FitError, 4),
    (errors.InvalidSamplesError, 4),
    (errors.NotUniformError, 4),
    (errors.TooFewSamplesError, 4),
    (errors.DataError, 2),
    (KeyboardInterrupt, 130),
)


def exit_code_of(error: BaseException) -> int:
    """Return the exit code for an error.

    Parameters
    ----------
    error : BaseException
        What was raised.

    Returns
    -------
    int
        5 for what metrosep did not raise on purpose.
    """
    for kind, code in EXIT_CODES:
        if isinstance(error, kind):
            return code
    return 5


def verdict_code(verdict: str | None) -> int:
    """Return the exit code for a verdict.

    Parameters
    ----------
    verdict : str or None
        "accept", "reject", "inconclusive" or none.

    Returns
    -------
    int
        0, 1, 3; 0 where nothing was to be judged.
    """
    return {"reject": 1, "inconclusive": 3}.get(verdict or "", 0)


def report_error(error: BaseException, *, verbosity: int) -> int:
    """Print one line about an error and return the exit code.

    Parameters
    ----------
    error : BaseException
        What was raised.
    verbosity : int
        2 or more prints the traceback too.

    Returns
    -------
    int
        Exit code.
    """
    code = exit_code_of(error)
    if verbosity >= 2:
        traceback.print_exception(error, file=sys.stderr)
    if code == 130:
        line = "interrupted; nothing half-written was left behind"
    elif code == 5:
        line = (
            f"internal error ({type(error).__name__}: {error}); this is a bug in metrosep: run again "
            "with -vv and report it"
        )
    else:
        line = str(error)
    print("error: " + " ".join(line.split()), file=sys.stderr)
    return code

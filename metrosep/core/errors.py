"""The tree of errors that metrosep raises; each message says what, where, why and what to do.

::

    MetrosepError
    |-- ReadError                     a file cannot become a measurement
    |   |-- FileMissingError (FileNotFoundError)
    |   |-- FileAccessError (PermissionError)
    |   |-- UnknownFormatError (ValueError)   no reader knows the content
    |   |-- AmbiguousFormatError      two readers are sure
    |   |-- FormatMismatchError       the content is not what the caller declared
    |   |-- CorruptFileError (ValueError)     bytes that do not fit (path, offset, field, expected, found)
    |   `-- UnsupportedFeatureError (NotImplementedError)   a legal file that this version does not read
    |-- WriteError (OSError)          a result cannot be written; nothing half-written is left
    |-- DataError (ValueError)        numbers that cannot be used
    |   |-- NotUniformError
    |   |-- TooFewSamplesError
    |   |-- InvalidSamplesError
    |   |   `-- OptionRangeError    an argument out of its range
    |   |-- OptionError (TypeError)   an argument of the wrong kind, an unknown keyword
    |   |-- NameNotFoundError (KeyError)   no channel, column, part or parameter of that name
    |   `-- UnitError
    |-- FitError
    |   |-- DegenerateFitError
    |   `-- NotConvergedError
    |-- SeparationError
    |   `-- NotSeparableError
    |-- TableError
    |   |-- LimitError
    |   |-- SignCheckFailedError      the dry-run makes the machine worse
    |   |-- InconclusiveTableError    the readings do not show that the table helps
    |   |-- PointlessTableError       it removes less than 30 % of the error
    |   `-- SignNotConfirmedError     nobody knows the controller's sign yet
    `-- RecipeError                   key and line of a recipe
        `-- RecipeMissingError (FileNotFoundError)
"""

from __future__ import annotations

import errno
from typing import Any, Self

__all__ = [
    "AmbiguousFormatError",
    "CorruptFileError",
    "DataError",
    "DegenerateFitError",
    "Example",
    "FileAccessError",
    "FileMissingError",
    "FitError",
    "FormatMismatchError",
    "InconclusiveTableError",
    "InvalidSamplesError",
    "LimitError",
    "MetrosepError",
    "NameNotFoundError",
    "NotConvergedError",
    "NotSeparableError",
    "NotUniformError",
    "OptionError",
    "OptionRangeError",
    "PointlessTableError",
    "ReadError",
    "ReadNameError",
    "ReadOptionError",
    "RecipeError",
    "RecipeMissingError",
    "SeparationError",
    "SignCheckFailedError",
    "SignNotConfirmedError",
    "TableError",
    "TooFewSamplesError",
    "UnitError",
    "UnknownFormatError",
    "UnsupportedFeatureError",
    "WriteError",
    "WriteOptionError",
]


class Example(str):
    """A value in a hint that shows the form: a person gives another."""

    __slots__ = ()


class MetrosepError(Exception):
    """Base of every error that metrosep raises on purpose; it travels between processes whole.

    Attributes
    ----------
    hints : tuple of dict
        Ways out, the best one first: arguments, as keys of a recipe, with the value that helps; an
        `Example` where a person gives it, None where the key is to be omitted.
    """

    hints: tuple[dict[str, Any], ...] = ()

    def hinting(self, **keys: Any) -> Self:
        """Add a way out to what the message says.

        Parameters
        ----------
        **keys
            Arguments of what was called, with values as a recipe has them.

        Returns
        -------
        MetrosepError
            This error.

        Examples
        --------
        >>> NotSeparableError("one feedrate").hinting(method="mean").hints
        ({'method': 'mean'},)
        """
        self.hints = (*self.hints, keys)
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Restore from args and attributes: some errors are made from more than their message."""
        state = dict(self.__dict__)
        if isinstance(self, OSError):  # which keeps these beside its attributes
            state |= {k: getattr(self, k) for k in ("errno", "strerror", "filename")}
        return _restored, (type(self), self.args), state

    def __str__(self) -> str:
        """Return the message, whatever a native base would print."""
        return str(self.args[0]) if self.args else ""


def _restored(kind: type[BaseException], args: tuple[Any, ...]) -> BaseException:
    native: Any = kind
    while native.__module__ != "builtins":  # whose own maker a second base would hide
        native = native.__base__
    made: BaseException = native.__new__(kind, *args)
    made.args = args  # which an OSError leaves to a maker that is not called here
    return made


class ReadError(MetrosepError):
    """A file cannot be turned into a measurement."""


class FileMissingError(ReadError, FileNotFoundError):
    """There is no such file.

    Parameters
    ----------
    message : str
        What is missing and what to do.
    filename : str, optional
        The file, as for FileNotFoundError.
    """

    def __init__(self, message: str, filename: str | None = None) -> None:
        super().__init__(message)
        self.errno = errno.ENOENT
        self.filename = filename


class FileAccessError(ReadError, PermissionError):
    """The file is there, and may not be read.

    Parameters
    ----------
    message : str
        What may not be read and what to do.
    filename : str, optional
        The file, as for PermissionError.
    """

    def __init__(self, message: str, filename: str | None = None) -> None:
        super().__init__(message)
        self.errno = errno.EACCES
        self.filename = filename


class UnknownFormatError(ReadError, ValueError):
    """No reader recognises the content of the file."""


class AmbiguousFormatError(ReadError, ValueError):
    """More than one reader is sure of the content; name one with ``format=``."""


class FormatMismatchError(ReadError, ValueError):
    """The content is not what the caller declared (a column, a unit, a format)."""


class CorruptFileError(ReadError, ValueError):
    """Bytes do not fit their own format.

    Parameters
    ----------
    path : str
        The file.
    reason : str
        One clause that says what is wrong.
    offset : int, optional
        Byte (or line, for text) at which it was noticed.
    field : str, optional
        Name of the field in the format's description.
    expected, found : object, optional
        What the format demands and what the file holds.
    hint : str, optional
        What the user can do.
    """

    def __init__(
        self,
        path: object,
        reason: str,
        *,
        offset: int | None = None,
        field: str | None = None,
        expected: object = None,
        found: object = None,
        hint: str = "re-export the file from the instrument or copy it again",
    ) -> None:
        self.path = str(path)
        self.reason = reason
        self.offset = offset
        self.field = field
        self.expected = expected
        self.found = found
        parts = [f"{self.path}: {reason}"]
        if field is not None:
            is_place = field.startswith(("line ", "lines ", "row ", "rows ", "column "))
            parts.append(field if is_place else f"field {field}")
        if offset is not None:
            parts.append(f"at offset {offset}")
        if expected is not None:
            parts.append(f"expected {expected}")
        if found is not None:
            parts.append(f"found {found}")
        super().__init__(", ".join(parts) + f"; {hint}")


class UnsupportedFeatureError(ReadError, NotImplementedError):
    """The file is legal, but uses something this version does not read."""


class WriteError(MetrosepError, OSError):
    """A result cannot be written; no half-written file is left behind.

    Parameters
    ----------
    message : str
        What cannot be written, why, and what to do.
    cause : OSError, optional
        What the system said; errno, strerror and filename are its own.
    filename : str, optional
        The file that was to be written, where the cause names another.
    """

    def __init__(
        self, message: str, cause: OSError | None = None, filename: str | None = None
    ) -> None:
        super().__init__(message)
        if cause is not None:
            self.errno, self.strerror = cause.errno, cause.strerror
            self.filename = cause.filename if filename is None else filename


class DataError(MetrosepError, ValueError):
    """Numbers that cannot be used as they are."""


class NotUniformError(DataError):
    """A uniform grid is needed and the positions are not uniform."""


class TooFewSamplesError(DataError):
    """Fewer samples than the method needs."""


class InvalidSamplesError(DataError):
    """Samples are NaN, infinite, out of order or inconsistent."""


class OptionRangeError(InvalidSamplesError):
    """An argument that is a number, but not one that can be used: NaN, negative, out of its range."""


class OptionError(DataError, TypeError):
    """An argument of the wrong kind (a truth value or a text for a number), or an unknown keyword."""


class NameNotFoundError(DataError, KeyError):
    """No channel, column, part or parameter has that name."""


class ReadNameError(FormatMismatchError, NameNotFoundError):
    """The file holds no column, channel, worksheet or term of the name that the caller gave."""


class ReadOptionError(FormatMismatchError, OptionError):
    """A keyword that the reader of this file does not take."""


class WriteOptionError(WriteError, OptionError):
    """A keyword that the writer of this format does not take."""


class UnitError(DataError):
    """A unit is missing, unknown or of the wrong dimension."""


class FitError(MetrosepError):
    """A fit has no trustworthy answer."""


class DegenerateFitError(FitError):
    """The data do not determine the parameters."""


class NotConvergedError(FitError):
    """The iteration ended before its criterion was met."""


class SeparationError(MetrosepError):
    """An error separation cannot be run."""


class NotSeparableError(SeparationError):
    """The readings cannot tell the parts from each other."""


class TableError(MetrosepError):
    """A compensation table cannot be made, read or written."""


class LimitError(TableError):
    """A table exceeds a limit of its controller or machine."""


class SignCheckFailedError(TableError):
    """The dry-run of a table makes the measured error larger, or cannot prove it where it must."""


class InconclusiveTableError(TableError):
    """The readings do not show that a table makes the machine better."""


class PointlessTableError(TableError):
    """A table removes less than 30 % of the error that repeats."""


class SignNotConfirmedError(TableError):
    """The sign of a controller is not known, and nobody has tried it on the machine."""


class RecipeError(MetrosepError):
    """A recipe is wrong.

    Parameters
    ----------
    message : str
        What is wrong and what would be right.
    key : str, optional
        The key in the recipe.
    line : int, optional
        Its line, from 1.
    table : (str, int), optional
        Header of the table that is wrong, such as ``[[check]]``, and its number among those, from 0.
    """

    def __init__(
        self,
        message: str,
        *,
        key: str | None = None,
        line: int | None = None,
        table: tuple[str, int] | None = None,
    ) -> None:
        self.key = key
        self.line = line
        self.table = table
        super().__init__(message)


class RecipeMissingError(RecipeError, FileNotFoundError):
    """There is no such recipe.

    Parameters
    ----------
    message : str
        What is missing and what to do.
    filename : str, optional
        The file, as for FileNotFoundError.
    """

    def __init__(self, message: str, filename: str | None = None) -> None:
        super().__init__(message)
        self.errno = errno.ENOENT
        self.filename = filename

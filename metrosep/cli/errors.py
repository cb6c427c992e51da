"""Exit codes and one-line errors of the command line.

0 accepted, 1 rejected (also: a table that would not shrink the error or exceeds a limit), 2 usage or
recipe error (also: an output that cannot be written), 3 inconclusive, 4 input unreadable or
unusable, 5 internal error, 130 interrupted.
"""

from __future__ import annotations

import errno
import re
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from metrosep.core import exit_codes
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.core.units import format_length

_INTERRUPTED = 130

_STDOUT_ERRORS = (errno.ENOSPC, errno.EIO, errno.EBADF, errno.EINVAL)


_READER_OPTIONS = frozenset(
    {
        *TEXT_OPTIONS, "group", "max_pixels", "names", "numbered", "overhang", "radius", "row_order",
        "sampling_rate", "scale", "segment", "servo_period", "slope", "time", "x", "y", "z",
    }
)  # fmt: skip
"""Options of readers that the commands about files take with ``--set``."""


_PLACES = ("x", "y", "z")
"""Options whose names a message also uses for a place in m."""


_ASKED = r"\b(?:raise|lower|give|state|say|set|leave|leave out|allow)(?: (?:its|a smaller|a larger|[a-z]+,? (?:and|or)))? "
_SUBJECT = r"(?:^|(?<=[:;.] )|(?<=\bthat ))"
_RULED = r" (?:allows?\b|must\b|is (?:a share|one of)\b|is [-+'\d][^\s;]*(?:;| with )|are (?:for|needed)\b)"
"""Before and behind the names of options: "raise max_filled", "that max_filled allows"."""


_CALL = re.compile(
    r"\bread (?:it|them|repeated runs) with metrosep\.read_runs\([^()]*\),? or (?=(metrosep)?)"
)
"""A way out that is a call of Python, before the command that does the same."""


_SKIPPED = re.compile(
    r"leave that line out with (?:--)?skip[-_]lines ?=? ?\W?[\d,-]+\W?(?! in \[input\])"
)
"""A way out that a command lacks whose files are read without options."""


def _place(name: str, number: str) -> str:
    """Return a place in m as a reader wants it; the text itself where it is not a number."""
    digits = number.rstrip(".")
    try:
        return f"{name} = {format_length(float(digits))}{number[len(digits) :]}"
    except ValueError:
        return f"{name}={number}"


def as_options(
    message: str,
    names: Collection[str],
    facts: Collection[str] = (),
    hints: Iterable[Mapping[str, object]] | None = (),
) -> str:
    """Return a message of the library with its arguments written as options of a command.

    Those of `facts` are written as ``--machine NAME=VALUE``: without a value, and with one that is among the
    `hints` of the error; None hints with all, as what mends a finding does.

    Notes
    -----
    A place, ``at x=0.02145``, is not an option: it is written as ``at x = 21.45 mm``. Arguments of a
    call of Python stay.

    Examples
    --------
    >>> as_options("give scale='2.5 um/V', or decimal=", ("scale", "decimal"))
    'give --scale "2.5 um/V", or --decimal'
    """
    asked = {(k, str(v)) for hint in hints or () for k, v in hint.items()}

    def fact(name: str, value: str | None) -> str | None:
        if value and hints is not None and (name, value) not in asked:
            return None
        return f'--machine "{name}={value or "..."}"'

    def option(found: re.Match[str]) -> str:
        before = found.string[: found.start()]
        # a call of Python (a column may be called "Travel (in)"), or written already
        call = re.sub(r"=\s*'[^']*'", "=", before)
        if re.search(r"\w\([^()]*$", call) or re.search(r"--machine \"?$", before):
            return found.group()
        if re.search(r"(?:^|[^\w=])(?<!= )['\"]$", before):  # the name of a column
            return found.group()
        if found.group(1) in _PLACES and before.endswith("at ") and found.group(4):
            return _place(found.group(1), found.group(4))
        quoted, plain = found.group(3), found.group(4)
        value = quoted if plain is None else plain
        if "settings" in names and found.group(1) == "format" and value:
            return f"--as {value}"
        if "settings" in names and found.group(1) in _READER_OPTIONS - set(names):
            return f'--set "{found.group(1)}={value or "..."}"'
        if found.group(1) not in names:
            said = fact(found.group(1), value) if found.group(1) in facts else None
            return said or found.group()
        if value and not re.fullmatch(r"[\w.+:-]+", value):
            value = f'"{value}"'
        flag = _flag(found.group(1), names)
        return f"{flag} {value}" if value and value != "True" else flag

    if names:
        message = _CALL.sub(lambda found: "use " if found[1] else "", message)
    message = re.sub(r"\bunit=\{'([^']*)': '([^']*)'\}", r"unit='\1:\2'", message)
    if "x" in names or "settings" in names:
        message = re.sub(r"\b([a-z]+)=\('([^']*)', '([^']*)'\)", r"\1='\2:\3'", message)
    if "x" in names:
        message = re.sub(r" or unit=(?!\S)", "", message)
    if names:
        overwrite = " or give --force" if "force" in names else ""
        message = message.replace(" or say overwrite", overwrite)
    if names and "exclude" not in names:  # of the command that has these
        message = re.sub(
            r"\b(exclude|accept)='([^']*)'", r'--\1 "\2" of metrosep separate', message
        )
    if "table_" in names or "format_" in names:
        new = r"--format \1" if "format_" in names else r"--table \1=FILE"
        message = re.sub(r"\bcontroller='([\w-]+)'", new, message)
    if "table_direction" in names:  # --direction names a column of the runs
        ways = r"direction=(['\"])(auto|both|split|forward|reverse)\1"
        message = re.sub(rf"(?<![\w.-]){ways}", r"--table-direction \2", message)
    message = re.sub(r"(?<![\w.-])([a-z_]+)=(?:(['\"])(.*?)\2|([\w.+-]+))?", option, message)
    return bare_options(message, names)


def bare_options(message: str, names: Iterable[str]) -> str:
    """Return a message in which names of two words and more, such as max_filled, are those of options.

    Only where the sentence speaks of an option: a column or a file may be called so too.

    Examples
    --------
    >>> bare_options("crop, or raise max_filled", ("max_filled", "limit"))
    'crop, or raise --max-filled'
    """
    words = "|".join(sorted((n for n in names if "_" in n.strip("_")), reverse=True))
    if not words:
        return message
    one = rf"(?:{words})(?!\w|[.-]\w|[\"'`/=\](]| = )"
    several = rf"{one}(?:(?:, (?:and |or )?| and | or ){one})*"

    def options(found: re.Match[str]) -> str:
        return found[1] + re.sub(one, lambda m: _flag(m[0], names), found[2])

    message = re.sub(rf"({_ASKED})({several})", options, message)
    return re.sub(rf"({_SUBJECT})({several})(?={_RULED})", options, message)


def _flag(name: str, names: Iterable[str]) -> str:
    """Return the option of an argument of the library."""
    return names[name] if isinstance(names, Mapping) else f"--{name.replace('_', '-')}"


def flags_of(command: Any) -> dict[str, str]:
    """Return the option of each parameter of a command, as it is typed."""
    long = {p.name: next((o for o in p.opts if o.startswith("--")), "") for p in command.params}
    return {name: flag for name, flag in long.items() if name and flag}


def exit_code_of(error: BaseException) -> int:
    """Return the exit code for an error."""
    code = exit_codes.exit_code_of(error, ((KeyboardInterrupt, _INTERRUPTED),))
    return 2 if code == exit_codes.INTERNAL and is_standard_output(error) else code


def is_standard_output(error: BaseException) -> bool:
    """Return whether an error says that standard output cannot be written."""
    if isinstance(error, BrokenPipeError):
        return True
    return isinstance(error, OSError) and error.filename is None and error.errno in _STDOUT_ERRORS


def verdict_code(verdict: str | None) -> int:
    """Return the exit code for a verdict."""
    return {"reject": 1, "inconclusive": 3}.get(verdict or "", 0)


def report_error(
    error: BaseException,
    *,
    verbosity: int,
    names: Collection[str] = (),
    facts: Collection[str] = (),
    words: Callable[[str], str] | None = None,
) -> int:
    """Print one line about an error and return the exit code."""
    code = exit_code_of(error)
    if verbosity >= 2:
        traceback.print_exception(error, file=sys.stderr)
    if isinstance(error, BrokenPipeError):  # the reader had enough: nothing to tell
        return code
    if code == _INTERRUPTED:
        line = "interrupted; nothing half-written was left behind"
    elif code == exit_codes.INTERNAL:
        line = (
            f"internal error ({type(error).__name__}: {error}); this is a bug in metrosep: run again "
            "with -vv and report it"
        )
    elif is_standard_output(error):
        line = f"standard output cannot be written ({getattr(error, 'strerror', error)}); send it elsewhere"
    else:
        hints = getattr(error, "hints", ())
        line = as_options(str(error), names, facts, hints) if words is None else words(str(error))
        if names and not {"skip_lines", "settings"}.intersection(names):
            line = _SKIPPED.sub("take that line out", line)
    print("error: " + " ".join(line.split()), file=sys.stderr)
    return code

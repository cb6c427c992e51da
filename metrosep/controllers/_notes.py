"""metrosep's own comment in a file: facts that its grammar cannot say, and a checksum of the rest.

A comment is ``metrosep: key=value key=value check=digits``. The checksum covers the facts and
every line that is not a comment, with blanks counting as one, so that a lost, doubled or exchanged
row and a number that was cut are found where no sidecar is left. A file of others has no such
comment, and nothing is checked.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.controllers.options import Option
from metrosep.core.errors import CorruptFileError, DataError

__all__ = ["agreed", "is_note", "note", "read_notes"]

_MARK = "metrosep: "
_CHECK = "check"


def note(facts: Mapping[str, object], body: Iterable[str]) -> str:
    """Return the comment, without the characters that start one.

    Examples
    --------
    >>> note({"entry_sign": 1}, ["0 1"]).split(" check=")[0]
    'metrosep: entry_sign=1'
    """
    words = [f"{k}={v}" for k, v in facts.items()]
    return _MARK + " ".join([*words, f"{_CHECK}={_checksum(words, body)}"])


def is_note(comment: str) -> bool:
    """Return whether a comment is one of metrosep with facts."""
    return comment.strip().startswith(_MARK)


def read_notes(comments: Iterable[str], body: Sequence[str], path: Path) -> dict[str, str]:
    """Return the facts of a file, after a check of its lines."""
    told: dict[str, str] = {}
    for comment in filter(is_note, comments):
        words = comment.strip().removeprefix(_MARK).split()
        pairs = [w.partition("=") for w in words]
        for key, _, value in pairs:
            if told.setdefault(key, value) != value:
                raise CorruptFileError(
                    path,
                    f"two comments of metrosep contradict each other: {key}={told[key][:20]} and "
                    f"{key}={value[:20]}",
                    hint="files were put together: take them apart, or write the table again",
                )
        checks = [value for key, _, value in pairs if key == _CHECK]
        facts = [w for w in words if not w.startswith(f"{_CHECK}=")]
        if checks and checks != [_checksum(facts, body)]:
            raise CorruptFileError(
                path,
                "its lines are not those that metrosep wrote: it was cut short, or a line was lost, "
                "doubled, exchanged or changed",
                field=_CHECK,
                expected=checks[0][:10],
                found=_checksum(facts, body),
                hint="write the table again; to read what you changed on purpose, remove the comment "
                "that starts with 'metrosep:' and give its facts as options",
            )
    told.pop(_CHECK, None)
    return told


def agreed(
    noted: Mapping[str, str],
    known: Iterable[Option],
    given: Mapping[str, Any],
    path: Path,
) -> dict[str, Any]:
    """Return what a file and the user say about options, and refuse if they contradict."""
    found = dict(given)
    for option in known:
        if option.name not in noted:
            continue
        try:
            value = option.checked(noted[option.name], "comment in the file")
        except DataError as exc:
            raise CorruptFileError(path, str(exc)) from None
        if found.setdefault(option.name, value) != value:
            raise DataError(
                f"{path}: you or its sidecar say {option.name}={found[option.name]}, the comment in "
                f"the file says {value}; leave the option out, or use the file that fits"
            )
    return found


def _checksum(facts: Iterable[str], body: Iterable[str]) -> str:
    lines = [" ".join(facts), *(" ".join(line.split()) for line in body)]
    return str(zlib.crc32("\n".join(lines).encode("utf-8")))

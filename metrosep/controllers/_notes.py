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

from metrosep.controllers.base import Dialect, load_sidecar, sidecar_options
from metrosep.controllers.options import Option
from metrosep.core.errors import CorruptFileError, DataError

__all__ = [
    "agreed",
    "fact",
    "is_note",
    "named_axes",
    "note",
    "own_axis",
    "read_notes",
    "require_agreement",
]

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


# ---- what a file, its sidecar and the user say about a fact: all that speak must agree ---------

_NEAR = 1e-9
"""Relative difference of two numbers that are one fact: rounding of a printed one."""


def named_axes(fields: dict[str, Any], axes: tuple[str, str], path: Path) -> dict[str, Any]:
    """Return the fields of a table whose file names its axes, and refuse another sidecar."""
    if load_sidecar(path).get("table"):
        said = (fields["axis"], fields["compensates"])
        require_agreement(path, "the axes", ("the file", axes), ("its sidecar", said))
    return {**fields, "axis": axes[0], "compensates": axes[1]}


def own_axis(fields: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the axes of a file that shifts the axis it looks up, and refuse a sidecar with two."""
    if fields["compensates"] != fields["axis"]:
        raise CorruptFileError(
            path,
            f"its sidecar says {fields['axis']} -> {fields['compensates']}, but this format shifts the "
            "axis that it looks up",
            hint="do not load it; write the table for a controller that corrects another axis",
        )
    return fields


def fact(
    dialect: Dialect,
    name: str,
    given: Mapping[str, Any],
    in_file: Mapping[str, Any],
    path: Path,
) -> Any:
    """Return an option that the user gave, the file states or its sidecar knows; all must agree."""
    told = {
        "the file": in_file.get(name),
        "its sidecar": sidecar_options(path, dialect.options).get(name),
        "you": given.get(name),
    }
    known = {who: value for who, value in told.items() if value is not None}
    for who, value in known.items():
        first, wanted = next(iter(known.items()))
        require_agreement(path, name, (first, wanted), (who, value))
    if known:
        return next(iter(known.values()))
    option = next(o for o in dialect.options if o.name == name)
    raise DataError(
        f"{path}: neither the file nor a sidecar tells {name} ({option.help}); give {name}=..."
    )


def require_agreement(path: Path, name: str, one: tuple[str, Any], other: tuple[str, Any]) -> None:
    """Refuse two statements about a fact that contradict each other."""
    a, b = one[1], other[1]
    if a is None or b is None or a == b:
        return
    near = isinstance(a, float) and isinstance(b, int | float)
    if near and abs(a - b) <= _NEAR * max(abs(a), abs(b)):
        return
    raise DataError(
        f"{path}: {one[0]} says {name}={a!r}, {other[0]} "
        f"{'say' if other[0] == 'you' else 'says'} {name}={b!r}; one is wrong: leave the option "
        "out, or take the file that fits"
    )

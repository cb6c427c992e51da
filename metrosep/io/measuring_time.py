"""When something was measured, as its file says; a clock of this computer is never asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

__all__ = ["measured_at", "moment_of"]

Header = Mapping[str, Any]

_FIRST, _LAST = 1980, 2199
"""Years outside are no dates of measuring: writers without a clock put 1970 or zeros."""


def measured_at(metadata: Mapping[str, Any]) -> str | None:
    """Return the date and time of measuring that the file of a map or profile states.

    Examples
    --------
    >>> measured_at({"format": "sdf", "header": {"CreateDate": "030120261215"}})
    '2026-01-03T12:15:00'
    >>> measured_at({"format": "sdf", "header": {"CreateDate": "010119700000"}}) is None
    True
    """
    header = metadata.get("header")
    read = _READ.get(str(metadata.get("format")))
    found: datetime | None = None
    with suppress(ValueError, TypeError, KeyError, OverflowError, OSError, AttributeError):
        if "measured_at" in metadata:
            found = datetime.fromisoformat(str(metadata["measured_at"]))
        elif read is not None and isinstance(header, Mapping):
            found = read(header)
    if found is None or not _FIRST <= found.year <= _LAST:
        return None
    return found.isoformat()


def moment_of(text: str) -> datetime:
    """Return a text of `measured_at` as a time that can be compared with others.

    Examples
    --------
    >>> moment_of("2026-01-03T13:00:00+01:00") == moment_of("2026-01-03T12:00:00")
    True
    """
    found = datetime.fromisoformat(text)
    return found if found.tzinfo is None else found.astimezone(UTC).replace(tzinfo=None)


def _unix(key: str) -> Callable[[Header], datetime]:
    return lambda header: datetime.fromtimestamp(int(header[key]), UTC)


def _sdf(header: Header) -> datetime:
    """Day, month, year, hour and minute as twelve digits (EUNA 15178)."""
    return datetime.strptime(str(header["CreateDate"]).strip(), "%d%m%Y%H%M")


def _x3p(header: Header) -> datetime:
    return datetime.fromisoformat(str(header["Record2/Date"]).strip())


def _digital_surf(header: Header) -> datetime:
    year, month, day, hour, minute, second = (
        int(header[k]) for k in ("year", "month", "day", "hour", "minute", "second")
    )
    return datetime(year, month, day, hour, minute, second)


_READ: Mapping[str, Callable[[Header], datetime]] = {
    "sdf": _sdf,
    "x3p": _x3p,
    "digital-surf": _digital_surf,
    "metropro": _unix("time_stamp"),
    "zygo-xyz": _unix("time_stamp"),
    "plu": _unix("unix_time"),
}

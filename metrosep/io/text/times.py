"""Dates and times of day as loggers write them: seconds from the first row, and when that was.

Arithmetic is in whole nanoseconds; a float of seconds since 1970 would keep 0.2 us. Nothing is
converted between time zones, and a day that may be a month is settled by the dates themselves or
refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import AmbiguousFormatError

__all__ = ["Moments", "RunningClock", "counted_moments", "is_moment", "may_be_minutes", "moments"]

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_GERMAN = {"mrz": 3, "mär": 3, "mai": 5, "okt": 10, "dez": 12}
_DATE = (
    r"(?:(?P<y>\d{4})(?P<s1>[-/.年])(?P<m>\d{1,2})[-/.月](?P<d>\d{1,2})日?"
    r"|(?P<a>\d{1,2})(?P<s2>[-/.])(?P<b>\d{1,2})(?P=s2)(?P<y2>\d{4}|\d{2})"
    r"|(?P<d3>\d{1,2})[- .]+(?P<name>[A-Za-zä]{3})[a-z]*[- .]+(?P<y3>\d{4}))"
)
_CLOCK = (
    r"(?:(?P<mi>\d{1,2}):(?P<sf>\d\d[.,]\d{1,9})"
    r"|(?P<h>\d{1,4}):(?P<min>\d\d)(?::(?P<sec>\d\d(?:[.,:]\d{1,9})?))?\s?(?P<half>[AaPp]\.?[Mm]\.?)?)"
)
_ZONE = r"\s?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?"
_MOMENT = re.compile(rf"{_DATE}(?:(?:T|,?\s+){_CLOCK}{_ZONE})?|{_CLOCK.replace('?P<', '?P<c_')}")
_SECOND = 10**9
_DAY = 86400 * _SECOND
_HALF = 43200 * _SECOND


class _Parts(NamedTuple):
    """What one text says: the numbers of its date, whether these may be swapped, ns of the day."""

    date: tuple[int, int, int] | None  # year, month, day; for a/b/y the month is taken as first
    swappable: bool
    ns: int | None
    zone: str
    form: str  # of the time of day: "hh:mm", "hh:mm:ss", "mm:ss.f"; empty without one


@dataclass(frozen=True, slots=True)
class Moments:
    """A column of moments: what it holds, and when each row was."""

    kind: str  # "moment", "date" or "clock"
    seconds: FloatArray  # shape (n,): from the first row, NaN where there is no text
    start: str  # the first moment as ISO 8601; two of them where day and month may be swapped


def is_moment(text: str) -> bool:
    """Return whether a field is a date, a time of day, or both."""
    return _MOMENT.fullmatch(text) is not None


def may_be_minutes(texts: Sequence[str]) -> bool:
    """Return whether times such as 12:30 may be hours and minutes, or minutes and seconds."""
    known = [t for t in texts if t]
    return bool(known) and all(re.fullmatch(r"\d{1,4}:\d\d", t) for t in known)


_COUNTED = (
    (1.2e17, 1.7e17, 1e-7, "ticks of 100 ns since 1601 (FILETIME)"),
    (1e18, 2.2e18, 1e-9, "ns since 1970"),
    (1e15, 2.2e15, 1e-6, "us since 1970"),
    (1e12, 2.2e12, 1e-3, "ms since 1970"),
    (1e9, 2.2e9, 1.0, "s since 1970"),
    (3e9, 4.5e9, 1.0, "s since 1904 (LabVIEW)"),
    (3e4, 7.5e4, 86400.0, "days of a spreadsheet"),
)
"""First and last number of each count of time in the years in which instruments write files."""
_SURE = 1e17  # as a time since the start of anything, in whatever unit, more than three years
_CALENDAR = re.compile(
    r"date|datum|time_?stamp|zeitstempel|unix|epoch|posix|filetime", re.IGNORECASE
)
"""Names of a column that says when a row was, not how long after the first."""
_FINE = {86400.0: 0.1 * 86400.0, 1e-3: 1.0}
"""Longest step in s of days (far below one) and of ms (as ns it would be 1 us: too fast for a table)."""


def counted_moments(name: str, values: FloatArray) -> tuple[FloatArray, str] | None:
    """Return numbers of a clock without a unit in s from the first, and what they count; else None.

    A time that runs from the start of a logger in ms has the numbers of days of a spreadsheet, one in
    us those of seconds since 1970: below `_SURE` the name must say that it is a date, and days and
    seconds must have fractions.
    """
    known = values[np.isfinite(values)]
    is_dated = _CALENDAR.search(name) is not None
    for low, high, seconds, what in _COUNTED:
        if not known.size or low > known.min() or known.max() > high:
            continue
        found = (values - known[0]) * seconds
        if low >= _SURE:
            return found, what
        steps = np.diff(known) * seconds
        is_fine = steps.size > 0 and float(np.max(steps)) <= _FINE.get(seconds, np.inf)
        has_fractions = seconds < 1.0 or bool(np.any(known % 1.0))
        if is_dated and is_fine and has_fractions:
            return found, what
    return None


def moments(
    texts: Sequence[str], lines: NDArray[np.int64], where: str, days: Sequence[str] | None = None
) -> Moments | None:
    """Return a column as moments, with the dates beside it; None where its texts are no moments."""
    parts = [_parts(t) for t in texts]
    known = [i for i, p in enumerate(parts) if p is not None]
    if not known or any(t for t, p in zip(texts, parts, strict=True) if p is None):
        return None
    if days is not None:
        beside = [_parts(d) for d in days]
        if any(b is None or b.date is None for b in beside):
            return None
        parts = [
            None if p is None or b is None else p._replace(date=b.date, swappable=b.swappable)
            for p, b in zip(parts, beside, strict=True)
        ]
    own = [p for p in parts if p is not None]
    dated = {p.date is not None for p in own}
    timed = {p.ns is not None for p in own}
    if len(dated) > 1 or len(timed) > 1:
        return None
    ns = np.zeros(len(own), dtype=np.int64)
    start = texts[known[0]]
    if dated == {True}:
        dates, start = _days(own, lines, where)
        ns = dates * _DAY
    if timed == {True}:
        _refuse_mixed(own, [texts[i] for i in known], [int(lines[i]) for i in known], where)
        clock = np.array([p.ns or 0 for p in own], dtype=np.int64)
        if dated == {False}:  # a clock that falls by half a day and more has passed midnight
            ns[1:] = np.cumsum(np.diff(clock) < -_HALF) * _DAY
        ns = ns + clock
        first = own[0]
        if dated == {True}:
            start = " or ".join(
                f"{day}T{_iso(clock[0])}{first.zone}" for day in start.split(" or ")
            )
    seconds = np.full(len(texts), np.nan)
    seconds[known] = (ns - ns[0]) * 1e-9
    kind = "moment" if dated == timed == {True} else "date" if dated == {True} else "clock"
    return Moments(kind, seconds, start)


class RunningClock:
    """A column of moments that comes in parts: seconds from its first row, the same as `moments` gives.

    What only the whole column can settle (a day that may be a month) is refused.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._first: int | None = None
        self._last = self._days = 0
        self._form: tuple[bool, str] | None = None

    def seconds(
        self, texts: Sequence[str], lines: NDArray[np.int64], days: Sequence[str] | None = None
    ) -> FloatArray:
        """Return the next part, NaN where there is no text; with the dates beside it, if there are."""
        found = np.full(len(texts), np.nan)
        for i, text in enumerate(texts):
            if not text:
                continue
            line = int(lines[i])
            part = self._plain(text, line)
            if days is not None:
                part = part._replace(date=self._plain(days[i], line).date)
            own = (part.date is not None, part.form)
            if self._form is None:
                self._form = own
            elif own != self._form:
                raise self._odd(text, line, "is of another form than those above it")
            if own == (False, "hh:mm"):
                raise self._odd(text, line, "may be hours and minutes, or minutes and seconds")
            ns = part.ns or 0
            if part.date is not None:
                ns += int(_day(*part.date).astype(np.int64)) * _DAY
            else:  # past midnight
                ns += self._days * _DAY
                if ns - self._last < -_HALF:
                    self._days += 1
                    ns += _DAY
            self._first = ns if self._first is None else self._first
            self._last = ns
            found[i] = (ns - self._first) * 1e-9
        return found

    def _plain(self, text: str, line: int) -> _Parts:
        part = _parts(text)
        if part is None or (part.date is not None and not _is_date(*part.date)):
            raise self._odd(text, line, "is not a date or a time of day")
        if part.swappable and part.date is not None and part.date[1] != part.date[2]:
            raise self._odd(
                text, line, "may be day/month or month/day, which only the whole tells"
            )
        return part

    def _odd(self, text: str, line: int, why: str) -> AmbiguousFormatError:
        return AmbiguousFormatError(
            f"{self._where}: line {line}: {text!r} {why}; read the file as a whole with metrosep.read, or "
            "name the other channels with channels="
        )


def _refuse_mixed(
    own: Sequence[_Parts], texts: Sequence[str], lines: Sequence[int], where: str
) -> None:
    """Refuse a column in which 12:30 may be hours and minutes, or minutes and seconds."""
    forms = [p.form for p in own]
    if len(set(forms)) == 1:
        return
    usual = max(set(forms), key=forms.count)
    i = next(i for i, form in enumerate(forms) if form != usual)
    raise AmbiguousFormatError(
        f"{where}: line {lines[i]}: time '{texts[i]}' stands among times of the form {usual}; write all "
        "of them alike, or give sampling_rate="
    )


def _days(
    own: Sequence[_Parts], lines: NDArray[np.int64], where: str
) -> tuple[NDArray[np.int64], str]:
    """Return the days since 1970, and the first; what may be day or month is settled or refused."""
    dates = [p.date for p in own if p.date is not None]
    readings = []
    for swapped in (False, True) if any(p.swappable for p in own) else (False,):
        try:
            readings.append(
                np.array(
                    [_day(y, *((d, m) if swapped else (m, d))) for y, m, d in dates], dtype="M8[D]"
                )
            )
        except ValueError:
            continue
    if not readings:
        i = next((i for i, p in enumerate(dates) if not _is_date(*p)), 0)
        raise AmbiguousFormatError(
            f"{where}: line {int(lines[i])}: no order of day, month and year fits all dates; write them "
            "as yyyy-mm-dd, or give sampling_rate="
        )
    first, last = readings[0], readings[-1]
    start = str(first[0]) if first[0] == last[0] else f"{first[0]} or {last[0]}"
    clock = np.array([p.ns or 0 for p in own], dtype=np.int64)
    likely = [r for r in readings if _is_even(r.astype(np.int64) * _DAY + clock)]
    if not np.array_equal(first - first[0], last - last[0]):
        if len(likely) != 1:
            raise AmbiguousFormatError(
                f"{where}: line {int(lines[0])}: the dates may be day/month or month/day, and both give "
                "steps of time; write them as yyyy-mm-dd, or give sampling_rate="
            )
        first, start = likely[0], str(likely[0][0])
    return first.astype(np.int64), start


def _is_even(ns: NDArray[np.int64]) -> bool:
    """Whether the steps of a time agree with their median within a half."""
    steps = np.diff(ns)
    usual = np.median(steps) if steps.size else 0.0
    return bool(usual > 0 and np.all(np.abs(steps - usual) <= 0.5 * usual))


@lru_cache(maxsize=4096)
def _day(year: int, month: int, day: int) -> np.datetime64:
    return np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "D")


def _is_date(year: int, month: int, day: int) -> bool:
    try:
        _day(year, month, day)
    except ValueError:
        return False
    return True


def _parts(text: str) -> _Parts | None:
    """Return what a text says, None where it is no moment."""
    found = _MOMENT.fullmatch(text)
    if found is None:
        return None
    named = {k.removeprefix("c_"): v for k, v in found.groupdict().items() if v is not None}
    date, swappable = None, False
    if "y" in named:
        date = int(named["y"]), int(named["m"]), int(named["d"])
    elif "a" in named:
        year = int(named["y2"]) + (2000 if len(named["y2"]) == 2 else 0)
        one, two = int(named["a"]), int(named["b"])
        swappable = named["s2"] != "."
        date = (year, one, two) if swappable else (year, two, one)
    elif "name" in named:
        name = named["name"].casefold()
        month = _GERMAN.get(name) or (_MONTHS.index(name) + 1 if name in _MONTHS else 0)
        date = int(named["y3"]), month, int(named["d3"])
    ns = None
    if "sf" in named:
        ns = int(named["mi"]) * 60 * _SECOND + _nanoseconds(named["sf"])
    elif "h" in named:
        hour, half = int(named["h"]), named.get("half", "")[:1].casefold()
        hour = hour % 12 + 12 * (half == "p") if half else hour
        ns = (hour * 60 + int(named["min"])) * 60 * _SECOND + _nanoseconds(named.get("sec", "0"))
    form = (
        "mm:ss.f"
        if "sf" in named
        else "hh:mm:ss"
        if "sec" in named
        else "hh:mm"
        if "h" in named
        else ""
    )
    return _Parts(date, swappable, ns, named.get("zone", ""), form)


def _nanoseconds(text: str) -> int:
    whole, _, part = re.sub("[,:]", ".", text).partition(".")
    return int(whole) * _SECOND + int(part.ljust(9, "0") or 0)


def _iso(ns: int) -> str:
    seconds, rest = divmod(int(ns), _SECOND)
    text = f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
    return f"{text}.{rest:09d}".rstrip("0") if rest else text

"""Dates and times of day as loggers write them: seconds from the first row, and when that was.

Arithmetic is in whole nanoseconds; a float of seconds since 1970 would keep 0.2 us. The offset of each
row from UTC counts where one is written. A day that may be a month, or a year, is settled by the dates
themselves or refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import AmbiguousFormatError
from metrosep.io.text._compiled import Stamps

_MONTHS = tuple(
    tuple(names.split())
    for names in (
        "january januar janvier gennaio enero", "february februar février febbraio febrero",
        "march märz mrz mars marzo", "april avril aprile abril", "may mai maggio mayo",
        "june juni juin giugno junio", "july juli juillet luglio julio", "august août agosto",
        "september septembre settembre septiembre", "october oktober octobre ottobre octubre",
        "november novembre noviembre", "december dezember décembre dicembre diciembre",
    )
)  # fmt: skip
"""Names in English, German, French, Italian and Spanish, of which at least three letters stand."""
_DATE = (
    r"(?:(?P<y>\d{4})(?P<s1>[-/.年])(?P<m>\d{1,2})[-/.月](?P<d>\d{1,2})日?"
    r"|(?P<a>\d{1,2})(?P<s2>[-/.])(?P<b>\d{1,2})(?P=s2)(?P<y2>\d{4}|\d{2})"
    r"|(?P<d3>\d{1,2})[- .]+(?P<name>[A-Za-zäéû]{3,})[- .]+(?P<y3>\d{4}))"
)
_CLOCK = (
    r"(?:(?P<mi>\d{1,2}):(?P<sf>\d\d[.,]\d{1,9})"
    r"|(?P<h>\d{1,4}):(?P<min>\d\d)(?::(?P<sec>\d\d(?:[.,:]\d{1,9})?))?\s?(?P<half>[AaPp]\.?[Mm]\.?)?)"
)
_ZONE = r"\s?(?P<zone>[Zz]|UTC|[+-]\d\d(?::?\d\d)?)?"
_BASIC = (
    r"(?P<b_y>(?:19|20|21)\d\d)(?P<b_m>0\d|1[0-2])(?P<b_d>[0-3]\d)"
    r"[Tt](?P<b_h>[0-2]\d)(?P<b_min>\d\d)(?P<b_sec>\d\d(?:[.,]\d{1,9})?)?"
    r"(?P<b_zone>[Zz]|[+-]\d\d(?::?\d\d)?)?"
)
"""ISO 8601 without marks: 20261129T101500."""
_MOMENT = re.compile(
    rf"{_DATE}(?:(?:[Tt]|,?\s+){_CLOCK}{_ZONE})?|{_CLOCK.replace('?P<', '?P<c_')}|{_BASIC}"
)
_SECOND = 10**9
_DAY = 86400 * _SECOND
_HALF = 43200 * _SECOND
_FIRST_SHORT = 69
_FIRST_YEAR, _LAST_YEAR = 1900, 2149
"""Years of measurements: the time between any two of them is a number of ns of 64 bits."""


@dataclass(frozen=True, slots=True)
class Moments:
    """A column of moments: what it holds, and when each row was."""

    kind: str  # "moment", "date" or "clock"
    seconds: FloatArray  # shape (n,): from the first row, NaN where there is no text
    start: str  # the first moment as ISO 8601; two of them where day and month may be swapped


def is_moment(text: str) -> bool:
    """Return whether a field is a date, a time of day, or both."""
    return _MOMENT.fullmatch(text) is not None


def may_be_minutes(texts: Sequence[str], own: Entries) -> bool:
    """Return whether times such as 12:30 may be hours and minutes, or minutes and seconds."""
    rows = np.flatnonzero(~own.is_empty)
    return bool((own.form[rows] == _FORMS.index("hh:mm")).all()) and all(
        re.fullmatch(r"\d{1,4}:\d\d", texts[i].strip('"')) for i in rows.tolist()
    )


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
LONG_AGO_S = 1e8
"""Three years, longer than any recording: a time of so many s counts from a date."""
_SURE = LONG_AGO_S * _SECOND  # as a time since the start of anything, in whatever unit
_CALENDAR = re.compile(r"date|datum|unix|epoch|posix|filetime", re.IGNORECASE)
"""Names of a column that says when a row was, not how long after the start of a logger."""
_STAMP = re.compile(r"time_?stamp|zeitstempel", re.IGNORECASE)
"""Names of a column that may say either: us of an uptime of 12 to 25 days are numbers like ms since 1970."""
_FINE = {86400.0: 0.1 * 86400.0, 1e-3: 1.0}
"""Longest step in s of days (far below one) and of ms (as ns it would be 1 us: too fast for a table)."""


def is_long_count(name: str, values: FloatArray) -> bool:
    """Return whether numbers rise as a clock does, and a float may not hold all digits of the later ones."""
    least = _COUNTED[-1][0] if _CALENDAR.search(name) else _COUNTED[-3][0]
    if not values.size or values[0] < least:
        return False
    known = values[np.isfinite(values)]
    if not known.size or not (known[-1] > 2.0**53 or np.any(known % 1.0)):
        return False
    return bool((np.diff(known) >= 0.0).all())


def counted_moments(
    name: str, values: FloatArray, since: FloatArray
) -> tuple[FloatArray, str] | None:
    """Return numbers of a clock without a unit in s from the first, and what they count; else None.

    `since` are the numbers from the first, with digits that `values` cannot hold.

    A time that runs from the start of a logger in ms has the numbers of days of a spreadsheet, one in
    us those of seconds since 1970: below `_SURE` the name must say that it is a date, and days, seconds
    and whatever is called a time stamp must have fractions, which no counter has.
    """
    known = values[np.isfinite(values)]
    is_dated = _CALENDAR.search(name) is not None
    is_stamp = _STAMP.search(name) is not None
    for low, high, seconds, what in _COUNTED:
        if not known.size or low > known.min() or known.max() > high:
            continue
        found = since * seconds
        if low >= _SURE:
            return found, what
        steps = np.diff(known) * seconds
        is_fine = steps.size > 0 and float(np.max(steps)) <= _FINE.get(seconds, np.inf)
        has_fractions = bool(np.any(known % 1.0))
        is_counted = is_dated and seconds < 1.0
        if is_fine and (is_counted or ((is_dated or is_stamp) and has_fractions)):
            return found, what
    return None


def written_moments(values: FloatArray) -> FloatArray | None:
    """Return dates that are written as numbers, 20260314101500, in s from the first; None for others."""
    known = values[np.isfinite(values)]
    if not known.size or known.min() < _FIRST_YEAR * 1e10 or known.max() > _LAST_YEAR * 1e10:
        return None
    whole = np.where(np.isfinite(values), values, known[0]).astype(np.int64)
    parts = [whole // 10**k % 100 for k in (8, 6, 4, 2, 0)]
    days, is_date = _day_numbers(whole // 10**10, parts[0], parts[1])
    hour, minute, second = parts[2:]
    is_time = (hour < 24) & (minute < 60) & (second < 60)
    if not (is_date & is_time).all():
        return None
    seconds = (days * 86400 + hour * 3600 + minute * 60 + second).astype(np.float64) + values % 1.0
    seconds[~np.isfinite(values)] = np.nan
    return np.asarray(seconds - seconds[np.isfinite(values)][0])


class Entries:
    """What the texts of a column say, as arrays of shape (n,): the parts of dates and times of day."""

    def __init__(self, texts: Sequence[str]) -> None:
        n = len(texts)
        self.is_known = np.zeros(n, dtype=np.bool_)  # whether a text is a moment
        self.is_empty = np.zeros(n, dtype=np.bool_)
        self.is_dated = np.zeros(n, dtype=np.bool_)
        self.is_swappable = np.zeros(n, dtype=np.bool_)  # a/b/y, of which a is taken as the month
        self.is_short = np.zeros(n, dtype=np.bool_)  # whether a may be the year: a/b/yy, a.b.yy
        self.date = np.zeros((3, n), dtype=np.int32)  # year, month, day
        self.form = np.zeros(n, dtype=np.int8)  # of the time of day: index of `_FORMS`
        self.ns = np.zeros(n, dtype=np.int64)  # of the day
        self.is_time = np.ones(n, dtype=np.bool_)  # whether a clock can show it: no 12:75
        self.is_zoned = np.zeros(n, dtype=np.bool_)
        self.offset = np.zeros(n, dtype=np.int64)  # from UTC in ns: local time - UTC
        for start in range(0, n, _CHUNK):
            self._take(texts[start : start + _CHUNK], start)

    def _take(self, texts: Sequence[str], start: int) -> None:
        """Take some texts: those of one shape, digits for digits, are read at once."""
        if isinstance(texts, Stamps):
            if texts.codes.shape[1] <= _LONGEST:
                self._take_width(texts, texts.codes, start + np.arange(len(texts)))
                return
            texts = list(texts)
        lengths = np.fromiter(map(len, texts), dtype=np.int64, count=len(texts))
        self.is_empty[start : start + len(texts)] = lengths == 0
        usual = int(lengths[0]) if lengths.size else 0
        alike = bool((lengths == usual).all())
        for length in [usual] if alike else np.unique(lengths).tolist():
            rows = np.flatnonzero(lengths == length)
            joined = "".join(texts if alike else [texts[i] for i in rows.tolist()])
            if not 0 < length <= _LONGEST:
                continue
            encoding, kind = "ascii", "u1"
            if not joined.isascii():  # full-width digits are digits
                encoding, kind = "utf-32-le", "<u4"
                joined = joined.translate(
                    {ord(c): str(int(c)) for c in set(joined) if c.isdecimal()}
                )
            codes = np.frombuffer(joined.encode(encoding), dtype=kind).reshape(-1, length)
            own = texts if alike else [texts[i] for i in rows.tolist()]
            self._take_width(own, codes, start + rows)

    def _take_width(
        self, texts: Sequence[str], codes: NDArray[Any], rows: NDArray[np.intp]
    ) -> None:
        """Take texts of one width, those of one shape at once; `rows` rise."""
        zero = codes.dtype.type(ord("0"))
        digits = np.ascontiguousarray((codes - zero).T)
        if all(d.max() < _TEN if d[0] < _TEN else (d == d[0]).all() for d in digits):
            is_run = rows[-1] - rows[0] == rows.size - 1
            where = slice(int(rows[0]), int(rows[-1]) + 1) if is_run else rows
            self._take_shape(texts[0], digits, where)
            return
        shapes = np.where(codes - zero < _TEN, zero, codes)
        left = np.arange(rows.size)
        for _ in range(_SHAPES):
            if not left.size:
                break
            is_same = (shapes[left] == shapes[left[0]]).all(axis=1)
            same = left[is_same]
            self._take_shape(texts[int(same[0])], digits[:, same], rows[same])
            left = left[~is_same]
        for i in left.tolist():
            self.set(int(rows[i]), texts[i])

    def set(self, i: int, text: str) -> None:
        """Take one text by itself."""
        digits = np.array([[int(c) if c.isdecimal() else -1] for c in text])
        self._take_shape(text, digits, np.array([i]))

    def _take_shape(self, text: str, digits: NDArray[Any], rows: NDArray[np.intp] | slice) -> None:
        """Take texts of the shape of the first, which tells where its parts are; a row of `digits` is a place in them."""
        found = _MOMENT.fullmatch(text)
        if found is None:
            return
        span = {
            k.removeprefix("c_").removeprefix("b_"): found.span(k)
            for k, v in found.groupdict().items()
            if v is not None
        }

        def whole(name: str) -> NDArray[np.int32]:
            return _whole(digits, *span[name])

        self.is_known[rows] = True
        if "y" in span:
            self.date[:, rows] = [whole("y"), whole("m"), whole("d")]
        elif "a" in span:
            is_short = bool(np.ptp(span["y2"]) == len("26"))
            year = _in_full(whole("y2")) if is_short else whole("y2")
            one, two = whole("a"), whole("b")
            is_swappable = text[slice(*span["s2"])] != "."
            self.is_short[rows] = is_short
            self.is_swappable[rows] = is_swappable
            self.date[:, rows] = [year, one, two] if is_swappable else [year, two, one]
        elif "name" in span:
            name = text[slice(*span["name"])].casefold()
            fit = [k for k, of in enumerate(_MONTHS, 1) if any(m.startswith(name) for m in of)]
            month = fit[0] if len(fit) == 1 else 0  # jui is June or July
            year = whole("y3")
            self.date[:, rows] = [year, np.full_like(year, month), whole("d3")]
        self.is_dated[rows] = not span.keys().isdisjoint(("y", "a", "name"))
        if "sf" in span:
            self.ns[rows] = whole("mi") * np.int64(60 * _SECOND) + _nanoseconds(
                text, digits, *span["sf"]
            )
        elif "h" in span:
            hour, half = whole("h"), text[slice(*span.get("half", (0, 0)))][:1].casefold()
            self.is_time[rows] = (whole("min") < 60) & ((hour <= 12) | (not half))
            hour = hour % 12 + 12 * (half == "p") if half else hour
            second = _nanoseconds(text, digits, *span["sec"]) if "sec" in span else 0
            self.ns[rows] = (hour * 60 + whole("min")) * np.int64(60 * _SECOND) + second
        for name in span.keys() & {"sf", "sec"}:  # 60 is a leap second
            self.is_time[rows] &= _nanoseconds(text, digits, *span[name]) < 61 * _SECOND
        if "zone" in span:
            self.is_zoned[rows] = True
            first, end = span["zone"]
            if text[first] in "+-":
                minutes = _whole(digits, first + 1, first + 3) * 60
                if end - first > len("+01"):
                    minutes += _whole(digits, end - 2, end)
                sign = -1 if text[first] == "-" else 1
                self.offset[rows] = minutes * np.int64(60 * _SECOND * sign)
        form = ("mm:ss.f", "hh:mm:ss", "hh:mm")[["sf" in span, "sec" in span, True].index(True)]
        self.form[rows] = _FORMS.index(form) if "sf" in span or "h" in span else 0


_FORMS = ("", "hh:mm", "hh:mm:ss", "mm:ss.f")
"""Forms of a time of day; the first is that of a date alone."""
_CHUNK = 2**15
"""Texts that are looked at at once."""
_LONGEST = 64
"""Characters of the longest text that is looked at beside others."""
_SHAPES = 64
"""Shapes of texts of one length that are read at once: twelve months, times of two halves of a day."""
_TEN = np.uint8(10)


def _in_full(year: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return years of two digits as 1969 to 2068, as POSIX does: no clock of a computer decides."""
    return np.where(year >= _FIRST_SHORT, year + 1900, year + 2000)


def _whole(digits: NDArray[Any], first: int, end: int) -> NDArray[np.int32]:
    """Return the whole numbers of at most nine digits, one digit in each row of an array."""
    found = np.zeros(digits.shape[1], dtype=np.int32)
    for k in range(first, end):
        found *= 10
        found += digits[k].astype(np.int32)
    return found


def _nanoseconds(text: str, digits: NDArray[Any], first: int, end: int) -> NDArray[np.int64]:
    """Return seconds such as 07.250 in ns."""
    mark = next((k for k in range(first, end) if not text[k].isdigit()), end)
    part = _whole(digits, mark + 1, end) * np.int64(10 ** (9 - max(end - mark - 1, 0)))
    return np.asarray(_whole(digits, first, mark) * np.int64(_SECOND) + part, dtype=np.int64)


def moments(
    texts: Sequence[str],
    lines: NDArray[np.int64],
    where: str,
    days: Entries | None = None,
    *,
    entries: Entries | None = None,
) -> Moments | None:
    """Return a column as moments, with the dates beside it; None where its texts are not moments.

    `entries` are what the texts say, where that is known already.
    """
    said = Entries(texts) if entries is None else entries
    if not said.is_known.any() or not (said.is_known | said.is_empty).all():
        return None
    own = np.flatnonzero(said.is_known)
    rows = slice(None) if own.size == said.is_known.size else own  # a slice copies nothing
    if days is not None and not days.is_dated.all():
        return None
    on = said if days is None else days
    is_dated = on.is_dated
    forms = said.form[rows]
    dated, timed = is_dated[rows], forms > 0
    if dated.any() != dated.all() or timed.any() != timed.all():
        return None
    ns = np.zeros(own.size, dtype=np.int64)
    clock, offset = said.ns[rows], said.offset[rows]
    wrong = own[~said.is_time[rows] | (dated & (clock >= _DAY + _SECOND))]
    if wrong.size:
        raise AmbiguousFormatError(
            f"{where}: line {int(lines[wrong[0]])}: {texts[wrong[0]]!r} is not a time of day; correct it, or "
            "give sampling_rate="
        )
    other = own[said.is_zoned[rows] != said.is_zoned[own[0]]]
    if other.size:
        raise AmbiguousFormatError(
            f"{where}: line {int(lines[other[0]])}: {texts[other[0]]!r} stands among times of which only some "
            "state their offset from UTC; write it in all of them or in none, or give sampling_rate="
        )
    start = texts[own[0]].strip('"')
    if dated[0]:
        whole_days, start = _days(on, rows, clock - offset, lines[rows], where)
        ns = whole_days * _DAY
    if timed[0]:
        if (forms != forms[0]).any():
            usual = int(np.argmax(np.bincount(forms)))
            i = own[np.flatnonzero(forms != usual)[0]]
            raise AmbiguousFormatError(
                f"{where}: line {int(lines[i])}: time {texts[i]!r} stands among times of the form {_FORMS[usual]}; "
                "write all of them alike, or give sampling_rate="
            )
        if not dated[0]:  # a clock that falls by half a day and more has passed midnight
            ns[1:] = np.cumsum(np.diff(clock) < -_HALF) * _DAY
        ns = ns + clock - offset
        if dated[0]:
            found = _MOMENT.fullmatch(texts[own[0]].strip('"'))
            zone = "" if found is None else found["zone"] or found["b_zone"] or ""
            start = " or ".join(f"{day}T{_iso(clock[0])}{zone}" for day in start.split(" or "))
    seconds = np.full(len(lines), np.nan)
    seconds[rows] = (ns - ns[0]) * 1e-9
    kind = "moment" if dated[0] and timed[0] else "date" if dated[0] else "clock"
    return Moments(kind, seconds, start)


class RunningClock:
    """A column of moments that comes in parts: seconds from its first row, the same as `moments` gives.

    What only the whole column can settle (a day that may be a month) is refused.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._first: int | None = None
        self._last = self._days = 0
        self._form: tuple[bool, int, bool] | None = None
        self._date: NDArray[np.int32] | None = None  # the last one of the part before

    def seconds(
        self, texts: Sequence[str], lines: NDArray[np.int64], days: Sequence[str] | None = None
    ) -> FloatArray:
        """Return the next part, NaN where there is no text; with the dates beside it, if there are."""
        own = Entries(texts)
        beside = None if days is None else Entries(days)
        rows = np.flatnonzero(~own.is_empty)
        found = np.full(len(texts), np.nan)
        if not rows.size:
            return found
        dated = own if beside is None else beside
        form = dated.is_dated[rows], own.form[rows], own.is_zoned[rows]
        first = self._form or (bool(form[0][0]), int(form[1][0]), bool(form[2][0]))
        faults = [
            *self._faults(own, rows, texts, self._date if beside is None else None),
            *(() if beside is None else self._faults(beside, rows, days or (), self._date)),
            (
                (form[0] != first[0]) | (form[1] != first[1]) | (form[2] != first[2]),
                texts,
                "is of another form than those above it",
            ),
            (form[0] & (own.ns[rows] >= _DAY + _SECOND), texts, "is not a time of day"),
            (
                ~form[0] & (form[1] == _FORMS.index("hh:mm")),
                texts,
                "may be hours and minutes, or minutes and seconds",
            ),
        ]
        if any(f.any() for f, _, _ in faults):
            _, k = min((int(np.argmax(f)), k) for k, (f, _, _) in enumerate(faults) if f.any())
            wrong, shown, why = faults[k]
            i = int(rows[np.argmax(wrong)])
            raise AmbiguousFormatError(
                f"{self._where}: line {int(lines[i])}: {shown[i]!r} {why}; read the file as a whole with "
                "metrosep.read, or name the other channels with channels="
            )
        self._form, self._date = first, dated.date[:, rows[-1:]]
        ns = own.ns[rows] - own.offset[rows]
        if first[0]:
            ns = ns + _day_numbers(*dated.date[:, rows])[0] * _DAY
        else:  # past midnight
            fell = np.diff(ns, prepend=self._last) < -_HALF
            self._last = int(ns[-1])
            ns = ns + (self._days + np.cumsum(fell)) * _DAY
            self._days += int(fell.sum())
        self._first = int(ns[0]) if self._first is None else self._first
        found[rows] = (ns - self._first) * 1e-9
        return found

    @staticmethod
    def _faults(
        entries: Entries,
        rows: NDArray[np.intp],
        texts: Sequence[str],
        before: NDArray[np.int32] | None,
    ) -> list[tuple[NDArray[np.bool_], Sequence[str], str]]:
        """Return for each reason which rows it holds for."""
        date = entries.date[:, rows]
        is_date = _day_numbers(*date)[1] | ~entries.is_dated[rows]
        either = entries.is_swappable[rows] & (date[1] != date[2])
        is_short, is_swappable = entries.is_short[rows], entries.is_swappable[rows]
        either |= is_short & is_swappable & (date[0] % 100 != date[1])
        # 26.03.05, 26.03.06: where the first part stays while a date changes, it may be the year
        steps = np.diff(date, prepend=date[:, :1] if before is None else before)
        either |= is_short & ~is_swappable & steps.any(axis=0) & (steps[2] == 0)
        # 25.12.31, 26.01.01 falls by thirty years as day and month: the first part may be the year
        either |= is_short & ~is_swappable & ((steps[0] < 0) | (steps[0] > 1))
        is_known = entries.is_known[rows] & entries.is_time[rows] & is_date
        return [
            (~is_known, texts, "is not a date or a time of day"),
            (
                either,
                texts,
                "may be day/month or month/day, or begin with the year, which only the whole tells",
            ),
        ]


def _day_numbers(
    year: NDArray[np.integer], month: NDArray[np.integer], day: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the days since 1970, and which dates there are: no 31 February.

    A date that stays from row to row is looked at once.
    """
    begins = np.ones(year.size, dtype=np.bool_)
    begins[1:] = (np.diff(day) != 0) | (np.diff(month) != 0) | (np.diff(year) != 0)
    at = np.flatnonzero(begins)
    if 2 * at.size < year.size:
        numbers, found = _day_numbers(year[at], month[at], day[at])
        lengths = np.diff(at, append=year.size)
        return np.repeat(numbers, lengths), np.repeat(found, lengths)
    months = (year - 1970) * 12 + (month - 1)
    start = months.astype("M8[M]")
    days = start.astype("M8[D]") + (day - 1)
    is_date = (month >= 1) & (month <= 12) & (day >= 1) & (days.astype("M8[M]") == start)
    is_date &= (year >= _FIRST_YEAR) & (year <= _LAST_YEAR)
    return days.astype(np.int64), is_date


def _days(
    entries: Entries,
    rows: NDArray[np.intp] | slice,
    clock: NDArray[np.int64],
    lines: NDArray[np.int64],
    where: str,
) -> tuple[NDArray[np.int64], str]:
    """Return the days since 1970, and the first; the order of day, month and year is settled or refused."""
    year, one, two = entries.date[:, rows]
    orders = [(year, one, two)]
    is_swappable = entries.is_swappable[rows]
    if is_swappable.any():
        orders.append((year, two, one))
    if entries.is_short[rows].all():  # a/b/yy and a.b.yy may be year, month and day
        first_part, second_part = (
            np.where(is_swappable, a, b) for a, b in ((one, two), (two, one))
        )
        orders.append((_in_full(first_part), second_part, year % 100))
    numbered = [_day_numbers(*order) for order in orders]
    readings = [numbers for numbers, is_date in numbered if is_date.all()]
    if not readings:
        raise AmbiguousFormatError(
            f"{where}: line {int(lines[np.argmin(numbered[0][1])])}: no order of day, month and year fits all dates (of the years "
            f"{_FIRST_YEAR} to {_LAST_YEAR}); write them as yyyy-mm-dd, or give sampling_rate="
        )
    first = readings[0]
    if any(not np.array_equal(first - first[0], r - r[0]) for r in readings[1:]):
        likely = [r for r in readings if _is_even(r * _DAY + clock)]
        if len(likely) != 1:
            raise AmbiguousFormatError(
                f"{where}: line {int(lines[0])}: the dates may be day/month or month/day, or begin with the "
                "year, and more than one order gives steps of time; write them as yyyy-mm-dd, or give "
                "sampling_rate="
            )
        readings = likely
    elif not is_swappable.any():  # 05.03.26: the day stands first where no step depends on it
        readings = readings[:1]
    starts = dict.fromkeys(str(np.datetime64(int(r[0]), "D")) for r in readings)
    return readings[0], " or ".join(starts)


def _is_even(ns: NDArray[np.int64]) -> bool:
    """Whether the steps of a time agree with their median within a half."""
    steps = np.diff(ns)
    usual = np.median(steps) if steps.size else 0.0
    return bool(usual > 0 and np.all(np.abs(steps - usual) <= 0.5 * usual))


def _iso(ns: int) -> str:
    seconds, rest = divmod(int(ns), _SECOND)
    text = f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
    return f"{text}.{rest:09d}".rstrip("0") if rest else text

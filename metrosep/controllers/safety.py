"""What is checked before a file of corrections appears; each check can be waived only by name.

Source: controllers notes, section 8. Sign and reading back are checked in
`metrosep.controllers.files`; positions in the table itself; limits of the machine in
`metrosep.compensation.limits`; here what depends on the file and on what is known about the table.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import ends_along, format_along, format_amount, is_rotary
from metrosep.compensation.limits import Finding, Limits
from metrosep.compensation.polynomial import PolynomialFit
from metrosep.compensation.sampling import rounded_spacing
from metrosep.controllers.base import DialectInfo, Encoded
from metrosep.core.errors import DataError, LimitError, TableError
from metrosep.core.readable import did_you_mean
from metrosep.core.units import format_length

CHECKS = {
    "dry-run": "the error shrinks when the very bytes are applied to it",
    "inconclusive": "the readings show that the table helps",
    "pointless": "the table removes 30 % of the error or more",
    "single": "the error was measured more than once",
    "spike": "no run has a reading that no other run has, in a table made of them",
    "points": "no more entries than the controller takes",
    "stroke": "the corrections stay within the actuator",
    "turning-back": "the corrected command of an axis still rises",
    "steepness": "corrections above 100 um are not steeper than errors of an axis, else a unit is wrong",
    "velocity": "the corrected axis can follow at the feed",
    "acceleration": "the corrected axis can follow at the feed",
    "reversal": "the step at a reversal is allowed",
    "coverage": "the table covers the travel",
    "soft-limits": "the travel keeps the largest correction as a margin to the software limits",
    "quantisation": "a step of an entry is at most a tenth of the corrections",
    "resampling": "what the file holds between its entries is the table, to a tenth",
    "uncertainty": "some entry is larger than its expanded uncertainty",
    "active": "a second iteration does not replace the first",
}
"""The checks that refuse, by the names that ``waive=`` takes."""

_COARSEST = 0.1
"""Step of an entry, or error of resampling, over the span of the corrections: refused above."""

_LARGE = 100e-6
"""Corrections beyond it, which tool paths refuse too, are mostly of a wrong unit if they are steep as well."""

_SAME = 1e-12
"""Corrections below a picometre count as zero at the reference."""


def waived_names(waive: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of checks; one text may hold several, with commas, as messages print them."""
    texts = (waive,) if isinstance(waive, str) else tuple(waive)
    return tuple(name.strip() for text in texts for name in text.split(","))


def checked_waivers(waive: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of checks, refused where one is not a check."""
    names = waived_names(waive)
    unknown = [n for n in names if n not in CHECKS]
    if unknown:
        hint = did_you_mean(unknown[0], CHECKS)
        raise DataError(
            f"waive={unknown[0]!r} is not a check; there are {', '.join(CHECKS)}.{hint}"
        )
    return names


def sidecar_warnings(made: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return what a sidecar warns of: its findings, directions without a run, a dry-run that is missing."""
    found = [{"waived": False, **f} for f in made.get("findings") or ()]
    verification = made.get("verification")
    said = []
    if isinstance(verification, str):
        said = [f"there was no dry-run: {verification}"]
    elif verification:
        said = [
            f"no run went {name}, so the {name} column is not verified; measure that direction"
            for name in verification.get("not_verified", ())
        ]
    more = [
        {"level": "warning", "problem": t, "fix": "", "check": "", "waived": False} for t in said
    ]
    return [*found, *more]


def judged(findings: Iterable[Finding], waive: Sequence[str]) -> tuple[Finding, ...]:
    """Return the findings, and refuse if an error is among them that is not waived."""
    names = checked_waivers(waive)
    found = tuple(findings)
    errors = [f for f in found if f.level == "error" and f.check not in names]
    if errors:
        text = "; ".join(f"{f.problem}: {f.fix}" for f in errors)
        checks = ", ".join(dict.fromkeys(f.check for f in errors if f.check in CHECKS))
        way = f" (to write it all the same, say waive={checks!r})" if checks else ""
        refused = LimitError(f"{text}; nothing was written{way}")
        hints = [dict(f.hint) for f in errors if f.hint]
        refused.hints = tuple(h for k, h in enumerate(hints) if h not in hints[:k])
        raise refused
    return found


def table_findings(carried: Any, limits: Limits, info: DialectInfo) -> list[Finding]:
    """Return what is wrong or uncertain about corrections for a machine."""
    found = list(carried.limits(limits)) if hasattr(carried, "limits") else []
    found = [_of_a_wrong_unit(f, carried, limits) for f in found]
    if info.carries == "map":
        names = ("travel_low", "travel_high", "soft_low", "soft_high")
        given = [n for n in names if getattr(limits, n) is not None]
        if given:
            raise DataError(
                f"{given[0]} is of one axis, {info.id} holds a map over two: measure the map over both "
                "travels and leave it out"
            )
        return [*found, *_area_uncertainty(carried)]
    if info.carries == "polynomial":
        return [*found, *_coverage(carried.domain, limits, info)]
    return [
        *(_with_spacing(f, carried, limits) for f in found),
        *_coverage(carried.span, limits, info, carried.axis),
        *_soft_limits(carried, limits),
        *_reference(carried),
        *_uncertainty(carried),
    ]


def _of_a_wrong_unit(finding: Finding, carried: Any, limits: Limits) -> Finding:
    """Return steepness as an error where corrections are large too, and no stroke says that they may be."""
    if finding.check != "steepness" or limits.stroke is not None or is_rotary(carried.compensates):
        return finding
    if carried.stroke <= _LARGE:
        return finding
    text = f"{finding.problem} and is as large as {format_length(carried.stroke)}"
    fix = "check the units of the readings; if they are right, state the stroke of the axis (stroke=)"
    return Finding.error(text, fix, finding.check)


def _with_spacing(finding: Finding, table: Any, limits: Limits) -> Finding:
    """Add the finest round spacing whose entries the controller takes."""
    if finding.check != "points" or limits.max_points is None or limits.max_points < 2:
        return finding
    least = (table.span[1] - table.span[0]) / (limits.max_points - 1)
    return replace(finding, hint={"spacing": rounded_spacing(least, table.axis, up=True)})


def carried_findings(
    carried: Any, table: Any, limits: Limits, info: DialectInfo
) -> Iterator[Finding]:
    """Return what is lost between a table and what the file holds of it, and what was not checked."""
    if info.carries != "table":
        return
    low, high = table.span
    margin = 1e-6 * (high - low)
    if carried.span[0] > low + margin or carried.span[1] < high - margin:
        yield Finding.error(
            f"the file holds {format_along(table.axis, carried.span[0])} ... "
            f"{format_along(table.axis, carried.span[1])} of a table over "
            f"{ends_along(table.axis, low, high)}",
            "state where it shall begin and end, or cut the table",
            "coverage",
        )
    if limits.travel_low is None and limits.travel_high is None and "roll" in info.outside:
        yield Finding.warning(
            f"the travel is not stated, and outside the table the controller does this: "
            f"{info.outside}",
            "state travel_low and travel_high of the machine",
            "coverage",
        )


def _coverage(
    covered: tuple[float, float], limits: Limits, info: DialectInfo, axis: str = "X"
) -> list[Finding]:
    low, high = covered
    wanted_low = low if limits.travel_low is None else limits.travel_low
    wanted_high = high if limits.travel_high is None else limits.travel_high
    margin = 1e-9 * (high - low)
    if wanted_low >= low - margin and wanted_high <= high + margin:
        return []
    return [
        Finding.error(
            f"the corrections cover {ends_along(axis, low, high)}, the travel is "
            f"{ends_along(axis, wanted_low, wanted_high)}; outside the controller "
            f"does this: {info.outside}",
            "measure the whole travel, or narrow it",
            "coverage",
        )
    ]


def _soft_limits(table: Any, limits: Limits) -> list[Finding]:
    if not table.is_on_axis:
        return []
    low = table.span[0] if limits.travel_low is None else limits.travel_low
    high = table.span[1] if limits.travel_high is None else limits.travel_high
    short = (limits.soft_low is not None and low - limits.soft_low < table.stroke) or (
        limits.soft_high is not None and limits.soft_high - high < table.stroke
    )
    if not short:
        return []
    return [
        Finding.error(
            f"the travel {format_along(table.axis, low)} ... {format_along(table.axis, high)} with "
            f"corrections up to {format_amount(table.compensates, table.stroke)} leaves the software limits",
            "keep the largest correction as a margin to them",
            "soft-limits",
        )
    ]


def _reference(table: Any) -> Iterator[Finding]:
    if abs(table.offset_removed) > _SAME:
        yield Finding.warning(
            f"{format_amount(table.compensates, table.offset_removed)} was subtracted so that the "
            f"correction is zero at the reference {format_along(table.axis, table.reference)}",
            "set the reference to where the axis is homed or zeroed",
            "reference",
        )
    low, high = table.span
    if low <= table.reference <= high:
        there = table.at_reference
        if abs(there) > _SAME:
            yield Finding.warning(
                f"the correction at the reference {format_along(table.axis, table.reference)} is "
                f"{format_amount(table.compensates, there)}, not zero: the zero of the machine moves by it",
                "subtract it from all entries, or state another reference",
                "reference",
            )


def _uncertainty(table: Any) -> list[Finding]:
    if table.u is None:
        return []
    columns = [table.forward] if table.reverse is None else [table.forward, table.reverse]
    size = np.max([np.abs(c) for c in columns], axis=0)
    below = int((size <= 2.0 * table.u).sum())
    n = table.positions.size
    if below == 0:
        return []
    text = (
        f"{below} of {n} entries are not larger than their expanded uncertainty (k = 2, up to "
        f"{format_amount(table.compensates, 2.0 * float(table.u.max()), digits=2)})"
    )
    if below == n:
        return [Finding.error(text, "measure more runs: this is noise", "uncertainty")]
    if below > n // 2:
        return [Finding.warning(text, "measure more runs", "uncertainty")]
    return []


def _area_uncertainty(carried: Any) -> list[Finding]:
    if carried.u is None:
        return []
    known = np.isfinite(carried.u)
    below = known & (np.abs(carried.values) <= 2.0 * np.where(known, carried.u, 0.0))
    n, some = int(known.sum()), int(below.sum())
    if n == 0 or some <= n // 2:
        return []
    text = f"{some} of {n} entries are not larger than their expanded uncertainty (k = 2)"
    level: Any = "error" if some == n else "warning"
    return [Finding(level, text, "measure more often: this is noise", "uncertainty")]


def file_findings(carried: Any, encoded: Encoded) -> Iterator[Finding]:
    """Return what is wrong or uncertain about the bytes."""
    yield from encoded.findings
    span = _span(carried)
    axis = getattr(carried, "compensates", "X")
    if span is None or span == 0.0:
        return
    if encoded.step > _COARSEST * span:
        yield Finding.error(
            f"an entry has steps of {format_amount(axis, encoded.step, digits=3)}, the corrections span "
            f"{format_amount(axis, span, digits=3)}: rounding would dominate",
            "use a controller or a count of finer steps",
            "quantisation",
        )
    if encoded.resampling_error > _COARSEST * span:
        yield Finding.error(
            f"between its entries the file misses the table by up to "
            f"{format_amount(axis, encoded.resampling_error, digits=3)}, the corrections span "
            f"{format_amount(axis, span, digits=3)}",
            "use a finer spacing of the file, or a coarser error",
            "resampling",
        )


def _span(carried: Any) -> float | None:
    """Span of the corrections; None of what has no entries."""
    if hasattr(carried, "values"):
        return float(np.ptp(carried.values))
    if not hasattr(carried, "forward"):
        return None
    both = [carried.forward] if carried.reverse is None else [carried.forward, carried.reverse]
    return float(np.ptp(np.concatenate(both)))


def require_read_back(wanted: Any, parsed: Any, encoded: Encoded) -> None:
    """Refuse bytes that do not read back as the table that was encoded."""
    margin = encoded.quantisation * (1.0 + 1e-9) + 1e-15
    if isinstance(wanted, PolynomialFit):
        x = np.linspace(*wanted.domain, 501)
        off = float(np.abs(parsed.correction(x) - wanted.correction(x)).max())
        if off > margin + 1e-12 * float(np.abs(wanted.correction(x)).max()):
            raise _not_read_back("polynomial")
        return
    for name in ("positions", "forward", "reverse", "x", "y", "values"):
        a, b = getattr(wanted, name, None), getattr(parsed, name, None)
        if name == "reverse" and hasattr(wanted, "forward"):
            a = wanted.forward if a is None else a
            b = parsed.forward if b is None else b
        if a is None and b is None:
            continue
        near = 1e-9 if name in ("positions", "x", "y") else margin
        if (
            a is None
            or b is None
            or np.shape(a) != np.shape(b)
            or np.abs(np.subtract(a, b)).max(initial=0.0) > near
        ):
            raise _not_read_back(name)


def _not_read_back(what: str) -> TableError:
    return TableError(
        f"what was encoded does not read back as the table ({what}); this is a bug in metrosep, "
        "nothing was written"
    )

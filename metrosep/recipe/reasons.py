"""Why a part is not accepted, in words: value, limit and uncertainty of each check."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from metrosep.core.readable import digits_of, readable_unit

__all__ = ["reason_of"]

_DIGITS = 4
_MOST_DIGITS = {"reject": 15, "inconclusive": 7}
"""Of a value beside its limit: as many as tell the two apart."""


def reason_of(characteristics: Iterable[Mapping[str, Any]]) -> str | None:
    """Return which characteristics are not accepted and why.

    Examples
    --------
    >>> entry = {"name": "Sq", "unit": "m", "value": 1.42e-8, "upper": 1.2e-8, "U": 3e-10}
    >>> reason_of([{**entry, "verdict": "reject"}])
    'Sq 14.2 nm > 12 nm (U 0.3 nm): reject'
    """
    bad = (c for c in characteristics if c.get("verdict") in ("reject", "inconclusive"))
    return "; ".join(f"{_name(c)} {_words(c)}: {c['verdict']}" for c in bad) or None


def _name(entry: Mapping[str, Any]) -> str:
    name = entry.get("name")
    own = name if name and name != entry.get("definition") else None
    return str(own or entry.get("metric") or name)


def _words(entry: Mapping[str, Any]) -> str:
    value = entry.get("value")
    if entry.get("reason"):
        return str(entry["reason"])
    limits = [v for v in (entry.get("lower"), entry.get("upper")) if v is not None]
    if value is None or not math.isfinite(value):
        return "not known"
    limit = min(limits, key=lambda v: abs(value - v), default=None)
    if limit is None:
        return _texts([value], entry, _DIGITS)[0]
    is_outside = value > limit if limit == entry.get("upper") else value < limit
    tried = range(_DIGITS, _MOST_DIGITS[entry["verdict"]] + 1)
    texts = [_texts([value, limit], entry, n) for n in (tried if value != limit else tried[:1])]
    shown, bound = next((pair for pair in texts if pair[0] != pair[1]), texts[0])
    spread = _texts([entry.get("U") or 0.0], entry, _DIGITS)[0]
    if is_outside and (shown != bound or entry["verdict"] == "reject"):
        return f"{shown} {'>' if value > limit else '<'} {bound} (U {spread})"
    factor = entry.get("guard_factor")
    times = "" if factor in (None, 1.0) else f"{factor:g} "
    return f"{shown}, within {times}U of {bound} (U {spread})"


def _texts(values: list[float], entry: Mapping[str, Any], digits: int) -> list[str]:
    """Return numbers in the unit in which the limits read well."""
    limits = [v for v in (entry.get("lower"), entry.get("upper")) if v]
    unit, factor = readable_unit(limits or [entry.get("value")], str(entry.get("unit") or "1"))
    tail = "" if unit == "1" else f" {unit}"
    return [f"{digits_of(v / factor, digits)}{tail}" for v in values]

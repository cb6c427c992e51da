"""What a report says about a named separation: method, noise, null space, audit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.recipe.step_help import step_words
from metrosep.report.text import length, readable_unit

__all__ = ["SEPARATED_NOTE", "not_seen", "plan_rows", "separation_audit", "separation_rows"]

Document = Mapping[str, Any]

_MOST_INDICES = 16
_PLURALS = {"frequency": "frequencies", "radius": "radii"}

SEPARATED_NOTE = (
    "The standard uncertainty u holds what the readings tell and what was stated for the method; "
    "linearity of the sensor and temperature are in it only where they were given."
)


def separation_rows(separation: Document) -> list[tuple[str, str]]:
    """Return the summary of a separation."""
    if not separation:
        return []
    rows = [("Method", f"{separation.get('op')}: {separation.get('what')}")]
    if separation.get("runs"):
        rows += plan_rows(separation)
    noise = separation.get("noise") or {}
    if noise.get("definition"):
        rows.append(("Noise", f"{_value(noise)}: {noise['definition']}"))
    op = str(separation.get("op"))
    rows += [(f"Not seen, {parts}", step_words(what, op)) for parts, what in not_seen(separation)]
    return rows


def not_seen(separation: Document) -> list[tuple[str, str]]:
    """Return what a separation cannot see, once where it is the same for several parts."""
    found: dict[str, list[str]] = {}
    for item in separation.get("null_space") or []:
        parts = found.setdefault(_unobservable(item), [])
        parts.append(str(item["part"]).replace("_", " "))
    return [(", ".join(parts), what) for what, parts in found.items()]


def plan_rows(plan: Document) -> list[tuple[str, str]]:
    """Return the summary of a plan of feedrates."""
    if not plan:
        return []
    runs = ", ".join(f"{n} at {v:.6g} mm/min" for v, n in plan.get("runs") or [])
    rows = [("Next runs, as planned", runs)]
    quantities = plan.get("quantities") or {}
    for key, name in (("worst_sd", "Predicted sd, at worst"), ("time", "Travel time of them")):
        q = quantities.get(key)
        if q and q.get("value") is not None:
            rows.append((name, _value(q)))
    return rows


def separation_audit(separation: Document) -> dict[str, Any]:
    """Return the settings of a separation, one level deep, for the list of what was done."""
    return dict(separation.get("audit") or {})


def _value(noise: Document) -> str:
    value = noise.get("value")
    if value is None:
        return "not known"
    unit, factor = readable_unit([value], noise.get("unit") or "m")
    return f"{value / factor:.3g} {unit}"


def _unobservable(item: Document) -> str:
    indices = list(item.get("indices") or [])
    if item.get("kind") == "wavelength":
        indices = [length(float(i)) for i in indices]
    shown = ", ".join(f"{i:.6g}" if isinstance(i, float) else str(i) for i in indices)
    kind = _PLURALS.get(str(item.get("kind")), "{}s").format(item.get("kind"))
    if len(indices) == 1:
        kind = str(item.get("kind"))
    if item.get("kind") == "polynomial":
        kind += " of degree"
    if len(indices) > _MOST_INDICES:
        first = ", ".join(str(i) for i in indices[:_MOST_INDICES])
        shown = f"{first}, … ({len(indices)} in all)"
    return f"{kind} {shown}: {item.get('reason')}"

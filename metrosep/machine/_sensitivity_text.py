"""The sensitivity table as text for a terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.machine.sensitivity import SensitivityTable

__all__ = ["amount_text", "report_text"]


_ANGLES = (("urad", 1e-6), ("arcsec", math.pi / 648e3), ("deg", math.pi / 180.0))
_ROUND = 1e-9
"""Of the amount: a number this near to one of three digits was typed as that."""


def amount_text(value: float, unit: str) -> str:
    """Return an amount of a term with three digits; an angle in the unit in which it is round.

    Examples
    --------
    >>> amount_text(4.84813681109536e-06, "rad"), amount_text(1.234e-6, "rad")
    ('1 arcsec', '1.23 urad')
    """
    if value != value:
        return "not known"
    if unit != "rad":
        return f"0 {unit}" if value == 0.0 else format_length(value, digits=3)
    texts = {name: f"{value / factor:.3g}" for name, factor in _ANGLES}
    round_ones = [
        name
        for name, factor in _ANGLES
        if abs(float(texts[name]) * factor - value) <= _ROUND * abs(value)
    ]
    name = min(round_ones, key=lambda k: len(_significant(texts[k])), default="urad")
    return f"{texts[name]} {name}"


def _significant(text: str) -> str:
    """Return the significant digits of a number."""
    return text.partition("e")[0].lstrip("-").replace(".", "").strip("0")


def report_text(table: SensitivityTable) -> str:
    """Return the ranked table, what hangs together, what is left after compensation, messages."""
    kind = f"{table.direction} deviation" if table.response == "form" else "optical path"
    meaning = "standard uncertainty" if table.distribution == "normal" else "half-width, uniform"
    lines = [
        f"Error terms ranked by Sq of the {kind}; removed: {', '.join(table.removed) or 'nothing'}",
        f"magnitude: {meaning}; area-weighted over {table.space.weights.size} points",
        "",
        f"{'term':<8}{'magnitude':>12}{'Sq raw':>12}{'Sq':>12}{'P-V':>12}{'share':>8}  group",
    ]
    group = {n: f"({k})" for k, g in enumerate(table.groups, start=1) for n in g}
    share, seen = table.shares, [n for n in table.order if n in table.visible]
    if not seen:
        lines[-1] = "none of these terms leaves anything that could be seen on this part"
    for name in seen:
        i = table.names.index(name)
        sizes = [format_length(float(v[i]), digits=3) for v in (table.sq_raw, table.sq, table.pv)]
        lines.append(
            f"{name:<8}{table.size_text(name):>12}{sizes[0]:>12}{sizes[1]:>12}{sizes[2]:>12}"
            f"{100.0 * share[i]:>7.1f}%  {group.get(name, '')}".rstrip()
        )
    lines += [f"not visible: {', '.join(names)} ({why})" for why, names in table.hidden.items()]
    raw = format_length(table.expected_sq_raw)
    lines += ["", f"expected Sq {format_length(table.expected_sq)} (nothing removed: {raw})"]
    lines += [
        f"({k}) {', '.join(g)}: maps alike (|r| > {table.threshold:g}), one part cannot tell them apart"
        for k, g in enumerate(table.groups, start=1)
    ]
    done: list[str] = []
    for step in table.pareto()[1:4] if seen else ():
        done.extend(step.names)
        lines.append(f"without {' + '.join(done)}: {format_length(step.sq)}")
    return "\n".join([*lines, *table.messages])

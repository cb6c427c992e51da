"""The sensitivity table as text for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.machine.sensitivity import SensitivityTable

__all__ = ["amount_text", "report_text"]


def amount_text(value: float, unit: str) -> str:
    """Return an amount of a term with three digits; small angles in urad."""
    return f"{1e6 * value:.3g} urad" if unit == "rad" else format_length(value, digits=3)


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
    share = table.shares
    for name in table.order:
        i = table.names.index(name)
        amount = amount_text(float(table.magnitudes[i]), table.units[i])
        gone = name in table.unobservable
        sizes = [format_length(float(v[i]), digits=3) for v in (table.sq_raw, table.sq, table.pv)]
        lines.append(
            f"{name:<8}{amount:>12}{sizes[0]:>12}{sizes[1]:>12}{sizes[2]:>12}"
            f"{100.0 * share[i]:>7.1f}%  {'not visible' if gone else group.get(name, '')}".rstrip()
        )
    raw = format_length(table.expected_sq_raw)
    lines += ["", f"expected Sq {format_length(table.expected_sq)} (nothing removed: {raw})"]
    lines += [
        f"({k}) {', '.join(g)}: maps alike (|r| > {table.threshold:g}), one part cannot tell them apart"
        for k, g in enumerate(table.groups, start=1)
    ]
    done: list[str] = []
    for step in table.pareto()[1:4]:
        done.extend(step.names)
        lines.append(f"without {' + '.join(done)}: {format_length(step.sq)}")
    return "\n".join([*lines, *table.messages])

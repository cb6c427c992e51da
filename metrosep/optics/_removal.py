"""Names of what can be taken off a wavefront, and the Zernike terms behind them."""

from __future__ import annotations

from collections.abc import Iterable

from metrosep.core.errors import DataError

TERMS = {"piston": (0,), "tilt": (1, 2), "tilt_y": (1,), "tilt_x": (2,), "defocus": (4,)}
"""ANSI numbers of what can be removed."""

_RANK = {0: 0, 1: 1, 2: 1, 4: 2}
"""Of those terms: what ranks below a term that is removed is fitted along."""


def removal_names(what: object) -> tuple[str, ...]:
    """Return names of what can be removed, each once, from a name or several."""
    given: tuple[object, ...]
    try:
        given = (what,) if isinstance(what, str) else tuple(what)  # type: ignore[arg-type]
    except TypeError:
        given = (what,)
    names: list[str] = []
    for name in given:
        if not isinstance(name, str) or name not in TERMS:
            raise DataError(f"removed must be of {', '.join(TERMS)}, got {name!r}")
        names.append(name)
    return tuple(dict.fromkeys(names))


def terms_to_fit(names: Iterable[str]) -> tuple[list[int], set[int]]:
    """Return the ANSI numbers to fit together, and those of them to take off."""
    asked = {j for name in names for j in TERMS[name]}
    highest = max(_RANK[j] for j in asked)
    return [j for j, rank in _RANK.items() if rank <= highest], asked


def what_is_gone(names: Iterable[str]) -> str:
    """Return what was removed in one order of words, whatever the order it was done in."""
    gone = {j for name in names for j in TERMS.get(name, ())}
    words = [name for name, terms in TERMS.items() if name != "tilt" and {*terms} <= gone]
    return ", ".join(words) or "anything removed"

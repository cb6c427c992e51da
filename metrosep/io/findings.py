"""An oddity of a file and what to do about it; the sizes of heights that no unit explains."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface

Level = Literal["error", "warning", "note"]

LARGE_HEIGHT = 0.1
"""P-V in m beyond which a unit is more likely wrong than a part that rough."""

SMALL_HEIGHT = 1e-12
"""P-V in m below which no instrument measures."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One oddity of a file.

    Parameters
    ----------
    level : {"error", "warning", "note"}
        ``error``: numbers from this file would mislead; ``warning``: look at it; ``note``: know it.
    problem : str
        What is odd, with numbers.
    fix : str
        What to do.
    unreadable : bool, optional
        Whether the file could not be read at all.
    """

    level: Level
    problem: str
    fix: str
    unreadable: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain values."""
        return asdict(self)


def height_findings(obj: Surface | Profile) -> Iterator[Finding]:
    """Yield what is unusual about the size of heights: a unit that is probably wrong."""
    size = obj.peak_to_valley()
    if size > LARGE_HEIGHT:
        yield Finding(
            "error" if size > 1.0 else "warning",
            f"P-V is {format_length(size)}: the unit of the heights is probably wrong",
            "compare with the instrument's display; declare the unit with --unit, or scale the export",
        )
    elif 0.0 < size < SMALL_HEIGHT:
        yield Finding(
            "warning",
            f"P-V is {size:.3g} m, less than any instrument resolves: the unit is probably wrong",
            "compare with the instrument's display; declare the unit with --unit",
        )

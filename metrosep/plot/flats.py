"""Maps of a three-flat, rotation, shift or ball test, with what was not seen said once below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core.errors import DataError
from metrosep.plot.maps import separation_maps
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["flat_maps"]

_PIXELS = "positions x and y are in pixels"


def flat_maps(
    result: Separation, *, parts: Sequence[str] | None = None, uncertainty: bool = False
) -> Figure:
    """Return a figure of the maps of a result, with its null space below.

    Parameters
    ----------
    result : Separation
        Of `three_flat`, `rotation_average`, `shift_rotation`, `ball_average` or `three_positions`.
    parts : sequence of str, optional
        Which maps; all that hold a measured pixel if omitted.
    uncertainty : bool, optional
        Whether standard uncertainties are drawn instead.

    Returns
    -------
    matplotlib Figure
        One colour scale for all maps; grey = not determined.

    Raises
    ------
    DataError
        If a part is unknown, or the result holds no maps.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.separation.flats import three_flat
    >>> z = 1e-9 * np.outer(np.arange(9.0), np.ones(9)) ** 2
    >>> len(flat_maps(three_flat(z, z, z), parts=["even_A"]).axes)
    2
    """
    shape = (result.coordinates["y"].size, result.coordinates["x"].size) \
        if {"x", "y"} <= set(result.coordinates) else ()  # fmt: skip
    source = result.u if uncertainty else result.parts
    maps = {k: v for k, v in source.items() if v.shape == shape}
    if parts is None:
        chosen = [k for k, v in maps.items() if np.isfinite(v).any()]
    else:
        chosen = list(parts)
    for name in chosen:
        if name not in maps:
            raise DataError(f"the result has no map {name!r}; it has {', '.join(maps) or 'none'}")
    if not chosen:
        raise DataError("the result holds no map with a measured pixel")
    steps: list[float | None] = [None, None]
    if not any(_PIXELS in m for m in result.messages):
        steps = [float(np.diff(result.coordinates[k][:2])[0]) for k in ("x", "y")]
    titles = {k: f"u({k})" for k in chosen} if uncertainty else None
    return separation_maps(
        {k: maps[k] for k in chosen},
        dx=steps[0],
        dy=steps[1],
        titles=titles,
        null_space=_merged(result.null_space),
    )


def _merged(items: Sequence[Unobservable]) -> list[Unobservable]:
    """Return the null space with parts that lack the same for the same reason joined."""
    groups: dict[tuple[str, tuple[int | float | str, ...], str], list[str]] = {}
    for item in items:
        groups.setdefault((item.kind, item.indices, item.reason), []).append(item.part)
    return [
        Unobservable(", ".join(names), kind, indices, reason)  # type: ignore[arg-type]
        for (kind, indices, reason), names in groups.items()
    ]

"""Charts of bars in a result document: rankings, budgets, coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import ArrayLike

from metrosep.recipe.charts import plain

__all__ = ["bar_chart"]


def bar_chart(
    title: str,
    labels: Sequence[str],
    series: Mapping[str, ArrayLike],
    *,
    unit: str,
    quantity: str,
    u: Mapping[str, ArrayLike] | None = None,
    stacked: bool = False,
    log: bool = False,
    caption: str = "",
) -> dict[str, Any]:
    """Return a chart of bars, one group for each label.

    Parameters
    ----------
    title : str
        Of the figure.
    labels : sequence of str
        Below the bars.
    series : mapping of str to array_like, shape (n_labels,)
        Values by name, SI; NaN draws nothing.
    unit : str
        SI unit; ``"1"`` for shares.
    quantity : str
        What the bars show.
    u : mapping of str to array_like, optional
        Standard uncertainty of each series.
    stacked : bool, optional
        One series on the other; else beside one another.
    log : bool, optional
        Whether the scale is logarithmic.
    caption : str, optional
        What it shows.

    Returns
    -------
    dict
        Of kind ``bars``.

    Raises
    ------
    ValueError
        If a series is not as long as the labels.
    """
    for name, values in {**series, **(u or {})}.items():
        if len(list(plain(values))) != len(labels):
            raise ValueError(f"{name} has not one value for each of the {len(labels)} labels")
    return {
        "kind": "bars",
        "title": title,
        "caption": caption,
        "labels": [str(v) for v in labels],
        "series": {name: plain(values) for name, values in series.items()},
        "u": {name: plain(values) for name, values in (u or {}).items()},
        "unit": unit,
        "quantity": quantity,
        "stacked": stacked,
        "log": log,
    }

"""`FeedPlan`: feeds of a set of runs, and the sd they promise for each wavelength."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.profile import html_table
from metrosep.core.provenance import freeze_mapping
from metrosep.separation._result_values import plain, reduced
from metrosep.separation.noise_density import TimeDensity

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["FeedPlan"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FeedPlan:
    """Feeds of a set of runs and what they will tell about each wavelength.

    Parameters
    ----------
    feeds : ndarray, shape (n_runs,), m/s
        One entry for each run, rising; may repeat.
    wavelengths : ndarray, shape (k,), m
        Waves that were planned for.
    information : ndarray, shape (k,), 1/m^2
        ``J = sum_r (L_r / v_r) / S(v_r / wavelength)``, runs already done included; 0 where S
        is not known.
    columns : mapping of str to ndarray
        Columns of `sd`.
    density : TimeDensity
        Disturbance S(f).
    fixed : ndarray, m/s
        Runs already done.
    audit : mapping
        Settings and scores, keys with unit suffixes.
    messages : tuple of str
        What the user should know, in plain words.
    """

    feeds: FloatArray
    wavelengths: FloatArray
    information: FloatArray
    columns: Mapping[str, FloatArray]
    density: TimeDensity
    fixed: FloatArray
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.feeds, self.wavelengths, self.information, *self.columns.values()):
            array.setflags(write=False)
        object.__setattr__(self, "columns", freeze_mapping(self.columns))
        object.__setattr__(self, "audit", freeze_mapping(self.audit))

    @property
    def sd(self) -> pd.DataFrame:
        """Predicted standard deviation of the amplitude coefficients, one row a wavelength.

        ``sd_nm`` is exact for records of this length; ``sd_long_record_nm`` is ``1 / sqrt(J)``;
        ``sd_one_feed_nm`` and ``sd_even_feeds_nm`` are ``sd_nm`` of as many runs all at the middle
        feed, and evenly spread over the range.
        """
        import pandas as pd

        return pd.DataFrame({k: np.array(v) for k, v in self.columns.items()})

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, NaN as None.

        Returns
        -------
        dict
            ``feeds``, ``wavelengths``, ``information``, ``fixed`` in SI, ``sd`` by column with
            unit suffixes, ``density`` (its source), ``audit``, ``messages``.
        """
        names = ("feeds", "wavelengths", "information", "fixed")
        return {
            **{name: plain(getattr(self, name)) for name in names},
            "sd": plain(self.columns),
            "density": self.density.source,
            "audit": plain(self.audit),
            "messages": list(self.messages),
        }

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {
            f"{w * 1e3:.4g} mm": f"sd {sd:.3g} nm" if np.isfinite(sd) else "sd not known"
            for w, sd in zip(self.wavelengths[:20], self.columns["sd_nm"][:20], strict=True)
        }
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table(repr(self), rows)

    def __repr__(self) -> str:
        feeds = ", ".join(
            f"{n} x {v * 6e4:.0f}"
            for v, n in zip(*np.unique(self.feeds, return_counts=True), strict=True)
        )
        sd = self.columns["sd_nm"]
        known = sd[np.isfinite(sd)]
        worst = f"largest sd {known.max():.3g} nm" if known.size else "no sd known"
        return f"FeedPlan({feeds} mm/min, {worst})"

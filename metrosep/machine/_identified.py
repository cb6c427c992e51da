"""What an identification found: terms with u, groups that hang together, what cannot be seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.machine._sensitivity_text import amount_text

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Identification", "IdentifiedGroup"]


@dataclass(frozen=True, slots=True)
class IdentifiedGroup:
    """Terms that one part cannot tell apart, and what is known of them together.

    Parameters
    ----------
    names : tuple of str
        The terms.
    sq, u : float, m
        Signed size of the map they have in common, as Sq after alignment, and its standard
        uncertainty.
    equivalents : mapping of str to tuple of (float, float)
        Amount and standard uncertainty of each term if it alone were at work, in its unit.
    likeness : float
        Share of the maps' squares that the common map holds, 0 to 1.
    """

    names: tuple[str, ...]
    sq: float
    u: float
    equivalents: Mapping[str, tuple[float, float]]
    likeness: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Identification:
    """Error terms that explain a measured map.

    Parameters
    ----------
    names, units : tuple of str
        Terms that were asked for.
    values, u : ndarray, shape (m,)
        Amount (actual minus nominal) and standard uncertainty of each term; NaN where the map does
        not determine it alone.
    groups : tuple of IdentifiedGroup
        Terms that are only known together.
    unobservable : tuple of str
        Terms of which the alignment or the part shows nothing.
    estimate : mapping of str to float
        One set of amounts that explains the map, of all terms that can be seen; within a group the
        smallest such set. For prediction and compensation of this part, not for diagnosis.
    covariance : ndarray, shape (p, p)
        Of `estimate`, in its order.
    freedoms : mapping of str to tuple of (float, float)
        Alignment fitted along, with standard uncertainty.
    sq_before, sq_after : float, m
        Sq after alignment alone, and after alignment and terms.
    predicted_sq : float, m
        Sq of a next part if `estimate` were compensated: what is left, and what the uncertainty of
        the amounts adds.
    residual : Surface or ndarray
        Measured minus model, m; NaN where not used.
    audit : mapping
        Settings and counts, with units in the keys.
    messages : tuple of str
        What the reader must know.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    u: FloatArray
    groups: tuple[IdentifiedGroup, ...]
    unobservable: tuple[str, ...]
    estimate: Mapping[str, float]
    covariance: FloatArray
    freedoms: Mapping[str, tuple[float, float]]
    sq_before: float
    sq_after: float
    predicted_sq: float
    residual: Surface | FloatArray
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __getitem__(self, term: str) -> Quantity:
        """Return the amount of a term; NaN where the map does not determine it."""
        if term not in self.names:
            raise DataError(f"{term!r} was not asked for; there are {', '.join(self.names)}")
        i = self.names.index(term)
        u = float(self.u[i])
        return Quantity(
            float(self.values[i]),
            self.units[i],
            f"{term}, actual minus nominal, from a measured map",
            u=None if np.isnan(u) else u,
            symbol=term,
        )

    @property
    def correction(self) -> dict[str, float]:
        """Minus the estimate: what to command to take the errors away."""
        return {n: -v for n, v in self.estimate.items()}

    def to_frame(self) -> pd.DataFrame:
        """Return the terms as a data frame.

        Returns
        -------
        pandas.DataFrame
            Index ``term``; columns ``value``, ``u``, ``unit`` (SI), ``group`` (0: none),
            ``if_alone``, ``u_if_alone``, ``observable``.
        """
        import pandas as pd

        return pd.DataFrame(self._rows()).set_index("term")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI; NaN becomes None.

        Returns
        -------
        dict
            Keys ``terms``, ``groups``, ``unobservable``, ``freedoms``, ``sq_before_nm``,
            ``sq_after_nm``, ``predicted_sq_nm``, ``audit``, ``messages``.
        """
        return {
            "terms": [
                {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in row.items()}
                for row in self._rows()
            ],
            "groups": [
                {"terms": list(g.names), "sq_nm": 1e9 * g.sq, "u_nm": 1e9 * g.u}
                for g in self.groups
            ],
            "unobservable": list(self.unobservable),
            "freedoms": {n: {"value": v, "u": u} for n, (v, u) in self.freedoms.items()},
            "sq_before_nm": 1e9 * self.sq_before,
            "sq_after_nm": 1e9 * self.sq_after,
            "predicted_sq_nm": 1e9 * self.predicted_sq,
            "audit": dict(self.audit),
            "messages": list(self.messages),
        }

    def report(self) -> str:
        """Return what was found as text.

        Returns
        -------
        str
            Several lines.
        """
        lines = [f"{'term':<8}{'amount':>14}{'u':>14}"]
        for n, unit, v, u in zip(self.names, self.units, self.values, self.u, strict=True):
            if not np.isnan(v):
                lines.append(f"{n:<8}{amount_text(v, unit):>14}{amount_text(u, unit):>14}")
        for g in self.groups:
            lines.append(
                f"together {', '.join(g.names)}: Sq {format_length(g.sq, digits=3)} "
                f"(u = {format_length(g.u, digits=2)}); if one alone:"
            )
            for n, (v, u) in g.equivalents.items():
                unit = self.units[self.names.index(n)]
                lines.append(f"  {n:<6}{amount_text(v, unit):>14}{amount_text(u, unit):>14}")
        if self.unobservable:
            lines.append(f"not visible: {', '.join(self.unobservable)}")
        lines.append(
            f"Sq {format_length(self.sq_before)} aligned, {format_length(self.sq_after)} explained; "
            f"if compensated {format_length(self.predicted_sq)}"
        )
        return "\n".join([*lines, *self.messages])

    def __repr__(self) -> str:
        known = int(np.count_nonzero(~np.isnan(self.values)))
        return (
            f"Identification({known} terms, {len(self.groups)} groups, Sq "
            f"{format_length(self.sq_before)} -> {format_length(self.sq_after)})"
        )

    def _rows(self) -> list[dict[str, Any]]:
        place = {n: (k, g) for k, g in enumerate(self.groups, start=1) for n in g.names}
        nothing = (float("nan"), float("nan"))
        return [
            {
                "term": n,
                "value": float(self.values[i]),
                "u": float(self.u[i]),
                "unit": self.units[i],
                "group": place[n][0] if n in place else 0,
                "if_alone": (place[n][1].equivalents[n] if n in place else nothing)[0],
                "u_if_alone": (place[n][1].equivalents[n] if n in place else nothing)[1],
                "observable": n not in self.unobservable,
            }
            for i, n in enumerate(self.names)
        ]

"""`FormDeviation`: straightness, flatness or roundness with the points that prove it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.public import PublicObject
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.parameters.table import Context, ParameterTable

Kind = Literal["straightness", "flatness", "roundness"]
Reference = Literal["MZ", "LS", "EP", "MC", "MI"]

_PROOF = 1e-9
"""Relative difference between objective and bound up to which the support is a proof."""

_ROUNDING = 1e-14
"""The same, relative to the largest height: rounding of an exact form."""

_REFERENCES: Mapping[tuple[str, str], str] = {
    ("straightness", "MZ"): "the middle of the minimum zone of two parallel lines",
    ("straightness", "LS"): "the least-squares line",
    ("straightness", "EP"): "the line through the end points",
    ("flatness", "MZ"): "the middle of the minimum zone of two parallel planes",
    ("flatness", "LS"): "the least-squares plane",
    ("roundness", "MZ"): "the middle of the minimum zone of two concentric circles (MZCI)",
    ("roundness", "LS"): "the least-squares circle (LSCI)",
    ("roundness", "MC"): "the minimum circumscribed circle (MCCI)",
    ("roundness", "MI"): "the maximum inscribed circle (MICI)",
}

_CLAUSES = {
    "straightness": ("STR", "ISO 12780-1:2011"),
    "flatness": ("FLT", "ISO 12781-1:2011"),
    "roundness": ("RON", "ISO 12181-1:2011"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """The points that hold a reference, each with its side and weight.

    Parameters
    ----------
    indices : ndarray of int, shape (m,) or (m, 2)
        Sample of a profile, or row and column of a surface.
    positions : ndarray, shape (m,) or (m, 2)
        x in m, angle in rad, or x and y in m (pixels where a surface is not calibrated).
    heights : ndarray, shape (m,), m
        Measured heights.
    sides : ndarray of int, shape (m,)
        +1: touches from outside the material (upper line, outer circle); -1: the other side.
    weights : ndarray, shape (m,)
        Not negative; 1 in sum on each side. Where the weighted positions of both sides coincide
        (or, of one-sided circles, the weighted directions cancel), no other reference is better.
    """

    indices: IntArray
    positions: FloatArray
    heights: FloatArray
    sides: IntArray
    weights: FloatArray

    def __len__(self) -> int:
        return int(self.sides.size)

    @property
    def upper(self) -> IntArray:
        """Indices of the points on side +1."""
        return self.indices[self.sides > 0]

    @property
    def lower(self) -> IntArray:
        """Indices of the points on side -1."""
        return self.indices[self.sides < 0]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FormDeviation(PublicObject):
    """Form deviation from one reference; SI.

    Parameters
    ----------
    kind : {"straightness", "flatness", "roundness"}
        What was evaluated.
    reference : {"MZ", "LS", "EP", "MC", "MI"}
        Associated reference.
    table : ParameterTable
        STRt, STRp, STRv, STRq (FLT.., RON..): total, peak, valley (positive), root mean square.
    reference_parameters : mapping of str to Quantity
        Line: ``slope``, ``intercept``; plane: ``slope_x``, ``slope_y``, ``intercept``; circle:
        ``a``, ``b`` (centre along angle 0 and pi/2) and ``radius``.
    residual : Profile or Surface
        Local deviations from the reference, NaN where not measured.
    support : Support
        Points that hold the reference; for LS and EP the highest and the lowest one.
    objective : float, m
        What the reference minimises: width of the zone (MZ), radius (MC); what it maximises:
        radius (MI); NaN for LS and EP.
    bound : float, m
        What no other reference can beat, from the support alone: lower for MZ and MC, upper for
        MI; NaN for LS and EP.
    """

    kind: Kind
    reference: Reference
    table: ParameterTable
    reference_parameters: Mapping[str, Quantity]
    residual: Profile | Surface
    support: Support
    objective: float = math.nan
    bound: float = math.nan

    @property
    def symbol(self) -> str:
        """STRt, FLTt or RONt."""
        return _CLAUSES[self.kind][0] + "t"

    @property
    def quantity(self) -> Quantity:
        """Total deviation with unit and definition."""
        return self.table[self.symbol]

    @property
    def value(self) -> float:
        """Total deviation in m."""
        return self.quantity.value

    @property
    def unit(self) -> str:
        """SI unit, m."""
        return self.quantity.unit

    @property
    def u(self) -> float | None:
        """Standard uncertainty in m; None where it is not known."""
        return self.quantity.u

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader must know, one sentence each."""
        return self.table.context.notes

    @property
    def is_optimal(self) -> bool:
        """Whether the support proves the reference; False for LS and EP, which need no proof."""
        if math.isnan(self.bound):
            return False
        largest = float(np.abs(self.support.heights).max())
        allowed = _PROOF * abs(self.value) + _ROUNDING * largest
        return abs(self.objective - self.bound) <= allowed

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, without the residual.

        Returns
        -------
        dict
            Keys of the table, and ``kind``, ``reference``, ``reference_parameters``, ``support``,
            ``bound``, ``is_optimal``.
        """
        return {
            "kind": self.kind,
            "reference": self.reference,
            **self.table.to_dict(),
            "reference_parameters": {k: q.to_dict() for k, q in self.reference_parameters.items()},
            "support": {
                "indices": self.support.indices.tolist(),
                "sides": self.support.sides.tolist(),
                "weights": self.support.weights.tolist(),
            },
            "bound": None if math.isnan(self.bound) else self.bound,
            "is_optimal": self.is_optimal,
        }

    def __repr__(self) -> str:
        proof = ", proven by its support" if self.is_optimal else ""
        return f"FormDeviation({self.symbol} = {self.quantity}, {self.reference}{proof})"


def form_table(
    kind: Kind,
    reference: Reference,
    residual: FloatArray,
    *,
    weights: FloatArray | None = None,
    n_total: int,
    history: tuple[Step, ...],
    settings: Mapping[str, Any],
    notes: Sequence[str],
) -> ParameterTable:
    """Return the t, p, v and q parameters of local deviations."""
    prefix, clause = _CLAUSES[kind]
    line = _REFERENCES[kind, reference]
    if reference == "EP":
        clause = "ISO 230-1:2012"
    peak, valley = float(residual.max()), float(residual.min())
    if weights is None:
        rms = math.sqrt(float(np.dot(residual, residual)) / residual.size)
    else:
        rms = math.sqrt(float(np.dot(weights, residual**2) / weights.sum()))
    rows = [  # 0.0 first: of equals max returns the first, which is not to be -0.0
        ("t", peak - valley, f"{kind}, peak to valley from {line}"),
        ("p", max(0.0, peak), f"{kind}, highest local deviation from {line}"),
        ("v", max(0.0, -valley), f"{kind}, lowest local deviation from {line}, positive"),
        ("q", rms, f"{kind}, root mean square of the local deviations from {line}"),
    ]
    said = list(notes)
    if reference != "LS":
        said.append(f"{prefix}p, {prefix}v and {prefix}q are standardised for the LS reference")
    if residual.size < n_total:
        said.append(f"{n_total - residual.size} of {n_total} samples were not measured: excluded")
    return ParameterTable(
        [Quantity(v, "m", f"{text}, {clause}", symbol=prefix + s) for s, v, text in rows],
        Context(
            edition=clause,
            n_valid=int(residual.size),
            n_total=n_total,
            history=history,
            settings={"reference": reference, **settings},
            notes=tuple(said),
        ),
    )

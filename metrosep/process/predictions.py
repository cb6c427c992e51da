"""What a turning job predicts: the error of each cause over the part, and the corrected program.

Errors are actual minus nominal along z, out of the material; a correction is the negative.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.quantity import Quantity
from metrosep.process.budget import ErrorBudget

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CorrectedProgram", "Prediction", "pv_quantities"]


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Form error before the part is cut.

    Parameters
    ----------
    budget : ErrorBudget
        Causes as maps over the same points, or as a P-V.
    rho, azimuth : ndarray, shape (n,), m and rad
        Points on the part.
    removed : tuple of str
        What was taken off each map.
    messages : tuple of str
        What to know.
    audit : mapping
        Settings, units in the keys.
    """

    budget: ErrorBudget
    rho: FloatArray
    azimuth: FloatArray
    removed: tuple[str, ...]
    messages: tuple[str, ...]
    audit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def maps(self) -> dict[str, FloatArray]:
        """Error of each cause that has a map, m."""
        return {c.name: c.map for c in self.budget.contributions if c.map is not None}

    @property
    def total(self) -> FloatArray:
        """Sum of the maps, m; NaN where one is not known."""
        return np.asarray(np.sum(list(self.maps.values()), axis=0), dtype=np.float64)

    @property
    def x(self) -> FloatArray:
        """Positions along x, m."""
        return np.asarray(self.rho * np.cos(self.azimuth), dtype=np.float64)

    @property
    def y(self) -> FloatArray:
        """Positions along y, m."""
        return np.asarray(self.rho * np.sin(self.azimuth), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedProgram:
    """A program with heights that make up for known errors: of the tip, or of points to be cut.

    Parameters
    ----------
    rho, azimuth : ndarray, shape (n,), m and rad
        Commanded points, lead-in first.
    nominal, z : ndarray, shape (n,), m
        Height without and with the correction.
    lead_in : int
        Points before the rim.
    residual_pv : mapping of str to float, m
        P-V of what an uncertainty of the tool setting of one u leaves, by factor.
    messages : tuple of str
        What to know.
    audit : mapping
        Settings, units in the keys.
    quantity : {"cut points", "tip"}
        What the points are. Cut points are points of the surface, which a tool with a nose must not
        be sent to as they are; "tip" are places of the tip, the lowest point of the edge.
    """

    rho: FloatArray
    azimuth: FloatArray
    nominal: FloatArray
    z: FloatArray
    lead_in: int
    residual_pv: Mapping[str, float]
    messages: tuple[str, ...]
    audit: Mapping[str, Any]
    quantity: Literal["cut points", "tip"] = "cut points"

    @property
    def change(self) -> FloatArray:
        """What was added to the nominal height, m: the negative of the predicted error."""
        return np.asarray(self.z - self.nominal, dtype=np.float64)

    def to_frame(self) -> pd.DataFrame:
        """Return the program as a table.

        Returns
        -------
        DataFrame
            Columns rho_um, azimuth_deg, z_nominal_nm, z_command_nm, the names of lengths with what
            they belong to in front: cut_point_rho_um, tip_z_command_nm.
        """
        import pandas as pd

        of = self.quantity.removesuffix("s").replace(" ", "_")
        return pd.DataFrame(
            {
                f"{of}_rho_um": 1e6 * self.rho,
                "azimuth_deg": np.degrees(self.azimuth),
                f"{of}_z_nominal_nm": 1e9 * self.nominal,
                f"{of}_z_command_nm": 1e9 * self.z,
            }
        )


def pv_quantities(budget: ErrorBudget) -> dict[str, Quantity]:
    """Return the P-V of each cause and of each total with unit and definition."""
    found = {
        f"{c.name}.pv": Quantity(float(c.pv or 0.0), "m", f"P-V of the error by {c.name}", u=c.u)
        for c in budget.contributions
    }
    for way, total in budget.totals().items():
        u = None if np.isnan(total.u) else total.u
        found[way] = Quantity(total.pv, "m", total.definition, u=u, symbol=f"PV {way}")
    return found

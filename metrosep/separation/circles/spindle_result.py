"""`SpindleMotion` and `SpindleHarmonics`: what a spindle test gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.profile import html_table
from metrosep.core.quantity import Quantity
from metrosep.parameters.table import ParameterTable
from metrosep.separation._methods import StoredResult
from metrosep.separation._readings import plain

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["SpindleHarmonics", "SpindleMotion"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpindleHarmonics(StoredResult):
    """Harmonics of the mean revolution and of the scatter; arrays over k = 1 .. n // 2.

    Parameters
    ----------
    k : ndarray of int, shape (h,)
        Undulations per revolution.
    amplitude : ndarray, shape (h,), m or rad
        Of the mean revolution: ``amplitude cos(k t - phase)``.
    phase : ndarray, shape (h,), rad
        Angle k t at which the harmonic is highest, -pi to pi.
    u : ndarray, shape (h,), m or rad
        Standard uncertainty of the amplitude, from the scatter between revolutions.
    nrr : ndarray, shape (h,), m or rad
        Non-repeatable: root mean square deviation of the complex amplitude of one revolution from
        the mean.
    significant : ndarray of bool, shape (h,)
        Whether the harmonic repeats (F test, 1 % of those named are expected to be noise).
    removed : tuple of int
        Harmonics that are not in the synchronous motion, such as the eccentricity k = 1.
    """

    k: NDArray[np.intp]
    amplitude: FloatArray
    phase: FloatArray
    u: FloatArray
    nrr: FloatArray
    significant: NDArray[np.bool_]
    removed: tuple[int, ...]

    def __repr__(self) -> str:
        found = [int(k) for k in self.k[self.significant]]
        named = ", ".join(str(k) for k in found[:8]) + (", ..." if len(found) > 8 else "")
        return f"SpindleHarmonics(k = 1 .. {int(self.k[-1])}, repeating: {named or 'none'})"

    def to_frame(self) -> pd.DataFrame:
        """Return a row per k: ``amplitude``, ``phase_rad``, ``u``, ``nrr``, ``significant``, ``removed``."""
        import pandas as pd

        return pd.DataFrame(
            {
                "amplitude": self.amplitude,
                "phase_rad": self.phase,
                "u": self.u,
                "nrr": self.nrr,
                "significant": self.significant,
                "removed": np.isin(self.k, self.removed),
            },
            index=pd.Index(self.k, name="k"),
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpindleMotion(StoredResult):
    """Result of a spindle test after ISO 230-7; frozen, SI.

    Parameters
    ----------
    direction : {"radial", "axial", "tilt", "face"}
        What was measured.
    sensitive : {"fixed", "rotating"}
        Sensitive direction.
    center : {"LSC", "MZC", "MIC", "MCC", "PC"}
        Centre that widths are counted about; PC (polar chart) for axial and face motion.
    table : ParameterTable
        ``synchronous``, ``asynchronous``, ``total`` and more, each with unit, definition and u.
    angle : ndarray, shape (n,), rad
        Of the columns.
    motion : ndarray, shape (m, n), m or rad
        Error motion of each revolution about the centre, mean level removed.
    synchronous_motion : ndarray, shape (n,), m or rad
        Mean over revolutions about the centre, only k <= kmax where that was asked.
    asynchronous_range : ndarray, shape (n,), m or rad
        Largest minus smallest reading at each angle.
    asynchronous_sd : ndarray, shape (n,), m or rad
        Standard deviation over revolutions (ddof 1) at each angle.
    harmonics : SpindleHarmonics
        Of the readings before the centre was removed.
    centre : tuple of (float, float), m or rad
        What was removed as ``a cos t + b sin t``; zeros where k = 1 is kept.
    revolutions : ndarray of int, shape (m,)
        Numbers of the revolutions used, in the record.
    audit : mapping
        Settings and what was removed, plain values.
    messages : tuple of str
        Warnings.
    """

    direction: str
    sensitive: str
    center: str
    table: ParameterTable
    angle: FloatArray
    motion: FloatArray
    synchronous_motion: FloatArray
    asynchronous_range: FloatArray
    asynchronous_sd: FloatArray
    harmonics: SpindleHarmonics
    centre: tuple[float, float]
    revolutions: NDArray[np.intp]
    audit: Mapping[str, Any]
    messages: tuple[str, ...]

    @property
    def synchronous(self) -> Quantity:
        """Synchronous error motion value."""
        return self.table["synchronous"]

    @property
    def asynchronous(self) -> Quantity:
        """Asynchronous error motion value."""
        return self.table["asynchronous"]

    @property
    def total(self) -> Quantity:
        """Total error motion value."""
        return self.table["total"]

    @property
    def n_revolutions(self) -> int:
        """Revolutions used."""
        return int(self.motion.shape[0])

    @property
    def unit(self) -> str:
        """Unit of the motion: m, or rad for tilt."""
        return self.synchronous.unit

    def __getitem__(self, symbol: str) -> Quantity:
        return self.table[symbol]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI: keys of the table and settings, no arrays over angle."""
        head = {n: getattr(self, n) for n in ("direction", "sensitive", "center", "centre")}
        tail = {"audit": self.audit, "messages": self.messages}
        found: dict[str, Any] = plain({**head, **self.table.to_dict(), **tail})
        return found

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {s: f"{q} \N{EM DASH} {q.definition}" for s, q in self.table.items()}
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        title = f"{self.direction} error motion, {self.center}, {self.n_revolutions} revolutions"
        return html_table(title, rows)

    def __repr__(self) -> str:
        head = f"SpindleMotion({self.direction}, {self.sensitive} sensitive direction"
        return (
            f"{head}, {self.center}, {self.n_revolutions} revolutions: synchronous "
            f"{self.synchronous}, asynchronous {self.asynchronous}, total {self.total})"
        )

"""What the methods with probes in a row on one carriage share: readings of known parts."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.separation._line_probes import Row, interpolation
from metrosep.separation.contract import SeparationMethod


class ProbeRowMethod(SeparationMethod):
    """Probes in a row; derived classes say where they sit."""

    @property
    @abstractmethod
    def _row(self) -> Row:
        """Offsets, step and what is known of the probes."""

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like
            ``artefact``, shape (n + span/step rounded up,), m, from the first probe at the first
            position on; the span is the distance of the first and the last probe.
        errors : mapping of str to array_like
            ``straightness``, shape (n,), m, and ``pitch``, shape (n,), rad; of three probes
            ``zero`` too, scalar, m (NaN is no zero difference).

        Returns
        -------
        ndarray, shape (n_probes, n), m
            From the trailing to the leading probe, in the order of the offsets.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or the lengths do not fit.
        """
        return simulated(
            self._row,
            truth,
            errors,
            truth_parts=self.truth_parts,
            error_parts=self.error_parts,
            what=self.name,
        )


# ---- readings that known parts produce on probes in a row --------------------------------------


def simulated(
    row: Row,
    truth: Mapping[str, ArrayLike],
    errors: Mapping[str, ArrayLike],
    *,
    truth_parts: Sequence[str],
    error_parts: Sequence[str],
    what: str,
) -> FloatArray:
    """Return the readings of parts: artefact (m,), straightness, pitch (n,), zero (scalar)."""
    for given, known, kind in ((truth, truth_parts, "truth"), (errors, error_parts, "error")):
        for name in given:
            if name not in known:
                raise DataError(f"{what} has no {kind} part {name!r}; it has {', '.join(known)}")
    parts = {k: np.asarray(v, dtype=np.float64) for k, v in {**truth, **errors}.items()}
    n = _n_positions(row, parts, what)
    o = np.array(row.offsets)
    readings = np.zeros((o.size, n))
    if "artefact" in parts:
        grid = (o[0] + row.step * np.arange(n + row.span)).astype(np.float64)
        at = [interpolation(grid, row.step * np.arange(n) + v) for v in o]
        readings += np.array([p @ parts["artefact"] for p in at])
    zero = np.zeros(n)
    readings += parts.get("straightness", zero) + o[:, None] * parts.get("pitch", zero)
    if "zero" in parts and np.isfinite(parts["zero"]).all():
        w = row.weights
        readings += (w * float(parts["zero"]) / (w @ w))[:, None]
    return readings


def _n_positions(row: Row, parts: Mapping[str, FloatArray], what: str) -> int:
    counts = {k: v.size for k, v in parts.items() if k in ("straightness", "pitch")}
    if "artefact" in parts:
        counts["artefact"] = parts["artefact"].size - row.span
    if len(set(counts.values())) != 1 or min(counts.values()) < 2:
        sizes = ", ".join(f"{k} {v.size}" for k, v in parts.items()) or "none is given"
        raise DataError(
            f"{what}: for n >= 2 carriage positions straightness and pitch have n values, the artefact "
            f"n + {row.span}; got {sizes}"
        )
    return next(iter(counts.values()))

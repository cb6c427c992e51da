"""What the methods with probes in a row on one carriage share: readings of known parts."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.separation._line_probes import Row
from metrosep.separation._line_simulation import simulated
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

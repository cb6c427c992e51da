"""Straightness from any number of probes at any offsets on one carriage, with an angle sensor.

Reading model: ``m_j = f(x + o_j) + z + o_j t + e_j``: artefact f, straightness z and pitch t of the
carriage, zeros e_j of the probes. Two probes leave the pitch in the artefact unless a sensor reads
it; from three on it is free. More probes than the carriage needs give redundancy: the noise is then
found from the readings, and fewer wavelengths are lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.errors import DataError
from metrosep.core.numbers import flag, positive
from metrosep.core.options import option
from metrosep.core.profile import Profile
from metrosep.separation._methods import described_by, settle
from metrosep.separation.contract import Separation
from metrosep.separation.lines._line_probes import Row, checked_row
from metrosep.separation.lines._line_problem import given_readings, method_named
from metrosep.separation.lines._line_result import ProbeRowMethod

__all__ = ["MultiProbe", "multi_probe_straightness"]

_METHODS = ("least_squares", "generalised")


@dataclass(frozen=True, slots=True)
class MultiProbe(ProbeRowMethod):
    """Probes at offsets on one carriage, evaluated by least squares.

    Parts: ``artefact``, (n + span/step rounded up,), from the first probe at the first position on;
    ``straightness`` and ``pitch`` (rad), (n,), of the carriage. `transfer` is the norm over the
    orthonormal combinations without carriage: noise s of a reading becomes ``s / transfer``.

    Parameters
    ----------
    offsets : tuple of float, m
        Positions of the probes on the carriage, rising; where the offset is 0, straightness is
        referred to.

    Raises
    ------
    DataError
        If the offsets do not rise or the method is unknown.
    """

    offsets: tuple[float, ...] = option(
        kind="lengths", help="of the probes on the carriage, rising, in the order of the readings"
    )
    step: float = option(
        kind="size",
        required=False,
        help="between the samples of the artefact, and the positions of the carriage unless they "
        "are given",
    )
    method: str = option(
        "least_squares",
        kind="text",
        choices=("least_squares", "generalised"),
        help="generalised adds a penalty on third differences",
    )
    zeros_known: bool = option(
        False,
        kind="flag",
        help="true: the readings are free of the zeros of the probes, which were adjusted to one "
        "line; the parabola then shows",
    )
    smoothing: float = option(1e-3, kind="number", help="weight of the penalty of generalised")

    name = "multi_probe_straightness"
    what = "straightedge and slide from probes at any offsets on the carriage"
    truth_parts = ("artefact",)
    error_parts = ("straightness", "pitch")
    _normed: ClassVar[bool] = True

    def __post_init__(self) -> None:
        settle(
            self,
            offsets=tuple(np.ravel(self.offsets).tolist()),
            method=method_named(self.method, _METHODS, self.name),
            zeros_known=flag(self.zeros_known, "zeros_known"),
            smoothing=positive(self.smoothing, f"{self.name}: smoothing"),
        )
        _ = self._row

    @property
    def _row(self) -> Row:
        three = len(self.offsets) > 2
        return checked_row(
            self.offsets,
            self.step,
            what=self.name,
            pitch=three,
            zero_known=three and self.zeros_known,
        )


@described_by(MultiProbe, MultiProbe.separate)
def multi_probe_straightness(
    m: ArrayLike | Sequence[Profile],
    offsets: ArrayLike,
    *,
    x: ArrayLike | None = None,
    step: float | None = None,
    method: str = "least_squares",
    zeros_known: bool = False,
    u_reading: float | None = None,
    pitch: ArrayLike | None = None,
    u_pitch: float | None = None,
    smoothing: float = 1e-3,
) -> Separation:
    """Return form of an artefact, straightness and pitch of a carriage from probes on it.

    Parameters
    ----------
    m : array_like, shape (n_probes, n) or (n_probes, R, n), m, or Profiles
        Readings in the order of the offsets at the same positions of the carriage; or R passes.
        NaN or masked = not measured.
    x : array_like, shape (n,), m, optional
        Positions of the carriage, rising; of any steps if `step` is given too.

    Returns
    -------
    Separation
        ``.artefact`` over ``coordinates["x"]``, ``.straightness`` and ``.pitch`` over
        ``coordinates["carriage_x"]``, where the offset is 0.

    Notes
    -----
    At each position of each pass the readings are projected onto what does not see the carriage,
    then averaged over the passes that hold the same probes; samples that no probe read are NaN. The artefact
    follows by least squares, the null space from the singular values of this design (above 600
    samples it is verified by the condition of its QR factors). Positions off the artefact grid are
    reached by the interpolating spline of degree 5. Cost O(n^3): 2 s at 2000 samples.

    References
    ----------
    C. Elster, I. Weingaertner, M. Schulz, Coupled distance sensor systems for high-accuracy
    topography measurement, Precis. Eng. 30 (2006) 32-38.

    Examples
    --------
    >>> import numpy as np
    >>> i = np.arange(40)
    >>> form, slide = 1e-8 * np.sin(i), 1e-6 * np.cos(i[:33])
    >>> m = [form[k : k + 33] + slide for k in (0, 2, 5, 7)]
    >>> offsets = 1e-3 * np.array([0, 2, 5, 7])
    >>> result = multi_probe_straightness(m, offsets, step=1e-3, zeros_known=True)
    >>> level = form - np.polyval(np.polyfit(i, form, 1), i)
    >>> bool(abs(result.artefact - level).max() < 1e-15)
    True
    """
    given = given_readings(m, x, step, MultiProbe.name)
    try:
        places = tuple(np.ravel(np.asarray(offsets, dtype=np.float64)).tolist())
    except (TypeError, ValueError):
        raise DataError(
            f"{MultiProbe.name}: offsets must be the positions of the probes in m, got {offsets!r}"
        ) from None
    probes = MultiProbe(places, given.step, method, zeros_known, smoothing)
    return given.separated(probes, u_reading, pitch, u_pitch)

"""Lost motion in the dry-run: whether the step of a table at a reversal has the right sign.

From every curve the offset is removed before P-V and RMS, because a run has no absolute zero; so
neither number sees a reverse column that is shifted the wrong way. The offset between the
directions is therefore judged on its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LostMotion", "judge_lost_motion"]

FloatArray = NDArray[np.float64]

_SIGNIFICANT = 3.0
"""Growth in standard uncertainties that is no longer chance."""

_ROUNDING = 1e-12
"""A picometre: growth below it is that of binary positions."""


@dataclass(frozen=True, slots=True)
class LostMotion:
    """Offset of the reverse direction against the forward one, mean over the compared positions.

    Parameters
    ----------
    before, after, wrong_sign : float, m
        Reverse minus forward without, with, and with the negated correction.
    step : float, m
        What the table does about it: mean of reverse minus forward correction.
    u : float or None, m
        Standard uncertainty of `before` from the scatter of the runs; None where nothing tells.
    margin : float, m
        Growth that is not held against the table.
    """

    before: float
    after: float
    wrong_sign: float
    step: float
    u: float | None
    margin: float

    @property
    def passed(self) -> bool:
        """Whether the table leaves lost motion alone or does not make it larger."""
        return self.step == 0.0 or abs(self.after) - abs(self.before) <= self.margin

    def to_dict(self) -> dict[str, Any]:
        """Return plain values with units in the keys.

        Returns
        -------
        dict
            For sidecars and reports.
        """
        return {
            "passed": self.passed,
            "before_m": self.before,
            "after_m": self.after,
            "wrong_sign_m": self.wrong_sign,
            "step_of_table_m": self.step,
            "u_m": self.u,
        }


def judge_lost_motion(
    before: dict[int, FloatArray],
    after: dict[int, FloatArray],
    wrong: dict[int, FloatArray],
    *,
    step: float,
    u: float | None,
    residual_rms: float,
) -> LostMotion:
    """Return the lost motion before and after a table.

    Parameters
    ----------
    before, after, wrong : dict of ndarray, shape (runs,), m
        For +1 and -1: mean of each run without, with and with the negated correction.
    step : float, m
        Mean of reverse minus forward correction.
    u : float or None, m
        Standard uncertainty where it is known otherwise than by scatter.
    residual_rms : float, m
        RMS that the table leaves of the shape: an offset is not known better.

    Returns
    -------
    LostMotion
        Judged with a margin of three standard uncertainties, at least the residual RMS.

    Notes
    -----
    A sensor that is set to zero between runs destroys the offset; its scatter then widens the
    margin where there are two runs or more in each direction.
    """

    def difference(of: dict[int, FloatArray]) -> float:
        return float(of[-1].mean() - of[1].mean())

    spread = u
    if u is None and min(before[1].size, before[-1].size) > 1:
        spread = math.sqrt(sum(float(v.var(ddof=1)) / v.size for v in before.values()))
    margin = max(_SIGNIFICANT * (spread or 0.0), residual_rms, _ROUNDING)
    return LostMotion(
        difference(before), difference(after), difference(wrong), step, spread, margin
    )

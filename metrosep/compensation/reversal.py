"""Lost motion in the dry-run: whether the step of a table at a reversal has the right sign.

Pitch hides it: a reverse column of the wrong sign can leave the RMS of both directions together
smaller than it was. The offset between the directions is therefore judged on its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.compensation._acceptance import ROUNDING, Stack, lost_motion_change
from metrosep.compensation.limits import Stated

__all__ = ["LostMotion", "judge_lost_motion"]


@dataclass(frozen=True, slots=True)
class LostMotion(Stated):
    """Offset of the reverse direction against the forward one, mean over the compared positions.

    Parameters
    ----------
    before, after, wrong_sign : float, m
        Reverse minus forward without, with, and with the negated correction.
    step : float, m
        What the table does about it: mean of reverse minus forward correction.
    u : float or None, m
        Standard uncertainty of `before` from the scatter of the runs; None for one run.
    passed : bool
        Whether the table leaves lost motion alone, or is not shown (99 %) to make it larger.
    """

    before: float
    after: float
    wrong_sign: float
    step: float
    u: float | None
    passed: bool

    def to_dict(self) -> dict[str, Any]:
        return {
            "passed": self.passed,
            "before_m": self.before,
            "after_m": self.after,
            "wrong_sign_m": self.wrong_sign,
            "step_of_table_m": self.step,
            "u_m": self.u,
        }


def judge_lost_motion(stack: Stack) -> LostMotion:
    """Return the lost motion before and after a table."""
    ahead, back = stack.way > 0, stack.way < 0
    before, after, wrong = (
        v[:, back].mean(axis=1) - v[:, ahead].mean(axis=1)
        for v in (stack.known, stack.rest, stack.wrong)
    )
    step, change, margin = lost_motion_change(stack)
    u = float(before.std(ddof=1) / np.sqrt(before.size)) if before.size > 1 else None
    return LostMotion(
        float(before.mean()), float(after.mean()), float(wrong.mean()), step, u,
        abs(step) <= ROUNDING or change + margin >= 0.0,
    )  # fmt: skip

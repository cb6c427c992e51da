"""What a dry-run found: grade, numbers and sentences, for a person, a sidecar and a report."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from metrosep.compensation._acceptance import (
    ROUNDING,
    Judged,
    Judgement,
    Reason,
    Stack,
    lost_motion_change,
)
from metrosep.compensation.area_errors import LENGTHS, AxisUnits, format_span
from metrosep.compensation.limits import Finding, Stated
from metrosep.core.public import shortened

Unknown = Literal["offset", "offsets", "line"]

DIRECTION_NAMES = {1: "forward", -1: "reverse"}
_UNKNOWN = {
    "offset": "one constant",
    "offsets": "one constant for each direction",
    "line": "one constant and the line (alignment)",
}


@dataclass(frozen=True, slots=True)
class DirectionResidual:
    """Error of one direction before and after the table.

    Parameters
    ----------
    direction : int
        +1 forward, -1 reverse.
    n_runs : int
        Runs that were compared; 1 for a curve.
    before_pv, after_pv, wrong_sign_pv : float, m
        P-V of the centre of the runs (median from three on) without, with, and with the negated
        correction. Nothing but the unknown of the measurement is taken off.
    before_rms, after_rms, wrong_sign_rms : float, m
        RMS of the mean run, the same way.
    run_before_rms, run_after_rms : float, m
        Mean RMS of the single runs, with all that does not repeat.
    u_after_rms, u_before_rms, u_after_pv, u_before_pv : float or None, m
        Standard uncertainties from the scatter of the runs, to first order; None for one run.
        Of an estimate without runs, of the RMS after: the RMS of its own standard uncertainty.
        Of a P-V: scatter of the runs between the two places where the mean is largest and
        smallest; that noise makes every P-V too large is not in it.
    """

    direction: int
    n_runs: int
    before_pv: float
    after_pv: float
    wrong_sign_pv: float
    before_rms: float
    after_rms: float
    wrong_sign_rms: float
    run_before_rms: float
    run_after_rms: float
    u_after_rms: float | None
    u_before_rms: float | None = None
    u_after_pv: float | None = None
    u_before_pv: float | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Verification(Judged):
    """Result of a dry-run.

    Parameters
    ----------
    residuals : tuple of DirectionResidual
        One for each direction.
    unknown : {"offset", "offsets", "line"}
        What the measurement cannot know and was taken off it: one constant, one for each direction,
        or a constant and the line.
    span : tuple of (float, float), m
        Positions that were compared.
    judgement : Judgement
        Improvement, gain, rest and P-V over all directions.
    reasons : tuple of Reason
        Why it is not accepted; empty if it is.
    findings : tuple of Finding
        Warnings.
    n_runs : int
        Runs, or pairs of directions; 0 where the error is stated.
    left_out : int
        Tables that were made without some of the runs; 0 where the runs did not make it.
    is_reversed : bool
        Whether the readings show that the sign is wrong: the negated bytes would be accepted, with
        at most half of the RMS left.
    diagnosis : str
        What is probably wrong with a table that is refused or pointless; it never changes the grade.
    lost_motion : LostMotion or None
        Offset between the directions before and after; None where it was not measured.
    unproven : tuple of int
        Directions with a column of their own that no run went through.
    units : AxisUnits
        Of texts and keys.
    """

    residuals: tuple[DirectionResidual, ...]
    unknown: Unknown
    span: tuple[float, float]
    judgement: Judgement
    reasons: tuple[Reason, ...] = ()
    findings: tuple[Finding, ...] = ()
    n_runs: int = 0
    left_out: int = 0
    is_reversed: bool = False
    diagnosis: str = ""
    lost_motion: LostMotion | None = None
    unproven: tuple[int, ...] = ()
    units: AxisUnits = LENGTHS

    def __repr__(self) -> str:
        j, amount = self.judgement, self.units.amount
        rms = (j.energy, max(j.energy - j.improvement.value, 0.0))
        before, after = (amount(math.sqrt(v)) for v in rms)
        on = f"{self.n_runs} runs" if self.n_runs else "the stated error"
        return shortened(
            f"Verification({self.grade}, RMS that repeats {before} -> {after}, gain {j.gain:.4g}, {on})"
        )

    @property
    def u_gain(self) -> float:
        """Standard uncertainty of `gain`."""
        return self.judgement.u_gain

    @property
    def improvement(self) -> float:
        """Mean square of the error without the table minus that with it, m^2."""
        return self.judgement.improvement.value

    @property
    def u_improvement(self) -> float:
        """Standard uncertainty of `improvement`, m^2."""
        return self.judgement.improvement.u

    @property
    def before_pv(self) -> float:
        """Largest P-V before, m."""
        return max(r.before_pv for r in self.residuals)

    @property
    def after_pv(self) -> float:
        """Largest P-V after, m."""
        return max(r.after_pv for r in self.residuals)

    @property
    def wrong_sign_pv(self) -> float:
        """Largest P-V with the sign reversed, m."""
        return max(r.wrong_sign_pv for r in self.residuals)

    @property
    def before_rms(self) -> float:
        """Largest RMS before, m."""
        return max(r.before_rms for r in self.residuals)

    @property
    def after_rms(self) -> float:
        """Largest RMS after, m."""
        return max(r.after_rms for r in self.residuals)

    @property
    def _known_to(self) -> float | None:
        """Standard uncertainty (RMS) of an error that was estimated, where no run is judged, m."""
        stated = [r.u_after_rms for r in self.residuals if r.u_after_rms is not None]
        return max(stated) if stated and self.n_runs == 0 else None

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person should read: what was judged on what, the numbers, the grade and why."""
        judged = (
            "judged against the stated error"
            if self.n_runs == 0
            else f"judged on {self.n_runs} run{'s' if self.n_runs > 1 else ''}"
        )
        if self.left_out == self.n_runs > 0:
            judged += ", each omitted once"
        elif self.left_out:
            judged += f", omitted in {self.left_out} groups"
        low, high = (format_span(self.units.looked_up, v, digits=6) for v in self.span)
        return (
            f"{judged}, {low.partition(' ')[0]} ... {high}; off the readings: {_UNKNOWN[self.unknown]}",
            numbers_text(self.judgement, self.units, known_to=self._known_to),
            self._graded_text(),
        )

    def to_dict(self) -> dict[str, Any]:
        found = {
            **self._verdict(),
            "sentences": list(self.sentences),
            "unknown": self.unknown,
            "unknown_text": _UNKNOWN[self.unknown],
            "n_runs": self.n_runs,
            "left_out": self.left_out,
            **judgement_dict(self.judgement),
            "after_pv_without_chance_slope_m": self.judgement.pv_after,
            "diagnosis": self.diagnosis,
            "span_m": list(self.span),
            "definition": (
                "error as the controller would apply the table (linear between entries, constant "
                f"outside); off the measurement: {_UNKNOWN[self.unknown]}; nothing off the table, no "
                "filter"
            ),
            "residuals": [
                {
                    "direction": DIRECTION_NAMES[r.direction],
                    "n_runs": r.n_runs,
                    **{f"{k}_m": v for k, v in asdict(r).items() if k.endswith(("_pv", "_rms"))},
                }
                for r in self.residuals
            ],
            "lost_motion": None if self.lost_motion is None else self.lost_motion.to_dict(),
            "not_verified": [DIRECTION_NAMES[d] for d in self.unproven],
        }
        named: dict[str, Any] = self.units.named(found)
        return named

    def _refusal(self, grade: str, left: list[Reason]) -> str:
        mine = [r for r in left if r.grade == grade]
        text = "; ".join(r.text for r in mine)
        worse = grade == "refused" and mine[0].check == "dry-run"
        hint = f"; {self.diagnosis}" if self.diagnosis and (worse or grade == "pointless") else ""
        checks = [r.check for r in left if r.check != "dry-run"]
        waive = f" (to write it all the same, say waive={', '.join(dict.fromkeys(checks))!r})"
        can = bool(checks) and all(r.check != "dry-run" for r in left)
        how = "the dry-run does not shrink the error: " if worse else ""
        return f"{grade}: {how}{text}{hint}; nothing was written{waive if can else ''}"


def numbers_text(
    j: Judgement, units: AxisUnits = LENGTHS, *, known_to: float | None = None
) -> str:
    """Return RMS and P-V before and after, and the gain, in one line.

    No reading judges the table of an estimate: what stays is what its error is known to.
    """
    after = math.sqrt(max(j.energy - j.improvement.value, 0.0))
    u = f" +- {j.u_gain:.2g}" if 0.0 < j.u_gain < math.inf else ""
    if known_to is not None:
        return (
            f"RMS {units.amount(math.sqrt(j.energy))} -> {units.amount(math.hypot(after, known_to))} "
            f"(predicted: the error is known to u = {units.amount(known_to)} RMS; no reading shows it), "
            f"P-V {units.amount(j.pv_before)}, gain {j.gain:.4g}{u}"
        )
    return (
        f"RMS that repeats {units.amount(math.sqrt(j.energy))} -> {units.amount(after)}, P-V "
        f"{units.amount(j.pv_before)} -> {units.amount(j.pv_after_plain)} (noise alone "
        f"{units.amount(j.pv_noise)}), gain {j.gain:.4g}{u}"
    )


def judgement_dict(j: Judgement) -> dict[str, Any]:
    """Return the numbers of a judgement as plain values."""
    return {
        "improvement_m2": j.improvement.value,
        "u_improvement_m2": j.improvement.u,
        "gain": j.gain,
        "u_gain": _finite(j.u_gain),
        "rest": _finite(j.rest),
        "repeats_m2": j.energy,
        "before_pv_m": j.pv_before,
        "after_pv_m": j.pv_after_plain,
        "noise_pv_m": j.pv_noise,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


# ---- lost motion: whether the step of a table at a reversal has the right sign ------------------
# Pitch hides it: a reverse column of the wrong sign can leave the RMS of both directions together
# smaller than it was. The offset between the directions is therefore judged on its own.


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

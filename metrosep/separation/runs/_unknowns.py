"""Private to separation: unknowns of the joint model that are not linear, solved by Gauss-Newton.

The frequency of a line, the growth of the error with the feedrate, the sensitivity of
a probe and the position of a run: each gives a column, its derivative over the runs, and takes the
step that is solved for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError

if TYPE_CHECKING:
    from metrosep.separation.runs.posterior import Model
    from metrosep.separation.runs.system import System


@dataclass(slots=True)
class Unknown:
    """One number that the model depends on in a curved way."""

    prior_sd: float  # scale of its column, which has a prior of unit variance
    largest_step: float  # the model counts as linear over such a change
    done: float  # A smaller change means that it has converged
    sd: float = float("nan")  # standard uncertainty after the last solution

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the derivative of the readings of one run."""
        raise NotImplementedError

    def shift(self, system: System, step: float) -> None:
        """Change the number in the system."""
        raise NotImplementedError


@dataclass(slots=True)
class Frequency(Unknown):
    """Frequency of a line, Hz."""

    line: int = 0  # which line

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the change of the line with its frequency; see `Unknown`."""
        assert model.post is not None  # noqa: S101  (after a solution)
        return system.terms.line_change(index, self.line, model.post.theta[system.extra])

    def shift(self, system: System, step: float) -> None:
        """Add to the frequency; see `Unknown`."""
        system.terms.frequencies[self.line] += step


@dataclass(slots=True, eq=False)
class Gain(Unknown):
    """Factor on the error in some runs: ``1 + value * lever`` in each."""

    # shape (n_runs,): relative speed for growth with the feedrate; 1 in the runs of a probe
    lever: FloatArray = field(default_factory=lambda: np.empty(0))
    with_slope: bool = False  # whether the alignment slope is multiplied too, as a probe does
    name: str = ""  # of the probe, or "following"
    value: float = 0.0  # the factor's excess

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the error in the runs with a lever; see `Unknown`."""
        if self.lever[index] == 0.0:
            return np.zeros(system.runs[index].x.size)
        out = system.shape(index, model, with_slope=self.with_slope) / self._own(index)
        return np.asarray(self.lever[index] * out)

    def _own(self, index: int) -> float:
        return 1.0 + self.value * float(self.lever[index])

    def shift(self, system: System, step: float) -> None:
        """Add to the factor; see `Unknown`."""
        before = 1.0 + self.value * self.lever
        self.value += step
        change = (1.0 + self.value * self.lever) / before
        system.gain = system.gain * change
        if self.with_slope:
            system.slope_gain = system.slope_gain * change


@dataclass(slots=True, eq=False)
class Shift(Unknown):
    """Position offset in m: run i shows the error of ``x - d_i``, with ``d = value * lever``."""

    lever: FloatArray = field(default_factory=lambda: np.empty(0))  # shape (n_runs,)
    value: float = 0.0  # m

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return minus the slope of the error in the runs with a lever; see `Unknown`."""
        assert model.post is not None  # noqa: S101  (after a solution)
        # d/dx (a cos w x + b sin w x) = w b cos w x - w a sin w x; a line has no wave of its own
        k, w = system.extension.n, system.extension.wavenumbers
        a, b = model.post.theta[1 : 1 + k], model.post.theta[1 + k : 1 + 2 * k]
        theta = np.zeros(system.size)
        theta[1 : 1 + 2 * k] = np.concatenate([w * b, -w * a])
        return np.asarray(-self.lever[index] * system.curve(index, theta, model.sensor))

    def shift(self, system: System, step: float) -> None:
        """Move the runs; see `Unknown`."""
        self.value += step
        system.runs = [
            replace(run, x=run.x - step * float(d)) if d else run
            for run, d in zip(system.runs, self.lever, strict=True)
        ]
        system._bases.clear()  # noqa: SLF001  (they are those of the old places)


_SHIFT_PRIOR, _SHIFT_STEP, _SHIFT_DONE = 3e-3, 0.3e-3, 1e-6
"""m; as far as the checks of the runs look for a displaced one."""


def shifts(names: Sequence[str], reference: str) -> list[Unknown]:
    """Return the unknowns of the position offsets of runs: of all beside a reference, or of sum zero."""
    n = len(names)
    if reference:
        levers = np.delete(np.eye(n), names.index(reference), axis=0)
    else:  # an orthonormal basis of what has the sum zero
        levers = np.linalg.qr(np.column_stack([np.ones(n), np.eye(n)[:, 1:]]))[0][:, 1:].T
    return [Shift(_SHIFT_PRIOR, _SHIFT_STEP, _SHIFT_DONE, lever=lever) for lever in levers]


def check_reference(names: Sequence[str], reference: str, way: str) -> None:
    """Refuse position offsets that these runs cannot show."""
    if len(names) < 2:
        raise DataError(
            f"position offsets compare runs, and there is {len(names)} {way} run; measure more"
        )
    n = list(names).count(reference)
    if reference and n != 1:
        raise DataError(
            f"position_reference={reference!r} names {'no' if n == 0 else n} {way} run"
            f"{'s' if n > 1 else ''}; the runs are {', '.join(names)}"
            + ("" if n else " (of two directions, leave the reference out: the sum is then zero)")
        )


def fitted_positions(
    unknowns: Sequence[Unknown], covariance: FloatArray, n_runs: int
) -> tuple[FloatArray, FloatArray]:
    """Return position offset and standard uncertainty of each run, m, from those of the unknowns."""
    own = [i for i, u in enumerate(unknowns) if isinstance(u, Shift)]
    first = covariance.shape[0] - len(unknowns)
    found = [u for u in unknowns if isinstance(u, Shift)]
    levers = np.array([u.lever for u in found]).reshape(-1, n_runs)
    at = first + np.array(own, dtype=int)
    spread = levers.T @ covariance[np.ix_(at, at)] @ levers
    value = np.array([u.value for u in found]) @ levers
    return value, np.sqrt(np.maximum(np.diag(spread), 0.0))


PositionOffsets = tuple[FloatArray, FloatArray] | None
"""Position offset and standard uncertainty of each run, m; None where they are not fitted."""

_UNPLACED = 1e-3
"""m; position offsets of a greater standard uncertainty are not determined."""

_MM = 1e-3


def position_columns(offsets: PositionOffsets) -> dict[str, list[float]]:
    """Return the columns of the table of the runs."""
    if offsets is None:
        return {}
    d, u = ((v / _MM).tolist() for v in offsets)
    return {"position_offset_mm": d, "u_position_offset_mm": u}


def explain_positions(
    names: Sequence[str],
    offsets: PositionOffsets,
    reference: str,
    *,
    delay: bool,
    nothing: bool,
) -> list[str]:
    """Say how far the runs lie from their places; `delay` would show in them, `nothing` was found."""
    if offsets is None:
        return []
    d, u = offsets
    i = int(u.argmax())
    if nothing or float(u[i]) > _UNPLACED:
        why = (
            "no error is above the noise that could show them"
            if nothing
            else f"u of run {names[i]} is {u[i] / _MM:.2g} mm, since the error is small or without short waves"
        )
        sentence = (
            f"position offsets are not determined by these runs: {why}; leave position_offsets out"
        )
        return [sentence]
    i = int(np.abs(d).argmax())
    zero = f"run {reference} is taken to lie at its place" if reference else "their sum is zero"
    sentence = (
        f"position offsets of the runs were fitted, {zero}: the largest is {d[i] / _MM:+.3g} mm "
        f"(u {u[i] / _MM:.2g} mm) of run {names[i]}"
    )
    if delay:
        sentence += "; a delay of the reading is part of them and was not looked for"
    return [sentence]

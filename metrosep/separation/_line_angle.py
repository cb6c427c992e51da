"""Whether an angle sensor on the carriage tells of the pitch that the probes see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotSeparableError, UnitError
from metrosep.separation._line_found import solve
from metrosep.separation._line_probes import Row
from metrosep.separation._line_problem import Sensor, problem_of

OPPOSITE = -0.8
"""A correlation below this between the pitch sensor and the pitch of the probes is a sign error."""

ALIKE = 0.8
"""Above this correlation the ratio of both is that of their units."""

SIGNIFICANT = 4.0
"""The pitch must exceed its uncertainty by this factor before it is judged."""

RATIO = (0.3, 3.0)
"""Outside this ratio of the sensor to the probes a unit or a distance is wrong."""


def check_angle(what: str, row: Row, x: FloatArray, readings: FloatArray, sensor: Sensor) -> None:
    """Refuse a sensor that runs opposite to the pitch of the probes, or in another unit."""
    seen = _pitch_of(row, x, readings)
    both = ~np.isnan(seen) & ~np.isnan(sensor.values)
    if both.sum() < 5:
        return
    line = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, x.size)[both], 1)
    probes, angle = (
        v[both] - line @ np.linalg.lstsq(line, v[both], rcond=None)[0]
        for v in (seen, sensor.values)
    )
    sizes = float(np.linalg.norm(probes)), float(np.linalg.norm(angle))
    if not (sizes[0] > 0.0 and float(np.std(angle)) > SIGNIFICANT * sensor.u):
        return
    alike, ratio = float(probes @ angle) / (sizes[0] * sizes[1]), sizes[1] / sizes[0]
    if ratio > RATIO[1] or (row.pitch and ratio < RATIO[0] and alike > ALIKE):
        raise UnitError(
            f"{what}: the pitch readings vary {ratio:.3g} times as much as the probes see it; give "
            "pitch in rad, readings and distances in m, and the sensor on the same carriage"
        )
    if row.pitch and alike < OPPOSITE:
        raise NotSeparableError(
            f"{what}: the pitch readings run opposite to the pitch that the probes see "
            f"(correlation {alike:.2f}): positive is where the leading probe (larger x) reads "
            "more; pass -pitch"
        )


def _pitch_of(row: Row, x: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the pitch that the probes see; of two probes the slope between them, form and all."""
    if not row.pitch:
        count = (~np.isnan(readings[1] - readings[0])).sum(axis=0)
        total = np.nansum(readings[1] - readings[0], axis=0)
        distance = row.offsets[1] - row.offsets[0]
        return np.where(count > 0, total / np.maximum(count, 1) / distance, np.nan)
    free = replace(row, zero_known=False)
    problem = problem_of(free, x, readings, None, 0.0)
    return solve(problem, method="least_squares", smoothing=0.0, degree=2).pitch[0]

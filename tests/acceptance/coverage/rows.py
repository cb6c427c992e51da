"""The rows that the joint estimator is judged by: one machine each, and what it must show there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from acceptance.coverage.machine import BASE_WAVES, COLUMN, Machine, Mode

__all__ = ["FIRST_SEED", "ROWS", "Row"]

FIRST_SEED = 410_000
"""Of the tables; the specification used 2000 on and 91000 to 97000."""

LEADS_HZ = Mode(12.0, 0.03, 100.0)
"""At 120 mm/s it has the wavelength of the lead."""

GRID_MM = 1.4 * 56.0
"""Period of the basis of the specification: lead GRID_MM / k lies on the grid for a whole k."""


@dataclass(frozen=True)
class Row:
    """A machine, where it is judged, and which limits of the acceptance table apply."""

    machine: Machine
    judged_mm: float = 45.0
    lag_s: float = 0.0  # delay and time constant together: what is seen at low frequency
    no_geometry: bool = False  # cover up to 1, sd over error is stated, not judged
    ratio_told_only: bool = False  # step, slip
    least_cover: float = 0.92
    least_third: float = 0.88
    greatest_sd_nm: float = 0.0  # RMS sd in every set; 0: not asked
    ends_only: bool = False  # lead moved within one cell: cover of the ends never below 0.90
    clean: bool = True  # no lag, no slip: any such message is false

    @property
    def slip(self):
        return bool(self.machine.slip)


BASE = Machine()


def _base(**changes):
    return Row(replace(BASE, **changes))


def _lead(wavelength, *, more=(), **changes):
    return Row(
        replace(
            BASE,
            waves=((wavelength, 300.0), *BASE_WAVES[2:5], *more),
            modes=(COLUMN, LEADS_HZ),
            **changes,
        )
    )


def _lag(delay_ms=0.0, low_pass_hz=0.0, **changes):
    machine = replace(BASE, delay_s=delay_ms * 1e-3, low_pass_hz=low_pass_hz, **changes)
    total = delay_ms * 1e-3 + (
        1.0 / (2.0 * 3.141592653589793 * low_pass_hz) if low_pass_hz else 0.0
    )
    return Row(machine, lag_s=total, clean=False, least_cover=0.88 if total < 0.5e-3 else 0.92)


def _white(nm):
    return Row(replace(BASE, modes=(), white_nm=nm), greatest_sd_nm=0.15 if nm == 1.0 else 0.0)


def _rough(p, rms, **changes):
    return _base(waves=(), slope_of_psd=p, rough_rms_nm=rms, **changes)


def _slip(mm, **changes):
    machine = replace(BASE, slip=((mm, 120.0),), **changes)
    return Row(machine, ratio_told_only=True, clean=False)


def _travel(mm):
    return Row(replace(BASE, travel_mm=mm), judged_mm=mm - 11.0)


ROWS: dict[str, Row] = {
    "base": _base(),
    "lead on grid": _lead(GRID_MM / 8.0),
    "lead off grid": _lead(70.0 / 7.03),
    "turbulence": _base(modes=(COLUMN, Mode(3.0, 0.5, 100.0))),
    "turbulence 2": _base(modes=(COLUMN, Mode(2.0, 0.6, 120.0), Mode(55.0, 0.05, 60.0))),
    "slow noise, 4 runs": _base(
        modes=(COLUMN, Mode(3.0, 0.5, 100.0)), feeds_mm_s=(80.0, 160.0), repeats=2
    ),
    "lag .2 ms": _lag(0.2),
    "lag .4 ms": _lag(0.4),
    "lag .6 ms": _lag(0.6),
    "lag 1 ms": _lag(1.0),
    "lag 2 ms": _lag(2.0),
    "LP 50 Hz": _lag(low_pass_hz=50.0),
    "LP 80 Hz": _lag(low_pass_hz=80.0),
    "LP 150 Hz": _lag(low_pass_hz=150.0),
    "LP 50 Hz, vibration behind it": _lag(low_pass_hz=50.0, filters_vibration=False),
    "1/f2": _rough(2.0, 150.0),
    "1/f3": _rough(3.0, 150.0),
    "mirror 071": _base(waves=(), mirror="071", mirror_rms_nm=150.0),
    "mirror 010": _base(waves=(), mirror="010", mirror_rms_nm=150.0),
    "mirror 001": _base(waves=(), mirror="001", mirror_rms_nm=150.0),
    "none": Row(replace(BASE, waves=()), no_geometry=True),
    "1 nm": _white(1.0),
    "5 nm": _white(5.0),
    "20 nm": _white(20.0),
    "200 nm": _white(200.0),
    "slip 3 mm": _slip(3.0),
    "slip 5.2 mm": _slip(5.2),
    "slip 8 mm": _slip(8.0),
    "4 runs 2x2": _base(feeds_mm_s=(80.0, 160.0), repeats=2),
    "6 runs 2x3": _base(feeds_mm_s=(80.0, 160.0)),
    "8 runs 4x2": _base(feeds_mm_s=(60.0, 80.0, 120.0, 160.0), repeats=2),
    "12 runs 4x3": _base(feeds_mm_s=(60.0, 80.0, 120.0, 160.0)),
    "two leads": _lead(10.3, more=((7.7, 120.0),)),
    "1/f2 + lead": _rough(2.0, 150.0, modes=(COLUMN, LEADS_HZ)),
    "unequal 12 mm": _base(unequal_mm=12.0),
    "both directions": _base(both_ways=True),
    "L 38": _travel(38.0),
    "L 54": _travel(54.0),
    "L 55.3": _travel(55.3),
    "L 57.3": _travel(57.3),
    "L 58": _travel(58.0),
    "L 71": _travel(71.0),
    "500 Hz": _base(rate_hz=500.0),
    "2 kHz": _base(rate_hz=2000.0),
    "step": replace(_base(step_nm=150.0), ratio_told_only=True),
    "bump": _base(bump_nm=150.0),
    "wave 1.6 mm": _base(waves=(*BASE_WAVES, (1.6, 80.0))),
    "gaps": _base(gap_samples=40),
    "drift": _base(drift_nm_s=100.0),
    "jitter 30 %": _base(clock_jitter=0.3),
    # 0.005 Hz wide: of constant amplitude in a run, which no option declares
    "tone of 11 Hz": _base(modes=(COLUMN, Mode(11.0, 0.0005, 100.0))),
    "runs displaced .1 mm": _base(displaced_mm=0.1),
}
ROWS["1/f2 + lead"] = replace(
    ROWS["1/f2 + lead"], machine=replace(ROWS["1/f2 + lead"].machine, waves=((9.6, 200.0),))
)
for _j in range(12):  # one cell of the grid of the specification, k from 7.5
    _k = 7.5 + _j / 12.0
    ROWS[f"lead cell {_j}"] = replace(_lead(GRID_MM / _k), ends_only=True)
# A real wave as large as what slips and of its length.
ROWS["slip on a wave of 8 mm"] = replace(
    ROWS["slip 8 mm"],
    machine=replace(ROWS["slip 8 mm"].machine, waves=(*BASE_WAVES, (8.0, 120.0))),
)
# At the end: the seed of a row of a printed table is its number.
ROWS["dropouts 15 %"] = _base(dropouts=0.15)
ROWS["dropouts 30 %, turbulence"] = _base(dropouts=0.3, modes=ROWS["turbulence"].machine.modes)
ROWS["dropouts 5 %, 8 kHz"] = _base(dropouts=0.05, rate_hz=8000.0)
# What slips is no size of the machine, but another in each run.
for _name, _scatter in (("slip of sizes .3", 0.3), ("slip of normal sizes", math.inf)):
    ROWS[_name] = _slip(8.0, slip_scatter=_scatter)
    ROWS[f"{_name} on a wave"] = replace(
        ROWS[_name], machine=replace(ROWS[_name].machine, waves=(*BASE_WAVES, (8.0, 120.0)))
    )
ROWS["10 kHz slip on a wave of 8 mm"] = replace(
    ROWS["slip on a wave of 8 mm"],
    machine=replace(ROWS["slip on a wave of 8 mm"].machine, rate_hz=10_000.0),
)
ROWS["10 kHz turbulence"] = _base(rate_hz=10_000.0, modes=ROWS["turbulence"].machine.modes)

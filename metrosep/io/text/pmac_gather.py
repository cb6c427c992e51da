"""PMAC gather data as text: plain columns of counts at a multiple of the servo period.

Nothing in the text names the columns, the period or what a count is: all are declared.
See ``data_formats/pmac-gather/SPEC.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core.errors import ReadError
from metrosep.core.recording import Recording
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import (
    Channels,
    column_names,
    interval,
    number_block,
    scales_of,
    text_lines,
)

__all__ = ["channels", "read", "sniff"]

FORMAT = "pmac-gather"
_COLUMN = "column"


def sniff(file: RawFile) -> Match:
    """Return NO: any columns of numbers look the same, so the format has to be named."""
    return Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the columns when none are declared."""
    lines = text_lines(file)
    rows = [(k, line) for k, line in enumerate(lines, start=1) if line.strip()]
    return tuple(column_names(file, None, number_block(file, rows).shape[1], _COLUMN))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
    servo_period: float | str | None = None,
    gather_period: Any = 1,
    names: Sequence[str] | None = None,
    scale: Any = None,
) -> Recording:
    """Return the columns of a gather."""
    refuse_options(file, "a gather of a PMAC", lateral_step=lateral_step)
    if isinstance(gather_period, bool) or not (
        isinstance(gather_period, (int, float, np.integer, np.floating))
        and gather_period >= 1
        and gather_period % 1 == 0
    ):
        raise ReadError(
            f"{file.path}: gather_period is {gather_period!r}; give the servo cycles per row, 1 or more"
        )
    if servo_period is None and gather_period != 1:
        refuse_options(file, "read with a sampling rate", gather_period=gather_period)
    period = interval(file, sampling_rate=sampling_rate, period=servo_period, name="servo_period")
    step = period * float(gather_period)
    lines = text_lines(file)
    body = number_block(file, [(k, line) for k, line in enumerate(lines, start=1) if line.strip()])
    columns = column_names(file, names, body.shape[1], _COLUMN)
    scales = scales_of(file, scale, columns)
    t = step * np.arange(len(body), dtype=np.float64)
    data = Channels(file)
    for name, column in zip(columns, body.T, strict=True):
        factor, label = scales[name]
        data.add(name, t, column * factor, label)
    cut = "the file does not end with a line end; its last row may be cut off"
    return data.recording(
        FORMAT,
        {"rows": len(body), "columns": body.shape[1]},
        channel=channel,
        unit=unit,
        warnings=(cut,) if lines[-1] else (),
        sampling_interval_s=step,
        count_scale={
            name: f"{factor!r} {label}".strip() for name, (factor, label) in scales.items()
        },
    )

"""PMAC gather data as text: plain columns of counts at a multiple of the servo period.

Nothing in the text names the columns, the period or what a count is: all are declared.
See ``data_formats/pmac-gather/SPEC.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core.numbers import count
from metrosep.core.recording import Recording
from metrosep.io.declared import sniffer
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import (
    Channels,
    column_names,
    interval,
    number_block,
    numbered_rows,
    scales_of,
    text_lines,
)

__all__ = ["channels", "read", "sniff"]

FORMAT = "pmac-gather"
_COLUMN = "column"


sniff = sniffer(FORMAT)
"""NO: any columns of numbers look the same, so the format has to be named."""


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the columns when none are declared."""
    lines = text_lines(file)
    n = number_block(file, numbered_rows(lines)).shape[1]
    return tuple(column_names(file, None, n, _COLUMN))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
    servo_period: float | str | None = None,
    gather_period: int = 1,
    names: Sequence[str] | None = None,
    scale: Any = None,
) -> Recording:
    """Return the columns of a gather."""
    refuse_options(file, "a gather of a PMAC", lateral_step=lateral_step)
    cycles = count(gather_period, "gather_period")
    if servo_period is None and cycles != 1:
        refuse_options(file, "read with a sampling rate", gather_period=gather_period)
    period = interval(file, sampling_rate=sampling_rate, period=servo_period, name="servo_period")
    step = period * cycles
    lines = text_lines(file)
    body = number_block(file, numbered_rows(lines))
    columns = column_names(file, names, body.shape[1], _COLUMN)
    scales = scales_of(file, scale, columns)
    t = step * np.arange(len(body), dtype=np.float64)
    data = Channels(file)
    for name, column in zip(columns, body.T, strict=True):
        factor, label = scales[name]
        data.add(name, t, column * factor, label)
    return data.recording(
        FORMAT,
        {"rows": len(body), "columns": body.shape[1]},
        channel=channel,
        unit=unit,
        warnings=tuple(file.cut_text()),
        sampling_interval_s=step,
        count_scale={
            name: f"{factor!r} {label}".strip() for name, (factor, label) in scales.items()
        },
    )

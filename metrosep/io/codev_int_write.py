"""Bytes of a Code V ``.int`` grid from a surface; the same surface gives the same bytes.

The format holds 16-bit counts: heights are rounded to steps of P-V / 65534. The middle between
the largest and smallest height becomes 0, since a constant would cost resolution; comments state
it, and the title states the step. Written top row first; lines have at most 80 characters.
"""

from __future__ import annotations

import numpy as np

from metrosep.core.errors import WriteError
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

__all__ = ["int_bytes", "quantisation_step"]

_LARGEST = 32767
_MISSING = -32768
_PER_LINE = 10
_TITLE = 48
"""Characters of the caller's title; the step follows within the 80 of a record."""

_FLAT_STEP = 1e-15
"""Step in m for a surface without relief: every count is 0 whatever the step."""


def quantisation_step(surface: Surface) -> float:
    """Return the step to which `int_bytes` rounds heights."""
    low, high = _range(surface)
    return (high - low) / (2 * _LARGEST) if high > low else _FLAT_STEP


def int_bytes(
    surface: Surface,
    *,
    wavelength: float = 632.8e-9,
    kind: str = "SUR",
    title: str = "metrosep",
) -> bytes:
    """Return a surface as the content of a Code V ``.int`` file with a grid.

    Parameters
    ----------
    surface : Surface
        Heights; the format holds no lateral steps, they are stated in a comment only.
    wavelength : float, optional
        In m, 10 nm to 1 mm; the unit in which the file states its scale.
    kind : {"SUR", "WFR"}, optional
        Whether the heights are those of a surface or of a wavefront; they are not converted.
    title : str, optional
        First line, at most 48 characters of printable ASCII; the quantisation step is added.

    Returns
    -------
    bytes
        ASCII text.

    Raises
    ------
    WriteError
        If nothing was measured, or an argument does not fit the format.
    """
    low, high = _range(surface)
    if kind not in ("SUR", "WFR"):
        raise WriteError(f"Code V kind {kind!r} is not written; use 'SUR' or 'WFR'")
    if not 1e-8 <= wavelength <= 1e-3:  # also catches NaN
        raise WriteError(f"wavelength is {wavelength} m; Code V needs one from 10 nm to 1 mm")
    clean = title.strip()
    if not (clean.isascii() and clean.isprintable() and len(clean) <= _TITLE) or clean[:1] == "!":
        raise WriteError(
            f"title {title[:60]!r} does not fit; use up to {_TITLE} ASCII characters, no ! at the start"
        )
    step = quantisation_step(surface)
    micrometres = f"{wavelength * 1e6:.12g}"
    counts_per_wave = f"{float(micrometres) * 1e-6 / step:.15g}"
    middle = low + (high - low) / 2
    unit = float(micrometres) * 1e-6 / float(counts_per_wave)
    raw = np.clip(np.rint((surface.z - middle) / unit), -_LARGEST, _LARGEST)
    counts = np.where(np.isnan(raw), _MISSING, raw).astype(np.int64)[::-1]
    rows, columns = surface.shape
    lines = [
        "! written by metrosep; top row first, heights point out of the material",
        f"! height of count 0: {middle!r} m",
        f"! lateral steps dx = {surface.dx!r} m, dy = {surface.dy!r} m",
        f"{clean} (step {format_length(step, digits=6)})",
        f"GRD {columns} {rows} {kind} WVL {micrometres} SSZ {counts_per_wave} NDA {_MISSING}",
    ]
    flat = [f"{v:7d}" for v in counts.ravel().tolist()]
    lines += ["".join(flat[i : i + _PER_LINE]) for i in range(0, len(flat), _PER_LINE)]
    return ("\n".join(lines) + "\n").encode("ascii")


def _range(surface: Surface) -> tuple[float, float]:
    if np.isnan(surface.z).all():
        raise WriteError("nothing was measured, so there is nothing to write as Code V INT")
    return float(np.nanmin(surface.z)), float(np.nanmax(surface.z))

"""Private to separation: what repeatability alone says, beside the joint estimate.

The joint method tests a wavelength against its model of the noise; the table of evidence asks only
whether the runs of different feedrates agree. Where the feedrates move a vibration by less than
the resolution, the second question has no answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError, NotSeparableError, TooFewSamplesError
from metrosep.core.runset import Run, RunSet
from metrosep.separation.evidence import evidence_table
from metrosep.separation.spectra import feed_spectra

__all__ = ["contradictions", "evidence_of"]


_AGREES, _DISAGREES = 1e-4, 0.5
"""p-values between which estimate and evidence may differ by chance."""

_STRONG = 8.0
"""A wave of the estimate is held against the evidence beyond so many of its uncertainties."""

_TIMES = 4.0
"""The evidence is held against the estimate where its wave is so many times as strong."""

_POINTS_OF_A_WAVE = 16
"""Of the estimate, where its spectrum is taken as that of the runs."""

_LEAST_RUNS = 2
"""Runs of each feedrate: fewer leave hardly any degrees of freedom."""


def evidence_of(
    runs: RunSet, probes: Sequence[str], *, start: float, stop: float, rate: float
) -> tuple[dict[str, list[Any]], Mapping[str, Any], tuple[str, ...]]:
    """Return the columns of the evidence and what was done, or why there are none."""
    used = RunSet([r for r, name in zip(runs, probes, strict=True) if name == probes[0]])
    groups = used.by_feed()
    if len(groups) < 2 or any(r.feed is None for r in used):
        return {}, {"not_taken": "fewer than 2 feedrates"}, ()
    if min(len(members) for _, members in groups) < _LEAST_RUNS:
        return {}, {"not_taken": f"fewer than {_LEAST_RUNS} runs at a feedrate"}, ()
    try:
        table = evidence_table(used, start=start, length=stop - start, false_discovery_rate=rate)
    except (InvalidSamplesError, TooFewSamplesError, NotSeparableError) as exc:
        return {}, {"not_taken": str(exc)}, ()
    return dict(table.columns), table.audit, table.unsteady


def contradictions(
    spectrum: Mapping[str, list[Any]],
    evidence: Mapping[str, list[Any]],
    curve: Callable[[FloatArray], FloatArray],
    *,
    span: tuple[float, float],
    noise_nm: float,
) -> list[str]:
    """Name the wave in which estimate and evidence of one result contradict each other most.

    The estimate knows the noise, the evidence only asks whether the runs agree; where both are
    right they find the same strong waves. Amplitudes are compared over neighbouring wavelengths,
    since the two tables have different ones; and with the estimate under the window of the
    evidence, where a strong wave off the grid of the travel leaks into its neighbours.
    """
    if not evidence:
        return []
    own_wave, own = (np.array(spectrum[k], dtype=float) for k in ("wavelength_mm", "amplitude_nm"))
    sd = np.array(spectrum["sd_nm"], dtype=float)
    wave, found = (np.array(evidence[k], dtype=float) for k in ("wavelength_mm", "amplitude_nm"))
    p = np.array(evidence["p"], dtype=float)
    sentences = []
    alone = np.zeros(own.size)
    for k in np.flatnonzero(np.array(spectrum["selected"]) & (own > _STRONG * sd)):
        near = np.abs(wave[0] / wave - wave[0] / own_wave[k]) < 1.6
        # The greatest wave of its surroundings only: the flanks of a strong one are no waves.
        around = own[max(k - 3, 0) : k + 4]
        if own[k] >= around.max() and near.any() and not np.isnan(p[near]).any():
            alone[k] = own[k] if p[near].min() > _DISAGREES else 0.0
    if alone.any():
        top = int(np.argmax(alone))
        sentences.append(
            f"the estimate holds a wave of {own_wave[top]:.3g} mm, {own[top]:.3g} nm, but the runs do not "
            "agree on one there (evidence): it is not certain, and the uncertainty does not hold it; "
            "add runs at another feedrate"
        )
    left = np.zeros(found.size)
    x = np.linspace(*span, _POINTS_OF_A_WAVE * found.size + 1)
    own_spectra = feed_spectra(
        RunSet([Run(x, curve(x))]),
        origin=span[0],
        length=span[1] - span[0],
        n_harmonics=found.size,
        taper="tukey",
    )
    leaked = np.abs(own_spectra.coefficients[0]) / own_spectra.mean_weight * 1e9
    for k in np.flatnonzero(p < _AGREES):
        near = np.abs(wave[0] / own_wave - wave[0] / wave[k]) < 1.6
        around = found[max(k - 3, 0) : k + 4]
        held = max(own[near].max(initial=0.0), leaked[max(k - 1, 0) : k + 2].max())
        if found[k] >= around.max() and near.any() and found[k] > _TIMES * held:
            left[k] = found[k] if found[k] > noise_nm else 0.0
    if left.any():
        top = int(np.argmax(left))
        sentences.append(
            f"the runs repeat a wave of {wave[top]:.3g} mm, {found[top]:.3g} nm (evidence), that the estimate "
            "does not hold: ask for shorter wavelengths with shortest="
        )
    return sentences

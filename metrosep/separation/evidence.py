r"""Evidence, wavelength by wavelength, that an error repeats over runs of different feedrates.

With :math:`Z_r(k)` the complex amplitude of run r at exactly :math:`k / l_x`, R runs:

.. math:: \hat G^2 = \frac{|\sum Z|^2 - \sum |Z|^2}{R (R - 1)}, \quad
          \hat S = \overline{|Z|^2} - \hat G^2, \quad
          F = R |\bar Z|^2 / \hat S \sim F(2, 2 (R - 1))

the last without geometry. :math:`\hat S` equals the sample variance of Z, so :math:`\hat G^2` is
free of bias and may be negative. Only runs of different feedrates are evidence: at one feedrate a
vibration locked to the start repeats as well as geometry does.

Source: the project's separation notes, section 3; Benjamini and Hochberg 1995.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray, benjamini_hochberg
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.runset import RunSet
from metrosep.separation.design import evaluation_range
from metrosep.separation.spectra import feed_spectra, n_wavelengths

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["EvidenceTable", "evidence_columns", "evidence_table"]


_NM, _MM = 1e-9, 1e-3
_MAX_ROWS = 250
_BLIND = "not separable by repeatability"
_AROUND = 8
"""Wavelengths on each side whose scatter says what noise alone does."""

_UNSTEADY = 1e-3
"""Chance by which any wavelength is called unsteady."""

_NULL_SHARE = 0.05
"""Chance by which the coherence passes its null level."""


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceTable:
    """Evidence of repeatability at each wavelength.

    Parameters
    ----------
    columns : mapping of str to list
        ``wavelength_mm amplitude_nm g2_nm2 s_nm2 snr f p q coherence coherence_null wiener_gain
        selected reason``; NaN where the runs cannot tell.
    messages : tuple of str
        What the user should know.
    audit : mapping
        What was done.
    unsteady : tuple of str
        The messages about waves that sit at a place but differ from run to run.
    """

    columns: Mapping[str, list[Any]]
    messages: tuple[str, ...]
    audit: Mapping[str, Any]
    unsteady: tuple[str, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """Return the columns as a DataFrame.

        Returns
        -------
        DataFrame
            One row a wavelength, the longest first.
        """
        import pandas as pd

        return pd.DataFrame(dict(self.columns))


def evidence_table(
    runs: RunSet,
    *,
    length: float | None = None,
    start: float | None = None,
    shortest: float | None = None,
    bandwidth: float | None = None,
    false_discovery_rate: float = 0.05,
) -> EvidenceTable:
    """Return the evidence that each wavelength repeats over runs of different feedrates.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction at two or more feedrates.
    length, start : float, m, optional
        Range; the common travel if omitted.
    shortest : float, m, optional
        Shortest wavelength of the table; 2.5 samples of the coarsest run if omitted, at most 250
        rows.
    bandwidth : float, Hz, optional
        Of the vibrations; feeds whose frequencies v/wavelength differ by less cannot be told
        apart. The resolution of the shortest run if omitted; never less than it.
    false_discovery_rate : float, optional
        Of Benjamini and Hochberg.

    Returns
    -------
    EvidenceTable
        With ``to_frame()``.

    Raises
    ------
    DataError
        If an option is out of range, or the runs go both ways.
    NotSeparableError
        If there is only one feedrate.
    InvalidSamplesError, TooFewSamplesError
        If a run has a wide gap or too few samples in the range.

    Notes
    -----
    All statistics are over runs mixed from all feeds, as many of each feed (the first ones): with
    ten runs at one feed and one at another, a vibration locked to the start would pass. The F test
    takes the noise as equally strong in all runs; where a vibration sits on the wavelength at one
    feed only, it raises S and lowers the evidence, which errs on the safe side. Coherence is
    ``|<Z_i conj(Z_j)>|^2 / (<|Z_i|^2> <|Z_j|^2>)`` over pairs of different feeds, no run twice.
    Lines and means are removed run by run, so a wave as long as the range is attenuated. Samples
    that were not measured are left out of the sums.

    Examples
    --------
    >>> from metrosep.separation.simulate import machine_axis
    >>> table = evidence_table(machine_axis(seed=1).runs).to_frame()
    >>> bool(table["selected"].any())
    True
    """
    _check(runs, bandwidth, false_discovery_rate)
    n_given, runs = len(runs), _balanced(runs)
    first, last = evaluation_range(runs, start=start, length=length)
    l_x = last - first
    n = min(n_wavelengths(runs, l_x), _MAX_ROWS)
    if shortest is not None:
        if not (math.isfinite(shortest) and l_x / n * (1 - 1e-9) <= shortest <= l_x):
            raise DataError(
                f"shortest is {shortest} m; it must lie between {l_x / n:.4g} and {l_x:.4g} m"
            )
        n = int(l_x / shortest * (1.0 + 1e-9))
    with one_blas_thread():
        spectra = feed_spectra(
            runs, origin=first, length=l_x, n_harmonics=n, taper_fraction=0.1, taper="tukey"
        )
    z = np.concatenate(spectra.per_run) / spectra.mean_weight
    feed_of = np.repeat(np.arange(len(spectra.feeds)), [len(p) for p in spectra.per_run])
    resolution = max(runs.feeds) / l_x
    width = resolution if bandwidth is None else max(bandwidth, resolution)
    usable = (max(spectra.feeds) - min(spectra.feeds)) / spectra.wavelength > width
    columns: dict[str, list[Any]] = {"wavelength_mm": (spectra.wavelength / _MM).tolist()}
    columns |= evidence_columns(z, feed_of, usable, rate=false_discovery_rate)
    messages = _messages(columns, spectra.feeds, width)
    unsteady = _unsteady(z, feed_of, spectra.wavelength)
    messages += unsteady
    if len(runs) < n_given:
        messages.append(
            f"{n_given - len(runs)} of {n_given} runs were left out, so that every feedrate has "
            "as many: else the feedrate with most runs would decide"
        )
    audit = {
        "n_runs": len(runs),
        "n_runs_left_out": n_given - len(runs),
        "feeds_mm_per_min": [f * 6e4 for f in spectra.feeds],
        "start_mm": first / _MM,
        "length_mm": l_x / _MM,
        "taper": "tukey, 10 % at each end",
        "bandwidth_hz": width,
        "false_discovery_rate": false_discovery_rate,
    }
    return EvidenceTable(columns, tuple(messages), audit, tuple(unsteady))


def _check(runs: RunSet, bandwidth: float | None, rate: float) -> None:
    if not isinstance(runs, RunSet):
        raise DataError(f"evidence_table needs a RunSet, got {type(runs).__name__}")
    if len(runs.directions) > 1:
        raise DataError(
            "the runs go both ways; the error may depend on the direction: use "
            "runs.select(direction=1), then direction=-1"
        )
    if len(runs.feeds) < 2 or any(r.feed is None for r in runs):
        raise NotSeparableError(
            f"the evidence of repeatability needs every run to have a feed and >= 2 feedrates, got "
            f"{len(runs.feeds)}: within one feedrate a locked vibration repeats as geometry does; "
            "add runs at another feedrate"
        )
    if not 0.0 < rate < 1.0:
        raise DataError(f"false_discovery_rate must be in (0, 1), got {rate}; 5 % is 0.05")
    if bandwidth is not None and not (math.isfinite(bandwidth) and bandwidth >= 0.0):
        raise DataError(f"bandwidth must be finite and not negative, in Hz, got {bandwidth}")


def _balanced(runs: RunSet) -> RunSet:
    """Return as many runs of each feedrate, the first ones."""
    groups = [members for _, members in runs.by_feed()]
    n = min(len(g) for g in groups)
    return RunSet([r for g in groups for r in g[:n]], history=runs.history)


def evidence_columns(
    amplitudes: ComplexArray,
    feed_of: NDArray[np.int_],
    usable: NDArray[np.bool_],
    *,
    rate: float,
) -> dict[str, list[Any]]:
    """Return the statistics of complex amplitudes of runs."""
    r = amplitudes.shape[0]
    total = np.abs(amplitudes.sum(axis=0)) ** 2
    power = (np.abs(amplitudes) ** 2).sum(axis=0)
    g2 = (total - power) / (r * (r - 1))
    s = np.maximum(power / r - g2, 1e-300)
    f = total / r / s
    p = (1.0 + f / (r - 1)) ** -(r - 1.0)  # the F distribution of 2 and 2 (R - 1) in closed form
    coherence, null = _coherence(amplitudes, feed_of)
    snr_mean = np.maximum(r * g2 / s, 0.0)
    selected = np.zeros(p.size, dtype=bool)
    selected[usable] = benjamini_hochberg(p[usable], rate=rate) if usable.any() else False
    q = np.full(p.size, np.nan)
    q[usable] = _adjusted(p[usable])
    return {
        "amplitude_nm": (np.sqrt(total) / r / _NM).tolist(),
        "g2_nm2": (g2 / _NM**2).tolist(),
        "s_nm2": (s / _NM**2).tolist(),
        "snr": (g2 / s).tolist(),
        "f": np.where(usable, f, np.nan).tolist(),
        "p": np.where(usable, p, np.nan).tolist(),
        "q": q.tolist(),
        "coherence": np.where(usable, coherence, np.nan).tolist(),
        "coherence_null": [null] * p.size,
        "wiener_gain": np.where(usable, snr_mean / (1.0 + snr_mean), np.nan).tolist(),
        "selected": selected.tolist(),
        "reason": [_reason(bool(u), bool(c)) for u, c in zip(usable, selected, strict=True)],
    }


def _coherence(amplitudes: ComplexArray, feed_of: NDArray[np.int_]) -> tuple[FloatArray, float]:
    """Return coherence over pairs of runs, one of each of two feeds, and its 95 % null level.

    Runs are paired so that none is used twice: the pairs are then independent and the null level
    1 - 0.05^(1/(n - 1)) of n pairs is exact for Gaussian noise.
    """
    first, second = _pairs(feed_of)
    n = len(first)
    a, b = amplitudes[first], amplitudes[second]
    cross = np.abs((a * b.conj()).mean(axis=0)) ** 2
    own = (np.abs(a) ** 2).mean(axis=0) * (np.abs(b) ** 2).mean(axis=0)
    if n < 2:
        return np.full(amplitudes.shape[1], np.nan), math.nan
    return np.asarray(cross / np.maximum(own, 1e-300)), 1.0 - _NULL_SHARE ** (1.0 / (n - 1))


def _pairs(feed_of: NDArray[np.int_]) -> tuple[list[int], list[int]]:
    """Pair runs of different feeds, each once, as many as there can be."""
    left = {int(k): [int(i) for i in np.flatnonzero(feed_of == k)] for k in np.unique(feed_of)}
    first: list[int] = []
    second: list[int] = []
    while True:
        fullest = sorted((k for k in left if left[k]), key=lambda k: (-len(left[k]), k))
        if len(fullest) < 2:
            return first, second
        first.append(left[fullest[0]].pop(0))
        second.append(left[fullest[1]].pop(0))


def _adjusted(p: FloatArray) -> FloatArray:
    """Return the smallest false discovery rate at which each is selected."""
    order = np.argsort(p)[::-1]
    n = p.size
    steps = p[order] * n / np.arange(n, 0, -1)
    out = np.empty(n)
    out[order] = np.minimum(np.minimum.accumulate(steps), 1.0)
    return out


def _reason(usable: bool, chosen: bool) -> str:
    if not usable:
        return _BLIND
    return "repeats at all feedrates" if chosen else "within the noise"


def _unsteady(
    amplitudes: ComplexArray, feed_of: NDArray[np.int_], wavelength: FloatArray
) -> list[str]:
    """Name waves that differ from run to run at one wavelength whatever the feedrate.

    The scatter of the runs of one feedrate about their mean, against that at the wavelengths around
    it: chi-square, 2 degrees for each run but one. A vibration stands out at another wavelength at
    each feedrate; what stands out at the same one at all of them sits at a place, as slipping
    balls do.
    """
    from scipy.stats import f as f_distribution

    feeds = [np.flatnonzero(feed_of == k) for k in np.unique(feed_of)]
    n = amplitudes.shape[1]
    if len(feeds) < 2 or min(len(f) for f in feeds) < 2 or n < 4 * _AROUND:
        return []
    worst_p = np.zeros(n)
    power = np.zeros(n)
    for rows in feeds:
        scatter = np.var(amplitudes[rows], axis=0, ddof=1)
        around = np.full(n, np.inf)
        for k in range(5, n):  # three wavelengths beyond the leakage on the long side
            left = scatter[max(k - _AROUND, 0) : k - 2]
            right = scatter[k + 3 : k + 1 + _AROUND]
            if left.size >= 3 and right.size >= 3:
                around[k] = max(float(left.mean()), float(right.mean()))
        freedom = 2 * (len(rows) - 1)
        p = f_distribution.sf(scatter / around, freedom, freedom * 3)
        worst_p = np.maximum(worst_p, np.where(np.isfinite(around), p, 1.0))
        power += scatter / len(feeds)
    together = worst_p ** len(feeds) * n
    k = int(np.argmin(together))
    if together[k] > _UNSTEADY:
        return []
    near = np.arange(k - 1, min(k + 2, n))
    amplitude = math.sqrt(float(power[near].max()))
    length = float(wavelength[0] * power[near].sum() / ((near + 1.0) @ power[near]))
    known = amplitude / math.sqrt(len(feed_of))
    sentence = (
        f"a wave of {length / _MM:.2g} mm, about {amplitude / _NM:.2g} nm, has another phase in "
        f"each run at every feedrate: a real wave of that length is known to {known / _NM:.2g} nm only, "
        "and the uncertainty of the estimate does not hold it; more runs reduce it"
    )
    return [sentence]


def _messages(
    columns: Mapping[str, list[Any]], feeds: tuple[float, ...], width: float
) -> list[str]:
    blind = [
        w
        for w, reason in zip(columns["wavelength_mm"], columns["reason"], strict=True)
        if reason == _BLIND
    ]
    if not blind:
        return []
    spread = (max(feeds) - min(feeds)) * 6e4
    sentence = (
        f"at wavelengths of {min(blind):.3g} mm and longer the feedrates, {spread:.4g} mm/min apart, "
        f"move a vibration by less than its bandwidth of {width:.3g} Hz: not separable by "
        "repeatability; add runs at feedrates farther apart"
    )
    return [sentence]

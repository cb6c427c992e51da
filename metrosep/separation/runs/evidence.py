r"""Evidence, wavelength by wavelength, that an error repeats over runs of different feedrates.

With :math:`Z_r(k)` the complex amplitude of run r at exactly :math:`k / l_x`, R runs:

.. math:: \hat G^2 = \frac{|\sum Z|^2 - \sum |Z|^2}{R (R - 1)}, \quad
          \hat S = \overline{|Z|^2} - \hat G^2, \quad
          F = R |\bar Z|^2 / \hat S \sim F(2, 2 (R - 1))

the last without geometry. :math:`\hat S` equals the sample variance of Z, so :math:`\hat G^2` is
free of bias and may be negative. Only runs of different feedrates are evidence: at one feedrate a
vibration locked to the start repeats as well as geometry does.

Source: the project's separation notes, section 3; Benjamini and Hochberg 1995; Fisher 1929 (test of
the greatest share).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray, benjamini_hochberg
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import quantity
from metrosep.core.options import Option
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation.contract import NamedMethod
from metrosep.separation.runs.design import evaluation_range
from metrosep.separation.runs.geometry import HELD_SHARE
from metrosep.separation.runs.sensor import LAG_CHI2
from metrosep.separation.runs.solver import Solution
from metrosep.separation.runs.spectra import feed_spectra, n_wavelengths
from metrosep.spectral.autoregressive import AutoregressiveModel

if TYPE_CHECKING:
    import pandas as pd

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
        Of the vibrations; feeds whose frequencies v/wavelength differ by less cannot be
        distinguished. The resolution of the shortest run if omitted; never less than it.
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
    that were not measured are omitted from the sums.

    Examples
    --------
    >>> from metrosep.separation.runs.simulate import machine_axis
    >>> table = evidence_table(machine_axis(seed=1).runs).to_frame()
    >>> bool(table["selected"].any())
    True
    """
    length, start, shortest = (
        None if v is None else quantity(v, name, "length")
        for v, name in ((length, "length"), (start, "start"), (shortest, "shortest"))
    )
    if bandwidth is not None:
        bandwidth = quantity(bandwidth, "bandwidth", "frequency")
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
            f"{n_given - len(runs)} of {n_given} runs were omitted, so that every feedrate has "
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


class EvidenceOfTable(NamedMethod):
    """`evidence_table` by its name."""

    name: ClassVar[str] = "evidence_table"
    what: ClassVar[str] = (
        "how surely each wavelength of an error repeats over runs of several feedrates"
    )
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "x": "length", "z": "length", "feed": "speed", "run": "label", "time": "time?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = {
        "direction": Option(
            "text", choices=("forward", "reverse"), help="the runs that are looked at"
        ),
        "start": Option("length", help="where the evaluation range begins"),
        "length": Option("size", help="of the evaluation range; the common travel if omitted"),
        "shortest": Option("size", help="shortest wavelength that is looked at"),
        "bandwidth": Option("frequency", help="of the sensor"),
        "false_discovery_rate": Option(
            "number", help="accepted share of wavelengths called repeatable that are noise"
        ),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> EvidenceTable:
        """Return the evidence of the runs of a table."""
        rest = dict(options)
        way = rest.pop("direction", None)
        runs = _runs(data)
        if way is not None:
            runs = runs.select(direction=1 if way == "forward" else -1)
        return evidence_table(runs, **rest)


_SAME_FEED = 1e-6
"""Feeds of one run may differ by this relative share: rounding of text."""


def _runs(data: RoleColumns) -> RunSet:
    """Return the runs of a table, told apart by the column of runs, in the order of the rows."""
    values = data.values
    found = []
    for name in dict.fromkeys(values["run"].tolist()):
        rows = values["run"] == name
        feed = values["feed"][rows]
        if not np.isfinite(feed).all() or float(np.ptp(feed)) > _SAME_FEED * abs(float(feed[0])):
            raise InvalidSamplesError(
                f"run {name}: its rows have different feedrates, or none; a run has one"
            )
        time = values["time"][rows] if "time" in values else None
        found.append(
            Run(
                values["x"][rows],
                values["z"][rows],
                t=time,
                feed=abs(float(feed[0])),
                run_id=str(name),
            )
        )
    return RunSet(found)


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


# ---- what a separation wants the user to know, in plain words ----------------------------------
# Each function returns sentences with a number, a unit and, where something can be done, what to
# do. Nothing here changes a result.

_PEAK_RATIO = 6.0
"""A resonance stands this much above the noise model's spectrum on both sides of it."""

_PEAK_SHARE = 0.02
"""Least share of the noise variance in a resonance that is worth a sentence."""

_MM_PER_MIN = 6e4
"""mm/min in one m/s."""


_CLOSE_FEEDS = 0.2
"""Feeds that spread less than this, relative, are worth a sentence."""


def _close_feeds(feeds: tuple[float, ...], travel: float) -> list[str]:
    """Say which wavelengths feeds that hardly differ cannot tell from a vibration."""
    if len(feeds) < 2 or feeds[0] <= (1.0 - _CLOSE_FEEDS) * feeds[-1]:
        return []
    spread = 1.0 - feeds[0] / feeds[-1]
    slower, faster = 0.5 * feeds[0] * _MM_PER_MIN, 2.0 * feeds[-1] * _MM_PER_MIN
    sentence = (
        f"the feedrates differ by {spread * 100:.2g} % only: at wavelengths above "
        f"{spread * travel * 1e3:.2g} mm a vibration cannot be distinguished from geometry; add runs at "
        f"{slower:.0f} or {faster:.0f} mm/min"
    )
    return [sentence]


_NAMED = 4
"""Resonances of a noise model that are named, the strongest."""


def noise_peaks(model: AutoregressiveModel, *, n_max: int = _NAMED) -> list[float]:
    """Return the frequencies of the strongest resonances of a noise model."""
    return [f for f, _, _ in _resonances(model)[:n_max]]


def _resonances(model: AutoregressiveModel) -> list[tuple[float, float, float]]:
    """Return frequency and band (to a tenth of the density) of each resonance, the strongest first."""
    from scipy.signal import find_peaks

    if model.order < 2:
        return []
    nyquist = 0.5 / model.time_step
    frequency = np.linspace(0.0, nyquist, 4097)[1:-1]
    density = model.psd(frequency)
    step = frequency[1] - frequency[0]
    peaks, _ = find_peaks(np.log(density), prominence=math.log(_PEAK_RATIO))
    found: list[tuple[float, float, float, float]] = []
    for i in peaks.tolist():
        above = (density > density[i] / 10.0) & (density <= density[i])
        left = i - int(np.argmin(above[i::-1])) if not above[: i + 1].all() else 0
        right = i + int(np.argmin(above[i:])) if not above[i:].all() else density.size
        share = float(density[left:right].sum() * step)
        if share > _PEAK_SHARE * float(density.sum() * step):
            ends = (float(frequency[left]), float(frequency[right - 1]))
            found.append((share, float(frequency[i]), *ends))
    return [(f, low, high) for _, f, low, high in sorted(found, reverse=True)]


_ONE_RUN = 1e-3
"""Chance by which a vibration of all runs would have so much of its power in one of them."""


def _held_by_all(
    band: tuple[float, float], records: Sequence[FloatArray], time_step: float
) -> bool:
    """Tell whether a resonance is of all runs, and not of one that differs, such as a displaced one.

    Powers of R runs at one frequency are exponential: the greatest has a share above g by a chance
    of at most R (1 - g)^(R - 1) (Fisher 1929). Over a band they scatter less. One frequency would not do:
    a long run resolves 1/T, and the frequency of a spindle or a motor differs more than that between runs.
    """
    if len(records) < 3:
        return True
    power = []
    for record in records:
        known = ~np.isnan(record)
        spectrum = np.abs(np.fft.rfft(np.where(known, record, 0.0))) ** 2
        cell = 1.0 / (time_step * record.size)
        first, last = (round(f / cell) for f in band)
        within = spectrum[max(first - 1, 0) : last + 2]
        power.append(float(within.mean()) / max(int(known.sum()), 1))
    share = max(power) / max(sum(power), 1e-300)
    return len(power) * (1.0 - share) ** (len(power) - 1) > _ONE_RUN


def explain_disturbances(
    solution: Solution,
    runs: RunSet,
    spectrum: Mapping[str, list[Any]],
    records: Sequence[Sequence[FloatArray]],
) -> tuple[str, ...]:
    """Name vibrations that fall onto a wavelength of the geometry at some feedrate.

    `records` are the residuals of the runs of each noise model.
    """
    low, high = runs.full_travel
    travel = high - low
    waves = [
        w * 1e-3 for w, s in zip(spectrum["wavelength_mm"], spectrum["selected"], strict=True) if s
    ]
    sentences = []
    found = sorted(
        {
            round(f, 1)
            for m, own in zip(solution.noise, records, strict=True)
            for f, *band in _resonances(m)[:_NAMED]
            if _held_by_all((band[0], band[1]), own, m.time_step)
        }
    )
    cell = max(runs.feeds) / travel  # noise models of two sampling rates see the same vibration
    for i, frequency in enumerate(found):
        if i and frequency - found[i - 1] < 0.25 * cell:
            continue
        hit = _collisions(frequency, runs.feeds, waves, travel)
        if hit:
            sentences.append(_collision_sentence(frequency, hit, runs.feeds, waves, travel))
    return tuple(sentences)


def _collisions(
    frequency: float, feeds: tuple[float, ...], waves: list[float], travel: float
) -> list[float]:
    """Return the feeds at which the vibration lies within one resolution cell of a wavelength."""
    return [
        v
        for v in feeds
        if any(abs(frequency / v - 1.0 / w) * travel < 1.0 for w in waves if w < travel)
    ]


def _collision_sentence(
    frequency: float,
    hit: list[float],
    feeds: tuple[float, ...],
    waves: list[float],
    travel: float,
) -> str:
    maps = ", ".join(f"{v / frequency * 1e3:.1f} mm at {v * _MM_PER_MIN:.0f} mm/min" for v in hit)
    clean = [v for v in feeds if v not in hit]
    sentence = f"{frequency:.1f} Hz disturbance maps onto {maps}"
    if len(clean) >= 2:
        *most, last = (f"{v * _MM_PER_MIN:.0f}" for v in clean)
        others = f"{', '.join(most)} and {last}"
        return f"{sentence}; the runs at {others} mm/min distinguish it from the geometry"
    better = _better_feed(frequency, feeds, waves, travel)
    if better is None:
        return f"{sentence}; no other feedrate in this range avoids it: remove the disturbance"
    return f"{sentence}; add a run at {better * _MM_PER_MIN:.0f}"


def _better_feed(
    frequency: float, feeds: tuple[float, ...], waves: list[float], travel: float
) -> float | None:
    """Return the round feed, in and a little around the range, farthest from any collision."""
    near, far = 0.6 * min(feeds) * _MM_PER_MIN, 1.4 * max(feeds) * _MM_PER_MIN
    step = 10.0 ** math.floor(math.log10(max(near, 1e-6)))
    best: tuple[float, float] | None = None
    for value in np.arange(math.ceil(near / step) * step, far, step):
        feed = float(value) / _MM_PER_MIN
        if any(abs(feed / v - 1.0) < 0.1 for v in feeds):
            continue
        distance = min(abs(frequency / feed - 1.0 / w) * travel for w in waves)
        if distance > 2.0 and (best is None or distance > best[0]):
            best = (distance, feed)
    return None if best is None else best[1]


def explain_lag(
    solution: Solution, *, mode: Literal["stated", "auto", "fit"], n_selected: int = 1
) -> tuple[str, ...]:
    """Say what lag the readings show and what was done about it."""
    value, sd = solution.lag * 1e3, solution.lag_sd * 1e3
    test = solution.lag_test
    if mode == "fit":
        if test is None or not test.fitted or n_selected == 0:
            return (
                (
                    "the lag is not determined by these runs and none is corrected: the error has too "
                    "little short-wave content; state the lag instead"
                ),
            )
        return (f"readings {said_lag(value, '.3f')} (sd {sd:.3f} ms)",)
    if test is None or test.chi2 <= LAG_CHI2:
        return ()
    if mode == "auto":
        return (
            (
                f"readings {said_lag(test.lag * 1e3)} (u {test.u * 1e3:.2g} ms), weight "
                f"{test.probability:.2f}: found by lag='auto' and corrected; its split into delay and time "
                'constant is not known; lag=0.0 (command line: --lag "0 ms") leaves it in'
            ),
        )
    return (
        (
            f"readings {said_lag(value + test.lag * 1e3)} (u {test.u * 1e3:.2g} ms), "
            f"{value:.3g} ms was stated: not corrected, and the uncertainty does not hold it; "
            "lag='auto' (command line: --lag auto) corrects it"
        ),
    )


def said_lag(lag_ms: float, digits: str = ".3g") -> str:
    """Return how a lag is said; a negative one is readings that come before their position."""
    way = "lead" if lag_ms < 0.0 else "lag"
    return f"{way} the position by {abs(lag_ms):{digits}} ms"


SURELY = 0.99
"""Probability from which it is reported that the runs are displaced."""

_LOST = 0.1
"""Share of a wave that the mean of displaced runs may lose; beyond that a band of small shifts fails."""


def explain_displacement(solution: Solution) -> tuple[str, ...]:
    """Say by how much the places of the runs scatter, where they do, and which waves it takes."""
    found = solution.displaced
    if found.probability < SURELY:
        return ()
    held = lost_below(found.sd)
    only = ""
    if held > solution.period / solution.n_harmonics:
        only = (
            f" in waves longer than {format_length(held, digits=2)} (shorter ones may be missing "
            "from the estimate and from its uncertainty)"
        )
    return (
        (
            f"{said_apart(found.sd)}: the uncertainty holds it{only}, and a lag is less well known; "
            "position_offsets=true (command line: --set position_offsets=true) fits the place of each "
            "run"
        ),
    )


def said_apart(sd: float) -> str:
    """Return how a scatter of the places of the runs is said."""
    return (
        f"the runs lie apart along the axis, each by its own, {format_length(sd, digits=2)} (sd)"
    )


def lost_below(sd: float) -> float:
    """Return the wavelength below which the mean of displaced runs loses more than a tenth."""
    # The mean of cos(2 pi (x - d)/l) over d of N(0, sd^2) is exp(-(2 pi sd / l)^2 / 2) of the wave.
    return 2.0 * math.pi * sd / math.sqrt(-2.0 * math.log1p(-_LOST))


def explain_slip(solution: Solution, *, sparse: bool, placed: bool) -> tuple[str, ...]:
    """Name the waves that have another phase in each run.

    Where the runs are not placed yet, their places may be the reason.
    """
    sentences = []
    for slip in solution.slip:
        amplitude = math.sqrt(2.0) * slip.sd
        rest = (
            "it is not in the estimate, but in the uncertainty; a real wave of that length is taken "
            "for absent (slip='sparse')"
            if sparse
            else f"a real wave of that length is known to {slip.u_amplitude / _NM:.2g} nm only, which the "
            "uncertainty holds"
        )
        # A displacement d turns the phase of a wave of the error by 2 pi d / length.
        displaced = (
            " (runs that lie apart along the axis look alike where the error has a wave of that "
            "length: position_offsets=true, command line --set position_offsets=true, fits their places)"
            if slip.amplitude > amplitude and not placed
            else ""
        )
        sentences.append(
            f"a wave of {slip.wavelength / _MM:.2g} mm, {amplitude / _NM:.2g} nm, has another phase in each "
            f"run{displaced}: {rest}; more runs reduce it"
        )
    return tuple(sentences)


SLOW_SAID = "too slow for a run to show"
"""What is said of noise slower than the runs: `separate` looks for it."""

_PRIOR_RATIO = 3.0
"""The band is mostly that of the prior where it is so many times what the noise leaves."""

_SLOW_SHARE = 0.15
"""Share of the noise below the lowest frequency that a run can show, from which it is named."""


def explain_band(solution: Solution, *, band: float, plain: float) -> tuple[str, ...]:
    """Say where the uncertainty is known not to be that of 95 %: prior, or noise slower than runs."""
    sentences = []
    if band > _PRIOR_RATIO * plain:
        sentences.append(
            f"the uncertainty, {band * 1e9:.2g} nm, is {band / plain:.2g} times what the noise of these "
            f"readings leaves ({plain * 1e9:.2g} nm): it comes from the prior, and is an upper bound"
        )
    longest = max(r.size * m.time_step for r, m in _with_models(solution))
    lowest = 2.0 / longest
    shares = []
    for model in solution.noise:
        frequency = np.linspace(0.0, 0.5 / model.time_step, 8193)[1:]
        density = model.psd(frequency)
        shares.append(float(density[frequency < lowest].sum() / density.sum()))
    if max(shares) > _SLOW_SHARE:
        sentences.append(
            f"{100 * max(shares):.0f} % of the noise lies below {lowest:.2g} Hz, {SLOW_SAID}: "
            "the uncertainty rests on an extrapolation and may be too small by half; take longer or "
            "slower runs"
        )
    return tuple(sentences)


def _with_models(solution: Solution) -> list[tuple[FloatArray, AutoregressiveModel]]:
    """Pair each residual with the noise model of the slowest sampling, enough for its duration."""
    slowest = max(solution.noise, key=lambda m: m.time_step)
    return [(r, slowest) for r in solution.residuals]


_LEFT_OUT = 1e-3
"""Chance by which noise would repeat so well at any wavelength below the shortest of the model."""


def _left_out(solution: Solution, runs: RunSet) -> list[str]:
    """Name the strongest wave that the runs repeat below the stated shortest wavelength."""
    shortest = solution.period / solution.n_harmonics / HELD_SHARE
    rests = [
        Run(np.linspace(run.x[0], run.x[-1], rest.size), rest, feed=run.feed)
        for run, rest in zip(runs, solution.residuals, strict=True)
    ]
    try:
        columns = evidence_table(RunSet(rests)).columns
    except (DataError, NotSeparableError):  # one feedrate, wide gaps: nothing can be said
        return []
    wavelength, p = (np.array(columns[k], dtype=np.float64) for k in ("wavelength_mm", "p"))
    short = wavelength * _MM < shortest
    known = short & (p * max(int(short.sum()), 1) < _LEFT_OUT)
    if not known.any():
        return []
    amplitude = np.where(known, np.array(columns["amplitude_nm"]), 0.0)
    k = int(np.argmax(amplitude))
    sentence = (
        f"waves below {shortest / _MM:.3g} mm were omitted as stated, but the runs repeat some: one of "
        f"{wavelength[k]:.3g} mm, {amplitude[k]:.2g} nm, is neither in the estimate nor in its "
        "uncertainty; state a shorter shortest= (command line: --shortest)"
    )
    return [sentence]


def explain_resolution(
    solution: Solution, *, limit: str, travel: float, runs: RunSet, n_selected: int
) -> tuple[str, ...]:
    """Say when the shortest wavelength was bounded by something other than evidence."""
    sentences = []
    considered = solution.n_harmonics
    below = f"wavelengths below {solution.period / considered * 1e3:.3g} mm were not considered"
    if limit == "cost":
        last = solution.rows[-max(considered // 10, 1) :, 3]  # chi-square of the shortest waves
        evidence = bool((last > 2.0 * math.log(considered / 0.01)).any())
        although = " although there is evidence down to this limit" if evidence else ""
        sentences.append(f"{below}{although}; state shortest= to go further")
    if limit == "data":
        sentences.append(
            f"{below}, although shortest= asks for them: the runs have too few samples for so many "
            "wavelengths; add runs or sample faster"
        )
    if limit in ("stated", "data"):
        sentences += _left_out(solution, runs)
    sentences += _close_feeds(runs.feeds, travel)
    if len(runs.feeds) == 1:
        sentences.append(
            f"one feedrate only ({runs.feeds[0] * _MM_PER_MIN:.0f} mm/min): a vibration that starts "
            "in phase with the run cannot be distinguished from geometry; add runs at another feedrate"
        )
        if solution.lag == 0.0:
            moved = format_length(runs.feeds[0] * 1e-3, digits=2)
            sentences.append(
                f"one feedrate only: a delay of the reading cannot be seen; each ms moves the error by "
                f"{moved} along the axis, and the uncertainty does not hold it; add runs at another "
                "feedrate, or state lag= (command line: --lag)"
            )
    if n_selected == 0:
        sentences.append(
            f"no wavelength up to the travel of {travel * 1e3:.4g} mm repeats beyond chance: there is "
            "nothing to compensate that these runs could show"
        )
    return tuple(sentences)

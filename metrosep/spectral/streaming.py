"""Mean over bins and power spectrum of recordings that do not fit into memory.

Both take a recording in chunks of any size and give what they would give of the whole at once:
the chunks leave no trace. NaN = not measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError


@dataclass(slots=True, eq=False)
class BinnedMean:
    """Mean, standard deviation and count of a channel over bins of another.

    Parameters
    ----------
    low, high : float
        Range of the positions that are binned, in the unit of `add`'s `x`.
    n_bins : int
        Number of bins of equal width.
    period : float, optional
        Positions are taken modulo this before they are binned, such as one turn of a spindle.

    Raises
    ------
    InvalidSamplesError
        If the range is empty or there is no bin.

    Notes
    -----
    A sample on an inner edge belongs to the upper bin, one at `high` to the last. Sums run over
    deviations from the first valid sample, so that a large offset costs no digits.

    Examples
    --------
    >>> bins = BinnedMean(0.0, 2.0, 2)
    >>> bins.add([0.1, 0.9, 1.5], [1.0, 3.0, 7.0])
    >>> bins.mean.tolist()
    [2.0, 7.0]
    """

    low: float
    high: float
    n_bins: int
    period: float | None = None
    count: NDArray[np.int64] = field(init=False)
    n_outside: int = field(init=False, default=0)
    n_invalid: int = field(init=False, default=0)
    _offset: float = field(init=False, default=float("nan"))
    _sums: FloatArray = field(init=False)
    _squares: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        if not (self.high > self.low) or self.n_bins < 1:
            raise InvalidSamplesError(
                f"bins need low < high and at least one bin, got {self.low} ... {self.high}, {self.n_bins}"
            )
        if self.period is not None and not self.period > 0.0:
            raise InvalidSamplesError(f"period must be positive, got {self.period}")
        self.count = np.zeros(self.n_bins, dtype=np.int64)
        self._sums = np.zeros(self.n_bins)
        self._squares = np.zeros(self.n_bins)

    def add(self, x: ArrayLike, z: ArrayLike) -> None:
        """Take the next chunk.

        Parameters
        ----------
        x, z : array_like, shape (n,)
            Positions and readings; pairs with a NaN are counted and omitted.

        Raises
        ------
        InvalidSamplesError
            If their lengths differ.
        """
        position = np.asarray(x, dtype=np.float64)
        reading = np.asarray(z, dtype=np.float64)
        if position.shape != reading.shape:
            raise InvalidSamplesError(
                f"positions and readings differ in length: {position.size} and {reading.size}"
            )
        valid = ~(np.isnan(position) | np.isnan(reading))
        if not valid.all():
            self.n_invalid += int(valid.size - np.count_nonzero(valid))
            position, reading = position[valid], reading[valid]
        if reading.size == 0:
            return
        if np.isnan(self._offset):
            self._offset = float(reading[0])
        if self.period is not None:
            position = np.mod(position, self.period)
        inside = (position >= self.low) & (position <= self.high)
        if not inside.all():
            self.n_outside += int(inside.size - np.count_nonzero(inside))
            position, reading = position[inside], reading[inside]
        scale = self.n_bins / (self.high - self.low)
        index = np.minimum(((position - self.low) * scale).astype(np.intp), self.n_bins - 1)
        deviation = reading - self._offset
        self.count += np.bincount(index, minlength=self.n_bins)
        self._sums += np.bincount(index, deviation, self.n_bins)
        self._squares += np.bincount(index, deviation * deviation, self.n_bins)

    @property
    def centres(self) -> FloatArray:
        """Middle of each bin."""
        width = (self.high - self.low) / self.n_bins
        return np.asarray(self.low + width * (np.arange(self.n_bins) + 0.5))

    @property
    def mean(self) -> FloatArray:
        """Mean of each bin, NaN where it has no sample."""
        some = np.where(self.count > 0, self.count, 1)
        return np.where(self.count > 0, self._sums / some + self._offset, np.nan)

    @property
    def sd(self) -> FloatArray:
        """Sample standard deviation of each bin, NaN below two samples."""
        n = np.where(self.count > 1, self.count, 2)
        variance = (self._squares - self._sums**2 / n) / (n - 1)
        return np.where(self.count > 1, np.sqrt(np.maximum(variance, 0.0)), np.nan)


@dataclass(slots=True, eq=False)
class StreamedPsd:
    """One-sided power spectral density by Welch's method, fed in chunks.

    Parameters
    ----------
    time_step : float, s
        Sampling interval.
    n_fft : int, optional
        Length of a segment; segments overlap by half.

    Raises
    ------
    TooFewSamplesError
        If a segment has fewer than 16 samples.
    InvalidSamplesError
        If the interval is not positive.

    Notes
    -----
    Periodic Hann window; the mean of each segment is removed; segments with a NaN are counted
    and omitted. For white noise the density integrates to the variance.

    References
    ----------
    P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70.
    """

    time_step: float
    n_fft: int = 4096
    n_segments: int = field(init=False, default=0)
    n_left_out: int = field(init=False, default=0)
    _rest: FloatArray = field(init=False)
    _total: FloatArray = field(init=False)
    _window: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        if self.n_fft < 16:
            raise TooFewSamplesError(f"a segment needs >= 16 samples, got {self.n_fft}")
        if not self.time_step > 0.0:
            raise InvalidSamplesError(f"time_step must be positive, got {self.time_step}")
        self._rest = np.empty(0)
        self._total = np.zeros(self.n_fft // 2 + 1)
        self._window = np.sin(np.pi * np.arange(self.n_fft) / self.n_fft) ** 2

    def add(self, z: ArrayLike) -> None:
        """Take the next chunk.

        Parameters
        ----------
        z : array_like, shape (n,)
            Readings at the sampling interval; NaN = not measured.
        """
        data = np.concatenate([self._rest, np.asarray(z, dtype=np.float64)])
        hop = self.n_fft // 2
        n = (data.size - self.n_fft) // hop + 1 if data.size >= self.n_fft else 0
        self._rest = data[n * hop :].copy()
        if n == 0:
            return
        segments = np.lib.stride_tricks.sliding_window_view(data, self.n_fft)[: n * hop : hop]
        step = max(1, 2**16 // self.n_fft)
        for start in range(0, n, step):
            self._take(segments[start : start + step])

    def new_record(self) -> None:
        """Say that the next chunk does not follow the last one: no segment spans the two."""
        self._rest = np.empty(0)

    def _take(self, segments: FloatArray) -> None:
        mean = segments.mean(axis=1, keepdims=True)
        whole = ~np.isnan(mean[:, 0])
        self.n_left_out += int(whole.size - np.count_nonzero(whole))
        if not whole.all():
            segments, mean = segments[whole], mean[whole]
        spectra = np.fft.rfft((segments - mean) * self._window, axis=1)
        self._total += (spectra.real**2 + spectra.imag**2).sum(axis=0)
        self.n_segments += segments.shape[0]

    @property
    def frequency(self) -> FloatArray:
        """Frequencies in Hz, shape (n_fft // 2,), without zero."""
        return np.asarray(np.fft.rfftfreq(self.n_fft, self.time_step)[1:])

    @property
    def density(self) -> FloatArray:
        """Squared unit of the readings per Hz, shape (n_fft // 2,).

        Raises
        ------
        TooFewSamplesError
            If no whole segment was given yet.
        """
        if self.n_segments == 0:
            raise TooFewSamplesError(
                f"no unbroken segment of {self.n_fft} samples so far; make n_fft smaller"
            )
        norm = self.n_segments * float((self._window**2).sum())
        density = 2.0 * self.time_step * self._total / norm
        if self.n_fft % 2 == 0:
            density[-1] /= 2.0
        return np.asarray(density[1:])

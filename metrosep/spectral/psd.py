"""Power spectral density of short records, pooled over runs; it integrates to the variance."""

from __future__ import annotations

from collections.abc import Sequence

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TooFewSamplesError
from metrosep.spectral.streaming import StreamedPsd

__all__ = ["pooled_periodogram"]


def pooled_periodogram(
    records: Sequence[FloatArray], *, time_step: float, n_fft: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the one-sided PSD averaged over the half-overlapping Hann segments of all records.

    Parameters
    ----------
    records : sequence of ndarray, shape (n_r,)
        Same sampling interval; segments that hold a NaN are left out. The mean of each segment
        is removed.
    time_step : float, s
        Sampling interval.
    n_fft : int, optional
        Segment length; the shortest record, at most 1024, if omitted.

    Returns
    -------
    frequency : ndarray, shape (n_fft // 2,), Hz
        Without zero.
    density : ndarray, shape (n_fft // 2,)
        Squared unit of the data per Hz.

    Raises
    ------
    TooFewSamplesError
        If no complete segment of at least 16 samples exists.

    Notes
    -----
    For white noise of variance s^2 the expected integral over frequency is s^2, less the share
    of the removed mean.
    """
    shortest = min((r.size for r in records), default=0)
    size = n_fft or min(shortest, 1024)
    if size < 16:
        raise TooFewSamplesError(f"a spectrum needs records of >= 16 samples, got {size}")
    spectrum = StreamedPsd(time_step, size)
    for record in records:
        spectrum.new_record()
        spectrum.add(record)
    if spectrum.n_segments == 0:
        raise TooFewSamplesError(
            f"no unbroken segment of {size} samples; the records have too many gaps"
        )
    return spectrum.frequency, spectrum.density

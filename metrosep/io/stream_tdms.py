"""TDMS channels in chunks; the file is never loaded as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack

from metrosep.core._arrays import FloatArray
from metrosep.io.source import RawFile
from metrosep.io.tdms import iter_chunks, sampling, unit_labels

__all__ = ["TdmsSource", "open_source"]


def open_source(file: RawFile, stack: ExitStack, *, group: str | None = None) -> TdmsSource:
    """Return the channels of a TDMS file that hold numbers.

    Parameters
    ----------
    file : RawFile
        The file.
    stack : ExitStack
        Not used: each pass opens the file anew.
    group : str, optional
        The one group to read.

    Returns
    -------
    TdmsSource
        Ready to be read.

    Raises
    ------
    CorruptFileError
        If the structure does not fit.
    """
    return TdmsSource(file, group)


class TdmsSource:
    """Channels of a TDMS file; see `metrosep.io.stream.ChunkSource`.

    Parameters
    ----------
    file : RawFile
        The file.
    group : str, optional
        The one group to read.
    """

    def __init__(self, file: RawFile, group: str | None = None) -> None:
        self._file = file
        longest, step, names = sampling(file, group)
        self.labels: Mapping[str, str] = {
            name: label for name, label in unit_labels(file).items() if name in names
        }
        self.n_samples: int | None = longest
        self.time_step = step

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the channels, `size` samples at a time.

        Parameters
        ----------
        names : sequence of str
            Channels.
        size : int
            Samples of a chunk.

        Yields
        ------
        dict of str to ndarray, shape (n,)
            Scaled as the file says; NaN behind the end of a shorter channel.

        Raises
        ------
        CorruptFileError
            If a scale does not fit.
        """
        yield from iter_chunks(self._file, names, size)

"""TDMS channels in chunks; the file is never loaded as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack

from metrosep.core._arrays import FloatArray
from metrosep.io.source import RawFile
from metrosep.io.tdms import iter_chunks, sampling, unit_labels

__all__ = ["TdmsSource", "open_source"]


def open_source(file: RawFile, stack: ExitStack, *, group: str | None = None) -> TdmsSource:
    """Return the channels of a TDMS file that hold numbers."""
    return TdmsSource(file, group)


class TdmsSource:
    """Channels of a TDMS file; see `metrosep.io.stream.ChunkSource`."""

    def __init__(self, file: RawFile, group: str | None = None) -> None:
        self._file = file
        longest, step, names = sampling(file, group)
        self.labels: Mapping[str, str] = {
            name: label for name, label in unit_labels(file).items() if name in names
        }
        self.n_samples: int | None = longest
        self.time_step = step

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the channels, `size` samples at a time."""
        yield from iter_chunks(self._file, names, size)

"""One-dimensional HDF5 datasets in chunks; the file is never loaded as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError
from metrosep.io.arrays import unit_label, unit_of
from metrosep.io.hdf5 import physical_values
from metrosep.io.hdf5_file import Hdf5File, open_hdf5
from metrosep.io.source import RawFile

__all__ = ["Hdf5Source", "open_source"]

_TIME_NAMES = frozenset({"t", "time"})


def open_source(file: RawFile, stack: ExitStack) -> Hdf5Source:
    """Return the numeric 1-D datasets of an HDF5 file that are as long as the longest one."""
    handle = stack.enter_context(open_hdf5(file))
    lengths = {
        name: handle.shape(name)[0]
        for name in handle.datasets
        if handle.is_numeric(name) and len(handle.shape(name)) == 1 and not name.endswith("_json")
    }
    longest = max(lengths.values(), default=0)
    if longest < 1:
        raise FormatMismatchError(
            f"{file.path}: holds no one-dimensional dataset of numbers, so there is nothing to stream"
        )
    return Hdf5Source(file, handle, tuple(n for n, k in lengths.items() if k == longest), longest)


class Hdf5Source:
    """Datasets of one length; see `metrosep.io.stream.ChunkSource`."""

    def __init__(
        self, file: RawFile, handle: Hdf5File, names: tuple[str, ...], n_samples: int
    ) -> None:
        self._file, self._handle = file, handle
        self._paths = {str(handle.attributes(n).get("name") or n): n for n in names}
        self.n_samples: int | None = n_samples
        self.labels: Mapping[str, str] = {
            n: unit_label(handle.attributes(p)) for n, p in self._paths.items()
        }
        self.time_step = self._step()

    def _step(self) -> float | None:
        n = self.n_samples or 0
        for path in self._paths.values():
            if path.rsplit("/", 1)[-1].lower() in _TIME_NAMES and n > 1:
                first, last = (float(self._values(path, k, k + 1)[0]) for k in (0, n - 1))
                unit = unit_of(self._handle.attributes(path))
                step = (last - first) / (n - 1) * (unit.factor if unit is not None else 1.0)
                return step if step > 0.0 else None
        return None

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the datasets, `size` samples at a time."""
        for start in range(0, self.n_samples or 0, size):
            yield {n: self._values(self._paths[n], start, start + size) for n in names}

    def _values(self, path: str, start: int, stop: int) -> FloatArray:
        raw = self._handle.read(path, start=start, stop=stop)
        return physical_values(self._file, path, raw, self._handle.attributes(path))

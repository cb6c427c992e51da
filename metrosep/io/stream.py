"""`open_stream`: long recordings in chunks, in bounded memory (HDF5, TDMS, CSV).

A chunk is a dict of channel to float64 array in SI, NaN = not measured, the same that `read` would
give, a part at a time. The file is opened once and closed with the context.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    ReadNameError,
    ReadOptionError,
    UnsupportedFeatureError,
)
from metrosep.core.text_options import accepted_options
from metrosep.core.units import Unit
from metrosep.io.read import recognise
from metrosep.io.registry import formats
from metrosep.io.source import RawFile, open_file, rate_of
from metrosep.io.text.logger import with_units
from metrosep.io.text.table import AS_THEY_FOLLOW, refuse_row_gap

CHUNK = 2**18
"""Samples of each channel in a chunk unless the caller says otherwise: 2 MB per channel."""

_SAME_STEP = 1e-4
"""Largest relative difference of a stated rate from the file's own: digits of a header."""


class ChunkSource(Protocol):
    """What a format offers for streaming."""

    labels: Mapping[str, str]
    """Text that the file gives as the unit of each channel, empty where it gives none."""

    n_samples: int | None
    """Samples of each channel; ``None`` where only reading to the end tells."""

    time_step: float | None
    """Sampling interval in s where the file declares it."""

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the samples of channels in the unit of the file, NaN = not measured; the last part is short."""


@dataclass(slots=True, eq=False)
class Stream(AbstractContextManager["Stream"]):
    """A recording that is read in chunks; see `open_stream`.

    Parameters
    ----------
    file : RawFile
        The file.
    format : str
        Identifier of the format.
    channels : tuple of str
        The channels that are read.
    units : mapping of str to Unit or None
        Unit in the file, declared by it or by the caller.
    n_samples : int or None
        Samples of each channel, where the file tells it beforehand.
    time_step : float or None, s
        Sampling interval, where the file or the caller tells it.
    source : ChunkSource
        Gives the samples as they stand in the file.
    stack : ExitStack, optional
        What is closed with the stream.
    is_counted : bool, optional
        Whether time is counted by rows: a gap in a column that numbers them is then refused.
    """

    file: RawFile
    format: str
    channels: tuple[str, ...]
    units: Mapping[str, Unit | None]
    n_samples: int | None
    time_step: float | None
    source: ChunkSource
    stack: ExitStack = field(default_factory=ExitStack)
    is_counted: bool = False

    def chunks(self, size: int = CHUNK) -> Iterator[dict[str, FloatArray]]:
        """Yield the recording from its start, a chunk at a time."""
        if size < 1:
            raise DataError(f"a chunk needs at least one sample, got {size}")
        factors = {n: u.factor for n in self.channels if (u := self.units[n]) is not None}
        for part in self.source.chunks(self.channels, size):
            if self.is_counted:
                names = [n for n in self.channels if self.units[n] is not None]
                refuse_row_gap(
                    self.file,
                    getattr(self.source, "row_gap", None),
                    f"name the channels, such as channels={names}, {AS_THEY_FOLLOW}",
                )
            yield {
                n: values * factors[n] if factors.get(n, 1.0) != 1.0 else values
                for n, values in part.items()
            }

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was unusual about the text, once it was read to its end; empty for other formats."""
        return tuple(getattr(self.source, "warnings", ()))

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stack.close()


def open_stream(
    path: str | os.PathLike[str],
    *,
    channels: Sequence[str] | None = None,
    unit: str | Mapping[str, str] | None = None,
    sampling_rate: float | str | None = None,
    format: str | None = None,  # noqa: A002
    **options: Any,
) -> Stream:
    r"""Open a recording to be read in chunks.

    Parameters
    ----------
    path : str or path
        The file, of any length.
    channels : sequence of str, optional
        Which to read; all of one length if omitted.
    unit : str or mapping of str to str, optional
        Unit of channels whose label is empty: one for all; or by name.
    sampling_rate : float (Hz) or str, optional
        Where the file does not tell it; refused where it contradicts the file.
    format : str, optional
        Identifier of the format, where the content fits several.
    **options
        Of the format: for text ``separator``, ``decimal``, ``thousands``, ``encoding``, ``comment``,
        ``skip_rows``, ``skip_lines``, ``missing``; for TDMS ``group``.

    Returns
    -------
    Stream
        A context manager with ``channels``, ``units``, ``n_samples``, ``time_step`` and
        ``chunks()``.

    Raises
    ------
    ReadError
        If the file cannot be opened, or a channel does not exist.
    UnsupportedFeatureError
        If the format is not read in chunks; `metrosep.io.read.read` reads it as a whole.
    UnitError
        If a declared unit is unknown.
    FormatMismatchError
        If a unit contradicts the file or names no channel.

    Examples
    --------
    >>> import numpy as np, tempfile, pathlib
    >>> from metrosep.io.stream import open_stream
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "long.csv"
    >>> _ = path.write_text("t_s,gap_um\n0,1\n1,2\n2,4\n")
    >>> with open_stream(path) as stream:
    ...     [chunk["gap_um"].tolist() for chunk in stream.chunks(2)]
    [[1e-06, 2e-06], [4e-06]]
    """
    file = open_file(path)
    description = recognise(file, format, options)
    module = description.facts.get("chunks")
    if module is None:
        known = ", ".join(f.id for f in formats() if "chunks" in f.facts)
        raise UnsupportedFeatureError(
            f"{file.path}: {description.title} is not read in chunks (those are {known}); read it whole "
            "with metrosep.read"
        )
    stack = ExitStack()
    try:
        opener = importlib.import_module(f"metrosep.io.{module}").open_source
        _refuse_unknown(file, opener, options)
        source: ChunkSource = opener(file, stack, **options)
        units = with_units(file, source.labels, unit)
        names = _names(file, units, channels)
        step = _interval(file, source.time_step, sampling_rate)
    except BaseException:
        stack.close()
        raise
    is_counted = channels is None and sampling_rate is not None and source.time_step is None
    return Stream(
        file, description.id, names, units, source.n_samples, step, source, stack, is_counted
    )


def _refuse_unknown(file: RawFile, opener: Any, options: Mapping[str, Any]) -> None:
    accepted = accepted_options(opener)[2:]
    for name in options:
        if name not in accepted:
            known = f"it takes {', '.join(accepted)}" if accepted else "it takes none"
            raise ReadOptionError(f"{file.path}: takes no option {name!r} here; {known}")


def _interval(file: RawFile, own: float | None, sampling_rate: float | str | None) -> float | None:
    """Return the sampling interval; a rate that contradicts the file is refused."""
    if sampling_rate is None:
        return own
    rate = rate_of(sampling_rate)
    if own is not None and abs(own * rate - 1.0) > _SAME_STEP:
        raise FormatMismatchError(
            f"{file.path}: samples are {own:g} s apart by the file, but sampling_rate is {rate:g} Hz; leave "
            "sampling_rate= out"
        )
    return 1.0 / rate if own is None else own


def _names(
    file: RawFile, units: Mapping[str, Unit | None], channels: Sequence[str] | None
) -> tuple[str, ...]:
    if channels is None:
        return tuple(units)
    for name in channels:
        if name not in units:
            raise ReadNameError(
                f"{file.path}: has no channel {name!r}; the channels are {', '.join(list(units)[:20])}"
            )
    return tuple(channels)

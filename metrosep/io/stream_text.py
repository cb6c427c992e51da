"""Columns of a long text file in chunks: the C parser of NumPy, and every row counted.

The head of the file gives dialect, names and units exactly as for a short file. A block is parsed
fast when each of its lines has the same number of separators; a block with anything else (a word
for "not measured", a comment, a short row) goes through the parser of short files, which reads it
or names the line.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, UnsupportedFeatureError
from metrosep.io.source import HEAD_BYTES, RawFile
from metrosep.io.table import Table, read_table, rows_as_columns

__all__ = ["TextSource", "open_source"]

_BLOCK = 2**22
"""Bytes of text that are parsed at once."""

_HEAD = HEAD_BYTES
"""Bytes that tell dialect, names and units."""

_PLAIN = frozenset(b"0123456789+-.,;eE \t\r\n")


def open_source(
    file: RawFile,
    stack: ExitStack,
    *,
    separator: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    comment: str | None = None,
    skip_rows: int = 0,
) -> TextSource:
    """Return the columns of numbers of a text file.

    Parameters
    ----------
    file : RawFile
        The file.
    stack : ExitStack
        Closes the file.
    separator, decimal, encoding, comment, skip_rows : optional
        As for `metrosep.io.table.read_table`.

    Returns
    -------
    TextSource
        Ready to be read.

    Raises
    ------
    UnsupportedFeatureError
        If a column holds labels or the text is not in a one-byte encoding or UTF-8.
    ReadError
        If the head is no table.
    """
    head = file.head[:_HEAD]
    if file.size > _HEAD:
        head = head[: head.rfind(b"\n") + 1]
    table = read_table(
        RawFile(file.path, head),
        separator=separator,
        decimal=decimal,
        encoding=encoding,
        comment=comment,
        skip_rows=skip_rows,
    )
    labels = [c.name for c in table.columns if c.values is None]
    if labels:
        raise UnsupportedFeatureError(
            f"{file.path}: column {labels[0]!r} holds text; a file with labels is not read in chunks"
        )
    if str(table.header["encoding"]).startswith("utf-16"):
        raise UnsupportedFeatureError(
            f"{file.path}: UTF-16 text is not read in chunks; convert it to UTF-8"
        )
    handle = stack.enter_context(file.stream())
    return TextSource(file, handle, table, comment)


class TextSource:
    """Columns of numbers of a text file; see `metrosep.io.stream.ChunkSource`.

    Parameters
    ----------
    file : RawFile
        The file.
    handle : binary file
        The same, open.
    table : Table
        What its head says.
    comment : str or None
        Start of comment lines, where the caller declared it.
    """

    def __init__(
        self, file: RawFile, handle: io.BufferedIOBase, table: Table, comment: str | None
    ) -> None:
        self._file, self._handle, self._table = file, handle, table
        self._comment = comment
        self.labels: Mapping[str, str] = {
            c.name: c.unit.name if c.unit is not None else "" for c in table.columns
        }
        self.n_samples = None
        self.time_step = self._step()

    def _step(self) -> float | None:
        """Return the interval of a column of time that is uniform in the head, in s."""
        for column in self._table.numbers:
            if column.unit is None or column.unit.dimension != "time" or column.values is None:
                continue
            steps = np.diff(column.values) * column.unit.factor
            usual = float(np.median(steps)) if steps.size else float("nan")
            if usual > 0.0 and float(np.abs(steps - usual).max()) < 0.01 * usual:
                return usual
        return None

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the columns, `size` rows at a time.

        Parameters
        ----------
        names : sequence of str
            Columns.
        size : int
            Rows of a chunk.

        Yields
        ------
        dict of str to ndarray, shape (n,)
            In the unit of the file.

        Raises
        ------
        CorruptFileError
            If a row does not fit; the message names its line.
        """
        where = [self._table.names.index(n) for n in names]
        rest = np.empty((0, len(self._table.names)))
        for block in self._blocks():
            rest = np.concatenate([rest, block]) if rest.size else block
            while rest.shape[0] >= size:
                yield {n: rest[:size, k].copy() for n, k in zip(names, where, strict=True)}
                rest = rest[size:]
        if rest.shape[0]:
            yield {n: rest[:, k].copy() for n, k in zip(names, where, strict=True)}

    def _blocks(self) -> Iterator[FloatArray]:
        """Yield rows of numbers; whole lines only, the last of which may lack its end."""
        self._handle.seek(0)
        first = int(self._table.lines[0])
        for _ in range(first - 1):
            self._handle.readline()
        line = first
        left = b""
        while True:
            data = self._handle.read(_BLOCK)
            text = left + data
            end = text.rfind(b"\n") + 1 if data else len(text)
            text, left = text[:end], text[end:]
            if text.strip():
                yield self._parse(text, line)
            line += text.count(b"\n")
            if not data:
                return
            if len(left) > _BLOCK:
                raise FormatMismatchError(
                    f"{self._file.path}: line {line} is longer than {_BLOCK} bytes: no table"
                )

    def _parse(self, text: bytes, line: int) -> FloatArray:
        numbers = self._fast(text)
        if numbers is not None:
            return numbers
        return rows_as_columns(self._file, self._table, text, line, comment=self._comment)

    def _fast(self, text: bytes) -> FloatArray | None:
        """Return the rows of a block in which every line is plain, else ``None``."""
        separator, decimal = self._table.header["separator"], self._table.header["decimal"]
        if separator in {" ", ", "} or not _PLAIN.issuperset(text[:4096]) or b"\n\n" in text:
            return None
        n_lines = text.count(b"\n") + (not text.endswith(b"\n"))
        if text.count(separator.encode()) != n_lines * (self._table.header["n_fields"] - 1):
            return None
        if decimal == ",":
            text = text.replace(b",", b".")
        try:
            values = np.loadtxt(
                io.BytesIO(text),
                delimiter=separator,
                comments=None,
                usecols=range(len(self._table.names)),
                ndmin=2,
                encoding="latin-1",
            )
        except ValueError:
            return None
        return values if values.shape[0] == n_lines and np.isfinite(values).all() else None

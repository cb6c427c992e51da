"""`BatchReport`: what became of every unit of a batch."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from metrosep.batch.rows import STATUSES

__all__ = ["BatchReport"]


@dataclass(frozen=True, slots=True)
class BatchReport:
    """What became of every unit of a batch.

    Parameters
    ----------
    rows : tuple of mapping
        One for each unit that was finished, by its name, as `metrosep.batch.rows.row_of` gives
        it, with ``seconds`` and ``skipped``.
    counts : mapping of str to int
        By status; with ``total`` units found, ``skipped`` (done before) and ``open`` (not begun,
        since the batch was stopped).
    seconds : float, s
        Wall time.
    exit_code : int
        5 bug, 6 failed files, 1 rejected, 3 inconclusive, 0 accepted, 130 interrupted.
    messages : tuple of str
        What the user should know.
    out : Path, optional
        Output folder; None after a dry run.
    stopped : str, optional
        Why the batch ended early.
    document : mapping, optional
        Content of index.json.
    """

    rows: tuple[Mapping[str, Any], ...]
    counts: Mapping[str, int]
    seconds: float
    exit_code: int
    messages: tuple[str, ...] = ()
    out: Path | None = None
    stopped: str | None = None
    document: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def summary(self) -> str:
        """Return one line: how many of which status, and how long it took.

        Returns
        -------
        str
            Such as ``1000 units: 970 accepted, 20 rejected, 10 failed; 41.2 s``.
        """
        n = self.counts
        words = [f"{n[s]} {s}" for s in STATUSES if n.get(s)]
        words += [f"{n['open']} not begun"] if n.get("open") else []
        text = f"{n['total']} unit{'s' if n['total'] != 1 else ''}: {', '.join(words) or 'none'}"
        if n.get("skipped"):
            text += f" ({n['skipped']} done before)"
        text += f"; {self.seconds:.1f} s"
        return text + (f"; {self.stopped}" if self.stopped else "")

    def index(self, path: str | os.PathLike[str]) -> Path:
        """Write the index once more.

        Parameters
        ----------
        path : str or path
            File; its suffix says which format: ``.json``, ``.csv``, or one that is installed.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        DataError
            If nothing that is installed writes this format, or after a dry run.
        WriteError
            If it cannot be written.
        """
        from metrosep.batch.index import write_index
        from metrosep.core.errors import DataError

        if not self.document:
            raise DataError(f"{path}: this batch has no index; it was a dry run")
        target = Path(path)
        return write_index(self.document, target, target.suffix.lstrip(".").lower())

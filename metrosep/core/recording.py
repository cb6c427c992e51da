"""`Recording`: channels over time, as a data logger wrote them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import InvalidSamplesError, NameNotFoundError
from metrosep.core.profile import html_table
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.public import PublicObject, shortened


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording(PublicObject):
    """Channels sampled over time; frozen, SI, NaN = not measured.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Time, finite and strictly increasing.
    channels : mapping of str to array_like, shape (n,)
        Samples of each channel in SI.
    units : mapping of str to str, optional
        SI unit of each channel where it is known.
    metadata : mapping, optional
        What the file said.
    history : tuple of Step, optional
        Where it came from.

    Raises
    ------
    InvalidSamplesError
        If time is not strictly increasing or a channel has another length.

    Examples
    --------
    >>> Recording([0.0, 0.5], {"gap": [1e-6, 2e-6]}, units={"gap": "m"})
    Recording(2 samples over 0.5 s, channels gap [m])
    """

    t: FloatArray
    channels: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()

    def __init__(
        self,
        t: ArrayLike,
        channels: Mapping[str, ArrayLike],
        *,
        units: Mapping[str, str] | None = None,
        metadata: Mapping[str, Any] | None = None,
        history: tuple[Step, ...] = (),
    ) -> None:
        ts = frozen_float(t, name="t", ndim=1)
        if np.isnan(ts).any() or (ts[1:] <= ts[:-1]).any():
            raise InvalidSamplesError("time t must be finite and strictly increasing, in seconds")
        columns = {k: frozen_float(v, name=f"channel {k!r}", ndim=1) for k, v in channels.items()}
        for name, column in columns.items():
            if column.size != ts.size:
                raise InvalidSamplesError(
                    f"channel {name!r} has {column.size} samples, time has {ts.size}"
                )
        object.__setattr__(self, "t", ts)
        object.__setattr__(self, "channels", freeze_mapping(columns))
        object.__setattr__(self, "units", freeze_mapping(units))
        object.__setattr__(self, "metadata", freeze_mapping(metadata))
        object.__setattr__(self, "history", tuple(history))

    def __len__(self) -> int:
        return int(self.t.size)

    def __getitem__(self, name: str) -> FloatArray:
        try:
            return self.channels[name]
        except KeyError:
            known = ", ".join(self.channels) or "none"
            raise NameNotFoundError(f"no channel {name!r}; the recording has {known}") from None

    @property
    def duration(self) -> float:
        """Time from the first to the last sample in s."""
        return float(self.t[-1] - self.t[0])

    def _channel_names(self) -> str:
        return ", ".join(f"{n} [{self.units[n]}]" if n in self.units else n for n in self.channels)

    def __repr__(self) -> str:
        names = self._channel_names() or "none"
        return shortened(
            f"Recording({len(self)} samples over {self.duration:.6g} s, channels {names})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        return html_table(
            "Recording",
            {
                "samples": str(len(self)),
                "duration": f"{self.duration:.6g} s",
                "channels": self._channel_names(),
                "history": " → ".join(s.name for s in self.history) or "made in memory",
            },
        )

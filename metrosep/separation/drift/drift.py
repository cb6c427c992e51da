"""Drift: ranges after ISO 230-3, Allan deviation, and the cures, A-B-B-A and the joint fit.

Displacements are error = actual - nominal of the tool against the work, positive apart. A range is
the largest minus the smallest reading in a stated window of time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.methods import Readings, RoleColumns
from metrosep.core.numbers import real
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.separation._readings import (
    NOISE_UNKNOWN,
    as_numbers,
    checked_sd,
    known_parts,
    part_of,
)
from metrosep.separation.contract import (
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    StoredResult,
    Unobservable,
    as_stated,
    not_known,
    type_a,
)
from metrosep.separation.drift.alternation import in_time
from metrosep.separation.runs.joint_method import JointDrift, joint_drift

if TYPE_CHECKING:
    import pandas as pd

_DISPLACEMENT = 10e-3
"""m; no machine in use drifts further, but readings in um passed as m do."""

_TILT = 10e-3
"""rad; the same for channels in rad."""

_TESTS = {
    "environment": "environmental temperature variation error (ETVE)",
    "spindle": "thermal distortion by the rotating spindle",
    "axis": "thermal distortion by moving a linear axis",
}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriftTest(StoredResult):
    """Drift ranges of one test.

    Parameters
    ----------
    kind : str
        ``"environment"``, ``"spindle"`` or ``"axis"``.
    windows : tuple of (float, float), s
        Start and end of each window.
    ranges : mapping of str to tuple of Quantity
        Range of each channel in each window, m (rad for channels in rad).
    combined : tuple of Quantity
        Root of the sum of squared ranges of the channels in m, by window.
    worst : mapping of str to Quantity
        Largest range of each channel within any window of `span`; empty without `span`.
    span : float, s
        Length of the sliding window; NaN without.
    t : ndarray, shape (n,), s
        Times.
    channels : mapping of str to ndarray, shape (n,)
        Readings as given.
    audit : mapping
        Counts and noise, plain values.
    messages : tuple of str
        What the user should know.
    """

    kind: str
    windows: tuple[tuple[float, float], ...]
    ranges: Mapping[str, tuple[Quantity, ...]]
    combined: tuple[Quantity, ...]
    worst: Mapping[str, Quantity]
    span: float
    t: FloatArray
    channels: Mapping[str, FloatArray]
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    _stored: ClassVar[tuple[str, ...]] = (
        "kind", "windows", "ranges", "combined", "worst", "span", "audit", "messages",
    )  # fmt: skip

    def to_frame(self) -> pd.DataFrame:
        """Return the ranges as rows: ``start_min``, ``stop_min``, ``channel``, ``range_um``, ``u_um``.

        The channel ``combined`` is the root of the sum of squares; channels in rad are in urad.
        """
        import pandas as pd

        rows = []
        for i, (start, stop) in enumerate(self.windows):
            cells = [(name, q[i]) for name, q in self.ranges.items()]
            rows += [
                {
                    "start_min": start / 60.0,
                    "stop_min": stop / 60.0,
                    "channel": name,
                    "range_um": q.value * 1e6,
                    "u_um": math.nan if q.u is None else q.u * 1e6,
                }
                for name, q in [*cells, ("combined", self.combined[i])]
            ]
        return pd.DataFrame(rows)

    def __repr__(self) -> str:
        each = ", ".join(str(q) for q in self.combined)
        return f"DriftTest({self.kind}, {len(self.ranges)} channels, combined {each})"


def iso230_3_drift(
    t: ArrayLike | Recording,
    channels: Mapping[str, ArrayLike] | Sequence[str] | None = None,
    *,
    kind: str = "environment",
    windows: Sequence[tuple[float, float]] | None = None,
    span: float | None = None,
    sd: float | None = None,
    angular: Sequence[str] = (),
) -> DriftTest:
    """Return drift ranges by axis and combined, over stated windows of time.

    Parameters
    ----------
    t : array_like, shape (n,), s, or Recording
        Times, strictly increasing.
    channels : mapping of str to array_like, shape (n,), m; or names of channels of the recording
        Displacements by name, such as ``{"EX0C": ..., "EY0C": ...}``; NaN where not measured.
        All channels of a recording if omitted.
    sd : float, m, optional
        Standard deviation of one reading. Without it, from the second differences of each channel.
    angular : sequence of str, optional
        Channels in rad: they are reported, and take no part in the combined range.

    Returns
    -------
    DriftTest
        ``ranges[name][i]``, ``combined[i]``, ``worst[name]``.

    Raises
    ------
    DataError
        If kind, span, sd or a name is not known or out of range, or there is no channel.
    InvalidSamplesError
        If times do not increase, lengths differ, or a window is turned round or outside.
    TooFewSamplesError
        If a window holds fewer than 2 readings of a channel.

    Notes
    -----
    Combined: ``sqrt(R_x^2 + R_y^2 + R_z^2)``. u: two readings make a range, so ``u = sd sqrt(2)``;
    noise also widens a range by itself, about ``2 sd sqrt(2 ln n)``, and a message says where that
    is a fifth of the range. The second-difference noise counts all that is faster than the sampling.

    Null space: drift common to tool and work, and drift of the sensor and its fixture (cap test).

    References
    ----------
    .. [1] ISO 230-3:2020 (ETVE, spindle, axis tests; clause numbers not verified).

    Examples
    --------
    >>> t = np.arange(0.0, 7200.0, 60.0)
    >>> test = iso230_3_drift(t, {"EX0C": 3e-6 * t / t[-1], "EZ0C": -4e-6 * t / t[-1]})
    >>> round(test.combined[0].value * 1e6, 6)
    5.0
    """
    if kind not in _TESTS:
        raise DataError(f"kind is one of {', '.join(_TESTS)}, got {kind!r}")
    sd = checked_sd(sd, "m")
    times, table = _table(t, channels)
    unknown = [name for name in angular if name not in table]
    if unknown:
        raise DataError(f"angular names {unknown[0]!r}, channels are {', '.join(table)}")
    spans = _windows(windows, times)
    noise = {name: _noise(z) if sd is None else sd for name, z in table.items()}
    ranges = {
        name: tuple(
            _range(name, times, z, w, noise[name], "rad" if name in angular else "m", kind)
            for w in spans
        )
        for name, z in table.items()
    }
    linear = [q for name, q in ranges.items() if name not in angular]
    combined = tuple(_combined([q[i] for q in linear], kind) for i in range(len(spans)))
    length = math.nan if span is None else real(span, "span", dimension="time")
    worst = {} if span is None else _worst(times, table, length, noise, angular)
    return DriftTest(
        kind=kind,
        windows=spans,
        ranges=ranges,
        combined=combined,
        worst=worst,
        span=length,
        t=times,
        channels=table,
        audit={
            "kind": _TESTS[kind],
            "windows_min": [[a / 60.0, b / 60.0] for a, b in spans],
            "noise_sd_nm": {name: v * 1e9 for name, v in noise.items()},
            "noise_from": "given" if sd is not None else "second differences",
        },
        messages=tuple(_messages(times, table, ranges, noise, angular)),
    )


def _table(
    t: ArrayLike | Recording, channels: Mapping[str, ArrayLike] | Sequence[str] | None
) -> tuple[FloatArray, dict[str, FloatArray]]:
    data: Mapping[str, ArrayLike]
    if isinstance(t, Recording):
        if isinstance(channels, Mapping):
            raise DataError(
                "a Recording holds its channels: name them in a list, or leave them out"
            )
        data = {n: t[n] for n in (t.channels if channels is None else channels)}
        times = t.t
    else:
        if not isinstance(channels, Mapping):
            raise DataError("pass channels as a mapping of names to readings, in m")
        times = frozen_float(t, name="t", ndim=1, min_size=2)
        data = channels
    if np.isnan(times).any() or (np.diff(times) <= 0.0).any():
        raise InvalidSamplesError("t must be finite and strictly increasing, in seconds")
    if not data:
        raise DataError("no channel was given")
    table = {}
    for name, values in data.items():
        table[name] = frozen_float(values, name=f"channel {name!r}", ndim=1)
        if table[name].size != times.size:
            raise InvalidSamplesError(
                f"channel {name!r} has {table[name].size} readings, t has {times.size}"
            )
    return times, table


def _windows(
    windows: Sequence[tuple[float, float]] | None, times: FloatArray
) -> tuple[tuple[float, float], ...]:
    first, last = float(times[0]), float(times[-1])
    if windows is None:
        return ((first, last),)
    try:
        found = tuple((float(a), float(b)) for a, b in windows)
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"windows must be pairs (start, stop) in seconds, got {windows!r}"
        ) from None
    for a, b in found:
        if not (a < b and b > first and a < last):
            raise InvalidSamplesError(
                f"window {a:g} to {b:g} s does not lie in the record, {first:g} to {last:g} s; times "
                "are seconds"
            )
    if not found:
        raise DataError("windows is empty; leave it out for the whole record")
    return found


def _noise(z: FloatArray) -> float:
    """Return the standard deviation of one reading from second differences; drift drops out."""
    second = z[2:] - 2.0 * z[1:-1] + z[:-2]
    second = second[~np.isnan(second)]
    return math.sqrt(float(second @ second) / second.size / 6.0) if second.size else math.nan


def _range(
    name: str,
    times: FloatArray,
    z: FloatArray,
    window: tuple[float, float],
    sd: float,
    unit: str,
    kind: str,
) -> Quantity:
    inside = z[(times >= window[0]) & (times <= window[1])]
    inside = inside[~np.isnan(inside)]
    if inside.size < 2:
        raise TooFewSamplesError(
            f"channel {name!r} has {inside.size} reading(s) from {window[0]:g} to {window[1]:g} s; a "
            "range needs 2"
        )
    text = (
        f"range of {name}, {window[0] / 60:g} to {window[1] / 60:g} min, {_TESTS[kind]}, ISO 230-3"
    )
    u = None if math.isnan(sd) else math.sqrt(2.0) * sd
    return Quantity(float(np.ptp(inside)), unit, text, u, name)


def _combined(ranges: Sequence[Quantity], kind: str) -> Quantity:
    text = f"root of the sum of squared ranges, {_TESTS[kind]}, ISO 230-3"
    if not ranges:
        return Quantity(math.nan, "m", text, None, "combined")
    value = math.sqrt(sum(q.value**2 for q in ranges))
    if value == 0.0 or any(q.u is None for q in ranges):
        return Quantity(value, "m", text, None, "combined")
    u = math.sqrt(sum((q.value * (q.u or 0.0)) ** 2 for q in ranges)) / value
    return Quantity(value, "m", text, u, "combined")


def _worst(
    times: FloatArray,
    table: Mapping[str, FloatArray],
    span: float,
    noise: Mapping[str, float],
    angular: Sequence[str],
) -> dict[str, Quantity]:
    if not (math.isfinite(span) and 0.0 < span <= float(times[-1] - times[0])):
        raise DataError(f"span must be positive and within the record, in s, got {span}")
    found = {}
    for name, z in table.items():
        value = largest_range(times, z, span)
        u = None if math.isnan(noise[name]) else math.sqrt(2.0) * noise[name]
        unit = "rad" if name in angular else "m"
        text = f"largest range of {name} within any {span / 60:g} min, ISO 230-3"
        found[name] = Quantity(value, unit, text, u, name)
    return found


class DriftOfChannels(NamedMethod):
    """`iso230_3_drift` by its name."""

    name = "iso230_3_drift"
    what = "thermal drift of several channels over windows of time, ISO 230-3"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {"time": "time", "readings": "length*"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "kind": Option(
            "text",
            choices=("environment", "spindle", "axis"),
            help="which test of ISO 230-3: only names the result",
        ),
        "windows": Option(
            "windows", help="in which the drift is judged; those of the test if omitted"
        ),
        "span": Option(
            "time",
            help="also report the largest range within any window of this length (3600: per hour)",
        ),
        "sd": Option("uncertainty", help="standard deviation of one reading"),
        "names": Option("texts", help="of the channels; those of the columns if omitted"),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> DriftTest:
        """Return the drift of the columns of readings."""
        rest = dict(options)
        names = rest.pop("names", None) or data.columns["readings"]
        columns = data.values["readings"]
        if len(names) != len(columns):
            raise DataError(f"{len(names)} names for {len(columns)} readings; give one for each")
        return iso230_3_drift(data.values["time"], dict(zip(names, columns, strict=True)), **rest)


def largest_range(times: FloatArray, z: FloatArray, span: float) -> float:
    """Return the largest range within any window of a length."""
    from collections import deque

    valid = np.flatnonzero(~np.isnan(z))
    high: deque[int] = deque()
    low: deque[int] = deque()
    best, start = math.nan, 0
    reach = span * (1.0 + 1e-12)
    for i in valid:
        while high and z[high[-1]] <= z[i]:
            high.pop()
        while low and z[low[-1]] >= z[i]:
            low.pop()
        high.append(int(i))
        low.append(int(i))
        while times[i] - times[valid[start]] > reach:
            start += 1
        while high[0] < valid[start]:
            high.popleft()
        while low[0] < valid[start]:
            low.popleft()
        if i > valid[start]:
            width = float(z[high[0]] - z[low[0]])
            best = width if math.isnan(best) else max(best, width)
    return best


def _messages(
    times: FloatArray,
    table: Mapping[str, FloatArray],
    ranges: Mapping[str, tuple[Quantity, ...]],
    noise: Mapping[str, float],
    angular: Sequence[str],
) -> list[str]:
    said = []
    for name, z in table.items():
        largest = max(q.value for q in ranges[name])
        limit, unit = (_TILT, "rad") if name in angular else (_DISPLACEMENT, "m")
        if largest > limit:
            said.append(
                f"{name}: the range of {largest:.4g} {unit} is more than {limit:g} {unit}, too much "
                f"for drift: are the readings in {unit}?"
            )
        missing = int(np.isnan(z).sum())
        if missing:
            said.append(f"{name}: {missing} of {z.size} readings were not measured: omitted")
        widening = 2.0 * noise[name] * math.sqrt(2.0 * math.log(max(times.size, 2)))
        smallest = min(q.value for q in ranges[name])
        if widening > 0.2 * smallest and widening > 0.0:
            said.append(
                f"{name}: noise widens the range by up to {widening * 1e9:.3g} nm; average first"
            )
    said.append("drift of the sensor and its fixture is in the ranges: subtract a cap test")
    return said


# ---- `DriftFit`: quantities measured again and again, and the drift, from one least-squares fit ----
# ``reading_i = value[label_i] + drift(t_i)``; the drift is zero at the reference time.

_LEVEL = "drift and quantities share their zero: drift is counted from the reference time"
_FOLLOWS = "what changes in step with the labels looks like the quantities"


@dataclass(frozen=True, slots=True)
class DriftFit(RecordedMethod):
    """Readings at stated times of quantities with stated names.

    Parameters
    ----------
    t : tuple of float, s
        Times, rising.
    labels : tuple of str
        What was measured at each; ``tuple("ABBA")``.

    Raises
    ------
    DataError
        If degree, pieces or reference are out of range.
    InvalidSamplesError
        If times do not rise, or there is not one label for each.
    NotSeparableError
        If drift and quantities cannot be distinguished at these times and labels.
    TooFewSamplesError
        If there are fewer readings than unknowns.

    Notes
    -----
    Readings (n_times, ...) in m, one (number, profile, map) for each time. Parts: ``values``
    (n_labels, ...) at the reference time, in the order in which the labels first occur; ``drift``
    (n_times, ...). `joint_drift` does the work and has the covariance that differences need: all
    values share the drift. The noise is pooled over the points, u is that of each point.

    Examples
    --------
    >>> found = DriftFit((0.0, 1.0, 2.0, 3.0), tuple("ABBA")).separate([[7.0], [3.1], [3.2], [7.3]])
    >>> found.values.round(9).tolist(), found.drift.round(9).ravel().tolist()
    ([[7.0], [3.0]], [0.0, 0.1, 0.2, 0.3])
    """

    t: tuple[float, ...]
    labels: tuple[str, ...]
    degree: int = option(1, kind="integer", help="of the polynomial in time that the drift is")
    n_pieces: int | None = option(
        None, kind="integer", help="pieces of a cubic spline in place of a polynomial"
    )
    reference: float | None = option(
        None, kind="time", help="time at which the drift is zero; the first one if omitted"
    )

    name = "joint_drift"
    what = "repeated quantities and the drift between them, from one fit over time"
    roles: ClassVar[Mapping[str, str]] = {"time": "time?", "label": "label?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "times": Option("times", help="of the columns, where they follow each other in time"),
        "labels": Option("texts", help="what was measured each time; one quantity if omitted"),
        "sd": Option("uncertainty", help="standard deviation of one reading"),
    }
    truth_parts = ("values",)
    error_parts = ("drift",)

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> JointDrift:
        """Return the quantities and the drift of rows or columns that follow each other in time."""
        rest = dict(options)
        readings, t = in_time(data)
        times, labels = rest.pop("times", None), rest.pop("labels", None)
        t = times if t is None else t
        if t is None:
            raise FormatMismatchError(
                'times are needed: time = "t_s" in [input] where rows follow each other in time, or '
                'times = ["0 s", "30 s"] in the step where columns do'
            )
        if "label" in data.extra:
            labels = data.extra["label"][0].tolist()
        return joint_drift(t, readings, labels, **rest)

    def __post_init__(self) -> None:
        self._fit(np.zeros((len(self.t), 1)), None)

    def _fit(self, readings: FloatArray, sd: float | None) -> JointDrift:
        return joint_drift(
            self.t,
            readings,
            self.labels,
            degree=self.degree,
            n_pieces=self.n_pieces,
            reference=self.reference,
            sd=sd,
        )

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        known = list(dict.fromkeys(self.labels))
        points = next(iter(parts.values())).shape[1:]
        values = part_of(parts, "values", (len(known), *points), self.name)
        drift = part_of(parts, "drift", (len(self.t), *points), self.name)
        return values[[known.index(label) for label in self.labels]] + drift

    def null_space(self) -> tuple[Unobservable, ...]:
        return (
            Unobservable("values", "term", ("in step with the labels",), _FOLLOWS),
            Unobservable("drift", "term", ("level",), _LEVEL),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        if array.ndim < 2 or array.shape[0] != len(self.t) or 0 in array.shape:
            raise InvalidSamplesError(
                f"{self.name}: there are {len(self.t)} times; the readings need the shape "
                f"({len(self.t)}, points), got {array.shape}"
            )
        fit = self._fit(array, stated)
        noise = _method_noise(fit, stated)
        messages = [m for m in fit.messages if "sd=" not in m]
        if math.isnan(noise.value):
            messages.append(NOISE_UNKNOWN)
        return Separation(
            self.name,
            {"values": fit.values, "drift": fit.drift},
            {"values": fit.u, "drift": fit.u_drift},
            {"values": "m", "drift": "m"},
            {"time": fit.t},
            self.null_space(),
            noise=noise,
            audit={**fit.audit, "labels": [str(label) for label in fit.labels]},
            messages=tuple(messages),
            history=(*history, Step(self.name, {"model": fit.audit["model"]})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further times."""
        return model


def _method_noise(fit: JointDrift, stated: float | None) -> Quantity:
    known = fit.sd[np.isfinite(fit.sd)]
    if stated is not None or not known.size:
        return not_known("m") if stated is None else as_stated(stated, "m")
    freedom = (fit.audit["n_readings"] - fit.audit["n_unknowns"]) * known.size
    text = "standard deviation of one reading, from the residuals (type A)"
    return type_a(math.sqrt(float(np.mean(known**2))), "m", text, freedom)

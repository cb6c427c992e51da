"""Voltages for a piezo-driven flexure: CSV of position or time and of what a DAC puts out.

The stage stands at d = d_off + polarity x c, with c = -e; the voltage is the monotone inverse of its
calibration, rounded to the steps of the DAC. Reading turns voltages back into corrections through
the same calibration, which the sidecar holds.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import is_described, read_table, settled
from metrosep.controllers._grammar import (
    NUMBER,
    Line,
    Word,
    damaged,
    decoded,
    joined,
    row_of,
    scaled,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    identity,
    load_sidecar,
    looked_up,
    sidecar_options,
)
from metrosep.controllers.options import Option, pick, whole
from metrosep.controllers.waves import (
    PLAYBACK_OPTIONS,
    STATED,
    Playback,
    encoded,
    plan,
    read_wave,
    sampled,
)
from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError
from metrosep.core.units import format_ends, format_length, parse_sensitivity
from metrosep.process.flexure import FlexureCalibration

_DECIMALS = 9
"""Of a voltage: 1 nV, far below a step of 24 bits of 10 V."""
_HEADERS = (
    ("position_mm", "voltage_V"),
    ("position_mm", "voltage_forward_V", "voltage_reverse_V"),
    ("time_s", "voltage_V"),
)
_VOLT = Word(rf"-?\d+\.\d{{{_DECIMALS}}}", float, f"{{:.{_DECIMALS}f}}".format)
"""As it is written: with fewer decimals it was cut."""
_ROW = Line("{at},{volts}", at=NUMBER, volts=row_of(_VOLT, ","))
_ROUGH = 2.0
"""Steps of the DAC that rounding and the branches of the hysteresis may cost without a word."""
_SHARED = {"polarity", "motion", "speed", "start", "direction", "start_angle", "points", "rotation", "closing"}  # fmt: skip
_UNIFORM = 1e-6
"""Times may differ from a uniform clock by this part of its period: they are printed decimals."""


class Voltage(Dialect):
    """Writer and reader of voltage tables; see the module."""

    info = DialectInfo(
        id="voltage",
        title="Voltages through a flexure calibration (CSV)",
        entry="V(d_off + polarity x correction), V the inverse of the calibration: -e is added",
        units="mm or s, V",
        outside="first and last entry are held; a turn repeats",
        sign_status="the calibration says where the stage goes; which way it moves the tool is "
        "yours to state (polarity)",
        activation=(
            "hold the stage at the first voltage before the axis moves: it must not jump",
            "position table: give it to what follows the encoder, linear between the entries",
            "time table: put one line out per period of the DAC, from the start on at the stated speed",
            "try it once with the tool off the part: the stage must move against the error",
        ),
        sign="stated",
        resolution="a step of the DAC through the steepest slope of the calibration",
        reference_rule="none: the offset may stand anywhere in the stroke",
        proof="own strict parser; the calibration evaluated at the printed voltages",
        suffix=".csv",
        example={"polarity": 1, "calibration": "1.66 um/V"},
        page="voltage",
    )
    options = (
        *(o for o in PLAYBACK_OPTIONS if o.name in _SHARED),
        Option(
            "calibration",
            "calibration of the stage, its stored form (a mapping, or its JSON text on the command line), "
            "or the sensitivity such as '1.66 um/V'",
            "object",
            required=True,
        ),
        pick("branch", "of the hysteresis: mean, up, down, or sweep (up where the voltage rises, else down)", ("mean", "up", "down", "sweep"), default="mean"),
        Option("offset", "where the stage rests (d_off); middle of its stroke if omitted", "length"),
        pick("over", "what the table is over", ("position", "time"), default="position"),
        Option("sample_time", "period of the DAC, over time", "time", default=1e-3, positive=True),
        Option("v_min", "lowest voltage the amplifier takes", "voltage", default=0.0),
        Option("v_max", "highest voltage the amplifier takes", "voltage", default=10.0),
        whole("bits", "of the DAC over v_min ... v_max", 4, 24, default=16),
        Option("slew", "fastest change of the voltage, V/s", "number", positive=True),
        Option("current", "of the amplifier's output, A", "number", positive=True),
        Option("capacitance", "of the piezo, F", "number", positive=True),
        Option("gain", "output voltage over input voltage", "number", default=1.0, positive=True),
        Option("bandwidth", "up to which the stage follows", "frequency", positive=True),
    )  # fmt: skip

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        curves, rest, polarity = _curves(options), _rest(options), options["polarity"]
        if options["over"] == "time":
            return _over_time(table, curves, rest, options)
        if is_rotary(table.axis):
            raise TableError(
                f"positions of {table.axis} are angles, the file holds mm; write it over='time' with "
                "motion='turn'"
            ).hinting(over="time", motion="turn")
        columns = [(table.forward, 1)]
        if table.reverse is not None or options["branch"] == "sweep":
            reverse = table.forward if table.reverse is None else table.reverse
            columns.append((reverse, -1))
        volts, back = [], []
        for values, way in columns:
            ordered = slice(None, None, way)
            v = quantised(
                rest + polarity * values[ordered],
                curves,
                options["bits"],
                table.positions[ordered],
            )
            volts.append(v[ordered])
            back.append(_corrections(v, curves, rest, polarity)[ordered])
        rates = _rates(table.positions, volts, options)
        header = _HEADERS[len(columns) - 1]
        rows = zip(map(_mm, table.positions), zip(*volts, strict=True), strict=True)
        wanted = [c for c, _ in columns]
        error = float(np.max(np.abs(np.array(back) - np.array(wanted))))
        data = _text(header, rows)
        step = _step(curves, options["bits"])
        return Encoded(
            data=data,
            findings=_warnings(error, step),
            quantisation=error,
            notes=_notes(curves, rest, rates, volts),
            step=step,
            carried=replace(table, reverse=None if len(wanted) == 1 else wanted[1]),
            resampling_error=self._between(data, table, options),
        )

    def _between(self, data: bytes, table: CompensationTable, options: dict[str, Any]) -> float:
        """Return how far the played voltages are from the table, also between entries."""
        lookup = self.lookup(data, Path(os.devnull), **options)
        p = table.positions
        places = (p[:-1, None] + np.diff(p)[:, None] * np.array([0.25, 0.5, 0.75])).ravel()
        return max(
            float(np.abs(lookup(places, way) - table.correction(places, way)).max())
            for way in (1, -1)
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the corrections that the voltages make."""
        known, header, rows = self._read(data, path, options)
        curves, rest = _curves(known), _rest(known)
        if header[0] == "time_s":
            play, values = _played(rows, known, curves, rest, path)
            return read_wave(play, values, path)
        positions = rows[:, 0] * 1e-3
        columns = [_corrections(rows[:, 1], curves, rest, known["polarity"])]
        if len(header) == 3:
            falling = _corrections(rows[::-1, 2], curves, rest, known["polarity"])
            columns.append(falling[::-1])
        return read_table(
            positions,
            columns[0],
            columns[1] if len(columns) == 2 else None,
            **identity(path, first=float(positions[0])),
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the stage adds, as the voltages make it."""
        known, header, rows = self._read(data, path, options)
        curves, rest, polarity = _curves(known), _rest(known), known["polarity"]
        if header[0] == "time_s":
            play, values = _played(rows, known, curves, rest, path)
            return play.lookup(values)
        at = rows[:, 0] * 1e-3
        rising = {1: rising_parts(rows[:, 1]), -1: rising_parts(rows[::-1, -1])[::-1]}

        def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
            (p,), d = looked_up((position,), direction)
            found = []
            for way, column in ((1, 1), (-1, rows.shape[1] - 1)):
                v = np.interp(p.ravel(), at, rows[:, column])
                # an interval belongs to the sample at its end, in the direction of motion
                right = np.searchsorted(at, p.ravel(), side="left" if way > 0 else "right")
                end = np.clip(right if way > 0 else right - 1, 0, at.size - 1)
                stage = curves.displacement(v, rising[way][end])
                found.append(polarity * (stage - rest).reshape(p.shape))
            return np.asarray(np.where(d > 0, *found))

        return along

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[dict[str, Any], tuple[str, ...], FloatArray]:
        given = dict(options)
        if given.get("calibration") is None:
            given["calibration"] = load_sidecar(path).get("calibration")
        header, rows = _parsed(data, path)
        needed: tuple[str, ...] = ("polarity", "calibration", "offset")
        if header[0] == "time_s":
            given.setdefault("over", "time")
            motion = given.get("motion") or sidecar_options(path, self.options).get(
                "motion", "pass"
            )
            needed += STATED[motion]
        known = settled(
            self.options, given, path, needed=() if is_described(path) else needed, file={}
        )
        if known["over"] != header[0].split("_")[0]:
            raise DataError(
                f"{path}: over={known['over']!r} was given, the file is over {header[0].split('_')[0]}; leave "
                "over= away, or look for the file that fits"
            )
        outside = (rows[:, 1:] < known["v_min"] - 1e-8) | (rows[:, 1:] > known["v_max"] + 1e-8)
        if outside.any():
            i = int(np.argmax(outside.any(axis=1)))
            raise CorruptFileError(
                path,
                f"line {i + 2}: a voltage outside the amplifier's range",
                expected=f"{known['v_min']:g} ... {known['v_max']:g} V",
                found=", ".join(f"{v:g}" for v in rows[i, 1:]),
            )
        return known, header, rows


def _curves(options: dict[str, Any]) -> StageCurves:
    return StageCurves.of(
        options["calibration"], options["branch"], float(options["v_min"]), float(options["v_max"])
    )


def _rest(options: dict[str, Any]) -> float:
    if options.get("offset") is not None:
        return float(options["offset"])
    return float(sum(_curves(options).stroke) / 2.0)


def _corrections(v: FloatArray, curves: StageCurves, rest: float, polarity: int) -> FloatArray:
    """Return corrections of voltages in the order in which they are passed."""
    return polarity * (curves.displacement(v, rising_parts(v)) - rest)


def _over_time(
    table: CompensationTable, curves: StageCurves, rest: float, options: dict[str, Any]
) -> Encoded:
    period, polarity = options["sample_time"], options["polarity"]
    play, values = sampled(table, {**options, "rate": 1}, period=period, interpolates=False)
    places = play.positions()
    volts = quantised(rest + polarity * values, curves, options["bits"], places)
    back = _corrections(volts, curves, rest, polarity)
    times = period * np.arange(play.n)
    rates = _rates(times, [volts], {**options, "speed": 1.0})
    rows = zip((scaled(round(t, 12), 0) for t in times), zip(volts, strict=True), strict=True)
    error, step = float(np.abs(back - values).max()), _step(curves, options["bits"])
    return encoded(
        _text(("time_s", "voltage_V"), rows), play, values, table, options,
        findings=_warnings(error, step),
        quantisation=error,
        notes=_notes(curves, rest, rates, [volts]),
        step=step,
    )  # fmt: skip


def _played(
    rows: FloatArray, known: dict[str, Any], curves: StageCurves, rest: float, path: Path
) -> tuple[Playback, FloatArray]:
    times = rows[:, 0]
    period = float(times[-1] - times[0]) / (times.size - 1)
    uneven = np.abs(times - period * np.arange(times.size))
    if uneven.max() > _UNIFORM * period:
        raise damaged(
            path, f"line {int(np.argmax(uneven)) + 2}: times are not those of a clock from 0 on"
        )
    play = plan({**known, "rate": 1}, period=period, interpolates=False, n=times.size)
    return play, _corrections(rows[:, 1], curves, rest, known["polarity"])


def _rates(places: FloatArray, volts: list[FloatArray], options: dict[str, Any]) -> dict[str, Any]:
    """Return how fast the voltage changes, and refuse what amplifier or stage cannot follow."""
    limit = _slew_limit(options)
    speed = options.get("speed")
    if speed is None:
        if limit is not None or options.get("bandwidth") is not None:
            raise DataError(
                "a limit of slew, current or bandwidth needs speed= of the axis: a table over "
                "position knows no time"
            )
        return {"largest_slew_V_per_s": None}
    slews = [np.abs(np.diff(v)) / np.diff(places) * speed for v in volts]
    largest = max(float(s.max()) for s in slews)
    half = max(float(np.ptp(v)) for v in volts) / 2.0
    equal = largest / (2.0 * math.pi * half) if half > 0.0 else 0.0
    if limit is not None and largest > limit:
        i = int(np.argmax(max(slews, key=lambda s: float(s.max()))))
        raise LimitError(
            f"between entries {i} and {i + 1} the voltage changes by {largest:.6g} V/s, the amplifier "
            f"makes {limit:.6g} V/s; drive {limit / largest:.3g} times as fast, or drop the shortest "
            "wavelengths (shortest=)"
        )
    if options.get("bandwidth") is not None and equal > options["bandwidth"]:
        raise LimitError(
            f"the voltage changes like a sine of {equal:.6g} Hz over its whole range, the stage "
            f"follows to {options['bandwidth']:.6g} Hz; drive slower, or drop the shortest wavelengths"
        )
    return {
        "largest_slew_V_per_s": largest,
        "slew_limit_V_per_s": limit,
        "equivalent_frequency_Hz": equal,
        "largest_frequency_of_full_stroke_Hz": None
        if limit is None or half == 0.0
        else limit / (2.0 * math.pi * half),
    }


def _slew_limit(options: dict[str, Any]) -> float | None:
    """Return the fastest change of the input voltage: as stated, or I / (C gain)."""
    current, capacitance = options.get("current"), options.get("capacitance")
    if (current is None) != (capacitance is None):
        raise DataError("current= of the amplifier and capacitance= of the piezo belong together")
    found = [options["slew"]] if options.get("slew") is not None else []
    if current is not None:
        found.append(float(current) / (float(capacitance or 0.0) * float(options["gain"])))
    return min(map(float, found)) if found else None


def _step(curves: StageCurves, bits: int) -> float:
    return (curves.high - curves.low) / float(2**bits - 1) * curves.steepest


def _notes(
    curves: StageCurves, rest: float, rates: dict[str, Any], volts: list[FloatArray]
) -> dict[str, Any]:
    low, high = curves.stroke
    return {
        "calibration": curves.stored(),
        "drive": {
            "offset_um": rest * 1e6,
            "stroke_um": [low * 1e6, high * 1e6],
            "first_voltage_V": float(volts[0][0]),
            "voltages_V": [min(float(v.min()) for v in volts), max(float(v.max()) for v in volts)],
            **rates,
        },
    }


def _mm(value: float) -> str:
    return scaled(round(float(value), 15), 3)


def _warnings(quantisation: float, step: float) -> tuple[Finding, ...]:
    """Return a warning if the voltages miss the corrections by more than rounding can."""
    if quantisation <= _ROUGH * step:
        return ()
    return (
        Finding.warning(
            f"the voltages miss the corrections by up to {format_length(quantisation, digits=3)}, a step of "
            f"the DAC is {format_length(step, digits=3)}: the branches of the calibration do not fit",
            "check which sweep is up and which is down, use more positions, or branch='mean'",
            "quantisation",
        ),
    )


def _text(header: tuple[str, ...], rows: Iterable[tuple[str, tuple[float, ...]]]) -> bytes:
    return joined([",".join(header), *(_ROW.write(at=at, volts=volts) for at, volts in rows)])


def _parsed(data: bytes, path: Path) -> tuple[tuple[str, ...], FloatArray]:
    first, *lines = decoded(data, path, "CSV of voltages").splitlines() or [""]
    header = tuple(first.split(","))
    if header not in _HEADERS:
        raise CorruptFileError(
            path,
            "not a voltage table",
            field="header",
            expected=" or ".join(",".join(h) for h in _HEADERS),
            found=",".join(header)[:80],
        )
    rows = []
    for i, line in enumerate(lines, start=2):
        found = _ROW.read(line)
        if found is None or len(found["volts"]) != len(header) - 1:
            raise CorruptFileError(
                path,
                f"line {i} does not hold {len(header)} decimal numbers, voltages with {_DECIMALS} decimals",
                found=line[:60] or "nothing",
                hint="no exponent, no blank line, a point as the decimal sign; cut or edited: write it "
                "again",
            )
        rows.append([found["at"], *found["volts"]])
    if not data.endswith(b"\n"):
        raise damaged(path, "its last line has no end: it was cut short")
    if len(rows) < 2:
        raise CorruptFileError(path, "a table needs at least 2 lines", found=len(rows))
    numbers = np.array(rows)
    falling = np.flatnonzero(np.diff(numbers[:, 0]) <= 0)
    if falling.size:
        raise CorruptFileError(path, f"line {int(falling[0]) + 3}: {header[0]} does not rise")
    return header, numbers


# ---- displacement of a piezo stage over its drive voltage, both branches, and what a DAC makes of it ----
# A calibration is a `FlexureCalibration`, its stored form (a mapping of voltages and displacements,
# as the sidecar holds it, also as JSON text), or a sensitivity such as ``"1.66 um/V"`` of a stage that is at 0 at 0 V.

_CURVES = ("mean", "up", "down")
_UM = 1e-6
_LEAD = 1e-3
"""Of the stroke: noise of two sweeps without hysteresis; more is a loop that is run backwards."""
_SLACK = 1e-9
"""Of a range: closer than this to its end is inside."""


@dataclass(frozen=True, slots=True, eq=False)
class StageCurves:
    """What converts displacements and voltages of a stage."""

    calibration: FlexureCalibration | float  # or float: curves, or sensitivity in m/V
    # {"mean", "up", "down", "sweep"}: curve to use; "sweep" takes "up" where the voltage rises and
    # "down" where it falls
    branch: str
    low: float  # V: range of the amplifier's input
    high: float

    @property
    def voltages(self) -> tuple[float, float]:
        """Voltages that are both calibrated and within the amplifier's range, V."""
        if isinstance(self.calibration, float):
            return self.low, self.high
        known = self.calibration.voltage
        low, high = max(self.low, float(known[0])), min(self.high, float(known[-1]))
        if not high > low:
            raise DataError(
                f"the calibration covers {known[0]:.6g} ... {known[-1]:.6g} V, the amplifier "
                f"{self.low:.6g} ... {self.high:.6g} V: they do not overlap"
            )
        return low, high

    @property
    def stroke(self) -> tuple[float, float]:
        """Displacements that the mean curve reaches within `voltages`, m, rising."""
        ends = self.displacement(np.array(self.voltages), None)
        return float(ends.min()), float(ends.max())

    @property
    def steepest(self) -> float:
        """Largest slope of displacement over voltage, absolute, m/V."""
        if isinstance(self.calibration, float):
            return abs(self.calibration)
        v = np.linspace(*self.voltages, 2001)
        return float(np.abs(np.diff(self.displacement(v, None)) / np.diff(v)).max())

    def displacement(self, voltage: FloatArray, rising: BoolArray | None) -> FloatArray:
        """Return where the stage stands at voltages."""
        if isinstance(self.calibration, float):
            return np.asarray(voltage * self.calibration)
        known = self.calibration.voltage
        inside = np.clip(voltage, known[0], known[-1])
        chosen = "mean" if rising is None else self.branch
        if chosen != "sweep":
            curve = cast("Literal['mean', 'up', 'down']", chosen)
            return np.asarray(self.calibration.evaluate(inside, direction=curve))
        up = self.calibration.evaluate(inside, direction="up")
        down = self.calibration.evaluate(inside, direction="down")
        return np.asarray(np.where(cast("BoolArray", rising), up, down))

    def voltage_for(self, displacement: FloatArray, rising: BoolArray) -> FloatArray:
        """Return the voltages that give displacements."""
        if isinstance(self.calibration, float):
            return np.asarray(displacement / self.calibration)
        if self.branch != "sweep":
            curve = cast("Literal['mean', 'up', 'down']", self.branch)
            return np.asarray(self.calibration.voltage_for(displacement, direction=curve))
        result = np.empty_like(displacement)
        for part, curve in ((rising, "up"), (~rising, "down")):
            if part.any():
                result[part] = self.calibration.voltage_for(displacement[part], direction=curve)
        return result

    def stored(self) -> dict[str, Any] | float:
        """Return the calibration as plain values."""
        if isinstance(self.calibration, float):
            return self.calibration
        curves = {
            f"{name}_um": [None if math.isnan(v) else float(v) / _UM for v in values]
            for name, values in ((n, getattr(self.calibration, n)) for n in _CURVES)
        }
        return {"voltage_V": self.calibration.voltage.tolist(), **curves}

    @staticmethod
    def of(value: Any, branch: str, low: float, high: float) -> StageCurves:
        """Return the curves of a calibration in any of its forms."""
        if not high > low:
            raise DataError(f"v_min={low} V, v_max={high} V; the upper voltage must be larger")
        if isinstance(value, str) and value.lstrip().startswith("{"):
            value = _from_json(value)
        if isinstance(value, str):
            value = parse_sensitivity(value)
        if isinstance(value, int | float) and not isinstance(value, bool):
            if not math.isfinite(value) or value == 0.0:
                raise DataError(f"calibration={value}: a sensitivity is in m/V, and not zero")
            if branch != "mean":
                raise DataError(
                    f"branch={branch!r} needs a calibration with sweeps up and down, "
                    "not a sensitivity"
                )
            return StageCurves(float(value), branch, low, high)
        if isinstance(value, Mapping):
            value = _from_stored(value)
        if not isinstance(value, FlexureCalibration):
            raise DataError(
                f"calibration is a {type(value).__name__}; give a FlexureCalibration "
                "(metrosep.process.flexure_calibration), its stored form, or '1.66 um/V'"
            )
        if branch == "sweep":
            _require_lag(value)
        return StageCurves(value, branch, low, high)


def _require_lag(known: FlexureCalibration) -> None:
    """Refuse branches that lead: a piezo lags, so that the falling one lies ahead of the rising one."""
    sense = math.copysign(1.0, float(known.mean[-1] - known.mean[0]))
    lag = sense * (known.down - known.up)
    lag = lag[np.isfinite(lag)]
    stroke = float(np.ptp(known.mean))
    if lag.size and float(lag.mean()) < -_LEAD * stroke:
        raise DataError(
            f"the branches of the calibration are exchanged: while the voltage falls the stage must stand "
            f"ahead of where it stands while it rises, here it stands {format_length(-float(lag.mean()))} "
            "behind in the mean; name the sweeps the other way round, or use branch='mean'"
        ).hinting(branch="mean")


def _from_json(text: str) -> dict[str, Any]:
    try:
        stored = json.loads(text)
    except (ValueError, RecursionError) as exc:
        raise DataError(
            f"calibration={text[:40]!r} is not the JSON of a stored calibration: {exc}"
        ) from None
    return cast("dict[str, Any]", stored)


def _from_stored(stored: Mapping[Any, Any]) -> FlexureCalibration:
    try:
        v = np.array([float(x) for x in stored["voltage_V"]])
        mean = _curve(stored["mean_um"])
        up, down = (
            _curve(stored[f"{n}_um"]) if f"{n}_um" in stored else np.full(v.size, math.nan)
            for n in ("up", "down")
        )
    except (KeyError, TypeError, ValueError) as exc:
        raise DataError(
            f"a stored calibration holds lists voltage_V and mean_um (up_um, down_um): {exc!r}"
        ) from None
    same = v.size == mean.size == up.size == down.size
    if not same or v.size < 2 or not np.isfinite(v).all() or (np.diff(v) <= 0).any():
        raise DataError(
            "a stored calibration holds lists of equal length, at least 2, voltage_V rising"
        )
    if np.isnan(mean).any():
        raise DataError("mean_um of a stored calibration has gaps")
    for name, values in (("mean_um", mean), ("up_um", up), ("down_um", down)):
        if np.isinf(values).any():
            i = int(np.flatnonzero(np.isinf(values))[0])
            raise DataError(f"{name} of a stored calibration is infinite at {v[i]:g} V")
    for values in (v, mean, up, down):
        values.setflags(write=False)
    blank = np.full(v.size, math.nan)
    return FlexureCalibration(v, up, down, mean, blank, {}, "end-point", {}, ())


def _curve(values: Any) -> FloatArray:
    return np.array([math.nan if x is None else float(x) for x in values]) * _UM


def rising_parts(values: FloatArray, *, sign: float = 1.0) -> BoolArray:
    """Return at which samples a signal came from below."""
    steps = np.sign(np.diff(values)) * math.copysign(1.0, sign)
    moving = np.flatnonzero(steps)
    if moving.size == 0:
        return np.ones(values.size, dtype=np.bool_)
    last = np.searchsorted(moving, np.arange(steps.size), side="right") - 1
    signs = steps[moving[np.maximum(last, 0)]]
    return np.concatenate([signs[:1], signs]) > 0


def quantised(
    displacement: FloatArray, curves: StageCurves, bits: int, places: FloatArray
) -> FloatArray:
    """Return the voltages that a DAC sets for displacements, in the order they are passed."""
    low, high = curves.stroke
    beyond = np.maximum(low - displacement, displacement - high)
    i = int(np.argmax(beyond))
    if beyond[i] > _SLACK * (high - low):
        raise LimitError(
            f"entry {i} at {places[i]:.9g} (m or rad) needs a displacement of "
            f"{format_length(float(displacement[i]))}, the stage reaches {format_ends(low, high)}"
            f" between {curves.voltages[0]:.6g} and {curves.voltages[1]:.6g} V; "
            "set offset=, remove offset and line from the error, or take a stage of more stroke"
        )
    inside = np.clip(displacement, low, high)
    falls = curves.displacement(np.array(curves.voltages), None)
    rising = rising_parts(inside, sign=float(falls[1] - falls[0]))
    try:
        wanted = curves.voltage_for(inside, rising)
    except LimitError as exc:
        raise LimitError(f"{exc}; or use branch='mean'").hinting(branch="mean") from None
    step = (curves.high - curves.low) / (2**bits - 1)
    v = curves.low + step * np.rint((wanted - curves.low) / step)
    outside = np.maximum(curves.low - wanted, wanted - curves.high)
    worst = int(np.argmax(outside))
    if outside[worst] > _SLACK * (curves.high - curves.low):
        raise LimitError(
            f"entry {worst} at {places[worst]:.9g} (m or rad) needs {wanted[worst]:.6g} V on this "
            f"branch, the amplifier takes {curves.low:.6g} ... {curves.high:.6g} V; set offset="
        )
    return np.asarray(np.clip(v, curves.low, curves.high))

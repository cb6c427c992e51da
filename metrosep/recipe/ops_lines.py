"""Steps of recipes for readings along a line: straightness, slopes, drift, dependence on speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import DataError, FormatMismatchError, InvalidSamplesError
from metrosep.core.inputs import Readings, RoleColumns
from metrosep.recipe.method import OP, U_READING, Method, as_rows, toolbox
from metrosep.recipe.schema import Field

__all__ = ["LINES"]

_PROBES = {
    **OP,
    **U_READING,
    "step": Field("size"),
    "u_pitch": Field("angle"),
    "smoothing": Field("number"),
}
_CHAINS = ("sequential", "generalised", "combined", "least_squares")


def _require_x(data: Readings) -> Any:
    if data.position is None:
        raise FormatMismatchError('positions are needed: name their column, x = "x_mm"')
    return data.position


def _straightedge(data: Readings, options: Mapping[str, Any]) -> Any:
    reversal = toolbox("straightedge_reversal")
    return reversal(*data.values, x=data.position, **options)


def _on_carriage(name: str) -> Callable[[Readings, Mapping[str, Any]], Any]:
    """Return the call of a method of probes on one carriage, with or without an angle sensor."""

    def call(data: Readings, options: Mapping[str, Any]) -> Any:
        if data.position is None and "step" not in options:
            raise FormatMismatchError(
                'the positions of the carriage are needed: x = "x_mm" in [input], or step = "10 mm"'
            )
        rest = dict(options)
        if data.position is not None:
            rest["x"] = data.position
        if "pitch" in data.extra:
            rest["pitch"] = data.extra["pitch"].mean(axis=0)
        if isinstance(rest.get("distance"), tuple):
            rest["distance"] = _distances(rest["distance"])
        return toolbox(name)(as_rows(data.values), **rest)

    return call


def _distances(given: tuple[float, ...]) -> float | tuple[float, ...]:
    if len(given) not in (1, 2) or min(given) <= 0.0:
        raise DataError(
            "three probes have one distance, or two that differ, above zero; got "
            + ", ".join(f"{d * 1e3:g} mm" for d in given)
        )
    return given[0] if len(given) == 1 else given


def _zero(data: Readings, options: Mapping[str, Any]) -> Any:
    """Three probes over a flat, or the three readings before and after they are reversed."""
    rest = {**options, "distance": _distances(options["distance"])}
    if "pitch" in data.extra:
        rest["pitch"] = data.extra["pitch"].mean(axis=0)
    readings = as_rows(data.values)
    if len(readings) == 6:
        rest["reversed_m"] = readings[3:]
    elif len(readings) == 3 and "pitch" not in rest:
        rest["flat"] = 0.0
    elif len(readings) != 3:
        raise InvalidSamplesError(
            f"3 readings over a flat are needed, or 6: 3 as they are and 3 reversed; got {len(readings)}"
        )
    return toolbox("zero_calibration")(readings[:3], **rest)


def _slopes(data: Readings, options: Mapping[str, Any]) -> Any:
    passes = data.values.reshape(-1, data.values.shape[-1])
    slopes = passes[0] if len(passes) == 1 else passes
    return toolbox("integrate_slopes")(slopes, _require_x(data), **options)


def _straightness(data: Readings, options: Mapping[str, Any]) -> Any:
    """One reading over x; repeats are averaged, and their scatter tells the sd of the mean.

    A run that lies higher or askew adds a line to the mean, and lines are no straightness: the
    scatter is that about a line of its own for each run.
    """
    x, repeats = _require_x(data), data.values[0]
    if len(data.values) != 1:
        raise InvalidSamplesError(
            f"one reading over x is needed, got {len(data.values)} ({', '.join(data.names)})"
        )
    rest, mean = dict(options), repeats[0]
    if len(repeats) > 1:
        mean = repeats.mean(axis=0)
        common = np.isfinite(mean)
        freedom = (len(repeats) - 1) * (int(common.sum()) - 2)
        if freedom > 0:
            line = np.vander(x[common] - x[common].mean(), 2)
            left = (repeats - mean)[:, common].T
            left = left - line @ np.linalg.lstsq(line, left, rcond=None)[0]
            scatter = float(np.sum(left**2)) / freedom
            rest.setdefault("sd", math.sqrt(scatter / len(repeats)))
    return toolbox("straightness_iso230_1")(x, mean, **rest)


def _in_time(data: Readings) -> tuple[Any, Any]:
    """Return readings in the order of time, and times where there is a column of them.

    A column of time means that the rows follow each other in time, one number each; without it
    the columns do, each a curve over x.
    """
    if "time" not in data.extra:
        return data.values[:, 0], None
    if len(data.values) != 1 or data.values.shape[1] != 1:
        raise InvalidSamplesError(
            f"with a column of time there is one column of readings, got {len(data.values)}; for "
            'curves leave time out and give times = ["0 s", ...] in the step'
        )
    return data.values[0, 0], data.extra["time"][0]


def _abba(data: Readings, options: Mapping[str, Any]) -> Any:
    rest = dict(options)
    readings, t = _in_time(data)
    times = rest.pop("times", None)
    return toolbox("abba")(readings, t=times if t is None else t, **rest)


def _joint_drift(data: Readings, options: Mapping[str, Any]) -> Any:
    rest = dict(options)
    readings, t = _in_time(data)
    times, labels = rest.pop("times", None), rest.pop("labels", None)
    t = times if t is None else t
    if t is None:
        raise FormatMismatchError(
            'times are needed: time = "t_s" in [input] where rows follow each other in time, or '
            'times = ["0 s", "30 s"] in the step where columns do'
        )
    if "label" in data.extra:
        labels = data.extra["label"][0].tolist()
    return toolbox("joint_drift")(t, readings, labels, **rest)


def _speed(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    values = data.values
    u = values.get("u")
    rest = dict(options) if u is None else {**options, "u": u}
    return toolbox("speed_dependence")(values["speed"], values["amplitude"], **rest)


def _temperature(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    values = data.values
    u = values.get("u")
    rest = dict(options) if u is None else {**options, "u": u}
    return toolbox("drift_against_temperature")(
        values["temperature"], values["displacement"], **rest
    )


def _drift_test(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    rest = dict(options)
    names = rest.pop("names", None) or data.columns["readings"]
    columns = data.values["readings"]
    if len(names) != len(columns):
        raise DataError(f"{len(names)} names for {len(columns)} readings; give one for each")
    channels = dict(zip(names, columns, strict=True))
    return toolbox("iso230_3_drift")(data.values["time"], channels, **rest)


def _repeatable(data: Readings, options: Mapping[str, Any]) -> Any:
    """Take columns and their repeats as repeats of one reading."""
    every = data.values.reshape(-1, data.values.shape[-1])
    return toolbox("repeatable")(every, x=data.position, **options)


def _periodic(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    values = data.values
    unit = data.units["reading"]
    return toolbox("periodic_error")(values["position"], values["reading"], unit=unit, **options)


LINES: Mapping[str, Method] = {
    "straightedge_reversal": Method(
        "form of a straightedge and straightness of a slide, by reversal",
        "curves",
        ("m1", "m2"),
        {**OP, **U_READING, "u_registration": Field("uncertainty")},
        _straightedge,
        over="x",
    ),
    "two_point": Method(
        "form of a straightedge and straightness of a slide, from two probes on the carriage",
        "curves",
        ("trailing", "leading"),
        {
            **_PROBES,
            "distance": Field("size", required=True),
            "method": Field("text", choices=_CHAINS),
        },
        _on_carriage("two_point"),
        roles={"pitch": "angle?"},
        over="x",
    ),
    "three_point": Method(
        "form of a straightedge and straightness of a slide, from three probes on the carriage",
        "curves",
        ("trailing", "middle", "leading"),
        {
            **_PROBES,
            "distance": Field("lengths", required=True),
            "method": Field("text", choices=_CHAINS),
            "zero": Field("length"),
            "u_zero": Field("uncertainty"),
        },
        _on_carriage("three_point"),
        roles={"pitch": "angle?"},
        over="x",
    ),
    "zero_calibration": Method(
        "zero difference of three probes, from a flat, a reversal or an angle sensor",
        "curves",
        (),
        {
            **OP,
            **U_READING,
            "distance": Field("lengths", required=True),
            "u_flat": Field("uncertainty"),
            "step": Field("size"),
            "u_pitch": Field("angle"),
        },
        _zero,
        roles={"pitch": "angle?"},
        over="x",
    ),
    "multi_probe_straightness": Method(
        "straightedge and slide from probes at any offsets on the carriage",
        "curves",
        (),
        {
            **_PROBES,
            "offsets": Field("lengths", required=True),
            "method": Field("text", choices=("least_squares", "generalised")),
            "zeros_known": Field("flag"),
        },
        _on_carriage("multi_probe_straightness"),
        roles={"pitch": "angle?"},
        over="x",
    ),
    "integrate_slopes": Method(
        "heights of a surface from slopes; each column a pass",
        "curves",
        (),
        {
            **OP,
            "method": Field("text", choices=("spline", "trapezoid", "simpson", "fourier", "feet")),
            "u_slope": Field("angle"),
            "zero_known": Field("flag"),
        },
        _slopes,
        dimension="angle",
        over="x",
    ),
    "straightness_iso230_1": Method(
        "straightness of a motion from three reference lines, ISO 230-1",
        "curves",
        ("deviation",),
        {
            **OP,
            "reference": Field("text", choices=("MZ", "LS", "EP")),
            "sd": Field("uncertainty"),
        },
        _straightness,
        over="x",
    ),
    "abba": Method(
        "A minus B without drift; rows (with time) or columns in the order A B B A",
        "curves",
        (),
        {
            **OP,
            "order": Field("text", choices=("ABBA", "BAAB")),
            "times": Field("times"),
            "sd": Field("uncertainty"),
        },
        _abba,
        roles={"time": "time?"},
    ),
    "joint_drift": Method(
        "repeated quantities and the drift between them, from one fit over time",
        "curves",
        (),
        {
            **OP,
            "times": Field("times"),
            "labels": Field("texts"),
            "degree": Field("integer"),
            "n_pieces": Field("integer"),
            "reference": Field("time"),
            "sd": Field("uncertainty"),
        },
        _joint_drift,
        roles={"time": "time?", "label": "label?"},
    ),
    "iso230_3_drift": Method(
        "thermal drift of several channels over windows of time, ISO 230-3",
        "table",
        (),
        {
            **OP,
            "kind": Field("text", choices=("environment", "spindle", "axis")),
            "windows": Field("windows"),
            "span": Field("time"),
            "sd": Field("uncertainty"),
            "names": Field("texts"),
        },
        _drift_test,
        roles={"time": "time", "readings": "length*"},
    ),
    "speed_dependence": Method(
        "how an amplitude of error motion grows with speed",
        "table",
        (),
        {**OP, "powers": Field("integers"), "confidence": Field("number")},
        _speed,
        roles={"speed": "any", "amplitude": "length", "u": "length?"},
    ),
    "drift_against_temperature": Method(
        "how a displacement follows a temperature",
        "table",
        (),
        {**OP, "confidence": Field("number")},
        _temperature,
        roles={"temperature": "any", "displacement": "length", "u": "length?"},
    ),
    "repeatable": Method(
        "what repeats in several readings of one thing, and what does not",
        "curves",
        (),
        {
            **OP,
            **U_READING,
            "align": Field("text", choices=("line", "piston", "none")),
            "shift": Field("text", choices=("trust", "fit")),
            "closed": Field("flag"),
        },
        _repeatable,
    ),
    "periodic_error": Method(
        "periodic error of an interferometer in a reading",
        "table",
        (),
        {
            **OP,
            "period": Field("size", required=True),
            "harmonics": Field("integer"),
            "degree": Field("integer"),
            "u_reading": Field("limit"),
        },
        _periodic,
        roles={"position": "length", "reading": "position"},
    ),
}

"""Steps of recipes for readings over a revolution: roundness, spindles, divided circles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import DataError, FormatMismatchError, InvalidSamplesError
from metrosep.io.readings import Readings
from metrosep.recipe.method import OP, U_READING, Method, as_rows, toolbox
from metrosep.recipe.schema import Field

__all__ = ["CIRCLE", "require_angles"]

_TURN = {"turn": Field("integer", choices=(1, -1))}


def require_angles(data: Readings) -> None:
    """Refuse readings that do not lie at equal angles over one revolution."""
    from metrosep.separation._readings import require_turn

    if data.position is None:
        raise FormatMismatchError(
            'the angle of each sample is needed: name its column, angle = "angle_deg"'
        )
    require_turn(data.position)


def _over_turn(name: str) -> Callable[[Readings, Mapping[str, Any]], Any]:
    """Return the call of a method of two readings over one revolution."""

    def call(data: Readings, options: Mapping[str, Any]) -> Any:
        require_angles(data)
        return toolbox(name)(*data.values, angle=data.position, **options)

    return call


def _face(data: Readings, options: Mapping[str, Any]) -> Any:
    require_angles(data)
    f1, f2, axial, *second = data.values
    rest = {k: v for k, v in options.items() if k != "radius"}
    axial2 = second[0] if second else None
    return toolbox("face_reversal")(
        f1, f2, axial, options["radius"], axial2=axial2, angle=data.position, **rest
    )


def _multiprobe(data: Readings, options: Mapping[str, Any]) -> Any:
    require_angles(data)
    return toolbox("multiprobe")(as_rows(data.values), angle=data.position, **options)


def _multistep(data: Readings, options: Mapping[str, Any]) -> Any:
    require_angles(data)
    return toolbox("multistep")(as_rows(data.values), angle=data.position, **options)


def _mixed(data: Readings, options: Mapping[str, Any]) -> Any:
    require_angles(data)
    if len(data.values) != 1:
        raise InvalidSamplesError(
            f"readings names one displacement probe, got {len(data.values)}; the slope probe is "
            'slope = "s_urad"'
        )
    displacement, slope = data.values[0], data.extra["slope"]
    if len(displacement) == 1:
        displacement, slope = displacement[0], slope[0]
    return toolbox("orthogonal_mixed")(displacement, slope, angle=data.position, **options)


def _closure(data: Readings, options: Mapping[str, Any]) -> Any:
    if data.values.shape[1] > 1:
        raise InvalidSamplesError(
            "closure takes one reading for each table index; average repeats first, and leave "
            "repeat out"
        )
    return toolbox("closure")(data.values[:, 0], **options)


def _spindle(data: Readings, options: Mapping[str, Any]) -> Any:
    """Evaluate readings at fixed angles by revolution, with an angle column, or with an index."""
    rest = dict(options)
    resampling: dict[str, Any] = {
        k: rest.pop(k) for k in ("threshold", "edge", "faults") if k in rest
    }
    analyse = toolbox("iso230_7")
    index = data.extra.get("index")
    if index is not None:
        return analyse(_by_index(data, index, rest, resampling), **rest)
    if resampling:
        key = next(iter(resampling))
        raise DataError(f'{key} is for an index channel; name its column, index = "index_V"')
    _refuse_rate(data, rest)
    one = len(data.values) == 1
    if data.values.shape[1] > 1:  # revolutions at fixed angles
        if data.position is not None:
            require_angles(data)
        return analyse(data.values[0] if one else data.values, data.position, **rest)
    if data.position is None:
        raise FormatMismatchError(
            'the angle of the spindle is needed: angle = "angle_deg" (accumulated or wrapped), '
            'index = "index_V" with time or sampling_rate, or repeat = "revolution" at fixed angles'
        )
    signals = data.values[:, 0]
    return analyse(signals[0] if one else signals, data.position, **rest)


def _refuse_rate(data: Readings, options: dict[str, Any]) -> None:
    if "sampling_rate" in options:
        raise DataError("sampling_rate is for an index channel; with an angle it is not needed")


def _by_index(
    data: Readings, index: Any, options: dict[str, Any], resampling: dict[str, Any]
) -> Any:
    if data.position is not None or data.values.shape[1] > 1:
        raise FormatMismatchError(
            "an index channel gives the angle: leave angle, x and repeat out, or leave index out"
        )
    pulses = toolbox("index_pulses")(
        index[0], **{k: v for k, v in resampling.items() if k != "faults"}
    )
    signals = data.values[:, 0]
    return toolbox("resample_by_index")(
        signals[0] if len(signals) == 1 else signals,
        pulses,
        n=options.pop("n", None),
        faults=resampling.get("faults", "refuse"),
        sampling_rate=_rate(data, options.pop("sampling_rate", None)),
    )


def _rate(data: Readings, given: float | None) -> float | None:
    """Return the sampling rate: as given, or from a column of time, which must be uniform."""
    time = data.extra.get("time")
    if time is None or given is not None:
        return given
    steps = np.diff(time[0])
    middle = float(np.median(steps)) if steps.size else 0.0
    if middle <= 0.0 or float(np.abs(steps - middle).max()) > 0.01 * middle:
        raise InvalidSamplesError(
            "the samples are not uniform in time; an index channel needs uniform sampling: record "
            "so, or use an encoder angle"
        )
    return (len(time[0]) - 1) / float(time[0][-1] - time[0][0])


CIRCLE: Mapping[str, Method] = {
    "donaldson": Method(
        "roundness of an artefact and radial error motion of a spindle, by reversal",
        "curves",
        ("m1", "m2"),
        {**OP, **U_READING, "u_index": Field("angle")},
        _over_turn("donaldson"),
        over="angle",
    ),
    "face_reversal": Method(
        "flatness of a plate, axial and tilt error motion of a spindle, by reversal",
        "curves",
        ("F1", "F2", "A"),
        {**OP, **U_READING, "radius": Field("size", required=True)},
        _face,
        spare=1,
        over="angle",
    ),
    "multiprobe": Method(
        "roundness of an artefact and motion of a spindle in x and y, from 3 or more probes",
        "curves",
        (),
        {
            **OP,
            **U_READING,
            "angles": Field("angles", required=True),
            "kmax": Field("integer", required=True),
            "u_angles": Field("angle"),
            "u_sensitivity": Field("number"),
            "max_gain": Field("number"),
            "radius": Field("size"),
            **_TURN,
        },
        _multiprobe,
        over="angle",
    ),
    "orthogonal_mixed": Method(
        "roundness and spindle motion from a displacement and a slope probe",
        "curves",
        ("displacement",),
        {
            **OP,
            **U_READING,
            "kmax": Field("integer", required=True),
            "radius": Field("size", required=True),
            "u_slope": Field("angle"),
            "u_angle": Field("angle"),
            "u_radius": Field("uncertainty"),
            **_TURN,
        },
        _mixed,
        roles={"slope": "angle"},
        over="angle",
    ),
    "multistep": Method(
        "roundness of an artefact and error motion of a spindle from indexed set-ups",
        "curves",
        (),
        {
            **OP,
            **U_READING,
            "steps": Field("integers"),
            "angles": Field("angles"),
            "kmax": Field("integer"),
            "u_index": Field("angle"),
            "eccentricity": Field("text", choices=("fixed", "free")),
            "drift": Field("text", choices=("none", "linear")),
            "step_revolutions": Field("number"),
            **_TURN,
        },
        _multistep,
        over="angle",
    ),
    "closure": Method(
        "angle errors of a polygon and of the table that carries it; one column a set-up",
        "curves",
        (),
        {
            **OP,
            "positions": Field("integers"),
            "table_sign": Field("integer", choices=(-1, 1)),
            "u_reading": Field("angle"),
        },
        _closure,
        dimension="angle",
    ),
    "iso230_7": Method(
        "synchronous, asynchronous and total error motion of a spindle, ISO 230-7",
        "curves",
        (),
        {
            **OP,
            "direction": Field("text", choices=("radial", "axial", "tilt", "face")),
            "sensitive": Field("text", choices=("fixed", "rotating")),
            "center": Field("text", choices=("LSC", "MZC", "MRS", "MIC", "MCC")),
            "distance": Field("size"),
            "kmax": Field("integer"),
            "drift": Field("text", choices=("keep", "linear")),
            "artefact_radius": Field("size"),
            "n": Field("integer"),
            "seed": Field("integer"),
            "sampling_rate": Field("frequency"),
            "threshold": Field("number"),
            "edge": Field("text", choices=("rising", "falling")),
            "faults": Field("text", choices=("refuse", "drop")),
        },
        _spindle,
        roles={"index": "any?", "time": "time?"},
        over="angle",
    ),
}

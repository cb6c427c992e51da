"""Steps of recipes around a separation: check and choose probes, evidence, fiducials, sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.runset import Run, RunSet
from metrosep.io.readings import Readings
from metrosep.io.role_columns import RoleColumns
from metrosep.recipe.method import OP, Method, as_rows, toolbox
from metrosep.recipe.ops_circle import require_angles
from metrosep.recipe.schema import Field

__all__ = ["CHECKS"]

_PER_SECOND = {"rev/s": 1.0, "Hz": 1.0, "rev/min": 1.0 / 60.0}

_SAME_FEED = 1e-6
"""Feeds of one run may differ by this relative share: rounding of text."""


def _check(data: Readings, options: Mapping[str, Any]) -> Any:
    require_angles(data)
    return toolbox("check_probes")(as_rows(data.values), **options)


def _choose(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    """Choose the angles of the probes that are not placed yet; the table holds the placed ones."""
    rest, placed = dict(options), data.values["angle"]
    count, kmax = rest.pop("n"), rest.pop("kmax")
    return toolbox("optimise_probe_angles")(count, kmax, fixed=placed, **rest)


def _evidence(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    rest = dict(options)
    way = rest.pop("direction", None)
    runs = _runs(data)
    if way is not None:
        runs = runs.select(direction=1 if way == "forward" else -1)
    return toolbox("evidence_table")(runs, **rest)


def _runs(data: RoleColumns) -> RunSet:
    """Return the runs of a table, told apart by the column of runs, in the order of the rows."""
    values = data.values
    found = []
    for name in dict.fromkeys(values["run"].tolist()):
        rows = values["run"] == name
        feed = values["feed"][rows]
        if not np.isfinite(feed).all() or float(np.ptp(feed)) > _SAME_FEED * abs(float(feed[0])):
            raise InvalidSamplesError(
                f"run {name}: its rows have different feedrates, or none; a run has one"
            )
        time = values["time"][rows] if "time" in values else None
        found.append(
            Run(
                values["x"][rows],
                values["z"][rows],
                t=time,
                feed=abs(float(feed[0])),
                run_id=str(name),
            )
        )
    return RunSet(found)


def _fiducials(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    """Register marked points; a row holds one of them in both maps."""
    pairs = [
        np.column_stack([data.values[f"x_{which}"], data.values[f"y_{which}"]])
        for which in ("fixed", "moved")
    ]
    seen = np.isfinite(pairs[0]).all(axis=1) & np.isfinite(pairs[1]).all(axis=1)
    if not seen.all():
        row = int(np.flatnonzero(~seen)[0]) + 1
        raise InvalidSamplesError(
            f"point {row} of {seen.size} lacks a coordinate in one of the maps; drop the row"
        )
    if seen.size < 2:
        raise TooFewSamplesError(f"two points or more are needed, got {seen.size}")
    return toolbox("register_points")(*pairs)


def _sweep(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    rest, values = dict(options), data.values
    names = rest.pop("names", None) or data.columns["readings"]
    columns = values["readings"]
    if len(names) != len(columns) or len(set(names)) != len(names):
        raise DataError(
            f"{len(columns)} columns of values need as many different names, got {', '.join(names)}"
        )
    rest["u"] = _uncertainties(values.get("u"), names)
    per_second = values["speed"] * _PER_SECOND[rest.pop("speed_unit")]
    return toolbox("fit_speed_sweep")(per_second, dict(zip(names, columns, strict=True)), **rest)


def _uncertainties(columns: Any, names: Any) -> dict[str, Any] | None:
    if columns is None:
        return None
    if len(columns) != len(names):
        raise DataError(
            f"{len(columns)} columns of uncertainties for {len(names)} of values; name one for "
            "each, in the same order"
        )
    return dict(zip(names, columns, strict=True))


CHECKS: Mapping[str, Method] = {
    "check_probes": Method(
        "whether four or more probes agree, and which angle or sensitivity is wrong if not",
        "curves",
        (),
        {
            **OP,
            "angles": Field("angles", required=True),
            "kmax": Field("integer", required=True),
            "u_reading": Field("size", required=True),
            "turn": Field("integer", choices=(1, -1)),
        },
        _check,
        over="angle",
    ),
    "optimise_probe_angles": Method(
        "angles of further probes of least noise; the table holds those that stand",
        "table",
        (),
        {
            **OP,
            "n": Field("integer", required=True),
            "kmax": Field("integer", required=True),
            "min_separation": Field("angle"),
            "tolerance": Field("angle"),
            "criterion": Field("text", choices=("rms", "worst")),
            "resolution": Field("angle"),
            "seed": Field("integer"),
        },
        _choose,
        roles={"angle": "angle"},
    ),
    "evidence_table": Method(
        "how surely each wavelength of an error repeats over runs of several feedrates",
        "table",
        (),
        {
            **OP,
            "direction": Field("text", choices=("forward", "reverse")),
            "start": Field("length"),
            "length": Field("size"),
            "shortest": Field("size"),
            "bandwidth": Field("frequency"),
            "false_discovery_rate": Field("number"),
        },
        _evidence,
        roles={"x": "length", "z": "length", "feed": "speed", "run": "label", "time": "time?"},
    ),
    "register_points": Method(
        "shift and turn of one map against another from points that are marked in both",
        "table",
        (),
        {**OP},
        _fiducials,
        roles={"x_fixed": "length", "y_fixed": "length", "x_moved": "length", "y_moved": "length"},
    ),
    "fit_speed_sweep": Method(
        "how values of spindle tests depend on speed, and which speeds stand out",
        "table",
        (),
        {
            **OP,
            "speed_unit": Field("text", required=True, choices=tuple(_PER_SECOND)),
            "powers": Field("integers"),
            "names": Field("texts"),
            "natural_frequency": Field("frequency"),
            "orders": Field("integers"),
        },
        _sweep,
        roles={"speed": "any", "readings": "length*", "u": "length*?"},
    ),
}

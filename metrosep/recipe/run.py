"""Carrying out a recipe: read, separate, fit, check, write; result.json last."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.compensation import CompensationTable, Verification, fit_polynomial
from metrosep.core.errors import ReadError, RecipeError, UnsupportedFeatureError, WriteError
from metrosep.core.provenance import history_as_dicts
from metrosep.core.quantity import Quantity
from metrosep.core.runset import RunSet
from metrosep.core.units import parse_quantity
from metrosep.parameters.decision import decide, worst
from metrosep.recipe.result import SCHEMA, Result, clean, plot_data
from metrosep.recipe.steps import METRICS
from metrosep.separation.base import ErrorEstimate

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["input_files", "run_recipe"]

PathLike = str | os.PathLike[str]
Progress = Callable[[str], None]

_RULE = (
    "accept if the value lies inside its limits by the guard band g = guard factor x U, reject if "
    "outside by g, else inconclusive (ISO 14253-1)"
)


def run_recipe(
    recipe: Recipe,
    inputs: PathLike | Iterable[PathLike] | None,
    *,
    out: PathLike | None,
    progress: Progress | None,
) -> Result:
    """Carry out a recipe; see `Recipe.run`.

    Parameters
    ----------
    recipe : Recipe
        What to do.
    inputs : path, iterable of paths or None
        Files or folders.
    out : path or None
        Folder for the results.
    progress : callable or None
        Told what is being done.

    Returns
    -------
    Result
        Document, estimate, files.

    Raises
    ------
    MetrosepError
        Of any kind of its tree.
    """
    tell = progress or _silent
    files = input_files(recipe, inputs)
    tell(f"reading {len(files)} file(s)")
    runs = _read(recipe, files)
    tell(f"separating {len(runs)} runs")
    estimate = _separate(recipe, runs)
    polynomial = _polynomial(recipe, runs, estimate)
    folder = None if out is None else _folder(Path(out))
    table, verification, written = _tables(recipe, runs, estimate, folder, tell)
    document = {
        "schema": SCHEMA,
        "metrosep": __version__,
        "title": recipe.title or "Separation of repeated runs",
        "inputs": _inputs(runs),
        "estimate": estimate.to_dict(),
        "plots": plot_data(runs, estimate),
        "table": table,
        "polynomial": polynomial,
        "messages": [*runs.metadata.get("warnings", ()), *estimate.messages],
        "provenance": history_as_dicts(estimate.history),
        "recipe": {"name": recipe.name, "text": recipe.text, "sha256": recipe.sha256},
        "versions": _versions(),
        "decision_rule": _RULE,
        **_characteristics(recipe, estimate, verification),
    }
    result = Result(clean(document), estimate)
    if folder is None:
        return result
    tell("writing the report")
    written += _reports(recipe, result, folder)
    return Result(result.document, estimate, (*written, result.write(folder / "result.json")))


def _silent(message: str) -> None:
    """Tell nobody."""


def input_files(recipe: Recipe, inputs: PathLike | Iterable[PathLike] | None) -> list[Path]:
    """Return the files that a recipe reads.

    Parameters
    ----------
    recipe : Recipe
        With ``[input] files``.
    inputs : path, iterable of paths or None
        Files, or folders in which the patterns of the recipe are looked for.

    Returns
    -------
    list of Path
        At least one.

    Raises
    ------
    ReadError
        If a folder holds no file of that pattern.
    RecipeError
        If neither inputs nor ``files`` are given.
    """
    if inputs is None:
        places = [recipe.folder]
        if "files" not in recipe.input:
            raise RecipeError(
                f'{recipe.name}: name the inputs, or add files = ["run*.csv"] to [input]'
            )
    elif isinstance(inputs, str | os.PathLike):
        places = [Path(inputs)]
    else:
        places = [Path(p) for p in inputs]
    found: list[Path] = []
    for place in places:
        if not place.is_dir():
            found.append(place)
            continue
        patterns = recipe.input.get("files", ["*.csv"])
        inside = sorted({f for p in patterns for f in place.glob(p) if f.is_file()})
        if not inside:
            raise ReadError(f"{place}: no file matches {', '.join(patterns)}")
        found += inside
    return found


def _read(recipe: Recipe, files: list[Path]) -> RunSet:
    from metrosep.io.runs import read_runs

    options = {k: v for k, v in recipe.input.items() if k != "files"}
    for key in ("x", "z", "feed", "time"):
        value = options.get(key)
        if isinstance(value, Mapping):
            if "scale" in value:
                options["scale"] = value["scale"]
            options[key] = (value["column"], value["unit"]) if "unit" in value else value["column"]
    return read_runs(files, **options)


def _separate(recipe: Recipe, runs: RunSet) -> ErrorEstimate:
    from metrosep.separation.separate import separate

    step = next(s for s in recipe.steps if s["op"] == "separate")
    return separate(runs, **{k: v for k, v in step.items() if k != "op"})


def _polynomial(recipe: Recipe, runs: RunSet, estimate: ErrorEstimate) -> dict[str, Any] | None:
    for step in recipe.steps:
        if step["op"] == "polynomial":
            options = {k: v for k, v in step.items() if k != "op"}
            domain = (estimate.start, estimate.stop)
            return fit_polynomial(runs, domain=domain, **options).to_dict()
    return None


def _folder(out: Path) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise WriteError(
            f"{out}: the output folder cannot be made ({exc.strerror or exc}); choose another with -o"
        ) from None
    return out


def _tables(
    recipe: Recipe, runs: RunSet, estimate: ErrorEstimate, folder: Path | None, tell: Progress
) -> tuple[dict[str, Any] | None, Verification | None, list[Path]]:
    import json

    from metrosep.controllers import write
    from metrosep.controllers.base import sidecar_path

    described, verification, written = None, None, list[Path]()
    for output in recipe.outputs:
        if output["kind"] != "table":
            continue
        table = CompensationTable.from_error(
            estimate,
            positions=output["spacing"],
            axis=output["axis"],
            compensates=output.get("compensates"),
            direction=output.get("direction", "auto"),
            reference=output.get("reference"),
        )
        if folder is None:
            verification = table.verify(runs)
            described = {**table.to_dict(), "verification": verification.to_dict()}
            continue
        tell(f"dry-running and writing {output['path']}")
        path = folder / _plain_name(output["path"], recipe)
        verification = write(
            table,
            path,
            output["controller"],
            verified_against=runs,
            overwrite=sidecar_path(path).exists(),
            **_machine(output.get("machine", {}), recipe),
        )
        written += [path, sidecar_path(path)]
        sidecar = json.loads(sidecar_path(path).read_text(encoding="utf-8"))
        described = {**sidecar.pop("table"), **sidecar, "path": path.name}
    return described, verification, written


_MACHINE = {
    "stroke": "length",
    "reversal_jump": "length",
    "feed": "speed",
    "velocity_share": "speed",
    "acceleration_share": "acceleration",
    "acceleration": "acceleration",
    "servo_period": "time",
}


def _machine(given: Mapping[str, Any], recipe: Recipe) -> dict[str, Any]:
    """Return the limits of a machine in SI; quantities are texts with units."""
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key in _MACHINE and not isinstance(value, str):
            raise RecipeError(f"{recipe.name}: machine {key} = {value!r} needs a unit, as a text")
        values[key] = (
            parse_quantity(value, dimension=_MACHINE[key], name=key) if key in _MACHINE else value
        )
    return values


def _plain_name(name: str, recipe: Recipe) -> str:
    if Path(name).name != name:
        raise RecipeError(
            f"{recipe.name}: output path {name!r} must be a plain file name; the folder is given with -o"
        )
    return name


def _reports(recipe: Recipe, result: Result, folder: Path) -> list[Path]:
    from importlib.metadata import entry_points

    written = []
    for output in recipe.outputs:
        if output["kind"] != "report":
            continue
        for name in output.get("formats", ["html"]):
            found = entry_points(group="metrosep.reports", name=name)
            if not found:
                known = ", ".join(sorted(e.name for e in entry_points(group="metrosep.reports")))
                raise UnsupportedFeatureError(
                    f"{recipe.name}: no report format {name!r} in this version; there are {known or 'none'}"
                )
            path = folder / _plain_name(output.get("path", f"report.{name}"), recipe)
            next(iter(found)).load()(dict(result.document), path)
            written.append(path)
    return written


def _inputs(runs: RunSet) -> list[dict[str, Any]]:
    return [
        {
            "name": step.parameters.get("file"),
            "sha256": step.parameters.get("sha256"),
            "size": step.parameters.get("size"),
            "format": step.parameters.get("format"),
        }
        for step in runs.history
        if step.name == "read"
    ]


def _versions() -> dict[str, str]:
    import numpy as np
    import scipy

    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


_NAMES = {
    "slope": "Alignment slope over the evaluation range",
    "lost_motion": "Lost motion, reverse minus forward",
    "before_pv": "P-V of the mean run before the table (dry-run)",
}


def _characteristics(
    recipe: Recipe, estimate: ErrorEstimate, verification: Verification | None
) -> dict[str, Any]:
    values = _metrics(estimate, verification)
    entries = [
        {"name": METRICS.get(k) or _NAMES[k], **q.to_dict(), "metric": k}
        for k, q in values.items()
    ]
    for entry in entries:
        entry.update(lower=None, upper=None, U=None, verdict=None)
    verdicts = []
    for check in recipe.checks:
        metric = check["metric"]
        if metric not in values:
            raise RecipeError(
                f'{recipe.name}: check "{metric}" needs an [[output]] of kind "table" (its dry-run)'
            )
        quantity = values[metric]
        expanded = check.get("U", None if quantity.u is None else 2.0 * quantity.u)
        if expanded is None:
            raise RecipeError(
                f"{recipe.name}: the uncertainty of {metric} is not known from these runs; state U"
            )
        verdict = decide(
            quantity.value,
            lower=check.get("lower"),
            upper=check.get("upper"),
            U=expanded,
            guard_factor=check.get("guard_factor", 1.0),
        )
        verdicts.append(verdict)
        entries.append(
            {
                **quantity.to_dict(),
                "metric": metric,
                "name": check.get("name", METRICS[metric]),
                "lower": check.get("lower"),
                "upper": check.get("upper"),
                "U": expanded,
                "verdict": verdict,
            }
        )
    checked = {c["metric"] for c in recipe.checks}
    kept = [e for e in entries if e["verdict"] is not None or e["metric"] not in checked]
    return {"characteristics": kept, "verdict": worst(verdicts)}


def _metrics(estimate: ErrorEstimate, verification: Verification | None) -> dict[str, Quantity]:
    values = {
        "pv": estimate.peak_to_valley(),
        "residual_rms": Quantity(
            estimate.residual_rms,
            "m",
            "RMS of all readings about the separated error: vibration and noise, which no table removes",
            symbol="RMS",
        ),
        "slope": Quantity(
            estimate.slope.value, "rad", estimate.slope.definition, estimate.slope.u, "slope"
        ),
    }
    if estimate.lost_motion is not None:
        lost = estimate.lost_motion
        values["lost_motion"] = Quantity(lost.value, lost.unit, lost.definition, lost.u, "B")
    if verification is not None:
        largest = max(verification.residuals, key=lambda r: r.after_rms)
        values["before_pv"] = Quantity(
            verification.before_pv, "m", "P-V of the mean run before the table", symbol="PV before"
        )
        values["after_pv"] = Quantity(
            verification.after_pv,
            "m",
            "P-V of the mean run after the table, vibration that did not average out included",
            symbol="PV after",
        )
        values["after_rms"] = Quantity(
            verification.after_rms,
            "m",
            "RMS of the mean run after the table, vibration that did not average out included",
            u=largest.u_after_rms,
            symbol="RMS after",
        )
    return values

"""Program files that a recipe asks for: written, read back, cut, and what the virtual part says."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError, MetrosepError, WriteError
from metrosep.core.units import format_length
from metrosep.recipe.preflight import output_name
from metrosep.recipe.steps import PROGRAM_FILE, PROGRAM_PROOF

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe


def try_programs(recipe: Recipe, produced: Any, tell: Callable[[str], None]) -> list[str]:
    """Return what the virtual parts of the programs say; the files are written nowhere that lasts."""
    if all(output["kind"] != "program" for output in recipe.outputs):
        return []
    from metrosep.recipe.outputs import temporary_folder

    with temporary_folder("program") as folder:
        try:
            return write_programs(recipe, produced, folder, tell)[1]
        except MetrosepError as exc:
            exc.args = (str(exc).replace(f"{folder}{os.sep}", ""), *exc.args[1:])
            raise


def program_names(recipe: Recipe) -> list[str]:
    """Return the names of the program files of a recipe."""
    return [
        output_name(output["path"], recipe.place("[[output]]", i))
        for i, output in enumerate(recipe.outputs)
        if output["kind"] == "program"
    ]


def refuse_replaced(recipe: Recipe, stage: Path, folder: Path) -> None:
    """Refuse programs that would replace another one of their name, unless their output says overwrite."""
    from metrosep.controllers.base import is_copy, sidecar_path

    free = [o.get("overwrite", False) for o in recipe.outputs if o["kind"] == "program"]
    for name, replaces in zip(program_names(recipe), free, strict=True):
        there = folder / name
        taken = next((p for p in (there, sidecar_path(there)) if p.exists()), None)
        if taken is not None and not replaces and not is_copy(stage / name, there):
            raise WriteError(
                f"{taken}: is another program, and a machine may be using it; choose another path or folder, or "
                "write overwrite = true into the output (the old one is kept as NAME.1)"
            )


def write_programs(
    recipe: Recipe, produced: Any, folder: Path, tell: Callable[[str], None]
) -> tuple[list[str], list[str]]:
    """Return the names of the program files that were written, and what their virtual parts say."""
    names: list[str] = []
    said: list[str] = []
    for i, output in enumerate(recipe.outputs):
        if output["kind"] != "program":
            continue
        place = recipe.place("[[output]]", i)
        name = output_name(output["path"], place)
        program = getattr(produced, "program", None)
        nose = getattr(produced, "nose", None)
        if program is None:
            raise place.error(
                "there is no program to write: give the nose of the tool (nose_radius), or a setting or a "
                "log that it makes up for",
                "kind",
            )
        tell(f"writing {name}")
        names += [name, f"{name}.json"]
        try:
            said += _written(output, program, nose, produced, folder / name)
        except MetrosepError as exc:
            if name not in str(exc):  # a recipe may write several
                exc.args = (f"{name}: {exc}", *exc.args[1:])
            raise
    return names, said


def _written(
    output: Mapping[str, Any], program: Any, nose: Any, produced: Any, target: Path
) -> list[str]:
    from metrosep.controllers.gcode.lathe import LatheAxes
    from metrosep.controllers.gcode.turning import write_program

    axes = LatheAxes(
        **{k: v for k, v in output.items() if k not in {**PROGRAM_FILE, **PROGRAM_PROOF}}
    )
    if nose is None and not output.get("cut_points", False):
        raise DataError(
            "the step has no nose (nose_radius): its points are points of the surface, no tip path; a "
            "program of them needs cut_points = true"
        )
    made = write_program(
        program,
        target,
        axes,
        nose=nose,
        form=produced.form,
        setting=produced.setting,
        kind=output.get("format", "gcode"),
        **{k: output[k] for k in PROGRAM_PROOF if k in output},
    )
    if made.check is None:
        return [f"{target.name}: was not cut in a virtual part"]
    check = made.check
    text = (
        f"{target.name}: the part cut from the file is off by {format_length(check.peak_to_valley)} P-V, "
        f"{format_length(check.form_error)} without the cusps of the feed, up to "
        f"{format_length(check.cusp)}; from the program it differs by "
        f"{format_length(check.difference)}, digits may cost {format_length(check.rounding)} "
        f"({check.interpolation} between blocks)"
    )
    return [text, *(f"{target.name}: {m}" for m in check.messages)]

"""Parts of a separation as files: curves as a table of text, maps in metrosep's own format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError
from metrosep.core.surface import Surface
from metrosep.recipe.preflight import output_name

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["write_parts"]


def write_parts(
    recipe: Recipe, produced: Any, folder: Path, tell: Callable[[str], None]
) -> list[str]:
    """Write the parts that the outputs of a recipe ask for.

    Parameters
    ----------
    recipe : Recipe
        With its outputs.
    produced : Separation or another result with ``to_frame``
        What was separated.
    folder : Path
        Where to write.
    tell : callable
        Told what is being done.

    Returns
    -------
    list of str
        Names of the files. Maps give one file for each part, its name in that of the file.

    Raises
    ------
    DataError
        If the result has no parts to write.
    WriteError
        If a file cannot be written.
    """
    written: list[str] = []
    for i, output in enumerate(recipe.outputs):
        if output["kind"] != "parts":
            continue
        name = output_name(output.get("path", "parts.csv"), recipe.place("[[output]]", i))
        tell(f"writing {name}")
        maps = _maps_of(produced)
        if maps:
            written += _write_maps(maps, folder, Path(name))
        elif hasattr(produced, "to_frame"):
            text = produced.to_frame().to_csv(index=False, lineterminator="\n")
            atomic_write(folder / name, text.encode("utf-8"))
            written.append(name)
        else:
            raise DataError(f"a {type(produced).__name__} has no parts that can be written")
    return written


def _maps_of(produced: Any) -> dict[str, Surface]:
    """Return the parts that are maps, as surfaces."""
    coordinates = getattr(produced, "coordinates", {})
    if not {"x", "y"} <= set(coordinates):
        return {}
    x, y = coordinates["x"], coordinates["y"]
    shape = (y.size, x.size)
    return {
        name: Surface(
            values,
            float(x[1] - x[0]),
            float(y[1] - y[0]),
            origin=(float(x[0]), float(y[0])),
            metadata={"part": name},
            history=produced.history,
        )
        for name, values in produced.parts.items()
        if values.shape == shape
    }


def _write_maps(maps: dict[str, Surface], folder: Path, name: Path) -> list[str]:
    from metrosep.io.write import write

    written = []
    for part, surface in maps.items():
        file = f"{name.stem}-{part}{name.suffix or '.h5'}"
        write(surface, folder / file)
        written.append(file)
    return written

"""Parts of a separation as files: curves as a table of text, maps in metrosep's own format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError
from metrosep.core.surface import Surface
from metrosep.recipe.preflight import output_name

if TYPE_CHECKING:
    from metrosep.recipe.description import Description
    from metrosep.recipe.recipe import Recipe

__all__ = ["write_parts"]


def write_parts(
    recipe: Recipe, described: Description, folder: Path, tell: Callable[[str], None]
) -> list[str]:
    """Write the parts that the outputs of a recipe ask for.

    Parameters
    ----------
    recipe : Recipe
        With its outputs.
    described : Description
        What was separated: tables and maps.
    folder : Path
        Where to write.
    tell : callable
        Told what is being done.

    Returns
    -------
    list of str
        Names of the files. Maps give one file for each part, tables over several coordinates one
        for each, its name in that of the file.

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
        usual = "parts.h5" if described.maps else "parts.csv"
        name = output_name(output.get("path", usual), recipe.place("[[output]]", i))
        tell(f"writing {name}")
        if not described.maps and not described.tables:
            raise DataError("this result has no parts that can be written; leave this output out")
        written += _write_maps(described.maps, folder, Path(name))
        for table, columns in described.tables.items():
            stem, suffix = Path(name).stem, Path(name).suffix
            kind = ".csv" if described.maps else suffix or ".csv"
            file = f"{stem}-{table}{kind}" if table else f"{stem}{kind}"
            atomic_write(folder / file, _csv(columns))
            written.append(file)
    return written


def _csv(columns: Mapping[str, Any]) -> bytes:
    import pandas as pd

    text: str = pd.DataFrame(dict(columns)).to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")


def _write_maps(maps: Mapping[str, Surface], folder: Path, name: Path) -> list[str]:
    from metrosep.io.write import write

    written = []
    for part, surface in maps.items():
        file = f"{name.stem}-{part}{name.suffix or '.h5'}"
        write(surface, folder / file)
        written.append(file)
    return written

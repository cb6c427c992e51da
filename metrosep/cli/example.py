"""Where the shipped examples lie: in the checkout, or inside the installed package."""

from __future__ import annotations

from pathlib import Path

from metrosep.core.errors import ReadError

__all__ = ["example_folder"]


def example_folder(name: str) -> Path:
    """Return the folder of a shipped example.

    Parameters
    ----------
    name : str
        Its name.

    Returns
    -------
    Path
        Folder with ``recipe.toml`` and its input.

    Raises
    ------
    ReadError
        If the installation does not hold it.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package.parent / "examples" / name, package / "_examples" / name):
        if (folder / "recipe.toml").is_file():
            return folder
    raise ReadError(
        f"the example {name!r} is not part of this installation; install metrosep again"
    )

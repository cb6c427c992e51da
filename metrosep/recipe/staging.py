"""Outputs of a run that appear together or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from metrosep.core.errors import MetrosepError, WriteError
from metrosep.recipe.preflight import RESULT_NAME

__all__ = ["staged"]


@contextmanager
def staged(folder: Path, *, tables: Collection[str] = ()) -> Iterator[Path]:
    """Give a hidden folder inside `folder`; at the end its files move into `folder`.

    Notes
    -----
    An older result.json goes first, then the files are renamed one by one, the new result.json
    last: where it is, all that it names is there and of the same run.
    """
    made = not folder.exists()
    stage = _hidden_folder(folder)
    try:
        try:
            yield stage
        except MetrosepError as exc:
            exc.args = (str(exc).replace(f"{stage}", f"{folder}"), *exc.args[1:])
            raise
        _move(stage, folder, tables)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):  # not empty: the run succeeded
                folder.rmdir()


def _hidden_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise WriteError(
            f"{folder}: the output folder cannot be made ({exc.strerror or exc}); choose another with -o"
        ) from None
    stage = folder / f".metrosep-{secrets.token_hex(6)}"
    try:
        stage.mkdir()
    except OSError as exc:
        raise WriteError(
            f"{folder}: the output folder cannot be written ({exc.strerror or exc}); choose another "
            "with -o"
        ) from None
    return stage


def keep_replaced(
    stage: Path, folder: Path, tables: Collection[str], *, overwrite: bool = True
) -> None:
    """Keep the tables of a folder that other ones of a stage will replace, or refuse that."""
    from metrosep.controllers._pairs import is_written, keep_old
    from metrosep.controllers.base import sidecar_path

    for name in tables:
        new = stage / name
        if new.is_file():
            pair = (new.read_bytes(), sidecar_path(new).read_bytes())
            if not is_written(folder / name, *pair, overwrite=overwrite):
                keep_old(folder / name)


def _move(stage: Path, folder: Path, tables: Collection[str]) -> None:
    keep_replaced(stage, folder, tables)
    files = sorted(stage.iterdir(), key=lambda f: (f.name == RESULT_NAME, f.name))
    for file in files:
        try:
            if file is files[0]:
                (folder / RESULT_NAME).unlink(missing_ok=True)
            os.replace(file, folder / file.name)  # noqa: PTH105  # replaces on every system
        except OSError as exc:
            raise WriteError(
                f"{folder / file.name}: cannot be replaced ({exc.strerror or exc}); close the program "
                "that holds it, or choose another folder with -o"
            ) from None

"""`Recipe`: a TOML list of steps that CLI, scripts and reports share."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from metrosep.core.errors import RecipeError, UnsupportedFeatureError
from metrosep.core.provenance import freeze_mapping
from metrosep.recipe.methods import METHODS, input_fields
from metrosep.recipe.pipeline import measuring_steps
from metrosep.recipe.preflight import check_recipe
from metrosep.recipe.result import Result
from metrosep.recipe.schema import Field, Place, checked_table
from metrosep.recipe.steps import (
    CHECK,
    INPUT,
    MEASURING,
    MEASURING_INPUT,
    METHOD_CHECK,
    METHOD_OUTPUTS,
    OUTPUTS,
    STEPS,
    TOP,
)

__all__ = ["Recipe"]

PathLike = str | os.PathLike[str]
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Recipe:
    """A checked recipe.

    Parameters
    ----------
    name : str
        Name of its file.
    text : str
        Its text.
    folder : Path
        Where relative file names of ``[input]`` start.
    title : str
        For reports.
    input : mapping
        How to read the runs.
    steps, checks, outputs : tuple of mapping
        What to do, values in SI.
    """

    name: str
    text: str
    folder: Path
    title: str
    input: Mapping[str, Any]
    steps: tuple[Mapping[str, Any], ...]
    checks: tuple[Mapping[str, Any], ...] = ()
    outputs: tuple[Mapping[str, Any], ...] = field(default=())

    @property
    def is_method(self) -> bool:
        """Whether it is not the separation of repeated runs: a named one, or steps that measure."""
        return self.is_pipeline or self.steps[0]["op"] in METHODS

    @property
    def is_pipeline(self) -> bool:
        """Whether it measures one map or profile, step by step (`metrosep.recipe.pipeline`)."""
        return self.steps[0]["op"] in MEASURING

    @property
    def reads_nothing(self) -> bool:
        """Whether the keys of its step say all, and no input is read."""
        op = self.steps[0]["op"]
        return op in METHODS and METHODS[op].reads == "nothing"

    @property
    def sha256(self) -> str:
        """Hash of the text."""
        return hashlib.sha256(self.text.encode("utf-8")).hexdigest()

    @classmethod
    def load(cls, path: PathLike) -> Recipe:
        """Read and check a recipe.

        Parameters
        ----------
        path : str or path
            TOML file.

        Returns
        -------
        Recipe
            Every key checked, every quantity in SI.

        Raises
        ------
        RecipeError
            If the file cannot be read, is not TOML, or a key is unknown, missing or of the wrong
            kind; the message names file and line.
        """
        target = Path(path)
        try:
            text = target.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as exc:
            reason = getattr(exc, "strerror", None) or exc
            raise RecipeError(f"{target}: the recipe cannot be read ({reason})") from None
        return cls.parse(text, name=target.name, folder=target.resolve().parent)

    @classmethod
    def parse(cls, text: str, *, name: str = "recipe.toml", folder: PathLike = ".") -> Recipe:
        """Check the text of a recipe.

        Parameters
        ----------
        text : str
            TOML.
        name : str, optional
            For messages.
        folder : str or path, optional
            Where relative file names start.

        Returns
        -------
        Recipe
            Every key checked, every quantity in SI.

        Raises
        ------
        RecipeError
            If something in it is wrong; the message names file and line.
        """
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as exc:
            raise RecipeError(f"{name}: not valid TOML: {exc}") from None
        top = Place(name, text)
        checked_table(data, TOP, top, what="the recipe")
        if data["metrosep"] != 1:
            raise top.error(
                f"metrosep = {data['metrosep']}: this version reads recipes of version 1",
                "metrosep",
            )
        ops = {**STEPS, **{op: method.fields for op, method in METHODS.items()}}
        steps = _several(data.get("step"), ops, "op", "[[step]]", top)
        named = [s["op"] for s in steps]
        method = METHODS.get(named[0]) if named else None
        pipeline = bool(named) and named[0] in MEASURING
        wanted = named.count("separate") if method is None else len(named)
        if pipeline:
            steps = measuring_steps(steps, lambda i: Place(name, text, "[[step]]", i))
        elif wanted != 1:
            raise top.error(
                'a recipe needs exactly one [[step]] that separates: op = "separate", one of '
                + ", ".join(METHODS)
                + "; or steps that measure: "
                + ", ".join(MEASURING),
                "step",
            )
        fields = INPUT if method is None else input_fields(method)
        if pipeline:
            fields = MEASURING_INPUT
        plain = method is None and not pipeline
        if "input" not in data and not (method is not None and method.reads == "nothing"):
            raise top.error('the recipe needs the key "input"')
        recipe = cls(
            name=name,
            text=text,
            folder=Path(folder),
            title=data.get("title", ""),
            input=freeze_mapping(
                checked_table(
                    data.get("input", {}), fields, Place(name, text, "[input]"), what="[input]"
                )
            ),
            steps=steps,
            checks=_several(
                data.get("check", []),
                {"": CHECK if plain else METHOD_CHECK},
                "",
                "[[check]]",
                top,
            ),
            outputs=_several(
                data.get("output", []),
                OUTPUTS if plain else METHOD_OUTPUTS,
                "kind",
                "[[output]]",
                top,
            ),
        )
        check_recipe(recipe)
        return recipe

    def place(self, header: str, number: int = 0) -> Place:
        """Return where a table of the recipe stands, to name its lines in messages.

        Parameters
        ----------
        header : str
            Such as ``[input]`` or ``[[output]]``; empty for the top.
        number : int, optional
            Which of the equal headers, from 0.

        Returns
        -------
        Place
            Of that table.
        """
        return Place(self.name, self.text, header, number)

    def run(
        self,
        inputs: PathLike | Iterable[PathLike] | None = None,
        *,
        out: PathLike | None = None,
        progress: Progress | None = None,
    ) -> Result:
        """Carry out the recipe.

        Parameters
        ----------
        inputs : path or iterable of paths, optional
            Files, or folders that hold the files of ``[input]``; the recipe's own folder if
            omitted.
        out : str or path, optional
            Folder for tables, reports and result.json, made if needed; nothing is written if
            omitted.
        progress : callable, optional
            Told what is being done.

        Returns
        -------
        Result
            Document, estimate and the files that were written.

        Raises
        ------
        MetrosepError
            Of any kind of its tree; result.json is written last, so its absence means that the
            run did not finish.
        """
        from metrosep.recipe.run import run_recipe

        return run_recipe(self, inputs, out=out, progress=progress)

    def batch(self, folder: PathLike, *, out: PathLike, **options: Any) -> None:
        """Refuse: running a folder of inputs comes with the batch capability.

        Parameters
        ----------
        folder, out : str or path
            Input and output folders.
        **options
            Of the batch.

        Raises
        ------
        UnsupportedFeatureError
            Always, in this version.
        """
        raise UnsupportedFeatureError(
            f"this version has no batch over {folder}; call run() for each input"
        )


def _several(
    items: Any,
    kinds: Mapping[str, Mapping[str, Field]],
    selector: str,
    header: str,
    top: Place,
) -> tuple[Mapping[str, Any], ...]:
    """Check an array of tables whose `selector` key says of which kind each is."""
    if not isinstance(items, list) or not all(isinstance(i, dict) for i in items):
        raise top.error(f"write {header} with double brackets", header.strip("[]"))
    checked = []
    for number, item in enumerate(items):
        place = Place(top.file, top.text, header, number)
        kind = item.get(selector, "") if selector else ""
        if not isinstance(kind, str) or kind not in kinds:
            known = ", ".join(f'"{k}"' for k in kinds)
            raise place.error(
                f"{header} needs {selector} = one of {known}, found {kind!r}", selector
            )
        what = f"{header} {number + 1}" + (f" ({kind})" if kind else "")
        checked.append(freeze_mapping(checked_table(item, kinds[kind], place, what=what)))
    return tuple(checked)

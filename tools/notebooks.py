"""Make the tutorials of the documentation as executed notebooks (nbformat 4.5), in docs/notebooks.

Run with `python tools/notebooks.py [NAME ...]`, such as `pitch-table`; all tutorials without a name. A page
becomes cells: its text, its Python blocks, and its commands as `!metrosep ...`. They run in their order
in an empty folder that sees the examples, and what they print and draw is kept. A test holds the cells to
the pages; the outputs are those of the last run.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
TUTORIALS = HERE / "docs" / "tutorials"
TARGET = HERE / "docs" / "notebooks"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$\n?", re.DOTALL | re.MULTILINE)
DPI = 72
LONGEST, LONGEST_VALUE = 4000, 300
"""Characters that are kept of what a cell prints, and of its value."""


def pages() -> list[Path]:
    """Return the tutorials."""
    return sorted(TUTORIALS.glob("*.md"))


def cells_of(page: str) -> list[tuple[str, str]]:
    """Return kind and source of the cells of a page."""
    cells: list[tuple[str, str]] = []
    end = 0
    for found in FENCE.finditer(page):
        language, code = found.groups()
        if language != "python" and not (language == "console" and code.startswith("metrosep ")):
            continue  # an output, another program: it stays in the text
        cells.append(("markdown", page[end : found.start()]))
        if language == "console":
            code = re.sub(r"^metrosep ", "!metrosep ", code, flags=re.MULTILINE)
        elif code.lstrip().startswith(">>>"):  # a session: its input
            lines = [line for line in code.splitlines() if line.startswith((">>>", "..."))]
            code = "\n".join(line[4:] for line in lines)
        cells.append(("code", code))
        end = found.end()
    cells.append(("markdown", page[end:]))
    kept = [(kind, source.strip("\n")) for kind, source in cells if source.strip()]
    note = "Run this notebook in the root of the repository: it reads `examples`."
    return [kept[0], ("markdown", note), *kept[1:]]


def notebook(cells: list[tuple[str, str]], outputs: list[list[Any]]) -> dict[str, Any]:
    """Return a notebook of cells and their outputs."""
    made: list[dict[str, Any]] = []
    count = 0
    for i, ((kind, source), out) in enumerate(zip(cells, outputs, strict=True)):
        cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{i}", "metadata": {}}
        cell["source"] = source.splitlines(keepends=True)
        if kind == "code":
            count += 1
            cell |= {"execution_count": count, "outputs": out}
            for each in out:
                if each["output_type"] == "execute_result":
                    each["execution_count"] = count
        made.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {
        "cells": made,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def executed(cells: list[tuple[str, str]]) -> Iterator[list[Any]]:
    """Give the outputs of each cell."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    namespace: dict[str, Any] = {"__name__": "__main__"}
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        for name in ("examples", "data_formats"):
            (Path(folder) / name).symlink_to(HERE / name)
        os.chdir(folder)
        try:
            for kind, source in cells:
                yield [] if kind == "markdown" else list(_run(source, namespace, plt, folder))
        finally:
            os.chdir(before)


def _run(
    source: str, namespace: dict[str, Any], plt: Any, folder: str
) -> Iterator[dict[str, Any]]:
    text, value = io.StringIO(), None
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        if source.startswith("!"):
            from metrosep.cli.main import main

            for line in source.splitlines():
                if line.startswith("!metrosep "):
                    with contextlib.suppress(SystemExit):
                        main(shlex.split(line, comments=True)[1:])
        else:
            tree = ast.parse(source)
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, "cell", "exec"), namespace)  # noqa: S102
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), "cell", "eval"), namespace)  # noqa: S307

    def without_folder(said: str) -> str:
        return said.replace(f"{os.path.realpath(folder)}/", "").replace(f"{folder}/", "")

    printed = without_folder(text.getvalue())
    if printed:
        kept = printed[:LONGEST] + ("...\n" if len(printed) > LONGEST else "")
        yield {"output_type": "stream", "name": "stdout", "text": kept.splitlines(keepends=True)}
    if value is not None:
        said = without_folder(repr(value))
        said = said if len(said) <= LONGEST_VALUE else f"{said[:LONGEST_VALUE]} ..."
        shown = {"text/plain": said.splitlines(keepends=True)}
        yield {"output_type": "execute_result", "metadata": {}, "data": shown}
    for number in plt.get_fignums():
        png = io.BytesIO()
        plt.figure(number).savefig(png, dpi=DPI, metadata={"Software": None})
        data = {"image/png": base64.b64encode(png.getvalue()).decode("ascii")}
        yield {"output_type": "display_data", "metadata": {}, "data": data}
    plt.close("all")


def main(names: list[str]) -> None:
    """Write the notebooks."""
    TARGET.mkdir(exist_ok=True)
    for page in pages():
        if names and page.stem not in names:
            continue
        cells = cells_of(page.read_text("utf-8"))
        made = notebook(cells, list(executed(cells)))
        file = TARGET / f"{page.stem}.ipynb"
        file.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", "utf-8")
        print(f"{file.name}: {file.stat().st_size} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])

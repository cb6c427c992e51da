"""Where a result comes from, as texts of a report: part and file, inputs with their hashes, steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.recipe.step_words import keys_of_step
from metrosep.report.rows import one_line
from metrosep.report.settings import in_words, step_parameters
from metrosep.report.text import size

__all__ = ["header_rows", "input_row", "short_hashes", "step_row"]

Document = Mapping[str, Any]


def header_rows(document: Document) -> list[tuple[str, str]]:
    """Return part, serial and other names that a batch found, with the file where there is one."""
    unit = document.get("unit") or {}
    groups = sorted((unit.get("groups") or {}).items())  # as a result.json holds them
    rows = [(in_words(str(k)), str(v)) for k, v in groups]
    if unit.get("name"):
        rows.append(("file", str(unit["name"])))
    return [(name.capitalize(), one_line(value)) for name, value in rows]


def short_hashes(document: Document) -> str:
    """Return the short hashes of recipe and inputs, for the foot of a page."""
    recipe = str((document.get("recipe") or {}).get("sha256") or "none")[:12]
    inputs = [str(i.get("sha256") or "none")[:12] for i in document.get("inputs") or []]
    more = f" and {len(inputs) - 1} more" if len(inputs) > 1 else ""
    return f"recipe {recipe}, input {inputs[0] if inputs else 'none'}{more}"


def input_row(entry: Document) -> dict[str, str]:
    """Return a file that was read.

    Examples
    --------
    >>> input_row({"name": "m1.dat", "beside": "m1.txt", "size": 56})["name"]
    'm1.dat (read beside m1.txt)'
    """
    name = str(entry.get("name") or "not named")
    notes = [f"read beside {entry['beside']}"] if entry.get("beside") else []
    notes += [f"measured {entry['measured_at']}"] if entry.get("measured_at") else []
    return {
        "name": f"{name} ({'; '.join(notes)})" if notes else name,
        "size": size(entry.get("size")),
        "format": str(entry.get("format") or "–"),
        "sha256": str(entry.get("sha256") or "–"),
    }


def step_row(step: Document) -> dict[str, str]:
    """Return a step of the history."""
    name = str(step.get("step") or "")
    keys = keys_of_step(name)
    fields = {} if keys is None else keys.step
    in_table = name in ("read", "read_columns")  # of the inputs
    told = ("op", "sha256", "size") if in_table else ("op",)
    given = {k: v for k, v in (step.get("parameters") or {}).items() if k not in told}
    return {
        "name": name,
        "parameters": step_parameters(given, fields),
        "version": str(step.get("version") or ""),
    }

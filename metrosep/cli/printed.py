"""What the command line prints about a named separation, and in which words."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import say

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.result import Result

__all__ = ["print_files", "print_named", "recipe_words"]

_SUMMARY = ("op", "what", "method", "null_space", "noise", "audit", "units", "runs", "result")


def recipe_words(recipe: Recipe, message: str) -> str:
    """Return a message of the library with its arguments as keys of a recipe."""
    from metrosep.recipe.step_help import recipe_words

    message = message.replace(" or say overwrite", " or give --force")
    return recipe_words(recipe, message)


def print_named(recipe: Recipe, result: Result, *, as_json: bool, command: bool = False) -> None:
    """Print what a named separation found."""
    from metrosep.recipe.step_help import step_words
    from metrosep.report.text import not_seen

    op, document = recipe.steps[0]["op"], result.document
    messages = [step_words(m, op, command=command) for m in document["messages"]]
    if as_json:
        kept = ("characteristics", "messages", "inputs", "verdict")
        separation = {k: v for k, v in document["separation"].items() if k in _SUMMARY}
        summary = {k: document[k] for k in kept} | {"separation": separation}
        summary["messages"] = messages
        summary["files"] = [str(f) for f in result.files]
        click.echo(json.dumps(summary, sort_keys=True, allow_nan=False))
        return
    for line in _values(document["characteristics"]):
        say(line)
    for feed, runs in document["separation"].get("runs") or []:
        say(f"next: {runs} run(s) at {feed:.6g} mm/min")
    for parts, what in not_seen(document["separation"]):
        say(f"not seen: {parts}: {step_words(what, op, command=command)}".replace("µ", "u"))
    for message in messages:
        say(f"note: {message}")
    for entry in document["characteristics"]:
        if entry.get("reason") or entry.get("u_note"):
            say(f"{entry['metric']}: {entry['verdict']}: {entry.get('reason') or entry['u_note']}")
    if result.verdict is not None:
        say(f"verdict: {result.verdict}")
    print_files(result, "parts")


def print_files(result: Result, usual: str) -> None:
    """Print what was written: tables and their sidecars are known by the document."""
    of_tables = [result.document.get("table"), *result.document.get("more_tables", ())]
    tables = {t.get("path") for t in of_tables if t}
    for file in result.files:
        label = {".json": "result", ".html": "report"}.get(file.suffix, usual)
        if file.name in tables:
            label = "table"
        elif file.name.removesuffix(".json") in tables:
            label = "sidecar"
        say(f"{label:8} {file}")


def _values(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return a line for each value; P-V and RMS of one part share theirs."""
    from metrosep.core.readable import value_text

    lines: dict[str, list[str]] = {}
    for entry in entries:
        part, _, kind = str(entry["metric"]).rpartition(".")
        text = value_text(entry["value"], entry["unit"], entry["u"])
        if part and kind in _EXTREMES:
            lines.setdefault(part, []).append(f"{_EXTREMES[kind]} {text}")
        else:
            lines.setdefault(str(entry["metric"]), []).append(text)
    return [f"{name}: {', '.join(texts)}" for name, texts in lines.items()]


_EXTREMES = {"pv": "P-V", "rms": "RMS"}

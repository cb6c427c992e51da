"""A result as plain pages of matplotlib: the PDF for where typst is not installed."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.report.html import captions_of
from metrosep.report.rows import one_line
from metrosep.report.view import view

__all__ = ["render_plain_pdf", "write_plain_pdf"]


def render_plain_pdf(document: Mapping[str, Any]) -> bytes:
    """Return the report of a result as plain pages."""
    from metrosep.plot.pages import plain_pages

    shown = view(document)
    lines = [(style, one_line(text)) for style, text in _lines(shown)]
    footer = f"SHA-256: {shown['hashes']}, metrosep {one_line(shown['version'])}"
    captions = {k: one_line(f"{t}. {c}") for k, (t, c) in captions_of(document).items()}
    return plain_pages(document, lines, captions, footer)


def write_plain_pdf(document: Mapping[str, Any], path: str | os.PathLike[str]) -> Path:
    """Write the report of a result as plain pages.

    Parameters
    ----------
    document : mapping
        Content of a result.json.
    path : str or path
        File.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        If the result is damaged or a verdict is unknown.
    WriteError
        If it cannot be written.
    """
    return atomic_write(path, render_plain_pdf(document))


def _lines(shown: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    mark = shown["stamp"]
    yield "title", shown["title"]
    yield "head", f"{mark.symbol} {mark.word}"
    yield "text", mark.meaning
    if shown["decision_rule"] and mark.word != "NO VERDICT":
        yield "text", f"Decision rule: {shown['decision_rule']}"
    yield from _facts(shown["header"])
    for message in shown["messages"]:
        yield "text", f"Note: {message}"
    yield from _facts(shown["summary"])
    if shown["characteristics"]:
        yield from _head("Characteristics")
        for entry in shown["characteristics"]:
            yield from _characteristic(entry)
    yield from _table(shown["table"])
    if shown["polynomial"]:
        yield from _head(f"Polynomial of the {shown['polynomial']['meaning']}")
        yield from (("mono", line) for line in shown["polynomial"]["horner"].splitlines())
        yield from _facts(shown["polynomial"]["rows"])
    yield from _head("Where it comes from")
    for item in shown["inputs"]:
        yield "text", f"{item['name']} ({item['format']}, {item['size']})"
        yield "mono", f"SHA-256 {item['sha256']}"
    for step in shown["steps"]:
        yield "text", f"{step['name']}: {step['parameters']} (metrosep {step['version']})"
    versions = [f"{name} {value}" for name, value in shown["versions"]]
    yield "text", ", ".join([f"metrosep {shown['version']}", *versions])
    if shown["recipe"]:
        yield from _head("Recipe")
        yield "mono", f"SHA-256 {shown['recipe'].get('sha256')}"
        text = str(shown["recipe"].get("text") or "")
        yield from (("mono", line) for line in text.splitlines())
    yield from _head("Signatures")
    for who in shown["signatures"]:
        yield "text", ""
        yield "mono", f"{who:<12} name {'_' * 24} date {'_' * 14} signature {'_' * 24}"


def _head(text: str) -> Iterator[tuple[str, str]]:
    yield "text", ""
    yield "head", text


def _facts(rows: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    yield from (("text", f"{name}: {value}") for name, value in rows)


def _characteristic(entry: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    words = [f"{entry['name']} = {entry['value']} {entry['unit']}".strip()]
    words += [f"{k} = {entry[k]}" for k in ("u", "U") if entry[k] != "–"]
    if entry["limits"] != "–":
        words.append(f"limits {entry['limits']}, guard band {entry['guard'] or 'not known'}")
    if entry["stamp"]:
        words.append(f"{entry['stamp'].symbol} {entry['stamp'].word}")
    yield "text", "; ".join(words)


def _table(table: Mapping[str, Any] | None) -> Iterator[tuple[str, str]]:
    if not table:
        return
    yield from _head("Compensation table")
    for found in table["findings"]:
        yield "text", f"{found['level']}: {found['problem']} {found['fix']}"
    yield from _facts(table["rows"])
    check = table["verification"]
    if check is None:
        yield "text", f"Dry-run: {table['waived']}. The sign is not proven on a measurement."
        return
    does = "shrinks" if check["passed"] else "does not shrink"
    yield "text", f"Dry-run: the table {does} the measured error in every direction."
    for row in check["rows"]:
        yield (
            "text",
            f"{row['direction']}, {row['quantity']}: before {row['before']}, after {row['after']}",
        )

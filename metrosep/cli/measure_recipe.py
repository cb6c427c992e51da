"""The recipe that a call of ``metrosep measure`` stands for."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from metrosep.cli.evaluation import Limits, Settings
from metrosep.cli.shortcut import input_lines, quoted
from metrosep.core.text_options import TEXT_OPTIONS

__all__ = ["measure_recipe"]

_PLAIN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?:SI)?\s*")
_EDITIONS = ("ISO 21920-2:2021", "ISO 4287:1997")
_INPUT = ("unit", "lateral_step", "channel", "format", *TEXT_OPTIONS)


def measure_recipe(
    file: str,
    settings: Settings,
    limits: Limits,
    reading: Mapping[str, Any],
    lengths: Mapping[str, str | None],
) -> str:
    """Return the recipe of a call as TOML."""
    lines = ["metrosep = 1", "", "[input]", f"files = [{quoted(file)}]"]
    lines += input_lines(reading, _INPUT)
    if settings.form.strip().lower() != "none":
        lines += ["", "[[step]]", 'op = "form"', f"form = {quoted(settings.form)}"]
    if settings.lambda_s is not None or settings.lambda_c is not None:
        lines += ["", *_filter(settings, lengths)]
    lines += ["", *_parameters(settings)]
    for symbol in {**limits.lower, **limits.upper}:
        lines += ["", "[[check]]", f"metric = {quoted(symbol)}"]
        given = (("lower", limits.lower), ("upper", limits.upper), ("U", limits.U))
        lines += [f"{k} = {_limit(texts[symbol])}" for k, texts in given if symbol in texts]
        if limits.guard_factor != 1.0:
            lines.append(f"guard_factor = {limits.guard_factor!r}")
    return "\n".join([*lines, "", "[[output]]", 'kind = "report"', ""])


def _filter(settings: Settings, lengths: Mapping[str, str | None]) -> list[str]:
    lines = ["[[step]]", 'op = "filter"']
    lines += [f"{k} = {quoted(v)}" for k, v in lengths.items() if v is not None]
    if settings.lambda_c is not None and settings.kind == "W":
        lines.append('profile = "W"')
    elif settings.lambda_c is not None and settings.sections is not None:
        lines.append(f"sections = {settings.sections}")
    if settings.end != "moment":
        lines.append(f"end = {quoted(settings.end)}")
    return lines


def _parameters(settings: Settings) -> list[str]:
    names = ", ".join(quoted(n) for n in settings.names or ("all",))
    lines = ["[[step]]", 'op = "parameters"', f"names = [{names}]"]
    if settings.kind is not None:
        lines.append(f"kind = {quoted(settings.kind)}")
    if settings.edition is not None:
        lines.append(f"edition = {quoted(_edition(settings.edition))}")
    if settings.sections is not None:
        lines.append(f"sections = {settings.sections}")
    if settings.centre:
        lines.append("centre = true")
    if settings.line != "lsq":
        lines.append(f"line = {quoted(settings.line)}")
    if settings.reference != "MZ":
        lines.append(f"reference = {quoted(settings.reference)}")
    return lines


def _edition(text: str) -> str:
    """Return an edition as recipes spell it; spaces and case do not count."""
    plain = "".join(text.lower().split())
    return next((e for e in _EDITIONS if "".join(e.lower().split()) == plain), text)


def _limit(text: str) -> str:
    """Return a limit as TOML has it: with its unit in quotes, a pure number or SI without."""
    number = _PLAIN.fullmatch(text)
    return quoted(text) if number is None else repr(float(number[1]))

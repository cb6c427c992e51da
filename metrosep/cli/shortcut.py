"""The recipe that a call of ``metrosep separate`` stands for."""

from __future__ import annotations

from typing import Any

__all__ = ["recipe_text"]

_INPUT = ("x", "z", "feed", "run", "direction", "time", "sampling_rate", "scale")
_SEPARATE = ("method", "start", "length", "shortest", "lag")


def recipe_text(options: dict[str, Any], *, table: tuple[str, str] | None, report: bool) -> str:
    """Return the recipe of a call as TOML.

    Parameters
    ----------
    options : dict
        Of the command.
    table : tuple of (str, str) or None
        Controller and file name of a table to write.
    report : bool
        Whether to write the report.

    Returns
    -------
    str
        TOML that `Recipe.parse` reads.
    """
    lines = ["metrosep = 1", "", "[input]"]
    lines += [f"{k} = {_quoted(options[k])}" for k in _INPUT if options.get(k) is not None]
    lines += ["", "[[step]]", 'op = "separate"']
    lines += [f"{k} = {_quoted(options[k])}" for k in _SEPARATE if options.get(k) is not None]
    if options.get("min_feeds") is not None:
        lines.append(f"min_feeds = {options['min_feeds']}")
    if options.get("poly") is not None:
        degree = str(options["poly"])
        lines += ["", "[[step]]", 'op = "polynomial"', 'quantity = "error"']
        lines.append(f"degree = {degree if degree.isdigit() else _quoted(degree)}")
    if table is not None:
        lines += ["", "[[output]]", 'kind = "table"', f"controller = {_quoted(table[0])}"]
        lines += [
            f"{k} = {_quoted(options[k])}"
            for k in ("axis", "compensates", "spacing", "reference")
            if options.get(k) is not None
        ]
        lines.append(f"path = {_quoted(table[1])}")
        if options.get("cross_axis") is not None:
            lines.append(f"machine = {{ cross_axis = {_quoted(options['cross_axis'])} }}")
    if report:
        lines += ["", "[[output]]", 'kind = "report"', 'formats = ["html"]']
    return "\n".join(lines) + "\n"


def _quoted(value: object) -> str:
    text = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{text}"'

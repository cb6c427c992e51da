"""The command that lists the controllers: what an entry is, limits, status, what they need."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import json_option

if TYPE_CHECKING:
    from metrosep.controllers.base import Dialect
    from metrosep.controllers.options import Option

__all__ = ["controllers"]

_STATUS = {
    "confirmed": "sign proven",
    "documented": "sign documented",
    "stated": "sign by a machine fact that you give",
    "unconfirmed": "sign NOT documented: try it on the machine, then --sign-confirmed",
}
_SOURCE = {"table": "result.json", "polynomial": "result.json", "map": "error_map.sdf"}


@click.command()
@click.argument("name", required=False)
@json_option
def controllers(name: str | None, as_json: bool) -> int:
    """List the controllers; with NAME all about one: options, limits, activation, an example."""
    from metrosep.controllers.registry import find, names

    found = [find(n) for n in ([name] if name else names())]
    if as_json:
        text = {"controllers": [_as_dict(d) for d in found]}
        click.echo(json.dumps(text, sort_keys=True, default=str))
    elif name:
        click.echo("\n".join(_page(found[0])))
    else:
        for d in found:
            click.echo("\n".join(_summary(d)))
        click.echo("\nmetrosep controllers NAME tells options, activation and an example.")
    return 0


def _as_dict(dialect: Dialect) -> dict[str, Any]:
    info = {**asdict(dialect.info), "example": dict(dialect.info.example)}
    return {**info, "options": [asdict(o) for o in dialect.options]}


def _summary(dialect: Dialect) -> list[str]:
    d = dialect.info
    limit = "no limit of points" if d.max_points is None else f"at most {d.max_points} points"
    return [
        f"{d.id:20} {d.title}",
        f"{'':20} holds   {_holds(dialect)}; {limit}",
        f"{'':20} entry   {d.entry}",
        f"{'':20} sign    {_STATUS[d.sign]} ({d.sign_status})",
    ]


def _holds(dialect: Dialect) -> str:
    d = dialect.info
    what = {
        "table": "corrections over one axis",
        "map": "corrections over two axes",
        "polynomial": "a polynomial",
    }[d.carries]
    if d.carries == "polynomial":
        return what
    ways = "both directions" if d.directions == "two" else "one value both ways"
    return f"{what}, {d.spacing} spacing, {ways}"


def _page(dialect: Dialect) -> list[str]:
    d = dialect.info
    limit = "no limit" if d.max_points is None else str(d.max_points)
    facts = {
        "holds": _holds(dialect),
        "entry": d.entry,
        "sign": f"{_STATUS[d.sign]} ({d.sign_status})",
        "units": d.units,
        "resolution": d.resolution or "not stated",
        "points": limit,
        "outside": d.outside,
        "reference": d.reference_rule or "free",
        "proof": d.proof,
    }
    lines = [f"{d.id}: {d.title}", ""]
    lines += [f"  {name:11} {value}" for name, value in facts.items()]
    lines += ["", "options (--machine NAME=VALUE)"]
    lines += [f"  {_option(o)}" for o in dialect.options] or ["  none"]
    lines += ["", "limits that can be checked (--machine NAME=VALUE)", f"  {_limits()}"]
    lines += ["", "activation"]
    lines += [f"  {i}. {step}" for i, step in enumerate(d.activation, start=1)]
    return [*lines, "", "example", f"  {_example(dialect)}"]


def _option(option: Option) -> str:
    if option.required:
        status = "required"
    elif option.default is None:
        status = "optional"
    else:
        status = f"default {option.default}"
    kind = "/".join(map(str, option.choices)) if option.choices else option.kind
    return f"{option.name:18} {kind}, {status}: {option.help}"


def _limits() -> str:
    from metrosep.controllers.options import LIMIT_DIMENSIONS

    return ", ".join(["max_points", *LIMIT_DIMENSIONS])


def _example(dialect: Dialect) -> str:
    d = dialect.info
    words = ["metrosep", "table", _SOURCE[d.carries], "--format", d.id, "-o", f"x{d.suffix}"]
    for name, value in d.example.items():
        words += ["--machine", f'"{name}={value}"']
    if d.sign == "unconfirmed":
        words.append("--sign-confirmed")
    return " ".join(words)

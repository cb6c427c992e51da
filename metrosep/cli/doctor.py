"""Commands about the installation: doctor, completion."""

from __future__ import annotations

import json
import platform
import re
import sys

import click

from metrosep.cli.options import json_option


@click.command()
@json_option
def doctor(as_json: bool) -> int:
    """Check the installation: versions, what optional packages add, folders, fonts.

    Exit code 0: all that is needed is there; 2: something needed is missing.
    """
    found = _findings()
    if as_json:
        click.echo(json.dumps(found, sort_keys=True))
    else:
        for name, version in found["versions"].items():
            click.echo(f"{name:<14} {version or 'MISSING: pip install ' + name}")
        for extra, state in found["extras"].items():
            click.echo(f"[{extra}]{'':<{max(1, 12 - len(extra))}} {state}")
        for name, state in found["places"].items():
            click.echo(f"{name:<14} {state}")
    return 2 if None in found["versions"].values() else 0


def _findings() -> dict[str, dict[str, str | None]]:
    import tempfile
    from importlib.metadata import metadata

    from metrosep._version import __version__

    versions: dict[str, str | None] = {
        "metrosep": __version__,
        "python": f"{platform.python_version()} ({sys.executable})",
        "system": f"{platform.system()} {platform.machine()}",
    }
    declared = metadata("metrosep")
    required = [r.replace("'", '"') for r in declared.get_all("Requires-Dist") or []]
    needed = [_name(r) for r in required if "extra ==" not in r]
    versions |= {name: _version(name) for name in needed}
    extras: dict[str, str | None] = {}
    for extra in declared.get_all("Provides-Extra") or []:
        names = [_name(r) for r in required if f'extra == "{extra}"' in r]
        missing = [n for n in names if _version(n) is None]
        extras[extra] = (
            f'not installed ({", ".join(missing)}): pip install "metrosep[{extra}]"'
            if missing
            else ", ".join(f"{n} {_version(n)}" for n in names)
        )
    places: dict[str, str | None] = {}
    try:
        with tempfile.TemporaryFile() as file:
            file.write(b"x" * 1024)
        places["scratch"] = f"{tempfile.gettempdir()} can be written"
    except OSError as exc:
        places["scratch"] = f"{tempfile.gettempdir()} cannot be written ({exc.strerror or exc})"
    places["encoding"] = f"{sys.getfilesystemencoding()} for names of files"
    return {"versions": versions, "extras": extras, "places": places}


def _name(requirement: str) -> str:
    """Return the name of a package from a requirement."""
    return re.split(r"[^\w.-]", requirement.strip(), maxsplit=1)[0]


def _version(name: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish", "powershell"]))
def completion(shell: str) -> int:
    """Print the script that completes commands and options in SHELL.

    bash: metrosep completion bash >> ~/.bashrc; zsh: metrosep completion zsh >> ~/.zshrc; fish:
    metrosep completion fish > ~/.config/fish/completions/metrosep.fish.
    """
    from click.shell_completion import get_completion_class

    from metrosep.cli.main import cli

    made = get_completion_class(shell)
    if made is None:
        raise click.UsageError(
            f"this version of click has no completion for {shell}; update it: pip install --upgrade click"
        )
    script = made(cli, {}, "metrosep", "_METROSEP_COMPLETE")
    click.echo(script.source_template % script.source_vars())
    return 0

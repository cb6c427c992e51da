"""Commands about the installation: doctor, completion."""

from __future__ import annotations

import json
import platform
import sys

import click

from metrosep.cli.options import json_option

__all__ = ["completion", "doctor"]

_NEEDED = (
    "click", "h5py", "lmfit", "matplotlib", "numpy", "pandas", "scikit-image", "scipy", "jinja2",
    "defusedxml", "threadpoolctl",
)  # fmt: skip


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
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }
    versions |= {name: _version(name) for name in _NEEDED}
    declared = metadata("metrosep")
    extras: dict[str, str | None] = {}
    for extra in declared.get_all("Provides-Extra") or []:
        marker = f'extra == "{extra}"'
        lines = [
            r.partition(";")[0].strip()
            for r in declared.get_all("Requires-Dist") or []
            if marker in r.replace("'", '"')
        ]
        names = ["".join(_name(line)) for line in lines]
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
    return (
        requirement.split(">", maxsplit=1)[0]
        .split("=", maxsplit=1)[0]
        .split("<", maxsplit=1)[0]
        .split("[", maxsplit=1)[0]
        .strip(" (")
    )


def _version(name: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


_POWERSHELL = """Register-ArgumentCompleter -Native -CommandName metrosep -ScriptBlock {
  param($word, $ast, $place)
  $env:COMP_WORDS = $ast.ToString(); $env:COMP_CWORD = $ast.CommandElements.Count - [int]($word -ne "")
  $env:_METROSEP_COMPLETE = "powershell_complete"
  metrosep --help 2>$null | Select-String "^  (\\\\S+)  " | ForEach-Object { $_.Matches[0].Groups[1].Value } |
    Where-Object { $_ -like "$word*" } | ForEach-Object {
      [System.Management.Automation.CompletionResult]::new($_, $_, "ParameterValue", $_) }
  Remove-Item Env:_METROSEP_COMPLETE
}
"""


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish", "powershell"]))
def completion(shell: str) -> int:
    """Print the script that completes commands and options in SHELL.

    bash: metrosep completion bash >> ~/.bashrc; zsh: metrosep completion zsh >> ~/.zshrc; fish:
    metrosep completion fish > ~/.config/fish/completions/metrosep.fish.
    """
    if shell == "powershell":
        click.echo(_POWERSHELL, nl=False)
        return 0
    from click.shell_completion import get_completion_class

    from metrosep.cli.main import cli

    made = get_completion_class(shell)
    assert made is not None  # noqa: S101  # one of the choices
    script = made(cli, {}, "metrosep", "_METROSEP_COMPLETE")
    click.echo(script.source_template % script.source_vars())
    return 0

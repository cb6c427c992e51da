"""``metrosep ui``: the workbench in the browser, loopback only."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import click

from metrosep.cli.options import say

_MISSING = (
    "the workbench needs starlette, uvicorn, websockets and tomlkit: pip install 'metrosep[ui]'"
)


@click.command()
@click.argument("files", nargs=-1, metavar="[FILE]...")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port. 0: any free port.")
@click.option("--no-browser", is_flag=True, help="Print the address, without opening a browser.")
@click.option(
    "--folder",
    "folders",
    multiple=True,
    metavar="DIR",
    help="Another folder that the page may use.",
)
@click.option("--operator", metavar="RECIPE", help="Only measure parts by this recipe.")
@click.option("--inbox", metavar="DIR", help="With --operator: where measurements arrive.")
@click.option("--out", metavar="DIR", help="With --operator: where results go.")
@click.option(
    "--serial", metavar="REGEX", help="With --operator: what a serial number looks like."
)
def ui(
    files: tuple[str, ...],
    port: int,
    no_browser: bool,
    folders: tuple[str, ...],
    operator: str | None,
    inbox: str | None,
    out: str | None,
    serial: str | None,
) -> int:
    """Open the workbench in the browser, with FILE: a map, a profile, a recipe, or several runs.

    It listens on this computer only, and asks for the token in the address that it prints. The
    recipe is kept with every change, in your folder of state (~/.local/state/metrosep on Linux), not
    beside FILE; files outside FILE's folder, --folder and what is dropped onto the page are not
    touched. Ctrl-C ends it.

    With --operator the page knows one recipe and cannot change it: a serial number, the newest file
    of the inbox, a verdict. Each result goes to a folder of its own in --out.
    """
    from metrosep.core.errors import ReadError, UnsupportedFeatureError

    try:
        import uvicorn

        from metrosep.app.documents import Places
        from metrosep.app.server import make_app, new_token
    except ModuleNotFoundError as exc:
        if (exc.name or "").partition(".")[0] in ("starlette", "uvicorn", "websockets", "tomlkit"):
            raise UnsupportedFeatureError(_MISSING) from None
        raise
    if operator is not None or inbox or out or serial:
        _require_operator(operator, inbox, out, others=[*files, *folders])
    first = [Path(f) for f in files]
    for file in first:
        if not file.is_file():
            raise ReadError(f"{file}: there is no such file")
    places = list(dict.fromkeys(f.resolve().parent for f in first)) or [Path.cwd()]
    opened = [*places, *map(Path, folders)]
    listener = _listener(port)
    token, port = new_token(), listener.getsockname()[1]
    if operator is not None:
        from metrosep.app.operator import SERIAL, Operation, make_operator_app

        operation = Operation(Path(operator), Path(str(inbox)), Path(str(out)), serial or SERIAL)
        app = make_operator_app(operation, port=port, token=token)
    else:
        names = [str(f.resolve()) for f in first]
        app = make_app(Places(opened), port=port, token=token, first=names)
    address = f"http://127.0.0.1:{port}/?token={token}"
    say(f"metrosep: the workbench is at {address}")
    if not no_browser:
        import webbrowser

        webbrowser.open(address)
    settings = uvicorn.Config(
        app, log_level="warning", ws="websockets-sansio", server_header=False
    )
    with contextlib.closing(listener):
        uvicorn.Server(settings).run(sockets=[listener])
    return 0


def _require_operator(
    operator: str | None, inbox: str | None, out: str | None, *, others: list[str]
) -> None:
    """Refuse options of operator mode that do not go together."""
    from metrosep.core.errors import DataError

    given = {"--operator RECIPE": operator, "--inbox DIR": inbox, "--out DIR": out}
    missing = [name for name, value in given.items() if not value]
    if missing:
        raise DataError(f"operator mode needs {', '.join(missing)}, too")
    if others:
        raise DataError(f"{others[0]}: operator mode opens nothing but its recipe and its inbox")


def _listener(port: int) -> socket.socket:
    """Return a socket of the loopback; nothing else can reach it."""
    from metrosep.core.errors import DataError

    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        made.bind(("127.0.0.1", port))
        made.listen()  # from here on a browser waits, though the server is not at work yet
    except OSError as exc:
        made.close()
        raise DataError(
            f"port {port} cannot be used ({exc.strerror or exc}); leave --port out, or choose another"
        ) from None
    return made

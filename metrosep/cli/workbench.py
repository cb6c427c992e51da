"""``metrosep ui``: the workbench in the browser, loopback only."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import click

from metrosep.cli.options import say

__all__ = ["ui"]

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
def ui(files: tuple[str, ...], port: int, no_browser: bool, folders: tuple[str, ...]) -> int:
    """Open the workbench in the browser, with FILE: a map, a profile, a recipe, or several runs.

    It listens on this computer only, and asks for the token in the address that it prints. The
    recipe is kept beside FILE with every change; files outside FILE's folder, --folder and what is
    dropped onto the page are not touched. Ctrl-C ends it.
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
    first = [Path(f) for f in files]
    for file in first:
        if not file.is_file():
            raise ReadError(f"{file}: there is no such file")
    places = list(dict.fromkeys(f.resolve().parent for f in first)) or [Path.cwd()]
    opened = [*places, *map(Path, folders)]
    listener = _listener(port)
    token, port = new_token(), listener.getsockname()[1]
    app = make_app(
        Places(opened),
        port=port,
        token=token,
        first=[str(f.resolve()) for f in first],
    )
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

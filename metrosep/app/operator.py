"""Operator mode: one locked recipe, a serial number, one button, a verdict; results file themselves."""

from __future__ import annotations

import json
import re
import stat
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from metrosep.app.server import STATIC, Guard, new_cookie, safe_headers
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, MetrosepError, ReadError
from metrosep.recipe.recipe import Recipe

__all__ = ["SERIAL", "Operation", "make_operator_app"]

SERIAL = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
"""Serial numbers where no other pattern is given."""

RECORD = "operator.json"
"""Written last beside a result: serial, operator, file, verdict, reason."""

_REST = 1.0
"""Seconds for which size and time of a file must rest before it counts as whole."""

_NAME = re.compile(r"[^\x00-\x1f\x7f]{1,80}")
_LARGEST = 10_000
"""Bytes of a request: a name and a serial number."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part that was measured."""

    serial: str
    file: str
    verdict: str
    rows: tuple[Mapping[str, Any], ...]  # characteristics that were not accepted
    number: int  # of the measurement of this serial, from 1
    folder: Path
    reason: str = ""

    @property
    def needs_reason(self) -> bool:
        """Whether the operator has to say why before the next part."""
        return self.verdict != "accept" and not self.reason


class Operation:
    """What one shift does: the recipe is read once, and never written."""

    def __init__(
        self,
        recipe: Path,
        inbox: Path,
        out: Path,
        serial: str = SERIAL,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path, self.inbox, self.out = recipe, inbox, out
        self.recipe = Recipe.load(recipe)
        if not self.recipe.checks:
            raise DataError(f"{recipe.name} judges nothing: add a [[check]] with its limits")
        for folder, what in ((inbox, "--inbox"), (out, "--out")):
            if not folder.is_dir():
                raise ReadError(f"{what} {folder}: there is no such folder; make it first")
        if inbox.resolve() == out.resolve():
            raise DataError("--inbox and --out are the same folder: results would be measured")
        try:
            self.pattern = re.compile(serial)
        except re.error as exc:
            raise DataError(f"--serial {serial}: not a regular expression ({exc.msg})") from None
        self.clock = clock
        self.operator = ""
        self.part: Part | None = None
        self._lock = threading.Lock()
        self._seen: dict[Path, tuple[int, int, float]] = {}
        self._done: set[tuple[str, int, int]] = set()
        self._counts: dict[str, int] = {}
        for record in sorted(out.glob(f"*/{RECORD}")):
            try:
                held = json.loads(record.read_bytes())
                self._done.add((held["file"], int(held["size"]), int(held["mtime_ns"])))
                self._counts[held["serial"]] = self._counts.get(held["serial"], 0) + 1
            except (OSError, ValueError, KeyError, TypeError):
                continue  # another program's file of this name

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why a part may fail, as ``[operator]`` of the recipe lists them."""
        return tuple(self.recipe.operator.get("reasons", ()))

    def waiting(self) -> list[Path]:
        """Return whole files of the inbox that were not measured yet, the newest first."""
        now, found = self.clock(), []
        patterns = self.recipe.input.get("files") or ("*",)
        for path in {p for one in patterns for p in self.inbox.glob(Path(one).name)}:
            try:
                is_ = path.lstat()
            except OSError:
                continue
            if not stat.S_ISREG(is_.st_mode) or path.name.startswith("."):
                continue  # neither a device, a pipe nor a way out of the folder
            mark = (is_.st_size, is_.st_mtime_ns)
            size, mtime, since = self._seen.get(path, (-1, -1, now))
            if (size, mtime) != mark:
                self._seen[path] = (*mark, now)
            elif now - since >= _REST and (path.name, *mark) not in self._done:
                found.append((is_.st_mtime_ns, path.name, path))
        return [path for *_, path in sorted(found, reverse=True)]

    def state(self) -> dict[str, Any]:
        """Return what the page shows."""
        files = self.waiting()
        part = self.part
        return {
            "title": self.recipe.title or self.path.stem,
            "recipe": self.path.name,
            "hash": self.recipe.sha256[:12],
            "operator": self.operator,
            "file": files[0].name if files else None,
            "waiting": len(files),
            "reasons": list(self.reasons),
            "part": None
            if part is None
            else {
                "serial": part.serial,
                "file": part.file,
                "verdict": part.verdict,
                "rows": list(part.rows),
                "number": part.number,
                "needs_reason": part.needs_reason,
                "reason": part.reason,
                "folder": part.folder.name,
            },
        }

    def act(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Do what the page asks for, and return what it shows then."""
        with self._lock:
            kind, text = message.get("do"), message.get("text", "")
            acts = {"name": self._sign_on, "measure": self._measure, "reason": self._say_why}
            if not isinstance(text, str):
                raise DataError("a text is needed")
            if kind == "next":
                self._next()
            elif kind in acts:
                acts[str(kind)](text.strip())
            else:
                raise DataError(f"there is no request {kind!r}")
            return self.state()

    def _sign_on(self, name: str) -> None:
        if not _NAME.fullmatch(name):
            raise DataError("Type your name: it stands in the report of each part.")
        self.operator = name

    def _measure(self, serial: str) -> None:
        if not self.operator:
            raise DataError("Type your name first: it stands in the report of each part.")
        if self.part is not None:
            raise DataError("The last part is still shown: press Next part.")
        if not self.pattern.fullmatch(serial):
            raise DataError(f"{serial!r} is not a serial number of this part: scan it again.")
        if Path(serial).name != serial or serial.startswith(".") or not serial.isprintable():
            raise DataError(f"{serial!r} cannot be the name of a folder; ask who set up --serial.")
        files = self.waiting()
        if not files:
            raise DataError(
                "No new measurement is in the inbox: measure the part, then scan again."
            )
        file, number = files[0], self._counts.get(serial, 0) + 1
        is_ = file.stat()
        folder = self._free(serial, number)
        stated = [f"item.serial={serial}", f"persons.measured={self.operator}"]
        recipe = Recipe.load(self.path, report=stated)
        if recipe.sha256 != self.recipe.sha256:
            raise DataError("The recipe was changed since the start: start metrosep again.")
        result = recipe.run(file, out=folder)
        entries = [e for e in result.document["characteristics"] if e.get("verdict") is not None]
        rows = tuple(
            {
                k: e.get(k)
                for k in ("name", "metric", "value", "unit", "lower", "upper", "U", "verdict")
            }
            for e in entries
            if e["verdict"] != "accept"
        )
        part = Part(serial, file.name, str(result.verdict), rows, number, folder)
        self._record(part, is_.st_size, is_.st_mtime_ns)
        self._done.add((file.name, is_.st_size, is_.st_mtime_ns))
        self._counts[serial] = number
        self.part = part

    def _free(self, serial: str, number: int) -> Path:
        """Return a folder of the results that is not there yet."""
        while (folder := self.out / (serial if number == 1 else f"{serial}_{number}")).exists():
            number += 1
        return folder

    def _record(self, part: Part, size: int, mtime_ns: int) -> None:
        held = {
            "serial": part.serial, "operator": self.operator, "file": part.file, "size": size,
            "mtime_ns": mtime_ns, "verdict": part.verdict, "measurement": part.number,
            "reason": part.reason, "recipe_sha256": self.recipe.sha256,
        }  # fmt: skip
        text = json.dumps(held, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        atomic_write(part.folder / RECORD, text.encode("utf-8"))

    def _say_why(self, reason: str) -> None:
        part = self.part
        if part is None or not part.needs_reason:
            raise DataError("No part waits for a reason.")
        if self.reasons and reason not in self.reasons:
            raise DataError("Choose one of the reasons that the recipe lists.")
        if not _NAME.fullmatch(reason):
            raise DataError("Type a reason in a few words.")
        held = json.loads((part.folder / RECORD).read_bytes())
        self.part = Part(
            part.serial, part.file, part.verdict, part.rows, part.number, part.folder, reason
        )
        self._record(self.part, held["size"], held["mtime_ns"])

    def _next(self) -> None:
        if self.part is not None and self.part.needs_reason:
            raise DataError("Say why this part was not accepted, then go on.")
        self.part = None


def make_operator_app(operation: Operation, *, port: int, token: str) -> Starlette:
    """Return the application: one page, what it shows, and what it asks for; nothing else."""
    guard = Guard(token, port)

    def guarded(answer: Callable[[Request], Any]) -> Callable[[Request], Any]:
        async def route(request: Request) -> Response:
            reason = guard.refusal(
                {k.lower(): v for k, v in request.headers.items()},
                token=request.query_params.get("token"),
                cookies=request.cookies,
            )
            if reason is not None:
                return PlainTextResponse(f"403: {reason}", status_code=403)
            made: Response = await answer(request)
            return made

        return route

    async def page(request: Request) -> Response:
        text = (STATIC / "operator.html").read_text(encoding="utf-8")
        response = Response(text, media_type="text/html", headers=safe_headers())
        new_cookie(response, guard)
        return response

    async def state(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(operation.state))

    async def act(request: Request) -> Response:
        try:
            body = await request.body()
            message = json.loads(body) if len(body) <= _LARGEST else None
            if not isinstance(message, dict):
                raise DataError("a request is an object")
            return JSONResponse(await run_in_threadpool(operation.act, message))
        except MetrosepError as exc:
            return JSONResponse({"message": str(exc)}, status_code=400)
        except ValueError:
            return JSONResponse({"message": "the request is not JSON"}, status_code=400)

    def file(name: str) -> Route:
        async def answer(request: Request) -> Response:
            return FileResponse(STATIC / name)

        return Route(f"/static/{name}", guarded(answer))

    return Starlette(
        routes=[
            Route("/", guarded(page)),
            Route("/state", guarded(state)),
            Route("/act", guarded(act), methods=["POST"]),
            *map(file, ("operator.js", "operator.css", "format.js", "style.css")),
        ]
    )

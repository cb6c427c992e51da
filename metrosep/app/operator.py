"""Operator mode: one locked recipe, a serial number, one button, a verdict; results file themselves."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import stat
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from metrosep.app.server import STATIC, Guard, new_cookie, safe_headers
from metrosep.app.wire import page_words
from metrosep.core.atomic import atomic_write, left_behind, own_name
from metrosep.core.errors import DataError, MetrosepError, ReadError
from metrosep.core.inside import reading_inside
from metrosep.recipe.preflight import RESULT_NAME
from metrosep.recipe.recipe import Recipe

SERIAL = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
"""Serial numbers where no other pattern is given."""

RECORD = "operator.json"
"""Written last beside a result: serial, operator, file, verdict, reason."""

_UNFILED = "measuring"
"""Beginning of the name of a folder whose results are not filed yet."""

_REST = 1.0
"""Seconds for which size and time of a file must rest before it counts as whole."""

_AGAIN = "look which measurement is shown now, then scan again."
_NAME = re.compile(r"[^\x00-\x1f\x7f]{1,80}")
_LARGEST = 10_000
"""Bytes of a request: a name and a serial number."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part that was measured."""

    serial: str
    file: str
    verdict: str
    rows: tuple[Mapping[str, Any], ...]  # characteristics that were judged
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
        for left in left_behind(out, _UNFILED):
            shutil.rmtree(left, ignore_errors=True)
        self.clock = clock
        self.operator = ""
        self.part: Part | None = None
        self._lock = threading.Lock()
        self._seen: dict[Path, tuple[int, int, float]] = {}
        self._done: set[tuple[str, int, int]] = set()
        self._failed: set[tuple[str, int, int]] = set()
        self._counts: dict[str, int] = {}
        self._owed: list[Part] = []  # parts of an earlier start that still need a reason
        for record in sorted(out.glob(f"[!.]*/{RECORD}")):
            try:
                held = json.loads(record.read_bytes())
                self._done.add((held["file"], int(held["size"]), int(held["mtime_ns"])))
                self._counts[held["serial"]] = self._counts.get(held["serial"], 0) + 1
                if held["verdict"] in ("reject", "inconclusive") and not held["reason"]:
                    self._owed.append(_kept_part(held, record.parent))
            except (OSError, ValueError, KeyError, TypeError):
                continue  # another program's file of this name
        self._next()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why a part may fail, as ``[operator]`` of the recipe lists them."""
        return tuple(self.recipe.operator.get("reasons", ()))

    def waiting(self) -> list[Path]:
        """Return whole files of the inbox that were not measured yet, the newest first.

        Files that could not be measured come last: they hold up no other part.
        """
        now, found = self.clock(), []
        for path in {p for one in self._patterns for p in self.inbox.glob(one)}:
            is_ = _regular(path)
            if is_ is None:
                continue
            mark = (is_.st_size, is_.st_mtime_ns)
            size, mtime, since = self._seen.get(path, (-1, -1, now))
            if (size, mtime) != mark:
                self._seen[path] = (*mark, now)
            elif now - since >= _REST and (path.name, *mark) not in self._done:
                well = (path.name, *mark) not in self._failed
                found.append((well, is_.st_mtime_ns, path.name, path))
        return [path for *_, path in sorted(found, reverse=True)]

    @property
    def _patterns(self) -> list[str]:
        return [Path(one).name for one in self.recipe.input.get("files") or ("*",)]

    def _shown(self, file: Path) -> dict[str, Any]:
        """Return what the page is given of a file, and sends back with the serial number."""
        size, mtime_ns, _ = self._seen[file]
        return {"name": file.name, "size": size, "mtime_ns": str(mtime_ns)}  # no number of a page

    def _idle(self) -> str:
        """Return why nothing waits."""
        fit = {p for one in self._patterns for p in self.inbox.glob(one)}
        rest = sorted(p.name for p in self.inbox.glob("*") if p not in fit and _regular(p))
        said = "No new measurement is in the inbox: measure the part, then scan again."
        if not rest:
            return said
        names = ", ".join(rest[:3]) + (", …" if len(rest) > 3 else "")
        return (
            f"{said} The recipe takes only {', '.join(self._patterns)}, and what else lies there "
            f"is not measured: {names}."
        )

    def state(self) -> dict[str, Any]:
        """Return what the page shows."""
        files = self.waiting()
        part = self.part
        return {
            "title": self.recipe.title or self.path.stem,
            "recipe": self.path.name,
            "hash": self.recipe.recorded["sha256"][:12],
            "operator": self.operator,
            "file": self._shown(files[0]) if files else None,
            "waiting": len(files),
            "failed": [f.name for f in files if (f.name, *self._seen[f][:2]) in self._failed],
            "idle": "" if files else self._idle(),
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
            acts = {"name": self._sign_on, "reason": self._say_why}
            if not isinstance(text, str):
                raise DataError("a text is needed")
            if kind == "next":
                self._next()
            elif kind == "measure":
                self._measure(text.strip(), message.get("file"))
            elif isinstance(kind, str) and kind in acts:
                acts[kind](text.strip())
            else:
                raise DataError(f"there is no request {kind!r}")
            return self.state()

    def words(self, error: MetrosepError) -> str:
        """Return an error as the page says it: names of files and serial numbers stay."""
        part = () if self.part is None else (self.part.serial,)
        return page_words(str(error), [self.path, *part, *self._seen, self.out, self.inbox])

    def _sign_on(self, name: str) -> None:
        if not _NAME.fullmatch(name):
            raise DataError("Type your name: it stands in the report of each part.")
        self.operator = name

    def _measure(self, serial: str, shown: object) -> None:
        """Judge the file that the page showed, and no other: the serial number belongs to it."""
        if not self.operator:
            raise DataError("Type your name first: it stands in the report of each part.")
        if self.part is not None:
            raise DataError("The last part is still shown: press Next part.")
        if not self.pattern.fullmatch(serial):
            raise DataError(f"{serial!r} is not a serial number of this part: scan it again.")
        if Path(serial).name != serial or serial.startswith(".") or not serial.isprintable():
            raise DataError(f"{serial!r} cannot be the name of a folder; ask who set up --serial.")
        file, mark = self._chosen(shown)
        stated = [f"item.serial={serial}", f"persons.measured={self.operator}"]
        recipe = Recipe.load(self.path, report=stated)
        if recipe.sha256 != self.recipe.sha256:
            raise DataError("The recipe was changed since the start: start metrosep again.")
        number = self._counts.get(serial, 0) + 1
        # filed whole, by its name: what a halt leaves behind bears no name of a part
        made = self.out / own_name(_UNFILED)
        made.mkdir()
        try:
            with reading_inside([self.inbox.resolve()]):  # a link may be laid meanwhile
                result = _with_report(recipe).run(file, out=made)
            _require_same(file, mark)
            rows = _judged(result.document)
            part = Part(serial, file.name, str(result.verdict), rows, number, made)
            self._record(part, *mark[1:])
            part = replace(part, folder=made.rename(self._free(serial, number)))
        except BaseException as exc:
            shutil.rmtree(made, ignore_errors=True)
            if isinstance(exc, ReadError) or not isinstance(exc, OSError):  # a full disk passes
                self._failed.add(mark)
            raise
        self._done.add(mark)
        self._counts[serial] = number
        self.part = part

    def _chosen(self, shown: object) -> tuple[Path, tuple[str, int, int]]:
        """Return the file that the page showed, with its name, size and time then."""
        files = self.waiting()
        if shown is None:
            if files:
                raise DataError(f"{files[0].name} has just arrived: {_AGAIN}")
            raise DataError(self._idle())
        if not isinstance(shown, dict) or not isinstance(shown.get("name"), str):
            raise DataError("The page does not say which file it showed: load it again.")
        found = next((file for file in files if self._shown(file) == shown), None)
        if found is None:
            raise DataError(
                f"{shown['name']} changed since it was shown, or is no longer there: {_AGAIN}"
            )
        return found, (found.name, shown["size"], int(shown["mtime_ns"]))

    def _free(self, serial: str, number: int) -> Path:
        """Return a folder of the results that is not there yet."""
        while (folder := self.out / (serial if number == 1 else f"{serial}_{number}")).exists():
            number += 1
        return folder

    def _record(self, part: Part, size: int, mtime_ns: int) -> None:
        held = {
            "serial": part.serial, "operator": self.operator, "file": part.file, "size": size,
            "mtime_ns": mtime_ns, "verdict": part.verdict, "measurement": part.number,
            "reason": part.reason, "recipe_sha256": self.recipe.recorded["sha256"],
        }  # fmt: skip
        _keep(part.folder, held)

    def _say_why(self, reason: str) -> None:
        part = self.part
        if part is None or not part.needs_reason:
            raise DataError("No part waits for a reason.")
        if self.reasons and reason not in self.reasons:
            raise DataError("Choose one of the reasons that the recipe lists.")
        if not _NAME.fullmatch(reason):
            raise DataError("Type a reason in a few words.")
        held = json.loads((part.folder / RECORD).read_bytes())
        _keep(part.folder, {**held, "reason": reason})  # who measured it stays who measured it
        self.part = replace(part, reason=reason)

    def _next(self) -> None:
        if self.part is not None and self.part.needs_reason:
            raise DataError("Say why this part was not accepted, then go on.")
        self.part = self._owed.pop(0) if self._owed else None


def _regular(path: Path) -> os.stat_result | None:
    """Return what a file is; None of a device, a pipe, a way out of the folder, a hidden file."""
    try:
        is_ = path.lstat()
    except OSError:
        return None
    return is_ if stat.S_ISREG(is_.st_mode) and not path.name.startswith(".") else None


def _require_same(file: Path, mark: tuple[str, int, int]) -> None:
    is_ = _regular(file)
    if is_ is None or (is_.st_size, is_.st_mtime_ns) != mark[1:]:
        raise DataError(f"{file.name} changed while it was measured: {_AGAIN}")


def _keep(folder: Path, held: Mapping[str, Any]) -> None:
    text = json.dumps(held, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    atomic_write(folder / RECORD, text.encode("utf-8"))


def _with_report(recipe: Recipe) -> Recipe:
    """Return the recipe with a report, which each part gets, whatever it lists."""
    if any(output["kind"] == "report" for output in recipe.outputs):
        return recipe
    return replace(recipe, outputs=(*recipe.outputs, {"kind": "report"}))


def _judged(document: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """Return the characteristics of a result that were judged, what was not accepted first."""
    keys = ("name", "metric", "value", "unit", "lower", "upper", "U", "verdict")
    entries = [e for e in document["characteristics"] if e.get("verdict") is not None]
    entries.sort(key=lambda e: e["verdict"] == "accept")
    return tuple({k: e.get(k) for k in keys} for e in entries)


def _kept_part(held: Mapping[str, Any], folder: Path) -> Part:
    """Return a part as its folder holds it; without rows where result.json is gone."""
    try:
        rows = _judged(json.loads((folder / RESULT_NAME).read_bytes()))
    except (OSError, ValueError, KeyError, TypeError):
        rows = ()
    return Part(
        held["serial"], held["file"], held["verdict"], rows, int(held["measurement"]), folder
    )


async def _message(request: Request) -> dict[str, Any]:
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > _LARGEST:
            raise DataError(f"a request has at most {_LARGEST} bytes")
    try:
        message = json.loads(body)
    except ValueError:
        raise DataError("the request is not JSON") from None
    if not isinstance(message, dict):
        raise DataError("a request is an object")
    return message


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
            message = await _message(request)
            return JSONResponse(await run_in_threadpool(operation.act, message))
        except MetrosepError as exc:
            return JSONResponse({"message": operation.words(exc)}, status_code=400)
        except OSError as exc:
            said = f"Nothing was kept of this ({exc}): mend that, then do it again."
            return JSONResponse({"message": said}, status_code=500)
        except Exception as exc:  # a fault of ours: it is reported, and the page goes on
            logging.getLogger("metrosep").exception("operator mode")
            said = (
                f"internal error ({type(exc).__name__}: {exc}): this is a bug in metrosep; "
                "please report it with what the terminal says"
            )
            return JSONResponse({"message": said}, status_code=500)

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

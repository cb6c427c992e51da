"""The server of the workbench: one page, one session, loopback only."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import secrets
import threading
import traceback
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from metrosep.app.answers import CHANGING, KINDS, Answers
from metrosep.app.asking import Ask
from metrosep.app.guards import Guard
from metrosep.app.messages import Tell
from metrosep.app.places import Places
from metrosep.app.sessions import Session
from metrosep.app.warm_up import start_warm_up
from metrosep.app.wire import error_header, pack
from metrosep.core.errors import MetrosepError, WriteError
from metrosep.core.exit_codes import exit_code_of
from metrosep.recipe.pipeline import CancelledError

__all__ = ["STATIC", "make_app", "new_token"]

STATIC = Path(__file__).parent / "static"
_LARGEST_MESSAGE = 4_000_000
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: "
    "blob:; connect-src 'self' ws://127.0.0.1:* ws://localhost:*; form-action 'none'; "
    "base-uri 'none'; frame-ancestors 'none'"
)


def new_token() -> str:
    """Return a token for one start of the server."""
    return secrets.token_urlsafe(32)


def make_app(places: Places, *, port: int, token: str, first: Sequence[str] = ()) -> Starlette:
    """Return the application."""
    guard = Guard(token, port)
    session = Session(places)
    answers = Answers(session)
    waiting: dict[str, Any] = {"error": None}
    pages: set[_Talk] = set()
    if first:
        try:
            session.open(first)
        except MetrosepError as exc:
            waiting["error"] = {**_failed(exc, None, "open"), "paths": list(first)}

    async def page(request: Request) -> Response:
        refused = _refused(guard, request)
        if refused is not None:
            return refused
        text = (STATIC / "index.html").read_text(encoding="utf-8")
        response = Response(text, media_type="text/html")
        response.headers["Content-Security-Policy"] = _POLICY
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.set_cookie(guard.cookie, token, httponly=True, samesite="strict", path="/")
        return response

    async def upload(request: Request) -> Response:
        refused = _refused(guard, request)
        if refused is not None:
            return refused
        try:
            target = await _received(request, places)
        except MetrosepError as exc:
            return JSONResponse(_failed(exc, None, "upload"), status_code=400)
        return JSONResponse({"ok": True, "path": str(target)})

    async def socket(websocket: WebSocket) -> None:
        if _reason(guard, websocket) is not None:
            await websocket.close(code=4403)
            return
        await websocket.accept()
        talk = _Talk(websocket, answers, waiting, pages)
        pages.add(talk)
        try:
            await talk.run()
        finally:
            pages.discard(talk)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        async def kept() -> None:
            state = session.state()
            news = {k: state.get(k) for k in ("saved_at", "keeping", "messages")}
            for one in list(pages):
                await one.send({"k": "saved", **news})

        def told() -> None:
            asyncio.run_coroutine_threadsafe(kept(), loop)

        session.keeper.told = told
        cool_down = start_warm_up()
        yield
        cool_down()
        session.keeper.told = None
        await run_in_threadpool(session.close)

    return Starlette(
        routes=[
            Route("/", page),
            Route("/upload", upload, methods=["POST"]),
            WebSocketRoute("/ws", socket),
            Mount("/static", _Guarded(guard, StaticFiles(directory=STATIC))),
        ],
        lifespan=lifespan,
    )


def _reason(guard: Guard, connection: HTTPConnection) -> str | None:
    return guard.refusal(
        {k.lower(): v for k, v in connection.headers.items()},
        token=connection.query_params.get("token"),
        cookies=connection.cookies,
    )


def _refused(guard: Guard, request: Request) -> Response | None:
    reason = _reason(guard, request)
    return None if reason is None else PlainTextResponse(f"403: {reason}", status_code=403)


class _Guarded:
    """An application behind the guard."""

    def __init__(self, guard: Guard, app: Any) -> None:
        self.guard, self.app = guard, app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        reason = _reason(self.guard, HTTPConnection(scope))
        if reason is None:
            await self.app(scope, receive, send)
        else:
            await PlainTextResponse(f"403: {reason}", status_code=403)(scope, receive, send)


async def _received(request: Request, places: Places) -> Path:
    """Write an upload to its place, piece by piece; nothing of it is left where that fails."""
    headers, largest = request.headers, places.largest_upload
    name = unquote(headers.get("x-file-name", ""))
    stated = headers.get("content-length", "")
    if stated.isdecimal() and int(stated) > largest:
        raise WriteError(_too_large(name, largest))
    target = places.upload(name, headers.get("x-set", ""))
    size, whole = 0, False
    try:
        with target.open("wb") as file:
            async for piece in request.stream():
                size += len(piece)
                if size > largest:
                    raise WriteError(_too_large(name, largest))
                await run_in_threadpool(file.write, piece)
        whole = True
    except OSError as exc:
        raise WriteError(f"{name}: the upload cannot be kept ({exc.strerror or exc})") from None
    except ClientDisconnect:
        raise WriteError(f"{name}: the upload was broken off") from None
    finally:
        if not whole:
            target.unlink(missing_ok=True)
    return target


def _too_large(name: str, largest: int) -> str:
    return (
        f"{name}: is larger than the {largest / 1e9:.3g} GB that are taken as a copy; open it in place "
        f"instead: metrosep ui FILE"
    )


def _failed(error: MetrosepError, number: Any, kind: Any) -> dict[str, Any]:
    ask = (
        {"name": error.name, "kind": "text", "path": error.path, "fields": list(error.fields)}
        if isinstance(error, Ask)
        else None
    )
    return error_header(str(error), code=exit_code_of(error), request=number, k=kind, ask=ask)


class _Talk:
    """One page: its requests side by side, one at a time of each kind."""

    def __init__(
        self,
        websocket: WebSocket,
        answers: Answers,
        waiting: dict[str, Any],
        pages: set[_Talk],
    ) -> None:
        self.websocket, self.answers = websocket, answers
        self.waiting, self.pages = waiting, pages
        self.cancelled: dict[int, threading.Event] = {}
        self.turns: dict[str, asyncio.Lock] = {}
        self.sending = asyncio.Lock()
        self.tasks: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        if self.waiting["error"] is not None:
            await self.send(self.waiting["error"])
            self.waiting["error"] = None
        try:
            while True:
                await self.take(await self.websocket.receive_text())
        except WebSocketDisconnect:
            pass
        finally:
            for event in self.cancelled.values():
                event.set()
            for task in self.tasks:
                task.cancel()

    async def take(self, text: str) -> None:
        try:
            message = json.loads(text) if len(text) <= _LARGEST_MESSAGE else None
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict) or not isinstance(message.get("k"), str):
            await self.send(error_header("a request is an object with id and k", code=2))
            return
        number = message.get("id")
        number = number if isinstance(number, int) and not isinstance(number, bool) else None
        if message["k"] == "cancel":
            of = message.get("of")
            event = self.cancelled.get(of) if type(of) is int else None
            if event is not None:
                event.set()
            return
        task = asyncio.create_task(self.work(message, number))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def work(self, message: Mapping[str, Any], number: int | None) -> None:
        kind = str(message["k"])
        event = threading.Event()
        if number is not None:
            self.cancelled[number] = event
        try:
            async with self.turns.setdefault(kind, asyncio.Lock()):
                tell = self.teller(number, asyncio.get_running_loop())
                header, frame = await run_in_threadpool(self.framed, message, number, event, tell)
            await self.post(frame)
            if kind in CHANGING and header.get("ok"):
                await self.tell_others({"k": "session", "session": header["session"]})
        finally:
            if number is not None:
                self.cancelled.pop(number, None)

    def teller(self, number: int | None, loop: asyncio.AbstractEventLoop) -> Tell:
        """Return what sends news of a request from the thread that works on it."""

        def tell(news: Mapping[str, Any]) -> None:
            asyncio.run_coroutine_threadsafe(self.send({**news, "of": number}), loop)

        return tell

    async def tell_others(self, news: Mapping[str, Any]) -> None:
        """Send news to the other pages: they show the same recipe."""
        for page in [p for p in self.pages if p is not self]:
            await page.send(news)

    def framed(
        self, message: Mapping[str, Any], number: int | None, event: threading.Event, tell: Tell
    ) -> tuple[Mapping[str, Any], bytes]:
        """Return the answer and its frame: whatever goes wrong, the page hears of it."""
        kind = message.get("k")
        try:
            header, arrays = self.answer(message, number, event, tell)
            return header, pack(header, arrays)
        except Exception as exc:  # a fault of ours: it is told, and the page goes on
            told = traceback.format_exc().encode("ascii", "backslashreplace").decode("ascii")
            logging.getLogger("metrosep").error("request %a\n%s", kind, told)  # noqa: TRY400
            words = (
                f"{kind}: internal error ({type(exc).__name__}: {exc}): this is a bug in metrosep; the "
                "recipe is kept; please report it with what the terminal says"
            )
            words = words.encode("utf-8", "backslashreplace").decode("utf-8")
            header = error_header(words, code=5, request=number, k=kind if kind in KINDS else None)
            return header, pack(header)

    def answer(
        self,
        message: Mapping[str, Any],
        number: int | None,
        event: threading.Event,
        tell: Tell,
    ) -> Any:
        kind = message.get("k")
        try:
            header, arrays = self.answers.answer(message, event.is_set, tell)
        except CancelledError:
            return {**error_header("cancelled", code=130, request=number, k=kind)}, {}
        except MetrosepError as exc:
            header = _failed(exc, number, kind)
            if kind != "open":  # what cannot be opened says nothing about the open recipe
                header["error"]["message"] = self.answers.session.words(str(exc))
            return header, {}
        except (KeyError, TypeError, ValueError) as exc:
            words = f"the request {kind} is not as it should be ({type(exc).__name__}: {exc})"
            return error_header(words, code=2, request=number, k=kind), {}
        except MemoryError:
            words = (
                f"{kind}: the memory of this computer does not suffice; close other programs, or cut "
                "the measurement; the recipe is kept"
            )
            return error_header(words, code=4, request=number, k=kind), {}
        return ({"id": number, **header} if number is not None else header), arrays

    async def send(self, header: Mapping[str, Any]) -> None:
        await self.post(pack(header))

    async def post(self, frame: bytes) -> None:
        async with self.sending:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await self.websocket.send_bytes(frame)

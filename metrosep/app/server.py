"""The server of the workbench: one page, one session, loopback only."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import math
import secrets
import threading
import traceback
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from metrosep._version import __version__
from metrosep.app.asking import Ask
from metrosep.app.documents import Edit, Places, Remembered
from metrosep.app.evaluations import Outcome
from metrosep.app.map_views import (
    lateral_unit,
    map_frame,
    map_view,
    profile_arrays,
    relief_view,
    section_frame,
    spectrum_frame,
)
from metrosep.app.pyramid import MapPyramid, build_pyramid
from metrosep.app.sessions import Session
from metrosep.app.view_tables import (
    Extremes,
    checked_view,
    profile_view,
    section_view,
)
from metrosep.app.wire import (
    Answer,
    Arrays,
    Cancel,
    Message,
    Tell,
    error_header,
    level_of,
    number_of,
    pack,
    page_words,
    point_of,
)
from metrosep.core.errors import DataError, MetrosepError, RecipeError, WriteError
from metrosep.core.exit_codes import exit_code_of
from metrosep.core.inside import carried
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.regions import counts_pixels
from metrosep.core.sections import is_calibrated, section_profile
from metrosep.core.surface import Surface
from metrosep.recipe.pipeline import CancelledError, lost_pixels

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


def safe_headers() -> dict[str, str]:
    """Return the headers of a page that asks nobody else for anything."""
    return {
        "Content-Security-Policy": _POLICY,
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }


def new_cookie(response: Response, guard: Guard) -> None:
    """Let the page of this start ask again without the token in its address."""
    response.set_cookie(guard.cookie, guard.token, httponly=True, samesite="strict", path="/")


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
            waiting["error"] = {**_failed(exc, None, "open", first), "paths": list(first)}

    async def page(request: Request) -> Response:
        refused = _refused(guard, request)
        if refused is not None:
            return refused
        text = (STATIC / "index.html").read_text(encoding="utf-8")
        response = Response(text, media_type="text/html", headers=safe_headers())
        new_cookie(response, guard)
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
        if isinstance(exc, WriteError):
            raise
        raise WriteError(
            f"{name}: the upload cannot be kept ({exc.strerror or exc})", exc
        ) from None
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


def _named(message: Mapping[str, Any]) -> list[str]:
    """Return the names of files in a request, which stay as they are in what is said of it."""
    several = message.get("paths")
    found = [message.get("path"), *(several if isinstance(several, list) else ())]
    return [name for name in found if isinstance(name, str)]


def _failed(
    error: MetrosepError, number: Any, kind: Any, names: Sequence[object] = ()
) -> dict[str, Any]:
    ask = (
        {
            "name": error.name,
            "kind": "text",
            "path": error.path,
            "fields": list(error.fields),
            "sample": error.sample,
        }
        if isinstance(error, Ask)
        else None
    )
    return error_header(
        page_words(str(error), names),
        code=exit_code_of(error),
        request=number,
        k=kind,
        ask=ask,
    )


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
            header = _failed(exc, number, kind, _named(message))
            if kind != "open":  # what cannot be opened says nothing about the open recipe
                header["error"]["message"] = self.answers.session.words(
                    str(exc), names=_named(message)
                )
            if kind == "edit" and isinstance(exc, RecipeError):
                header["error"]["mends"] = self.answers.session.mends(exc, edits_of(message))
            elif kind in OF_RUNS:
                header["error"]["mends"] = self.answers.session.mends_of_runs(exc)
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


# ---- what the server answers to each kind of request: a header and arrays, from one session ----

CHANGING = ("open", "edit", "undo", "redo")
"""Requests after which every page shows another recipe."""

_OWN = ("hello", "view", *CHANGING)
_PICTURES = (
    "map",
    "relief",
    "section",
    "sections",
    "profile",
    "spectrum",
    "density",
    "heights",
    "waves2d",
    "places",
)
_ELSEWHERE = {
    "metrics": "metrics_answers:metrics",
    "export": "export_answers:export",
    "curves": "run_answers:curves",
    "waves": "run_answers:waves",
    "table": "table_answers:table",
    "controllers": "table_answers:controllers",
    "ranking": "metrics_answers:ranking",
    "machine": "table_answers:machine",
    "report": "export_answers:report",
    "compare": "compare_answers:compare",
    "run_folder": "export_answers:run_folder",
    "list": "browsing:listing",
    "thumbnail": "browsing:thumbnail",
    "latest": "browsing:latest",
    "scale": "mends:scale",
}
"""Functions ``f(session, message, cancel, tell)`` in modules of their own, loaded when asked."""

KINDS = (*_OWN, *_PICTURES, *_ELSEWHERE)
OF_RUNS = ("curves", "waves", "table")
"""What is made of separated runs: where they cannot be separated, the answer says what may be done."""


def _never() -> bool:
    return False


def _nobody(news: Mapping[str, object]) -> None:
    """Tell nobody."""


class Answers:
    """Answers for one session."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.pictures = PictureAnswers(session)

    def answer(self, message: Message, cancel: Cancel = _never, tell: Tell = _nobody) -> Answer:
        """Return the answer to a request."""
        kind = message.get("k")
        if not isinstance(kind, str) or kind not in KINDS:
            raise DataError(f"there is no request {kind!r}; there are {', '.join(KINDS)}")
        with self.session.places.guarding():
            if kind in _OWN:
                header, arrays = getattr(self, f"_{kind}")(message)
            elif kind in _PICTURES:
                header, arrays = getattr(self.pictures, kind)(message, cancel)
            else:
                module, _, name = _ELSEWHERE[kind].partition(":")
                function = getattr(import_module(f"metrosep.app.{module}"), name)
                header, arrays = function(self.session, message, cancel, tell)
        return {"k": kind, "ok": True, **header}, arrays

    def _hello(self, message: Message) -> Answer:
        from metrosep.app.menus import described_menus
        from metrosep.recipe.step_help import described_steps

        session = self.session.state()
        menus = described_menus()
        return {
            "version": __version__,
            "session": session,
            "schema": described_steps(),
            "menus": menus,
        }, {}

    def _open(self, message: Message) -> Answer:
        reading = message.get("reading") or {}
        if not isinstance(reading, Mapping):
            raise DataError("reading is an object of options")
        paths = message.get("paths") or [message.get("path")]
        if not isinstance(paths, list) or not all(isinstance(p, str) and p for p in paths):
            raise DataError(
                f"path is a text, or paths a list of them; got {said_value(message.get('path'))}"
            )
        self.session.open(paths, reading, keep_recipe=message.get("keep_recipe") is True)
        self.pictures.forget()
        import_module("metrosep.app.browsing").remember(self.session)
        return {"session": self.session.state()}, {}

    def _edit(self, message: Message) -> Answer:
        label = message.get("label")
        self.session.edit(edits_of(message), label if isinstance(label, str) else None)
        return {"session": self.session.state()}, {}

    def _view(self, message: Message) -> Answer:
        self.session.show(checked_view(message.get("view")))
        return {}, {}

    def _undo(self, message: Message) -> Answer:
        self.session.undo()
        return {"session": self.session.state()}, {}

    def _redo(self, message: Message) -> Answer:
        self.session.redo()
        return {"session": self.session.state()}, {}


def edits_of(message: Message) -> list[Edit]:
    """Return the edits of a request."""
    given = message.get("edits", [message])
    if not isinstance(given, list) or not all(isinstance(e, Mapping) for e in given):
        raise DataError("edits is a list of objects with path, old and new")
    return [Edit.from_message(e) for e in given]


# ---- answers that are pictures of one map or profile: map, section, profile, spectrum ----------


class PictureAnswers:
    """Pictures of what one session evaluates."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._pyramids = Remembered(build_pyramid)
        self._extremes = Remembered(Extremes)
        self._moved = Remembered(_moved, most=17)
        self._transform: Any = None
        self._distributions = Remembered(_distribution, most=3)
        self._fields = Remembered(_waves, most=3)

    def _stage(self, message: Message, cancel: Cancel) -> tuple[Outcome, Surface | Profile]:
        outcome = self.session.outcome(level_of(message), cancel=cancel)
        stage = message.get("stage", -1)
        if isinstance(stage, bool) or not isinstance(stage, int):
            raise DataError(f"stage is the number of a step, got {said_value(stage)}")
        obj = outcome.after(stage)
        if isinstance(obj, Surface) and outcome.shift != (0.0, 0.0):
            obj = self._moved.of(obj, outcome.shift)
        return outcome, obj

    def _surface(self, message: Message, cancel: Cancel, what: str) -> tuple[Outcome, Surface]:
        """Return a stage of a map; a profile has no picture of the kind `what`."""
        outcome, obj = self._stage(message, cancel)
        if not isinstance(obj, Surface):
            raise DataError(f"this measurement is a profile, it has no {what}")
        return outcome, obj

    def forget(self) -> None:
        """Forget what was made of the file that was open before."""
        for kept in (
            self._pyramids,
            self._extremes,
            self._moved,
            self._distributions,
            self._fields,
        ):
            kept.clear()
        self._transform = None

    def map(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``map``."""
        outcome, obj = self._surface(message, cancel, "map")
        view = map_view(
            self._pyramid(obj),
            window=message.get("window"),
            pixels=message.get("pixels") or (512, 512),
            level=level_of(message),
            limits=message.get("range"),
            shade=bool(message.get("shade")),
        )
        extent = self._pyramid(obj).window
        header, arrays = map_frame(view, extent, is_preview=outcome.is_preview)
        full = self.session.evaluations
        source = None if full is None else full.obj
        header |= {"pixel": None, "first": None, "failed": outcome.failed, "done": outcome.done}
        if isinstance(source, Surface) and is_calibrated(source):
            header |= {"pixel": [source.dx, source.dy], "first": source.origin}
        return header, arrays

    def relief(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``relief``: heights about their mean for a view in three dimensions."""
        outcome, obj = self._surface(message, cancel, "relief")
        header, z = relief_view(obj, side=message.get("side", 512))
        return {**header, "is_preview": outcome.is_preview}, {"z": z}

    def _pyramid(self, obj: Surface) -> MapPyramid:
        evaluations = self.session.evaluations
        if evaluations is not None and obj is evaluations.obj and evaluations.pyramid is not None:
            return evaluations.pyramid
        return self._pyramids.of(obj)

    def section(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``section``."""
        outcome, obj = self._surface(message, cancel, "sections")
        view = section_view(
            obj,
            point_of(message, "a"),
            point_of(message, "b"),
            columns=message.get("columns") or 1000,
            cursors=message.get("cursors") or (),
        )
        return section_frame(view, is_preview=outcome.is_preview)

    def sections(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``sections``: heights along what the recipe draws on the map."""
        from metrosep.recipe.map_sections import heights_along

        _, document = self.session.need()
        if counts_pixels(document.recipe.sections):  # of the map as it was read
            message = {**message, "level": "full"}
        outcome, obj = self._surface(message, cancel, "sections")
        curves: list[dict[str, Any]] = []
        arrays: Arrays = {}
        columns = message.get("columns") or 1000
        for i, section in enumerate(document.recipe.sections):
            if lost_pixels(document.recipe.steps, section):
                continue  # as below
            try:
                line = heights_along(obj, section)
            except DataError:
                continue  # the numbers of this section say why
            if line is None:
                continue
            turn = math.tau * (len(line) - 1) / len(line)  # of a circle, to its last sample
            curves.append(
                {"index": i, "name": section["name"], "kind": section["kind"],
                 "length": float(line.x[-1]), "unit": lateral_unit(obj), "share_valid": 1.0 - line.n_invalid / len(line),
                 "radius": float(line.x[-1]) / turn}
            )  # fmt: skip
            arrays |= profile_arrays(profile_view(Extremes(line), columns=columns), f"{i}_")
        return {"curves": curves, "is_preview": outcome.is_preview}, arrays

    def profile(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``profile``."""
        outcome, obj = self._stage(message, cancel)
        if not isinstance(obj, Profile):
            raise DataError("this measurement is a map: ask for a section")
        arrays: Arrays = {}
        for name, shown in (("measured", outcome.source), ("residual", obj)):
            if name not in (message.get("series") or ["residual"]):
                continue
            view = profile_view(
                self._extremes.of(shown),
                window=message.get("window"),
                columns=message.get("columns") or 1000,
            )
            arrays |= profile_arrays(view, f"{name}_")
        whole = [float(obj.x[0]), float(obj.x[-1])]
        header = {"is_preview": outcome.is_preview, "failed": outcome.failed, "done": outcome.done}
        return {**header, "extent": message.get("window") or whole}, arrays

    def spectrum(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``spectrum``."""
        from metrosep.app.spectrum_views import profile_spectrum, spectrum_view
        from metrosep.spectral.dft import Band

        outcome, obj = self._stage(message, cancel)
        unit = lateral_unit(obj)
        place = (
            (point_of(message, "a"), point_of(message, "b")) if isinstance(obj, Surface) else ()
        )
        kept = self._transform
        if kept is None or kept[0] is not obj or kept[1] != place:
            line = section_profile(obj, *place) if isinstance(obj, Surface) else obj
            kept = self._transform = (obj, place, profile_spectrum(line, unit=unit))
        shortest, longest = message.get("band") or (None, None)
        band = Band(
            None if shortest is None else float(shortest),
            None if longest is None else float(longest),
        )
        view = spectrum_view(kept[2], band=band)
        return spectrum_frame(view, unit=unit, is_preview=outcome.is_preview)

    def heights(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``heights``: the distribution of heights with the material ratio curve."""
        from metrosep.app.field_views import heights_view

        outcome, obj = self._stage(message, cancel)
        header, arrays = heights_view(self._distributions.of(obj), message.get("at"))
        return {**header, "is_preview": outcome.is_preview}, arrays

    def waves2d(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``waves2d``: the power of the waves in all directions of a map."""
        outcome, obj = self._surface(message, cancel, "waves in all directions")
        header, arrays = self._fields.of(obj)
        return {**header, "is_preview": outcome.is_preview}, arrays

    def places(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``places``: peak and valley near a point, or the circle of what was measured."""
        from metrosep.app.field_views import aperture_of, extremes_near

        outcome, obj = self._surface(message, cancel, "places")
        if message.get("what") == "aperture":
            (x, y), radius = aperture_of(obj)
            return {"centre": [x, y], "radius": radius, "is_preview": outcome.is_preview}, {}
        peak, valley = extremes_near(obj, point_of(message, "at"), number_of(message, "radius"))
        return {"peak": peak, "valley": valley, "is_preview": outcome.is_preview}, {}

    def density(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``density``: the spectrum that a step ``psd`` compares with its limit."""
        from metrosep.app.spectrum_views import density_frame

        outcome, _ = self._stage(message, cancel)
        stage = message.get("stage", -1)
        done = [s for s in outcome.stages if s.enabled]
        chosen = [s for s in done if s.index == stage] if stage >= 0 else done[-1:]
        if not chosen or chosen[0].op != "psd":
            raise DataError("the step that is shown compares no spectrum with a limit")
        return density_frame(chosen[0].detail, is_preview=outcome.is_preview)


def _distribution(obj: Surface | Profile) -> Any:
    from metrosep.app.field_views import distribution

    return distribution(obj)


def _waves(obj: Surface) -> Any:
    from metrosep.app.field_views import waves_view

    return waves_view(obj)


def _moved(obj: Surface, shift: tuple[float, float]) -> Surface:
    """Return a preview where the map itself lies: its cells begin half a cell later."""
    place = (obj.origin[0] + shift[0], obj.origin[1] + shift[1])
    return Surface(obj.z, obj.dx, obj.dy, origin=place)


# ---- who may talk to the workbench: pages of this very server, with the token of this start ----
# A web site that the user visits could send requests to the loopback (cross-site), or have its own
# name point there (DNS rebinding). Both come with a Host or Origin that is not ours.

COOKIE = "metrosep"
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


@dataclass(frozen=True, slots=True)
class Guard:
    """The rule for one server."""

    token: str  # of this start
    port: int  # where the server listens

    @property
    def cookie(self) -> str:
        """Name of the cookie: cookies are shared by all ports of a host."""
        return f"{COOKIE}-{self.port}"

    def refusal(
        self, headers: Mapping[str, str], *, token: str | None, cookies: Mapping[str, str]
    ) -> str | None:
        """Return why a request is refused, or None.

        Examples
        --------
        >>> guard = Guard("secret", 8899)
        >>> guard.refusal({"host": "127.0.0.1:8899"}, token="secret", cookies={})
        >>> guard.refusal({"host": "evil.example:8899"}, token="secret", cookies={})
        'the host is not the loopback of this computer'
        """
        host = headers.get("host", "")
        if host not in {f"{name}:{self.port}" for name in _LOOPBACK}:
            return "the host is not the loopback of this computer"
        origin = headers.get("origin")
        if origin is not None and origin not in {f"http://{n}:{self.port}" for n in _LOOPBACK}:
            return "the request comes from another site"
        given = token if token is not None else cookies.get(self.cookie, "")
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            return (
                "the token is missing or of another start; open the address that metrosep printed"
            )
        return None


# ---- what the first picture needs, loaded while the page loads ---------------------------------


def warm_up(stop: Callable[[], bool] = lambda: False) -> None:
    """Run on a few pixels what opening a map or profile does.

    Notes
    -----
    The libraries behind forms, parameters and spectra load when they are used first: half a second
    that nobody need wait for.
    """
    from metrosep.app.evaluations import Evaluations
    from metrosep.app.map_views import map_view
    from metrosep.app.pyramid import build_pyramid
    from metrosep.app.spectrum_views import profile_spectrum
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.io.registry import formats
    from metrosep.recipe.pipeline import checked_step
    from metrosep.recipe.step_help import described_steps

    y, x = np.mgrid[0:32, 0:48] * 1e-5
    surface = Surface(1e-8 * np.cos(1e5 * x + 2e5 * y), 1e-5, 1e-5)
    profile = Profile(x[0], 1e-8 * np.cos(1e5 * x[0]))
    plane = checked_step({"op": "form", "form": "plane"})
    line = checked_step({"op": "form", "form": "polynomial: degree=1"})
    values = checked_step({"op": "parameters"})
    parts: tuple[Callable[[], object], ...] = (
        described_steps,
        formats,
        lambda: map_view(build_pyramid(surface)),
        lambda: Evaluations(surface).outcome([plane, values], "full"),
        lambda: profile_spectrum(profile),
        lambda: Evaluations(profile).outcome([line, values], "full"),
    )
    for part in parts:
        if stop():
            return
        with contextlib.suppress(MetrosepError):  # it is the loading that counts
            part()


def start_warm_up() -> Callable[[], None]:
    """Warm up in a thread of its own."""
    stop = threading.Event()

    def work() -> None:
        try:
            warm_up(stop.is_set)
        except Exception:  # nothing depends on it: what fails here is told when it is used
            logging.getLogger("metrosep").debug("warm-up", exc_info=True)

    threading.Thread(target=carried(work), daemon=True, name="warm-up").start()
    return stop.set

"""Drive a headless Chromium through its remote debugging, with `websockets` and nothing else.

Used by `tools/screenshots.py` and by `tests/browser`: it opens the page of the workbench, moves a
real mouse, presses real keys, and keeps the address of every request that the page makes.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
)
NAMES = ("chromium", "chromium-browser", "google-chrome")
KEYS = {
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "Enter": 13,
    "Escape": 27,
    "Tab": 9,
    "Delete": 46,
    "PageUp": 33,
    "PageDown": 34,
    "Home": 36,
    "End": 35,
}
ALT, CONTROL, SHIFT = 1, 2, 8


def find_chromium() -> str | None:
    """Return the browser of this computer, or None."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """A tab: evaluates, waits, moves the mouse, presses keys."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.number = 0
        self.requests: list[str] = []
        self.errors: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return what the browser answers; events on the way are kept."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv(timeout=60))
            if message.get("id") == self.number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return dict(message["result"])
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        kind, given = message.get("method"), message.get("params", {})
        if kind == "Network.requestWillBeSent":
            self.requests.append(given["request"]["url"])
        elif kind == "Network.webSocketCreated":
            self.requests.append(given["url"])
        elif kind == "Runtime.exceptionThrown":
            detail = given["exceptionDetails"]
            self.errors.append(detail.get("exception", {}).get("description", detail["text"]))
        elif kind == "Log.entryAdded" and given["entry"]["level"] == "error":
            self.errors.append(f"{given['entry']['text']} {given['entry'].get('url', '')}")
        elif kind == "Runtime.consoleAPICalled" and given["type"] in ("error", "assert"):
            self.errors.append(str([a.get("value", a.get("description")) for a in given["args"]]))

    def show(self, width: int, height: int, scheme: str = "light") -> None:
        """Set the size of the window and the colour scheme."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def go(self, address: str) -> None:
        """Open an address."""
        self.call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """Return the value of an expression; a promise is awaited."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True,
                           awaitPromise=True)  # fmt: skip
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, script: str, seconds: float = 90.0) -> Any:
        """Wait until an expression is true; return it."""
        end = time.monotonic() + seconds
        while True:
            with contextlib.suppress(RuntimeError):
                value = self.run(script)
                if value:
                    return value
            if time.monotonic() > end:
                raise TimeoutError(f"not true after {seconds} s: {script}\n{self.errors}")
            time.sleep(0.02)

    def text(self, selector: str) -> str:
        """Return the text of an element."""
        return str(self.run(f"document.querySelector({json.dumps(selector)})?.textContent ?? ''"))

    def box(self, selector: str) -> tuple[float, float, float, float]:
        """Return left, top, width and height of an element, scrolled into view."""
        found = self.run(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); if (!e) return null;"
            "e.scrollIntoView({block: 'nearest'}); const b = e.getBoundingClientRect();"
            "return [b.left, b.top, b.width, b.height]; })()"
        )
        if found is None:
            raise LookupError(f"nothing on the page is {selector}")
        return tuple(found)

    def middle(self, selector: str) -> tuple[float, float]:
        """Return the middle of an element."""
        x, y, width, height = self.box(selector)
        return x + width / 2, y + height / 2

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Move, press or release the left button."""
        buttons = 0 if kind == "mouseReleased" else int(more.pop("held", kind == "mousePressed"))
        button = "left" if buttons or kind == "mouseReleased" else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons,
                  clickCount=1 if kind != "mouseMoved" else 0, **more)  # fmt: skip

    def click(self, selector: str) -> None:
        """Click into the middle of an element."""
        x, y = self.middle(selector)
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def drag(
        self, start: tuple[float, float], by: tuple[float, float], seconds: float = 0.3
    ) -> int:
        """Drag from a place, at about 60 moves a second; return how many."""
        x, y = start
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y)
        begin, moves = time.monotonic(), 0
        while (part := (time.monotonic() - begin) / seconds) < 1.0:
            self.mouse("mouseMoved", x + part * by[0], y + part * by[1], held=True)
            moves += 1
            time.sleep(0.012)
        self.mouse("mouseMoved", x + by[0], y + by[1], held=True)
        self.mouse("mouseReleased", x + by[0], y + by[1])
        return moves + 1

    def press(
        self, key: str, *, shift: bool = False, control: bool = False, alt: bool = False
    ) -> None:
        """Press a key."""
        code = KEYS.get(key, ord(key.upper()) if len(key) == 1 else 0)
        text: dict[str, str] = {}
        if not control and not alt:
            text = {"text": key} if len(key) == 1 else {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code,
                      modifiers=SHIFT * shift + CONTROL * control + ALT * alt, **(text if kind == "keyDown" else {}))  # fmt: skip

    def fill(self, selector: str, text: str) -> None:
        """Type a text into a field in place of what is there."""
        self.click(selector)
        self.run(f"document.querySelector({json.dumps(selector)}).select()")
        self.call("Input.insertText", text=text)

    def picture(self) -> bytes:
        """Return what is seen, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


@contextlib.contextmanager
def browser() -> Iterator[Page]:
    """Start Chromium with a fresh profile; give a page; end it."""
    from websockets.sync.client import connect

    program = find_chromium()
    if program is None:
        raise RuntimeError(f"no Chromium is installed ({', '.join(NAMES)})")
    with tempfile.TemporaryDirectory(
        prefix="metrosep-chromium-", ignore_cleanup_errors=True
    ) as home:
        process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={home}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            told = Path(home) / "DevToolsActivePort"
            end = time.monotonic() + 30
            while not told.is_file() or len(told.read_text().split()) < 2:
                if process.poll() is not None or time.monotonic() > end:
                    raise RuntimeError("Chromium does not start")
                time.sleep(0.05)
            port, path = told.read_text().split()[:2]
            with connect(f"ws://127.0.0.1:{port}{path}", open_timeout=30) as whole:
                call = {"id": 1, "method": "Target.createTarget", "params": {"url": "about:blank"}}
                whole.send(json.dumps(call))
                target = json.loads(whole.recv(timeout=30))["result"]["targetId"]
                own = f"ws://127.0.0.1:{port}/devtools/page/{target}"
                with connect(own, max_size=None, open_timeout=30) as socket:
                    yield Page(socket)
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=10)
            if process.poll() is None:
                process.kill()
                process.wait()


@contextlib.contextmanager
def workbench(file: Path | None, folder: Path | None = None) -> Iterator[str]:
    """Start `metrosep ui` for a file, with another folder open; give its address; end it."""
    command = [sys.executable, "-m", "metrosep", "ui", "--no-browser", "--port", "0"]
    command += [] if folder is None else ["--folder", str(folder)]
    process = subprocess.Popen(
        [*command, *([] if file is None else [str(file)])],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    said = ""
    try:
        for line in process.stdout or ():
            said += line
            found = re.search(r"http://\S+token=\S+", line)
            if found:
                yield found.group(0)
                break
        else:
            raise RuntimeError(f"metrosep ui did not start:\n{said}")
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=10)
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


if __name__ == "__main__":  # exit code 1 where there is none
    sys.exit(0 if find_chromium() else 1)

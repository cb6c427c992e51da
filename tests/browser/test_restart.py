"""The server is killed: the page says so, and the next start shows the recipe as it was."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.browser

FULL = "document.querySelector('#status-full.done') !== null"


class Server:
    """`metrosep ui` for a file, to be killed."""

    def __init__(self, file: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "metrosep", "ui", "--no-browser", str(file)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        assert self.process.stdout is not None
        found = None
        for line in self.process.stdout:
            if found := re.search(r"http://\S+token=\S+", line):
                break
        assert found
        self.address = found.group(0)

    def kill(self) -> None:
        """End it as a power cut would."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


@pytest.fixture
def servers() -> Iterator[list[Server]]:
    started: list[Server] = []
    yield started
    for server in started:
        if server.process.poll() is None:
            server.kill()


def test_nothing_is_lost_when_the_server_is_killed(
    tab: Any, map_file: Path, servers: list[Server]
) -> None:
    servers.append(Server(map_file))
    tab.go(servers[0].address)
    tab.wait(FULL)
    first = tab.run("document.body.dataset.full")
    tab.click('[aria-label="Step 1, form: on"]')
    tab.wait("/recipe saved [0-9]/.test(document.querySelector('#status-saved').textContent)")
    tab.wait(f"document.body.dataset.full !== '{first}'")
    tab.wait(FULL)
    before = tab.text('[data-metric="Sz"] td:nth-child(2)')
    servers[0].kill()

    tab.wait("document.querySelector('#status-link.lost') !== null")
    assert "connection lost" in tab.text("#status-link")
    tab.click('[aria-label="Step 1, form: on"]')
    tab.wait("document.querySelector('.alert p') !== null")
    assert "not made" in tab.text(".alert p")
    tab.wait(
        "document.querySelector('#status-link').textContent.includes('address that it prints')"
    )
    assert tab.text("#title") == "bowl.x3p"  # what was seen stays

    servers.append(Server(map_file))
    tab.go(servers[1].address)
    tab.wait(FULL)
    assert tab.run("document.querySelector('[aria-label=\"Step 1, form: on\"]').checked") is False
    assert tab.text('[data-metric="Sz"] td:nth-child(2)') == before
    assert "taken up again" in tab.run("document.querySelector('#messages').title")


def test_a_token_of_another_start_shows_no_page(
    tab: Any, map_file: Path, servers: list[Server]
) -> None:
    servers.append(Server(map_file))
    tab.go(re.sub(r"token=.*", "token=old", servers[0].address))
    tab.wait("document.body.textContent.includes('403')")
    assert "open the address that metrosep printed" in tab.text("body")
    tab.go(re.sub(r"\?.*", "", servers[0].address))
    tab.wait("document.body.textContent.includes('403')")

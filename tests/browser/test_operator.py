"""Operator mode by scanner: two keys for each part, nothing else to press."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

RECIPE = """metrosep = 1
title = "Flat 30 mm"
[input]
files = ["*.x3p"]
[[step]]
op = "parameters"
names = ["Sz"]
[[check]]
name = "flatness"
metric = "Sz"
upper = "100 nm"
U = "5 nm"
[operator]
reasons = ["dust", "scratch"]
"""


@contextmanager
def operator_page(root: Path) -> Iterator[str]:
    """Start the command and give the address that it prints."""
    command = [sys.executable, "-m", "metrosep", "ui", "--operator", "flat.toml", "--inbox", "in"]
    command += ["--out", "out", "--serial", "[A-Z][0-9]{2}", "--no-browser"]
    process = subprocess.Popen(command, cwd=root, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        found = re.search(r"http://\S+", line)
        assert found, line
        yield found[0]
    finally:
        process.terminate()
        process.wait(timeout=20)
        if process.stderr is not None:
            process.stderr.close()


def put(root: Path, name: str, height: float) -> None:
    from metrosep import Surface
    from metrosep.io.write import write

    z = np.zeros((12, 15))
    z[3, 4] = height
    write(Surface(z, 1e-6, 1e-6), root / "in" / name)


def scan(page: Any, serial: str) -> None:
    """Type as a scanner does: the text, then Enter."""
    page.call("Input.insertText", text=serial)
    page.press("Enter")


def mode(page: Any, name: str) -> None:
    page.wait(f"document.body.dataset.mode === '{name}'")


PARTS, BAD = 5, 3
"""Each waits a second until its file rests; twenty were run once."""


def test_parts_with_two_keys_each(tab: Any, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "flat.toml").write_text(RECIPE)
    before = (tmp_path / "flat.toml").read_bytes()
    with operator_page(tmp_path) as address:
        tab.go(address)
        mode(tab, "name")
        scan(tab, "A. Weber")
        mode(tab, "serial")
        for k in range(PARTS):
            bad = k == BAD
            put(tmp_path, f"m{k}.x3p", 180e-9 if bad else 40e-9)
            tab.wait(f"document.getElementById('file').textContent.includes('m{k}.x3p')")
            scan(tab, f"B{k:02d}")  # one key: the Enter of the scanner
            mode(tab, "reason" if bad else "part")
            *_, height = tab.box("#verdict")
            assert height >= 96
            assert ("Rejected" if bad else "Accepted") in tab.text("#verdict")
            if bad:
                assert "flatness" in tab.text("#rows")
                assert tab.run("document.getElementById('next').disabled")
                tab.run("document.getElementById('reason').value = 'scratch'")
                tab.click("#reason-form button")
                mode(tab, "part")
            tab.press("Enter")  # the second: the focus is on Next part
            mode(tab, "serial")
        scan(tab, "not a serial")
        tab.wait("document.getElementById('message').textContent.includes('scan it again')")
        assert tab.run("document.activeElement.id") == "serial"
        for width, height in ((1366, 768), (390, 844), (320, 640)):
            tab.show(width, height)
            assert tab.run("document.documentElement.scrollWidth <= innerWidth")
        assert [e for e in tab.errors if "400" not in e] == []
        assert [
            r for r in tab.requests if not r.startswith((address[:17], "data:", "about"))
        ] == []
    assert (tmp_path / "flat.toml").read_bytes() == before
    kept = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert kept == [f"B{k:02d}" for k in range(PARTS)]
    held = json.loads((tmp_path / "out" / f"B{BAD:02d}" / "operator.json").read_text())
    assert (held["verdict"], held["reason"], held["operator"]) == ("reject", "scratch", "A. Weber")


def text_of(page: Any, where: str, part: str) -> None:
    page.wait(f"document.getElementById('{where}').textContent.includes({json.dumps(part)})")


def test_the_serial_number_goes_to_the_file_that_the_operator_saw(
    tab: Any, tmp_path: Path
) -> None:
    for folder in ("in", "out"):
        (tmp_path / folder).mkdir()
    (tmp_path / "flat.toml").write_text(RECIPE)
    with operator_page(tmp_path) as address:
        tab.go(address)
        mode(tab, "name")
        scan(tab, "A. Weber")
        mode(tab, "serial")
        text_of(tab, "file", "No new measurement")
        put(tmp_path, "first.x3p", 40e-9)
        text_of(tab, "file", "Measurement: first.x3p.")
        put(tmp_path, "second.x3p", 180e-9)
        text_of(tab, "file", "2 files wait: second.x3p is judged with this serial number.")
        scan(tab, "A01")  # the part that was looked at is the first one
        text_of(tab, "message", "second.x3p is shown now, first.x3p was before")
        assert list((tmp_path / "out").iterdir()) == []
        scan(tab, "B01")
        mode(tab, "reason")
        assert "B01, second.x3p" in tab.text("#about")
        tab.run("document.getElementById('reason').value = 'dust'")
        tab.click("#reason-form button")
        mode(tab, "part")
        tab.press("Enter")
        mode(tab, "serial")
        text_of(tab, "file", "Measurement: first.x3p.")
        (tmp_path / "in" / "first.x3p").unlink()  # gone before the page looks again
        scan(tab, "A01")
        text_of(tab, "file", "No new measurement")
        put(tmp_path, "third.x3p", 40e-9)
        text_of(tab, "file", "Measurement: third.x3p.")
        scan(tab, "A01")
        mode(tab, "part")
    files = {
        record.parent.name: json.loads(record.read_text())["file"]
        for record in (tmp_path / "out").glob("*/operator.json")
    }
    assert files == {"A01": "third.x3p", "B01": "second.x3p"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--operator", "flat.toml"], "--inbox DIR, --out DIR"),
        (["--inbox", "in"], "--operator RECIPE"),
        (
            ["--operator", "flat.toml", "--inbox", "in", "--out", "in", "x.x3p"],
            "opens nothing but",
        ),
    ],
)
def test_options_that_do_not_go_together(tmp_path: Path, options: list[str], said: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "metrosep", "ui", *options],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert said in done.stderr

"""Lines to sign: name, date and signature of three people, blank, in every report that is paper."""

from __future__ import annotations

import re
import shutil
import subprocess
from itertools import pairwise

import pytest

from metrosep.report import render_html
from metrosep.report.typeset import render_plain_pdf

ROLES = ("Measured by", "Checked by", "Released by")
SMALL = {
    "schema": "metrosep.result/1",
    "metrosep": "0.1.0",
    "title": "Ring",
    "verdict": None,
    "inputs": [{"name": "a.datx", "sha256": "ab" * 32, "size": 12, "format": "datx"}],
}
FEWEST = 20.0
"""Points (7 mm): room above a line in which a hand can write."""


def words(data, tmp_path, *options):
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext (poppler) is not installed")
    (tmp_path / "x.pdf").write_bytes(data)
    command = ["pdftotext", *options, str(tmp_path / "x.pdf"), "-"]
    return subprocess.run(command, check=True, capture_output=True).stdout.decode("utf-8")


def test_the_first_page_has_blank_cells_to_sign():
    page = render_html(SMALL)
    part = page[page.index('<section class="signatures">') : page.index("</section>")]
    rows = re.findall(r"<tr>(.*?)</tr>", part, flags=re.DOTALL)
    head = re.findall(r"<th[^>]*>(.*?)</th>", rows[0])
    assert head[1:] == ["name", "date", "signature"]
    assert [re.findall(r"<th[^>]*>(.*?)</th>", r)[0] for r in rows[1:]] == list(ROLES)
    for row in rows[1:]:
        assert re.findall(r"<td>(.*?)</td>", row) == ["", "", ""]
    assert page.index('<section class="signatures">') < page.index("Annex: Ring")


def test_the_pdf_has_lines_with_room_above_them(tmp_path):
    pytest.importorskip("typst")
    from metrosep.report.typeset import render_pdf

    data = render_pdf(SMALL)
    text = words(data, tmp_path, "-layout")
    for word in ("Signatures", *ROLES, "name", "date", "signature"):
        assert word in text
    boxes = re.findall(
        r'<word xMin="[\d.]+" yMin="([\d.]+)" xMax="[\d.]+" yMax="[\d.]+">(Measured|Checked|Released)<',
        words(data, tmp_path, "-bbox"),
    )
    boxes = boxes[-3:]  # the first page has a measured file, too
    heights = [float(y) for y, _ in boxes]
    assert [w for _, w in boxes] == ["Measured", "Checked", "Released"]
    assert all(b - a >= FEWEST for a, b in pairwise(heights))


def test_the_plain_pages_have_lines_too(tmp_path):
    text = words(render_plain_pdf(SMALL), tmp_path, "-layout")
    for role in ROLES:
        (line,) = [n for n in text.splitlines() if role in n]
        assert re.search(r"name _{9,} +date _{9,} +signature _{9,}", line)

"""Small pictures of a batch: one beside each result, not larger than 8 kB, and the odd pixel stays."""

import struct
import zlib

import numpy as np

import metrosep as ms
from metrosep.batch.work import thumbnail
from metrosep.core._thumbnails import _table
from metrosep.recipe import Recipe

RECIPE = """metrosep = 1
[input]
files = ["*.sdf"]
[batch]
index = ["html"]
[[step]]
op = "form"
form = "plane"
[[check]]
metric = "residual.pv"
upper = "100 nm"
U = "5 nm"
"""


def pixels(png):
    """Return the colour numbers of an indexed PNG."""
    at, data, size = 8, b"", None
    while at < len(png):
        n = struct.unpack(">I", png[at : at + 4])[0]
        kind, body = png[at + 4 : at + 8], png[at + 8 : at + 8 + n]
        size = struct.unpack(">II", body[:8]) if kind == b"IHDR" else size
        data += body if kind == b"IDAT" else b""
        at += 12 + n
    width, height = size
    lines = np.frombuffer(zlib.decompress(data), dtype=np.uint8).reshape(height, width + 1)
    return lines[:, 1:]


def part(path, seed, spike):
    rng = np.random.default_rng(seed)
    z = 5e-9 * rng.standard_normal((300, 200))
    z[40, 150] += spike
    return ms.write(ms.Surface(z, 1e-6, 1e-6), path)


def test_a_picture_is_small_and_keeps_the_pixel_that_stands_out(tmp_path):
    part(tmp_path / "p.sdf", 1, 5e-6)
    png = thumbnail(Recipe.parse(RECIPE).run(tmp_path / "p.sdf").document)
    assert len(png) <= 8192
    shown = pixels(png)
    assert max(shown.shape) <= 96
    i, j = (int(v) for v in np.argwhere(shown == 255)[0])
    # row 0 of the picture is the largest y
    assert abs((1 - (i + 0.5) / shown.shape[0]) - 40 / 300) < 0.02
    assert abs((j + 0.5) / shown.shape[1] - 150 / 200) < 0.02
    assert _table().shape == (256, 3)


def test_the_index_of_a_batch_shows_them_worst_first(tmp_path):
    inbox = tmp_path / "in"
    inbox.mkdir()
    for name, spike in (("a", 0.0), ("b", 0.3e-6), ("c", 5e-6)):
        part(inbox / f"{name}.sdf", 3, spike)
    report = Recipe.parse(RECIPE, folder=inbox).batch(
        inbox, out=tmp_path / "out", scheduler="serial"
    )
    assert report.counts["rejected"] == 2
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    bad = page.partition("Not accepted, worst first")[2].partition("<h2>")[0]
    assert 0 < bad.index("c.sdf") < bad.index("b.sdf")
    assert "a.sdf" not in bad
    assert bad.count('loading="lazy"') == 2
    assert len([*(tmp_path / "out").rglob("thumb.png")]) == 3


def test_a_result_without_pictures_has_no_thumbnail():
    assert thumbnail({}) is None

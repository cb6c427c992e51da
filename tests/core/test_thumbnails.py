"""Small pictures in notebooks: size, orientation, gaps, names that are HTML."""

from __future__ import annotations

import itertools
import re
import struct
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core._thumbnails import map_thumbnail, profile_thumbnail
from metrosep.core.provenance import Step

LARGEST = 40_000
"""Bytes of a PNG; the specification's number."""

GREY = (138, 138, 138)
DARKEST, BRIGHTEST = (0x44, 0x01, 0x54), (0xFD, 0xE7, 0x25)
"""Ends of viridis."""


def decoded(png: bytes) -> np.ndarray:
    """Return the pixels of an indexed PNG of 8 bits as (row, column, RGBA), by its standard."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, chunks = 8, {}
    while at < len(png):
        (length,) = struct.unpack(">I", png[at : at + 4])
        kind, data = png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        (check,) = struct.unpack(">I", png[at + 8 + length : at + 12 + length])
        assert check == zlib.crc32(kind + data)
        chunks[kind] = data
        at += 12 + length
    assert list(chunks)[-1] == b"IEND"
    columns, rows, depth, colour, *rest = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert (depth, colour, rest) == (8, 3, [0, 0, 0])
    lines = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(rows, columns + 1)
    assert not lines[:, 0].any()  # no filter
    palette = np.frombuffer(chunks[b"PLTE"], np.uint8).reshape(-1, 3)
    opaque = np.full((palette.shape[0], 1), 255, np.uint8)
    clear = np.frombuffer(chunks.get(b"tRNS", b""), np.uint8)
    opaque[: clear.size, 0] = clear
    return np.hstack([palette, opaque])[lines[:, 1:]]


def of_map(z: np.ndarray, dx: float | None = 1e-6, dy: float | None = 1e-6) -> np.ndarray:
    return decoded(map_thumbnail(np.asarray(z, float), dx, dy)[0])


def is_grey(pixels: np.ndarray) -> np.ndarray:
    return (pixels[..., :3] == GREY).all(axis=-1)


# ---- maps -----------------------------------------------------------------------------------------


def test_y_points_up_and_x_to_the_right() -> None:
    """Row 0 of a map lies at its lowest y, so at the bottom of the picture."""
    z = np.zeros((4, 4))
    z[0, 0], z[0, 3] = -1.0, 1.0
    picture = of_map(z)
    assert tuple(picture[-1, 0, :3]) == DARKEST
    assert tuple(picture[-1, -1, :3]) == BRIGHTEST
    assert len({tuple(p) for p in picture[: picture.shape[0] // 2].reshape(-1, 4)}) == 1


def test_gaps_are_grey_where_they_are_and_nowhere_else() -> None:
    z = np.add.outer(np.arange(8.0), np.arange(8.0))
    z[6:, :2] = np.nan  # upper left
    picture = is_grey(of_map(z))
    n = picture.shape[0]
    assert picture[: n // 4, : n // 4].all()
    assert picture.sum() == (n // 4) ** 2


def test_less_than_half_a_cell_is_not_drawn_as_measured() -> None:
    """Of 768 pixels on 192 cells a side: each cell is the mean of 16; 7 of them are too few."""
    z = np.ones((768, 768))
    z[:384, :384] = np.nan
    z[:384:4, 0:384] = 1.0  # 4 of 16 pixels of each cell, lower left
    z[384::4, 384:] = 3.0  # upper right: a quarter is 3, so the means are 1.5
    picture = of_map(z)
    assert is_grey(picture[96:, :96]).all()
    assert is_grey(picture).sum() == 96 * 96
    assert tuple(picture[0, -1, :3]) == BRIGHTEST
    assert map_thumbnail(z, 1e-6, 1e-6)[1] == (1.0, 1.5)


def test_pixels_are_square_in_metres() -> None:
    assert of_map(np.zeros((10, 10)), dx=2e-6, dy=1e-6).shape[:2] == (96, 192)
    assert of_map(np.zeros((10, 10)), dx=1e-6, dy=4e-6).shape[:2] == (192, 48)
    assert of_map(np.zeros((10, 40)), None, None).shape[:2] == (48, 192)
    assert of_map(np.zeros((1, 4000))).shape[:2] == (12, 192)  # a line is still seen


def test_one_wild_pixel_does_not_take_all_colours() -> None:
    z = np.tile(np.linspace(0.0, 1e-9, 192), (192, 1))
    z[5, 5] = 1e-3
    _, span = map_thumbnail(z, 1e-6, 1e-6)
    assert span is not None
    assert span[1] <= 1e-9


@pytest.mark.parametrize(
    "z",
    [
        np.full((5, 7), np.nan),
        np.full((5, 7), 3e-6),
        np.array([[2.0]]),
        np.array([[np.nan]]),
        np.array([[-1e100, 1e100]]),
        np.array([[5e-324, 0.0]]),
    ],
    ids=["nothing", "constant", "one pixel", "one gap", "huge", "tiny"],
)
def test_odd_maps_have_a_picture_without_warnings(z: np.ndarray) -> None:
    picture = of_map(z)
    assert is_grey(picture).all() == np.isnan(z).all()
    assert "<img" in Surface(z, dx=1e-6, dy=1e-6)._repr_html_()
    assert "<img" in Surface(z)._repr_html_()


def test_a_large_noisy_map_stays_small() -> None:
    z = np.random.default_rng(3).standard_normal((700, 700))
    assert len(map_thumbnail(z, 1e-6, 1e-6)[0]) <= LARGEST


# ---- profiles -------------------------------------------------------------------------------------


def of_profile(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    return decoded(profile_thumbnail(np.asarray(x, float), np.asarray(z, float)))


def line_rows(picture: np.ndarray) -> list[float]:
    """Return the middle row of the line in each column, NaN where there is none."""
    drawn = (picture[..., 3] == 255) & ~is_grey(picture)
    return [float(np.flatnonzero(c).mean()) if c.any() else np.nan for c in drawn.T]


def test_a_rising_profile_rises() -> None:
    rows = line_rows(of_profile(np.arange(500.0), np.arange(500.0)))
    assert all(b <= a for a, b in itertools.pairwise(rows))
    assert rows[0] - rows[-1] > 80  # of 96


def test_every_spike_is_seen() -> None:
    z = np.zeros(100_000)
    z[54_321] = 1e-6
    rows = np.array(line_rows(of_profile(np.arange(z.size) * 1e-6, z)))
    k = int(0.54321 * rows.size)
    assert np.flatnonzero(rows != rows[0]).tolist() == [k]


def test_gaps_of_a_profile_are_grey_and_not_bridged() -> None:
    z = np.ones(1000)
    z[500:750] = np.nan
    picture = of_profile(np.arange(1000.0), z)
    grey = is_grey(picture).all(axis=0)
    n = grey.size
    assert grey[n // 2 + 2 : 3 * n // 4 - 2].all()
    assert not grey[: n // 2 - 1].any()
    assert not grey[3 * n // 4 + 2 :].any()


def test_few_samples_are_joined_by_lines() -> None:
    rows = line_rows(of_profile(np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.0, 0.0])))
    assert not np.isnan(rows).any()
    assert int(np.argmin(rows)) == pytest.approx(len(rows) / 3, abs=1)


@pytest.mark.parametrize(
    ("x", "z"),
    [
        ([0.0, 1.0], [np.nan, np.nan]),
        ([0.0, 1.0, 2.0], [4.0, 4.0, 4.0]),
        ([1.0], [2.0]),
        ([1.0], [np.nan]),
        ([0.0, 1e-300], [-1e100, 1e100]),
    ],
    ids=["nothing", "constant", "one sample", "one gap", "huge"],
)
def test_odd_profiles_have_a_picture_without_warnings(x: list[float], z: list[float]) -> None:
    picture = of_profile(np.array(x), np.array(z))
    assert is_grey(picture).all() == np.isnan(z).all()
    assert "<img" in Profile(x, z)._repr_html_()


# ---- what stands around them ------------------------------------------------------------------------


class _Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag != "img":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


HOSTILE = "<script>alert('1')</script>\"'><img src=x onerror=alert(1)>&amp;"


@pytest.mark.parametrize("kind", ["map", "profile"])
def test_names_that_are_html_are_text(kind: str) -> None:
    step = Step(HOSTILE, {HOSTILE: HOSTILE})
    z = np.zeros((3, 4))
    text = (
        Surface(z, dx=1e-6, dy=1e-6, history=(step,))
        if kind == "map"
        else Profile(np.arange(4.0), z[0], history=(step,))
    )._repr_html_()
    seen = _Tags(text)
    assert seen.open == []
    assert seen.tags <= {
        "div", "img", "table", "caption", "b", "tr", "th", "td", "details", "summary", "ol", "li", "p",
    }  # fmt: skip
    assert seen.attributes <= {"style", "alt", "src"}
    assert text.count("<img") == 1
    assert "&lt;script&gt;" in text


def test_it_asks_for_nothing_and_stays_small() -> None:
    z = np.random.default_rng(1).standard_normal((300, 300))
    for text in (
        Surface(z, dx=1e-6, dy=1e-6)._repr_html_(),
        Profile(np.arange(300.0), z[0])._repr_html_(),
    ):
        assert re.findall(r"(?:src|href|url)\s*[=(]\s*'?([a-z]+:[a-z/]*)", text) == [
            "data:image/png"
        ]
        assert len(text) < 1.5 * LARGEST

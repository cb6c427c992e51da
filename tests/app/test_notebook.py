"""The widget of a notebook without a front end: traits, frames, refusals."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.app.notebook import explore, widget_module, widget_style
from metrosep.app.wire import unpack
from metrosep.core.errors import DataError

STEP = 1e-5
ROUNDING = 1e-21
"""Heights of some 1e-6 m round by 1e-16 of them; a few of these add up."""


def tilted() -> Surface:
    """Return z = 1e-3 x + 2e-3 y over 60 x 40 pixels, one pixel missing."""
    y, x = np.mgrid[0:40, 0:60] * STEP
    z = 1e-3 * x + 2e-3 * y
    z[20, 30] = np.nan
    return Surface(z, dx=STEP, dy=STEP)


def wave() -> Profile:
    """Return ten waves of 5 nm in 400 samples."""
    i = np.arange(400)
    return Profile(i * STEP, 5e-9 * np.cos(2 * np.pi * 10 * i / 400))


@pytest.fixture(autouse=True)
def _anywidget() -> None:
    pytest.importorskip("anywidget")


def header_of(widget: Any, picture: str) -> dict[str, Any]:
    return unpack(getattr(widget, f"{picture}_frame"))[0]


# ---- what is shown ----------------------------------------------------------------------------


def test_a_map_has_its_section_and_all_frames() -> None:
    w = tilted().explore()
    assert w.kind == "map"
    # 8 % of the width from the rim, which lies half a pixel beyond the first sample
    width, y = 60 * STEP, 19.5 * STEP
    assert w.a == pytest.approx((-0.5 * STEP + 0.08 * width, y), abs=1e-15)
    assert w.b == pytest.approx((59.5 * STEP - 0.08 * width, y), abs=1e-15)
    for picture in ("map", "section", "spectrum"):
        assert header_of(w, picture)["ok"], picture
    assert w.profile_frame == b""
    header, arrays = unpack(w.map_frame)
    assert header["coverage"] == pytest.approx(2399 / 2400, abs=1e-12)
    assert (arrays["index"] == 0).any()


def test_a_profile_has_its_frames() -> None:
    w = wave().explore()
    assert w.kind == "profile"
    assert (w.a, w.b, w.map_frame, w.section_frame) == (None, None, b"", b"")
    assert header_of(w, "profile")["ok"]
    header = header_of(w, "spectrum")
    # the middle third of 1 / 400 to 1 / 2 of the samples holds the ten waves
    assert header["inside"] == pytest.approx(5e-9 / math.sqrt(2), abs=1e-13)
    assert w.section is w._exploration.obj


def test_the_band_begins_as_the_middle_third_of_the_wavelengths() -> None:
    long, short = math.log(400 * STEP), math.log(2 * STEP)
    third = (long - short) / 3
    want = (math.exp(short + third), math.exp(short + 2 * third))
    assert wave().explore().band == pytest.approx(want, abs=1e-12)


def test_the_section_is_that_of_the_map() -> None:
    """On a plane, bilinear reading is exact: z rises by the slopes times the way."""
    w = tilted().explore(a=(1e-4, 1e-4), b=(5e-4, 3e-4))
    z = w.section.z
    assert np.isnan(z).any()  # it runs through the missing pixel
    assert z[0] == pytest.approx(1e-3 * 1e-4 + 2e-3 * 1e-4, abs=ROUNDING)
    assert z[-1] - z[0] == pytest.approx(1e-3 * 4e-4 + 2e-3 * 2e-4, abs=ROUNDING)
    assert w.section.x[-1] == pytest.approx(math.hypot(4e-4, 2e-4), abs=1e-15)


def test_the_cursors_read_the_plane_where_they_stand() -> None:
    w = tilted().explore(a=(1e-4, 1e-4), b=(5e-4, 1e-4))
    w.cursors = (0.25, 1.0)
    assert header_of(w, "section")["heights"] == [
        [0.25, pytest.approx(1e-3 * 2e-4 + 2e-3 * 1e-4, abs=ROUNDING)],
        [1.0, pytest.approx(1e-3 * 5e-4 + 2e-3 * 1e-4, abs=ROUNDING)],
    ]


def test_a_set_end_draws_section_and_spectrum_again_and_not_the_map() -> None:
    w = tilted().explore()
    before = {p: getattr(w, f"{p}_frame") for p in ("map", "section", "spectrum")}
    heard: list[str] = []
    w.observe(lambda change: heard.append(change["name"]), names=list(w.keys))
    w.a = (1e-4, 2e-4)
    assert sorted(heard) == ["a", "section_frame", "spectrum_frame"]
    assert w.map_frame == before["map"]
    assert header_of(w, "section")["length"] == pytest.approx(
        math.hypot(w.b[0] - 1e-4, w.b[1] - 2e-4), abs=1e-15
    )
    assert w.section.z[0] == pytest.approx(1e-3 * 1e-4 + 2e-3 * 2e-4, abs=ROUNDING)


def test_the_same_value_again_draws_nothing() -> None:
    w = tilted().explore(a=(1e-4, 1e-4))
    heard: list[str] = []
    w.observe(lambda change: heard.append(change["name"]), names=list(w.keys))
    w.a = [1e-4, 1e-4]  # a list comes from the front end
    assert [name for name in heard if name.endswith("_frame")] == []


def test_limits_of_the_band_change_only_the_sums() -> None:
    w = wave().explore(band=(1e-4, 1e-3))
    assert header_of(w, "spectrum")["inside"] == pytest.approx(5e-9 / math.sqrt(2), abs=1e-13)
    w.band = (1e-4, 2e-4)
    assert header_of(w, "spectrum")["inside"] < 1e-13
    assert header_of(w, "spectrum")["outside"] == pytest.approx(5e-9 / math.sqrt(2), abs=1e-13)


def test_limits_of_the_colours_and_the_view_draw_the_map() -> None:
    w = tilted().explore(limits=(0.0, 1e-6))
    assert header_of(w, "map")["range"] == [0.0, 1e-6]
    w.view = {"window": [0.0, 0.0, 1e-4, 1e-4], "pixels": [10, 10], "level": "drag"}
    header, arrays = unpack(w.map_frame)
    assert header["window"] != header["extent"]
    # z = 1e-3 x + 2e-3 y runs to 3e-7 m in this corner: below a third of the colours
    assert arrays["index"].max() < 255 / 2
    w.limits = None
    assert header_of(w, "map")["range"] == header_of(w, "map")["auto_range"]


def test_a_window_of_the_profile_is_drawn() -> None:
    w = wave().explore(window=(1e-3, 2e-3))
    _, arrays = unpack(w.profile_frame)
    assert 1e-3 - STEP <= arrays["x"][0] <= arrays["x"][-1] <= 2e-3 + STEP


def test_no_two_frames_are_alike() -> None:
    """A trait that is set to an equal value is not sent: the front end would wait in vain."""
    w = tilted().explore()
    first = w.section_frame
    start = w.a
    w.a = (1e-4, 1e-4)
    w.a = start
    assert w.section_frame != first


def test_equal_ends_are_told_in_the_pictures_and_leave_the_map() -> None:
    w = tilted().explore()
    w.a = w.b
    header = header_of(w, "section")
    assert not header["ok"]
    assert "its ends must differ" in header["error"]["message"]
    assert header_of(w, "map")["ok"]
    w.a = (0.0, 0.0)
    assert header_of(w, "section")["ok"]


@pytest.mark.parametrize(
    "z", [np.full((4, 5), np.nan), np.full((4, 5), 2e-9), np.zeros((1, 1)), np.zeros((1, 9))]
)
def test_odd_maps_are_shown_without_warnings(z: np.ndarray[Any, Any]) -> None:
    for dx in (1e-6, None):
        w = Surface(z, dx=dx, dy=dx).explore()
        assert header_of(w, "map")["ok"]


def test_one_sample_is_refused_by_the_spectrum_only() -> None:
    w = Profile([0.0], [1e-9]).explore()
    assert w.band is None
    assert not header_of(w, "spectrum")["ok"]


# ---- units --------------------------------------------------------------------------------------


def test_without_lateral_calibration_wavelengths_are_pixels_and_called_so() -> None:
    """A wave of 8 pixels; the same map with steps of 1 um has a wave of 8 um."""
    column = np.tile(np.cos(2 * np.pi * np.arange(64) / 8), (5, 1)) * 1e-9
    column[:, 40] = np.nan
    for surface, unit, step in (
        (Surface(column), "px", 1.0),
        (Surface(column, dx=1e-6, dy=1e-6), "m", 1e-6),
    ):
        w = surface.explore(a=(0.0, 2.0 * step), b=(63.0 * step, 2.0 * step))
        header, arrays = unpack(w.spectrum_frame)
        assert header["unit"] == unit
        greatest = arrays["wavelength"][arrays["amplitude"].argmax()]
        assert greatest == pytest.approx(8.0 * step, abs=1e-9 * step)
        (message,) = header["messages"]
        assert ("0 px ... 39 px" if unit == "px" else "0 m ... 39 um") in message
        assert header_of(w, "section")["unit"] == header_of(w, "map")["unit"] == unit


# ---- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bands": (1, 2)}, "no option 'bands' to explore a Surface; there are a, b, band"),
        ({"window": (0, 1)}, "no option 'window'"),
        ({"a": (1e-4,)}, "a, an end of the section, must be two finite numbers"),
        ({"a": (math.nan, 0)}, "must be two finite numbers"),
        ({"b": "12"}, "must be two finite numbers, got '12'"),
        ({"band": (2e-4, 1e-4)}, "the band of wavelengths must rise"),
        ({"band": (0.0, 1e-4)}, "the band of wavelengths must be positive"),
        ({"limits": (1.0, 1.0)}, "the limits of the colours must rise"),
        ({"colours": "jet"}, "colours are viridis or cividis, got 'jet'"),
        ({"height": 100}, "height must be 240 to 2000 pixels, got 100"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(DataError, match=words):
        tilted().explore(**options)


def test_a_wrong_value_leaves_the_old_one() -> None:
    w = tilted().explore()
    before, frame = w.band, w.spectrum_frame
    with pytest.raises(DataError, match="must rise"):
        w.band = (3.0, 2.0)
    assert (w.band, w.spectrum_frame) == (before, frame)


def test_only_maps_and_profiles_are_explored() -> None:
    with pytest.raises(DataError, match="a Surface or a Profile can be explored, got ndarray"):
        explore(np.zeros((3, 3)))  # type: ignore[arg-type]


def test_without_anywidget_it_says_what_to_install() -> None:
    """In an interpreter that cannot find it; nothing else of the package needs it."""
    code = (
        "import sys; sys.modules['anywidget'] = None\n"
        "from metrosep import Surface\n"
        "from metrosep.core.errors import UnsupportedFeatureError\n"
        "s = Surface([[0.0, 1e-9]], dx=1.0, dy=1.0); s._repr_html_()\n"
        "try: s.explore()\n"
        "except UnsupportedFeatureError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert 'pip install "metrosep[notebook]"' in done
    assert "anywidget, which is not installed" in done


# ---- front end ----------------------------------------------------------------------------------


def test_the_front_end_is_one_module_that_fetches_nothing() -> None:
    text = widget_module()
    assert not re.search(r"^\s*import\b", text, re.MULTILINE)
    assert text.count("export default") == 1
    for word in ("fetch(", "XMLHttpRequest", "import(", "innerHTML", "eval("):
        assert word not in text, word
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)  # a licence names its home
    assert set(re.findall(r"https?://[^\s\"'`]+", code)) == {"http://www.w3.org/2000/svg"}


def test_the_style_is_all_within_the_widget() -> None:
    text = widget_style()
    depth, outside = 0, ""
    for sign in text:
        depth -= sign == "}"
        if depth == 0:
            outside += sign
        depth += sign == "{"
    assert depth == 0
    selectors = [s.strip(" \n}{") for s in re.split(r"[{}]", outside) if s.strip(" \n}{")]
    assert selectors
    assert all(s.startswith(".metrosep-explore") for s in selectors)
    assert "url(" not in text
    assert "@import" not in text

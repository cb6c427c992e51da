"""The page and the notebook are told the same of a map or profile, units included."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.map_views import lateral_unit
from metrosep.app.notebook import Exploration
from metrosep.app.server import PictureAnswers
from metrosep.app.sessions import Session
from metrosep.app.wire import unpack

MEASURED = -2
"""The stage before all steps: the page proposes to take a plane off."""

SHARED = {
    "map": ("range", "window", "scale", "unit", "coverage", "is_preview", "extent"),
    "section": ("length", "pv", "sq", "share_valid", "unit", "is_preview"),
    "spectrum": ("inside", "outside", "messages", "unit", "is_preview"),
    "profile": ("is_preview",),
}


def eight_pixels() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return waves of 8 pixels along x, a pixel missing in the upper rows."""
    z = np.tile(1e-9 * np.cos(2 * np.pi * np.arange(64) / 8), (6, 1))
    z[4:, 40] = np.nan
    return z


def answers(folder: Path, obj: ms.Surface | ms.Profile) -> PictureAnswers:
    """Return the pictures of the page for an object that was written to a file."""
    file = folder / "a.h5"
    ms.write(obj, file)
    session = Session(Places([folder]))
    session.open(str(file))
    return PictureAnswers(session)


def plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


@pytest.mark.parametrize(("step", "unit"), [(1e-6, "m"), (None, "px")])
def test_page_and_notebook_say_the_same_of_a_map(
    tmp_path: Path, step: float | None, unit: str
) -> None:
    surface = ms.Surface(eight_pixels(), dx=step, dy=step)
    page, notebook = answers(tmp_path, surface), Exploration(surface)
    one = step or 1.0
    a, b, band = (0.0, 4.0 * one), (63.0 * one, 4.0 * one), (4.0 * one, 16.0 * one)
    message = {"stage": MEASURED, "level": "full", "a": a, "b": b, "band": band}
    frames = {
        "map": notebook.map({"level": "full"}),
        "section": notebook.section(a, b),
        "spectrum": notebook.spectrum(a, b, band),
    }
    for kind, frame in frames.items():
        header, arrays = getattr(page, kind)(message, lambda: False)
        other, others = unpack(frame)
        assert {k: plain(header[k]) for k in SHARED[kind]} == {k: other[k] for k in SHARED[kind]}
        assert header["unit"] == unit, kind
        assert arrays.keys() == others.keys()
        for name, values in arrays.items():
            assert np.array_equal(values, others[name], equal_nan=True), (kind, name)


def test_wavelengths_of_a_map_without_calibration_are_pixels(tmp_path: Path) -> None:
    page = answers(tmp_path, ms.Surface(eight_pixels()))
    message = {"stage": MEASURED, "level": "full", "a": (0.0, 1.0), "b": (63.0, 1.0), "band": None}
    header, arrays = page.spectrum(message, lambda: False)
    assert header["unit"] == "px"
    assert arrays["wavelength"][arrays["amplitude"].argmax()] == 8.0
    message |= {"a": (0.0, 5.0), "b": (63.0, 5.0)}  # through the missing pixel
    (said,) = page.spectrum(message, lambda: False)[0]["messages"]
    assert said.startswith("spectrum of the longest part without a gap: 0 px ... 39 px, ")


def test_page_and_notebook_say_the_same_of_a_profile(tmp_path: Path) -> None:
    profile = ms.Profile(np.arange(64) * 1e-6, eight_pixels()[5])
    page, notebook = answers(tmp_path, profile), Exploration(profile)
    header, arrays = page.spectrum(
        {"stage": MEASURED, "level": "full", "band": None}, lambda: False
    )
    other, others = unpack(notebook.spectrum())
    assert {k: header[k] for k in SHARED["spectrum"]} == {k: other[k] for k in SHARED["spectrum"]}
    assert header["unit"] == "m"
    assert np.array_equal(arrays["amplitude"], others["amplitude"])
    shown = {"stage": MEASURED, "level": "full", "series": ["measured"]}
    _, arrays = page.profile(shown, lambda: False)
    _, others = unpack(notebook.profile())
    for name, values in others.items():
        assert np.array_equal(arrays[f"measured_{name}"], values, equal_nan=True), name


def test_one_step_alone_is_no_calibration() -> None:
    z = [[0.0, 1e-9]]
    assert lateral_unit(ms.Surface(z, dx=1e-6, dy=None)) == "px"
    assert lateral_unit(ms.Surface(z, dx=None, dy=1e-6)) == "px"
    assert lateral_unit(ms.Profile([0.0, 1.0], z[0])) == "m"

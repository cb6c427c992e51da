"""What the first picture needs, loaded while the page loads."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable

import numpy as np

from metrosep.core.errors import MetrosepError

__all__ = ["start_warm_up", "warm_up"]


def warm_up(stop: Callable[[], bool] = lambda: False) -> None:
    """Carry out on a few pixels what opening a map or profile does.

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
    from metrosep.recipe.described_steps import described_steps
    from metrosep.recipe.pipeline import checked_step

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

    threading.Thread(target=work, daemon=True, name="warm-up").start()
    return stop.set

"""The top of the house: what objects of the core can do by upper layers is attached here.

Nothing is loaded before it is used.
"""

from __future__ import annotations

from typing import Any

from metrosep.core.attached import attached

__all__: list[str] = []


def _explore(obj: Any, /, **options: Any) -> Any:
    from metrosep.app.notebook import explore

    return explore(obj, **options)


def _plot(obj: Any, ax: Any = None, /, **options: Any) -> Any:
    from metrosep.plot.objects import draw_object

    return draw_object(obj, ax, **options)


def _to_frame(obj: Any, /) -> Any:
    from metrosep.io.frames import to_frame

    return to_frame(obj)


def _to_xarray(obj: Any, /) -> Any:
    from metrosep.io.frames import to_xarray

    return to_xarray(obj)


def _save(obj: Any, path: Any, /) -> Any:
    from metrosep.io.saved import save

    return save(obj, path)


def _mask(obj: Any, shape: str, /, *, outside: bool, **keys: Any) -> Any:
    from metrosep.recipe.pipeline import run_step

    return run_step(
        obj, {"op": "mask", "aperture": {"shape": shape, **keys}, "outside": outside}
    ).obj


attached.explore, attached.mask = _explore, _mask
attached.plot, attached.to_frame, attached.to_xarray = _plot, _to_frame, _to_xarray
attached.save = _save
attached.method_packages = ("metrosep.separation", "metrosep.recipe")

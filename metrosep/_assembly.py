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


def _level(obj: Any, /) -> Any:
    return obj.remove_line() if hasattr(obj, "remove_line") else _remove_form(obj, "plane")


def _remove_form(obj: Any, form: Any, /, **options: Any) -> Any:
    from metrosep.forms import form_from_text, remove

    return remove(obj, form_from_text(form) if isinstance(form, str) else form, **options)


def _filter(obj: Any, kind: str, /, **options: Any) -> Any:
    from metrosep import filters
    from metrosep.core.numbers import choice

    return getattr(filters, choice(kind, "filter", _FILTERS))(obj, **options)


def _mask(obj: Any, shape: str, /, *, outside: bool, **keys: Any) -> Any:
    from metrosep.recipe.pipeline import run_step

    return run_step(
        obj, {"op": "mask", "aperture": {"shape": shape, **keys}, "outside": outside}
    ).obj


def _parameters(obj: Any, names: tuple[str, ...], /, **options: Any) -> Any:
    from metrosep.filters import profile_kind
    from metrosep.parameters import areal_parameters, profile_parameters

    wanted = names or None
    if hasattr(obj, "dy"):
        return areal_parameters(obj, names=wanted, **options)
    return profile_parameters(obj, names=wanted, **{"kind": profile_kind(obj) or "P"} | options)


def _step_height(obj: Any, /, **options: Any) -> Any:
    from metrosep.parameters import step_height

    return step_height(obj, **options)


def _resample(obj: Any, onto: Any, /, **options: Any) -> Any:
    from metrosep.filters import resample

    return resample(obj, onto, **options)


def _load_document(path: Any, /) -> Any:
    from metrosep.recipe.result import Result, load_document, stored_estimate

    document = load_document(path)
    produced = stored_estimate(document) if document.get("estimate") is not None else None
    return Result(document, produced)


_FILTERS = (
    "gaussian", "robust_gaussian", "spline", "opening", "closing", "dilation", "erosion", "primary",
    "roughness", "waviness",
)  # fmt: skip

attached.verbs = {
    "level": _level, "remove_form": _remove_form, "filter": _filter, "mask": _mask,
    "parameters": _parameters, "step_height": _step_height, "resample": _resample,
}  # fmt: skip
attached.explore = _explore
attached.plot, attached.to_frame, attached.to_xarray = _plot, _to_frame, _to_xarray
attached.save, attached.load_document = _save, _load_document
attached.method_packages = ("metrosep.separation", "metrosep.recipe")

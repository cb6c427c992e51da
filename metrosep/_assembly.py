"""The top of the house: what objects of the core can do by upper layers is attached here.

Nothing is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.core.attached import attached


def _explore(obj: Any, /, **options: Any) -> Any:
    from metrosep.app.notebook import explore

    return explore(obj, **options)


def _plot(obj: Any, ax: Any = None, /, **options: Any) -> Any:
    from metrosep.plot.objects import draw_object
    from metrosep.plot.style import known_to_pyplot

    made = draw_object(obj, ax, **options)
    return made if ax is not None and not isinstance(ax, str) else known_to_pyplot(made)


def _to_frame(obj: Any, /) -> Any:
    from metrosep.io.frames import to_frame

    return to_frame(obj)


def _to_xarray(obj: Any, /) -> Any:
    from metrosep.io.frames import to_xarray

    return to_xarray(obj)


def _save(obj: Any, path: Any, /) -> Any:
    from metrosep.io.saved import save

    return save(obj, path)


def _check_options(made: Any, what: str, given: int, options: Mapping[str, Any]) -> None:
    """Refuse options that a function does not have behind its first values, or lacks."""
    import inspect

    from metrosep.core.errors import OptionError

    known = list(inspect.signature(made).parameters.values())[given:]
    names = [p.name for p in known]
    stray = [k for k in options if k not in names]
    missing = [p.name for p in known if p.default is p.empty and p.name not in options]
    if stray or missing:
        said = f"does not take {', '.join(stray)}" if stray else f"needs {', '.join(missing)}"
        shown = ", ".join(k for k in names if k != "names")  # which are no keyword of ours
        raise OptionError(f"{what} {said}; its options are {shown}")


def _called(made: Any, what: str, /, *values: Any, **options: Any) -> Any:
    """Call a function of an upper layer with options that it has."""
    _check_options(made, what, len(values), options)
    return made(*values, **options)


def _level(obj: Any, /) -> Any:
    return obj.remove_line() if hasattr(obj, "remove_line") else _remove_form(obj, "plane")


def _remove_form(obj: Any, form: Any, /, **options: Any) -> Any:
    from metrosep.forms import fit, remove

    _check_options(fit, "remove_form", 2, options)
    return remove(obj, form, **options)


def _filter(obj: Any, kind: str, /, **options: Any) -> Any:
    from metrosep import filters
    from metrosep.core.errors import OptionError
    from metrosep.core.numbers import choice

    made = getattr(filters, choice(kind, "filter", _FILTERS))
    if kind in _OF_PROFILES and hasattr(obj, "dy"):
        raise OptionError(
            f'filter "{kind}" is of profiles, and this is a map; use "gaussian" with nesting_index='
        )
    return _called(made, f'filter "{kind}"', obj, **options)


def _mask(obj: Any, shape: str, /, *, outside: bool, **keys: Any) -> Any:
    from metrosep.recipe.pipeline import run_step

    plain = {k: v.tolist() if hasattr(v, "tolist") else v for k, v in keys.items()}  # of numpy
    return run_step(
        obj, {"op": "mask", "aperture": {"shape": shape, **plain}, "outside": outside}
    ).obj


def _parameters(obj: Any, names: tuple[str, ...], /, **options: Any) -> Any:
    from metrosep.core.errors import OptionError
    from metrosep.filters import profile_kind
    from metrosep.parameters import areal_parameters, profile_parameters

    if "names" in options:
        raise OptionError(
            'parameters() takes the symbols themselves, parameters("Sq", "Sz"), not names='
        )
    wanted = names or None
    if hasattr(obj, "dy"):
        return _called(areal_parameters, "parameters() of a map", obj, names=wanted, **options)
    given = {"names": wanted, "kind": profile_kind(obj) or "P"} | options
    return _called(profile_parameters, "parameters() of a profile", obj, **given)


def _step_height(obj: Any, /, **options: Any) -> Any:
    from metrosep.parameters import step_height

    return _called(step_height, "step_height", obj, **options)


def _resample(obj: Any, onto: Any, /, **options: Any) -> Any:
    from metrosep.filters import resample

    return _called(resample, "resample", obj, onto, **options)


def _load_document(path: Any, /) -> Any:
    from metrosep.recipe.result import Result, load_document, stored_estimate

    document = load_document(path)
    produced = stored_estimate(document) if document.get("estimate") is not None else None
    return Result(document, produced)


_OF_PROFILES = ("primary", "roughness", "waviness")
_FILTERS = (
    "gaussian", "robust_gaussian", "spline", "opening", "closing", "dilation", "erosion", *_OF_PROFILES,
)  # fmt: skip

attached.verbs = {
    "level": _level, "remove_form": _remove_form, "filter": _filter, "mask": _mask,
    "parameters": _parameters, "step_height": _step_height, "resample": _resample,
}  # fmt: skip
attached.explore = _explore
attached.plot, attached.to_frame, attached.to_xarray = _plot, _to_frame, _to_xarray
attached.save, attached.load_document = _save, _load_document
attached.method_packages = ("metrosep.separation", "metrosep.recipe")

"""What every public object does alike: draw itself, become a table, be saved, be compared by its values.

The classes inherit it; nothing is written again in one of them. What needs an upper layer (pictures,
files, data frames) stands in `attached`, which the top of the package fills.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any, Self

import numpy as np

from metrosep.core.attached import attached

_ABOUT = ("metadata", "history", "audit", "messages", "notes", "out", "files")
"""Fields that say where an object came from, or lies; `equals` leaves them out."""


_ROWS = 12
"""Of a table in a notebook."""

_LONGEST = 100
"""Characters of the line of an object."""


def _refuse_change(obj: Any, name: str, value: Any = None) -> None:
    """Refuse to set or delete an attribute."""
    del value
    from metrosep.core.readable import nearest

    kind = type(obj).__name__
    named = {f.name for f in dataclasses.fields(obj)}
    near = nearest(name, named)
    about = f"{name} is a field of it" if name in named else f"it has no {name!r}"
    hint = f"; did you mean {near}?" if near and name not in named else ""
    raise dataclasses.FrozenInstanceError(
        f"a {kind} does not change, and {about}{hint}: make a new {kind}, or keep your value beside it"
    )


class PublicObject:
    """Base of what a user holds in hand."""

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        """Let a frozen class say in a sentence that it is frozen, also of names that it does not have."""
        super().__init_subclass__(**options)
        if "__setattr__" in cls.__dict__ and "__dataclass_fields__" in cls.__dict__:
            cls.__setattr__ = _refuse_change  # type: ignore[method-assign]
            cls.__delattr__ = _refuse_change  # type: ignore[method-assign]

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draw the object and return the axes; nothing is shown and no setting of matplotlib changes.

        Parameters
        ----------
        ax : matplotlib Axes or str, optional
            Axes to draw into; new ones if omitted, of a figure that a notebook and ``plt.show()`` show where
            pyplot is in use. Of an estimate also "spectrum" or "psd".
        **options
            ``vmin``, ``vmax``: ends of the scale, in SI or as a text with its unit ("5 nm"); ``unit``:
            unit of the values that are drawn.

        Returns
        -------
        matplotlib Axes
            A figure for what needs several panels.

        Raises
        ------
        DataError
            If the object has no picture, or an option is wrong.
        """
        return attached.plot(self, ax, **options)

    def to_frame(self) -> Any:
        """Return the object as a table; column names end in their units.

        Returns
        -------
        pandas.DataFrame
            Long form: one row for each sample, pixel or entry.

        Raises
        ------
        DataError
            If the object is not a table.
        """
        return attached.to_frame(self)

    def to_xarray(self) -> Any:
        """Return the object with its axes, for xarray.

        Returns
        -------
        xarray.DataArray or xarray.Dataset
            SI, units in the attributes.

        Raises
        ------
        DataError
            If the object has no axes.
        UnsupportedFeatureError
            If xarray is not installed.
        """
        return attached.to_xarray(self)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Save the object in an HDF5 file; `metrosep.load` returns it with every bit.

        Parameters
        ----------
        path : str or path
            File; it appears whole or not at all.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        DataError
            If the object holds something that cannot be saved.
        WriteError
            If the file cannot be written.
        """
        place: Path = attached.save(self, path)
        return place

    def equals(self, other: object) -> bool:
        """Return whether another object has the same class and values; NaN equals NaN.

        Parameters
        ----------
        other : object
            Anything.

        Returns
        -------
        bool
            Where the data came from (metadata, history, messages) does not count: `identical`.
        """
        return _alike(self, other, about=False)

    def identical(self, other: object) -> bool:
        """Return whether another object has the same class, values, metadata and history.

        Parameters
        ----------
        other : object
            Anything.

        Returns
        -------
        bool
            NaN equals NaN.
        """
        return _alike(self, other, about=True)

    def _repr_html_(self) -> str:
        """Return the line of the object and the first rows of its table, for notebooks."""
        from metrosep.core.errors import DataError

        line = f"<p><b>{escape(repr(self))}</b></p>"
        try:
            frame = self.to_frame()
        except DataError:
            return line
        return line + str(frame.head(_ROWS).to_html(border=0))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PublicObject):
            return NotImplemented
        return self.equals(other)

    def __hash__(self) -> int:
        """Return a hash of class and sizes: equal objects have equal ones."""
        sizes = [getattr(v, "shape", None) for k, v in state_of(self) if k not in _ABOUT]
        return hash((type(self).__name__, *(s for s in sizes if s is not None)))


def shortened(text: str) -> str:
    """Return the line of an object, cut at a word where it is longer than 100 characters.

    Examples
    --------
    >>> shortened("Recording(" + "channel, " * 40 + ")")[-21:], shortened("Run(1)")
    ('channel, channel ...)', 'Run(1)')
    """
    if len(text) <= _LONGEST:
        return text
    kept = text[: _LONGEST - 5]
    return kept[: max(kept.rfind(" "), kept.find("(") + 1)].rstrip(" ,;:") + " ...)"


def state_of(obj: Any) -> Iterator[tuple[str, Any]]:
    """Yield what an object holds: the fields of a dataclass, else its slots or attributes."""
    if dataclasses.is_dataclass(obj):
        names = [f.name for f in dataclasses.fields(obj)]
    else:
        slots = [s for c in type(obj).__mro__ for s in getattr(c, "__slots__", ())]
        names = [*dict.fromkeys(slots)] or [*vars(obj)]
    for name in names:
        if name != "__weakref__" and hasattr(obj, name):
            yield name, getattr(obj, name)


def _alike(a: Any, b: Any, *, about: bool) -> bool:
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    left, right = dict(state_of(a)), dict(state_of(b))
    keys = [k for k in left if about or k not in _ABOUT]
    return left.keys() == right.keys() and all(same(left[k], right[k], about=about) for k in keys)


def same(a: Any, b: Any, *, about: bool = True) -> bool:
    """Return whether two values are the same through and through; NaN equals NaN.

    Without `about`, where data came from does not count, in the objects that they hold either.

    Examples
    --------
    >>> same({"a": (np.nan, 1)}, {"a": (np.nan, 1)}), same(np.zeros(2), np.zeros(3))
    (True, False)
    """
    if a is b:
        return True
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        x, y = np.asarray(a), np.asarray(b)
        numeric = x.dtype.kind in "fc" and y.dtype.kind in "fc"
        return x.shape == y.shape and bool(np.array_equal(x, y, equal_nan=numeric))
    if isinstance(a, float) and isinstance(b, float) and a != a and b != b:
        return True
    if isinstance(a, Mapping) and isinstance(b, Mapping) and not isinstance(a, PublicObject):
        return a.keys() == b.keys() and all(same(v, b[k], about=about) for k, v in a.items())
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(same(v, w, about=about) for v, w in zip(a, b, strict=True))
    if isinstance(a, PublicObject) or (dataclasses.is_dataclass(a) and type(a) is type(b)):
        return _alike(a, b, about=about)
    return bool(a == b)


class Guessed:
    """Methods of `Surface` and `Profile` that are functions of filters, forms and parameters."""

    __slots__ = ()

    def level(self) -> Self:
        """Return the heights without their least-squares plane, or line.

        Returns
        -------
        Surface or Profile
            What is left; the history names what was removed.

        Raises
        ------
        DegenerateFitError
            If too few points are valid.
        """
        made: Self = attached.verbs["level"](self)
        return made

    def remove_form(self, form: Any = "plane", **options: Any) -> Self:
        """Return what is left of the heights after the best-fit form.

        Parameters
        ----------
        form : Form or str, optional
            An object of `metrosep.forms`, or a text such as "sphere" or "conic: R=50 mm, k=-1.2".
        **options
            Of `metrosep.forms.fit`.

        Returns
        -------
        Surface or Profile
            Measured minus ideal.

        Raises
        ------
        DataError
            If the form or an option is unknown.
        FitError
            If the points do not determine the form.
        """
        made: Self = attached.verbs["remove_form"](self, form, **options)
        return made

    def filter(self, kind: str = "gaussian", **options: Any) -> Self:
        """Return the heights through a filter of ISO 16610.

        Parameters
        ----------
        kind : str, optional
            A function of `metrosep.filters`: "gaussian", "robust_gaussian", "spline", "opening",
            "closing", "dilation", "erosion"; of a profile "primary", "roughness", "waviness" too.
        **options
            Of that function: ``nesting_index="80 um"`` of a map, ``cutoff="0.8 mm"`` of a profile,
            ``band="short"``.

        Returns
        -------
        Surface or Profile
            What passes the filter.

        Raises
        ------
        DataError
            If the filter or an option is unknown.
        """
        made: Self = attached.verbs["filter"](self, kind, **options)
        return made

    def mask(self, shape: str, *, outside: bool = True, **keys: Any) -> Self:
        """Return the heights without what lies outside a region, or inside it.

        Parameters
        ----------
        shape : {"circle", "ring", "rectangle", "polygon", "brush"}
            Of the region. The centre of a pixel decides; edges of a polygon are half-open.
        outside : bool, optional
            True: what lies outside is removed; False: what lies inside.
        **keys
            As in a step ``mask`` of a recipe, in m or as texts with units: ``diameter``,
            ``inner_diameter``, ``width``, ``height``, ``angle``, ``centre``, ``radius``, ``points``.

        Returns
        -------
        Surface or Profile
            NaN where it was removed.

        Raises
        ------
        StepError
            If there is no such region.
        TooFewSamplesError
            If nothing is left.
        """
        made: Self = attached.verbs["mask"](self, shape, outside=outside, **keys)
        return made

    def parameters(self, *names: str, **options: Any) -> Any:
        """Return the parameters of ISO 25178-2 of a map, or of ISO 21920-2 of a profile.

        Parameters
        ----------
        *names : str
            Symbols wanted; all if omitted.
        **options
            Of `metrosep.parameters.areal_parameters` or `metrosep.parameters.profile_parameters`.

        Returns
        -------
        ParameterTable
            ``table["Sq"].value`` in SI, ``table.to_frame()``.

        Raises
        ------
        DataError
            If a name or an option is unknown.
        """
        return attached.verbs["parameters"](self, names, **options)

    def step_height(self, **options: Any) -> Any:
        """Return the signed height of a step: of a groove negative.

        Parameters
        ----------
        **options
            Of `metrosep.parameters.step_height`: ``width``, ``middle``, ``kind``, ``axis``, ``degree``, ``upper``,
            ``lower``.

        Returns
        -------
        StepHeight
            With its standard uncertainty.

        Raises
        ------
        DataError
            If an option is wrong.
        TooFewSamplesError
            If a part holds too few valid samples.
        """
        return attached.verbs["step_height"](self, **options)

    def resample(self, onto: Any = None, **options: Any) -> Self:
        """Return the heights on another grid.

        Parameters
        ----------
        onto : Surface or Profile, optional
            Whose grid is wanted.
        **options
            Of `metrosep.filters.resample`: ``step`` in place of `onto`, ``method``.

        Returns
        -------
        Surface or Profile
            NaN outside what was measured.

        Raises
        ------
        DataError
            If the grid is not given or cannot be made.
        """
        made: Self = attached.verbs["resample"](self, onto, **options)
        return made

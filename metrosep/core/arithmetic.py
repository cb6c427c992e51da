"""Arithmetic of heights and of quantities: with units, with a history that names both parents, never by guess.

Two maps combine where their grids are the same to 1 % of a step; there is no inner join. A number that is
added is a length in m, or a text with its unit.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from metrosep.core.errors import DataError, OptionError
from metrosep.core.numbers import is_real, quantity, real
from metrosep.core.provenance import Step, hash_bytes

if TYPE_CHECKING:
    from metrosep.core._arrays import FloatArray

_SAME = 0.01
"""Of a step: grids that differ by less are one grid."""

_UFUNCS: dict[Any, Callable[..., Any]] = {
    np.negative: operator.neg, np.absolute: operator.abs, np.add: operator.add,
    np.subtract: operator.sub, np.multiply: operator.mul, np.true_divide: operator.truediv,
}  # fmt: skip


class HeightArithmetic:
    """What a map and a profile do with ``+``, ``-``, ``*`` and ``/``."""

    __slots__ = ()
    z: FloatArray
    history: tuple[Step, ...]

    def _with_heights(self, z: FloatArray, step: Step) -> Self:
        raise NotImplementedError

    def _grid(self) -> tuple[tuple[FloatArray, float], ...]:
        """Return positions and step along each axis, without positions where the step is not known."""
        raise NotImplementedError

    def _combined(
        self, other: Any, name: str, how: Callable[[Any, Any], Any], *, turned: bool
    ) -> Any:
        """Return the sum or difference with another of the kind, or with a length."""
        if isinstance(other, type(self)):
            require_same_grid(self, other)
            left, right = (other, self) if turned else (self, other)
            step = Step(name, {"left": _name_of(left), "right": _name_of(right)})
            return self._with_heights(how(left.z, right.z), step)
        if not isinstance(other, str) and not is_real(other):
            return NotImplemented
        height = quantity(other, f"what is {name}ed", "length")
        pair = (height, self.z) if turned else (self.z, height)
        return self._with_heights(how(*pair), Step(name, {"height_m": height, "turned": turned}))

    def _scaled(self, other: Any, name: str, how: Callable[[Any, Any], Any]) -> Any:
        if not is_real(other) or getattr(other, "unit", "1") != "1":
            return NotImplemented  # a length times a quantity is not a height
        factor = real(other, "a factor")
        if name == "divide" and factor == 0.0:
            raise DataError("heights cannot be divided by zero")
        return self._with_heights(how(self.z, factor), Step(name, {"factor": factor}))

    def __add__(self, other: Any) -> Any:
        return self._combined(other, "add", operator.add, turned=False)

    def __radd__(self, other: Any) -> Any:
        return self._combined(other, "add", operator.add, turned=True)

    def __sub__(self, other: Any) -> Any:
        return self._combined(other, "subtract", operator.sub, turned=False)

    def __rsub__(self, other: Any) -> Any:
        return self._combined(other, "subtract", operator.sub, turned=True)

    def __mul__(self, other: Any) -> Any:
        return self._scaled(other, "multiply", operator.mul)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self._scaled(other, "divide", operator.truediv)

    def __neg__(self) -> Self:
        return self._with_heights(-self.z, Step("negate"))

    def __abs__(self) -> Self:
        return self._with_heights(np.abs(self.z), Step("absolute"))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Return an object for what the table of operators holds, a plain array for every other function."""
        if ufunc in _UFUNCS and method == "__call__" and not options and not _has_arrays(inputs):
            return _UFUNCS[ufunc](*(i.item() if isinstance(i, np.generic) else i for i in inputs))
        plain = [np.asarray(i) if isinstance(i, HeightArithmetic) else i for i in inputs]
        return getattr(ufunc, method)(*plain, **options)

    def allclose(self, other: object, *, atol: float | str) -> bool:
        """Return whether another one has the same grid and heights to a tolerance; NaN equals NaN.

        Parameters
        ----------
        other : Surface or Profile
            Of the same kind.
        atol : float (m) or str with unit
            Largest difference, such as "0.1 nm".

        Returns
        -------
        bool
            False where only one of the two was measured.

        Raises
        ------
        OptionError
            If the other one is of another kind.
        DataError
            If the grids differ.
        """
        if not isinstance(other, type(self)):
            raise OptionError(
                f"allclose needs a {type(self).__name__}, got {type(other).__name__}"
            )
        require_same_grid(self, other)
        most = quantity(atol, "atol", "length")
        gaps = np.isnan(self.z) == np.isnan(other.z)
        away = np.nan_to_num(np.abs(self.z - other.z), nan=0.0)
        return bool(gaps.all()) and float(away.max(initial=0.0)) <= most


def _has_arrays(inputs: tuple[Any, ...]) -> bool:
    return any(isinstance(i, np.ndarray) and i.ndim for i in inputs)


def _name_of(obj: HeightArithmetic) -> str:
    """Return the file that heights were read from, or the start of the hash of their values."""
    files = [s.parameters.get("file") for s in obj.history if s.name == "read"]
    digest = hash_bytes(np.ascontiguousarray(obj.z).tobytes())[:12]
    return f"{files[0]} ({digest})" if files and files[0] else digest


def require_same_grid(a: HeightArithmetic, b: HeightArithmetic) -> None:
    """Refuse two maps or profiles whose samples do not lie at the same places, to 1 % of a step."""
    if a.z.shape != b.z.shape:
        raise DataError(
            f"the grids differ: {a.z.shape} and {b.z.shape} samples; resample one onto the other"
        )
    grids = (g._grid() for g in (a, b))  # noqa: SLF001  (of its own class)
    for (x, step), (other, other_step) in zip(*grids, strict=True):
        if math.isnan(step) != math.isnan(other_step):
            raise DataError("one of the two has no lateral step; give it with lateral_step")
        away = float(np.abs(x - other).max(initial=0.0))
        if away > _SAME * step:
            raise DataError(
                f"the grids differ by up to {away / step:.3g} steps; resample one onto the other"
            )

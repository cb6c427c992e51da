"""A form that the user writes as a formula."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.forms.base import RIGID, Shape, checked

# ---- formulas as text: parsed to a tree of allowed parts, evaluated with exact derivatives -----
# The text is never run as a program. Python's own parser makes a syntax tree, of which only numbers,
# known names, arithmetic and the functions below pass. Evaluation carries each value with its
# derivatives (dual numbers), so that these are exact to rounding.

Value = FloatArray | float
Tree = tuple[Any, ...]
"""("number", v), ("name", n), ("neg", a), ("+", a, b) ... or (function, a)."""
Dual = tuple[Value, dict[str, Value]]
"""A value and its derivatives by name; those that are missing are zero."""

LONGEST = 2000
"""Characters of a formula."""
MOST_PARTS = 500
"""Parts of a formula; each costs a pass over the points."""
DEEPEST = 100
"""Levels of brackets and operators."""

CONSTANTS = {"pi": math.pi}

_OPERATORS: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}

_FUNCTIONS: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "sin": (np.sin, lambda a, _: np.cos(a)),
    "cos": (np.cos, lambda a, _: -np.sin(a)),
    "tan": (np.tan, lambda a, _: 1.0 / np.cos(a) ** 2),
    "arcsin": (np.arcsin, lambda a, _: 1.0 / np.sqrt(1.0 - a * a)),
    "arccos": (np.arccos, lambda a, _: -1.0 / np.sqrt(1.0 - a * a)),
    "arctan": (np.arctan, lambda a, _: 1.0 / (1.0 + a * a)),
    "sinh": (np.sinh, lambda a, _: np.cosh(a)),
    "cosh": (np.cosh, lambda a, _: np.sinh(a)),
    "tanh": (np.tanh, lambda a, _: 1.0 / np.cosh(a) ** 2),
    "exp": (np.exp, lambda _, value: value),
    "log": (np.log, lambda a, _: 1.0 / a),
    "log10": (np.log10, lambda a, _: 1.0 / (a * math.log(10.0))),
    "sqrt": (np.sqrt, lambda _, value: 0.5 / value),
    "abs": (np.abs, lambda a, _: np.sign(a)),
}
"""Name, function, and derivative by argument and value."""

_ALIASES = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "ln": "log"}

FUNCTION_NAMES = frozenset({*_FUNCTIONS, *_ALIASES})


def parse(text: object, names: Iterable[str]) -> Tree:
    """Return the tree of a formula in the given names.

    Raises DataError, with what is wrong and where, for anything but allowed parts.
    """
    if not isinstance(text, str):
        raise DataError(f"a formula is text, got {type(text).__name__}")
    if len(text) > LONGEST:
        raise DataError(f"the formula has {len(text)} characters, more than {LONGEST}")
    if "^" in text:
        raise DataError("the formula has a '^': a power is written **, such as x**2")
    try:
        body = ast.parse(text.strip(), mode="eval").body
        n_parts = sum(1 for _ in ast.walk(body))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        where = getattr(error, "offset", None)
        at = f" at character {where}" if where else ""
        raise DataError(f"the formula cannot be read{at}: {_short(text)}") from error
    if n_parts > 3 * MOST_PARTS:  # the parser counts operators and contexts too
        raise DataError(f"the formula has more than {MOST_PARTS} parts; split it up")
    try:
        return _convert(body, frozenset(names))
    except RecursionError as error:  # while printing the part that is not allowed
        raise DataError("the formula is nested too deeply; split it up") from error


def names_in(tree: Tree) -> set[str]:
    """Return the names that occur in a tree."""
    if tree[0] == "name":
        return {tree[1]}
    if tree[0] == "number":
        return set()
    return set().union(*(names_in(t) for t in tree[1:]))


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _convert(node: ast.expr, names: frozenset[str], depth: int = 0) -> Tree:
    if depth > DEEPEST:
        raise DataError(f"the formula is nested deeper than {DEEPEST} levels; split it up")
    below = depth + 1
    match node:
        case ast.Constant(value=bool() | complex() | str() | bytes() | None):
            pass
        case ast.Constant(value=int() | float() as value):
            return ("number", _number(value))
        case ast.Name(id=name) if name in names:
            return ("name", name)
        case ast.Name(id=name) if name in CONSTANTS:
            return ("number", CONSTANTS[name])
        case ast.Name(id=name):
            raise DataError(
                f"the formula has the name {_short(name)}, which is neither a coordinate nor a "
                f"parameter; there are: {', '.join(sorted({*names, *CONSTANTS}))}"
            )
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return ("neg", _convert(operand, names, below))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _convert(operand, names, below)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return (
                _OPERATORS[type(op)],
                _convert(left, names, below),
                _convert(right, names, below),
            )
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
            known = _ALIASES.get(name, name)
            if known in _FUNCTIONS:
                return (known, _convert(argument, names, below))
        case _:
            pass
    raise DataError(
        f"the formula has {_short(ast.unparse(node))}, which is not allowed: numbers, names, "
        f"+ - * / **, brackets, and {', '.join(sorted(_FUNCTIONS))} of one argument"
    )


def _number(value: float) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise DataError("the formula has a number that is too large")
    return number


def evaluate(tree: Tree, names: Mapping[str, Dual]) -> Dual:
    """Return the value of a tree and its derivatives, of whatever the names carry.

    Warnings of numpy are the caller's to silence.
    """
    kind = tree[0]
    if kind == "number":
        return np.float64(tree[1]), {}
    if kind == "name":
        return names[tree[1]]
    a, da = evaluate(tree[1], names)
    if kind == "neg":
        return -a, {n: -d for n, d in da.items()}
    if kind in _FUNCTIONS:
        function, derivative = _FUNCTIONS[kind]
        value = function(a)
        return value, _times(derivative(a, value), da) if da else {}
    b, db = evaluate(tree[2], names)
    if kind in ("+", "-"):
        sign = 1.0 if kind == "+" else -1.0
        return a + sign * b, _sum(da, {n: sign * d for n, d in db.items()})
    if kind == "*":
        return a * b, _sum(_times(b, da), _times(a, db))
    if kind == "/":
        value = a / b
        return value, _sum({n: d / b for n, d in da.items()}, _times(-value / b, db) if db else {})
    return _power(a, da, b, db)


def _power(a: Value, da: dict[str, Value], b: Value, db: dict[str, Value]) -> Dual:
    is_square = np.ndim(b) == 0 and b == 2.0  # the usual one, and a product costs little
    value = a * a if is_square else np.power(a, b)
    found: dict[str, Value] = {}
    if da and is_square:
        found = _times(2.0 * a, da)
    elif da:
        # b a^(b-1), and 0 for b = 0 also where a = 0
        rate = np.where(np.equal(b, 0.0), 0.0, b * np.power(a, np.where(b == 0.0, 1.0, b - 1.0)))
        found = _times(rate, da)
    if db:
        # a^b log a, whose limit at a = 0 is 0 for b > 0
        rate = np.where((np.equal(a, 0.0)) & (np.greater(b, 0.0)), 0.0, value * np.log(a))
        found = _sum(found, _times(rate, db))
    return value, found


def _times(rate: Value, slopes: Mapping[str, Value]) -> dict[str, Value]:
    """Return derivatives times a rate; that of a coordinate by itself is the number 1."""
    return {n: rate if isinstance(d, float) and d == 1.0 else rate * d for n, d in slopes.items()}


def _sum(a: dict[str, Value], b: dict[str, Value]) -> dict[str, Value]:
    return {n: a[n] + b[n] if n in a and n in b else a.get(n, b.get(n, 0.0)) for n in {*a, *b}}


# ------------------------------------------------------------------------------------------------

_COORDINATES = ("x", "y", "r", "theta")
_RESERVED = {*_COORDINATES, *CONSTANTS, *FUNCTION_NAMES, *RIGID}


@dataclass(frozen=True, init=False, repr=False)
class Expression(Shape):
    """A form ``z = f(x, y)`` given as text, with named parameters.

    Parameters
    ----------
    text : str
        Formula in ``x``, ``y``, ``r = sqrt(x^2 + y^2)``, ``theta = atan2(y, x)``, ``pi`` and the
        parameters, with ``+ - * / **``, brackets and the functions sin, cos, tan, arcsin, arccos,
        arctan, sinh, cosh, tanh, exp, log, log10, sqrt, abs. At most 2000 characters.
    units : mapping of str to str, optional
        SI units of parameters, for reports; "" where not given.
    has_centre : bool, optional
        Whether x and y count from the middle of what was measured, on a map that declares no
        origin.
    **parameters : float or None
        Values by name, SI; None where not known: a fit then needs a starting value.

    Raises
    ------
    DataError
        If the text is not such a formula, names something else, or does not hold a parameter; if a
        parameter has a reserved name or is not finite.

    Notes
    -----
    The text is parsed, never run. Gradient and parameter derivatives are exact: each part of the
    formula carries its own (forward-mode differentiation). A point where the formula has no finite
    value is outside the domain, NaN. The slopes of r and theta at the centre, where they have
    none, count as 0, which is right for every smooth form such as ``r**3`` and ``r**2 * cos(2 *
    theta)``.

    Examples
    --------
    >>> form = Expression("a*x**2 + b*sin(2*pi*y/L)", a=1.0, b=1e-7, L=1e-3)
    >>> form(2e-3, 0.0).item()
    4e-06
    >>> form.parameters
    {'a': 1.0, 'b': 1e-07, 'L': 0.001}
    """

    text: str
    values: tuple[tuple[str, float | None], ...]
    unit_pairs: tuple[tuple[str, str], ...]
    has_centre: bool
    tree: Tree

    name = "expression"

    def __init__(
        self,
        text: str,
        /,
        *,
        units: Mapping[str, str] | None = None,
        has_centre: bool = True,
        **parameters: float | None,
    ) -> None:
        reserved = sorted(_RESERVED & parameters.keys())
        if reserved:
            raise DataError(
                f"{', '.join(reserved)} cannot name a parameter: a formula or a fit uses it itself"
            )
        tree = parse(text, (*_COORDINATES, *parameters))
        idle = [n for n in parameters if n not in names_in(tree)]
        if idle:
            raise DataError(f"the formula does not hold the parameter {', '.join(idle)}")
        strange = sorted((units or {}).keys() - parameters.keys())
        if strange:
            raise DataError(f"units names {', '.join(strange)}, which is not a parameter")
        unit_of = {n: (units or {}).get(n, "") for n in parameters}
        self._set(
            text=text,
            values=tuple((n, checked(v, n)) for n, v in parameters.items()),
            unit_pairs=tuple(unit_of.items()),
            units=unit_of,
            has_centre=bool(has_centre),
            tree=tree,
        )

    @property
    def parameters(self) -> dict[str, float | None]:
        return dict(self.values)

    def with_parameters(self, **values: float) -> Self:
        self._check_names(values)
        now = self.parameters | values
        return type(self)(self.text, units=self.units, has_centre=self.has_centre, **now)

    def __repr__(self) -> str:
        inside = super().__repr__().partition("(")[2]
        return f"Expression({self.text!r}, {inside}".replace(", )", ")")

    def _evaluate(
        self, x: FloatArray, y: FloatArray, by: Collection[str]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return heights and their derivatives by coordinates or parameters."""
        numbers = self._known(*self.parameters)
        names: dict[str, Dual] = {
            n: (np.float64(v), {n: 1.0} if n in by else {})
            for n, v in zip(self.parameters, numbers, strict=True)
        }
        used = names_in(self.tree)
        names["x"] = (x, {"x": 1.0} if "x" in by else {})
        names["y"] = (y, {"y": 1.0} if "y" in by else {})
        if used & {"r", "theta"}:
            names |= _polar(x, y, with_slopes="x" in by, with_angle="theta" in used)
        with np.errstate(all="ignore"):
            value, slopes = evaluate(self.tree, names)
            known = np.isfinite(value) & np.isfinite(x)
            found = {n: _finite(slopes.get(n, 0.0), known) for n in by}
            return _finite(value, known), found

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._evaluate(x, y, ())[0]

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = self._evaluate(x, y, ("x", "y"))[1]
        return found["x"], found["y"]

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        found = self._evaluate(x, y, tuple(names))[1]
        return [found[n] for n in names]

    def expansion(
        self, x: FloatArray, y: FloatArray, names: Sequence[str], *, slopes: bool
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray] | None, list[FloatArray]]:
        if names:  # those of the rigid motion are taken from the slopes
            return super().expansion(x, y, names, slopes=slopes)
        height, found = self._evaluate(x, y, ("x", "y") if slopes else ())
        return height, (found["x"], found["y"]) if slopes else None, []


def _polar(
    x: FloatArray, y: FloatArray, *, with_slopes: bool, with_angle: bool
) -> dict[str, Dual]:
    r = np.hypot(x, y)
    of_r: dict[str, Value] = {}
    of_theta: dict[str, Value] = {}
    if with_slopes:
        safe = np.where(r == 0.0, 1.0, r)
        c, s = x / safe, y / safe
        of_r = {"x": c, "y": s}
        of_theta = {"x": -s / safe, "y": c / safe} if with_angle else {}
    found: dict[str, Dual] = {"r": (r, of_r)}
    return found | {"theta": (np.arctan2(y, x), of_theta)} if with_angle else found


def _finite(value: Value, known: NDArray[np.bool_]) -> FloatArray:
    """Return a full array, NaN where the value is not finite or nothing is known."""
    full = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), known.shape))
    full[~(np.isfinite(full) & known)] = np.nan
    return full

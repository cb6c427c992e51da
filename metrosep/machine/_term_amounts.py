"""How large each error term may be: magnitudes, means and covariance, from what a person writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.units import parse_quantity
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.gram import check_covariance
from metrosep.machine.sobol import DISTRIBUTIONS

__all__ = ["Shape", "TermAmounts", "amounts_of_set", "term_amounts", "term_unit"]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """How a term runs along its axis, in parts of its largest amount: of its value, or of its u."""

    errors: ErrorSet
    name: str
    of_u: bool
    scale: float

    def at(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Return the shape at axis positions."""
        if self.of_u:
            return np.asarray(self.errors.u_at(q)[self.name] / self.scale)
        return np.asarray(self.errors.at(q, names=(self.name,))[self.name] / self.scale)


@dataclass(frozen=True, slots=True, eq=False)
class TermAmounts:
    """Terms with magnitudes (m,), means (m,) and covariance (m, m), in SI; shapes of functions.

    `typed` holds each magnitude as a person wrote it, empty where it was a number.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    magnitudes: FloatArray
    mean: FloatArray
    covariance: FloatArray
    shapes: Mapping[str, Shape] = field(default_factory=dict)
    typed: tuple[str, ...] = ()


def term_unit(chain: Any, term: str) -> str:
    """Return "rad" for an angular term of a chain, "m" for another."""
    for element in chain.elements:
        if term in element.location_errors:
            return "rad" if any(element.location_errors[term][3:]) else "m"
    return "rad" if term[1:2] in ("A", "B", "C") else "m"


def term_amounts(
    chain: Any,
    errors: Any,
    *,
    mean: Mapping[str, float | str] | None = None,
    correlations: Mapping[tuple[str, str], float] | ArrayLike | None = None,
    distribution: str = "normal",
) -> TermAmounts:
    """Return checked amounts of the terms named in `errors`, in its order."""
    if distribution not in DISTRIBUTIONS:
        raise DataError(f"distribution is one of {', '.join(DISTRIBUTIONS)}, got {distribution!r}")
    if not isinstance(errors, Mapping):
        raise DataError(
            "errors maps terms to magnitudes in SI, such as {'EXX': 1e-6, 'B0Z': '0.001 deg'}; got "
            f"{type(errors).__name__}"
        )
    names = chain.known_terms(tuple(errors))
    if not names:
        raise DataError(f"errors names no term; known are {', '.join(chain.terms)}")
    units = tuple(term_unit(chain, n) for n in names)
    size = np.array([_amount(errors[n], u, n) for n, u in zip(names, units, strict=True)])
    if (size < 0.0).any():
        k = int(np.argmax(size < 0.0))
        raise InvalidSamplesError(f"the magnitude of {names[k]} is {size[k]}, below zero")
    known = {} if mean is None else mean
    extra = [n for n in known if n not in names]
    if extra:
        raise DataError(f"mean names {', '.join(map(str, extra))}, which errors does not")
    middle = np.array(
        [_amount(known.get(n, 0.0), u, n) for n, u in zip(names, units, strict=True)]
    )
    sd = size * DISTRIBUTIONS[distribution]
    covariance = check_covariance(
        _correlation_matrix(correlations, names) * np.outer(sd, sd), len(names)
    )
    for array in (size, middle, covariance):
        array.setflags(write=False)
    typed = tuple(v.strip() if isinstance(v := errors[n], str) else "" for n in names)
    return TermAmounts(names, units, size, middle, covariance, typed=typed)


def amounts_of_set(chain: Any, errors: ErrorSet, q: Mapping[str, FloatArray]) -> TermAmounts:
    """Return the amounts of an error set on a part that is cut at axis positions q.

    The magnitude of a term is the root of its expected square, ``sqrt(value^2 + u^2)``. A term that
    depends on its position keeps its shape, and its uncertainty is taken to have the same shape.
    """
    names = chain.known_terms(errors.names)
    if not names:
        raise DataError(f"errors names no term; known are {', '.join(chain.terms)}")
    value, u = errors.at(q), errors.u_at(q)
    shapes: dict[str, Shape] = {}
    mean, sd = np.zeros(len(names)), np.zeros(len(names))
    for k, n in enumerate(names):
        top, top_u = (float(np.abs(v).max(initial=0.0)) for v in (value[n], u[n]))
        if value[n].ndim or u[n].ndim:
            shapes[n] = Shape(errors, n, top == 0.0, (top or top_u) or 1.0)
            mean[k] = top
            rms, rms_u = (float(np.sqrt(np.mean(v**2))) for v in (value[n], u[n]))
            sd[k] = rms_u * (top / rms if rms > 0.0 else top_u / rms_u if rms_u > 0.0 else 0.0)
        else:
            mean[k], sd[k] = float(value[n]), float(u[n])
    covariance = check_covariance(errors.correlation(names) * np.outer(sd, sd), len(names))
    size = np.sqrt(mean**2 + sd**2)
    for array in (size, mean, covariance):
        array.setflags(write=False)
    units = tuple(term_unit(chain, n) for n in names)
    return TermAmounts(names, units, size, mean, covariance, shapes)


def _amount(value: float | str, unit: str, name: str) -> float:
    if isinstance(value, str):
        return parse_quantity(value, dimension="length" if unit == "m" else "angle", name=name)
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise InvalidSamplesError(f"{name} is {value!r}; give a finite number in {unit}")
    return number


def _correlation_matrix(
    correlations: Mapping[Any, float] | ArrayLike | None, names: tuple[str, ...]
) -> FloatArray:
    n = len(names)
    if correlations is None:
        return np.eye(n)
    if isinstance(correlations, Mapping):
        matrix = np.eye(n)
        for pair, value in correlations.items():
            if not (len(pair) == 2 and len(set(pair)) == 2 and set(pair) <= set(names)):
                raise DataError(f"correlations names pairs of the terms in errors, got {pair!r}")
            i, j = (names.index(p) for p in pair)
            matrix[i, j] = matrix[j, i] = _amount(value, "1", f"correlation of {pair}")
    else:
        matrix = np.asarray(correlations, dtype=np.float64)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all() or (np.diag(matrix) != 1.0).any():
        raise InvalidSamplesError(
            f"correlations must be a finite {n} x {n} matrix with ones on its diagonal, got shape "
            f"{matrix.shape}"
        )
    if np.abs(matrix).max() > 1.0:
        raise InvalidSamplesError(f"a correlation of {np.abs(matrix).max()} is beyond 1")
    return matrix

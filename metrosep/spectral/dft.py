"""Fourier coefficients at exact wavelengths on positions that need not be uniform.

Runs at different feedrates have different sample pitches; an FFT index would mean another
wavelength in each of them. Here the wavelength is given and the sum runs over the positions.
Convention: ``e(x) = sum a_k cos(2 pi k (x - x0)/l) + b_k sin(...)``, eq. 4 of motion-error-fourier.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import positive
from metrosep.core.units import format_ends, format_length

_FEW_HARMONICS = 16
"""Below it each cosine is worked out by itself."""
_MAX_CELLS = 4_000_000
"""Cells of the basis held at a time, 32 MB."""


def fourier_basis(x: ArrayLike, *, origin: float, period: float, n_harmonics: int) -> FloatArray:
    """Return cosines, then sines, of the harmonics 1 ... K at the positions.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Positions.
    origin : float, m
        Position of zero phase.
    period : float, m
        Longest wavelength, > 0.
    n_harmonics : int
        K, >= 0.

    Returns
    -------
    ndarray, shape (n, 2 K)
        ``cos(2 pi k (x - origin)/period)`` for k = 1 ... K, then the sines.

    Notes
    -----
    Of many harmonics each is the product of a coarse and a fine one, ``k = q m + j``: a square
    root as many cosines, and equal to 1e-12.
    """
    phase = (2.0 * np.pi / period) * (np.asarray(x, dtype=np.float64) - origin)
    if n_harmonics < _FEW_HARMONICS:
        turns = np.outer(phase, np.arange(1, n_harmonics + 1))
        return np.hstack([np.cos(turns), np.sin(turns)])
    q = math.isqrt(n_harmonics)
    m = -(-n_harmonics // q)
    fine = np.exp(1j * np.outer(phase, np.arange(1, q + 1)))
    coarse = np.exp(1j * np.outer(phase, q * np.arange(m)))
    waves = (coarse[:, :, None] * fine[:, None, :]).reshape(phase.size, m * q)[:, :n_harmonics]
    return np.hstack([waves.real, waves.imag])


def _row_blocks(n_rows: int, n_harmonics: int) -> list[slice]:
    size = max(1, _MAX_CELLS // max(2 * n_harmonics, 1))
    return [slice(first, first + size) for first in range(0, n_rows, size)]


def fourier_sum(
    x: ArrayLike, coefficients: ArrayLike, *, origin: float, period: float
) -> FloatArray:
    """Return the Fourier series at positions, in bounded memory.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Positions.
    coefficients : array_like, shape (2 K,)
        Cosine, then sine coefficients of the harmonics 1 ... K.
    origin, period : float, m
        As for `fourier_basis`.

    Returns
    -------
    ndarray, shape (n,)
        ``sum a_k cos + b_k sin``, unit of the coefficients.
    """
    xs = np.asarray(x, dtype=np.float64)
    both = np.asarray(coefficients, dtype=np.float64)
    k = both.size // 2
    total = np.empty(xs.size)
    for part in _row_blocks(xs.size, k):
        total[part] = fourier_basis(xs[part], origin=origin, period=period, n_harmonics=k) @ both
    return total


def fourier_coefficients(
    x: ArrayLike,
    z: ArrayLike,
    *,
    origin: float,
    period: float,
    n_harmonics: int,
    weights: ArrayLike | None = None,
) -> NDArray[np.complex128]:
    """Return ``a_k + i b_k`` of weighted data by direct summation at exact wavelengths.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Positions, monotonic, covering the period.
    z : array_like, shape (n,), m
        Heights without NaN.
    origin : float, m
        Position of zero phase.
    period : float, m
        Length l of the modelling; harmonic k has the wavelength l/k.
    n_harmonics : int
        K, >= 1.
    weights : array_like, shape (n,), optional
        Taper; 1 if omitted. It is not divided out.

    Returns
    -------
    ndarray of complex, shape (K,), m
        ``a_k = (2/l) sum f z cos dx`` and likewise b_k, with dx the local pitch.

    Raises
    ------
    DataError
        If a height is NaN or there are fewer than three samples.

    Notes
    -----
    On a uniform grid that fills the period these are the coefficients of the discrete Fourier
    transform. Cost O(n K).
    """
    xs = np.asarray(x, dtype=np.float64)
    zs = np.asarray(z, dtype=np.float64)
    if xs.size < 3:
        raise DataError(f"a Fourier sum needs at least 3 samples, got {xs.size}")
    if np.isnan(zs).any():
        raise DataError("a Fourier sum cannot hold NaN; drop the samples that were not measured")
    cell = np.abs(np.gradient(xs))
    cell /= cell.sum()
    weighted = zs * cell if weights is None else zs * cell * np.asarray(weights, dtype=np.float64)
    sums = np.zeros(2 * n_harmonics)
    for part in _row_blocks(xs.size, n_harmonics):
        basis = fourier_basis(xs[part], origin=origin, period=period, n_harmonics=n_harmonics)
        sums += 2.0 * (weighted[part] @ basis)
    return np.asarray(sums[:n_harmonics] + 1j * sums[n_harmonics:], dtype=np.complex128)


# ---- `Band`: the wavelengths between two limits ------------------------------------------------


@dataclass(frozen=True, slots=True)
class Band:
    """Wavelengths ``shortest <= wavelength <= longest``; an open side is None.

    Parameters
    ----------
    shortest, longest : float (m), str with unit or None, optional
        Limits, positive and finite, in this order.

    Raises
    ------
    DataError
        If a limit is not positive and finite, or they are not in order.

    Examples
    --------
    >>> Band(2.5e-6, 0.8e-3)
    Band(2.5 um ... 800 um)
    >>> Band(shortest=2.5e-6)
    Band(2.5 um ... )
    """

    shortest: float | None = None
    longest: float | None = None

    def __post_init__(self) -> None:
        for name in ("shortest", "longest"):
            value = getattr(self, name)
            if value is None:
                continue
            number = positive(value, f"the {name} wavelength of a band", dimension="length")
            object.__setattr__(self, name, number)
        if (
            self.shortest is not None
            and self.longest is not None
            and not self.shortest < self.longest
        ):
            raise DataError(
                f"a band runs from its shortest to its longest wavelength, got "
                f"{format_ends(self.shortest, self.longest, between=' to ')}"
            )

    def __repr__(self) -> str:
        low, high = ("" if v is None else format_length(v) for v in (self.shortest, self.longest))
        return f"Band({low} ... {high})"


# ---- private helpers: arguments of the wrong type become a `DataError` that names them ---------


def symbols(names: object) -> Sequence[str]:
    """Return symbols asked for by name: a sequence of texts, not one text."""
    if isinstance(names, str | bytes):
        raise DataError(f"names is a sequence of symbols, got the text {names!r}")
    try:
        found: tuple[object, ...] = tuple(names)  # type: ignore[arg-type]
    except TypeError:
        raise DataError(f"names is a sequence of symbols, got {names!r}") from None
    texts = [n for n in found if isinstance(n, str)]
    if len(texts) < len(found):
        wrong = next(n for n in found if not isinstance(n, str))
        raise DataError(f"names holds symbols as text, such as 'Ra', got {wrong!r}")
    return texts


def instance_of(obj: object, kinds: type | tuple[type, ...], what: str) -> None:
    """Refuse an object of another class, saying which one is needed."""
    allowed = kinds if isinstance(kinds, tuple) else (kinds,)
    if not isinstance(obj, allowed):
        names = " or ".join(k.__name__ for k in allowed)
        raise DataError(f"{what} needs a {names}, got {type(obj).__name__}")

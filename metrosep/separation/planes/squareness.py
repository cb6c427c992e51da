"""Squareness of three axes from the lengths of body and face diagonals.

Signs: ``a_xy > 0`` where the positive axes X and Y enclose less than 90 degrees: the angle is
``pi/2 - a_xy``, Y leans towards +X. A length error is actual minus nominal, so the diagonal
between both positive axes is then longer than nominal.

Names: ``"ppp"``, ``"npp"``, ``"pnp"``, ``"nnp"`` give the sign of travel along X, Y, Z; ``"0"``
stands for an axis that does not move: ``"pp0"``, ``"np0"`` in the XY face, ``"p0p"``, ``"n0p"``,
``"0pp"``, ``"0np"``. A diagonal and its reversal (``"nnp"``, ``"ppn"``) are the same.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError, UnitError
from metrosep.core.numbers import not_negative, positive, real
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._readings import real_numbers
from metrosep.separation.contract import StoredResult
from metrosep.separation.runs.base import ErrorEstimate

if TYPE_CHECKING:
    import pandas as pd

PAIRS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_SIGN = {"p": 1.0, "n": -1.0, "0": 0.0, "+": 1.0, "-": -1.0}
_TOO_LARGE = 1e-2
_ESTIMABLE = 1e-9
_REACH = 1e-3
"""Share of a diagonal that an estimate may fall short of it."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Squareness(StoredResult):
    """Squareness errors of the axis pairs and scale errors of the axes.

    Parameters
    ----------
    angles : mapping of str to Quantity
        ``"xy"``, ``"xz"``, ``"yz"`` in rad; NaN where the diagonals do not determine it.
    scales : mapping of str to Quantity
        ``"x"``, ``"y"``, ``"z"``: relative length errors; NaN where not determined.
    remainder : mapping of str to float
        What the first-order formula makes wrong in each angle, rad, from the errors found: the
        estimate minus the truth if the instrument measures the true distance of the end points.
    residuals : mapping of str to float
        Measured minus fitted length error in m; all zero where nothing is redundant.
    common : float, m
        Mean length error of the body diagonals, from the scales; NaN without all four.
    audit : mapping
        Sizes, names, redundancy; plain values.
    messages : tuple of str
        What is not seen, in plain words.
    """

    angles: Mapping[str, Quantity]
    scales: Mapping[str, Quantity]
    remainder: Mapping[str, float]
    residuals: Mapping[str, float]
    common: float
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    @property
    def a_xy(self) -> float:
        """Squareness error of X and Y in rad; the positive axes enclose pi/2 - a_xy."""
        return self.angles["xy"].value

    @property
    def a_xz(self) -> float:
        """Squareness error of X and Z in rad."""
        return self.angles["xz"].value

    @property
    def a_yz(self) -> float:
        """Squareness error of Y and Z in rad."""
        return self.angles["yz"].value

    def to_frame(self) -> pd.DataFrame:
        """Return a row per angle and scale: ``value_urad``, ``u_urad`` (scales: 1e-6)."""
        import pandas as pd

        rows = {**self.angles, **{f"scale_{k}": q for k, q in self.scales.items()}}
        data = {
            k: {"value_urad": q.value * 1e6, "u_urad": math.nan if q.u is None else q.u * 1e6}
            for k, q in rows.items()
        }
        return pd.DataFrame.from_dict(data, orient="index").rename_axis("name")

    def __repr__(self) -> str:
        return "Squareness(" + ", ".join(f"{k} {q}" for k, q in self.angles.items()) + ")"


def squareness_from_diagonals(
    lengths: Mapping[str, float | Quantity | ErrorEstimate],
    size: Sequence[float],
    *,
    u: float | Mapping[str, float] | None = None,
    covariance: ArrayLike | None = None,
) -> Squareness:
    """Return squareness errors from length errors of diagonals.

    Parameters
    ----------
    lengths : mapping of str to float, Quantity or ErrorEstimate, m
        Length error (actual minus nominal) of each diagonal by name, see the module. Of an estimate
        of the error along a diagonal it is the difference of its ends, slope included.
    size : sequence of 3 float, m
        Travel along X, Y and Z between the ends of the diagonals, > 0.
    u : float or mapping of str to float, m, optional
        Standard uncertainty of each length error, independent of one another; that of the quantities
        or estimates if omitted.
    covariance : array_like, shape (n, n), m^2, optional
        Instead of `u`, in the order of `lengths`: what errors of the instrument (wavelength, air, dead
        path) make common to several diagonals.

    Returns
    -------
    Squareness
        ``a_xy``, ``a_xz``, ``a_yz`` (rad), ``angles`` with u, ``scales``, ``remainder``.

    Raises
    ------
    NotSeparableError
        If no angle is determined by these diagonals.
    DataError
        If lengths is not a mapping, a name is not known, a diagonal is given twice, `size` is not three
        positive lengths, u is not a number, negative or lacks a diagonal, the covariance is not one or
        is given beside u, or an estimate does not reach from end to end.
    InvalidSamplesError
        If a length error is not a finite number.
    UnitError
        If a length error exceeds 1 % of its diagonal.

    Notes
    -----
    First order, signs s of the name, travels L, diagonal ``D = sqrt(sum s^2 L^2)``::

        dL = ( sum_i e_i s_i^2 L_i^2 + sum_ij a_ij s_i s_j L_i L_j ) / D

    Four body diagonals give ``a_xy = D / (4 X Y) (dL_ppp - dL_npp - dL_pnp + dL_nnp)`` and so on;
    two diagonals of a face give its angle alone. All that is given is solved by least squares with
    weights 1/u^2, or the inverse of the covariance C; with the solution ``H dL`` the covariance of
    angles and scales is ``H C H'``. Of an error common to all four body diagonals nothing is left in
    the angles; of errors opposite in ppp and npp more than of independent ones.

    Null space: body diagonals alone see the scale errors e only as one common length, which
    cancels in the angles; a common error of the instrument (wavelength, dead path) does the same.
    Angles that are not determined are NaN. Straightness, roll and pitch errors at the end points
    enter as if they were squareness.

    References
    ----------
    .. [1] ISO 230-6:2002 (diagonal displacement tests); formula derived, see the documentation.

    Examples
    --------
    >>> dl = {"ppp": 2e-6, "npp": -1e-6, "pnp": -1e-6, "nnp": 2e-6}
    >>> round(squareness_from_diagonals(dl, (1.0, 1.0, 1.0)).a_xy * 1e6, 4)
    2.5981
    """
    travel = checked_travel(size)
    given = _by_canonical_name(lengths)
    table = {name: _length(name, value, travel) for name, value in given.items()}
    signs = signs_of(table)
    dl = np.array(list(table.values()), dtype=np.float64)
    diagonal = np.sqrt((signs**2) @ travel**2)
    _check_lengths(list(table), dl, diagonal)
    design = design_of(signs, travel)
    if covariance is not None and u is not None:
        raise DataError("u and covariance state the same; give one of them")
    sd = _standard_uncertainties(_own_u(given, travel) if u is None else u, list(table))
    whole = None if sd is None else np.diag(sd**2)
    if covariance is not None:
        whole = _checked_covariance(covariance, list(table))
    weight = _whitener(whole, dl.size)
    inverse = np.linalg.pinv(weight @ design, rcond=1e-12) @ weight
    known = np.abs(inverse @ design - np.eye(6)).max(axis=1) < _ESTIMABLE
    if not known[:3].any():
        raise NotSeparableError(
            f"the diagonals {', '.join(table)} determine no squareness; measure the four body "
            "diagonals ppp, npp, pnp, nnp, or both diagonals of a face"
        )
    least = inverse @ dl
    values = np.where(known, least, np.nan)
    spread = None
    if whole is not None:
        spread = np.sqrt(np.maximum(np.diag(inverse @ whole @ inverse.T), 0.0))
    residuals = dl - design @ least
    found = _quantities(values, spread, known)
    return Squareness(
        angles=dict(zip(PAIRS, found[:3], strict=True)),
        scales=dict(zip("xyz", found[3:], strict=True)),
        remainder=_remainder(signs, travel, least, inverse, known),
        residuals=dict(zip(table, residuals.tolist(), strict=True)),
        common=_common(table),
        audit={
            "size_mm": [float(v) * 1e3 for v in travel],
            "diagonals": list(table),
            "redundancy": int(dl.size - np.linalg.matrix_rank(design)),
            "residual_rms_nm": float(np.sqrt(np.mean(residuals**2))) * 1e9,
        },
        messages=tuple(_messages(known, stated=whole is not None)),
    )


def checked_travel(size: Sequence[float]) -> FloatArray:
    """Return the travels as an array."""
    try:
        x, y, z = (positive(v, "size", dimension="length") for v in size)
    except (TypeError, ValueError, InvalidSamplesError):
        raise DataError(
            f"size must be three positive lengths (X, Y, Z) in m, got {size!r}"
        ) from None
    return np.array([x, y, z])


def canonical_name(name: str) -> tuple[str, bool]:
    """Return the name of a diagonal and whether it was given the other way round.

    Examples
    --------
    >>> canonical_name("ppn")
    ('nnp', True)
    """
    text = str(name).lower()
    if len(text) != 3 or set(text) - set(_SIGN) or text.count("0") > 1:
        raise DataError(
            f"{name!r} is not a diagonal; name the sign of travel along X, Y, Z, such as 'ppp', 'npp', "
            "or 'pp0' in a face"
        )
    text = text.replace("+", "p").replace("-", "n")
    moving = text.replace("0", "")
    if moving[-1] == "p":
        return text, False
    return text.translate(str.maketrans("pn", "np")), True


def _by_canonical_name(lengths: Mapping[str, Any]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    if not isinstance(lengths, Mapping):
        raise DataError(
            "pass the length errors as a mapping such as {'ppp': 2e-6, 'npp': -1e-6, ...}: the "
            f"names are needed, got a {type(lengths).__name__}"
        )
    for name, value in lengths.items():
        own, _ = canonical_name(name)
        if own in table:
            raise DataError(
                f"diagonal {own} is given twice ({name!r} is the same line); average them"
            )
        table[own] = value
    if not table:
        raise NotSeparableError("no diagonal was given")
    return table


def _length(name: str, value: Any, travel: FloatArray) -> float:
    """Return the length error of a diagonal, m."""
    if isinstance(value, ErrorEstimate):
        _check_reach(name, value, travel)
        ends = value.evaluate([value.start, value.stop])
        return float(ends[1] - ends[0] + value.slope.value * (value.stop - value.start))
    try:
        return float(getattr(value, "value", value))
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"the length error of {name} must be a number in m, got {value!r}"
        ) from None


def _check_reach(name: str, estimate: ErrorEstimate, travel: FloatArray) -> None:
    """Refuse an estimate that does not reach over its diagonal."""
    legs = signs_of([name])[0] * travel
    diagonal, reach = float(np.sqrt((legs**2).sum())), estimate.stop - estimate.start
    if abs(reach - diagonal) > _REACH * diagonal:
        raise DataError(
            f"the estimate of diagonal {name} reaches over {format_length(reach)}, the diagonal over "
            f"{format_length(diagonal)}: separate its runs over the whole diagonal (start, length)"
        )


def _own_u(given: Mapping[str, Any], travel: FloatArray) -> dict[str, float] | None:
    """Return the uncertainties that lengths bring themselves; None where one brings none."""
    found: dict[str, float] = {}
    for name, value in given.items():
        if isinstance(value, ErrorEstimate):
            if not value.has_covariance or value.slope.u is None:
                return None
            ends = float(value.u_of_difference([value.stop], value.start)[0])
            own: float | None = math.hypot(ends, value.slope.u * (value.stop - value.start))
        else:
            own = getattr(value, "u", None)
        if own is None or not math.isfinite(own):
            return None
        found[name] = own
    return found


def _checked_covariance(covariance: ArrayLike, names: list[str]) -> FloatArray:
    """Return a covariance of length errors as a symmetric array."""
    whole = np.asarray(real_numbers(covariance, "covariance"), dtype=np.float64)
    n = len(names)
    if whole.shape != (n, n) or not np.isfinite(whole).all():
        raise DataError(
            f"the covariance of {n} length errors is a finite array of shape ({n}, {n}) in m^2, in the order "
            f"{', '.join(names)}; got shape {whole.shape}"
        )
    size = float(np.abs(whole).max())
    if np.abs(whole - whole.T).max() > 1e-9 * size or (
        np.linalg.eigvalsh(whole)[0] < -1e-9 * size
    ):
        raise DataError(
            "the covariance of the length errors is not symmetric with variances >= 0 in every "
            "combination; check its order and its signs"
        )
    return np.asarray(0.5 * (whole + whole.T))


def _whitener(whole: FloatArray | None, n: int) -> FloatArray:
    """Return W with ``W C W' = 1``; a combination known exactly weighs 1e6 times the least known."""
    if whole is None or not whole.any():
        return np.eye(n)
    power, vectors = np.linalg.eigh(whole)
    root = np.sqrt(np.maximum(power, 1e-12 * power[-1]))
    return np.asarray((vectors / root) @ vectors.T)


def signs_of(names: Iterable[str]) -> FloatArray:
    """Return the signs of travel along X, Y, Z of diagonals, shape (n, 3)."""
    return np.array([[_SIGN[letter] for letter in name] for name in names])


def _check_lengths(names: list[str], dl: FloatArray, diagonal: FloatArray) -> None:
    for name, value, nominal in zip(names, dl, diagonal, strict=True):
        if not math.isfinite(value):
            raise InvalidSamplesError(
                f"the length error of {name} is {value}; leave the diagonal out or measure it again"
            )
        if abs(value) > _TOO_LARGE * nominal:
            raise UnitError(
                f"the length error of {name} is {value:.4g} m on {nominal:.4g} m; pass actual minus "
                "nominal in m, not the length itself and not um"
            )


def design_of(signs: FloatArray, travel: FloatArray) -> FloatArray:
    """Return what three angles and three scales make of the length of each diagonal."""
    legs = signs * travel
    diagonal = np.sqrt((legs**2).sum(axis=1))
    shear = np.column_stack([legs[:, i] * legs[:, j] for i, j in PAIRS.values()])
    return np.asarray(np.hstack([shear, legs**2]) / diagonal[:, None])


def _standard_uncertainties(
    u: float | Mapping[str, float] | None, names: list[str]
) -> FloatArray | None:
    if u is None:
        return None
    if isinstance(u, Mapping):
        own = {
            canonical_name(k)[0]: not_negative(v, f"u of {k}", dimension="length")
            for k, v in u.items()
        }
        missing = [n for n in names if n not in own]
        if missing:
            raise DataError(f"u lacks the diagonal {missing[0]}")
        return np.array([own[n] for n in names])
    one = real(u, "u", dimension="length", what="a number or a mapping of names to numbers")
    return np.full(len(names), not_negative(one, "u", dimension="length"))


def _quantities(
    values: FloatArray, spread: FloatArray | None, known: NDArray[np.bool_]
) -> list[Quantity]:
    """Return the angles of the pairs and the scales of the axes."""
    said = [
        (
            "rad",
            f"squareness error of {x} and {y}: pi/2 minus the angle between the positive axes",
            f"a_{x}{y}".lower(),
        )
        for x, y in ("XY", "XZ", "YZ")
    ]
    said += [("1", f"relative length error of {axis.upper()}", f"e_{axis}") for axis in "xyz"]
    sd = np.full(6, np.nan) if spread is None else np.where(known, spread, np.nan)
    return [
        Quantity(float(value), unit, text, u=None if math.isnan(u) else float(u), symbol=symbol)
        for value, u, (unit, text, symbol) in zip(values, sd, said, strict=True)
    ]


def _remainder(
    signs: FloatArray,
    travel: FloatArray,
    least: FloatArray,
    inverse: FloatArray,
    known: NDArray[np.bool_],
) -> dict[str, float]:
    """Return what the exact distance of end points would add to each angle."""
    shear = np.diag(1.0 + least[3:])
    for value, (i, j) in zip(least[:3], PAIRS.values(), strict=True):
        shear[i, j] += value
    # Y and Z both lean towards X, so part of the angle between them is already there.
    shear[1, 2] -= shear[0, 1] * shear[0, 2]
    legs = signs * travel
    # Axis j leans towards axis i by a, so it loses its own length with the cosine.
    for j in (1, 2):
        lean = sum(shear[i, j] ** 2 for i in range(j))
        shear[j, j] -= lean / 2.0
    exact = np.sqrt(((legs @ shear.T) ** 2).sum(axis=1)) - np.sqrt((legs**2).sum(axis=1))
    second = inverse @ (exact - design_of(signs, travel) @ least)
    return {p: float(second[i]) if known[i] else math.nan for i, p in enumerate(PAIRS)}


def _common(table: Mapping[str, float]) -> float:
    body = ["".join(s) + "p" for s in itertools.product("pn", repeat=2)]
    return float(np.mean([table[b] for b in body])) if set(body) <= set(table) else math.nan


def _messages(known: NDArray[np.bool_], *, stated: bool) -> list[str]:
    messages = []
    lost = [p for p, k in zip(PAIRS, known[:3], strict=True) if not k]
    if lost:
        messages.append(f"{', '.join(lost)} not determined by these diagonals: NaN")
    if not known[3:].all():
        messages.append(
            "scale errors of the single axes are not seen, only what they add to the diagonals; in "
            "the angles they cancel"
        )
    if not stated:
        messages.append("no standard uncertainty: pass u= of a length error")
    messages.append("straightness and angular errors at the end points count as squareness")
    return messages

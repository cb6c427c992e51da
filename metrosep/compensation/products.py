"""A map as two tables of one axis each, for controllers that know no map: f(x) g(y) or f(x) + g(y).

SINUMERIK multiplies two sag tables, most controllers sum several tables of one output. Both forms
are bilinear between the nodes exactly as the map is, so what is lost is lost at the nodes alone:
the residual is reported there. A product is not zero at the reference of the map as the map is: the
constant by which it differs there is free, moves the zero of the machine, and is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import AreaSource
from metrosep.compensation.limits import Stated
from metrosep.compensation.map_verify import MapVerification
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, TableError
from metrosep.core.provenance import Step
from metrosep.core.units import format_length

Form = Literal["product", "sum"]

_ZERO = 1e-18
"""An attometre: a map below it is zero."""

_ROUNDING = 1e-12
"""Of the largest correction: what the tables add at the reference below it is rounding."""

_LITTLE = 1e-12
"""A picometre of RMS: what saves less is not worth a shift of the zero."""

_MOST_CONSTANT, _SCANNED, _REFINED = 20.0, 161, 5
"""Largest constant in largest corrections; constants that are tried; valleys that are refined."""

_CONVENTIONS = {
    "product": (
        "c(x, y) = first(x) * second(y); first in m carries the sign of the correction, second is a "
        "factor without unit whose largest absolute entry is +1: a dialect that negates entries "
        "negates first only"
    ),
    "sum": (
        "c(x, y) = first(x) + second(y), both corrections in m, both zero at the reference: a "
        "dialect that negates entries negates both"
    ),
}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ProductTables(Stated):
    """Two tables that stand for a map, and what they leave of it.

    Parameters
    ----------
    form : {"product", "sum"}
        How the controller joins them.
    first : CompensationTable
        Over the first axis of the map (columns), corrections in m.
    second : CompensationTable
        Over the second axis (rows): a factor without unit, at most 1, for "product"; corrections in
        m for "sum".
    residual : ndarray, shape (m, n), m
        Map plus `constant` minus tables at the nodes.
    residual_pv, residual_rms : float, m
        Its P-V, and its RMS about zero.
    share : float, dimensionless
        RMS of the residual over the RMS of the map, both about zero.
    at_reference : float, m
        What the tables add at the reference of the map; the zero of the machine moves by it.
    singular_values : ndarray, m
        Of the map plus `constant`, falling; ``share`` of the product is that of all but the first.
    map : CompensationMap
        What they stand for.
    constant : float, m
        What the tables add everywhere beside the map; 0 for a sum.

    Notes
    -----
    The tables of a product bear no uncertainty: that of a factor without unit is not one of a
    correction. Take that of the map.
    """

    form: Form
    first: CompensationTable
    second: CompensationTable
    residual: FloatArray
    residual_pv: float
    residual_rms: float
    share: float
    at_reference: float
    singular_values: FloatArray
    map: CompensationMap
    constant: float = 0.0

    def __repr__(self) -> str:
        sign = "*" if self.form == "product" else "+"
        return (
            f"ProductTables({self.first.axis} {sign} {self.second.axis} -> {self.first.compensates}, "
            f"{100.0 * self.share:.3g} % of the RMS left)"
        )

    @property
    def convention(self) -> str:
        """How the entries of the two tables make the correction, in words."""
        return _CONVENTIONS[self.form]

    @property
    def messages(self) -> tuple[str, ...]:
        """What a user must know before the tables are loaded."""
        left = (
            f"{self.form} of two tables: {100.0 * self.share:.3g} % of the map's RMS stay, P-V "
            f"{format_length(self.residual_pv, digits=3)}, RMS "
            f"{format_length(self.residual_rms, digits=3)}"
        )
        said = [left]
        if self.at_reference != 0.0:
            said.append(
                f"the zero of the machine moves by {format_length(self.at_reference, digits=3)}, which "
                "the tables add at the reference: set the zero with the tables active"
            )
        return tuple(said)

    def correction(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return the correction as the controller would join the two tables.

        Parameters
        ----------
        x, y : array_like, m or rad
            Commanded positions; they broadcast.

        Returns
        -------
        ndarray, m
            Linear between entries of either table, constant outside.

        Raises
        ------
        DataError
            If the positions do not broadcast.
        """
        one, two = self.first.correction(x), self.second.correction(y)
        one, two = one.reshape(np.shape(x) or (1,)), two.reshape(np.shape(y) or (1,))
        try:
            return np.asarray(one * two if self.form == "product" else one + two)
        except ValueError:
            raise DataError(
                f"positions of shapes {np.shape(x)} and {np.shape(y)} do not broadcast; give y as a "
                "column (y[:, None]) for a grid"
            ) from None

    def as_map(self) -> CompensationMap:
        """Return the two tables as one map.

        Returns
        -------
        CompensationMap
            What the tables add at every node: map plus constant minus residual.
        """
        return replace(
            self.map,
            values=self.map.values + self.constant - self.residual,
            history=(
                *self.map.history,
                Step("rank_one", {"form": self.form, "share": self.share}),
            ),
        )

    def verify(self, against: AreaSource | None = None) -> MapVerification:
        """Return the dry-run of the two tables, and refuse if the error does not shrink.

        Parameters
        ----------
        against : Surface, ErrorMap or callable e(x, y), optional
            Measured error in m; that of the map's `source` if omitted.

        Returns
        -------
        MapVerification
            P-V and RMS before, after and with the sign reversed.

        Raises
        ------
        SignCheckFailedError
            If P-V or RMS does not shrink: the map is not a product (sum) of two tables.
        TableError
            If map and measurement do not overlap, or there is nothing to verify against.
        DataError
            If nothing was measured inside the map.
        """
        # a product cannot be zero at the reference: what it adds there is in `messages`
        return self.as_map().verify(against, free_zero=True)

    def to_dict(self) -> dict[str, Any]:
        second = self.second.to_dict()
        if self.form == "product":
            second["factor"] = second.pop("forward_m")
            second = {k: second[k] for k in ("axis", "compensates", "positions_m", "factor")}
        return {
            "form": self.form,
            "convention": self.convention,
            "first": self.first.to_dict(),
            "second": second,
            "residual_pv_m": self.residual_pv,
            "residual_rms_m": self.residual_rms,
            "residual_share": self.share,
            "at_reference_m": self.at_reference,
            "constant_m": self.constant,
            "singular_values_m": self.singular_values.tolist(),
            "messages": list(self.messages),
        }


def rank_one(
    corrections: CompensationMap, *, form: Form = "product", keep_zero: bool = False
) -> ProductTables:
    """Return two tables of one axis each that come closest to a map.

    Parameters
    ----------
    corrections : CompensationMap
        Map, shape (m, n).
    form : {"product", "sum"}, optional
        "product" for ``f(x) g(y)``, "sum" for ``f(x) + g(y)``.
    keep_zero : bool, optional
        Add no constant to the map of a product: more stays, the zero of the machine moves less.

    Returns
    -------
    ProductTables
        The tables with their residual.

    Raises
    ------
    DataError
        If `corrections` is not a map or `form` is unknown.
    TableError
        If the map is zero everywhere.

    Notes
    -----
    Least squares over the nodes, each with the same weight. Product: the first singular pair of the
    map plus a constant k, ``c + k = sum s_k v_k(x) w_k(y)`` (Eckart and Young); k is where the sum of
    the other ``s_k^2`` is smallest, at most 20 times the largest correction: for a map f(x) + g(y) it
    would fall forever. Its gauge ``f -> a f, g -> g / a`` is fixed by ``max |g| = 1`` with the plus
    sign at the first such entry. Sum: the gauge ``f + a, g - a`` is fixed by ``f = g = 0`` at the
    reference, exactly, under which the least squares are done.

    References
    ----------
    .. [1] controllers notes, section 3.4: ``$AN_CEC_MULT_BY_TABLE``.

    Examples
    --------
    >>> import numpy as np
    >>> x, y = np.linspace(0, 0.1, 5), np.linspace(0, 0.2, 3)
    >>> twist = CompensationMap.from_error(lambda x, y: 1e-4 * x * y, x=x, y=y)
    >>> tables = rank_one(twist)
    >>> round(tables.share, 12), (tables.second.forward.round(12) + 0.0).tolist()
    (0.0, [0.0, 0.5, 1.0])
    """
    if not isinstance(corrections, CompensationMap):
        raise DataError(f"tables are made of a CompensationMap, got {type(corrections).__name__}")
    if form not in _CONVENTIONS:
        raise DataError(f"form={form!r}; use 'product' or 'sum'")
    values = corrections.values
    scale = float(np.abs(values).max())
    if scale < _ZERO:
        raise TableError("the map is zero everywhere: there is nothing to make tables of")
    with one_blas_thread():
        free = form == "product" and not keep_zero
        constant = scale * _constant(values / scale, _LITTLE / scale) if free else 0.0
        values = values + constant
        rows, sizes, columns = np.linalg.svd(values / scale, full_matrices=False)
        if form == "product":
            f, g = _gauged(scale * sizes[0] * columns[0], rows[:, 0])
            model = g[:, None] * f
        else:
            f, g = _sum_tables(corrections)
            model = g[:, None] + f
    residual = values - model
    residual.setflags(write=False)
    sizes = scale * sizes
    sizes.setflags(write=False)
    first, second = _tables(corrections, f + 0.0, g + 0.0, form)  # no -0.0
    one, two = (
        float(t.correction(r)[0])
        for t, r in zip((first, second), corrections.reference, strict=True)
    )
    at_zero = one * two if form == "product" else one + two
    rms = float(np.sqrt(np.mean(residual**2)))
    return ProductTables(
        form=form,
        first=first,
        second=second,
        residual=residual,
        residual_pv=float(np.ptp(residual)),
        residual_rms=rms,
        share=rms / float(np.sqrt(np.mean(corrections.values**2))),
        at_reference=at_zero if abs(at_zero) > _ROUNDING * scale else 0.0,
        singular_values=sizes,
        map=corrections,
        constant=constant,
    )


def _constant(values: FloatArray, little: float) -> float:
    """Return the constant with which a map of largest value 1 comes closest to a product.

    What is left has several minima: the best five brackets of a scan are refined. No constant where
    it saves no more than `little` of the RMS.
    """
    from scipy.optimize import minimize_scalar

    def left(k: float) -> float:
        return float((np.linalg.svd(values + k, compute_uv=False)[1:] ** 2).sum())

    if min(values.shape) < 2:
        return 0.0
    scan = _MOST_CONSTANT * np.sinh(6.0 * np.linspace(-1.0, 1.0, _SCANNED)) / np.sinh(6.0)
    rest = np.array([left(k) for k in scan])
    inner = np.arange(1, _SCANNED - 1)
    valleys = inner[(rest[1:-1] <= rest[:-2]) & (rest[1:-1] <= rest[2:])]
    best = valleys[np.argsort(rest[valleys], kind="stable")[:_REFINED]]
    found = [
        minimize_scalar(
            left, bounds=(scan[i - 1], scan[i + 1]), method="bounded", options={"xatol": _ROUNDING}
        ).x
        for i in best
    ]
    ends = [float(scan[i]) for i in (0, -1)]
    k = min((*map(float, found), *ends), key=left)
    saved = np.sqrt(left(0.0) / values.size) - np.sqrt(left(k) / values.size)
    return k if saved > little else 0.0


def _gauged(f: FloatArray, g: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Scale the pair to ``max |g| = 1``, plus at the largest entry."""
    largest = np.abs(g).max()
    peak = g[np.flatnonzero(np.abs(g) >= largest * (1.0 - 1e-9))[0]]
    return f * peak, g / peak


def _sum_tables(corrections: CompensationMap) -> tuple[FloatArray, FloatArray]:
    """Solve the least squares of f(x) + g(y) under f(x0) = g(y0) = 0 with multipliers."""
    m, n = corrections.values.shape
    matrix = np.zeros((n + m + 2, n + m + 2))
    matrix[:n, :n] = m * np.eye(n)
    matrix[n : n + m, n : n + m] = n * np.eye(m)
    matrix[:n, n : n + m] = 1.0
    matrix[n : n + m, :n] = 1.0
    matrix[n + m, :n] = _weights(corrections.x, corrections.reference[0])
    matrix[n + m + 1, n : n + m] = _weights(corrections.y, corrections.reference[1])
    matrix[:, n + m :] = matrix[n + m :].T
    sums = np.concatenate([corrections.values.sum(axis=0), corrections.values.sum(axis=1), [0, 0]])
    solved = np.linalg.solve(matrix, sums)
    f, g = solved[:n], solved[n : n + m]
    f[corrections.x == corrections.reference[0]] = 0.0
    g[corrections.y == corrections.reference[1]] = 0.0
    return f, g


def _weights(positions: FloatArray, at: float) -> FloatArray:
    """Return how linear interpolation at a place weighs the entries."""
    return np.array([np.interp(at, positions, unit) for unit in np.eye(positions.size)])


def _tables(
    corrections: CompensationMap, f: FloatArray, g: FloatArray, form: str
) -> tuple[CompensationTable, CompensationTable]:
    made = []
    for k, (positions, entries) in enumerate([(corrections.x, f), (corrections.y, g)]):
        step = Step("rank_one", {"form": form, "part": ("first", "second")[k]})
        made.append(
            CompensationTable(
                positions=positions,
                forward=entries,
                reverse=None,
                axis=corrections.axes[k],
                compensates=corrections.compensates,
                reference=corrections.reference[k],
                is_exact_inverse=corrections.is_exact_inverse,
                source_sha256=corrections.source_sha256,
                history=(*corrections.history, step),
            )
        )
    return made[0], made[1]

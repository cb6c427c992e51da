"""Drift and the repeated quantities from one least-squares fit.

``r_i = q[label_i] + d(t_i) + noise``; d is a polynomial or a cubic spline that is zero at the
reference time, so q is the quantity as it would have been read then.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.separation._checked_numbers import (
    checked_count,
    checked_number,
    checked_sd,
)
from metrosep.separation._result_values import plain, reduced

__all__ = ["JointDrift", "joint_drift"]


_WORST_CONDITION = 1e8


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointDrift:
    """Quantities free of drift, and the drift.

    Parameters
    ----------
    labels : tuple
        Names of the quantities, in the order in which they first occur.
    values : ndarray, shape (labels, ...)
        Quantity at the reference time; NaN where it was never measured.
    u : ndarray, shape (labels, ...)
        Standard uncertainty of `values`.
    covariance : ndarray, shape (labels, labels)
        Of `values` for noise of unit standard deviation; differences need it, since all values
        share the drift. NaN for a label that was never measured. Where the gaps differ from point
        to point: that of readings without gaps.
    t : ndarray, shape (n,), s
        Times of the readings.
    drift : ndarray, shape (n, ...)
        Drift at `t`, zero at the reference time.
    u_drift : ndarray, shape (n, ...)
        Its standard uncertainty.
    residual : ndarray, shape (n, ...)
        Reading minus fit, NaN where not measured.
    sd : ndarray, shape (...)
        Standard deviation of one reading: from the residuals, else the one given, else NaN.
    reference : float, s
        Where the drift is zero.
    audit : mapping
        Model, counts, degrees of freedom.
    messages : tuple of str
        What the user should know.
    covariances : ndarray, shape (patterns, labels, labels), optional
        `covariance` of each pattern of gaps that occurs; without it `covariance` holds everywhere.
    pattern : ndarray of int, shape (...), optional
        Which of `covariances` holds at each point.
    """

    labels: tuple[Hashable, ...]
    values: FloatArray
    u: FloatArray
    covariance: FloatArray
    t: FloatArray
    drift: FloatArray
    u_drift: FloatArray
    residual: FloatArray
    sd: FloatArray
    reference: float
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    covariances: FloatArray | None = None
    pattern: NDArray[np.intp] | None = None

    def difference(self, first: Hashable, second: Hashable) -> tuple[FloatArray, FloatArray]:
        """Return one quantity minus another with its standard uncertainty.

        Parameters
        ----------
        first, second : hashable
            Labels.

        Returns
        -------
        tuple of (ndarray, ndarray), shape (...)
            Difference and u; the common drift is in u.

        Raises
        ------
        DataError
            If a label does not occur.
        """
        try:
            i, j = self.labels.index(first), self.labels.index(second)
        except ValueError:
            raise DataError(
                f"labels are {', '.join(map(str, self.labels))}, not {first!r} and {second!r}"
            ) from None
        c = self.covariance[None] if self.covariances is None else self.covariances
        variance = np.maximum(c[:, i, i] + c[:, j, j] - 2.0 * c[:, i, j], 0.0)
        root = np.sqrt(variance)[0 if self.pattern is None else self.pattern]
        return self.values[i] - self.values[j], np.asarray(self.sd * root)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            ``values``, ``u`` and ``differences`` (against the first label, each with ``value`` and
            ``u``) by label, ``t``, ``drift``, ``u_drift``, ``residual``, ``sd``, ``reference``,
            ``covariance``, ``audit``, ``messages``.
        """
        names = [str(label) for label in self.labels]
        differences = {}
        for label in self.labels[1:]:
            value, u = self.difference(label, self.labels[0])
            differences[f"{label}-{self.labels[0]}"] = {"value": value, "u": u}
        found: dict[str, Any] = plain(
            {
                "labels": names,
                "values": dict(zip(names, self.values, strict=True)),
                "u": dict(zip(names, self.u, strict=True)),
                "differences": differences,
                "t": self.t,
                "drift": self.drift,
                "u_drift": self.u_drift,
                "residual": self.residual,
                "sd": self.sd,
                "reference": self.reference,
                "covariance": self.covariance,
                "audit": self.audit,
                "messages": self.messages,
            }
        )
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def __repr__(self) -> str:
        return (
            f"JointDrift({len(self.labels)} quantities, {self.t.size} readings, "
            f"{self.audit.get('model')})"
        )


def joint_drift(
    t: ArrayLike,
    readings: ArrayLike,
    labels: Sequence[Hashable] | None = None,
    *,
    degree: int = 1,
    n_pieces: int | None = None,
    reference: float | None = None,
    sd: float | None = None,
) -> JointDrift:
    """Return repeated quantities and the drift between them by least squares.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Times, strictly increasing.
    readings : array_like, shape (n, ...)
        Scalars, profiles or maps; each point has its own drift. NaN where not measured.
    labels : sequence, shape (n,), optional
        What was measured at each time, such as ``"ABBA"``; one and the same if omitted.
    degree : int, optional
        Of the polynomial drift, 0 to 8; not used with `n_pieces`.
    n_pieces : int, optional
        Cubic spline drift with so many equal pieces, instead of the polynomial.
    reference : float, s, optional
        Time at which the drift is zero; the first reading if omitted.
    sd : float, optional
        Standard deviation of one reading. Without it, from the residuals.

    Returns
    -------
    JointDrift
        ``values``, ``u``, ``drift``, ``u_drift``, ``residual``, ``difference(a, b)``.

    Raises
    ------
    NotSeparableError
        If drift and quantities cannot be told apart at these times and labels.
    TooFewSamplesError
        If there are fewer readings than unknowns.
    InvalidSamplesError
        If times do not increase, lengths differ, readings are no numbers or infinite, or labels
        are no names.
    DataError
        If degree, n_pieces, reference or sd is no number or out of range.

    Notes
    -----
    Ordinary least squares: for white normal noise it attains the Cramer-Rao bound. A-B-B-A at equal
    steps with degree 1 gives `abba`. Null space: the level, which is why d is zero at the
    reference; changes that follow the labels. Gaps: each point is fitted to what was measured there.

    References
    ----------
    .. [1] ISO 230-3:2020 (drift); Gauss-Markov theorem.

    Examples
    --------
    >>> fit = joint_drift([0.0, 1.0, 2.0, 3.0], [7.0, 3.1, 3.2, 7.3], "ABBA")
    >>> round(float(fit.difference("A", "B")[0]), 9)
    4.0
    """
    times = _checked_times(t)
    table = _checked_readings(readings)
    names = _checked_labels(labels, times.size)
    if not table.ndim or table.shape[0] != times.size or len(names) != times.size:
        raise InvalidSamplesError(
            f"t has {times.size} times, readings shape {table.shape}, labels {len(names)}: one "
            "reading and one label for each time"
        )
    if np.isinf(table).any():
        raise InvalidSamplesError("a reading is infinite; write NaN where nothing was measured")
    sd = checked_sd(sd)
    zero = float(times[0]) if reference is None else checked_number(reference, "reference")
    drift_design, model = _drift_design(times, zero, degree, n_pieces)
    known = tuple(dict.fromkeys(names))
    which = np.array([[name == k for k in known] for name in names], dtype=np.float64)
    design = np.hstack([which, drift_design])
    flat = table.reshape(times.size, -1)
    with one_blas_thread():
        parts = _solve(design, flat, len(known), sd)
    shape = table.shape[1:]
    return JointDrift(
        labels=known,
        values=parts["values"].reshape(len(known), *shape),
        u=parts["u"].reshape(len(known), *shape),
        covariance=(
            parts["covariances"][0]
            if parts["covariances"].shape[0] == 1
            else np.linalg.pinv(design.T @ design)[: len(known), : len(known)]
        ),
        t=times,
        drift=parts["drift"].reshape(table.shape),
        u_drift=parts["u_drift"].reshape(table.shape),
        residual=parts["residual"].reshape(table.shape),
        sd=parts["sd"].reshape(shape),
        reference=zero,
        audit=freeze_mapping(
            {
                "model": model,
                "n_readings": int(times.size),
                "n_unknowns": int(design.shape[1]),
                "reference_s": zero,
                "n_not_measured": int(np.count_nonzero(np.isnan(table))),
                "sd": "given" if sd is not None else "residuals",
            }
        ),
        messages=_messages(table, design, sd, parts),
        covariances=parts["covariances"],
        pattern=parts["pattern"].astype(np.intp).reshape(shape),
    )


def _checked_readings(readings: ArrayLike) -> FloatArray:
    try:
        return as_float(readings)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"readings must be numbers, or arrays of one shape, one for each time: {exc}"
        ) from None


def _checked_labels(labels: Sequence[Hashable] | None, n: int) -> list[Hashable]:
    if labels is None:
        return ["all"] * n
    try:
        names = list(labels)
        hash(tuple(names))
    except TypeError:
        raise InvalidSamplesError(
            "labels must be one name for each time, such as 'ABBA' or a list of names, got "
            f"{labels!r}"
        ) from None
    return names


def _checked_times(t: ArrayLike) -> FloatArray:
    times = frozen_float(t, name="t", ndim=1, min_size=2)
    if np.isnan(times).any() or (np.diff(times) <= 0.0).any():
        raise InvalidSamplesError("t must be finite and strictly increasing, in seconds")
    return times


def _drift_design(
    times: FloatArray, zero: float, degree: int, n_pieces: int | None
) -> tuple[FloatArray, str]:
    """Return columns of the drift, each zero at the reference time."""
    if not times[0] <= zero <= times[-1]:
        raise DataError(
            f"reference = {zero:g} s lies outside the readings, {times[0]:g} to {times[-1]:g} s"
        )
    both = np.append(times, zero)
    span = float(times[-1] - times[0])
    if n_pieces is None:
        degree = checked_count(degree, "degree")
        if degree > 8:
            raise DataError(f"degree of the drift is 0 to 8, got {degree}; use n_pieces for more")
        s = 2.0 * (both - times[0]) / span - 1.0
        columns = np.polynomial.legendre.legvander(s, degree)[:, 1:]
        name = f"polynomial of degree {degree}"
    else:
        from scipy.interpolate import BSpline

        n_pieces = checked_count(n_pieces, "n_pieces", low=1)
        inner = np.linspace(times[0], times[-1], n_pieces + 1)
        knots = np.concatenate([[times[0]] * 3, inner, [times[-1]] * 3])
        # The splines sum to one: without the first they hold no constant.
        columns = BSpline.design_matrix(both, knots, 3).toarray()[:, 1:]
        name = f"cubic spline of {n_pieces} pieces"
    return np.asarray(columns[:-1] - columns[-1]), name


def _solve(
    design: FloatArray, flat: FloatArray, n_labels: int, sd: float | None
) -> dict[str, FloatArray]:
    """Fit every column of readings to the rows that were measured."""
    n, p = design.shape
    points = flat.shape[1]
    out = {
        "values": np.full((n_labels, points), np.nan),
        "u": np.full((n_labels, points), np.nan),
        "drift": np.full((n, points), np.nan),
        "u_drift": np.full((n, points), np.nan),
        "residual": np.full((n, points), np.nan),
        "sd": np.full(points, np.nan),
    }
    valid = ~np.isnan(flat)
    if valid.all():
        patterns, member = np.ones((1, n), dtype=bool), np.zeros(points, dtype=np.intp)
    else:
        patterns, member = np.unique(valid.T, axis=0, return_inverse=True)
    out["pattern"] = np.asarray(member.ravel(), dtype=np.float64)
    out["covariances"] = np.full((patterns.shape[0], n_labels, n_labels), np.nan)
    solved = False
    for k, rows in enumerate(patterns):
        mine = np.flatnonzero(member.ravel() == k)
        seen = np.append(design[rows, :n_labels].any(axis=0), np.ones(p - n_labels, dtype=bool))
        part = design[np.ix_(rows, seen)]
        problem = _problem(part)
        if problem:
            if patterns.shape[0] == 1:
                raise problem
            continue
        solved = True
        inverse = np.linalg.pinv(part)
        found = inverse @ flat[np.ix_(rows, mine)]
        residual = flat[np.ix_(rows, mine)] - part @ found
        freedom = part.shape[0] - part.shape[1]
        spread = np.full(mine.size, np.nan if sd is None else sd)
        if sd is None and freedom > 0:
            spread = np.sqrt(np.einsum("ij,ij->j", residual, residual) / freedom)
        root = np.sqrt(np.einsum("ij,ij->i", inverse, inverse))
        n_seen = int(seen[:n_labels].sum())
        known = np.flatnonzero(seen[:n_labels])
        out["covariances"][k][np.ix_(known, known)] = inverse[:n_seen] @ inverse[:n_seen].T
        out["values"][np.ix_(seen[:n_labels], mine)] = found[:n_seen]
        out["u"][np.ix_(seen[:n_labels], mine)] = root[:n_seen, None] * spread
        out["drift"][:, mine] = design[:, n_labels:] @ found[n_seen:]
        lever = np.sqrt(((design[:, n_labels:] @ inverse[n_seen:]) ** 2).sum(axis=1))
        out["u_drift"][:, mine] = lever[:, None] * spread
        out["residual"][np.ix_(rows, mine)] = residual
        out["sd"][mine] = spread
    if not solved:
        raise TooFewSamplesError("at no point are there enough readings for drift and quantities")
    return out


def _problem(design: FloatArray) -> Exception | None:
    n, p = design.shape
    if n < p:
        return TooFewSamplesError(
            f"{n} readings for {p} unknowns; repeat the quantities or lower the order of the drift"
        )
    scale = np.maximum(np.sqrt((design**2).sum(axis=0)), np.finfo(float).tiny)
    if np.linalg.cond(design / scale) > _WORST_CONDITION:
        return NotSeparableError(
            "drift and quantities cannot be told apart: return to a quantity that was measured "
            "before (A-B-B-A), or lower the order of the drift"
        )
    return None


def _messages(
    table: FloatArray, design: FloatArray, sd: float | None, parts: Mapping[str, FloatArray]
) -> tuple[str, ...]:
    said = []
    found = ~np.isnan(parts["values"]).all(axis=0)
    alone = int(np.count_nonzero(found & np.isnan(parts["sd"])))
    if sd is None and design.shape[0] == design.shape[1]:
        said.append("no redundancy and no sd=: there is no uncertainty; add a reading")
    elif alone:
        said.append(f"{alone} point(s) have no redundancy left by the gaps: no uncertainty there")
    missing = int(np.count_nonzero(np.isnan(table)))
    if missing:
        said.append(f"{missing} of {table.size} readings were not measured: left out")
    lost = int(np.count_nonzero(np.isnan(parts["values"]).any(axis=0)))
    if lost:
        said.append(f"{lost} point(s) have too few readings for a quantity: NaN")
    return tuple(said)

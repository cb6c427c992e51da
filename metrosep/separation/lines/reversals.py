"""Reversals: artefact and machine from set-ups in which one of them changes its sign.

Straightedge reversal and Donaldson's roundness reversal are one algebra: ``m1 = A + M`` and
``m2 = A - M`` give ``A = (m1 + m2)/2`` and ``M = (m1 - m2)/2``. What the alignment of each set-up
decides (line, offset, eccentricity) belongs to neither and is removed. Only what repeats is
separated; the scatter of the repeats is the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError
from metrosep.core.numbers import not_negative
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_ends
from metrosep.separation._readings import (
    Averaged,
    average_repeats,
    checked_readings,
    curves,
    given_parts,
    left_share,
    line_basis,
    require_common,
    stacked,
    unit_message,
    without_basis,
)
from metrosep.separation.contract import (
    U_READING,
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
)
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import DirectionEstimate, ErrorEstimate, SampledCurve


def combined(
    method: RecordedMethod,
    array: FloatArray,
    weights: Mapping[str, FloatArray],
    bases: Mapping[str, FloatArray],
    stated: float | None,
) -> tuple[Averaged, dict[str, FloatArray], dict[str, FloatArray]]:
    """Return means over repeats, parts ``w @ mean`` without their basis, and their uncertainty.

    The widest basis, that of the artefact, is what may differ from repeat to repeat.
    """
    averaged = average_repeats(array, bases["artefact"], u_reading=stated)
    parts, u = {}, {}
    for name, w in weights.items():
        used, basis = w != 0.0, bases[name]
        curve = w[used] @ averaged.mean[used]
        valid = ~np.isnan(curve)
        require_common(valid, basis, method.name)
        parts[name] = without_basis(curve, basis)
        with np.errstate(divide="ignore"):
            spread = (w[used] ** 2) @ (1.0 / averaged.counts[used])
        variance = np.where(valid, averaged.noise.value**2 * spread, np.nan)
        u[name] = np.sqrt(variance * left_share(valid, basis))
    return averaged, parts, u


class ReversedPair(RecordedMethod):
    """Two readings ``A + M`` and ``A - M``; methods say what alignment takes from each."""

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        part, machine = given_parts(self, truth, errors).values()
        return np.stack([part + machine, part - machine])

    @property
    def _weights(self) -> dict[str, FloatArray]:
        """Half the sum is the artefact, half the difference the machine."""
        artefact, machine = *self.truth_parts, *self.error_parts
        return {artefact: np.array([0.5, 0.5]), machine: np.array([0.5, -0.5])}

    def _halves(
        self, array: FloatArray, basis: FloatArray, stated: float | None, **at: FloatArray
    ) -> Separation:
        """Return both parts over their coordinate, a basis removed from each."""
        weights = self._weights
        averaged, parts, u = combined(self, array, weights, dict.fromkeys(weights, basis), stated)
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, "m"),
            at,
            self.null_space(),
            noise=averaged.noise,
            audit={
                "n_repeats": averaged.n_repeats,
                "n_samples": int(array.shape[2]),
                "n_not_measured": int(np.isnan(averaged.mean).any(axis=0).sum()),
                "removed": "least squares: offset and "
                + ("eccentricity" if "angle" in at else "line"),
            },
            messages=(*averaged.messages, *unit_message(array, self.name)),
        )


_LINE = "line and offset are the alignment of each set-up; measure them against another reference"


@dataclass(frozen=True, slots=True)
class StraightedgeReversal(ReversedPair):
    """Reversal of a straightedge against a slide.

    Reading 1: ``m1 = T + S``. For reading 2 the edge is turned about its long axis and the probe
    set to its other side: ``m2 = T - S``, at the same positions of the edge.

    Readings: m1 and m2 (2, n) in m, or M passes of each. Parts: ``artefact``, deviation of the edge
    towards the probe of reading 1; ``machine``, straightness error of the slide in the same sense.

    Parameters
    ----------
    u_registration : float, m, optional
        Standard uncertainty of the position of the edge in set-up 2. It adds
        ``u_registration |T'| / 2`` to the uncertainty of both parts.
    u_common : float, m, optional
        Standard uncertainty of what both set-ups read alike and neither shows: sag, temperature,
        drift of the edge before the first, linearity of the sensor. It is added whole to the uncertainty of the edge and
        cancels in that of the slide.
    x : tuple of float or None, optional
        Positions in m; equal steps, of a length that does not matter, if omitted.
    u_drift : float, m, optional
        Standard uncertainty, at each position, of a change of the edge between the set-ups (heat,
        support). It adds ``u_drift / 2`` to the uncertainty of both parts.
    """

    u_registration: float = option(
        0.0,
        kind="uncertainty",
        help="standard uncertainty of the position of the edge in the second set-up",
    )
    u_common: float = option(
        0.0,
        kind="uncertainty",
        help="standard uncertainty of what both set-ups read alike; it goes into the edge alone",
    )
    x: tuple[float, ...] | None = None
    u_drift: float = option(
        0.0,
        kind="uncertainty",
        help="standard uncertainty of a change of the edge between the set-ups; half of it goes into both",
    )

    name = "straightedge_reversal"
    what = "form of a straightedge and straightness of a slide, by reversal"
    readings = ("m1", "m2")
    over = "x"
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("artefact",)
    error_parts = ("machine",)

    def null_space(self) -> tuple[Unobservable, ...]:
        return tuple(Unobservable(p, "polynomial", (0, 1), _LINE) for p in ("artefact", "machine"))

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        u_registration, u_common, u_drift = self._stated()
        if u_registration > 0.0 and self.x is None:
            raise DataError("u_registration is a length: it needs the positions x in m")
        array = checked_readings(readings, names=("m1", "m2"), minimum=4, what=self.name)
        x = _positions(self.x, array.shape[2])
        result = self._halves(array, line_basis(x), stated, x=x)
        u_shift = _shift_uncertainty(result.parts["artefact"], x, u_registration / 2.0)
        more = u_shift**2 + (0.5 * u_drift) ** 2
        u = {name: np.sqrt(u**2 + more) for name, u in result.u.items()}
        return replace(
            result,
            u={**u, "artefact": np.hypot(u["artefact"], u_common)},
            audit={**result.audit, **self._stated_audit()},
            history=(*history, self._step()),
        )

    def of_estimates(self, first: ErrorEstimate, second: ErrorEstimate) -> Separation:
        """Return edge and slide of the estimates of both set-ups, with their covariance.

        Parameters
        ----------
        first, second : ErrorEstimate
            Of the runs before and after the edge was turned; of two directions their mean.

        Returns
        -------
        Separation
            With `covariance` of both parts, over the range that both estimates cover.

        Raises
        ------
        NotSeparableError
            If the ranges do not overlap, or both estimates are of the same runs.
        DataError
            If an uncertainty is not a length, or the covariance of an estimate is not known.
        """
        u_registration, u_common, u_drift = self._stated()
        _refuse_same_runs(first, second)
        x = _common_positions(first, second)
        values = np.array([e.evaluate(x) for e in (first, second)])
        set_ups = _set_ups(first, second)
        whole = first.covariance(x) + second.covariance(x)
        known = ~np.isnan(values).any(axis=0)
        require_common(known, line_basis(x), self.name)
        parts = {n: without_basis(w @ values, line_basis(x)) for n, w in self._weights.items()}
        # cov T = cov S = (cov m1 + cov m2) / 4 for independent measurements; a line is taken off.
        common = _without_line(whole / 4.0, x)
        shift = np.gradient(parts["artefact"], x) * (0.5 * u_registration)
        common = common + np.outer(shift, shift)
        band = np.sqrt(np.maximum(np.diag(common), 0.0))
        modes = CovarianceModes.of(x, np.eye(x.size), np.nan_to_num(common))
        band = np.hypot(band, 0.5 * u_drift)
        u = {**dict.fromkeys(parts, band), "artefact": np.hypot(band, u_common)}
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, "m"),
            {"x": x},
            self.null_space(),
            audit={
                "readings": "estimates of repeated runs",
                "methods": [first.method, second.method],
                "n_samples": int(x.size),
                "n_not_measured": int((~known).sum()),
                "removed": "least squares: offset and line",
                "u_from": "covariance of the two estimates, independent: cov = (cov1 + cov2)/4",
                **({"set_ups": set_ups} if set_ups else {}),
                **self._stated_audit(),
            },
            messages=(*([set_ups] if set_ups else []), *first.messages, *second.messages),
            history=(*first.history, *second.history, self._step()),
            modes=dict.fromkeys(parts, modes),
        )

    def _stated(self) -> tuple[float, float, float]:
        """Return u of registration, of what is common, and of drift, in m."""
        return (
            not_negative(self.u_registration, "u_registration", dimension="length"),
            not_negative(self.u_common, "u_common", dimension="length"),
            not_negative(self.u_drift, "u_drift", dimension="length"),
        )

    def _step(self) -> Step:
        registration, common, drift = self._stated()
        more = {"u_common_m": common, "u_drift_m": drift}
        return Step(
            self.name, {"u_registration_m": registration, **{k: u for k, u in more.items() if u}}
        )

    def _stated_audit(self) -> dict[str, float]:
        registration, common, drift = self._stated()
        more = {"u_common_nm": common * 1e9, "u_drift_nm": drift * 1e9}
        return {"u_registration_mm": registration * 1e3, **{k: u for k, u in more.items() if u}}


class EstimatesReversed(NamedMethod):
    """`straightedge_reversal` of the stored results of two estimates."""

    name = "reversal_of_estimates"
    function = "straightedge_reversal"
    what = "straightedge and slide from the results of runs before and after the edge was reversed"
    reads = "results"
    readings = ("before the edge was reversed", "after it")
    accepts = ("ErrorEstimate",)
    arguments: ClassVar[Mapping[str, Option]] = {
        name: StraightedgeReversal.fields[name]
        for name in ("u_registration", "u_common", "u_drift")
    }


@described_by(StraightedgeReversal, StraightedgeReversal.separate)
def straightedge_reversal(
    m1: ArrayLike | Profile | ErrorEstimate,
    m2: ArrayLike | Profile | ErrorEstimate,
    *,
    x: ArrayLike | None = None,
    u_reading: float | None = None,
    u_registration: float = 0.0,
    u_common: float = 0.0,
    u_drift: float = 0.0,
) -> Separation:
    """Return form of a straightedge and straightness of a slide from a reversal.

    Parameters
    ----------
    m1, m2 : array_like, shape (n,) or (M, n), m, or Profile, or ErrorEstimate
        Readings before and after the edge was turned about its long axis and the probe set to
        its other side, at the same 4 or more positions of the edge; or M passes of each; or what
        was separated from the runs of each.
    x : array_like, shape (n,), m, optional
        Positions, if the readings are arrays; equal steps if omitted.

    Returns
    -------
    Separation
        ``.artefact`` (the edge), ``.machine`` (the slide), least-squares line removed. Of two
        estimates with ``.covariance("artefact")`` and ``.covariance("machine")``.

    Notes
    -----
    ``T = (m1 + m2)/2``, ``S = (m1 - m2)/2``; white noise s of one reading gives ``s / sqrt(2 M)``.
    Of two estimates ``cov T = cov S = (cov m1 + cov m2)/4``: they are independent measurements.
    A shift d of the edge between the set-ups adds ``d T'/2`` to both. Gravity does not reverse:
    in a set-up that measures vertically the sag of the edge stays in the machine.

    References
    ----------
    C. J. Evans, R. J. Hocken, W. T. Estler, Self-calibration: reversal, redundancy, error
    separation, and 'absolute testing', CIRP Annals 45 (1996) 617-634, section 2.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 0.3, 31)
    >>> edge, slide = 40e-9 * np.sin(40 * x), 1e-6 * (x - 0.15) ** 2
    >>> result = straightedge_reversal(edge + slide, edge - slide, x=x)
    >>> line = np.polyval(np.polyfit(x, slide, 1), x)
    >>> bool(abs(result.machine - (slide - line)).max() < 1e-20)
    True
    """
    if isinstance(m1, ErrorEstimate) or isinstance(m2, ErrorEstimate):
        if not (isinstance(m1, ErrorEstimate) and isinstance(m2, ErrorEstimate)):
            raise DataError(
                "straightedge_reversal: one set-up is an estimate, the other is not; separate the "
                "runs of both, or give the readings of both"
            )
        if x is not None or u_reading is not None:
            raise DataError(
                "straightedge_reversal: estimates bring their positions and their uncertainty, "
                "leave out x and u_reading"
            )
        return StraightedgeReversal(u_registration, u_common, None, u_drift).of_estimates(m1, m2)
    readings, positions, history = curves((m1, m2), what="straightedge_reversal", axis="x")
    if positions is None and x is not None:
        positions = np.asarray(x, dtype=np.float64)
    elif x is not None:
        raise DataError("straightedge_reversal: profiles bring their positions, leave out x")
    method = StraightedgeReversal(
        u_registration,
        u_common,
        None if positions is None else tuple(positions.ravel().tolist()),
        u_drift,
    )
    array = stacked(readings, method.name)
    return method.separate(array, u_reading=u_reading, history=history)


def slide_error(reversal: Separation, *, part: str = "machine") -> ErrorEstimate:
    """Return what a reversal of estimates found of the slide as the error of an axis.

    Parameters
    ----------
    reversal : Separation
        Of `straightedge_reversal` of two estimates.
    part : str, optional
        The slide; ``artefact`` is the edge.

    Returns
    -------
    ErrorEstimate
        For tables, polynomials and dry-runs, with the uncertainty and covariance of the part, for
        both directions of travel; its slope is not known (NaN).

    Raises
    ------
    DataError
        If it is not a separation over x, or the covariance of the part is not known: it was made of
        readings, not of estimates.

    Examples
    --------
    >>> from metrosep.separation.runs.simulate import machine_axis
    >>> from metrosep.separation import separate
    >>> first, second = (separate(machine_axis(seed=i).runs, method="mean") for i in (1, 2))
    >>> error = slide_error(straightedge_reversal(first, second))
    >>> error.has_covariance
    True
    """
    if not isinstance(reversal, Separation):
        raise DataError(
            "slide_error takes the separation that straightedge_reversal makes of two estimates, not "
            f"{type(reversal).__name__}: reverse first, slide_error(straightedge_reversal(first, second))"
        )
    reversal.covariance(part)
    if "x" not in reversal.coordinates:
        raise DataError(
            f"slide_error needs a part over x in m; {reversal.method} has it over "
            f"{', '.join(reversal.coordinates)}"
        )
    x = reversal.coordinates["x"]
    travel = (float(x[0]), float(x[-1]))
    curves = (SampledCurve(x, reversal.parts[part]), SampledCurve(x, reversal.u[part]))
    return ErrorEstimate(
        method=reversal.method,
        start=travel[0],
        stop=travel[1],
        fit_range=travel,
        directions_data={0: DirectionEstimate(*curves, modes=reversal.modes[part])},
        slope=Quantity(math.nan, "rad", "alignment of each set-up; a reversal does not show it"),
        spectrum_data={},
        feed_spectra_data={},
        residual_psd_data={"frequency_hz": [], "psd_nm2_per_hz": [], "model_nm2_per_hz": []},
        residual_rms=math.nan,
        audit={"part": part, **reversal.audit},
        messages=reversal.messages,
        history=reversal.history,
    )


_POINTS = 401
"""Positions of a reversal of estimates."""


def _common_positions(first: ErrorEstimate, second: ErrorEstimate) -> FloatArray:
    """Return positions over the range that both estimates cover."""
    start, stop = max(first.start, second.start), min(first.stop, second.stop)
    if not stop > start:
        raise NotSeparableError(
            "straightedge_reversal: the estimates have no position in common, they cover "
            f"{format_ends(first.start, first.stop)} and "
            f"{format_ends(second.start, second.stop)}; both must be given "
            "over the positions of the edge"
        )
    return np.linspace(start, stop, _POINTS)


def _set_ups(first: ErrorEstimate, second: ErrorEstimate) -> str:
    """Return which files were taken as which set-up; empty where no file stands behind an estimate."""
    names = [_origin(e) for e in (first, second)]
    if not all(names):
        return ""
    return (
        f"before: {names[0]}, after: {names[1]} (the edge was turned between them; in the other "
        "order the slide has the other sign)"
    )


def _origin(estimate: ErrorEstimate) -> str:
    """Return the folder of a stored result and the files of its runs."""
    said = [s.parameters for s in estimate.history]
    files = ", ".join(dict.fromkeys(str(p["file"]) for p in said if p.get("file")))
    folder = next((str(p["result"]) for p in reversed(said) if p.get("result")), "")
    return f"{folder} ({files})" if folder and files else folder or files


def _refuse_same_runs(first: ErrorEstimate, second: ErrorEstimate) -> None:
    """Refuse runs that stand behind both estimates: they would not be independent."""
    used = [
        {h for s in e.history for h in s.parameters.get("runs_sha256", ()) if h}
        for e in (first, second)
    ]
    if used[0] & used[1]:
        raise NotSeparableError(
            f"straightedge_reversal: both estimates are made of the same {len(used[0] & used[1])} "
            "run(s); the second set-up needs runs of its own"
        )


def _without_line(covariance: FloatArray, x: FloatArray) -> FloatArray:
    """Return the covariance of curves less their least-squares line; NaN where it is not known."""
    known = ~np.isnan(np.diag(covariance))
    q, _ = np.linalg.qr(line_basis(x)[known])
    keep = np.eye(q.shape[0]) - q @ q.T
    out = np.full_like(covariance, np.nan)
    out[np.ix_(known, known)] = keep @ covariance[np.ix_(known, known)] @ keep
    return out


def _shift_uncertainty(values: FloatArray, x: FloatArray, u: float) -> FloatArray:
    """Return |dT/dx| u; where a neighbour is missing, the steepest slope stands for it."""
    if u == 0.0:
        return np.zeros(values.size)
    slope = np.abs(np.gradient(values, x))
    if np.isnan(slope).all():
        raise DataError("the slope of the edge cannot be found: no three neighbours were measured")
    return np.array(np.where(np.isnan(slope), np.nanmax(slope), slope) * u)


def _positions(x: tuple[float, ...] | None, n: int) -> FloatArray:
    if x is None:
        return np.arange(n, dtype=np.float64)
    positions = np.array(x, dtype=np.float64)
    if positions.size != n:
        raise DataError(f"there are {positions.size} positions for {n} samples")
    steps = np.diff(positions)
    if not np.isfinite(positions).all() or not ((steps > 0).all() or (steps < 0).all()):
        raise InvalidSamplesError("positions must be finite and strictly rising or falling")
    return positions

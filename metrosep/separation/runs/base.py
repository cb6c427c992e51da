"""`ErrorEstimate`: what a separation of repeated runs returns, whatever the method.

Sign: the estimate is the error ``e = actual - nominal`` of the axis, so the correction to add to
the command is ``-e``. The least-squares line over the evaluation range (alignment of artefact and
axis, eq. 1 of motion-error-fourier) is removed from `evaluate` and reported apart as `slope`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import quantity
from metrosep.core.profile import Profile, html_table
from metrosep.core.provenance import Step, freeze_mapping, history_as_dicts
from metrosep.core.public import PublicObject, shortened
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_ends, format_length
from metrosep.separation.covariance import CovarianceModes
from metrosep.spectral.dft import fourier_sum

if TYPE_CHECKING:
    import pandas as pd

    from metrosep.separation.contract import Separation

Columns = Mapping[str, list[Any]]

_NAMES = {1: "forward", -1: "reverse"}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ErrorEstimate(PublicObject):
    """Repeatable geometric error of an axis with its uncertainty, spectrum and audit.

    Parameters
    ----------
    method : str
        ``"joint"``, ``"kono"`` or ``"mean"``.
    start, stop : float, m
        Evaluation range.
    fit_range : tuple of (float, float), m
        Travel that was modelled; what lies outside the evaluation range is guard zone.
    directions_data : mapping of int to DirectionEstimate
        Keys +1 (forward), -1 (reverse) and/or 0 (the direction was not distinguished).
    slope : Quantity
        Alignment that was removed, rad.
    lost_motion : Quantity or None
        Mean reverse minus forward offset, m; only where both directions were run.
    spectrum_data, feed_spectra_data, residual_psd_data : mapping of str to list
        Columns of the tables of the same names.
    residual_rms : float, m
        RMS of the readings about the estimate, all runs; without those that a robust fit rejected,
        which are in ``terms["robust"]``.
    lag, lag_sd : float, s
        Delay of the reading against the position, and its standard uncertainty (NaN if it was
        given, not fitted).
    audit : mapping
        What was done: plain values, keys with unit suffixes.
    messages : tuple of str
        What the user should know, in plain words.
    history : tuple of Step
        From the files on.
    terms : mapping
        What was estimated beside the error ("drift", "lines", "following", "robust", "probes"):
        plain values, keys with unit suffixes; by direction where both were estimated.
    evidence_data : mapping of str to list
        Columns of `evidence`; dropped where there are two directions and no column says which.
    runs_data : mapping of str to list
        Columns of `runs`.
    """

    method: str
    start: float
    stop: float
    fit_range: tuple[float, float]
    directions_data: Mapping[int, DirectionEstimate]
    slope: Quantity
    spectrum_data: Columns
    feed_spectra_data: Columns
    residual_psd_data: Columns
    residual_rms: float
    lost_motion: Quantity | None = None
    lag: float = 0.0
    lag_sd: float = math.nan
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    history: tuple[Step, ...] = ()
    terms: Mapping[str, Any] = field(default_factory=dict)
    evidence_data: Columns = field(default_factory=dict)
    runs_data: Columns = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions_data", freeze_mapping_int(self.directions_data))
        object.__setattr__(self, "audit", freeze_mapping(self.audit))
        object.__setattr__(self, "terms", freeze_mapping(self.terms))
        if len(self.directions) > 1 and "direction" not in self.evidence_data:
            object.__setattr__(self, "evidence_data", {})

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions that were estimated apart: (-1, 1), (1,), (-1,)."""
        return tuple(sorted(d for d in self.directions_data if d != 0)) or (0,)

    def slope_of(self, direction: int | None = None) -> Quantity:
        """Return the slope that was removed from a direction.

        Parameters
        ----------
        direction : {1, -1, None}, optional
            The mean of both if omitted, or where they were not estimated apart.

        Returns
        -------
        Quantity, rad
            `slope` where there is one for all.
        """
        part = self.directions_data.get(direction or 0)
        return self.slope if part is None or part.slope is None else part.slope

    def _chosen(self, direction: int | None) -> list[DirectionEstimate]:
        if direction is not None and direction not in (-1, 1):
            raise DataError(f"direction is +1 (forward), -1 (reverse) or None, got {direction!r}")
        if direction is not None and direction in self.directions_data:
            return [self.directions_data[direction]]
        return list(self.directions_data.values())

    def evaluate(self, x: ArrayLike, *, direction: int | None = None) -> FloatArray:
        """Return the error ``actual - nominal`` at positions.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        direction : {1, -1}, optional
            Forward or reverse where both were estimated; their mean if omitted. Ignored where
            the runs had one direction only.

        Returns
        -------
        ndarray, shape (n,), m
            Error without the line over the evaluation range; NaN outside the measured travel.

        Raises
        ------
        DataError
            If `direction` is none of 1, -1, None.
        """
        parts = self._chosen(direction)
        return np.asarray(np.mean([p.error(x) for p in parts], axis=0))

    def sd(self, x: ArrayLike, *, direction: int | None = None) -> FloatArray:
        """Return the standard uncertainty of `evaluate`, pointwise.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        direction : {1, -1}, optional
            As for `evaluate`.

        Returns
        -------
        ndarray, shape (n,), m
            Standard uncertainty of the repeatable part as the readings determine it (type A).
            The artefact's own form, sensor linearity and temperature are not in it.

        Raises
        ------
        DataError
            If `direction` is none of 1, -1, None.
        """
        parts = self._chosen(direction)
        squares = [p.uncertainty(x) ** 2 for p in parts]
        return np.asarray(np.sqrt(np.sum(squares, axis=0)) / len(parts))

    @property
    def has_covariance(self) -> bool:
        """Whether `covariance` is known; results that were stored without it have none."""
        return all(p.modes is not None for p in self.directions_data.values())

    def covariance(self, x: ArrayLike, *, direction: int | None = None) -> FloatArray:
        """Return the covariance of `evaluate` between positions.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        direction : {1, -1}, optional
            As for `evaluate`; the errors of two directions are independent.

        Returns
        -------
        ndarray, shape (n, n), m^2
            Its diagonal is ``sd(x, direction=direction)**2``; NaN where `sd` is NaN.

        Raises
        ------
        DataError
            If `direction` is none of 1, -1, None, or the covariance is not known.

        Notes
        -----
        Kept as modes on up to 241 nodes over the travel; see
        `metrosep.separation.covariance`. What the modes lack of the variance, such as waves
        shorter than the nodes tell apart or the step of coarse readings, is common to positions
        nearer than one node only.

        References
        ----------
        Specified in the project's notes (separation-2), equation (18).
        """
        parts = self._chosen(direction)
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64)).ravel()
        total: FloatArray = np.zeros((xs.size, xs.size))
        for part in parts:
            total += part.covariance(xs)
        return total / len(parts) ** 2

    def u_of_difference(
        self, x: ArrayLike, other: float | str, *, direction: int | None = None
    ) -> FloatArray:
        """Return the standard uncertainty of ``evaluate(x) - evaluate(other)``.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        other : float, m
            The position that they are compared with, such as the zero of a table.
        direction : {1, -1}, optional
            As for `evaluate`.

        Returns
        -------
        ndarray, shape (n,), m
            ``sqrt(var(x) + var(other) - 2 cov(x, other))``, exactly 0 at `other`; NaN where `sd`
            is NaN.

        Raises
        ------
        DataError
            As `covariance` does.
        """
        other = quantity(other, "other", "length")
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64)).ravel()
        squares = [np.empty(0)]
        for first in range(0, xs.size, _BLOCK):
            places = np.append(xs[first : first + _BLOCK], other)
            whole = self.covariance(places, direction=direction)
            squares.append((np.diag(whole) + whole[-1, -1] - 2.0 * whole[-1])[:-1])
        square = np.where(
            xs == other, 0.0 * self.sd(xs, direction=direction), np.concatenate(squares)
        )
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))

    def evaluate_at(
        self, x: ArrayLike, *, feed: float, direction: int | None = None
    ) -> FloatArray:
        """Return the error at a feedrate, where ``following=`` estimated how it changes.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        feed : float, m/s
            Feedrate, > 0.
        direction : {1, -1}, optional
            As for `evaluate`.

        Returns
        -------
        ndarray, shape (n,), m
            Error without the line; equal to `evaluate` where nothing depends on the feedrate.

        Raises
        ------
        DataError
            If `direction` is none of 1, -1, None, or the feed is not positive.
        """
        speed = _checked_feed(feed)
        rows = []
        for part in self._chosen(direction):
            z, term = part.error(x), part.feed_term
            rows.append(z if term is None else z + (speed - term.reference) * term.change(x))
        return np.asarray(np.mean(rows, axis=0))

    def sd_at(self, x: ArrayLike, *, feed: float, direction: int | None = None) -> FloatArray:
        """Return the standard uncertainty of `evaluate_at`; it grows away from the mean feed.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        feed : float, m/s
            Feedrate, > 0.
        direction : {1, -1}, optional
            As for `evaluate`.

        Returns
        -------
        ndarray, shape (n,), m
            Standard uncertainty, type A.

        Raises
        ------
        DataError
            If `direction` is none of 1, -1, None, or the feed is not positive.
        """
        speed = _checked_feed(feed)
        squares = []
        for part in self._chosen(direction):
            square, term = part.uncertainty(x) ** 2, part.feed_term
            if term is not None:
                away = speed - term.reference
                square = square + 2.0 * away * term.covariance(x) + away**2 * term.variance(x)
            squares.append(np.maximum(square, 0.0))
        return np.asarray(np.sqrt(np.sum(squares, axis=0)) / len(squares))

    def to_profile(self, *, n_points: int = 501, direction: int | None = None) -> Profile:
        """Return the estimate over the evaluation range as a profile.

        Parameters
        ----------
        n_points : int, optional
            Number of positions.
        direction : {1, -1}, optional
            As for `evaluate`.

        Returns
        -------
        Profile
            Error over position; ``metadata["standard_uncertainty"]`` holds `sd` at the same
            positions, as lists ``x_m`` and ``u_m`` (None where it is not known).
        """
        x = np.linspace(self.start, self.stop, n_points)
        band = [_plain(v) for v in self.sd(x, direction=direction).tolist()]
        return Profile(
            x,
            self.evaluate(x, direction=direction),
            metadata={"standard_uncertainty": {"x_m": x.tolist(), "u_m": band}},
            history=self.history,
        )

    def peak_to_valley(self) -> Quantity:
        """Return the P-V of the estimate over the evaluation range, line removed.

        Returns
        -------
        Quantity
            In m; u is that of the difference between the two extremes, with their covariance.

        Notes
        -----
        ``u^2 = var(high) + var(low) - 2 cov(high, low)`` at the extremes of the estimate. Where
        other places come as near to them as the uncertainty, the extremes of the truth may lie
        there: the P-V of an estimate is then too large rather than too small, and u holds that
        only in part. Of an estimate that was stored without its covariance u takes the two
        extremes as independent, and says so.
        """
        x = np.linspace(self.start, self.stop, 2001)
        z = self.evaluate(x)
        ends = x[[int(np.nanargmax(z)), int(np.nanargmin(z))]]
        if self.has_covariance:
            u, how = (
                float(self.u_of_difference(ends[:1], float(ends[1]))[0]),
                "; u with the covariance of its two extremes",
            )
        else:
            u, how = float(np.hypot(*self.sd(ends))), "; u takes its two extremes as independent"
        return Quantity(
            float(np.nanmax(z) - np.nanmin(z)),
            "m",
            "P-V of the estimated repeatable error over the evaluation range, least-squares line "
            "removed, no filter" + how,
            u=u,
            symbol="PV",
        )

    @property
    def spectrum(self) -> pd.DataFrame:
        """Wavelengths: amplitude, phase at `start`, sd, snr, p, whether selected, and why."""
        import pandas as pd

        return pd.DataFrame(dict(self.spectrum_data))

    @property
    def feed_spectra(self) -> pd.DataFrame:
        """Amplitude against wavelength, one series for each feedrate."""
        import pandas as pd

        return pd.DataFrame(dict(self.feed_spectra_data))

    @property
    def residual_psd(self) -> pd.DataFrame:
        """Residual PSD in time: measured and, where there is one, the noise model."""
        import pandas as pd

        return pd.DataFrame(dict(self.residual_psd_data))

    @property
    def evidence(self) -> pd.DataFrame:
        """Evidence of repeatability for each wavelength; see `evidence_table`."""
        import pandas as pd

        return pd.DataFrame(dict(self.evidence_data))

    @property
    def runs(self) -> pd.DataFrame:
        """Checks of the runs, those omitted too: gain and shift against the others, findings."""
        import pandas as pd

        return pd.DataFrame(dict(self.runs_data))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values for JSON (NaN as None).

        Returns
        -------
        dict
            Readable by `from_dict`.
        """
        return estimate_as_dict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ErrorEstimate:
        """Return the estimate that `to_dict` wrote.

        Parameters
        ----------
        data : mapping
            The ``estimate`` part of a result.json.

        Returns
        -------
        ErrorEstimate
            Evaluates to the same numbers.

        Raises
        ------
        DataError
            If a key is missing or of the wrong kind.
        """
        return estimate_from_dict(cls, data)

    def __sub__(self, other: Any) -> Separation:
        """Return the difference of two estimates over the travel that both cover.

        A part for each direction that both have ("both" where they were not distinguished). u is added
        in squares; it is not known (NaN) where both were made of the same file. What both removed,
        piston and slope, is not in it.
        """
        from metrosep.separation.contract import Separation

        if not isinstance(other, ErrorEstimate):
            return NotImplemented
        ways = [d for d in self.directions if d in other.directions]
        low, high = max(self.start, other.start), min(self.stop, other.stop)
        if not ways or not low < high:
            raise DataError(
                "the two estimates have no direction or no travel in common: "
                f"{self!r} and {other!r}"
            )
        shared = bool(self._sources() & other._sources())
        x = np.linspace(low, high, _DIFFERENCE)
        names = {1: "forward", -1: "reverse", 0: "both"}
        parts = {
            names[d]: self.evaluate(x, direction=d) - other.evaluate(x, direction=d) for d in ways
        }
        u = {
            names[d]: np.full(x.size, np.nan)
            if shared
            else np.hypot(self.sd(x, direction=d), other.sd(x, direction=d))
            for d in ways
        }
        why = "u is not known: both estimates were made of the same readings"
        step = Step("subtract", {"left": repr(self), "right": repr(other)})
        return Separation(
            "difference", parts, u, dict.fromkeys(parts, "m"), {"x": x}, (),
            messages=(why,) if shared else (), history=(*self.history, step),
        )  # fmt: skip

    def _sources(self) -> set[str]:
        """Return the hashes of the files that the estimate was made of."""
        return {str(s.parameters["sha256"]) for s in self.history if "sha256" in s.parameters}

    def __repr__(self) -> str:
        ways = ", ".join(_NAMES.get(d, "direction not distinguished") for d in self.directions)
        sd = self.sd(np.linspace(self.start, self.stop, 501))
        known = sd[~np.isnan(sd)]
        band = format_length(float(known.mean()), digits=2) if known.size else "not known"
        return shortened(
            f"ErrorEstimate({self.method}, {format_ends(self.start, self.stop)}"
            f", {ways}, P-V {self.peak_to_valley()}, mean sd {band})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {
            "method": self.method,
            "range": f"{format_length(self.start)} … {format_length(self.stop)}",
            "P-V, line removed": str(self.peak_to_valley()),
            "alignment slope": str(self.slope),
            "residual RMS of the readings": format_length(self.residual_rms),
        }
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table("ErrorEstimate", rows)


_BLOCK = 512
_DIFFERENCE = 601
"""Positions of the difference of two estimates."""
"""Positions of which the covariance is looked at together."""


def _checked_feed(feed: float) -> float:
    if not (math.isfinite(feed) and feed > 0.0):
        raise DataError(f"feed must be positive and finite, in m/s, got {feed}")
    return float(feed)


# ---- private to separation: an estimate as plain values for JSON, and back ---------------------


def estimate_as_dict(estimate: ErrorEstimate) -> dict[str, Any]:
    """Return everything as plain values, NaN as None."""
    return {
        "method": estimate.method,
        "start_m": estimate.start,
        "stop_m": estimate.stop,
        "fit_range_m": list(estimate.fit_range),
        "directions": {
            str(d): {
                "error": p.error.to_dict(),
                "uncertainty": p.uncertainty.to_dict(),
                **({} if p.feed_term is None else {"feed_term": p.feed_term.to_dict()}),
                **({} if p.modes is None else {"covariance": p.modes.to_dict()}),
                **({} if p.slope is None else {"slope": p.slope.to_dict()}),
            }
            for d, p in estimate.directions_data.items()
        },
        "slope": estimate.slope.to_dict(),
        "lost_motion": None if estimate.lost_motion is None else estimate.lost_motion.to_dict(),
        "spectrum": _without_nan(estimate.spectrum_data),
        "feed_spectra": _without_nan(estimate.feed_spectra_data),
        "residual_psd": _without_nan(estimate.residual_psd_data),
        "residual_rms_m": _plain(estimate.residual_rms),
        "lag_s": estimate.lag,
        "lag_sd_s": _plain(estimate.lag_sd),
        "audit": dict(estimate.audit),
        "messages": list(estimate.messages),
        "history": history_as_dicts(estimate.history),
        **({"terms": _nested_plain(estimate.terms)} if estimate.terms else {}),
        **({"evidence": _without_nan(estimate.evidence_data)} if estimate.evidence_data else {}),
        **({"runs": _without_nan(estimate.runs_data)} if estimate.runs_data else {}),
    }


def estimate_from_dict(cls: type[ErrorEstimate], data: Mapping[str, Any]) -> ErrorEstimate:
    """Return the estimate that `estimate_as_dict` wrote."""
    try:
        return cls(
            method=str(data["method"]),
            start=float(data["start_m"]),
            stop=float(data["stop_m"]),
            fit_range=(float(data["fit_range_m"][0]), float(data["fit_range_m"][1])),
            directions_data={
                int(d): DirectionEstimate(
                    curve_from_dict(p["error"]),
                    _sampled(curve_from_dict(p["uncertainty"])),
                    FeedTerm.from_dict(p["feed_term"]) if "feed_term" in p else None,
                    CovarianceModes.from_dict(p["covariance"]) if "covariance" in p else None,
                    _quantity(p["slope"]) if "slope" in p else None,
                )
                for d, p in data["directions"].items()
            },
            slope=_quantity(data["slope"]),
            lost_motion=None if data["lost_motion"] is None else _quantity(data["lost_motion"]),
            spectrum_data=_with_nan(data["spectrum"]),
            feed_spectra_data=_with_nan(data["feed_spectra"]),
            residual_psd_data=_with_nan(data["residual_psd"]),
            residual_rms=_number(data["residual_rms_m"]),
            lag=float(data["lag_s"]),
            lag_sd=_number(data["lag_sd_s"]),
            audit=data["audit"],
            messages=tuple(data["messages"]),
            history=tuple(Step(s["step"], s["parameters"], s["version"]) for s in data["history"]),
            terms=data.get("terms", {}),
            evidence_data=_with_nan(data.get("evidence", {})),
            runs_data=_with_nan(data.get("runs", {})),
        )
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as exc:
        raise DataError(
            f"this is not a stored estimate ({type(exc).__name__}: {exc}); expected the "
            "'estimate' part of a result.json that this version wrote"
        ) from exc


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value


def _nested_plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _nested_plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_nested_plain(v) for v in value]
    return _plain(value)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _without_nan(columns: Columns) -> dict[str, list[Any]]:
    return {k: [_plain(v) for v in values] for k, values in columns.items()}


def _with_nan(columns: Columns) -> dict[str, list[Any]]:
    return {k: [math.nan if v is None else v for v in values] for k, values in columns.items()}


def _sampled(curve: Curve) -> SampledCurve:
    if not isinstance(curve, SampledCurve):
        raise TypeError("the uncertainty must be a sampled curve")
    return curve


def _quantity(data: Mapping[str, Any]) -> Quantity:
    return Quantity(
        _number(data["value"]),
        str(data["unit"]),
        str(data["definition"]),
        u=None if data["u"] is None else float(data["u"]),
        symbol=str(data.get("symbol", "")),
    )


# ---- private to separation: what an estimate holds for each direction of travel ----------------


@dataclass(frozen=True, slots=True, eq=False)
class DirectionEstimate:
    """Error and standard uncertainty of one direction of travel.

    Parameters
    ----------
    error : FourierCurve or SampledCurve
        Error in m, line removed over the evaluation range.
    uncertainty : SampledCurve
        Standard uncertainty in m.
    feed_term : FeedTerm or None
        How the error changes with the feedrate, where that was estimated.
    modes : CovarianceModes or None
        What the errors at different positions have in common; None where it is not known.
    slope : Quantity or None
        Slope of this direction, rad, where both were estimated: they differ where the lost motion
        changes along the axis.
    """

    error: Curve
    uncertainty: SampledCurve
    feed_term: FeedTerm | None = None
    modes: CovarianceModes | None = None
    slope: Quantity | None = None

    def covariance(self, x: FloatArray) -> FloatArray:
        """Return the covariance at positions.

        Parameters
        ----------
        x : ndarray, shape (n,), m
            Positions.

        Returns
        -------
        ndarray, shape (n, n), m^2
            NaN where the uncertainty is NaN.

        Raises
        ------
        DataError
            If it is not known: one run, or a result that was stored without it.
        """
        if self.modes is not None:
            return self.modes.covariance(x, self.uncertainty(x))
        if np.isnan(self.uncertainty.z).all():
            raise DataError(
                "the covariance of the estimate is not known: one run tells no uncertainty; add runs"
            )
        raise DataError(
            "this estimate was stored without its covariance; separate the runs again with this "
            "version"
        )


def freeze_mapping_int(items: Mapping[int, DirectionEstimate]) -> Mapping[int, DirectionEstimate]:
    """Return a read-only copy, refusing an empty one."""
    from types import MappingProxyType

    if not items or not set(items) <= {-1, 0, 1}:
        raise DataError(f"an estimate needs directions out of -1, 0, 1, got {list(items)}")
    return MappingProxyType(dict(items))


# ---- curves that an estimate consists of: a Fourier series with a line, or samples -------------
# Both evaluate to NaN outside the travel that was measured: an error is never extrapolated.

LINE_POINTS = 4001
"""Uniform positions over the evaluation range from which its least-squares line is taken."""

_EDGE_RTOL = 1e-9
"""Positions this far outside the travel, relative to it, count as its end (rounding)."""


def _inside(x: FloatArray, travel: tuple[float, float]) -> NDArray[np.bool_]:
    margin = _EDGE_RTOL * (travel[1] - travel[0])
    return np.asarray((x >= travel[0] - margin) & (x <= travel[1] + margin))


@dataclass(frozen=True, slots=True, eq=False)
class FourierCurve:
    """``offset + slope (x - origin) + sum a_k cos + b_k sin`` of ``2 pi k (x - origin)/period``."""

    origin: float  # m: zero of phase; longest wavelength
    period: float
    cosine: FloatArray  # shape (K,), m: coefficients a_k, b_k
    sine: FloatArray
    offset: float  # m: constant part
    slope: float  # rad: linear part
    travel: tuple[float, float]  # of (float, float), m: where the curve is defined

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Return the values at positions in m; NaN outside the travel."""
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64))
        both = np.concatenate([self.cosine, self.sine])
        z = self.offset + self.slope * (xs - self.origin)
        z += fourier_sum(xs.ravel(), both, origin=self.origin, period=self.period).reshape(
            xs.shape
        )
        return np.where(_inside(xs, self.travel), z, np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `curve_from_dict`."""
        return {
            "kind": "fourier",
            "origin_m": self.origin,
            "period_m": self.period,
            "cosine_m": self.cosine.tolist(),
            "sine_m": self.sine.tolist(),
            "offset_m": self.offset,
            "slope_rad": self.slope,
            "travel_m": list(self.travel),
        }


@dataclass(frozen=True, slots=True, eq=False)
class SampledCurve:
    """Samples joined by straight lines."""

    x: FloatArray  # m, rising
    z: FloatArray  # m, NaN: not known there

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Return the values at positions in m; NaN outside the travel."""
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64))
        travel = (float(self.x[0]), float(self.x[-1]))
        return np.where(_inside(xs, travel), np.interp(xs, self.x, self.z), np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `curve_from_dict`."""
        z = [None if np.isnan(v) else float(v) for v in self.z]
        return {"kind": "sampled", "x_m": self.x.tolist(), "z_m": z}


Curve = FourierCurve | SampledCurve


@dataclass(frozen=True, slots=True, eq=False)
class FeedTerm:
    """How an error changes with the feedrate: ``e(x, v) = e(x) + (v - reference) change(x)``."""

    reference: float  # m/s, for which the error itself stands
    change: SampledCurve  # m for each m/s, line removed over the evaluation range
    covariance: SampledCurve  # of error and change, m^2 s/m
    variance: SampledCurve  # of the change, (m s/m)^2

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `FeedTerm.from_dict`."""
        return {
            "reference_m_per_s": self.reference,
            "change": self.change.to_dict(),
            "covariance": self.covariance.to_dict(),
            "variance": self.variance.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> FeedTerm:
        """Return the term that `to_dict` wrote.

        Parameters
        ----------
        data : dict
            As stored.

        Returns
        -------
        FeedTerm
            The same term.

        Raises
        ------
        DataError
            If a curve is damaged or not sampled.
        KeyError
            If a key is missing.
        """
        curves = [curve_from_dict(data[k]) for k in ("change", "covariance", "variance")]
        if not all(isinstance(c, SampledCurve) for c in curves):
            raise DataError("the curves of a feed-dependent term must be sampled")
        change, covariance, variance = (c for c in curves if isinstance(c, SampledCurve))
        return cls(float(data["reference_m_per_s"]), change, covariance, variance)


def curve_from_dict(data: dict[str, Any]) -> Curve:
    """Return the curve that `to_dict` wrote."""
    try:
        if data["kind"] == "fourier":
            low, high = data["travel_m"]
            return FourierCurve(
                origin=float(data["origin_m"]),
                period=float(data["period_m"]),
                cosine=np.array(data["cosine_m"], dtype=np.float64),
                sine=np.array(data["sine_m"], dtype=np.float64),
                offset=float(data["offset_m"]),
                slope=float(data["slope_rad"]),
                travel=(float(low), float(high)),
            )
        if data["kind"] == "sampled":
            return SampledCurve(
                np.array(data["x_m"], dtype=np.float64), np.array(data["z_m"], dtype=np.float64)
            )
    except (KeyError, TypeError, ValueError) as exc:
        raise DataError(
            f"a stored curve is damaged or incomplete ({exc!r}); run the separation again"
        ) from exc
    raise DataError(f"unknown kind of curve {data.get('kind')!r}; expected 'fourier' or 'sampled'")

"""Multi-probe roundness: artefact and spindle motion from three or more probes round one section.

Model: ``m_i(theta) = r(theta + t phi_i) + x(theta) cos(phi_i) + y(theta) sin(phi_i)``.

Signs: probe angles phi count counter-clockwise from +X, as seen by an observer for whom +Y is 90
degrees on. A reading grows when the surface comes towards the probe, so x > 0 is the axis moved to
+X and r > 0 is material. The turn t = +1: the part turns against the count of the probe angles
(clockwise), so the point of the part at the probe phi is theta + phi. With t = -1 it turns with the
count, and the angle of the part is counted the other way, theta - phi.

Harmonic k = 0 is the zero of each probe and k = 1 is eccentricity and motion in one: neither is
separable. Undulations whose noise gain exceeds ``max_gain`` are suppressed by the angles: reported,
NaN in ``harmonics``, absent from the curves.

Source of the three-probe weights: D. J. Whitehouse, J. Phys. E 9 (1976) 531; here least squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError, UnitError
from metrosep.core.numbers import count, positive
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import unit_message
from metrosep.separation.circles._circle import (
    CircleMethod,
    ProbeGeometry,
    Revolutions,
    angle_tuple,
    centred,
    check_radius,
    check_sign,
    circle_readings,
    harmonics_of,
    hidden_message,
    hidden_of,
    numbers,
    probe_geometry,
    reading_noise,
    turn_option,
    turned,
    unseen,
    variances,
)
from metrosep.separation.contract import (
    U_READING,
    Parts,
    Separation,
    Unobservable,
    settle,
    suppressed_harmonics,
)


@dataclass(frozen=True)
class MultiprobeRoundness(CircleMethod):
    """Probes at fixed angles round one section of a turning artefact.

    Readings: one row for each probe, in m. Parts: ``artefact``, radius deviation over its own
    angle; ``x`` and ``y``, motion of the axis over the angle of rotation.

    Parameters
    ----------
    angles : sequence of float, shape (n,), n >= 3, rad
        Where the probes stand, in the order of the readings.
    cov : array_like, shape (n,) or (n, n), m^2, optional
        Variances or covariance of one reading of each probe; they weight the probes and, where no
        `u_reading` is given, make the uncertainty. All probes alike if omitted.
    u_angles : float or sequence of float, rad, optional
        Standard uncertainty of each probe angle, independent (type B).
    u_sensitivity : float or sequence of float, optional
        Relative standard uncertainty of the sensitivity of each probe, independent (type B).
    radius : float, m, optional
        Radius of the artefact: the audit then holds the second undulation that the eccentricity
        itself makes, ``e^2 / (4 radius)``.

    Raises
    ------
    TooFewSamplesError, InvalidSamplesError
        If there are fewer than 3 angles, they are not finite, or `cov` is not a covariance.
    UnitError
        If angles or their uncertainty look like degrees, or `radius` like mm.
    DataError
        If kmax, the uncertainties, `max_gain`, `turn` or `radius` are out of range.
    NotSeparableError
        If the probes stand on one line or their angles suppress every undulation.

    Examples
    --------
    >>> method = MultiprobeRoundness(np.deg2rad([0, 45, 135]), 20)
    >>> [k for item in method.null_space() if item.kind == "harmonic" for k in item.indices][:4]
    [7, 9, 15, 17]
    """

    angles: Any = option(
        kind="angles", help="where the probes stand, in the order of the readings"
    )
    kmax: int = option(
        kind="integer",
        help="highest undulation per revolution that is separated, >= 2 and below half the samples",
    )
    cov: Any = None
    u_angles: Any = option(0.0, kind="angle", help="standard uncertainty of each probe angle")
    u_sensitivity: Any = option(
        0.0, kind="number", help="relative standard uncertainty of the sensitivity of each probe"
    )
    max_gain: float = option(
        50.0,
        kind="number",
        help="an undulation whose noise is magnified more than this is called suppressed",
    )
    turn: Literal[1, -1] = turn_option()
    radius: float | None = option(
        None, kind="size", help="of the artefact: tells the undulation that the eccentricity makes"
    )

    name = "multiprobe"
    what = "roundness of an artefact and motion of a spindle in x and y, from 3 or more probes"
    over = "angle"
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("artefact",)
    error_parts = ("x", "y")
    _sources: ClassVar[str] = "probes"

    def __post_init__(self) -> None:
        angles = angle_tuple(self.angles, least=3, what="probe")
        n = len(angles)
        settle(
            self,
            angles=angles,
            kmax=count(self.kmax, "kmax", least=2),
            cov=_covariance(self.cov, n),
            u_angles=_each_probe(self.u_angles, n, "u_angles", "rad", 0.2),
            u_sensitivity=_each_probe(self.u_sensitivity, n, "u_sensitivity", "", 0.5),
            max_gain=positive(self.max_gain, "max_gain"),
            turn=check_sign(self.turn, "turn"),
            radius=None if self.radius is None else check_radius(self.radius),
        )
        if np.isinf(self._geometry().gain[0]).all():
            raise NotSeparableError(
                "these probe angles suppress every undulation (do two probes stand at the same or "
                "at opposite places?); use optimise_probe_angles"
            )

    @property
    def _n_sources(self) -> int:
        return len(self.angles)

    def _geometry(self) -> ProbeGeometry:
        cov = None if self.cov is None else np.array(self.cov)
        return probe_geometry(
            np.array(self.angles),
            self.kmax,
            covariance=cov,
            max_gain=self.max_gain,
            turn=self.turn,
        )

    @property
    def gain(self) -> FloatArray:
        """Noise of the artefact harmonics 0 ... kmax over that of a reading's; inf: suppressed."""
        gain: FloatArray = self._geometry().gain[0]
        return gain

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        # the artefact is turned by its Fourier phases, exact for harmonics below N/2
        parts = self._rows_of(truth, errors)
        phi = np.array(self.angles)
        out: FloatArray = (
            turned(parts["artefact"], self.turn * phi)
            + np.outer(np.cos(phi), parts["x"])
            + np.outer(np.sin(phi), parts["y"])
        )
        return out

    def null_space(self) -> tuple[Unobservable, ...]:
        why = (
            f"suppressed by these probe angles (noise gain of the artefact above {self.max_gain:g})"
            "; other angles or one more probe show them"
        )
        rows = zip(self._parts, self._geometry().gain, strict=True)
        return tuple(item for part, gain in rows for item in unseen(part, hidden_of(gain), why))

    def _separated(
        self, given: Revolutions, stated: float | None, start: float, history: tuple[Step, ...]
    ) -> Separation:
        geometry, array = self._geometry(), given.values
        n_turns, n_samples = array.shape[1:]
        each = harmonics_of(array, self.kmax)
        mean = each.mean(axis=1)
        found = _parts(geometry, mean)
        rest = _rest(geometry, mean)
        misfit, freedom = float(np.sum(np.abs(rest) ** 2)), 2 * int(geometry.freedom.sum())
        noise, source, u_k = _noise(self, geometry, array, each, misfit, freedom, stated)
        hidden = suppressed_harmonics(self.null_space())
        ratio = _chi2_ratio(geometry, each, noise.value, source, misfit, freedom, n_samples)
        angles_deg = np.rad2deg(self.angles).tolist()
        centring = _eccentricity(self, mean)
        return self._result(
            given,
            found,
            noise,
            u_k,
            _type_b(self, geometry, mean, found, n_samples),
            start=start,
            settings={"angles_deg": angles_deg, "turn": self.turn, "kmax": self.kmax},
            audit={
                "max_gain": self.max_gain,
                "gain": [float(g) if math.isfinite(g) else None for g in geometry.gain[0]],
                "suppressed": hidden,
                "removed": "k = 0 and k = 1 of every part, k > kmax",
                "noise_source": source,
                "residual_chi2_ratio": ratio,
                "residual_freedom": freedom,
                **centring,
            },
            messages=(
                *given.messages,
                *unit_message(centred(array), self.name),
                *((source,) if math.isnan(noise.value) else ()),
                *hidden_message(
                    hidden,
                    "suppressed by these probe angles: NaN in harmonics, absent from the curves",
                ),
                *_noise_messages(source, n_turns, ratio, freedom),
                *_limacon_message(centring),
            ),
            step=Step(self.name, {"kmax": self.kmax, "angles_deg": angles_deg}),
            history=history,
        )


@described_by(MultiprobeRoundness, MultiprobeRoundness.separate)
def multiprobe(
    m: Any,
    angles: ArrayLike,
    kmax: int,
    *,
    cov: ArrayLike | None = None,
    u_reading: float | None = None,
    u_angles: ArrayLike = 0.0,
    u_sensitivity: ArrayLike = 0.0,
    max_gain: float = 50.0,
    turn: Literal[1, -1] = 1,
    radius: float | None = None,
    angle: ArrayLike | None = None,
) -> Separation:
    """Return roundness of an artefact and motion of its axis from three or more probes.

    Parameters
    ----------
    m : array_like, shape (n, N) or (n, M, N), m, or Recording, or sequence of Profile
        Readings of each probe over one revolution of N equal steps, or M revolutions. Profiles
        hold the angle of rotation in rad as their position, the same in each. A `Recording` is
        cut into revolutions by its channel ``angle`` (or of unit rad); without it, it must be one.
    angle : array_like, shape (N,), rad, optional
        Angle of rotation at each sample of `m` given as arrays; from 0 in equal steps if omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.x``, ``.y``: sums of the observable harmonics 2 ... kmax; ``.suppressed``;
        ``.harmonics``, NaN where not observable.

    Notes
    -----
    ``m_i(theta) = r(theta + turn phi_i) + x(theta) cos(phi_i) + y(theta) sin(phi_i)``, least
    squares weighted by `cov` for each k. Three alike probes: the noise gain is
    ``sqrt(1 + c2^2 + c3^2) / |W_k|``, with ``W_k = 1 + c2 exp(j k phi_2) + c3 exp(j k phi_3)``.
    Revolutions with a NaN are omitted whole and counted. See docs: separation-multiprobe.

    References
    ----------
    D. J. Whitehouse, Some theoretical aspects of error separation techniques in surface metrology,
    J. Phys. E: Sci. Instrum. 9 (1976) 531-536 (three probes; W_k and its zeros).

    Examples
    --------
    >>> theta = 2 * np.pi * np.arange(256) / 256
    >>> phi = np.deg2rad([0.0, 27.0, 60.0])
    >>> readings = [
    ...     50e-9 * np.cos(3 * (theta + p)) + 20e-9 * np.sin(2 * theta) * np.sin(p) for p in phi
    ... ]
    >>> result = multiprobe(readings, phi, 50)
    >>> bool(np.abs(result.artefact - 50e-9 * np.cos(3 * theta)).max() < 1e-20)
    True
    >>> bool(np.abs(result.y - 20e-9 * np.sin(2 * theta)).max() < 1e-20)
    True
    """
    method = MultiprobeRoundness(
        angles, kmax, cov, u_angles, u_sensitivity, max_gain, turn, radius
    )
    return circle_readings(m, what="multiprobe", angle=angle).separated(method, u_reading)


# ---- the work of `MultiprobeRoundness.separate`: harmonics, uncertainty, audit, messages -------

_FEW_REVOLUTIONS = 5
"""Below this the uncertainty of a harmonic from revolutions has fewer than 8 degrees of freedom."""

_DISAGREE = 5.0
"""Excess of chi-square, in its standard deviations, at which the probes are reported to disagree."""


_ROUNDING = 1e-12
"""Disagreement of this share of the readings is rounding."""


def _parts(geometry: ProbeGeometry, spectra: ComplexArray) -> ComplexArray:
    """Return (3, ..., kmax + 1) from (n, ..., kmax + 1)."""
    out: ComplexArray = np.einsum("pkn,n...k->p...k", geometry.rows, spectra)
    return out


def _rest(geometry: ProbeGeometry, spectra: ComplexArray) -> ComplexArray:
    """Return the whitened rest (k, ..., n) of spectra (n, ..., k) that no parts explain."""
    known = geometry.freedom > 0
    out: ComplexArray = np.einsum(
        "kij,jl,l...k->k...i", geometry.residual[known], geometry.whitener, spectra[..., known]
    )
    return out


def _noise(
    method: MultiprobeRoundness,
    geometry: ProbeGeometry,
    array: FloatArray,
    each: ComplexArray,
    misfit: float,
    freedom: int,
    u_reading: float | None,
) -> tuple[Quantity, str, FloatArray]:
    """Return noise, its source, u of harmonics: stated, else of revolutions, else of the misfit."""
    n, n_turns, n_samples = array.shape
    gain = np.where(np.isinf(geometry.gain), np.nan, geometry.gain)
    white = gain * math.sqrt(2.0 / (n_samples * n_turns))
    value, u, u_k = math.nan, None, None
    if u_reading is not None:
        value, source = u_reading, "as stated (u_reading)"
    elif method.cov is not None:
        value = math.sqrt(float(np.trace(np.array(method.cov))) / n)
        source = "as stated (cov, root mean square)"
    elif n_turns > 1:
        about = centred(array - array.mean(axis=1, keepdims=True))
        dof = n * (n_samples - 3) * (n_turns - 1)
        value = math.sqrt(float(np.sum(about**2)) / dof)
        u = value / math.sqrt(2.0 * dof)
        scatter = _parts(geometry, each - each.mean(axis=1, keepdims=True))
        u_k = np.sqrt(np.sum(np.abs(scatter) ** 2, axis=1) / (2.0 * (n_turns - 1) * n_turns))
        source = f"type A from {n_turns} revolutions, asynchronous motion included"
    elif freedom > 0:
        value = math.sqrt(misfit / freedom * n_samples / 2.0)
        u = value / math.sqrt(2.0 * freedom)
        source = f"type A from what {n} probes disagree by, {freedom} degrees of freedom"
    else:
        source = (
            "the noise of a reading is not known (three probes, one revolution): give u_reading, "
            "cov, repeated revolutions or a fourth probe; no uncertainty is stated"
        )
    return reading_noise(value, source, u), source, white * value if u_k is None else u_k


def _type_b(
    method: MultiprobeRoundness,
    geometry: ProbeGeometry,
    mean: ComplexArray,
    found: ComplexArray,
    n_samples: int,
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return variances of curves (3, N) and of harmonics (3, kmax + 1) for each named term.

    A wrong angle of probe i changes its reading by ``d_i`` per rad, a wrong sensitivity by the
    reading itself; the estimator's row of that probe carries it into the parts.
    """
    phi = np.array(method.angles)[:, np.newaxis]
    k = np.arange(method.kmax + 1)
    r, x, y = found
    turning = 1j * method.turn * k * np.exp(1j * method.turn * k * phi)
    d = turning * r - np.sin(phi) * x + np.cos(phi) * y
    out = {}
    for label, per_unit, u in (
        ("probe angles", d, method.u_angles),
        ("probe sensitivities", mean, method.u_sensitivity),
    ):
        if not any(u):
            continue
        moved = geometry.rows.transpose(0, 2, 1) * (per_unit * np.array(u)[:, np.newaxis])
        out[label] = variances(moved, n_samples)
    return out


def _chi2_ratio(
    geometry: ProbeGeometry,
    each: ComplexArray,
    noise: float,
    source: str,
    misfit: float,
    freedom: int,
    n_samples: int,
) -> float | None:
    """Return what the probes disagree by, squared, over what the noise explains.

    Revolutions tell the noise of the disagreement itself: motion and drift of the level that
    differ from revolution to revolution do not hide it.
    """
    n_turns = each.shape[1]
    if freedom == 0 or math.isnan(noise):
        return None
    if source.startswith("as stated") or n_turns == 1:
        explained = noise**2 * 2.0 / (n_samples * n_turns)
    else:
        scatter = _rest(geometry, each - each.mean(axis=1, keepdims=True))
        explained = float(np.sum(np.abs(scatter) ** 2)) / (freedom * (n_turns - 1) * n_turns)
    floor = (_ROUNDING * float(np.abs(each).max())) ** 2
    explained = max(explained, floor)
    return misfit / freedom / explained if explained > 0.0 else None


def _eccentricity(method: MultiprobeRoundness, mean: ComplexArray) -> dict[str, float | None]:
    """Return the run-out that turns with the part, and what only motion can have made, at k = 1."""
    phi = np.array(method.angles)
    basis = np.exp(1j * method.turn * np.outer(phi, [1.0, -1.0]))
    with_part, against = np.abs(np.linalg.lstsq(basis, mean[:, 1], rcond=None)[0])
    second = None if method.radius is None else float(with_part**2 / (4.0 * method.radius)) * 1e9
    return {
        "eccentricity_um": float(with_part) * 1e6,
        "motion_against_k1_um": float(against) * 1e6,
        "eccentric_circle_k2_nm": second,
    }


def _limacon_message(audit: Mapping[str, float | None]) -> list[str]:
    second = audit["eccentric_circle_k2_nm"]
    if second is None or second < 0.1:
        return []
    text = (
        f"the eccentricity of {audit['eccentricity_um']:.3g} um by itself makes a second "
        f"undulation of {second:.3g} nm amplitude in artefact k = 2; centre better or allow for it"
    )
    return [text]


def _noise_messages(source: str, n_turns: int, ratio: float | None, freedom: int) -> list[str]:
    out = []
    if "revolutions" in source and 1 < n_turns < _FEW_REVOLUTIONS:
        out.append(
            f"u of single harmonics comes from {n_turns} revolutions only "
            f"({2 * (n_turns - 1)} degrees of freedom each)"
        )
    spread = 2.0 / max(freedom, 1) * (1.0 + (1.0 / (n_turns - 1) if n_turns > 1 else 0.0))
    if ratio is not None and ratio > 1.0 + _DISAGREE * math.sqrt(spread):
        out.append(
            f"the probes disagree {math.sqrt(ratio):.3g} times more than their noise explains: "
            "an angle, a sensitivity or the turn is wrong; check_probes names the suspect"
        )
    return out


def _each_probe(values: Any, n: int, name: str, unit: str, most: float) -> tuple[float, ...]:
    """Return one uncertainty for each probe, refused beyond what can be meant."""
    array = np.atleast_1d(numbers(values, f"{name} must be one number or {n}"))
    if array.shape not in ((1,), (n,)):
        raise DataError(f"{name} must be one number or {n}, got the shape {array.shape}")
    if not ((array >= 0.0).all() and np.isfinite(array).all()):
        raise DataError(f"{name} must be >= 0 and finite, got {array.tolist()} {unit}".rstrip())
    if array.max() > most:
        hint = "; degrees? give numpy.deg2rad" if unit else "; percent? divide by 100"
        raise UnitError(f"{name} of {array.max():.6g} {unit} is above {most:g}{hint}")
    return tuple(np.broadcast_to(array, n).tolist())


def _covariance(cov: Any, n: int) -> tuple[tuple[float, ...], ...] | None:
    """Return the covariance of the probes as rows, refused where it is none."""
    if cov is None:
        return None
    array = numbers(cov, f"cov must hold {n} variances or {n} x {n} covariances in m^2")
    if array.shape == (n,):
        array = np.diag(array)
    if array.shape != (n, n):
        raise InvalidSamplesError(
            f"cov must hold {n} variances or {n} x {n} covariances in m^2, got {array.shape}"
        )
    size = float(np.abs(array).max()) if np.isfinite(array).all() else math.nan
    if (
        not size > 0.0
        or np.abs(array - array.T).max() > 1e-9 * size
        or (np.diag(array) <= 0).any()
    ):
        raise InvalidSamplesError(
            "cov must be finite and symmetric with variances > 0, in m^2; a probe of no use is "
            "better omitted"
        )
    return tuple(tuple(row) for row in array.tolist())

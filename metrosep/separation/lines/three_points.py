"""Straightness from three probes on one carriage: sequential, generalised, combined, least squares.

Reading model: ``m_j = f(x + o_j) + z + o_j t + e_j`` with o = 0, d1, d1 + d2: the leading probe, at
larger x, is the third. ``m1 - 2 m2 + m3`` (equal distances) is free of straightness z and pitch t.
A zero difference ``delta = e1 - 2 e2 + e3`` bends the artefact: ``f + delta x^2 / (2 d^2)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.docs import described_by
from metrosep.core.errors import DataError
from metrosep.core.numbers import flag, not_negative, positive, real
from metrosep.core.options import option
from metrosep.core.profile import Profile
from metrosep.separation.contract import Separation, settle
from metrosep.separation.lines._line_problem import (
    METHODS,
    Row,
    ZeroCalibration,
    checked_row,
    distances,
    given_readings,
    method_named,
    split_call,
)
from metrosep.separation.lines._line_result import (
    ProbeRowMethod,
    smoothing_option,
    step_option,
)

_MAX_ZERO = 1e-3
"""A zero difference above 1 mm is not an adjustment of a straightness probe: the unit is wrong."""


def zero_error_sag(zero: float, length: float, distance: float | tuple[float, float]) -> float:
    """Return the sag of the parabola into which a zero error of three probes bends an artefact.

    Parameters
    ----------
    zero : float, m
        Zero difference ``e1 - 2 e2 + e3``.
    length : float, m
        Of the artefact measured.
    distance : float or tuple of (float, float), m
        Between the probes, both distances where they differ.

    Returns
    -------
    float
        ``zero (length / distance)^2 / 8``, m; with two distances
        ``zero length^2 / (4 d1 (d1 + d2))``.

    Raises
    ------
    DataError
        If a distance is not above zero.

    Examples
    --------
    >>> round(zero_error_sag(1e-9, 0.3, 0.01) * 1e9, 6)
    112.5
    """
    d1, d2 = distances(distance)
    zero = real(zero, "zero", dimension="length")
    length = not_negative(length, "length", dimension="length")
    return zero * length**2 / (4.0 * d1 * (d1 + d2))


@dataclass(frozen=True, slots=True)
class ThreePoint(ProbeRowMethod):
    """Three probes at x, x + d1 and x + d1 + d2 on one carriage.

    Parts: ``artefact``, (n + span/step rounded up,), from the trailing probe at the first position
    on; ``straightness`` and ``pitch`` (rad), (n,), of the carriage; ``zero``, one number, NaN where
    it is not known. `transfer` is ``|H| = |1 - 2 exp(j w d) + exp(2 j w d)|``, or its like for two
    distances: noise s of a reading becomes ``sqrt(6) s / |H|``.

    Parameters
    ----------
    distance : float or tuple of (float, float), m
        Between neighbours, above zero; both where they differ.
    zero : float or None, m, optional
        Zero difference ``e1 - 2 e2 + e3`` of the probes (``e1 - (1 + r) e2 + r e3``, r = d1/d2):
        an error e of the middle probe alone is ``-2 e``. 0.0 for probes adjusted to one line.
        Without it (and without an angle sensor) the parabola is not known and omitted.

    Raises
    ------
    DataError
        If a distance is not above zero, the method unknown, sums do not close with these
        distances, or the zero is not usable.
    """

    distance: float | tuple[float, float] = option(
        kind="lengths", help="between neighbouring probes, two values where they differ"
    )
    step: float = step_option()
    method: str = option(
        "sequential",
        kind="text",
        choices=METHODS,
        help='"sequential" sums second differences along chains of samples one distance apart. '
        '"generalised" finds a curve at any distances by least squares with a penalty on '
        'third differences. "combined" keeps the chains, exact at steps and short waves, and '
        'takes only offset and line of each chain from "generalised". "least_squares" uses no'
        " penalty",
    )
    zero: float | None = option(
        None, kind="length", help="zero difference e1 - 2 e2 + e3 of the probes, where it is known"
    )
    u_zero: float = option(0.0, kind="uncertainty", help="standard uncertainty of zero")
    smoothing: float = smoothing_option()

    name = "three_point"
    what = "form of a straightedge and straightness of a slide, from three probes on the carriage"
    readings = ("trailing", "middle", "leading")
    truth_parts = ("artefact",)
    error_parts = ("straightness", "pitch", "zero")
    _probe_names: ClassVar[tuple[str, ...]] = ("trailing probe", "middle probe", "leading probe")

    def __post_init__(self) -> None:
        smoothing = positive(self.smoothing, f"{self.name}: smoothing")
        settle(self, method=method_named(self.method, METHODS, self.name), smoothing=smoothing)
        _check_multiple(self._row, self.method, self.name)
        zero = self.zero
        if zero is not None:
            zero = real(zero, "zero", dimension="length", finite=False)
            if not abs(zero) <= _MAX_ZERO:
                raise DataError(f"zero is {zero}; it is the zero difference of the probes in m")
        settle(self, zero=zero, u_zero=not_negative(self.u_zero, "u_zero", dimension="length"))

    @property
    def _row(self) -> Row:
        d1, d2 = distances(self.distance)
        return checked_row(
            np.array([0.0, d1, d1 + d2]),
            self.step,
            what=self.name,
            pitch=True,
            zero_known=self.zero is not None,
        )

    @property
    def _zero(self) -> tuple[float, float] | None:
        return None if self.zero is None else (self.zero, self.u_zero)


@described_by(ThreePoint, ThreePoint.separate)
def three_point(
    m: ArrayLike | Sequence[Profile],
    *more: Any,
    distance: float | tuple[float, float] | None = None,
    x: ArrayLike | None = None,
    step: float | None = None,
    method: str = "sequential",
    zero: float | None = None,
    u_zero: float = 0.0,
    zero_cal: ZeroCalibration | None = None,
    u_reading: float | None = None,
    pitch: ArrayLike | None = None,
    u_pitch: float | None = None,
    smoothing: float = 1e-3,
) -> Separation:
    """Return form of an artefact, straightness and pitch of a carriage from three probes on it.

    Call it ``three_point(m, distance, ...)``. The parabola of the form is omitted unless the zero
    difference of the probes is known: pass ``zero=0.0`` to keep the parabola. Positions and
    straightness refer to the trailing probe.

    Parameters
    ----------
    m : array_like, shape (3, n) or (3, R, n), m, or three Profiles
        Readings of the trailing, middle and leading probe (rising x) at the same positions of the
        carriage; or R passes. NaN or masked = not measured. Positive in the same sense for all.
    *more : float or tuple, or array_like and float or tuple
        The distance; ``three_point(m1, m2, m3, distance)`` with one array for each probe is the
        same.
    distance : float or tuple of (float, float), m
        Between neighbouring probes, two values where they differ; also by name.
    x : array_like, shape (n,), m, optional
        Positions of the carriage (of its trailing probe; subtract the distance from positions of
        the middle probe), rising in equal steps.
    step : float, m, optional
        Step between the positions, instead of `x`; the distance if neither is given. With both,
        the step between the samples of the artefact (not with "sequential").
    zero_cal : ZeroCalibration, optional
        Instead of both: what `zero_calibration` found.

    Returns
    -------
    Separation
        ``.artefact`` over ``coordinates["x"]``, least-squares line (and parabola, where it is not
        known) removed; ``.straightness`` and ``.pitch`` over ``coordinates["carriage_x"]``, such
        that all add up to the readings; ``.zero``, NaN where it is not known.

    Notes
    -----
    Of several passes, those that lack a probe at a position do not count there: each pass has its
    own straightness and pitch. ``u`` follows the counts. Samples that no probe read are NaN and
    listed.

    Null space: offset, line, without a zero the parabola, and wavelengths that all distances are
    multiples of. With one step between the probes, N artefact positions and noise s of a reading
    the RMS of u is ``s sqrt(6 (N^2 - 4)(N^2 + 5) / (420 N))``, 20.6 s at N = 31. An uncertainty
    u_zero adds a parabola of sag ``u_zero (L/d)^2 / 8``.

    References
    ----------
    W. Gao, S. Kiyono, On-machine profile measurement of machined surface using the combined
    three-point method, JSME Int. J. C 40 (1997) 253-259. The penalty is ours.

    Examples
    --------
    >>> import numpy as np
    >>> i = np.arange(31)
    >>> bent = 1e-9 * np.array([1.0, -2.0, 1.0])[:, None] / 6.0 * np.ones(29)
    >>> result = three_point(bent, 10e-3, step=10e-3, zero=0.0)
    >>> sag = result.artefact[0] - result.artefact[15]
    >>> bool(abs(sag - zero_error_sag(1e-9, 0.3, 10e-3)) < 1e-18)
    True
    """
    readings, apart = split_call(m, more, distance, 3, ThreePoint.name)
    given = given_readings(readings, x, step, ThreePoint.name, distance=apart)
    if zero_cal is not None:
        if not isinstance(zero_cal, ZeroCalibration):
            raise DataError(
                f"three_point: zero_cal is what zero_calibration returns, got {zero_cal!r}; a known "
                "number is given as zero=..., u_zero=..."
            )
        if zero is not None or u_zero != 0.0:
            raise DataError("three_point: give zero with u_zero, or zero_cal, not both")
        zero, u_zero = zero_cal.zero_for(apart), zero_cal.u
    probes = ThreePoint(apart, given.step, method, zero, u_zero, smoothing)
    return given.separated(probes, u_reading, pitch, u_pitch)


# ---- straightness from two probes on one carriage: sequential, generalised, combined, least squares ----
# Reading model: ``m1 = f(x) + z``, ``m2 = f(x + d) + z + d t``: the leading probe, at larger x, is
# the second. ``m2 - m1 = f(x + d) - f(x) + d t`` is free of the straightness z of the carriage. Its
# pitch t is not separated from the form f; read it with an angle sensor, or use three probes.


@dataclass(frozen=True, slots=True)
class TwoPoint(ProbeRowMethod):
    """Two probes at x and x + distance on one carriage.

    Parts: ``artefact``, (n + distance/step rounded up,), from the trailing probe at the first
    position on; ``straightness``, (n,), and ``pitch`` (rad), (n,), if it was read. `transfer` is
    ``|H| = |exp(2 pi j d / wavelength) - 1|``: noise s of a reading becomes ``sqrt(2) s / |H|``.

    Raises
    ------
    DataError
        If a distance is not above zero, or the method unknown, or "sequential" is asked for with a
        distance that is not a multiple of the step.
    """

    distance: float = option(kind="size", help="between the probes, above zero; also by name")
    step: float = step_option()
    method: str = option(
        "sequential",
        kind="text",
        choices=METHODS,
        help='"sequential" sums differences along chains of samples one distance apart. '
        '"generalised" finds a curve at any distance by least squares with a penalty on third'
        ' differences. "combined" keeps the chains and takes only their offsets from '
        '"generalised". "least_squares" uses no penalty',
    )
    smoothing: float = smoothing_option()

    name = "two_point"
    what = "form of a straightedge and straightness of a slide, from two probes on the carriage"
    readings = ("trailing", "leading")
    truth_parts = ("artefact",)
    error_parts = ("straightness", "pitch")
    _probe_names: ClassVar[tuple[str, ...]] = ("trailing probe", "leading probe")

    def __post_init__(self) -> None:
        settle(
            self,
            distance=real(
                self.distance, f"{self.name}: distance", dimension="length", finite=False
            ),
            method=method_named(self.method, METHODS, self.name),
            smoothing=positive(self.smoothing, f"{self.name}: smoothing"),
        )
        _check_multiple(self._row, self.method, self.name)

    @property
    def _row(self) -> Row:
        return checked_row((0.0, self.distance), self.step, what=self.name, pitch=False)


def _check_multiple(row: Row, method: str, what: str) -> None:
    """Refuse sums where the distance is not a multiple of the step."""
    if method in ("sequential", "combined") and row.shifts is None:
        raise DataError(
            f"{what}: the distances {[o * 1e3 for o in row.offsets[1:]]} mm are not multiples of the step "
            f"{row.step * 1e3:.9g} mm, so {method!r} sums do not close; use method='generalised' or "
            "'least_squares', or another step"
        )
    if len(row.offsets) == 3 and method in ("sequential", "combined"):
        o = row.offsets
        if abs((o[1] - o[0]) - (o[2] - o[1])) > 1e-6 * row.step:
            raise DataError(
                f"{what}: {method!r} needs two equal distances; with unequal ones use "
                "method='least_squares' or 'generalised'"
            )


@described_by(TwoPoint, TwoPoint.separate)
def two_point(
    m: ArrayLike | Sequence[Profile],
    *more: Any,
    distance: float | None = None,
    x: ArrayLike | None = None,
    step: float | None = None,
    method: str = "sequential",
    u_reading: float | None = None,
    pitch: ArrayLike | None = None,
    u_pitch: float | None = None,
    smoothing: float = 1e-3,
) -> Separation:
    """Return form of an artefact and straightness of a carriage from two probes on the carriage.

    Call it ``two_point(m, distance, ...)``. Positions and straightness refer to the trailing probe;
    the pitch of the carriage stays in the form unless an angle sensor reads it.

    Parameters
    ----------
    m : array_like, shape (2, n) or (2, R, n), m, or two Profiles
        Readings of the trailing and of the leading probe (larger x) at the same positions of the
        carriage; or R passes. NaN or masked = not measured. Positive in the same sense for both.
    *more : float, or array_like and float
        The distance; ``two_point(m1, m2, distance)`` with one array for each probe is the same.
    x : array_like, shape (n,), m, optional
        Positions of the carriage (of its trailing probe), rising in equal steps.
    step : float, m, optional
        As of `three_point`.

    Returns
    -------
    Separation
        ``.artefact`` over ``coordinates["x"]``, least-squares line removed; ``.straightness`` over
        ``coordinates["carriage_x"]``, such that both add up to the readings; ``.pitch`` if it was
        read.

    Notes
    -----
    Of several passes, those that lack a probe at a position do not count there: each pass has its
    own straightness. ``u`` follows the counts. Samples that no probe read are NaN and listed.
    With two probes nothing tells a pitch sensor of the wrong sign: check it once by tilting.

    Null space: offset and line (with them the zero difference of the probes), all form that is
    the sum of pitch times distance, and the wavelengths distance/n. For ``distance == step`` and
    N artefact positions the RMS of u is ``s sqrt(2 (N^2 - 4) / (15 N))``,
    2.03 s at N = 31.

    References
    ----------
    H. Tanaka, H. Sato, Extensive analysis and development of straightness measurement by
    sequential two-points method, J. Eng. Ind. 108 (1986) 176-182.

    Examples
    --------
    >>> import numpy as np
    >>> form, slide = 1e-7 * np.array([0, 1, 3, 2, -1, 0]), 1e-6 * np.array([5, -2, 7, 0, 1])
    >>> result = two_point([form[:-1] + slide, form[1:] + slide], 10e-3, step=10e-3)
    >>> at = np.arange(6)
    >>> level = form - np.polyval(np.polyfit(at, form, 1), at)
    >>> bool(abs(result.artefact - level).max() < 1e-20)
    True
    """
    readings, apart = split_call(m, more, distance, 2, TwoPoint.name)
    given = given_readings(readings, x, step, TwoPoint.name, distance=apart)
    probes = TwoPoint(apart, given.step, method, smoothing)
    return given.separated(probes, u_reading, pitch, u_pitch)


# ---- `MultiProbe`: any number of probes at any offsets, with an angle sensor -----------------

_METHODS = ("least_squares", "generalised")


@dataclass(frozen=True, slots=True)
class MultiProbe(ProbeRowMethod):
    """Probes at offsets on one carriage, evaluated by least squares.

    Parts: ``artefact``, (n + span/step rounded up,), from the first probe at the first position on;
    ``straightness`` and ``pitch`` (rad), (n,), of the carriage. `transfer` is the norm over the
    orthonormal combinations without carriage: noise s of a reading becomes ``s / transfer``.

    Parameters
    ----------
    offsets : tuple of float, m
        Positions of the probes on the carriage, rising; where the offset is 0, straightness is
        referred to.

    Raises
    ------
    DataError
        If the offsets do not rise or the method is unknown.
    """

    offsets: tuple[float, ...] = option(
        kind="lengths", help="of the probes on the carriage, rising, in the order of the readings"
    )
    step: float = option(
        kind="size",
        required=False,
        help="between the samples of the artefact, and the positions of the carriage unless they "
        "are given",
    )
    method: str = option(
        "least_squares",
        kind="text",
        choices=("least_squares", "generalised"),
        help="generalised adds a penalty on third differences",
    )
    zeros_known: bool = option(
        False,
        kind="flag",
        help="true: the readings are free of the zeros of the probes, which were adjusted to one "
        "line; the parabola then shows",
    )
    smoothing: float = option(1e-3, kind="number", help="weight of the penalty of generalised")

    name = "multi_probe_straightness"
    what = "straightedge and slide from probes at any offsets on the carriage"
    truth_parts = ("artefact",)
    error_parts = ("straightness", "pitch")
    _normed: ClassVar[bool] = True

    def __post_init__(self) -> None:
        settle(
            self,
            offsets=tuple(np.ravel(self.offsets).tolist()),
            method=method_named(self.method, _METHODS, self.name),
            zeros_known=flag(self.zeros_known, "zeros_known"),
            smoothing=positive(self.smoothing, f"{self.name}: smoothing"),
        )
        _ = self._row

    @property
    def _row(self) -> Row:
        three = len(self.offsets) > 2
        return checked_row(
            self.offsets,
            self.step,
            what=self.name,
            pitch=three,
            zero_known=three and self.zeros_known,
        )


@described_by(MultiProbe, MultiProbe.separate)
def multi_probe_straightness(
    m: ArrayLike | Sequence[Profile],
    offsets: ArrayLike,
    *,
    x: ArrayLike | None = None,
    step: float | None = None,
    method: str = "least_squares",
    zeros_known: bool = False,
    u_reading: float | None = None,
    pitch: ArrayLike | None = None,
    u_pitch: float | None = None,
    smoothing: float = 1e-3,
) -> Separation:
    """Return form of an artefact, straightness and pitch of a carriage from probes on it.

    Parameters
    ----------
    m : array_like, shape (n_probes, n) or (n_probes, R, n), m, or Profiles
        Readings in the order of the offsets at the same positions of the carriage; or R passes.
        NaN or masked = not measured.
    x : array_like, shape (n,), m, optional
        Positions of the carriage, rising; of any steps if `step` is given too.

    Returns
    -------
    Separation
        ``.artefact`` over ``coordinates["x"]``, ``.straightness`` and ``.pitch`` over
        ``coordinates["carriage_x"]``, where the offset is 0.

    Notes
    -----
    At each position of each pass the readings are projected onto what does not see the carriage,
    then averaged over the passes that hold the same probes; samples that no probe read are NaN. The artefact
    follows by least squares, the null space from the singular values of this design (above 600
    samples it is verified by the condition of its QR factors). Positions off the artefact grid are
    reached by the interpolating spline of degree 5. Cost O(n^3): 2 s at 2000 samples.

    References
    ----------
    C. Elster, I. Weingaertner, M. Schulz, Coupled distance sensor systems for high-accuracy
    topography measurement, Precis. Eng. 30 (2006) 32-38.

    Examples
    --------
    >>> import numpy as np
    >>> i = np.arange(40)
    >>> form, slide = 1e-8 * np.sin(i), 1e-6 * np.cos(i[:33])
    >>> m = [form[k : k + 33] + slide for k in (0, 2, 5, 7)]
    >>> offsets = 1e-3 * np.array([0, 2, 5, 7])
    >>> result = multi_probe_straightness(m, offsets, step=1e-3, zeros_known=True)
    >>> level = form - np.polyval(np.polyfit(i, form, 1), i)
    >>> bool(abs(result.artefact - level).max() < 1e-15)
    True
    """
    given = given_readings(m, x, step, MultiProbe.name)
    try:
        places = tuple(np.ravel(np.asarray(offsets, dtype=np.float64)).tolist())
    except (TypeError, ValueError):
        raise DataError(
            f"{MultiProbe.name}: offsets must be the positions of the probes in m, got {offsets!r}"
        ) from None
    probes = MultiProbe(places, given.step, method, zeros_known, smoothing)
    return given.separated(probes, u_reading, pitch, u_pitch)

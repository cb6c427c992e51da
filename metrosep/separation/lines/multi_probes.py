"""Straightness from any number of probes at any offsets on one carriage, with an angle sensor.

Reading model: ``m_j = f(x + o_j) + z + o_j t + e_j``: artefact f, straightness z and pitch t of the
carriage, zeros e_j of the probes. Two probes leave the pitch in the artefact unless a sensor reads
it; from three on it is free. More probes than the carriage needs give redundancy: the noise is then
found from the readings, and fewer wavelengths are lost.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FormatMismatchError
from metrosep.core.inputs import Readings
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._readings import checked_readings
from metrosep.separation.contract import (
    U_READING,
    Separation,
    SeparationMethod,
    Unobservable,
    as_rows,
)
from metrosep.separation.lines._line_probes import Row, checked_row, interpolation
from metrosep.separation.lines._line_problem import (
    Request,
    checked_smoothing,
    given_readings,
    method_named,
    null_space_of,
    transfer_of,
)
from metrosep.separation.lines._line_result import evaluate

__all__ = ["MultiProbe", "multi_probe_straightness"]


# ---- what the methods with probes in a row on one carriage share: readings of known parts ------


class ProbeRowMethod(SeparationMethod):
    """Probes in a row; derived classes say where they sit."""

    over: ClassVar = "x"
    roles: ClassVar[Mapping[str, str]] = {"pitch": "angle?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "u_pitch": Option("angle", help="standard uncertainty of one reading of the pitch"),
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Separation:
        """Return the parts of probes on one carriage, with or without an angle sensor."""
        if data.position is None and "step" not in options:
            raise FormatMismatchError(
                'the positions of the carriage are needed: x = "x_mm" in [input], or step = "10 mm"'
            )
        rest = dict(options)
        if data.position is not None:
            rest["x"] = data.position
        if "pitch" in data.extra:
            rest["pitch"] = data.extra["pitch"].mean(axis=0)
        if isinstance(rest.get("distance"), tuple):
            rest["distance"] = one_or_two(rest["distance"])
        found: Separation = getattr(sys.modules[cls.__module__], cls.name)(
            as_rows(data.values), **rest
        )
        return found

    @property
    @abstractmethod
    def _row(self) -> Row:
        """Offsets, step and what is known of the probes."""

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like
            ``artefact``, shape (n + span/step rounded up,), m, from the first probe at the first
            position on; the span is the distance of the first and the last probe.
        errors : mapping of str to array_like
            ``straightness``, shape (n,), m, and ``pitch``, shape (n,), rad; of three probes
            ``zero`` too, scalar, m (NaN is no zero difference).

        Returns
        -------
        ndarray, shape (n_probes, n), m
            From the trailing to the leading probe, in the order of the offsets.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or the lengths do not fit.
        """
        return simulated(
            self._row,
            truth,
            errors,
            truth_parts=self.truth_parts,
            error_parts=self.error_parts,
            what=self.name,
        )


# ---- readings that known parts produce on probes in a row --------------------------------------


def one_or_two(given: tuple[float, ...]) -> float | tuple[float, ...]:
    """Return the distance of three probes, or both where they differ."""
    if len(given) not in (1, 2) or min(given) <= 0.0:
        raise DataError(
            "three probes have one distance, or two that differ, above zero; got "
            + ", ".join(f"{d * 1e3:g} mm" for d in given)
        )
    return given[0] if len(given) == 1 else given


STEP = "between the positions of the carriage, and between the samples of the form"
SMOOTHING = "weight of the penalty of generalised and combined"


def simulated(
    row: Row,
    truth: Mapping[str, ArrayLike],
    errors: Mapping[str, ArrayLike],
    *,
    truth_parts: Sequence[str],
    error_parts: Sequence[str],
    what: str,
) -> FloatArray:
    """Return the readings of parts: artefact (m,), straightness, pitch (n,), zero (scalar)."""
    for given, known, kind in ((truth, truth_parts, "truth"), (errors, error_parts, "error")):
        for name in given:
            if name not in known:
                raise DataError(f"{what} has no {kind} part {name!r}; it has {', '.join(known)}")
    parts = {k: np.asarray(v, dtype=np.float64) for k, v in {**truth, **errors}.items()}
    n = _n_positions(row, parts, what)
    o = np.array(row.offsets)
    readings = np.zeros((o.size, n))
    if "artefact" in parts:
        grid = (o[0] + row.step * np.arange(n + row.span)).astype(np.float64)
        at = [interpolation(grid, row.step * np.arange(n) + v) for v in o]
        readings += np.array([p @ parts["artefact"] for p in at])
    zero = np.zeros(n)
    readings += parts.get("straightness", zero) + o[:, None] * parts.get("pitch", zero)
    if "zero" in parts and np.isfinite(parts["zero"]).all():
        w = row.weights
        readings += (w * float(parts["zero"]) / (w @ w))[:, None]
    return readings


def _n_positions(row: Row, parts: Mapping[str, FloatArray], what: str) -> int:
    counts = {k: v.size for k, v in parts.items() if k in ("straightness", "pitch")}
    if "artefact" in parts:
        counts["artefact"] = parts["artefact"].size - row.span
    if len(set(counts.values())) != 1 or min(counts.values()) < 2:
        sizes = ", ".join(f"{k} {v.size}" for k, v in parts.items()) or "none is given"
        raise DataError(
            f"{what}: for n >= 2 carriage positions straightness and pitch have n values, the artefact "
            f"n + {row.span}; got {sizes}"
        )
    return next(iter(counts.values()))


# ------------------------------------------------------------------------------------------------

_METHODS = ("least_squares", "generalised")


@dataclass(frozen=True, slots=True)
class MultiProbe(ProbeRowMethod):
    """Probes at offsets on one carriage, evaluated by least squares.

    Parameters
    ----------
    offsets : tuple of float, m
        Positions of the probes on the carriage, rising; where the offset is 0, straightness is
        referred to.
    step : float, m
        Between the samples of the artefact, and the positions of the carriage unless they are given.
    method : {"least_squares", "generalised"}, optional
        Without or with a penalty on third differences.
    zeros_known : bool, optional
        Whether the readings are free of the zeros of the probes; the parabola then shows.
    smoothing : float, optional
        Weight of the penalty.

    Raises
    ------
    DataError
        If the offsets do not rise or the method is unknown.
    """

    offsets: tuple[float, ...] = option(
        kind="lengths", help="of the probes on the carriage, rising, in the order of the readings"
    )
    step: float = option(kind="size", required=False, help=STEP)
    method: str = option(
        "least_squares",
        kind="text",
        choices=("least_squares", "generalised"),
        help="generalised adds a penalty on third differences",
    )
    zeros_known: bool = option(
        False, kind="flag", help="true: the probes were adjusted to one line"
    )
    smoothing: float = option(1e-3, kind="number", help="weight of the penalty of generalised")

    name: ClassVar[str] = "multi_probe_straightness"
    what: ClassVar[str] = "straightedge and slide from probes at any offsets on the carriage"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("straightness", "pitch")

    def __post_init__(self) -> None:
        object.__setattr__(self, "offsets", tuple(np.ravel(self.offsets).tolist()))
        object.__setattr__(self, "method", method_named(self.method, _METHODS, self.name))
        checked_smoothing(self.smoothing, self.name)
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

    def transfer(self, wavelengths: ArrayLike) -> FloatArray:
        """Return what is left of a unit wave when the carriage has cancelled.

        Parameters
        ----------
        wavelengths : array_like, shape (k,), m
            Above zero.

        Returns
        -------
        ndarray, shape (k,)
            Norm over the orthonormal combinations without carriage; noise s becomes
            ``s / transfer``.
        """
        row = self._row
        nuisance = np.column_stack([np.ones(len(row.offsets)), row.offsets])
        return transfer_of(
            row.offsets,
            nuisance if row.pitch else nuisance[:, :1],
            np.asarray(wavelengths, dtype=np.float64),
        )

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return offset, line, with unknown zeros the parabola, and the wavelengths not seen.

        Returns
        -------
        tuple of Unobservable
            Of whole readings without an angle sensor.
        """
        row = self._row
        return null_space_of(row, 2 if row.pitch and not row.zero_known else 1, pitch_part=True)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        x: ArrayLike | None = None,
        pitch: ArrayLike | None = None,
        u_pitch: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return artefact, straightness and pitch.

        Parameters
        ----------
        readings : array_like, shape (n_probes, n) or (n_probes, R, n), m
            In the order of the offsets; or R passes. NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; from passes or redundancy if omitted.
        x : array_like, shape (n,), m, optional
            Positions of the carriage, rising, of any steps; steps from zero if omitted.
        pitch : array_like, shape (n,), rad, optional
            Readings of an angle sensor on the carriage, positive where the leading end reads more.
        u_pitch : float, rad, optional
            Standard uncertainty of one of them; needed with `pitch`.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            As `multi_probe_straightness`.

        Raises
        ------
        DataError
            If the readings or the pitch cannot be used.
        """
        names = tuple(f"probe {j + 1}" for j in range(len(self.offsets)))
        array = checked_readings(readings, names=names, minimum=3, what=self.name)
        request = Request(self.name, self._row, self.method, self.smoothing)
        return evaluate(
            request,
            array,
            x=x,
            u_reading=u_reading,
            pitch=pitch,
            u_pitch=u_pitch,
            history=history,
        )


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
    offsets : array_like, shape (n_probes,), m
        Positions of the probes on the carriage, rising, two at least.
    x : array_like, shape (n,), m, optional
        Positions of the carriage, rising; of any steps if `step` is given too.
    step : float, m, optional
        Between the samples of the artefact.
    method : {"least_squares", "generalised"}, optional
        Without or with a penalty on third differences.
    zeros_known : bool, optional
        Whether the readings are free of the zeros of the probes.
    u_reading : float, m, optional
        Standard uncertainty of one reading; from passes or redundancy if omitted.
    pitch : array_like, shape (n,), rad, optional
        Readings of an angle sensor on the carriage, positive where the leading end reads more;
        with `u_pitch`. It determines the parabola.
    u_pitch : float, rad, optional
        Standard uncertainty of one of them.
    smoothing : float, optional
        Weight of the penalty.

    Returns
    -------
    Separation
        ``.artefact`` over ``coordinates["x"]``, ``.straightness`` and ``.pitch`` over
        ``coordinates["carriage_x"]``, where the offset is 0.

    Raises
    ------
    DataError
        If offsets, step, method or pitch do not fit.
    InvalidSamplesError, NotUniformError, TooFewSamplesError
        If readings or positions cannot be used.
    NotSeparableError
        If gaps or positions leave samples that do not hang together, or the pitch runs opposite to
        that of the probes.
    UnitError
        If the probes are farther apart than the carriage travels, or the pitch readings vary by
        less than 0.3 or more than 3 times what the probes see.

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
    return MultiProbe(places, given.step, method, zeros_known, smoothing).separate(
        given.readings,
        u_reading=u_reading,
        x=given.x,
        pitch=pitch,
        u_pitch=u_pitch,
        history=given.history,
    )

"""`PlaneModel`: maps of an XY plane separated into the errors of its two axes (Kono 2008, eq. 3).

``z(x, y) = e(x) + e(y) + alpha (y - y0) + beta (x - x0) + coupling(x, y)``: the machine's share is
the sum model, what it leaves is the coupling. Error = actual - nominal; rows grow with y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._method_parts import known_parts, part_of
from metrosep.separation._plane_coupling import two_way
from metrosep.separation._plane_input import plane_origin, plane_stack, plane_steps
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.plane_fit import PlaneFit, fit_plane_model

__all__ = ["PlaneModel"]


_LINE = "mean and line of an axis are the piston and the tilt of the map: alpha and beta hold them"
_SUM = "what depends on x alone or on y alone is the errors of the axes by definition"
_TILT = "axis and artefact tilt alike; measure the alignment against another reference"
_UNITS = {"coupling": "m", "along_x": "m", "along_y": "m", "alpha": "rad", "beta": "rad"}


@dataclass(frozen=True, slots=True)
class PlaneModel(SeparationMethod):
    """Sum model of an XY plane on a grid of steps dx and dy.

    Parameters
    ----------
    dx, dy : float, m
        Steps of the columns and rows.
    origin : tuple of (float, float), m, optional
        x and y of the first sample; where alpha and beta add nothing.

    Raises
    ------
    DataError
        If a step is not positive or the origin is no pair of finite numbers.

    Examples
    --------
    >>> method = PlaneModel(1e-3, 1e-3)
    >>> z = method.simulate({}, {"along_x": [0.0, 1e-9, 0.0], "along_y": [1e-9, 0.0, 1e-9]})
    >>> (z * 1e9).tolist()
    [[1.0, 2.0, 1.0], [0.0, 1.0, 0.0], [1.0, 2.0, 1.0]]
    """

    dx: float
    dy: float
    origin: tuple[float, float] = (0.0, 0.0)

    name: ClassVar[str] = "plane_model"
    truth_parts: ClassVar[tuple[str, ...]] = ("coupling",)
    error_parts: ClassVar[tuple[str, ...]] = ("along_x", "along_y", "alpha", "beta")

    def __post_init__(self) -> None:
        plane_steps(self.dx, self.dy)
        plane_origin(self.origin)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the map of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n_y, n_x), m
            ``coupling``: what is neither a function of x nor of y.
        errors : mapping of str to array_like
            ``along_x``, shape (n_x,), and ``along_y``, shape (n_y,), m; ``alpha`` (along y) and
            ``beta`` (along x), scalars, rad.

        Returns
        -------
        ndarray, shape (n_y, n_x), m
            One map; NaN where an axis is.

        Raises
        ------
        DataError
            If a part is unknown or has another shape, or the parts do not tell both sizes.
        """
        parts = known_parts(self, truth, errors)
        shape = _shape(parts)
        x, y = self.dx * np.arange(shape[1]), self.dy * np.arange(shape[0])
        slope_x, slope_y = (part_of(parts, n, (), self.name) for n in ("beta", "alpha"))
        along_x = part_of(parts, "along_x", shape[1:], self.name) + slope_x * x
        along_y = part_of(parts, "along_y", shape[:1], self.name) + slope_y * y
        coupling = part_of(parts, "coupling", shape, self.name)
        return np.asarray(coupling + along_x + along_y[:, np.newaxis])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what a map cannot tell.

        Returns
        -------
        tuple of Unobservable
            Mean and line of each axis, sums of functions of x and of y in the coupling, and the
            split of the tilt.
        """
        return (
            Unobservable("along_x", "polynomial", (0, 1), _LINE),
            Unobservable("along_y", "polynomial", (0, 1), _LINE),
            Unobservable("coupling", "term", ("functions of x", "functions of y"), _SUM),
            Unobservable("alpha", "term", ("tilt of the artefact along y",), _TILT),
            Unobservable("beta", "term", ("tilt of the artefact along x",), _TILT),
        )

    def separate(
        self,
        readings: ArrayLike | Surface,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the errors of both axes, the alignments and the coupling.

        Parameters
        ----------
        readings : array_like, shape (n_y, n_x) or (M, n_y, n_x), m, or Surface
            Maps of the plane; NaN = not measured. A surface must lie on this grid.
        u_reading : float, m, optional
            Standard uncertainty of one reading. From the repeats if there are any; of one map
            without it smooth coupling alone is told from noise.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``coupling`` (n_y, n_x), ``along_x``, ``along_y``, ``alpha``, ``beta``; the F test
            of the coupling in the audit.

        Raises
        ------
        DataError
            If shape, steps or `u_reading` are not usable, or a surface lies on another grid.
        InvalidSamplesError
            If the maps are no real numbers.
        NotSeparableError
            If the measured rows and columns fall into groups that share no point.
        TooFewSamplesError
            If fewer than 3 rows or columns are measured, or no point is left to test.

        Notes
        -----
        `fit_plane_model` does the work. The coupling has ``u^2 = s^2 (1/M - h)``, h the leverage of
        the sum model at the point: ``s^2 (1 - 1/n_x) (1 - 1/n_y) / M`` on a whole map.
        """
        if isinstance(readings, Surface):
            grid = (readings.dx, readings.dy, tuple(readings.origin))
            if grid != (self.dx, self.dy, tuple(self.origin)):
                raise DataError(
                    f"{self.name}: the surface has steps and origin {grid}, the method "
                    f"{(self.dx, self.dy, self.origin)}; resample it or set the method up for it"
                )
            history = (*readings.history, *history)
            readings = readings.z
        fit = fit_plane_model(
            readings, dx=self.dx, dy=self.dy, origin=self.origin, u_reading=u_reading
        )
        stack = plane_stack(readings, self.dx, self.dy, self.origin)[0]
        return self._result(fit, _left_share((~np.isnan(stack)).sum(axis=0)), history)

    def _result(self, fit: PlaneFit, share: FloatArray, history: tuple[Step, ...]) -> Separation:
        test = fit.interaction
        parts = {
            "coupling": fit.residual.z,
            "along_x": fit.along_x.z,
            "along_y": fit.along_y.z,
            "alpha": np.array(fit.alpha.value),
            "beta": np.array(fit.beta.value),
        }
        u = {
            "coupling": fit.noise.value * np.sqrt(share),
            "along_x": fit.u_x.z,
            "along_y": fit.u_y.z,
            "alpha": np.array(fit.alpha.u),
            "beta": np.array(fit.beta.u),
        }
        return Separation(
            self.name,
            parts,
            u,
            _UNITS,
            {"x": fit.along_x.x, "y": fit.along_y.x},
            self.null_space(),
            noise=fit.noise,
            audit={
                **fit.audit,
                "coupling_rms_nm": test.rms * 1e9,
                "coupling_f": test.f,
                "coupling_p": test.p,
                "degrees_of_freedom": [d if math.isfinite(d) else None for d in test.dof],
            },
            messages=fit.messages,
            history=(*history, Step(self.name, {"dx_m": self.dx, "dy_m": self.dy})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the map as it is: repeats of maps are in front."""
        return model


def _shape(parts: Mapping[str, FloatArray]) -> tuple[int, int]:
    """Return rows and columns as the parts tell them."""
    if "coupling" in parts and parts["coupling"].ndim == 2:
        n_y, n_x = parts["coupling"].shape
        return n_y, n_x
    if "along_x" in parts and "along_y" in parts:
        return parts["along_y"].size, parts["along_x"].size
    raise DataError(
        "plane_model: a map needs the coupling, shape (n_y, n_x), or both along_x and along_y; give "
        "the missing one as zeros"
    )


def _left_share(count: NDArray[np.int64]) -> FloatArray:
    """Return the share of a unit variance that the sum model leaves at each point."""
    rows, columns = count.any(axis=1), count.any(axis=0)
    inner = np.ix_(rows, columns)
    with one_blas_thread():
        inverse = two_way(np.zeros(count[inner].shape), count[inner])[2]
    n_y = int(rows.sum())
    own = np.diag(inverse)
    lever = own[:n_y, np.newaxis] + own[n_y:] + 2.0 * inverse[:n_y, n_y:]
    share = np.full(count.shape, np.nan)
    with np.errstate(divide="ignore"):
        share[inner] = np.maximum(1.0 / count[inner] - lever, 0.0)
    share[count == 0] = np.nan
    return share

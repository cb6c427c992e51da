"""`GridCalibration`: a stage and a grid plate separated from views of the same plate.

``reading(site) = plate(mark) + stage(site) + placement``: the plate as placed, turned by quarter
turns and shifted by whole pitches. Arrays are (n_y, n_x, 2), last axis x and y component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.separation._grid_solution import Repeats, refuse_unknown
from metrosep.separation._lattice_views import GridView, checked_placement
from metrosep.separation._method_parts import known_parts, part_of
from metrosep.separation._real_numbers import real_numbers
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.lattice_calibration import grid_calibration, unseen_terms
from metrosep.separation.null_space import Unobservable
from metrosep.separation.planner_checks import positive

__all__ = ["GridCalibration"]

Placement = tuple[int, tuple[int, int]]

_INITIAL_ROTATED_SHIFTED: tuple[Placement, ...] = ((0, (0, 0)), (1, (0, 0)), (0, (1, 0)))


@dataclass(frozen=True, slots=True)
class GridCalibration(SeparationMethod):
    """Views of a grid plate on a stage.

    Parameters
    ----------
    pitch : float, m
        Pitch of the lattice.
    placements : tuple of (int, (int, int)), optional
        Quarter turns from x to y, and the shift along x and y in pitches after it, of each view:
        as placed, turned once, and shifted by one pitch along x if omitted.
    repeats : {"relaid", "passes"}, optional
        Whether the plate was placed anew for each repeat of a view, or stayed.

    Raises
    ------
    DataError
        If the pitch is not positive, a turn or a shift is no whole number, or
        `repeats` is unknown.

    Examples
    --------
    >>> method = GridCalibration(1e-2)
    >>> plate = np.zeros((3, 3, 2))
    >>> plate[0, 0] = (1e-9, 0.0)
    >>> views = method.simulate({"plate": plate}, {})
    >>> (views[1, 0, 2] * 1e9).tolist(), bool(np.isnan(views[2, :, 0]).all())
    ([0.0, 1.0], True)
    """

    pitch: float
    placements: tuple[Placement, ...] = _INITIAL_ROTATED_SHIFTED
    repeats: Repeats = "relaid"

    name: ClassVar[str] = "grid_calibration"
    truth_parts: ClassVar[tuple[str, ...]] = ("plate",)
    error_parts: ClassVar[tuple[str, ...]] = ("stage",)

    def __post_init__(self) -> None:
        positive(self.pitch, "pitch", "m")
        refuse_unknown("free", self.repeats)
        for i, placement in enumerate(self.placements, start=1):
            try:
                turns, shift = placement
            except (TypeError, ValueError):
                raise DataError(
                    f"placement {i} is {placement!r}; give (turns, (shift x, shift y))"
                ) from None
            checked_placement(GridView((), turns, shift), i)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the views of given parts, placed without translation and rotation.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n_y, n_x, 2), m
            ``plate``: error of each mark, along the axes of the plate.
        errors : mapping of str to array_like, shape (n_y, n_x, 2), m
            ``stage``: what the stage adds at each site.

        Returns
        -------
        ndarray, shape (n_views, n_y, n_x, 2), m
            Reading minus nominal; NaN where no mark lies on a site.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or of another shape; if a lattice that is turned
            by a quarter has an even and an odd side.
        """
        parts = known_parts(self, truth, errors)
        shape = next(iter(parts.values())).shape
        if len(shape) != 3 or shape[2] != 2:
            raise DataError(f"{self.name}: parts have the shape (n_y, n_x, 2), got {shape}")
        odd = any(turns % 2 for turns, _ in self.placements)
        if odd and (shape[0] - shape[1]) % 2:
            raise DataError(
                f"{self.name}: a lattice of {shape[0]} x {shape[1]} does not fall onto itself when "
                "turned by a quarter; take rows and columns that are both even or both odd"
            )
        plate, stage = (part_of(parts, n, shape, self.name) for n in ("plate", "stage"))
        return np.stack([stage + _on_stage(plate, *p) for p in self.placements])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what no view sees.

        Returns
        -------
        tuple of Unobservable
            Translation, rotation and scale of stage and plate.
        """
        return unseen_terms()

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the errors of stage and plate.

        Parameters
        ----------
        readings : array_like, shape (n_views, n_y, n_x, 2) or (n_views, M, n_y, n_x, 2), m
            Reading minus nominal position; NaN where no mark is or was read.
        u_reading : float, m, optional
            Standard uncertainty of one reading as it is believed.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``stage`` and ``plate`` (n_y, n_x, 2); `grid_calibration` does the work.

        Raises
        ------
        DataError
            If the shape does not fit the placements, or the lattice is too large or too small.
        InvalidSamplesError
            If the readings are no real numbers.
        NotSeparableError
            If these placements do not tell stage from plate.
        UnitError
            If the readings are larger than half the pitch.
        """
        views = np.asarray(real_numbers(readings, f"{self.name}: readings"), dtype=np.float64)
        count = len(self.placements)
        if views.ndim not in (4, 5) or views.shape[0] != count or views.shape[-1] != 2:
            raise DataError(
                f"{self.name} has {count} placements: the readings need the shape ({count}, n_y, n_x, "
                f"2) or ({count}, repeats, n_y, n_x, 2), got {views.shape}"
            )
        given = [GridView(v, *p) for v, p in zip(views, self.placements, strict=True)]
        found = grid_calibration(
            given, pitch=self.pitch, repeats=self.repeats, u_reading=u_reading
        )
        step = Step(self.name, {"pitch_m": self.pitch, "repeats": self.repeats})
        return replace(found, history=(*history, step))


def _on_stage(plate: FloatArray, turns: int, shift: tuple[int, int]) -> FloatArray:
    """Return what the marks of a turned and shifted plate add at the sites of the stage."""
    n_y, n_x = plate.shape[:2]
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[turns % 4]
    turn = np.array([[cos, -sin], [sin, cos]], dtype=np.float64)
    middle = np.array([(n_x - 1) / 2, (n_y - 1) / 2])
    rows, columns = np.mgrid[:n_y, :n_x]
    sites = np.stack([columns, rows], axis=-1) - middle - np.array(shift)
    marks = np.rint(sites @ turn + middle).astype(np.intp)  # turn transposed, times the site
    on_plate = ((marks >= 0) & (marks < np.array([n_x, n_y]))).all(axis=-1)
    seen = np.full(plate.shape, np.nan)
    seen[on_plate] = plate[marks[on_plate][:, 1], marks[on_plate][:, 0]] @ turn.T
    return seen

"""Private: what the Gaussian filter is asked to do, checked and in samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters import _arguments as arguments
from metrosep.filters._kernel import standard_deviation
from metrosep.spectral.dft import real_number

End = Literal["moment", "renormalise", "closed", "cut"]

ENDS = ("moment", "renormalise", "closed", "cut")


@dataclass(frozen=True, slots=True)
class GaussianTask:
    """Steps and cut-offs per axis in the order of the array, and the part that was measured.

    `inside` is the smallest box around the valid samples (everything for a closed profile).
    """

    inside: tuple[slice, ...]
    steps: tuple[float, ...]
    cutoffs: tuple[float, ...]

    @property
    def sds(self) -> tuple[float, ...]:
        """Standard deviations in samples."""
        return tuple(
            standard_deviation(c, s) for c, s in zip(self.cutoffs, self.steps, strict=True)
        )

    @property
    def named(self) -> dict[str, Any]:
        """The cut-offs under the names that people use."""
        if len(self.cutoffs) == 1:
            return {"cutoff_m": self.cutoffs[0]}
        return {"nesting_index_x_m": self.cutoffs[1], "nesting_index_y_m": self.cutoffs[0]}

    def cut(self) -> tuple[slice, ...]:
        """Return `inside` without one cut-off at each end."""
        kept = []
        for part, step, cutoff in zip(self.inside, self.steps, self.cutoffs, strict=True):
            n_lost = math.ceil(cutoff / step * (1.0 - arguments.ON_LIMIT))
            n_left = part.stop - part.start - 2 * n_lost
            if n_left < 2:
                raise TooFewSamplesError(
                    f'end="cut" takes one cut-off {format_length(cutoff)} off each end of '
                    f"{format_length((part.stop - part.start) * step)} and leaves "
                    f"{arguments.counted(max(n_left, 0), 'sample')}: measure longer, or use "
                    'end="moment"'
                )
            kept.append(slice(part.start + n_lost, part.stop - n_lost))
        return tuple(kept)


def gaussian_task(
    obj: Profile | Surface,
    *,
    cutoff: float | None,
    nesting_index: float | tuple[float, float] | None,
    upr: float | None,
    end: str,
) -> GaussianTask:
    """Return the task of one object, or say what is wrong with it."""
    if end not in ENDS:
        raise DataError(f"end must be one of {', '.join(ENDS)}, got {end!r}")
    arguments.check_object(obj)
    if isinstance(obj, Profile):
        if end == "closed":
            arguments.check_not_repeated(obj)
        if upr is not None:
            cutoff = _cutoff_of_upr(obj, upr, cutoff, end)
        task = arguments.profile_task(
            obj,
            cutoff=cutoff,
            nesting_index=nesting_index,
            what="a Gaussian filter",
            minimum=1 if end == "closed" else 2,
            closed=end == "closed",
            name="cutoff" if upr is None else "the cut-off",
        )
    else:
        if upr is not None or end == "closed":
            raise DataError(
                'upr= and end="closed" are for closed profiles; a surface has ends, use "moment"'
            )
        task = arguments.surface_task(
            obj,
            cutoff=cutoff,
            nesting_index=nesting_index,
            what="an areal Gaussian filter",
            minimum=3,
        )
    return GaussianTask(task.inside, task.steps, task.wavelengths)


def _cutoff_of_upr(profile: Profile, upr: float, cutoff: float | None, end: str) -> float:
    """Return the wavelength of a cut-off in undulations per revolution."""
    if end != "closed":
        raise DataError('upr= counts undulations of a closed profile: say end="closed"')
    if cutoff is not None:
        raise DataError("give cutoff= or upr=, not both")
    number = real_number(upr, "upr", "a number of undulations per revolution")
    if not (math.isfinite(number) and number >= 1.0):
        raise DataError(f"upr must be finite and at least 1 undulation per revolution, got {upr}")
    return arguments.profile_step(profile) * len(profile) / number

"""Private: what the Gaussian filter is asked to do, checked and in samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import choice, real
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters import _arguments as arguments
from metrosep.filters._kernel import standard_deviation

End = Literal["moment", "renormalise", "closed", "cut"]

ENDS = ("moment", "renormalise", "closed", "cut")


@dataclass(frozen=True, slots=True)
class GaussianTask(arguments.Task):
    """The task of a Gaussian filter; all of a closed profile lies inside."""

    @property
    def sds(self) -> tuple[float, ...]:
        """Standard deviations in samples."""
        return tuple(
            standard_deviation(c, s) for c, s in zip(self.wavelengths, self.steps, strict=True)
        )

    def cut(self) -> tuple[slice, ...]:
        """Return `inside` without one cut-off at each end."""
        kept = []
        for part, step, cutoff in zip(self.inside, self.steps, self.wavelengths, strict=True):
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
    cutoff: arguments.Wavelength,
    nesting_index: arguments.Wavelengths,
    upr: float | None,
    end: str,
) -> GaussianTask:
    """Return the task of one object, or say what is wrong with it."""
    choice(end, "end", ENDS)
    arguments.check_object(obj)
    closed = end == "closed"
    if isinstance(obj, Surface) and (upr is not None or closed):
        raise DataError(
            'upr= and end="closed" are for closed profiles; a surface has ends, use "moment"'
        )
    if isinstance(obj, Profile) and upr is not None:
        cutoff = _cutoff_of_upr(obj, upr, cutoff, end)
    task = arguments.task_of(
        obj,
        cutoff,
        nesting_index,
        what="a Gaussian filter",
        areal="an areal Gaussian filter",
        minimum=(1 if closed else 2, 3),
        closed=closed,
        name="cutoff" if upr is None else "the cut-off",
    )
    return GaussianTask(task.z, task.inside, task.steps, task.wavelengths)


def _cutoff_of_upr(profile: Profile, upr: float, cutoff: arguments.Wavelength, end: str) -> float:
    """Return the wavelength of a cut-off in undulations per revolution."""
    if end != "closed":
        raise DataError('upr= counts undulations of a closed profile: say end="closed"')
    if cutoff is not None:
        raise DataError("give cutoff= or upr=, not both")
    number = real(upr, "upr", what="a number of undulations per revolution")
    if number < 1.0:
        raise DataError(f"upr must be at least 1 undulation per revolution, got {upr}")
    return arguments.profile_step(profile) * len(profile) / number

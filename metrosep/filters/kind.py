"""Which profile a profile is: primary (P), waviness (W) or roughness (R), and who said so.

A roughness profile that is filtered again gives too small numbers without any sign of it. So the
kind travels with the object: readers take it from the file (``metadata["profile_kind"]``), filters
set it, parameters look at it.
"""

from __future__ import annotations

from typing import Any, Literal

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step

__all__ = ["DoubleFilterError", "ProfileKind", "filtered_profile", "profile_kind"]

ProfileKind = Literal["P", "W", "R"]


class DoubleFilterError(DataError):
    """A profile that was filtered already would be filtered the same way again."""


def profile_kind(profile: Profile) -> ProfileKind | None:
    """Return the kind of a profile as its file or the last filter declares it.

    Parameters
    ----------
    profile : Profile
        Any.

    Returns
    -------
    {"P", "W", "R"} or None
        None where nobody has said it.

    Examples
    --------
    >>> profile_kind(Profile([0, 1e-6], [0, 0], metadata={"profile_kind": "R"}))
    'R'
    """
    kind = profile.metadata.get("profile_kind")
    return kind if kind in ("P", "W", "R") else None


def filtered_profile(
    profile: Profile, z: Any, *, step: Step, kind: ProfileKind | None, x: Any = None
) -> Profile:
    """Return a profile with filtered heights, its kind and one more step of history."""
    metadata = {**profile.metadata, "profile_kind": kind}
    return Profile(
        profile.x if x is None else x, z, metadata=metadata, history=(*profile.history, step)
    )

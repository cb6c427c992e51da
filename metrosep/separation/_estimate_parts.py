"""Private to separation: what an estimate holds for each direction of travel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from metrosep.core.errors import DataError
from metrosep.separation.curves import Curve, FeedTerm, SampledCurve

__all__ = ["DirectionEstimate", "freeze_mapping_int"]


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
    """

    error: Curve
    uncertainty: SampledCurve
    feed_term: FeedTerm | None = None


def freeze_mapping_int(items: Mapping[int, DirectionEstimate]) -> Mapping[int, DirectionEstimate]:
    """Return a read-only copy, refusing an empty one."""
    from types import MappingProxyType

    if not items or not set(items) <= {-1, 0, 1}:
        raise DataError(f"an estimate needs directions out of -1, 0, 1, got {list(items)}")
    return MappingProxyType(dict(items))

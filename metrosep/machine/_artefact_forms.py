"""Private: the unknown profile of a straightedge or square, place by place, that several sets share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError

if TYPE_CHECKING:
    from metrosep.machine._reading_problem import ReadingSet


@dataclass(frozen=True, slots=True, eq=False)
class ArtefactForm:
    """Shapes of the profile of an artefact at the places of one set."""

    orders: tuple[int, ...]
    columns: FloatArray  # (n, m)
    place: FloatArray  # (n,), along the artefact, m


_PLACE = 1e-7  # m: places that are nearer are one


def forms_of(
    sets: Sequence[ReadingSet], labels: Sequence[str], points: Sequence[FloatArray]
) -> dict[int, ArtefactForm]:
    """Return the shapes of the profiles, by set: all that its places can hold, in rising order."""
    by_owner: dict[str, list[int]] = {}
    for i, (reading, label) in enumerate(zip(sets, labels, strict=True)):
        if "form" in reading.unknown:
            by_owner.setdefault(reading.artefact or label, []).append(i)
    found = {}
    for owner, mine in by_owner.items():
        _require_reversal(owner, [sets[i] for i in mine])
        joined = np.concatenate([points[i] for i in mine])
        axis = int(np.argmax(np.ptp(joined, axis=0)))
        keys = np.round(joined[:, axis] / _PLACE).astype(np.int64)
        places, which = np.unique(keys, return_inverse=True)
        if places.size < 3:
            raise TooFewSamplesError(
                f"the profile of {owner} needs 3 places along it or more, its sets have {places.size}"
            )
        # discrete Legendre polynomials: a basis of whatever the places hold, smooth ones first
        scaled: FloatArray = 2.0 * (places - places[0]) / float(places[-1] - places[0]) - 1.0
        whole = np.polynomial.legendre.legvander(scaled, places.size - 1)
        basis = np.linalg.qr(whole)[0] * np.sqrt(places.size)
        basis = basis * np.sign(basis[-1])
        first = 0
        if all("offset" in sets[i].unknown for i in mine):
            first = 2 if all("slope" in sets[i].unknown for i in mine) else 1
        begin = 0
        for i in mine:
            n = points[i].shape[0]
            rows = which[begin : begin + n]
            begin += n
            orders = tuple(range(first, places.size))
            along = np.asarray(places[rows] * _PLACE, dtype=np.float64)
            found[i] = ArtefactForm(orders, np.asarray(basis[rows][:, first:]), along)
    return found


def _require_reversal(owner: str, sets: Sequence[ReadingSet]) -> None:
    """Refuse an unknown profile that was read from one side only."""
    ways = np.array([getattr(s.instrument, "direction", (0.0, 0.0, 0.0)) for s in sets])
    if not np.any(ways @ ways[0] < 0.0):
        raise DataError(
            f"{owner} was read from one side only, so its form and the error of the axis are one thing; "
            "read it reversed too (the direction turned round, the same artefact), or take its known form off the readings"
        )

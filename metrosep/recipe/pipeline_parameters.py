"""Filter and parameters of one map or profile, as recipes and the command ``measure`` ask for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.core.quantity import Quantity
    from metrosep.parameters.table import ParameterTable

__all__ = [
    "Evaluating",
    "find_parameter",
    "iso_filtered",
    "limit_values",
    "parameter_tables",
]

_INTERFEROMETRIC = ("PV", "RMS", "PVr", "PVq", "PV20")
_FORM = {"STR": "straightness", "FLT": "flatness", "RON": "roundness"}


@dataclass(frozen=True, slots=True)
class Evaluating:
    """Which parameters, and how they are evaluated."""

    names: tuple[str, ...] = ()  # symbols wanted; empty for all
    kind: str | None = None  # P, W or R; None takes what the file or the filter says, else P
    edition: str | None = None  # of the profile standard; None is the present one
    # sampling lengths; as many as there are cut-offs in a filtered profile, else 5
    sections: int | None = None
    centre: bool = False  # subtract means again
    line: str = "lsq"  # core line of the Rk and Sk family
    reference: str = "MZ"  # of form deviations


def iso_filtered(
    obj: Any,
    *,
    lambda_s: float | None,
    lambda_c: float | None,
    end: str = "moment",
    kind: str | None = None,
    sections: int | None = None,
) -> Any:
    """Return an object after the S-filter and the L-filter, both Gaussian."""
    from metrosep.filters import Band, chain, gaussian

    if lambda_s is not None and lambda_c is not None and not lambda_s < lambda_c:
        raise DataError(
            f"lambda_s = {format_length(lambda_s)} must be shorter than lambda_c = "
            f"{format_length(lambda_c)}: the S-filter takes the short waves away, the L-filter the "
            "long ones"
        )
    if lambda_s is None and lambda_c is None:
        return obj
    options: dict[str, Any] = {"end": end}
    if isinstance(obj, Surface):
        return gaussian(obj, band=Band(shortest=lambda_s, longest=lambda_c), **options)
    if lambda_c is None:
        assert lambda_s is not None  # noqa: S101  # one of them is given
        return chain.primary(obj, lambda_s=lambda_s, **options)
    if kind == "W":
        return chain.waviness(obj, lambda_c=lambda_c, lambda_s=lambda_s, **options)
    if sections is not None:
        options["sections"] = sections
    return chain.roughness(obj, lambda_c=lambda_c, lambda_s=lambda_s, **options)


def parameter_tables(obj: Surface | Profile, how: Evaluating) -> tuple[ParameterTable, ...]:
    """Return the parameters of an object, a table for each family."""
    tables = []
    for family, names in _families(obj, how.names).items():
        if family in _FORM:
            tables.append(_form_table(obj, family, names, how))
        elif family == "interferometric":
            tables.append(_interferometric(obj, names))
        elif family == "S":
            tables.append(_areal(obj, names, how))
        else:
            tables.append(_profile(obj, family, names, how))
    return tuple(tables)


def find_parameter(tables: Sequence[ParameterTable], symbol: str) -> Quantity:
    """Return a parameter by its symbol or the spelling of the other edition."""
    for table in tables:
        if symbol in table:
            return table[symbol]
        if (own := table.own_symbol(symbol)) in table.unavailable:
            raise DataError(f"no verdict on {symbol}: {table.unavailable[own]}")
    raise DataError(f"a limit is set for {symbol}, which was not measured")


def limit_values(given: Mapping[str, str], symbol: str, unit: str) -> float | None:
    """Return a limit in the unit of its parameter."""
    from metrosep.forms.catalogue import parameter_value

    text = given.get(symbol)
    return None if text is None else parameter_value(text, unit, f"the limit of {symbol}")


def _families(obj: Surface | Profile, names: Sequence[str]) -> dict[str, list[str] | None]:
    """Return the wanted symbols by family; None is all of them."""
    if not names:
        return {"interferometric": None, "S": None} if isinstance(obj, Surface) else {"": None}
    families: dict[str, list[str] | None] = {}
    for name in names:
        family = _family(obj, name)
        families.setdefault(family, [])
        known = families[family]
        if known is not None:
            known.append(name)
    return families


def _family(obj: Surface | Profile, name: str) -> str:
    if name in _INTERFEROMETRIC:
        return "interferometric"
    if name[:3] in _FORM:
        return name[:3]
    if isinstance(obj, Profile) and name in ("Mr1", "Mr2", "A1", "A2"):
        return "R"
    if isinstance(obj, Profile) and name[:1] in ("P", "W", "R"):
        return name[0]
    if isinstance(obj, Surface) and name[:1] in ("S", "V"):
        return "S"
    what = "map" if isinstance(obj, Surface) else "profile"
    raise DataError(f"a {what} has no parameter {name!r}")


def _only(table: ParameterTable, names: Sequence[str]) -> ParameterTable:
    from metrosep.parameters.table import ParameterTable

    missing = [n for n in names if n not in table and n not in table.unavailable]
    if missing:
        raise DataError(f"no parameter {', '.join(missing)} among {', '.join(table)}")
    kept = {n: table.unavailable[n] for n in names if n in table.unavailable}
    return ParameterTable(
        [table[n] for n in names if n not in kept], table.context, unavailable=kept
    )


def _form_table(
    obj: Surface | Profile, family: str, names: list[str] | None, how: Evaluating
) -> ParameterTable:
    from metrosep.parameters import form_deviation

    kind: Any = _FORM[family]
    reference: Any = how.reference
    return _only(form_deviation(obj, kind=kind, reference=reference).table, names or ())


def _interferometric(obj: Surface | Profile, names: list[str] | None) -> ParameterTable:
    from metrosep.parameters import interferometric_parameters

    if not isinstance(obj, Surface):
        raise DataError("PV, RMS, PVr and PVq are parameters of a map; ask a profile for Pt, Pq")
    return interferometric_parameters(obj, names=names)


def _areal(obj: Surface | Profile, names: list[str] | None, how: Evaluating) -> ParameterTable:
    from metrosep.parameters import areal_parameters

    if not isinstance(obj, Surface):
        raise DataError("S parameters belong to a map")
    line: Any = how.line
    return areal_parameters(obj, names=names, line=line)


def _profile(
    obj: Surface | Profile, family: str, names: list[str] | None, how: Evaluating
) -> ParameterTable:
    from metrosep.filters import profile_kind
    from metrosep.parameters import profile_parameters

    if not isinstance(obj, Profile):
        raise DataError(f"{family} parameters belong to a profile; a map has S parameters")
    if family and how.kind and family != how.kind:
        raise DataError(f"kind={how.kind!r} has no parameter {', '.join(names or ())}")
    kind: Any = family or how.kind or profile_kind(obj) or "P"
    edition = {} if how.edition is None else {"edition": how.edition}
    line: Any = how.line
    return profile_parameters(
        obj,
        kind=kind,
        sections=how.sections or _sections(obj),
        centre=how.centre,
        line=line,
        names=names,
        **edition,
    )


def _sections(profile: Profile) -> int:
    """Return how many cut-offs fit into a profile that metrosep or its file filtered, else 5."""
    from metrosep.parameters.sections import sections_that_fit

    cutoff = profile.metadata.get("lambda_c_m")
    if not isinstance(cutoff, float) or not profile.is_uniform:
        return 5
    return sections_that_fit(profile, cutoff)

"""What the commands measure and form do with one object: form off, filter, parameters, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

if TYPE_CHECKING:
    from metrosep.core.quantity import Quantity
    from metrosep.parameters.table import ParameterTable

__all__ = ["Evaluation", "Limits", "Settings", "evaluate"]

_INTERFEROMETRIC = ("PV", "RMS", "PVr", "PVq", "PV20")
_FORM = {"STR": "straightness", "FLT": "flatness", "RON": "roundness"}


@dataclass(frozen=True, slots=True)
class Settings:
    """How objects are evaluated; lengths in SI.

    Parameters
    ----------
    form : str
        Text of the form that is removed first, or "none".
    lambda_s, lambda_c : float or None
        Cut-offs (profile) or nesting indices (surface) of the S- and L-filter.
    end : str
        End rule of the filters.
    kind : str or None
        P, W or R; None takes what the file or the filter says, else P.
    edition : str or None
        Of the profile standard; None is the present one.
    sections : int
        Sampling lengths.
    centre : bool
        Subtract means again.
    line : str
        Core line of the Rk family.
    names : tuple of str
        Symbols wanted; empty for all.
    reference : str
        Of form deviations.
    """

    form: str = "none"
    lambda_s: float | None = None
    lambda_c: float | None = None
    end: str = "moment"
    kind: str | None = None
    edition: str | None = None
    sections: int = 5
    centre: bool = False
    line: str = "lsq"
    names: tuple[str, ...] = ()
    reference: str = "MZ"


@dataclass(frozen=True, slots=True)
class Limits:
    """Tolerances and expanded uncertainties by symbol, in the unit of the parameter.

    Parameters
    ----------
    lower, upper, U : dict of str to str
        As typed; parsed with the unit of each parameter.
    guard_factor : float
        Guard band over U.
    """

    lower: dict[str, str] = field(default_factory=dict)
    upper: dict[str, str] = field(default_factory=dict)
    U: dict[str, str] = field(default_factory=dict)
    guard_factor: float = 1.0


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Parameters of one object, and the verdicts on them.

    Parameters
    ----------
    tables : tuple of ParameterTable
        One per family.
    verdicts : dict of str to dict
        By symbol: verdict, lower, upper, U.
    removed : str
        What was fitted and removed, in words; empty if nothing.
    """

    tables: tuple[ParameterTable, ...]
    verdicts: dict[str, dict[str, Any]]
    removed: str = ""

    @property
    def quantities(self) -> dict[str, Quantity]:
        """All parameters by symbol."""
        return {s: t[s] for t in self.tables for s in t}

    @property
    def verdict(self) -> Any:
        """The worst verdict, None without limits."""
        from metrosep.parameters.decision import worst

        return worst([v["verdict"] for v in self.verdicts.values()])


def evaluate(obj: Any, settings: Settings, limits: Limits) -> Evaluation:
    """Return the parameters of an object after form removal and filters.

    Parameters
    ----------
    obj : Surface or Profile
        As read.
    settings : Settings
        What to do.
    limits : Limits
        What to judge.

    Returns
    -------
    Evaluation
        Tables and verdicts.

    Raises
    ------
    InvalidSamplesError
        If the object is neither a profile nor a map.
    DataError
        If the object has no such parameter, or a limit names none.
    """
    if not isinstance(obj, Surface | Profile):
        raise InvalidSamplesError(
            f"parameters need a profile or a map, and this file holds a {type(obj).__name__}; "
            "name a channel, or separate it first"
        )
    removed = ""
    if settings.form.strip().lower() != "none":
        from metrosep.forms.catalogue import form_from_text
        from metrosep.forms.fit import fit

        result = fit(obj, form_from_text(settings.form))
        removed, obj = result.report(), result.residual
    obj = _filtered(obj, settings)
    tables = tuple(_tables(obj, settings))
    return Evaluation(tables, _verdicts(tables, limits), removed)


def _filtered(obj: Any, settings: Settings) -> Any:
    from metrosep.filters import chain, gaussian

    if settings.lambda_s is None and settings.lambda_c is None:
        return obj
    options: dict[str, Any] = {"end": settings.end}
    if isinstance(obj, Surface):
        if settings.lambda_s is not None:
            obj = gaussian(obj, nesting_index=settings.lambda_s, band="long", **options)
        if settings.lambda_c is not None:
            obj = gaussian(obj, nesting_index=settings.lambda_c, band="short", **options)
        return obj
    if settings.lambda_s is not None:
        obj = chain.primary(obj, lambda_s=settings.lambda_s, **options)
    if settings.lambda_c is None:
        return obj
    part = chain.waviness if settings.kind == "W" else chain.roughness
    return part(obj, lambda_c=settings.lambda_c, **options)


def _tables(obj: Surface | Profile, settings: Settings) -> list[ParameterTable]:
    families = _families(obj, settings.names)
    tables = []
    for family, names in families.items():
        if family in _FORM:
            tables.append(_form_table(obj, family, names, settings))
        elif family == "interferometric":
            tables.append(_interferometric(obj, names))
        elif family == "S":
            tables.append(_areal(obj, names, settings))
        else:
            tables.append(_profile(obj, family, names, settings))
    return tables


def _families(obj: Surface | Profile, names: Sequence[str]) -> dict[str, list[str] | None]:
    """Return the wanted symbols by family; None is all of them."""
    if not names:
        return {"interferometric": None, "S": None} if isinstance(obj, Surface) else {"": None}
    families: dict[str, list[str] | None] = {}
    for name in names:
        if name in _INTERFEROMETRIC:
            family = "interferometric"
        elif name[:3] in _FORM:
            family = name[:3]
        elif isinstance(obj, Profile) and name[:1] in ("P", "W", "R"):
            family = name[0]
        elif isinstance(obj, Surface) and name[:1] in ("S", "V"):
            family = "S"
        else:
            what = "map" if isinstance(obj, Surface) else "profile"
            raise DataError(f"a {what} has no parameter {name!r}")
        families.setdefault(family, [])
        known = families[family]
        if known is not None:
            known.append(name)
    return families


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
    obj: Surface | Profile, family: str, names: list[str] | None, settings: Settings
) -> ParameterTable:
    from metrosep.parameters import form_deviation

    kind: Any = _FORM[family]
    reference: Any = settings.reference
    return _only(form_deviation(obj, kind=kind, reference=reference).table, names or ())


def _interferometric(obj: Surface | Profile, names: list[str] | None) -> ParameterTable:
    from metrosep.parameters import interferometric_parameters

    if not isinstance(obj, Surface):
        raise DataError("PV, RMS, PVr and PVq are parameters of a map; ask a profile for Pt, Pq")
    return interferometric_parameters(obj, names=names)


def _areal(obj: Surface | Profile, names: list[str] | None, settings: Settings) -> ParameterTable:
    from metrosep.parameters import areal_parameters

    if not isinstance(obj, Surface):
        raise DataError("S parameters belong to a map")
    line: Any = settings.line
    return areal_parameters(obj, names=names, line=line)


def _profile(
    obj: Surface | Profile, family: str, names: list[str] | None, settings: Settings
) -> ParameterTable:
    from metrosep.filters import profile_kind
    from metrosep.parameters import profile_parameters

    if not isinstance(obj, Profile):
        raise DataError(f"{family} parameters belong to a profile; a map has S parameters")
    kind: Any = family or settings.kind or profile_kind(obj) or "P"
    edition = {} if settings.edition is None else {"edition": settings.edition}
    line: Any = settings.line
    return profile_parameters(
        obj,
        kind=kind,
        sections=settings.sections,
        centre=settings.centre,
        line=line,
        names=names,
        **edition,
    )


def _verdicts(tables: Sequence[ParameterTable], limits: Limits) -> dict[str, dict[str, Any]]:
    from metrosep.forms.catalogue import parameter_value
    from metrosep.parameters.decision import decide

    found = {s: t[s] for t in tables for s in t}
    verdicts: dict[str, dict[str, Any]] = {}
    for symbol in {**limits.lower, **limits.upper}:
        if symbol not in found:
            raise DataError(f"a limit is set for {symbol}, which was not measured")
        quantity = found[symbol]

        def number(given: dict[str, str], symbol: str = symbol, unit: str = quantity.unit) -> Any:
            text = given.get(symbol)
            return None if text is None else parameter_value(text, unit, f"the limit of {symbol}")

        U = number(limits.U)
        if U is None and quantity.u is not None:
            U = 2.0 * quantity.u
        if U is None:
            raise DataError(
                f"the uncertainty of {symbol} is not known; state it: --U '{symbol}=1 nm', or "
                f"--U '{symbol}=0 nm' for simple acceptance"
            )
        lower, upper = number(limits.lower), number(limits.upper)
        verdict = decide(
            quantity.value, lower=lower, upper=upper, U=U, guard_factor=limits.guard_factor
        )
        verdicts[symbol] = {"verdict": verdict, "lower": lower, "upper": upper, "U": U}
    return verdicts

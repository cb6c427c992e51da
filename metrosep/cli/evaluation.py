"""What the commands measure and form do with one object: form off, filter, parameters, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

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
    sections : int or None
        Sampling lengths; as many as there are cut-offs in a filtered profile, else 5.
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
    sections: int | None = None
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
    _check_applies(obj, settings)
    removed = ""
    if settings.form.strip().lower() != "none":
        from metrosep.forms.catalogue import form_from_text
        from metrosep.forms.fit import fit

        result = fit(obj, form_from_text(settings.form))
        removed, obj = result.report(), result.residual
    obj = _filtered(obj, settings)
    tables = tuple(_tables(obj, settings))
    return Evaluation(tables, _verdicts(tables, limits), removed)


def _check_applies(obj: Surface | Profile, settings: Settings) -> None:
    """Refuse what would be ignored."""
    if settings.end != "moment" and settings.lambda_s is None and settings.lambda_c is None:
        raise DataError("--end says what a filter does at the ends; give --lambda-s or --lambda-c")
    if isinstance(obj, Surface):
        given = {
            "--kind": settings.kind,
            "--edition": settings.edition,
            "--sections": settings.sections,
            "--centre": settings.centre or None,
        }
        stray = [k for k, v in given.items() if v is not None]
        if stray:
            raise DataError(f"{', '.join(stray)} belongs to profiles, and this file holds a map")


def _filtered(obj: Any, settings: Settings) -> Any:
    from metrosep.filters import Band, chain, gaussian

    short, long = settings.lambda_s, settings.lambda_c
    if short is not None and long is not None and not short < long:
        raise DataError(
            f"lambda_s = {format_length(short)} must be shorter than lambda_c = "
            f"{format_length(long)}: the S-filter takes the short waves away, the L-filter the "
            "long ones"
        )
    if short is None and long is None:
        return obj
    options: dict[str, Any] = {"end": settings.end}
    if isinstance(obj, Surface):
        return gaussian(obj, band=Band(shortest=short, longest=long), **options)
    if long is None:
        assert short is not None  # noqa: S101  # one of them is given
        return chain.primary(obj, lambda_s=short, **options)
    if settings.kind == "W":
        return chain.waviness(obj, lambda_c=long, lambda_s=short, **options)
    if settings.sections is not None:
        options["sections"] = settings.sections
    return chain.roughness(obj, lambda_c=long, lambda_s=short, **options)


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
        elif isinstance(obj, Profile) and name in ("Mr1", "Mr2", "A1", "A2"):
            family = "R"
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
    if family and settings.kind and family != settings.kind:
        raise DataError(f"--kind {settings.kind} has no parameter {', '.join(names or ())}")
    kind: Any = family or settings.kind or profile_kind(obj) or "P"
    edition = {} if settings.edition is None else {"edition": settings.edition}
    line: Any = settings.line
    return profile_parameters(
        obj,
        kind=kind,
        sections=settings.sections or _sections(obj),
        centre=settings.centre,
        line=line,
        names=names,
        **edition,
    )


def _find(tables: Sequence[ParameterTable], symbol: str) -> Quantity:
    """Return a parameter by its symbol or the spelling of the other edition."""
    for table in tables:
        if symbol in table:
            return table[symbol]
        if (own := table.own_symbol(symbol)) in table.unavailable:
            raise DataError(f"no verdict on {symbol}: {table.unavailable[own]}")
    raise DataError(f"a limit is set for {symbol}, which was not measured")


def _sections(profile: Profile) -> int:
    """Return how many cut-offs fit into a profile that metrosep or its file filtered, else 5."""
    from metrosep.parameters.sections import sections_that_fit

    cutoff = profile.metadata.get("lambda_c_m")
    if not isinstance(cutoff, float) or not profile.is_uniform:
        return 5
    return sections_that_fit(profile, cutoff)


def _verdicts(tables: Sequence[ParameterTable], limits: Limits) -> dict[str, dict[str, Any]]:
    from metrosep.forms.catalogue import parameter_value
    from metrosep.parameters.decision import decide

    verdicts: dict[str, dict[str, Any]] = {}
    asked = {**limits.lower, **limits.upper}
    idle = [s for s in limits.U if s not in asked]
    if idle:
        raise DataError(f"--U is given for {', '.join(idle)}, which has no limit")
    for symbol in asked:
        quantity = _find(tables, symbol)

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
        verdicts[quantity.symbol] = {"verdict": verdict, "lower": lower, "upper": upper, "U": U}
    return verdicts

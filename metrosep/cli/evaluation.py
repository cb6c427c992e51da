"""What the commands measure and form do with one object: form off, filter, parameters, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.recipe.pipeline_checks import (
    Evaluating,
    find_parameter,
    iso_filtered,
    limit_values,
    parameter_tables,
)

if TYPE_CHECKING:
    from metrosep.core.quantity import Quantity
    from metrosep.parameters.table import ParameterTable

__all__ = ["Evaluation", "Limits", "Settings", "evaluate"]

_EXAMPLES = {"m": ("1 nm", "0 nm"), "": ("0.001", "0"), "1": ("0.001", "0")}
"""Of an uncertainty and of none, by the unit of the parameter."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How objects are evaluated; lengths in SI."""

    form: str = "none"  # text of the form that is removed first, or "none"
    # cut-offs (profile) or nesting indices (surface) of the S- and L-filter
    lambda_s: float | None = None
    lambda_c: float | None = None
    end: str = "moment"  # end rule of the filters
    kind: str | None = None  # P, W or R; None takes what the file or the filter says, else P
    edition: str | None = None  # of the profile standard; None is the present one
    # sampling lengths; as many as there are cut-offs in a filtered profile, else 5
    sections: int | None = None
    centre: bool = False  # subtract means again
    line: str = "lsq"  # core line of the Rk family
    names: tuple[str, ...] = ()  # symbols wanted; empty for all
    reference: str = "MZ"  # of form deviations

    @property
    def evaluating(self) -> Evaluating:
        """What the parameters need of it."""
        return Evaluating(
            names=self.names,
            kind=self.kind,
            edition=self.edition,
            sections=self.sections,
            centre=self.centre,
            line=self.line,
            reference=self.reference,
        )


@dataclass(frozen=True, slots=True)
class Limits:
    """Tolerances and expanded uncertainties by symbol, in the unit of the parameter."""

    # to str: as typed; parsed with the unit of each parameter
    lower: dict[str, str] = field(default_factory=dict)
    upper: dict[str, str] = field(default_factory=dict)
    U: dict[str, str] = field(default_factory=dict)
    guard_factor: float = 1.0  # guard band over U


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Parameters of one object, and the verdicts on them."""

    tables: tuple[ParameterTable, ...]  # one per family
    verdicts: dict[str, dict[str, Any]]  # to dict: by symbol: verdict, lower, upper, U
    removed: str = ""  # what was fitted and removed, in words; empty if nothing

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
    """Return the parameters of an object after form removal and filters."""
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
    obj = iso_filtered(
        obj,
        lambda_s=settings.lambda_s,
        lambda_c=settings.lambda_c,
        end=settings.end,
        kind=settings.kind,
        sections=settings.sections,
    )
    tables = parameter_tables(obj, settings.evaluating)
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


def _verdicts(tables: Sequence[ParameterTable], limits: Limits) -> dict[str, dict[str, Any]]:
    from metrosep.parameters.decision import decide

    verdicts: dict[str, dict[str, Any]] = {}
    asked = {**limits.lower, **limits.upper}
    idle = [s for s in limits.U if s not in asked]
    if idle:
        raise DataError(f"--U is given for {', '.join(idle)}, which has no limit")
    for symbol in asked:
        quantity = find_parameter(tables, symbol)
        lower, upper, U = (
            limit_values(given, symbol, quantity.unit)
            for given in (limits.lower, limits.upper, limits.U)
        )
        if U is None and quantity.u is not None:
            U = 2.0 * quantity.u
        if U is None:
            some, none = _EXAMPLES.get(quantity.unit, ("0.001 SI", "0 SI"))
            raise DataError(
                f"the uncertainty of {symbol} is not known; state it: --U '{symbol}={some}', or "
                f"--U '{symbol}={none}' for simple acceptance"
            )
        verdict = decide(
            quantity.value, lower=lower, upper=upper, U=U, guard_factor=limits.guard_factor
        )
        verdicts[quantity.symbol] = {"verdict": verdict, "lower": lower, "upper": upper, "U": U}
    return verdicts

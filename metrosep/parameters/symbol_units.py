"""The SI unit of each parameter by its symbol, known without data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from types import MappingProxyType

from metrosep.core.errors import DataError
from metrosep.core.limits import FORM_OF_SYMBOL
from metrosep.core.readable import nearest
from metrosep.parameters.arguments import AREAL, PROFILE, Call, call_of, is_call


def unit_of_symbol(symbol: str) -> str | None:
    """Return the SI unit of a parameter of profiles or maps.

    Examples
    --------
    >>> unit_of_symbol("Sa"), unit_of_symbol("Sku"), unit_of_symbol("Spd"), unit_of_symbol("Xyz")
    ('m', '1', '1/m^2', None)
    """
    if is_call(symbol):
        try:
            return _call(symbol).function.unit
        except DataError:
            return None
    return "m" if symbol[:3] in FORM_OF_SYMBOL and len(symbol) > 3 else _units().get(symbol)


def is_of_all(symbol: str) -> bool:
    """Return whether ``names = "all"`` asks for a parameter: deviations of form are asked for by name.

    Examples
    --------
    >>> is_of_all("Sku"), is_of_all("FLTt"), is_of_all("Xyz")
    (True, False, False)
    """
    return (
        symbol[:3] not in FORM_OF_SYMBOL
        and not is_call(symbol)
        and unit_of_symbol(symbol) is not None
    )


def beside_all(symbol: str, known: Sequence[str]) -> tuple[str, str]:
    """Return what is meant by a symbol that ``names = "all"`` does not give, or nothing; and why it does not.

    Examples
    --------
    >>> beside_all("Saq", ()), beside_all("FLTt", ())[1]
    (('Sq', 'there are all parameters'), '"all" has no parameters with arguments and no deviations of form: name it')
    """
    if unit_of_symbol(symbol) is not None:
        return "", '"all" has no parameters with arguments and no deviations of form: name it'
    offered = [*known, *(s for s in _units() if is_of_all(s))]
    return nearest(symbol, offered, 0.4), f"there are {', '.join([*known, 'all parameters'])}"


def wrong_call(names: Iterable[str]) -> str | None:
    """Return what is wrong with the first of some names whose arguments cannot be read.

    Examples
    --------
    >>> wrong_call(["Sq", "Smr(120 %, 1 um)"])
    'Smr(120 %, 1 um): a material ratio lies between 0 % and 100 %, got 120 %'
    """
    for name in filter(is_call, names):
        try:
            _call(name)
        except DataError as exc:
            return str(exc)
    return None


def current_symbol(name: str) -> str:
    """Return the symbol of 2021 for one that the edition before spells otherwise, else the name itself.

    Examples
    --------
    >>> current_symbol("Smr1"), current_symbol("Smrk1"), current_symbol("a name")
    ('Smrk1', 'Smrk1', 'a name')
    """
    from metrosep.parameters.areal import EDITION, _named

    return _named(name, EDITION, name)


def same_parameter(one: str, other: str) -> bool:
    """Return whether two symbols are spellings of one parameter.

    Examples
    --------
    >>> same_parameter("RSm", "Rsm"), same_parameter("Smrk1", "Smr1"), same_parameter("Sa", "Sq")
    (True, True, False)
    """
    from metrosep.parameters.areal import _ALIASES
    from metrosep.parameters.profile import _plain

    if is_call(one) or is_call(other):
        return _one_spelling(one) == _one_spelling(other)
    if _ALIASES.get(one, one) == _ALIASES.get(other, other):
        return True
    return any(_plain(one, kind) == _plain(other, kind) for kind in "PWR")


def _call(name: str) -> Call:
    """Return what a name with arguments means, of a map or of any kind of profile."""
    if name.lstrip().startswith(("S", "V")):
        return call_of(name, AREAL)
    from metrosep.parameters.profile import _renamed

    name = _renamed(name.lstrip(), "R")
    return call_of(name, PROFILE, name[0] if name[0] in "PW" else "R")


def _one_spelling(name: str) -> str:
    try:
        return _call(name).name if is_call(name) else name
    except DataError:
        return name


@cache
def _units() -> Mapping[str, str]:
    from metrosep.parameters._profile_rows import ASME, NEW, OLD, ROWS
    from metrosep.parameters.areal import _ALIASES, _ROWS as AREAL
    from metrosep.parameters.interferometric import _ROWS as INTERFEROMETRIC

    found = {row.symbol: row.unit for row in (*AREAL, *INTERFEROMETRIC)}
    found |= {old: found[new] for new, old in _ALIASES.items()}
    for edition in (OLD, NEW, ASME):
        for row in ROWS:
            if row.name(edition) is not None:
                found |= {row.symbol(kind, edition): row.unit for kind in ("P", "W", "R")}
    return MappingProxyType(found)

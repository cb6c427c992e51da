"""Type F1 software gauges (ISO 5436-2): profile and expected values in one file, compared.

The ``.smd`` file holds a primary profile, form-free and lambda_s filtered, and lines
``PARAMETER_VALUE symbol value unit uncertainty``. The word after the value is the unit where it is
no number or exactly ``1``; any other number there is the uncertainty of a pure number. P parameters are taken from the profile as it
is; R and W ones after a Gaussian filter with the lambda_c of the file's ``PROFILE_FILTER`` line or
of the caller.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from metrosep.core.errors import DataError, MetrosepError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.units import parse_unit
from metrosep.filters.kind import ProfileKind
from metrosep.parameters._profile_rows import named_edition
from metrosep.parameters.sections import sections_that_fit
from metrosep.spectral._checks import finite_number, instance_of, whole_number

__all__ = ["Expectation", "GaugeRow", "GaugeSettings", "expectations", "verify_softgauge"]

_SYMBOL = re.compile(r"[A-Za-z][\w()]*")
_LENGTH = r"([-+.\dEe]+)\s*([^\s\d.]\w*)"
_FILTER = re.compile(r"^PROFILE_FILTER\s+(?P<name>\w+)(?P<rest>.*)$", re.IGNORECASE)
_PURE = {"1": 1.0, "-": 1.0, "none": 1.0, "%": 0.01}
_DIMENSIONS = {"m": "length", "1": "number", "rad": "angle"}


@dataclass(frozen=True, slots=True)
class Expectation:
    """A value that a software gauge expects.

    Parameters
    ----------
    symbol : str
        Such as ``"Ra"``.
    value : float
        In SI.
    half_digit : float
        Half of the last printed digit, in SI.
    u : float or None
        Uncertainty as printed, in SI; None where it is not given or zero.
    printed : str
        Value and unit as the file has them.
    dimension : str, optional
        Of the unit: ``"length"``, ``"number"``, ``"angle"``, ...; empty where it is not known.
    """

    symbol: str
    value: float
    half_digit: float
    u: float | None
    printed: str
    dimension: str = ""


@dataclass(frozen=True, slots=True)
class GaugeSettings:
    """What the file says about the evaluation.

    Parameters
    ----------
    lambda_c, lambda_s : float or None, m
        Cut-offs; None where they are not given.
    """

    lambda_c: float | None = None
    lambda_s: float | None = None


@dataclass(frozen=True, slots=True)
class GaugeRow:
    """One comparison.

    Parameters
    ----------
    expected : Expectation
        From the file.
    computed : float
        In SI; NaN where it could not be worked out.
    unit : str
        SI unit.
    tolerance : float
        Half of the last printed digit, and the printed uncertainty where there is one.
    reason : str
        Why nothing was computed; empty otherwise.
    """

    expected: Expectation
    computed: float
    unit: str
    tolerance: float
    reason: str = ""

    @property
    def deviation(self) -> float:
        """Computed minus expected, in SI."""
        return self.computed - self.expected.value

    @property
    def agrees(self) -> bool | None:
        """Whether the deviation is within the tolerance; None where nothing was computed."""
        if math.isnan(self.computed):
            return None
        return abs(self.deviation) <= self.tolerance

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON.

        Returns
        -------
        dict
            Keys ``symbol``, ``expected``, ``computed``, ``deviation``, ``tolerance``, ``unit``,
            ``printed``, ``agrees``, ``reason``.
        """
        missing = math.isnan(self.computed)
        return {
            "symbol": self.expected.symbol,
            "expected": self.expected.value,
            "computed": None if missing else self.computed,
            "deviation": None if missing else self.deviation,
            "tolerance": self.tolerance,
            "unit": self.unit,
            "printed": self.expected.printed,
            "agrees": self.agrees,
            "reason": self.reason,
        }


def expectations(lines: Iterable[str]) -> tuple[tuple[Expectation, ...], GaugeSettings]:
    """Return the expected values and settings that record 2 of an ``.smd`` file states.

    Parameters
    ----------
    lines : iterable of str
        Of record 2.

    Returns
    -------
    expected : tuple of Expectation
        In the order of the file.
    settings : GaugeSettings
        Cut-offs.

    Raises
    ------
    DataError
        If a line of this kind cannot be understood, or a symbol stands twice.

    Examples
    --------
    >>> expected, _ = expectations(["PARAMETER_VALUE Ra 0.4213 um 0.0002"])
    >>> round(expected[0].value, 10), round(expected[0].u, 11)
    (4.213e-07, 2e-10)
    """
    found: list[Expectation] = []
    settings = GaugeSettings()
    for line in lines:
        text = line.strip()
        if text.upper().startswith("PARAMETER_VALUE"):
            found.append(_expectation(text))
        elif match := _FILTER.match(text):
            settings = _settings(match)
    symbols = [e.symbol for e in found]
    twice = sorted({s for s in symbols if symbols.count(s) > 1})
    if twice:
        raise DataError(f"the file expects two values of {', '.join(twice)}; keep one of them")
    return tuple(found), settings


def verify_softgauge(
    profile: Profile,
    *,
    lambda_c: float | None = None,
    kind: ProfileKind = "P",
    edition: str = "ISO 4287:1997",
    sections: int | None = None,
    centre: bool = False,
    line: str = "lsq",
    relative_tolerance: float = 0.0,
) -> tuple[GaugeRow, ...]:
    """Return the comparison of computed with expected parameters of a software gauge.

    Parameters
    ----------
    profile : Profile
        As read from an ``.smd`` file: record 2 in ``metadata["header"]["information"]``.
    lambda_c : float, optional, m
        Cut-off for R and W parameters; that of the file if omitted.
    kind : {"P", "W", "R"}, optional
        What the profile in the file is; "R" or "W": it is filtered already.
    edition : str, optional
        Of the definitions.
    sections : int, optional
        Sampling lengths; as many cut-offs as fit into the evaluation length if omitted.
    centre : bool, optional
        As in `profile_parameters`.
    line : {"lsq", "secant"}, optional
        Core line of the Rk family.
    relative_tolerance : float, optional
        Added to the tolerance, as a share of the expected value.

    Returns
    -------
    tuple of GaugeRow
        One per expected value. A parameter that metrosep does not have, cannot give for this
        profile (no cut-off, filtered already), or that the file gives in a unit of another
        dimension, stands there with the reason.

    Raises
    ------
    DataError
        If the file expects no value, a line cannot be understood, or an option is unknown or out
        of range.

    Notes
    -----
    The ends are cut by one cut-off at each side for R and W (run-in and run-out), as instruments
    do. A value agrees when it is within half of its last printed digit plus the printed
    uncertainty.

    References
    ----------
    .. [1] ISO 5436-2:2012, type F1 (layout of the lines as recalled in the file's description).
    """
    instance_of(profile, Profile, "a software gauge")
    _check_options(kind, edition, sections, line, relative_tolerance)
    header = profile.metadata.get("header")
    lines: Sequence[str] = header.get("information", ()) if isinstance(header, Mapping) else ()
    expected, settings = expectations(lines)
    if not expected:
        raise DataError(
            "the file expects nothing: it has no line PARAMETER_VALUE; a software gauge of type F1 "
            "states its values in record 2"
        )
    cutoff = lambda_c if lambda_c is not None else settings.lambda_c
    tables: dict[str, Any] = {}
    rows = []
    for item in expected:
        letter = item.symbol[0]
        if letter not in tables:
            tables[letter] = _table(
                profile,
                letter,
                cutoff,
                kind,
                edition=edition,
                sections=sections,
                centre=centre,
                line=line,
            )
        rows.append(_row(item, tables[letter], relative_tolerance))
    return tuple(rows)


def _expectation(text: str) -> Expectation:
    words = text.split()[1:]
    if len(words) < 2 or _SYMBOL.fullmatch(words[0]) is None:
        raise DataError(f"expected PARAMETER_VALUE symbol value unit uncertainty, found {text!r}")
    symbol, number, rest = words[0], words[1], words[2:]
    try:
        printed = Decimal(number)
    except InvalidOperation:
        raise DataError(f"the value in {text!r} is no number") from None
    if not printed.is_finite():
        raise DataError(f"the value in {text!r} is not finite")
    # "Psk 0.0888 1" states the unit of a pure number, "Psk 0.0888 0.01" its uncertainty
    stated = rest.pop(0) if rest and (rest[0] == "1" or not _is_number(rest[0])) else ""
    if len(rest) > 1:
        raise DataError(f"expected PARAMETER_VALUE symbol value unit uncertainty, found {text!r}")
    factor, dimension = _unit(stated or "1", text)
    u = abs(_uncertainty(rest[0], text)) * factor if rest else 0.0
    half = 0.5 * 10.0 ** int(printed.as_tuple().exponent)
    return Expectation(
        symbol=symbol,
        value=float(printed) * factor,
        half_digit=half * factor,
        u=u or None,
        printed=f"{number} {stated}".strip(),
        dimension=dimension,
    )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _uncertainty(word: str, text: str) -> float:
    u = float(word) if _is_number(word) else math.nan
    if not math.isfinite(u):
        raise DataError(f"the uncertainty {word!r} in {text!r} is no finite number")
    return u


def _unit(unit: str, text: str) -> tuple[float, str]:
    """Return factor to SI and dimension of a unit."""
    if unit.lower() in _PURE:
        return _PURE[unit.lower()], "number"
    try:
        found = parse_unit(unit)
    except UnitError as error:
        raise DataError(f"the unit in {text!r} is not known: {error}") from None
    return found.factor, found.dimension


def _cutoff(number: str, unit: str, text: str) -> float:
    factor, dimension = _unit(unit, text)
    if not _is_number(number) or dimension != "length":
        raise DataError(f"the cut-off {number} {unit} in {text!r} is no length")
    return float(number) * factor


def _settings(match: re.Match[str]) -> GaugeSettings:
    found: dict[str, float] = {}
    for key in ("LC", "LS"):
        part = re.search(rf"\b{key}\s*=?\s*{_LENGTH}", match["rest"], re.IGNORECASE)
        if part is not None:
            found[key] = _cutoff(part[1], part[2], match[0])
    if "gauss" not in match["name"].lower():
        raise DataError(f"the file asks for the filter {match['name']}; only Gaussian is defined")
    return GaugeSettings(lambda_c=found.get("LC"), lambda_s=found.get("LS"))


def _table(
    profile: Profile,
    letter: str,
    cutoff: float | None,
    kind: ProfileKind,
    *,
    edition: str,
    sections: int | None,
    centre: bool,
    line: str,
) -> Any:
    """Return the parameters of one kind, or the error that stands in their way."""
    from metrosep.filters.chain import roughness, waviness
    from metrosep.parameters.profile import profile_parameters

    if letter not in ("P", "W", "R"):
        return DataError(f"metrosep knows parameters of P, W and R profiles, not of {letter}")
    wanted: ProfileKind = letter  # type: ignore[assignment]
    try:
        if kind not in ("P", wanted):
            raise DataError(
                f"the profile was declared {kind}, filtered already: it has no {wanted} parameters"
            )
        used = profile
        if wanted != kind:
            if cutoff is None:
                raise DataError("the file names no cut-off (PROFILE_FILTER ... LC); give lambda_c")
            chain = roughness if wanted == "R" else waviness
            used = chain(profile, lambda_c=cutoff, end="cut")
        n = sections or (1 if wanted == "P" or cutoff is None else sections_that_fit(used, cutoff))
        return profile_parameters(
            used,
            kind=wanted,
            edition=edition,
            sections=n,
            centre=centre,
            line=line,  # type: ignore[arg-type]
        )
    except MetrosepError as error:
        return error


def _row(item: Expectation, table: Any, relative_tolerance: float) -> GaugeRow:
    tolerance = item.half_digit + (item.u or 0.0) + relative_tolerance * abs(item.value)
    if isinstance(table, MetrosepError):
        return GaugeRow(item, math.nan, "", tolerance, str(table))
    try:
        quantity = table[item.symbol]
    except (KeyError, DataError) as error:
        return GaugeRow(item, math.nan, "", tolerance, str(error.args[0]))
    needed = _DIMENSIONS.get(quantity.unit, quantity.unit)
    if item.dimension not in ("", needed):
        unit = item.printed.partition(" ")[2] or "1"
        reason = (
            f"the file gives it in {unit}, a {item.dimension}, but {item.symbol} is a {needed}"
        )
        return GaugeRow(item, math.nan, "", tolerance, reason)
    return GaugeRow(item, float(quantity.value), quantity.unit, tolerance)


def _check_options(
    kind: str, edition: str, sections: object, line: str, relative_tolerance: object
) -> None:
    """Refuse at the call what would else stand as a reason in every row."""
    named_edition(edition)
    if kind not in ("P", "W", "R"):
        raise DataError(f'kind is "P", "W" or "R", got {kind!r}')
    if line not in ("lsq", "secant"):
        raise DataError(f'line is "lsq" or "secant", got {line!r}')
    if sections is not None:
        whole_number(sections, "sections")
    if finite_number(relative_tolerance, "relative_tolerance") < 0.0:
        raise DataError(f"relative_tolerance must not be negative, got {relative_tolerance}")

"""Type F1 software gauges (ISO 5436-2): profile and expected values in one file, compared.

The ``.smd`` file holds a primary profile, form-free and lambda_s filtered, and the expected values.
P parameters are taken from the profile as it is; R and W ones after a Gaussian filter with the
lambda_c of the file's ``PROFILE_FILTER`` lines or of the caller. A damaged file proves nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any, Literal

from metrosep.core.errors import DataError, MetrosepError, UnitError
from metrosep.core.numbers import choice, count, flag, not_negative, positive
from metrosep.core.profile import Profile
from metrosep.core.readable import nearest
from metrosep.core.surface import Surface
from metrosep.core.units import format_engineering, parse_unit
from metrosep.filters._arguments import ProfileKind
from metrosep.parameters._profile_rows import named_edition
from metrosep.parameters.sections import sections_that_fit
from metrosep.spectral.dft import instance_of

_DIMENSIONS = {"m": "length", "1": "number", "rad": "angle"}
_ANEW = "take the file anew from its publisher"


@dataclass(frozen=True, slots=True)
class GaugeRow:
    """One comparison.

    Parameters
    ----------
    expected : Expectation
        From the file.
    computed : float
        In SI; NaN where it was not compared.
    unit : str
        SI unit.
    tolerance : float
        Half of the last printed digit, and the printed uncertainty where there is one.
    reason : str
        Why nothing was compared; empty otherwise.
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
        """Whether the deviation is within the tolerance; None where nothing was compared."""
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


@dataclass(frozen=True, slots=True)
class GaugeResult:
    """What a software gauge proves; a sequence of its rows.

    Parameters
    ----------
    rows : tuple of GaugeRow
        One per expected value.
    damage : tuple of str, optional
        Why the file proves nothing at all: gaps.
    unread : tuple of str, optional
        Lines that seem to state a value and were not taken.
    reader_warnings : tuple of str, optional
        What the reader warned of, such as a wrong checksum: reported with any result. Publishers sum
        in more than one way, so it alone decides nothing; values that all agree outweigh it.
    """

    rows: tuple[GaugeRow, ...]
    damage: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    reader_warnings: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[GaugeRow]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: int) -> GaugeRow:
        return self.rows[index]

    @property
    def n_agree(self) -> int:
        """Number of values that agree."""
        return sum(r.agrees is True for r in self.rows)

    @property
    def result(self) -> Literal["verified", "differs", "not verified"]:
        """Verified: all agree; differs: one does not; not verified: neither can be said."""
        if not self.damage and any(r.agrees is False for r in self.rows):
            return "differs"
        left = self.damage or self.unread or self._missing or not self.rows
        return "not verified" if left else "verified"

    @property
    def _missing(self) -> list[str]:
        return [r.expected.symbol for r in self.rows if r.agrees is None]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the file is not verified, or is only in part, and what is uncertain; else empty."""
        missing = self._missing
        n = f"{len(missing)} of {len(self.rows)} values were not compared: {', '.join(missing)}"
        return (*self.reader_warnings, *self.damage, *self.unread, *((n,) if missing else ()))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON.

        Returns
        -------
        dict
            Keys ``result``, ``reasons``, ``rows``.
        """
        return {
            "result": self.result,
            "reasons": list(self.reasons),
            "rows": [r.to_dict() for r in self.rows],
        }


def verify_softgauge(
    profile: Profile | Surface,
    *,
    expected: Mapping[str, str] | None = None,
    lambda_c: float | None = None,
    kind: ProfileKind = "P",
    edition: str = "ISO 4287:1997",
    sections: int | None = None,
    centre: bool = False,
    line: str = "lsq",
    relative_tolerance: float = 0.0,
) -> GaugeResult:
    """Return the comparison of computed with expected parameters of a software gauge.

    Parameters
    ----------
    profile : Profile or Surface
        As read from an ``.smd`` file: record 2 in ``metadata["header"]["information"]``. Or a map,
        as the publishers of areal gauges give it in SDF (ISO 25178-71), form-free and filtered.
    expected : mapping of str to str, optional
        Symbol to value with unit and uncertainty as printed, ``{"Sa": "0.4213 um 0.0002"}``, in
        place of those of the file; of a map they stand in another file, so it needs them.
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
    GaugeResult
        One row per expected value. A parameter that metrosep does not have, cannot give for this
        profile (no cut-off, filtered already), that the file gives in a unit of another dimension
        or with a value that decides nothing, stands there with the reason.

    Raises
    ------
    DataError
        If the file expects no value, a line cannot be understood, or an option is unknown or out
        of range.

    Notes
    -----
    The ends are cut by one cut-off at each side for R and W (run-in and run-out), as instruments
    do. A value agrees when it is within half of its last printed digit plus the printed
    uncertainty. A zero without decimals is a placeholder, and a length or an angle whose tolerance
    reaches down to 0 would agree with nothing at all: neither is compared. Heights that are
    not measured make the whole file prove nothing; what the reader warned of (the checksum) is
    reported with the result.

    References
    ----------
    .. [1] ISO 5436-2:2012, type F1 (layout of the lines as recalled in the file's description).
    """
    instance_of(profile, (Profile, Surface), "a software gauge")
    _check_options(kind, edition, sections, line, relative_tolerance)
    if lambda_c is not None:
        lambda_c = positive(lambda_c, "lambda_c", dimension="length")
    centre = flag(centre, "centre")
    header = profile.metadata.get("header")
    lines: Sequence[str] = header.get("information", ()) if isinstance(header, Mapping) else ()
    if expected is not None:
        kept = [text for text in lines if _keyword(text.strip()) == _FILTER]
        lines = [*kept, *(f"{_VALUE} {symbol} {text}" for symbol, text in expected.items())]
    elif isinstance(profile, Surface):
        raise DataError(
            'a map holds no expected values: state those of its publisher, expected={"Sa": "1.23 um"}, '
            '--expect "Sa=1.23 um"'
        )
    wanted, settings = expectations(lines)
    if not wanted:
        raise DataError(
            "; ".join(
                (
                    "the file expects nothing: it has no line PARAMETER_VALUE",
                    *settings.unread,
                    "a software gauge of type F1 states its values in record 2",
                )
            )
        )
    cutoff = lambda_c if lambda_c is not None else settings.lambda_c
    tables: dict[str, Any] = {}
    rows = []
    for item in wanted:
        letter = "map" if isinstance(profile, Surface) else item.symbol[0]
        if letter not in tables and isinstance(profile, Surface):
            tables[letter] = _areal_table(profile, [e.symbol for e in wanted], line)
        elif letter not in tables and isinstance(profile, Profile):
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
    standing = profile.metadata.get("unproven")  # the gauge itself is the proof
    warned = (w for w in profile.metadata.get("warnings", ()) if w != standing)
    reader_warnings = tuple(f"{w}; {_ANEW}" for w in warned)
    return GaugeResult(tuple(rows), _damage(profile), settings.unread, reader_warnings)


def _areal_table(surface: Surface, wanted: Sequence[str], line: Any) -> Any:
    """Return the areal parameters, or the error that stands in their way."""
    from metrosep.parameters.areal import areal_parameters
    from metrosep.parameters.symbol_units import unit_of_symbol

    known = [s for s in wanted if s[:1] in ("S", "V") and unit_of_symbol(s) is not None]
    try:
        return areal_parameters(surface, names=known, line=line)
    except MetrosepError as error:
        return error


def _damage(profile: Profile | Surface) -> tuple[str, ...]:
    """Return why a file proves nothing, whatever its numbers are."""
    if not profile.n_invalid:
        return ()
    return (
        (
            f"{profile.n_invalid} of {profile.z.size} heights are not measured, and expected values "
            f"are of the whole {type(profile).__name__.lower()}: neither agreement nor difference proves anything; {_ANEW}"
        ),
    )


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
    quantity, reason = None, ""
    if item.problem:
        reason = item.problem
    elif item.is_placeholder:
        reason = f"{item.printed} is a placeholder: no expected value was filled in"
    elif isinstance(table, MetrosepError):
        reason = str(table)
    else:
        try:
            quantity = table[item.symbol]
        except (KeyError, DataError) as error:
            reason = str(error.args[0])
        else:
            reason = _undecided(item, quantity)
    if quantity is None or reason:
        return GaugeRow(item, math.nan, "", tolerance, reason)
    return GaugeRow(item, float(quantity.value), quantity.unit, tolerance)


def _undecided(item: Expectation, quantity: Any) -> str:
    """Return why comparing with a quantity would say nothing."""
    needed = _DIMENSIONS.get(quantity.unit, quantity.unit)
    unit = item.printed.partition(" ")[2] or "1"
    if item.dimension not in ("", needed):
        return f"the file gives it in {unit}, a {item.dimension}, but {item.symbol} is a {needed}"
    allowed = item.half_digit + (item.u or 0.0)
    if needed != "number" and allowed >= abs(item.value):
        width = format_engineering(allowed, quantity.unit, digits=3)
        return f"the file allows {width}, so that 0 would agree as well; write digits that decide"
    if math.isnan(quantity.value):
        return f"{item.symbol} has no value for this profile"
    return ""


def _check_options(
    kind: str, edition: str, sections: object, line: str, relative_tolerance: object
) -> None:
    """Refuse at the call what would else stand as a reason in every row."""
    named_edition(edition)
    choice(kind, "kind", ("P", "W", "R"))
    choice(line, "line", ("lsq", "secant"))
    if sections is not None:
        count(sections, "sections")
    not_negative(relative_tolerance, "relative_tolerance")


# ---- what record 2 of an ``.smd`` software gauge states: expected values and cut-offs ----------
# Lines ``PARAMETER_VALUE symbol value unit uncertainty`` and ``PROFILE_FILTER Gaussian LS 2.5 um LC
# 0.8 mm``; several of the latter add up. The word after the value is the unit where it is not a number
# or exactly ``1``; any other number there is the uncertainty of a pure number. What stands between
# ``/*`` and ``*/`` is a comment.

_SYMBOL = re.compile(r"[A-Za-z][\w()]*")
_LENGTH = r"([-+.\dEe]+)\s*([^\s\d.]\w*)"
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_VALUE, _FILTER = "PARAMETER_VALUE", "PROFILE_FILTER"
_CUTOFFS = ("LC", "LS")
_PURE = {"1": 1.0, "-": 1.0, "none": 1.0, "%": 0.01}

_ALIKE = 0.8
"""Similarity (`difflib`) from which another keyword is reported as a slip: three letters of fifteen."""

_LARGEST = 30
"""Powers of ten that a value may have: more is none."""

_SAME = 1e-9
"""Relative difference up to which two cut-offs are one: 0.8 mm and 800 um."""


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
    problem : str, optional
        Why it cannot be compared, such as a unit that is not known.
    """

    symbol: str
    value: float
    half_digit: float
    u: float | None
    printed: str
    dimension: str = ""
    problem: str = ""

    @property
    def is_placeholder(self) -> bool:
        """Whether it is a zero that states nothing: a length, or without decimals."""
        exponent = int(Decimal(self.printed.partition(" ")[0]).as_tuple().exponent)
        return self.value == 0.0 and (self.dimension != "number" or exponent >= 0)


@dataclass(frozen=True, slots=True)
class GaugeSettings:
    """What the file says about the evaluation."""

    lambda_c: float | None = None  # m: cut-offs; None where they are not given
    lambda_s: float | None = None
    # sentences on lines that seem to state a value or a filter and were not taken: a keyword with
    # a slip, a value within a comment
    unread: tuple[str, ...] = ()


def expectations(lines: Iterable[str]) -> tuple[tuple[Expectation, ...], GaugeSettings]:
    """Return the expected values and settings that record 2 of an ``.smd`` file states.

    Examples
    --------
    >>> expected, _ = expectations(["PARAMETER_VALUE Ra 0.4213 um 0.0002"])
    >>> round(expected[0].value, 10), round(expected[0].u, 11)
    (4.213e-07, 2e-10)
    """
    found: list[Expectation] = []
    filters: list[str] = []
    unread: list[str] = []
    whole = "\n".join(lines)
    # a comment leaves its line ends, so that each line keeps its place
    outside = _COMMENT.sub(lambda c: "\n" * c.group().count("\n"), whole)
    for raw, plain in zip(whole.split("\n"), outside.split("\n"), strict=True):
        text = plain.strip()
        keyword = _keyword(text)
        if keyword == _VALUE:
            found.append(_expectation(text))
        elif keyword == _FILTER:
            filters.append(text)
        elif (meant := _meant(text)) and _states(text, meant):
            unread.append(f"the line {text!r} was not taken: write {meant} if that is meant")
        elif _keyword(raw) == _VALUE:
            unread.append(f"the line {raw.strip()!r} stands in a comment and was not compared")
    symbols = [e.symbol for e in found]
    twice = sorted({s for s in symbols if symbols.count(s) > 1})
    if twice:
        raise DataError(f"the file expects two values of {', '.join(twice)}; keep one of them")
    cutoffs = _cutoffs(filters)
    return tuple(found), GaugeSettings(cutoffs.get("LC"), cutoffs.get("LS"), tuple(unread))


def _keyword(text: str) -> str:
    return text.upper().split()[0] if text.strip() else ""


def _meant(text: str) -> str:
    """Return the keyword that the first words of a line seem to be a slip of."""
    words = text.upper().split()
    for word in (*words[:1], "_".join(words[:2])):
        if close := nearest(word, (_VALUE, _FILTER), _ALIKE):
            return close
    return ""


def _states(text: str, meant: str) -> bool:
    """Whether a line states something behind its first words; a heading does not."""
    words = text.upper().split()
    if meant == _FILTER:
        return any(word.startswith(tuple(_CUTOFFS)) for word in words[1:])
    return any(_is_number(word) for word in words[1:4])


def _expectation(text: str) -> Expectation:
    words = text.split()[1:]
    if len(words) < 2 or _SYMBOL.fullmatch(words[0]) is None:
        raise DataError(f"expected PARAMETER_VALUE symbol value unit uncertainty, found {text!r}")
    symbol, number, rest = words[0], words[1], words[2:]
    try:
        printed = Decimal(number)
    except InvalidOperation:
        raise DataError(f"the value in {text!r} is not a number") from None
    if not printed.is_finite() or printed.adjusted() > _LARGEST:
        raise DataError(f"the value in {text!r} is not finite")
    # "Psk 0.0888 1" states the unit of a pure number, "Psk 0.0888 0.01" its uncertainty
    stated = rest.pop(0) if rest and (rest[0] == "1" or not _is_number(rest[0])) else ""
    if len(rest) > 1:
        raise DataError(f"expected PARAMETER_VALUE symbol value unit uncertainty, found {text!r}")
    try:
        factor, dimension = _unit(stated or "1", text)
        problem = ""
    except DataError as error:  # of this value, not of the others
        factor, dimension, problem = 1.0, "", str(error)
    u = _uncertainty(rest[0], text) * factor if rest else 0.0
    half = 0.5 * 10.0 ** int(printed.as_tuple().exponent)
    return Expectation(
        symbol=symbol,
        value=float(printed) * factor,
        half_digit=half * factor,
        u=u or None,
        printed=f"{number} {stated}".strip(),
        dimension=dimension,
        problem=problem,
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
        raise DataError(f"the uncertainty {word!r} in {text!r} is not a finite number")
    if u < 0.0:
        raise DataError(f"the uncertainty {word!r} in {text!r} is negative: it must be 0 or more")
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
        raise DataError(f"the cut-off {number} {unit} in {text!r} is not a length")
    cutoff = float(number) * factor
    if not 0.0 < cutoff < math.inf:
        raise DataError(f"the cut-off {number} {unit} in {text!r} is not positive and finite")
    return cutoff


def _cutoffs(lines: Iterable[str]) -> dict[str, float]:
    """Return the cut-offs of all filter lines, in m."""
    found: dict[str, tuple[float, str]] = {}
    for text in lines:
        words = text.split(maxsplit=2)
        if len(words) > 1 and "gauss" not in words[1].lower():
            raise DataError(f"the file asks for the filter {words[1]}; only Gaussian is defined")
        for key, value in _stated(words[2] if len(words) > 2 else "", text):
            before, where = found.setdefault(key, (value, text))
            if not math.isclose(before, value, rel_tol=_SAME):
                raise DataError(
                    f"the file states two cut-offs {key}: {where!r} and {text!r}; keep one of them"
                )
    return {key: value for key, (value, _) in found.items()}


def _stated(rest: str, text: str) -> Iterator[tuple[str, float]]:
    """Yield the cut-offs that stand behind the name of a filter."""
    for key in _CUTOFFS:
        for place in re.finditer(rf"\b{key}(?![A-Za-z_])\s*=?\s*", rest, re.IGNORECASE):
            if re.match(r"(none|off)\b", rest[place.end() :], re.IGNORECASE):
                continue
            part = re.match(_LENGTH, rest[place.end() :])
            if part is None:
                raise DataError(f"the cut-off {key} in {text!r} has no number with a unit")
            yield key, _cutoff(part[1], part[2], text)

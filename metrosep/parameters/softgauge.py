"""Type F1 software gauges (ISO 5436-2): profile and expected values in one file, compared.

The ``.smd`` file holds a primary profile, form-free and lambda_s filtered, and the expected values.
P parameters are taken from the profile as it is; R and W ones after a Gaussian filter with the
lambda_c of the file's ``PROFILE_FILTER`` lines or of the caller. A damaged file proves nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.profile import Profile
from metrosep.core.units import format_engineering
from metrosep.filters.kind import ProfileKind
from metrosep.parameters._flags import true_or_false
from metrosep.parameters._gauge_lines import Expectation, GaugeSettings, expectations
from metrosep.parameters._profile_rows import named_edition
from metrosep.parameters.sections import sections_that_fit
from metrosep.spectral._checks import finite_number, instance_of, whole_number

__all__ = [
    "Expectation",
    "GaugeResult",
    "GaugeRow",
    "GaugeSettings",
    "expectations",
    "verify_softgauge",
]

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
    doubts : tuple of str, optional
        What the reader warned of, such as a wrong checksum: told with any result. Publishers sum
        in more than one way, so it alone decides nothing; values that all agree outweigh it.
    """

    rows: tuple[GaugeRow, ...]
    damage: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

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
        """Why the file is not verified, or is only in part, and what to doubt; else empty."""
        missing = self._missing
        n = f"{len(missing)} of {len(self.rows)} values were not compared: {', '.join(missing)}"
        return (*self.doubts, *self.damage, *self.unread, *((n,) if missing else ()))

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
    profile: Profile,
    *,
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
    told with the result.

    References
    ----------
    .. [1] ISO 5436-2:2012, type F1 (layout of the lines as recalled in the file's description).
    """
    instance_of(profile, Profile, "a software gauge")
    _check_options(kind, edition, sections, line, relative_tolerance)
    if lambda_c is not None and finite_number(lambda_c, "lambda_c", "a wavelength in m") <= 0.0:
        raise DataError(f"lambda_c must be positive, got {lambda_c}")
    centre = true_or_false(centre, "centre")
    header = profile.metadata.get("header")
    lines: Sequence[str] = header.get("information", ()) if isinstance(header, Mapping) else ()
    expected, settings = expectations(lines)
    if not expected:
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
    doubts = tuple(f"{w}; {_ANEW}" for w in profile.metadata.get("warnings", ()))
    return GaugeResult(tuple(rows), _damage(profile), settings.unread, doubts)


def _damage(profile: Profile) -> tuple[str, ...]:
    """Return why a file proves nothing, whatever its numbers are."""
    if not profile.n_invalid:
        return ()
    return (
        (
            f"{profile.n_invalid} of {len(profile)} heights are not measured, and expected values "
            f"are of the whole profile: neither agreement nor difference proves anything; {_ANEW}"
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
    if kind not in ("P", "W", "R"):
        raise DataError(f'kind is "P", "W" or "R", got {kind!r}')
    if line not in ("lsq", "secant"):
        raise DataError(f'line is "lsq" or "secant", got {line!r}')
    if sections is not None:
        whole_number(sections, "sections")
    if finite_number(relative_tolerance, "relative_tolerance") < 0.0:
        raise DataError(f"relative_tolerance must not be negative, got {relative_tolerance}")

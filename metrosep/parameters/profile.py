"""P, W and R parameters of a profile after ISO 4287:1997 or ISO 21920-2:2021.

The profile is taken as it is: form removed and filtered by others, mean line z = 0, out of the
material. Which profile it is (P, W, R) is declared, and a wrong declaration is refused. Every
table says edition, sections, centring and thresholds; the same file gives other numbers with
others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from metrosep.core._arrays import comb
from metrosep.core.docs import documented
from metrosep.core.errors import DataError, NotConvergedError
from metrosep.core.numbers import choice, flag, positive
from metrosep.core.profile import Profile
from metrosep.core.units import Pixels, format_length
from metrosep.filters._arguments import DoubleFilterError, ProfileKind, profile_kind
from metrosep.parameters._profile_rows import (
    FIVE,
    HEIGHT_THRESHOLD,
    NEW,
    OLD,
    ROWS,
    SPACING_THRESHOLD,
    Edition,
    ProfileRow,
    Work,
    named_edition,
)
from metrosep.parameters.arguments import PROFILE, Call, call_of, canonical, is_call, unknown
from metrosep.parameters.material_ratio import CoreLine
from metrosep.parameters.sections import Evaluation, section_slices, sections_in, trim
from metrosep.parameters.table import (
    TABLE,
    Context,
    ParameterTable,
    evaluated,
    rows_of_calls,
    with_and_without_arguments,
)
from metrosep.parameters.watershed import LARGEST_GAP
from metrosep.spectral.dft import instance_of

_OFFSET_SHARE = 0.05
"""A mean of the heights above this share of q deserves a note: sk and ku depend on it."""

_CUTOFF_SHARE = 0.01
"""A section further from the cut-off than this share of it (and a step) is not one of the standard;
the note then says what to do."""

_SAME_LENGTH = 0.5 * (1.0 + 1e-6)
"""Of a step: sections of whole samples come no nearer to a cut-off."""

_OTHER_SPELLINGS = {
    "mr1": "mrk1",
    "mr2": "mrk2",
    "a1": "ak1",
    "a2": "ak2",
    "max": "z1max",
    "tm": "z",
    "\N{GREEK SMALL LETTER DELTA}q": "dq",
}
"""Spelling without kind, small letters, to the one spelling that entries are compared by."""


@documented(table=TABLE)
class ProfileParameterTable(ParameterTable):
    """Profile parameters; a symbol of the other edition finds the same parameter.

    Parameters
    ----------
    $table

    Examples
    --------
    >>> from metrosep.core.quantity import Quantity
    >>> table = ProfileParameterTable([Quantity(1e-4, "m", "mean spacing", symbol="Rsm")],
    ...                               Context("ISO 21920-2:2021", n_valid=4, n_total=4))
    >>> table["RSm"].value, "RSm" in table, list(table)
    (0.0001, True, ['Rsm'])
    """

    __slots__ = ()

    def own_symbol(self, symbol: str) -> str:
        known = (*self, *self.unavailable)
        if symbol in known:
            return symbol
        kind = str(self.context.settings.get("kind", "R"))
        if is_call(symbol):
            return canonical(_renamed(symbol, kind), PROFILE, kind)
        meant = _plain(symbol, kind)
        return next((s for s in known if _plain(s, kind) == meant), symbol)


def profile_parameters(
    profile: Profile,
    *,
    kind: ProfileKind = "P",
    edition: str = NEW,
    sections: int = 5,
    centre: bool = False,
    line: CoreLine = "lsq",
    names: Sequence[str] | None = None,
) -> ProfileParameterTable:
    """Return the parameters of a P, W or R profile.

    Parameters
    ----------
    profile : Profile
        Uniform; form removed and filtered as its kind asks. Nothing is filtered here.
    kind : {"P", "W", "R"}, optional
        Which profile it is; refused where the profile itself declares another.
    edition : {"ISO 21920-2:2021", "ISO 4287:1997", "ASME B46.1"}, optional
        Whose definitions and symbols.
    sections : int, >= 1, optional
        Section (sampling) lengths in the evaluation length; P always uses one.
    centre : bool, optional
        Subtract the mean of the heights, of each section (1997) or of the whole (2021).
        Instruments do not: the filter's mean line stays zero.
    line : {"lsq", "secant"}, optional
        Core line of the Rk family; Mitutoyo instruments use the secant.
    names : sequence of str, optional
        Symbols wanted, in the spelling of either edition; all by default. With arguments:
        "Rmr(0.5 um)", "Rmr(5 %, 1 um)", "Rcm(20 %)", "Rdc(20 %, 80 %)", "Rvm(10 %)", "Rvv(80 %)".

    Returns
    -------
    ProfileParameterTable
        Parameters in the order of the standard; those that cannot be given are listed in
        ``unavailable`` with the reason.

    Raises
    ------
    DataError
        If an option is unknown or of the wrong type, P data are asked for R or W parameters, a
        height is beyond 1e60 m, or their range is below 1e-60 m and not zero.
    DoubleFilterError
        If the profile is declared R or W and asked as something else.
    TooFewSamplesError
        If fewer than two samples are valid, or too few for the sections.
    NotUniformError
        If the positions are not uniform.

    Notes
    -----
    Missing ends are cut off before sections are formed. Inside, heights use the valid samples,
    gradients the complete 7-point stencils, and elements never bridge a gap. Where less than half
    of one of several sections is valid, what needs the sections is unavailable. O(n log n).
    1997: a, q, sk, ku, dq, Sm, c per section, then their mean; Sm and c drop what is below 10 % of z
    of the section. 2021: these over the whole; sm and c are means over the elements of both
    directions and drop what is below 10 % of p or v; zx is the largest height in a window of one
    section length that slides sample by sample, and a window counts where half of it is valid.
    Both: p, v, z are means of the section values; t is over the whole.

    References
    ----------
    .. [1] ISO 4287:1997, 4.1 to 4.5; ISO 13565-2:1996 (clauses recalled).
    .. [2] ISO 21920-2:2021 (recalled; p, v, z, zx, sm, c, dq as Mahr describes them in public).

    Examples
    --------
    >>> import numpy as np
    >>> i = np.arange(4000)
    >>> sine = Profile(i * 1e-6, 50e-9 * np.cos(2 * np.pi * i / 100))
    >>> table = profile_parameters(sine, kind="R", names=["Rq", "RSm"])
    >>> f"{table['Rq'].value:.5g} {table['RSm'].value:.5g}"
    '3.5355e-08 0.0001'
    """
    instance_of(profile, Profile, "a table of profile parameters")
    chosen = named_edition(edition)
    choice(kind, "kind", ("P", "W", "R"))
    choice(line, "line", ("lsq", "secant"))
    centre = flag(centre, "centre")
    _check_kind(profile, kind)
    wanted, calls = _wanted(names, kind, chosen)
    taken, comb_note = _measured_comb(profile)
    evaluation = Evaluation.of(
        taken,
        sections=1 if kind == "P" else sections,
        by_section=chosen == OLD,
        centre=centre,
    )
    work = Work(evaluation, line)
    rows = [*(r.row(kind, chosen, evaluation) for r in wanted), *rows_of_calls(calls)]
    quantities, unavailable = evaluated(rows, work)
    context = Context(
        edition=chosen,
        n_valid=len(profile) - profile.n_invalid,
        n_total=len(profile),
        history=profile.history,
        settings=_settings(evaluation, kind, centre=centre, line=line),
        notes=(
            *comb_note,
            *_notes(taken, evaluation, kind, wanted, centre=centre),
            *_feature_notes(work, [q.symbol for q in quantities], kind),
        ),
    )
    return ProfileParameterTable(quantities, context, unavailable=unavailable)


def section_values(profile: Profile, symbol: str, table: ProfileParameterTable) -> list[float]:
    """Return a parameter of each section of the profile of a table, evaluated as one of its own."""
    settings = table.context.settings
    kept = trim(profile.z)
    x, z = profile.x[kept], profile.z[kept]
    found = []
    for k, part in enumerate(section_slices(z.size, settings["sections"])):
        section = Profile(x[part], z[part], metadata=profile.metadata, history=profile.history)
        one = profile_parameters(
            section,
            kind=settings["kind"],
            edition=table.context.edition,
            sections=1,
            centre=settings["centre"],
            line=settings["line"],
            names=[symbol],
        )
        if symbol not in one:
            reason = "; ".join(one.unavailable.values())
            raise DataError(f"{symbol} of section {k + 1} cannot be given: {reason}")
        found.append(one[symbol].value)
    return found


def _plain(symbol: str, kind: str) -> str:
    """Return a spelling that is the same for both editions, without the kind."""
    rest = symbol.lower()
    if rest not in _OTHER_SPELLINGS:
        rest = rest[1:] if rest[:1] == kind.lower() else "?" + rest
    return _OTHER_SPELLINGS.get(rest, rest)


def _renamed(name: str, kind: str) -> str:
    """Return a name with arguments with the symbol of ISO: ASME's tp is mr."""
    return f"{kind}mr{name[2:]}" if name.startswith("tp(") else name


def _wanted(
    names: Sequence[str] | None, kind: ProfileKind, edition: Edition
) -> tuple[list[ProfileRow], list[Call]]:
    rows = [r for r in ROWS if r.name(edition) is not None]
    if names is None:
        return rows, []
    plain, called = with_and_without_arguments(names)
    by_plain = {_plain(r.symbol(kind, edition), kind): r for r in rows}
    if strange := [n for n in plain if _plain(n, kind) not in by_plain]:
        known = [r.symbol(kind, edition) for r in rows]
        raise unknown(strange, known, f"a parameter of kind {kind} with edition {edition}")
    wanted = {_plain(n, kind) for n in plain}
    calls = [call_of(_renamed(n, kind), PROFILE, kind) for n in called]
    return [r for p, r in by_plain.items() if p in wanted], calls


def _check_kind(profile: Profile, kind: ProfileKind) -> None:
    declared = profile_kind(profile)
    if declared is None or declared == kind:
        return
    if declared == "P":
        chain = "roughness" if kind == "R" else "waviness"
        raise DataError(
            f"the profile is declared P (not filtered by a cutoff) and {kind} parameters were "
            f"asked; filter it first, with metrosep.filters.{chain}(profile, lambda_c=...)"
        )
    raise DoubleFilterError(
        f"the profile is declared {declared}, already filtered, and {kind} parameters were asked; "
        f'pass kind="{declared}" or start from the unfiltered profile'
    )


def _settings(e: Evaluation, kind: str, *, centre: bool, line: str) -> dict[str, Any]:
    return {
        "kind": kind,
        "sections": len(e.parts),
        f"section_length_{e.unit}": float(e.section_lengths.mean()),
        f"evaluation_length_{e.unit}": e.whole.size * e.step,
        f"dx_{e.unit}": e.step,
        "centre": centre,
        "line": line,
        "height_threshold": HEIGHT_THRESHOLD,
        "height_threshold_of": f"{kind}z" if e.by_section else f"{kind}p and {kind}v",
        "spacing_threshold": SPACING_THRESHOLD if e.by_section else None,
    }


def _notes(
    profile: Profile, e: Evaluation, kind: str, wanted: list[ProfileRow], *, centre: bool
) -> list[str]:
    notes = []
    if profile_kind(profile) is None:
        notes.append(f"Nobody declared which profile this is; it was taken as {kind} as asked.")
    elif kind != "P" and not any(s.name != "read" for s in profile.history):
        notes.append(f"The file declares it {kind}: form and filter were dealt with before it.")
    cut = len(profile) - e.whole.size
    inside = int(np.isnan(e.whole).sum())
    if cut:
        notes.append(
            f"{cut} missing samples at the ends were cut off before sections were formed."
        )
    if inside:
        notes.append(
            f"{inside} of {e.whole.size} samples are missing inside; heights use the others, "
            "gradients complete 7-point stencils."
        )
    gapped = [
        f"section {k + 1} ({count} of {part.size} samples)"
        for k, (count, part) in enumerate(zip(e.valid_counts, e.parts, strict=True))
        if count < part.size
    ]
    if gapped and len(e.parts) > 1:
        notes.append(
            f"Not complete: {', '.join(gapped)}; each section counts alike in means, and one with "
            "less than half of its samples stops them."
        )
    sizes = sorted({p.size for p in e.parts})
    if len(sizes) > 1:
        notes.append(f"Sections hold {sizes[0]} or {sizes[-1]} samples: they do not divide.")
    if kind != "P":
        notes.extend(_cutoff_note(profile, e, kind))
    mean = float(np.nanmean(e.whole))
    if not centre and abs(mean) > _OFFSET_SHARE * e.amplitude.q:
        notes.append(
            f"The mean of the heights is {format_length(mean)}, not 0; a, q, sk, ku, p and v count "
            "from z = 0 (centre=True removes it)."
        )
    robust = any("robust" in s.name or "13565" in s.name for s in profile.history)
    if kind == "R" and any(r.new in ("k", "pk", "vk") for r in wanted) and not robust:
        notes.append(
            "The core family is of the profile as it is; ISO 13565-1 and ISO 21920 ask for a "
            "valley-suppressing (robust) filter before it."
        )
    return notes


def _measured_comb(profile: Profile) -> tuple[Profile, tuple[str, ...]]:
    """Return the profile at the step at which it was measured: of every other sample missing twice its own.

    Taken at the finer step it would show each wave a second time as an alias of as large an amplitude,
    and no sample would have a neighbour.
    """
    p, first = comb(~np.isnan(profile.z))
    if p == 1:
        return profile, ()
    one = Profile(
        profile.x[first::p],
        profile.z[first::p],
        metadata=profile.metadata,
        history=profile.history,
    )
    step = format_length(
        p * profile.step if profile.lateral_unit == "m" else Pixels(p * profile.step)
    )
    return one, (
        f"One sample in {p} was measured, {step} apart: the profile is evaluated at this step.",
    )


_ELEMENTS = {"c", "Sm", "sm"}
_PEAKS, _PITS = {"pd", "mpc", "5p", "10z"}, {"vd", "mvc", "5v", "10z"}


def _feature_notes(work: Work, symbols: list[str], kind: str) -> list[str]:
    """Return what gaps and few peaks did to parameters of peaks, pits and elements."""
    given = {s.removeprefix(kind) for s in symbols}
    gaps = int(np.isnan(work.evaluation.whole).sum())
    notes = []
    if gaps and given & (_ELEMENTS | _PEAKS | _PITS):
        filled = int(np.count_nonzero(work.ground.is_filled))
        if filled:
            notes.append(
                f"{filled} of {gaps} missing samples lie in gaps of at most {LARGEST_GAP} and were filled to find "
                "peaks, pits and elements; all other parameters are those of measured samples."
            )
        if gaps > filled:
            notes.append(
                f"{gaps - filled} missing samples lie in longer gaps: peaks and pits beside them are not counted, "
                "and elements that reach into them are omitted, of wide ones more than of narrow ones."
            )
    for word, names in (("peaks", {"5p", "10z"}), ("pits", {"5v", "10z"})):
        if given & names and (n := len(work.peaks if word == "peaks" else work.pits)) < FIVE:
            notes.append(f"There are {n} significant {word}: their mean stands for that of five.")
    return notes


def _cutoff_note(profile: Profile, e: Evaluation, kind: str) -> list[str]:
    """Return a note where the sections are not those of the cut-off (nor of lambda_f for W)."""
    if e.unit != "m":
        return []
    used = float(e.section_lengths.mean())
    names = ("lambda_c_m", "lambda_f_m") if kind == "W" else ("lambda_c_m",)
    cutoffs = [c for c in map(profile.metadata.get, names) if isinstance(c, float) and c > 0.0]
    if not cutoffs:
        return []
    nearest = min(cutoffs, key=lambda c: abs(used - c))
    off = abs(used - nearest)
    if off <= _SAME_LENGTH * e.dx:
        return []
    if off <= max(_CUTOFF_SHARE * nearest, e.dx):
        note = (
            f"Sections are {format_length(used)} long, the cut-off is {format_length(nearest)}: "
            "they divide the length that is left."
        )
        return [note]
    cutoff = cutoffs[0]
    note = (
        f"Used are sections of {format_length(used)}, {used / cutoff:.3g} times lambda_c, which is "
        f"{format_length(cutoff)}: the standard takes sections of one cut-off; "
    )
    return [note + _advice(e, cutoff, kind)]


def _advice(e: Evaluation, cutoff: float, kind: str) -> str:
    """Return how to come to sections of one cut-off."""
    length = e.whole.size * e.dx
    n = sections_in(length, cutoff)
    off = length / n - cutoff
    chain = f", or metrosep.filters.roughness(..., sections={n})" if kind == "R" else ""
    if abs(off) <= max(_CUTOFF_SHARE * cutoff, e.dx):
        return f"pass sections={n}."
    if off > 0.0:
        cut = f"crop the profile to {format_length(n * cutoff)} and pass sections={n}"
        return f"the length is not a whole number of them: {cut}{chain}."
    count = "one" if n == 1 else str(n)
    if n == len(e.parts):
        return f"the length is short of {count}: measure longer."
    return f"pass sections={n}, or measure longer: the length is short of {count}."


# ---- default settings: setting classes of ISO 21920-3:2021 and the cutoff rule of ISO 4288:1996 ----
# ISO 21920-3 takes cutoff, section and evaluation length, S filter, step and tip from the tolerance
# limit on the drawing. ISO 4288 took the cutoff from the measured value, by iteration. Lengths in m.
# Entries are recalled except where `SettingClass.read` names them; check against a bought copy.

_ROUNDING = 1e-9
"""Relative; a limit of 2 um given as 2.0000000000000002e-6 is still 2 um."""


@dataclass(frozen=True, slots=True)
class SettingClass:
    """A setting class of ISO 21920-3.

    Parameters
    ----------
    name : str
        "Sc1" to "Sc5".
    Ra_max, Rz_max : float, m
        Largest tolerance limit of the class; infinite for Sc5.
    nic : float, m
        Cutoff of the L (lambda c) filter, and section length.
    le : float, m
        Evaluation length.
    nis : float, m
        Cutoff of the S (lambda s) filter.
    max_dx : float, m
        Largest step.
    tip_radius : float, m
        Nominal radius of the stylus tip.
    sections : int
        Section lengths in the evaluation length.
    read : tuple of str
        Fields that were read in a public source; the others are recalled.
    """

    name: str
    Ra_max: float
    Rz_max: float
    nic: float
    le: float
    nis: float
    max_dx: float
    tip_radius: float
    sections: int = 5
    read: tuple[str, ...] = ("Ra_max", "Rz_max", "nis", "tip_radius")


SETTING_CLASSES = (
    SettingClass("Sc1", 0.02e-6, 0.16e-6, 0.08e-3, 0.4e-3, 2.5e-6, 0.5e-6, 2e-6),
    SettingClass("Sc2", 0.1e-6, 0.8e-6, 0.25e-3, 1.25e-3, 2.5e-6, 0.5e-6, 2e-6),
    SettingClass("Sc3", 2e-6, 16e-6, 0.8e-3, 4e-3, 2.5e-6, 0.5e-6, 2e-6),
    SettingClass("Sc4", 10e-6, 80e-6, 2.5e-3, 12.5e-3, 8e-6, 1.5e-6, 5e-6),
    SettingClass("Sc5", math.inf, math.inf, 8e-3, 40e-3, 25e-6, 5e-6, 10e-6),
)
"""The classes, finest first."""

_CUTOFFS_4288: dict[str, tuple[tuple[float, float], ...]] = {
    "Ra": ((0.02e-6, 0.08e-3), (0.1e-6, 0.25e-3), (2e-6, 0.8e-3), (10e-6, 2.5e-3), (80e-6, 8e-3)),
    "Rz": ((0.1e-6, 0.08e-3), (0.5e-6, 0.25e-3), (10e-6, 0.8e-3), (50e-6, 2.5e-3), (200e-6, 8e-3)),
    "RSm": (
        (0.04e-3, 0.08e-3),
        (0.13e-3, 0.25e-3),
        (0.4e-3, 0.8e-3),
        (1.3e-3, 2.5e-3),
        (4e-3, 8e-3),
    ),
}
"""ISO 4288:1996, tables 1 to 3 (recalled): largest measured value and its cutoff."""


def setting_class(*, Ra: float | None = None, Rz: float | None = None) -> SettingClass:
    """Return the setting class for a tolerance limit.

    Parameters
    ----------
    Ra, Rz : float, m, > 0, optional
        Upper tolerance limit of exactly one of them, from the drawing and not from a measurement.

    Returns
    -------
    SettingClass
        The finest class whose limit is not exceeded.

    Raises
    ------
    DataError
        If none or both are given, or the limit is not finite and positive.

    References
    ----------
    .. [1] ISO 21920-3:2021, default settings (limits, nis and tip read in public sources, the rest
       recalled).

    Examples
    --------
    >>> found = setting_class(Ra=5e-9)
    >>> found.name, found.nic, found.le
    ('Sc1', 8e-05, 0.0004)
    """
    if (Ra is None) == (Rz is None):
        raise DataError("give the tolerance limit of one parameter, Ra or Rz")
    limit = positive(Ra if Rz is None else Rz, "Ra" if Rz is None else "Rz", dimension="length")
    for found in SETTING_CLASSES[:-1]:
        largest = found.Ra_max if Rz is None else found.Rz_max
        if limit <= largest * (1.0 + _ROUNDING):
            return found
    return SETTING_CLASSES[-1]


def suggested_cutoff(symbol: Literal["Ra", "Rz", "RSm"], value: float) -> float:
    """Return the cutoff that ISO 4288:1996 asks for at a measured value.

    Parameters
    ----------
    symbol : {"Ra", "Rz", "RSm"}
        "RSm" for periodic profiles, else "Ra" or "Rz".
    value : float, m, > 0
        What was measured with some cutoff.

    Returns
    -------
    float
        Cutoff and sampling length, m. Where it is not the one that was used, filter with it and
        measure again until it is; the standard then also tries the next shorter one.

    Raises
    ------
    DataError
        If the symbol is unknown, the value is not finite and positive, or no cutoff covers it.

    References
    ----------
    .. [1] ISO 4288:1996, tables 1 to 3 and clause 7.2 (recalled).

    Examples
    --------
    >>> suggested_cutoff("Rz", 18.5e-6)
    0.0025
    """
    table = _CUTOFFS_4288.get(symbol)
    if table is None:
        raise DataError(f"the cutoff follows from {', '.join(_CUTOFFS_4288)}, got {symbol!r}")
    measured = positive(value, symbol, dimension="length")
    for largest, cutoff in table:
        if measured <= largest * (1.0 + _ROUNDING):
            return cutoff
    raise DataError(
        f"{symbol} = {format_length(measured)} is above {format_length(table[-1][0])}, the last "
        "entry of ISO 4288; choose the cutoff yourself and state it"
    )


def settle_cutoff(
    symbol: Literal["Ra", "Rz", "RSm"], measure: Callable[[float], float], *, start: float = 0.8e-3
) -> float:
    """Return the cutoff that agrees with the value measured with it, after ISO 4288:1996.

    Parameters
    ----------
    symbol : {"Ra", "Rz", "RSm"}
        "RSm" for periodic profiles, else "Ra" or "Rz".
    measure : callable
        Takes a cutoff in m, filters with it, returns the parameter in m.
    start : float, m, optional
        First cutoff: 0.08, 0.25, 0.8, 2.5 or 8 mm.

    Returns
    -------
    float
        Cutoff in m.

    Raises
    ------
    DataError
        If an argument is unknown, or a measured value is not covered.
    NotConvergedError
        If two cutoffs each ask for another one: the standard has no answer then.

    Notes
    -----
    For a non-periodic profile the standard then tries the next shorter cutoff once; do that with
    `suggested_cutoff` where it matters.

    References
    ----------
    .. [1] ISO 4288:1996, clause 7.2 (recalled).

    Examples
    --------
    >>> settle_cutoff("Ra", lambda cutoff: 3e-6 if cutoff > 1e-3 else 2.5e-6)
    0.0025
    """
    start = positive(start, "start", dimension="length")
    if symbol not in _CUTOFFS_4288:
        suggested_cutoff(symbol, start)  # says which symbols there are
    cutoffs = [c for _, c in _CUTOFFS_4288[symbol]]
    cutoff = min(cutoffs, key=lambda c: abs(c - start))
    if abs(cutoff - start) > _ROUNDING * start:
        known = ", ".join(format_length(c) for c in cutoffs)
        raise DataError(f"start must be one of {known}, got {format_length(start)}")
    tried: list[float] = []
    while cutoff not in tried:
        tried.append(cutoff)
        cutoff = suggested_cutoff(symbol, measure(cutoff))
        if cutoff == tried[-1]:
            return cutoff
    raise NotConvergedError(
        f"the cutoffs {', '.join(format_length(c) for c in (*tried, cutoff))} ask for each other; "
        "take the cutoff from the drawing (ISO 21920-3) or state your own"
    )

"""Limits of waviness and roughness by spectrum (ISO 10110-8): A / f^B over a band, or an RMS in it.

The one-sided density of a line, PSD1(f), is compared in bands of a third of an octave with the mean of
the limit over the same band. The mean of n independent values of a random surface scatters like
chi-square with 2 n degrees of freedom, and a band is accepted or rejected by its 5 % points. Of a map
the mean of the lines is taken in both directions, and the worse one counts. Scope of the standard as
in public texts; the notation of A and B is recalled.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.limits import COVERAGE
from metrosep.core.numbers import not_negative, positive, real
from metrosep.core.units import format_ends, format_length, parse_quantity, parse_unit
from metrosep.parameters.decision import Verdict, worst
from metrosep.spectral.masked import MaskedPsd
from metrosep.spectral.spectra import Psd

_PER_OCTAVE = 3
_WAVES = 8
"""Waves across the outline: below, the width of the window counts. `MaskedPsd.lowest` is that of two."""
_RISK = 0.05
_GRAMMAR = (
    'A limit is written as "A = 0.02 um^3, B = 2 from 0.1 mm to 5 mm" (PSD = A / f^B with f in '
    '1/um; "nm^2 mm" counts f in 1/mm) or "rms = 5 nm from 0.1 mm to 5 mm"'
)
_FROM_TO = r"\s*,?\s*from\s+(?P<low>.+?)\s+to\s+(?P<high>.+?)\s*"
_POWER = re.compile(
    r"\s*A\s*=\s*(?P<A>[-+]?[\d.]+(?:[eE][-+]?\d+)?|[^\s,;]+)\s*(?P<unit>[^,;]*?)\s*[,; ]"
    r"\s*B\s*=\s*(?P<B>[\d.]+)" + _FROM_TO
)
_RMS = re.compile(r"\s*(?i:rms)\s*(?:<=?|≤|=)\s*(?P<rms>.+?)" + _FROM_TO)
_CUBE = re.compile(
    r"(?P<one>[a-zA-Zµμ]+)\^?(?:3|\(3\s*-\s*B\))|(?P<two>[a-zA-Zµμ]+)\^?2\s*[*·⋅ ]?\s*(?P<f>[a-zA-Zµμ]+)"
)
_RAISED = str.maketrans("²³", "23")


@dataclass(frozen=True, slots=True)
class PsdLimit:
    """A limit of a one-sided line spectrum over a band of wavelengths.

    Parameters
    ----------
    shortest, longest : float, m, > 0
        Wavelengths of the band.
    A : float or None
        PSD1(f) <= A / f^B with f in 1/m, m^(3 - B); None for a limit of the RMS.
    B : float
        Exponent.
    rms : float or None, m
        Limit of the RMS in the band.
    text : str
        As it was written.

    Raises
    ------
    DataError
        If the wavelengths are not in order, or A and an RMS are both given or both missing.

    Examples
    --------
    >>> limit = psd_limit("A = 1e-3 um^3, B = 2 from 10 um to 1 mm")
    >>> f"{limit.root_mean_square() * 1e6:.9f}"
    '0.994987437'
    """

    shortest: float
    longest: float
    A: float | None = None
    B: float = 0.0
    rms: float | None = None
    text: str = ""

    def __post_init__(self) -> None:
        positive(self.shortest, "the shortest wavelength", dimension="length")
        positive(self.longest, "the longest wavelength", dimension="length")
        if not self.shortest < self.longest:
            raise DataError(
                f"the band of a limit goes from a shorter to a longer wavelength, got "
                f"{format_length(self.shortest)} and {format_length(self.longest)}"
            )
        if (self.A is None) == (self.rms is None):
            raise DataError("a limit of a spectrum has A and B, or an RMS")
        positive(self.rms if self.A is None else self.A, "the limit")
        real(self.B, "B")

    def mean_square(self, low: float, high: float) -> float:
        """Return the integral of A / f^B between two frequencies.

        Parameters
        ----------
        low, high : float, 1/m
            Frequencies, 0 <= low < high; 0 where B < 1 and infinity where B > 1, as the integral is
            finite there.

        Returns
        -------
        float, m^2
            ``A (low^(1-B) - high^(1-B)) / (B - 1)``, for B = 1 ``A ln(high / low)``.

        Raises
        ------
        DataError
            If the frequencies are not in order, or the integral between them is not finite.
        """
        low = not_negative(low, "low") if self.B < 1.0 else positive(low, "low")
        if self.B <= 1.0 or high != math.inf:
            high = positive(high, "high")
        if not low < high:
            raise DataError(
                f"the integral goes from a lower to a higher frequency, got {low:g} and {high:g} 1/m"
            )
        A = 0.0 if self.A is None else self.A
        if self.B == 1.0:
            return A * math.log(high / low)
        return float(A * (low ** (1.0 - self.B) - high ** (1.0 - self.B)) / (self.B - 1.0))

    def root_mean_square(self) -> float:
        """Return the RMS that the limit allows over its band.

        Returns
        -------
        float, m
            The stated one, or that of A / f^B.
        """
        if self.rms is not None:
            return self.rms
        return math.sqrt(self.mean_square(1.0 / self.longest, 1.0 / self.shortest))


def psd_limit(text: str) -> PsdLimit:
    """Return the limit that a text means.

    Parameters
    ----------
    text : str
        ``"A = 0.02 um^3, B = 2 from 0.1 mm to 5 mm"`` or ``"rms = 5 nm from 0.1 mm to 5 mm"``. The
        unit of A is that of the density: ``um^3`` (or ``um^(3-B)``) counts f in 1/um, ``nm^2 mm`` in
        1/mm.

    Returns
    -------
    PsdLimit
        In SI.

    Raises
    ------
    DataError
        If the text cannot be read, or A has no unit.

    Examples
    --------
    >>> limit = psd_limit("A = 2 nm^2 mm, B = 1 from 0.1 mm to 5 mm")
    >>> f"{limit.A:.3g} {limit.B:g} {limit.shortest:g}"
    '2e-18 1 0.0001'
    """
    found = _POWER.fullmatch(text)
    if found is not None:
        value, B = (_number(found[name], name, text) for name in ("A", "B"))
        return PsdLimit(
            *_band(found),
            A=value * _unit(found["unit"], B, text),
            B=B,
            text=" ".join(text.split()),
        )
    found = _RMS.fullmatch(text)
    if found is None:
        comma = " It has a decimal comma; write a point." if re.search(r"\d,\d", text) else ""
        raise DataError(f"{text!r} is not a limit of a spectrum.{comma} {_GRAMMAR}")
    rms = parse_quantity(found["rms"], dimension="length", name="rms")
    return PsdLimit(*_band(found), rms=rms, text=" ".join(text.split()))


def _band(found: re.Match[str]) -> tuple[float, float]:
    names = {"low": "from", "high": "to"}
    ends = sorted(parse_quantity(found[k], dimension="length", name=n) for k, n in names.items())
    return ends[0], ends[1]


def _number(text: str, name: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise DataError(f"{name} = {text!r} in {whole!r} is not a number. {_GRAMMAR}") from None


def _unit(text: str, B: float, whole: str) -> float:
    """Return the size of a unit of A in m^(3 - B)."""
    found = _CUBE.fullmatch(text.strip().translate(_RAISED))
    if found is None:
        what = f"the unit {text!r}" if text.strip() else "no unit"
        raise DataError(
            f"A of {whole!r} has {what}; the unit of the density is needed. {_GRAMMAR}"
        )
    one = parse_unit(found["one"] or found["two"], dimension="length").factor
    wave = one if found["one"] else parse_unit(found["f"], dimension="length").factor
    return float(one**2 * wave * wave**-B)


@dataclass(frozen=True, slots=True)
class BandResult:
    """One band of a spectrum against its limit.

    Parameters
    ----------
    low, high : float, 1/m
        Frequencies.
    mean, limit : float
        Mean of the density over the band and of the limit, m^3; mean squares, m^2, for an RMS.
    n_independent : float
        Independent values in the band.
    left : float
        Least share of the density that holes leave in the band.
    added : float
        Most that closing them may have put there, as `mean`.
    """

    low: float
    high: float
    mean: float
    limit: float
    n_independent: float
    left: float = 1.0
    added: float = 0.0

    @property
    def ratio(self) -> float:
        """Mean over limit."""
        return self.mean / self.limit

    @property
    def verdict(self) -> Verdict:
        """Accept where the true ratio is at most 1 at 5 % risk, reject where it is larger."""
        least, most = self.between()
        return "accept" if most <= 1.0 else "reject" if least > 1.0 else "inconclusive"

    def between(self, risk: float = _RISK) -> tuple[float, float]:
        """Return the least and the largest true ratio, each missed at a risk.

        Parameters
        ----------
        risk : float, 0 to 0.5
            Of each end.

        Returns
        -------
        tuple of float
            ``mean 2 n / chi2(2 n) / limit`` at both ends; what holes hide is added to the largest, and
            what closing them may have put there is taken off the least.
        """
        more, less = _factors(self.n_independent, risk)
        least = (self.mean * less - self.added * more) / self.limit
        return least, self.mean * more / self.left / self.limit


@dataclass(frozen=True, slots=True, eq=False)
class PsdVerdict:
    """What a spectrum says about a limit.

    Parameters
    ----------
    limit : PsdLimit
        What was asked.
    bands : tuple of BandResult
        Of the worse direction, the lowest frequency first.
    direction : {"x", "y"}
        Of the lines.
    verdict : {"accept", "reject", "inconclusive"}
        Of both directions together.
    spectrum : Psd
        Of that direction.
    notes : tuple of str
        What a reader must know.
    """

    limit: PsdLimit
    bands: tuple[BandResult, ...]
    direction: str
    verdict: Verdict
    spectrum: Psd
    notes: tuple[str, ...]

    @property
    def worst(self) -> BandResult:
        """The band with the largest ratio."""
        return max(self.bands, key=lambda b: b.ratio)

    def margin(self, risk: float) -> float:
        """Return how far the largest ratio may lie from the truth, on the side of the limit that counts.

        Parameters
        ----------
        risk : float, 0 to 0.5
            Of that side.

        Returns
        -------
        float
            Of all bands: the largest true ratio less `worst`; where a band is rejected, `worst` less the
            largest of the least ones.
        """
        ends = [b.between(risk) for b in self.bands]
        least, most = max(v[0] for v in ends), max(v[1] for v in ends)
        ratio = self.worst.ratio
        rejected = any(b.verdict == "reject" for b in self.bands)
        return ratio - least if rejected else most - ratio

    @property
    def expanded(self) -> float:
        """Expanded uncertainty of the largest ratio: the end of its 95.45 % interval towards the limit."""
        return self.margin(0.5 * (1.0 - COVERAGE))

    @property
    def guard(self) -> float:
        """Guard band at 5 % risk: accepted bands have ratio + guard <= 1, a rejected one ratio - guard > 1."""
        return self.margin(_RISK)

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        band = self.worst
        ratio, n = band.ratio, band.n_independent
        n_open = sum(b.verdict != "accept" for b in self.bands)
        what = f"the mean density reaches {ratio:.3g} of the limit"
        if self.limit.A is None:
            rms = format_length(math.sqrt(band.mean), digits=3)
            what = f"the RMS in the band is {rms}, its square {ratio:.3g} of the limit's"
        more, less = _factors(n, _RISK)
        short, long = (format_length(1.0 / f, digits=3) for f in (band.high, band.low))
        return (
            f"{self.verdict}: {what}, at wavelengths {short} to "
            f"{long} along {self.direction} ({n:.3g} independent value{'s' if n > 1.0 else ''}, so "
            f"the true ratio lies between {ratio * less:.3g} and {ratio * more:.3g} at 5 % each); "
            f"{n_open} of {len(self.bands)} bands not accepted"
            + (f"; limit: {self.limit.text}" if self.limit.text else "")
        )


def judge_psd(spectrum: MaskedPsd, limit: PsdLimit) -> PsdVerdict:
    """Return whether a spectrum keeps a limit.

    Parameters
    ----------
    spectrum : MaskedPsd
        Of a map or a profile.
    limit : PsdLimit
        Of the one-sided density along a line.

    Returns
    -------
    PsdVerdict
        Bands, verdict and the worse direction.

    Raises
    ------
    DataError
        If no frequency of the spectrum lies in the band of the limit.

    Notes
    -----
    Accept if ``mean 2 n / chi2_0.05(2 n) <= limit`` in all bands, reject if
    ``mean 2 n / chi2_0.95(2 n) > limit`` in any. n is the width of the band times the effective
    length of the window, times the evenness (sum P)^2 / (N sum P^2) of the density in it, at least 1;
    parallel lines of a map hang together, so their number adds none. Bands beyond what the
    measurement reaches are inconclusive. Where a falling spectrum was taken from heights, bands of
    fewer than 8 waves across the outline read high, which a note says. Of what the part holds in its
    holes, on a share s of the window's square, nothing is known: omitted, 1 - s of it is left; closed,
    short waves hold less, down to (1 - 2 s)^2 where the waves are shortest (`MaskedPsd.left`). A band is
    accepted if it also is with its mean over the least of this: what is missing accepts no part. What
    closing may have put there (`MaskedPsd.added`) rejects none: it is taken off first, at its upper 5 %.
    """
    names = ("x", "y")
    results = []
    for k, (psd, length, lowest, name) in enumerate(
        zip(spectrum.one_sided, spectrum.lengths, spectrum.lowest, names, strict=False)
    ):
        bands, notes = _bands(psd, length, lowest, limit, spectrum.left[k], spectrum.added[k])
        outcome = worst([b.verdict for b in bands]) or "inconclusive"
        if notes and outcome == "accept":
            outcome = "inconclusive"
        long = sum(b.low < _WAVES * 0.5 * lowest * (1.0 - 1e-9) for b in bands)
        told = [_reads_high(long, len(bands))] if long and spectrum.reads_high else []
        results.append(PsdVerdict(limit, bands, name, outcome, psd, (*notes, *told)))
    order = {"reject": 2, "inconclusive": 1, "accept": 0}
    chosen = max(results, key=lambda r: (order[r.verdict], r.worst.ratio))
    if spectrum.filled_share:
        holes = (
            f"{100 * spectrum.filled_share:.3g} % of the outline were holes, with "
            f"{100 * spectrum.lost_share:.3g} % of the window's square, and were {spectrum.holes}; what they "
            "may have held counts against accepting, and what closing may have added against rejecting"
        )
        chosen = PsdVerdict(
            limit, chosen.bands, chosen.direction, chosen.verdict, chosen.spectrum,
            (*chosen.notes, holes),
        )  # fmt: skip
    return chosen


def _reads_high(long: int, n: int) -> str:
    """Return what is known of the bias of the lowest bands: `docs/explanation/power-spectral-density`."""
    return (
        f"{long} of {n} bands hold waves of which fewer than {_WAVES} fit across, and the spectrum falls: from "
        "heights it reads high there, by up to 17 % (f^-3) or 35 % (f^-4), on the safe side of a limit; take it "
        'from slopes (estimate = "slopes", detrend = "plane")'
    )


def _bands(
    psd: Psd,
    length: float,
    lowest: float,
    limit: PsdLimit,
    left: FloatArray,
    added: FloatArray,
) -> tuple[tuple[BandResult, ...], list[str]]:
    f, P = psd.frequency, psd.density
    low, high = 1.0 / limit.longest, 1.0 / limit.shortest
    notes = []
    if lowest > low * (1.0 + 1e-9):
        notes.append(
            f"wavelengths above {format_length(1 / lowest)} cannot be judged on this width"
        )
    if f[-1] < high * (1.0 - 1e-9):
        notes.append(f"wavelengths below {format_length(1 / f[-1])} are shorter than two steps")
    first, last = max(low, lowest), min(high, float(f[-1]))
    if not ((f >= first) & (f <= last)).any():
        raise DataError(
            f"no frequency of the spectrum lies in the band of the limit, "
            f"{format_ends(limit.shortest, limit.longest, between=' to ')}: it reaches from "
            f"{format_ends(1 / f[-1], 1 / lowest, between=' to ')}"
        )
    if limit.A is None:
        edges = np.array([first, last])
    else:
        n = max(1, round(_PER_OCTAVE * math.log2(last / first)))
        edges = np.geomspace(first, last, n + 1)
    found = []
    for a, b in pairwise(edges.tolist()):
        square, independent = _in_band(f, P, a, b, length)
        width = b - a
        allowed = limit.rms**2 if limit.rms is not None else limit.mean_square(a, b)
        scale = 1.0 if limit.rms is not None else width
        here = left[(f > a - f[1]) & (f < b + f[1])]
        most = _in_band(f, added, a, b, length)[0] / scale
        found.append(
            BandResult(a, b, square / scale, allowed / scale, independent, float(here.min()), most)
        )
    return tuple(found), notes


def _in_band(
    f: FloatArray, P: FloatArray, a: float, b: float, length: float
) -> tuple[float, float]:
    """Return the integral of the density from a to b, and how many independent values it holds."""
    step = float(f[1])
    share = np.clip(
        (np.minimum(f + 0.5 * step, b) - np.maximum(f - 0.5 * step, a)) / step, 0.0, 1.0
    )
    weighted = share * P
    square = float(weighted.sum()) * step
    total = float((weighted**2).sum())
    evenness = float(weighted.sum()) ** 2 / (total * float(share.sum())) if total > 0.0 else 1.0
    return square, max(1.0, (b - a) * length * min(evenness, 1.0))


def _factors(n: float, risk: float) -> tuple[float, float]:
    """Return true mean over measured mean, largest and smallest, each missed at a risk."""
    from scipy.special import gammaincinv

    low, high = (float(gammaincinv(n, share)) for share in (risk, 1.0 - risk))
    return n / low, n / high

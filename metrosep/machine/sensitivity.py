"""`SensitivityTable`: which error term does what to the part, before and after alignment.

Each term has a magnitude (a standard uncertainty, or the half-width of a uniform distribution).
``Sq`` and ``P-V`` of a term are those of the part with this error alone at its magnitude; its share
is that of the expected mean square ``tr(G S) + mu' G mu``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.public import PublicObject, shortened
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.machine._responses import MapMaker
from metrosep.machine.alignment import Alignment
from metrosep.machine.gram import AlignedGram, correlations, expected_mean_square, shares
from metrosep.machine.sobol import DISTRIBUTIONS, SobolIndices, draws, sobol_indices

if TYPE_CHECKING:
    import pandas as pd

    from metrosep.forms.zernike import ZernikeOrder


@dataclass(frozen=True, slots=True)
class ParetoStep:
    """What is left when the terms that matter most are compensated.

    Parameters
    ----------
    names : tuple of str
        What this step compensates beyond the steps before it: a term or a group.
    sq : float, m
        Root of the expected mean square that is left.
    """

    names: tuple[str, ...]
    sq: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SensitivityTable(PublicObject):
    """Error terms of a machine, ranked by what they do to a part.

    Parameters
    ----------
    names : tuple of str
        Error terms, in the order of all arrays.
    units : tuple of str
        ``"m"`` or ``"rad"``.
    magnitudes, mean : ndarray, shape (m,)
        Of each term in its unit; the mean is what is known of it.
    distribution : str
        ``"normal"`` (the magnitude is a standard uncertainty) or ``"uniform"`` (a half-width).
    covariance : ndarray, shape (m, m)
        Of the random part of the terms.
    unit_gram : AlignedGram
        Gram matrices and extremes of the unit maps.
    space : Alignment
        What was removed.
    groups : tuple of tuple of str
        Terms that cannot be distinguished on this part, ``|r|`` above `threshold`.
    threshold : float
        Of ``|r|``.
    response, direction : str
        ``"form"`` or ``"wavefront"``; ``"vertical"`` or ``"normal"``.
    maker : MapMaker
        Makes the maps again.
    audit : mapping
        Settings, with units in the keys.
    messages : tuple of str
        What the reader must know.
    typed : tuple of str, optional
        Each magnitude as it was written, such as ``"1 arcsec"``; empty where it was a number.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    magnitudes: FloatArray
    mean: FloatArray
    distribution: str
    covariance: FloatArray
    unit_gram: AlignedGram
    space: Alignment
    groups: tuple[tuple[str, ...], ...]
    threshold: float
    response: str
    direction: str
    maker: MapMaker
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    typed: tuple[str, ...] = ()

    @property
    def gram(self) -> FloatArray:
        """Gram matrix after alignment, m^2 per unit^2; `unit_gram.raw` is the one before."""
        return self.unit_gram.matrix

    @property
    def removed(self) -> tuple[str, ...]:
        """Freedoms that were removed."""
        return self.space.names

    @property
    def sq_raw(self) -> FloatArray:
        """Sq of each term alone at its magnitude about zero, nothing removed, m."""
        return np.asarray(np.sqrt(np.diag(self.unit_gram.raw)) * self.magnitudes)

    @property
    def sq(self) -> FloatArray:
        """Sq of each term alone at its magnitude, after alignment, m."""
        return np.asarray(np.sqrt(np.diag(self.gram)) * self.magnitudes)

    @property
    def pv_raw(self) -> FloatArray:
        """P-V of each term alone at its magnitude, nothing removed, m."""
        return (self.unit_gram.highest_raw - self.unit_gram.lowest_raw) * self.magnitudes

    @property
    def pv(self) -> FloatArray:
        """P-V of each term alone at its magnitude, after alignment, m."""
        return (self.unit_gram.highest - self.unit_gram.lowest) * self.magnitudes

    @property
    def shares(self) -> FloatArray:
        """Share of each term in the expected mean square after alignment."""
        return shares(self.gram, self._second_moment())

    @property
    def shares_raw(self) -> FloatArray:
        """Share of each term in the expected mean square before alignment."""
        return shares(self.unit_gram.raw, self._second_moment())

    @property
    def correlations(self) -> FloatArray:
        """How alike the aligned maps are, shape (m, m); NaN for terms that leave nothing."""
        return correlations(self.gram)

    @property
    def unobservable(self) -> tuple[str, ...]:
        """Terms of which the alignment leaves nothing, and terms that do nothing to this part."""
        return tuple(
            n for n, gone in zip(self.names, self.unit_gram.is_removed, strict=True) if gone
        )

    @property
    def visible(self) -> tuple[str, ...]:
        """Terms that leave something on the part at their magnitude, by falling Sq."""
        return tuple(n for n in self.order if self.sq[self.names.index(n)] > 0.0)

    @property
    def hidden(self) -> dict[str, tuple[str, ...]]:
        """Terms that leave nothing on the part, by the reason."""
        raw = np.diag(self.unit_gram.raw)
        found: dict[str, list[str]] = {}
        for n in (n for n in self.names if n not in self.visible):
            i = self.names.index(n)
            if raw[i] == 0.0:
                why = "no effect on this part"
            elif n in self.unobservable:
                why = f"taken away by the alignment: {', '.join(self.removed)}"
            else:
                why = "size zero"
            found.setdefault(why, []).append(n)
        return {why: tuple(names) for why, names in found.items()}

    @property
    def order(self) -> tuple[str, ...]:
        """Terms by falling Sq after alignment."""
        return tuple(self.names[i] for i in np.argsort(-self.sq, kind="stable"))

    @property
    def expected_sq(self) -> float:
        """Root of the expected mean square after alignment, ``tr(G S) + mu' G mu``, m."""
        return _root(expected_mean_square(self.gram, self.covariance, self.mean))

    @property
    def expected_sq_raw(self) -> float:
        """The same before alignment, m."""
        return _root(expected_mean_square(self.unit_gram.raw, self.covariance, self.mean))

    @property
    def sq_together(self) -> float:
        """Sq after alignment with every term at plus its magnitude at once, m."""
        return _root(self.magnitudes @ self.gram @ self.magnitudes)

    @property
    def sq_together_raw(self) -> float:
        """The same before alignment, m."""
        return _root(self.magnitudes @ self.unit_gram.raw @ self.magnitudes)

    def __getitem__(self, term: str) -> Quantity:
        """Return Sq of a term after alignment, with its definition."""
        kind = self.direction if self.response == "form" else self.response
        text = (
            f"Sq of the {kind} deviation from {term} = {self.size_text(term)}; "
            f"removed: {', '.join(self.removed) or 'nothing'}; area-weighted"
        )
        return Quantity(float(self.sq[self._place(term)]), "m", text, symbol="Sq")

    def size_text(self, term: str) -> str:
        """Return the magnitude of a term as it was written, or with three digits and its unit.

        Parameters
        ----------
        term : str
            Of `names`.

        Returns
        -------
        str
            Such as ``"1 arcsec"``; numbers of radians have the unit in which they are round.

        Raises
        ------
        DataError
            If the term is not in the table.
        """
        i = self._place(term)
        written = self.typed[i] if self.typed else ""
        return written or amount_text(float(self.magnitudes[i]), self.units[i])

    def unit_maps(self, *, aligned: bool = True) -> FloatArray:
        """Return the map of a unit of each term on the polar mesh.

        Parameters
        ----------
        aligned : bool, optional
            Whether the removed freedoms are removed.

        Returns
        -------
        ndarray, shape (n_rho, n_azimuth, m), m per unit
            NaN where the surface is not defined.
        """
        whole = self.maker.mesh.whole(self._maps(aligned=aligned))
        whole.setflags(write=False)
        return whole

    def zernike(self, terms: int = 15, *, order: ZernikeOrder = "ansi") -> pd.DataFrame:
        """Return what each error term, at its magnitude, adds to the Zernike terms of the part.

        Parameters
        ----------
        terms : int, optional
            How many first Zernike terms, fitted together with the area as weight.
        order : {"ansi", "noll", "fringe"}, optional
            How they are counted; ANSI and Noll are normalised to rms.

        Returns
        -------
        pandas.DataFrame
            Index ``term``; a column ``Z4_nm`` ... for each Zernike term, nothing removed before,
            and ``rest_nm``, the rms that they leave.

        Raises
        ------
        DataError
            If the Zernike terms do not exist.
        DegenerateFitError
            If the points do not determine them.

        Notes
        -----
        Of the form, or of the wavefront where that is the response. The disc is the part.
        """
        import pandas as pd

        from metrosep.forms.zernike import Zernike

        mesh, maps = self.maker.mesh, self._maps(aligned=False) * self.magnitudes
        form = Zernike(terms, order=order, radius=1e-3 * float(self.audit["radius_mm"]))
        weights = mesh.weights / float(mesh.weights.max())
        rows = []
        for k, name in enumerate(self.names):
            fit, left = form.fit_list(mesh.x, mesh.y, maps[:, k], weights=weights)
            found = {f"{z}_nm": 1e9 * float(v or 0.0) for z, v in fit.form.parameters.items()}
            rest = float(np.sqrt((mesh.weights * left**2).sum() / mesh.weights.sum()))
            rows.append({"term": name, **found, "rest_nm": 1e9 * rest})
        return pd.DataFrame(rows).set_index("term")

    def monte_carlo(
        self, n: int = 10000, *, seed: int = 0, maps: bool = False
    ) -> MonteCarloResult:
        """Draw the errors and return Sq of each draw, and P-V if maps are wanted.

        Parameters
        ----------
        n : int, optional
            Draws, at least 2.
        seed : int, optional
            Of the generator.
        maps : bool, optional
            Whether every drawn map is made, for its P-V: slower. Sq needs only the Gram matrix.

        Returns
        -------
        MonteCarloResult
            Sq, P-V (or None), and the mean square beside its expectation.

        Raises
        ------
        DataError
            If the amounts are uniform and correlated: then their covariance says too little.
        TooFewSamplesError
            If n is below 2.
        """
        amounts = self._amounts(n, seed)
        unit = self._maps(aligned=True) if maps else None
        return drawn_maps(self.gram, amounts, self.expected_sq**2, unit)

    @described_by(sobol_indices, errors=False)
    def sobol(self, n: int = 65536, *, seed: int = 0) -> SobolIndices:
        """Return Sobol indices of Sq (not of its square) after alignment.

        Returns
        -------
        SobolIndices
            In the order of `names`.

        Raises
        ------
        DataError
            If the terms are correlated: the indices hold for independent ones.
        TooFewSamplesError
            If n is below 64.
        """
        if self._is_correlated():
            raise DataError(
                "Sobol indices need independent terms, these are correlated; take shares"
            )
        options: Any = {"mean": self.mean, "distribution": self.distribution, "n": n, "seed": seed}
        return sobol_indices(self.gram, self._spreads(), **options)

    def pareto(self, *, by: str = "group", left: float = 0.0) -> tuple[ParetoStep, ...]:
        """Return what is left when the terms are compensated one after the other, best first.

        Parameters
        ----------
        by : {"group", "term"}, optional
            Whether terms that cannot be distinguished go together.
        left : float, optional
            Share of an amount that its compensation leaves, 0 to 1.

        Returns
        -------
        tuple of ParetoStep
            The first compensates nothing. Each next takes the term or group after which least is
            left.

        Raises
        ------
        DataError
            If `by` is unknown.
        InvalidSamplesError
            If `left` is not between 0 and 1.
        """
        numbers.choice(by, "by", ("group", "term"))
        left = numbers.between(left, "left", 0.0, 1.0)
        grouped = {n: g for g in self.groups for n in g} if by == "group" else {}
        open_sets = list(dict.fromkeys(grouped.get(n, (n,)) for n in self.names))
        factors = np.ones(len(self.names))
        steps = [ParetoStep((), self._expected(factors))]
        while open_sets:
            trials = []
            for names in open_sets:
                trial = factors.copy()
                trial[[self.names.index(n) for n in names]] = left
                trials.append((self._expected(trial), trial))
            best = min(range(len(trials)), key=lambda k: trials[k][0])
            steps.append(ParetoStep(open_sets.pop(best), trials[best][0]))
            factors = trials[best][1]
        return tuple(steps)

    def to_frame(self) -> pd.DataFrame:
        """Return the table, by falling Sq after alignment.

        Returns
        -------
        pandas.DataFrame
            Index ``term``; columns ``unit``, ``size`` (text), ``magnitude`` (SI), ``mean`` (SI), ``sq_raw_nm``,
            ``pv_raw_nm``, ``share_raw``, ``sq_nm``, ``pv_nm``, ``share``, ``group`` (0: none),
            ``observable``.
        """
        import pandas as pd

        return pd.DataFrame(self._rows()).set_index("term")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON.

        Returns
        -------
        dict
            Keys ``terms`` (rows as in `to_frame`), ``groups``, ``unobservable``,
            ``expected_sq_nm``, ``expected_sq_raw_nm``, ``pareto``, ``audit``, ``messages``.
        """
        return {
            "terms": plain_rows(self._rows()),
            "groups": [list(g) for g in self.groups],
            "unobservable": list(self.unobservable),
            "expected_sq_nm": 1e9 * self.expected_sq,
            "expected_sq_raw_nm": 1e9 * self.expected_sq_raw,
            "pareto": [{"compensated": list(s.names), "sq_nm": 1e9 * s.sq} for s in self.pareto()],
            "audit": dict(self.audit),
            "messages": list(self.messages),
        }

    def report(self) -> str:
        """Return the table as text, ranked, with groups, what is unobservable, and messages.

        Returns
        -------
        str
            Several lines.
        """
        return report_text(self)

    def __repr__(self) -> str:
        return shortened(
            f"SensitivityTable({len(self.names)} terms, {self.response}, removed "
            f"{', '.join(self.removed) or 'nothing'}, expected Sq "
            f"{format_length(self.expected_sq)}, first {self.order[0]})"
        )

    def _rows(self) -> list[dict[str, Any]]:
        group = {n: k for k, g in enumerate(self.groups, start=1) for n in g}
        columns = {
            "magnitude": self.magnitudes,
            "mean": self.mean,
            "sq_raw_nm": 1e9 * self.sq_raw,
            "pv_raw_nm": 1e9 * self.pv_raw,
            "share_raw": self.shares_raw,
            "sq_nm": 1e9 * self.sq,
            "pv_nm": 1e9 * self.pv,
            "share": self.shares,
        }
        gone = self.unobservable
        return [
            {
                "term": n,
                "unit": self.units[i],
                "size": self.size_text(n),
                **{k: float(v[i]) for k, v in columns.items()},
                "group": group.get(n, 0),
                "observable": n not in gone,
            }
            for n, i in ((n, self.names.index(n)) for n in self.order)
        ]

    def _place(self, term: str) -> int:
        if term not in self.names:
            raise DataError(f"{term!r} was not ranked; there are {', '.join(self.names)}")
        return self.names.index(term)

    def _maps(self, *, aligned: bool) -> FloatArray:
        maps = self.maker.make()
        if aligned:
            maps = self.space.remove(maps)
            maps[:, self.unit_gram.is_removed] = 0.0
        return maps

    def _spreads(self) -> FloatArray:
        """Return the half-width or standard uncertainty of the random part of each term."""
        return np.asarray(np.sqrt(np.diag(self.covariance)) / DISTRIBUTIONS[self.distribution])

    def _second_moment(self) -> FloatArray:
        """Return ``S + mu mu'``: with it, shares add up to the whole expectation."""
        return self.covariance + np.outer(self.mean, self.mean)

    def _is_correlated(self) -> bool:
        return bool((self.covariance != np.diag(np.diag(self.covariance))).any())

    def _amounts(self, n: int, seed: int) -> FloatArray:
        if not self._is_correlated():
            return draws(n, self._spreads(), self.mean, self.distribution, seed)
        if self.distribution != "normal":
            raise DataError(
                "uniform and correlated: the covariance does not say how such errors are "
                "distributed; give standard uncertainties with distribution='normal'"
            )
        return correlated_draws(n, self.covariance, self.mean, seed)

    def _expected(self, factors: FloatArray) -> float:
        covariance = self.covariance * np.outer(factors, factors)
        return _root(expected_mean_square(self.gram, covariance, self.mean * factors))


def _root(square: Any) -> float:
    """Return the root of a square; effects that cancel leave rounding, which may be negative."""
    return float(np.sqrt(max(float(square), 0.0)))


# ---- monte Carlo of error terms: Sq of each draw from the Gram matrix, P-V from its map --------

_DRAWS, _POINTS = 256, 1024
"""Of a block: its products stay in the cache until their extremes are taken."""


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloResult:
    """Drawn errors and what they do."""

    amounts: FloatArray  # shape (n, m): drawn amounts of the terms
    sq: FloatArray  # shape (n,), m: of each draw after alignment
    pv: FloatArray | None  # shape (n,), m: if maps were made
    mean_square: float  # m^2: mean of Sq^2, and its standard uncertainty from the number of draws
    u_mean_square: float
    expected: float  # m^2: ``tr(G S) + mu' G mu``

    def quantile(self, p: float) -> float:
        """Return the Sq in m that a share p (0 to 1) of the parts stays below."""
        return float(np.quantile(self.sq, p))


def correlated_draws(n: int, covariance: FloatArray, mean: FloatArray, seed: int) -> FloatArray:
    """Return normal draws with a covariance that may be singular, shape (n, m)."""
    size = np.sqrt(np.diag(covariance))
    safe = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    unit = np.random.default_rng(seed).standard_normal((n, mean.size))
    return np.asarray(mean + (unit @ root.T) * size)


def drawn_maps(
    gram: FloatArray, amounts: FloatArray, expected: float, maps: FloatArray | None
) -> MonteCarloResult:
    """Return Sq of each draw, and P-V if unit maps (n_points, m) are given."""
    n = amounts.shape[0]
    if n < 2:
        raise TooFewSamplesError(f"a Monte Carlo needs at least 2 draws, got {n}")
    square = np.maximum(np.sum((amounts @ gram) * amounts, axis=1), 0.0)
    sq = np.sqrt(square)
    pv = None if maps is None else peak_to_valleys(maps, amounts)
    for array in (amounts, sq, pv):
        if array is not None:
            array.setflags(write=False)
    spread = float(square.std(ddof=1) / np.sqrt(n))
    return MonteCarloResult(amounts, sq, pv, float(square.mean()), spread, expected)


def peak_to_valleys(maps: FloatArray, amounts: FloatArray) -> FloatArray:
    """Return the P-V of every ``maps @ amounts``; blocked, one thread.

    In single precision, each map scaled to its amounts: 1e-6 of the P-V, in half the time. The
    mean square needs no maps: the Gram matrix holds it to rounding.
    """
    size = np.abs(amounts).max(axis=0)
    unit = np.divide(amounts, size, out=np.zeros_like(amounts), where=size > 0.0)
    scaled = maps * size
    top = float(np.abs(scaled).max(initial=0.0)) or 1.0
    turned = np.ascontiguousarray((scaled / top).T, dtype=np.float32)
    factors = unit.astype(np.float32)
    n = amounts.shape[0]
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    block = np.empty((_DRAWS, _POINTS), dtype=np.float32)
    with one_blas_thread():
        for i in range(0, n, _DRAWS):
            q = factors[i : i + _DRAWS]
            rows = slice(i, i + q.shape[0])
            for j in range(0, turned.shape[1], _POINTS):
                points = turned[:, j : j + _POINTS]
                drawn = block[: q.shape[0], : points.shape[1]]
                np.matmul(q, points, out=drawn)
                np.minimum(low[rows], drawn.min(axis=1), out=low[rows])
                np.maximum(high[rows], drawn.max(axis=1), out=high[rows])
    result: FloatArray = (high - low) * top
    return result


# ---- the table as text for a terminal ------------------------------------------------------------

_ANGLES = (("urad", 1e-6), ("arcsec", math.pi / 648e3), ("deg", math.pi / 180.0))
_ROUND = 1e-9
"""Of the amount: a number this near to one of three digits was typed as that."""


def plain_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of a table for JSON: None for NaN."""
    return [{k: None if v != v else v for k, v in row.items()} for row in rows]


def amount_text(value: float, unit: str) -> str:
    """Return an amount of a term with three digits; an angle in the unit in which it is round."""
    if value != value:
        return "not known"
    if unit != "rad":
        return f"0 {unit}" if value == 0.0 else format_length(value, digits=3)
    texts = {name: f"{value / factor:.3g}" for name, factor in _ANGLES}
    digits = {
        name: len(text.partition("e")[0].lstrip("-").replace(".", "").strip("0"))
        for name, text in texts.items()
    }
    round_ones = [
        name
        for name, factor in _ANGLES
        if abs(float(texts[name]) * factor - value) <= _ROUND * abs(value)
    ]
    name = min(round_ones, key=digits.__getitem__, default="urad")
    return f"{texts[name]} {name}"


def report_text(table: SensitivityTable) -> str:
    """Return the ranked table, what hangs together, what is left after compensation, messages."""
    kind = f"{table.direction} deviation" if table.response == "form" else "optical path"
    meaning = "standard uncertainty" if table.distribution == "normal" else "half-width, uniform"
    lines = [
        f"Error terms ranked by Sq of the {kind}; removed: {', '.join(table.removed) or 'nothing'}",
        f"magnitude: {meaning}; area-weighted over {table.space.weights.size} points",
        "",
        f"{'term':<8}{'magnitude':>12}{'Sq raw':>12}{'Sq':>12}{'P-V':>12}{'share':>8}  group",
    ]
    group = {n: f"({k})" for k, g in enumerate(table.groups, start=1) for n in g}
    share, seen = table.shares, [n for n in table.order if n in table.visible]
    if not seen:
        lines[-1] = "none of these terms leaves anything that could be seen on this part"
    for name in seen:
        i = table.names.index(name)
        sizes = [format_length(float(v[i]), digits=3) for v in (table.sq_raw, table.sq, table.pv)]
        lines.append(
            f"{name:<8}{table.size_text(name):>12}{sizes[0]:>12}{sizes[1]:>12}{sizes[2]:>12}"
            f"{100.0 * share[i]:>7.1f}%  {group.get(name, '')}".rstrip()
        )
    lines += [f"not visible: {', '.join(names)} ({why})" for why, names in table.hidden.items()]
    raw = format_length(table.expected_sq_raw)
    lines += ["", f"expected Sq {format_length(table.expected_sq)} (nothing removed: {raw})"]
    lines += [
        f"({k}) {', '.join(g)}: maps alike (|r| > {table.threshold:g}), one part cannot distinguish them"
        for k, g in enumerate(table.groups, start=1)
    ]
    done: list[str] = []
    for step in table.pareto()[1:4] if seen else ():
        done.extend(step.names)
        left = format_length(step.sq) if step.sq else "nothing is left"
        lines.append(f"without {' + '.join(done)}: {left}")
        if step.sq == 0.0:  # what follows leaves nothing less
            break
    return "\n".join([*lines, *table.messages])

"""Averages that leave the instrument: random balls, and the three positions of a sphere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError
from metrosep.core.numbers import positive
from metrosep.core.options import Option, option
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation.contract import (
    U_READING,
    NamedMethod,
    Parts,
    Separation,
    Unobservable,
)
from metrosep.separation.maps._map_input import (
    checked_removed,
    map_stack,
    noise_of,
    require_overlap,
    rigid_terms,
    stored_in_si,
    unit_warnings,
    without_plane,
)
from metrosep.separation.maps._map_method import MapMethod, MapReadings, map_separation

_LEAST_PATCHES = 5


def ball_average(
    surfaces: Sequence[ArrayLike | Surface] | ArrayLike,
    *,
    dx: float | None = None,
    dy: float | None = None,
    removed: tuple[str, ...] = ("piston", "tilt", "power"),
    correlated: bool = True,
) -> Separation:
    """Return the error of an instrument from maps of many patches of a ball.

    Parameters
    ----------
    surfaces : sequence of Surface or array_like, shape (n_y, n_x), m
        At least 5 maps, in the order in which they were measured, each of another patch.
    dx, dy : float, m, optional
        Steps of plain arrays; pixels if omitted.
    removed : tuple of str, optional
        What alignment and radius decide in each map: ``"piston"``, ``"tilt"``, ``"power"``.

    Returns
    -------
    Separation
        ``.instrument`` (transmission sphere and optics), ``.patch_sd`` (scatter of one patch,
        both (n_y, n_x) in m) with their standard uncertainties.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If maps cannot be used, are fewer than 5 or do not overlap.

    Notes
    -----
    ``M_i = I + P_i``: the mean tends to I where patches are drawn at random from the whole ball, with
    ``u = s/sqrt(N_eff)``, s the scatter of one patch. Neighbouring patches that overlap say the same
    twice: ``N_eff = N / (1 + 2 sum (1 - l/N) r_l)``, r_l the autocorrelation at lag l, pooled over all
    pixels, up to the first lag at which it is not significant. s is then freed of the bias
    of correlated samples. Not seen: what all patches share, first of all piston, tilt and the radius
    (power). A ball turned about one axis only is not random: rotationally symmetric shares of the
    patches stay in the mean.

    References
    ----------
    U. Griesmann, Q. Wang, J. Soons, R. Carakos, Proc. SPIE 5869 (2005) 58690S. R. E. Parks,
    C. J. Evans, L. Shao, OSA Technical Digest Series 12 (1998) 80-83.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> x = np.linspace(-1, 1, 16)
    >>> maps = [20e-9 * x**3 * x[:, None] + 1e-9 * rng.standard_normal((16, 16)) for _ in range(50)]
    >>> bool(0.1e-9 < ball_average(maps).u["instrument"].mean() < 0.2e-9)
    True
    """
    stack, grid, history = map_stack(
        surfaces, what="ball_average", least=_LEAST_PATCHES, dx=dx, dy=dy
    )
    checked_removed(removed)
    common = require_overlap(stack, "ball_average")
    units = unit_warnings(stack, grid)
    stack = without_plane(stack, grid, removed=removed, mask=common)
    stack[:, ~common] = np.nan
    n = stack.shape[0]
    tau, lags = _repetition(stack[:, common]) if correlated else (1.0, 0)
    if n / tau < 2.0:
        raise DataError(
            f"ball_average: the {n} patches resemble each other as if there were only "
            f"{n / tau:.2g} independent ones; turn the ball further between the maps"
        )
    mean = np.where(common, stack.mean(axis=0), np.nan)
    spread = stack.std(axis=0, ddof=1)
    sd = spread * math.sqrt((n - 1.0) / (n - tau))
    u = sd * math.sqrt(tau / n)
    pooled = math.sqrt(float(np.mean(sd[common] ** 2)))
    noise = Quantity(
        pooled, "m", "standard deviation of one patch about the mean (type A)",
        u=pooled / math.sqrt(2.0 * (n / tau - 1.0)), symbol="s",
    )  # fmt: skip
    messages = list(units)
    if tau > 1.0:
        text = (
            f"neighbouring patches resemble each other: the {n} maps are worth "
            f"{n / tau:.1f} independent ones"
        )
        messages.insert(0, text)
    shared = (
        "what all patches of the ball share (its radius, a zonal error seen the same each time)"
    )
    null = (
        Unobservable("instrument", "term", ("common form of the patches",),
                     f"{shared} stays in the mean; turn the ball about all axes"),
        *rigid_terms(("instrument",), removed),
    )  # fmt: skip
    audit = {
        "n_maps": n,
        "n_effective": n / tau,
        "lags_summed": lags,
        "removed": ", ".join(removed),
        "n_pixels": int(common.sum()),
    }
    parts = {"instrument": mean, "patch_sd": np.where(common, sd, np.nan)}
    u_parts = {"instrument": u, "patch_sd": sd / math.sqrt(2.0 * (n / tau - 1.0))}
    return map_separation(
        "ball_average", grid, parts, u_parts, null, noise, audit, messages, history,
        {"removed": list(removed)},
    )  # fmt: skip


class BallTest(NamedMethod):
    """`ball_average` by its name."""

    name = "ball_average"
    what = "error of an instrument from maps of many patches of a ball"
    reads = "maps"
    arguments: ClassVar[Mapping[str, Option]] = {
        "removed": Option(
            "texts", help="terms that are set-up, not form: piston,tilt or piston,tilt,power"
        ),
        "correlated": Option(
            "flag",
            help="true: neighbours in the order may overlap; the effective number of patches is then "
            "found from the autocorrelation along the order",
        ),
    }


@dataclass(frozen=True, slots=True)
class ThreePositions(MapMethod):
    """Sphere at the confocal position, turned by 180 degrees there, and at the cat's eye.

    ``W0 = I + S``, ``W180 = I + S(-x, -y)``, ``Wc = I - D_o``: I is the whole instrument
    (reference arm and diverger), D_o the share of the diverger that is odd under half a turn, which
    the cat's eye loses because rays come back on the other side. Maps: at 0 degrees, at 180 degrees,
    at the cat's eye. Parts: ``part``, ``instrument`` and ``diverger_odd``, only whose odd share counts.

    Parameters
    ----------
    dx, dy : float, m, optional
        Lateral steps; pixels if omitted.
    removed : tuple of str, optional
        What alignment decides in each reading.
    """

    dx: float | None = None
    dy: float | None = None
    removed: tuple[str, ...] = option(
        ("piston", "tilt", "power"),
        kind="texts",
        help="terms that are set-up, not form: piston,tilt or piston,tilt,power",
    )

    name = "three_positions"
    what = "form of a sphere and error of the interferometer from three positions"
    reads = "maps"
    readings = ("confocal", "confocal_180", "cats_eye")
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("part",)
    error_parts = ("instrument", "diverger_odd")

    def __post_init__(self) -> None:
        checked_removed(self.removed)
        stored_in_si(self, positive, dx="length", dy="length")

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        part, instrument, diverger = self._given(truth, errors)[0]
        odd = (diverger - _half_turn(diverger)) / 2.0
        return np.stack([instrument + part, instrument + _half_turn(part), instrument - odd])

    def null_space(self) -> tuple[Unobservable, ...]:
        even = Unobservable(
            "instrument", "term", ("share of the diverger that half a turn does not change",),
            "reference arm and diverger act together there; their sum is in the instrument",
        )  # fmt: skip
        return (even, *rigid_terms((*self.truth_parts, *self.error_parts), self.removed))

    def _names(self) -> tuple[str, ...]:
        return ("0 deg", "180 deg", "cat's eye")

    def _separated(self, read: MapReadings) -> Separation:
        stack, grid, common, u_reading, history = read
        units = unit_warnings(stack, grid)
        common = common & common[::-1, ::-1]
        if common.sum() < 30:
            raise DataError(
                f"{self.name}: only {int(common.sum())} pixels have a measured counterpart half a "
                "turn away; centre the aperture in the map"
            )
        stack = without_plane(stack, grid, removed=self.removed, mask=common)
        stack[:, ~common] = np.nan
        turned = _half_turn(stack)
        even, odd = (stack + turned) / 2.0, (stack - turned) / 2.0
        part = (even[0] + even[1]) / 2.0 - even[2] + (odd[0] - odd[1]) / 2.0
        instrument = even[2] + (odd[0] + odd[1]) / 2.0
        diverger = (odd[0] + odd[1]) / 2.0 - odd[2]
        # W0 - W180 must change its sign under half a turn: its even share is noise
        closure = (even[0] - even[1])[None]
        noise = noise_of(closure, float(common.sum()), u_reading)
        parts = {"part": part, "instrument": instrument, "diverger_odd": diverger}
        u = {
            name: np.where(common, noise.value * math.sqrt(factor), np.nan)
            for name, factor in (("part", 1.0), ("instrument", 0.75), ("diverger_odd", 0.75))
        }
        audit = {
            "removed": ", ".join(self.removed),
            "n_pixels": int(common.sum()),
            "closure_rms_nm": float(np.sqrt(np.mean(closure[0][common] ** 2))) * 1e9,
        }
        return map_separation(
            self.name, grid, parts, u, self.null_space(), noise, audit,
            (*units, *_warnings(stack, common)), history, {"removed": list(self.removed)},
        )  # fmt: skip


@described_by(ThreePositions, ThreePositions.separate)
def three_positions(
    confocal: ArrayLike | Surface,
    confocal_180: ArrayLike | Surface,
    cats_eye: ArrayLike | Surface,
    *,
    dx: float | None = None,
    dy: float | None = None,
    removed: tuple[str, ...] = ("piston", "tilt", "power"),
    u_reading: float | None = None,
) -> Separation:
    """Return the form of a sphere and the error of the interferometer (two-sphere test).

    Parameters
    ----------
    confocal, confocal_180 : Surface or array_like, shape (n_y, n_x), m
        Sphere at the confocal position, and turned by half a turn about the optical axis.
    cats_eye : Surface or array_like, shape (n_y, n_x), m
        Its vertex at the focus.

    Returns
    -------
    Separation
        ``.part`` (as at 0 degrees), ``.instrument`` (reference arm and diverger), ``.diverger_odd``.

    Notes
    -----
    With a bar for half a turn of the map: ``S = (W0 + bar W180 - Wc - bar Wc) / 2``, u = s.
    ``I = (Wc + bar Wc)/2 + (odd W0 + odd W180)/2``, u = s sqrt(3/4), which uses that W0 - W180 must be
    odd; its even share shows the noise. The cat's eye reads ``R + (D + bar D)/2``, R the reference
    arm, D the diverger; all maps are heights of the surface with one sign (an instrument that
    reports wavefronts needs the factor 1/2 on all three). The test is sensitive to decentring
    of the half turn: gradient times shift, half of it in each part.

    References
    ----------
    A. E. Jensen, J. Opt. Soc. Am. 63 (1973) 1313A. K. Creath, J. C. Wyant, Proc. SPIE 1531 (1992) 2-7.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 33)
    >>> S, I = 20e-9 * (x**3 * x[:, None]**2), 8e-9 * x**2 * x[:, None]**2
    >>> result = three_positions(I + S, I + np.rot90(S, 2), I, removed=("piston",))
    >>> bool(abs(result.part - S).max() < 1e-20)
    True
    """
    maps: list[Any] = [confocal, confocal_180, cats_eye]
    return ThreePositions(dx, dy, tuple(removed)).separate(maps, u_reading=u_reading)


def _half_turn(z: FloatArray) -> FloatArray:
    return z[..., ::-1, ::-1]


def _repetition(values: FloatArray) -> tuple[float, int]:
    """Return N/N_eff of a sequence of maps (N, k), and how many lags it took."""
    n = values.shape[0]
    rest = values - values.mean(axis=0)
    variance = float(np.sum(rest**2)) / n
    if variance == 0.0:
        return 1.0, 0
    tau, used = 1.0, 0
    for lag in range(1, n // 2):
        products = np.sum(rest[lag:] * rest[:-lag], axis=1)
        correlation = float(products.mean()) / variance + tau / n  # the mean was taken off
        spread = float(products.std(ddof=1)) / variance / math.sqrt(products.size)
        if correlation < 3.0 * spread:
            break
        tau += 2.0 * (1.0 - lag / n) * correlation
        used = lag
    return tau, used


def _warnings(stack: FloatArray, common: NDArray[np.bool_]) -> tuple[str, ...]:
    """Say that the reading at 180 degrees is that at 0 degrees."""
    size = float(np.sqrt(np.mean(stack[0][common] ** 2)))
    difference = float(np.sqrt(np.mean((stack[0] - stack[1])[common] ** 2)))
    if size > 0.0 and difference < 1e-9 * size:
        return ("the readings at 0 and 180 deg are the same: is it one file twice?",)
    return ()

"""Ranking of the error terms of a machine by what they do to a given part.

Each term gets a map of its unit effect from the closed-form Jacobian of the chain; an alignment is
projected out of the maps; the Gram matrix of what is left answers the rest: Sq, shares, groups that
one part cannot tell apart, Monte Carlo. `error = actual - nominal`, z out of the material.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, OptionError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.regions import assumed_axis
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.machine._mesh import (
    N_AZIMUTH,
    N_RHO,
    Positions,
    SurfaceMesh,
    axis_positions,
    checked_place,
    checked_radii,
    polar_mesh,
)
from metrosep.machine._responses import MapMaker, Shape, WavefrontHook, path_hook
from metrosep.machine.alignment import Alignment, alignment_space, removed_freedoms
from metrosep.machine.elements import axis_of, term_unit
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.gram import AlignedGram, aligned_gram, check_covariance, groups_alike
from metrosep.machine.sensitivity import SensitivityTable
from metrosep.machine.sobol import DISTRIBUTIONS
from metrosep.machine.terms import FourierTerm, TrialAmounts

_LARGE_ANGLE = 0.1
"""rad: a plain number beyond it was hardly meant in rad, and first order holds no more."""

_REACHED = 1e-6
"""Of the radius: a tool point this near to its place is there."""


def rank(
    chain: Any,
    surface: Any,
    *,
    radius: float,
    errors: Any,
    removed: str | Iterable[str] = ("piston", "tilt"),
    response: str = "form",
    direction: str = "vertical",
    distribution: str = "normal",
    mean: Mapping[str, float | str] | None = None,
    correlations: Mapping[tuple[str, str], float] | ArrayLike | None = None,
    inner_radius: float = 0.0,
    centre: tuple[float, float] | None = None,
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0),
    positions: Positions | None = None,
    wavefront: WavefrontHook | None = None,
    mode: str = "reflect",
    n: float | None = None,
    threshold: float = 0.9,
    n_rho: int = N_RHO,
    n_azimuth: int = N_AZIMUTH,
) -> SensitivityTable:
    """Rank error terms by the deviation they leave on a part after alignment.

    Parameters
    ----------
    chain : Chain
        The machine.
    surface : Form or Surface
        Nominal surface; a form counts from its own origin, which lies on the axis of the part.
    radius : float, m
        Outer radius of the part.
    errors : mapping of str to float, str, callable or ErrorTerm, or ErrorSet
        Term -> magnitude in SI, or as text with a unit (``"1 um"``, ``"0.001 deg"``): an error that
        is constant over the travel of its axis. A text may also give a curve of random phase:
        ``"wave 8 mm 1 um"`` (wavelength, amplitude), ``"2 upr 50 nm"`` (of a rotary axis),
        ``"random 1 um length 5 mm"`` (sd, Gaussian covariance ``exp(-d^2 / (2 length^2))``). A function
        of the axis position or an error term (`TableTerm`) is a known curve, which acts with its
        shape, as those of an error set do; the magnitude of these is ``sqrt(value^2 + u^2)``.
    removed : str or iterable of str, optional
        Freedoms that an alignment removes: ``"none"``, ``"piston"``, ``"plane"``,
        ``"plane+defocus"``, ``"rigid"``, or names of `metrosep.machine.alignment.FREEDOMS`.
    response : {"form", "wavefront"}, optional
        Deviation of the surface, or change of the optical path of a reflected plane wave.
    direction : {"vertical", "normal"}, optional
        Of the deviation of the form.
    distribution : {"normal", "uniform"}, optional
        Whether a magnitude is a standard uncertainty or a half-width.
    mean : mapping of str to float or str, optional
        What is known of terms; zero where nothing stands.
    correlations : mapping or array_like, shape (m, m), optional
        Of the random part: ``{("EXX", "EYX"): 0.5}``, or the matrix in the order of `errors`.
    inner_radius : float, m, optional
        Inner radius; the part lies between both.
    centre : tuple of (float, float), m, optional
        Axis of the part in the coordinates of the surface; of a map without origin the middle
        of what was measured.
    tool : tuple of (float, float, float), m, optional
        Tool point in the frame of the last element of the tool branch.
    positions : callable or mapping of str to float or str, optional
        ``positions(x, y, z)`` returns axis positions by name; found for lathes (spindle at minus
        the azimuth) and machines of three linear axes. A mapping states where axes of rotation are
        locked (rad, or a text such as ``"30 deg"``): the linear axes are found, and one axis that
        carries the part and is not named turns it as a spindle, at minus the azimuth.
    wavefront : callable, optional
        Turns a change of height and slopes into optical path, in place of `mode`.
    mode : {"reflect", "refract"}, optional
        What the surface does to a plane wave along -z; of the response "wavefront".
    n : float, optional
        Refractive index of the material, to refract.
    threshold : float, optional
        Of ``|r|``: terms more alike are a group.
    n_rho, n_azimuth : int, optional
        Radii (at the middle of rings of equal width) and azimuths of the mesh.

    Returns
    -------
    SensitivityTable
        Terms with Sq and P-V before and after, shares, groups.

    Raises
    ------
    DataError
        If a term, freedom or option is unknown, no term is given, a unit does not fit, the way
        from a point of the part to axis positions is not known, or the form ends inside `radius`.
    InvalidSamplesError
        If a magnitude is negative or not finite, radii do not fit, correlations are none, or an
        effect is not finite.
    TooFewSamplesError
        If the mesh is too coarse or the surface covers almost none of it.
    UnitError
        If a text has no unit or one of another kind.

    Notes
    -----
    ``d = Ez - dz/dx Ex - dz/dy Ey`` [1]_; Sq is the root of the mean of d^2 over the area seen
    along z. First order in the errors: exact poses differ by 0.04 nm at 1 um and 0.001 deg on a
    part of 20 mm. Points where a measured map is NaN are omitted and counted in a message. The mesh
    holds no point at the centre, where the azimuth is not defined.

    References
    ----------
    .. [1] papers.md, sections 0 and 4.3.

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> from metrosep.machine.chains import presets
    >>> lathe = presets("fts_lathe", radius=20e-3)
    >>> table = rank(
    ...     lathe, Toric(Rb=0.265, Rd=0.1325), radius=20e-3, n_rho=50, n_azimuth=72,
    ...     errors={"EXX": "1 um", "EZX": "1 um", "B0Z": "0.001 deg"})
    >>> table.order, table.unobservable
    (('B0Z', 'EXX', 'EZX'), ('EZX',))
    """
    numbers.choice(response, "response", ("form", "wavefront"))
    numbers.choice(direction, "direction", ("vertical", "normal"))
    if response == "wavefront" and direction == "normal":
        raise DataError("a wavefront has no normal direction; leave direction out")
    if wavefront is not None and not callable(wavefront):
        raise DataError(f"wavefront is a function, got {type(wavefront).__name__}")
    if response != "wavefront" and (n is not None or mode != "reflect"):
        raise DataError('mode and n belong to response="wavefront"; a form has neither')
    if response == "wavefront" and wavefront is None:
        wavefront = path_hook(mode, n)
    freedoms = removed_freedoms(removed)
    notes: tuple[str, ...] = ()
    if centre is None and isinstance(surface, Surface):
        centre, notes = assumed_axis(surface)
    radius, inner_radius = checked_radii(radius, inner_radius)
    lengths: Any = {"radius": radius, "inner_radius": inner_radius, "centre": centre}
    mesh = polar_mesh(surface, **lengths, n_rho=n_rho, n_azimuth=n_azimuth)
    place = checked_place(tool)
    if isinstance(errors, ErrorSet):
        q = axis_positions(chain, mesh.x, mesh.y, mesh.z, positions=positions, tool=place)
        if mean is not None or correlations is not None or distribution != "normal":
            raise DataError(
                "an ErrorSet holds values, uncertainties and correlations itself: leave out mean, "
                "correlations and distribution"
            )
        amounts = amounts_of_set(chain, errors, q)
    else:
        known = _known_curves(errors)
        rest = {n: v for n, v in errors.items() if n not in known} if known else errors
        twice = [n for n in known if n in (mean or {})]
        if twice:
            raise DataError(
                f"{twice[0]} is a known curve, so it has no mean; leave it out of mean"
            )
        parts = []
        if rest or not known:
            parts.append(
                term_amounts(
                    chain, rest, mean=mean, correlations=correlations, distribution=distribution
                )
            )
        if known:
            q = axis_positions(chain, mesh.x, mesh.y, mesh.z, positions=positions, tool=place)
            parts.append(amounts_of_set(chain, ErrorSet(known), q))
        amounts = parts[0] if len(parts) == 1 else _joined(parts[0], parts[1], tuple(errors))
    random = _random_curves(chain, errors)
    if random and correlations is not None:
        raise DataError(
            f"{next(iter(random))} has a random phase and correlates with nothing; leave correlations out"
        )
    maker = MapMaker(
        chain,
        mesh,
        amounts.names,
        response,
        direction,
        place,
        positions,
        wavefront,
        {**amounts.shapes, **{n: curve.shown for n, curve in random.items()}},
    )
    columns = maker.freedoms(freedoms)
    space = alignment_space(freedoms, columns, mesh.weights, scales=_scales(freedoms, mesh))
    gram = aligned_gram(maker.make(), space)
    for name, curve in random.items():
        gram = _with_random(gram, amounts.names.index(name), curve, name, maker, space)
    audit = {
        "radius_mm": 1e3 * radius,
        "inner_radius_mm": 1e3 * inner_radius,
        "n_rho": mesh.shape[0],
        "n_azimuth": mesh.shape[1],
        "n_missing": mesh.n_missing,
        "removed": freedoms,
        "dropped": space.dropped,
        "response": response,
        "direction": direction,
        **({"mode": mode, "refractive_index": n} if response == "wavefront" else {}),
        "distribution": distribution,
        "tool_mm": tuple(1e3 * v for v in place),
        "weights": "area along z",
    }
    return SensitivityTable(
        names=amounts.names,
        units=amounts.units,
        magnitudes=amounts.magnitudes,
        mean=amounts.mean,
        distribution=distribution,
        covariance=amounts.covariance,
        unit_gram=gram,
        space=space,
        groups=groups_alike(gram.matrix, amounts.names, threshold=threshold),
        threshold=threshold,
        response=response,
        direction=direction,
        maker=maker,
        audit=freeze_mapping(audit),
        typed=amounts.typed,
        messages=(
            *notes,
            *getattr(chain, "messages", ()),
            *_large_angles(amounts, errors, mean),
            *_reach(maker),
            *_messages(amounts, gram, space, mesh, random),
        ),
    )


def _scales(names: tuple[str, ...], mesh: SurfaceMesh) -> FloatArray:
    """Return the size that the map of each freedom could have: below 1e-9 of it, it is rounding."""
    size = float(mesh.rho[-1])
    slope = float(np.sqrt(np.sum(mesh.weights * (mesh.slope_x**2 + mesh.slope_y**2))))
    turn = size * slope
    known = {"shift_x": 1e-3, "shift_y": 1e-3, "rotation_z": max(turn, 1e-3 * size)}
    return np.array([known.get(n, 0.0) for n in names])


def _reach(maker: MapMaker) -> tuple[str, ...]:
    """Return a message where given axis positions do not put the tool on the part."""
    if maker.positions is None:
        return ()
    miss = maker.miss()
    if miss <= _REACHED * float(maker.mesh.rho[-1]):
        return ()
    text = (
        f"the axis positions put the tool up to {format_length(miss)} beside the points they "
        "should cut; check the signs, unless this is meant"
    )
    return (text,)


def _large_angles(
    amounts: TermAmounts, errors: Any, mean: Mapping[str, float | str] | None
) -> list[str]:
    """Return a message for each angle of a plain number that looks like degrees."""
    found = []
    for kind, given in (("magnitude", errors), ("mean", mean)):
        if not isinstance(given, Mapping):
            continue
        for name, unit in zip(amounts.names, amounts.units, strict=True):
            value = given.get(name, 0.0)
            plain = unit == "rad" and numbers.is_real(value)
            if plain and abs(float(value)) > _LARGE_ANGLE:
                found.append(
                    f"{name}: a {kind} of {float(value):.4g} was taken as rad, no small error; if "
                    f'it is in degrees, write "{float(value):g} deg"'
                )
    return found


def _messages(
    amounts: TermAmounts,
    gram: AlignedGram,
    space: Alignment,
    mesh: SurfaceMesh,
    random: Mapping[str, RandomCurve],
) -> tuple[str, ...]:
    found = [
        f"{n}: {curve.text} over the travel; Sq is the root of the mean square over all phases, P-V "
        f"and maps are those of one {'phase' if len(curve.waves) == 1 else 'draw'}"
        for n, curve in random.items()
    ]
    curves = {*amounts.shapes, *random}
    flat = [n for n, d in zip(amounts.names, np.diag(gram.raw), strict=True) if d == 0.0]
    gone = [n for n, g in zip(amounts.names, gram.is_removed, strict=True) if g and n not in flat]
    motions = {n for n in amounts.names if axis_of(n) is not None}
    for names, why in (
        ([n for n in gone if n not in motions], ""),
        (
            [n for n in gone if n in motions and n not in curves],
            " of this constant; a curve of the same term leaves a deviation",
        ),
        ([n for n in gone if n in curves], " of this curve"),
    ):
        if names:
            found.append(
                f"{', '.join(names)}: the alignment ({', '.join(space.used)}) takes the whole effect{why}"
            )
    constant = [n for n in amounts.names if n in motions and n not in curves]
    if constant:
        found.append(
            f"{', '.join(constant)}: one number, so constant over the travel; a bow or a wave of "
            "this size leaves another deviation"
        )
    if flat:
        found.append(f"{', '.join(flat)}: no effect on this part with this tool point")
    if space.dropped:
        found.append(
            f"{', '.join(space.dropped)}: does what the other freedoms do, or nothing, on this "
            "surface; counted once"
        )
    if mesh.n_missing:
        share = 100.0 * mesh.n_missing / (mesh.shape[0] * mesh.shape[1])
        found.append(
            f"the surface is not defined at {mesh.n_missing} points of the mesh ({share:.1f} %); "
            "they are omitted"
        )
    if amounts.shapes:
        found.append(
            f"{', '.join(amounts.shapes)}: function of the axis position; the magnitude is its "
            "largest amount, and its uncertainty is taken to have its shape"
        )
    zero = [n for n, v in zip(amounts.names, amounts.magnitudes, strict=True) if v == 0.0]
    if zero:
        found.append(f"{', '.join(zero)}: magnitude zero, so no part in the ranking")
    return tuple(found)


# ---- curves of which only the size and the wavelength are known -------------------------------------

_CURVES = (
    re.compile(r"wave\s+(?P<length>[\d.]+\s*[^\W\d]+)\s+(?P<size>\S.*)"),
    re.compile(r"(?P<upr>\d+)\s*upr\s+(?P<size>\S.*)"),
    re.compile(r"random\s+(?P<size>[\d.]+\s*[^\W\d]+)\s+length\s+(?P<length>\S.*)"),
)
_DRAWN = 0.05  # of its unit: the size in which a draw is laid out
_NODES = 24
"""Of the Gauss-Hermite rule over the spectrum of a random curve; half of them are wavelengths."""


@dataclass(frozen=True, slots=True, eq=False)
class RandomCurve:
    """A curve of random phase: waves of amplitude 1 or of unit variance, with their weights."""

    text: str
    waves: tuple[tuple[float, float], ...]  # wavelength (m or rad), weight of its mean square
    name: str

    def shape(self, wavelength: float, phase: float) -> Shape:
        """Return one wave along the axis."""
        unit: Any = TrialAmounts()  # 1 m is no error of a machine, but the unit of its map
        unit[self.name] = FourierTerm([1.0], [wavelength], [phase])
        return Shape(ErrorSet(unit), self.name, False, 1.0)

    @property
    def shown(self) -> Shape:
        """Return what maps and P-V show: a wave, or one draw of a random curve."""
        if len(self.waves) == 1:
            return self.shape(self.waves[0][0], 0.0)
        wavelengths, weights = np.array(self.waves).T
        drawn = np.random.default_rng(0).normal(size=(2, len(self.waves)))
        cos, sin = drawn * np.sqrt(weights) * _DRAWN  # an error of more than 1 m is refused
        unit: Any = TrialAmounts()
        unit[self.name] = FourierTerm(
            np.hypot(cos, sin).tolist(), wavelengths.tolist(), np.arctan2(-sin, cos).tolist()
        )
        return Shape(ErrorSet(unit), self.name, False, _DRAWN)


def curve_text(text: str) -> dict[str, str] | None:
    """Return size and wavelength (or upr) of a text that describes a curve, as texts; else None."""
    for pattern in _CURVES:
        found = pattern.fullmatch(text.strip())
        if found is not None:
            return found.groupdict()
    return None


def _random_curves(chain: Any, errors: Any) -> dict[str, RandomCurve]:
    """Return the terms that were given as a wave or as a random curve."""
    if isinstance(errors, ErrorSet) or not isinstance(errors, Mapping):
        return {}
    kinds = {e.name: e.kind for e in chain.elements}
    found = {}
    for name, value in errors.items():
        given = curve_text(value) if isinstance(value, str) else None
        if given is None:
            continue
        axis = axis_of(name)
        if axis is None:
            raise DataError(f"{name} is a constant and has no wave; give its size alone")
        if "upr" in given:
            if kinds[axis] != "rotary" or int(given["upr"]) < 1:
                raise DataError(
                    f"{name} = {value!r}: undulations per revolution (1 or more) belong to a rotary axis"
                )
            waves: tuple[tuple[float, float], ...] = ((2.0 * np.pi / int(given["upr"]), 0.5),)
        else:
            dimension = "angle" if kinds[axis] == "rotary" else "length"
            length = numbers.positive(
                given["length"], f"wavelength of {name}", dimension=dimension
            )
            waves = ((length, 0.5),) if value.strip().startswith("wave") else _spectrum(length)
        found[name] = RandomCurve(value.strip(), waves, name)
    return found


def _spectrum(length: float) -> tuple[tuple[float, float], ...]:
    """Return waves that have the covariance ``exp(-d^2 / (2 length^2))`` in the mean."""
    nodes, weights = np.polynomial.hermite.hermgauss(_NODES)
    half = nodes > 0.0
    wavelengths = 2.0 * np.pi * length / (np.sqrt(2.0) * nodes[half])
    shares = 2.0 * weights[half] / np.sqrt(np.pi)
    return tuple(zip(wavelengths.tolist(), shares.tolist(), strict=True))


def _with_random(
    gram: AlignedGram, k: int, curve: RandomCurve, name: str, maker: MapMaker, space: Alignment
) -> AlignedGram:
    """Return the Gram matrix with the mean square of a curve over all phases; it mixes with nothing."""
    raw, matrix = gram.raw.copy(), gram.matrix.copy()
    sums = np.zeros(2)
    for wavelength, weight in curve.waves:
        for phase in (0.0, -0.5 * np.pi):
            alone = replace(maker, terms=(name,), shapes={name: curve.shape(wavelength, phase)})
            part = aligned_gram(alone.make(), space)
            sums += weight * np.array([part.raw[0, 0], part.matrix[0, 0]])
    for whole, size in zip((raw, matrix), sums, strict=True):
        whole[k, :] = whole[:, k] = 0.0
        whole[k, k] = size
    removed = gram.is_removed.copy()
    removed[k] = sums[1] == 0.0
    return replace(gram, raw=raw, matrix=matrix, is_removed=removed)


# ---- how large each error term may be, from what a person writes --------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class TermAmounts:
    """Terms with magnitudes, means and covariance, in SI; shapes of functions."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    magnitudes: FloatArray  # shape (m,), as the mean; the covariance is (m, m)
    mean: FloatArray
    covariance: FloatArray
    shapes: Mapping[str, Shape] = field(default_factory=dict)
    typed: tuple[str, ...] = ()  # each magnitude as a person wrote it, empty where it was a number


def term_amounts(
    chain: Any,
    errors: Any,
    *,
    mean: Mapping[str, float | str] | None = None,
    correlations: Mapping[tuple[str, str], float] | ArrayLike | None = None,
    distribution: str = "normal",
) -> TermAmounts:
    """Return checked amounts of the terms named in `errors`, in its order."""
    numbers.choice(distribution, "distribution", DISTRIBUTIONS)
    if not hasattr(chain, "known_terms"):
        raise OptionError(
            f"the machine must be a chain, got {chain!r}; make one with metrosep.machine.presets(name)"
        )
    if not isinstance(errors, Mapping):
        raise DataError(
            "errors maps terms to magnitudes in SI, such as {'EXX': 1e-6, 'B0Z': '0.001 deg'}; got "
            f"{type(errors).__name__}"
        )
    names = chain.known_terms(tuple(errors))
    if not names:
        raise DataError(f"errors names no term; known are {', '.join(chain.terms)}")
    units = tuple(term_unit(chain, n) for n in names)
    size = np.array([_amount(errors[n], u, n) for n, u in zip(names, units, strict=True)])
    if (size < 0.0).any():
        k = int(np.argmax(size < 0.0))
        raise InvalidSamplesError(f"the magnitude of {names[k]} is {size[k]}, below zero")
    known = {} if mean is None else mean
    extra = [n for n in known if n not in names]
    if extra:
        raise DataError(f"mean names {', '.join(map(str, extra))}, which errors does not")
    middle = np.array(
        [_amount(known.get(n, 0.0), u, n) for n, u in zip(names, units, strict=True)]
    )
    sd = size * DISTRIBUTIONS[distribution]
    covariance = check_covariance(
        _correlation_matrix(correlations, names) * np.outer(sd, sd), len(names)
    )
    for array in (size, middle, covariance):
        array.setflags(write=False)
    typed = tuple(v.strip() if isinstance(v := errors[n], str) else "" for n in names)
    return TermAmounts(names, units, size, middle, covariance, typed=typed)


def _known_curves(errors: Any) -> dict[str, Any]:
    """Return the terms that were given as a curve: a term, or a function of the position."""
    if not isinstance(errors, Mapping):
        return {}
    return {
        n: v for n, v in errors.items() if callable(v) or callable(getattr(v, "evaluate", None))
    }


def _joined(one: TermAmounts, two: TermAmounts, names: tuple[str, ...]) -> TermAmounts:
    """Return amounts of magnitudes and of known curves together, in the order of the names."""
    both = (*one.names, *two.names)
    order = [both.index(n) for n in names]
    n, k = len(both), len(one.names)
    covariance = np.zeros((n, n))
    covariance[:k, :k], covariance[k:, k:] = one.covariance, two.covariance
    typed = (*one.typed, *([""] * len(two.names)))
    size = np.concatenate([one.magnitudes, two.magnitudes])[order]
    mean = np.concatenate([one.mean, two.mean])[order]
    covariance = covariance[np.ix_(order, order)]
    for array in (size, mean, covariance):
        array.setflags(write=False)
    units = (*one.units, *two.units)
    return TermAmounts(
        names,
        tuple(units[i] for i in order),
        size,
        mean,
        covariance,
        two.shapes,
        tuple(typed[i] for i in order),
    )


def amounts_of_set(chain: Any, errors: ErrorSet, q: Mapping[str, FloatArray]) -> TermAmounts:
    """Return the amounts of an error set on a part that is cut at axis positions q.

    The magnitude of a term is the root of its expected square, ``sqrt(value^2 + u^2)``. A term that
    depends on its position keeps its shape, and its uncertainty is taken to have the same shape.
    """
    names = chain.known_terms(errors.names)
    if not names:
        raise DataError(f"errors names no term; known are {', '.join(chain.terms)}")
    value, u = errors.at(q), errors.u_at(q)
    shapes: dict[str, Shape] = {}
    mean, sd = np.zeros(len(names)), np.zeros(len(names))
    for k, n in enumerate(names):
        top, top_u = (float(np.abs(v).max(initial=0.0)) for v in (value[n], u[n]))
        if value[n].ndim or u[n].ndim:
            shapes[n] = Shape(errors, n, top == 0.0, (top or top_u) or 1.0)
            mean[k] = top
            rms, rms_u = (float(np.sqrt(np.mean(v**2))) for v in (value[n], u[n]))
            sd[k] = rms_u * (top / rms if rms > 0.0 else top_u / rms_u if rms_u > 0.0 else 0.0)
        else:
            mean[k], sd[k] = float(value[n]), float(u[n])
    covariance = check_covariance(errors.correlation(names) * np.outer(sd, sd), len(names))
    size = np.sqrt(mean**2 + sd**2)
    for array in (size, mean, covariance):
        array.setflags(write=False)
    units = tuple(term_unit(chain, n) for n in names)
    return TermAmounts(names, units, size, mean, covariance, shapes)


def _amount(value: float | str, unit: str, name: str) -> float:
    if isinstance(value, str) and (curve := curve_text(value)) is not None:
        value = curve["size"]
    return numbers.quantity(value, name, "length" if unit == "m" else "angle")


def _correlation_matrix(
    correlations: Mapping[Any, float] | ArrayLike | None, names: tuple[str, ...]
) -> FloatArray:
    n = len(names)
    if correlations is None:
        return np.eye(n)
    if isinstance(correlations, Mapping):
        matrix = np.eye(n)
        for pair, value in correlations.items():
            if not (len(pair) == 2 and len(set(pair)) == 2 and set(pair) <= set(names)):
                raise DataError(f"correlations names pairs of the terms in errors, got {pair!r}")
            i, j = (names.index(p) for p in pair)
            matrix[i, j] = matrix[j, i] = numbers.real(value, f"correlation of {pair}")
    else:
        matrix = np.asarray(correlations, dtype=np.float64)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all() or (np.diag(matrix) != 1.0).any():
        raise InvalidSamplesError(
            f"correlations must be a finite {n} x {n} matrix with ones on its diagonal, got shape "
            f"{matrix.shape}"
        )
    if np.abs(matrix).max() > 1.0:
        raise InvalidSamplesError(f"a correlation of {np.abs(matrix).max()} is beyond 1")
    return matrix

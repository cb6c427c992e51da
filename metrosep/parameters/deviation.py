"""Form deviations by one function: straightness, flatness, roundness.

The reference is always stated. ISO 1101:2017 takes the minimum zone where a drawing says nothing;
many instruments print least squares without saying so, a value that is never smaller.
"""

from __future__ import annotations

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.parameters._flags import true_or_false
from metrosep.parameters.flatness import flatness_deviation
from metrosep.parameters.form_result import FormDeviation, Kind, Reference
from metrosep.parameters.roundness import roundness_deviation
from metrosep.parameters.straightness import straightness_deviation

__all__ = ["form_deviation"]

_OPTIONS: dict[str, tuple[str, ...]] = {
    "straightness": ("normal",),
    "flatness": (),
    "roundness": ("exact", "radius"),
}


def form_deviation(
    obj: Profile | Surface,
    *,
    kind: Kind,
    reference: Reference = "MZ",
    normal: bool = False,
    exact: bool = False,
    radius: float | None = None,
) -> FormDeviation:
    """Return the straightness, flatness or roundness deviation of an object.

    Parameters
    ----------
    obj : Profile or Surface
        A profile for straightness (x in m) and roundness (x is the angle in rad, z larger
        outwards), a surface for flatness.
    kind : {"straightness", "flatness", "roundness"}
        What is evaluated.
    reference : {"MZ", "LS", "EP", "MC", "MI"}, optional
        Minimum zone and least squares for all; end points for straightness; minimum circumscribed
        and maximum inscribed circle for roundness.
    normal : bool, optional
        Straightness: measure at right angles to the line instead of along z.
    exact : bool, optional
        Roundness: true circles instead of limacons.
    radius : float, m, optional
        Roundness: radius that z is counted from.

    Returns
    -------
    FormDeviation
        ``value`` (STRt, FLTt or RONt in m), ``table``, ``reference_parameters``, ``residual``,
        ``support`` and ``bound``, which proves the reference.

    Raises
    ------
    DataError
        If the kind is unknown, the object or an option does not belong to it, an option is of the
        wrong type, or the reference does not exist for it.
    TooFewSamplesError
        If the valid samples do not exceed the freedoms of the reference.
    DegenerateFitError
        If pixels lie on one line, or a round trace has a gap of half a turn.
    InvalidSamplesError
        If the angle of a round trace spans more than one turn.
    NotConvergedError
        If a reference is not found.

    Notes
    -----
    Positive deviations point out of the material, of round traces outwards. NaN is excluded and
    counted. No filter is applied: filter before, and the history says so.

    References
    ----------
    .. [1] ISO 12780-1:2011, ISO 12781-1:2011, ISO 12181-1:2011, ISO 1101:2017, ISO 230-1:2012.

    Examples
    --------
    >>> x = [0.0, 1.0, 2.0, 3.0, 4.0]
    >>> result = form_deviation(Profile(x, [0, 2e-6, 1e-6, 3e-6, 0]), kind="straightness")
    >>> result
    FormDeviation(STRt = 3 um, MZ, proven by its support)
    """
    normal, exact = true_or_false(normal, "normal"), true_or_false(exact, "exact")
    options = {"normal": normal, "exact": exact, "radius": radius is not None}
    if kind not in _OPTIONS:
        raise DataError(f"a form is straightness, flatness or roundness, not {kind!r}")
    foreign = [name for name, given in options.items() if given and name not in _OPTIONS[kind]]
    if foreign:
        raise DataError(f"{kind} has no option {', '.join(foreign)}: leave it out")
    if kind == "flatness":
        if not isinstance(obj, Surface):
            raise DataError(f"flatness needs a Surface, got {type(obj).__name__}")
        return flatness_deviation(obj, reference=reference)
    if not isinstance(obj, Profile):
        raise DataError(f"{kind} needs a Profile, got {type(obj).__name__}: take a section first")
    if kind == "straightness":
        return straightness_deviation(obj, reference=reference, normal=normal)
    return roundness_deviation(obj, reference=reference, exact=exact, radius=radius)

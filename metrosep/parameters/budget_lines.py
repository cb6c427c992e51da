"""Ready lines for the budget of a texture, form or interferometric parameter.

Each returns a `Contribution` with the distribution that its source calls for; anything else is
a `Contribution` of your own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import flag, not_negative, quantity, real
from metrosep.parameters.budget import Contribution
from metrosep.parameters.repeats import TypeA


def scale_line(value: float, half_width: float, *, degree: float = 1.0) -> Contribution:
    """Return the line of the z scale.

    Parameters
    ----------
    value : float
        The parameter.
    half_width : float
        Limits of the relative scale error, 100 ppm = 1e-4; rectangular.
    degree : float, optional
        Power with which the parameter follows the scale: 1 for heights, 0 for Rsk.

    Returns
    -------
    Contribution
        Sensitivity degree times value.

    Raises
    ------
    DataError
        If a number is not finite or the half-width negative.
    """
    return Contribution("z scale", half_width, "rectangular", sensitivity=degree * value)


def lateral_scale_line(value: float, half_width: float, *, exponent: float) -> Contribution:
    """Return the line of the lateral scale.

    Parameters
    ----------
    value : float
        The parameter.
    half_width : float
        Limits of the relative error of x and y; rectangular.
    exponent : float
        Power with which the parameter follows lengths along the surface: 1 for RSm and Sal, -1
        for Rdq and Sdq, 0 for heights without a filter.

    Returns
    -------
    Contribution
        Sensitivity exponent times value.

    Raises
    ------
    DataError
        If a number is not finite or the half-width negative.
    """
    return Contribution("lateral scale", half_width, "rectangular", sensitivity=exponent * value)


def repeatability_line(repeats: TypeA, *, of_mean: bool = True) -> Contribution:
    """Return the line of the scatter between repeats.

    Parameters
    ----------
    repeats : TypeA
        From `type_a` or `from_repeats`.
    of_mean : bool, optional
        Whether the result is the mean of these repeats; else of one further measurement.

    Returns
    -------
    Contribution
        u = s / sqrt(n), or s, with n - 1 degrees of freedom.

    Raises
    ------
    DataError
        If `of_mean` is not True or False.

    Examples
    --------
    >>> from metrosep.parameters.repeats import type_a
    >>> repeatability_line(type_a([1.0, 2.0, 3.0, 4.0, 5.0])).dof
    4
    """
    value = repeats.u if flag(of_mean, "of_mean") else repeats.s
    return Contribution("repeatability", value, dof=repeats.dof)


def certificate_line(
    name: str, expanded: float, *, coverage_factor: float = 2.0, sensitivity: float = 1.0
) -> Contribution:
    """Return the line of a calibrated reference: flat, arc, sphere, step.

    Parameters
    ----------
    name : str
        What the certificate is of.
    expanded : float
        U in the certificate.
    coverage_factor : float, optional
        Its k.
    sensitivity : float, optional
        Change of the result per unit of the reference.

    Returns
    -------
    Contribution
        u = U / k.

    Raises
    ------
    DataError
        If a number is out of range.
    """
    return Contribution(name, expanded, divisor=coverage_factor, sensitivity=sensitivity)


def alternatives_line(name: str, values: ArrayLike) -> Contribution:
    """Return the line of a choice: filter, cutoff, mask, sampling, form removal.

    Parameters
    ----------
    name : str
        What was chosen.
    values : array_like, shape (n,)
        The parameter under each choice that the drawing allows, n >= 2.

    Returns
    -------
    Contribution
        Rectangular over half the range of the values.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 values.
    InvalidSamplesError
        If a value is not finite.
    """
    array = np.asarray(values, dtype=np.float64).ravel()
    if array.size < 2:
        raise TooFewSamplesError(f"{name}: at least 2 alternatives are needed, got {array.size}")
    if not np.isfinite(array).all():
        raise InvalidSamplesError(f"{name}: an alternative is NaN or infinite")
    return Contribution(name, 0.5 * float(np.ptp(array)), "rectangular")


def drift_line(rate: float, duration: float, *, sensitivity: float = 1.0) -> Contribution:
    """Return the line of a thermal drift during the measurement.

    Parameters
    ----------
    rate : float (m/s) or str with unit
        Largest drift rate; its sign is not used.
    duration : float (s) or str with unit
        Time that matters: of the scan, or between reference and part.
    sensitivity : float, optional
        Share that reaches the result; 0 where a line or plane is removed.

    Returns
    -------
    Contribution
        Rectangular, half-width rate times duration.

    Raises
    ------
    DataError
        If a number is not finite or the duration negative.
    """
    rate = quantity(rate, "rate", "speed")
    duration = not_negative(duration, "duration", dimension="time")
    return Contribution("drift", abs(rate) * duration, "rectangular", sensitivity=sensitivity)


def nonlinearity_line(
    coefficient: float, half_range: float | str, *, sensitivity: float = 1.0
) -> Contribution:
    """Return the line of a quadratic sensor error, such as the gap^2 term of a capacitance probe.

    Parameters
    ----------
    coefficient : float, 1/m
        Limits of the unknown coefficient of the squared deflection.
    half_range : float, m
        Largest deflection from the middle of the range.
    sensitivity : float, optional
        Share that reaches the result.

    Returns
    -------
    Contribution
        Rectangular, half-width coefficient times half_range^2.

    Raises
    ------
    DataError
        If a number is not finite.
    """
    half_range = quantity(half_range, "half_range", "length")
    width = abs(real(coefficient, "coefficient")) * half_range**2
    return Contribution("sensor nonlinearity", width, "rectangular", sensitivity=sensitivity)

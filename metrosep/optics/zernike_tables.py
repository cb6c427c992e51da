"""Zernike terms of a wavefront as a table, and their fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import positive
from metrosep.core.provenance import freeze_mapping
from metrosep.forms.zernike import Zernike, ZernikeOrder, term_name, to_nm

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class ZernikeTable:
    """Zernike terms of a wavefront, normalised to rms (ANSI, Noll) or to the rim (Fringe).

    Parameters
    ----------
    coefficients : mapping of str to float, m
        By name, such as ``"Z4"``.
    u : mapping of str to float, m
        Standard uncertainty from the residual, as if it were independent from point to point. NaN,
        with a message, where there are no more points than terms.
    nm : tuple of (int, int)
        Radial and azimuthal order of each term.
    order : str
        How the terms are counted.
    radius : float, m
        Of the disc of the polynomials.
    residual_rms : float, m
        What the terms leave within the disc.
    messages : tuple of str
        What a reader should know, of the wavefront too.
    """

    coefficients: Mapping[str, float]
    u: Mapping[str, float]
    nm: tuple[tuple[int, int], ...]
    order: str
    radius: float
    residual_rms: float
    messages: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> float:
        """Return the coefficient of a term in m, by its name."""
        if name not in self.coefficients:
            raise DataError(
                f"no term {name!r} was fitted; there are {', '.join(self.coefficients)}"
            )
        return self.coefficients[name]

    def values(self) -> FloatArray:
        """Return the coefficients in their order.

        Returns
        -------
        ndarray, m
            One for each term.
        """
        return np.array(list(self.coefficients.values()))

    def to_frame(self) -> pd.DataFrame:
        """Return the table.

        Returns
        -------
        DataFrame
            Columns term, n, m, name, coefficient_nm, u_nm.
        """
        import pandas as pd

        return pd.DataFrame(
            {
                "term": list(self.coefficients),
                "n": [n for n, _ in self.nm],
                "m": [m for _, m in self.nm],
                "name": [term_name(n, m) for n, m in self.nm],
                "coefficient_nm": [1e9 * v for v in self.coefficients.values()],
                "u_nm": [1e9 * v for v in self.u.values()],
            }
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the table as plain values.

        Returns
        -------
        dict
            Keys with units.
        """
        return {
            "order": self.order,
            "radius_mm": 1e3 * self.radius,
            "residual_rms_nm": 1e9 * self.residual_rms,
            "coefficients_nm": {k: 1e9 * v for k, v in self.coefficients.items()},
            "u_nm": {k: 1e9 * v for k, v in self.u.items()},
            "messages": list(self.messages),
        }


def fit_table(
    points: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    terms: int | Sequence[int],
    order: ZernikeOrder,
    radius: float,
    messages: tuple[str, ...] = (),
) -> ZernikeTable:
    """Return Zernike terms through points by least squares with the area as weight."""
    disc = positive(radius, "radius", dimension="length")
    form = Zernike(terms, order=order, radius=disc)
    x, y, path, area = points
    w = area / float(area.max())
    fit, left = form.fit_list(x, y, path, weights=w)
    names = list(fit.form.parameters)
    inside = ~np.isnan(left)
    notes = list(messages)
    if not inside.all():
        notes.append(
            f"{int((~inside).sum())} of {inside.size} points lie outside the disc of the terms, "
            f"radius {1e3 * disc:.6g} mm"
        )
    u = np.full(len(names), np.nan)
    if fit.n_valid > len(names):
        u = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    else:
        notes.append(f"{len(names)} terms of {fit.n_valid} points leave no uncertainty to tell")
    squares = float((w[inside] * left[inside] ** 2).sum() / w[inside].sum())
    return ZernikeTable(
        freeze_mapping({k: float(v or 0.0) for k, v in fit.form.parameters.items()}),
        freeze_mapping(dict(zip(names, (float(v) for v in u), strict=True))),
        tuple(to_nm(int(name[1:]), order) for name in names),
        order,
        disc,
        float(np.sqrt(squares)),
        tuple(notes),
    )

"""Ideal surfaces and their fit to measurements."""

from __future__ import annotations

from metrosep.forms.base import Form
from metrosep.forms.catalogue import form_from_text
from metrosep.forms.conic import Asphere, Conic, Cylinder, Plane, Sphere
from metrosep.forms.expression import Expression
from metrosep.forms.fit import fit, remove
from metrosep.forms.linear import LinearFit, LinearForm
from metrosep.forms.moments import (
    GridPolynomial,
    evaluate_grid,
    fit_grid_polynomial,
    remove_grid,
)
from metrosep.forms.points import PointSet
from metrosep.forms.polynomial import XY, Chebyshev, Legendre, Polynomial
from metrosep.forms.qforbes import QForbes
from metrosep.forms.result import FitResult
from metrosep.forms.sine_grid import SineGrid
from metrosep.forms.stl import GridForm, MeshForm, from_triangles
from metrosep.forms.toric import Biconic, Toric
from metrosep.forms.zernike import (
    Zernike,
    ansi_to_nm,
    fringe_to_nm,
    nm_to_ansi,
    nm_to_fringe,
    nm_to_noll,
    noll_to_nm,
    term_name,
)

__all__ = [
    "XY",
    "Asphere",
    "Biconic",
    "Chebyshev",
    "Conic",
    "Cylinder",
    "Expression",
    "FitResult",
    "Form",
    "GridForm",
    "GridPolynomial",
    "Legendre",
    "LinearFit",
    "LinearForm",
    "MeshForm",
    "Plane",
    "PointSet",
    "Polynomial",
    "QForbes",
    "SineGrid",
    "Sphere",
    "Toric",
    "Zernike",
    "ansi_to_nm",
    "evaluate_grid",
    "fit",
    "fit_grid_polynomial",
    "form_from_text",
    "fringe_to_nm",
    "from_triangles",
    "nm_to_ansi",
    "nm_to_fringe",
    "nm_to_noll",
    "noll_to_nm",
    "remove",
    "remove_grid",
    "term_name",
]

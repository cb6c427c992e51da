"""Machines: kinematic chains with their error terms, ranking by effect on a part, identification.

`error = actual - nominal`; names after ISO 230-1: E, direction, moving axis. A name loads its module on first use.
"""

# ruff: noqa: F403

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:  # a module states its names in ``__all__``
    from metrosep.machine.alignment import *
    from metrosep.machine.calibration import *
    from metrosep.machine.chains import *
    from metrosep.machine.circles import *
    from metrosep.machine.elements import *
    from metrosep.machine.error_sets import *
    from metrosep.machine.gram import *
    from metrosep.machine.identification import *
    from metrosep.machine.instruments import *
    from metrosep.machine.inverse import *
    from metrosep.machine.ranking import *
    from metrosep.machine.sensitivity import *
    from metrosep.machine.sobol import *
    from metrosep.machine.terms import *
    from metrosep.machine.thermal import *

# fmt: off
_HOMES = {
    "alignment": ["FREEDOMS", "alignment_space", "freedom_maps", "removed_freedoms"],
    "calibration": ["Calibration", "ReadingSet", "calibrate", "plan_calibration"],
    "chains": ["Chain", "preset_table", "presets"],
    "circles": ["CircleTest", "Reversal", "circle_test"],
    "elements": ["Element", "axis_of", "element_terms", "from_paper", "import_errors", "to_paper"],
    "error_sets": ["ErrorSet", "as_error_set"],
    "gram": ["aligned_gram", "correlations", "expected_mean_square", "groups_alike", "shares"],
    "identification": ["Identification", "IdentifiedGroup", "identify"],
    "instruments": [
        "Angle", "Ballbar", "Displacement", "FunctionalCurves", "Instrument", "Length", "Nest",
        "at_functional_point",
    ],
    "inverse": ["CorrectedPath", "correct_path", "inverse_kinematics"],
    "ranking": ["rank"],
    "sensitivity": ["ParetoStep", "SensitivityTable"],
    "sobol": ["sobol_indices"],
    "terms": [
        "CallableTerm", "ConstantTerm", "ErrorTerm", "FourierTerm", "PolynomialTerm", "SumTerm",
        "TableTerm", "as_term",
    ],
    "thermal": ["ThermalFit", "ThermalTerm", "fit_thermal"],
}
# fmt: on

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return list(__all__)

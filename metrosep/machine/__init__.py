"""Machines: kinematic chains with their error terms, ranking by effect on a part, identification.

`error = actual - nominal`; names after ISO 230-1: E, direction, moving axis. A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.machine._reading_problem import ReadingSet as ReadingSet
    from metrosep.machine.alignment import (
        FREEDOMS as FREEDOMS,
        alignment_space as alignment_space,
        freedom_maps as freedom_maps,
        removed_freedoms as removed_freedoms,
    )
    from metrosep.machine.calibration import (
        Calibration as Calibration,
        calibrate as calibrate,
        plan_calibration as plan_calibration,
    )
    from metrosep.machine.chains import (
        Chain as Chain,
        preset_table as preset_table,
        presets as presets,
    )
    from metrosep.machine.circles import (
        CircleTest as CircleTest,
        Reversal as Reversal,
        circle_test as circle_test,
    )
    from metrosep.machine.elements import (
        Element as Element,
        axis_of as axis_of,
        element_terms as element_terms,
        from_paper as from_paper,
        import_errors as import_errors,
        to_paper as to_paper,
    )
    from metrosep.machine.error_sets import ErrorSet as ErrorSet, as_error_set as as_error_set
    from metrosep.machine.gram import (
        aligned_gram as aligned_gram,
        correlations as correlations,
        expected_mean_square as expected_mean_square,
        groups_alike as groups_alike,
        shares as shares,
    )
    from metrosep.machine.identification import (
        Identification as Identification,
        IdentifiedGroup as IdentifiedGroup,
        identify as identify,
    )
    from metrosep.machine.instruments import (
        Angle as Angle,
        Ballbar as Ballbar,
        Displacement as Displacement,
        FunctionalCurves as FunctionalCurves,
        Instrument as Instrument,
        Length as Length,
        Nest as Nest,
        at_functional_point as at_functional_point,
    )
    from metrosep.machine.inverse import (
        CorrectedPath as CorrectedPath,
        correct_path as correct_path,
        inverse_kinematics as inverse_kinematics,
    )
    from metrosep.machine.ranking import rank as rank
    from metrosep.machine.sensitivity import (
        ParetoStep as ParetoStep,
        SensitivityTable as SensitivityTable,
    )
    from metrosep.machine.sobol import sobol_indices as sobol_indices
    from metrosep.machine.terms import (
        CallableTerm as CallableTerm,
        ConstantTerm as ConstantTerm,
        ErrorTerm as ErrorTerm,
        FourierTerm as FourierTerm,
        PolynomialTerm as PolynomialTerm,
        SumTerm as SumTerm,
        TableTerm as TableTerm,
        as_term as as_term,
    )
    from metrosep.machine.thermal import (
        ThermalFit as ThermalFit,
        ThermalTerm as ThermalTerm,
        fit_thermal as fit_thermal,
    )

__getattr__, __dir__ = lazy_package(__name__)

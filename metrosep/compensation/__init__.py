"""From an error to what is added to a command: tables, inverses, limits, dry-runs, polynomials."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.compensation.area_errors import ErrorMap as ErrorMap
    from metrosep.compensation.closed_loop import (
        LoopCut as LoopCut,
        LoopHistory as LoopHistory,
        LoopPass as LoopPass,
        LoopResult as LoopResult,
        iterate_loop as iterate_loop,
        run_closed_loop as run_closed_loop,
    )
    from metrosep.compensation.combine import combine_tables as combine_tables
    from metrosep.compensation.from_machine import (
        MachineTables as MachineTables,
        tables_from_machine as tables_from_machine,
        volume_from_machine as volume_from_machine,
    )
    from metrosep.compensation.knots import (
        Knots as Knots,
        choose_knots as choose_knots,
        knots_for_tolerance as knots_for_tolerance,
        optimal_values as optimal_values,
    )
    from metrosep.compensation.limits import (
        Finding as Finding,
        Limits as Limits,
        check_limits as check_limits,
        dead_zone as dead_zone,
    )
    from metrosep.compensation.loop_machines import (
        AxisMachine as AxisMachine,
        FaceMachine as FaceMachine,
        LoopMachine as LoopMachine,
        Servo as Servo,
    )
    from metrosep.compensation.map_verify import (
        MapVerification as MapVerification,
        dry_run_map as dry_run_map,
    )
    from metrosep.compensation.maps import (
        CompensationMap as CompensationMap,
        check_map_limits as check_map_limits,
    )
    from metrosep.compensation.polynomial import (
        PolynomialFit as PolynomialFit,
        exact_correction as exact_correction,
        fit_polynomial as fit_polynomial,
    )
    from metrosep.compensation.products import ProductTables as ProductTables, rank_one as rank_one
    from metrosep.compensation.rounding import (
        Rounded as Rounded,
        round_entries as round_entries,
        round_increments as round_increments,
    )
    from metrosep.compensation.table import CompensationTable as CompensationTable
    from metrosep.compensation.trial import (
        TrialMap as TrialMap,
        TrialTable as TrialTable,
        trial_map as trial_map,
        trial_table as trial_table,
    )
    from metrosep.compensation.uniform import (
        is_uniform as is_uniform,
        resample_uniform as resample_uniform,
        resampling_error as resampling_error,
        uniform_spacing as uniform_spacing,
    )
    from metrosep.compensation.verification import (
        DirectionResidual as DirectionResidual,
        LostMotion as LostMotion,
        Verification as Verification,
    )
    from metrosep.compensation.verify import dry_run as dry_run
    from metrosep.compensation.volumes import (
        MachineVolume as MachineVolume,
        volume_positions as volume_positions,
    )

__getattr__, __dir__ = lazy_package(__name__)

"""Machines: kinematic chains with their error terms, ranking by effect on a part, identification.

`error = actual - nominal`; names after ISO 230-1: E, direction, moving axis. A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.machine.alignment import (
        FREEDOMS as FREEDOMS,
        alignment_space as alignment_space,
        freedom_maps as freedom_maps,
        removed_freedoms as removed_freedoms,
    )
    from metrosep.machine.chain_files import preset_table as preset_table, presets as presets
    from metrosep.machine.chains import Chain as Chain
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
        TableTerm as TableTerm,
        as_term as as_term,
    )

# fmt: off
_HOMES = {
    "alignment": ["FREEDOMS", "alignment_space", "freedom_maps", "removed_freedoms"],
    "chain_files": ["preset_table", "presets"],
    "chains": ["Chain"],
    "elements": ["Element", "axis_of", "element_terms", "from_paper", "import_errors", "to_paper"],
    "error_sets": ["ErrorSet", "as_error_set"],
    "gram": ["aligned_gram", "correlations", "expected_mean_square", "groups_alike", "shares"],
    "identification": ["Identification", "IdentifiedGroup", "identify"],
    "ranking": ["rank"],
    "sensitivity": ["ParetoStep", "SensitivityTable"],
    "sobol": ["sobol_indices"],
    "terms": [
        "CallableTerm", "ConstantTerm", "ErrorTerm", "FourierTerm", "PolynomialTerm",
        "TableTerm", "as_term",
    ],
}
# fmt: on

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return list(__all__)

"""Parameters and verdicts."""

from __future__ import annotations

from metrosep.parameters.decision import decide
from metrosep.parameters.table import Context, ParameterTable

__all__ = ["Context", "ParameterTable", "decide"]

"""Parameters and verdicts."""

from __future__ import annotations

from metrosep.parameters.decision import decide

__all__ = ["decide"]

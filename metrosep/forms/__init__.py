"""Ideal surfaces and their fit to measurements."""

from __future__ import annotations

from metrosep.forms.base import Form

__all__ = ["Form"]

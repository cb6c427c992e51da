"""Controllers' table files: one dialect per controller, each with writer, reader and simulator."""

from __future__ import annotations

from metrosep.controllers.files import describe, find, names, read, simulate, write

__all__ = ["describe", "find", "names", "read", "simulate", "write"]

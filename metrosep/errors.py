"""The errors that metrosep raises, under a short name; the tree is drawn in `metrosep.core.errors`."""

from __future__ import annotations

from metrosep.core.errors import *  # noqa: F403

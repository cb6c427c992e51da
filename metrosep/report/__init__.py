"""Reports, made from a result document only."""

from __future__ import annotations

from metrosep.report.html import render_html, write_html

__all__ = ["render_html", "write_html"]

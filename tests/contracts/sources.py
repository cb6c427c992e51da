"""Syntax trees of the package, which tests of its texts and of its habits read."""

import ast
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "metrosep"


@cache
def trees() -> dict[Path, ast.Module]:
    """Return the tree of every module of metrosep, parsed once by each worker."""
    return {p: ast.parse(p.read_text(encoding="utf-8")) for p in sorted(PACKAGE.rglob("*.py"))}

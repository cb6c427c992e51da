"""Rows of the index: the little that a table of a thousand results shows of each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.io.own_notes import moment_of
from metrosep.recipe.reasons import reason_of

__all__ = ["STATUSES", "exit_code", "row_of"]

STATUSES = ("accepted", "rejected", "inconclusive", "measured", "failed", "refused")
"""What can become of a unit; measured: there were no limits; refused: it was not begun."""

_OF_VERDICT = {"accept": "accepted", "reject": "rejected", "inconclusive": "inconclusive"}
_SHOWN = (
    "name", "metric", "symbol", "value", "unit", "u", "lower", "upper", "U", "guard_factor", "verdict",
)  # fmt: skip


def row_of(document: Mapping[str, Any], link: str | None) -> dict[str, Any]:
    """Return the row of a result.json or a failed.json."""
    unit = document["unit"]
    verdict = document.get("verdict")
    failed = "reason" in document
    status = document["status"] if failed else _OF_VERDICT.get(verdict or "", "measured")
    return {
        "unit": unit["name"],
        "key": unit["key"],
        "groups": dict(unit["groups"]),
        "status": status,
        "verdict": verdict,
        "reason": document.get("reason") or reason_of(document.get("characteristics", ())),
        "exit_code": document["exit_code"] if failed else _code(status),
        "link": link,
        "characteristics": [
            {k: c[k] for k in _SHOWN if k in c} for c in document.get("characteristics", ())
        ],
        "messages": list(document.get("messages", ())),
        "hash": unit["hash"],
        "input_sha256": unit["input_sha256"],
        "recipe_sha256": unit["recipe_sha256"],
        "version": unit["version"],
        "measured_at": _measured_at(document),
        **({k: document.get(k) for k in ("error", "again")} if failed else {}),
    }


def _measured_at(document: Mapping[str, Any]) -> str | None:
    known = [i["measured_at"] for i in document.get("inputs") or () if i.get("measured_at")]
    return min(known, key=moment_of, default=None)


def _code(status: str) -> int:
    return {"rejected": 1, "inconclusive": 3}.get(status, 0)


def exit_code(rows: list[dict[str, Any]], *, closed: bool = False) -> int:
    """Return the exit code of a batch: 5, then 6, 1, 3; 0 where all is accepted.

    Examples
    --------
    >>> exit_code([{"status": "rejected", "exit_code": 1}, {"status": "failed", "exit_code": 4}])
    6
    """
    failed = [r for r in rows if r["status"] in ("failed", "refused")]
    if any(r["exit_code"] == 5 for r in failed):
        return 5
    if failed or closed:
        return 6
    statuses = {r["status"] for r in rows}
    return 1 if "rejected" in statuses else 3 if "inconclusive" in statuses else 0

"""What the page of a method draws: charts of its document; terms of a machine with what they are."""

from __future__ import annotations

import math
from typing import Any

from metrosep.app.metrics_answers import as_far_as_it_goes, term_words
from metrosep.app.separations import MethodResults
from metrosep.app.sessions import Session
from metrosep.app.wire import Answer, Cancel, Message, Tell, plain
from metrosep.core.errors import DataError
from metrosep.recipe.describe.describe_tests import curves_of
from metrosep.separation import Separation


def machine(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``machine``."""
    with session.lock:
        opened, document = session.need()
        recipe, op = document.recipe, str(document.recipe.steps[0]["op"])
    if op == "rank" or not isinstance(opened.material, MethodResults):
        raise DataError(f"there are pictures of a method, and a ranking has its own; this is {op}")
    tell({"k": "progress", "words": "computing"})
    result, refused = as_far_as_it_goes(opened.material, recipe, cancel)
    charts = list(result.document["separation"]["charts"])
    if isinstance(result.produced, Separation) and not any(c["kind"] == "curves" for c in charts):
        charts = [*curves_of(result.produced), *charts]  # the report draws these from the parts
    header = {
        "op": op,
        "rows": _terms(result.produced) if op == "calibrate" else [],
        "null": list(result.produced.found.null) if op == "calibrate" else [],
        "charts": charts,
        "messages": [
            session.words(str(m))
            for m in [refused] * (refused is not None)
            + (_messages(result) if op == "calibrate" else list(result.document["messages"]))
        ],
        "verdict": None if refused is not None else result.verdict,
    }
    return plain(header), {}


def _messages(result: Any) -> list[str]:
    """Return what a calibration says beside what it does not determine, which has a list of its own."""
    of_null = set(result.produced.messages) - set(result.produced.found.messages)
    return [str(m) for m in result.document["messages"] if m not in of_null]


def _terms(produced: Any) -> list[dict[str, Any]]:
    """Return every term: its value or its P-V with u, or that the readings do not determine it."""
    import numpy as np

    from metrosep.machine._bases import UnseenTerm
    from metrosep.machine.elements import axis_of, term_unit
    from metrosep.machine.terms import ConstantTerm

    found = produced.found
    rows: list[dict[str, Any]] = []
    for name, term in found.errors.items():
        row: dict[str, Any] = {
            "term": name,
            "words": term_words(name),
            "axis": axis_of(name) or "",
            "unit": term_unit(found.chain, name),
            "kind": "value",
            "value": None,
            "u": None,
        }
        if isinstance(term, ConstantTerm):
            row |= {"value": term.value, "u": term.u}
        elif not isinstance(term, UnseenTerm):
            basis = found.bases[name]
            low, high = (
                (0.0, 2.0 * math.pi) if basis.kind == "fourier" else (basis.low, basis.high)
            )
            x = np.linspace(low, high, 181)
            row |= {
                "kind": "P-V",
                "value": float(np.ptp(term.evaluate(x))),
                "u": float(np.max(term.sd(x))),
            }
        rows.append(row)
    return rows

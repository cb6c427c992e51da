"""A document as json.load gives it from a result.json, made from a simulated axis."""

import functools
import json

from metrosep.compensation import CompensationTable, fit_polynomial
from metrosep.core.provenance import history_as_dicts
from metrosep.recipe.result import clean, plot_data
from metrosep.separation import separate
from metrosep.separation.runs.simulate import machine_axis

RECIPE = """\
schema = "metrosep.recipe/1"
[separate]
method = "joint"
length = "45 mm"
"""


@functools.cache
def make_document(method, directions):
    axis = machine_axis(
        seed=7, directions=directions, lost_motion=0.3e-6 if len(directions) > 1 else 0.0
    )
    # the shortest wave of the axis is 3.3 mm: the folds of the table take a quarter of the time
    shortest = {"shortest": 1.5e-3} if method == "joint" else {}
    estimate = separate(
        axis.runs, method=method, start=axis.start, length=axis.stop - axis.start, **shortest
    )
    table = CompensationTable.from_error(estimate, positions=46, axis="X", compensates="Z")
    verification = table.verify(axis.runs)
    document = {
        "schema": "metrosep.result/1",
        "metrosep": "0.1.0",
        "title": "Slide X, straightness in Z",
        "verdict": "accept",
        "decision_rule": "Accepted if the value and its expanded uncertainty (k = 2) lie inside the limits.",
        "inputs": [
            {"name": "runs.csv", "sha256": "ab" * 32, "size": 812345, "format": "delimited"}
        ],
        "estimate": estimate.to_dict(),
        "plots": plot_data(axis.runs, estimate),
        "characteristics": _characteristics(estimate),
        "table": {
            **table.to_dict(),
            "controller": "linuxcnc",
            "path": "straightness.comp",
            "file_sha256": "cd" * 32,
            "entry": "nominal forward reverse",
            "units": "mm",
            "outside": "constant",
            "activation": ["Copy the file to the machine's folder.", "Home the axis again."],
            "quantisation_m": 5e-10,
            "findings": [
                {"level": "warning", "problem": "the table is short", "fix": "measure the travel"}
            ],
            "verification": verification.to_dict(),
        },
        "polynomial": fit_polynomial(estimate, quantity="compensation").to_dict(),
        "messages": ["The disturbance at 150 Hz is larger than the error itself."],
        "provenance": history_as_dicts(table.history),
        "recipe": {"text": RECIPE, "sha256": "ef" * 32},
        "versions": {"python": "3.11.9", "numpy": "2.4.6", "scipy": "1.17.1"},
    }
    return json.loads(json.dumps(clean(document), sort_keys=True, allow_nan=False))


def _characteristics(estimate):
    pv = estimate.peak_to_valley().to_dict()
    pv.update(name="peak to valley", lower=None, upper=2e-6, U=2 * pv["u"], verdict="accept")
    slope = estimate.slope.to_dict()
    slope.update(name="slope", symbol="m", lower=None, upper=None, U=None, verdict=None)
    return [pv, slope]

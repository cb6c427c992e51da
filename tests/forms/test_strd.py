"""Certified nonlinear regressions of NIST StRD, fitted as user expressions.

The files lie in the corpus. A set counts as reached when every parameter agrees with its certified
value to at least six digits (log relative error), from either of the starts that NIST gives.
"""

import re

import numpy as np
import pytest

from metrosep.core.errors import NotConvergedError
from metrosep.forms.expression import Expression
from metrosep.forms.fit import fit
from metrosep.forms.points import PointSet

DIGITS = 6.0
"""Asked for by the issue; the certified values have eleven."""

MODELS = {
    "Bennett5": "b1 * (b2 + x) ** (-1 / b3)",
    "BoxBOD": "b1 * (1 - exp(-b2 * x))",
    "Chwirut1": "exp(-b1 * x) / (b2 + b3 * x)",
    "Chwirut2": "exp(-b1 * x) / (b2 + b3 * x)",
    "DanWood": "b1 * x ** b2",
    "ENSO": (
        "b1 + b2 * cos(2 * pi * x / 12) + b3 * sin(2 * pi * x / 12)"
        " + b5 * cos(2 * pi * x / b4) + b6 * sin(2 * pi * x / b4)"
        " + b8 * cos(2 * pi * x / b7) + b9 * sin(2 * pi * x / b7)"
    ),
    "Eckerle4": "b1 / b2 * exp(-0.5 * ((x - b3) / b2) ** 2)",
    "Gauss1": "b1 * exp(-b2 * x) + b3 * exp(-((x - b4) / b5) ** 2) + b6 * exp(-((x - b7) / b8) ** 2)",
    "Gauss2": "b1 * exp(-b2 * x) + b3 * exp(-((x - b4) / b5) ** 2) + b6 * exp(-((x - b7) / b8) ** 2)",
    "Gauss3": "b1 * exp(-b2 * x) + b3 * exp(-((x - b4) / b5) ** 2) + b6 * exp(-((x - b7) / b8) ** 2)",
    "Hahn1": "(b1 + b2 * x + b3 * x**2 + b4 * x**3) / (1 + b5 * x + b6 * x**2 + b7 * x**3)",
    "Kirby2": "(b1 + b2 * x + b3 * x**2) / (1 + b4 * x + b5 * x**2)",
    "Lanczos1": "b1 * exp(-b2 * x) + b3 * exp(-b4 * x) + b5 * exp(-b6 * x)",
    "Lanczos2": "b1 * exp(-b2 * x) + b3 * exp(-b4 * x) + b5 * exp(-b6 * x)",
    "Lanczos3": "b1 * exp(-b2 * x) + b3 * exp(-b4 * x) + b5 * exp(-b6 * x)",
    "MGH09": "b1 * (x**2 + x * b2) / (x**2 + x * b3 + b4)",
    "MGH10": "b1 * exp(b2 / (x + b3))",
    "MGH17": "b1 + b2 * exp(-x * b4) + b3 * exp(-x * b5)",
    "Misra1a": "b1 * (1 - exp(-b2 * x))",
    "Misra1b": "b1 * (1 - (1 + b2 * x / 2) ** (-2))",
    "Misra1c": "b1 * (1 - (1 + 2 * b2 * x) ** (-0.5))",
    "Misra1d": "b1 * b2 * x / (1 + b2 * x)",
    "Nelson": "b1 - b2 * x * exp(-b3 * y)",
    "Rat42": "b1 / (1 + exp(b2 - b3 * x))",
    "Rat43": "b1 / (1 + exp(b2 - b3 * x)) ** (1 / b4)",
    "Roszman1": "b1 - b2 * x - arctan(b3 / (x - b4)) / pi",
    "Thurber": "(b1 + b2 * x + b3 * x**2 + b4 * x**3) / (1 + b5 * x + b6 * x**2 + b7 * x**3)",
}


OUT_OF_REACH = {
    "BoxBOD": "start 1 lies on a plateau: the second parameter moves nothing there",
    "MGH10": "start 1 leads into a valley whose walls are 10^8 times steeper than its floor",
    "MGH17": "start 1 has the two exponentials in the wrong order of magnitude",
}
"""Sets whose start 1 is not reached; the fit says so and gives no numbers."""


def load(path):
    """Return x, y, z, two starts and the certified values with their standard deviations."""
    text = path.read_text(encoding="ascii")
    rows = re.findall(r"^\s*b(\d+)\s*=\s*(\S+)\s+(\S+)\s+(\S+)\s+(\S+)\s*$", text, re.MULTILINE)
    numbers = np.array([[float(v) for v in row[1:]] for row in rows])
    first, last = map(int, re.search(r"Data\s+\(lines (\d+) to\s+(\d+)\)", text).groups())
    lines = text.splitlines()[first - 1 : last]
    data = np.array([[float(v) for v in line.split()] for line in lines if line.strip()])
    z = np.log(data[:, 0]) if path.stem == "Nelson" else data[:, 0]
    y = data[:, 2] if data.shape[1] > 2 else np.zeros(len(z))
    return data[:, 1], y, z, numbers[:, 0], numbers[:, 1], numbers[:, 2], numbers[:, 3]


def digits(found, certified):
    """Return the smallest number of equal digits."""
    error = np.abs(found - certified) / np.abs(certified)
    return float(-np.log10(max(error.max(), 1e-16)))


@pytest.mark.parametrize("which", [1, 2])
@pytest.mark.parametrize("name", MODELS)
def test_certified_values(corpus, name, which):
    x, y, z, first, second, certified, sd = load(corpus / "strd" / f"{name}.dat")
    names = [f"b{i + 1}" for i in range(certified.size)]
    start = dict(zip(names, (first if which == 1 else second).tolist(), strict=True))
    form = Expression(MODELS[name], **start)

    if which == 1 and name in OUT_OF_REACH:
        with pytest.raises(NotConvergedError, match="did not settle"):
            fit(PointSet(x, y, z), form, free=names, max_iterations=300)
        return
    found = fit(PointSet(x, y, z), form, free=names, max_iterations=2000)

    values = np.array([found.params[n] for n in names])
    assert digits(values, certified) >= DIGITS
    if found.rms > 1e-9:  # the residual of Lanczos1 is rounding
        assert digits(np.array([found.u_white[n] for n in names]), sd) >= 4.0

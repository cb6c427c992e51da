"""Every dialect: random tables written, read and simulated stay within rounding and interpolation."""


import numpy as np
import pytest
from hypothesis import HealthCheck, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.registry import find

TABLES = [d.id for d in controllers.describe() if d.carries == "table"]
MAPS = [d.id for d in controllers.describe() if d.carries == "map"]
POLYNOMIALS = [d.id for d in controllers.describe() if d.carries == "polynomial"]

ROUNDING = 1e-15
"""Of sums of positions and corrections in double precision."""

quick = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)


def axes_of(name):
    """Corrected axis: its own, or another where the dialect only takes that."""
    return ("X", "Z") if name in OTHER_AXIS else ("X", "X")


OTHER_AXIS: set[str] = set()
"""Dialects that correct another axis only; filled below from what they refuse."""


@st.composite
def tables(draw, name):
    """A smooth table that starts with zero at its reference 0, uniform, asymmetric."""
    info = find(name).info
    most = min(info.max_points or 40, 40)
    n = draw(st.integers(4, max(4, most)))
    step = draw(st.sampled_from([0.5e-3, 1e-3, 5e-3, 10e-3]))
    seed = draw(st.integers(0, 2**31))
    rng = np.random.default_rng(seed)
    x = np.arange(n) * step
    phase = rng.uniform(0, 2 * np.pi, 3)
    waves = rng.uniform(0.1, 3.0, 3)
    size = draw(st.sampled_from([1e-6, 3e-6]))

    def curve(offset):
        t = x / x[-1]
        z = sum(np.sin(2 * np.pi * w * t + p) for w, p in zip(waves, phase, strict=True)) / 3
        return size * (z - z[0]) * (1 - t if name in CLOSED else 1) + 0.3 * offset * size * t * (
            1 - t
        )

    reverse = curve(1.0) if info.directions == "two" else None
    axis, other = axes_of(name)
    return CompensationTable(x, curve(0.0), reverse, axis, other, 0.0)


CLOSED: set[str] = set()
"""Dialects whose last entry must be zero again."""


def bound(table, sidecar):
    return sidecar["quantisation_m"] + sidecar["resampling_error_m"] + ROUNDING


@pytest.mark.parametrize("name", TABLES)
def test_every_dialect_has_an_example_that_is_complete(name):
    dialect = find(name)
    required = {o.name for o in dialect.options if o.required}

    assert required <= set(dialect.info.example)
    assert dialect.info.activation
    assert dialect.info.entry
    assert dialect.info.outside

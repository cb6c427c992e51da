"""Every dialect: random tables written, read and simulated stay within rounding and resampling."""

import dataclasses
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import MORE, ONLY_REVERSAL, ROUNDING, map_for, table_for
from hypothesis import HealthCheck, given, settings, strategies as st

from metrosep import Profile, controllers
from metrosep.compensation import fit_polynomial
from metrosep.controllers.registry import find
from metrosep.errors import TableError

BY_KIND = {
    kind: [d.id for d in controllers.describe() if d.carries == kind]
    for kind in ("table", "map", "polynomial")
}

WAIVED = ("quantisation", "resampling", "dry-run", "uncertainty")
"""Random corrections may be small; what rounding and resampling cost is the bound that is tested."""

PLAYED = ("pi-gcs", "nv200", "linuxcnc-lincurve")
"""A wave is made for one pass, and a chain of curves for one column: two are refused, equal or not."""

quick = settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    derandomize=True,
)


@st.composite
def shapes(draw):
    """Number of positions, spacing in m, size of the corrections in m, seed."""
    n = draw(st.integers(9, 32))
    step = draw(st.sampled_from([2e-3, 2.5e-3]))
    size = draw(st.sampled_from([0.5e-6, 1e-6, 3e-6]))
    return n, step, size, draw(st.integers(0, 2**31))


def written(carried, name, path):
    machine = {**find(name).info.example, **MORE.get(name, {})}
    controllers.write(carried, path, name, waive=WAIVED, sign_confirmed=True, **machine)
    sidecar = json.loads(path.with_name(path.name + ".json").read_text())
    return sidecar["quantisation_m"] + sidecar["resampling_error_m"] + ROUNDING


@pytest.mark.parametrize("name", BY_KIND["table"])
@quick
@given(shape=shapes())
def test_a_table_arrives(name, shape):
    table = table_for(name, shape)
    between = np.linspace(*table.span, 7 * table.positions.size)
    places = np.union1d(between, table.positions)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"x{find(name).info.suffix}"
        bound = written(table, name, path)
        lookup, back = controllers.simulate(path, name), controllers.read(path, name)

        for direction in (1, -1):
            wanted = table.correction(places, direction)
            if name in ONLY_REVERSAL:
                wanted = wanted - table.correction(places, 1)
            assert np.abs(lookup(places, direction) - wanted).max() <= bound
        assert (back.axis, back.compensates) == (table.axis, table.compensates)


@pytest.mark.parametrize("name", BY_KIND["map"])
@quick
@given(shape=shapes())
def test_a_map_arrives(name, shape):
    carried = map_for(name, shape)
    x = np.union1d(np.linspace(carried.x[0], carried.x[-1], 41), carried.x)
    y = np.union1d(np.linspace(carried.y[0], carried.y[-1], 29), carried.y)
    xs, ys = np.meshgrid(x, y)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"x{find(name).info.suffix}"
        bound = written(carried, name, path)
        lookup, back = controllers.simulate(path, name), controllers.read(path, name)

        off = np.abs(lookup(xs, ys) - carried.correction(xs.ravel(), ys.ravel()).reshape(xs.shape))
        assert off.max() <= bound
        assert (back.axes, back.compensates) == (carried.axes, carried.compensates)


@pytest.mark.parametrize("name", BY_KIND["polynomial"])
@quick
@given(shape=shapes())
def test_a_polynomial_arrives(name, shape):
    n, step, size, seed = shape
    x = np.linspace(-0.3, 0.7, 201) * n * step
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 6))
    z = size * np.polyval(rng.uniform(-1, 1, degree + 1), x / x[-1])
    fit = fit_polynomial(Profile(x, z), degree=degree, quantity="error")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.st"
        bound = written(fit, name, path)

        lookup = controllers.simulate(path, name)
        assert np.abs(lookup(x) + z).max() <= bound + 1e-9 * size
        assert lookup(x[-1] + 1.0) == pytest.approx(float(lookup(x[-1])), abs=ROUNDING)


@pytest.mark.parametrize(
    "name",
    [n for n in BY_KIND["table"] if find(n).info.directions == "one" and n not in PLAYED],
)
def test_equal_columns_are_one_value(name, tmp_path):
    once = table_for(name, (11, 2e-3, 1e-6, 5))
    twice = dataclasses.replace(once, reverse=once.forward.copy())
    for kind, table in (("once", once), ("twice", twice)):
        written(table, name, tmp_path / kind)

    assert (tmp_path / "once").read_bytes() == (tmp_path / "twice").read_bytes()
    with pytest.raises(TableError, match=r"two|both directions"):
        written(dataclasses.replace(twice, reverse=twice.forward + 1e-6), name, tmp_path / "other")

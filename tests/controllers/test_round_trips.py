"""Every dialect: random tables written, read and simulated stay within rounding and resampling."""

import dataclasses
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from metrosep import Profile, controllers
from metrosep.compensation import CompensationMap, CompensationTable, fit_polynomial
from metrosep.controllers.registry import find
from metrosep.errors import SignCheckFailedError

BY_KIND = {
    kind: [d.id for d in controllers.describe() if d.carries == kind]
    for kind in ("table", "map", "polynomial")
}

OTHER_AXIS = {"linuxcnc-lincurve", "sinumerik-cec", "fanuc-straightness", "isg-cross"}
"""Dialects that correct another axis than the one they look up."""

ONLY_REVERSAL = {"pmac-backlash"}
"""It holds the difference between the directions; the forward corrections stand in another file."""

MORE = {"nv200": {"rate": 2000}, "rrf": {"max_nodes": 961}}
"""What the long tables here need beyond the example."""

WAIVED = ("quantisation", "resampling", "dry-run", "uncertainty")
"""Random corrections may be small; what rounding and resampling cost is the bound that is tested."""

ROUNDING = 2e-15
"""Of sums of positions and corrections in double precision, in m."""

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


def waves(t, size, rng):
    """A smooth curve over t from 0 to 1, of this size, zero at 0 and not symmetric."""
    phases, cycles = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.1, 2.0, 3)
    z = sum(np.sin(2 * np.pi * c * t + p) for c, p in zip(cycles, phases, strict=True)) / 3
    return size * (z - z[0] * np.cos(np.pi * t / 2))


def table_for(name, shape):
    n, step, size, seed = shape
    rng = np.random.default_rng(seed)
    x = np.arange(n) * step
    forward = waves(x / x[-1], size, rng)
    forward[0] = 0.0
    reverse = None
    if find(name).info.directions == "two":
        reverse = forward + 0.2 * size * np.sin(np.pi * x / x[-1]) ** 2
    return CompensationTable(
        x, forward, reverse, "X", "Z" if name in OTHER_AXIS else "X", 0.0, is_exact_inverse=True
    )


def map_for(name, shape):
    n, step, size, seed = shape
    rng = np.random.default_rng(seed)
    x, y = np.arange(n) * step, np.arange(max(n // 2, 3)) * 2 * step
    values = np.outer(1.0 + waves(y / y[-1], 1.0, rng) / 2, waves(x / x[-1], size, rng))
    if "product" not in name:
        values = values + np.outer(waves(y / y[-1], size, rng), np.cos(x / x[-1]))
    values[0, 0] = 0.0
    if "product" in name:
        values[:, 0] = 0.0
    return CompensationMap(x, y, values, ("X", "Y"), "Z", (0.0, 0.0))


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


@pytest.mark.parametrize("name", controllers.names())
def test_every_dialect_says_what_a_user_must_know(name, repository):
    dialect = find(name)
    info = dialect.info
    required = {o.name for o in dialect.options if o.required}

    assert info.id == name
    assert required <= set(info.example)
    for fact in ("title", "entry", "units", "outside", "sign_status", "proof", "resolution"):
        assert getattr(info, fact), fact
    assert info.activation
    assert (repository / "docs" / "controllers" / f"{info.page}.md").is_file()
    assert info.sign in ("confirmed", "documented", "stated", "unconfirmed")


@pytest.mark.parametrize("name", BY_KIND["table"])
def test_the_flipped_table_is_refused_by_every_dialect(name, tmp_path):
    table = table_for(name, (21, 2e-3, 3e-6, 5))
    flipped = dataclasses.replace(
        table.negated(),
        source=None,
    )

    def error(x, *, direction=None):
        del direction
        return -table.correction(x, 1)

    if name in ONLY_REVERSAL:
        pytest.skip("judged by its lost motion: tests/controllers/test_pmac_backlash.py")
    with pytest.raises(SignCheckFailedError, match="does not shrink"):
        controllers.write(
            flipped,
            tmp_path / "x",
            name,
            verified_against=error,
            waive=("quantisation", "resampling"),
            sign_confirmed=True,
            **find(name).info.example,
        )
    assert list(tmp_path.iterdir()) == []

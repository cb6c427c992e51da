"""Straightedge reversal of two estimates: (19) with covariance, against draws and planted parts."""

import json
from dataclasses import replace

import numpy as np
import pytest
from contracts.estimates import DRAWS, LENGTH, NM, OF_DRAWS, X, known, some_covariance, waves

from metrosep import Run, RunSet
from metrosep.errors import DataError, NotSeparableError
from metrosep.separation import ErrorEstimate, Separation, separate, straightedge_reversal

pytestmark = pytest.mark.usefixtures("separations_once")

PM = 1e-12
EDGE = 80 * NM * np.exp(-(((X - 12e-3) / 4e-3) ** 2))
SLIDE = 60 * NM * np.sin(2 * np.pi * X / 31e-3) * X / LENGTH
"""A bump left of the middle and a wave that grows to the right: no mirror, no sign fits by chance."""


def level(z, x=X):
    return z - np.polyval(np.polyfit(x - x.mean(), z, 1), x - x.mean())


def pair(seeds=(1, 2)):
    """Estimates of both set-ups; the noise of each has a covariance of its own."""
    first, _ = known(error=level(EDGE + SLIDE), seed=seeds[0])
    second, _ = known(error=level(EDGE - SLIDE), seed=seeds[1])
    return first, second


def test_edge_and_slide_have_their_places_and_signs():
    result = straightedge_reversal(*pair())

    x = result.coordinates["x"]
    assert np.abs(result.artefact - level(np.interp(x, X, EDGE), x)).max() < 0.05 * NM
    assert np.abs(result.machine - level(np.interp(x, X, SLIDE), x)).max() < 0.05 * NM
    swapped = straightedge_reversal(*pair()[::-1])
    # S turns when the set-ups are swapped, T does not.
    np.testing.assert_allclose(swapped.machine, -result.machine, rtol=0, atol=PM)
    np.testing.assert_allclose(swapped.artefact, result.artefact, rtol=0, atol=PM)


def test_every_position_has_its_uncertainty_and_covariance_as_drawn():
    rng = np.random.default_rng(7)
    result = straightedge_reversal(*pair())
    x = result.coordinates["x"]
    noise = [
        waves(x) @ np.linalg.cholesky(some_covariance(24, seed)) @ rng.normal(size=(24, DRAWS))
        for seed in (1, 2)
    ]

    half = np.array([level(d, x) for d in ((noise[0] + noise[1]) / 2).T])
    turned = np.array([level(d, x) for d in ((noise[0] - noise[1]) / 2).T])

    for name, drawn in (("artefact", half), ("machine", turned)):
        np.testing.assert_allclose(result.u[name], drawn.std(axis=0), rtol=OF_DRAWS + 0.02)
        covariance = result.covariance(name)
        np.testing.assert_allclose(np.diag(covariance), result.u[name] ** 2, rtol=1e-12)
        off = np.abs(covariance - np.cov(drawn, rowvar=False)).max()
        assert off < 2 * OF_DRAWS * covariance.max()
        # The mean of the left third minus that of the right third: any functional of the curve.
        w = np.where(x < 15e-3, 1.0, np.where(x > 30e-3, -1.0, 0.0)) / 133
        assert np.sqrt(w @ covariance @ w) == pytest.approx(
            (drawn @ w).std(), rel=OF_DRAWS + 0.03, abs=0.0
        )


def test_what_both_setups_read_alike_is_the_edges_alone():
    plain, told = (straightedge_reversal(*pair(), u_common=u) for u in (0.0, 20 * NM))

    np.testing.assert_allclose(
        told.u["artefact"], np.hypot(plain.u["artefact"], 20 * NM), rtol=1e-12
    )
    np.testing.assert_array_equal(told.u["machine"], plain.u["machine"])
    assert told.audit["u_common_nm"] == pytest.approx(20.0, rel=1e-12, abs=0.0)
    # The same of plain readings.
    z = level(EDGE)
    bare = straightedge_reversal(z, z, x=X, u_reading=3 * NM, u_common=20 * NM)
    assert bare.u["artefact"].min() > 20 * NM
    assert bare.u["machine"].max() < 3 * NM


def test_a_shift_of_the_edge_adds_its_slope():
    plain, told = (straightedge_reversal(*pair(), u_registration=u) for u in (0.0, 0.1e-3))

    x = plain.coordinates["x"]
    slope = np.gradient(level(np.interp(x, X, EDGE), x), x)
    expected = np.hypot(plain.u["machine"], 0.05e-3 * slope)
    np.testing.assert_allclose(told.u["machine"], expected, rtol=1e-2)


def test_it_is_stored_with_its_covariance():
    result = straightedge_reversal(*pair())

    back = Separation.from_dict(json.loads(json.dumps(result.to_dict(), allow_nan=False)))

    for name in ("artefact", "machine"):
        np.testing.assert_array_equal(back.covariance(name), result.covariance(name))
    assert "covariance of the two estimates" in back.audit["u_from"]


def runs_of(shape, seed):
    """Runs at three feeds with 5 nm of noise, from a text book: no simulator of the package."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-2e-3, LENGTH + 2e-3, 500)
    z = np.interp(x, X, shape)
    return RunSet(
        [
            Run(x, z + 5 * NM * rng.normal(size=x.size), feed=f, run_id=f"s{seed}r{i}")
            for i, f in enumerate((0.08, 0.1, 0.125))
        ]
    )


def test_from_runs_to_parts_with_the_user_s_call():
    first, second = (
        separate(runs_of(z, i), method="mean", start=0.0, length=LENGTH)
        for i, z in enumerate((EDGE + SLIDE, EDGE - SLIDE))
    )

    result = straightedge_reversal(first, second)

    x = result.coordinates["x"]
    # (19); both estimates have no line, so taking it off again changes nothing.
    quarter = np.sqrt(first.sd(x) ** 2 + second.sd(x) ** 2) / 2
    np.testing.assert_allclose(result.u["machine"], quarter, rtol=0.02)
    np.testing.assert_allclose(result.u["artefact"], quarter, rtol=0.02)
    error = result.machine - level(np.interp(x, X, SLIDE), x)
    u = np.sqrt(np.mean(result.u["machine"] ** 2))
    assert u == pytest.approx(5 * NM / np.sqrt(6), rel=0.15, abs=0.0)  # 2 set-ups of 3 runs
    assert np.sqrt(np.mean(error**2)) == pytest.approx(u, rel=0.25, abs=0.0)
    with pytest.raises(NotSeparableError, match="made of the same 3 run"):
        straightedge_reversal(first, first)


def test_what_is_not_two_measurements_is_refused():
    first, second = pair()
    far = replace(second, start=LENGTH + 1e-3, stop=2 * LENGTH)
    old = ErrorEstimate.from_dict(
        {
            **first.to_dict(),
            "directions": {
                "1": {
                    k: v
                    for k, v in first.to_dict()["directions"]["1"].items()
                    if k != "covariance"
                }
            },
        }
    )

    with pytest.raises(DataError, match="one set-up is an estimate, the other is not"):
        straightedge_reversal(first, EDGE)
    with pytest.raises(DataError, match="leave out x and u_reading"):
        straightedge_reversal(first, second, u_reading=1e-9)
    with pytest.raises(NotSeparableError, match="no position in common"):
        straightedge_reversal(first, far)
    with pytest.raises(DataError, match="stored without its covariance"):
        straightedge_reversal(old, second)
    with pytest.raises(DataError, match="u_common"):
        straightedge_reversal(first, second, u_common=-1e-9)
    with pytest.raises(DataError, match="only its uncertainty at each position"):
        straightedge_reversal(EDGE, EDGE).covariance("machine")
    with pytest.raises(DataError, match="no part 'slide'"):
        straightedge_reversal(first, second).covariance("slide")

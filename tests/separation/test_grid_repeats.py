"""Coupled grid whose straightedge was laid anew between the repeats, or stayed."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.separation.planes.coupled_method import CoupledGrid, coupled_grid

NM = 1e-9
DX, DY, NOISE = 2e-3, 3e-3, 12 * NM
SHAPE = (7, 9)
V, U = np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j]
TERMS = {"free": [np.ones(SHAPE), U, V, U * V], "common": [np.ones(SHAPE), U, V]}
TERMS["none"] = TERMS["free"][:1]
SLOPES = ["free", "common", "none"]


def laid(rng, slopes):
    """Lines of both directions as they lie once: 2 um of offset, 15 um/m of slope and more."""
    rows = 2e-6 * rng.standard_normal((SHAPE[0], 1)) + np.zeros(SHAPE)
    columns = 2e-6 * rng.standard_normal((1, SHAPE[1])) + np.zeros(SHAPE)
    if slopes == "none":
        return rows, columns
    n_y, n_x = (SHAPE[0], SHAPE[1]) if slopes == "free" else (1, 1)
    rows = rows + 1e-6 * rng.standard_normal((n_y, 1)) * U
    return rows, columns + 1e-6 * rng.standard_normal((1, n_x)) * V


def measured(rng, slopes="free", repeats=3, noise=NOISE, relaid=True):
    e = 50 * NM * rng.standard_normal(SHAPE)
    lays = [laid(rng, slopes) for _ in range(repeats if relaid else 1)]
    lays = lays if relaid else lays * repeats
    sets = [np.array([e + lay[k] for lay in lays]) for k in range(2)]
    return e, *(s + noise * rng.standard_normal(s.shape) for s in sets)


def without(z, slopes, seen=None):
    use = np.ones(z.shape, bool) if seen is None else seen
    b = np.stack(TERMS[slopes], axis=-1)
    return z - b @ np.linalg.lstsq(b[use], z[use], rcond=None)[0]


def ragged(*sets):
    """Other points missing in each repeat, and a line that one repeat did not run."""
    rows, columns = (s.copy() for s in sets)
    rows[0, 2, 3:5] = np.nan
    rows[1, 5, 0] = np.nan
    rows[2, 4] = np.nan
    columns[1, 1:3, 6] = np.nan
    columns[2, :, 2] = np.nan
    return rows, columns


def test_reported_fault_12_nm_stay_12_nm_when_the_straightedge_is_laid_anew():
    """It gave 2362 nm and u = 1333 nm."""
    _, rows, columns = measured(np.random.default_rng(1))

    found = coupled_grid(rows, columns, dx=DX, dy=DY)

    # 378 readings less 63 points, 96 line terms and 4 back: sd of s 4.7 %
    assert found.audit["degrees_of_freedom"] == 378 - 63 - 96 + 4
    assert found.noise.value == pytest.approx(NOISE, rel=0.15, abs=0.0)
    assert found.noise.u == pytest.approx(NOISE / np.sqrt(2 * 223), rel=0.2, abs=0.0)
    assert found.u["error"].max() < NOISE
    assert found.audit["repeats"] == "relaid"


@pytest.mark.parametrize("slopes", SLOPES)
@pytest.mark.parametrize("gaps", [False, True])
def test_noise_free_map_is_exact(slopes, gaps):
    e, rows, columns = measured(np.random.default_rng(2), slopes, noise=0.0)
    if gaps:
        rows, columns = ragged(rows, columns)

    found = coupled_grid(rows, columns, dx=DX, dy=DY, slopes=slopes)

    assert np.max(np.abs(found.error - without(e, slopes))) < 1e-9 * np.ptp(e)
    assert len(found.null_space[0].indices) == len(TERMS[slopes])
    assert found.noise.value < 1e-9 * np.ptp(e)


@pytest.mark.parametrize("slopes", SLOPES)
@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("relaid", [True, False])
def test_map_u_and_freedom_are_those_of_brute_force(slopes, gaps, relaid):
    """One design row for each reading, map and all line terms written out, by pinv."""
    _, rows, columns = measured(np.random.default_rng(3), slopes, relaid=relaid)
    if gaps:
        rows, columns = ragged(rows, columns)
    n_map, design, z = rows[0].size, [], []
    for way, sets in enumerate((rows, columns)):
        for repeat, j, i in np.argwhere(~np.isnan(sets)):
            lay = repeat if relaid else 0
            line, at = (j, U[j, i]) if way == 0 else (i, V[j, i])
            row = np.zeros(n_map + 2 * 3 * 10 * 2)
            row[j * SHAPE[1] + i] = 1.0
            first = n_map + 20 * (2 * lay + way)
            row[first + line] = 1.0
            if slopes != "none":
                row[first + 10 + (line if slopes == "free" else 0)] = at
            design.append(row)
            z.append(sets[repeat, j, i])
    design, z = np.array(design), np.array(z)
    solve = np.linalg.pinv(design, rcond=1e-10)
    left = z - design @ (solve @ z)
    rank = np.linalg.matrix_rank(design, tol=1e-9)
    b = np.stack(TERMS[slopes], axis=-1).reshape(n_map, -1)
    map_of = solve[:n_map] - b @ np.linalg.lstsq(b, solve[:n_map], rcond=None)[0]
    s = np.sqrt(left @ left / (z.size - rank))

    kind = "relaid" if relaid else "passes"
    found = coupled_grid(rows, columns, dx=DX, dy=DY, slopes=slopes, repeats=kind)

    assert found.audit["degrees_of_freedom"] == z.size - rank
    assert found.noise.value == pytest.approx(s, rel=1e-9, abs=0.0)
    assert np.max(np.abs(found.error.ravel() - map_of @ z)) < 1e-9 * NM * 1e3
    u = s * np.sqrt((map_of**2).sum(axis=1))
    assert np.max(np.abs(found.u["error"].ravel() - u)) < 1e-9 * u.max()
    assert found.audit["n_readings"] == z.size


def test_repeats_that_read_the_same_points_give_the_map_of_their_mean():
    _, rows, columns = measured(np.random.default_rng(4))

    relaid = coupled_grid(rows, columns, dx=DX, dy=DY)
    passes = coupled_grid(rows, columns, dx=DX, dy=DY, repeats="passes")
    mean = coupled_grid(rows.mean(axis=0), columns.mean(axis=0), dx=DX, dy=DY)

    assert np.max(np.abs(relaid.error - mean.error)) < 1e-15
    assert np.max(np.abs(passes.error - mean.error)) < 1e-15
    assert passes.noise.value > 50 * relaid.noise.value


def test_passes_of_lines_that_stayed_have_more_freedom_and_no_warning():
    _, rows, columns = measured(np.random.default_rng(5), relaid=False)

    passes = coupled_grid(rows, columns, dx=DX, dy=DY, repeats="passes")
    relaid = coupled_grid(rows, columns, dx=DX, dy=DY)

    # two repeats more, each with 2 terms for 7 + 9 lines
    assert passes.audit["degrees_of_freedom"] - relaid.audit["degrees_of_freedom"] == 2 * 32
    assert passes.noise.value == pytest.approx(NOISE, rel=0.15, abs=0.0)
    assert relaid.noise.value == pytest.approx(NOISE, rel=0.15, abs=0.0)
    assert not any("laid anew" in m for m in passes.messages + relaid.messages)


def test_passes_that_were_laid_anew_are_told():
    """Even where the lays differ by little more than the noise."""
    rng = np.random.default_rng(6)
    _, rows, columns = measured(rng, relaid=False)
    rows += 1.5 * NOISE * rng.standard_normal((3, SHAPE[0], 1))
    columns += 1.5 * NOISE * rng.standard_normal((3, 1, SHAPE[1]))

    found = coupled_grid(rows, columns, dx=DX, dy=DY, repeats="passes")

    assert any("laid anew" in m and "'relaid'" in m for m in found.messages)


def test_no_alarm_for_passes_of_lines_that_stayed():
    for seed in range(60):
        _, rows, columns = measured(np.random.default_rng(100 + seed), relaid=False, repeats=2)
        found = coupled_grid(rows, columns, dx=DX, dy=DY, repeats="passes")
        assert not any("laid anew" in m for m in found.messages)


def test_repeats_of_another_number_in_each_direction():
    e, rows, columns = measured(np.random.default_rng(7), noise=0.0)

    found = coupled_grid(rows, columns[:1], dx=DX, dy=DY)

    assert np.max(np.abs(found.error - without(e, "free"))) < 1e-9 * np.ptp(e)


def test_line_run_in_one_repeat_only():
    """Each repeat ran other lines: together they are the grid."""
    e, rows, columns = measured(np.random.default_rng(8), noise=0.0, repeats=2)
    rows[0, ::2] = np.nan
    rows[1, 1::2] = np.nan
    columns[1] = np.nan

    found = coupled_grid(rows, columns, dx=DX, dy=DY)

    assert np.max(np.abs(found.error - without(e, "free"))) < 1e-9 * np.ptp(e)


@pytest.mark.slow
@pytest.mark.parametrize("gaps", [False, True])
def test_uncertainty_agrees_with_monte_carlo(gaps):
    """400 trials: an sd is known to 3.5 %; three times that for the worst of four."""
    rest, told = [], []
    at = ([0, 3, 4, 2], [0, 2, 5, 3])
    for seed in range(400):
        e, rows, columns = measured(np.random.default_rng(1000 + seed))
        if gaps:
            rows, columns = ragged(rows, columns)
        found = coupled_grid(rows, columns, dx=DX, dy=DY)
        rest.append((found.error - without(e, "free"))[at])
        told.append(found.u["error"][at])

    drawn = np.std(rest, axis=0)
    stated = np.sqrt(np.mean(np.square(told), axis=0))
    assert drawn == pytest.approx(stated, rel=0.11, abs=0.0)


def test_method_hands_the_kind_of_repeats_on():
    _, rows, columns = measured(np.random.default_rng(9))
    readings = np.stack([rows, columns])

    found = CoupledGrid(DX, DY).separate(readings)
    stayed = CoupledGrid(DX, DY, repeats="passes").separate(readings)

    assert stayed.noise.value > 50 * found.noise.value
    assert found.null_space == stayed.null_space == CoupledGrid(DX, DY).null_space()
    assert found.history[-1].parameters["repeats"] == "relaid"


def test_refuses():
    flat = np.zeros((2, 5, 5))
    with pytest.raises(DataError, match="one of relaid, passes"):
        coupled_grid(flat, flat, dx=DX, dy=DY, repeats="some")
    with pytest.raises(DataError, match="one of relaid, passes"):
        CoupledGrid(DX, DY, repeats="mean")
    many = np.random.default_rng(1).standard_normal((60, 30, 30))
    many[np.arange(60), np.arange(60) % 30, 3] = np.nan
    many[30:, 7, 7] = np.nan
    with pytest.raises(DataError, match="in all repeats"):
        coupled_grid(many, many, dx=DX, dy=DY)

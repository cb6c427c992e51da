"""2-D self-calibration: views of a grid plate, simulated mark by mark without library code."""

import copy
import json

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    UnitError,
)
from metrosep.separation.planes.lattice_calibration import GridView, grid_calibration

NM = 1e-9
PITCH = 10e-3
STANDARD = ((0, (0, 0)), (1, (0, 0)), (0, (1, 0)))
RELATIVE = 1e-9


def simulate(rng, n, *, noise=0.0, placements=STANDARD, repeats=1, stage=None, plate=None):
    """Put each mark where it comes to lie and read it with the stage error of that site."""
    stage = 100 * NM * rng.standard_normal((n, n, 2)) if stage is None else stage
    plate = 100 * NM * rng.standard_normal((n, n, 2)) if plate is None else plate
    middle = (n - 1) / 2
    views = []
    for turns, (shift_x, shift_y) in placements:
        view = np.full((repeats, n, n, 2), np.nan)
        translation, rotation = 100 * NM * rng.standard_normal(2), 3e-8 * rng.standard_normal()
        for j in range(n):
            for i in range(n):
                x, y = i - middle, j - middle
                error = plate[j, i]
                for _ in range(turns):  # x goes to y, y to -x
                    x, y = -y, x
                    error = np.array([-error[1], error[0]])
                x, y = x + shift_x, y + shift_y
                column, row = round(x + middle), round(y + middle)
                if 0 <= column < n and 0 <= row < n:
                    rigid = translation + rotation * np.array([-y, x])
                    drawn = noise * rng.standard_normal((repeats, 2))
                    view[:, row, column] = error + stage[row, column] + rigid + drawn
        views.append(GridView(view, turns, (shift_x, shift_y)))
    return stage, plate, views


def without_terms(e, mask=None):
    """Without translation, rotation and scale."""
    n_y, n_x = e.shape[:2]
    j, i = np.mgrid[:n_y, :n_x]
    j, i = j - (n_y - 1) / 2, i - (n_x - 1) / 2
    one, zero = np.ones_like(i), np.zeros_like(i)
    pairs = [(one, zero), (zero, one), (-j, i), (i, j)]
    basis = np.stack([np.stack(p, -1) for p in pairs], -1).reshape(-1, 4)
    use = np.ones(e.size, bool) if mask is None else np.repeat(mask.ravel(), 2)
    flat = e.reshape(-1)
    return (flat - basis @ np.linalg.lstsq(basis[use], flat[use], rcond=None)[0]).reshape(e.shape)


@pytest.mark.parametrize("n", [3, 4, 7, 10])
def test_noise_free_parts_are_exact_but_for_the_null_space(n):
    stage, plate, views = simulate(np.random.default_rng(n), n)

    found = grid_calibration(views, pitch=PITCH)

    assert np.max(np.abs(found.stage - without_terms(stage))) < RELATIVE * np.ptp(stage)
    assert np.max(np.abs(found.plate - without_terms(plate))) < RELATIVE * np.ptp(plate)
    assert found.audit["null_space_dimension"] == 7  # 2 x (2 translations, rotation), 1 scale


def test_named_views_are_the_standard_placements():
    stage, plate, views = simulate(np.random.default_rng(20), 6)
    named = dict(
        zip(("initial", "rotated", "shifted"), [v.readings[0] for v in views], strict=True)
    )

    found = grid_calibration(named, pitch=PITCH)

    assert np.max(np.abs(found.stage - without_terms(stage))) < RELATIVE * np.ptp(stage)
    assert np.max(np.abs(found.plate - without_terms(plate))) < RELATIVE * np.ptp(plate)


def test_scale_is_lost_and_only_the_sum_is_told():
    """Stage 3 ppm long, plate 5 ppm long, nothing else: both parts zero, sum 8 ppm."""
    n = 5
    j, i = np.mgrid[:n, :n] - (n - 1) / 2
    radial = PITCH * np.stack([i, j], -1)
    _, _, views = simulate(np.random.default_rng(21), n, stage=3e-6 * radial, plate=5e-6 * radial)

    found = grid_calibration(views, pitch=PITCH)

    assert np.max(np.abs(found.stage)) < 1e-16
    assert np.max(np.abs(found.plate)) < 1e-16
    assert found.audit["sum_of_scales_ppm"] == pytest.approx(8.0, abs=1e-6)
    assert found.audit["scale_ppm"] is None
    assert "scale" in found.null_space[0].indices
    assert any("scale" in m for m in found.messages)


def test_orthogonality_and_bow_of_the_stage_are_seen():
    """What a designer asks: squareness of the axes and a curved axis, told from the plate's."""
    n = 7
    j, i = np.mgrid[:n, :n] - (n - 1) / 2
    stage = 50 * NM * np.stack([j, np.zeros_like(j)], -1)  # x reads more at larger y: shear
    stage[..., 1] += 5 * NM * i**2  # bow of x
    _, _, views = simulate(np.random.default_rng(22), n, stage=stage, plate=np.zeros((n, n, 2)))

    found = grid_calibration(views, pitch=PITCH)

    assert np.max(np.abs(found.plate)) < 1e-15
    assert np.max(np.abs(found.stage - without_terms(stage))) < 1e-15
    assert np.ptp(found.stage[..., 0]) > 100 * NM


def test_planted_mark_keeps_place_component_and_sign():
    n = 6
    plate = np.zeros((n, n, 2))
    plate[1, 4, 0] = 80 * NM
    _, _, views = simulate(np.random.default_rng(23), n, stage=np.zeros((n, n, 2)), plate=plate)

    found = grid_calibration(views, pitch=PITCH)

    assert np.unravel_index(np.argmax(np.abs(found.plate)), plate.shape) == (1, 4, 0)
    assert found.plate[1, 4, 0] > 60 * NM
    assert np.max(np.abs(found.stage)) < 1e-15


def test_correction_is_minus_the_stage_error():
    stage, _, views = simulate(np.random.default_rng(24), 6, noise=NM)
    found = grid_calibration(views, pitch=PITCH)
    true = without_terms(stage)

    assert np.std(true - found.stage) < 0.05 * np.std(true)
    assert np.std(true + found.stage) > 1.9 * np.std(true)


@pytest.mark.slow
def test_uncertainty_agrees_with_monte_carlo():
    """300 trials: an sd is known to 4.1 %; three times that."""
    rng = np.random.default_rng(25)
    stage, plate, _ = simulate(rng, 4)
    rest = []
    for _ in range(300):
        *_, views = simulate(rng, 4, noise=5 * NM, stage=stage, plate=plate)
        found = grid_calibration(views, pitch=PITCH)
        off_s, off_p = (found.stage - without_terms(stage), found.plate - without_terms(plate))
        rest.append([off_s[0, 0, 0], off_s[2, 2, 1], off_p[1, 3, 0], found.noise.value])

    rest = np.array(rest)
    unit = 5 * NM / found.noise.value
    stated = unit * np.array(
        [found.u["stage"][0, 0, 0], found.u["stage"][2, 2, 1], found.u["plate"][1, 3, 0]]
    )
    assert rest[:, :3].std(axis=0) == pytest.approx(stated, rel=0.13, abs=0.0)
    assert np.sqrt(np.mean(rest[:, 3] ** 2)) == pytest.approx(5 * NM, rel=0.02, abs=0.0)


def test_repeats_shrink_u_by_the_root():
    stage, plate, few = simulate(np.random.default_rng(26), 5, noise=5 * NM, repeats=2)
    _, _, many = simulate(
        np.random.default_rng(27), 5, noise=5 * NM, repeats=32, stage=stage, plate=plate
    )

    ratio = [grid_calibration(v, pitch=PITCH).u["stage"].mean() for v in (few, many)]

    assert ratio[0] / ratio[1] == pytest.approx(4.0, rel=0.2, abs=0.0)


def test_noise_gain_grows_slowly_with_the_lattice():
    """About one sigma, growing like a logarithm, not like the number of sites."""
    gains = []
    for n in (3, 6, 12):
        _, _, views = simulate(np.random.default_rng(28), n, noise=NM)
        found = grid_calibration(views, pitch=PITCH)
        gains.append(np.sqrt(np.mean(found.u["stage"] ** 2)) / found.noise.value)

    assert 0.6 < gains[0] < gains[1] < gains[2] < 1.1
    assert gains[2] - gains[1] < 0.15


def test_missing_marks_stay_exact_where_determined():
    stage, _, views = simulate(np.random.default_rng(29), 6)
    for v in views:
        v.readings[:, 2, 3] = np.nan  # this site is never read
    views[0].readings[:, 0, 1] = np.nan

    found = grid_calibration(views, pitch=PITCH)

    assert np.isnan(found.stage[2, 3]).all()
    assert np.isfinite(found.stage).sum() >= 2 * 33
    known = np.isfinite(found.stage[..., 0])
    rest = (found.stage - without_terms(stage, known))[known]
    assert np.max(np.abs(rest)) < RELATIVE * np.ptp(stage)
    assert any("not determined" in m for m in found.messages)


def test_wrong_turn_is_noticed():
    """The plate was turned the other way: the residuals exceed the stated noise and it is said."""
    _, _, views = simulate(
        np.random.default_rng(30), 6, placements=((0, (0, 0)), (3, (0, 0)), (0, (1, 0)))
    )
    said = [views[0], GridView(views[1].readings, 1), views[2]]

    found = grid_calibration(said, pitch=PITCH, u_reading=2 * NM)

    assert any("not what it was said to be" in m for m in found.messages)


@pytest.mark.parametrize(
    ("placements", "match"),
    [
        (((0, (0, 0)), (0, (1, 0))), "90 degrees is missing"),
        (((0, (0, 0)), (1, (0, 0))), "shifted by one pitch is missing"),
        (((0, (0, 0)),), "90 degrees and a view shifted"),
        (((0, (0, 0)), (2, (0, 0)), (0, (1, 0))), "90 degrees is missing"),
        (((0, (0, 0)), (1, (0, 0)), (2, (0, 0)), (3, (0, 0))), "shifted by one pitch is missing"),
        (((0, (0, 0)), (1, (0, 0)), (0, (2, 0))), "patterns undetermined"),
    ],
)
def test_what_is_missing_is_named(placements, match):
    _, _, views = simulate(np.random.default_rng(31), 6, placements=placements)

    with pytest.raises(NotSeparableError, match=match):
        grid_calibration(views, pitch=PITCH)


def test_wrong_sign_of_the_shift_is_refused():
    _, _, views = simulate(np.random.default_rng(32), 5)

    with pytest.raises(DataError, match="sign of the shift"):
        grid_calibration([*views[:2], GridView(views[2].readings, 0, (-1, 0))], pitch=PITCH)


@pytest.mark.parametrize(
    ("views", "error", "match"),
    [
        ([], NotSeparableError, "no view"),
        ({"first": np.zeros((5, 5, 2))}, DataError, "named initial"),
        ([np.zeros((5, 5, 2))], DataError, "GridView"),
        ([GridView(np.zeros((5, 5)))], DataError, "shape"),
        ([GridView(np.zeros((2, 5, 2)))], DataError, "3 x 3"),
        ([GridView(np.zeros((5, 5, 2))), GridView(np.zeros((6, 5, 2)))], DataError, "differ"),
        ([GridView(np.zeros((5, 5, 2)), 0.5)], DataError, "whole"),
        ([GridView(np.zeros((5, 6, 2)), 1)], DataError, "onto itself"),
        ([GridView(np.ones((5, 5, 2)))], UnitError, "in m"),
    ],
)
def test_refuses(views, error, match):
    with pytest.raises(error, match=match):
        grid_calibration(views, pitch=PITCH)


# -- hostile review ------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 5 * NM])
@pytest.mark.parametrize("declared", [1, 3])
def test_a_turn_of_the_other_sense_is_told_without_a_stated_noise(noise, declared):
    """Plate turned one way, declared the other; the right declaration says nothing."""
    true = 4 - declared
    placements = ((0, (0, 0)), (true, (0, 0)), (0, (1, 0)))
    _, _, views = simulate(np.random.default_rng(3), 5, noise=noise, placements=placements)
    wrong = [
        GridView(v.readings, declared if v.turns == true else v.turns, v.shift) for v in views
    ]

    said = " ".join(grid_calibration(wrong, pitch=PITCH).messages)
    assert "view 2 turned by" in said
    assert "as stated, the result is wrong" in said
    assert "sense" not in " ".join(grid_calibration(views, pitch=PITCH).messages)


def test_one_wrong_turn_among_right_ones_is_named():
    placements = ((0, (0, 0)), (1, (0, 0)), (3, (0, 0)), (0, (1, 0)))
    _, _, views = simulate(np.random.default_rng(4), 5, noise=NM, placements=placements)
    wrong = [*views[:2], GridView(views[2].readings, 1), views[3]]
    said = " ".join(grid_calibration(wrong, pitch=PITCH).messages)
    assert "view 3 turned by -90 degrees instead of +90" in said
    assert "view 2" not in said


def test_noise_alone_does_not_accuse_the_turn():
    zero = np.zeros((5, 5, 2))
    for seed in range(10):
        _, _, views = simulate(
            np.random.default_rng(seed), 5, noise=20 * NM, stage=zero, plate=zero
        )
        assert "sense" not in " ".join(grid_calibration(views, pitch=PITCH).messages)


@pytest.mark.parametrize(
    ("change", "options", "error", "match"),
    [
        ({"shift": 1}, {}, DataError, "pair of whole"),
        ({"shift": (1.5, 0)}, {}, DataError, "pair of whole"),
        ({"shift": (1, 0, 0)}, {}, DataError, "pair of whole"),
        ({"turns": "a"}, {}, DataError, "turns is a whole number"),
        ({"turns": np.nan}, {}, DataError, "turns is a whole number"),
        ({"readings": np.zeros((5, 5, 2)) + 1j}, {}, InvalidSamplesError, "complex"),
        ({"readings": [[1.0], [1.0, 2.0]]}, {}, InvalidSamplesError, "view 1: readings"),
        ({}, {"u_reading": "a"}, DataError, "u_reading 'a' is not a number"),
        ({}, {"u_reading": -1e-9}, DataError, "u_reading"),
        ({}, {"pitch": "10 V"}, DataError, "a length is needed"),
    ],
)
def test_what_is_typed_wrong_is_refused(change, options, error, match):
    _, _, views = simulate(np.random.default_rng(1), 5)
    first = {"readings": views[0].readings, "turns": 0, "shift": (0, 0), **change}
    with pytest.raises(error, match=match):
        grid_calibration([GridView(**first), *views[1:]], **{"pitch": PITCH, **options})


def test_result_is_strict_json_and_copied():
    _, _, views = simulate(np.random.default_rng(1), 4)
    found = grid_calibration(views, pitch=PITCH)
    json.dumps(found.to_dict(), allow_nan=False)
    assert copy.deepcopy(found).to_dict() == found.to_dict()
    assert len(repr(views[0])) < 80

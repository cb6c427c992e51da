"""What is rounding of zero is not a drift; what is small and real is."""

import math

import numpy as np
import pytest

from metrosep.parameters import part_series
from metrosep.parameters.gauge import capability_of
from metrosep.parameters.repeats import constant, floors

N = 40
RISE = np.arange(N) / (N - 1.0)


def noise(size, seed, n=N):
    return size * np.random.default_rng(seed).standard_normal(n)


def table(**more):
    return {"Sq": 1e-8 + noise(3e-10, 1), **more}


def test_rounding_of_zero_is_no_trend():
    # a rise of 5e-24 m with a scatter of 1e-24 m, and a twin of it
    piston = 5e-24 * RISE + noise(1e-24, 2)
    found = part_series(table(piston=piston, tilt=piston + noise(1e-26, 3)))

    assert found.drifting == ()
    assert found.correlated == ()
    term = found.terms[1]
    assert term.constant
    assert (term.beyond, term.runs, term.drifts) == ((), (), False)
    assert all(math.isnan(v) for v in (term.lower, term.upper, term.range_upper))
    assert math.isnan(found.correlation[1, 2])
    assert found.messages == (
        "piston: the same in all parts to within rounding",
        "tilt: the same in all parts to within rounding",
    )


def test_a_true_drift_of_a_picometre_is_found():
    # the same shape, 12 decades larger
    found = part_series(table(piston=1e-9 + 5e-12 * RISE + noise(1e-12, 2)))

    assert [t.name for t in found.drifting] == ["piston"]
    assert not any(t.constant for t in found.terms)


@pytest.mark.parametrize("size", [1e-12, 1e-14])
def test_a_small_term_is_not_hidden_by_a_radius(size):
    # radius of 1 km: 1e-12 of it is 1 nm
    found = part_series(table(R=1e3 + noise(1e-3, 4), Z8=5 * size * RISE + noise(size, 2)))

    assert [t.name for t in found.drifting] == ["Z8"]


def test_without_larger_values_small_ones_count():
    found = part_series({"a": 5e-24 * RISE + noise(1e-24, 2)})

    assert [t.name for t in found.drifting] == ["a"]
    sizes = {"m": 1e-8}
    assert part_series({"a": 5e-24 * RISE + noise(1e-24, 2)}, sizes=sizes).drifting == ()


def test_numbers_without_unit_and_other_units_do_not_judge_each_other():
    units = {"n": "1", "Sdr": "1", "tilt": "rad", "Sq": "m"}
    columns = {
        "n": 1e6 + noise(10.0, 5),
        "Sdr": 5e-10 * RISE + noise(1e-10, 2),
        "tilt": 5e-13 * RISE + noise(1e-13, 6),
    }
    found = part_series(table(**columns), units=units)

    assert sorted(t.name for t in found.drifting) == ["Sdr", "tilt"]


@pytest.mark.parametrize(
    ("values", "floor", "wanted"),
    [
        ([1e-24, 2e-24], 1e-20, True),
        ([1e-24, 2e-24], 0.0, False),
        ([5.0, 5.0 + 1e-12], 0.0, True),
        ([5.0, 5.0 + 1e-10], 0.0, False),
        ([0.0, 2e-20], 1e-20, False),
        ([math.nan, 3.0, math.nan], 0.0, True),
        ([], 0.0, True),
    ],
)
def test_constant_by_hand(values, floor, wanted):
    assert constant(values, floor) is wanted


def test_floors_by_hand():
    found = floors([("m", -2e-8), ("m", 1e-9), ("m", math.nan), ("rad", 5e3), ("1", 1e9)])

    assert set(found) == {"m", "rad"}
    assert abs(found["m"] - 2e-20) <= 1e-32
    assert found["rad"] == 1e-15


def test_rounding_has_no_capability():
    # 1e-24 beside limits of 12e-9: Cpk would be 1e15
    values = noise(1e-24, 7).tolist()

    assert capability_of(values, lower=-12e-9, upper=12e-9) is None
    assert capability_of(noise(1e-12, 7).tolist(), lower=-12e-9, upper=12e-9) is not None


def test_identities_are_told_apart_from_a_planted_pair():
    # Sq, RMS, 3 Sq and -Sq say the same; 20 noisy terms; Z8 and Z9 share a part with r about 0.86
    sq = 1e-8 + noise(3e-10, 1)
    common = noise(1e-9, 11)
    columns = {"Sq": sq, "rms": sq * (1 + 1e-9), "Sz": 3 * sq, "minus": -sq}
    columns |= {"Z8": common + noise(0.4e-9, 12), "Z9": common + noise(0.4e-9, 13)}
    columns |= {f"n{i}": noise(1e-9, 20 + i) for i in range(4)}
    found = part_series(columns)

    assert found.same == (("Sq", "rms", "Sz", "minus"),)
    assert [set(p[:2]) for p in found.correlated] == [{"Z8", "Z9"}]
    assert found.to_dict()["same"] == [["Sq", "rms", "Sz", "minus"]]


def test_the_pairs_of_an_identity_do_not_help_others_over_the_threshold():
    # 15 sure pairs in the count would let p = 0.03 pass as one of 21; alone it is one of 6
    sq = 1e-8 + noise(3e-10, 1)
    chance = {f"n{i}": noise(1e-9, 300 + i) for i in range(3)}
    alone = part_series({"Sq": sq, **chance})
    many = part_series({**{f"Sq{i}": sq * (1 + i) for i in range(12)}, **chance})

    assert len(many.same) == 1
    assert len(many.same[0]) == 12
    # one term stands for the group: the same tests, the same result
    assert [p[2] for p in many.correlated] == [p[2] for p in alone.correlated]

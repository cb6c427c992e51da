"""Drift: ranges against plain loops, A-B-B-A closed forms, joint fit against the bound, Allan."""

import copy
import json
import math
import pickle

import numpy as np
import pytest

from metrosep import Recording
from metrosep.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.separation import abba, allan_deviation, iso230_3_drift, joint_drift

UM, NM = 1e-6, 1e-9
ROUNDING = 1e-12  # goal S22, of quantities of the order of one

# --- A-B-B-A -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("order", "sign"), [("ABBA", 1.0), ("BAAB", -1.0)])
def test_linear_drift_cancels(order, sign):
    """A = 5.5, B = 2.25; drift 3 + 0.7 t."""
    t = np.arange(4.0)
    objects = np.array([5.5 if c == "A" else 2.25 for c in order])

    result = abba(objects + 3 + 0.7 * t, order=order)

    assert float(result.difference) == pytest.approx(3.25, abs=ROUNDING)
    assert float(result.drift_rate) == pytest.approx(0.7, abs=ROUNDING)
    assert result.weights == pytest.approx(sign * np.array([0.5, -0.5, -0.5, 0.5]), abs=ROUNDING)


@pytest.mark.parametrize(("order", "sign"), [("ABBA", 1.0), ("BAAB", -1.0)])
def test_quadratic_drift_leaves_two_c_dt_squared(order, sign):
    t = 30.0 * np.arange(4.0)
    c = 1e-4

    result = abba(c * (t - 17.0) ** 2, order=order, t=t)

    assert float(result.difference) == pytest.approx(sign * 2 * c * 30.0**2, abs=ROUNDING)
    assert result.quadratic_gain * c == pytest.approx(float(result.difference), abs=ROUNDING)


def test_unequal_steps_still_cancel_linear_drift():
    t = np.array([0.0, 10.0, 25.0, 31.0])
    readings = np.array([4.0, 1.0, 1.0, 4.0]) + 0.03 * t

    assert float(abba(readings, t=t).difference) == pytest.approx(3.0, abs=ROUNDING)
    assert abs(float(abba(readings).difference) - 3.0) > 0.01  # equal steps are the wrong model


def test_maps_and_gaps():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 6, 5))
    rate = rng.normal(size=(6, 5))
    stack = np.array([a, b + rate, b + 2 * rate, a + 3 * rate])
    holed = stack.copy()
    holed[2, 1, 3] = np.nan

    full, part = abba(stack), abba(holed)

    np.testing.assert_allclose(full.difference, a - b, atol=ROUNDING, rtol=0)
    assert np.argwhere(np.isnan(part.difference)).tolist() == [[1, 3]]
    assert any("lack a reading" in m for m in part.messages)


@pytest.mark.slow
def test_uncertainty_of_one_and_of_many_sequences():
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(4000, 4))

    one = abba(np.zeros(4), sd=0.3)
    singles = [float(abba(row).difference) for row in noise]
    many = abba(noise[:400].ravel())

    assert float(one.u) == pytest.approx(0.3, abs=ROUNDING)
    assert np.std(singles) == pytest.approx(1.0, abs=0.04)  # 3.6 sd of 4000
    assert float(many.u) == pytest.approx(1 / 20, abs=0.006)
    assert math.isnan(float(abba(np.zeros(4)).u))


def test_a_change_in_step_with_the_exchange_is_not_seen():
    """Null space: what follows A-B-B-A is taken for the object."""
    assert float(abba(np.array([1.0, 0, 0, 1])).difference) == pytest.approx(1.0, abs=ROUNDING)


@pytest.mark.parametrize(
    ("readings", "options", "error", "match"),
    [
        ([1, 2, 3], {}, InvalidSamplesError, "fours"),
        ([], {}, InvalidSamplesError, "fours"),
        (3.0, {}, InvalidSamplesError, "fours"),
        ([[1, 2], [1], [1, 2], [1, 2]], {}, InvalidSamplesError, "one shape"),
        ([1, 2, 3, np.inf], {}, InvalidSamplesError, "infinite"),
        ([np.nan] * 4, {}, InvalidSamplesError, "all are NaN"),
        ([1, 2, 3, 4], {"order": "ABAB"}, DataError, "'ABBA' or 'BAAB'"),
        ([1, 2, 3, 4], {"sd": -1}, DataError, "sd must"),
        ([1, 2, 3, 4], {"sd": "1 nm"}, DataError, "sd must be a number"),
        ([1, 2, 3, 4], {"order": ["A"]}, DataError, "'ABBA' or 'BAAB'"),
        ([1, 2, 3, 4], {"t": ["a", 1, 2, 3]}, InvalidSamplesError, "times"),
        ([1, 2, 3, 4], {"t": [0, 1, 1, 2]}, InvalidSamplesError, "increasing"),
        ([1, 2, 3, 4], {"t": [0, 1, 2]}, InvalidSamplesError, "shape"),
    ],
)
def test_bad_sequences_are_refused(readings, options, error, match):
    with pytest.raises(error, match=match):
        abba(readings, **options)


# --- joint fit -----------------------------------------------------------------------------------


def test_joint_fit_of_abba_is_abba():
    rng = np.random.default_rng(2)
    readings = rng.normal(size=4)

    value, u = joint_drift(np.arange(4.0), readings, "ABBA", sd=0.2).difference("A", "B")

    assert float(value) == pytest.approx(float(abba(readings).difference), abs=ROUNDING)
    assert float(u) == pytest.approx(0.2, abs=ROUNDING)


@pytest.mark.parametrize(("degree", "pieces"), [(3, None), (1, 6)])
def test_exact_drift_and_quantities_come_back(degree, pieces):
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(0, 3600, size=40))
    names = [("A", "B", "C")[i] for i in rng.integers(0, 3, size=40)]
    truth = {"A": 1.0, "B": -2.0, "C": 0.5}
    s = (t - t[0]) / 3600
    drift = 2 * s - 3 * s**2 + s**3

    fit = joint_drift(t, drift + [truth[n] for n in names], names, degree=degree, n_pieces=pieces)

    for name, value in zip(fit.labels, fit.values, strict=True):
        assert float(value) == pytest.approx(truth[name], abs=1e-9)
    np.testing.assert_allclose(fit.drift, drift, atol=1e-9, rtol=0)
    assert fit.drift[0] == pytest.approx(0.0, abs=ROUNDING)


def test_scatter_attains_the_cramer_rao_bound():
    """Goal S22, within 10 %: information matrix written here from basis functions of its own."""
    rng = np.random.default_rng(4)
    t = np.linspace(0.0, 100.0, 24)
    names = list("ABBAABBACCABBACCAABBCCAB")
    sd = 0.4
    basis = np.column_stack(
        [[float(n == k) for n in names] for k in "ABC"] + [t / 100, (t / 100) ** 2]
    )
    bound = np.sqrt(np.diag(np.linalg.inv(basis.T @ basis / sd**2)))[:3]
    clean = basis @ np.array([1.0, 2.0, 3.0, -4.0, 5.0])

    fits = [joint_drift(t, clean + sd * rng.normal(size=24), names, degree=2) for _ in range(1500)]

    values = np.array([f.values for f in fits])
    scatter = values.std(axis=0, ddof=1)
    assert scatter == pytest.approx(bound, abs=0.06 * bound.max())
    assert np.mean([f.u for f in fits], axis=0) == pytest.approx(bound, abs=0.05 * bound.max())
    assert values.mean(axis=0) == pytest.approx([1, 2, 3], abs=4 * bound.max() / 38)
    inside = np.mean([abs(f.values[0] - 1.0) <= 1.96 * f.u[0] for f in fits])
    assert 0.91 <= inside <= 0.96  # 19 degrees of freedom: 93.5 %


def test_profiles_each_point_with_its_own_drift_and_gaps():
    rng = np.random.default_rng(5)
    t = np.arange(8.0)
    shape = {"A": rng.normal(size=50), "B": rng.normal(size=50)}
    rate = rng.normal(size=50)
    readings = np.array([shape[n] + rate * k for k, n in zip(t, "ABBAABBA", strict=True)])
    holed = readings.copy()
    holed[3, 7] = np.nan
    holed[:, 9] = np.nan

    fit = joint_drift(t, holed, "ABBAABBA")
    value, _ = fit.difference("A", "B")

    wanted = shape["A"] - shape["B"]
    wanted[9] = np.nan
    np.testing.assert_allclose(value, wanted, atol=1e-11, rtol=0)
    assert np.isnan(fit.residual[3, 7])
    assert any("too few readings" in m for m in fit.messages)


def test_the_difference_is_as_uncertain_as_its_gaps_make_it():
    """Weights of the readings that remain, by normal equations written here."""
    t, order, sd = np.arange(10.0), "ABBAABBAAB", 0.5
    lost = [1, 4, 5, 8]
    kept = [k for k in range(10) if k not in lost]
    design = np.array([[order[k] == "A", order[k] == "B", k / 9.0] for k in kept], dtype=float)
    pick = np.array([1.0, -1.0, 0.0])
    wanted = sd * math.sqrt(pick @ np.linalg.inv(design.T @ design) @ pick)  # 0.43, full: 0.32
    readings = np.zeros(10)
    readings[lost] = np.nan
    map_of_three = np.zeros((10, 3))
    map_of_three[lost, 1] = np.nan
    full = float(joint_drift(t, np.zeros(10), order, sd=sd).difference("A", "B")[1])

    one, several = (
        joint_drift(t, readings, order, sd=sd),
        joint_drift(t, map_of_three, order, sd=sd),
    )

    assert wanted > 1.3 * full
    assert float(one.difference("A", "B")[1]) == pytest.approx(wanted, abs=ROUNDING)
    assert several.difference("A", "B")[1] == pytest.approx([full, wanted, full], abs=ROUNDING)
    assert np.sqrt(np.diag(one.covariance)) * sd == pytest.approx(one.u, abs=ROUNDING)


def test_a_quantity_that_gaps_removed_has_no_difference():
    readings = np.array([1.0, np.nan, np.nan, 1.1, 1.2, 1.3])

    value, u = joint_drift(np.arange(6.0), readings, "ABBAAA", sd=0.1).difference("A", "B")

    assert math.isnan(float(value))
    assert math.isnan(float(u))


def test_gaps_that_use_up_the_redundancy_are_said():
    readings = np.array([[1.0, 1.0], [2, 2], [3, 3], [1, np.nan], [2, 2]])

    fit = joint_drift(np.arange(5.0), readings, "ABCAB", degree=1)

    assert np.isnan(fit.u[:, 1]).all()
    assert np.isfinite(fit.values[:, 1]).all()
    assert any("1 point(s) have no redundancy" in m for m in fit.messages)


def test_masked_readings_are_not_measured():
    readings = np.ma.masked_greater(np.array([7.0, 3.1, 900.0, 7.3, 7.4, 3.5]), 100.0)
    plain = readings.filled(np.nan)

    fit, wanted = (joint_drift(np.arange(6.0), r, "ABBAAB") for r in (readings, plain))

    assert fit.values == pytest.approx(wanted.values, abs=ROUNDING)
    assert math.isnan(float(abba(readings[:4]).difference))


def test_reference_time_moves_the_level_only():
    t = np.arange(6.0)
    readings = 10 + 0.5 * t

    first, last = joint_drift(t, readings), joint_drift(t, readings, reference=5.0)

    assert float(first.values[0]) == pytest.approx(10.0, abs=ROUNDING)
    assert float(last.values[0]) == pytest.approx(12.5, abs=ROUNDING)
    assert first.u_drift[0] == 0.0
    assert "polynomial of degree 1" in repr(first)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "match"),
    [
        (([0, 1, 2], [1, 2, 3], "ABC"), {}, TooFewSamplesError, "lower the order"),
        (([0, 1, 2, 3, 4], [1] * 5, "AAABB"), {"degree": 4}, TooFewSamplesError, "5 readings"),
        (([0, 1, 1], [1, 2, 3]), {}, InvalidSamplesError, "increasing"),
        (([0, 1, 2], [1, 2]), {}, InvalidSamplesError, "one reading"),
        (([0, 1, 2], [1, 2, np.inf]), {}, InvalidSamplesError, "infinite"),
        (([0, 1, 2], [1, 2, 3]), {"degree": 9}, DataError, "0 to 8"),
        (([0, 1, 2], [1, 2, 3]), {"n_pieces": 0}, DataError, "whole number from 1"),
        (([0, 1, 2], [1, 2, 3]), {"reference": 7.0}, DataError, "outside"),
        (([0, 1, 2], [1, 2, 3]), {"sd": -1.0}, DataError, "sd must"),
        (([0, 1, 2], [1, 2, 3]), {"sd": "1 nm"}, DataError, "sd must be a number"),
        (([0, 1, 2], [1, 2, 3]), {"degree": "2"}, DataError, "whole number"),
        (([0, 1, 2], [1, 2, 3]), {"degree": None}, DataError, "whole number"),
        (([0, 1, 2], [1, 2, 3]), {"n_pieces": "2"}, DataError, "whole number"),
        (
            ([0, 1, 2], [1, 2, 3]),
            {"reference": "start"},
            DataError,
            "reference 'start' is not a number",
        ),
        (([0, 1, 2], ["a", "b", "c"]), {}, InvalidSamplesError, "numbers"),
        (([0, 1, 2], [[1, 2], [1], [1, 2]]), {}, InvalidSamplesError, "one shape"),
        (([0, 1, 2], [1, 2, 3], 7), {}, InvalidSamplesError, "labels"),
        (([0, 1, 2], [1, 2, 3], [["a"], ["a"], ["b"]]), {}, InvalidSamplesError, "labels"),
    ],
)
def test_bad_joint_fits_are_refused(arguments, options, error, match):
    with pytest.raises(error, match=match):
        joint_drift(*arguments, **options)


def test_confounded_order_is_not_separable():
    """With no time between the readings of one object, its drift cannot be distinguished from the other."""
    with pytest.raises(NotSeparableError, match="A-B-B-A"):
        joint_drift([0.0, 1e-9, 1.0, 1.0 + 1e-9], [0.0, 1e-12, 1.0, 1.0], "AABB")
    with pytest.raises(DataError, match="labels are"):
        joint_drift(np.arange(12.0), np.arange(12.0)).difference("A", "B")


# --- ranges --------------------------------------------------------------------------------------


def drifting(rng=None):
    t = np.arange(0.0, 4 * 3600.0 + 1, 60.0)
    x = 4 * UM * (1 - np.exp(-t / 3000))
    z = -3 * UM * np.sin(2 * np.pi * t / 14400)
    if rng is not None:
        x, z = x + 5 * NM * rng.normal(size=t.size), z + 5 * NM * rng.normal(size=t.size)
    return t, {"EX0C": x, "EZ0C": z}


def test_ranges_are_largest_minus_smallest_in_each_window():
    t, channels = drifting()
    windows = [(0.0, 3600.0), (3600.0, 14400.0)]

    test = iso230_3_drift(t, channels, windows=windows, kind="spindle")

    for i, (a, b) in enumerate(windows):
        inside = [k for k in range(t.size) if a <= t[k] <= b]
        each = [max(z[k] for k in inside) - min(z[k] for k in inside) for z in channels.values()]
        for name, value in zip(channels, each, strict=True):
            assert test.ranges[name][i].value == pytest.approx(value, abs=1e-18)
        assert test.combined[i].value == pytest.approx(math.hypot(*each), abs=1e-18)
    assert test.ranges["EX0C"][0].value == pytest.approx(4 * UM * (1 - math.exp(-1.2)), abs=1e-15)
    assert list(test.to_frame()["channel"]) == ["EX0C", "EZ0C", "combined"] * 2


def test_worst_hour_equals_brute_force():
    rng = np.random.default_rng(6)
    t = np.cumsum(rng.uniform(20, 100, size=300))
    z = np.cumsum(rng.normal(size=300)) * NM
    z[rng.integers(0, 300, size=20)] = np.nan

    test = iso230_3_drift(t, {"EX0C": z}, span=3600.0)

    brute = max(
        abs(z[i] - z[j])
        for i in range(300)
        for j in range(i)
        if t[i] - t[j] <= 3600.0 and not np.isnan(z[i] + z[j])
    )
    assert test.worst["EX0C"].value == pytest.approx(brute, abs=1e-18)
    assert any("not measured" in m for m in test.messages)


def test_uncertainty_of_a_range():
    """Two readings make the range of a steep drift: sd sqrt2; noise from second differences."""
    rng = np.random.default_rng(7)
    values, stated = [], []
    for _ in range(500):
        t = np.arange(0.0, 600.0, 10.0)
        z = 1 * UM * t / 600 + 2 * NM * rng.normal(size=60)
        q = iso230_3_drift(t, {"EX0C": z}).ranges["EX0C"][0]
        values.append(q.value)
        stated.append(q.u)

    assert np.mean(stated) == pytest.approx(2 * NM * 2**0.5, abs=0.05 * NM)
    assert np.std(values) == pytest.approx(2 * NM * 2**0.5, abs=0.35 * NM)  # 3.8 sd of 500


def test_angles_are_kept_apart_and_recordings_read():
    t, channels = drifting()
    recording = Recording(t, {**channels, "EAC": 50 * channels["EX0C"]})

    test = iso230_3_drift(recording, angular=("EAC",))
    chosen = iso230_3_drift(recording, ["EX0C"])

    assert test.ranges["EAC"][0].unit == "rad"
    wanted = math.hypot(test.ranges["EX0C"][0].value, test.ranges["EZ0C"][0].value)
    assert test.combined[0].value == pytest.approx(wanted, abs=1e-18)
    assert list(chosen.ranges) == ["EX0C"]


def test_noise_that_makes_a_range_is_said():
    rng = np.random.default_rng(8)
    t = np.arange(1000.0)

    said = iso230_3_drift(t, {"EX0C": NM * rng.normal(size=1000)}).messages

    assert any("noise widens the range" in m for m in said)
    assert not any("noise" in m for m in iso230_3_drift(*drifting()).messages)


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"kind": "etve"}, DataError, "kind is one of"),
        ({"windows": [(60.0, 0.0)]}, InvalidSamplesError, "window"),
        ({"windows": [(1e9, 2e9)]}, InvalidSamplesError, "times are seconds"),
        ({"windows": []}, DataError, "empty"),
        ({"windows": [(0.0, 30.0)]}, TooFewSamplesError, "needs 2"),
        ({"span": 1e9}, DataError, "span"),
        ({"sd": -1.0}, DataError, "sd must"),
        ({"sd": "1 V"}, DataError, "a length is needed"),
        ({"span": "1 mm"}, DataError, "a time is needed"),
        ({"windows": [0.0, 60.0]}, InvalidSamplesError, "pairs"),
        ({"angular": ("EAC",)}, DataError, "angular names"),
        ({"channels": {}}, DataError, "no channel"),
        ({"channels": [1.0, 2.0]}, DataError, "mapping"),
        ({"channels": {"x": [1.0]}}, InvalidSamplesError, "has 1 reading"),
    ],
)
def test_bad_drift_tests_are_refused(change, error, match):
    t, channels = drifting()
    options = {"channels": channels, **change}

    with pytest.raises(error, match=match):
        iso230_3_drift(t, options.pop("channels"), **options)


def test_readings_in_um_passed_as_m_are_said():
    t, channels = drifting()
    wrong = {name: z / UM for name, z in channels.items()}

    said = iso230_3_drift(t, wrong).messages

    assert sum("are the readings in m" in m for m in said) == 2
    assert not any("are the readings" in m for m in iso230_3_drift(t, channels).messages)
    tilted = iso230_3_drift(t, {"EAC": 5e3 * channels["EX0C"]}, angular=("EAC",))
    assert any("are the readings in rad" in m for m in tilted.messages)


def test_masked_channel_is_not_measured():
    t, channels = drifting()
    spiked = channels["EX0C"].copy()
    spiked[7] = 1.0

    test = iso230_3_drift(t, {"EX0C": np.ma.masked_greater(spiked, 0.5)})

    assert test.ranges["EX0C"][0].value < 5 * UM
    assert any("1 of" in m for m in test.messages)


# --- Allan deviation -----------------------------------------------------------------------------


def test_allan_deviation_of_noise_and_of_drift():
    rng = np.random.default_rng(9)
    t = 0.5 * np.arange(20000)

    tau, dev, u = allan_deviation(t, rng.normal(size=20000))
    _, ramp, _ = allan_deviation(t, 0.1 * t)

    early = tau < 50
    assert np.all(np.abs(dev - np.sqrt(0.5 / tau))[early] < 5 * u[early])
    np.testing.assert_allclose(ramp, 0.1 * tau / 2**0.5, atol=1e-9, rtol=0)


def test_allan_deviation_equals_its_definition():
    rng = np.random.default_rng(10)
    z = np.cumsum(rng.normal(size=60))
    tau, dev, _ = allan_deviation(np.arange(60.0), z, n_times=5)

    for k, value in zip(tau.astype(int), dev, strict=True):
        pairs = [z[i + k : i + 2 * k].mean() - z[i : i + k].mean() for i in range(60 - 2 * k + 1)]
        assert value == pytest.approx(math.sqrt(np.mean(np.square(pairs)) / 2), abs=1e-12)


@pytest.mark.parametrize(
    ("t", "z", "error", "match"),
    [
        ([0, 1, 2], [0, 1, 2], TooFewSamplesError, "needs 4"),
        ([0, 1, 2, 4], [0, 1, 2, 3], InvalidSamplesError, "equally spaced"),
        ([0, 1, 2, 3], [0, 1, np.nan, 3], InvalidSamplesError, "NaN"),
        ([0, 1, 2, 3], [0, 1, 2], InvalidSamplesError, "4 times"),
    ],
)
def test_bad_records_have_no_allan_deviation(t, z, error, match):
    with pytest.raises(error, match=match):
        allan_deviation(t, z)


# --- results as values ---------------------------------------------------------------------------


def results():
    t, channels = drifting(np.random.default_rng(0))
    channels["EX0C"][5] = np.nan
    return {
        "ranges": iso230_3_drift(t, channels),
        "abba": abba([[1.0, np.nan], [0, 0], [0, 0], [1, 1]]),
        "joint": joint_drift(np.arange(5.0), [1.0, 2, np.nan, 1, 2], "ABBAB"),
    }


def through_pickle(result):
    return pickle.loads(pickle.dumps(result))  # noqa: S301 - bytes of its own


@pytest.mark.parametrize("name", ["ranges", "abba", "joint"])
@pytest.mark.parametrize("how", [copy.deepcopy, through_pickle])
def test_results_survive_copies_and_give_json(name, how):
    result = results()[name]

    again = how(result)
    text = json.dumps(result.to_dict(), allow_nan=False)

    assert type(again) is type(result)
    assert json.dumps(again.to_dict(), allow_nan=False) == text
    assert again.audit == result.audit
    with pytest.raises(TypeError):
        again.audit["new"] = 1


def test_dictionary_of_each_holds_its_numbers():
    found = {name: r.to_dict() for name, r in results().items()}

    assert found["abba"]["difference"] == [pytest.approx(1.0, abs=1e-15), None]  # a sum of four
    assert set(found["joint"]["values"]) == {"A", "B"}
    assert found["ranges"]["ranges"]["EZ0C"][0]["value"] == pytest.approx(6 * UM, abs=0.1 * UM)
    assert "t" not in found["ranges"]  # the record itself is not copied

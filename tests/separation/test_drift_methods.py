"""A-B-B-A and the joint drift fit under the contract."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.core.options import options_of
from metrosep.separation.contract import Separation
from metrosep.separation.drift.alternation import AbbaDrift, abba
from metrosep.separation.drift.drift import DriftFit
from metrosep.separation.runs.joint_method import joint_drift

N = 15
"""Points of a profile; each drifts by itself."""

SAME = 1e-20
"""m; the class and the function do the same sums."""


class TestOneSequence(SeparationContract):
    takes_repeats = False
    order, n_sequences, t = "ABBA", 1, None

    def method(self):
        return AbbaDrift(self.n_sequences, self.order, self.t)

    def truth(self, rng):
        return {"difference": 5e-6 * rng.standard_normal(N)}

    def errors(self, rng):
        return {"drift_rate": 1e-7 * rng.standard_normal(N)}

    def readings(self, truth, errors):
        """``a`` and ``b`` may be given instead of their difference: then with their level."""
        times = np.arange(4.0 * self.n_sequences) if self.t is None else np.array(self.t)
        a = truth.get("a", truth.get("difference", np.zeros(N)) / 2)
        b = truth.get("b", -truth.get("difference", np.zeros(N)) / 2)
        out = []
        for i, now in enumerate(times):
            which = a if self.order[i % 4] == "A" else b
            moved = errors.get("drift_rate", np.zeros(N)) * (now - times.mean())
            out.append(
                which + moved + errors.get("in_step", np.zeros(N)) * (-1) ** (i % 4 in (1, 2))
            )
        return np.array(out)

    def invisible(self, rng):
        step = 1e-6 * rng.standard_normal(N)
        sign = 1.0 if self.order == "ABBA" else -1.0
        yield {"difference": -2 * sign * step}, {"in_step": step}

    def test_levels_do_not_matter_and_stay(self):
        rng, _, errors, _ = self.draw(20)
        a, b = 1e-3 * rng.standard_normal((2, N))
        readings = self.readings({"a": a, "b": b}, errors)
        found = self.method().separate(readings)
        np.testing.assert_allclose(found.difference, a - b, rtol=0.0, atol=1e-17)
        left = self.method().correct(readings)
        np.testing.assert_allclose(left, self.readings({"a": a, "b": b}, {}), rtol=0, atol=1e-17)


class TestSequences(TestOneSequence):
    has_redundancy = True
    order, n_sequences = "BAAB", 5


class TestUnequalTimes(TestSequences):
    n_sequences = 3
    t = (0.0, 10.0, 21.0, 30.0, 55.0, 64.0, 73.0, 82.0, 100.0, 109.0, 122.0, 130.0)


def test_abba_gives_what_the_function_gives_with_gaps():
    rng = np.random.default_rng(3)
    readings = 1e-6 * rng.standard_normal((12, N))
    readings[5, 4] = np.nan
    found = AbbaDrift(3).separate(readings)
    same = abba(readings)
    np.testing.assert_allclose(found.difference, same.difference, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.u["difference"], same.u, rtol=0.0, atol=SAME)
    stated = AbbaDrift(3).separate(readings, u_reading=1e-9)
    assert stated.u["difference"][4] == pytest.approx(1e-9 / np.sqrt(2), abs=SAME)
    assert stated.u["drift_rate"][0] == pytest.approx(1e-9 / np.sqrt(15), abs=SAME)


def test_curved_drift_reaches_the_difference_as_stated():
    t = np.arange(4.0)
    found = AbbaDrift().separate((3e-9 * t**2)[:, None])
    assert float(found.difference[0]) == pytest.approx(
        3e-9 * found.audit["quadratic_gain"], abs=SAME
    )
    assert any("higher degree" in str(item) for item in found.null_space)


LABELS = tuple("ABCCBAABC")
TIMES = (0.0, 1.0, 2.5, 3.0, 4.5, 6.0, 6.5, 8.0, 9.0)


class TestDriftFit(SeparationContract):
    takes_repeats = False
    has_redundancy = True
    degree, pieces = 2, None

    def method(self):
        return DriftFit(TIMES, LABELS, degree=self.degree, n_pieces=self.pieces)

    def truth(self, rng):
        return {"values": 5e-6 * rng.standard_normal((3, N))}

    def errors(self, rng):
        a, b = 1e-7 * rng.standard_normal((2, N))
        return {"drift": np.array([a * t + b * t**2 / 9 for t in TIMES])}

    def readings(self, truth, errors):
        out = np.zeros((len(TIMES), N))
        for i, label in enumerate(LABELS):
            out[i] += truth.get("values", np.zeros((3, N)))["ABC".index(label)]
            out[i] += errors.get("drift", np.zeros((len(TIMES), N)))[i]
        return out

    def invisible(self, rng):
        level = 1e-6 * rng.standard_normal(N)
        yield {"values": np.tile(-level, (3, 1))}, {"drift": np.tile(level, (len(TIMES), 1))}
        each = 1e-6 * rng.standard_normal((3, N))
        follows = np.array([each["ABC".index(label)] for label in LABELS])
        yield {"values": -each}, {"drift": follows}


class TestSplineDrift(TestDriftFit):
    pieces = 1


class TestNoSpareReading(TestDriftFit):
    """As many unknowns as readings."""

    has_redundancy = False
    degree = 6


def test_drift_fit_gives_what_the_function_gives_with_gaps_and_maps():
    rng = np.random.default_rng(5)
    readings = 1e-6 * rng.standard_normal((len(TIMES), 3, 4))
    readings[2, 1, 1] = np.nan
    found = DriftFit(TIMES, LABELS, reference=4.0).separate(readings)
    same = joint_drift(TIMES, readings, LABELS, reference=4.0)
    np.testing.assert_allclose(found.values, same.values, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.u["drift"], same.u_drift, rtol=0.0, atol=SAME)
    left = DriftFit(TIMES, LABELS, reference=4.0).correct(readings)
    np.testing.assert_allclose(left, readings - same.drift, rtol=0.0, atol=SAME)


def test_a_coordinate_in_seconds_bears_seconds_in_the_table():
    flat = DriftFit(TIMES, LABELS).separate(np.zeros((len(TIMES), 1)), u_reading=1e-9)
    assert flat.drift.shape == (len(TIMES), 1)
    curve = Separation("drift", {"drift": TIMES}, {"drift": TIMES}, {"drift": "m"}, {"time": TIMES}, ())  # fmt: skip
    assert list(curve.to_frame().columns) == ["time_s", "drift_m", "u_drift_m"]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: AbbaDrift(0), "n_sequences"),
        (lambda: AbbaDrift(1, "AABB"), "order"),
        (lambda: AbbaDrift(2, t=(0.0, 1.0, 2.0, 3.0)), "t has shape"),
        (lambda: AbbaDrift().separate(np.zeros((8, 3))), "1 sequences hold 4"),
        (
            lambda: AbbaDrift().simulate({"difference": [1.0]}, {"drift_rate": [1.0, 2.0]}),
            "differ in shape",
        ),
        (lambda: AbbaDrift().separate(np.zeros((4, 3)), u_reading=np.inf), "u_reading"),
        (lambda: DriftFit((0.0, 1.0), tuple("AB")), "readings for"),
        (lambda: DriftFit(TIMES, LABELS, degree=9), "degree"),
        (lambda: DriftFit(TIMES, LABELS[:4]), "label"),
        (
            lambda: DriftFit(TIMES, LABELS).simulate({"values": np.zeros((2, 4))}, {}),
            "must have the shape",
        ),
        (lambda: DriftFit(TIMES, LABELS).separate(np.zeros((4, 3))), "9 times"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()


def test_pieces_are_those_of_a_cubic_spline_as_the_help_says():
    assert "cubic spline" in options_of(DriftFit)["n_pieces"].help
    times = np.linspace(0.0, 10.0, 24)
    bent = 1e-9 * times**3
    labels = tuple("AB" * 12)

    def left(**how):
        return np.abs(
            DriftFit(tuple(times), labels, **how).separate(bent[:, None]).drift[:, 0] - bent
        )

    assert left(n_pieces=1).max() < 1e-18  # one piece of a broken line leaves 0.4 um
    assert left(degree=1).max() > 1e-7


def test_noise_may_be_stated_with_its_unit():
    readings = np.linspace(0.0, 1e-6, len(TIMES))[:, None]
    stated = DriftFit(TIMES, LABELS).separate(readings, u_reading="2 nm")
    same = DriftFit(TIMES, LABELS).separate(readings, u_reading=2e-9)
    np.testing.assert_array_equal(stated.u["values"], same.u["values"])


def test_tables_of_a_result_cannot_be_written_over():
    found = abba(np.zeros((4, 3)))
    with pytest.raises(TypeError):
        found.audit["new"] = 1.0

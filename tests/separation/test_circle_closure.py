"""Circle closure: readings written face by face; the closed form of the full design."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation.circles.circle_closure import CircleClosure, closure

N = 12


def read(faces, table, positions, zero=0.0):
    """Comparator readings one by one: the face that stands at index j, minus the table there."""
    n = len(faces)
    return np.array(
        [[faces[(j + p) % n] - table[j] + zero * p for j in range(n)] for p in positions]
    )


def centred(rng, n=N):
    values = rng.standard_normal(n) * 1e-6
    return values - values.mean()


class _Closure(SeparationContract):
    takes_repeats = False
    has_redundancy = True
    positions = tuple(range(N))

    def method(self):
        return CircleClosure(N, self.positions)

    def truth(self, rng):
        return {"artefact": centred(rng)}

    def errors(self, rng):
        return {"machine": centred(rng)}

    def readings(self, truth, errors):
        zero = np.zeros(N)
        return read(truth.get("artefact", zero), errors.get("machine", zero), self.positions)

    def invisible(self, rng):
        yield {"artefact": np.full(N, 2e-6)}, {"machine": np.full(N, 2e-6)}


class TestFullCrossCalibration(_Closure):
    pass


class TestPartialDesign(_Closure):
    positions = (0, 1, 5, 9)


class TestDesignWithHiddenHarmonic(_Closure):
    """Positions 0, 4, 8 of 12: k = 3 and 6 show alike."""

    positions = (0, 4, 8)

    def truth(self, rng):
        return {"artefact": without(centred(rng), (3, 6))}

    def errors(self, rng):
        return {"machine": without(centred(rng), (3, 6))}

    def invisible(self, rng):
        wave = 1e-6 * np.cos(2 * math.pi * 3 * np.arange(N) / N + 0.4)
        yield {"artefact": wave}, {"machine": wave}
        flip = 1e-6 * (-1.0) ** np.arange(N)
        yield {"artefact": flip}, {"machine": flip}


def without(values, ks):
    n = values.size
    j = np.arange(n)
    out = values.copy()
    for k in ks:
        for basis in (np.cos(2 * math.pi * k * j / n), np.sin(2 * math.pi * k * j / n)):
            if (basis**2).sum() > 1e-9:
                out = out - basis * (values * basis).sum() / (basis**2).sum()
    return out


def test_asymmetric_polygon_and_table_come_back_with_their_signs():
    faces, table = np.zeros(6), np.zeros(6)
    faces[1], table[4] = 6e-6, 3e-6

    found = closure(read(faces, table, range(6), zero=1e-4))

    np.testing.assert_allclose(found.artefact, faces - 1e-6, rtol=0, atol=1e-18)
    np.testing.assert_allclose(found.machine, table - 0.5e-6, rtol=0, atol=1e-18)
    added = closure(read(faces, -table, range(6)), table_sign=1)
    np.testing.assert_allclose(added.machine, table - 0.5e-6, rtol=0, atol=1e-18)


def test_pitches_sum_to_the_full_circle():
    rng = np.random.default_rng(0)
    found = closure(read(centred(rng), centred(rng), range(N)))

    pitch = 2 * math.pi / N + np.diff(np.append(found.artefact, found.artefact[0]))

    assert pitch.sum() == pytest.approx(2 * math.pi, abs=1e-14)


def test_full_design_is_the_mean_over_diagonals():
    """Closed form: a_i = mean over set-ups of what face i reads, row means taken off."""
    m = np.random.default_rng(1).standard_normal((N, N)) * 1e-6
    rows = m - m.mean(axis=1, keepdims=True)
    faces = [np.mean([rows[p, (i - p) % N] for p in range(N)]) for i in range(N)]

    found = closure(m, u_reading=1e-7)

    np.testing.assert_allclose(found.artefact, faces, rtol=0, atol=1e-18)
    np.testing.assert_allclose(found.machine, -rows.mean(axis=0), rtol=0, atol=1e-18)
    np.testing.assert_allclose(found.u["artefact"], 1e-7 * math.sqrt(N - 1) / N, rtol=1e-9, atol=0)


def test_position_sets_with_a_common_factor_name_what_they_hide():
    rng = np.random.default_rng(2)
    faces, table = centred(rng), centred(rng)

    found = closure(read(faces, table, (0, 4, 8)), positions=(0, 4, 8))

    assert found.suppressed == [3, 6]
    np.testing.assert_allclose(found.artefact, without(faces, (3, 6)), rtol=0, atol=1e-17)
    assert any("k=3, 6" in text for text in found.messages)


def test_missing_readings_cost_precision_not_truth():
    rng = np.random.default_rng(3)
    faces, table = centred(rng), centred(rng)
    m = read(faces, table, range(N))
    m[rng.random((N, N)) < 0.3] = np.nan

    found = closure(m, u_reading=1e-8)

    np.testing.assert_allclose(found.artefact, faces, rtol=0, atol=1e-17)
    assert (found.u["artefact"] > 1e-8 * math.sqrt(N - 1) / N).all()
    assert any("not measured" in text for text in found.messages)
    assert np.isnan(CircleClosure(N).correct(m)[np.isnan(m)]).all()


def test_two_setups_have_no_redundancy_to_spare_and_say_so():
    """Three divisions, two set-ups: 6 readings, 3 + 3 + 2 unknowns less 2 gauges."""
    found = closure(read(centred(np.random.default_rng(0), 3), np.zeros(3), (0, 1)))

    assert math.isnan(found.noise.value)
    assert np.isnan(found.u["artefact"]).all()
    assert any("u_reading" in text for text in found.messages)


@pytest.mark.parametrize(
    ("m", "options", "error", "words"),
    [
        (np.zeros((4, 4)), {"positions": (0, 1)}, DataError, "do not fit"),
        (np.zeros((2, 4)), {"positions": (2, 6)}, NotSeparableError, "same position"),
        (np.zeros((1, 4)), {}, TooFewSamplesError, "2 set-ups"),
        (np.zeros((2, 2)), {}, TooFewSamplesError, "3 divisions"),
        (np.zeros(4), {}, InvalidSamplesError, "shape"),
        (np.eye(4), {}, UnitError, "deg2rad"),
        (np.zeros((2, 4)), {"positions": (0, 0.5)}, DataError, "whole"),
        (np.zeros((2, 4)), {"table_sign": 0}, DataError, "table_sign"),
        (np.zeros((2, 4)), {"u_reading": -1}, DataError, "u_reading"),
    ],
)
def test_impossible_requests_are_refused(m, options, error, words):
    with pytest.raises(error, match=words):
        closure(m, **options)


def test_face_that_was_never_read_is_refused():
    m = np.zeros((3, 6))
    for p in range(3):
        m[p, (2 - p) % 6] = np.nan

    with pytest.raises(NotSeparableError, match="missing"):
        closure(m)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"u_reading": "small"}, "u_reading"),
        ({"u_reading": True}, "u_reading must be a number in rad"),
        ({"u_reading": 5.0}, "in rad"),
        ({"positions": [0, math.inf, 2]}, "positions"),
    ],
)
def test_what_is_no_number_is_refused_in_words(options, words):
    with pytest.raises(DataError, match=words):
        closure(np.zeros((3, 6)), **options)


def test_complex_readings_and_divisions_that_are_no_number_are_refused():
    with pytest.raises(InvalidSamplesError, match="complex"):
        closure(np.zeros((3, 6)) * 1j)
    for n in (math.nan, math.inf, "6", 5.5):
        with pytest.raises(DataError, match="divisions"):
            CircleClosure(n)


def test_null_space_calls_the_common_angle_offset():
    assert CircleClosure(12).null_space()[0].indices == ("offset",)

"""Squareness from diagonals under the contract; lengths are distances of sheared corners."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.planes.diagonals import Diagonals
from metrosep.separation.planes.squareness import squareness_from_diagonals

BODY = ("ppp", "npp", "pnp", "nnp")
FACES = ("pp0", "np0", "p0p", "n0p", "0pp", "0np")
SIZE = (0.5, 0.4, 0.3)
ANGLES, SCALES = ("xy", "xz", "yz"), ("scale_x", "scale_y", "scale_z")
M = 4

STEP = 1e-4
"""Relative step of the central difference: its own error is of the third order, 1e-8 of the result."""


def distance(name, parts):
    """Length of a diagonal of axes that lean towards each other, from coordinates of its ends."""
    legs = np.array([{"p": 1.0, "n": -1.0, "0": 0.0}[c] for c in name]) * SIZE
    e = np.diag([1.0 + parts.get(s, 0.0) for s in SCALES])
    e[0, 1], e[0, 2], e[1, 2] = (parts.get(a, 0.0) for a in ANGLES)
    return np.linalg.norm(e @ legs) * (1.0 + parts.get("instrument", 0.0))


class TestBodyDiagonals(SeparationContract):
    takes_repeats = False
    has_redundancy = True
    trials = 500
    names = BODY
    exact = 1e-7
    """STEP: the simulator differentiates numerically."""

    def method(self):
        return Diagonals(self.names, SIZE)

    def truth(self, rng):
        return {}

    def errors(self, rng):
        return dict(zip(ANGLES, 2e-6 * rng.standard_normal(3), strict=True))

    def readings(self, truth, errors):
        """First order, as the method: the slope of the distance by a central difference."""
        parts = {**truth, **errors}
        size = max([abs(v) for v in parts.values()], default=0.0) or 1.0
        step = {k: v / size * STEP for k, v in parts.items()}
        back = {k: -v for k, v in step.items()}
        out = np.array([distance(n, step) - distance(n, back) for n in self.names])
        return np.repeat(out[:, None] * size / (2 * STEP), M, axis=1)

    def invisible(self, rng):
        g = 5e-6 * rng.standard_normal()
        yield {"instrument": g}, dict.fromkeys(SCALES, -g)
        a, b = 5e-6 * rng.standard_normal(2)
        c = -(a * SIZE[0] ** 2 + b * SIZE[1] ** 2) / SIZE[2] ** 2
        if self.names == BODY:
            yield {}, {"scale_x": a, "scale_y": b, "scale_z": c}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """The method gives one length; to the third order of the numerical slope."""
        rng, _, errors, _ = self.draw(seed)
        errors.update(zip(SCALES, 2e-6 * rng.standard_normal(3), strict=True))
        truth = {"instrument": 1e-6}
        simulated = self.method().simulate(truth, errors)
        np.testing.assert_allclose(
            np.repeat(simulated, M, axis=1), self.readings(truth, errors), rtol=0.0, atol=1e-13
        )

    def test_null_space_changes_no_part_that_is_given(self):
        """As in the suite, with the error of the numerical slope."""
        rng, _, _, readings = self.draw(8)
        plain = self.method().separate(readings)
        for truth, errors in self.invisible(rng):
            hidden = self.readings(truth, errors)
            assert np.max(np.abs(hidden)) < 1e-7 * 5e-6
            seen = self.method().separate(readings + hidden)
            for name, values in plain.parts.items():
                np.testing.assert_allclose(seen.parts[name], values, rtol=0.0, atol=1e-11)
            assert any(item.part in {*truth, *errors} for item in plain.null_space)

    def test_what_is_not_seen_is_nan(self):
        *_, readings = self.draw(9)
        found = self.method().separate(readings)
        named = {item.part for item in found.null_space}
        for name, value in found.parts.items():
            if np.isnan(value):
                assert name in named
        assert np.isnan(found.instrument)
        assert np.isnan(found.scale_x) == (self.names == BODY)


class TestBodyAndFaceDiagonals(TestBodyDiagonals):
    names = (*BODY, *FACES)

    def errors(self, rng):
        return dict(zip((*ANGLES, *SCALES), 2e-6 * rng.standard_normal(6), strict=True))


def test_the_class_gives_what_the_function_gives():
    rng = np.random.default_rng(1)
    lengths = 1e-6 * rng.standard_normal((4, 3))
    lengths[2, 1] = np.nan
    found = Diagonals(BODY, SIZE).separate(lengths, u_reading=1e-7)
    u = dict(zip(BODY, 1e-7 / np.sqrt([3, 3, 2, 3]), strict=True))
    mean = dict(zip(BODY, np.nanmean(lengths, axis=1), strict=True))
    same = squareness_from_diagonals(mean, SIZE, u=u)
    for pair in ANGLES:
        assert float(found.parts[pair]) == pytest.approx(same.angles[pair].value, abs=1e-18)
        assert float(found.u[pair]) == pytest.approx(same.angles[pair].u, abs=1e-18)


def test_uncertainty_of_body_diagonals_is_the_closed_form():
    """a_xy = D / (4 X Y) (ppp - npp - pnp + nnp): u = D s / (2 X Y)."""
    found = Diagonals(BODY, SIZE).separate(np.zeros((4, 1)), u_reading=1e-7)
    d = np.sqrt(sum(v**2 for v in SIZE))
    assert float(found.u["xy"]) == pytest.approx(d * 1e-7 / (2 * 0.5 * 0.4), abs=1e-16)
    assert float(found.u["yz"]) == pytest.approx(d * 1e-7 / (2 * 0.4 * 0.3), abs=1e-16)


def test_one_run_without_u_has_no_uncertainty():
    found = Diagonals(BODY, SIZE).separate(np.zeros((4, 1)))
    assert np.isnan(found.u["xy"])
    assert any("u_reading" in m for m in found.messages)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Diagonals("ppp", SIZE), "tuple"),
        (lambda: Diagonals(("ppp", "nnn"), SIZE), "twice"),
        (lambda: Diagonals(("ppp",), SIZE), "no squareness"),
        (lambda: Diagonals(BODY, (0.5, 0.4)), "size"),
        (lambda: Diagonals(BODY, SIZE).separate(np.ones((4, 1))), "1 %|um"),
        (lambda: Diagonals(BODY, SIZE).separate([[0.0], [0.0], [0.0], [np.nan]]), "nnp"),
        (lambda: Diagonals(BODY, SIZE).simulate({}, {"xy": [1e-6, 2e-6]}), "shape"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()

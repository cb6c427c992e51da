"""u of calibrated curves holds what the orders that were fitted leave out: corners, bumps, odd waves."""

import json

import numpy as np
import pytest

from metrosep.machine import Displacement, Nest, ReadingSet, calibrate, presets
from metrosep.machine._lack_of_fit import _Case, _Curves

REACH, NOISE = 0.4, 0.1e-6
PLACES = np.linspace(0.0, 1.0, 41)


def corner(t, at, sign):
    return 2e-6 * sign * np.maximum(t - at, 0.0)


def bump(t, at, sign):
    return 0.8e-6 * sign * (np.abs(t - at) < 0.03)


def wave(t, at, sign):
    return 0.5e-6 * sign * np.sin(2.0 * np.pi * 5.5 * t + 9.0 * at)


def calibrated(curve, seed, *, places=PLACES, degree=3, runs=2):
    """A laser along X, both ways; the truth is zero at home, X = 0."""
    rng = np.random.default_rng([seed, 21])
    t = np.concatenate([places[:: (-1) ** k] for k in range(runs)])
    laser = Displacement(direction=(1, 0, 0))
    q = {"X": REACH * t, "Y": 0.0, "Z": 0.0}
    line = ReadingSet(laser, q, curve(t) + NOISE * rng.normal(size=t.size), unknown=("offset",))
    return calibrate(presets("mill_xyz"), [line], terms=["EXX"], degrees=degree)


@pytest.mark.parametrize("shape", [corner, bump, wave])
def test_truth_is_within_3_u_whatever_the_orders_leave(shape):
    beyond = []
    for seed in range(6):
        at, sign = 0.2 + 0.1 * seed, (-1) ** seed

        def curve(t, at=at, sign=sign):
            return 1e-6 * t**2 - 0.4e-6 * t + shape(t, at, sign)

        term = calibrated(curve, seed).errors["EXX"]
        off = np.abs(term.evaluate(REACH * PLACES) - (curve(PLACES) - curve(np.zeros(1))))
        beyond.append(np.mean(off[1:] > 3.0 * term.sd(REACH * PLACES)[1:]))
    assert np.max(beyond) <= 0.05


def test_where_no_curve_is_left_out_u_is_that_of_the_readings():
    """Of least squares in closed form; half more, because a curve that is small cannot be seen."""
    ratios, inside = [], []
    t = np.concatenate([PLACES, PLACES[::-1]])
    X = np.column_stack([t, t**2, t**3, np.ones(t.size)])
    at = PLACES[1:, None] ** [1, 2, 3]
    C = np.linalg.inv(X.T @ X)[:3, :3]
    plain = NOISE * np.sqrt(np.einsum("ij,jk,ik->i", at, C, at))
    for seed in range(10):
        term = calibrated(lambda t: 1e-6 * t**2, seed).errors["EXX"]
        u = term.sd(REACH * PLACES[1:])
        ratios.append(np.mean(u / plain))
        inside.append(np.abs(term.evaluate(REACH * PLACES[1:]) - 1e-6 * PLACES[1:] ** 2) <= 2 * u)
    assert 1.0 < np.mean(ratios) < 1.7
    assert np.mean(inside) > 0.92


@pytest.mark.parametrize(("n", "student"), [(5, 4.527 / 2.0), (9, 2.517 / 2.0)])
def test_a_few_readings_of_one_pass_have_a_u(n, student):
    """No drift is told from a constant by so few; white noise is. Student's t of n - 3 degrees, from a table."""
    term = calibrated(lambda t: 1e-6 * t**2, 1, places=PLACES[:: 40 // (n - 1)], degree=2, runs=1)
    u = term.errors["EXX"].sd(REACH * np.array([0.5, 1.0]))
    assert np.all((u > 0.3 * student * NOISE) & (u < 3.0 * student * NOISE))


def line_of(y, **more):
    """The calibration of X by readings at even places, of order 3."""
    q = {"X": REACH * np.linspace(0.0, 1.0, y.size), "Y": 0.0, "Z": 0.0}
    line = ReadingSet(Displacement(direction=(1, 0, 0)), q, y, unknown=("offset",), **more)
    return calibrate(presets("mill_xyz"), [line], terms=["EXX"], degrees=3)


def few(seed, n=8):
    """Places, the error of X there, and its readings with white noise."""
    t = np.linspace(0.0, 1.0, n)
    e = 1e-6 * t**2 - 0.4e-6 * t
    return t, e, e + NOISE * np.random.default_rng([seed, 5]).normal(size=n)


def test_eight_readings_with_white_noise_are_all_used_and_their_u_holds():
    """4 unknowns: by refusing 3 of 8 the rest agreed by chance, and u was 240 times too small."""
    held, size = [], []
    for seed in range(40):
        t, e, y = few(seed)
        found = line_of(y)
        assert not any(found.refused.values()), seed
        u = found.errors["EXX"].sd(REACH * t)[1:]
        held.append(np.abs(found.errors["EXX"].evaluate(REACH * t) - e)[1:] < 2.0 * u)
        # the textbook: least squares, the scatter with n - 4 degrees, Student's t of them over 2
        A = np.vander(t, 4)
        of_b = np.linalg.inv(A.T @ A) * np.sum((y - A @ np.linalg.lstsq(A, y)[0]) ** 2) / 4.0
        D = A[1:] - A[0]
        size.append(u / (2.869 / 2.0 * np.sqrt(np.einsum("ij,jk,ik->i", D, of_b, D))))
    assert 0.90 < np.mean(held) < 0.995  # 95.45 % of 40 independent sets: +- 3.3 %
    # a part of the scatter may be an order above 3, which u then holds in place of noise
    assert np.min(size) > 0.7
    assert 0.9 < np.median(size) < 1.3


@pytest.mark.parametrize(("size", "refused"), [(20e-6, 1), (2e-7, 0)])
def test_a_gross_reading_of_eight_is_refused_and_two_sigma_is_not(size, refused):
    for seed in range(3):
        _, _, y = few(seed)
        y[3] += size
        found = line_of(y)
        assert sum(found.refused.values()) == refused
        assert np.isnan(found.residuals["displacement"][3]) == bool(refused)


def test_a_stated_noise_judges_few_readings_by_itself():
    """Readings within 4 stated sigma are used, one of 15 is not, and u needs no Student's t."""
    t, _, y = few(74)
    found = line_of(y, u=NOISE)
    assert not any(found.refused.values())
    y[3] += 15.0 * NOISE
    assert sum(line_of(y, u=NOISE).refused.values()) == 1
    A = np.vander(t, 4)
    D = A[-1] - A[0]
    u = found.errors["EXX"].sd(REACH)
    assert u < 1.3 * NOISE * np.sqrt(D @ np.linalg.inv(A.T @ A) @ D)


def test_u_is_larger_far_from_the_places():
    """A wave is left out: between places that are 100 mm apart it may stand anywhere."""
    places = np.r_[np.linspace(0.0, 0.4, 33), np.linspace(0.65, 1.0, 29)]
    term = calibrated(lambda t: wave(t, 0.3, 1), 1, places=places).errors["EXX"]
    u = term.sd(REACH * np.array([0.206, 0.525, 0.806]))
    assert u[1] > 1.5 * max(u[0], u[2])


def test_past_the_ends_u_holds_a_curve_that_goes_on():
    """Read to 80 % of a travel with a wave; over 8 % more it runs on as it was."""
    inside, size = [], []
    for seed in range(8):
        at, sign = 0.15 * seed, (-1) ** seed

        def curve(t, at=at, sign=sign):
            return 1e-6 * t**2 + wave(t, at, sign)

        term = calibrated(curve, seed, places=0.8 * PLACES).errors["EXX"]
        x = np.linspace(0.8, 0.864, 9)[1:]
        off = term.evaluate(REACH * x) - (curve(x) - curve(np.zeros(1)))
        inside.append(np.abs(off) <= 2.0 * term.sd(REACH * x))
        size.append(term.sd(REACH * x))
    assert np.mean(inside) > 0.9
    assert np.median(size, axis=0)[-1] > 1.2 * np.median(size, axis=0)[0]
    assert np.median(size) < 3e-6  # of 0.5 um: not without limit


def test_what_is_stored_of_a_curve_is_the_curve():
    """The sum over the orders in the document, by numpy, is what `evaluate` returns, orders beyond the fit too."""
    found = calibrated(lambda t: wave(t, 0.3, 1), 2)
    term = found.to_dict()["terms"]["EXX"]
    order = np.array([int(name.split()[1]) for name in term["orders"]])
    assert term["fitted"] == 3
    assert order.size > 20
    c = np.zeros(order.max() + 1)
    c[order] = term["values"]
    t = np.linspace(0.0, 1.0, 33)
    P = np.polynomial.Legendre(c, domain=(0.0, 1.0))
    assert found.errors["EXX"].evaluate(REACH * t) == pytest.approx(P(t) - P(0.0), abs=1e-15)
    assert np.ptp(np.polynomial.Legendre(c[:4])(2.0 * t - 1.0)) < 0.5 * np.ptp(P(t))


def test_noise_has_a_drift_that_is_no_constant_where_the_readings_favour_one():
    """All drifts that could be told from a constant were dropped as unlikely: max() of nothing."""
    shift = np.array([[3e-6], [0.0]])
    cases = [
        _Case(
            base, 40.0, 40, 30.0 * np.eye(4), np.full(4, 5.0), np.full(4, 30.0), np.zeros((1, 4)),
            b, 0.0, False, shown, np.array([[7e-12]]),
        )
        for base, b, shown in zip((60.0, 0.0), shift, (True, False), strict=True)
    ]  # fmt: skip
    own = [np.array([0, 1]), np.array([2, 3])]
    mean, cov = _Curves(cases, [np.ones((3, 2))] * 2, own).moments()
    # both explain the same, so D = 0 leaves of the coefficient what the drift that is shown says
    assert mean[0] == pytest.approx(3e-6, abs=1e-15)
    assert 0.1 * 7e-12 < cov[0, 0] <= 7e-12  # the curve may take a part of the square 40 / 40


def from_document(term, x):
    """The curve of a stored term, by what the page says of the keys."""

    def plain(x):
        if term["basis"] == "fourier":
            return np.stack([getattr(np, n[:3])(int(n[3:]) * x) for n in term["orders"]], axis=1)
        t = (2.0 * x - term["low"] - term["high"]) / (term["high"] - term["low"])
        P = np.stack([np.polynomial.Legendre.basis(int(n[6:]))(t) for n in term["orders"]], axis=1)
        off = np.array(term.get("off", np.zeros((len(term["orders"]), 1))))
        return P - np.stack([x**0, np.cos(x), np.sin(x)], axis=1)[:, : off.shape[1]] @ off.T

    n, c = term["fitted"], np.array(term["values"])
    inside = x if term["basis"] == "fourier" else np.clip(x, term["low"], term["high"])
    at_home = plain(np.array([term["home"]])) @ c if "home" in term else 0.0
    return plain(x)[:, :n] @ c[:n] + plain(inside)[:, n:] @ c[n:] - at_home


def test_a_reader_of_the_document_has_the_curve_inside_and_past_its_ends():
    rng = np.random.default_rng(8)
    x = np.tile(np.linspace(0.05, 0.35, 41), 2)
    line = ReadingSet(
        Displacement(direction=(1, 0, 0)), {"X": x, "Y": 0.0, "Z": 0.0},
        wave(x / REACH, 0.3, 1) + NOISE * rng.normal(size=82), unknown=("offset",),
    )  # fmt: skip
    moved = calibrate(presets("mill_xyz"), [line], terms=["EXX"], degrees=3, home={"X": 0.1})
    five, found = presets("five_axis", pivot_height=0.08), [("EXX", moved)]
    for axis, low, high, term in (
        ("A", -95, 30, "EYA"),
        ("A", -95, 30, "EXA"),
        ("C", 0, 351, "EZC"),
    ):
        a = np.tile(np.radians(np.linspace(low, high, 40)), 2)
        q = dict.fromkeys("XYZAC", 0.0) | {axis: a}
        nest = ReadingSet(
            Nest(), q, 1e-6 * np.sin(9.0 * a)[:, None] + NOISE * rng.normal(size=(80, 3))
        )
        found.append((term, calibrate(five, [nest], terms=[term], degrees=4)))
    for name, calibration in found:
        term, curve = calibration.to_dict()["terms"][name], calibration.errors[name]
        term = json.loads(json.dumps(term, allow_nan=False))
        assert len(term["orders"]) > term["fitted"]
        low, high = term.get("low", 0.0), term.get("high", 6.0)
        assert term["position_unit"] == ("m" if name == "EXX" else "rad")
        at = np.linspace(low - 0.2 * (high - low), high + 0.2 * (high - low), 57)
        size = np.ptp(curve.evaluate(np.linspace(low, high, 57)))
        assert size > 0.3e-6
        assert from_document(term, at) == pytest.approx(curve.evaluate(at), abs=1e-9 * size)
    assert moved.to_dict()["terms"]["EXX"]["home"] == 0.1


def test_u_of_places_is_that_of_the_curve():
    found = calibrated(lambda t: corner(t, 0.6, 1), 3)
    x = REACH * np.array([0.3, 0.61, 0.97, 1.04])
    u = found.u_at({"X": x, "Y": 0.0, "Z": 0.0})[:, 0]
    assert u == pytest.approx(found.errors["EXX"].sd(x), abs=1e-15)


def test_a_degree_that_takes_all_places_leaves_nothing_to_judge():
    found = calibrated(lambda t: 1e-6 * t**2, 2, places=np.linspace(0.0, 1.0, 5), degree=4, runs=3)
    assert found.errors["EXX"].sd(REACH).item() < 3.0 * NOISE


def test_a_wave_that_two_axes_could_have_is_not_given_to_both():
    """Read along the diagonal of X and Y each of them alone explains it: the curves were off by as much, with u of 1 um."""
    along = np.linspace(0.0, 0.4, 41)
    places = np.concatenate([along, along[::-1], along])
    truth = 5e-6 * np.sin(2 * np.pi * places / 0.05)  # of X only
    noise = 0.1e-6 * np.random.default_rng(3).normal(size=(2, places.size))
    half = 2**-0.5
    sets = [
        ReadingSet(
            Displacement(direction=(half, half, 0.0)),
            {"X": places, "Y": places, "Z": 0.0},
            truth * half + noise[0],
            name="diagonal",
        ),
        ReadingSet(
            Displacement(direction=(1, 0, 0)),
            {"X": places, "Y": 0.1, "Z": 0.0},
            truth + noise[1],
            name="x",
        ),
    ]
    x = np.linspace(0.02, 0.38, 60)
    wave = 5e-6 * np.sin(2 * np.pi * x / 0.05)
    for some in (sets[:1], sets):
        found = calibrate(presets("mill_xyz"), some, terms=["EXX", "EYY"], degrees=3).fitted
        of_x, of_y = (found[name].evaluate(x) for name in ("EXX", "EYY"))
        assert -0.05 < (of_x + of_y) @ wave / (wave @ wave) < 1.05  # once at most
        assert abs(of_y @ wave / (wave @ wave)) < 0.6  # half of it, where only the sum is seen
        assert np.mean(np.abs(of_x - wave) < 3.0 * found["EXX"].sd(x)) > 0.95


def test_two_axes_that_both_go_on_are_both_found():
    """X by its own laser, Y only by a diagonal with it: Y takes what X leaves of the diagonal, and no more."""
    along = np.linspace(0.0, 0.4, 41)
    places = np.concatenate([along, along[::-1], along])
    half, inside, missed = 2**-0.5, [], []

    def truth(x, length, size):
        return size * np.sin(2 * np.pi * x / length)

    for seed in range(3):
        of = {"EXX": (0.05, 3e-6), "EYY": (0.063, -2e-6 - 0.5e-6 * seed)}
        noise = 0.1e-6 * np.random.default_rng([seed, 4]).normal(size=(2, places.size))
        x, y = (truth(places, *of[name]) for name in of)
        sets = [
            ReadingSet(
                Displacement(direction=(half, half, 0.0)),
                {"X": places, "Y": places, "Z": 0.0},
                (x + y) * half + noise[0],
                name="diagonal",
            ),
            ReadingSet(
                Displacement(direction=(1, 0, 0)),
                {"X": places, "Y": 0.0, "Z": 0.0},
                x + noise[1],
                name="x",
            ),
        ]
        found = calibrate(presets("mill_xyz"), sets, terms=[*of], degrees=3)
        for name, wave_of in of.items():
            off = found.errors[name].evaluate(along[1:]) - truth(along[1:], *wave_of)
            inside.append(np.abs(off) <= 2.0 * found.errors[name].sd(along[1:]))
            missed.append(np.sqrt(np.mean(off**2)) / abs(wave_of[1]))
    assert np.max(missed) < 0.1  # by the orders that are fitted alone 0.7
    assert np.mean(inside) > 0.9

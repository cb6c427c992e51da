"""Squareness and diagonals against a machine of homogeneous transforms written here."""

import copy
import itertools
import json
import math
import pickle

import numpy as np
import pytest

from metrosep.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation.planes.diagonals import iso230_6_diagonals
from metrosep.separation.planes.squareness import squareness_from_diagonals

UM, URAD, NRAD = 1e-6, 1e-6, 1e-9
SIZE = (0.5, 0.4, 0.3)
BODY = ("ppp", "npp", "pnp", "nnp")
FACES = ("pp0", "np0", "p0p", "n0p", "0pp", "0np")


def rotation(axis, angle):
    """Right-handed turn about an axis as a homogeneous matrix, exact."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(4)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def shift(axis, distance):
    matrix = np.eye(4)
    matrix[axis, 3] = distance
    return matrix


def machine(q, *, xy, xz, yz, scale=(0.0, 0.0, 0.0)):
    """Serial axes X, Y, Z; Y leans towards +X by xy, Z towards +X by xz and towards +Y by yz.

    A turn by -xy about z brings the y direction to (sin xy, cos xy, 0).
    """
    a, b, c = (v * (1.0 + e) for v, e in zip(q, scale, strict=True))
    stack = shift(0, a) @ rotation(2, -xy) @ shift(1, b) @ rotation(2, xy)
    stack = stack @ rotation(1, xz) @ rotation(0, -yz) @ shift(2, c)
    return stack[:3, 3]


def ends(name, size):
    """Start and end of a diagonal in axis coordinates; '0' stays at 0."""
    start = [0.0 if letter != "n" else v for letter, v in zip(name, size, strict=True)]
    stop = [v if letter == "p" else 0.0 for letter, v in zip(name, size, strict=True)]
    return np.array(start), np.array(stop)


def length_error(name, size, *, exact, **errors):
    start, stop = ends(name, size)
    nominal = float(np.linalg.norm(stop - start))
    moved = machine(stop, **errors) - machine(start, **errors)
    if exact:
        return float(np.linalg.norm(moved)) - nominal
    return float((moved - (stop - start)) @ (stop - start)) / nominal


def measured(names, size=SIZE, *, exact=False, **errors):
    return {n: length_error(n, size, exact=exact, **errors) for n in names}


ANGLES = {"xy": 21 * URAD, "xz": -13 * URAD, "yz": 34 * URAD}


def test_the_simulator_encloses_less_than_ninety_degrees():
    """The sign of the test itself: a positive xy brings +Y and +X together."""
    directions = [machine(q, **ANGLES) for q in np.eye(3)]
    between = {
        pair: math.acos(float(directions[i] @ directions[j]))
        for pair, (i, j) in {"xy": (0, 1), "xz": (0, 2)}.items()
    }

    assert math.pi / 2 - between["xy"] == pytest.approx(21 * URAD, abs=2 * NRAD)
    assert math.pi / 2 - between["xz"] == pytest.approx(-13 * URAD, abs=2 * NRAD)
    assert np.all(length_error("ppp", SIZE, exact=True, xy=1e-5, xz=0.0, yz=0.0) > 0)


@pytest.mark.parametrize("names", [BODY, FACES, BODY + FACES])
@pytest.mark.parametrize("size", [SIZE, (0.2, 1.0, 0.7)])
def test_injected_angles_come_back(names, size):
    """Goal S21: 1e-9 rad with the displacement along the nominal diagonal."""
    small = {k: v / 10 for k, v in ANGLES.items()}  # second order below 1e-11 rad

    found = squareness_from_diagonals(measured(names, size, **small), size)

    for pair, value in small.items():
        assert found.angles[pair].value == pytest.approx(value, abs=NRAD / 10)
    assert (found.a_xy, found.a_xz, found.a_yz) == tuple(q.value for q in found.angles.values())


@pytest.mark.parametrize("exact", [False, True])
def test_larger_angles_within_one_nanoradian_first_order(exact):
    found = squareness_from_diagonals(measured(BODY, exact=exact, **ANGLES), SIZE)

    for pair, value in ANGLES.items():
        assert found.angles[pair].value == pytest.approx(value, abs=3 * NRAD)


def test_closed_form_of_the_specification():
    rng = np.random.default_rng(0)
    dl = dict(zip(BODY, rng.normal(size=4) * UM, strict=True))
    d = math.sqrt(sum(v * v for v in SIZE))

    found = squareness_from_diagonals(dl, SIZE)

    wanted = d / (4 * 0.5 * 0.4) * (dl["ppp"] - dl["npp"] - dl["pnp"] + dl["nnp"])
    assert found.a_xy == pytest.approx(wanted, abs=1e-6 * NRAD)
    wanted = d / (4 * 0.5 * 0.3) * (dl["ppp"] - dl["npp"] + dl["pnp"] - dl["nnp"])
    assert found.a_xz == pytest.approx(wanted, abs=1e-6 * NRAD)
    wanted = d / (4 * 0.4 * 0.3) * (dl["ppp"] + dl["npp"] - dl["pnp"] - dl["nnp"])
    assert found.a_yz == pytest.approx(wanted, abs=1e-6 * NRAD)


def test_common_length_and_scale_errors_cancel_and_are_said():
    plain = squareness_from_diagonals(measured(BODY, **ANGLES), SIZE)
    scaled = squareness_from_diagonals(
        measured(BODY, **ANGLES, scale=(30e-6, -20e-6, 10e-6)), SIZE
    )
    longer = squareness_from_diagonals(
        {k: v + 5 * UM for k, v in measured(BODY, **ANGLES).items()}, SIZE
    )

    for pair in ANGLES:
        # products of scale and angle, 3e-5 x 3e-5, remain
        assert scaled.angles[pair].value == pytest.approx(plain.angles[pair].value, abs=3 * NRAD)
        assert longer.angles[pair].value == pytest.approx(
            plain.angles[pair].value, abs=1e-6 * NRAD
        )
    assert longer.common - plain.common == pytest.approx(5 * UM, abs=1e-12)
    assert all(math.isnan(q.value) for q in scaled.scales.values())
    assert any("scale errors of the single axes are not seen" in m for m in scaled.messages)


def test_faces_determine_the_scales_too():
    found = squareness_from_diagonals(
        measured(FACES, **ANGLES, scale=(30e-6, -20e-6, 10e-6)), SIZE, u=0.1 * UM
    )

    for axis, value in zip("xyz", (30e-6, -20e-6, 10e-6), strict=True):
        assert found.scales[axis].value == pytest.approx(value, abs=1e-8)
        assert found.scales[axis].u > 0


def test_one_face_leaves_the_other_angles_nan():
    found = squareness_from_diagonals(measured(("pp0", "np0"), **ANGLES), SIZE)

    assert found.a_xy == pytest.approx(ANGLES["xy"], abs=3 * NRAD)
    assert math.isnan(found.a_xz)
    assert math.isnan(found.a_yz)
    assert any("xz, yz not determined" in m for m in found.messages)


def test_a_reversed_diagonal_is_the_same_line():
    dl = measured(BODY, **ANGLES)
    turned = {"ppp": dl["ppp"], "pnn": dl["npp"], "npn": dl["pnp"], "++-": dl["nnp"]}

    assert squareness_from_diagonals(turned, SIZE).a_yz == pytest.approx(
        squareness_from_diagonals(dl, SIZE).a_yz, abs=1e-6 * NRAD
    )


def test_stated_remainder_is_that_of_the_exact_lengths():
    """1 mrad: first order is wrong by up to 1e-6 rad; the remainder says so to third order."""
    big = {"xy": 1e-3, "xz": -0.7e-3, "yz": 1.4e-3}
    directions = [machine(q, **big) for q in np.eye(3)]

    found = squareness_from_diagonals(measured(BODY, exact=True, **big), SIZE)

    wrong = {}
    for pair, (i, j) in {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}.items():
        true = math.pi / 2 - math.acos(float(directions[i] @ directions[j]))
        wrong[pair] = found.angles[pair].value - true
        assert found.remainder[pair] == pytest.approx(wrong[pair], abs=10 * NRAD)
    assert max(map(abs, wrong.values())) > 300 * NRAD


def test_uncertainty_is_propagated():
    """u(a_xy) = D / (4 X Y) sqrt(4) u for equal u; and by simulation."""
    rng = np.random.default_rng(1)
    d = math.sqrt(sum(v * v for v in SIZE))
    dl = measured(BODY, **ANGLES)

    found = squareness_from_diagonals(dl, SIZE, u=0.2 * UM)
    values = [
        squareness_from_diagonals({k: v + 0.2 * UM * rng.normal() for k, v in dl.items()}, SIZE)
        for _ in range(800)
    ]

    assert found.angles["xy"].u == pytest.approx(d / (2 * 0.5 * 0.4) * 0.2 * UM, abs=1e-15)
    for pair in ANGLES:
        scatter = np.std([v.angles[pair].value for v in values], ddof=1)
        assert found.angles[pair].u == pytest.approx(scatter, abs=0.1 * scatter)  # 4 sd


def test_weights_and_redundancy():
    """Ten diagonals, six unknowns; the diagonal that is 1000 times worse hardly counts."""
    dl = measured(BODY + FACES, **ANGLES)
    dl["ppp"] += 3 * UM
    u = {name: (100 * UM if name == "ppp" else 0.1 * UM) for name in dl}

    found = squareness_from_diagonals(dl, SIZE, u=u)

    assert found.audit["redundancy"] == 4
    assert found.a_xy == pytest.approx(ANGLES["xy"], abs=5 * NRAD)
    assert found.residuals["ppp"] == pytest.approx(3 * UM, abs=0.01 * UM)


def diagonal_runs(rng, name, *, noise=0.1 * UM, play=2 * UM, n=5, m=9, **errors):
    """Positions along a diagonal with its linear error, play and noise."""
    start, stop = ends(name, SIZE)
    d = float(np.linalg.norm(stop - start))
    t = np.linspace(0, 0.98 * d, m) + d / 200 * np.sin(np.arange(m))
    growth = t / d * length_error(name, SIZE, exact=False, **errors)
    up = (t + growth)[:, None] + noise * rng.normal(size=(m, n))
    down = (t + growth)[:, None] + play + noise * rng.normal(size=(m, n))
    return t - t[0], up - t[0], down - t[0]


def test_diagonal_test_reports_each_line_and_the_angles():
    rng = np.random.default_rng(2)
    data = {name: diagonal_runs(rng, name, **ANGLES) for name in BODY}

    test = iso230_6_diagonals(data, size=SIZE)

    assert test.reversal.value == pytest.approx(2 * UM, abs=0.4 * UM)
    assert test.systematic.value == max(t["E"].value for t in test.tests.values())
    for name in BODY:
        q = test.length_errors[name]
        wanted = length_error(name, SIZE, exact=False, **ANGLES)
        assert q.value == pytest.approx(wanted, abs=4 * q.u)
        assert 0.02 * UM < q.u < 0.1 * UM
    for pair, value in ANGLES.items():
        q = test.squareness.angles[pair]
        assert q.value == pytest.approx(value, abs=4 * q.u)
    assert test.to_frame().loc["npp", "B_um"] == test.tests["npp"]["B"].value / UM


@pytest.mark.slow
def test_uncertainty_of_a_length_error_is_that_of_repeats():
    rng = np.random.default_rng(3)
    results = [
        iso230_6_diagonals({"ppp": diagonal_runs(rng, "ppp", **ANGLES)}, size=SIZE)
        for _ in range(60)
    ]
    values = [r.length_errors["ppp"].value for r in results]
    stated = np.mean([r.length_errors["ppp"].u for r in results])

    assert np.std(values, ddof=1) == pytest.approx(stated, abs=0.35 * stated)  # 3.8 sd of 60
    assert results[0].squareness is None
    assert any("measure the four body diagonals" in m for m in results[0].messages)


def test_unidirectional_diagonals_have_no_reversal():
    rng = np.random.default_rng(4)
    data = {n: (*diagonal_runs(rng, n, **ANGLES)[:2], None) for n in BODY}

    test = iso230_6_diagonals(data)

    assert test.reversal is None
    assert np.isnan(test.to_frame().loc["ppp", "B_um"])
    assert any("pass size=" in m for m in test.messages)


@pytest.mark.parametrize(
    ("lengths", "size", "options", "error", "match"),
    [
        ({"ppp": 1e-6, "npp": 0, "pnp": 0}, SIZE, {}, NotSeparableError, "four body diagonals"),
        ({}, SIZE, {}, NotSeparableError, "no diagonal"),
        ({"ppq": 0.0}, SIZE, {}, DataError, "not a diagonal"),
        ({"p00": 0.0}, SIZE, {}, DataError, "not a diagonal"),
        ({"ppp": 0.0, "nnn": 0.0}, SIZE, {}, DataError, "is given twice"),
        (dict.fromkeys(BODY, 0.7), SIZE, {}, UnitError, "actual minus nominal"),
        (dict.fromkeys(BODY, math.nan), SIZE, {}, InvalidSamplesError, "measure it again"),
        (dict.fromkeys(BODY, 0.0), (1.0, 1.0), {}, DataError, "three positive"),
        (dict.fromkeys(BODY, 0.0), (1.0, 1.0, 0.0), {}, DataError, "three positive"),
        (dict.fromkeys(BODY, 0.0), SIZE, {"u": -1.0}, DataError, "zero or more"),
        (dict.fromkeys(BODY, 0.0), SIZE, {"u": {"ppp": 1e-9}}, DataError, "lacks the diagonal"),
        (dict.fromkeys(BODY, 0.0), SIZE, {"u": [1e-7] * 4}, DataError, "mapping of names"),
        (dict.fromkeys(BODY, 0.0), SIZE, {"u": "1 V"}, DataError, "a length is needed"),
        (dict.fromkeys(BODY, 0.0), SIZE, {"u": dict.fromkeys(BODY, "a")}, DataError, "u of ppp"),
        ([0.0] * 4, SIZE, {}, DataError, "mapping such as"),
        (dict.fromkeys(BODY, 0.0), "abc", {}, DataError, "three positive"),
        (dict.fromkeys(BODY, 0.0), (1.0, "b", 1.0), {}, DataError, "three positive"),
        (dict.fromkeys(BODY, "1 um"), SIZE, {}, InvalidSamplesError, "length error of ppp"),
    ],
)
def test_bad_input_is_refused_by_name(lengths, size, options, error, match):
    with pytest.raises(error, match=match):
        squareness_from_diagonals(lengths, size, **options)


def test_bad_diagonal_tests_are_refused():
    rng = np.random.default_rng(5)
    good = diagonal_runs(rng, "ppp", **ANGLES)

    with pytest.raises(DataError, match="no diagonal was given"):
        iso230_6_diagonals({})
    with pytest.raises(DataError, match="is given twice"):
        iso230_6_diagonals({"ppp": good, "nnn": good})
    with pytest.raises(DataError, match="got 2 items"):
        iso230_6_diagonals({"ppp": good[:2]})
    with pytest.raises(DataError, match="check size and targets"):
        iso230_6_diagonals({"ppp": good}, size=(0.1, 0.1, 0.1))
    with pytest.raises(DataError, match="mapping such as"):
        iso230_6_diagonals([good])
    with pytest.raises(DataError, match="got a float"):
        iso230_6_diagonals({"ppp": 5.0})
    with pytest.raises(DataError, match="got a str"):
        iso230_6_diagonals({"ppp": "abc"})
    with pytest.raises(DataError, match="three positive"):
        iso230_6_diagonals({"ppp": good}, size="abc")
    with pytest.raises(DataError, match="seed"):
        iso230_6_diagonals({"ppp": good}, seed="a")
    with pytest.raises(TooFewSamplesError, match="needs 2"):
        iso230_6_diagonals({"ppp": (good[0], good[1][:, :1], None)})


def test_a_size_in_mm_is_refused_and_short_targets_are_said():
    """The length error is slope times diagonal: 1000 times the size, 1000 times the error."""
    rng = np.random.default_rng(6)
    t, up, down = diagonal_runs(rng, "ppp", **ANGLES)
    half, most = slice(0, 5), slice(0, 8)

    with pytest.raises(DataError, match=r"targets span .* half of the diagonal"):
        iso230_6_diagonals({"ppp": (t, up, down)}, size=[v * 1e3 for v in SIZE])
    with pytest.raises(DataError, match="half of the diagonal"):
        iso230_6_diagonals({"ppp": (t[half], up[half], down[half])}, size=SIZE)
    short = iso230_6_diagonals({"ppp": (t[most], up[most], down[most])}, size=SIZE)
    whole = iso230_6_diagonals({"ppp": (t, up, down)}, size=SIZE)

    assert any("ppp" in m and "extrapolated" in m for m in short.messages)
    assert not any("extrapolated" in m for m in whole.messages)


def through_pickle(result):
    return pickle.loads(pickle.dumps(result))  # noqa: S301 - bytes of its own


@pytest.mark.parametrize("how", [copy.deepcopy, through_pickle])
def test_results_survive_copies_and_give_json(how):
    rng = np.random.default_rng(7)
    data = {name: diagonal_runs(rng, name, **ANGLES) for name in ("pp0", "np0")}
    test = iso230_6_diagonals(data, size=SIZE)

    for result in (test, test.squareness):
        again = how(result)
        text = json.dumps(result.to_dict(), allow_nan=False)
        assert json.dumps(again.to_dict(), allow_nan=False) == text
        assert repr(again) == repr(result)
    assert test.to_dict()["squareness"]["angles"]["xz"]["value"] is None
    assert set(test.to_dict()["tests"]) == {"pp0", "np0"}


def test_all_names_of_body_diagonals_are_four_lines():
    dl = measured(BODY, **ANGLES)
    for names in itertools.product(("ppp", "nnn"), ("npp", "pnn"), ("pnp", "npn"), ("nnp", "ppn")):
        found = squareness_from_diagonals(dict(zip(names, dl.values(), strict=True)), SIZE)
        assert found.a_xz == pytest.approx(ANGLES["xz"], abs=3 * NRAD)

"""Ranking on five axes that are locked or turn the part, against bodies in the bed, without library code."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from metrosep import Surface
from metrosep.errors import DataError
from metrosep.forms import Toric
from metrosep.machine import identify, presets
from metrosep.machine.chains import Chain, preset_table
from metrosep.machine.ranking import rank

H, RADIUS = 0.08, 0.02
TORIC = Toric(Rb=0.265, Rd=0.1325)
N_RHO, N_AZIMUTH = 16, 24
PICOMETRE = 1e-6  # um
UM, URAD = 1e-6, 1e-6
TERMS = {
    "EXX": UM,
    "EZZ": UM,
    "X0C": UM,
    "B0C": 5 * URAD,
    "C0Y": 5 * URAD,
    "EBY": 5 * URAD,
    "EAA": 5 * URAD,
}


def rx(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def rz(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def tool_against_work(term, A, C, p):
    """Displacement in the bed of a tool that touches the part at p, by a unit of the term."""
    on_table = rz(-C) @ p  # from the place where the axis of C starts
    above_a = np.array([0, 0, H]) + on_table
    place = rx(-A) @ above_a  # from the axis of A, which the bed sees at -Y
    tool = np.array([place[0], 0.0, place[2]])
    y = place[1]  # Y carries the part, so it stands where the part must go back to
    return {
        "EXX": np.array([1.0, 0, 0]),
        "EZZ": np.array([0, 0, 1.0]),
        "X0C": -(rx(-A) @ [1.0, 0, 0]),  # the line of C moves, the part with it
        "B0C": -(rx(-A) @ np.cross([0, 1.0, 0], on_table)),
        "C0Y": np.array([-y, 0, 0]),
        "EBY": np.cross([0, 1.0, 0], tool),
        "EAA": np.cross([1.0, 0, 0], place),
    }[term]


def expected(A, C):
    """Sq in um before and after alignment of each term; `C` of the azimuth."""
    rho = (np.arange(N_RHO) + 0.5) / N_RHO * RADIUS
    azimuth = 2 * np.pi * np.arange(N_AZIMUTH) / N_AZIMUTH
    rows = []
    for r in rho:
        for f in azimuth:
            x, y = r * np.cos(f), r * np.sin(f)
            one = np.array(x), np.array(y)
            p = np.array([x, y, float(TORIC(*one))])
            gx, gy = (float(v) for v in TORIC.gradient(*one))
            back = (rx(-A) @ rz(-C(f))).T
            e = [back @ tool_against_work(t, A, C(f), p) * TERMS[t] for t in TERMS]
            rows.append([r, x, y, *(v[2] - gx * v[0] - gy * v[1] for v in e)])
    table = np.array(rows)
    root = np.sqrt(table[:, 0] / table[:, 0].sum())[:, None]
    maps = table[:, 3:] * root
    plane = np.column_stack([np.ones(len(table)), table[:, 1], table[:, 2]]) * root
    left = maps - plane @ np.linalg.lstsq(plane, maps, rcond=None)[0]
    return [1e6 * np.sqrt((m**2).sum(axis=0)) for m in (maps, left)]


@pytest.mark.parametrize(
    ("at", "A", "C"),
    [
        ({"A": "-30 deg", "C": "50 deg"}, np.radians(-30), lambda f: np.radians(50)),
        # C carries the part towards -Z for a positive word: the azimuth comes to +X at C = +azimuth
        ({"A": 0.0}, 0.0, lambda f: f),
        ({"A": "20 deg"}, np.radians(20), lambda f: f),
    ],
)
def test_five_axes_rank_as_bodies_in_the_bed_move(at, A, C):
    table = rank(
        presets("five_axis", pivot_height=H), TORIC, radius=RADIUS, errors=TERMS, positions=at,
        n_rho=N_RHO, n_azimuth=N_AZIMUTH,
    )  # fmt: skip
    before, after = expected(A, C)
    assert_allclose(1e6 * table.sq_raw, before, rtol=0, atol=PICOMETRE)
    assert_allclose(1e6 * table.sq, after, rtol=0, atol=PICOMETRE)


def test_a_part_that_was_cut_with_a_and_c_locked_tells_its_errors():
    """The axis of C stands 2 um beside its place, and Y leans by -3 urad."""
    planted = {"X0C": 2 * UM, "C0Y": -3 * URAD}
    line = np.linspace(-0.018, 0.018, 25)
    x, y = np.meshgrid(line, line)
    z = np.full(x.shape, np.nan)
    for i in np.ndindex(x.shape):
        if np.hypot(x[i], y[i]) < 0.018:
            one = np.array(x[i]), np.array(y[i])
            p = np.array([x[i], y[i], float(TORIC(*one))])
            gx, gy = (float(v) for v in TORIC.gradient(*one))
            A, C = np.radians(-30), np.radians(50)
            e = sum(v * tool_against_work(t, A, C, p) for t, v in planted.items())
            e = (rx(-A) @ rz(-C)).T @ e
            z[i] = p[2] + e[2] - gx * e[0] - gy * e[1]
    step = line[1] - line[0]
    found = identify(
        presets("five_axis", pivot_height=H), Surface(z, step, step), form=TORIC, centre=(0.018, 0.018),
        terms=tuple(planted), positions={"A": "-30 deg", "C": "50 deg"}, exact=False,
    )  # fmt: skip
    for name, value in planted.items():
        assert found[name].value == pytest.approx(value, rel=1e-3, abs=0.0)


def ranked(chain=None, **at):
    chain = chain or presets("five_axis", pivot_height=H)
    return rank(
        chain, TORIC, radius=RADIUS, errors={"EXX": UM}, positions=at, n_rho=8, n_azimuth=12
    )


def test_what_cannot_be_locked_or_turn_the_part_is_refused():
    with pytest.raises(DataError, match="where A, C stand while the part is cut is not stated"):
        ranked()
    with pytest.raises(
        DataError, match="no axis 'B' can be locked: the machine has X, Z, Y, A, C"
    ):
        ranked(A=0.0, B=0.0)
    with pytest.raises(DataError, match="X is a linear axis, and where it stands follows"):
        ranked(A=0.0, X=0.0)
    with pytest.raises(DataError, match="A cannot turn the part as a spindle: C stands between"):
        ranked(C=0.0)
    table = preset_table("five_axis")
    table["element"] = table["element"][:-1]
    with pytest.raises(DataError, match="A does not turn the part about its z"):
        ranked(Chain.from_dict({k: v for k, v in table.items() if k != "parameters"}))
    with pytest.raises(DataError, match=r'at = \{ A = "0 deg", C = "0 deg" \}'):
        rank(presets("five_axis", pivot_height=H), TORIC, radius=RADIUS, errors={"EXX": UM})

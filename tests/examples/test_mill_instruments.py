"""Six instruments on one mill of bodies: each finds what it can see, and says what it cannot."""

import runpy
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from metrosep.io.reading_sets import read_reading_set
from metrosep.machine import Nest, calibrate, presets

MILL = presets("mill_xyz")
UM, URAD = 1e-6, 1e-6


@pytest.fixture
def folder(repository):
    return repository / "examples" / "mill_instruments"


@pytest.fixture
def truth(folder):
    """The simulator's own module: bodies, without library code."""
    return runpy.run_path(str(folder / "mill.py"))


def found_of(folder, *names, **options):
    sets = [read_reading_set(folder / f"{n}.csv", MILL) for n in names]
    return calibrate(MILL, sets, **options)


def about_line(x, y):
    return y - np.polyval(np.polyfit(x, y, 1), x)


def planted(truth, term, q):
    shift, turns = truth["motions"](term[2], q)
    return shift["XYZ".index(term[1])] if term[1] in "XYZ" else turns["ABC".index(term[1])]


def test_the_data_are_those_of_the_script(folder, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "mill", raising=False)
    runpy.run_path(str(folder / "make_data.py"))["main"](tmp_path)
    made = sorted(f.name for f in tmp_path.iterdir())
    assert made == sorted(f.name for f in folder.glob("*.csv"))
    for name in made:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    monkeypatch.delitem(sys.modules, "mill")


def test_the_indicator_tells_the_slide_from_the_straightedge(folder, truth):
    found = found_of(folder, "indicator_front", "indicator_back", terms=["EYX"], degrees=5)
    x = np.linspace(0.0, 0.4, 21)
    true = np.array([planted(truth, "EYX", p) for p in x])
    edge = 1.8e-6 * np.cos(np.pi * x / 0.4) - 1.2e-6 * np.exp(-(((x - 0.31) / 0.03) ** 2))

    assert_allclose(
        about_line(x, found.errors["EYX"].evaluate(x)), about_line(x, true), rtol=0, atol=0.12 * UM
    )
    form, u = found.unknowns["indicator_front"]["form"]
    assert_allclose(about_line(x, form), about_line(x, edge), rtol=0, atol=4.0 * u.max())


@pytest.mark.parametrize(
    ("file", "term", "degree", "span"),
    [
        ("level", "EAY", 3, 0.3),
        ("laser_linear", "EXX", 7, 0.4),
        ("laser_angular", "EBX", 4, 0.4),
    ],
)
def test_angles_and_positions_come_back_with_their_sign(folder, truth, file, term, degree, span):
    found = found_of(folder, file, terms=[term], degrees=degree)
    q = np.linspace(0.0, span, 9)
    true = np.array([planted(truth, term, p) for p in q])
    curve = found.errors[term]

    assert_allclose(curve.evaluate(q), true, rtol=0, atol=4.0 * curve.sd(q).max())
    assert np.abs(curve.evaluate(q) + true).max() > np.abs(true).max()


def test_circles_see_squareness_where_they_are(folder, truth):
    found = found_of(
        folder, "ballbar_xy", "ballbar_yz", "ballbar_zx",
        terms=["C0Y", "B0Z", "A0Z", "EXX", "EYY", "EZZ"], degrees=1,
    )  # fmt: skip
    mill, tool, ball = truth["Mill"](), np.array([0.0, 0.0, -0.12]), np.array([0.2, 0.15, 0.0])
    a = np.radians(np.arange(0.0, 360.0, 6.0))
    r = []
    for angle in a:
        place = ball + 0.1 * np.array([np.cos(angle), np.sin(angle), 0.0])
        r.append(np.linalg.norm(mill.point(place - tool, tool) - ball) - 0.1)
    # r = ... - R C0Y sin a cos a (ISO 230-4)
    shapes = np.column_stack([np.ones(a.size), np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])
    local = -2.0 * np.linalg.lstsq(shapes, np.array(r), rcond=None)[0][4] / 0.1
    term = found.errors["C0Y"]

    assert abs(term.value - local) < 0.5 * URAD
    assert np.isnan(found.errors["EXX"].evaluate(0.1))
    assert any("length of ballbar xy" in n and "EXX order 1" in n for n in found.null)
    assert "ball z of ballbar xy: no reading depends on it" in found.null


def test_four_unknown_stations_give_all_errors(folder, truth):
    found = found_of(folder, *(f"tracker_{n}" for n in (1, 2, 3, 4)), degrees=4)
    rng = np.random.default_rng(8)
    mill, tool = truth["Mill"](), np.array([0.02, 0.03, -0.15])  # a tool that was not there
    states = rng.uniform(0.0, truth["SPAN"], (60, 3))
    true = np.array([mill.point(s, tool) - s - tool for s in states])
    said = found.read(Nest(), dict(zip("XYZ", states.T, strict=True)), tool=tool)
    # the frame of the stations is free: six rigid freedoms
    J = np.zeros((60, 3, 6))
    J[:, :, :3] = np.eye(3)
    for k in range(3):
        J[:, :, 3 + k] = np.cross(np.eye(3)[k], states + tool)
    rest = (true - said).reshape(-1)
    rest = rest - J.reshape(-1, 6) @ np.linalg.lstsq(J.reshape(-1, 6), rest, rcond=None)[0]
    size = true.reshape(-1)
    size = size - J.reshape(-1, 6) @ np.linalg.lstsq(J.reshape(-1, 6), size, rcond=None)[0]

    assert found.null == () or all("u =" in n for n in found.null)
    assert np.sqrt(np.mean(rest**2)) < 0.1 * np.sqrt(np.mean(size**2))

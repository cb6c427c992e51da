"""Forbes' aspheres: printed polynomials, orthogonality by quadrature, derivatives, properties."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.forms.conic import Conic
from metrosep.forms.qforbes import QForbes, q_bfs, q_con

ROUNDING = 1e-13
"""Relative, polynomials of low order."""

QUADRATURE = 1e-10
"""Gauss rules are exact for these degrees; what is left is rounding at order 20."""

DIFFERENCE = 1e-8
"""Central differences in double precision."""

U = np.array([0.3, 0.7, 1.0])


def _form(kind="con", **more):
    k = 0.0 if kind == "bfs" else -0.7
    arguments = {
        "R": 60e-3,
        "k": k,
        "kind": kind,
        "coefficients": (3e-5, -2e-5, 1e-5, 4e-6),
        "radius": 20e-3,
    }
    return QForbes(**(arguments | more))


def _points(n=40, radius=19e-3, seed=1):
    rng = np.random.default_rng(seed)
    r, t = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    return r * np.cos(t), r * np.sin(t)


def test_qcon_values_of_the_acceptance_table():
    values = q_con(U**2, 3)[0] * U**4

    assert values[0] == pytest.approx([0.0081, 0.2401, 1.0], abs=1e-8)
    assert values[1] == pytest.approx([-0.036126, -0.494606, 1.0], abs=1e-8)
    assert values[2] == pytest.approx([0.09271908, 0.27438628, 1.0], abs=1e-8)


def test_polynomials_printed_by_forbes():
    X = np.linspace(0, 1, 11)

    con, _ = q_con(X, 4)
    bfs, _ = q_bfs(X, 3)

    assert np.abs(con[1] - (6 * X - 5)).max() < ROUNDING
    assert np.abs(con[2] - (15 - 14 * X * (3 - 2 * X))).max() < ROUNDING * 10
    assert np.abs(con[3] - (-(35 - 12 * X * (14 - X * (21 - 10 * X))))).max() < ROUNDING * 100
    assert np.abs(bfs[0] - 1).max() < ROUNDING
    assert np.abs(bfs[1] - (13 - 16 * X) / math.sqrt(19)).max() < ROUNDING
    assert np.abs(bfs[2] - math.sqrt(2 / 95) * (29 - 4 * X * (25 - 19 * X))).max() < ROUNDING * 10


def test_qcon_is_orthogonal_with_the_weight_x_to_the_fourth():
    nodes, weights = np.polynomial.legendre.leggauss(30)
    X = (nodes + 1) / 2

    q, _ = q_con(X, 21)

    gram = (q * weights / 2 * X**4) @ q.T
    norms = 1.0 / (2 * np.arange(21) + 5.0)  # of P_m^(0,4) on [0, 1]
    assert np.abs(gram - np.diag(norms)).max() < QUADRATURE


def test_slopes_of_qbfs_are_orthonormal():
    # weight (2/pi) / sqrt(1 - u^2) on [0, 1]: the mean over t, u = sin t
    t = np.pi * (np.arange(200) + 0.5) / 400
    u = np.sin(t)
    X = u * u

    q, dq = q_bfs(X, 21)
    slope = 2 * u * ((1 - 2 * X) * q + X * (1 - X) * dq)

    assert np.abs(slope @ slope.T / t.size - np.eye(21)).max() < QUADRATURE


def test_rms_slope_of_the_normal_departure_is_the_norm_of_the_coefficients():
    form = _form("bfs")
    u = np.sin(np.pi * (np.arange(400) + 0.5) / 800)
    h = 1e-6
    radii = [form.radius * (u + s * h) for s in (-1, 1)]

    normal = [form.departure(r, 0 * r) * np.sqrt(1 - (r / form.R) ** 2) for r in radii]

    rms = np.sqrt(np.mean(((normal[1] - normal[0]) / (2 * h * form.radius)) ** 2))
    assert rms == pytest.approx(np.linalg.norm(form.coefficients) / form.radius, rel=1e-8, abs=0.0)


@pytest.mark.parametrize("kind", ["con", "bfs"])
def test_polynomials_agree_with_their_derivatives(kind):
    X = np.linspace(0.05, 0.95, 19)
    h = 1e-6
    q = q_con if kind == "con" else q_bfs

    _, d = q(X, 12)

    numeric = (q(X + h, 12)[0] - q(X - h, 12)[0]) / (2 * h)
    assert np.abs(d - numeric).max() < DIFFERENCE * np.abs(d).max()


def test_departure_of_bfs_is_zero_at_vertex_and_rim():
    form = _form("bfs")

    ends = form.departure(np.array([0.0, form.radius]), np.zeros(2))

    assert np.abs(ends).max() < 1e-18
    assert form(form.radius)[()] == pytest.approx(
        Conic(form.R, 0.0)(form.radius)[()], rel=1e-14, abs=0.0
    )


def test_departure_of_bfs_is_along_the_normal():
    form = _form("bfs", coefficients=(1e-9,))
    r = 12e-3
    u2 = (r / form.radius) ** 2
    cosine = math.sqrt(1 - (r / form.R) ** 2)

    departure = form.departure(np.array([r]), np.zeros(1)).item()

    assert departure * cosine == pytest.approx(1e-9 * u2 * (1 - u2), rel=1e-13, abs=0.0)


def test_con_of_even_powers_is_the_even_asphere():
    # X^2 (a0 + a1 (6 X - 5)) = (a0 - 5 a1) X^2 + 6 a1 X^3
    form = _form(coefficients=(3e-5, -2e-5))
    x, y = _points()
    X = (x * x + y * y) / form.radius**2

    expected = Conic(form.R, form.k)(x, y) + 13e-5 * X**2 - 12e-5 * X**3

    assert np.abs(form(x, y) - expected).max() < 1e-17


@pytest.mark.parametrize("kind", ["con", "bfs"])
def test_slopes_agree_with_differences(kind):
    form = _form(kind)
    x, y = _points()
    h = 1e-7

    dx, dy = form.gradient(x, y)

    assert np.abs(dx - (form(x + h, y) - form(x - h, y)) / (2 * h)).max() < DIFFERENCE
    assert np.abs(dy - (form(x, y + h) - form(x, y - h)) / (2 * h)).max() < DIFFERENCE
    assert [float(s.item()) for s in form.gradient(0.0, 0.0)] == [0.0, 0.0]


@pytest.mark.parametrize("kind", ["con", "bfs"])
def test_derivatives_agree_with_differences(kind):
    form = _form(kind, coefficients=(3e-3, -2e-3, 1e-3))  # large, so that dz/dR feels them
    x, y = _points()
    names = list(form.parameters)

    for name, value in zip(names, form.derivatives(x, y, names), strict=True):
        now = form.parameters[name]
        step = 1e-5 * abs(now)
        up, down = (form.with_parameters(**{name: now + s})(x, y) for s in (step, -step))
        numeric = (up - down) / (2 * step)
        assert np.abs(value - numeric).max() < DIFFERENCE * np.abs(numeric).max(), name


@pytest.mark.parametrize("kind", ["con", "bfs"])
@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3])
def test_another_unit_of_length_gives_the_same_shape(kind, scale):
    form = _form(kind)
    other = _form(
        kind,
        R=form.R * scale,
        radius=form.radius * scale,
        coefficients=[a * scale for a in form.coefficients],
    )
    x, y = _points()

    assert np.abs(other(x * scale, y * scale) / scale - form(x, y)).max() < 1e-16
    assert np.abs(other.gradient(x * scale, y * scale)[0] - form.gradient(x, y)[0]).max() < 1e-14


@pytest.mark.parametrize("kind", ["con", "bfs"])
def test_flipped_part_and_symmetry(kind):
    form = _form(kind)
    flipped = _form(kind, R=-form.R, coefficients=[-a for a in form.coefficients])
    x, y = _points()

    assert np.abs(flipped(x, y) + form(x, y)).max() < 1e-18
    assert np.abs(form(y, -x) - form(x, y)).max() < 1e-17


def test_nan_beyond_the_radius_and_rim_inside():
    for form in (_form("con"), _form("bfs"), _form(coefficients=())):
        r = np.array([0.0, form.radius, form.radius * 1.001])
        for values in (form(r), form.gradient(r)[0], form.derivatives(r, 0 * r, ["R"])[0]):
            assert np.isnan(values).tolist() == [False, False, True]


def test_nan_beyond_the_equator_of_the_sphere():
    form = _form("bfs", radius=70e-3)

    assert np.isnan(form([0.0, 59e-3, 65e-3])).tolist() == [False, False, True]


def test_high_orders_stay_bounded():
    X = np.linspace(0, 1, 1001)

    con = q_con(X, 100)[0] * X**2
    bfs = q_bfs(X, 100)[0] * X * (1 - X)

    assert np.isfinite(con).all()
    assert con[:, -1] == pytest.approx(np.ones(100), rel=1e-9, abs=0.0)
    assert np.abs(con).max() < 1.0 + 1e-9
    assert np.abs(bfs).max() < 1.0


def test_unknown_parameters_start_from_the_data():
    truth = QForbes(R=60e-3, kind="bfs", coefficients=(1e-6, -1e-6), radius=20e-3)
    x, y = _points(400, radius=20e-3)

    form = QForbes(coefficients=(None, None)).start(x, y, truth(x, y))

    assert form.parameters["a0"] == 0.0
    assert pytest.approx(60e-3, rel=1e-2, abs=0.0) == form.R
    assert form.radius == pytest.approx(np.hypot(x, y).max(), rel=1e-9, abs=0.0)
    known = QForbes(R=50e-3, k=None, kind="con", coefficients=(None,), radius=20e-3)
    assert known.start(x, y, truth(x, y)).R == 50e-3


def test_names_and_units():
    assert _form("con").units == {
        "R": "m",
        "k": "1",
        "a0": "m",
        "a1": "m",
        "a2": "m",
        "a3": "m",
    }
    assert "k" not in _form("bfs").parameters
    assert repr(_form("bfs", coefficients=(1e-6,))) == "QForbes(R=0.06, a0=1e-06)"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "q2d"}, "kind"),
        ({"kind": "bfs", "k": -1.0}, "sphere"),
        ({"R": 0.0}, "R must be"),
        ({"radius": 0.0}, "radius"),
        ({"radius": -1.0}, "positive"),
        ({"coefficients": (np.nan,)}, "a0"),
        ({"coefficients": (0.0,) * 101}, "100"),
    ],
)
def test_bad_arguments_raise(arguments, message):
    with pytest.raises(DataError, match=message):
        _form(**arguments)


def test_what_is_not_known_cannot_be_evaluated():
    with pytest.raises(DataError, match="a0"):
        QForbes(R=1.0, coefficients=(None,), radius=0.1)(0.0)
    with pytest.raises(DataError, match="radius"):
        QForbes(R=1.0, coefficients=(1.0,))(0.0)
    with pytest.raises(DataError, match="no parameter"):
        _form("bfs").with_parameters(k=1.0)

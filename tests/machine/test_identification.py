"""Identification: planted errors of a lathe, cut exactly by a simulator of its own."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.forms import Plane, Sphere, Toric
from metrosep.machine.chains import presets
from metrosep.machine.identification import identify

R = 20e-3
TORIC = Toric(Rb=0.265, Rd=0.1325)
NOISE = 2e-9


@pytest.fixture(scope="module")
def lathe():
    return presets("fts_lathe", radius=R)


def cut(form, x, y, *, EXX=0.0, EYX=0.0, EZX=0.0, EXC=0.0, ECC=0.0, EAC=0.0, B0Z=0.0):
    """Return the points that a lathe with these errors really cuts, all orders, no library code.

    The tool stands at (rho, 0, z) of the bed, the spindle at minus the azimuth; the slide X runs
    from the rim to the centre and is turned by -B0Z about Y; EXC, ECC, EAC move the part with it.
    """
    rho, theta, z = np.hypot(x, y), -np.arctan2(y, x), form(x, y)
    bx = R - (R - rho) * np.cos(B0Z) + EXX
    bz = z - (R - rho) * np.sin(B0Z) + EZX
    px = bx * np.cos(theta) + EYX * np.sin(theta) - EXC
    py = -bx * np.sin(theta) + EYX * np.cos(theta)
    px, py = px * np.cos(ECC) + py * np.sin(ECC), -px * np.sin(ECC) + py * np.cos(ECC)
    py, pz = py * np.cos(EAC) + bz * np.sin(EAC), -py * np.sin(EAC) + bz * np.cos(EAC)
    return px, py, pz


def places(n=4000, seed=0, inner=0.3e-3):
    rng = np.random.default_rng(seed)
    rho = np.sqrt(rng.uniform((inner / R) ** 2, 0.96, n)) * R
    phi = rng.uniform(-np.pi, np.pi, n)
    return rho * np.cos(phi), rho * np.sin(phi)


PLANTED = {"EXX": 1.3e-6, "EYX": -0.8e-6, "B0Z": 17e-6}


def test_noise_free_planted_errors_come_back_with_their_signs(lathe):
    found = identify(lathe, cut(TORIC, *places(), **PLANTED), form=TORIC, terms=list(PLANTED))
    for term, value in PLANTED.items():
        assert found[term].value == pytest.approx(value, abs=1e-8 * abs(value))
    assert found.sq_before > 50e-9
    assert found.sq_after < 1e-15
    assert found.correction["EXX"] == pytest.approx(-1.3e-6, abs=1e-13)


@pytest.mark.parametrize(
    "planted",
    [{"EXX": 2e-6}, {"EYX": 2e-6}, {"EXC": 2e-6}, {"ECC": 2e-5}, {"B0Z": 2e-5}],
)
def test_one_planted_error_among_freedoms_has_the_sign_of_the_machine(lathe, planted):
    """No freedom removed but piston: every sign and azimuth shows on the asymmetric toric."""
    ((term, value),) = planted.items()
    tilted = identify(
        lathe, cut(TORIC, *places(), **planted), form=TORIC, terms=[term], removed="piston"
    )
    assert tilted[term].value == pytest.approx(value, abs=1e-6 * abs(value))


def test_z_scores_of_planted_errors_over_seeds(lathe):
    scores = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 9])
        truth = {t: v * rng.standard_normal() for t, v in PLANTED.items()}
        x, y, z = cut(TORIC, *places(600, seed), **truth)
        noisy = z + NOISE * rng.standard_normal(z.size) + 3e-6 + 1e-5 * x - 4e-5 * y
        found = identify(lathe, (x, y, noisy), form=TORIC, terms=list(PLANTED))
        scores.append([(found[t].value - truth[t]) / found[t].u for t in PLANTED])
        assert found.freedoms["tilt_y"][0] == pytest.approx(-4e-5, abs=1e-7)
    scores = np.array(scores)
    # 120 scores: standard error of their deviation 0.065, of each term's mean 0.16
    assert np.std(scores) == pytest.approx(1.0, abs=0.25)
    assert np.abs(scores.mean(axis=0)).max() < 0.6
    assert np.abs(scores).max() < 4.5


def test_freedoms_have_honest_uncertainties(lathe):
    scores = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 31])
        x, y, z = cut(TORIC, *places(500, seed), B0Z=1e-5)
        noisy = z + NOISE * rng.standard_normal(z.size) + 1e-6 - 2e-6 * x
        found = identify(lathe, (x, y, noisy), form=TORIC, terms=["B0Z", "EXX"])
        scores.append(
            [
                (found.freedoms[n][0] - v) / found.freedoms[n][1]
                for n, v in (("tilt_x", -2e-6), ("tilt_y", 0.0))
            ]
        )
    assert np.std(scores) == pytest.approx(1.0, abs=0.3)


def test_large_errors_need_the_exact_finish(lathe):
    planted = {"EXX": 150e-6, "EYX": -120e-6, "B0Z": 2e-3}
    points = cut(TORIC, *places(inner=6e-3), **planted)

    exact = identify(lathe, points, form=TORIC, terms=list(planted))
    linear = identify(lathe, points, form=TORIC, terms=list(planted), exact=False)

    for term, value in planted.items():
        assert exact[term].value == pytest.approx(value, abs=1e-7 * abs(value))
    assert abs(linear.estimate["EXX"] - 150e-6) > 0.1e-6
    assert np.isnan(linear["EXX"].value)  # the residual shows that constants do not describe it
    assert "exact=False" in " ".join(linear.messages)
    assert exact.sq_after < 1e-14 < linear.sq_after


def test_a_deep_part_without_noise_settles():
    """A sag of 51 mm rounds to 7e-18 m; a step below that is none."""
    deep, form = presets("fts_lathe", radius=0.3), Toric(Rb=1.0, Rd=0.8)
    x, step = np.linspace(-0.21, 0.21, 60, retstep=True)
    z = form(x, x[:, None]) + 1e-5 * np.hypot(x, x[:, None])
    for scale in (1.0, 3.0):
        found = identify(
            deep, Surface(z * scale, dx=scale * step, dy=scale * step), threshold=0.9999,
            form=Toric(Rb=scale, Rd=0.8 * scale), terms=["B0Z", "EXX"],
        )  # fmt: skip
        assert found["B0Z"].value == pytest.approx(1e-5, abs=2e-11)


def test_piston_of_the_slide_is_not_visible_and_nan(lathe):
    found = identify(
        lathe, cut(TORIC, *places(), EZX=5e-6, B0Z=1e-5), form=TORIC, terms=["EZX", "B0Z"]
    )
    assert found.unobservable == ("EZX",)
    assert np.isnan(found["EZX"].value)
    assert found["EZX"].u is None
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-12)
    assert "EZX" in " ".join(found.messages)


def test_terms_alike_are_known_only_together(lathe):
    found = identify(
        lathe,
        cut(TORIC, *places(), EYX=1.5e-6, B0Z=1e-5),
        form=TORIC,
        terms=["EYX", "ECC", "B0Z"],
    )
    (group,) = found.groups
    assert group.names == ("EYX", "ECC")
    assert np.isnan(found["EYX"].value)
    assert np.isnan(found["ECC"].value)
    assert group.equivalents["EYX"][0] == pytest.approx(1.5e-6, abs=0.03e-6)  # |r| = 0.98, not 1
    assert group.likeness > 0.97
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-11)
    assert found.estimate["EYX"] == pytest.approx(1.5e-6, abs=1e-11)

    apart = identify(
        lathe,
        cut(TORIC, *places(), EYX=1.5e-6, B0Z=1e-5),
        form=TORIC,
        terms=["EYX", "ECC", "B0Z"],
        threshold=0.999,
    )
    assert apart.groups == ()
    assert apart["EYX"].value == pytest.approx(1.5e-6, abs=1e-11)


@pytest.mark.slow
def test_the_size_of_a_group_has_z_scores_of_one(lathe):
    """Whatever mixture is planted, the common map's size is known to its u."""
    scores = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 5])
        x, y = places(500, seed)
        clean = cut(TORIC, x, y, EYX=1e-6, ECC=-3e-5)
        exact = identify(lathe, clean, form=TORIC, terms=["EYX", "ECC"])
        noisy = (*clean[:2], clean[2] + NOISE * rng.standard_normal(500))
        found = identify(lathe, noisy, form=TORIC, terms=["EYX", "ECC"])
        scores.append((found.groups[0].sq - exact.groups[0].sq) / found.groups[0].u)
    assert np.std(scores) == pytest.approx(1.0, abs=0.35)
    assert np.abs(scores).max() < 4.0


def test_terms_that_are_one_do_not_break_the_fit(lathe):
    """EXX and EXFTS are the same motion here: exactly singular."""
    found = identify(
        lathe,
        cut(TORIC, *places(), EXX=2e-6, B0Z=1e-5),
        form=TORIC,
        terms=["EXX", "EXFTS", "B0Z", "EYX", "EYFTS"],
    )
    assert [g.names for g in found.groups] == [("EXX", "EXFTS"), ("EYX", "EYFTS")]
    assert found.groups[0].equivalents["EXFTS"][0] == pytest.approx(2e-6, abs=1e-11)
    assert sum(found.estimate[t] for t in ("EXX", "EXFTS")) == pytest.approx(2e-6, abs=1e-11)
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-11)
    assert found.audit["rank"] == 3


def test_on_a_sphere_shifts_are_turns_and_a_turn_about_the_axis_is_nothing(lathe):
    ball = Sphere(R=0.2)
    points = cut(ball, *places(), B0Z=1e-5)
    found = identify(
        lathe,
        points,
        form=ball,
        terms=["EXC", "EYC", "EAC", "EBC", "B0Z", "ECC"],
        removed="piston",
    )
    assert {g.names for g in found.groups} == {("EXC", "EBC"), ("EYC", "EAC")}
    assert "ECC" in found.unobservable
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-11)


def test_three_terms_that_make_one_another_are_a_group_without_a_pair_alike(lathe):
    """On a plane EAC and EBC are the tilts; a callable chain adds a term that is their sum."""

    class Sum:
        name, elements = lathe.name, lathe.elements
        terms = ("EAC", "EBC", "EAX", "B0Z")

        def known_terms(self, names):
            return tuple(names)

        def jacobian(self, q, *, tool, terms):
            J = np.array(lathe.jacobian(q, tool=tool, terms=("EAC", "EBC", "EAX", "B0Z")))
            J[..., 2] = J[..., 0] + J[..., 1]
            return J[..., [self.terms.index(t) for t in terms]]

    x, y, z = cut(Plane(), *places(), EAC=1e-6, B0Z=1e-5)
    found = identify(Sum(), (x, y, z), form=Plane(), removed="piston", exact=False)
    (group,) = found.groups
    assert group.names == ("EAC", "EBC", "EAX")
    assert np.isnan(found["EAC"].value)
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-9)


def test_heights_in_micrometres_are_refused_not_fitted(lathe):
    x, y, z = cut(TORIC, *places(500), B0Z=1e-5)
    with pytest.raises(TooFewSamplesError, match="in m"):
        identify(lathe, (x, y, 1e6 * z), form=TORIC, terms=["B0Z", "EXX", "EYX"])


def grid(n=61, half=0.7 * R):
    x = np.linspace(-half, half, n)
    return np.meshgrid(x, x)


def test_a_map_with_gaps_keeps_its_gaps_and_its_place(lathe):
    X, Y = grid()
    z = TORIC(X, Y) - 2e-5 * (R - np.hypot(X, Y))
    z[10:14, 40:50] = np.nan
    before = z.copy()
    step = X[0, 1] - X[0, 0]

    found = identify(lathe, Surface(z, dx=step, dy=step), form=TORIC, terms=["B0Z", "EXX"])

    assert found["B0Z"].value == pytest.approx(2e-5, abs=1e-9)  # the map holds the linear effect
    assert np.isnan(found.residual.z[10:14, 40:50]).all()
    assert found.residual.dx == step
    assert (np.isnan(z) == np.isnan(before)).all()
    assert found.residual.history[-1].name == "identify"


def test_a_margin_that_was_not_measured_moves_no_axis(lathe):
    X, Y = grid()
    step = X[0, 1] - X[0, 0]
    z = cut(TORIC, X, Y, B0Z=20e-6)[2]
    z = np.where(np.hypot(X, Y) < 0.7 * R, z, np.nan)
    padded = np.pad(z, ((3, 0), (0, 21)), constant_values=np.nan)

    for heights, told in ((z, 0), (padded, 1)):
        found = identify(lathe, Surface(heights, step, step), form=TORIC, terms=["B0Z"])
        assert found["B0Z"].value == pytest.approx(20e-6, abs=1e-10)
        assert sum("middle of what was measured" in m for m in found.messages) == told


def test_a_nominal_map_of_the_same_pixels_stands_where_the_measured_one_does(lathe):
    """An edge that is missing in one of them moves neither against the other."""
    X, Y = grid()
    step = X[0, 1] - X[0, 0]
    nominal = Surface(TORIC(X, Y), step, step)
    z = cut(TORIC, X, Y, B0Z=20e-6)[2]
    z[:, 50:] = np.nan

    found = identify(lathe, Surface(z, step, step), form=nominal, terms=["B0Z"])

    assert found["B0Z"].value == pytest.approx(20e-6, abs=1e-9)
    assert not any("middle of what was measured" in m for m in found.messages)


def test_the_centre_of_the_part_is_left_out_and_counted(lathe):
    X, Y = grid()  # an odd grid: one pixel lies on the axis
    step = X[0, 1] - X[0, 0]
    z = TORIC(X, Y) - 2e-5 * (R - np.hypot(X, Y))
    found = identify(lathe, Surface(z, dx=step, dy=step), form=TORIC, terms=["B0Z", "EYX"])
    assert np.isnan(found.residual.z[30, 30])
    assert found.audit["n_points"] == z.size - 1
    assert found.audit["n_not_used"] == 1


def test_waviness_widens_the_uncertainty_and_is_reported(lathe):
    X, Y = grid(81)
    step = X[0, 1] - X[0, 0]
    rng = np.random.default_rng(2)
    z = TORIC(X, Y) - 2e-5 * (R - np.hypot(X, Y))
    white = identify(
        lathe,
        Surface(z + NOISE * rng.standard_normal(z.shape), dx=step, dy=step),
        form=TORIC,
        terms=["B0Z"],
    )
    wavy = identify(
        lathe,
        Surface(z + NOISE * np.sqrt(2) * np.sin(2 * np.pi * X / 3e-3), dx=step, dy=step),
        form=TORIC,
        terms=["B0Z"],
    )
    assert white.audit["inflation"] == pytest.approx(1.0, abs=0.1)
    assert not any("not white" in m for m in white.messages)
    assert wavy["B0Z"].u > 3 * white["B0Z"].u
    assert "not white" in wavy.messages[-1]


def test_a_thinned_map_keeps_its_widening(lathe):
    """Every third pixel of waviness of 4 mm is as wavy as the whole map."""
    X, Y = grid(120)
    step = X[0, 1] - X[0, 0]
    waves = NOISE * (np.sin(2 * np.pi * X / 4e-3) + np.sin(2 * np.pi * Y / 4e-3))
    wavy = Surface(TORIC(X, Y) - 2e-5 * (R - np.hypot(X, Y)) + waves, dx=step, dy=step)
    thin = identify(lathe, wavy, form=TORIC, terms=["B0Z"], max_points=2000)
    assert thin.audit["stride"] == 3
    assert thin.audit["inflation"] > 2.0
    assert "not white" in thin.messages[-1]


def test_predicted_residual_of_a_next_part(lathe):
    """Compensate what was found and cut again: what is left is the noise and what u adds."""
    x, y, z = cut(TORIC, *places(), **PLANTED)
    rng = np.random.default_rng(8)
    found = identify(
        lathe,
        (x, y, z + NOISE * rng.standard_normal(z.size)),
        form=TORIC,
        terms=list(PLANTED),
    )
    left = {t: v + found.correction[t] for t, v in PLANTED.items()}
    worse = {t: v - found.correction[t] for t, v in PLANTED.items()}
    again, wrong = (
        identify(lathe, cut(TORIC, *places(), **e), form=TORIC, terms=list(PLANTED)).sq_before
        for e in (left, worse)
    )
    assert found.sq_after == pytest.approx(NOISE, abs=0.1e-9)
    assert found.predicted_sq == pytest.approx(NOISE, abs=0.1e-9)
    assert again < 0.2e-9
    assert wrong > 1.9 * found.sq_before  # the flipped sign doubles the error


def test_shifts_and_turns_of_the_alignment_come_back(lathe):
    shift, turn = (5e-6, -3e-6), 1e-4
    x, y = places()
    px, py, z = cut(TORIC, x, y, B0Z=1e-5)
    seen_x = np.cos(turn) * px - np.sin(turn) * py + shift[0]
    seen_y = np.sin(turn) * px + np.cos(turn) * py + shift[1]
    found = identify(
        lathe,
        (seen_x, seen_y, z + 1e-6),
        form=TORIC,
        terms=["B0Z"],
        removed=("piston", "shift", "rotation_z"),
    )
    # the mark of the cone moves with the part by 5 um: first order of the freedoms in the start
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-10)
    for name, value in (("shift_x", shift[0]), ("shift_y", shift[1]), ("rotation_z", turn)):
        assert found.freedoms[name][0] == pytest.approx(value, abs=1e-4 * abs(value))


def test_report_frame_and_dict(lathe):
    found = identify(
        lathe, cut(TORIC, *places(), EYX=1e-6), form=TORIC, terms=["EYX", "ECC", "EZX", "B0Z"]
    )
    text = found.report()
    assert "together EYX, ECC" in text
    assert "not visible: EZX" in text
    frame = found.to_frame()
    assert frame.loc["EYX", "group"] == 1
    assert frame.loc["EYX", "if_alone"] == pytest.approx(1e-6, abs=0.03e-6)
    plain = found.to_dict()
    assert plain["terms"][0]["value"] is None
    assert plain["unobservable"] == ["EZX"]
    assert "Identification" in repr(found)
    with pytest.raises(ValueError, match="read-only"):
        found.values[0] = 1.0
    with pytest.raises(DataError, match="not asked"):
        found["EXX"]


def test_plane_is_assumed_only_with_a_message(lathe):
    flat = cut(Plane(), *places(), B0Z=1e-5)
    found = identify(lathe, flat, terms=["B0Z", "EXX"])
    assert found["B0Z"].value == pytest.approx(1e-5, abs=1e-10)
    assert found.unobservable == ("EXX",)
    assert "nominally plane" in found.messages[0]


def test_whole_numbers_and_large_maps_are_taken(lathe):
    X, Y = grid(101)
    z = TORIC(X, Y) - 2e-5 * (R - np.hypot(X, Y))
    step = X[0, 1] - X[0, 0]
    found = identify(
        lathe, Surface(z, dx=step, dy=step), form=TORIC, terms=["B0Z"], max_points=2000
    )
    assert found.audit["stride"] == 3
    assert np.isfinite(found.residual.z).sum() < 2000
    assert found["B0Z"].value == pytest.approx(2e-5, abs=1e-9)


@pytest.mark.parametrize(
    ("points", "options", "error", "match"),
    [
        (None, {"terms": ["EXQ"]}, DataError, "EXQ"),
        (None, {"terms": []}, DataError, "no error term"),
        (None, {"terms": ["EXX", "EXX"]}, DataError, "twice"),
        (None, {"terms": ["EZX"]}, DataError, "shows nothing"),
        (None, {"removed": "tip"}, DataError, "tip"),
        (None, {"threshold": 0.0}, DataError, "threshold"),
        (None, {"radius": -1.0}, InvalidSamplesError, "radius"),
        (None, {"radius": 1e-6}, TooFewSamplesError, "no measured point"),
        (None, {"inner_radius": 0.0198, "radius": 0.0199}, TooFewSamplesError, r"needed|radii"),
        (([0.01], [0.0], [0.0]), {}, TooFewSamplesError, "1 valid point"),
        (([0.01], [0.0], [0.0, 1.0]), {}, InvalidSamplesError, "one shape"),
        (([0.01, np.nan], [0.0, 0.0], [0.0, 1.0]), {}, InvalidSamplesError, "finite"),
        (([0.01, 0.0], [0.0, 0.0], [0.0, np.inf]), {}, InvalidSamplesError, "finite"),
        ((["a"], [0.0], [0.0]), {}, InvalidSamplesError, "real numbers"),
        (np.zeros((5, 5)), {}, DataError, "Surface"),
        (Surface(np.zeros((5, 5))), {}, DataError, "calibration"),
        (
            Surface(np.full((5, 5), np.nan), dx=1e-3, dy=1e-3),
            {},
            TooFewSamplesError,
            "no measured",
        ),
    ],
)
def test_bad_input_is_refused(lathe, points, options, error, match):
    given = cut(TORIC, *places(50), B0Z=1e-5) if points is None else points
    with pytest.raises(error, match=match):
        identify(lathe, given, form=TORIC, **({"terms": ["B0Z", "EXX"]} | options))

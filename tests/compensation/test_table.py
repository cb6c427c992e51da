"""`CompensationTable`: what becomes of an error at positions of an axis."""

import dataclasses

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet
from metrosep.compensation import CompensationTable, Limits
from metrosep.errors import DataError, LimitError, TableError
from metrosep.separation import separate

PM = 1e-12
SETTLED = 2e-13
"""Promise of the fixed point, with rounding."""

P = np.linspace(0.0, 50e-3, 26)


def plain(error, **options):
    return CompensationTable.from_error(error, **{"positions": P, "axis": "X"} | options)


def test_entries_are_minus_the_error(lopsided):
    table = plain(lopsided, exact=False)

    np.testing.assert_allclose(table.forward, lopsided(0.0) - lopsided(P), atol=PM, rtol=0)
    assert table.forward.min() < -2.5e-6  # the bump is +3 um
    assert table.positions[np.argmin(table.forward)] == pytest.approx(12e-3, abs=1e-3)


def test_exact_entries_solve_the_equation(lopsided):
    table = plain(lopsided)

    rest = lopsided(P + table.forward) - lopsided(0.0) + table.forward

    # a function is not asked beyond the last entry: there the error is held
    np.testing.assert_allclose(rest[:-1], 0.0, atol=SETTLED, rtol=0)
    assert table.is_exact_inverse


def test_linear_error_has_the_closed_form():
    table = plain(lambda x: 1e-3 * x, positions=[0.0, 10e-3, 20e-3, 21e-3])

    # 21 mm is the last entry: beyond it the error is held, where it falls short it is linear
    np.testing.assert_allclose(
        table.forward[:3], -1e-3 * np.array([0.0, 10e-3, 20e-3]) / 1.001, atol=SETTLED, rtol=0
    )


def test_profile_gives_the_same_as_its_function(lopsided):
    x = np.linspace(0.0, 50e-3, 5001)

    of_profile = plain(Profile(x, lopsided(x)))

    # linear between samples 10 um apart: |e''| h^2 / 8 with |e''| < 0.5 per m
    np.testing.assert_allclose(of_profile.forward, plain(lopsided).forward, atol=7e-12, rtol=0)


def test_descending_profile_is_not_mirrored(lopsided):
    x = np.linspace(0.0, 50e-3, 501)

    table = plain(Profile(x[::-1], lopsided(x[::-1])), exact=False)

    np.testing.assert_allclose(table.forward, lopsided(0.0) - lopsided(P), atol=1e-9, rtol=0)


def test_estimate_gives_minus_the_truth(one_way, one_way_estimate):
    table = plain(one_way_estimate, positions="1 mm")

    x = table.positions
    rest = table.forward + one_way.truth(x)
    rest -= np.polyval(np.polyfit(x, rest, 1), x)
    assert np.abs(rest).max() < 5e-9  # estimate's noise and e e' (1 um x 4e-4)
    assert table.removed == "offset"
    assert table.history[-1].name == "table"
    # of the difference from the zero at the first position
    whole = one_way_estimate.covariance(x)
    shape = np.diag(whole) + whole[0, 0] - 2.0 * whole[0]
    np.testing.assert_allclose(
        table.u, np.sqrt(shape + (x * one_way_estimate.slope.u) ** 2), rtol=1e-9
    )


def test_slope_of_the_runs_is_in_a_table_of_the_axis_itself_and_in_no_other():
    """Pitch of 30 um/m: the correction at 60 mm is -1.8 um; straightness does not know it."""
    x = np.linspace(0.0, 60e-3, 601)
    askew = RunSet([Run(x, 30e-6 * x + 5e-6 * i, feed=0.1, run_id=f"r{i}") for i in range(4)])
    estimate = separate(askew, method="mean")
    told = {"positions": "10 mm", "axis": "X"}

    pitch = CompensationTable.from_error(estimate, compensates="X", **told)
    straight = CompensationTable.from_error(estimate, compensates="Z", **told)

    # c(p) = -e(p + c(p)): 30e-6 of 1.8 um is 54 pm
    assert pitch.forward[-1] == pytest.approx(-1.8e-6, abs=60 * PM)
    assert np.abs(straight.forward).max() < PM


@pytest.mark.parametrize(
    ("positions", "expected"),
    [
        ("10 mm", [0.0, 10e-3, 20e-3, 30e-3, 40e-3]),
        ("20000 um", [0.0, 20e-3, 40e-3]),
        (4, [0.0, 15e-3, 30e-3, 45e-3]),
        ([1e-3, 2e-3, 44e-3], [1e-3, 2e-3, 44e-3]),
    ],
)
def test_positions_by_spacing_number_or_array(one_way_estimate, positions, expected):
    table = plain(one_way_estimate, positions=positions)

    np.testing.assert_allclose(table.positions, expected, atol=PM, rtol=0)


def test_spacing_puts_entries_on_multiples(lopsided):
    x = np.linspace(0.5e-3, 9.7e-3, 301)

    table = plain(Profile(x, lopsided(x)), positions="2 mm")

    np.testing.assert_allclose(table.positions, [2e-3, 4e-3, 6e-3, 8e-3], atol=PM, rtol=0)


@pytest.mark.parametrize("reference", [None, 10e-3, 0.05, 0.034])
def test_zero_is_exact_at_the_reference(lopsided, reference):
    table = plain(lopsided, reference=reference)
    zero = 0.0 if reference is None else reference

    assert table.reference == pytest.approx(zero, abs=PM)
    assert table.correction(table.reference)[0] == 0.0
    assert table.offset_removed == pytest.approx(float(lopsided(zero)), abs=PM)


def test_every_multiple_of_the_spacing_can_be_the_reference(lopsided):
    """0.1 mm times 3 is not 0.3 mm in binary; a person types 0.3 mm."""
    x = np.linspace(0.0, 5e-3, 501)

    for k in range(51):
        table = plain(
            Profile(x, lopsided(x)), positions="0.1 mm", reference=float(f"{k}e-1") * 1e-3
        )
        assert table.forward[k] == 0.0


def test_reference_is_the_first_position_where_zero_is_not_covered(lopsided):
    table = plain(lopsided, positions=P + 5e-3)

    assert table.reference == 5e-3
    assert table.forward[0] == 0.0


def test_reference_outside_is_refused(lopsided):
    with pytest.raises(TableError, match=r"reference X = 60 mm lies outside"):
        plain(lopsided, reference=60e-3)


def test_cross_axis_is_not_inverted(lopsided):
    table = plain(lambda x: 1000 * lopsided(x), compensates="Z")

    np.testing.assert_allclose(
        table.forward, 1000 * (lopsided(0.0) - lopsided(P)), atol=PM, rtol=0
    )
    assert not table.is_exact_inverse
    assert not table.is_on_axis
    assert table.exact_inverse() is table


def test_exact_inverse_of_an_inexact_table(lopsided):
    inexact = plain(lopsided, exact=False)

    exact = inexact.exact_inverse()

    p = exact.positions
    rest = exact.forward - inexact.correction(p + exact.forward)
    np.testing.assert_allclose(rest, 0.0, atol=SETTLED, rtol=0)
    assert exact.is_exact_inverse
    assert exact.exact_inverse() is exact
    assert exact.history[-1].name == "exact_inverse"


def test_interpolation_error_of_a_parabola():
    """Linear interpolation of e = k x^2/2 is off by k h^2/8, exactly."""
    table = plain(lambda x: 0.5 * 0.02 * x**2, positions=np.linspace(0, 40e-3, 21))

    assert table.interpolation_error == pytest.approx(0.02 * (2e-3) ** 2 / 8, rel=1e-6, abs=0.0)


def test_correction_is_linear_inside_and_constant_outside():
    table = CompensationTable(
        [0.0, 1e-3, 3e-3], [0.0, 4e-9, -2e-9], [1e-9, 0, 7e-9], "X", "X", 0.0
    )

    np.testing.assert_allclose(
        table.correction([-1.0, 0.5e-3, 1e-3, 2e-3, 9.0]),
        [0.0, 2e-9, 4e-9, 1e-9, -2e-9],
        atol=1e-21,
        rtol=0,
    )
    np.testing.assert_allclose(
        table.correction([-1.0, 0.5e-3, 9.0], -1), [1e-9, 0.5e-9, 7e-9], atol=1e-21, rtol=0
    )


@pytest.mark.parametrize("direction", [0, 2, None, "forward"])
def test_correction_refuses_another_direction(lopsided, direction):
    with pytest.raises(DataError, match=r"\+1 or -1"):
        plain(lopsided).correction(0.0, direction)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scaling_position_and_error_scales_the_table(lopsided, scale):
    table = plain(lopsided, exact=False)

    scaled = plain(lambda x: scale * lopsided(x / scale), positions=P * scale, exact=False)

    np.testing.assert_allclose(scaled.forward, scale * table.forward, atol=PM * scale, rtol=1e-9)


def test_table_is_frozen_and_read_only(lopsided):
    p = P.copy()
    table = plain(lopsided, positions=p)
    p[3] = 7.0

    with pytest.raises(dataclasses.FrozenInstanceError):
        table.axis = "Y"
    with pytest.raises(ValueError, match="read-only"):
        table.forward[0] = 1.0
    assert table.positions[3] == P[3]


def test_limits_are_refused_only_when_required(lopsided):
    table = plain(lopsided)

    assert [f.level for f in table.limits(stroke=1e-6)] == ["error"]
    with pytest.raises(LimitError, match="stroke"):
        table.require_limits(Limits(stroke=1e-6))


def test_negated_turns_both_columns():
    table = CompensationTable([0.0, 1e-3], [0.0, 4e-9], [1e-9, 0], "X", "X", 0.0).negated()

    np.testing.assert_array_equal(table.forward, [0.0, -4e-9])
    np.testing.assert_array_equal(table.reverse, [-1e-9, 0.0])


def test_repr_says_axes_span_and_stroke():
    table = CompensationTable([0.0, 1e-3], [0.0, 4e-9], None, "X", "Z", 0.0)

    assert repr(table) == (
        "CompensationTable(X -> Z, 2 points, 0 ... 1 mm, both directions alike, stroke 4 nm, "
        "zero at 0 m)"
    )
    assert "c = −e" in table._repr_html_()


@pytest.mark.parametrize("field", ["axis", "compensates"])
@pytest.mark.parametrize("name", ["X\nM30", "X\x00", " ", ""])
def test_axes_that_cannot_be_printed_are_refused(field, name):
    with pytest.raises(TableError, match=f"{field} must name an axis"):
        CompensationTable(
            [0, 1],
            [0, 0],
            None,
            **{"axis": "X", "compensates": "X", "reference": 0.0, field: name},
        )


@pytest.mark.parametrize("reference", [float("nan"), float("inf")])
def test_reference_that_is_no_position_is_refused(reference):
    with pytest.raises(TableError, match="must be a finite position"):
        CompensationTable([0.0, 1e-3], [0.0, 1e-6], None, "X", "Z", reference)

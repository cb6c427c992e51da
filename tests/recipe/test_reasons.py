"""Why a part is not accepted: value, limit, U, in the unit of the limit."""

import pytest

from metrosep.batch.index import reason_of


def entry(value, verdict="reject", **more):
    base = {"name": "rough Sq", "metric": "Sq", "definition": "root mean square", "unit": "m"}
    return base | {"value": value, "U": 0.3e-9, "lower": 6e-9, "upper": 12e-9} | more | {
        "verdict": verdict
    }  # fmt: skip


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        (entry(14.2e-9), "rough Sq 14.2 nm > 12 nm (U 0.3 nm): reject"),
        (entry(5e-9), "rough Sq 5 nm < 6 nm (U 0.3 nm): reject"),
        (entry(12.1e-9, "inconclusive"), "rough Sq 12.1 nm > 12 nm (U 0.3 nm): inconclusive"),
        (
            entry(11.95e-9, "inconclusive"),
            "rough Sq 11.95 nm, within U of 12 nm (U 0.3 nm): inconclusive",
        ),
        (
            entry(6.1e-9, "inconclusive"),
            "rough Sq 6.1 nm, within U of 6 nm (U 0.3 nm): inconclusive",
        ),
        (
            entry(11.5e-9, "inconclusive", guard_factor=2.0),
            "rough Sq 11.5 nm, within 2 U of 12 nm (U 0.3 nm): inconclusive",
        ),
        # digits until it differs from the limit
        (entry(12.00001e-9, U=0.0), "rough Sq 12.00001 nm > 12 nm (U 0 nm): reject"),
        (
            entry(12.0000000001e-9, "inconclusive"),
            "rough Sq 12 nm, within U of 12 nm (U 0.3 nm): inconclusive",
        ),
        # the unit is that of the limit
        (entry(1.42e-6), "rough Sq 1420 nm > 12 nm (U 0.3 nm): reject"),
        (entry(2.0, unit="1", lower=None, upper=1.5, U=0.1), "rough Sq 2 > 1.5 (U 0.1): reject"),
        (entry(3e-9, upper=0.0, lower=None), "rough Sq 3 nm > 0 nm (U 0.3 nm): reject"),
        (entry(None, "inconclusive"), "rough Sq not known: inconclusive"),
        # a check without a name has the words of the definition
        (entry(14e-9, name="root mean square"), "Sq 14 nm > 12 nm (U 0.3 nm): reject"),
    ],
)
def test_a_reason_has_value_limit_and_uncertainty(given, wanted):
    assert reason_of([given]) == wanted


def test_two_checks_of_one_metric_are_told_apart():
    one = entry(14e-9, name="root mean square", lower=None)
    two = {**one, "upper": 13e-9, "verdict": "inconclusive", "U": 2e-9}

    assert reason_of([one, two]) == (
        "Sq 14 nm > 12 nm (U 0.3 nm): reject; Sq 14 nm > 13 nm (U 2 nm): inconclusive"
    )


def test_what_is_accepted_or_not_judged_has_no_reason():
    assert reason_of([entry(8e-9, "accept"), entry(1e-3, None)]) is None
    assert reason_of([]) is None

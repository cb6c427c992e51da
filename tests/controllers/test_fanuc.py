"""Fanuc pitch error data: the parameter manual's example, a walk in pulses, drift, what is refused."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import Run, RunSet, controllers
from metrosep.compensation import CompensationTable, trial_table
from metrosep.controllers.fanuc import Fanuc
from metrosep.controllers.options import checked_options
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    SignNotConfirmedError,
    TableError,
)

ROUNDING = 1e-15
"""Sums of 128 doubles of 10 um."""

MANUAL = [2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1]
"""Points 33 to 48 of the example in the 0i parameter manual; reference 40, interval 50 mm."""
MANUAL_CURVE = [0, 2, 3, 4, 2, 2, 1, 1, 0, 2, 3, 3, 2, 1, -1, -1, 0]
"""Summed by hand away from the reference at 0 mm, at -400, -350 ... 400 mm."""

HEAD = (
    "%(FANUC PITCH ERROR, DETECTION UNIT 0.001 MM, INCREMENT 0.001 MM, REFERENCE 0 MM, "
    "ENTRY = -E, SIGN NOT DOCUMENTED: DRY-RUN ON THE MACHINE FIRST - MADE BY METROSEP)\n"
)
HAND = (
    HEAD
    + "N3620A1P40\nN3621A1P33\nN3622A1P48\nN3623A1P1\nN3624A1P50000\n"
    + "".join(f"N{10033 + i}P{v}\n" for i, v in enumerate(MANUAL))
    + "%\n"
)


def walk(data, position_mm, *, unit_um, reference_mm=0.0, increment_mm=0.001):
    """Pulses (um) that the control has output on the way from the reference: the manual's words."""
    word, axis = {}, {}
    for line in data.decode().splitlines()[1:-1]:
        name, value = line.split("P")
        number = int(name[1:].split("A")[0])
        word[number], axis[number] = int(value), name
    step = word[3624] * increment_mm
    output = 0.0
    for number in range(word[3621], word[3622] + 1):
        k = number - word[3620]
        low, high = reference_mm + (k - 1) * step, reference_mm + k * step
        pulses = word[10000 + number] * word[3623]
        if k >= 1:  # walking up from the reference through part of the section
            output += pulses * min(max((position_mm - low) / step, 0.0), 1.0)
        else:  # walking down: pulses are taken back
            output -= pulses * min(max((high - position_mm) / step, 0.0), 1.0)
    return output * unit_um


def checked(**given):
    return checked_options(given, Fanuc.options, "fanuc")


def encode(table, **given):
    return Fanuc().encode(table, **checked(**{"detection_unit": 1e-6, **given}))


def decode(data, **given):
    return Fanuc().decode(data, Path("absent.txt"), **given)


def manual_table():
    x = np.arange(-400, 401, 50) * 1e-3
    return CompensationTable(x, np.array(MANUAL_CURVE) * 1e-6, None, "X", "X", 0.0)


@pytest.fixture
def one_way(measured):
    return CompensationTable.from_error(
        measured, positions=np.arange(0, 51) * 1e-3, axis="X", source_sha256=("ab" * 32,)
    )


def test_manual_example_is_written_byte_for_byte():
    data = encode(manual_table(), reference_number=40).data

    assert data.decode() == HAND


def test_manual_example_reads_as_the_curve():
    table = decode(HAND.encode())

    np.testing.assert_allclose(
        table.positions, np.arange(-400, 401, 50) * 1e-3, atol=1e-15, rtol=0
    )
    np.testing.assert_allclose(table.forward, np.array(MANUAL_CURVE) * 1e-6, atol=ROUNDING, rtol=0)
    assert table.reverse is None


@pytest.mark.parametrize("mm", [-500, -400, -375, -60, -50, -10, 0, 20, 50, 175, 400, 600])
def test_lookup_is_the_walk_in_pulses(tmp_path, mm):
    path = tmp_path / "x.txt"
    path.write_text(HAND)

    seen = controllers.simulate(path, "fanuc")(mm * 1e-3, 1)

    assert seen == pytest.approx(walk(HAND.encode(), mm, unit_um=1.0) * 1e-6, abs=ROUNDING)


def test_axis_that_travels_too_far_gets_negative_increments_upwards():
    """+2 um too far at +10 mm, exact at 20 mm: the sections above zero hold -2 and +2 units."""
    x = np.array([-10.0, 0.0, 10.0, 20.0]) * 1e-3
    table = CompensationTable(x, np.array([1.0, 0.0, -2.0, 0.0]) * 1e-6, None, "X", "X", 0.0)

    lines = encode(table).data.decode().splitlines()

    assert lines[6:9] == ["N10000P-1", "N10001P-2", "N10002P2"]


def test_other_sign_negates_the_entries_and_reads_back_alike():
    other = encode(manual_table(), reference_number=40, entry_sign=1).data

    assert b"N10033P-2\n" in other
    assert b"ENTRY = +E" in other
    np.testing.assert_allclose(
        decode(other).forward, np.array(MANUAL_CURVE) * 1e-6, atol=ROUNDING, rtol=0
    )


def test_entries_of_less_than_half_a_unit_do_not_drift():
    """128 sections of +0.4 unit: rounding each would give 0 instead of 51.2 units."""
    x = np.arange(129) * 1e-3
    table = CompensationTable(x, 0.4e-6 * np.arange(129), None, "X", "X", 0.0)

    encoded = encode(table)

    back = decode(encoded.data)
    assert back.forward[-1] == pytest.approx(51e-6, abs=ROUNDING)
    assert np.abs(back.forward - table.forward).max() <= 0.5e-6 + ROUNDING
    assert encoded.quantisation == pytest.approx(0.4e-6, abs=ROUNDING)  # 0.4, 0.8, 1.2, 1.6, 2.0


@pytest.mark.parametrize("size", [-0.4, 0.4, 0.49, 2.51])
def test_no_drift_on_either_side_of_the_reference(size):
    x = np.arange(-64, 65) * 1e-3
    table = CompensationTable(x, size * 1e-6 * np.arange(-64, 65), None, "X", "X", 0.0)

    back = decode(encode(table).data)

    assert np.abs(back.forward - table.forward).max() <= 0.5e-6 + ROUNDING


@given(
    n=st.integers(2, 60),
    below=st.integers(0, 59),
    seed=st.integers(0, 2**32 - 1),
    unit=st.sampled_from([1e-8, 1e-7, 1e-6]),
    magnification=st.integers(1, 3),
    sign=st.sampled_from([-1, 1]),
)
@settings(derandomize=True, deadline=None, max_examples=80)
def test_round_trip_is_within_the_quantisation(n, below, seed, unit, magnification, sign):
    rng = np.random.default_rng(seed)
    below = min(below, n - 1)
    x = np.arange(-below, n - below) * 2e-3 + 5e-3
    c = np.cumsum(rng.uniform(-3, 3, n)) * unit
    table = CompensationTable(x, c - c[below], None, "X", "X", 5e-3)

    encoded = encode(table, detection_unit=unit, magnification=magnification, entry_sign=sign)

    step = unit * magnification
    assert encoded.step == step
    assert encoded.quantisation <= step / 2 + ROUNDING
    at = rng.uniform(x[0] - 3e-3, x[-1] + 3e-3, 50)
    output = np.array(
        [walk(encoded.data, p * 1e3, unit_um=unit * 1e6, reference_mm=5.0) for p in at]
    )
    np.testing.assert_allclose(  # a control with k = +1 subtracts what it outputs
        -sign * output * 1e-6,
        table.correction(at),
        atol=encoded.quantisation + ROUNDING,
        rtol=0,
    )


def test_planted_error_shrinks_and_the_negated_table_doubles_it(bump, one_way):
    x = np.linspace(0, 50, 401)
    error = bump(x * 1e-3) - bump(0.0)
    left = {}
    for name, table in (("right", one_way), ("wrong", one_way.negated())):
        data = encode(table, detection_unit=1e-7, largest=127).data
        c = np.array([walk(data, p, unit_um=0.1) for p in x]) * 1e-6
        left[name] = np.abs(bump(x * 1e-3 + c) - bump(0.0) + c).max()

    assert np.abs(error).max() > 2.9e-6
    assert left["right"] < 0.1e-6  # half a unit and chords of 1 mm over a bump 3 mm wide: 84 nm
    assert left["wrong"] > 1.9 * np.abs(error).max()


def test_written_only_when_the_sign_was_tried(tmp_path, one_way):
    with pytest.raises(SignNotConfirmedError, match="sign of fanuc"):
        controllers.write(
            one_way, tmp_path / "x.txt", "fanuc", detection_unit="100 nm", largest=127
        )
    assert list(tmp_path.iterdir()) == []


def test_write_read_simulate(tmp_path, one_way, measured):
    path = tmp_path / "x.txt"

    done = controllers.write(
        one_way,
        path,
        "fanuc",
        verified_against=measured,
        sign_confirmed=True,
        detection_unit="100 nm",
        largest=127,
    )

    assert done.after_pv < 0.06 * done.before_pv
    assert done.wrong_sign_pv > 1.9 * done.before_pv
    back = controllers.read(path, "fanuc")
    assert np.abs(back.forward - one_way.forward).max() <= 0.5e-7 + ROUNDING
    assert (back.axis, back.reference) == ("X", 0.0)


def test_detection_unit_is_asked_for(tmp_path, one_way):
    with pytest.raises(DataError, match="detection_unit"):
        controllers.write(one_way, tmp_path / "x.txt", "fanuc", sign_confirmed=True)


def test_two_directions_are_refused(table):
    with pytest.raises(TableError, match=r"direction='both'.*1851"):
        encode(table)


def test_correction_at_the_reference_is_refused():
    shifted = CompensationTable([0.0, 1e-3], [1e-6, 0.0], None, "X", "X", 0.0)

    with pytest.raises(TableError, match=r"exactly 0 and is 1.*reference="):
        encode(shifted)


def test_increment_out_of_range_is_refused():
    steep = CompensationTable(np.arange(3) * 1e-3, [0, 1e-6, 9e-6], None, "X", "X", 0.0)

    with pytest.raises(LimitError, match=r"increment 8 between 1 and 2 mm.*-7 \.\.\. 7"):
        encode(steep)
    assert encode(steep, largest=127).data.count(b"P8\n") == 1
    assert encode(steep, magnification=2).data.count(b"P4\n") >= 1


def test_too_many_points_are_refused():
    x = np.arange(130) * 1e-3
    table = CompensationTable(x, np.zeros(130), None, "X", "X", 0.0)

    with pytest.raises(LimitError, match=r"130 points.*takes 129.*interval="):
        encode(table)
    data = encode(table, capacity=1024).data
    with pytest.raises(LimitError, match="129 points, the control takes 128"):
        decode(data)
    assert decode(data, capacity=1024).positions.size == 130


def test_coarser_interval_is_resampled_and_its_error_told():
    x = np.arange(11) * 1e-3
    table = CompensationTable(x, [0, 3e-6, 0, 0, 0, 0, 0, 0, 0, 0, 0], None, "X", "X", 0.0)

    encoded = encode(table, interval=2e-3)

    assert encoded.resampling_error == pytest.approx(3e-6, abs=ROUNDING)
    assert encoded.carried.positions.size == 6


def test_uneven_positions_are_resampled_through_the_reference():
    x = np.array([-1.5, 0.0, 1.0, 2.7]) * 1e-3
    table = CompensationTable(x, [2e-6, 0, 1e-6, 3e-6], None, "X", "X", 0.0)

    encoded = encode(table)

    p = encoded.carried.positions
    assert (np.abs(p).min(), p[0], p[-1]) == (0.0, -2e-3, 3e-3)
    assert encoded.resampling_error > 0.0


def test_spacing_below_the_input_increment_is_refused():
    table = CompensationTable([0.0, 1.5e-6], [0, 0], None, "X", "X", 0.0)

    with pytest.raises(TableError, match="not a multiple of 1"):
        encode(table)


def test_interval_too_small_for_the_rapid_traverse_is_refused():
    """15 m/min over 7500 is 2 mm."""
    table = CompensationTable(np.arange(5) * 1e-3, np.zeros(5), None, "X", "X", 0.0)

    with pytest.raises(LimitError, match=r"interval 1 mm is below 2 mm"):
        encode(table, rapid="15 m/min")
    encode(table, rapid="7.5 m/min")


def test_numbers_beyond_the_last_are_refused():
    with pytest.raises(LimitError, match="reference_number"):
        encode(manual_table(), reference_number=1020)
    with pytest.raises(LimitError, match="reference_number"):
        encode(manual_table(), reference_number=3)


def test_file_of_the_control_needs_its_facts(tmp_path):
    bare = HAND.replace(HEAD, "%\n").encode()

    with pytest.raises(DataError, match="detection_unit"):
        decode(bare)
    table = decode(
        bare, detection_unit=1e-6, increment=1e-6, reference_position=0.0, entry_sign=-1
    )
    np.testing.assert_allclose(table.forward, np.array(MANUAL_CURVE) * 1e-6, atol=ROUNDING, rtol=0)


def test_facts_of_the_dialect():
    info = Fanuc.info

    assert (info.sign, info.directions, info.spacing) == ("unconfirmed", "one", "uniform")
    assert all(info.activation)
    assert info.page == "fanuc"


def test_table_of_another_axis_is_refused(tmp_path):
    """Pitch error shifts the axis it looks up: X -> Z would shift X by what Z needs."""
    cross = CompensationTable([0.0, 1e-3], [0, 1e-6], None, "X", "Z", 0.0)

    with pytest.raises(TableError, match=r"X -> Z.*controller='fanuc-straightness'"):
        encode(cross)
    path = tmp_path / "x.txt"
    path.write_text(HAND)
    path.with_name("x.txt.json").write_text('{"table": {"axis": "X", "compensates": "Z"}}')
    with pytest.raises(CorruptFileError, match="X -> Z"):
        controllers.read(path, "fanuc")


@pytest.mark.parametrize(
    "option",
    [
        {"entry_sign": 1},
        {"detection_unit": 1e-5},
        {"increment": 1e-5},
        {"reference_position": 1e-3},
        {"magnification": 2},
        {"reference_number": 41},
    ],
)
def test_option_that_contradicts_the_file_is_refused(tmp_path, option):
    (name,) = option
    with pytest.raises(DataError, match=rf"the file says {name}=.*you say"):
        decode(HAND.encode(), **option)
    path = tmp_path / "x.txt"
    path.write_text(HAND)
    path.with_name("x.txt.json").write_text(json.dumps({"options": option}))
    with pytest.raises(DataError, match=rf"the file says {name}="):
        controllers.read(path, "fanuc")


def test_option_that_agrees_with_the_file_is_taken():
    same = {"entry_sign": -1, "detection_unit": 0.001 * 1e-3, "reference_number": 40}

    np.testing.assert_array_equal(
        decode(HAND.encode(), **same).forward, decode(HAND.encode()).forward
    )


def test_interval_beyond_the_table_is_refused():
    for interval in (1.0, 100.0):
        with pytest.raises(LimitError, match=r"larger than the table, which spans 800 mm"):
            encode(manual_table(), interval=interval)


def test_way_out_of_a_reference_that_is_no_position_works():
    """Between -3 and 4 mm the chord of 0.1 x^2 misses the zero; a position there is exact."""

    def error(x):
        return 0.1 * np.asarray(x) ** 2

    p = np.array([-20, -7, -3, 4, 9, 15, 30]) * 1e-3
    with pytest.raises(TableError, match=r"make the table with reference=.* as an entry of it"):
        encode(CompensationTable.from_error(error, positions=p, axis="X", reference=0.0))

    more = CompensationTable.from_error(
        error, positions=np.union1d(p, 0.0), axis="X", reference=0.0
    )
    assert encode(more, largest=127).carried.positions.size > 7


@pytest.mark.parametrize(("x", "c"), [(1e5, 1e-6), (1e-3, 1e6), (1e-3, 1e300)])
def test_numbers_that_no_word_holds_are_refused_with_their_entry(x, c):
    with pytest.raises(LimitError, match=r"of entry 1 exceeds") as caught:
        encode(CompensationTable([0.0, x], [0, c], None, "X", "X", 0.0))
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("unit", [1e-300, 1e300])
def test_detection_unit_that_no_machine_has_is_refused(unit):
    with pytest.raises(DataError, match="detection_unit"):
        encode(manual_table(), detection_unit=unit)


def test_files_of_earlier_versions_are_read():
    old = HAND.replace(" - MADE BY METROSEP", "")
    assert old != HAND
    assert np.array_equal(decode(old.encode()).forward, decode(HAND.encode()).forward)


def test_file_on_the_page_is_whole(repository):
    page = (repository / "docs" / "controllers" / "fanuc.md").read_text("utf-8")
    block = re.search(r"```text\n(.*?)```", page, re.DOTALL)[1]
    x = np.array([-10, 0, 10, 20]) * 1e-3
    table = CompensationTable(x, np.array([1, 0, -2, 0]) * 1e-6, None, "X", "X", 0.0)

    assert encode(table).data.decode() == block


# ---- both directions: 3605 bit 0, 3626, 3627 (report A-77810E) --------------------------------------


def walk_back(data, position_mm, *, unit_um, detection_um):
    """Output (um) for travel in - direction: 3627 at the reference, then the second list, - side to + side.

    Point 3626 is the most distant one on the - side, as 3621 is of the first list; increments of both
    lists belong to the section below their point and are seen walking up.
    """
    word = {}
    for line in data.decode().splitlines()[1:-1]:
        name, value = line.split("P")
        word[int(name[1:].split("A")[0])] = int(value)
    step = word[3624] * 1e-3
    output = word[3627] * detection_um
    for i in range(word[3622] - word[3621] + 1):
        above = word[3621] + i - word[3620]  # number of the section above the reference
        low, high = (above - 1) * step, above * step
        pulses = word[10000 + word[3626] + i] * word[3623] * unit_um
        if above >= 1:
            output += pulses * min(max((position_mm - low) / step, 0.0), 1.0)
        else:
            output -= pulses * min(max((high - position_mm) / step, 0.0), 1.0)
    return output


def both_ways():
    x = np.arange(-40, 61, 10) * 1e-3
    forward = 6e-6 * np.sin(x / 23e-3) + 2e-6 * (1 - np.cos(x / 15e-3))
    reverse = forward - 1.37e-6 + 8e-6 * x / 0.06 * np.cos(x / 31e-3)
    return CompensationTable(x, forward, reverse, "X", "X", 0.0, is_exact_inverse=True)


@pytest.mark.parametrize(("magnification", "extra"), [(1, {}), (2, {"reverse_number": 900})])
def test_lists_of_both_directions_over_the_whole_travel(tmp_path, magnification, extra):
    made, path = both_ways(), tmp_path / "x.txt"
    options = {"detection_unit": "100 nm", "largest": 127, "magnification": magnification, **extra}
    controllers.write(
        made, path, "fanuc", bidirectional=True, sign_confirmed=True, allow_unverified=True,
        reference_number=20, increment="1 um", **options,
    )  # fmt: skip
    unit = 1e-7 * magnification
    data, lookup = path.read_bytes(), controllers.simulate(path, "fanuc")

    for mm in np.linspace(-55, 75, 131):
        ahead, back = (made.correction(mm * 1e-3, d)[0] for d in (1, -1))
        seen = walk(data, mm, unit_um=0.1) * 1e-6
        seen_back = 1e-6 * walk_back(data, mm, unit_um=0.1, detection_um=0.1)
        half = 0.5 * unit * (1 + 1e-6)
        assert abs(seen - ahead) <= half
        assert abs(seen_back - back) <= half
        assert abs(float(lookup(mm * 1e-3, 1)) - ahead) <= half
        assert abs(float(lookup(mm * 1e-3, -1)) - back) <= half


def bidirectional(**given):
    return encode(both_ways(), bidirectional=True, detection_unit=1e-7, largest=127, **given)


def test_lost_motion_at_the_reference_stands_in_3627_with_its_sign():
    """c_rev - c_fwd = -1.37 um there: -14 units of 0.1 um, of the correction (k = -1)."""
    text = bidirectional(reference_number=20).data.decode()
    assert "N3627A1P-14\n" in text
    assert "N3626A1P27\n" in text  # points 17 to 26 are those of the first list
    other = bidirectional(reference_number=20, entry_sign=1).data.decode()
    assert "N3627A1P14\n" in other
    assert "N3605" not in text  # its other bits belong to the machine


def test_what_the_file_cannot_set_is_a_reminder():
    text = " ".join(f"{f.problem} {f.fix}" for f in bidirectional().findings)
    assert "bit 0 of 3605" in text
    assert "1851 to 0" in text
    assert "trial table in both directions" in text


def test_two_directions_need_points_of_their_own():
    with pytest.raises(LimitError, match=r"overlap: points 17 to 26 and 26 to 35"):
        bidirectional(reference_number=20, reverse_number=26)
    with pytest.raises(LimitError, match=r"points 1020 to 1029 leave 0 to 1023"):
        bidirectional(reverse_number=1020)
    with pytest.raises(TableError, match="bidirectional=True"):
        encode(both_ways(), detection_unit=1e-7)
    with pytest.raises(TableError, match="reverse_number= is for"):
        encode(manual_table(), reverse_number=900)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("N3626A1P27", "N3626A1P26", "as many from 26"),
        ("N3627A1P", "N3628A1P", "one N...P... a line"),
        ("N3626A1P27\n", "", "parameter 3626 is missing"),
        ("N10036P", "N10037P", "each number once|do not run"),
    ],
)
def test_damaged_lists_of_both_directions_are_refused(old, new, words):
    text = bidirectional(reference_number=20).data.decode()
    assert old in text
    with pytest.raises(CorruptFileError, match=words):
        decode(text.replace(old, new, 1).encode())


def test_a_trial_shows_both_directions(tmp_path):
    """The bump is 0.3 as high in - direction: swapped lists are seen on the machine."""
    trial = trial_table(both_ways(), 5e-6)
    path = tmp_path / "t.txt"
    controllers.write(
        trial, path, "fanuc", bidirectional=True, detection_unit="100 nm", largest=127
    )
    peak = trial.position * 1e3
    assert walk(path.read_bytes(), peak, unit_um=0.1) == pytest.approx(5.0, rel=0, abs=0.05)
    back = walk_back(path.read_bytes(), peak, unit_um=0.1, detection_um=0.1)
    assert back == pytest.approx(1.5, rel=0, abs=0.05)
    assert json.loads((tmp_path / "t.txt.json").read_text())["trial"] is not None


def test_wrong_sign_of_the_second_list_is_refused(tmp_path):
    """A table whose lost motion has the wrong sign makes the - direction worse."""
    right = both_ways()
    mirrored = CompensationTable(
        right.positions, right.forward, 2 * right.forward - right.reverse, "X", "X", 0.0
    )
    x = np.linspace(-40e-3, 60e-3, 401)
    runs = RunSet(
        [
            Run(
                x if d > 0 else x[::-1],
                -right.correction(x if d > 0 else x[::-1], d),
                run_id=str(d),
            )
            for d in (1, -1)
        ]
    )
    options = {"bidirectional": True, "detection_unit": "100 nm", "largest": 127}
    with pytest.raises(SignCheckFailedError):
        controllers.write(
            mirrored,
            tmp_path / "x.txt",
            "fanuc",
            verified_against=runs,
            sign_confirmed=True,
            **options,
        )
    assert list(tmp_path.iterdir()) == []


class TestFanuc(DialectContract):
    name = "fanuc"
    hand = HAND
    lines = (
        "",
        "N1",
        "N10099P1",
        "N10034P1,5",
        "N10034P 1",
        "N10034P1e0",
    )
    damage = (
        ("N3623A1P1\n", "N3623A1P0\n"),
        ("N3624A1P50000\n", "N3624A1P0\n"),
        ("N3624A1P50000\n", "N3624A1P-5\n"),
        ("N3620A1P40\n", "N3620A1P99\n"),
        ("N3620A1P40\n", "N3620A2P40\n"),
        ("N3622A1P48\n", "N3622A1P47\n"),
        ("N3621A1P33\n", "N3621A1P49\n"),
        ("N10033P2\n", "N10033P2\nN10033P2\n"),
        ("N10033P2\n", "N10033P128\n"),
        ("N10033P2\n", "N10033A1P2\n"),
        ("N10033P2\n", "N10033P2\x00\n"),
    )

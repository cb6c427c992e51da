"""Writing: dry-run of the very bytes, refusals, sidecar, and nothing left when it fails."""

import dataclasses
import errno
import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet, controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.base import keep_old, kept_files
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    WriteError,
)

QUANTUM = 1e-13
"""Ten decimals of mm, half a step on position and entry."""
BOTH = pytest.mark.parametrize("controller", ["linuxcnc", "csv"])


def names_in(folder):
    return sorted(p.name for p in folder.iterdir())


def test_names_and_descriptions_agree():
    assert controllers.names()[:2] == ("linuxcnc", "csv")
    assert tuple(d.id for d in controllers.describe()) == controllers.names()
    assert controllers.describe()[0].max_points == 256


@BOTH
def test_written_table_is_simulated_with_place_and_sign(tmp_path, table, bump, controller):
    """+3 um at 12 mm, -1 um at 20 mm, nothing at 38 mm (the mirror of 12): nothing may move."""
    path = tmp_path / "x.tab"

    controllers.write(table, path, controller, allow_unverified=True)

    lookup = controllers.simulate(path, controller)
    x = np.array([5e-3, 12e-3, 20e-3, 38e-3])
    np.testing.assert_allclose(lookup(x, 1), -bump(x), atol=3e-9, rtol=0)
    np.testing.assert_allclose(lookup(x, -1), -bump(x) - 0.7e-6, atol=3e-9, rtol=0)
    assert lookup(12e-3, 1) < -2.9e-6
    assert lookup(20e-3, 1) > 0.9e-6


@BOTH
def test_corrected_axis_is_straight_and_the_wrong_sign_doubles(tmp_path, table, bump, controller):
    controllers.write(table, tmp_path / "x.tab", controller, allow_unverified=True)
    lookup = controllers.simulate(tmp_path / "x.tab", controller)
    x = np.linspace(0.0, 50e-3, 3001)

    after = bump(x + lookup(x, 1)) + lookup(x, 1)
    wrong = bump(x - lookup(x, 1)) - lookup(x, 1)

    # 0.5 mm between entries, |e''| = 2 x 3 um / (3 mm)^2: |e''| h^2/8 = 21 nm, twice for P-V
    assert np.ptp(after) < 50e-9
    assert np.ptp(wrong) == pytest.approx(2 * np.ptp(bump(x)), rel=0.02, abs=0.0)


@BOTH
def test_simulator_broadcasts_and_clamps(tmp_path, table, controller):
    controllers.write(table, tmp_path / "x.tab", controller, allow_unverified=True)
    lookup = controllers.simulate(tmp_path / "x.tab", controller)

    grid = lookup(np.array([[0.0], [12e-3]]), np.array([1, -1]))
    assert grid.shape == (2, 2)
    assert lookup(9.0, 1) == lookup(50e-3, 1)
    assert lookup(-9.0, -1) == lookup(0.0, -1)
    with pytest.raises(DataError, match="direction"):
        lookup(0.0, 0)


@BOTH
def test_dry_run_is_returned_and_recorded(tmp_path, table, measured, controller):
    result = controllers.write(table, tmp_path / "x.tab", controller, verified_against=measured)

    sidecar = json.loads((tmp_path / "x.tab.json").read_text())
    assert result.after_pv < 0.02 * result.before_pv
    assert sidecar["verification"]["passed"] is True
    assert sidecar["verification"]["residuals"][0]["after_pv_m"] == result.residuals[0].after_pv


@BOTH
def test_sidecar_says_sign_units_source_and_hash(tmp_path, table, controller):
    path = tmp_path / "x.tab"
    controllers.write(table, path, controller, allow_unverified=True)

    text = (tmp_path / "x.tab.json").read_text()

    sidecar = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert sidecar["file_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert "mm" in sidecar["units"]
    assert "e" in sidecar["entry"]
    assert "c = -e" in sidecar["table"]["sign"]
    assert sidecar["table"]["source_sha256"] == ["ab" * 32]
    assert sidecar["table"]["reference_m"] == 0.0
    assert sidecar["controller"] == controller
    assert sidecar["verification"] == "waived by the user"
    assert sidecar["quantisation_m"] <= QUANTUM * 1.01
    assert names_in(tmp_path) == ["x.tab", "x.tab.json"]


def test_same_table_gives_the_same_bytes(tmp_path, table, measured):
    for name in ("a.comp", "b.comp"):
        controllers.write(table, tmp_path / name, verified_against=measured)

    assert (tmp_path / "a.comp").read_bytes() == (tmp_path / "b.comp").read_bytes()
    assert (tmp_path / "a.comp.json").read_bytes() == (tmp_path / "b.comp.json").read_bytes()


@BOTH
def test_unverified_table_is_refused(tmp_path, table, controller):
    table = dataclasses.replace(table, source=None)
    with pytest.raises(SignCheckFailedError, match=r"verified_against.*allow_unverified"):
        controllers.write(table, tmp_path / "x.tab", controller)
    assert names_in(tmp_path) == []


@BOTH
def test_wrong_sign_is_refused_even_if_a_waiver_is_given(tmp_path, table, measured, controller):
    with pytest.raises(SignCheckFailedError, match=r"x\.tab.*reversed sign.*nothing was written"):
        controllers.write(
            table.negated(),
            tmp_path / "x.tab",
            controller,
            verified_against=measured,
            allow_unverified=True,
        )
    assert names_in(tmp_path) == []


def test_table_of_the_mirrored_axis_is_refused(tmp_path, table, bump):
    x = np.linspace(0.0, 50e-3, 2001)

    with pytest.raises(SignCheckFailedError):
        controllers.write(table, tmp_path / "x.comp", verified_against=Profile(x, bump(50e-3 - x)))
    assert names_in(tmp_path) == []


def test_reverse_runs_are_judged_by_the_reverse_column(tmp_path, table, bump):
    x = np.linspace(50e-3, 0.0, 2001)
    back = RunSet([Run(x, bump(x), feed=0.1, run_id=f"r{i}") for i in range(3)])
    p = table.positions
    wrong = CompensationTable(p, table.forward, -table.reverse, "X", "X", 0.0)

    controllers.write(table, tmp_path / "x.comp", verified_against=back)
    with pytest.raises(SignCheckFailedError, match="reversed sign"):
        controllers.write(wrong, tmp_path / "y.comp", verified_against=back)


@BOTH
def test_existing_file_is_refused_and_overwritten_on_demand(tmp_path, table, controller):
    path = tmp_path / "x.tab"
    path.write_text("mine")

    with pytest.raises(WriteError, match="exists already"):
        controllers.write(table, path, controller, allow_unverified=True)
    assert path.read_text() == "mine"
    assert names_in(tmp_path) == ["x.tab"]

    controllers.write(table, path, controller, allow_unverified=True, overwrite=True)
    assert controllers.read(path, controller).positions.size == 101
    assert (tmp_path / "x.tab.1").read_text() == "mine"
    assert not (tmp_path / "x.tab.1.json").exists()


@BOTH
def test_the_same_bytes_are_left_and_others_keep_the_old_pair(tmp_path, table, controller):
    path, beside = tmp_path / "x.tab", tmp_path / "x.tab.json"
    controllers.write(table, path, controller, allow_unverified=True)
    first = path.read_bytes(), beside.read_bytes()
    stamp = path.stat().st_mtime_ns

    controllers.write(table, path, controller, allow_unverified=True)
    assert path.stat().st_mtime_ns == stamp
    other = table.negated()
    with pytest.raises(WriteError, match="exists already"):
        controllers.write(other, path, controller, allow_unverified=True)
    assert (path.read_bytes(), beside.read_bytes()) == first
    assert names_in(tmp_path) == ["x.tab", "x.tab.json"]

    controllers.write(other, path, controller, allow_unverified=True, overwrite=True)
    kept = tmp_path / "x.tab.1", tmp_path / "x.tab.1.json"
    assert tuple(f.read_bytes() for f in kept) == first
    assert path.read_bytes() != first[0]


def test_foreign_file_at_the_place_of_the_sidecar_is_kept(tmp_path, table):
    (tmp_path / "x.comp.json").write_text("{}")

    with pytest.raises(WriteError, match=r"x\.comp\.json: exists already"):
        controllers.write(table, tmp_path / "x.comp", allow_unverified=True)
    assert (tmp_path / "x.comp.json").read_text() == "{}"
    assert names_in(tmp_path) == ["x.comp.json"]


@BOTH
def test_missing_folder_is_refused(tmp_path, table, controller):
    with pytest.raises(WriteError, match="does not exist"):
        controllers.write(table, tmp_path / "no" / "x.tab", controller, allow_unverified=True)
    assert names_in(tmp_path) == []


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_is_refused(tmp_path, table):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(WriteError, match="cannot be written"):
            controllers.write(table, tmp_path / "x.comp", allow_unverified=True)
        assert names_in(tmp_path) == []
    finally:
        tmp_path.chmod(0o700)


def test_refused_permission_is_one_sentence(tmp_path, table, monkeypatch):
    """The same for root, who is never refused: the system call says no."""

    def denied(*_, **__):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "open", denied)

    with pytest.raises(WriteError, match=r"Permission denied.*choose a folder") as caught:
        controllers.write(table, tmp_path / "x.comp", allow_unverified=True)
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == []


def test_folder_in_place_of_the_file_is_refused(tmp_path, table):
    (tmp_path / "x.comp").mkdir()

    with pytest.raises(WriteError, match="is a folder"):
        controllers.write(table, tmp_path / "x.comp", allow_unverified=True, overwrite=True)
    assert names_in(tmp_path) == ["x.comp"]


def test_impossible_name_is_refused(tmp_path, table):
    with pytest.raises(WriteError, match="cannot be written"):
        controllers.write(table, tmp_path / ("x" * 300), allow_unverified=True)
    assert names_in(tmp_path) == []


def no_room(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("old", [True, False])
def test_full_disk_leaves_what_was_there(tmp_path, table, monkeypatch, call, old):
    path = tmp_path / "x.comp"
    if old:
        controllers.write(table, path, allow_unverified=True)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    monkeypatch.setattr(os, call, no_room)

    with pytest.raises(WriteError, match="No space left") as caught:
        controllers.write(table.negated(), path, allow_unverified=True, overwrite=True)

    assert "\n" not in str(caught.value)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize("old", [True, False])
def test_disk_that_fills_between_sidecar_and_table(tmp_path, table, monkeypatch, old):
    """The sidecar is in place when the table fails: it must not stay without its table."""
    path = tmp_path / "x.comp"
    if old:
        controllers.write(table, path, allow_unverified=True)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    true_replace = Path.replace

    def replace(self, target):
        return no_room() if Path(target).name == "x.comp" else true_replace(self, target)

    monkeypatch.setattr(Path, "replace", replace)

    with pytest.raises(WriteError, match="No space left"):
        controllers.write(table.negated(), path, allow_unverified=True, overwrite=True)

    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_limit_of_the_machine_is_refused(tmp_path, table):
    with pytest.raises(LimitError, match="stroke"):
        controllers.write(table, tmp_path / "x.comp", allow_unverified=True, stroke=1e-6)
    assert names_in(tmp_path) == []


def test_dead_zone_of_the_controller_is_recorded(tmp_path, table):
    """0.7 um lost motion lies in 0.5 ... 1 um, where a = 2 m/s2 and T = 1 ms get stuck."""
    controllers.write(
        table, tmp_path / "x.comp", allow_unverified=True, acceleration=2.0, servo_period=1e-3
    )

    (finding,) = json.loads((tmp_path / "x.comp.json").read_text())["findings"]
    assert finding["level"] == "warning"
    assert "never executes" in finding["problem"]


@BOTH
def test_unknown_limit_is_refused(tmp_path, table, controller):
    with pytest.raises(DataError, match=r"unknown machine limit.*colour"):
        controllers.write(table, tmp_path / "x.tab", controller, allow_unverified=True, colour=3)


def test_unknown_controller_is_refused(tmp_path, table):
    for use in (
        lambda: controllers.write(table, tmp_path / "x", "fanuk", allow_unverified=True),
        lambda: controllers.read(tmp_path / "x", "fanuk"),
        lambda: controllers.simulate(tmp_path / "x", "fanuk"),
    ):
        with pytest.raises(DataError, match=r"'fanuk'; there are 'linuxcnc', 'csv'"):
            use()


@BOTH
@pytest.mark.parametrize(
    "sidecar",
    [
        "{",
        "[]",
        '"x"',
        '{"table": 5}',
        '{"table": {"axis": 5}}',
        '{"table": {"reference_m": "0 mm"}}',
        "\x00\x01",
    ],
)
def test_damaged_sidecar_is_named(tmp_path, table, controller, sidecar):
    path = tmp_path / "x.tab"
    controllers.write(table, path, controller, allow_unverified=True)
    (tmp_path / "x.tab.json").write_text(sidecar)

    with pytest.raises(CorruptFileError, match=r"x\.tab\.json"):
        controllers.read(path, controller)


@BOTH
def test_file_without_a_sidecar_still_reads(tmp_path, table, controller):
    path = tmp_path / "x.tab"
    controllers.write(table, path, controller, allow_unverified=True)
    (tmp_path / "x.tab.json").unlink()

    told = {"linear_units": "mm"} if controller == "linuxcnc" else {}  # the file has no unit
    back = controllers.read(path, controller, **told)

    np.testing.assert_allclose(back.forward, table.forward, atol=QUANTUM * 1.01, rtol=0)
    assert back.axis == "X"


@BOTH
def test_table_that_was_read_is_written_to_the_same_bytes(tmp_path, table, controller):
    controllers.write(table, tmp_path / "a.tab", controller, allow_unverified=True)

    again = controllers.read(tmp_path / "a.tab", controller)
    controllers.write(again, tmp_path / "b.tab", controller, allow_unverified=True)

    assert (tmp_path / "a.tab").read_bytes() == (tmp_path / "b.tab").read_bytes()


def test_files_that_were_kept_are_found_again_in_their_order(tmp_path):
    file = tmp_path / "x [1].comp"
    for k in range(11):
        file.unlink(missing_ok=True)  # what is kept is a link, and no table is written in place
        file.write_text(f"{k}\n")
        keep_old(file)
    (tmp_path / "x [1].comp.1.json").write_text("{}")
    (tmp_path / "x 1.comp.1").write_text("of another table")

    assert [f.read_text() for f in kept_files(file)] == [f"{k}\n" for k in range(11)]

"""A compensation table on a real controller: LinuxCNC loads it, moves, and tells what it applied.

Type 0 lists where the axis really arrives, so LinuxCNC applies nominal - actual = -e, which is
metrosep's correction c. Nothing here is simulated except the slide behind the motor.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from metrosep import controllers
from metrosep.compensation import CompensationTable, dead_zone
from metrosep.core.errors import CorruptFileError, LimitError
from metrosep.core.runset import Run, RunSet

pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        shutil.which("linuxcnc") is None,
        reason="LinuxCNC is not installed: bash tests/acceptance/linuxcnc/install.sh",
    ),
]

RUN = Path(__file__).with_name("run.py")
LIMIT_S = 100.0  # of one LinuxCNC session; the longest takes about 25 s

MM = 1e-3  # m
UM = 1e-3  # mm
# The trim is frozen one servo period before the axis stops: slope * a * T^2 = 2e-3 * 1e3 * 1e-6 mm.
# (controllers.md asks for 2e-5; most of the deviation seen there was the rounding of getp.)
TOLERANCE_MM = 2e-6
RESIDUAL_MM = 2e-5  # e * e' of the sign-flipped table (7 um * 2e-3), which the exact one has not
PRINTED_DIGITS = 7  # of halcmd getp

SEED = 20260214
N_POINTS = 256  # as many as LinuxCNC takes
N_TARGETS = 90

HAND_TABLE = """\
-10 -9.998 -9.9975
0 0 0.0005
10 9.997 9.9975
20 20.004 20.0045
"""
# Target in mm in the order of visit (so the sign of the step is the direction), nominal - actual in um.
HAND_EXPECTED = (
    (-20, -2.5),
    (-5, -1.0),
    (5, 1.5),
    (10, 3.0),
    (15, -0.5),
    (20, -4.0),
    (30, -4.0),
    (15, -1.0),
    (10, 2.5),
    (5, 1.0),
    (0, -0.5),
)


def launch(table: Path, targets_mm, limit_s: float = LIMIT_S) -> subprocess.CompletedProcess:
    """Run LinuxCNC with `table`; results lie beside the table."""
    targets = table.with_suffix(".targets.json")
    targets.write_text(json.dumps([float(target) for target in targets_mm]))
    output = table.with_suffix(".result.json")
    return subprocess.run(
        [sys.executable, RUN, table, targets, "-o", output, "--limit", f"{limit_s}"],
        capture_output=True,
        text=True,
        check=False,
        timeout=2 * limit_s + 20,  # it may wait as long for another run
    )


def visit(table: Path, targets_mm) -> dict:
    """What LinuxCNC did at the targets."""
    done = launch(table, targets_mm)
    assert done.returncode == 0, done.stderr
    return json.loads(table.with_suffix(".result.json").read_text())


def offsets_mm(result: dict) -> np.ndarray:
    """Offsets applied by LinuxCNC (motor-pos-cmd - pos-cmd), mm."""
    return np.array([reading["offset_mm"] for reading in result["readings"]])


def looked_up_mm(table: Path, position_mm, direction) -> np.ndarray:
    """Trim that type 0 stands for, from the file alone: linear, constant beyond the ends, mm."""
    nominal, forward, reverse = np.loadtxt(table).T
    return np.where(
        np.asarray(direction) > 0,
        np.interp(position_mm, nominal, nominal - forward),
        np.interp(position_mm, nominal, nominal - reverse),
    )


class Slide:
    """Axis with a positioning error e = actual - nominal that differs by direction, mm.

    Rough, uneven, not symmetric in any sense, with a lost motion that varies from 0.8 to 2.2 um
    (clear of the 0.25 to 0.5 um that this machine's trim generator cannot follow from rest). No
    slope exceeds 2.5e-3.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        position = np.linspace(-40.0, 60.0, N_POINTS) + rng.uniform(-0.12, 0.12, N_POINTS)
        self.reference = 102
        position[self.reference] = 0.0
        forward = np.cumsum(rng.normal(0.03, 0.15, N_POINTS)) * UM
        self.position = position
        self.forward = forward - forward[self.reference]
        self.reverse = self.forward + (1.5 + 0.7 * np.sin(0.21 * position)) * UM

    def error(self, position_mm, direction) -> np.ndarray:
        """e of the slide when its motor stands at `position_mm`, reached in `direction`."""
        return np.where(
            np.asarray(direction) > 0,
            np.interp(position_mm, self.position, self.forward),
            np.interp(position_mm, self.position, self.reverse),
        )

    def measured(self) -> RunSet:
        """Three passes in each direction over the knots, SI: one does not show a slope."""
        back = slice(None, None, -1)
        both = [
            Run(self.position * MM, self.forward * MM),
            Run(self.position[back] * MM, self.reverse[back] * MM),
        ]
        return RunSet(3 * both)

    def residual(self, target_mm, direction, offset_mm) -> np.ndarray:
        """Actual minus nominal when the motor is sent to target + offset."""
        return offset_mm + self.error(target_mm + offset_mm, direction)

    def targets(self) -> np.ndarray:
        """Knots, mid-points, both ends and beyond them, forward and then back."""
        middle = (self.position[1:] + self.position[:-1]) / 2
        some = np.concatenate([self.position, middle])[:: 4 * N_POINTS // N_TARGETS]
        beyond = self.position[0] - 7.0, self.position[-1], self.position[-1] + 9.0
        way = np.sort(np.concatenate([some, beyond]))
        return np.concatenate([way, way[::-1][1:]])


def way_of(result: dict) -> tuple[np.ndarray, np.ndarray]:
    """Targets in mm and directions of approach."""
    readings = result["readings"]
    return (
        np.array([reading["target_mm"] for reading in readings]),
        np.array([reading["direction"] for reading in readings]),
    )


@pytest.fixture(scope="module")
def slide() -> Slide:
    return Slide(np.random.default_rng(SEED))


@pytest.fixture(scope="module")
def written(slide: Slide, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table of the slide, made and written by metrosep."""
    table = CompensationTable.from_error(
        lambda x: slide.error(x / MM, 1) * MM,
        reverse=lambda x: slide.error(x / MM, -1) * MM,
        positions=slide.position * MM,
        axis="X",
        direction="split",
        reference=0.0,
    )
    path = tmp_path_factory.mktemp("linuxcnc") / "x.comp"
    controllers.write(table, path, controller="linuxcnc", verified_against=slide.measured())
    return path


@pytest.fixture(scope="module")
def compensated(slide: Slide, written: Path) -> dict:
    """The slide's machine with metrosep's table, visited in both directions."""
    return visit(written, slide.targets())


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> dict:
    table = tmp_path_factory.mktemp("linuxcnc") / "hand.comp"
    table.write_text(HAND_TABLE)
    return visit(table, [target for target, _ in HAND_EXPECTED])


def test_hand_written_table_is_applied_as_nominal_minus_actual(by_hand):
    expected = np.array([offset for _, offset in HAND_EXPECTED]) * UM

    np.testing.assert_allclose(offsets_mm(by_hand), expected, rtol=0, atol=TOLERANCE_MM)


def test_nothing_is_applied_before_the_first_move(by_hand):
    pins = by_hand["before_first_move"]["pins_mm"]

    assert pins["motor-pos-cmd"] == pins["pos-cmd"] == 0.0


def test_offset_is_the_compensation_and_not_the_homing_offset(by_hand):
    for reading in by_hand["readings"]:
        pins = reading["pins_mm"]
        assert pins["motor-offset"] == 0.0
        assert pins["backlash-filt"] == pytest.approx(reading["offset_mm"], rel=0, abs=1e-9)


def test_command_line_tool_reports_the_same_positions(by_hand):
    for reading in by_hand["readings"]:
        for pin, printed in reading["printed_mm"].items():
            assert printed == float(f"{reading['pins_mm'][pin]:.{PRINTED_DIGITS}g}")


def test_table_written_by_metrosep_loads_without_a_message(compensated):
    assert compensated["messages"] == []


def test_controller_applies_what_metrosep_simulates(written, compensated, record_property):
    targets, directions = way_of(compensated)
    simulated = controllers.simulate(written, controller="linuxcnc")
    expected = (
        np.where(directions > 0, simulated(targets * MM, 1), simulated(targets * MM, -1)) / MM
    )

    deviation = np.abs(offsets_mm(compensated) - expected)

    record_property("max_deviation_mm", float(deviation.max()))
    print(f"{deviation.size} readings, largest deviation {deviation.max():.2e} mm")
    assert np.count_nonzero(directions > 0) >= 40
    assert np.count_nonzero(directions < 0) >= 40
    assert deviation.max() <= TOLERANCE_MM


def test_controller_applies_what_the_file_says(written, compensated):
    targets, directions = way_of(compensated)

    expected = looked_up_mm(written, targets, directions)

    np.testing.assert_allclose(offsets_mm(compensated), expected, rtol=0, atol=TOLERANCE_MM)


def test_table_removes_the_error_of_the_slide(slide, compensated, record_property):
    targets, directions = way_of(compensated)
    raw = np.abs(slide.error(targets, directions)).max()

    residual = np.abs(slide.residual(targets, directions, offsets_mm(compensated))).max()

    record_property("raw_and_residual_mm", (float(raw), float(residual)))
    print(f"raw error {raw:.2e} mm, residual {residual:.2e} mm")
    assert raw > 5 * UM
    assert residual <= RESIDUAL_MM


def test_table_with_the_sign_flipped_doubles_the_error(slide, written, tmp_path):
    nominal, forward, reverse = np.loadtxt(written).T
    flipped = tmp_path / "flipped.comp"
    np.savetxt(flipped, np.column_stack([nominal, 2 * nominal - forward, 2 * nominal - reverse]))
    result = visit(flipped, slide.targets()[::7])
    targets, directions = way_of(result)

    residual = slide.residual(targets, directions, offsets_mm(result))

    doubled = 2 * slide.error(targets, directions)
    np.testing.assert_allclose(residual, doubled, rtol=0, atol=RESIDUAL_MM)


def long_table(path: Path, n: int) -> Path:
    """Table of `n` entries 1 mm apart, -1 um in each, -2 um in the 256th, -4 um after it."""
    error = [1, *[1] * 254, 2, *[4] * (n - 256)]
    rows = [
        f"{i - 128} {i - 128 + e * UM:.6f} {i - 128 + e * UM:.6f}" for i, e in enumerate(error)
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_256_entries_are_loaded(tmp_path):
    result = visit(long_table(tmp_path / "full.comp", 256), [100, 140])

    assert result["messages"] == []
    np.testing.assert_allclose(offsets_mm(result), [-1 * UM, -2 * UM], rtol=0, atol=TOLERANCE_MM)


def test_entry_257_is_refused_with_a_message_and_not_applied(tmp_path):
    result = visit(long_table(tmp_path / "over.comp", 257), [100, 140])

    assert "too many compensation entries" in " ".join(m["text"] for m in result["messages"])
    np.testing.assert_allclose(offsets_mm(result), [-1 * UM, -2 * UM], rtol=0, atol=TOLERANCE_MM)


def test_what_the_controller_drops_the_reader_refuses(tmp_path):
    header = tmp_path / "header.comp"
    header.write_text("# nominal forward reverse\n" + HAND_TABLE)

    with pytest.raises(LimitError, match=r"257 lines, LinuxCNC uses the first 256"):
        controllers.read(long_table(tmp_path / "over.comp", 257))
    with pytest.raises(CorruptFileError, match="line 1 is not three numbers"):
        controllers.read(header)


def test_a_header_line_silently_disables_the_table(tmp_path):
    table = tmp_path / "header.comp"
    table.write_text("# nominal forward reverse\n" + HAND_TABLE)

    result = visit(table, [20, 10])

    assert result["messages"] == []
    assert offsets_mm(result).tolist() == [0.0, 0.0]


@pytest.fixture(scope="module")
def lost_motion(tmp_path_factory: pytest.TempPathFactory):
    """Function of e forward and reverse in um: the table as read back, what LinuxCNC applied, um."""

    def tried(forward_um: float, reverse_um: float) -> tuple[CompensationTable, np.ndarray]:
        path = tmp_path_factory.mktemp("linuxcnc") / "lost_motion.comp"
        lines = [
            f"{p} {p + forward_um * UM:.7f} {p + reverse_um * UM:.7f}\n" for p in (-50.0, 50.0)
        ]
        path.write_text("".join(lines))
        result = visit(path, [10, 5, -5])
        return controllers.read(path, "linuxcnc", linear_units="mm"), offsets_mm(result) / UM

    return tried


@pytest.mark.parametrize(
    ("forward_um", "step_um", "is_applied"),
    # of 0.5 um the trims, kept as float32, make 0.49999985 um here; from 0 it would be 0.50000002
    [(0.0, 0.2, True), (0.0, 0.4, False), (2.0, 0.5, False), (0.0, 0.6, True)],
)
def test_reversal_step_in_the_dead_zone_is_never_applied(
    forward_um, step_um, is_applied, lost_motion
):
    # machine.ini: 1000 mm/s^2 and 1 ms. The window that metrosep warns of is what is stuck here.
    machine = {"acceleration": 1.0, "servo_period": 1e-3}

    table, offsets = lost_motion(forward_um, forward_um + step_um)

    low, high = dead_zone(**machine)
    findings = [f for f in table.limits(**machine) if f.check == "dead-zone"]
    back = -forward_um - step_um if is_applied else -forward_um
    assert offsets == pytest.approx([-forward_um, back, back], rel=0, abs=TOLERANCE_MM / UM)
    assert (low < step_um * 1e-6 <= high) != is_applied
    assert [f.level for f in findings] == ([] if is_applied else ["warning"])
    assert all("LinuxCNC never executes from rest" in f.problem for f in findings)


def test_missing_table_is_refused_at_once(tmp_path):
    done = launch(tmp_path / "absent.comp", [1.0])

    assert done.returncode == 4
    assert "absent.comp: no such compensation file" in done.stderr


def test_a_run_out_of_time_leaves_nothing_behind(tmp_path):
    table = tmp_path / "slow.comp"
    table.write_text(HAND_TABLE)

    done = launch(table, [10, -10] * 500, limit_s=15.0)  # it may take 5 s to begin

    assert done.returncode == 1
    assert "time limit reached" in done.stderr
    assert not table.with_suffix(".result.json").exists()
    assert not {"rtapi_app", "milltask", "linuxcncsvr"} & set(living_processes())


def living_processes() -> list[str]:
    """Names of the processes of this machine that are not dead."""
    names = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, state = stat.read_text().split("(", 1)[1].rsplit(")", 1)
        except OSError:
            continue  # it ended meanwhile
        if state.split()[0] != "Z":
            names.append(name)
    return names

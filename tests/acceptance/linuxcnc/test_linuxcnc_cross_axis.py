"""Straightness on a real controller: a table looked up along X moves Z, wired in HAL.

The wiring under test is the one that `metrosep.controllers.write` puts into the sidecar; only joint
numbers, ideal drives and encoders are added here. The encoders are read at the start of the servo
period and the drives written at its end, as with real hardware, and joint 0 homes to an offset.
Every following error above 1e-6 mm stops the machine.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.core.errors import TableError
from metrosep.core.runset import Run, RunSet

pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        shutil.which("linuxcnc") is None,
        reason="LinuxCNC is not installed: bash tests/acceptance/linuxcnc/install.sh",
    ),
]

HERE = Path(__file__).parent
LIMIT_S = 100.0  # of one LinuxCNC session; the longest takes about 15 s

MM = 1e-3  # m
UM = 1e-3  # mm
# The trim is frozen one servo period before the axis stops: slope * a * T^2 = 2e-3 * 1e3 * 1e-6 mm.
TOLERANCE_MM = 2e-6
FOLLOWING_MM = 1e-6  # limit of the controller in every servo period; 0.1 mm is one period of delay
ROUNDING_MM = 1e-12  # of sums of positions below 100 mm

SEED = 20260301
N_POINTS = 21
HOME_MM = 3.5  # where joint 0 says it stands after homing on the spot

PINS = (
    "joint.0.pos-fb",
    "joint.0.f-error",
    "joint.1.pos-cmd",
    "joint.1.motor-pos-cmd",
    "joint.1.pos-fb",
    "joint.1.f-error",
    "drive-a.out",
    "drive-b.out",
)

BEFORE_ROUTING = """\
loadrt scale names=encoder-a,encoder-b,drive-a,drive-b
setp encoder-a.gain 1
setp encoder-b.gain 1
setp drive-a.gain 1
setp drive-b.gain 1
addf encoder-a servo-thread
addf encoder-b servo-thread
"""
AFTER_ROUTING = """\
addf drive-a servo-thread
addf drive-b servo-thread
net a-drive => drive-a.in
net b-drive => drive-b.in
net a-position drive-a.out => encoder-a.in
net b-position drive-b.out => encoder-b.in
net a-fb encoder-a.out
net b-fb encoder-b.out
"""
REPLACED = ("net x-motor", "net z-motor", "addf motion-")  # by the routing, as it says itself


class Way:
    """Guideway of X: straightness error of Z (actual - nominal) that differs by direction, mm.

    Rough, uneven, not symmetric in any sense, with a lost motion that varies from 0.8 to 2.2 um
    (clear of the 0.25 to 0.5 um that this machine's trim generator cannot follow from rest).
    """

    def __init__(self, rng: np.random.Generator) -> None:
        position = np.linspace(-40.0, 60.0, N_POINTS) + rng.uniform(-1.5, 1.5, N_POINTS)
        position[8] = 0.0
        forward = np.cumsum(rng.normal(0.3, 1.2, N_POINTS)) * UM
        self.position = position
        self.forward = forward - forward[8]
        self.reverse = self.forward + rng.uniform(0.8, 2.2, N_POINTS) * UM

    def error(self, x_mm, direction) -> np.ndarray:
        """Deviation of Z from its command with X at `x_mm`, reached in `direction`."""
        return np.where(
            np.asarray(direction) > 0,
            np.interp(x_mm, self.position, self.forward),
            np.interp(x_mm, self.position, self.reverse),
        )

    def measured(self) -> RunSet:
        """Three passes in each direction over the knots, SI: one does not show a slope."""
        back = slice(None, None, -1)
        both = [
            Run(self.position * MM, self.forward * MM),
            Run(self.position[back] * MM, self.reverse[back] * MM),
        ]
        return RunSet(3 * both)

    def targets(self) -> list[list[float]]:
        """[X, Z]: X over all knots, mid-points and beyond both ends and back, Z elsewhere each time."""
        middle = (self.position[1:] + self.position[:-1]) / 2
        beyond = self.position[0] - 7.0, self.position[-1] + 9.0
        way = np.sort(np.concatenate([self.position, middle, beyond]))
        x = np.concatenate([way, way[::-1][1:]])
        z = 4.0 + 0.07 * x + 1.5 * (np.arange(x.size) % 3)
        return np.round(np.column_stack([x, z]), 9).tolist()


class Visit:
    """What LinuxCNC did, one value per target, mm."""

    def __init__(self, result: dict) -> None:
        readings = result["readings"]
        self.messages = result["messages"]
        self.before_first_move = result["before_first_move"]
        self.target_x = np.array([reading["target_mm"] for reading in readings])
        self.target_z = np.array([reading["target_z_mm"] for reading in readings])
        self.direction = np.array([reading["direction"] for reading in readings])
        self._pins = [
            {f"joint.0.{pin}": value for pin, value in reading["pins_mm"].items()}
            | reading["more_mm"]
            for reading in readings
        ]

    def __getitem__(self, pin: str) -> np.ndarray:
        """Values of a pin."""
        return np.array([pins[pin] for pins in self._pins])

    @property
    def correction(self) -> np.ndarray:
        """What the drive of Z was sent beyond the command of its joint."""
        return self["drive-b.out"] - self["joint.1.motor-pos-cmd"]

    def simulated(self, table: Path) -> np.ndarray:
        """What metrosep says that the file does."""
        correction = controllers.simulate(table, controller="linuxcnc")
        x = self.target_x * MM
        return np.where(self.direction > 0, correction(x, 1), correction(x, -1)) / MM

    def deviation(self, way: Way) -> np.ndarray:
        """Actual minus nominal Z of the machine on its guideway."""
        x = self["drive-a.out"] - self["joint.0.motor-offset"]
        return self["drive-b.out"] + way.error(x, self.direction) - self.target_z


def hal_of(table: Path) -> str:
    """machine.hal with the sidecar's wiring between the controller and ideal hardware."""
    routing = json.loads(Path(f"{table}.json").read_text())["hal_routing"]
    wired = "\n".join(routing).replace("joint.A", "joint.0").replace("joint.B", "joint.1")
    machine = (HERE / "machine.hal").read_text().splitlines(keepends=True)
    kept = "".join(line for line in machine if not line.startswith(REPLACED))
    return kept + BEFORE_ROUTING + wired + "\n" + AFTER_ROUTING


def strict_ini() -> str:
    """machine.ini with joint 0 homing to an offset and no following error allowed."""
    ini = (HERE / "machine.ini").read_text()
    ini = ini.replace("FERROR = 1000", f"FERROR = {FOLLOWING_MM:g}")
    before, joint_0 = ini.split("[JOINT_0]")
    home = f"HOME = {HOME_MM}\nHOME_OFFSET = {HOME_MM}\nHOME_SEQUENCE"
    return before + "[JOINT_0]" + joint_0.replace("HOME_SEQUENCE", home, 1)


def launch(table: Path, targets_mm, hal: str) -> subprocess.CompletedProcess:
    """Run LinuxCNC with `table` and the wiring `hal`; results lie beside the table."""
    targets, wiring, settings = (table.with_suffix(f".{kind}") for kind in ("json", "hal", "ini"))
    targets.write_text(json.dumps(targets_mm))
    wiring.write_text(hal)
    settings.write_text(strict_ini())
    command = [sys.executable, HERE / "run.py", table, targets, "--limit", f"{LIMIT_S:g}"]
    command += ["-o", table.with_suffix(".result.json"), "--hal", wiring, "--ini", settings]
    command += [word for pin in PINS for word in ("--pin", pin)]
    limit_s = 2 * LIMIT_S + 20  # it may wait as long for another run
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=limit_s)


def visit(table: Path, targets_mm, hal: str) -> Visit:
    """What LinuxCNC did at the targets."""
    done = launch(table, targets_mm, hal)
    assert done.returncode == 0, done.stdout + done.stderr
    return Visit(json.loads(table.with_suffix(".result.json").read_text()))


@pytest.fixture(scope="module")
def way() -> Way:
    return Way(np.random.default_rng(SEED))


@pytest.fixture(scope="module")
def table(way: Way) -> CompensationTable:
    """Corrections of Z along X, made by metrosep."""
    return CompensationTable.from_error(
        lambda x: way.error(x / MM, 1) * MM,
        reverse=lambda x: way.error(x / MM, -1) * MM,
        positions=way.position * MM,
        axis="X",
        compensates="Z",
        direction="split",
        reference=0.0,
    )


@pytest.fixture(scope="module")
def written(way: Way, table: CompensationTable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table and its wiring, written by metrosep."""
    path = tmp_path_factory.mktemp("cross") / "x-z.comp"
    controllers.write(
        table,
        path,
        controller="linuxcnc",
        verified_against=way.measured(),
        unknown="offset",  # against a known straightedge: the line of the way is known
        cross_axis="hal",
    )
    return path


@pytest.fixture(scope="module")
def compensated(way: Way, written: Path) -> Visit:
    """The machine with metrosep's table and wiring, visited in both directions."""
    return visit(written, way.targets(), hal_of(written))


@pytest.fixture(scope="module")
def flipped(way: Way, written: Path, tmp_path_factory: pytest.TempPathFactory) -> Visit:
    """The same wiring with the sign of the table's entries turned over."""
    path = tmp_path_factory.mktemp("cross") / "flipped.comp"
    nominal, forward, reverse = np.loadtxt(written).T
    np.savetxt(path, np.column_stack([nominal, 2 * nominal - forward, 2 * nominal - reverse]))
    return visit(path, way.targets()[::7], hal_of(written))


def test_wiring_loads_and_no_following_error_ever_exceeds_the_limit(compensated):
    assert compensated.messages == []


def test_homing_offset_is_planted_and_moves_neither_drive(compensated):
    at_rest = compensated.before_first_move

    assert at_rest["pins_mm"]["pos-cmd"] == HOME_MM
    assert at_rest["pins_mm"]["motor-offset"] == -HOME_MM
    assert at_rest["more_mm"]["drive-a.out"] == 0.0
    assert at_rest["more_mm"]["drive-b.out"] == 0.0


def test_z_gets_what_metrosep_simulates(written, compensated, record_property):
    deviation = np.abs(compensated.correction - compensated.simulated(written))

    record_property("max_deviation_mm", float(deviation.max()))
    print(f"{deviation.size} readings, largest deviation {deviation.max():.2e} mm")
    assert np.count_nonzero(compensated.direction > 0) >= 40
    assert np.count_nonzero(compensated.direction < 0) >= 40
    assert deviation.max() <= TOLERANCE_MM


def test_z_gets_minus_the_straightness_error_of_that_direction(way, compensated):
    expected = -way.error(compensated.target_x, compensated.direction)

    np.testing.assert_allclose(compensated.correction, expected, rtol=0, atol=TOLERANCE_MM)


def test_x_is_not_moved_by_the_table_it_carries(compensated):
    drive = compensated["drive-a.out"] - compensated["joint.0.motor-offset"]
    carried = compensated["joint.0.motor-pos-cmd"] - compensated["joint.0.motor-offset"] - drive

    np.testing.assert_allclose(drive, compensated["joint.0.pos-cmd"], rtol=0, atol=ROUNDING_MM)
    np.testing.assert_allclose(drive, compensated.target_x, rtol=0, atol=ROUNDING_MM)
    assert np.abs(carried).max() > 5 * UM


@pytest.mark.parametrize("joint", [0, 1])
def test_neither_joint_sees_a_following_error(joint, compensated):
    assert np.abs(compensated[f"joint.{joint}.f-error"]).max() <= ROUNDING_MM


@pytest.mark.parametrize("joint", [0, 1])
def test_display_shows_the_target_and_not_the_compensation(joint, compensated):
    targets = (compensated.target_x, compensated.target_z)[joint]

    shown = compensated[f"joint.{joint}.pos-fb"]

    np.testing.assert_allclose(shown, targets, rtol=0, atol=ROUNDING_MM)


def test_table_straightens_the_way(way, compensated, record_property):
    raw = np.abs(way.error(compensated.target_x, compensated.direction)).max()

    residual = np.abs(compensated.deviation(way)).max()

    record_property("raw_and_residual_mm", (float(raw), float(residual)))
    print(f"raw error {raw:.2e} mm, residual {residual:.2e} mm")
    assert raw > 5 * UM
    assert residual <= TOLERANCE_MM


def test_table_with_the_sign_flipped_doubles_the_error(way, flipped):
    doubled = 2 * way.error(flipped.target_x, flipped.direction)

    np.testing.assert_allclose(flipped.deviation(way), doubled, rtol=0, atol=TOLERANCE_MM)


def test_feedback_corrected_after_the_motion_controller_is_a_following_error(written, tmp_path):
    # Shows that the order of the routing matters and that the machine here can tell.
    late = tmp_path / "late.comp"
    shutil.copy(written, late)
    lines = hal_of(written).splitlines()
    moved = [line for line in lines if line.startswith("addf comp-fb-")]
    lines = [line for line in lines if line not in moved]
    after = lines.index("addf motion-controller servo-thread") + 1

    done = launch(
        late, [[10.0, 1.0], [5.0, 1.0]], "\n".join(lines[:after] + moved + lines[after:])
    )

    assert len(moved) == 2
    assert done.returncode == 1
    assert "following error" in done.stderr


def test_cross_axis_table_is_refused_unless_routed(way, table, tmp_path):
    path = tmp_path / "x-z.comp"

    with pytest.raises(TableError, match=r"X -> Z.*would move X.*cross_axis='hal'"):
        controllers.write(table, path, controller="linuxcnc", verified_against=way.measured())

    assert list(tmp_path.iterdir()) == []

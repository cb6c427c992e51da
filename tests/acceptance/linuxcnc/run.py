#!/usr/bin/env python3
"""Loads a type-0 compensation file into a real LinuxCNC, visits targets, writes what it did.

    run.py TABLE.comp TARGETS.json -o RESULT.json [--limit 120] [--feed 6000]
           [--hal MACHINE.hal] [--ini MACHINE.ini] [--pin joint.1.pos-fb ...]
           [--axes XYZ] [--rest 0.1] [--off-before 3 ...]

TABLE.comp holds bare triples ``nominal forward reverse`` in mm, TARGETS.json a list of positions
of X, or of pairs [X, Z], in mm that joint 0 (and 1) visits in that order. RESULT.json has one
reading per target: its direction of approach, the pins of joint 0, the pins asked for, and the
offset of joint 0 (motor-pos-cmd - pos-cmd). Another machine may stand in for machine.hal/.ini; with
``--axes`` it has other axes, targets are lists of as many, and TABLE is any file: it lies beside the
INI file as ``table.comp``.

LinuxCNC runs as an ordinary user (root's runs are handed to METROSEP_CNC_USER, by default
``metrosep-cnc``) in a pseudo-terminal and in a folder of its own that is removed afterwards. Each
of its processes is a descendant of this one and is ended with it. Only the standard library is
used.

Exit codes: 0 done; 1 LinuxCNC failed or ran out of time; 4 an input is unreadable; 75 LinuxCNC, or
the user for it, is missing, or another instance occupies the machine.
"""

import argparse
import contextlib
import ctypes
import json
import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
MACHINE_FILES = {name: HERE / name for name in ("machine.ini", "machine.hal", "drive.py")}
CNC_USER = os.environ.get("METROSEP_CNC_USER", "metrosep-cnc")

# Fixed by LinuxCNC itself, which allows one instance per machine.
CNC_TEMP = Path("/tmp")  # noqa: S108
CNC_LOCK = CNC_TEMP / "linuxcnc.lock"
CNC_PROCESSES = frozenset({"linuxcnc", "linuxcncsvr", "rtapi_app", "milltask"})
CNC_SHARED_MEMORY = frozenset({0x64, 0x48414C32, 0x48484C34, *range(1001, 1010)})  # keys
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

EXIT_FAILED, EXIT_UNREADABLE, EXIT_UNAVAILABLE = 1, 4, 75
DRIVER_MARGIN_S = 10.0  # the driver gives up this much earlier, so that LinuxCNC can shut down
GRACE_S = 3.0
PR_SET_CHILD_SUBREAPER = 36


class RunError(Exception):
    """A run that gave no readings; carries the exit code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def run(
    table: Path,
    targets_mm: Sequence[Sequence[float]],
    *,
    limit_s: float,
    feed_mm_min: float,
    machine: Mapping[str, Path] = MACHINE_FILES,
    pins: Sequence[str] = (),
    axes: str = "XZ",
    rest_s: float = 0.0,
    off_before: Sequence[int] = (),
) -> dict[str, Any]:
    """Readings of LinuxCNC at the targets with the compensation file loaded."""
    if not table.is_file():  # LinuxCNC itself would hang at start-up
        raise RunError(EXIT_UNREADABLE, f"{table}: no such compensation file")
    for path in machine.values():
        if not path.is_file():
            raise RunError(EXIT_UNREADABLE, f"{path}: no such file of the machine")
    account = ordinary_account()
    request = {
        "targets_mm": [list(target) for target in targets_mm],
        "pins": list(pins),
        "axes": axes,
        "rest_s": rest_s,
        "off_before": list(off_before),
        "feed_mm_min": feed_mm_min,
        "limit_s": max(limit_s - DRIVER_MARGIN_S, limit_s / 2),
    }
    with only_instance(limit_s), private_folder(account) as folder:
        for name, path in machine.items():
            shutil.copy(path, folder / name)
        shutil.copyfile(table, folder / "table.comp")
        (folder / "request.json").write_text(json.dumps(request))
        for path in (folder, *folder.iterdir()):
            os.chown(path, account.pw_uid, account.pw_gid)
            path.chmod(0o700)
        started = time.monotonic()
        outcome = execute(folder, account, limit_s)
        seconds = time.monotonic() - started
        readings = folder / "readings.json"
        if not readings.is_file():
            log = (folder / "run.log").read_text(errors="replace")
            raise RunError(EXIT_FAILED, f"LinuxCNC gave no readings ({outcome}):\n{log}")
        result: dict[str, Any] = json.loads(readings.read_text())
    for reading in result["readings"]:
        pins = reading["pins_mm"]
        reading["offset_mm"] = pins["motor-pos-cmd"] - pins["pos-cmd"]
    return result | {"user": account.pw_name, "seconds": seconds, "folder": str(folder)}


def execute(folder: Path, account: pwd.struct_passwd, limit_s: float) -> str:
    """Run ``linuxcnc`` in a pseudo-terminal until it ends or the time is over; say which."""
    identity: dict[str, Any] = {}
    if os.geteuid() == 0:
        identity = {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []}
    began = time.time()
    process = subprocess.Popen(
        ["script", "-qefc", "linuxcnc machine.ini", "run.log"],
        cwd=folder,
        env={"PATH": SYSTEM_PATH, "HOME": str(folder), "SHELL": "/bin/sh", "LC_ALL": "C"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        **identity,
    )
    try:
        return f"exit code {process.wait(timeout=limit_s)}"
    except subprocess.TimeoutExpired:
        return f"stopped after {limit_s:g} s"
    finally:
        end_descendants()
        remove_leftovers(account.pw_uid, began)


# ---- who may run it, where, and alone ----------------------------------------------------------


def ordinary_account() -> pwd.struct_passwd:
    """Account LinuxCNC runs as: the caller, or `CNC_USER` when that is root."""
    for program in ("linuxcnc", "halcmd", "script"):
        if shutil.which(program, path=SYSTEM_PATH) is None:
            raise RunError(EXIT_UNAVAILABLE, f"{program} is not installed: run install.sh")
    if os.geteuid() != 0:
        return pwd.getpwuid(os.geteuid())
    try:
        return pwd.getpwnam(CNC_USER)
    except KeyError:
        message = f"LinuxCNC refuses root and there is no user {CNC_USER}: run install.sh"
        raise RunError(EXIT_UNAVAILABLE, message) from None


@contextlib.contextmanager
def private_folder(account: pwd.struct_passwd) -> Iterator[Path]:
    """Folder that only `account` can enter, removed at the end.

    Not below TMPDIR: that may be closed to `account`, and the path of LinuxCNC's socket, which
    lies in the home folder, may not exceed 107 bytes.
    """
    folder = Path(tempfile.mkdtemp(prefix=f"{account.pw_name[:20]}-", dir=CNC_TEMP))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def only_instance(limit_s: float) -> Iterator[None]:
    """Wait for other runs of this script; refuse beside a LinuxCNC that is not ours.

    The lock is a name in the abstract socket space: it works across users and goes with its owner.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as lock:
        stop = time.monotonic() + limit_s
        while True:
            try:
                lock.bind("\0metrosep-linuxcnc-acceptance")
                break
            except OSError:
                if time.monotonic() > stop:
                    message = f"another acceptance run holds LinuxCNC for more than {limit_s:g} s"
                    raise RunError(EXIT_UNAVAILABLE, message) from None
                time.sleep(0.2)
        if foreign := sorted(name for name in process_names() if name in CNC_PROCESSES):
            message = f"another LinuxCNC runs on this machine ({', '.join(foreign)}): end it first"
            raise RunError(EXIT_UNAVAILABLE, message)
        # A lock left by a killed run would make the start script ask a question and wait.
        try:
            CNC_LOCK.unlink(missing_ok=True)
        except PermissionError:
            message = f"{CNC_LOCK} was left by another user: remove it"
            raise RunError(EXIT_UNAVAILABLE, message) from None
        yield


# ---- leaving nothing behind --------------------------------------------------------------------


def become_subreaper() -> None:
    """Make orphaned descendants children of this process: LinuxCNC's own detach themselves."""
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_CHILD_SUBREAPER) failed")


def process_table() -> dict[int, tuple[str, str, int]]:
    """Name, state letter and parent of every process, by its id."""
    table = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                name, rest = (entry / "stat").read_text().split("(", 1)[1].rsplit(")", 1)
                state, parent = rest.split()[:2]
                table[int(entry.name)] = (name, state, int(parent))
    return table


def process_names() -> list[str]:
    """Names of all processes that are not dead."""
    return [name for name, state, _ in process_table().values() if state != "Z"]


def descendants() -> list[int]:
    """Ids of the living processes below this one, parents first."""
    table = process_table()
    found: list[int] = []
    generation = {os.getpid()}
    while generation:
        generation = {pid for pid, (_, _, parent) in table.items() if parent in generation}
        found += [pid for pid in generation if table[pid][1] != "Z"]
    return found


def end_descendants() -> None:
    """End what LinuxCNC left running, first politely, and collect the dead."""
    for demand in (signal.SIGTERM, signal.SIGKILL):
        stop = time.monotonic() + GRACE_S
        for pid in descendants():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, demand)
        while descendants() and time.monotonic() < stop:
            reap()
            time.sleep(0.05)
    reap()


def reap() -> None:
    """Collect the exit codes of dead children, adopted ones included."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0] != 0:
            pass


def remove_leftovers(uid: int, began: float) -> None:
    """Remove the shared memory, lock and logs that a killed LinuxCNC leaves in the system."""
    for line in Path("/proc/sysvipc/shm").read_text().splitlines()[1:]:
        fields = line.split()
        key, segment, attached, owner = (int(fields[i]) for i in (0, 1, 6, 7))
        if key in CNC_SHARED_MEMORY and attached == 0 and owner == uid:
            subprocess.run(["ipcrm", "-m", str(segment)], check=False, capture_output=True)
    logs = [*CNC_TEMP.glob("linuxcnc.debug.*"), *CNC_TEMP.glob("linuxcnc.print.*")]
    for path in (CNC_LOCK, *logs):
        with contextlib.suppress(OSError):
            status = path.stat()
            if status.st_uid == uid and status.st_mtime >= began - 1.0:
                path.unlink()


# ---- command line ------------------------------------------------------------------------------


def arguments() -> argparse.Namespace:
    """Arguments of the command line."""
    parser = argparse.ArgumentParser(description="Try a compensation file on a real LinuxCNC.")
    parser.add_argument("table", type=Path, help="type-0 compensation file, mm")
    parser.add_argument("targets", type=Path, help="JSON list of X or [X, Z], mm, in order")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON of the readings")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds")
    parser.add_argument("--feed", type=float, default=6000.0, help="mm/min")
    parser.add_argument("--hal", type=Path, default=MACHINE_FILES["machine.hal"], help="wiring")
    parser.add_argument("--ini", type=Path, default=MACHINE_FILES["machine.ini"], help="settings")
    parser.add_argument("--pin", action="append", default=[], help="further pin to read")
    parser.add_argument("--axes", default="XZ", help="letters of the axes, a joint for each")
    parser.add_argument("--rest", type=float, default=0.0, help="seconds of rest before reading")
    parser.add_argument(
        "--off-before", type=int, action="append", default=[], help="target: off and on before it"
    )
    return parser.parse_args()


def position(value: Any, axes: str) -> list[float]:
    """One target: the first axis, or a list of the first axes, mm."""
    values = [float(v) for v in value] if isinstance(value, list) else [float(value)]
    if not 1 <= len(values) <= len(axes):
        raise ValueError(f"{value} is not a position of {', '.join(axes)}")
    return values


def main() -> int:
    """Run and return the exit code."""
    options = arguments()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    become_subreaper()
    try:
        targets = [
            position(value, options.axes) for value in json.loads(options.targets.read_text())
        ]
    except (OSError, ValueError, TypeError) as error:
        print(f"run.py: {options.targets}: not a JSON list of positions: {error}", file=sys.stderr)
        return EXIT_UNREADABLE
    try:
        result = run(
            options.table,
            targets,
            limit_s=options.limit,
            feed_mm_min=options.feed,
            machine=MACHINE_FILES | {"machine.hal": options.hal, "machine.ini": options.ini},
            pins=options.pin,
            axes=options.axes,
            rest_s=options.rest,
            off_before=options.off_before,
        )
    except RunError as error:
        print(f"run.py: {error}", file=sys.stderr)
        return error.code
    options.output.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

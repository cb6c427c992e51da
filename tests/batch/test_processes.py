"""Workers that are processes: killed at any moment, alone or with everything, nothing is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from metrosep.batch import run_batch
from metrosep.batch.loop import Stop, executor, work_through
from metrosep.batch.units import Unit
from metrosep.batch.work import Task

KILLS = 5
PARTS = 40
SCRIPT = """
import sys
from metrosep.batch import run_batch
if __name__ == "__main__":
    report = run_batch(sys.argv[1], sys.argv[2], out=sys.argv[3], workers=2)
    sys.exit(report.exit_code)
"""


@pytest.fixture
def many(tmp_path, parts, recipe_text):
    """A folder of parts with their recipe; every seventh is corrupt, every fifth too rough."""
    (tmp_path / "r.toml").write_text(recipe_text)
    truth = {}
    for i in range(PARTS):
        name = f"P_{i:03d}.{('sdf', 'x3p', 'sur')[i % 3]}"
        parts(tmp_path / "in" / name, 14e-9 if i % 5 == 0 else 6e-9, seed=i)
        truth[name] = "rejected" if i % 5 == 0 else "accepted"
        if i % 7 == 0:
            (tmp_path / "in" / name).write_bytes(b"not a map\n")
            truth[name] = "failed"
    return tmp_path, truth


def done(out: Path) -> dict[Path, int]:
    """Return when each unit was done; one that is done twice has a newer mark."""
    return {
        f: f.stat().st_mtime_ns for n in ("result", "failed") for f in out.glob(f"*/*/{n}.json")
    }


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="process groups of POSIX")
def test_killed_at_any_moment_nothing_is_lost_or_done_twice(many):
    folder, truth = many
    (folder / "go.py").write_text(SCRIPT)
    command = [sys.executable, folder / "go.py", folder / "r.toml", folder / "in", folder / "qa"]
    chance = np.random.default_rng(20261122)
    marks: dict[Path, int] = {}
    counts = []
    for _ in range(KILLS):
        process = subprocess.Popen(command, start_new_session=True, env=environment())
        wanted = len(marks) + int(chance.integers(1, 7))
        deadline = time.monotonic() + 60
        while len(done(folder / "qa")) < wanted and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(chance.uniform(0.0, 0.05))
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        now = done(folder / "qa")
        assert {k: now[k] for k in marks} == marks  # none done twice
        marks = now
        counts.append(len(now))
    assert counts == sorted(set(counts))  # each run went on
    assert counts[-1] < PARTS  # and the last was killed at work
    process = subprocess.run(command, env=environment(), check=False)
    now = done(folder / "qa")
    assert {k: now[k] for k in marks} == marks
    assert process.returncode == 6
    index = json.loads((folder / "qa/index.json").read_text())
    assert {r["unit"]: r["status"] for r in index["rows"]} == truth
    assert len(now) == PARTS
    assert not list((folder / "qa").glob("*/*/.metrosep*"))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_ends_cleanly_and_can_be_resumed(many):
    folder, truth = many
    command = [sys.executable, "-m", "metrosep", "batch", "r.toml", "in", "-o", "qa"]
    process = subprocess.Popen(
        [*command, "--workers", "2"],
        cwd=folder, env=environment(), start_new_session=True, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    for _ in range(3):
        assert process.stderr.readline().startswith("metrosep: ")
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: workers hear it too
    _, text = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; what is done is kept" in text
    assert "Traceback" not in text
    first = done(folder / "qa")
    assert 3 <= len(first) < PARTS
    report = run_batch(folder / "r.toml", folder / "in", out=folder / "qa", scheduler="serial")
    assert report.counts["skipped"] == len(first)
    assert {r["unit"]: r["status"] for r in report.rows} == truth
    assert {k: done(folder / "qa")[k] for k in first} == first


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="processes of POSIX")
def test_workers_end_with_their_parent(many):
    folder, _ = many
    (folder / "go.py").write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, folder / "go.py", folder / "r.toml", folder / "in", folder / "qa"],
        start_new_session=True, env=environment(),
    )  # fmt: skip
    while len(done(folder / "qa")) < 2:
        time.sleep(0.01)
    process.kill()  # the parent alone
    process.wait()
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    pytest.fail("a worker outlived its parent")


@pytest.mark.slow
def test_a_script_without_its_guard_is_told_so(many):
    folder, _ = many
    (folder / "go.py").write_text(SCRIPT.replace('if __name__ == "__main__":', "if True:"))
    run = subprocess.run(
        [sys.executable, folder / "go.py", folder / "r.toml", folder / "in", folder / "qa"],
        env=environment(), capture_output=True, text=True, check=False,
    )  # fmt: skip
    last = run.stderr.strip().splitlines()[-1]
    assert "worker processes cannot start" in last
    assert "__main__" in last
    assert not done(folder / "qa")


def suicidal(task: Task, unit: Unit) -> dict[str, object]:
    """Stand in for the work on a unit: a name says whether it kills its worker."""
    flag = Path(task.out) / f"{unit.name}.tries"
    tries = int(flag.read_text()) + 1 if flag.exists() else 1
    flag.write_text(str(tries))
    if unit.name == "always" or (unit.name == "once" and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"unit": unit.name, "status": "accepted", "reason": None}


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_killed_worker_costs_one_more_try_and_the_culprit_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr("metrosep.batch.loop.do_unit", suicidal)
    names = ["a", "b", "once", "c", "always", "d", "e"]
    for name in names:
        (tmp_path / f"{name}.in").write_text(name)
    units = [Unit(n, str(tmp_path / f"{n}.in"), (str(tmp_path / f"{n}.in"),), n) for n in names]
    task = Task("", "r.toml", ".", "0" * 64, str(tmp_path), 2)
    with executor("processes", 2) as make:
        rows = list(work_through(task, units, make, width=4, stop=Stop()))
    assert sorted(r["unit"] for r in rows) == sorted(names)
    bad = {r["unit"]: r["reason"] for r in rows if r["status"] == "failed"}
    assert set(bad) == {"always"}
    assert "died twice" in bad["always"]
    assert int((tmp_path / "once.tries").read_text()) <= 3
    (mark,) = tmp_path.glob("*/*/failed.json")
    assert json.loads(mark.read_text())["again"] is True

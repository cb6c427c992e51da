"""A thousand maps of 512 x 512 in three formats: every verdict against truth, memory bounded."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from metrosep.batch import run_batch

N = 1000
SIZE = 512
CORRUPT = N // 100
ROUGH = N // 50
WORKERS = 2
MOST_BYTES = 400e6
"""Resident memory of a worker: Python with numpy and scipy 100 MB, and 30 copies of a map."""


def make(folder: Path, write) -> dict[str, str]:
    """Fill a folder; equal maps are one file under several names, so that this takes seconds."""
    chance = np.random.default_rng(20261122)
    order = chance.permutation(N)
    corrupt, rough = set(order[:CORRUPT].tolist()), set(order[CORRUPT : CORRUPT + ROUGH].tolist())
    folder.mkdir()
    truth = {}
    for i in range(N):
        suffix, sa = ("x3p", "sur", "sdf")[i % 3], 14e-9 if i in rough else 6e-9
        model = folder.parent / f"{i % 4}_{sa}.{suffix}"
        if not model.exists():
            write(model, sa, size=SIZE, seed=i % 4)
        name = f"PART_{i:04d}.{suffix}"
        truth[name] = "rejected" if i in rough else "accepted"
        if i in corrupt:
            content = model.read_bytes()
            (folder / name).write_bytes(content[: int(len(content) * chance.uniform(0.0, 0.9))])
            truth[name] = "failed"
        else:
            os.link(model, folder / name)
    return truth


def largest_worker(stop: threading.Event) -> list[int]:
    """Note the largest memory of any process below this one, until told to stop."""
    psutil = pytest.importorskip("psutil")
    most = [0]

    def look() -> None:
        while not stop.is_set():
            for child in psutil.Process().children(recursive=True):
                try:
                    most[0] = max(most[0], child.memory_info().rss)
                except psutil.Error:  # it ended meanwhile
                    continue
            time.sleep(0.1)

    threading.Thread(target=look, daemon=True).start()
    return most


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_verdict_of_a_thousand_is_right(tmp_path, parts, recipe):
    truth = make(tmp_path / "in", parts)
    stop = threading.Event()
    most = largest_worker(stop)
    report = run_batch(recipe, tmp_path / "in", out=tmp_path / "qa", workers=WORKERS)
    stop.set()
    assert {r["unit"]: r["status"] for r in report.rows} == truth
    assert (report.counts["failed"], report.counts["rejected"]) == (CORRUPT, ROUGH)
    assert all(r["reason"] for r in report.rows if r["status"] == "failed")
    assert report.exit_code == 6
    assert 0 < most[0] < MOST_BYTES
    index = json.loads((tmp_path / "qa/index.json").read_text())
    assert index["counts"]["total"] == N
    again = run_batch(recipe, tmp_path / "in", out=tmp_path / "qa", workers=WORKERS)
    assert again.counts["skipped"] == N
    assert again.document == report.document

"""The same batch on a Dask cluster; one of its workers is killed in mid-run."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys

import pytest

from metrosep.batch import run_batch
from metrosep.batch.loop import ClusterError, executor, parse_scheduler

PARTS = 30

needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="the package distributed is missing"
)


@pytest.mark.slow
@needs_dask
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.filterwarnings("ignore")
def test_a_worker_of_the_cluster_is_killed_and_nothing_is_lost(tmp_path, parts, recipe):
    from distributed import Client, LocalCluster

    for i in range(PARTS):
        parts(tmp_path / "in" / f"P_{i:02d}.sur", 14e-9 if i % 5 == 0 else 6e-9, seed=i)
    killed, done = [], []
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        Client(cluster) as client,
    ):

        def tell(event):
            done.append(event["unit"])
            if event["done"] == 4:
                pid = next(iter(client.run(os.getpid).values()))
                assert pid != os.getpid()
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

        address = cluster.scheduler_address
        report = run_batch(
            recipe, tmp_path / "in", out=tmp_path / "qa", scheduler=f"dask={address}", tell=tell
        )
    assert killed
    assert sorted(done) == [f"P_{i:02d}.sur" for i in range(PARTS)]
    assert {r["unit"]: r["status"] for r in report.rows} == {
        f"P_{i:02d}.sur": "rejected" if i % 5 == 0 else "accepted" for i in range(PARTS)
    }
    assert len(list((tmp_path / "qa").glob("*/*/result.json"))) == PARTS
    assert report.exit_code == 1


@pytest.mark.slow
@needs_dask
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_of_its_own(inbox, recipe, tmp_path):
    report = run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="dask", workers=2)
    assert report.counts["total"] == 6
    assert report.counts["accepted"] == 2


@pytest.mark.slow
@needs_dask
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_does_not_answer_is_one_sentence(inbox, recipe, tmp_path, monkeypatch):
    monkeypatch.setattr("metrosep.batch.loop._CONNECT_SECONDS", 1)
    with pytest.raises(
        ClusterError, match=r"no cluster answers at tcp://127\.0\.0\.1:9 .*HOST:PORT"
    ):
        run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="dask=tcp://127.0.0.1:9")


def test_without_dask_it_says_what_to_install(inbox, recipe, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"metrosep\[cluster\]"):
        run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="dask")


@pytest.mark.parametrize("text", ["dask=", "processes=2", "", "Dask", "dask:tcp://x:1"])
def test_schedulers_that_are_none(text):
    from metrosep.core.errors import DataError

    with pytest.raises(DataError, match="is not known"):
        parse_scheduler(text)


def test_executors_do_what_they_are_asked():
    for kind in ("serial", "threads"):
        with executor(kind, 2) as make:
            pool = make()
            assert [f.result() for f in [pool.submit(pow, 2, n) for n in range(5)]] == [
                1,
                2,
                4,
                8,
                16,
            ]
            assert isinstance(pool.submit(int, "x").exception(), ValueError)

"""Items shared among threads: each once, own scratch, errors arrive."""

import threading
from collections.abc import Sequence

import numpy as np
import pytest

from metrosep.core.threads import in_threads, thread_count


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_each_item_is_worked_on_once(threads):
    done = np.zeros(500, dtype=int)

    def work(items):
        for item in items:
            done[item] += 1

    in_threads(work, range(500), threads=threads)
    assert (done == 1).all()


def test_several_threads_take_part():
    seen, barrier = set(), threading.Barrier(2, timeout=10.0)

    def work(items):
        for _ in items:
            barrier.wait()  # passes only when two threads are here
            seen.add(threading.get_ident())

    in_threads(work, [0, 1], threads=2)
    assert len(seen) == 2


def test_an_error_of_any_thread_arrives_and_the_rest_stops():
    done = []

    def work(items):
        for item in items:
            if item == 3:
                raise ValueError("item 3")
            done.append(item)

    for threads in (1, 2):
        done.clear()
        with pytest.raises(ValueError, match="item 3"):
            in_threads(work, range(10_000), threads=threads)
        assert len(done) < 10_000


def test_no_items_no_work():
    calls = []
    in_threads(calls.extend, [])
    assert calls == []


@pytest.mark.parametrize(("text", "count"), [("1", 1), ("2", 2), ("99", 4)])
def test_the_environment_sets_the_number(monkeypatch, text, count):
    monkeypatch.setenv("METROSEP_THREADS", text)
    assert thread_count() == count


@pytest.mark.parametrize("text", ["", "0", "-1", "many", "9" * 5000])
def test_nonsense_in_the_environment_is_not_a_number(monkeypatch, text):
    monkeypatch.setenv("METROSEP_THREADS", text)
    assert 1 <= thread_count() <= 4


def test_the_error_state_of_the_caller_holds_in_every_thread():
    barrier, seen = threading.Barrier(2, timeout=10.0), []

    def work(items):
        for _ in items:
            barrier.wait()
            seen.append(np.geterr()["over"])

    with np.errstate(over="ignore"):
        in_threads(work, [0, 1], threads=2)
    assert seen == ["ignore", "ignore"]


def test_any_sequence_is_worked_on_once():
    class Letters(Sequence):
        def __len__(self):
            return 50

        def __getitem__(self, i):
            if not 0 <= i < 50:
                raise IndexError(i)
            return i

    done = np.zeros(50, dtype=int)

    def work(items):
        for item in items:
            done[item] += 1

    in_threads(work, Letters(), threads=4)
    assert (done == 1).all()

"""Threads: one block keeps all work in the thread that does it."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.blas import one_thread, threads
from metrosep.filters import _areal


def test_inside_of_a_block_there_is_one_thread_and_outside_as_many_as_processors():
    assert threads(1) == 1
    assert threads(10**6) == os.cpu_count()
    with one_thread():
        assert threads(10**6) == 1
        with one_thread():
            assert threads(8) == 1
        assert threads(8) == 1
    assert threads(10**6) == os.cpu_count()


def test_the_block_of_one_thread_does_not_bind_another():
    with one_thread(), ThreadPoolExecutor(1) as pool:
        assert pool.submit(threads, 10**6).result() == os.cpu_count()


def test_the_block_ends_with_an_error():
    with pytest.raises(KeyError), one_thread():
        raise KeyError
    assert threads(10**6) == os.cpu_count()


def test_a_filter_in_the_block_opens_no_pool_and_gives_the_same_bits(monkeypatch):
    z = 1e-9 * np.random.default_rng(7).standard_normal((300, 260))
    z[40:60, 100:130] = np.nan
    surface = ms.Surface(z, 1e-6, 1e-6)
    wanted = ms.filters.gaussian(surface, nesting_index=20e-6).z

    def refused(*_: object) -> None:
        raise AssertionError("a pool was opened")

    monkeypatch.setattr(_areal, "ThreadPoolExecutor", refused)
    with one_thread():
        found = ms.filters.gaussian(surface, nesting_index=20e-6).z
    assert np.array_equal(found, wanted, equal_nan=True)

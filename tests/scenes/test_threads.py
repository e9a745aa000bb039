"""One thread for linear algebra, whoever asks for it and however many do."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from scenes import threads
from scenes.threads import one_blas_thread


class Blas:
    """Stands for a BLAS of four threads; limits: how many are in force, and were ever."""

    def __init__(self):
        self.count, self.ever = 4, 0

    @property
    def now(self):
        return int(self.count == 1)

    def get_num_threads(self):
        return self.count

    def set_num_threads(self, count):
        assert count in (1, 4)
        self.count, self.ever = count, self.ever + (count == 1)


@pytest.fixture
def blas(monkeypatch):
    """A BLAS of this test's own: searches of a live track may still hold the process's."""
    made = Blas()
    monkeypatch.setattr(threads, "_blas", lambda loaded: [made])
    monkeypatch.setattr(threads, "_limit", threads._Limit())
    return made


@contextmanager
def held_longer():
    """One thread holds the limit, and another that came meanwhile holds it on, until this ends."""
    inside, leave = threading.Event(), threading.Event()

    def other():
        with one_blas_thread():
            inside.set()
            leave.wait(10.0)

    thread = threading.Thread(target=other)
    with one_blas_thread():
        thread.start()
        assert inside.wait(10.0)
    yield
    leave.set()
    thread.join(10.0)


def test_the_limit_holds_until_the_last_thread_leaves(blas):
    with held_longer():
        assert (blas.now, blas.ever) == (1, 1)
    assert blas.now == 0
    with one_blas_thread(), one_blas_thread():
        assert (blas.now, blas.ever) == (1, 2)
    assert blas.now == 0


def test_an_error_inside_lifts_the_limit(blas):
    with pytest.raises(ValueError, match="inside"), one_blas_thread():
        raise ValueError("inside")
    assert blas.now == 0


def test_inside_every_blas_has_one_thread():
    import numpy as np

    with one_blas_thread():
        np.ones((2, 2)) @ np.ones((2, 2))
        of_numpy = [lib for lib in threadpool_info() if lib["user_api"] == "blas" and "numpy" in lib["filepath"]]
        assert all(lib["num_threads"] == 1 for lib in of_numpy)


def blas_threads():
    """How many threads NumPy's BLAS has now."""
    libraries = [lib for lib in threadpool_info() if lib["user_api"] == "blas" and "numpy" in lib["filepath"]]
    return libraries[0]["num_threads"] if libraries else 1


def in_a_thread(call):
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result(30.0)


def test_a_thread_beside_the_first_has_one_thread_too():
    def inside():
        with one_blas_thread():
            return blas_threads()

    assert inside() == 1
    assert in_a_thread(inside) == 1  # whoever limited it first


@pytest.mark.skipif(blas_threads() == 1, reason="linear algebra has one thread here")
def test_whoever_leaves_last_lifts_the_limit():
    before = blas_threads()
    with held_longer():
        assert blas_threads() == 1
    assert blas_threads() == before
    with one_blas_thread():
        pass
    with threadpool_limits(1, "blas"):  # others' limits hold as before
        assert blas_threads() == 1
    assert in_a_thread(others_limit) == 1
    assert blas_threads() == before


def others_limit():
    with threadpool_limits(1, "blas"):
        return blas_threads()

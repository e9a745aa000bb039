"""One thread for linear algebra, whoever asks for it and however many do."""

import threading

import pytest
from threadpoolctl import threadpool_info

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


def test_the_limit_holds_until_the_last_thread_leaves(blas):
    inside, leave = threading.Event(), threading.Event()

    def other():
        with one_blas_thread():
            inside.set()
            leave.wait(10.0)

    thread = threading.Thread(target=other)
    with one_blas_thread():
        thread.start()
        assert inside.wait(10.0)
    assert (blas.now, blas.ever) == (1, 1)
    leave.set()
    thread.join(10.0)
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

"""One thread for linear algebra, whoever asks for it and however many do."""

import threading

from threadpoolctl import threadpool_info

from scenes.threads import one_blas_thread


def most_threads():
    return max(lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas")


def test_the_limit_holds_until_the_last_thread_leaves():
    import numpy as np

    np.ones((2, 2)) @ np.ones((2, 2))
    before = most_threads()
    inside, leave = threading.Event(), threading.Event()

    def other():
        with one_blas_thread():
            inside.set()
            leave.wait(10.0)

    thread = threading.Thread(target=other)
    with one_blas_thread():
        thread.start()
        assert inside.wait(10.0)
    try:
        assert most_threads() == 1
    finally:
        leave.set()
        thread.join(10.0)
    assert most_threads() == before
    with one_blas_thread(), one_blas_thread():
        assert most_threads() == 1
    assert most_threads() == before

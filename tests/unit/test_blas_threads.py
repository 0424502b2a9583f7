"""Threads of matrix products while several searches run in one process."""

from threadpoolctl import ThreadpoolController, threadpool_limits

from skyline.match.blas_threads import one_blas_thread


def blas_threads():
    return {
        library["num_threads"]
        for library in ThreadpoolController().info()
        if library["user_api"] == "blas"
    }


def test_a_search_that_ends_first_leaves_the_other_its_one_thread():
    first, second = one_blas_thread(), one_blas_thread()
    with threadpool_limits(2, user_api="blas"):
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert blas_threads() == {1}
        second.__exit__(None, None, None)
        assert blas_threads() == {2}

"""One thread for the linear algebra of a diagnosis.

Its matrices are small. With several BLAS threads on busy cores the threads mostly wait for each other.
"""

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Limit the BLAS libraries that are loaded to one thread inside."""
    with _controller().limit(limits=1, user_api="blas"):
        yield

"""joblib's Dask backend, for studies: connected to a cluster, and told when a job is lost with its worker."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from tensegrity_mj.errors import MissingLibraryError, OptionError

try:
    from distributed import Client, KilledWorker
    from joblib._dask import DaskDistributedBackend
except ImportError as error:
    raise MissingLibraryError(
        f"a cluster needs Dask, and '{error.name}' is missing: python -m pip install 'tensegrity-mj[cluster]'"
    ) from error

CONNECT_TIMEOUT = 20  # s


def death() -> Any:
    """What Dask raises for a job that killed every worker that it was given to."""
    return KilledWorker


@contextlib.contextmanager
def connected(address: str | None, client: Any) -> Iterator[Any]:
    """The client given, or one of our own for the length of the block.

    Raises:
        OptionError: if no scheduler answers at the address, or the client is none.
    """
    if client is not None:
        if not isinstance(client, Client):
            raise OptionError(f"workers: client = {client!r}; it must be a dask.distributed.Client")
        yield client
        return
    try:
        own = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise OptionError(
            f"workers: no Dask scheduler answers at {address!r} ({type(error).__name__}: {error}); "
            "start one with `dask scheduler`, and give the address that it prints"
        ) from error
    with own:
        yield own


def check_import(client: Any, module: str) -> None:
    """Find out before any point that the cluster's workers can import what they need: Dask would wait for ever.

    Raises:
        OptionError: naming the module.
    """
    for name in (__package__, module):
        try:
            client.run(exec, f"import {name}")  # a builtin, which needs nothing to be sent
        except Exception as error:
            raise OptionError(
                f"workers: the cluster cannot import '{name}' ({type(error).__name__}: {error}); install it where its "
                "workers run, in the version used here"
            ) from error


class _Lost:
    """What a job is answered with that Dask gave up."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


class CallsBack(DaskDistributedBackend):  # type: ignore[misc]
    """joblib's Dask backend, which calls back for jobs that end without a result too.

    joblib's own answers nobody when Dask gives a job up (its worker died, or cannot import the task), so that
    `Parallel` would wait for it for ever.
    """

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Threads of all workers; at least two, since joblib would compute in this process for one."""
        return max(2, super().effective_n_jobs(n_jobs))

    def submit(self, func: Any, callback: Callable[[Any], None] | None = None) -> Any:
        """Give a job to Dask."""
        future = super().submit(func, callback)

        def tell(done: Any) -> None:
            error = done.exception()
            if error is not None and callback is not None:
                callback(_Lost(error))

        future.add_done_callback(tell)
        return future

    def retrieve_result_callback(self, out: Any) -> Any:
        """The result of a job, or the error that ended it."""
        if isinstance(out, _Lost):
            raise out.error
        return super().retrieve_result_callback(out)

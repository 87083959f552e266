"""Points of a study on a Dask cluster: what a lost worker had is done again, a lost scheduler is an error."""

from __future__ import annotations

import contextlib
import queue
import time
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from typing import Any

from tensegrity_mj.basics.checks import instance
from tensegrity_mj.basics.dependencies import of_extra
from tensegrity_mj.errors import ClusterError, MissingLibraryError, OptionError
from tensegrity_mj.studies.attempt import DIED, Answer, Task, attempt, unable

try:
    from distributed import Client, Future, KilledWorker
except ImportError as error:
    raise MissingLibraryError(
        f"a cluster needs Dask, and '{error.name}' is missing: python -m pip install {of_extra('cluster')}"
    ) from error

CONNECT_TIMEOUT = 20  # s
CLOSE_TIMEOUT = 10  # s
LOOK_INTERVAL = 2  # s without a result, after which the cluster is looked at
ANSWER_TIMEOUT = 30  # s for the scheduler to answer
WORKER_TIMEOUT = 60  # s without any worker; one that died is often begun anew


@contextlib.contextmanager
def connected(address: str | None, client: Any) -> Iterator[Any]:
    """The client given, or one of our own for the length of the block.

    Raises:
        OptionError: if no scheduler answers at the address, or the client is none.
    """
    if client is not None:
        instance("workers: client", client, Client, "it must be a dask.distributed.Client")
        yield client
        return
    try:
        own = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise OptionError(
            f"workers: no Dask scheduler answers at {address!r} ({type(error).__name__}: {error}); "
            "start one with `dask scheduler`, and give the address that it prints"
        ) from error
    try:
        yield own
    finally:
        with contextlib.suppress(OSError):  # TimeoutError, too: a scheduler that is lost says no goodbye
            own.close(timeout=CLOSE_TIMEOUT)


def check_import(client: Any, module: str) -> None:
    """Find out before any point that the cluster's workers can import what they need.

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


def compute(
    client: Any, count: int | None, task: Task, points: Mapping[str, dict[str, Any]]
) -> Generator[Answer, None, None]:
    """Answers of the points as they are ready; a point whose worker dies is tried again alone, and is then given up.

    Args:
        client: a `dask.distributed.Client`.
        count: how many points at a time; by default all threads of all workers.
        task, points: as in `run_many`, points by key.

    Raises:
        ClusterError: if the scheduler does not answer any more, or has no workers.
        OptionError: if the workers cannot compute the task.
    """
    watched = _Cluster(client)
    suspects = {}
    # Dask itself gives a point to other workers when its worker dies, and gives it up when several died with it; which
    # of those under way there did it, only trying each alone shows.
    for key, answer in watched.results(count, task, points):
        if answer is None:
            suspects[key] = points[key]
        else:
            yield answer
    for key, answer in watched.results(1, task, suspects):
        yield answer or (key, DIED, {})


class _Cluster:
    """A cluster that is looked at while nothing comes from it."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.threads = 1
        self.seen = time.monotonic()
        self.look()

    def look(self) -> None:
        """Count the threads of all workers.

        Raises:
            ClusterError: if the scheduler does not answer, or has had no workers for a while.
        """
        if self.client.status != "running":
            raise _lost(f"its connection is {self.client.status}")
        try:
            workers = self.client.nthreads(callback_timeout=ANSWER_TIMEOUT)
        except Exception as error:  # any error that a broken connection raises
            raise _lost(f"{type(error).__name__}: {error}") from error
        if workers:
            self.threads, self.seen = max(1, sum(workers.values())), time.monotonic()
        elif time.monotonic() - self.seen > WORKER_TIMEOUT:
            raise ClusterError(
                f"workers: the cluster has had no worker for {WORKER_TIMEOUT:.0f} s; start some with `dask worker`"
            )

    def results(
        self, count: int | None, task: Task, points: Mapping[str, dict[str, Any]]
    ) -> Generator[tuple[str, Answer | None], None, None]:
        """(key, answer) of each point as it ends, None where its worker died; `count` at a time, so that none waits."""
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        left, running = iter(points.items()), dict[str, tuple[str, Any]]()
        try:
            while True:
                while len(running) < (count or self.threads) and (following := next(left, None)) is not None:
                    key, point = following
                    future = self.client.submit(attempt, task, key, point, pure=False)
                    running[future.key] = key, future
                    future.add_done_callback(ended.put)
                if not running:
                    return
                try:
                    future = ended.get(timeout=LOOK_INTERVAL)
                except queue.Empty:
                    self.look()
                    continue
                answer = self._result(future, task)
                key, _ = running.pop(future.key)
                yield key, answer
        finally:
            for _, future in running.values():
                future.release()

    def _result(self, future: Future, task: Task) -> Answer | None:
        while True:
            try:
                answer: Answer = future.result(timeout=LOOK_INTERVAL)
                return answer
            except TimeoutError:  # the worker that has it may be lost: Dask computes it again
                self.look()
            except KilledWorker:
                return None
            except CancelledError as error:
                raise _lost(str(error)) from error
            except Exception as error:
                raise unable(task, error) from error


def _lost(reason: str) -> ClusterError:
    return ClusterError(f"workers: the scheduler of the cluster does not answer any more ({reason}); start it again")

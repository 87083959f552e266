"""Workers that compute the points of a study: local processes by joblib, a Dask cluster, or this process.

A point whose worker dies is computed again alone, and is then given up. A cluster that has lost its scheduler, or all
of its workers, is an error.
"""

from __future__ import annotations

import contextlib
import enum
import os
import queue
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from functools import partial
from typing import Any

from tensegrity_mj.basics.checks import instance, warn_caller
from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, text, whole
from tensegrity_mj.controllers.own import Spec
from tensegrity_mj.controllers.specs import is_here
from tensegrity_mj.errors import ClusterError, OptionError, TensegrityError
from tensegrity_mj.studies.attempt import DIED, Answer, Task, attempt, settle, unable

FEEDER_WAIT = 1.0  # s
# Of a cluster:
CONNECT_TIMEOUT = 20  # s
CLOSE_TIMEOUT = 10  # s
LOOK_INTERVAL = 2  # s without a result, after which the cluster is looked at
ANSWER_TIMEOUT = 30  # s for the scheduler to answer
WORKER_TIMEOUT = 60  # s without any worker; one that died is often begun anew


class Backend(enum.Enum):
    """Places where points are computed."""

    PROCESSES = "processes"  # worker processes of this machine
    CLUSTER = "cluster"  # a Dask cluster; its workers need this package, and one thread each
    THIS_PROCESS = "this process"  # one after another, here: to debug, or for a few short points


@value("workers", OptionError)
class Workers:
    """Workers that compute the points; results do not depend on them.

    Attributes:
        count: how many points at a time, >= 1; by default all cores, or all threads of the cluster's workers.
        backend: see `Backend`.
        address: of the cluster's scheduler, such as "tcp://host:8786".
        client: a `dask.distributed.Client` in place of an address; it stays open.
    """

    count: int | None = field(whole(1), default=None, none="None for all cores")
    backend: Backend = field(choice(Backend), default=Backend.PROCESSES)
    address: str | None = field(text(), default=None, none="None")
    client: Any = field(None, default=None)

    def __attrs_post_init__(self) -> None:
        if self.backend is Backend.THIS_PROCESS and self.count not in (None, 1):
            raise OptionError(f"workers: count = {self.count}; this process computes one point at a time")
        given = [name for name in ("address", "client") if getattr(self, name) is not None]
        if self.backend is Backend.CLUSTER and len(given) != 1:
            raise OptionError("workers: a cluster needs the address of its scheduler, or a client, and not both")
        if self.backend is not Backend.CLUSTER and given:
            raise OptionError(f"workers: {given[0]} belongs to Backend.CLUSTER; leave it out")

    @contextlib.contextmanager
    def ready(self, task: Task) -> Iterator[Compute]:
        """Provide the function that computes points of a task, for the length of a block.

        Raises:
            MissingLibraryError: if Dask is wanted and missing.
            OptionError: if no scheduler answers, or the workers cannot import the task.
        """
        if self.backend is Backend.THIS_PROCESS:
            yield _here
        elif self.backend is Backend.PROCESSES:
            try:
                from joblib import cpu_count
            except ImportError as error:
                remedy = f"python -m pip install {of_extra('studies')}"
                text = f"points are computed one at a time: joblib cannot be imported ({error}); {remedy}"
                warn_caller(text, RuntimeWarning)
                yield _here
            else:
                yield partial(_processes, self.count or int(cpu_count()))
        else:
            optional("distributed", "a cluster", of_extra("cluster"))
            with _connected(self.address, self.client) as client:
                _check_import(client, task.__module__)
                yield partial(_by_cluster, client, self.count)


# Answers of the points given by key, as they are ready; a generator, whose `close` stops the workers.
Compute = Callable[[Task, Mapping[str, dict[str, Any]]], Generator[Answer, None, None]]


def _here(task: Task, points: Mapping[str, dict[str, Any]]) -> Generator[Answer, None, None]:
    for key, point in points.items():
        yield attempt(task, key, point)


def _processes(count: int, task: Task, points: Mapping[str, dict[str, Any]]) -> Generator[Answer, None, None]:
    """Points in processes of this machine; one whose process dies is tried again alone, and is then given up."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    missing = dict(points)
    while missing:
        begun: list[str] = []
        try:
            with contextlib.closing(_run(count, task, missing, begun)) as results:
                for answer in results:
                    del missing[answer[0]]
                    yield answer
            return
        except TerminatedWorkerError:
            pass
        # Any point in flight may have killed the worker: retry each alone to find out.
        for key in [key for key in begun if key in missing]:
            point = missing.pop(key)
            try:
                with contextlib.closing(_run(count, task, {key: point}, [])) as results:
                    yield from results
            except TerminatedWorkerError:
                yield key, DIED, {}


def _run(
    count: int, task: Task, points: Mapping[str, dict[str, Any]], begun: list[str]
) -> Generator[Answer, None, None]:
    """Answers of the points by joblib, one a job; `begun` gets the keys of those that were given out."""
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    def jobs() -> Iterator[Any]:
        for key, point in list(points.items()):
            begun.append(key)
            yield delayed(attempt)(task, key, point)

    # joblib computes in this process where one worker is requested, and a crash would take it down: two processes
    # then, of which one works at a time. One point a job, and none waiting in a worker's queue: what is lost by a
    # crash is what was being computed.
    begin = {"initializer": settle, "initargs": (os.getpid(), os.getcwd(), *sys.path)}
    with parallel_config(backend="loky", inner_max_num_threads=1, **begin):
        parallel = Parallel(
            n_jobs=max(2, count),
            pre_dispatch=count,
            batch_size=1,
            return_as="generator_unordered",
            max_nbytes=None,
        )
    results, ended = None, False
    try:
        results = parallel(jobs())
        # Not `yield from`: it would close the results before the warnings are silenced.
        for answer in results:  # noqa: UP028
            yield answer
        ended = True
    except (TerminatedWorkerError, TensegrityError):
        raise
    except Exception as error:
        raise unable(task, error) from error
    finally:
        if results is not None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that work was cancelled is what was wanted
                results.close()
            # The feeder of a stopped queue cleans up its semaphore; a process that ends meanwhile prints a warning.
            for thread in () if ended else threading.enumerate():
                if thread.name == "QueueFeederThread":
                    thread.join(FEEDER_WAIT)


def workers_for(law: Spec | None, workers: Workers | None) -> Workers:
    """Return workers that can have a law, given by its spec: this process alone, for one that no other can make.

    Raises:
        OptionError: if the given ones cannot.
    """
    if law is None or not is_here(law):
        return workers or Workers()
    if workers is not None and workers.backend is not Backend.THIS_PROCESS:
        raise OptionError(
            f"law '{law['name']}': it exists in this process only, and workers cannot make it again. Put it, or a "
            'function scene -> law, at the top of a file of its own and give "path.py:name"; or leave workers out'
        )
    return Workers(backend=Backend.THIS_PROCESS)


@contextlib.contextmanager
def _connected(address: str | None, client: Any) -> Iterator[Any]:
    """The client given, or one of our own for the length of the block.

    Raises:
        OptionError: if no scheduler answers at the address, or the client is none.
    """
    from distributed import Client

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


def _check_import(client: Any, module: str) -> None:
    """Raise OptionError, before any point, where the cluster's workers cannot import what they need."""
    for name in (__package__, module):
        try:
            client.run(exec, f"import {name}")  # a builtin, which needs nothing to be sent
        except Exception as error:
            raise OptionError(
                f"workers: the cluster cannot import '{name}' ({type(error).__name__}: {error}); install it where its "
                "workers run, in the version used here"
            ) from error


def _by_cluster(
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

    def _result(self, future: Any, task: Task) -> Answer | None:
        from distributed import KilledWorker

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

"""Workers that compute the points of a study: local processes, a Dask cluster, or this process. By joblib."""

from __future__ import annotations

import contextlib
import enum
import os
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from typing import Any

from tensegrity_mj.basics.checks import warn_caller
from tensegrity_mj.basics.dependencies import of_extra
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import choice, text, whole
from tensegrity_mj.controllers.own import Spec
from tensegrity_mj.controllers.specs import is_here
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.studies.attempt import DIED, Answer, Task, attempt, settle, unable

FEEDER_WAIT = 1.0  # s


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
            from tensegrity_mj.studies import cluster

            with cluster.connected(self.address, self.client) as client:
                cluster.check_import(client, task.__module__)
                yield partial(cluster.compute, client, self.count)


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

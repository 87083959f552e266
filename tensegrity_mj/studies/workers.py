"""Who computes the points of a study: processes of this machine, a Dask cluster, or this process. By joblib."""

from __future__ import annotations

import contextlib
import enum
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from tensegrity_mj.checks import member
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.jsontext import to_exact_json
from tensegrity_mj.studies.attempt import FAILED, Answer, Task, attempt, settle

DIED = to_exact_json(
    {
        "status": FAILED,
        "error": "WorkerDied",
        "reason": "the process that computed this point died, and so did one that computed it alone: "
        "for lack of memory, or by a crash in compiled code",
    }
)


class Backend(enum.Enum):
    """Where points are computed."""

    PROCESSES = "processes"  # worker processes of this machine
    CLUSTER = "cluster"  # a Dask cluster; its workers need this package, and one thread each
    THIS_PROCESS = "this process"  # one after another, here: to debug, or for a few short points


@dataclass(frozen=True)
class Workers:
    """Who computes the points; results do not depend on it.

    Attributes:
        count: how many points at a time, >= 1; by default all cores, or all threads of the cluster's workers.
        backend: see `Backend`.
        address: of the cluster's scheduler, such as "tcp://host:8786".
        client: a `dask.distributed.Client` in place of an address; it stays open.
    """

    count: int | None = None
    backend: Backend = Backend.PROCESSES
    address: str | None = None
    client: Any = None

    def __post_init__(self) -> None:
        member("workers: backend", self.backend, Backend)
        count = self.count
        if count is not None and (not isinstance(count, int) or isinstance(count, bool) or count < 1):
            raise OptionError(f"workers: count = {count!r}; it must be an integer >= 1, or None for all cores")
        if self.backend is Backend.THIS_PROCESS and count not in (None, 1):
            raise OptionError(f"workers: count = {count}; this process computes one point at a time")
        given = [name for name in ("address", "client") if getattr(self, name) is not None]
        if self.backend is Backend.CLUSTER and len(given) != 1:
            raise OptionError("workers: a cluster needs the address of its scheduler, or a client, and not both")
        if self.backend is not Backend.CLUSTER and given:
            raise OptionError(f"workers: {given[0]} belongs to Backend.CLUSTER; leave it out")

    @contextlib.contextmanager
    def ready(self, task: Task) -> Iterator[Compute]:
        """What computes points of a task, for the length of a block.

        Raises:
            MissingLibraryError: if Dask is wanted and missing.
            OptionError: if no scheduler answers, or the cluster cannot import the task.
        """
        if self.backend is Backend.THIS_PROCESS:
            yield _here
        elif self.backend is Backend.PROCESSES:
            yield _Pool(self.count or _cores(), _processes, _terminated())
        else:
            from tensegrity_mj.studies import cluster

            with cluster.connected(self.address, self.client) as client:
                cluster.check_import(client, task.__module__)
                yield _Pool(self.count, partial(_cluster, client), cluster.death())


# Answers of the points given by key, as they are ready; a generator, whose `close` stops the workers.
Compute = Callable[[Task, Mapping[str, dict[str, Any]]], Generator[Answer, None, None]]


def _here(task: Task, points: Mapping[str, dict[str, Any]]) -> Generator[Answer, None, None]:
    for key, point in points.items():
        yield attempt(task, key, point)


class _Pool:
    """Points through joblib, one a job; a point whose worker dies is tried again alone, and is then given up."""

    def __init__(self, count: int | None, parallel: Callable[[int | None], Any], death: type[Exception]) -> None:
        self.count, self.parallel, self.death = count, parallel, death

    def __call__(self, task: Task, points: Mapping[str, dict[str, Any]]) -> Generator[Answer, None, None]:
        missing = dict(points)
        while missing:
            begun: list[str] = []
            try:
                with contextlib.closing(self._run(task, missing, begun)) as answers:
                    for answer in answers:
                        del missing[answer[0]]
                        yield answer
                return
            except self.death:
                pass
            # Of the points that were under way, which one it was only trying tells.
            for key in [key for key in begun if key in missing]:
                point = missing.pop(key)
                try:
                    with contextlib.closing(self._run(task, {key: point}, [])) as answers:
                        yield from answers
                except self.death:
                    yield key, DIED, {}

    def _run(self, task: Task, points: Mapping[str, dict[str, Any]], begun: list[str]) -> Generator[Answer, None, None]:
        from joblib import delayed

        def jobs() -> Iterator[Any]:
            for key, point in list(points.items()):
                begun.append(key)
                yield delayed(attempt)(task, key, point)

        answers = None
        try:
            answers = self.parallel(self.count)(jobs())
            # Not `yield from`: it would close the answers before the warnings are silenced.
            for answer in answers:  # noqa: UP028
                yield answer
        except (self.death, TensegrityError):
            raise
        except Exception as error:
            raise OptionError(
                f"the workers cannot compute '{task.__name__}' ({type(error).__name__}: {error}); its module "
                f"'{task.__module__}' and tensegrity_mj must be installed where they run"
            ) from error
        finally:
            if answers is not None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # that work was cancelled is what was wanted
                    answers.close()


def _cores() -> int:
    from joblib import cpu_count

    return int(cpu_count())


def _terminated() -> Any:
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    return TerminatedWorkerError


# One point a job, and none waiting in a worker's queue: what is lost by a crash is what was being computed.
_ONE_BY_ONE = {"batch_size": 1, "return_as": "generator_unordered", "max_nbytes": None}


def _processes(count: int | None) -> Any:
    from joblib import Parallel, parallel_config

    assert count is not None
    # joblib computes in this process where one worker is asked for, and a crash would take it down: two processes
    # then, of which one works at a time.
    begin = {"initializer": settle, "initargs": (os.getpid(),)}
    with parallel_config(backend="loky", inner_max_num_threads=1, **begin):
        return Parallel(n_jobs=max(2, count), pre_dispatch=count, **_ONE_BY_ONE)


def _cluster(client: Any, count: int | None) -> Any:
    from joblib import Parallel

    from tensegrity_mj.studies.cluster import CallsBack

    return Parallel(backend=CallsBack(client=client), pre_dispatch=count or "n_jobs", **_ONE_BY_ONE)

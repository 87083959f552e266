"""Workers that compute the points of a study: local processes by joblib, a Dask cluster, or this process.

What a task raises is data, too. A point whose worker dies is computed again alone, and is then given up. A cluster that
has lost its scheduler, or all of its workers, is an error.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import os
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from functools import partial
from typing import Any

from tensegrity_mj.basics.checks import instance, warn_caller
from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.jsontext import to_exact_json
from tensegrity_mj.basics.kinds import choice, text, whole
from tensegrity_mj.controllers.own import Spec
from tensegrity_mj.controllers.specs import is_here
from tensegrity_mj.errors import ClusterError, OptionError, TensegrityError
from tensegrity_mj.studies.plain import plain

FEEDER_WAIT = 1.0  # s
IDLE_TIMEOUT = 300  # s that a process waits for more work
# Of a cluster:
CONNECT_TIMEOUT = 20  # s
CLOSE_TIMEOUT = 10  # s
LOOK_INTERVAL = 2  # s without a result, after which the cluster is looked at
ANSWER_TIMEOUT = 30  # s for the scheduler to answer
WORKER_TIMEOUT = 60  # s without any worker; one that died is often begun anew
DONE, FAILED = "done", "failed"
WATCH_INTERVAL = 0.25  # s between looks whether the parent still lives

DIED = to_exact_json(
    {
        "status": FAILED,
        "error": "WorkerDied",
        "reason": "the process that computed this point died, and so did one that computed it alone: "
        "for lack of memory, or by a crash in compiled code",
    }
)

# Threads of one process take turns: an engine may hold what a process has only once (MuJoCo's control callback).
_TURN = threading.Lock()


@dataclasses.dataclass(frozen=True)
class WithFiles:
    """Result of a task that leaves files too: plain values, and the content of each file by its name.

    The process that runs the study writes the files, so that workers need not share a file system with it.
    """

    values: Mapping[str, Any]
    files: Mapping[str, bytes] = dataclasses.field(default_factory=dict)


Task = Callable[[dict[str, Any]], Mapping[str, Any] | WithFiles]
# key of the point, its outcome as exact JSON, the content of its files by name
Answer = tuple[str, str, dict[str, bytes]]


def attempt(task: Task, key: str, point: dict[str, Any]) -> Answer:
    """Compute one point; an exception of the task becomes its outcome."""
    try:
        with _TURN:
            result = task(point)
        values, files = (result.values, dict(result.files)) if isinstance(result, WithFiles) else (result, {})
        if not isinstance(values, Mapping):
            raise OptionError(f"the task returned a {type(values).__name__}; it must return a dict of plain values")
        values = plain(values, "the task's result")
        return key, to_exact_json({"status": DONE, "values": values}), files
    except (Exception, SystemExit) as error:
        return key, to_exact_json(failure(error)), {}


def failure(error: BaseException) -> dict[str, Any]:
    """An exception as an outcome; with its traceback, unless it is an error that this package raises on purpose."""
    name = type(error).__name__
    outcome = {"status": FAILED, "error": name, "reason": str(error) or name}
    if not isinstance(error, TensegrityError):
        trace = error.__traceback__
        below = trace.tb_next if trace is not None else None  # this module's own frame says nothing
        outcome["traceback"] = "".join(traceback.format_exception(type(error), error, below))
    return outcome


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
                yield partial(_answers, partial(_Processes, self.count or int(cpu_count())), None)
        else:
            optional("distributed", "a cluster", of_extra("cluster"))
            with _connected(self.address, self.client) as client:
                for name in (__package__, task.__module__):  # before any point
                    try:
                        client.run(exec, f"import {name}")  # a builtin, which needs nothing to be sent
                    except Exception as error:
                        raise OptionError(
                            f"workers: the cluster cannot import '{name}' ({type(error).__name__}: {error}); install "
                            "it where its workers run, in the version used here"
                        ) from error
                yield partial(_answers, partial(_Cluster, client), self.count)


# Answers of the points given by key, as they are ready; a generator, whose `close` stops the workers.
Compute = Callable[[Task, Mapping[str, dict[str, Any]]], Generator[Answer, None, None]]


def _here(task: Task, points: Mapping[str, dict[str, Any]]) -> Generator[Answer, None, None]:
    for key, point in points.items():
        yield attempt(task, key, point)


def _answers(
    make_pool: Callable[[], _Processes | _Cluster], count: int | None, task: Task, points: Mapping[str, dict[str, Any]]
) -> Generator[Answer, None, None]:
    """Answers of the points as they are ready; a point whose worker dies is tried again alone, and is then given up.

    So many at a time as the pool has places, where `count` does not say.

    Raises:
        ClusterError: if the scheduler does not answer any more, or has no workers.
        OptionError: if the workers cannot compute the task.
    """
    pool, suspects = make_pool(), {}
    # Any of the points in flight may have killed the worker: only trying each alone shows which.
    for key, answer in _results(pool, count, task, points):
        if answer is None:
            suspects[key] = points[key]
        else:
            yield answer
    for key, answer in _results(pool, 1, task, suspects):
        yield answer or (key, DIED, {})


def _results(
    pool: _Processes | _Cluster, count: int | None, task: Task, points: Mapping[str, dict[str, Any]]
) -> Generator[tuple[str, Answer | None], None, None]:
    """(key, answer) of each point as it ends, None where its worker died; `count` at a time, so that none waits."""
    ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
    left, running = iter(points.items()), dict[int, tuple[str, Any]]()
    try:
        while True:
            while len(running) < (count or pool.places) and (following := next(left, None)) is not None:
                key, point = following
                future = pool.submit(attempt, task, key, point)
                running[id(future)] = key, future
                future.add_done_callback(ended.put)
            if not running:
                return
            try:
                future = ended.get(timeout=LOOK_INTERVAL)
            except queue.Empty:
                pool.look()
                continue
            answer = _result(pool, future, task)
            key, _ = running.pop(id(future))
            yield key, answer
    finally:
        pool.give_up([future for _, future in running.values()])


def _result(pool: _Processes | _Cluster, future: Any, task: Task) -> Answer | None:
    while True:
        try:
            answer: Answer = future.result(timeout=LOOK_INTERVAL)
            return answer
        except TimeoutError:  # the worker that has it may be lost: Dask computes it again
            pool.look()
        except pool.died:
            return None
        except CancelledError as error:
            raise _lost(str(error)) from error
        except TensegrityError:
            raise
        except Exception as error:
            raise OptionError(
                f"the workers cannot compute '{task.__name__}' ({type(error).__name__}: {error}); its module "
                f"'{task.__module__}' and tensegrity_mj must be installed where they run"
            ) from error


class _Processes:
    """Processes of this machine, of one thread each; they wait a while for more work of the same place."""

    def __init__(self, places: int) -> None:
        from joblib.externals.loky.process_executor import TerminatedWorkerError
        from joblib.parallel import ParallelBackendBase

        self.places, self.died = places, TerminatedWorkerError
        own = dict.fromkeys(ParallelBackendBase.MAX_NUM_THREADS_VARS, "1")
        begin = {"initializer": settle, "initargs": (os.getpid(), os.getcwd(), *sys.path)}
        self._begin: dict[str, Any] = {"max_workers": places, "timeout": IDLE_TIMEOUT, "env": own, **begin}

    def submit(self, *call: Any) -> Any:
        """Submit a call; returns its future."""
        while True:
            with contextlib.suppress(self.died):  # a process that died in this very moment: the next ones are new
                return self._executor().submit(*call)

    def look(self) -> None:
        """Look at nothing: a process that dies says so."""

    def give_up(self, futures: list[Any]) -> None:
        """Stop the processes where something is left that is not wanted any more."""
        if futures:
            self._executor().shutdown(kill_workers=True)
            # The feeder of a stopped queue cleans up its semaphore; a process that ends meanwhile prints a warning.
            for thread in threading.enumerate():
                if thread.name == "QueueFeederThread":
                    thread.join(FEEDER_WAIT)

    def _executor(self) -> Any:
        from joblib.externals.loky import get_reusable_executor

        return get_reusable_executor(**self._begin)


class _Cluster:
    """A cluster that is looked at while nothing comes from it.

    Dask itself gives a point to other workers when its worker dies, and gives it up when several died with it.
    """

    def __init__(self, client: Any) -> None:
        from distributed import KilledWorker

        self.client, self.died, self.places = client, KilledWorker, 1
        self.seen = time.monotonic()
        self.look()

    def submit(self, *call: Any) -> Any:
        """Submit a call; returns its future."""
        return self.client.submit(*call, pure=False)

    def look(self) -> None:
        """Count the threads; raise ClusterError if the scheduler does not answer, or had no workers for a while."""
        if self.client.status != "running":
            raise _lost(f"its connection is {self.client.status}")
        try:
            workers = self.client.nthreads(callback_timeout=ANSWER_TIMEOUT)
        except Exception as error:  # any error that a broken connection raises
            raise _lost(f"{type(error).__name__}: {error}") from error
        if workers:
            self.places, self.seen = max(1, sum(workers.values())), time.monotonic()
        elif time.monotonic() - self.seen > WORKER_TIMEOUT:
            raise ClusterError(
                f"workers: the cluster has had no worker for {WORKER_TIMEOUT:.0f} s; start some with `dask worker`"
            )

    def give_up(self, futures: list[Any]) -> None:
        """Let go of what is not wanted any more."""
        for future in futures:
            future.release()


def _lost(reason: str) -> ClusterError:
    return ClusterError(f"workers: the scheduler of the cluster does not answer any more ({reason}); start it again")


def settle(parent: int, *place: str) -> None:
    """Begin as a worker process of `parent`: leave Ctrl-C to it, and end when it ends, for any reason.

    `place`, the parent's folder and where it looks for modules, is for joblib alone: it gives work to workers that wait
    for more where they have begun with the same arguments, and has new ones begin in the new place otherwise.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    # A parent that was killed cannot stop its children, and they would wait for work for minutes.
    while os.getppid() == parent:
        time.sleep(WATCH_INTERVAL)
    os._exit(1)


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
    """Provide the client given, or one of our own; raise OptionError if no scheduler answers, or it is none."""
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

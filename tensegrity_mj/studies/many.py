"""`run_many`: one way to run many. Each finished point is saved at once, and a study goes on where it stopped."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypedDict

from tensegrity_mj.basics.jsontext import from_exact_json, to_exact_json
from tensegrity_mj.basics.progress import bar
from tensegrity_mj.basics.texts import file_name
from tensegrity_mj.errors import ClusterError, OptionError
from tensegrity_mj.simulation import versions
from tensegrity_mj.studies import store
from tensegrity_mj.studies.plain import digest, plain
from tensegrity_mj.studies.workers import DONE, Backend, Task, Workers

Values = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes:
        task: the module and the name of the function.
        points: in the order given.
        outcomes: one a point: {"status": "done", "values": {...}}, or {"status": "failed", "error": class of the
            exception, "reason": its message} and its "traceback" where the error was no `TensegrityError`.
        common, identity: as given to `run_many`.
        folder: where it is kept, or None.
        computed: how many different points this call computed; the others were there.
        seconds: how long this call took.
    """

    task: str
    points: tuple[Values, ...]
    outcomes: tuple[Values, ...]
    common: Values
    identity: Values
    folder: Path | None
    computed: int
    seconds: float

    @property
    def failed(self) -> list[int]:
        """The numbers of the points that failed."""
        return [number for number, outcome in enumerate(self.outcomes) if outcome["status"] != DONE]

    def values(self, name: str) -> list[Any]:
        """Return one value of every point; None where a point failed or has no such value."""
        return [outcome.get("values", {}).get(name) for outcome in self.outcomes]

    def rows(self, lost: Callable[[Values], Values]) -> list[Values]:
        """All values of every point; of one that failed, what `lost` makes of its outcome."""
        return [outcome["values"] if outcome["status"] == DONE else lost(outcome) for outcome in self.outcomes]

    def file(self, number: int, name: str) -> Path | None:
        """Return the path of a file that the task left for a point; None if it left none of that name."""
        if self.folder is None:
            return None
        path = self.folder / store.FILES / _file_name(self.points.index(self.points[number]), name)
        return path if path.is_file() else None

    def to_dict(self) -> dict[str, Any]:
        """Return the content of result.json. Tracebacks stay in points.jsonl."""
        outcomes = [{key: item for key, item in outcome.items() if key != "traceback"} for outcome in self.outcomes]
        return {
            "format": store.FORMAT,
            "task": self.task,
            "identity": self.identity,
            "common": self.common,
            "points": [
                {"point": point, "outcome": outcome} for point, outcome in zip(self.points, outcomes, strict=True)
            ],
        }


class RunOptions(TypedDict, total=False):
    """Arguments of `run_many` that studies hand on; who calls a study gives `workers` and `progress`."""

    identity: Mapping[str, Any] | None
    workers: Workers | None
    progress: bool
    label: str


def run_many(
    task: Task,
    points: Sequence[Mapping[str, Any]],
    folder: str | os.PathLike[str] | None = None,
    *,
    common: Mapping[str, Any] | None = None,
    identity: Mapping[str, Any] | None = None,
    workers: Workers | None = None,
    progress: bool = False,
    label: str = "points",
) -> Study:
    """Compute a function at many points; in a folder, go on where an earlier call stopped.

    What is finished is on disk at once, so that nothing finished is lost or computed again, however the earlier call
    ended. The result depends neither on interruptions nor on the workers. Equal points are computed once.

    Args:
        task: a function of a module (workers import it): a dict of plain values in, one out, or `WithFiles`. What it
            raises becomes the outcome of its point.
        points: dicts of plain values (see `plain`), one a call of the task.
        folder: made where it is absent; None keeps everything in memory.
        common: values that every point has in addition to its own; the task gets both in one dict.
        identity: values that the task does not get, but that make a study another one when they differ: versions,
            for example.
        workers: who computes; all cores of this machine by default.
        progress: show a bar with the time left on stderr.
        label: what stands before the bar.

    Raises:
        OptionError: a task that is no function of a module, a point that is not plain, a folder that holds another
            study or is in use.
        MissingLibraryError: if workers need Dask and it is missing.
        ClusterError: if the cluster's scheduler is lost, or all of its workers are; its message says as much as that of
            KeyboardInterrupt. What one lost worker had is computed again by others.
        KeyboardInterrupt: on Ctrl-C or SIGTERM; its message says how much is finished, and how to go on.
    """
    name = task_name(task)
    workers, started = workers or Workers(), time.perf_counter()
    shared, facts = plain(common or {}, "common"), plain(identity or {}, "identity")
    given = [_point(number, point, shared) for number, point in enumerate(points)]
    # The key is of everything that the task gets, so that a record means the same in any order and any folder.
    calls = {digest({"task": name, "point": shared | point}): shared | point for point in given}
    keys = [digest({"task": name, "point": shared | point}) for point in given]
    first = {key: number for number, key in reversed(list(enumerate(keys)))}
    place = None if folder is None else Path(folder)
    study = {"task": name, "identity": facts, "common": shared, "points": given}

    with contextlib.ExitStack() as stack:
        saved = stack.enter_context(store.opened(place, study))
        missing = {key: call for key, call in calls.items() if key not in saved.outcomes}
        if missing:
            shown = stack.enter_context(bar_of(label, len(calls), len(calls) - len(missing), progress))
            compute = stack.enter_context(workers.ready(task))
            try:
                with _stoppable(workers.backend), contextlib.closing(compute(task, missing)) as results:
                    for key, text, files in results:
                        named = {_file_name(first[key], own): content for own, content in files.items()}
                        saved.add(key, from_exact_json(text), named)
                        shown.update()
            except (KeyboardInterrupt, ClusterError) as error:
                reached = saved.stopped(f"{{}} of {len(calls)} points are finished")
                if isinstance(error, ClusterError):
                    raise ClusterError(f"{error}. {reached}") from error
                raise KeyboardInterrupt(reached) from None
        outcomes = tuple(saved.outcomes[key] for key in keys)
        seconds = time.perf_counter() - started
        result = Study(name, tuple(given), outcomes, shared, facts, place, len(missing), seconds)
        if place is not None:
            store.write(place / store.RESULT, f"{to_exact_json(result.to_dict(), indent=1)}\n".encode())
    return result


def run_study(
    task: Task,
    points: Sequence[Mapping[str, Any]],
    folder: str | os.PathLike[str] | None,
    label: str,
    how: RunOptions,
    common: Mapping[str, Any] | None = None,
) -> Study:
    """`run_many` for a study of the package: of other versions it is another one."""
    options: RunOptions = {"label": label, **how}
    options["identity"] = {"versions": versions(), **(how.get("identity") or {})}
    return run_many(task, points, folder, common=common, **options)


def task_name(task: Any) -> str:
    """The module and the name of a function.

    Raises:
        OptionError: if workers could not import it: it is no function, has no name, or is a script's own.
    """
    module, name = getattr(task, "__module__", None), getattr(task, "__qualname__", None)
    if not callable(task) or not isinstance(module, str) or not isinstance(name, str):
        raise OptionError(f"task = {task!r}; it must be a function of a module")
    if "<" in name or "." in name or getattr(sys.modules.get(module), name, None) is not task:
        raise OptionError(f"task {module}.{name}: it must stand at the top of its module, where workers can import it")
    if module == "__main__":
        raise OptionError(
            f"task {name}: it belongs to the script that runs; put it in a module that workers can import"
        )
    return f"{module}.{name}"


def _point(number: int, point: Any, shared: Values) -> Values:
    if not isinstance(point, Mapping):
        raise OptionError(f"points[{number}] = {point!r}; it must be a dict of plain values")
    values: Values = plain(point, f"points[{number}]")
    if both := sorted(values.keys() & shared.keys()):
        raise OptionError(f"points[{number}]: '{both[0]}' is in `common` too; give it once")
    return values


def _file_name(number: int, name: str) -> str:
    return f"{number:06d}-{file_name(name)}"


def bar_of(label: str, total: int, done: int, shown: bool) -> Any:
    """A progress bar with the time left, where it is to be shown."""
    form = "{desc} {percentage:3.0f}% |{bar}| {n_fmt}/{total_fmt} [{elapsed} < {remaining}]"
    return bar(shown, label, total=total, initial=done, bar_format=form)


@contextlib.contextmanager
def _stoppable(backend: Backend) -> Iterator[None]:
    """Stop at SIGTERM as at Ctrl-C, and do not let a second one disturb the stopping."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        for one in (signal.SIGINT, signal.SIGTERM):
            signal.signal(one, signal.SIG_IGN)
        raise KeyboardInterrupt

    def pass_on(number: int, frame: FrameType | None) -> None:
        # Compiled code may be running: the handler of Ctrl-C knows (see `interrupts`).
        signal.raise_signal(signal.SIGINT)

    handlers: dict[signal.Signals, Any]
    if backend is Backend.THIS_PROCESS:
        handlers = {signal.SIGTERM: pass_on}
    else:
        handlers = {signal.SIGTERM: stop, signal.SIGINT: stop}
    # Signals that other code catches or ignores are left to it.
    usual = (signal.SIG_DFL, signal.default_int_handler)
    previous = {one: signal.getsignal(one) for one in handlers if signal.getsignal(one) in usual}
    for one in previous:
        signal.signal(one, handlers[one])
    try:
        yield
    finally:
        for one, handler in previous.items():
            signal.signal(one, handler)

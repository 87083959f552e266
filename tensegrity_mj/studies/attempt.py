"""Computation of one point, where the work is done: in a worker process, a cluster, or here. Failures are data, too."""

from __future__ import annotations

import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from tensegrity_mj.basics.jsontext import to_exact_json
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.studies.plain import plain

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


@dataclass(frozen=True)
class WithFiles:
    """Result of a task that leaves files too: plain values, and the content of each file by its name.

    The process that runs the study writes the files, so that workers need not share a file system with it.
    """

    values: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)


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


def unable(task: Task, error: BaseException) -> OptionError:
    """The error of workers that cannot even begin a task."""
    return OptionError(
        f"the workers cannot compute '{task.__name__}' ({type(error).__name__}: {error}); its module "
        f"'{task.__module__}' and tensegrity_mj must be installed where they run"
    )


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

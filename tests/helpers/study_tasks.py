"""Tasks of studies, in a module that worker processes can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from tensegrity_mj.errors import InfeasibleError
from tensegrity_mj.studies.workers import WithFiles


def noted(point: dict[str, Any]) -> dict[str, Any]:
    """A third of x; writes into $STUDY_LOG, if that is set, which point it computes in which process."""
    log = os.environ.get("STUDY_LOG")
    if log:
        with open(log, "a", encoding="utf-8") as file:
            file.write(f"{point['x']} {os.getpid()}\n")
    time.sleep(point.get("seconds", 0.0))
    return {"third": point["x"] / 3, "odd": point["x"] % 2 == 1}


def troubled(point: dict[str, Any]) -> Any:
    """Everything that can go wrong, by the point's `how`."""
    match point["how"]:
        case "well":
            return {"x": np.float64(0.1), "list": np.arange(3), "nan": float("nan")}
        case "infeasible":
            raise InfeasibleError("no admissible u")
        case "mistake":
            return {"x": 1 / point.get("zero", 0)}
        case "exit":
            raise SystemExit("leaving")
        case "no dict":
            return [1, 2]
        case "not plain":
            return {"x": {"y": object()}}
        case "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        case "killed once":
            mark = Path(point["mark"])
            if not mark.exists():
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return {"x": 2}
        case "files":
            return WithFiles({"x": 1}, {"note.txt": b"kept", "other.bin": bytes(1000)})
        case "threads":
            return {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    raise AssertionError(point)


def simulated(point: dict[str, Any]) -> Any:
    """The task of a sweep, noted in $STUDY_LOG."""
    from tensegrity_mj.studies.sweep import simulate_point

    noted({"x": point["parameters"]["law.decay_rate"]})
    return simulate_point(point)

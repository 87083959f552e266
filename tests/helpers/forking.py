"""Processes that are forked from one that has imported already what takes most of their time."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# A line asks for a process; its number and, if that is waited for, its exit code are the answer.
SERVER = """
import json, os, runpy, sys, traceback
sys.dont_write_bytecode = True  # files are edited within a second of each other, which bytecode does not see
def main():
    for line in sys.stdin:
        run, arguments, folder, environment, is_waited_for = json.loads(line)
        child = os.fork()
        if child == 0:
            return run, arguments, folder, environment
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) if is_waited_for else 0
        print(child, code, flush=True)
    os._exit(0)
"""
SERVED = """
run, arguments, folder, environment = main()
os.chdir(folder)
os.environ.update(environment)
os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
for number, name in ((1, "out"), (2, "err")):
    os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
sys.path[0:0] = [folder, *environment.get("PYTHONPATH", "").split(os.pathsep)]
sys.argv = [run, *arguments]
failed = False
try:
    (runpy.run_path if run.endswith(".py") else runpy.run_module)(run, run_name="__main__")
except SystemExit as end:
    failed = bool(end.code)
except BaseException:
    traceback.print_exc()
    failed = True
sys.stdout.flush()
os._exit(failed)
"""


@dataclass(frozen=True)
class Forked:
    """A process that runs."""

    pid: int

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.send_signal(signal.SIGKILL)


class Forks:
    """Makes processes that run a script (.py) or a module and print into `out` and `err` of their folder."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def _asked(self, *request: Any) -> tuple[int, int]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(json.dumps(request), file=self.process.stdin, flush=True)
        pid, code = map(int, self.process.stdout.readline().split())
        return pid, code

    def run(self, folder: Path, script: str, **environment: str) -> tuple[str, str]:
        """What a script prints, and its messages."""
        for name in ("out", "err"):
            (folder / name).unlink(missing_ok=True)
        _, code = self._asked(script, [], str(folder), environment, True)
        out, err = ((folder / name).read_text() for name in ("out", "err"))
        assert code == 0, err
        return out, err

    def start(self, folder: Path, module: str, *arguments: str, **environment: str) -> Forked:
        return Forked(self._asked(module, arguments, str(folder), environment, False)[0])


@contextlib.contextmanager
def forks(imported: str, without: tuple[str, ...] = ()) -> Iterator[Forks]:
    """Processes forked from one that has run `imported`, in this environment without variables that begin so."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(without)}
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": inherited}
    with subprocess.Popen([sys.executable, "-c", f"{SERVER}{imported}{SERVED}"], **pipes) as process:
        try:
            yield Forks(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()

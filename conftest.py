"""What every test may rely on."""

from __future__ import annotations

import gc
import importlib
import importlib.util
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from types import ModuleType
from typing import Any

from quick_xla import compile_quickly

if "PYTEST_XDIST_WORKER" in os.environ:  # as many processes as cores: threads of linear algebra would only wait
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # `-n 0` tests what users run.
    compile_quickly()

# Workers of Dask's clusters are forked from a process that has imported it.
os.environ.setdefault("DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD", "forkserver")

import cloudpickle
import pytest
import session_report
from hypothesis import HealthCheck, settings

import tensegrity_mj as tmj
from tensegrity_mj.studies import workers

WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")  # the name of this process, where several test
PROCESSES = workers._Processes
LAYOUT: dict[str, Any] = {}

# Half a million objects live as long as the tests do: a search among them for garbage every 700 new ones takes a
# quarter of the time of collecting the tests and a tenth of that of tracing JAX's programs.
gc.set_threshold(50_000, 10, 10)

# No test depends on how fast the machine is, which this check of hypothesis does.
settings.register_profile("any speed", suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any speed")

# A shell that starts this in the background makes it deaf to SIGINT; tests of interrupts need to hear it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(session_report)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A longer limit for studies, which take minutes each on an idle machine; and the order for several processes.

    Files with slow tests come first, and long files before short ones, so that none that takes long is begun when all
    other processes are already done.
    """
    for item in items:
        if item.get_closest_marker("study") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(3000))
    if WORKER:
        sizes = {path: path.stat().st_size for path in {item.path for item in items}}
        items.sort(key=lambda item: (item.get_closest_marker("slow") is None, -sizes[item.path], item.path))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[Any]:
    """Every second process reads the files from the last on.

    To compile a file's assertions takes a process longer than all else of collecting it. Each keeps what it compiles,
    so that two processes do half of it each.
    """
    report = yield
    if isinstance(collector, pytest.Directory) and WORKER.endswith(tuple("13579")):
        report.result.reverse()
    return report


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Studies compute their points here, sent as to another process: to start two of these takes three seconds.

    And where several processes test, figures are not laid out, which takes longer than drawing them: tests/pictures
    looks at layouts.
    """
    workers._Processes = PROCESSES if item.get_closest_marker("workers") else OnePlace
    if WORKER:
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        LAYOUT.setdefault("real", ConstrainedLayoutEngine.execute)
        ConstrainedLayoutEngine.execute = LAYOUT["real"] if "pictures" in item.path.parts else lambda *_: None


class OnePlace:
    """Stands for the processes of workers, but in tests marked `workers`: computes at once what it is given."""

    places, died = 1, ()

    def __init__(self, places: int) -> None:
        """There is one place, whatever is wanted."""

    def submit(self, call: Callable[..., Any], *given: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(sent(call(*sent(given))))
        return future

    def look(self) -> None:
        """Nothing can be lost."""

    def give_up(self, futures: list[Any]) -> None:
        """Nothing is under way."""


def sent(value: Any) -> Any:
    """What comes of a value in another process."""
    return pickle.loads(cloudpickle.dumps(value))


# Scenes are immutable: one of each serves every test.


@pytest.fixture(scope="session")
def prism() -> tmj.Scene:
    """The shipped three-bar prism with its control law."""
    return tmj.load_scene("prism")


@pytest.fixture(scope="session")
def law(prism: tmj.Scene) -> Any:
    """The prism's own law, which keeps nothing between calls."""
    return tmj.controllers.from_scene(prism)


@pytest.fixture(scope="session")
def prism_run(prism: tmj.Scene) -> tmj.Trajectory:
    """A tenth of a second of the prism under its law, in MuJoCo, at a step of 10 ms."""
    return tmj.simulate(prism, tmj.controllers.from_scene(prism), tmj.MuJoCo(1e-2), duration=0.1)


@pytest.fixture(scope="session")
def pinned_rod() -> tmj.Scene:
    """The shipped pinned rod with its control law."""
    return tmj.load_scene("pinned_rod")


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Imports an example by its name."""
    examples = Path(__file__).parent / "examples"
    monkeypatch.syspath_prepend(str(examples))

    def read(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, examples / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
        return module

    return read

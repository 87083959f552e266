"""What a run of the tests ends with: the memory of each process, and, on request, the tests nearest to their bounds.

With the setting `enable_assertion_pass_hook=true` every assertion that passes is read as pytest explains it,
"4e-13 <= 1e-12" or "1.0 == 1.0 ± 1e-9", beside `assert_allclose`: the largest quotient of error and bound of each test.
"""

from __future__ import annotations

import ctypes
import gc
import os
import re
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

SMALL = 1e-6  # bounds above it are none of round-off
NEAR = 0.1  # of its bound: a quotient that is listed
MOST = 40  # lines
FREED_FROM, MOST_HELD = 0.5e9, 0.9e9  # bytes of a process, above which a module's end, or a test's, frees memory
WORTH = 0.25e9  # bytes above what was left the last time: less is not worth compiling again what is freed

quotients: dict[str, float] = {}
left = {"bytes": 0.0}  # when memory was last freed
peaks: dict[str, str] = {}  # by process: the largest memory, and the test that raised it most
rise: dict[str, Any] = {"peak": 0.0, "by": 0.0, "test": ""}  # [GB]
NUMBER = re.compile(r"(?!.*\.\.)[\d.e+\-*/() ]+")  # and none that is shortened by dots


def note(error: Any, bound: Any) -> None:
    """Keep the largest quotient of the test under way."""
    with np.errstate(all="ignore"):
        found = float(np.nanmax(np.asarray(error) / np.asarray(bound), initial=0.0))
    name = os.environ.get("PYTEST_CURRENT_TEST", "").split(" (")[0]
    quotients[name] = max(quotients.get(name, 0.0), found)


def resident() -> float:
    """Bytes of memory of this process; infinite where the system does not tell."""
    pages = Path("/proc/self/statm")
    return int(pages.read_text().split()[1]) * resource.getpagesize() if pages.exists() else np.inf


def pytest_assertion_pass(expl: str) -> None:
    """Called where the setting is on."""
    first = re.sub(r"np\.float64\(([^()]*)\)", r"\1", expl.split("\n")[0])
    for pattern, is_approx in ((r"(.+?) (?:<|<=) (.+)", False), (r"(.+?) == (.+) ± (.+)", True)):
        sides = match.groups() if (match := re.fullmatch(pattern, first)) else ()
        if sides and all(NUMBER.fullmatch(side) and side.count("(") == side.count(")") for side in sides):
            one, *others = (eval(side) for side in sides)  # of digits and signs alone
            bound, scale = others[-1], abs(others[0]) if is_approx and others[0] else 1.0
            if 0 < bound <= SMALL * scale:
                note(abs(one - others[0]) if is_approx else one, bound)


def pytest_configure(config: pytest.Config) -> None:
    if not config.getini("enable_assertion_pass_hook"):
        return
    compared = np.testing.assert_allclose

    def measured(actual: Any, desired: Any, rtol: float = 1e-7, atol: float = 0, **options: Any) -> None:
        compared(actual, desired, rtol=rtol, atol=atol, **options)
        bound = np.broadcast_arrays(atol + rtol * np.abs(desired), np.asarray(actual, float))[0]
        if np.any(bound > 0) and rtol <= SMALL:
            note((np.abs(np.asarray(actual) - desired) * np.ones(bound.shape))[bound > 0], bound[bound > 0])

    np.testing.assert_allclose = measured


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Any:
    """Free what a module's tests compiled and drew, of which the next needs nothing, where that is much."""
    done = yield
    if (peak := largest()) - rise["peak"] > rise["by"] and rise["peak"]:
        rise.update(by=peak - rise["peak"], test=item.nodeid)
    rise["peak"] = peak
    ends = nextitem is None or nextitem.path != item.path
    if resident() > max(FREED_FROM if ends else MOST_HELD, left["bytes"] + WORTH):
        for value in vars(getattr(item, "module", None) or object).values() if ends else ():
            if getattr(value, "__module__", "") == item.path.stem and hasattr(value, "cache_clear"):
                value.cache_clear()
        if "jax" in sys.modules:
            sys.modules["jax"].clear_caches()
        if "matplotlib.pyplot" in sys.modules:
            sys.modules["matplotlib.pyplot"].close("all")
        gc.collect()
        if sys.platform == "linux":
            getattr(ctypes.CDLL(None), "malloc_trim", int)(0)  # of glibc, which keeps most of what is freed
        left["bytes"] = resident()
    return done


def largest() -> float:
    """The most memory that this process has had [GB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e9 if sys.platform == "darwin" else 1e6)


def pytest_sessionfinish(session: pytest.Session) -> None:
    most = f"{largest():.2g} GB" + (f", {rise['by']:.2g} GB of it in {rise['test']}" if rise["test"] else "")
    peaks[os.environ.get("PYTEST_XDIST_WORKER", "this process")] = most
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput |= {"peaks": peaks, "quotients": quotients}


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """What a process of xdist brings."""
    output = getattr(node, "workeroutput", {})
    peaks.update(output.get("peaks", {}))
    quotients.update(output.get("quotients", {}))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    for name, most in sorted(peaks.items()):
        terminalreporter.write_line(f"largest memory: {name} {most}")
    near = sorted((-value, name) for name, value in quotients.items() if value > NEAR)
    for value, name in near[:MOST]:
        terminalreporter.write_line(f"error/bound {-value:.2g}  {name}")

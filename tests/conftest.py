"""What every test may rely on."""

from __future__ import annotations

import signal

import pytest

import tensegrity_mj as tmj

# A shell that starts this in the background makes it deaf to SIGINT; tests of interrupts need to hear it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Studies take minutes each on an idle machine: their limit against hanging is longer."""
    for item in items:
        if item.get_closest_marker("study") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(3000))


# Scenes are immutable: one of each serves every test.


@pytest.fixture(scope="session")
def prism() -> tmj.Scene:
    """The shipped three-bar prism with its control law."""
    return tmj.load_scene("prism")


@pytest.fixture(scope="session")
def pinned_rod() -> tmj.Scene:
    """The shipped pinned rod with its control law."""
    return tmj.load_scene("pinned_rod")

"""Check the package itself: what it promises of accuracy, what it does at the extremes, how it drifts, its speed."""

from types import ModuleType

from evidence.commands.audit import drift, extremes, promise, speed

COMMANDS: dict[str, ModuleType] = {"extremes": extremes, "promise": promise, "drift": drift, "speed": speed}

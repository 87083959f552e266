"""Check the package itself: promised accuracy, extreme runs, stable steps, drift over long runs, speed."""

from types import ModuleType

from evidence.commands.audit import drift, extremes, promise, speed, stability

COMMANDS: dict[str, ModuleType] = {
    "extremes": extremes,
    "promise": promise,
    "stability": stability,
    "drift": drift,
    "speed": speed,
}

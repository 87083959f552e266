"""Check the package itself: promised accuracy, extreme runs, stable steps, drift over long runs, speed, steps."""

from types import ModuleType

from evidence.commands.audit import drift, extremes, promise, speed, stability, step

COMMANDS: dict[str, ModuleType] = {
    "extremes": extremes,
    "promise": promise,
    "stability": stability,
    "drift": drift,
    "speed": speed,
    "step": step,
}

"""Input and output of every engine: a request, recorded rows, and the trajectory made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, member, positive
from tensegrity_mj.basics.seconds import Rounded, fitted, read
from tensegrity_mj.controllers.scenes import AnyLaw, law_for
from tensegrity_mj.dynamics.native.law import NativeLaw, native_law
from tensegrity_mj.engines.continuing import Start
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Actuation, Mode, OnInfeasible, whole_ratio
from tensegrity_mj.model.moved_supports import check_motions_until
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.runs.trajectory import Trajectory

if TYPE_CHECKING:
    from tensegrity_mj.dynamics.native.plant import Plant


@dataclass(frozen=True)
class Request:
    """One run to be made: the same for every engine."""

    scene: Scene
    law: NativeLaw
    actuation: Actuation = field(default_factory=Actuation.continuous)
    on_infeasible: OnInfeasible = OnInfeasible.STOP
    duration: float = 1.0
    output_interval: float | None = None
    progress: bool = False
    start: Start | None = None  # where it goes on from another run

    @property
    def sampled(self) -> bool:
        """True where the law is sampled."""
        there = bool(self.law.address) or self.law.own is not None  # compiled, or as arrays alone
        return there and self.actuation.mode is not Mode.CONTINUOUS

    @property
    def begin(self) -> float:
        """Time [s] at which it begins."""
        return float(self.scene.start_time) if self.start is None else self.start.time

    @property
    def intervals(self) -> dict[str, float]:
        """Intervals [s] that fixed steps divide, by what they are."""
        found = {"duration": self.duration}
        if self.output_interval is not None:
            found["output interval"] = self.output_interval
        if self.sampled:
            assert self.actuation.period is not None
            found["control period"] = self.actuation.period
        if self.begin > 0:
            found["start"] = self.begin
        breaks = [one for one in self.scene.breaks if self.begin < one.time < self.begin + self.duration]
        return found | {f"break of string '{one.string}'": one.time for one in breaks}

    @property
    def softer(self) -> str:
        """Another remedy for a run with contact that diverged, as words within a list of remedies, or ""."""
        contact = self.scene.contact
        return "" if contact is None else f"make contacts softer (stiffness = {contact.stiffness:g} /s²), "

    @property
    def kinks(self) -> list[float]:
        """Times [s] at which forces have kinks in any state: in data of supports, or in a law at every stage."""
        times = {time for motion in self.scene.motions for time in motion.times}
        times.update(() if self.sampled else self.law.kinks)
        return sorted(time for time in times if self.begin < time < self.begin + self.duration)


def request_for(
    scene: Scene,
    controller: AnyLaw,
    duration: float | None,
    actuation: Actuation | None,
    on_infeasible: OnInfeasible,
    output_interval: float | None,
    progress: bool,
    as_c: Callable[[Any, Structure], NativeLaw] = native_law,
) -> Request:
    """A request to an engine, checked; the arguments are those of `simulate`.

    Args:
        as_c: (law, structure) -> its C function.

    Raises:
        OptionError: for options that are out of range or contradict each other.
        SceneError: where a support's motion, given as data, ends on its way within the run.
    """
    actuation = Actuation.continuous() if actuation is None else actuation
    instance("actuation", actuation, Actuation, "use Actuation.continuous() or one of the hold modes")
    member("on_infeasible", on_infeasible, OnInfeasible)
    total = read(repr(float(scene.duration))) if duration is None else duration
    total = positive("duration", total, "s")
    if output_interval is not None:
        output_interval = positive("output_interval", output_interval, "s")
    if output_interval is not None and output_interval > total * (1 + 1e-12):
        raise OptionError(f"output_interval = {output_interval!r} s is longer than the run of {total} s")
    check_motions_until(scene, scene.start_time + total)
    controller = law_for(scene, controller)
    law = as_c(controller, scene.structure)
    if law.discontinuous and actuation.mode is Mode.CONTINUOUS:
        raise OptionError(law.discontinuous)
    if controller is None and actuation.mode is not Mode.CONTINUOUS:
        raise OptionError(f"actuation '{actuation.mode.value}' without a law: there is nothing to sample; leave it out")
    if law.period is not None and actuation.period is not None and abs(actuation.period / law.period - 1) > 1e-9:
        raise OptionError(
            f"control period = {actuation.period:g} s: the law (or its recording) has samples each {law.period:g} s; "
            "use that period"
        )
    return Request(scene, law, actuation, on_infeasible, total, output_interval, progress)


def settled(engine: Any, request: Request) -> tuple[Any, Request, list[str]]:
    """An engine and a request whose step divides the request's times, as far as their digits leave it open (`fitted`).

    Returns:
        Both, with plain floats, and a sentence for each number that was taken for another one than was written.
    """
    step, times, words = getattr(engine, "timestep", None), request.intervals, []
    found = {what: float(time) for what, time in times.items()}
    if step is not None and getattr(engine, "accuracy", None) is None:
        h, found = fitted(step, times)
        for what, one in {"time step": step, **times}.items():
            new = found.get(what, h)
            if isinstance(one, Rounded) and new != one:
                count = round(found.get(what, found["duration"]) / h)
                words.append(f"{what} {one.text} s is taken as {new!r} s ({count} steps)")
        if isinstance(step, Rounded):
            engine = replace(engine, timestep=h)
    period = found.get("control period", request.actuation.period)
    if request.sampled and request.begin > 0:
        whole_ratio(request.begin, float(period or 0), "start over the control period")
    actuation = request.actuation if period is None else Actuation(request.actuation.mode, float(period))
    interval = found.get("output interval")
    return engine, replace(request, duration=found["duration"], output_interval=interval, actuation=actuation), words


@dataclass(frozen=True)
class ReadyRun:
    """A run that is ready to start.

    Attributes:
        run: its loop, and the trajectory of it.
        plant: packed for it; None where its engine packs none, or several as it chooses its method.
    """

    run: Callable[[], Trajectory]
    plant: Plant | None = None

    @classmethod
    def of(cls, engine: Any, request: Request) -> ReadyRun:
        """A request prepared by its engine; `engine.run` as it is of one that has no `prepare`."""
        prepare: Any = getattr(engine, "prepare", None)
        return cls(partial(engine.run, request)) if prepare is None else prepare(request)


class Accelerations(Protocol):
    """Accelerations of the nodes from an engine's own equations, at one state and without a step.

    Called with time [s], node positions and velocities (N, 3), and rest lengths (M,) [m] (None: the structure's, or
    what the law sets). Returns the positions (N, 3) [m] where the engine places the nodes, and their accelerations
    (N, 3) [m/s²].
    """

    def __call__(
        self, time: float, nodes: Array, velocities: Array, rest_lengths: Array | None = None
    ) -> tuple[Array, Array]: ...


class AcceleratingEngine(Protocol):
    """An engine that gives the accelerations of the nodes."""

    def accelerations(self, request: Request) -> Accelerations:
        """See `Accelerations`."""
        ...

"""Many simulations at once at the speed of the engine, `simulate_many`; a law in MuJoCo's own loops, `law_in`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tensegrity_mj.basics import interrupts, kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import checked, instance, member
from tensegrity_mj.controllers.scenes import SCENE_LAW, AnyLaw, law_for
from tensegrity_mj.dynamics.native.law import FAILED, NO_SOLUTION, NOT_FINITE, NativeLaw, native_law
from tensegrity_mj.engines.request import Request, request_for, settled
from tensegrity_mj.engines.requirements import require
from tensegrity_mj.engines.table import ENGINES, checked_engine
from tensegrity_mj.errors import ControllerError, DivergenceError, InfeasibleError, OptionError, TensegrityError
from tensegrity_mj.model.actuation import Actuation, OnInfeasible
from tensegrity_mj.model.elements.elastic_rods import carried
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation.single import provenance_of
from tensegrity_mj.vibration.step_warnings import warn_before_run

if TYPE_CHECKING:
    from tensegrity_mj.engines.jax.program import JAXEnsemble
    from tensegrity_mj.engines.jax.settings import JAX
    from tensegrity_mj.engines.mujoco.ensemble import MuJoCoEnsemble
    from tensegrity_mj.engines.mujoco.settings import MuJoCo
    from tensegrity_mj.engines.reference.engine import ReferenceEngine
    from tensegrity_mj.engines.reference.ensemble import IntegratedEnsemble

_MEMBERS: dict[str, Callable[[Any], Any]] = {
    "nodes": lambda structure: structure.node_names,
    "rods": lambda structure: [(rod.name, rod.nodes) for rod in structure.rods],
    "strings": lambda structure: [(string.name, string.nodes) for string in structure.strings],
}


class Ensemble(Sequence[Trajectory]):
    """The runs of `simulate_many`. `ensemble[i]` is run i as a `Trajectory`, or raises what `simulate` would raise.

    Attributes:
        scenes: of the runs.
        time: (T,) [s].
        cost: wall time [s], steps and evaluations of all runs together; of DAE and ODE, how many runs went side by side
            (`lanes`), and why others did not.
    """

    def __init__(
        self, engine_run: MuJoCoEnsemble | IntegratedEnsemble | JAXEnsemble, requests: Sequence[Request]
    ) -> None:
        self._run, self._requests = engine_run, requests
        self._outcomes: dict[int, Trajectory | TensegrityError] = {}
        self.scenes = tuple(request.scene for request in requests)
        self.time: Array = engine_run.times
        self.cost = engine_run.cost

    def __len__(self) -> int:
        return len(self._requests)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(len(self)))]
        outcome = self._outcome(range(len(self))[number])
        if isinstance(outcome, TensegrityError):
            raise outcome
        return outcome

    def _outcome(self, number: int) -> Trajectory | TensegrityError:
        if number not in self._outcomes:
            try:
                run = self._run.members[number].conclude(self._run.seconds / len(self))
                run.provenance.update(provenance_of(self._requests[number]))
                run.provenance["engine"]["one_of"] = len(self)
                self._outcomes[number] = run
            except TensegrityError as error:
                self._outcomes[number] = error
        return self._outcomes[number]

    @property
    def nodes(self) -> Array:
        """Node positions (S, T, N, 3) [m]; NaN from where a run ended early."""
        return self._recorded(0)

    @property
    def velocities(self) -> Array:
        """Node velocities (S, T, N, 3) [m/s]; NaN from where a run ended early."""
        return self._recorded(1)

    def _recorded(self, part: int) -> Array:
        N, T = len(self.scenes[0].structure.nodes), len(self.time)
        out = np.empty((len(self), T, N, 3))
        members: Sequence[Any] = self._run.members
        for number, member_ in enumerate(members):
            ended, outcome = member_.ended_early, self._outcome(number)
            out[number] = member_.rows[:T, 3 * N * part : 3 * N * (part + 1)].reshape(T, N, 3)
            if isinstance(outcome, DivergenceError):  # the energy balance may know it earlier than the engine
                ended = outcome.time
            if ended is not None:
                out[number, self.time > ended] = np.nan
        return out

    @property
    def status(self) -> tuple[Status | None, ...]:
        """Status of each run; None where its law failed. A divergence is found by all that `simulate` checks."""
        found: list[Status | None] = []
        for number in range(len(self)):
            outcome = self._outcome(number)
            if isinstance(outcome, Trajectory):
                found.append(outcome.status)
            else:
                found.append(Status.DIVERGED if isinstance(outcome, DivergenceError) else None)
        return tuple(found)

    def message(self, number: int) -> str:
        """Reason why run `number` ended early; "" where it did not."""
        outcome = self._outcome(range(len(self))[number])
        return str(outcome) if isinstance(outcome, TensegrityError) else outcome.message


def simulate_many(
    scenes: Sequence[Scene],
    controllers: AnyLaw | Sequence[AnyLaw] = SCENE_LAW,
    engine: MuJoCo | ReferenceEngine | JAX | None = None,
    *,
    duration: float | None = None,
    actuation: Actuation | None = None,
    on_infeasible: OnInfeasible = OnInfeasible.STOP,
    output_interval: float | None = None,
    threads: int = 0,
    progress: bool = False,
) -> Ensemble:
    """Simulate scenes whose structures have the same members, in one process, on threads.

    Each run equals that of `simulate`. Initial states, targets, loads, breaks, and all numbers of structure, gravity
    and contact may differ from scene to scene. Nodes, rods and strings may not, nor which of them have joints or masses
    (`run_many` runs any scenes, in processes). Scenes with the same structure, gravity and contact share one model; any
    other has its own, which takes longer to set up.

    Args:
        scenes: of the same members.
        controllers: a law for all, or one a scene; each scene's own by default, None for none. A law that keeps
            something between calls gets a fresh state a run.
        engine: `MuJoCo(...)`, `DAE(...)` or `ODE(...)`, without `accuracy`; or `JAX(method="rk4", ...)`, of scenes that
            differ in their starts and in their strings' stiffness, damping and rest lengths, under one law.
        duration, actuation, on_infeasible, output_interval, progress: as in `simulate`; the duration is the first
            scene's by default.
        threads: number of threads; 0 for as many as there are cores. JAX's results depend on it by the round-off of
            sums in another order; those of others do not.

    Warns:
        StabilityWarning: where the step is beyond the largest stable one at the start of the first scene.

    Raises:
        OptionError: for options that are out of range, and for scenes that differ in more than they may.
            A single run that fails raises nothing here: see `Ensemble`.
    """
    engine = _shared(engine, "simulate_many")
    threads = checked("threads (0 for all cores)", threads, kinds.whole(0))
    scenes = _checked(scenes, engine)
    laws = list(controllers) if isinstance(controllers, Sequence) else [controllers] * len(scenes)
    if len(laws) != len(scenes):
        raise OptionError(
            f"controllers: there are {len(laws)} laws for {len(scenes)} scenes; give one law, or one each"
        )
    total = scenes[0].duration if duration is None else duration
    requests: list[Request] = []
    known: dict[int, NativeLaw] = {}  # by law: describing one may take longer than running it
    for number, (scene, given) in enumerate(zip(scenes, laws, strict=True)):
        law = law_for(scene, given)
        shared = (actuation, on_infeasible, output_interval, progress and number == 0)
        if id(law) in known and callable(getattr(law, "native", None)):
            native = native_law(law, scene.structure, known[id(law)].description)
            requests.append(replace(requests[0], scene=scene, law=native, progress=False))
        else:
            requests.append(request_for(scene, law, total, *shared))
            known[id(law)] = requests[-1].law
    engine, first, _ = settled(engine, requests[0])
    length, interval, held = first.duration, first.output_interval, first.actuation
    requests = [replace(one, duration=length, output_interval=interval, actuation=held) for one in requests]
    warn_before_run(scenes[0], engine, requests[0].law, requests[0].actuation)
    with interrupts.deferred():
        run = engine.ensemble(requests, int(threads))
        run.run()
    return Ensemble(run, requests)


def _checked(scenes: Any, engine: Any) -> list[Scene]:
    if isinstance(scenes, Scene) or not isinstance(scenes, Sequence) or not scenes:
        raise OptionError("scenes: give a list of at least one Scene")
    first, use = scenes[0], "simulate_many" if engine.descriptor.shares_model else ""
    for number, scene in enumerate(scenes):
        instance(f"scenes[{number}]", scene, Scene, "use a Scene, or load_scene(name or path)")
        require(engine, scene, use, f"scenes[{number}]")
        for what, names in _MEMBERS.items():
            if names(scene.structure) != names(first.structure):
                raise OptionError(
                    f"scenes[{number}] ('{scene.name}') has other {what} than the first: simulate_many runs structures "
                    "of the same members; use run_many for different ones"
                )
    return list(scenes)


def _shared(engine: Any, what: str) -> Any:
    """The engine; OptionError unless it makes many runs with these options."""
    engine = checked_engine(engine)
    if not callable(getattr(engine, "ensemble", None)):
        able = " or ".join(row.place.partition(":")[2] + "(...)" for row in ENGINES.values())
        raise OptionError(f"engine = {engine!r}: {what} runs in {able}; run_many takes any engine")
    if getattr(engine, "accuracy", None) is not None:
        raise OptionError(f"{what}: accuracy = {engine.accuracy:g} m chooses a step for each run; give a timestep")
    if engine.descriptor.shares_model and getattr(engine, "locate_slack", False):
        raise OptionError(
            f"{what}: locate_slack = True, which splits the steps of one run where its strings change, and here "
            "MuJoCo makes the steps of many: leave it out, or use run_many"
        )
    return engine


@contextmanager
def law_in(
    scene: Scene,
    law: AnyLaw = SCENE_LAW,
    engine: MuJoCo | None = None,
    *,
    on_infeasible: OnInfeasible = OnInfeasible.STOP,
) -> Iterator[Any]:
    """Close the loop inside MuJoCo: while this is open, every step of the MjModel that it gives is made under the law.

        with tmj.law_in(scene, law, tmj.MuJoCo(timestep=1e-3)) as model:
            data = mujoco.MjData(model)
            mujoco.mj_step(model, data, 1000)

    `mj_step`, `mujoco.rollout` and `mujoco.batch.Batch` alike, on as many threads as they use, with the model or copies
    of it. The law is evaluated at every stage, at MjData.time, and sets MjData.ctrl; external loads of the scene act.
    Masses, gravity and the like of the model may be changed, its strings may not: their stiffness and rest lengths are
    what turns the law's answer into controls. Other models are left alone. Nothing is recorded: `simulate` and
    `simulate_many` do that. An interrupt (Ctrl-C) within a law in Python is raised at the end.

    Args:
        scene: whose model is made.
        law: a law, or a function; the scene's own by default. It must not keep anything between calls.
        engine: `MuJoCo(...)`: timestep and integrator of the model.
        on_infeasible: STOP: `InfeasibleError` at the end if the law had no solution anywhere. In either case the
            controls stay as they are at a state without one.

    Raises:
        OptionError: for laws that must be sampled, or keep something between calls; for scenes with strings that
            break; within another run or `law_in` (runs of other threads are waited for). At the end, if a model of the
            same shape with other strings was stepped: it was left alone.
        ControllerError, InfeasibleError: at the end, if the law failed, or had no solution, at some state.
    """
    from tensegrity_mj.dynamics.native.plant import Plant
    from tensegrity_mj.engines.mujoco.ensemble import law_in as installed
    from tensegrity_mj.engines.mujoco.many import OTHER_STRINGS
    from tensegrity_mj.engines.mujoco.run_view import RUN

    engine = checked_engine(engine)
    if getattr(engine, "descriptor", None) is not ENGINES["mujoco"]:
        raise OptionError(f"engine = {engine!r}: law_in closes the loop inside MuJoCo: use MuJoCo(...)")
    engine = _shared(engine, "law_in")
    member("on_infeasible", on_infeasible, OnInfeasible)
    law = law_for(scene, law)
    if law is None:
        raise OptionError(f"law_in: there is no law to install, and scene '{scene.name}' names none; give law")
    request = request_for(scene, law, None, None, on_infeasible, None, False)
    if not request.law.stateless:
        raise OptionError(
            "the law keeps something between its calls, and here states are not kept apart: use simulate_many"
        )
    require(engine, scene, "law_in")
    model = engine.model(scene)
    plant = Plant(scene, request.law, request.actuation, on_infeasible, RUN, carried(scene))
    with installed(model, plant) as answers:
        yield model
    if answers[OTHER_STRINGS]:
        raise OptionError(
            f"a model was stepped that is built as that of scene '{scene.name}' but has other strings (stiffness, "
            "damping, rest lengths, nodes or order); the law was not applied to it: use a law_in of its own scene"
        )
    if answers[FAILED]:
        cause = next(iter([*(request.law.failure or []), *(error for _, error in plant.elements.failures)]), None)
        if cause is not None and not isinstance(cause, Exception):
            raise cause  # KeyboardInterrupt within Python code
        raise ControllerError(f"the law or an element failed at some state: {cause or 'no reason given'}") from cause
    if answers[NOT_FINITE]:
        raise ControllerError("the law returned a value that is not finite at some state")
    if answers[NO_SOLUTION] and on_infeasible is OnInfeasible.STOP:
        raise InfeasibleError(
            "the law had no admissible solution at some state; choose OnInfeasible.PASSIVE to keep its last controls"
        )

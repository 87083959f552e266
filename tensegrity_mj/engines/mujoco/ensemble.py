"""Many runs of one MuJoCo model at once, on threads: `mujoco.batch` steps them, each with a table of its own.

A simulation of the batch finds its table by its number in MjData.userdata, so every actuation, the ledger and the
recording are those of a single run, by the same compiled code.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, cast

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.plant import Plant
from tensegrity_mj.engines.driving import Stopwatch, drive
from tensegrity_mj.engines.mujoco import many, mjcf_tree, run_view
from tensegrity_mj.engines.mujoco.implicit_forces import set_implicit_forces
from tensegrity_mj.engines.mujoco.install import installed
from tensegrity_mj.engines.mujoco.motion import set_supports
from tensegrity_mj.engines.mujoco.prepared import Prepared, prepared, prepared_with, within
from tensegrity_mj.engines.mujoco.run import MuJoCoRun, causes_of
from tensegrity_mj.engines.mujoco.settings import MuJoCo
from tensegrity_mj.engines.recording import check_rows
from tensegrity_mj.engines.request import Request
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.scene import Scene

TOKEN = 0.7390851332151607  # separates userdata of ours from any other


class MuJoCoEnsemble:
    """Simulations of scenes whose structures have the same members.

    Attributes:
        ready: of the first scene, whose model those with the same structure, gravity and contact share.
        members: a run each, which `conclude`s with its trajectory or its error.
        models: of the simulations.
        stages: evaluations of the forces a step.
        data: in which runs are set up; each simulation has a row of the batch.
        seconds: wall time of the integration of all.
    """

    def __init__(self, options: MuJoCo, requests: Sequence[Request], threads: int) -> None:
        first, count = requests[0].scene, len(requests)
        self.options, self.seconds, self.stages = options, 0.0, options.stages
        self.ready = within(self.prepare(first))
        self.model, tree, self.data = self.ready.model, self.ready.tree, self.ready.data
        self.batch = Batch(self.model, count, threads)
        self.models, self.members = [self.model] * count, cast("list[MuJoCoRun]", [None] * count)
        self.counters, self.tables = np.zeros((count, 6), np.int64), np.zeros(count, np.int64)
        parts = [[getattr(one.scene, what) for what in ("structure", "gravity", "contact")] for one in requests]
        shared = [all(one is own or one == own for one, own in zip(part, parts[0], strict=True)) for part in parts]
        ready = [self.ready if same else self.prepare(one.scene) for same, one in zip(shared, requests, strict=True)]
        self.give_models(dict(enumerate(ready)))
        for number, request in enumerate(requests):
            if shared[number]:
                check_motions(request.scene, first, tree)
            member = self.enter(number, request, ready[number], first if shared[number] else None)
            if number == 0:
                check_rows(float(count) * member.rows.shape[0], member.rows.shape[1])
        # What the end of a step leaves in MjData the next simulation overwrites: copies, refreshed at each call.
        names = ["qvel", "qacc", "actuator_force"]
        if first.contact is not None or (first.motions and tree.forest.closures):
            names.append("qfrc_constraint")
        self.copies = {name: self.batch.bind(name) for name in names}
        self.running = np.ones(count, np.int64)
        self.guide = many.Guide(self.model)
        self.guide.set(token=TOKEN, runs=self.tables, running=self.running)
        self.guide.set_copies(self.copies)

    def prepare(self, scene: Scene) -> Prepared:
        """A scene with a model of its own.

        Raises:
            StructureError, SceneError, OptionError: as `MuJoCo.model`.
        """
        return prepared(scene, self.options.timestep, self.options.word, run_view.USERDATA_SIZE)

    def give_models(self, ready: Mapping[int, Prepared]) -> None:
        """Have simulations step these models, by their numbers.

        Raises:
            OptionError: unless they are of one kind with the first's.
        """
        models, failed = list(self.models), ""
        for number, one in ready.items():
            models[number] = one.model
            if one.model.signature != self.model.signature:
                failed = failed or f"scenes[{number}]"
        if all(one is other for one, other in zip(models, self.models, strict=True)):
            return
        try:
            if not failed:
                self.batch.set_models(models)
        except (ValueError, mujoco.FatalError) as error:
            failed = f"scenes: {error}"
        if failed:
            raise OptionError(
                f"{failed}: a model in MuJoCo is built otherwise than the first's (joints, floor, masses that move), "
                "and simulate_many runs models of one kind: use run_many"
            )
        self.models = models

    @property
    def times(self) -> Array:
        """(T,) [s] of the rows."""
        return self.members[0].grid.times

    @property
    def cost(self) -> dict[str, float]:
        """Wall time [s], steps and evaluations of all runs together."""
        steps = int(self.counters[:, run_view.STEP].sum())
        return {"wall_time": self.seconds, "steps": steps, "evaluations": steps * self.stages}

    def enter(self, number: int, request: Request, ready: Prepared, first: Scene | None = None) -> MuJoCoRun:
        """Begin a run as the simulation of that number, instead of the one before.

        `ready` is of the simulation's model; `first`: the scene that it was made from, if another.
        """
        data = self.data
        ready = ready if ready.data is data else within(ready, data)
        member = MuJoCoRun(self.options, request, ready, first)
        self.counters[number] = member.counters
        member.counters = self.counters[number]
        # Limits of forces are of the run, though clipped strings never move them.
        member.plant.set(counters=member.counters, force_range=np.array(ready.model.actuator_forcerange))
        self.tables[number] = member.plant.address
        self.members[number] = member
        _begin(data, ready, request.scene, first)
        self.batch.reset([number], stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.batch.qpos[number], self.batch.qvel[number] = data.qpos, data.qvel
        self.batch.userdata[number] = TOKEN, number
        return member

    def run(self) -> None:
        """Simulate all; nothing is raised for what becomes of a simulation."""
        request, grid = self.members[0].request, self.members[0].grid
        label = f"MuJoCo {self.options.integrator.value}, {len(self.members)} runs"
        running, _ = self.running, many.end_of_steps.address  # compiled before any clock runs

        def advance(first: int, count: int) -> int:
            self._advance(lambda ids: self.batch.step(ids, nstep=count))
            self._judge(first + count)
            return first + count if running.any() else first

        with installed(self.guide, many.many_runs):
            clock = Stopwatch(*(member.request for member in self.members))
            if drive(grid, request, label, advance):
                self._advance(self.batch.forward)  # the last row
            self.seconds = clock.seconds

    def _advance(self, call: Any) -> None:
        ids = None if self.running.all() else np.flatnonzero(self.running)
        try:
            call(ids)
        except SimulationError as error:
            for number in error.ids:
                self.members[number].cause = f"MuJoCo gave up: {self.batch.error(int(number))}"
        many.end_of_steps(self.guide.address)

    def _judge(self, steps: int) -> None:
        """Stop those that have ended, and those that MuJoCo warned of, that are not finite, or that lost steps."""
        running = self.running
        running &= self.counters[:, run_view.ENDED] == run_view.RUNNING
        finite = np.isfinite(self.batch.bind("qpos")).all(axis=1) & np.isfinite(self.batch.bind("qvel")).all(axis=1)
        made = self.counters[:, run_view.STEP]
        counts = self.batch.warning[:, :, 1]
        for number in np.flatnonzero(running & (counts.any(axis=1) | ~finite | (made != steps))):
            member = self.members[number]
            if causes := causes_of(counts[number], finite[number], made[number], steps):
                member.cause = member.cause or ", ".join(causes)
                running[number] = False


def check_motions(scene: Scene, first: Scene, tree: mjcf_tree.BodyTree) -> None:
    """Raise OptionError where a scene's supports move in ways that the drives of the first scene's model cannot."""
    if scene.motions == first.motions:
        return
    if [motion.support for motion in scene.motions] != [motion.support for motion in first.motions]:
        raise OptionError(
            f"scene '{scene.name}': other supports move than in the first scene, and simulate_many runs one model: use "
            "run_many"
        )
    own = mjcf_tree.body_tree(scene)
    pairs = [(one.moved, other.moved) for one, other in zip(own.joints, tree.joints, strict=True)]
    pairs += [(one[1], other[1]) for one, other in zip(own.moved_nodes, tree.moved_nodes, strict=True)]
    for needed, given in pairs:
        if np.abs(needed - given @ (given.T @ needed)).max(initial=0.0) > 1e-9:
            raise OptionError(
                f"scene '{scene.name}': a support moves in directions in which it stands still in the first scene, and "
                "simulate_many runs one model: put first a scene that uses them all, or use run_many"
            )


def _begin(data: mujoco.MjData, ready: Prepared, scene: Scene, first: Scene | None) -> None:
    """Have data at the start of a scene; `first`: what the model was made from, if another."""
    mujoco.mj_resetData(ready.model, data)
    data.qvel[:] = ready.velocities
    if first is None:
        return
    if not np.array_equal(scene.nodes0, first.nodes0):
        mjcf_tree.place(data, first, scene.nodes0, scene.velocities0, ready.tree)
    elif not np.array_equal(scene.velocities0, first.velocities0):
        data.qvel[:] = mjcf_tree.joint_coordinates(first, ready.tree, scene.nodes0, scene.velocities0)[1]


@contextmanager
def law_in(model: mujoco.MjModel, plant: Plant) -> Iterator[NDArray[np.int64]]:
    """Install the law of a plant for every MjData of a model; gives the array whose place [status] is set to 1
    (`OTHER_STRINGS`: a model with other strings was stepped).

    The plant's table is that of a `RUN`, and its mode is continuous: nothing is kept from stage to stage.
    """
    scene = plant.scene
    guide, statuses = many.Guide(model), np.zeros(many.STATUS_COUNT, np.int64)
    ready = within(prepared_with(model, scene))
    plant.take(ready.table)
    plant.set(designed=np.array(scene.structure.rest_lengths), force_range=np.zeros((plant["string_count"], 2)))
    if scene.motions:
        set_supports(scene, ready.tree, model, plant)
    implicit_size = set_implicit_forces(scene, ready.tree, model, plant)
    lent = np.array([(plant.place(name), plant[name].size) for name in many.LENT], np.int64)
    guide.set(law_table=plant.address, lent=lent, statuses=statuses)
    guide.set(implicit_size=implicit_size, room=many.law_room(plant, implicit_size))
    with installed(guide, many.law_alone, lasting=True):
        yield statuses

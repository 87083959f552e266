"""One excited chain: the scene of a case, its run, and what is measured of it; many of them by `run_many`."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from evidence.cable.amplitude import response_amplitude, whirl
from evidence.cable.chain import DIRECTION, Chain
from evidence.cable.spectrum import spectrum
from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import positive
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.engines.table import engine_of, engine_settings, make_engine
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.cable import Excitation, Start
from tensegrity_mj.model import rods
from tensegrity_mj.model.motion import Motion
from tensegrity_mj.model.moved_supports import velocities_with_supports
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.text.writing import scene_to_toml
from tensegrity_mj.runs.trajectory import Status, Trajectory
from tensegrity_mj.simulation import simulate_as_far
from tensegrity_mj.studies.many import RunOptions, Study, run_study
from tensegrity_mj.studies.sweep import scene_of
from tensegrity_mj.vibration.integrators import largest_frequency
from tensegrity_mj.vibration.small_motions import vibration
from tensegrity_mj.vibration.stepping import Scheme

DURATION, INTERVAL = 45.0, 0.02  # s
SPECTRUM = 2.0  # Hz, up to which spectra are kept
OWN = ("frequency", "excitation", "amplitude", "start", "seed")  # of a case, in its point
AXES = ("in-plane", "out-of-plane", "vertical")
# h ω of the largest stable step of each scheme, for undamped oscillations; MuJoCo's discrete has none of this kind.
STABLE = {Scheme.RUNGE_KUTTA: math.sqrt(8.0), Scheme.SEMI_IMPLICIT: 2.0, Scheme.VELOCITY_IMPLICIT: 2.0}
COARSENESS = 0.35  # h ω of the default step: a twentieth of the fastest period, an eighth of the limit


@value("case", OptionError)
class Case:
    """A hanging chain, how its top moves, and the engine that computes it.

    Attributes:
        scene: a chain that hangs at rest; its own motions are replaced.
        frequency: of the excitation [Hz].
        excitation: along `direction`, or a circle in the horizontal plane.
        amplitude: [m], half the peak-to-peak, or the circle's radius.
        start: in which frame the chain is at rest at t = 0.
        seed: [rad] by which the chain leans out of the plane at the start.
        engine: DAE's RK4 by default, with lengths kept, at the step of `default_step`.
        direction: horizontal, of any length.
    """

    scene: Scene = field(kinds.part(Scene))
    frequency: float = field(kinds.positive("Hz"))
    excitation: Excitation = field(kinds.choice(Excitation), default=Excitation.IN_LINE)
    amplitude: float = field(kinds.positive("m"), default=0.05)
    start: Start = field(kinds.choice(Start), default=Start.MOVING_FRAME)
    seed: float = field(kinds.finite("rad"), default=0.0)
    engine: Any = field(None, default=None)
    direction: tuple[float, float, float] = field(kinds.direction(), default=DIRECTION)

    def __attrs_post_init__(self) -> None:
        if self.excitation is Excitation.NONE:
            raise OptionError("case: excitation = none; use Excitation.IN_LINE or Excitation.CIRCULAR")
        _axes(self.scene, self.direction)
        chain = Chain.of(self.scene.structure)
        if self.engine is None:
            object.__setattr__(self, "engine", engine_of("dae normalize", default_step(self.scene)))
        engine_settings(self.engine)
        assert len(chain.rods)

    @property
    def coarseness(self) -> float:
        """h ω of the engine's step, ω the `fastest` of the hanging chain; NaN where the engine chooses its steps."""
        step = self.engine.stepping.timestep
        if step is None:
            return math.nan
        return step * fastest(self.scene)

    @property
    def exceeded(self) -> str:
        """Message that the engine's step is beyond its limit, or "": the linear model shows it before anything runs."""
        scheme = self.engine.stepping.scheme
        if scheme is None or scheme not in STABLE or not self.coarseness > STABLE[scheme]:
            return ""
        bound = STABLE[scheme]
        step = self.engine.stepping.timestep
        return (
            f"unstable step: {step:g} s is beyond the limit {step * bound / self.coarseness:.3g} s of {scheme.value} "
            f"(h ω = {self.coarseness:.3g} > {bound:.3g}) for a chain of {len(self.scene.structure.rods)} elements"
        )

    def excited(self) -> Scene:
        """The scene of the case (§3.3.3): the chain with the motion of its top [m], leaning by the seed, at rest in the
        frame of `start` at t = 0; what `run_cases` simulates with the case's engine.
        """
        structure, (axis, _, up) = self.scene.structure, _axes(self.scene, self.direction)
        chain = Chain.of(structure)
        top = structure.rods[int(chain.rods[0])].name
        if self.excitation is Excitation.IN_LINE:
            motion = Motion.in_line(top, self.amplitude, self.frequency, axis)
        else:
            motion = Motion.circular(top, self.amplitude, self.frequency, up)
        nodes = np.array(self.scene.nodes0)
        first = nodes[chain.nodes[0]].copy()
        if self.seed:
            # Turned about the direction of the excitation, through its top.
            arm = nodes - first
            c, s = math.cos(self.seed), math.sin(self.seed)
            along = np.outer(arm @ axis, axis)
            nodes = first + along + c * (arm - along) - s * np.cross(axis, arm)
        nodes = nodes + motion.at(0.0)[0]
        scene = self.scene.with_(motions=(motion,), initial_nodes=nodes, initial_velocities=None)
        if self.start is Start.LAB_FRAME:
            still = np.zeros_like(nodes)
            still[chain.nodes[0]] = motion.at(0.0)[1]
            scene = scene.with_(initial_velocities=velocities_with_supports(structure, nodes, (motion,), still))
        return scene


def fastest(scene: Scene) -> float:
    """The largest angular frequency [rad/s] of a chain that hangs in a scene's gravity, bending included.

    Raises:
        OptionError: for a structure that is no chain, or a scene without gravity.
    """
    Chain.of(scene.structure)
    positive(f"scene '{scene.name}': gravity", float(np.linalg.norm(scene.gravity)), "m/s²")
    still = np.zeros_like(scene.nodes0)
    return largest_frequency(vibration(scene.with_(motions=()), scene.nodes0, still, np.zeros(0)))


def default_step(scene: Scene, coarseness: float = COARSENESS, interval: float = INTERVAL) -> float:
    """The largest step [s] that divides the interval of output with h ω within `coarseness`, at most 0.01 s."""
    most = min(0.01, positive("coarseness", coarseness) / fastest(scene))
    return interval / math.ceil(interval / most * (1 - 1e-9))


@dataclass(frozen=True, eq=False)
class CaseResults:
    """Results of several cases.

    Attributes:
        cases: in order.
        markers: (P,) [m] arc lengths from the top.
        study: of `run_many`.
    """

    cases: tuple[Case, ...]
    markers: Array
    study: Study

    @property
    def failed(self) -> list[int]:
        """The numbers of the cases without measures: diverged, refused, or failed."""
        return [k for k, status in enumerate(self.statuses) if status != Status.COMPLETED.value]

    @property
    def statuses(self) -> list[str]:
        """A run's status, "unstable step" where it was refused, or "failed"."""
        return [status or "failed" for status in self.study.values("status")]

    @property
    def messages(self) -> list[str]:
        """Reasons for which cases have no measures, or ""."""
        return [
            outcome["values"]["message"] if "values" in outcome else outcome["reason"]
            for outcome in self.study.outcomes
        ]

    @property
    def frequencies(self) -> Array:
        """(C,) of the excitations [Hz]."""
        return np.array([case.frequency for case in self.cases])

    @property
    def amplitudes(self) -> Array:
        """(C, P, 3) maximum response amplitudes [m] of the markers along `AXES`; NaN for a case without."""
        return self._array("amplitudes", (len(self.markers), 3))

    @property
    def relative(self) -> Array:
        """(C, P, 3) maximum response amplitudes over the peak-to-peak of the excitation, as in the thesis' figures."""
        return self.amplitudes / np.array([2.0 * case.amplitude for case in self.cases])[:, None, None]

    @property
    def drift(self) -> Array:
        """(C,) largest | ‖b_i‖ - 1 | over rods and recorded times, as in §3.5.2."""
        return self._array("drift", ())

    @property
    def turning(self) -> Array:
        """(C, P) of `Whirl`: 0 along a line, ±1 around a circle."""
        return self._array("whirl", (len(self.markers), 3))[..., 2]

    @property
    def growth(self) -> Array:
        """(C, P) of `Whirl` [1/s]; NaN where nothing grows out of the plane while it is small."""
        return self._array("whirl", (len(self.markers), 3))[..., 0]

    @property
    def spectral_frequencies(self) -> Array:
        """(F,) [Hz] of `densities`."""
        return next((np.array(one) for one in self.study.values("frequencies") if one is not None), np.zeros(0))

    @property
    def densities(self) -> Array:
        """(C, P, 3, F) power spectral densities [m²/Hz]."""
        return self._array("densities", (len(self.markers), 3, len(self.spectral_frequencies)))

    def _array(self, name: str, shape: tuple[int, ...]) -> Array:
        none = np.full(shape, np.nan)
        found = self.study.values(name)
        return np.array([none if one is None else np.array(one, float).reshape(shape) for one in found])


def run_cases(
    cases: Sequence[Case],
    markers: Sequence[float],
    folder: str | os.PathLike[str] | None = None,
    *,
    duration: float = DURATION,
    interval: float = INTERVAL,
    **how: Unpack[RunOptions],
) -> CaseResults:
    """Run many cases and measure markers on each; in a folder, go on where an earlier call stopped.

    A case whose step is beyond the stable one is not run: its status says so.

    Args:
        cases: of any chains.
        markers: arc lengths [m] from the top.
        folder: see `run_many`.
        duration, interval: of the runs and their samples [s].
        how: identity, workers, progress and label, see `run_many`.

    Raises:
        OptionError: for markers that some chain does not have, and as `run_many`.
    """
    positive("duration", duration, "s")
    positive("interval", interval, "s")
    known: dict[int, str] = {}  # texts of scenes by identity: cases share them
    texts: dict[str, str] = {}
    points = []
    for case in cases:
        if id(case.scene) not in known:
            Chain.of(case.scene.structure).weights(markers)
            known[id(case.scene)] = scene_to_toml(case.scene)
        name = texts.setdefault(known[id(case.scene)], f"scene{len(texts)}")
        points.append(point_of(case, name))
    common = {
        "scenes": {name: text for text, name in texts.items()},
        "markers": list(markers),
        "duration": duration,
        "interval": interval,
    }
    study = run_study(measure_case, points, folder, "cables", how, common)
    return CaseResults(tuple(cases), np.array(markers, float), study)


def measure_case(point: dict[str, Any]) -> dict[str, Any]:
    """The task of `run_cases`: one case."""
    case = case_of(point)
    if refusal := case.exceeded:
        return {"status": "unstable step", "message": refusal}
    run = simulated(case, point["duration"], point["interval"])
    if run.status is not Status.COMPLETED:
        return {"status": run.status.value, "message": run.message, "drift": drift_of(run)}
    return {"status": run.status.value, "message": "", **measures_of(case, run, point["markers"])}


def point_of(case: Case, scene: str) -> dict[str, Any]:
    """A case as plain values, with the name that its point's `scenes` have for its scene."""
    engine, options = engine_settings(case.engine)
    return {
        "scene": scene,
        **plain_values(case, *OWN),
        "engine": {"name": engine, "options": options},
        "direction": list(case.direction),
    }


def case_of(point: Mapping[str, Any]) -> Case:
    """The case of a point of `run_cases`."""
    engine = make_engine(point["engine"]["name"], dict(point["engine"]["options"]))
    own = {name: point[name] for name in OWN}
    return Case(scene_of(point["scenes"][point["scene"]]), engine=engine, direction=point["direction"], **own)


def simulated(case: Case, duration: float = DURATION, interval: float = INTERVAL) -> Trajectory:
    """The run of a case; one that diverges, as far as it came."""
    return simulate_as_far(case.excited(), None, case.engine, duration=duration, output_interval=interval)


def measures_of(case: Case, run: Trajectory, markers: Sequence[float]) -> dict[str, Any]:
    """Return the measures that are kept of a run: amplitudes (P, 3), spectra (P, 3, F), whirling (P, 3), drift."""
    chain = Chain.of(case.scene.structure)
    W = chain.weights(markers)
    axes = np.stack(_axes(case.scene, case.direction), axis=1)
    position = W @ run.nodes[:, chain.nodes] @ axes  # (T, P, 3)
    velocity = W @ run.velocities[:, chain.nodes] @ axes
    columns = range(len(W))
    found = [[spectrum(run.time, position[:, p, a]).until(SPECTRUM) for a in range(3)] for p in columns]
    whirls = [
        whirl(
            run.time, position[:, p, 0], position[:, p, 1], 1.0 / case.frequency,
            (velocity[:, p, 0], velocity[:, p, 1]),
        )
        for p in columns
    ]  # fmt: skip
    return {
        "amplitudes": [
            [response_amplitude(run.time, position[:, p, a], velocity[:, p, a]) for a in range(3)] for p in columns
        ],
        "frequencies": found[0][0].frequency.tolist() if found else [],
        "densities": [[one.density.tolist() for one in row] for row in found],
        "whirl": [[one.growth, one.gain, one.turning] for one in whirls],
        "drift": drift_of(run),
        "energy_residual": run.energy_residual,
    }


def drift_of(run: Trajectory) -> float:
    """Largest | ‖b_i‖ - 1 | over rods and recorded times."""
    b = rods.directions(run.scene.structure, run.nodes)
    return float(np.abs(np.linalg.norm(b, axis=-1) - 1.0).max(initial=0.0))


def _axes(scene: Scene, direction: Sequence[float]) -> tuple[Array, Array, Array]:
    """Unit vectors along the excitation, out of its plane, and up."""
    g = np.array(scene.gravity, float)
    along = np.asarray(direction, float)
    if not np.linalg.norm(g) > 0:
        raise OptionError(f"scene '{scene.name}' has no gravity; a hanging chain needs it")
    up = -g / np.linalg.norm(g)
    along = along / np.linalg.norm(along)
    if abs(float(along @ up)) > 1e-9:
        raise OptionError(f"case: direction = {direction!r}; it must be horizontal")
    return along, np.cross(along, up), up

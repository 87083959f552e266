"""The thesis' experiments of chapters 4 to 6: each is run once in each engine, and serves many rows and figures."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError

if TYPE_CHECKING:
    from tensegrity_mj.model.actuation import Actuation
    from tensegrity_mj.model.scene import Scene
    from tensegrity_mj.runs.trajectory import Trajectory
    from tensegrity_mj.simulation import Engine
    from tensegrity_mj.thesis.disturbance import Disturbance


class EngineName(enum.Enum):
    """The engines of the ledger, by the names of the command line."""

    DAE = "dae"
    MUJOCO = "mujoco"
    ODE = "ode"
    STATICS = "statics"


# How the columns of the ledger are headed.
TITLES = {one: ENGINES[one.value].title if one.value in ENGINES else one.value for one in EngineName}
# Which engines a motion is computed in, and which an equilibrium: MuJoCo's forces confirm those of statics.
OF_MOTION = (EngineName.DAE, EngineName.MUJOCO, EngineName.ODE)
OF_EQUILIBRIUM = (EngineName.STATICS, EngineName.MUJOCO)

SAMPLED = 1e-3  # s; the laws of p = 1 and p = ∞ jump, so they are sampled at 1 kHz, force density held


@dataclass(frozen=True)
class Experiment:
    """One experiment of the thesis.

    Attributes:
        name: unique.
        scene: of `models/`.
        about: what it is, with the page.
        law: another law than the scene's, or None.
        options: of the law, in place of the scene's.
        period: control period [s] with held force density; None evaluates the law at every stage.
        timestep: of MuJoCo's RK4 [s]; so small that its nodes are within 1e-7 m of the DAE's.
        interval: between recorded samples [s].
        rtol, atol: of the DAE (and the ODE), where the law is continuous.
        set_point: the scene's last target from the start, in place of its path.
    """

    name: str
    scene: str
    about: str
    law: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    period: float | None = None
    timestep: float = 2e-3
    interval: float = 0.01
    rtol: float = 1e-10
    atol: float = 1e-12
    set_point: bool = False

    def load(self) -> Scene:
        """Its scene."""
        from tensegrity_mj.library.load import load_scene
        from tensegrity_mj.model.target import Target

        scene = load_scene(self.scene)
        if not self.set_point or scene.target is None:
            return scene
        return scene.with_(target=Target.set_point(scene.target.nodes[-1]))

    def actuation(self) -> Actuation:
        """What is held between evaluations of the law."""
        from tensegrity_mj.model.actuation import Actuation

        return Actuation.continuous() if self.period is None else Actuation.hold_force_density(self.period)

    def engine(self, name: EngineName) -> Engine:
        """The engine with the settings of this experiment."""
        if name is EngineName.MUJOCO:
            from tensegrity_mj.engines.mujoco.engine import MuJoCo

            return MuJoCo(timestep=self.timestep if self.period is None else self.period)
        if name is EngineName.DAE:
            from tensegrity_mj.engines.reference.dae import DAE
            from tensegrity_mj.engines.reference.method import Method

            if self.period is not None:
                # Smooth between samples: one step of order four is exact to 1e-12 m, and error control has no use.
                return DAE(method=Method.RK4, timestep=self.period)
            return DAE(rtol=self.rtol, atol=self.atol)
        from tensegrity_mj.engines.reference.ode import ODE

        return ODE(rtol=self.rtol, atol=self.atol)


def simulate_experiment(
    experiment: Experiment, engine: EngineName, disturbance: Disturbance | None = None
) -> Trajectory:
    """Run it.

    Args:
        disturbance: of the plant, of which the law knows nothing, or of the law's gain.
    """
    from tensegrity_mj.controllers.scenes import from_scene
    from tensegrity_mj.simulation import simulate
    from tensegrity_mj.thesis.disturbance import disturbed, disturbed_options

    scene = experiment.load()
    options = disturbed_options(scene, experiment.law, experiment.options, disturbance)
    law = from_scene(scene, experiment.law, **options)
    return simulate(
        disturbed(scene, disturbance),
        law,
        experiment.engine(engine),
        actuation=experiment.actuation(),
        output_interval=experiment.interval,
    )


def _gains(**values: float) -> dict[str, Any]:
    given = {"X": 1.0, "Y": 1.0, "Z": 1.5, **values}
    return {"translation": given, "rotation": given}


# ---------------------------------------------------------------------------------------------------- the list

_CHAPTER_5 = (
    Experiment("pinned", "pinned_rod", "§5.4: pinned rod, p = 2, δ = 0.15"),
    Experiment("pinned-fast", "pinned_rod", "§6.2: pinned rod, p = 2, δ = 0.20", options={"decay_rate": 0.20}),
    Experiment("pinned-p1", "pinned_rod", "§5.4: pinned rod, p = 1, sampled", options={"norm": 1}, period=SAMPLED),
    Experiment(
        "pinned-pinf", "pinned_rod", "§5.4: pinned rod, p = ∞, sampled", options={"norm": "inf"}, period=SAMPLED
    ),
    Experiment("pinned-Z18", "pinned_rod", "§5.6: pinned rod with Z = 1.8 for 3/2", options=_gains(Z=1.8)),
    Experiment("pinned-Y08", "pinned_rod", "§5.6: pinned rod with Y = 0.8 for 1", options=_gains(Y=0.8)),
    Experiment("pinned-Y12", "pinned_rod", "§5.6: pinned rod with Y = 1.2 for 1", options=_gains(Y=1.2)),
    Experiment("prism", "prism", "§5.5: prism, p = 2, δ = 1"),
    Experiment("prism-Z18", "prism", "§5.6: prism with Z = 1.8 for 3/2", options=_gains(Z=1.8)),
    Experiment("prism-Y08", "prism", "§5.6: prism with Y = 0.8 for 1", options=_gains(Y=0.8)),
    Experiment("prism-Y12", "prism", "§5.6: prism with Y = 1.2 for 1", options=_gains(Y=1.2)),
)

_ONTO_B = {"decay_rate": 0.15, "norm": 2, "onto": "current"}
_ONTO_TARGET = {"decay_rate": 0.15, "norm": 2, "onto": "target"}

_CHAPTER_6 = (
    Experiment("projection", "pinned_rod", "§6.2: pinned rod, projection onto b⊥, δ = 0.15", "projection", _ONTO_B),
    Experiment("mirror-b", "pinned_rod_mirror", "§6.2: second start, onto b⊥", "projection", _ONTO_B),
    Experiment("mirror-bd", "pinned_rod_mirror", "§6.2: second start, onto b_d⊥", "projection", _ONTO_TARGET),
    Experiment(
        "mirror-lyapunov",
        "pinned_rod_mirror",
        "§6.2: second start, Lyapunov law, δ = 0.20",
        "lyapunov",
        {"decay_rate": 0.20},
        timestep=1e-3,
    ),
    Experiment("prism-projection", "prism", "§6.3: prism, projection onto b⊥", "projection"),
)

BEAM_STRINGS, BEAM_CELLS = 196, 39


def cell_strings(cell: int) -> range:
    """Indices of the six strings of a cell of the beam, 1 to 39: its left vertical, four of its own, the next one."""
    return range(5 * (cell - 1), 5 * cell + 1)


def _one_sum(minimum: float) -> dict[str, Any]:
    return {"sums": [["all", minimum]] if minimum else []}


def _cell_sums(minimum: float) -> dict[str, Any]:
    return {"sums": [[[f"s{k + 1}" for k in cell_strings(cell)], minimum] for cell in range(1, BEAM_CELLS + 1)]}


_CROSS: dict[str, Any] = {"timestep": 1e-2}
_BEAM: dict[str, Any] = {"timestep": 2e-2, "interval": 0.1}

_CHAPTER_4 = (
    Experiment("cross-1.2", "cross", "§4.6.1: cross, tracking, u_sum = 1.20 N/m", options=_one_sum(1.2), **_CROSS),
    Experiment("cross-0.4", "cross", "§4.6.1: cross, tracking, u_sum = 0.40 N/m", options=_one_sum(0.4), **_CROSS),
    Experiment("cross-0", "cross", "§4.6.1: cross, tracking, no sum", options=_one_sum(0.0), **_CROSS),
    Experiment("cross-set-point", "cross", "§4.6.1: cross, set-point", options=_one_sum(1.2), **_CROSS, set_point=True),
    Experiment("beam-1960", "planar_beam", "§4.6.2: beam, one sum of 1960 N/m", options=_one_sum(1960.0), **_BEAM),
    Experiment("beam-980", "planar_beam", "§4.6.2: beam, one sum of 980 N/m", options=_one_sum(980.0), **_BEAM),
    Experiment("beam-0", "planar_beam", "§4.6.2: beam, no sum", options=_one_sum(0.0), **_BEAM),
    Experiment("beam-cells-60", "planar_beam", "§4.6.2: beam, 60 N/m in each cell", options=_cell_sums(60.0), **_BEAM),
    Experiment("beam-cells-30", "planar_beam", "§4.6.2: beam, 30 N/m in each cell", options=_cell_sums(30.0), **_BEAM),
)

EXPERIMENTS: Mapping[str, Experiment] = {one.name: one for one in (*_CHAPTER_4, *_CHAPTER_5, *_CHAPTER_6)}


def experiment_of(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        OptionError: for a name that is none.
    """
    if name not in EXPERIMENTS:
        raise OptionError(f"experiment {name!r}: there is none of that name; there are {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]

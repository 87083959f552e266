"""The thesis' experiments of chapters 4 to 6: each is run once in each engine, and serves many rows and figures."""

from __future__ import annotations

import enum
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evidence.thesis.disturbance import Disturbance, disturbed, disturbed_options
from tensegrity_mj.controllers.scenes import from_scene
from tensegrity_mj.engines.table import ENGINES, engine_of, make_engine
from tensegrity_mj.errors import OptionError
from tensegrity_mj.library.named import load_scene
from tensegrity_mj.model.actuation import Actuation
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.target import Target
from tensegrity_mj.runs.trajectory import Trajectory
from tensegrity_mj.simulation import simulate


class EngineName(enum.Enum):
    """The engines of the ledger, by the names of the command line."""

    DAE = "dae"
    MUJOCO = "mujoco"
    ODE = "ode"
    STATICS = "statics"


# Heads of the ledger's columns.
TITLES = {one: ENGINES[one.value].title if one.value in ENGINES else one.value for one in EngineName}
# Engines that compute a motion, and an equilibrium: MuJoCo's forces confirm those of statics.
OF_MOTION = (EngineName.DAE, EngineName.MUJOCO, EngineName.ODE)
OF_EQUILIBRIUM = (EngineName.STATICS, EngineName.MUJOCO)


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
        """Load the experiment's scene."""
        scene = load_scene(self.scene)
        if not self.set_point or scene.target is None:
            return scene
        return scene.with_(target=Target.set_point(scene.target.nodes[-1]))

    def actuation(self) -> Actuation:
        """Return the actuation between evaluations of the law."""
        return Actuation.continuous() if self.period is None else Actuation.hold_force_density(self.period)

    def engine(self, name: EngineName) -> Any:
        """The engine with the settings of this experiment."""
        if name is EngineName.MUJOCO:
            return engine_of("rk4", self.timestep if self.period is None else self.period)
        if name is EngineName.DAE and self.period is not None:
            # Smooth between samples: one step of order four is exact to 1e-12 m, and error control has no use.
            return engine_of("dae", self.period)
        return make_engine(name.value, {"rtol": self.rtol, "atol": self.atol})


def simulate_experiment(
    experiment: Experiment, engine: EngineName, disturbance: Disturbance | None = None
) -> Trajectory:
    """Run it.

    Args:
        disturbance: of the plant, of which the law knows nothing, or of the law's gain.
    """
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


# ---------------------------------------------------------------------------------------------------- the list

FILE = Path(__file__).parent / "tables" / "experiments.toml"
BEAM_CELLS = 39


def cell_strings(cell: int) -> range:
    """Indices of the six strings of a cell of the beam, 1 to 39: its left vertical, four of its own, the next one."""
    return range(5 * (cell - 1), 5 * cell + 1)


def _experiment(name: str, row: dict[str, Any]) -> Experiment:
    """Make the experiment of a row; its `cells` is the least sum of u in each cell of the beam [N/m]."""
    if least := row.pop("cells", None):
        names = [[f"s{k + 1}" for k in cell_strings(cell)] for cell in range(1, BEAM_CELLS + 1)]
        row["options"] = {"sums": [[own, least] for own in names]}
    return Experiment(name, **row)


EXPERIMENTS: Mapping[str, Experiment] = {
    name: _experiment(name, row) for name, row in tomllib.loads(FILE.read_text(encoding="utf-8")).items()
}


def experiment_of(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        OptionError: for a name that is none.
    """
    if name not in EXPERIMENTS:
        raise OptionError(f"experiment {name!r}: there is none of that name; there are {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]

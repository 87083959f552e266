"""V in angles: the landscapes V_φ(φ, φ̇) of figures 5.1, 6.2 and 6.7, and a run's way over them.

With φ the angle from b_d to b, θ the angle of b about b_d, and gains X = α I, Y = β I, Z = γ I and K I, all three laws
have V_b = V_φ(φ, φ̇) + V_θ(φ, θ̇). From ‖e_b‖² = 2 (1 - cos φ), ‖p‖ = sin φ and ‖ḃ‖² = φ̇² + sin²φ θ̇²:

    no projection      V_φ = α (1 - cos φ) + β φ̇ sin φ       + γ φ̇²/2                      (5.9), (6.21)
    onto b⊥            V_φ = α sin²φ / 2   + β φ̇ sin φ       + γ φ̇²/2 + K (1 - cos φ)      (6.11), (6.22)
    onto b_d⊥          V_φ = α sin²φ / 2   + β φ̇ sin φ cos φ + γ φ̇²/2 + K (1 - cos φ)      (6.23)
    all                V_θ = γ sin²φ θ̇² / 2

where pᵀḃ = -b_dᵀḃ = φ̇ sin φ for a projection onto b⊥, and cos φ times that onto b_d⊥.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.basics.kinds import not_negative, positive
from tensegrity_mj.basics.texts import figure_text
from tensegrity_mj.controllers import quadratic_terms
from tensegrity_mj.controllers.lyapunov import Lyapunov
from tensegrity_mj.controllers.projection import Projection
from tensegrity_mj.dynamics.target import target_positions
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.rods import directions, rod_number
from tensegrity_mj.pictures import figure as figures
from tensegrity_mj.pictures import palette, run_panels
from tensegrity_mj.pictures.figure import Figure, PathLike
from tensegrity_mj.runs.trajectory import Trajectory


@value(error=OptionError)
class Landscape:
    """V of one rod about its set-point, in angles.

    Attributes:
        onto: plane that the law projects the error of b onto; None for the Lyapunov law of chapter 5.
        alpha, beta, gamma: X = α I, Y = β I, Z = γ I.
        stiffness: K of K I.

    Raises:
        OptionError: unless α γ > β², γ > 0 and K >= 0.
    """

    onto: quadratic_terms.Onto | None = None
    alpha: float = 1.0
    beta: float = 1.0
    gamma: float = field(positive(), default=1.5)
    stiffness: float = field(not_negative(), default=0.0)

    def __attrs_post_init__(self) -> None:
        alpha, beta, gamma = self.alpha, self.beta, self.gamma
        if not alpha * gamma > beta * beta:
            text = f"alpha = {alpha:g}, beta = {beta:g}, gamma = {gamma:g}; they must have alpha * gamma > beta²"
            raise refused(self, text)

    @classmethod
    def of(cls, law: Lyapunov | Projection, rod: str | None = None) -> Landscape:
        """The landscape of a law, for one of its rods: the first by default.

        Raises:
            OptionError: for another law, an unknown rod, or gains of b that are not multiples of the identity.
        """
        if not isinstance(law, (Lyapunov, Projection)):
            raise OptionError(f"a landscape is drawn of a Lyapunov or a Projection law, not of {law!r}")
        record = law.gains[rod_number(law.structure, rod)]
        values = []
        for key in ("Xb", "Yb", "Zb", "Kb"):
            matrix = record[key]
            if not np.array_equal(matrix, matrix[0, 0] * np.eye(3)):
                raise OptionError(
                    f"a landscape in one angle needs gains of b that are numbers; {key} = {matrix.tolist()}"
                )
            values.append(float(matrix[0, 0]))
        return cls(law.projected_onto, *values)

    def __call__(self, phi: ArrayLike, rate: ArrayLike) -> Array:
        """V_φ at angles [rad] and rates [rad/s], which broadcast."""
        phi, rate = _numbers("phi", phi), _numbers("rate", rate)
        # 2 sin²(φ/2) = 1 - cos φ, without its loss of digits near zero.
        away = 2.0 * np.sin(0.5 * phi) ** 2
        kinetic = 0.5 * self.gamma * rate**2
        if self.onto is None:
            return self.alpha * away + self.beta * rate * np.sin(phi) + kinetic
        mixed = self.beta * rate * np.sin(phi)
        if self.onto is quadratic_terms.Onto.TARGET:
            mixed = mixed * np.cos(phi)
        return 0.5 * self.alpha * np.sin(phi) ** 2 + mixed + kinetic + self.stiffness * away

    def turning(self, phi: ArrayLike, rate: ArrayLike) -> Array:
        """V_θ at angles φ [rad] and rates θ̇ [rad/s]."""
        return 0.5 * self.gamma * (np.sin(_numbers("phi", phi)) * _numbers("rate", rate)) ** 2


class Angles(NamedTuple):
    """Angles of a rod relative to its set-point; arrays (T,).

    Attributes:
        phi: from b_d to b, 0 to π [rad].
        phi_rate: its rate [rad/s]; where b = ± b_d, the speed.
        theta_rate: the rate at which b turns about b_d [rad/s]; there, zero.
    """

    phi: Array
    phi_rate: Array
    theta_rate: Array


def angles(run: Trajectory, rod: str | None = None) -> Angles:
    """The angles of a rod of a run, the first by default, relative to the target.

    Raises:
        OptionError: no such rod, no target, or one that moves.
    """
    instance("run", run, Trajectory, "use a Trajectory, as of simulate or Trajectory.load")
    structure = run.scene.structure
    number = rod_number(structure, rod)
    aim = target_positions(structure, run.scene.target, run.time)
    if aim is None:
        raise OptionError(f"scene '{run.scene.name}' has no target, relative to which a rod has an angle")
    axes = directions(structure, aim)[:, number]
    if not np.all(axes == axes[0]):
        raise OptionError(f"scene '{run.scene.name}': its target moves, and a landscape stands about a set-point")
    b, rate = (directions(structure, values)[:, number] for values in (run.nodes, run.velocities))
    normal = np.cross(axes, b)  # sin φ long, along b_d × b
    sine = np.linalg.norm(normal, axis=1)
    apart = sine > 0
    normal[apart] /= sine[apart, None]
    along = np.cross(normal, b)  # of growing φ
    return Angles(
        np.arctan2(sine, np.sum(axes * b, axis=1)),
        np.where(apart, np.sum(along * rate, axis=1), np.linalg.norm(rate, axis=1)),
        np.where(apart, np.sum(normal * rate, axis=1) / np.where(apart, sine, 1.0), 0.0),
    )


def _numbers(what: str, values: ArrayLike) -> Array:
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        raise OptionError(f"{what} = {values!r}; it must be a number or an array of numbers") from None


def draw_landscape(
    law: Lyapunov | Projection | Landscape,
    runs: Trajectory | Sequence[Trajectory] = (),
    path: PathLike | None = None,
    *,
    rod: str | None = None,
) -> Figure:
    """Figures 5.1, 6.2 and 6.7: contours of V_φ(φ, φ̇) of one rod, and the ways of runs over them.

    φ is the angle from b_d to b. In space b turns about b_d too; that part of V, V_θ, is not in the picture.
    Each way starts at a dot.

    Args:
        law: whose V, or a `Landscape`.
        runs: towards a set-point; none for the contours alone.
        rod: the rod's name; the first by default.

    Raises:
        OptionError: gains that are no numbers, an unknown rod, a run without a set-point, or a path that cannot be
            written.
    """
    shape = law if isinstance(law, Landscape) else Landscape.of(law, rod)
    all_runs = run_panels.listed(runs) if isinstance(runs, Trajectory) or len(runs) else []
    ways = [angles(run, rod) for run in all_runs]
    top = max([1.0, *(1.1 * float(np.max(np.abs(way.phi_rate))) for way in ways)])
    figure = figures.new_figure(6.4, 4.6)
    panel = figure.subplots()
    phi, rate = np.linspace(-np.pi, np.pi, 361), np.linspace(-top, top, 241)
    contours = panel.contour(phi, rate, shape(phi, rate[:, None]), levels=24, cmap="viridis", linewidths=0.8)
    figure.colorbar(contours, ax=panel, label=r"$V_\varphi$")
    panel.set_xlabel(r"$\varphi$ [rad]", fontsize=9)
    panel.set_xticks([-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi], [r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$"])
    panel.set_ylim(-top, top)
    for number, (run, way) in enumerate(zip(all_runs, ways, strict=True)):
        label = (
            f"{run_panels.law_name(run)}, {figure_text(run.engine or run.scene.name)}" if len(all_runs) > 1 else None
        )
        color = palette.color_of(2 + number)
        panel.plot(way.phi, way.phi_rate, lw=1.6, ls=figures.line_style(number), color=color, label=label)
        panel.plot(way.phi[:1], way.phi_rate[:1], marker="o", ms=5, ls="none", color=color)
    names = {None: "no projection", "current": r"onto $b^\perp$", "target": r"onto $b_d^\perp$"}
    name = names[shape.onto.value if shape.onto else None]
    gains = (
        rf"$\alpha = {shape.alpha:g}$, $\beta = {shape.beta:g}$, $\gamma = {shape.gamma:g}$, $K = {shape.stiffness:g}$"
    )
    run_panels.over_time(panel, f"{name}: {gains}", r"$\dot\varphi$ [rad/s]")
    return figures.saved(figure, path)

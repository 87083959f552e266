"""The lightest tower by gradients: form, prestress and sections together, by SciPy's SLSQP on derivatives of JAX.

    python -m pip install ".[jax]"
    python examples/design_tower.py                             # about a minute on two cores
    python examples/design_tower.py --wind 50 --frequency 12

Six bars and 27 strings hold a payload two metres up, in two stages that look the same after each third of a turn.
Sought are radii, heights and angles of the rings of nodes, force densities and sections of the least mass at which

    forces balance the payload and the rods' weight; rods of a stage keep apart
    strings keep a force density and do not yield, rods do not yield or buckle, in wind from anywhere, to first order
    the lowest frequencies, by the second derivative of the members' energy, are as high as given

First, at a form by hand and without wind, the mass is compared with that of `tensegrity_mj.statics.minimal_mass`,
which proves it by linear programming. The design is then judged by what has nothing of JAX: the package's statics,
strength, modes and clearance, MuJoCo and the DAE. Writes into --out: design.json, tower.toml, design.png.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from optimum import Optimum, least

import tensegrity_mj as tmj
from tensegrity_mj.engines.jax.arrays import incidence, times
from tensegrity_mj.engines.jax.small_motions import frequency_squares
from tensegrity_mj.model import Load, Section
from tensegrity_mj.statics import ALUMINIUM, UHMWPE, check_state, find_equilibrium, minimal_mass, natural_modes

GRAVITY = np.array([0.0, 0.0, -9.81])
HEIGHT, PLATFORM, PAYLOAD = 2.0, 0.2, 30.0  # m, m, kg: of the payload, and the radius of the ring that carries it
SLACKEST = 50.0  # N/m: the least force density of strings, in any wind
APART = 0.04  # m, at least, between the axes of rods of a stage
LOWEST = 4  # frequencies are kept high enough, as modes may change places
BLUNT = 1.0  # N: the radius of the tip of a cone, see `_small_motions`

RINGS = ("b1", "t1", "b2", "t2")
FORM = ("base radius", "t1 radius", "t1 height", "t1 angle", "b2 radius", "overlap", "b2 angle", "t2 angle")
BY_HAND = np.array([0.4, 0.3, 1.1, np.pi / 6, 0.3, 0.2, np.pi / 2, np.pi * 2 / 3])
LEAST = np.array([0.15, 0.15, 0.6, 0.0, 0.15, 0.15, np.pi / 6, np.pi / 3])
MOST = np.array([0.6, 0.6, 1.6, np.pi / 3, 0.6, 0.6, np.pi * 5 / 6, np.pi])

# Groups of three members, rods first: from node i of a ring to node i + shift of another.
_ROWS = """rod1 b1 t1 1, rod2 b2 t2 1, vertical1 b1 t1 0, vertical2 b2 t2 0, inner1 b1 t1 -1, inner2 b2 t2 -1,
    up b1 b2 0, down t2 t1 0, saddle t1 b2 0, saddle' t1 b2 -1, top t2 t2 1"""
GROUPS = {name: (*rings, int(shift)) for name, *rings, shift in map(str.split, _ROWS.split(","))}
PAIRS = np.array(
    [
        (3 * RINGS.index(a) + i, 3 * RINGS.index(b) + (i + shift) % 3)
        for a, b, shift in GROUPS.values()
        for i in range(3)
    ]
)
ENDS = incidence(PAIRS, 12)
MATERIALS = [ALUMINIUM] * 6 + [UHMWPE] * 27
DENSITY, MODULUS, YIELD = np.array([[m.density, m.elasticity_modulus, m.yield_stress] for m in MATERIALS]).T
ON_NODES = np.where(np.arange(12) < 9, 0.0, PAYLOAD / 3)  # kg
UNITS = np.repeat([[-100.0, 1e-4], [100.0, 1e-6]], (6, 27), axis=0).T  # N/m and m²
# (6, 12, 12): mass matrices of uniform rods of unit mass by nodes, 1/6 [[2, 1], [1, 2]].
SHARES = (np.abs(ENDS[:6, :, None] * ENDS[:6, None]) + np.eye(12) * np.abs(ENDS[:6, None])) / 6


def place(form: Any) -> Any:
    """(12, 3) [m]: the nodes of the four rings of a form (8,)."""
    third = 2 * np.pi / 3 * np.arange(3)
    base, wide, high, turn, inner, overlap, second, top = form
    rings = [(base, 0.0, 0.0), (wide, high, turn), (inner, high - overlap, second), (PLATFORM, HEIGHT, top)]
    return jnp.concatenate(
        [jnp.stack([r * jnp.cos(third + a), r * jnp.sin(third + a), z + 0 * third], axis=1) for r, z, a in rings]
    )


def layout(nodes: Any) -> tmj.Structure:
    """The tower at nodes (12, 3), with members that say nothing yet."""
    names = [f"{ring}_{i + 1}" for ring in RINGS for i in range(3)]
    members = [(f"{group}_{i + 1}", group) for group in GROUPS for i in range(3)]
    ends = [(names[i], names[j]) for i, j in PAIRS]
    support = [tmj.Support.pinned(0.0)] * 3 + [tmj.Support.free()] * 3
    return tmj.Structure(
        "tower",
        dict(zip(names, np.asarray(nodes).tolist(), strict=True)),
        tuple(tmj.Rod(n, e, 1.0, support=s, group=g) for (n, g), e, s in zip(members, ends, support, strict=False)),
        tuple(tmj.String(n, e, 1.0, group=g) for (n, g), e in zip(members[6:], ends[6:], strict=True)),
        point_masses=tuple(tmj.PointMass(name, PAYLOAD / 3) for name in names[9:]),
    )


class Values(NamedTuple):
    """What a design comes to; members are rods first."""

    mass: Any  # [kg]
    nodes: Any  # (12, 3) [m]
    forces: Any  # (33,) [N], positive in tension
    areas: Any  # (33,) [m²]
    squares: Any  # ω² (27,) [1/s²]
    loads: Any  # [N] that are left on the nodes that count, 0 in balance
    margins: dict[str, Any]  # >= 0, each in units of its limit


def tower(alike: bool = True, moves: bool = True) -> Callable[..., Values]:
    """(y, wind [N], frequency [Hz]) -> what a design y comes to.

    y is form, force densities and areas, in units of about one: a number a group where members of a group are alike,
    and the first nodes of the rings stand for all. Where nothing moves, wind and frequency do not count.
    """
    every = 3 if alike else 1

    def values(y: Any, wind: Any, frequency: Any) -> Values:
        densities, areas = UNITS * jnp.repeat(y[8:].reshape(2, -1), every, axis=1)
        nodes = place(y[:8])
        spans = times(ENDS, nodes)
        lengths = jnp.sqrt(jnp.sum(spans**2, axis=1))
        forces, masses = densities * lengths, DENSITY * areas * lengths
        # Rods weigh half at either end, and strings nothing, as in minimal_mass and in the engines.
        heavy = 0.5 * np.abs(ENDS[:6]).T @ masses[:6] + ON_NODES
        loads = heavy[:, None] * GRAVITY - times(ENDS.T, densities[:, None] * spans)
        squares, gusts = jnp.zeros(0), jnp.zeros(33)
        if moves:
            squares, gusts = _small_motions(nodes, lengths, forces, MODULUS * areas, masses, wind)
        euler = np.pi * MODULUS[:6] * areas[:6] ** 2 / (4 * lengths[:6] ** 2)  # π² E I / ℓ², I = A² / 4π
        normals = jnp.cross(spans[:6:3], spans[1:6:3])
        apart = jnp.sum((nodes[PAIRS[:6:3, 0]] - nodes[PAIRS[1:6:3, 0]]) * normals, axis=1)
        margins = {
            "yield": (1 - (jnp.abs(forces) + gusts) / (YIELD * areas))[::every],
            "buckling": (1 - (gusts - forces)[:6] / euler)[::every],
            "force density": ((forces - gusts)[6:] / (SLACKEST * lengths[6:]) - 1)[::every],
            "distance": apart / jnp.sqrt(jnp.sum(normals**2, axis=1)) / APART - 1,
            "frequency": squares[:LOWEST] / (2 * np.pi * frequency) ** 2 - 1,
        }
        return Values(masses.sum(), nodes, forces, areas, squares, loads[3 :: every if alike else 1], margins)

    return values


def values_of(y: Any, wind: float, frequency: float) -> Values:
    """What a design comes to, of NumPy's arrays."""
    names: list[str] = []

    def noted(*at: Any) -> Values:
        values = tower()(*at)
        names[:] = values.margins
        return values

    found = jax.tree.map(np.asarray, jax.jit(noted)(y, wind, frequency))  # which sorts dictionaries
    return found._replace(margins={name: found.margins[name] for name in names})


@lru_cache
def functions(alike: bool = True, moves: bool = True) -> Callable[..., tuple[Any, Any, Any]]:
    """(y, wind, frequency) -> mass, equations and margins, for `least`."""

    def three(*at: Any) -> tuple[Any, Any, Any]:
        values = tower(alike, moves)(*at)
        return values.mass, values.loads.ravel() / (PAYLOAD * 9.81), jnp.concatenate(list(values.margins.values()))

    return three


def start(alike: bool = True) -> tuple[Any, Any]:
    """A guess y of 400 N/m in rods and 200 N/m in strings, which nothing balances yet; and bounds (y, 2)."""
    sizes = np.array([2, 9]) * (1 if alike else 3)
    guess = np.concatenate([BY_HAND, np.repeat([4.0, 2.0], sizes), np.ones(sizes.sum())])
    low = np.concatenate([LEAST, np.full(sizes.sum(), SLACKEST / 100), np.full(sizes.sum(), 1e-3)])
    return guess, np.column_stack([low, np.concatenate([MOST, np.full(2 * sizes.sum(), 1e3)])])


def _small_motions(nodes: Any, lengths: Any, forces: Any, axial: Any, masses: Any, wind: Any) -> tuple[Any, Any]:
    """ω² (27,), and the most that wind adds to the members' forces (33,) [N], from the worst side."""
    rest = lengths / (1 + forces / axial)

    def energy(span: Any, k: Any, long: Any) -> Any:
        return 0.5 * k * (jnp.sqrt(jnp.sum(span**2)) - long) ** 2

    spans, free = times(ENDS, nodes), np.eye(36)[:, 9:]
    blocks = jax.vmap(jax.hessian(energy))(spans, axial / rest, rest)
    K = free.T @ jnp.einsum("mi,mab,mj->iajb", ENDS, blocks, ENDS).reshape(36, 36) @ free
    by_node = jnp.tensordot(masses[:6], SHARES, 1) + np.diag(ON_NODES)
    squares = frequency_squares(K, free.T @ jnp.kron(by_node, np.eye(3)) @ free)
    pushes = np.zeros((12, 3, 2))
    pushes[9:, 0, 0] = pushes[9:, 1, 1] = 1 / 3
    moved = (free @ jnp.linalg.solve(K, wind * free.T @ pushes.reshape(36, 2))).reshape(12, 3, 2)
    change = (axial / rest / lengths)[:, None] * jnp.sum(spans[:, :, None] * times(ENDS, moved), axis=1)
    # Of winds (cos θ, sin θ) the most is √(x² + y²), a cone without a slope at its tip: so a little more.
    return squares, jnp.sqrt(jnp.sum(change**2, axis=1) + BLUNT**2)


def best(y: Any, wind: float, frequency: float, kept: int, count: int = 4) -> Optimum:
    """The lightest from y and from others by chance: forms within bounds, other numbers by up to a half.

    The first entries of y are kept: 8 for a given form.
    """
    found, (_, bounds) = [], start()
    for seed in range(count):
        generator, other = np.random.default_rng(seed), np.array(y)
        if seed:
            other[:8] = LEAST + (MOST - LEAST) * generator.uniform(0.2, 0.8, 8)
            other[8:] *= generator.uniform(0.5, 1.5, len(y) - 8)
            other[:kept] = y[:kept]
        found.append(least(functions(), other, bounds, arguments=(wind, frequency), kept=kept))
    return min((one for one in found if one.converged), key=lambda one: one.cost)


def named(values: Values, active: Any) -> list[str]:
    """Names of margins of groups."""
    groups = {"buckling": list(GROUPS)[:2], "force density": list(GROUPS)[2:], "frequency": range(1, LOWEST + 1)}
    names = [(what, list(groups.get(what, GROUPS))[n]) for what, of in values.margins.items() for n in range(len(of))]
    return ["{} {}".format(*names[row]) for row in active]


def built(values: Values) -> tmj.Scene:
    """The design as a scene at rest: members are elastic, and as long without force as its forces want."""
    given, lengths = layout(values.nodes), np.linalg.norm(ENDS @ np.asarray(values.nodes), axis=1)
    areas = np.asarray(values.areas)
    rest = lengths / (1 + np.asarray(values.forces) / (MODULUS * areas))
    k, masses, radii = MODULUS * areas / rest, DENSITY * areas * lengths, np.sqrt(areas / np.pi)
    rods = [
        replace(rod, mass=m, radius=r, section=Section.solid(r, E, limit), stiffness=stiff, rest_length=long)
        for rod, m, r, E, limit, stiff, long in zip(
            given.rods, *(one.tolist() for one in (masses, radii, MODULUS, YIELD, k, rest)), strict=False
        )
    ]
    strings = {"stiffness": k[6:], "rest_length": rest[6:], "strength": (YIELD * areas)[6:]}
    structure = replace(given, rods=tuple(rods)).with_strings(**strings)
    return tmj.Scene(structure, name="tower", source=__doc__.split("\n")[0], gravity=tuple(GRAVITY), duration=1.0)


def judged(scene: tmj.Scene, wind: float, swing: float = 1e-5) -> dict[str, float]:
    """What the package's own numbers make of it, and two engines of a period of its first mode, swing [m] wide."""
    at_rest, around = find_equilibrium(scene), np.pi / 6 * np.arange(12)
    pushes = wind / 3 * np.column_stack([np.cos(around), np.sin(around), 0 * around])
    blown = [find_equilibrium(scene.with_(loads=[Load(f"t2_{i}", push) for i in (1, 2, 3)])) for push in pushes]
    modes = natural_modes(at_rest)
    frequency, shape = float(modes.frequencies[0]), modes.shapes[:, 0].reshape(-1, 3)
    found = {
        "nodes are off their equilibrium by [m]": float(np.abs(at_rest.nodes - scene.nodes0).max()),
        "utilisation": max(use.utilisation for use in check_state(at_rest).uses),
        "utilisation in wind": max(use.utilisation for state in blown for use in check_state(state).uses),
        "least force density in wind [N/m]": min(float(state.force_densities.min()) for state in blown),
        "first frequency [Hz]": frequency,
        "clearance of rods [m]": tmj.clearance(scene).smallest[tmj.runs.Pairs.ROD_ROD].distance,
    }
    moving = scene.with_(initial_velocities=2 * np.pi * frequency * swing * shape / np.abs(shape).max())
    for engine in (tmj.MuJoCo(2e-5), tmj.DAE()):
        still, back = (tmj.simulate(one, None, engine, duration=1 / frequency) for one in (scene, moving))
        name = type(engine).__name__
        found[f"{name}: nodes move by [m]"] = float(np.abs(still.nodes - scene.nodes0).max())
        found[f"{name}: off after a period, of the swing"] = float(np.abs(back.nodes[-1] - scene.nodes0).max()) / swing
    return found


def draw(path: Path, towers: dict[str, Values], curves: dict[str, Any], proven: float) -> None:
    """Towers from the side, and least masses by frequency."""
    import matplotlib.pyplot as plt

    figure, (*sides, panel) = plt.subplots(1, 3, figsize=(8, 4), layout="constrained", width_ratios=(1, 1, 2.2))
    for side, (name, values) in zip(sides, towers.items(), strict=True):
        nodes, radii = np.asarray(values.nodes), np.sqrt(np.asarray(values.areas) / np.pi)
        for row, pair in enumerate(PAIRS):
            color, width = ("0.3", 700.0) if row < 6 else ("C1", 1400.0)
            side.plot(*nodes[pair][:, [0, 2]].T, color=color, lw=width * radii[row], zorder=row < 6)
        side.set(title=f"{name}\n{values.mass:.2f} kg", aspect="equal", xlim=(-0.5, 0.5), xlabel="x [m]")
        panel.plot(*np.transpose(curves[name]), "o-", label=name)
    panel.axhline(proven, color="0.5", ls="--", label="form by hand, no wind: linear programs")
    panel.set(xlabel="least first frequency [Hz]", ylabel="least mass [kg]", ylim=(0, None))
    panel.legend(loc="lower right")
    figure.savefig(path, dpi=80)


def main() -> None:
    """Design, judge, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/design"), help="folder (default: %(default)s)")
    parser.add_argument("--wind", type=float, default=100.0, help="[N] on the payload, from anywhere (%(default)s)")
    parser.add_argument("--frequency", type=float, default=8.0, help="[Hz] the least first one (%(default)s)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    told: dict[str, Any] = {}

    def tell(what: str, found: Optimum | None = None, **numbers: Any) -> None:
        if found is not None:
            numbers = {"mass": found.cost, "KKT residual": found.residual, "violation": found.violation} | numbers
        told[what] = numbers
        print(f"{what}:", *(f"  {name}: {number}" for name, number in numbers.items()), sep="\n")

    materials: dict[str, Any] = {"rods": ALUMINIUM, "strings": UHMWPE, "least_force_density": SLACKEST}
    proven = minimal_mass(layout(place(BY_HAND)), gravity=GRAVITY, tolerance=1e-9, **materials)
    tell("form by hand, no wind, linear programs", mass=proven.mass, bound=proven.lower_bound)
    for alike, each in ((False, "member"), (True, "group")):
        dead = least(functions(alike, False), *start(alike), arguments=(0.0, 1.0), kept=8)
        tell(f"form by hand, no wind, gradients, each {each}", dead, off=dead.cost / proven.mass - 1)

    towers, curves = {}, {}
    for name, kept in (("form by hand", 8), ("form free", 0)):
        found = best(dead.y, options.wind, options.frequency, kept)
        values = towers[name] = values_of(found.y, options.wind, options.frequency)
        tell(name, found, active=named(values, found.active))
        hertz = options.frequency * np.linspace(0.25, 2.0, 8)
        curves[name] = [(one, best(found.y, options.wind, one, kept, 1).cost) for one in hertz]
    tell("the form", **{name: float(number) for name, number in zip(FORM, found.y, strict=False)})
    tell("least masses by frequency [kg]", hertz=hertz.tolist(), **{n: [m for _, m in c] for n, c in curves.items()})
    scene = built(values)
    tell("judged", **judged(scene, options.wind), by_gradients=float(jnp.sqrt(values.squares[0]) / (2 * np.pi)))
    tmj.save_scene(scene, options.out / "tower.toml")
    draw(options.out / "design.png", towers, curves, proven.mass)
    (options.out / "design.json").write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()

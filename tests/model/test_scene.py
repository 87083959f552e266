"""Scenes: motions that a structure cannot make, loads, targets and controls that do not fit are refused by name."""

from __future__ import annotations

import math
import pickle
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evidence.random_linked import random_velocities
from evidence.random_structures import random_configuration, random_scene, random_structure
from tensegrity_mj.errors import SceneError
from tensegrity_mj.model.events import ControlSpec, Load
from tensegrity_mj.model.members import PointMass, Rod, String, Support
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.model.structure import Structure
from tensegrity_mj.model.target import Target
from tensegrity_mj.model.text.reading import scene_from_toml
from tensegrity_mj.model.text.writing import scene_to_toml

NAN = math.nan

# A rod pinned at the origin, one whose lower end slides in the plane z = 0, one that swings in the plane y = 4
# about its lower end, and a point mass in the plane z = 1.
STRUCTURE = Structure(
    name="four kinds",
    nodes={
        "a": (0.0, 0.0, 0.0),
        "b": (0.0, 0.0, 1.0),
        "c": (2.0, 0.0, 0.0),
        "d": (2.0, 0.0, 1.0),
        "e": (0.0, 4.0, 0.0),
        "g": (1.0, 4.0, 0.0),
        "p": (0.0, 2.0, 1.0),
        "f": (4.0, 0.0, 0.0),
    },
    rods=(
        Rod("r1", ("a", "b"), 1.0, support=Support.pinned(0.0)),
        Rod("r2", ("c", "d"), 1.0, support=Support.constrained([0, 0, 1])),
        Rod("r3", ("e", "g"), 1.0, support=Support.pinned(0.0, plane=(0, 1, 0))),
    ),
    strings=(String("s1", ("b", "d"), 5.0), String("s2", ("d", "f"), 5.0), String("s3", ("b", "p"), 5.0)),
    fixed_nodes=("f",),
    point_masses=(PointMass("p", 1.0, (0, 0, 1)),),
)
ROWS = STRUCTURE.node_index


def nodes(**rows: tuple[float, float, float]) -> np.ndarray:
    """The reference with some nodes elsewhere."""
    return changed(STRUCTURE.positions, rows)


def speeds(**rows: tuple[float, float, float]) -> np.ndarray:
    """At rest, but for some nodes."""
    return changed(np.zeros((8, 3)), rows)


def changed(base: np.ndarray, rows: dict[str, tuple[float, float, float]]) -> np.ndarray:
    array = np.array(base)
    for name, row in rows.items():
        array[ROWS[name]] = row
    return array


def scene(**changes: Any) -> Scene:
    return Scene(STRUCTURE, **changes)


def target(*waypoints: np.ndarray, times: Any = None) -> Target:
    return Target.path(range(len(waypoints)) if times is None else times, waypoints)


ALL = "'a', 'b', 'c', 'd', 'e', 'g', 'p', 'f'"

INVALID: dict[str, tuple[Callable[[], Scene], tuple[str, ...]]] = {
    "structure": (lambda: Scene("prism"), ("structure", "'prism'", "Structure")),  # type: ignore[arg-type]
    "name": (lambda: scene(name=3), ("scene", "name = 3", "text")),
    "source": (lambda: scene(source="\ud800"), ("source", "UTF-8")),
    "gravity NaN": (lambda: scene(gravity=(0, 0, NAN)), ("gravity", "nan", "three finite numbers [m/s²]")),
    "gravity as a number": (lambda: scene(gravity=-9.81), ("gravity", "-9.81", "three finite numbers [m/s²]")),
    "duration": (lambda: scene(duration=0.0), ("duration", "0.0", "> 0 s")),
    "duration NaN": (lambda: scene(duration=NAN), ("duration", "nan", "> 0 s")),
    # start
    "shape of nodes": (lambda: scene(initial_nodes=np.zeros((3, 3))), ("initial_nodes", "(3, 3)", "(8, 3)", ALL)),
    "nodes are no numbers": (lambda: scene(initial_nodes="up"), ("initial_nodes = 'up'", "(N, 3)")),
    "NaN among nodes": (lambda: scene(initial_nodes=nodes(d=(2, NAN, 1))), ("initial_nodes", "'d'", "nan", "finite")),
    "stretched rod": (
        lambda: scene(initial_nodes=nodes(b=(0, 0, 1.1))),
        ("initial_nodes", "rod 'r1'", "1.1 m long", "its length is 1 m"),
    ),
    "pinned rod elsewhere": (
        lambda: scene(initial_nodes=nodes(a=(0.1, 0, 0), b=(0.1, 0, 1))),
        ("initial_nodes", "rod 'r1'", "support by 0.1 m", "σ = 0.0"),
    ),
    "sliding rod lifted": (
        lambda: scene(initial_nodes=nodes(c=(3, 0, 0.2), d=(3, 0, 1.2))),
        ("initial_nodes", "rod 'r2'", "support by 0.2 m", "D r = r̄"),
    ),
    "planar rod out of its plane": (
        lambda: scene(initial_nodes=nodes(g=(0.6, 4.8, 0))),
        ("initial_nodes", "rod 'r3'", "plane by 0.8 m", "(0.0, 1.0, 0.0)"),
    ),
    "planar point mass lifted": (
        lambda: scene(initial_nodes=nodes(p=(1, 1, 1.5))),
        ("initial_nodes", "point mass on node 'p'", "0.5 m out of its plane"),
    ),
    "fixed node moved": (lambda: scene(initial_nodes=nodes(f=(4, 0, 1))), ("initial_nodes", "fixed node 'f'", "1 m")),
    "string of no length": (
        lambda: scene(initial_nodes=nodes(p=(0, 0, 1))),
        ("initial_nodes", "string 's3'", "length 0"),
    ),
    # speeds
    "shape of velocities": (lambda: scene(initial_velocities=np.zeros(3)), ("initial_velocities", "(3,)", "(8, 3)")),
    "NaN among velocities": (
        lambda: scene(initial_velocities=speeds(d=(0, 0, NAN))),
        ("initial_velocities", "'d'", "nan"),
    ),
    "velocity that stretches": (
        lambda: scene(initial_velocities=speeds(d=(0, 0, 0.5))),
        ("initial_velocities", "rod 'r2'", "lengthen at 0.5 m/s"),
    ),
    "velocity off the pin": (
        lambda: scene(initial_velocities=speeds(a=(1, 0, 0), b=(1, 0, 0))),
        ("initial_velocities", "rod 'r1'", "support at 1 m/s", "σ = 0.0"),
    ),
    "velocity off the slide": (
        lambda: scene(initial_velocities=speeds(c=(1, 0, 0.25), d=(1, 0, 0.25))),
        ("initial_velocities", "rod 'r2'", "support at 0.25 m/s"),
    ),
    "velocity out of the plane": (
        lambda: scene(initial_velocities=speeds(g=(0, 0.5, 0))),
        ("initial_velocities", "rod 'r3'", "out of its plane at 0.5 m/s"),
    ),
    "velocity of the planar mass": (
        lambda: scene(initial_velocities=speeds(p=(1, 0, 2))),
        ("initial_velocities", "point mass on 'p'", "plane at 2 m/s"),
    ),
    "velocity of the fixed node": (
        lambda: scene(initial_velocities=speeds(f=(0, 1, 0))),
        ("initial_velocities", "fixed node 'f'", "[0.0, 1.0, 0.0] m/s", "at rest"),
    ),
    # loads
    "one load instead of several": (lambda: scene(loads=Load("b", (0, 0, 1))), ("loads", "sequence")),
    "load of another kind": (lambda: scene(loads=[("b", (0, 0, 1))]), ("loads[0]", "'b'", "use Load(")),
    "load on an unknown node": (lambda: scene(loads=[Load("z", (0, 0, 1))]), ("loads[0]", "'z'", ALL)),
    "load NaN": (lambda: scene(loads=[Load("b", (0, 0, NAN))]), ("load on node 'b'", "nan", "[N]")),
    "load frequency": (
        lambda: scene(loads=[Load("b", (0, 0, 1), math.inf)]),
        ("'b': angular_frequency = inf", "finite"),
    ),
    "load phase": (lambda: scene(loads=[Load("b", (0, 0, 1), 1.0, "sin")]), ("'b': phase = 'sin'", "finite")),  # type: ignore[arg-type]
    "load function of another shape": (lambda: scene(loads=lambda t: np.zeros(3)), ("loads", "(3,)", "(8, 3)")),
    "load function that fails": (lambda: scene(loads=lambda t: 1 / t), ("loads", "t = 0", "ZeroDivisionError")),
    "load function NaN": (lambda: scene(loads=lambda t: np.full((8, 3), NAN)), ("loads", "t = 0", "finite")),
    # targets
    "target of another kind": (lambda: scene(target=nodes()), ("target", "Target.set_point")),
    "target of another shape": (
        lambda: scene(target=Target.set_point(np.zeros((2, 3)))),
        ("target", "(1, 2, 3)", "(W, 8, 3)"),
    ),
    "target of texts": (lambda: scene(target=Target.set_point("up")), ("target", "numbers")),
    "ragged target": (lambda: scene(target=Target.path([0, 1], [nodes(), nodes()[:2]])), ("target", "numbers")),
    "times and waypoints": (lambda: scene(target=target(nodes(), times=[0, 1])), ("target", "2 times", "(1, 8, 3)")),
    "no waypoint": (lambda: scene(target=Target((), np.zeros((0, 8, 3)))), ("target", "times []", "increase")),
    "times that stand": (lambda: scene(target=target(nodes(), nodes(), times=[1, 1])), ("[1.0, 1.0]", "increase")),
    "times NaN": (lambda: scene(target=target(nodes(), nodes(), times=[0, NAN])), ("target", "nan", "finite")),
    "target that stretches": (
        lambda: scene(target=Target.set_point(nodes(b=(0, 0.8, 0.7)))),
        ("target:", "rod 'r1'", "1.063", "its length is 1 m"),
    ),
    "waypoint off a support": (
        lambda: scene(target=target(nodes(), nodes(c=(2, 0, 1), d=(2, 0, 2)), times=[0, 2.5])),
        ("waypoint 1 (t = 2.5 s)", "rod 'r2'", "support by 1 m"),
    ),
    "NaN in a target": (lambda: scene(target=Target.set_point(nodes(d=(NAN, 0, 0)))), ("target", "'d'", "nan")),
    # control
    "control of another kind": (lambda: scene(control="lyapunov"), ("control", "'lyapunov'", "ControlSpec")),
    "law without name": (lambda: scene(control=ControlSpec("")), ("control", "law", "''")),
    "options of another kind": (lambda: scene(control=ControlSpec("x", [1])), ("options", "[1]", "map")),  # type: ignore[arg-type]
    "option without name": (lambda: scene(control=ControlSpec("x", {"": 1})), ("option ''", "non-empty")),
    "option of another kind": (lambda: scene(control=ControlSpec("x", {"gain": None})), ("'gain'", "None")),  # type: ignore[dict-item]
    "option with a NaN": (lambda: scene(control=ControlSpec("x", {"gain": [1.0, NAN]})), ("'gain'", "nan")),
}


@pytest.mark.parametrize("case", INVALID)
def test_refused_and_named(case: str) -> None:
    make, words = INVALID[case]
    with pytest.raises(SceneError) as caught:
        make()
    for word in words:
        assert word in str(caught.value)


def test_motions_that_the_supports_allow_pass() -> None:
    start = nodes(b=(0.6, 0, 0.8), c=(3, 1, 0), d=(3, 1, 1), g=(0, 4, -1), p=(1, 1, 1))
    # Each rod turns about its support: across itself, so to first order without stretch.
    moving = speeds(b=(0.8, 1, -0.6), c=(1, 2, 0), d=(1, 2, 0), g=(3, 0, 0), p=(1, 2, 0))
    path = target(nodes(), start, times=[0, 3])
    good = scene(initial_nodes=start, initial_velocities=moving, target=path, gravity=(0, 0, -9.81))
    np.testing.assert_array_equal(good.nodes0, start)
    np.testing.assert_array_equal(good.velocities0, moving)
    assert good.name == "four kinds"


def test_a_lone_point_mass_may_move_in_its_plane() -> None:
    lone = Structure("mass", {"p": (0.3, 0.1, 0.2)}, point_masses=(PointMass("p", 1.0, (1, 2, 3)),))
    shifted = lone.positions + 0.1 * np.array([[2.0, -1.0, 0.0]])  # orthogonal to the normal
    assert Scene(lone, initial_nodes=shifted).nodes0[0, 0] == shifted[0, 0]


def test_round_off_of_saved_numbers_passes_and_what_can_be_seen_does_not() -> None:
    scene(initial_nodes=nodes(b=(0, 0, 1 + 1e-10)))
    with pytest.raises(SceneError):
        scene(initial_nodes=nodes(b=(0, 0, 1 + 1e-7)))
    scene(initial_velocities=speeds(d=(1, 0, 1e-10)))
    with pytest.raises(SceneError):
        scene(initial_velocities=speeds(d=(1, 0, 1e-7)))


def test_loads_are_cosines_and_functions_pass_through() -> None:
    loads = (
        Load("b", (0, 0, 2.0), 3.0, -math.pi / 2),
        Load("b", (1.0, 0, 0)),
        Load("d", (0, 1.0, 0), 0.0, math.pi / 3),
    )
    forces = scene(loads=loads).nodal_forces(0.7)
    np.testing.assert_allclose(forces[ROWS["b"]], [1.0, 0.0, 2 * math.sin(3 * 0.7)], rtol=1e-15)
    np.testing.assert_allclose(forces[ROWS["d"]], [0.0, 0.5, 0.0], rtol=1e-15)
    assert np.count_nonzero(forces) == 3
    by_function = scene(loads=lambda t: t * np.ones((8, 3)))
    np.testing.assert_array_equal(by_function.nodal_forces(2.0), 2 * np.ones((8, 3)))


def test_scenes_are_values() -> None:
    made = scene(loads=[Load("b", [0, 0, 1])], control=ControlSpec("x", {"gain": np.eye(2), "norm": np.int64(2)}))  # type: ignore[arg-type]
    same = scene(
        loads=(Load("b", (0.0, 0.0, 1.0)),), control=ControlSpec("x", {"gain": [[1.0, 0.0], [0.0, 1.0]], "norm": 2})
    )
    assert made == same
    assert made.with_(duration=3.0) != same
    assert made.with_(initial_velocities=speeds(p=(1, 0, 0))) != same
    assert made.with_(target=Target.set_point(nodes())) != same
    assert pickle.loads(pickle.dumps(made)) == made
    with pytest.raises(SceneError, match="duration"):
        made.with_(duration=-1.0)
    with pytest.raises(ValueError, match="read-only"):
        made.with_(initial_nodes=nodes()).nodes0[0] = 1.0


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_random_motions_keep_supports_and_rods(seed: int, planar: bool) -> None:
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, rods=3, planar=planar, own_planes=0.5, point_masses=1)
    ways = [random_configuration(rng, structure, 0.3) for _ in range(2)]
    scene = random_scene(rng, structure, displaced=0.5, moving=2.0, gravity=True, loads=2)
    scene.with_(target=Target.path([0.5, 1.0], ways), control=ControlSpec("lyapunov", {"decay_rate": 0.5, "norm": 2}))
    # What the constructor accepted is what physics requires: no rod's length changes along the motion.
    start = random_configuration(rng, structure, 0.5)
    velocities = random_velocities(rng, structure, start, 1.0)
    h = 1e-6
    i, j = structure.rod_nodes.T
    later = start + h * velocities
    # Lengths change by (h ω)² / 2 < 1e-12 m only, and by round-off.
    np.testing.assert_allclose(np.linalg.norm(later[j] - later[i], axis=1), structure.rod_lengths, atol=1e-11)


def test_nodes_of_a_start_are_written_under_their_own_names() -> None:
    nodes = {"z": (0.0, 0.0, 0.0), "a": (1.0, 0.0, 0.0), "m": (0.0, 2.0, 0.0), "b": (0.0, 2.0, 3.0)}
    made = Structure("names", nodes, (Rod("r1", ("z", "a"), 1.0), Rod("r2", ("m", "b"), 1.0)))
    start = made.positions + np.array([[0, 0, 0.5], [0, 0, 0.5], [0.25, 0, 0], [0.25, 0, 0]])
    text = scene_to_toml(Scene(made, initial_nodes=start))
    written = tomllib.loads(text)["scene"]["initial_nodes"]
    assert written == dict(zip(nodes, start.tolist(), strict=True))
    assert np.array_equal(scene_from_toml(text).nodes0, start)

"""The table of engines and of what each cannot simulate: commands, sweeps, studies and pages have their names from it.
It imports none of them.

A new engine is a folder of its own next to this file, and a row here.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model import capabilities as has
from tensegrity_mj.model.capabilities import Descriptor, Limit

if TYPE_CHECKING:
    from tensegrity_mj.model.scene import Scene

_WITHOUT_CONTACT = "leave it out (scene.with_(contact=None))"
_OWN_NODES = "give each rod nodes of its own"
_NO_CONTACT = Limit(has.CONTACT, "the thesis' equations have no forces of contact", _WITHOUT_CONTACT, OptionError)
_ROWS = "hold nodes by supports and planes of rods"
_RIGID = "make the rods rigid (without stiffness)"
_NOT_LOCATED = Limit(
    has.CONTACT,
    "its forces jump at other instants than those of strings",
    "leave one of the two out (scene.with_(contact=None))",
    OptionError,
    lambda engine: "locate_slack = True" if engine.locate_slack else "",
)
_ALONE = "its contact is that of rods and point masses that are alone, on a plane"
_OTHERWISE = "leave one of the two out"
# Contact in the DAE.
_CONTACT_LIMITS = (
    Limit(
        has.CONTACT_OF_RODS & has.COULOMB,
        "that law is of rods with a plane",
        "leave rods = true out, or set contact.law = 'mujoco'",
    ),
    Limit(has.TERRAIN, _ALONE, "take a plane, with a normal for a slope"),
    Limit(has.TURNING_FRICTION, "its friction is that of sliding", "leave torsion and rolling out"),
    Limit(has.CLASS_K & has.CONTACT, _ALONE, f"{_OWN_NODES}, or {_WITHOUT_CONTACT}"),
    Limit(has.MOVED_SUPPORTS & has.CONTACT, _ALONE, _OTHERWISE),
    Limit(has.BODIES & has.CONTACT, "a body has nodes and no shape that could touch", _WITHOUT_CONTACT),
    Limit(has.CONSTRAINTS & has.CONTACT, "constraints join what contact takes one by one", _WITHOUT_CONTACT),
    Limit(has.ELASTIC & has.CONTACT, _ALONE, f"{_WITHOUT_CONTACT}, or {_RIGID}"),
    Limit(has.ADDED_MASS & has.CONTACT, "contact feels the mass of dry rods", _OTHERWISE),
    Limit(
        has.CONTACT,
        "contact is in the equations of rods that are alone",
        "leave the solver out",
        OptionError,
        lambda engine: "" if engine.solver.value == "joints" else f"Solver.{engine.solver.name}",
    ),
    _NOT_LOCATED,
)
_ELASTIC_ADDED_MASS = Limit(
    has.ELASTIC & has.ADDED_MASS,
    "added mass is that of rods of constant length",
    f"leave one of the two out, or {_RIGID}",
)
# Of any model that MuJoCo has of a scene.
ELASTIC_LIMITS = (
    Limit(
        has.ELASTIC & has.CONTACT, "the bodies of contact have a constant length", f"{_WITHOUT_CONTACT}, or {_RIGID}"
    ),
    Limit(
        has.ELASTIC & has.CLASS_K,
        "bodies that share a node form a tree, and an elastic rod in it would need a second node that moves by itself",
        f"{_OWN_NODES}, or {_RIGID}",
        StructureError,
    ),
    Limit(
        has.ELASTIC_HELD_BETWEEN,
        "its bodies slide along the rod, starting at one end",
        f"hold it at an end (sigma = 0 or 1), or {_RIGID}",
        StructureError,
    ),
)


ENGINES = {
    "mujoco": Descriptor(
        "MuJoCo",
        "tensegrity_mj.engines.mujoco.settings:MuJoCo",
        shares_model=True,
        limits=(
            Limit(has.BODIES & has.CONTACT, "a body has nodes and no shape that could touch", _WITHOUT_CONTACT),
            Limit(
                has.CLASS_K & has.HELD_SPIN,
                "bodies that hang on each other turn relative to each other, so that nothing holds one about its own "
                "axis alone",
                "let rods turn (contact with spin = 'free')",
            ),
            Limit(
                has.CONSTRAINTS & has.CONTACT,
                "forces of constraints are found before those of contact are known",
                f"{_WITHOUT_CONTACT}, or hold nodes by supports",
            ),
            Limit(
                has.CONSTRAINTS & has.CLOSED_LOOPS,
                "forces of constraints are found before those of joints that close loops are known",
                "open the loop, or simulate it with the DAE",
                StructureError,
            ),
            Limit(
                has.CONSTRAINTS,
                "their forces are found for the accelerations of the step's start, and this integrator does not step "
                "with those",
                "use Integrator.RK4 or EULER",
                OptionError,
                lambda engine: "" if engine.is_explicit else f"Integrator.{engine.integrator.name}",
            ),
            *ELASTIC_LIMITS,
            _ELASTIC_ADDED_MASS,
            Limit(
                has.ADDED_MASS & has.CONTACT,
                "accelerations of added mass are found before the forces of contact are known",
                "leave one of the two out, with scene.with_(contact=None) or scene.with_(water=None)",
            ),
            Limit(
                has.ADDED_MASS & has.CLOSED_LOOPS,
                "accelerations of added mass are found before the forces of joints that close loops are known",
                "open the loop",
                StructureError,
            ),
            Limit(
                has.ADDED_MASS,
                "its force is found for the accelerations of the step's start, and this integrator does not step with "
                "those",
                "use Integrator.RK4 or EULER",
                OptionError,
                lambda engine: "" if engine.is_explicit else f"Integrator.{engine.integrator.name}",
            ),
            _NOT_LOCATED,
            Limit(
                has.COULOMB,
                "MuJoCo's friction is the convex law 'mujoco'",
                "set contact.law = 'mujoco'",
            ),
        ),
    ),
    "dae": Descriptor(
        "DAE",
        "tensegrity_mj.engines.reference.dae:DAE",
        {"method": "rk4"},
        (
            *_CONTACT_LIMITS,
            _ELASTIC_ADDED_MASS,
            Limit(
                has.UNEVEN_MASS & has.CLASS_K,
                "Weights.HERMITE shares loads otherwise than velocities, and forces of joints are found from symmetric "
                "equations",
                "use Solver.FULL, or Weights.RIGID",
                OptionError,
                lambda engine: "Solver.JOINTS" if engine.solver.value == "joints" else "",
            ),
        ),
    ),
    "ode": Descriptor(
        "ODE",
        "tensegrity_mj.engines.reference.ode:ODE",
        {"method": "rk4"},
        (
            _NO_CONTACT,
            Limit(has.ELASTIC, "its angles are those of rods of constant length", _RIGID, StructureError),
            Limit(
                has.CONSTRAINTS,
                "minimal coordinates are those that rods have by their own supports; linear constraints couple them",
                _ROWS,
                StructureError,
            ),
            Limit(
                has.BODIES,
                "minimal coordinates are angles of rods, and those of a body have poles of their own",
                "leave the body out",
                StructureError,
            ),
            Limit(
                has.CLASS_K,
                "the angles of minimal coordinates are those of rods that hang on no other, of class 1",
                _OWN_NODES,
                StructureError,
            ),
        ),
    ),
    "jax": Descriptor(
        "JAX",
        "tensegrity_mj.engines.jax.settings:JAX",
        {"method": "rk4"},
        (
            Limit(has.CONTACT, "no array function states its forces", _WITHOUT_CONTACT, OptionError),
            Limit(
                has.NO_ARRAYS, "it acts by functions of arrays, which JAX compiles and differentiates", "leave it out"
            ),
            Limit(has.ELEMENT_STATES, "array functions are of positions, velocities and time alone", "leave it out"),
            Limit(
                has.FUNCTION_LOADS, "JAX cannot look into a Python function", "give them as `Load`s, or as an element"
            ),
            Limit(has.FUNCTION_MOTIONS, "JAX cannot look into a Python function", "give it as harmonics or data"),
            Limit(has.YIELDING, "its memory is that of steps, and no function of the state", "leave yields out"),
        ),
        shares_model=True,
        extra="jax",
    ),
}


def installed() -> tuple[str, ...]:
    """The names of the engines that come with the package, without an extra."""
    return tuple(name for name, row in ENGINES.items() if not row.extra)


def engine_class(name: str) -> Any:
    """The class of an engine's options.

    Raises:
        OptionError: for a name that is none.
    """
    if name not in ENGINES:
        raise OptionError(f"engine = {name!r}: {unknown(str(name), ENGINES, 'engine')}")
    module, _, attribute = ENGINES[name].place.partition(":")
    return getattr(import_module(module), attribute)


def option_names(name: str) -> list[str]:
    """The options of an engine."""
    return [item.name for item in dataclasses.fields(engine_class(name))]


def make_engine(name: str, options: Mapping[str, Any]) -> Any:
    """The engine with these options, plain values: of those that are enums, the words (or the members).

    Raises:
        OptionError: for an option that it has not, or a value that the option cannot have.
    """
    from tensegrity_mj.basics.checks import choice_from

    kind, known = engine_class(name), option_names(name)
    usual = kind()  # where an option's default depends on others, it still shows of what kind the option is
    chosen = {}
    for option, value in options.items():
        if option not in known:
            raise OptionError(f"engine.{option}: {unknown(option, known, f'option of engine {name}')}")
        default = getattr(usual, option)
        is_word = isinstance(default, enum.Enum) and not isinstance(value, type(default))
        chosen[option] = choice_from(f"engine.{option}", type(default), value) if is_word else value
    return kind(**chosen)


def engine_settings(engine: Any) -> tuple[str, dict[str, Any]]:
    """The name of an engine and its options as plain values, those at their defaults left out.

    Raises:
        OptionError: if it is no engine of the table.
    """
    for name in ENGINES:
        if type(engine) is engine_class(name):
            items = {item.name: (getattr(engine, item.name), item.default) for item in dataclasses.fields(engine)}
            chosen = {key: value for key, (value, default) in items.items() if value != default}
            return name, {key: getattr(value, "value", value) for key, value in chosen.items()}
    raise OptionError(f"engine = {engine!r}; use one of {_classes()}, an object and not a class")


def checked_engine(engine: Any, what: str = "run") -> Any:
    """An engine's options, MuJoCo's for None; OptionError for a class, or what has not this method."""
    engine = make_engine("mujoco", {}) if engine is None else engine
    if isinstance(engine, type) or not callable(getattr(engine, what, None)):
        raise OptionError(f"engine = {engine!r}; use {_classes('(...)', ' or ')}")
    return engine


def _classes(call: str = "", last: str = ", ") -> str:
    names = [row.place.partition(":")[2] + call for row in ENGINES.values()]
    return last.join([", ".join(names[:-1]), names[-1]])


# Names of engines with a fixed step, as points, tables and the command line have them, and their displayed names.
TITLES = {
    "euler": "MuJoCo Euler",
    "implicitfast": "MuJoCo implicitfast",
    "implicit": "MuJoCo implicit",
    "discrete": "MuJoCo discrete",
    "rk4": "MuJoCo RK4",
    "dae": "DAE RK4",
    "ode": "ODE RK4",
}
NAMES = tuple(TITLES)
CONTROLLED = ("dop853", "radau")  # methods that control their error
MOST_STEPS = 50_000  # of one of them


def engine_of(name: str, level: float) -> Any:
    """The engine of a name such as "euler", "dae", "dae normalize" or "ode dop853".

    MuJoCo goes by its integrators. The others take the classical Runge-Kutta method, unless another one follows; a
    treatment of drift may follow, too.

    Args:
        level: the step [s]; the rtol of a method that controls its error, whose atol is a hundredth of it.

    Raises:
        OptionError: for an unknown name.
    """
    family, _, word = name.partition(" ")
    if family not in ENGINES:
        return make_engine("mujoco", {"integrator": name, "timestep": level})
    if word in CONTROLLED:
        return make_engine(family, {"method": word, "rtol": level, "atol": 1e-2 * level, "max_steps": MOST_STEPS})
    drift = {"drift": word} if word not in ("", "rk4") else {}
    return make_engine(family, {**ENGINES[family].fixed_step, "timestep": level, **drift})


def simulates(name: str, scene: Scene) -> bool:
    """Return whether the engine of that name simulates a scene; contact, which has no small motions, does not count."""
    return has.refusal(engine_of(name, 1.0), scene.with_(contact=None)) is None

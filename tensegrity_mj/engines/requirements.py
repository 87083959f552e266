"""Check, by `require`, that an engine, or a function that uses engines, can do a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensegrity_mj.engines.table import ELASTIC_LIMITS, ENGINES
from tensegrity_mj.errors import OptionError, StructureError
from tensegrity_mj.model import capabilities as has
from tensegrity_mj.model.scene import Scene

_STILL = "leave motions out (scene.with_(motions=()))"
_PUSHING_DAMPERS = has.Limit(
    has.PUSHING_DAMPERS,
    "such strings change the model as they go slack, and many simulations share it",
    "use simulate, or run_many",
    OptionError,
)
_LATER = has.Limit(has.LATER_START, "its clock begins at 0", "use simulate or run_many, or start_time = 0", OptionError)
_STATES_AT_REST = has.Limit(
    has.ELEMENT_STATES,
    "the states of elements are not solved for",
    "replace the element by one without a state whose forces are those at rest, or let a damped run come to rest",
)
_OWN_STARTS = "leave start out, and vary numbers of the scene by draws"
# What functions cannot do, whichever the engine.
USES: Mapping[str, tuple[has.Limit, ...]] = {
    "linearize": (has.Limit(has.MOVED_SUPPORTS, "the linear model would depend on time", _STILL),),
    "engine_equilibrium": (
        has.Limit(has.MOVED_SUPPORTS, "an equilibrium is of supports that stand still", _STILL),
        _STATES_AT_REST,
    ),
    "statics": (_STATES_AT_REST,),
    "simulate_many": (_LATER, _PUSHING_DAMPERS),
    "law_in": (
        _LATER,
        _PUSHING_DAMPERS,
        has.Limit(has.YIELDING, "their memory belongs to a run, which goes on", "use simulate_many", OptionError),
        has.Limit(has.BREAKS, "a break belongs to a run, which begins and ends", "use simulate_many", OptionError),
        has.Limit(
            has.ELEMENT_STATES, "a state belongs to a run, which integrates it", "use simulate_many", OptionError
        ),
    ),
    "random starts": (
        has.Limit(has.CLOSED_LOOPS, "a random start would tear the loop open", _OWN_STARTS, OptionError),
        has.Limit(has.CONSTRAINTS, "a random start would not keep it", _OWN_STARTS, OptionError),
    ),
    "MuJoCo's model": ELASTIC_LIMITS,
    "dm_control models": (
        _LATER,
        has.Limit(
            has.ELASTIC, "dm_control knows no armature of tendons", "use simulate or law_in, or make the rods rigid"
        ),
        has.Limit(
            has.CLASS_K,
            "they are for structures of class 1, whose rods share no node",
            "use simulate or law_in, or give each rod nodes of its own",
            StructureError,
        ),
        has.Limit(has.MOVED_SUPPORTS, "they are for supports that stand still", f"use simulate, or {_STILL}"),
        has.Limit(
            has.ADDED_MASS,
            "they hold forces over a step, and that of added mass depends on the accelerations of each stage",
            "use simulate or law_in, or leave it out (scene.with_(water=None))",
        ),
        has.Limit(
            has.NOT_LINEAR, "their actuators are linear, and act between the steps alone", "use simulate or law_in"
        ),
        has.Limit(has.ELEMENT_STATES, "they integrate no states but MuJoCo's own", "use simulate or simulate_many"),
    ),
}


def require(engine: Any, scene: Scene, use: str = "", where: str = "") -> None:
    """Raise an error that names the item, who refuses it, why, and which engines take it, unless a scene can be done.

    Args:
        engine: options of an engine, or None where it is the use alone that counts. One without `descriptor` is held
            to simulate all scenes.
        scene: what is to be done.
        use: a name of `USES`, for its own limits.
        where: begins the item, as "scenes[1]".

    Raises:
        SceneError, StructureError, OptionError: as the limit says.
    """
    place = f"{where}: " if where else ""
    for limit in USES[use] if use else ():
        if found := limit.trait.find(scene):
            raise limit.error(f"{use}: {place}{found}: {limit.reason}; {limit.remedy}")
    if refused := has.refusal(engine, scene):
        limit, found, setting = refused
        title = engine.descriptor.title
        able = " or ".join(_title(name) for name in engines_for(scene) or engines_for(scene, extra=True))
        others = "" if setting else f"use {able}, or " if able else "no engine simulates it: "
        who = f"{title} with {setting}" if setting else title
        raise limit.error(f"{who}: {place}{found}: {limit.reason}; {others}{limit.remedy}")


def _title(name: str) -> str:
    row = ENGINES[name]
    return f"{row.title} (of the extra '{row.extra}')" if row.extra else row.title


def engines_for(scene: Scene, extra: bool = False) -> list[str]:
    """The names of the engines that simulate a scene, with some of their options at least.

    Those that come with the package, or those of its extras.
    """
    return [
        name
        for name, row in ENGINES.items()
        if bool(row.extra) is extra
        and not any(limit.setting is None and limit.trait.find(scene) for limit in row.limits)
    ]


def only_one(scene: Scene) -> str:
    """Words for a scene that one engine alone simulates: what it has, and the engine."""
    (name,) = engines_for(scene)
    found = {limit.trait.find(scene): None for row in ENGINES.values() for limit in row.limits if limit.setting is None}
    return f"{', '.join(words for words in found if words)}, which {ENGINES[name].title} alone simulates"

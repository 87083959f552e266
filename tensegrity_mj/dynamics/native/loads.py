"""A scene's `loads` in compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import ACT_SIGNATURE, Effect, NativeElement
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.vectors import add, times
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.model.elements.element import Element
from tensegrity_mj.model.scene import Scene

LOAD = np.dtype([("node", "i8"), ("force", "f8", (3,)), ("frequency", "f8"), ("phase", "f8")], align=True)
Loads, pack = view_of("Loads", loads=(LOAD, "count"))


def pack_loads(element: Element, scene: Scene) -> NativeElement | None:
    """The loads of a scene; None for a function in Python, which is called."""
    if callable(scene.loads):
        return None
    records = np.zeros(len(scene.loads), LOAD)
    for record, load in zip(records, scene.loads, strict=True):
        record["node"] = scene.structure.node_index[load.node]
        record["force"] = load.force
        record["frequency"], record["phase"] = load.angular_frequency, load.phase
    packed = pack(loads=records)
    return NativeElement(act_loads.address, packed.address, (packed,))


@c_function(ACT_SIGNATURE, "loads")
def act_loads(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """f(t) = force · cos(ω t + phase) of every load."""
    given, forces = Loads(context_at), Effect(effect_at).forces
    for a in range(given.count):
        load = given.loads[a]
        scale = np.cos(load.frequency * t + load.phase)
        add(forces, load.node, times(scale, load.force))
    return SOLVED

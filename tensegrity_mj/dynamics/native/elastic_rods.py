"""Elastic rods in compiled code: forces along them. See `model.elements.elastic_rods`."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.elements import ACT_SIGNATURE, Effect, Motion, NativeElement
from tensegrity_mj.dynamics.native.law import SOLVED
from tensegrity_mj.dynamics.native.vectors import dot, minus, row_of, times
from tensegrity_mj.dynamics.native.views import view_of
from tensegrity_mj.model.elements.elastic_rods import ElasticRods
from tensegrity_mj.model.rods import Bars
from tensegrity_mj.model.scene import Scene

BAR = np.dtype([("nodes", "i8", (2,)), ("stiffness", "f8"), ("damping", "f8"), ("length", "f8")], align=True)
ElasticBars, pack = view_of("ElasticBars", bars=(BAR, "count"), pulls="size")


def pack_elastic_rods(element: ElasticRods, scene: Scene) -> NativeElement:
    """The elastic rods of a scene."""
    found = Bars.of(scene.structure)
    bars = np.zeros(len(found.rows), BAR)
    bars["nodes"], bars["length"] = found.nodes, found.lengths
    bars["stiffness"], bars["damping"] = found.stiffness, found.damping
    packed = pack(bars=bars, pulls=not element.carried)
    return NativeElement(act_elastic_rods.address, packed.address, (packed,))


@c_function(ACT_SIGNATURE, "elastic rods")
def act_elastic_rods(t: Any, motion_at: Any, context_at: Any, effect_at: Any) -> Any:
    """N = k (L - ℓ) + c dL/dt along each rod; c (dL/dt)² is lost."""
    motion, own, effect = Motion(motion_at), ElasticBars(context_at), Effect(effect_at)
    nodes, velocities, forces, lost = motion.nodes, motion.velocities, effect.forces, 0.0
    for a in range(own.count):
        bar = own.bars[a]
        i, j = bar.nodes[0], bar.nodes[1]
        span = minus(row_of(nodes, j), row_of(nodes, i))
        length = np.sqrt(dot(span, span))
        rate = dot(span, minus(row_of(velocities, j), row_of(velocities, i))) / length
        pull = times((bar.stiffness * (length - bar.length) + bar.damping * rate) / length, span)
        for x in range(3 * own.pulls):
            forces[i, x] += pull[x]
            forces[j, x] -= pull[x]
        lost += bar.damping * rate * rate
    effect.given += lost
    return SOLVED

"""Elastic rods in a scene's MJCF: two bodies that slide, and tendons between them.

The body of one end slides as its support lets it, and that of the other end relative to it. Each has a sixth of the
mass. The other two thirds move as the rod's middle does, which no body can: they are the armature of three tendons, one
an axis of the world, whose lengths are that middle's coordinates. So the mass matrix is that of the two-node bar,
m/6 [2 1; 1 2] for each axis. Masses that the rod carries are three such tendons through their centre, and armature of
the slides of the second end. Armature has no weight: what each body is to weigh more, it does by `gravcomp`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from tensegrity_mj.engines.mujoco.mjcf_bodies import Names
from tensegrity_mj.engines.mujoco.mjcf_frames import numbers
from tensegrity_mj.engines.mujoco.mjcf_tree import BodyTree, distinct
from tensegrity_mj.model.scene import Scene


def add_bars(root: ET.Element, world: ET.Element, scene: Scene, tree: BodyTree, names: Names) -> None:
    """Add the tendons of all elastic rods, behind those of strings."""
    structure = scene.structure
    rows = np.flatnonzero(structure.elastic).tolist()
    if not rows:
        return
    if np.any(scene.gravity):
        ET.SubElement(world, "body", gravcomp="1")  # MuJoCo looks for gravcomp where a body has one above zero
    found = root.find("tendon")
    tendons = ET.SubElement(root, "tendon") if found is None else found
    called = distinct([structure.rods[row].name for row in rows], {string.name for string in structure.strings})
    for row, name in zip(rows, called, strict=True):
        rod, joint = structure.rods[row], tree.joints[row]
        look: dict[str, Any] = {"width": numbers([rod.radius]), "rgba": "0.25 0.35 0.55 1"}
        spring = {"stiffness": rod.stiffness, "damping": rod.damping, "springlength": structure.rod_lengths[row]}
        law: dict[str, Any] = {key: numbers([value]) for key, value in spring.items()}
        bar = ET.SubElement(tendons, "spatial", name=name, **law, **look)
        for node in rod.nodes:
            ET.SubElement(bar, "site", site=node)
        total, first, _ = structure.rod_lumps[:, row]
        for mass, at in ((2 * rod.mass / 3, 0.5), *([(total, first / total)] if total else [])):
            for shares in np.hstack([joint.axes, abs(joint.sigma - at) * joint.stretches]):
                moving = [(slide, share) for slide, share in zip(names.rod_slides[row], shares, strict=True) if share]
                fixed = ET.SubElement(tendons, "fixed", armature=numbers([mass])) if moving else tendons
                for slide, share in moving:
                    ET.SubElement(fixed, "joint", joint=slide, coef=numbers([share]))

"""What makes a scene's contact valid."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.contact import Contact, overlaps
from tensegrity_mj.errors import SceneError
from tensegrity_mj.scene import Scene
from tensegrity_mj.validation.values import check_normal, check_number, sequence_of


def check_contact(scene: Scene) -> None:
    contact = scene.contact
    if not isinstance(contact, Contact):
        raise SceneError(f"contact = {contact!r}: use Contact(floor=0.0), Contact(rods=True) or both, or None")

    def number(name: str, value: Any, allowed: str, test: Any) -> None:
        check_number(f"contact: {name}", value, allowed, test, SceneError)

    if contact.floor is not None:
        number("floor", contact.floor, "a finite height [m], or None for no floor", lambda x: True)
    if not isinstance(contact.rods, (bool, np.bool_)):
        raise SceneError(f"contact: rods = {contact.rods!r}; it must be True or False")
    if contact.floor is None and not contact.rods:
        raise SceneError("contact: there is neither a floor nor contact between rods: give one, or leave contact out")
    if contact.rods and len(scene.structure.rods) < 2:
        raise SceneError("contact: rods = True, but there are no two rods that could touch: leave it out")
    check_normal("contact", contact.normal, SceneError)
    number("friction", contact.friction, "0, or within [1e-5, 1e5]", lambda x: x == 0 or 1e-5 <= x <= 1e5)
    # MuJoCo takes an acceleration beyond 1e10 m/s² for a divergence: these reach it at 1 cm and at 1 km/s.
    number("stiffness", contact.stiffness, "> 0 and at most 1e12 [1/s²]", lambda x: 0 < x <= 1e12)
    number("damping", contact.damping, "within [0, 1e7] [1/s]", lambda x: 0 <= x <= 1e7)
    names, values = ("d0", "d1", "width", "midpoint", "power"), sequence_of("impedance", contact.impedance, SceneError)
    if len(values) != len(names):
        raise SceneError(f"contact: impedance = {contact.impedance!r}; it must be five numbers ({', '.join(names)})")
    # Beyond these MuJoCo takes others without a word, or overflows: (midpoint)^(1 - power) must be finite.
    share = ("within [0.0001, 0.9999]", lambda x: 1e-4 <= x <= 0.9999)
    length = ("at least 1e-9 m", lambda x: x >= 1e-9)
    allowed = (share, share, length, share, ("within [1, 50]", lambda x: 1 <= x <= 50))
    for name, value, (text, test) in zip(names, values, allowed, strict=True):
        number(f"impedance: {name}", value, text, test)
    if values[1] < values[0]:
        raise SceneError(
            f"contact: impedance: d1 = {values[1]:g} at the depth `width` is below d0 = {values[0]:g} at touch; a "
            "contact that softens as it is pressed may give energy: make d1 at least d0"
        )
    found = overlaps(scene.structure, contact, scene.nodes0)
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        remedy = (
            "start higher, lower the floor, or make rods thinner"
            if "floor" in found[0]
            else ("move them apart, make them thinner, or leave rods = False")
        )
        raise SceneError(f"contact: at the start {found[0]}{more}: {remedy}")

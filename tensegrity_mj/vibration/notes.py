"""What the largest stable step of a linear model does not say: sentences for people."""

from __future__ import annotations

import numpy as np

from tensegrity_mj.vibration.contact_steps import contact_limit
from tensegrity_mj.vibration.small_motions import Vibration
from tensegrity_mj.vibration.stepping import Scheme, Stepping
from tensegrity_mj.vibration.tree import has_tree_model

NEAR_POLE = 0.1  # sin φ below which the ODE's angles turn much faster than the rod


def notes_on(model: Vibration, stepping: Stepping) -> tuple[str, ...]:
    """What a model and its limit leave out, a sentence each."""
    return (*_of_strings(model), *_of_surroundings(model, stepping), *_of_integrator(model, stepping))


def _of_strings(model: Vibration) -> list[str]:
    structure, notes = model.scene.structure, []
    if model.at_edge.any():
        first_one = structure.strings[int(np.argmax(model.at_edge))].name
        notes.append(
            f"{int(model.at_edge.sum())} strings ('{first_one}' is one) are at the edge of slackness: they pull during "
            "half of a motion only, so that the limit may be larger than that of the taut side given here"
        )
    if not model.taut.all() and len(model.taut):
        slack = len(model.taut) - int(model.taut.sum())
        notes.append(f"{slack} of {len(model.taut)} strings are slack in this state and count once they are taut")
    return notes


def _of_surroundings(model: Vibration, stepping: Stepping) -> list[str]:
    scene, notes = model.scene, []
    if scene.resistance is not None and scene.resistance.drag is not None:
        notes.append("the damping of drag is not in the model: it matters where a fluid is fast")
    if scene.water is not None:
        slower = "added mass makes motions slower, so that the limit is on the safe side of it, but "
        surface = ", nor is the stiffness of buoyancy at the surface" if scene.structure.rods else ""
        notes.append(
            f"water is not in the model: {slower if scene.adding_mass else ''}the damping of drag, which matters where "
            f"the water is fast, is not there{surface}"
        )
    if scene.elements:
        names = ", ".join(dict.fromkeys(element.label for element in scene.elements))
        notes.append(
            f"of elements ({names}) the model has differences of their forces, the symmetric part of their stiffness"
        )
    stateful = ", ".join(dict.fromkeys(element.label for element in scene.elements if element.has_state))
    if stateful:
        notes.append(
            f"states of elements ({stateful}) stay as they are at the start in the model: explicit steps must also be "
            "short against their own rates, which are among the eigenvalues of linearize"
        )
    if scene.contact is not None and stepping.scheme is not None:
        notes.append(
            "contact is not in the model: where something touches, a step must also be below "
            f"{contact_limit(scene.contact, stepping.scheme):.3g} s for what rests to rest, and far below to resolve a "
            "landing (docs/contact.md)"
        )
    return notes


def _of_integrator(model: Vibration, stepping: Stepping) -> list[str]:
    structure, notes = model.scene.structure, []
    implicit = stepping.scheme is Scheme.VELOCITY_IMPLICIT and abs(model.string_damper - model.body_damper).max() > 0
    if implicit and model.state.joints is not None and (model.law is not None or not has_tree_model(model)):
        notes.append(
            "damped strings between rods that share nodes: what this integrator takes of a damper depends on how "
            "the rods hang on each other, which is in the limit of trees of up to 30 rods with supports that stand "
            "still and no law; the limit here is that without dampers, and the real one may be larger or smaller: use "
            "RK4, or measure it with tensegrity-mj stability"
        )
    elif implicit:
        notes.append(
            "dampers between bodies that move: this integrator does not keep angular momentum, and a structure that "
            "spins may spin up without bound at any step (docs/stability.md); at rest the limit holds"
        )
    if stepping.polar:
        first, second = structure.rod_nodes.T
        b = (model.state.nodes[second] - model.state.nodes[first]) / structure.rod_lengths[:, None]
        sines = np.hypot(b[:, 0], b[:, 1])
        spatial = np.array([rod.support.plane is None for rod in structure.rods], bool)
        near = np.flatnonzero(spatial & (sines < NEAR_POLE))
        if len(near):
            notes.append(
                f"rod '{structure.rods[int(near[0])].name}' is near the pole of the ODE's angles: the limit is that of "
                "motions that are small even there"
            )
    return notes

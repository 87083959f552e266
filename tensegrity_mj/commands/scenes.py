"""List the scenes that come with the package, or describe one scene or file: what it is, and what it needs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import Any

import tensegrity_mj.library as library
from tensegrity_mj import model
from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.basics.jsontext import plain_values, to_json
from tensegrity_mj.commands.common import Outcome, number, table
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.capabilities import DRY_BODIES


def execute(options: argparse.Namespace) -> Outcome:
    """List, or describe one."""
    if options.schema:
        if options.scene is not None:
            raise OptionError(f"scenes {options.scene}: --schema prints that of all scene files; leave out the scene")
        schema = model.format_schema()
        return Outcome(schema, to_json(schema, indent=1))
    if options.scene is not None:
        details = describe(library.load_scene(options.scene))
        return Outcome(details, _text(details))
    scenes = {name: library.load_scene(name) for name in library.scene_names()}
    kinds = {name: (group, line) for group, lines in shipped().items() for name, line in lines.items()}
    rows = []
    for name, scene in scenes.items():
        group, line = kinds.get(name, OTHER)
        counts = counts_of(scene.structure)
        rows.append({"name": name, "group": group, "description": line, **counts, "source": scene.source})
    return Outcome({"status": "ok", "scenes": rows}, _listed(rows, options.sources))


OTHER = ("Others", "")


def counts_of(structure: model.Structure) -> dict[str, int]:
    """Number of members of each kind that a structure was given; a string with mass is one."""
    return {
        "rods": len(structure.rods),
        "strings": len(structure.given.strings),
        "bodies": len(structure.bodies),
    }


def counts_text(counts: Mapping[str, Any]) -> str:
    """Text of these numbers, such as "1 rod, 3 strings"; without zeros."""
    nouns = (("rods", "rod"), ("strings", "string"), ("bodies", "body"))
    return ", ".join(f"{counts[many]} {one if counts[many] == 1 else many}" for many, one in nouns if counts[many])


def shipped() -> dict[str, dict[str, str]]:
    """Descriptions of the shipped scenes, by groups and names."""
    found: dict[str, dict[str, str]] = table_beside(__file__)["shipped"]
    return found


def _listed(rows: list[dict[str, Any]], sources: bool) -> str:
    """One line a scene, by groups."""
    width = max((len(row["name"]) for row in rows), default=0)
    sizes = {row["name"]: counts_text(row) for row in rows}
    size_width = max(map(len, sizes.values()), default=0)
    lines = []
    for group in [*shipped(), OTHER[0]]:
        members = {row["name"]: row for row in rows if row["group"] == group}
        order = [*shipped().get(group, {}), *members]
        lines += [f"{group}:"] if members else []
        for name in dict.fromkeys(name for name in order if name in members):
            row = members[name]
            lines.append(f"  {name:<{width}}  {sizes[name]:<{size_width}}  {row['description']}")
            lines += [f"  {'':<{width}}  from {row['source']}"] if sources else []
    return "\n".join(lines)


def describe(scene: model.Scene) -> dict[str, Any]:
    """Describe a scene's parts and needs; it is valid because it could be loaded."""
    from tensegrity_mj.engines.mujoco.needs import requirements

    structure = scene.structure
    needs = requirements(scene).to_dict()
    return {
        "status": "ok",
        "valid": True,
        **plain_values(scene, "name", "source", "duration"),
        **plain_values(structure, "nodes", "fixed_nodes"),
        "rods": [
            plain_values(rod, "name", "nodes", "mass", "group")
            | ({} if rod.stiffness is None else plain_values(rod, "stiffness", "damping"))
            | {"length": float(length), "support": support_text(rod), "sigma": rod.support.sigma}
            | ({"carried": float(carried)} if carried else {})
            for rod, length, carried in zip(structure.rods, structure.rod_lengths, structure.rod_lumps[0], strict=True)
        ],
        "strings": [
            plain_values(string, "name", "nodes", "stiffness", "damping", "group")
            | {"rest_length": float(rest_length)}
            | ({} if string.is_linear else plain_values(string, "curve", "yields", "tension"))
            | ({} if string.string_law is None else plain_values(string, "string_law"))
            for string, rest_length in zip(structure.strings, structure.rest_lengths, strict=True)
        ],
        "ropes": [
            plain_values(rope.string, "name", "nodes", "stiffness", "damping", "mass")
            | {"rest_length": sum(part.rest_length or 0.0 for part in rope.parts), "segments": len(rope.points)}
            | {"strings": [part.name for part in rope.parts]}
            for rope in structure.ropes
        ],
        "point_masses": {point.node: point.mass for point in structure.point_masses},
        "bodies": [plain_values(body, "name", "nodes", "mass", "held") for body in structure.bodies],
        "constraints": [plain_values(one, "name", "nodes", "direction") for one in structure.constraints],
        "degrees_of_freedom": needs["degrees_of_freedom"],
        "mujoco_velocities": needs["velocities"],
        "needs": {key: value for key, value in needs.items() if key not in ("scene", "degrees_of_freedom")},
        **statics(scene),
        "gravity": scene.gravity,
        "contact": None if scene.contact is None else vars(scene.contact),
        "motions": {motion.support: motion_text(motion) for motion in scene.motions},
        "resistance": resistance_text(scene) or None,
        "water": water_text(scene) or None,
        "water_segments": None if scene.water is None else scene.water_segments.report(),
        "left_out": DRY_BODIES.find(scene) or None,
        "loads": "a function" if callable(scene.loads) else len(scene.loads),
        "target": None if scene.target is None else {"waypoints": len(scene.target.times), "times": scene.target.times},
        "control": None if scene.control is None else {"law": scene.control.law, **scene.control.options},
    }


def statics(scene: model.Scene) -> dict[str, Any]:
    """Self-stress and redundant rods at the start; where no law moves it, whether its strings hold it there.

    A structure that nothing holds against gravity falls freely, or floats in the scene's water. Whether its strings can
    be prestressed is found without its weight there, which pulls nothing as it falls, and without the water's forces.
    """
    import numpy as np

    from tensegrity_mj.errors import InfeasibleError
    from tensegrity_mj.linearization.linearizing import ElementStates
    from tensegrity_mj.model.elements.resistance import resisting_forces
    from tensegrity_mj.model.elements.water import water_forces
    from tensegrity_mj.statics.equilibrium import balance, unheld_gravity
    from tensegrity_mj.statics.model import StaticModel
    from tensegrity_mj.statics.self_stress import prestress, self_stress

    scene = ElementStates(scene).scene  # elements act as they do at the states of the start
    structure, nodes = scene.structure, scene.nodes0
    still = np.zeros_like(nodes)
    stress, twice = self_stress(structure, nodes), scene.redundancy
    found: dict[str, Any] = {
        "self_stress_modes": len(stress.modes),
        "rigid_motions": stress.rigid_motions,
        "mechanisms": stress.mechanisms,
        "undetermined_forces": twice.undetermined,
        "singular": twice.singular,
    }
    if scene.control is not None:
        return found
    loose = unheld_gravity(scene)
    falls, floats = bool(np.any(loose)) and scene.water is None, bool(np.any(loose)) and scene.water is not None
    gravity = np.array(scene.gravity) - loose
    seen = scene.with_(gravity=tuple(gravity.tolist())) if falls else scene
    there = balance(StaticModel.of(seen))
    found |= {
        "falls_freely": falls,
        "floats_freely": floats,
        "unbalanced_force": there.unbalanced,
        "unbalanced": there.describe(),
        "in_equilibrium": there.is_equilibrium,
    }
    if not structure.strings:
        return found | {"can_be_prestressed": False, "why_not": "there are no strings"}
    loads = scene.nodal_forces(float(scene.start_time)) + resisting_forces(scene, nodes, still)
    if not floats:
        loads = loads + water_forces(scene, float(scene.start_time), nodes, still)[0]
    try:
        prestress(structure, nodes=nodes, gravity=gravity, loads=loads)
        found |= {"can_be_prestressed": True, "why_not": ""}
    except InfeasibleError as error:
        found |= {"can_be_prestressed": False, "why_not": str(error)}
    return found


def support_text(rod: model.Rod) -> str:
    rows = len(rod.support.directions)
    kind = {0: "free", 3: "pinned"}.get(rows, f"held in {rows} direction{'s' if rows > 1 else ''}")
    where = "" if rows == 0 else f" at σ = {rod.support.sigma:g}"
    return f"{kind}{where}" + ("" if rod.support.plane is None else ", planar")


def motion_text(motion: model.Motion) -> str:
    if motion.function is not None:
        return "a function of time"
    parts = [
        f"{math.hypot(*item.amplitude):g} m at {item.angular_frequency / (2 * math.pi):g} Hz"
        for item in motion.harmonics
    ]
    if motion.times:
        parts.append(f"data at {len(motion.times)} times, until {motion.times[-1]:g} s")
    return " and ".join(parts)


def resistance_text(scene: model.Scene) -> str:
    """Text of the resistance to motion; empty where there is none."""
    resistance = scene.resistance or model.Resistance()
    damped = sum(point.damping > 0 for point in scene.structure.point_masses)
    parts = [f"viscous, {resistance.viscous:g} N s/m²"] if resistance.viscous else []
    if (drag := resistance.drag) is not None:
        tangential = f" and {drag.tangential:g} along rods" if drag.tangential else ""
        parts.append(f"drag, C = {drag.normal:g} across{tangential}, {drag.density:g} kg/m³")
    if (bending := resistance.bending) is not None:
        joints = "joints of two rods" if bending.pairs is None else f"{len(bending.pairs)} joints"
        parts.append(f"bending of {joints}, {bending.stiffness:g} N m and {bending.damping:g} N m s")
    if damped:
        parts.append(f"damping of {damped} point mass{'es' * (damped > 1)}")
    wind = [f"wind {resistance.wind} m/s"] if any(resistance.wind) else []
    return "; ".join(parts + wind)


def water_text(scene: model.Scene) -> str:
    """Water, waves and current, in words; nothing without water."""
    water = scene.water
    if water is None:
        return ""
    segments = scene.water_segments
    parts = [f"{water.density:g} kg/m³, " + ("deep" if water.depth is None else f"{water.depth:g} m deep")]
    for wave in water.waves:
        size = f"{wave.wavelength:g} m long" if wave.wavelength is not None else f"{wave.angular_frequency:g} rad/s"
        parts.append(f"waves of {2 * wave.amplitude:g} m, {size}, towards {math.degrees(wave.direction):.4g}°")
    if (sea := water.sea) is not None:
        size = f"{sea.spectrum.value} sea of H_s = {sea.significant_height:g} m and T_p = {sea.peak_period:g} s"
        which = f"{sea.components} components, seed {sea.seed}"
        parts.append(f"{size}, {which}, towards {math.degrees(sea.direction):.4g}°")
    if any(water.current):
        parts.append(f"current {water.current} m/s")
    loads = [f"drag {water.drag:g} across"]
    if water.tangential_drag:
        loads[0] += f" and {water.tangential_drag:g} along {' and '.join(f'{kind}s' for kind in segments.kinds)}"
    if water.string_diameter is not None:
        loads.append(f"strings {water.string_diameter:g} m thick")
    if "rod" in segments.kinds:
        loads.append(f"C_a = {water.added_mass:g}, C_M = {water.inertia_coefficient:g}")
    parts.append(", ".join([*loads, segments.text()]))
    return "; ".join([*parts, *segments.warnings])


def _needs(needs: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows about the size of MuJoCo's model."""
    if needs["positions"] is None:
        return [("engine for it", needs["engine"])]
    joints = ", ".join(f"{count} {kind}" for kind, count in needs["joints"].items() if count)
    pairs, touching = needs["contact_pairs"], ""
    if pairs:
        touching = f", {pairs} pair{'s' * (pairs > 1)} may touch ({needs['rows_per_contact']} rows a contact)"
    members = ", ".join(f"{needs[what]} {what}" for what in ("tendons", "actuators", "sensors", "equalities"))
    return [
        ("engine for its size", needs["engine"]),
        ("MuJoCo's model", f"nq = {needs['positions']}, nv = {needs['velocities']}; joints: {joints}; {members}"),
        ("constraint rows", f"{needs['constraint_rows']} at the start{touching}"),
        ("flags", ", ".join(needs["flags"])),
        *[("" if row else "more than the least", reason) for row, reason in enumerate(needs["reasons"])],
    ]


def _balance(data: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows about the balance of forces where the scene starts."""
    fluids = ", wind and water included" if data["water"] or "wind" in (data["resistance"] or "") else ""
    rows = []
    if data["falls_freely"]:
        rows = [("falls freely", "nothing holds it against gravity; the next two lines ignore gravity and contact")]
    if data["floats_freely"]:
        rows = [("floats freely", "nothing but water holds it; the line of prestress ignores weight and water")]
    return [
        *rows,
        ("unbalanced force", f"{data['unbalanced']}; at the scene's start{fluids}"),
        ("prestress", "possible with every string in tension" if data["can_be_prestressed"] else data["why_not"]),
    ]


def _text(data: dict[str, Any]) -> str:
    from tensegrity_mj.statics.listing import counted

    control, contact, spun = data["control"], data["contact"], data["mujoco_velocities"]
    fixed = f", fixed: {', '.join(data['fixed_nodes'])}" if data["fixed_nodes"] else ""
    spins = ", where free rods also spin" if data["rods"] else ""
    turning = f" ({spun} in MuJoCo{spins})" if spun and spun != data["degrees_of_freedom"] else ""
    parts = {name for rope in data["ropes"] for name in rope["strings"]}
    whole = [*data["ropes"], *(string for string in data["strings"] if string["name"] not in parts)]
    head = [
        ("scene", data["name"]),
        ("source", data["source"] or "-"),
        ("nodes", f"{len(data['nodes'])}{fixed}"),
        ("rods", str(len(data["rods"]))),
        ("strings", str(len(whole))),
        *([("bodies", str(len(data["bodies"])))] if data["bodies"] else []),
        *([("constraints", ", ".join(one["name"] for one in held))] if (held := data["constraints"]) else []),
        ("degrees of freedom", f"{data['degrees_of_freedom']}{turning}"),
        (
            "statics",
            f"at its start {counted(data['self_stress_modes'], 'state')} of self-stress of the strings, "
            f"{counted(data['mechanisms'], 'mechanism')}, {counted(data['rigid_motions'], 'rigid motion')}",
        ),
        *([("forces not unique", ", ".join(data["undetermined_forces"]))] if data["undetermined_forces"] else []),
        *([("singular start", ", ".join(data["singular"]))] if data["singular"] else []),
        *(_balance(data) if control is None else []),
        *_needs(data["needs"]),
        ("gravity", "none" if not any(data["gravity"]) else f"{data['gravity']} m/s²"),
        ("control", "none" if control is None else ", ".join(f"{key} = {value}" for key, value in control.items())),
        ("contact", "none" if contact is None else ", ".join(f"{key} = {value}" for key, value in contact.items())),
        *[("motion", f"{name}: {text}") for name, text in data["motions"].items()],
        ("resistance", data["resistance"] or "none"),
        *([("water", data["water"])] if data["water"] else []),
        *([("left out", data["left_out"])] if data["left_out"] else []),
        ("duration", number(data["duration"], "s")),
    ]
    rods = [
        f"  {rod['name']}: {' - '.join(rod['nodes'])}, {rod['mass']:g} kg, {rod['length']:.6g} m, {rod['support']}"
        + (f", carries {rod['carried']:g} kg" if "carried" in rod else "")
        + (f", k = {rod['stiffness']:g} N/m, c = {rod['damping']:g} N s/m" if "stiffness" in rod else "")
        for rod in data["rods"]
    ]
    strings = [
        f"  {s['name']}: {' - '.join(s['nodes'])}, "
        + (f"k = {s['stiffness']:g} N/m, " if s["stiffness"] else f"constant {s['tension']:g} N, ")
        + f"c = {s['damping']:g} N s/m"
        + (f", L0 = {s['rest_length']:.6g} m" if s["stiffness"] else "")
        + (f", a curve of {len(s['curve'])} points" + ", yields" * s["yields"] if s.get("curve") else "")
        + (f", {s['string_law']}" if "string_law" in s else "")
        + (f", {s['mass']:g} kg in {s['segments']} segments" if "mass" in s else "")
        for s in whole
    ]
    bodies = [
        f"  {body['name']}: {' - '.join(body['nodes'])}, {body['mass']:g} kg, {'held' if body['held'] else 'free'}"
        for body in data["bodies"]
    ]
    members = {"rods:": rods, "strings:": strings, "bodies:": bodies}
    return "\n".join([table(head), *(line for title, rows in members.items() if rows for line in (title, *rows))])

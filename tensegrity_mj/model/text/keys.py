"""The keys of every table of the format. docs/format.md describes them."""

from __future__ import annotations

from tensegrity_mj.model.members import LIMITS

FORMAT = 1

# What a file may have at most, so that each is read in seconds, whoever wrote it: its size, a structure of about 25,000
# rods and three times as many strings; the parts of a dotted key, and how deep values stand in each other, where the
# format needs 5.
MOST_BYTES = 10_000_000
MOST_DEPTH = 16
MOST_POSITIONS = (
    1_000_000  # of nodes in all waypoints or shapes of a target: a table that names no node has all of them
)

FILE_KEYS = ("format", "name", "source", "structure", "scene")
STRUCTURE_KEYS = ("name", "string_law", "fixed_nodes", "nodes", "rods", "strings", "point_masses")
ROD_KEYS = ("name", "nodes", "mass", "radius", "support", "section")
STRING_KEYS = ("name", "nodes", "stiffness", "damping", "rest_length", "tension", "force_density", *LIMITS, "strength")
POINT_MASS_KEYS = ("node", "mass", "plane")
SUPPORT_KEYS = {
    "free": ("kind", "sigma", "plane"),
    "pinned": ("kind", "sigma", "plane"),
    "constrained": ("kind", "sigma", "plane", "D", "values"),
}
SECTION_KEYS = ("area", "second_moment", "elasticity_modulus", "yield_stress")
TUBE_KEYS = ("outer_radius", "wall", "elasticity_modulus", "yield_stress")
SCENE_KEYS = (
    "gravity",
    "duration",
    "loads",
    "breaks",
    "motions",
    "contact",
    "resistance",
    "water",
    "initial_nodes",
    "initial_velocities",
    "target",
    "control",
)
CONTACT_KEYS = ("floor", "normal", "rods", "friction", "stiffness", "damping", "impedance")
RESISTANCE_KEYS = ("viscous", "bending", "drag", "wind")
BENDING_KEYS = ("stiffness", "damping", "pairs")
DRAG_KEYS = ("normal", "tangential", "density", "diameter")
WATER_KEYS = (
    "density",
    "depth",
    "waves",
    "current",
    "drag",
    "tangential_drag",
    "added_mass",
    "inertia",
    "segments",
    "weights",
    "diameter",
    "above",
    "viscosity",
)
WAVE_KEYS = ("amplitude", "wavelength", "angular_frequency", "direction", "phase")
BREAK_KEYS = ("string", "time")
LOAD_KEYS = ("node", "force", "angular_frequency", "phase")
MOTION_DATA = ("times", "displacements", "velocities", "accelerations")
MOTION_KEYS = ("support", "harmonics", *MOTION_DATA)
HARMONIC_KEYS = ("amplitude", "angular_frequency", "phase")
TARGET_KEYS = ("nodes", "waypoints", "times", "values", "rates", "accelerations", "shapes")
CURVE_KEYS = TARGET_KEYS[2:]
SHAPE_KEYS = ("parameter", "nodes")
WAYPOINT_KEYS = ("time", "nodes")
CONTROL_KEYS = ("law", "options")

"""The keys of the tables of the format that are not those of a value class. docs/format.md describes them all."""

from __future__ import annotations

FORMAT = 1

# Limits of a file, so that any file is read in seconds: its size, enough for a structure of about 25,000 rods and three
# times as many strings; the parts of a dotted key, and the depth of nested values, of which the format needs 5.
MOST_BYTES = 10_000_000
MOST_DEPTH = 16
MOST_POSITIONS = (
    1_000_000  # of nodes in all waypoints or shapes of a target: a table that names no node has all of them
)

FILE_KEYS = ("format", "name", "source", "structure", "scene")
# `defaults` and `groups` are written out in the members when a file is read (`reading`).
MEMBER_KEYS = ("rods", "strings", "point_masses", "constraints", "bodies")
STRUCTURE_KEYS = ("name", "string_law", "fixed_nodes", "nodes", *MEMBER_KEYS, "defaults", "groups")
SUPPORT_KEYS = {
    "free": ("kind", "sigma", "plane"),
    "pinned": ("kind", "sigma", "plane"),
    "constrained": ("kind", "sigma", "plane", "D", "values"),
}
TUBE_KEYS = ("outer_radius", "wall", "elasticity_modulus", "yield_stress")
# In the order in which they are written: those of a line each, and those with a section of their own.
SCENE_LINES: tuple[str, ...] = ("gravity", "duration", "start_time", "rope_start", "loads", "breaks", "motions")
SCENE_LINES += ("contact", "resistance", "elements")
SCENE_SECTIONS = ("water", "initial_nodes", "initial_velocities", "target", "control")
# Keys that are written as nodes and motions, which they stand for.
SCENE_KEYS = (*SCENE_LINES, *SCENE_SECTIONS, "whole", "ground")
GROUND_KEYS = ("file", "baseline", "scale")
TARGET_KEYS = ("nodes", "waypoints", "times", "values", "rates", "accelerations", "shapes")
CURVE_KEYS = TARGET_KEYS[2:]
SHAPE_KEYS = ("parameter", "nodes")
WAYPOINT_KEYS = ("time", "nodes")

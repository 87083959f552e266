"""The table of a plant: what compiled code reads of it, by names."""

from __future__ import annotations

from tensegrity_mj.dynamics.native.law import Report
from tensegrity_mj.dynamics.native.views import changing_view, fields_of

REPORT_SIZE = len(Report)
WATCHED_SIZE, RESOLUTION_SIZE = 6, 22  # numbers a string of what `watch` counts, a node of what `resolution` adds up
NO_LAW, CONTINUOUS, HOLD_FORCE_DENSITY, HOLD_REST_LENGTH = range(4)  # modes

PLANT = fields_of(
    rod_count="size",
    row_width="size",  # of what `write_row` writes
    nodes=("f8", "node_count", 3),
    velocities=("f8", "node_count", 3),
    forces=("f8", "node_count", 3),
    # Strings.
    segments=("i8", "segment_count", 2),  # their nodes, string by string
    ranges=("i8", "string_count", 2),  # of each string's segments
    segment_lengths=("f8", "segment_count"),
    stiffness=("f8", "string_count"),
    compliance=("f8", "string_count"),  # 1/k
    damping=("f8", "string_count"),
    damped="size",  # whether any string has a damper
    clipped=("i8", "string_count"),  # whether a string never pushes
    # Tension curves, `curves`: whether any string has more than its stiffness; pieces of all, string by string.
    curved="size",
    pieces=("f8", "piece_count", 4),
    piece_ranges=("i8", "string_count", 2),
    # Strings that yield: whether any does, and whether a state that a run has come to is next; their permanent
    # stretches; stretch and rate at the last such state, and when that was; the largest stretch, and what it has lost.
    yielding="size",
    arrived="state",
    yields=("i8", "string_count"),
    permanent=("f8", "string_count"),
    last_stretch=("f8", "string_count", 4),
    yielded_at="real",
    lengths=("f8", "string_count"),
    rates=("f8", "string_count"),
    rest=("f8", "string_count"),
    tensions=("f8", "string_count"),
    elastic=("f8", "string_count"),  # part of the tensions
    breaking="state",  # how many strings are still to break, when each does, and whether it has
    break_times=("f8", "string_count"),
    broken=("i8", "string_count"),
    # The law, and what holds its commands.
    mode="size",
    law="size",
    law_context="size",
    returns_lengths="size",
    passive="size",  # where the law has no solution, the last admissible rest lengths are held
    suspended="state",  # so they are, in the continuous mode
    command=("f8", "string_count"),
    report=("f8", REPORT_SIZE),
    holds_force_density="state",
    held=("f8", "string_count"),
    memory=("f8", "string_count"),  # the last admissible rest lengths
    limited="size",
    max_force_density=("f8", "string_count"),
    min_rest_length=("f8", "string_count"),
    winch_reach=("f8", "string_count"),
    winch=("f8", 3),  # work of the jumps so far, energy at the start, energy set free by strings that break or yield
    sampled_lengths=("f8", "string_count"),
    # Elements (`elements`), and moved supports: their `PackedMotions`, and d, ḋ, d̈ of each.
    status="state",  # not 0 where one of them failed
    element_count="size",
    elements="state",  # addresses of their records, and of a `Motion`: lent ones of a copy
    seen="state",
    added=("f8", "wet_rods", 4),  # α of the rods: of all, or of none
    held_mass=("f8", "node_count", 3),  # forces of added mass, and of constraints in MuJoCo, as last found
    # At a stage the elements' states, and their rates there; for an engine that steps by itself, those of the whole
    # steps so far, and the sum of the stages' rates.
    element_states=("f8", 4, "element_state_count"),
    motions="size",
    moved=("f8", "motion_count", 3, 3),
    # Counters.
    watched=("f8", "string_count", WATCHED_SIZE),
    resolution=("f8", "node_count", RESOLUTION_SIZE),
    resolution_kind="state",
)
PlantView = changing_view("Plant", PLANT)

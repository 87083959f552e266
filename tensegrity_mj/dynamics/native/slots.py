"""The numbered places of a plant's table, which compiled code reads."""

from __future__ import annotations

from tensegrity_mj.dynamics.native.law import Report

# Slots of the table: sizes, flags, and addresses of the arrays named after them.
NODE_COUNT, STRING_COUNT, STRING_NODES, STIFFNESS, DAMPING, CLIPPED, DAMPED = range(7)


MODE, RETURNS_LENGTHS, PASSIVE, LAW, LAW_CONTEXT, HOLDS_FORCE_DENSITY, STATUS = range(7, 14)


HELD, MEMORY, COMMAND, REPORT = range(14, 18)


ELEMENT_COUNT, ELEMENTS, SEEN, ADDED = range(18, 22)  # records of `ELEMENT`, a `Motion`, α of the rods or 0


REST, LENGTH, RATE, TENSION, ELASTIC, FORCES, NODES, VELOCITIES = range(22, 30)


WINCH, SAMPLED_LENGTH = 30, 31


SUSPENDED = 32  # in the continuous mode: the law has no solution, the last admissible rest lengths are held


LIMITED, MAX_FORCE_DENSITY, MIN_REST_LENGTH, WINCH_REACH = range(33, 37)


BREAKING, BREAK_TIMES, BROKEN = range(37, 40)  # how many strings are still to break, when each does, whether it has


COMPLIANCE = 40  # 1/k


MOTION_COUNT, MOTIONS, MOVED = 41, 42, 43  # moved supports, their `PackedMotions`, and d, ḋ, d̈ of each (m, 3, 3)


ROD_TOTAL, HELD_MASS = 44, 45  # how many rods there are; forces of the added mass as last found (N, 3)


# How many numbers the elements' states have, and (4, S): at a stage, their rates there; for an engine that steps by
# itself, those of the whole steps so far, and the sum of the stages' rates.
ELEMENT_STATE_COUNT, ELEMENT_STATES = 49, 50


ENGINE_SLOTS = 51  # an engine's own slots start here


TABLE_SIZE = 112


REPORT_SIZE = len(Report)


NO_LAW, CONTINUOUS, HOLD_FORCE_DENSITY, HOLD_REST_LENGTH = range(4)

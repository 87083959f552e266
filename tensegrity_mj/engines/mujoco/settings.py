"""MuJoCo's integrators."""

from __future__ import annotations

import enum

from tensegrity_mj.vibration.stepping import Scheme


class Integrator(enum.Enum):
    """MuJoCo's integrators."""

    EULER = "euler"  # semi-implicit, order 1
    IMPLICITFAST = "implicitfast"  # implicit in velocity, symmetric part only, order 1
    IMPLICIT = "implicit"  # implicit in velocity, order 1
    RK4 = "rk4"  # classical Runge-Kutta, order 4
    DISCRETE = "discrete"  # implicit in position and velocity, order 1: for stability, not for accuracy


SCHEMES = {
    Integrator.EULER: Scheme.SEMI_IMPLICIT,
    Integrator.IMPLICITFAST: Scheme.VELOCITY_IMPLICIT,
    Integrator.IMPLICIT: Scheme.VELOCITY_IMPLICIT,
    Integrator.RK4: Scheme.RUNGE_KUTTA,
    Integrator.DISCRETE: Scheme.LINEARLY_IMPLICIT,
}

WORDS = {Integrator.EULER: "Euler", Integrator.RK4: "RK4"}  # MuJoCo's own; those of the others are their values

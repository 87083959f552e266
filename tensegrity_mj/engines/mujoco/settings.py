"""MuJoCo's integrators."""

from __future__ import annotations

import enum


class Integrator(enum.Enum):
    """MuJoCo's integrators."""

    EULER = "euler"  # semi-implicit, order 1
    IMPLICITFAST = "implicitfast"  # implicit in velocity, symmetric part only, order 1
    IMPLICIT = "implicit"  # implicit in velocity, order 1
    RK4 = "rk4"  # classical Runge-Kutta, order 4
    DISCRETE = "discrete"  # implicit in position and velocity, order 1: for stability, not for accuracy


_WORDS = {
    Integrator.EULER: "Euler",
    Integrator.IMPLICITFAST: "implicitfast",
    Integrator.IMPLICIT: "implicit",
    Integrator.RK4: "RK4",
    Integrator.DISCRETE: "discrete",
}

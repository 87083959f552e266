"""Methods of integration of the DAE and the ODE."""

from __future__ import annotations

import enum


class Method(enum.Enum):
    """Integration methods of the equations."""

    DOP853 = "dop853"  # explicit Runge-Kutta of order 8(5,3), error-controlled, compiled
    RADAU = "radau"  # SciPy's implicit Radau IIA of order 5, error-controlled, for stiff strings
    RK4 = "rk4"  # classical, fixed step, compiled

"""Steps that a contact allows: the largest stable one, and the largest that resolves a landing.

At rest at the depth r a single contact (see `contact`) carries what pushes it down with a⁰ = -d k r / (1 - d), and a
small motion about that depth obeys ẍ + D ẋ + K x = 0 with

    D = d b = damping d / d₁,      K = stiffness / d₁² (d² + 2 d d' r + d² d' r / (1 - d)),      d' = ∂d/∂r

Friction that sticks is a damper of at most damping / d₁. MuJoCo's one-stage integrators take both explicitly: they are
stable while h² K / 4 + h D / 2 <= 1, Runge-Kutta while |R(h s)| <= 1 for both roots of s² + D s + K = 0. How deep a
contact will be is not known before a run; the limit is the smallest over all depths. Nothing diverges beyond it: what
should rest chatters.

A landing is a kink. What it costs is a matter of h times the contact's own rate, far below that limit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tensegrity_mj.basics.arrays import Array, bisect
from tensegrity_mj.model.elements.contact import Contact, impedance
from tensegrity_mj.vibration.integrators import REACH, polynomial
from tensegrity_mj.vibration.stepping import Scheme

DEPTHS = 400  # that are checked, up to the width of the impedance; deeper it is constant
# Steps that resolve a landing, times the contact's rate. Measured on the fall of prism_drop over 1 s, of 0.3 m: RK4 at
# 0.1 errs by 0.15 % of the height, at 0.2 by 1.9 %; the first-order integrators at 0.0125 by 0.2 % (discrete), 1.1 %
# (Euler) and 9.6 % (the implicit ones, which brake the fall itself), and by a part that is proportional to h.
RESOLVED_RUNGE_KUTTA, RESOLVED_FIRST_ORDER = 0.1, 0.01
SLACK = 1 + 1e-9  # of steps that are just at a bound


def small_motion(contact: Contact, depth: Array) -> tuple[Array, Array]:
    """K [1/s²] and D [1/s] of a contact that rests at depths r >= 0 [m]."""
    d, slope = impedance(contact, depth)
    stiffness, damping, (_, d1, *_) = contact.spring
    K = stiffness / d1**2 * (d**2 + slope * depth * (2 * d + d**2 / (1 - d)))
    return K, damping / d1 * d


def contact_limit(contact: Contact, scheme: Scheme, depth: float | None = None) -> float:
    """The largest stable step [s] of a contact that rests at a depth [m], or at the worst of all depths."""
    _, damping, (_, d1, width, *_) = contact.spring
    depths = np.linspace(0.0, width, DEPTHS + 1) if depth is None else np.array([depth])
    K, D = small_motion(contact, depths)
    if contact.friction > 0:
        K, D = np.append(K, 0.0), np.append(D, damping / d1)
    if scheme is not Scheme.RUNGE_KUTTA:
        over = D + np.sqrt(D**2 + 4 * K)
        return float(4 / over.max()) if over.max() > 0 else math.inf
    steps = [_runge_kutta_step(root) for root in _roots(K, D) if root != 0]
    return min(steps, default=math.inf)


def contact_rate(contact: Contact) -> float:
    """|s| [1/s] of the faster root of s² + damping s + stiffness = 0: 1 / (2.5 ms) by default."""
    return float(np.abs(_roots(*np.array([contact.spring[:2]]).T)).max())


def resolving_step(contact: Contact, scheme: Scheme) -> float:
    """The largest step [s] that resolves a landing to a percent or so of the fall."""
    share = RESOLVED_RUNGE_KUTTA if scheme is Scheme.RUNGE_KUTTA else RESOLVED_FIRST_ORDER
    return share / contact_rate(contact)


def check_contact(contact: Contact, scheme: Scheme, step: float) -> tuple[dict[str, float | bool], str]:
    """Check a step [s] before a run: return a report, and the text of a warning or ""."""
    limit, resolving = contact_limit(contact, scheme), resolving_step(contact, scheme)
    report: dict[str, float | bool] = {
        "limit": limit,
        "exceeded": step > limit * SLACK,
        "resolving_step": resolving,
        "resolved": step <= resolving * SLACK,
    }
    remedy = "accuracy=..., which chooses the step"
    if scheme is not Scheme.RUNGE_KUTTA:
        remedy = f"Integrator.RK4 below {resolving_step(contact, Scheme.RUNGE_KUTTA):.3g} s, or {remedy}"
    if report["exceeded"]:
        text = (
            f"the step of {step:g} s is beyond the largest stable one of the scene's contact, {limit:.3g} s: what "
            f"should rest may chatter; use a step below {min(limit, resolving):.3g} s, or {remedy}"
        )
        return report, text
    if not report["resolved"]:
        order = "" if scheme is Scheme.RUNGE_KUTTA else ", of the first order,"
        text = (
            f"the step of {step:g} s is stable and too coarse for the scene's contact: this integrator{order} resolves "
            f"a landing with steps below {resolving:.3g} s; use such a step, or {remedy}"
        )
        return report, text
    return report, ""


def _roots(K: Array, D: Array) -> NDArray[np.complex128]:
    """Both roots of s² + D s + K = 0."""
    spread = np.sqrt((D**2 - 4 * K).astype(complex))
    faster = -0.5 * (D + spread)
    safe = np.where(faster == 0, 1.0, faster)
    return np.concatenate([faster, np.where(faster == 0, 0.0, K / safe)])


def _runge_kutta_step(root: complex) -> float:
    """The largest h with |R(h s)| <= 1, Re s <= 0."""
    return bisect(lambda h: abs(polynomial(h * root)) <= 1 + 1e-9, 0.0, REACH / abs(root))[0]

"""The law of a single contact as docs/contact.md has it, apart from MuJoCo."""

from __future__ import annotations

from tensegrity_mj.model.elements.contact import Contact


def impedance(contact: Contact, depth: float) -> float:
    """d(r) as docs/contact.md has it."""
    d0, d1, width, middle, power = contact.spring.impedance
    x = min(depth / width, 1.0)
    s = middle * (x / middle) ** power if x <= middle else 1.0 - (1.0 - middle) * ((1.0 - x) / (1.0 - middle)) ** power
    return d0 + s * (d1 - d0)


def acceleration(contact: Contact, gap: float, rate: float, free: float) -> float:
    """The contact's own acceleration where the surfaces are `gap` apart; `free` is that without the contact."""
    if gap >= 0:
        return free
    d, d1 = impedance(contact, -gap), contact.spring.impedance[1]
    spring = -contact.spring.damping / d1 * rate - contact.stiffness * d / d1**2 * gap
    return max(free, (1 - d) * free + d * spring)

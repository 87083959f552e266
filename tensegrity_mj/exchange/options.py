"""Options for a file of another program: units, and values that the file does not give."""

from __future__ import annotations

from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import not_negative, positive
from tensegrity_mj.errors import OptionError


@value("import options", OptionError)
class ImportOptions:
    """Values for what a file does not say; None for none, and a file that needs one is refused.

    Attributes:
        unit: length of one unit of a file of NTRT [m]; None for a decimetre, which its own programs count in.
        stiffness, damping: of each string without its own [N/m], [N s/m].
        rod_mass, rod_radius: of each rod without its own [kg], [m].
        node_mass: of each node without a rod that is not fixed [kg].
    """

    unit: float | None = field(positive("m"), default=None, none="None")
    stiffness: float | None = field(positive("N/m"), default=None, none="None")
    damping: float | None = field(not_negative("N s/m"), default=None, none="None")
    rod_mass: float | None = field(positive("kg"), default=None, none="None")
    rod_radius: float | None = field(positive("m"), default=None, none="None")
    node_mass: float | None = field(positive("kg"), default=None, none="None")

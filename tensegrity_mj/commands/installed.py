"""Commands of other distributions, by entry points:

    [project.entry-points."tensegrity_mj.commands"]
    audit = "evidence.commands.audit"

Each names a module as those of this package are, with its TOML file next to it.
"""

from __future__ import annotations

import functools
from types import ModuleType

from tensegrity_mj.commands.common import warn
from tensegrity_mj.errors import printable_message

EVIDENCE = ("reproduce", "audit")  # commands of tensegrity-mj-evidence, a distribution next to this package
MISSING = "comes with tensegrity-mj-evidence: in a checkout, install it with python -m pip install --editable evidence"


@functools.cache
def installed() -> dict[str, dict[str, ModuleType]]:
    """The commands by the names of their distributions; one that cannot be imported is left out with a warning."""
    from importlib.metadata import entry_points

    found: dict[str, dict[str, ModuleType]] = {}
    for point in sorted(entry_points(group="tensegrity_mj.commands")):
        home = point.dist.name if point.dist else "others"
        try:
            found.setdefault(home, {})[point.name] = point.load()
        except (ImportError, AttributeError) as error:
            why = printable_message(str(error))
            warn(f"command {point.name} of {home} cannot be loaded ({why}): install the version for this package")
    return {home: commands for home, commands in found.items() if commands}

"""Commands of other distributions, by entry points:

    [project.entry-points."tensegrity_mj.commands"]
    audit = "evidence.commands.audit"

Each names a module like those of this package, with its TOML file beside it.
"""

from __future__ import annotations

import functools
from types import ModuleType

from tensegrity_mj.commands.common import warn
from tensegrity_mj.errors import OptionError

EVIDENCE = ("reproduce", "audit")  # commands of tensegrity-mj-evidence, which stands beside this package
MISSING = "comes with tensegrity-mj-evidence: in a checkout, install it with python -m pip install --editable evidence"


@functools.cache
def commands_of_others() -> dict[str, dict[str, ModuleType]]:
    """Return commands by the names of their distributions; warn of those that cannot be imported."""
    from tensegrity_mj.basics.installed import installed, load

    found: dict[str, dict[str, ModuleType]] = {}
    for name, point in sorted(installed("commands").items()):
        try:
            found.setdefault(point.dist.name if point.dist else "others", {})[name] = load(point)
        except OptionError as error:
            warn(str(error))
    return {home: commands for home, commands in found.items() if commands}

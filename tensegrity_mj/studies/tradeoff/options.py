"""What a trade-off study is to cover, as one frozen object."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tensegrity_mj.basics.checks import positive, whole
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.engines.table import ENGINES
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Mode
from tensegrity_mj.studies.tradeoff.settings import BUDGET

PERIODS = (1e-2, 1e-3)  # s
REPEATS = 3


class Loop(enum.Enum):
    """With the law or without."""

    OPEN = "open"
    CLOSED = "closed"


@dataclass(frozen=True)
class TradeoffOptions:
    """What is swept.

    Attributes:
        loops: open, closed or both.
        engines: names of `engines.table.ENGINES`; all by default.
        actuations: of the closed loop.
        periods: between control samples [s], of the held actuations.
        families: words such as "RK4" or "DAE DOP853", of which a setting's family must contain one; none: all.
        steps: fixed steps [s] in place of the grid's.
        tolerances: rtol in place of the usual ones; atol is a hundredth of it.
        duration: of each run [s]; the scene's by default.
        repeats: how often each point is timed; those that take long are timed less often, once at least.
        budget: of a run's right-hand sides, weighed by strings; see `settings.most_evaluations`.
    """

    loops: Sequence[Loop] = tuple(Loop)
    engines: Sequence[str] = field(default_factory=lambda: tuple(ENGINES))
    actuations: Sequence[Mode] = tuple(Mode)
    periods: Sequence[float] = PERIODS
    families: Sequence[str] = ()
    steps: Sequence[float] | None = None
    tolerances: Sequence[float] | None = None
    duration: float | None = None
    repeats: int = REPEATS
    budget: float = BUDGET

    def __post_init__(self) -> None:
        for name, kind in (("loops", Loop), ("actuations", Mode)):
            given = tuple(dict.fromkeys(getattr(self, name)))
            if not given or not all(isinstance(one, kind) for one in given):
                allowed = ", ".join(f"{kind.__name__}.{one.name}" for one in kind)
                raise OptionError(f"tradeoff: {name} = {getattr(self, name)!r}; name at least one of {allowed}")
            object.__setattr__(self, name, tuple(one for one in kind if one in given))
        if not self.engines or not all(one in ENGINES for one in self.engines):
            raise OptionError(f"tradeoff: engines = {self.engines!r}; name at least one of {', '.join(ENGINES)}")
        object.__setattr__(self, "engines", tuple(one for one in ENGINES if one in self.engines))
        for name, unit in (("periods", "s"), ("steps", "s"), ("tolerances", "")):
            given = getattr(self, name)
            if given is not None:
                numbers = {positive(f"tradeoff: {name}", one, unit) for one in given}
                object.__setattr__(self, name, tuple(sorted(numbers, reverse=True)))
        if not self.periods and any(mode is not Mode.CONTINUOUS for mode in self.actuations):
            object.__setattr__(self, "actuations", (Mode.CONTINUOUS,))
        if any(not isinstance(word, str) or not word.strip() for word in self.families):
            raise OptionError(f"tradeoff: families = {self.families!r}; each must be a text such as 'RK4'")
        object.__setattr__(self, "families", tuple(self.families))
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("tradeoff: duration", self.duration, "s"))
        whole("tradeoff: repeats", self.repeats, 1)
        object.__setattr__(self, "budget", positive("tradeoff: budget", self.budget))

    def wants(self, family: str) -> bool:
        """Whether a family is swept."""
        words = family.casefold()
        return not self.families or any(word.casefold() in words for word in self.families)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return plain_values(
            self,
            *("loops", "engines", "actuations", "periods", "families", "steps", "tolerances", "duration", "repeats"),
            "budget",
        )

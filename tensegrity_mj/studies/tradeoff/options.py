"""What a trade-off study is to cover, as one frozen object."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from typing import Any

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.fields import field, item_of, refused, value
from tensegrity_mj.basics.jsontext import plain_values
from tensegrity_mj.basics.kinds import Kind
from tensegrity_mj.engines.table import ENGINES, installed
from tensegrity_mj.errors import OptionError
from tensegrity_mj.model.actuation import Mode

PERIODS = (1e-2, 1e-3)  # s
REPEATS = 3
BUDGET = 1e6  # of right-hand sides, each weighed as in `settings.weight`: seconds a run, for whatever structure


class Loop(enum.Enum):
    """With the law or without."""

    OPEN = "open"
    CLOSED = "closed"


def _some(known: Iterable[Any], one: Kind) -> Kind:
    """One at least of what is known at the time, in its order."""

    def plain(value: Any) -> tuple[Any, ...]:
        given = kinds.tuple_of(one.plain, value)
        if not given or not all(item in known for item in given):
            raise kinds.Wrong(f" = {value!r}; name at least one of {', '.join(map(str, known))}")
        return tuple(item for item in known if item in given)

    return Kind(plain)


def _falling(unit: str = "") -> Kind:
    """Numbers > 0, the largest first."""
    numbers = kinds.many(kinds.positive(unit), "numbers")
    return numbers._replace(plain=lambda value: tuple(sorted(set(numbers.plain(value)), reverse=True)))


@value("tradeoff", OptionError)
class TradeoffOptions:
    """What is swept.

    Attributes:
        loops: open, closed or both.
        engines: names of `engines.table.ENGINES`; all that come with the package by default.
        actuations: of the closed loop.
        periods: between control samples [s], of the held actuations.
        families: words such as "RK4" or "DAE DOP853", of which a setting's family must contain one; none: all.
        steps: fixed steps [s] in place of the grid's.
        tolerances: rtol in place of the usual ones; atol is a hundredth of it.
        duration: of each run [s]; the scene's by default.
        repeats: how often each point is timed; those that take long are timed less often, once at least.
        budget: of a run's right-hand sides, weighed by strings; see `settings.most_evaluations`.
    """

    loops: tuple[Loop, ...] = field(_some(Loop, kinds.choice(Loop)), default=tuple(Loop))
    engines: tuple[str, ...] = field(_some(ENGINES, kinds.text()), factory=installed)
    actuations: tuple[Mode, ...] = field(_some(Mode, kinds.choice(Mode)), default=tuple(Mode))
    periods: tuple[float, ...] = field(_falling("s"), default=PERIODS)
    families: tuple[str, ...] = field(kinds.many(kinds.printable_name("a text such as 'RK4'"), "texts"), default=())
    steps: tuple[float, ...] | None = field(_falling("s"), default=None, none="None for the grid's")
    tolerances: tuple[float, ...] | None = field(_falling(), default=None, none="None for the usual ones")
    duration: float | None = field(kinds.positive("s"), default=None, none="None for the scene's")
    repeats: int = field(kinds.whole(1), default=REPEATS)
    budget: float = field(kinds.positive(), default=BUDGET)

    def __attrs_post_init__(self) -> None:
        if not self.periods and any(mode is not Mode.CONTINUOUS for mode in self.actuations):
            object.__setattr__(self, "actuations", (Mode.CONTINUOUS,))
        if not all(word.strip() for word in self.families):
            raise refused(self, f"families = {self.families!r}; each must be a text such as 'RK4'")

    def wants(self, family: str) -> bool:
        """Whether a family is swept."""
        words = family.casefold()
        return not self.families or any(word.casefold() in words for word in self.families)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return plain_values(self, *item_of(type(self)).keys)

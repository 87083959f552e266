"""Changes of what a value holds of classes of others, by their kinds or places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from tensegrity_mj.basics import fields
from tensegrity_mj.basics.fields import field, value
from tensegrity_mj.basics.kinds import parts
from tensegrity_mj.errors import OptionError, SceneError
from tensegrity_mj.studies.parameter_values import Scaled, changed


class Effect:
    """What others give subclasses of."""


@value("spring", SceneError)
class Spring(Effect):
    stiffness: float = 1.0
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Magnet(Effect):
    moment: float = 2.0
    stiffness: float = 3.0


@value()
class World:
    effects: tuple[Any, ...] = field(parts(Effect), default=())


def test_members_by_their_kind_or_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "_KINDS", {"spring": Spring, "magnet": Magnet})
    world = World((Spring(), Magnet(), Spring(2.0)))

    def after(path: str, given: Any) -> Any:
        return changed(world, path.split("/"), path, "the world", given).effects

    assert after("effects[spring]/stiffness", 5) == (Spring(5.0), Magnet(), Spring(5.0))
    assert after("effects[2]/place/z", 5) == (Spring(), Magnet(), Spring(2.0, (0.0, 0.0, 5.0)))
    assert after("effects/stiffness", Scaled(2)) == (Spring(2.0), Magnet(stiffness=6.0), Spring(4.0))
    assert type(after("effects[magnet]/moment", 4)[1].moment) is float
    with pytest.raises(OptionError, match=r"no member of effects 'sprig' .did you mean 'spring'.*: spring, 0, magnet"):
        after("effects[sprig]/stiffness", 1)
    with pytest.raises(OptionError, match="no part of a member of effects 'moment'"):
        after("effects/moment", 1)
    with pytest.raises(OptionError, match="the world has no effects"):
        changed(World(), ["effects"], "effects", "the world", 1)
    strange = World((Effect(),))
    with pytest.raises(OptionError, match="is of class Effect, which has no fields that could be set"):
        changed(strange, ["effects", "moment"], "effects.moment", "the world", 1)

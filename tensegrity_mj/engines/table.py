"""The table of engines: the command line, sweeps, studies and pages have their names from it. It imports none of them.

A new engine is a folder of its own beside this file, and a row here.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from tensegrity_mj.basics.texts import unknown
from tensegrity_mj.errors import OptionError


@dataclass(frozen=True)
class Row:
    """An engine.

    Attributes:
        title: what texts and figures call it.
        place: its class, a frozen dataclass of options with `run(request)`, as "module:class".
        fixed_step: the options with which it takes steps of `timestep` by the classical Runge-Kutta method.
    """

    title: str
    place: str
    fixed_step: Mapping[str, Any] = field(default_factory=dict)


ENGINES = {
    "mujoco": Row("MuJoCo", "tensegrity_mj.engines.mujoco.engine:MuJoCo"),
    "dae": Row("DAE", "tensegrity_mj.engines.reference.dae:DAE", {"method": "rk4"}),
    "ode": Row("ODE", "tensegrity_mj.engines.reference.ode:ODE", {"method": "rk4"}),
}


def engine_class(name: str) -> Any:
    """The class of an engine's options.

    Raises:
        OptionError: for a name that is none.
    """
    if name not in ENGINES:
        raise OptionError(f"engine = {name!r}: {unknown(str(name), ENGINES, 'engine')}")
    module, _, attribute = ENGINES[name].place.partition(":")
    return getattr(import_module(module), attribute)


def option_names(name: str) -> list[str]:
    """The options of an engine."""
    return [item.name for item in dataclasses.fields(engine_class(name))]


def make_engine(name: str, options: Mapping[str, Any]) -> Any:
    """The engine with these options, plain values: of those that are enums, the words.

    Raises:
        OptionError: for an option that it has not, or a value that the option cannot have.
    """
    from tensegrity_mj.basics.checks import choice_from

    kind, known = engine_class(name), option_names(name)
    usual = kind()  # where an option's default depends on others, it still shows of what kind the option is
    chosen = {}
    for option, value in options.items():
        if option not in known:
            raise OptionError(f"engine.{option}: {unknown(option, known, f'option of engine {name}')}")
        default = getattr(usual, option)
        is_word = isinstance(default, enum.Enum)
        chosen[option] = choice_from(f"engine.{option}", type(default), value) if is_word else value
    return kind(**chosen)


def engine_settings(engine: Any) -> tuple[str, dict[str, Any]]:
    """The name of an engine and its options as plain values, those at their defaults left out.

    Raises:
        OptionError: if it is no engine of the table.
    """
    for name in ENGINES:
        if type(engine) is engine_class(name):
            items = {item.name: (getattr(engine, item.name), item.default) for item in dataclasses.fields(engine)}
            return name, {key: _word(value) for key, (value, default) in items.items() if value != default}
    allowed = ", ".join(row.place.partition(":")[2] for row in ENGINES.values())
    raise OptionError(f"engine = {engine!r}; use one of {allowed}, an object and not a class")


def _word(value: Any) -> Any:
    return value.value if isinstance(value, enum.Enum) else value

"""The parameters of a fit, by the paths of sweeps (`studies.parameters`), and the scene with other values of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tensegrity_mj.basics import kinds
from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.basics.checks import instance, sequence_of
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.errors import OptionError, TensegrityError
from tensegrity_mj.model.scene import Scene
from tensegrity_mj.studies.parameter_values import PATH, Noted, Scaled, once
from tensegrity_mj.studies.parameters import Draft
from tensegrity_mj.studies.scene_parameters import member_names

ROOTS = ("structure", "scene", "plant")
FORM = "write PATH, PATH=START, PATH=START:LOW:HIGH, with * before START for a factor and ~DEVIATION behind for a prior"


@value("Parameter {path}", OptionError)
class Parameter:
    """A number of a scene that measurements are to determine.

    Attributes:
        path: as in sweeps, under `structure`, `scene` or `plant`: structure.strings[s1].stiffness of one member,
            structure.strings[s1,s2].stiffness or structure.strings.stiffness of several that share one value, and
            structure.strings[*].stiffness of each by itself.
        start: where the fit begins; the scene's own value by default, of a factor 1.
        low, high: bounds; 0 is the lowest where the scene refuses a negative value.
        scaled: whether it is a factor on what each member has.
        prior: standard deviation about the start of what is known of it before; None where nothing is.
    """

    path: str = field(PATH)
    start: float | None = field(kinds.finite(), default=None, none="None for the scene's own")
    low: float | None = field(kinds.finite(), default=None, none="None for what the scene takes")
    high: float | None = field(kinds.finite(), default=None, none="None for no bound")
    scaled: bool = field(kinds.flag(), default=False)
    prior: float | None = field(kinds.positive(), default=None, none="None where nothing is known before")

    def __attrs_post_init__(self) -> None:
        if self.path.partition(".")[0] not in ROOTS:
            raise refused(self, f"what is identified is a part of {', '.join(ROOTS)}, as structure.strings.stiffness")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise refused(self, f"low = {self.low:g} is not below high = {self.high:g}")

    @classmethod
    def of(cls, text: str) -> Parameter:
        """Read a parameter from text: PATH, PATH=START or PATH=START:LOW:HIGH, with * and ~DEVIATION.

        Raises:
            OptionError: for a text that is none.
        """
        path, sign, rest = text.partition("=")
        numbers, _, prior = rest.strip().partition("~")
        parts = numbers.removeprefix("*").split(":") if sign else []
        try:
            start, low, high = [float(one) if one else None for one in (*parts, "", "", "")[:3]]
            if len(parts) not in (0, 1, 3):
                raise ValueError
            known = float(prior) if prior else None
        except ValueError:
            raise OptionError(f"parameter {text}: {FORM}") from None
        return cls(path.strip(), start, low, high, numbers.startswith("*"), known)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Parameters of a scene: names (P,), and start, low, high, size, prior (NaN for none), each (P,)."""

    scene: Scene
    paths: tuple[str, ...]
    scaled: tuple[bool, ...]
    start: Array
    low: Array
    high: Array
    prior: Array

    @classmethod
    def of(cls, scene: Scene, given: Iterable[Parameter | str]) -> Unknowns:
        """The unknowns of parameters, those with [*] as one for each member.

        Raises:
            OptionError: for a path that names nothing, one that is given twice, a start that is not within its bounds,
                or members of several values without a start.
        """
        each = [Parameter.of(one) if isinstance(one, str) else one for one in sequence_of("parameters", given)]
        for one in each:
            instance("parameters", one, Parameter, f"use a Parameter, or {FORM}")
        if not each:
            raise OptionError("parameters: give at least one, such as structure.strings[s1].stiffness")
        rows = [(path, one) for one in each for path in member_names(scene, one.path) or [one.path]]
        paths = tuple(path for path, _ in rows)
        once(paths)
        numbers = []
        for path, one in rows:
            start = _start(scene, path, one)
            low = _lowest(scene, path, one, start) if one.low is None else one.low
            high = np.inf if one.high is None else one.high
            if not low <= start <= high:
                raise OptionError(f"{path}: its start {start:g} is not within {low:g} to {high:g}")
            numbers.append((start, low, high, np.nan if one.prior is None else one.prior))
        return cls(scene, paths, tuple(one.scaled for _, one in rows), *np.array(numbers).T)

    @property
    def names(self) -> list[str]:
        """Names of the parameters (P,), as text."""
        return [
            path.removeprefix("structure.") + " (factor)" * factor
            for path, factor in zip(self.paths, self.scaled, strict=True)
        ]

    @property
    def sizes(self) -> Array:
        """(P,) what changes are compared with: the start, or where that is zero the prior, the bounds, or 1."""
        width = np.where(np.isfinite(self.high - self.low), self.high - self.low, 1.0)
        return np.where(self.start != 0, np.abs(self.start), np.where(np.isnan(self.prior), width, self.prior))

    def at(self, values: Array) -> Draft:
        """Return the experiment with these values (P,); raise TensegrityError for one that the scene cannot have."""
        given = zip(self.paths, self.scaled, values.tolist(), strict=True)
        return Draft(self.scene).apply({path: Scaled(one) if factor else one for path, factor, one in given})


def _start(scene: Scene, path: str, one: Parameter) -> float:
    noted = Noted(1.0)
    Draft(scene).apply({path: noted})  # says what is wrong with a path
    if one.start is not None or one.scaled:
        return 1.0 if one.start is None else one.start
    if len(set(noted.found)) != 1:
        which = f"{len(set(noted.found))} values" if noted.found else "no value"
        raise OptionError(f"{path}: its members have {which}; give a start, or a factor on each: {path}=*1")
    return noted.found[0]


def _lowest(scene: Scene, path: str, one: Parameter, start: float) -> float:
    """Zero where the scene refuses a negative value, or no bound."""
    below = -abs(start) or -1.0
    try:
        Draft(scene).apply({path: Scaled(below) if one.scaled else below})
    except TensegrityError:
        return 0.0
    return -np.inf

"""Value classes: what their fields take, what they say of what they do not take, and how they pass through a file."""

from __future__ import annotations

import dataclasses
import enum
import math
import pickle
import tomllib
from importlib.metadata import EntryPoint
from typing import Any, ClassVar

import numpy as np
import pytest

from tensegrity_mj.basics import fields, kinds
from tensegrity_mj.basics.fields import field, refused, value
from tensegrity_mj.errors import FormatError, SceneError, StructureError
from tensegrity_mj.model.text.codec import Table, check_kinds, read, table_of

NAN = math.nan


class Shape(enum.Enum):
    ROUND = "round"
    FLAT = "flat"


@value("wave")
class Wave:
    amplitude: float = field(kinds.not_negative("m"))
    phase: float = field(kinds.finite("rad"), default=0.0)


@value("pond {name!r}", StructureError)
class Pond:
    name: str = field(kinds.printable_name())
    depth: float = field(kinds.positive("m"), default=2.0)
    width: float | None = field(kinds.positive("m"), default=None, none="None for as wide as it is deep")
    waves: tuple[Wave, ...] = field(kinds.parts(Wave), default=())
    first: Wave | None = field(kinds.part(Wave, "Wave(amplitude)"), default=None, none="None")
    shape: Shape = field(kinds.choice(Shape), default=Shape.ROUND)
    lilies: int = field(kinds.whole(0, 9), default=0)
    deep: bool = field(kinds.flag(), default=False)
    up: tuple[float, float, float] = field(kinds.direction(), default=(0.0, 0.0, 1.0))
    banks: tuple[tuple[float, float, float], ...] = field(kinds.rows(3), default=())
    share: float = field(kinds.within(0, 1), default=0.5, key="part")
    owner: tuple[str, ...] = field(kinds.pair("person"), default=("a", "b"))
    note: str = field(kinds.text(), default="")

    def __attrs_post_init__(self) -> None:
        if self.deep and self.depth < 1:
            raise refused(self, f"deep, but depth = {self.depth:g} m; make it 1 m at least")


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"name": ""}, "pond: name = ''; it must be a non-empty string of printable characters"),
    ({"name": "a\n"}, "it must be a non-empty string of printable characters"),
    ({"name": 3}, "pond: name = 3; it must be"),
    ({"name": np.array([1.0, 2.0])}, "pond: name = [1.0, 2.0]; it must be"),
    ({"depth": 0}, "pond 'p': depth = 0; it must be > 0 m"),
    ({"depth": NAN}, "depth = nan; it must be > 0 m"),
    ({"depth": True}, "depth = True; it must be > 0 m"),
    ({"depth": "deep"}, "depth = 'deep'; it must be > 0 m"),
    ({"depth": 10**400}, "depth = 1000"),
    ({"depth": 1e-200}, "depth = 1e-200; it must be > 0 m, and of a magnitude from 1e-100 to 1e+100"),
    ({"width": np.float64(-1)}, "width = -1.0; it must be > 0 m, or None for as wide as it is deep"),
    ({"waves": Wave(1.0)}, "waves = Wave(amplitude=1.0, phase=0.0); it must be a sequence (a list or tuple, of one"),
    ({"waves": "all"}, "waves = 'all'; it must be a sequence"),
    ({"waves": [Wave(1.0), 1.0]}, "waves[1] = 1.0; use Wave(amplitude, phase)"),
    ({"first": 1.0}, "first = 1.0; use Wave(amplitude), or None"),
    ({"shape": "rund"}, "shape = 'rund' (did you mean 'round'?); it must be one of Shape.ROUND, Shape.FLAT"),
    ({"lilies": 10}, "lilies = 10; it must be an integer from 0 to 9"),
    ({"lilies": 1.0}, "lilies = 1.0; it must be an integer"),
    ({"lilies": True}, "lilies = True; it must be an integer"),
    ({"deep": 1}, "deep = 1; it must be True or False"),
    ({"up": (0, 0, 0)}, "up = (0, 0, 0); its length must not be zero"),
    ({"up": (0, 0)}, "up = (0, 0); it must be three finite numbers"),
    ({"up": 1.0}, "up = 1.0; it must be three finite numbers"),
    ({"up": "xyz"}, "up = 'xyz'; it must be three finite numbers"),
    (
        {"up": np.array([0, NAN, 0])},
        "up = [0.0, nan, 0.0]; it must be three finite numbers of at most 1e+100",
    ),
    ({"banks": [[0, 0]]}, "banks = [[0, 0]]; it must be a sequence of finite vectors, (T, 3)"),
    ({"banks": [[0, 0, 1e200]]}, "of at most 1e+100"),
    ({"share": 2}, "pond 'p': part = 2; it must be within [0, 1]"),
    ({"owner": ("a",)}, "owner = ('a',); it must name two persons"),
    ({"owner": 3}, "owner = 3; it must name two persons"),
    ({"owner": {"a", "b"}}, "; it must name two persons"),  # a set has no order
    ({"owner": {"a": 1, "b": 2}}, "owner = {'a': 1, 'b': 2}; it must name two persons"),
    ({"owner": ("a", 2)}, "owner[1] = 2; it must be the name of a person"),
    ({"note": "\ud800"}, "it must be a text that UTF-8 can hold"),
    ({"deep": True, "depth": 0.5}, "pond 'p': deep, but depth = 0.5 m; make it 1 m at least"),
]


@pytest.mark.parametrize(("given", "message"), WRONG, ids=range(len(WRONG)))
def test_what_is_not_allowed_is_refused_and_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(StructureError) as caught:
        Pond(**{"name": "p", **given})
    assert message in str(caught.value)


def pond() -> Pond:
    waves = [Wave(1, phase=np.float32(0.5)), Wave(2.0)]
    given: dict[str, Any] = {"depth": np.float64(3), "waves": waves, "up": [0, 0, 2], "banks": np.eye(3), "lilies": 3}
    return Pond("p", **given)


def test_values_become_plain_and_stay_as_they_are() -> None:
    one = pond()
    assert type(one.depth) is float
    assert (type(one.waves), type(one.waves[0].amplitude), one.waves[0].phase) == (tuple, float, 0.5)
    assert one.banks == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert one == pond() == pickle.loads(pickle.dumps(one))
    assert hash(one) == hash(pond())
    assert repr(one.waves) == "(Wave(amplitude=1.0, phase=0.5), Wave(amplitude=2.0, phase=0.0))"
    assert (Pond.depth, Wave.phase) == (2.0, 0.0)
    with pytest.raises(AttributeError):
        one.depth = 4.0  # type: ignore[misc]


def test_copies_with_other_fields_are_checked_too() -> None:
    assert dataclasses.replace(pond(), depth=5).depth == 5.0
    assert [item.name for item in dataclasses.fields(Wave)] == ["amplitude", "phase"]  # type: ignore[arg-type]
    with pytest.raises(StructureError, match="depth = -1"):
        dataclasses.replace(pond(), depth=-1)


def from_file(text: str) -> Pond:
    return read(Pond, Table(tomllib.loads(text), "mine.toml", "scene.pond", None))


def test_files_hold_what_is_not_at_its_default() -> None:
    assert table_of(Pond("p")) == {"name": "p"}
    assert list(table_of(pond())) == ["name", "depth", "waves", "lilies", "up", "banks"]
    text = """
        name = "p"
        depth = 3
        lilies = 3
        waves = [{ amplitude = 1, phase = 0.5 }, { amplitude = 2.0 }]
        up = [0, 0, 2]
        banks = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    """
    assert from_file(text) == pond()
    other = dataclasses.replace(pond(), first=Wave(1.0), shape=Shape.FLAT, share=1, width=3, owner=("c", "d"))
    more = 'first = { amplitude = 1 }\nshape = "flat"\npart = 1\nwidth = 3\nowner = ["c", "d"]'
    assert from_file(f"{text}\n{more}") == other
    assert list(table_of(other))[1:] == "depth width waves first shape lilies up banks part owner".split()


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("depth = 1", FormatError, "mine.toml: scene.pond: 'name' is missing; it must be a text in quotes"),
        ("name = 3", FormatError, "mine.toml: scene.pond: name = 3 (an integer); it must be a text in quotes"),
        ('name = "p"\ndeepth = 1', FormatError, "unknown key 'deepth' (did you mean 'depth'?); allowed: name, depth"),
        ('name = "p"\nshare = 1', FormatError, "unknown key 'share'"),
        ('name = "p"\ndepth = "1"', FormatError, "depth = '1' (a text); it must be a number"),
        ('name = "p"\ndepth = -1', StructureError, "scene.pond: depth = -1.0; it must be > 0 m"),
        ('name = "p"\ndepth = 0.5\ndeep = true', StructureError, "scene.pond: deep, but depth = 0.5 m"),
        ('name = "p"\nwaves = 3', FormatError, "waves = 3 (an integer); it must be an array of tables"),
        ('name = "p"\nwaves = [3]', FormatError, "waves = [3] (a list); it must be an array of tables"),
        ('name = "p"\nwaves = [{}]', FormatError, "scene.pond.waves[0]: 'amplitude' is missing; it must be a number"),
        (
            'name = "p"\nwaves = [{ amplitude = 1 }, { amplitude = -1 }]',
            SceneError,
            "scene.pond.waves[1]: amplitude = -1.0; it must be >= 0 m",
        ),
        ('name = "p"\nfirst = 3', FormatError, "scene.pond.first = 3 (an integer); it must be a table"),
        ('name = "p"\nfirst = { amplitude = nan }', SceneError, "scene.pond.first: amplitude = nan; it must be >= 0 m"),
        ('name = "p"\nshape = "square"', FormatError, 'shape = \'square\' (a text); it must be "round" or "flat"'),
        ('name = "p"\ndeep = 1', FormatError, "deep = 1 (an integer); it must be true or false"),
        ('name = "p"\nlilies = 1.0', FormatError, "lilies = 1.0 (a number); it must be an integer"),
        ('name = "p"\nbanks = [[1, 2]]', FormatError, "banks = [[1, 2]] (a list); it must be rows of three numbers"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_its_place(text: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error) as caught:
        from_file(text)
    assert message in str(caught.value)


# Classes of others, by their names -----------------------------------------------------------------------


class Effect:
    """What others give subclasses of."""

    smooth: ClassVar[bool] = False


@value("magnet at {node!r}")
class Magnet(Effect):
    node: str
    moment: float = 1.0
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    shape: Shape | None = None
    turns: int = 1
    on: bool = True
    places: tuple[tuple[float, float, float], ...] = ()
    waves: tuple[Wave, ...] = ()
    wave: Wave | None = None
    depth: float = field(kinds.positive("m"), default=2.0)
    smooth = True


@dataclasses.dataclass(frozen=True)
class Spring(Effect):
    node: str
    stiffness: float = 2.0
    others: tuple[str, ...] = ()


@value()
class Field:
    effects: tuple[Any, ...] = field(kinds.parts(Effect), default=())


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "_KINDS", {})
    fields.register("magnet", Magnet)
    fields.register("spring", Spring)


EFFECTS = """
    [[effects]]
    kind = "magnet"
    node = "a"
    moment = 2
    axis = [1, 0, 0]
    shape = "flat"
    turns = 3
    on = false
    places = [[1, 2, 3]]
    waves = [{ amplitude = 1 }]
    wave = { amplitude = 2 }
    depth = 3
    [[effects]]
    kind = "spring"
    node = "b"
    stiffness = 4
    others = ["c"]
"""


def effects(text: str) -> Field:
    return read(Field, Table(tomllib.loads(text), "mine.toml", "scene", None))


@pytest.mark.usefixtures("known")
def test_classes_of_others_are_read_and_written_by_name() -> None:
    magnet = Magnet(
        "a",
        2,
        (1, 0, 0),
        Shape.FLAT,
        3,
        False,
        ((1, 2, 3),),
        (Wave(1),),
        Wave(2),
        depth=3,  # type: ignore[arg-type]
    )
    assert effects(EFFECTS) == Field((magnet, Spring("b", 4.0, ("c",))))
    assert (magnet.smooth, type(magnet.moment), magnet.places) == (True, float, ((1.0, 2.0, 3.0),))
    found = [table_of(item) for item in effects(EFFECTS).effects]
    assert list(found[0])[:3] == ["kind", "node", "moment"]
    assert found[1] == {"kind": "spring", "node": "b", "stiffness": 4.0, "others": ("c",)}
    assert table_of(Magnet("a")) == {"kind": "magnet", "node": "a"}
    with pytest.raises(SceneError, match=r"magnet at 'a': moment = nan; it must be a finite number"):
        Magnet("a", NAN)


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "spring"', 'kind = "sprung"', "scene.effects[1] 'sprung': kind = 'sprung' (a text); it must be"),
        ('kind = "spring"', "", 'scene.effects[1]: \'kind\' is missing; it must be "magnet" or "spring"'),
        ("stiffness = 4", "stifness = 4", "effects[1] 'spring': unknown key 'stifness' (did you mean 'stiffness'?)"),
        ("stiffness = 4", 'stiffness = "4"', "effects[1] 'spring': stiffness = '4' (a text); it must be a number"),
        ('node = "a"', "", "scene.effects[0] 'magnet': 'node' is missing; it must be a text in quotes"),
        ("turns = 3", "turns = 3.5", "scene.effects[0] 'magnet': turns = 3.5 (a number); it must be an integer"),
    ],
)
def test_what_is_wrong_with_them_in_a_file(old: str, new: str, message: str) -> None:
    with pytest.raises(FormatError) as caught:
        effects(EFFECTS.replace(old, new))
    assert message in str(caught.value)


def test_a_file_that_names_a_kind_where_none_is_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "_KINDS", {})
    with pytest.raises(FormatError, match=r"effects.0. 'magnet': no kind of effect is registered here: install"):
        effects(EFFECTS)


def test_what_has_no_name_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "_KINDS", {"magnet": Magnet})
    one = fields.item_of(Field).keys["effects"]
    check_kinds("effects", one, [Magnet("a")])
    check_kinds("waves", fields.item_of(Pond).keys["waves"], [Wave(1.0)])
    with pytest.raises(SceneError, match=r"effects\[1\] is a Spring, .* register\(name, Spring\)"):
        check_kinds("effects", one, [Magnet("a"), Spring("b")])


@pytest.mark.usefixtures("known")
def test_what_is_registered() -> None:
    fields.register("magnet", Magnet)
    assert fields.registered(Effect) == {"magnet": Magnet, "spring": Spring}
    assert fields.registered(Wave) == {}
    with pytest.raises(SceneError, match="kind 'magnet' is Magnet already; give Spring another"):
        fields.register("magnet", Spring)
    with pytest.raises(SceneError, match="it must be a class of values"):
        fields.register("effect", Effect)
    with pytest.raises(SceneError, match="kind = ''; it must be a non-empty"):
        fields.register("", Magnet)


def test_types_that_no_file_can_hold() -> None:
    class Odd(Effect):
        rows: dict[str, float]

    with pytest.raises(SceneError, match=r"Odd: rows is of type dict\[str, float\]; a file can hold float, int"):
        value()(Odd)


def test_a_package_that_is_installed_registers_by_an_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    def points(group: str) -> list[EntryPoint]:
        return [EntryPoint("spring", f"{__name__}:Spring", group)] if group == "tensegrity_mj.effects" else []

    monkeypatch.setattr(fields, "_KINDS", {})
    monkeypatch.setattr("importlib.metadata.entry_points", points)
    assert effects('[[effects]]\nkind = "spring"\nnode = "b"').effects == (Spring("b"),)

"""Files of other programs, changed by chance: each becomes a scene, or is refused in one line."""

from __future__ import annotations

import random
import warnings
from pathlib import Path

import pytest

import tensegrity_mj as tmj
from tensegrity_mj.engines.mujoco.mjcf import save_mjcf
from tensegrity_mj.exchange import ImportOptions, import_scene, save_csv

DATA = Path(__file__).resolve().parents[1] / "data" / "exchange"
WORDS = [
    "0",
    "-1",
    "1e400",
    "nan",
    "[]",
    "''",
    "{}",
    "(",
    ")",
    "a",
    "rod",
    ":",
    ";",
    "\x00",
    "é",
    "&x",
    "*x",
    "<",
    "/>",
]


def changed(text: str, chance: random.Random) -> str:
    for _ in range(chance.randint(1, 3)):
        at, other = chance.randrange(len(text)), chance.randrange(len(text))
        piece = chance.choice([chance.choice(WORDS), text[other : other + 20], ""])
        text = text[:at] + piece + text[at + (0 if piece else chance.randint(1, 10)) :]
    return text


@pytest.mark.parametrize("name", ["stedy_tbar.m", "motes_dbar.m", "robot.xml", "prism.yaml", "p_nodes.csv", "dbar.xml"])
def test_a_changed_file_is_read_or_refused(name: str, tmp_path: Path) -> None:
    save_csv(tmj.load_scene("prism"), tmp_path / "p_nodes.csv")
    save_mjcf(tmj.load_scene("dbar"), tmp_path / "dbar.xml")
    source = next(path for path in (DATA / name, DATA / "ntrt" / name, tmp_path / name) if path.exists())
    text, chance = source.read_text(encoding="utf-8"), random.Random(name)
    path, read = tmp_path / name, 0
    for _ in range(60):
        path.write_text(changed(text, chance), encoding="utf-8")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                read += import_scene(path, options=ImportOptions(rod_mass=1.0, stiffness=1.0)).scene is not None
        except tmj.TensegrityError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert name.partition("_")[0] in str(error)  # noqa: PT017
    assert read < 60

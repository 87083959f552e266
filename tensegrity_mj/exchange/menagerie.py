"""MJCF for readers other than the MuJoCo that is installed.

After the conventions of MuJoCo Menagerie it is a model with default classes, and a scene that includes it. The physics
is that of `mjcf.scene_to_mjcf`, element by element; what differs is how it is written. The model has rods, nodes and
strings in classes, names without spaces, a keyframe "home", ranges of controls and sensors of strings; the scene has
the floor, light, sky and a camera. For MuJoCo Warp, what it refuses is left out.
"""

from __future__ import annotations

import copy
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tensegrity_mj.basics.files import checked, table_beside, write_text
from tensegrity_mj.engines.mujoco.mjcf import scene_to_mjcf
from tensegrity_mj.engines.mujoco.mjcf_tree import distinct, numbers
from tensegrity_mj.engines.mujoco.mjcf_versions import fit
from tensegrity_mj.errors import OptionError
from tensegrity_mj.exchange.mjcf_text import parsed, remarks
from tensegrity_mj.model.scene import Scene

CONVENTIONS = table_beside(__file__)


def save_menagerie(scene: Scene, path: str | os.PathLike[str], warp: bool = False) -> tuple[list[Path], list[str]]:
    """Write NAME.xml and, beside it, scene.xml, which includes it; returns both paths, and what they do not hold.

    A control is the change of a string's rest length [m], from what leaves it no line (or its smallest rest length) to
    as much again as it has.

    Raises:
        OptionError: for another suffix, a place where no file can be written, or another scene.xml there.
        FormatError: if a file cannot be written.
    """
    model = checked(path, (".xml",), "MJCF")
    scenery = checked(
        model.with_name("scene.xml" if model.stem != "scene" else "scene_with_floor.xml"), (".xml",), "MJCF"
    )
    _refuse_to_replace(scenery, model.name)
    root = parsed(scene_to_mjcf(scene))
    notes = remarks(root)
    if warp:
        notes += fit(root, "warp")
    _rename(root)
    _use_classes(root)
    _add_controls(root, scene)
    _add_home(root)
    outer = _including_scene(root, model.name)
    for element, place in ((root, model), (outer, scenery)):
        ET.indent(element)
        write_text(place, ET.tostring(element, encoding="unicode") + "\n")
    return [model, scenery], notes


def save_mjcf_for(
    scene: Scene, path: str | os.PathLike[str], reader: str | None = None
) -> tuple[list[Path], list[str]]:
    """Write MJCF for a reader; returns the paths of the files, and what they do not hold, a sentence each.

    Args:
        reader: None for the MuJoCo that is installed; the version of an older one, such as "3.2"; "drake", also for
            other parsers of MJCF; "menagerie" or "warp", as `save_menagerie`.

    Raises:
        OptionError: for another suffix, a place where no file can be written, a reader that there is none of, or a
            scene that cannot be written for it.
        FormatError: if a file cannot be written.
    """
    if reader in ("menagerie", "warp"):
        return save_menagerie(scene, path, warp=reader == "warp")
    destination = checked(path, (".xml",), "MJCF")
    root = parsed(scene_to_mjcf(scene))
    notes = remarks(root) + ([] if reader is None else fit(root, reader))
    ET.indent(root)
    return [write_text(destination, ET.tostring(root, encoding="unicode") + "\n")], notes


def _refuse_to_replace(place: Path, model: str) -> None:
    """Refuse where a file that nobody named would be replaced, unless it is the scene of the same model."""
    if place.exists() and f'<include file="{model}"' not in place.read_text(encoding="utf-8", errors="replace"):
        raise OptionError(
            f"{place} is there already, and is no scene of {model}: write into another folder, or move it"
        )


def _rename(root: ET.Element) -> None:
    """Names of letters, digits, - and _ alone, unique among their kind, and what refers to them."""
    kinds = {"spatial": "tendon", "general": "actuator", "freejoint": "joint", "connect": "equality"}
    references: dict[str, dict[str, str]] = {}
    for element in root.iter():
        name = element.get("name")
        if name is not None and isinstance(element.tag, str):
            references.setdefault(kinds.get(element.tag, element.tag), {})[name] = name
    for known in references.values():
        plain = [re.sub(r"\W+", "_", name).strip("_") or "unnamed" for name in known]
        known.update(zip(known, [re.sub(r"\W+", "_", one).rstrip("_") for one in distinct(plain, set())], strict=True))
    for element in root.iter():
        if not isinstance(element.tag, str):
            continue
        own = kinds.get(element.tag, element.tag)
        for key, kind in (
            ("name", own),
            ("site", "site"),
            ("site1", "site"),
            ("site2", "site"),
            ("tendon", "tendon"),
            ("joint", "joint"),
        ):
            if key in element.attrib and kind in references:
                element.set(key, references[kind].get(element.attrib[key], element.attrib[key]))
    root.set("model", re.sub(r"\W+", "_", root.get("model", "")).strip("_") or "structure")


def _use_classes(root: ET.Element) -> None:
    """Move what all rods, nodes or strings have alike into their default class."""
    default = ET.Element("default")
    main = ET.SubElement(default, "default", {"class": root.get("model", "")})
    found: dict[str, list[ET.Element]] = {tag: [] for tag in CONVENTIONS["classes"]}
    for element in root.iter():
        if element.tag in found and element.get("site") is None and element.get("type") in (None, "capsule"):
            found[str(element.tag)].append(element)
    classes: dict[str, ET.Element] = {}
    for tag, elements in found.items():
        if not elements:
            continue
        name = CONVENTIONS["classes"][tag]
        if name not in classes:
            classes[name] = ET.SubElement(main, "default", {"class": name})
        alike = {key: elements[0].attrib[key] for key in CONVENTIONS["shared"][tag] if key in elements[0].attrib}
        alike = {key: value for key, value in alike.items() if all(one.get(key) == value for one in elements)}
        ET.SubElement(classes[name], {"spatial": "tendon"}.get(tag, tag), alike)
        for element in elements:
            for key in alike:
                del element.attrib[key]
            element.set("class", name)
    tags = [child.tag for child in root]
    root.insert(tags.index("worldbody") if "statistic" not in tags else tags.index("statistic"), default)


def _add_controls(root: ET.Element, scene: Scene) -> None:
    actuators, structure = root.find("actuator"), scene.structure
    if actuators is None:
        return
    sensors = ET.Element("sensor")
    least = np.maximum(structure.limits("min_rest_length"), 0.0)
    for actuator, rest, low in zip(actuators, structure.rest_lengths, least, strict=True):
        if rest > 0:  # a string of constant force has no rest length
            actuator.set("ctrllimited", "true")
            actuator.set("ctrlrange", numbers([min(low - rest, 0.0), rest]))
        for tag, kind, word in CONVENTIONS["sensors"]:
            name = str(actuator.get("name"))
            ET.SubElement(sensors, tag, {kind: name, "name": f"{name}_{word}"})
    root.append(sensors)


def _add_home(root: ET.Element) -> None:
    """The keyframe "home": the start of the scene, with all controls at zero."""
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    old = root.find("keyframe")
    if old is not None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        root.remove(old)
    values: dict[str, Any] = {"qpos": data.qpos, "qvel": data.qvel, "ctrl": data.ctrl}
    keys = {key: numbers(value) for key, value in values.items() if len(value)}
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", {"name": "home", **keys})


def _including_scene(root: ET.Element, file: str) -> ET.Element:
    """The scene that includes the model, with what of the model is scenery moved into it."""
    world, statistic = root.find("worldbody"), root.find("statistic")
    assert world is not None
    outer = ET.parse(Path(__file__).with_suffix(".xml")).getroot()
    scenery = outer.find("worldbody")
    assert scenery is not None
    outer.set("model", f"{root.get('model')}_scene")
    outer.insert(0, ET.Element("include", file=file))
    if statistic is not None:
        root.remove(statistic)
        outer.insert(1, statistic)
    for element in [one for one in world if one.tag == "light" or (one.tag == "geom" and one.get("type") == "plane")]:
        world.remove(element)
        if element.tag == "geom":
            element.attrib.pop("rgba", None)
            element.set("material", "ground")
        scenery.append(copy.copy(element))
    place = {} if statistic is None else statistic.attrib
    center, extent = np.array([*map(float, place.get("center", "0 0 0").split())]), float(place.get("extent", "1"))
    camera = {"name": "side", "pos": numbers(center + extent * np.array([0.0, -2.0, 0.3])), "xyaxes": "1 0 0 0 0.15 1"}
    ET.SubElement(scenery, "camera", camera)
    return outer

"""Readers of MJCF: the oldest MuJoCo that loads a file, and files for older ones and for other programs."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

from tensegrity_mj.basics.files import table_beside
from tensegrity_mj.engines.mujoco.mjcf_tree import distinct
from tensegrity_mj.errors import OptionError

TABLE = table_beside(__file__)
FEATURES: list[dict[str, Any]] = TABLE["features"]
SAID = "Loads in MuJoCo"  # so begins the comment
OF_DRAKE = (
    "Drake reads bodies, joints, shapes and loops alone: its user adds strings, contact's stiffness, step and start"
)


def parts(version: str) -> tuple[int, ...]:
    """The three numbers of a version such as "3.2" or "3.2.1".

    Raises:
        OptionError: where it is none, or older than all that files are written for.
    """
    if not re.fullmatch(r"\d{1,4}(\.\d{1,4}){1,2}", version):
        raise OptionError(f"'{version}': write menagerie, warp, drake or the version of a MuJoCo, such as 3.2 or 3.2.1")
    found, least = (tuple(map(int, f"{one}.0".split(".")[:3])) for one in (version, TABLE["oldest"]))
    if found < least:
        raise OptionError(f"MuJoCo {version}: no file is written for one older than {TABLE['oldest']}")
    return found


def oldest(root: ET.Element) -> str:
    """The oldest MuJoCo that loads a model."""
    said = [feature["since"] for feature in FEATURES if _having(root, feature)]
    return max(said, key=parts, default=str(TABLE["oldest"]))


def state_oldest(root: ET.Element) -> None:
    """Write into a model which MuJoCo loads it: a comment, in place of the one that may be there."""
    order = " Before 4.0 RK4 is of order 2 on its ball and free joints." if _loses_order(root) else ""
    for old in [one for one in root if not isinstance(one.tag, str) and SAID in (one.text or "")]:
        root.remove(old)
    root.insert(1, ET.Comment(f" {SAID} {oldest(root)} and newer.{order} "))


def fit(root: ET.Element, reader: str) -> list[str]:
    """Write a model for "warp", "drake" or the version of an older MuJoCo; returns what it loses, a sentence each.

    Raises:
        OptionError: for what cannot be left out or written otherwise, and a reader that there is none of.
    """
    who = TABLE["names"].get(reader, f"MuJoCo {reader}")
    version = None if reader in TABLE["names"] else parts(reader)
    notes = [OF_DRAKE] if reader == "drake" else []
    if reader == "drake":
        _part_names(root)
        _carry_sites(root)
    for feature in FEATURES:
        known = reader not in feature.get("strangers", ()) if version is None else parts(feature["since"]) <= version
        for element in [] if known else _having(root, feature):
            if "needs" in feature:
                newer = "" if version is None else f"; MuJoCo {feature['since']} does"
                raise OptionError(f"{who} does not know {feature['needs']}{newer}: this scene cannot be written for it")
            if "lost" in feature:
                del element.attrib[feature["key"]]
                notes.append(
                    f"the {feature['at']} {feature['key']} is left out, which {who} does not know: {feature['lost']}"
                )
            elif feature["instead"] == "bodies":
                _connect_bodies(root, element)
            else:
                element.tag = "joint"
                element.set("type", "free")
    if version is not None and version < parts(TABLE["fourth"]) and _loses_order(root):
        notes.append(
            f"RK4 of {who} is of order 2 on ball and free joints, which turn the rods; MuJoCo 4.0's is of order 4"
        )
    state_oldest(root)
    return notes


def _loses_order(root: ET.Element) -> bool:
    turning = any(one.tag == "freejoint" or one.get("type") in ("ball", "free") for one in root.iter())
    return turning and any(option.get("integrator") == "RK4" for option in root.iter("option"))


def _having(root: ET.Element, feature: dict[str, Any]) -> list[ET.Element]:
    key, meant = feature["key"], feature.get("value")
    return [one for one in root.iter(feature["at"]) if not key or (key in one.attrib and meant in (None, one.get(key)))]


def _part_names(root: ET.Element) -> None:
    """Rename bodies of several joints whose parts, the body's name and a number in Drake, have another body's name."""
    names = {str(body.get("name")) for body in root.iter("body")}
    for body in root.iter("body"):
        own = str(body.get("name"))
        while len(body.findall("joint")) > 1 and any(re.fullmatch(re.escape(own) + r"\d+", one) for one in names):
            own += "_"
        names.add(own)
        body.set("name", own)


def _carry_sites(root: ET.Element) -> None:
    """Give the sites of the world to a body that stands still there."""
    taken = {str(body.get("name")) for body in root.iter("body")}
    for world in root.findall("worldbody[site]"):
        body = ET.SubElement(world, "body", name=distinct(["fixed nodes"], taken)[0])
        for site in world.findall("site"):
            world.remove(site)
            body.append(site)


def _connect_bodies(root: ET.Element, connect: ET.Element) -> None:
    """Name two bodies and the place in the first, in place of two sites, which are at one place at the start."""
    carriers = {site.get("name"): (body, site) for body in root.iter("body") for site in body.findall("site")}
    # Sites that no body has are the world's, which is named by leaving out the second body.
    found = [carriers[name] for key in ("site1", "site2") if (name := connect.attrib.pop(key)) in carriers]
    for key, (body, _) in zip(("body1", "body2"), found, strict=False):
        connect.set(key, str(body.get("name")))
    connect.set("anchor", str(found[0][1].get("pos")))

"""The model that pictures are drawn with: lights, the water's meshes and uneven ground, and no member."""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.model.elements.terrain import Terrain
from tensegrity_mj.pictures.camera import FIELD_OF_VIEW
from tensegrity_mj.pictures.surface import Surface

# An almost empty model: it lends MuJoCo's renderer its lights and its settings. Drawn without multisampling, shadow,
# reflection and sky, which cost most of the time in software OpenGL; frames are smoothed by drawing them larger.
_MODEL = f"""
<mujoco>
  <statistic center="0 0 0" extent="1"/>
  <visual>
    <global fovy="{FIELD_OF_VIEW}"/>
    <quality shadowsize="0" offsamples="0" numslices="14" numstacks="7" numquads="1"/>
    <headlight ambient="0.42 0.42 0.42" diffuse="0.38 0.38 0.38" specular="0.06 0.06 0.06"/>
  </visual>
  <worldbody>
    <light type="directional" dir="-0.3 0.35 -1" diffuse="0.34 0.34 0.34" ambient="0 0 0"
           specular="0.1 0.1 0.1" castshadow="false"/>
  </worldbody>
</mujoco>
"""


def make_model(surface: Surface | None = None, terrain: Terrain | None = None, cell: float = 1.0) -> Any:
    """The MjModel that pictures are drawn with; with water, it lends the renderer a skin for each of its meshes.

    On a terrain there are lines a `cell` [m] apart.
    """
    import mujoco

    specification = mujoco.MjSpec.from_string(_MODEL)
    if terrain is not None:
        add_terrain(specification, terrain)
        texture = specification.add_texture(name="lines", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256)
        texture.builtin, texture.mark = mujoco.mjtBuiltin.mjBUILTIN_FLAT, mujoco.mjtMark.mjMARK_EDGE
        texture.rgb1, texture.markrgb = [1.0, 1.0, 1.0], [0.8, 0.8, 0.8]
        lined = specification.add_material(name="lined", texuniform=True, texrepeat=[2.0 / cell, 2.0 / cell])
        lined.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "lines"
    for faces in () if surface is None else surface.faces:
        count = int(faces.max()) + 1
        # Where vertices are is said for each frame; here the triangles count, and that there is a bone.
        skin = specification.add_skin()
        skin.vert, skin.face = np.zeros(3 * count).tolist(), faces.ravel().tolist()
        skin.bodyname, skin.bindpos, skin.bindquat = ["world"], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        skin.vertid, skin.vertweight = [list(range(count))], [[1.0] * count]
    return specification.compile()


def add_terrain(specification: Any, terrain: Terrain) -> None:
    """Add the height field of a terrain to a model's assets, its only one."""
    _, sizes, shares = terrain.height_field()
    rows, columns = shares.shape
    specification.add_hfield(name="terrain", nrow=rows, ncol=columns, size=sizes, userdata=shares.ravel().tolist())

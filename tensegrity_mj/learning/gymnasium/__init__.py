"""Tasks as Gymnasium's environments: importing it registers them.

    import gymnasium
    import tensegrity_mj.learning.gymnasium

    env = gymnasium.make("Tensegrity/SixBarRoll-v0")
    robots = gymnasium.make_vec("Tensegrity/SixBarRoll-v0", num_envs=1024, vectorization_mode="vector_entry_point")

See docs/gymnasium.md. Importing it raises `tensegrity_mj.errors.MissingPackageError` where gymnasium is missing.
"""

from typing import TYPE_CHECKING

from tensegrity_mj.basics.dependencies import of_extra, optional
from tensegrity_mj.basics.faces import face

optional("gymnasium", "tensegrity_mj.learning.gymnasium", of_extra("gym"))

from tensegrity_mj.learning.gymnasium.registration import register as register  # noqa: E402 - after the check

if TYPE_CHECKING:
    from tensegrity_mj.learning.gymnasium.environments import TensegrityEnv as TensegrityEnv
    from tensegrity_mj.learning.gymnasium.environments import TensegrityVectorEnv as TensegrityVectorEnv
    from tensegrity_mj.learning.gymnasium.stable_baselines import StableBaselinesVecEnv as StableBaselinesVecEnv
else:
    __getattr__, __dir__ = face(__name__)

register()

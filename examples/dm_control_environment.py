"""A random policy against the thesis' law, in a dm_control environment.

    python examples/dm_control_environment.py
    python examples/dm_control_environment.py --scene pinned_rod --action force-density --duration 20
    python examples/dm_control_environment.py --video prism.mp4     # the law's episode
    python examples/dm_control_environment.py --view                # in dm_control's viewer; space starts it

Prints the return (the sum of the rewards) and the largest distance of a node from its target at the end, of both.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tensegrity_mj as tmj
from tensegrity_mj.model.strings import rest_length

ACTIONS = {"rest-length": tmj.Command.REST_LENGTH, "force-density": tmj.Command.FORCE_DENSITY}
Policy = Callable[[Any], np.ndarray]  # dm_env.TimeStep -> action


def random_policy(env: Any, seed: int) -> Policy:
    """Actions drawn evenly from the whole action spec."""
    generator, spec = np.random.default_rng(seed), env.action_spec()
    return lambda timestep: generator.uniform(spec.minimum, spec.maximum)


def law_policy(env: Any, scene: tmj.Scene, action: tmj.Command) -> Policy:
    """The law that the scene names, called once a control step; where it has no solution, the last action is kept."""
    law = tmj.controllers.from_scene(scene)
    spec = env.action_spec()
    kept = np.clip(
        scene.structure.rest_lengths if action is tmj.Command.REST_LENGTH else 0.0, spec.minimum, spec.maximum
    )

    def policy(timestep: Any) -> np.ndarray:
        nonlocal kept
        seen = timestep.observation
        try:
            u = law(env.physics.time(), seen["nodes"], seen["velocities"])
        except tmj.errors.InfeasibleError:
            return kept
        if action is tmj.Command.REST_LENGTH:
            u = rest_length(scene.structure.stiffness, seen["string_lengths"], u)
        kept = np.clip(u, spec.minimum, spec.maximum)
        return kept

    return policy


def episode(env: Any, policy: Policy, after_step: Callable[[], None] = lambda: None) -> tuple[float, float]:
    """Play one episode; returns the return and the largest node error [m] at its end."""
    timestep, total = env.reset(), 0.0
    after_step()
    while not timestep.last():
        timestep = env.step(policy(timestep))
        total += timestep.reward
        after_step()
    gaps = timestep.observation["nodes"] - timestep.observation["target"]
    return total, float(np.max(np.linalg.norm(gaps, axis=1)))


def main() -> None:
    """Play both policies."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="prism", help="name or path of a scene with a target and a law")
    parser.add_argument("--action", choices=ACTIONS, default="rest-length", help="what an action is")
    parser.add_argument("--duration", type=float, default=5.0, help="of an episode [s]")
    parser.add_argument("--seed", type=int, default=0, help="of the random policy")
    parser.add_argument("--video", type=Path, help="write the law's episode to this .mp4")
    parser.add_argument("--view", action="store_true", help="then show the law's episode in dm_control's viewer")
    options = parser.parse_args()
    if options.video:
        from tensegrity_mj.pictures.opengl import choose_backend

        os.environ["MUJOCO_GL"] = choose_backend()  # before dm_control is imported, which settles it
    if options.view:
        from tensegrity_mj.pictures.viewer import require_display

        require_display()

    from tensegrity_mj.learning.dm_control import environment

    scene, action = tmj.load_scene(options.scene), ACTIONS[options.action]
    env = environment(scene, action, control_timestep=0.01, timestep=2e-3, time_limit=options.duration)
    law, frames = law_policy(env, scene, action), []

    def draw() -> None:
        if options.video and env.physics.time() >= len(frames) / 30 - 1e-9:
            frames.append(env.physics.render(480, 640))

    print(f"{'policy':8s} {'return':>10s} {'final error [m]':>16s}")
    for name, policy, after_step in (("random", random_policy(env, options.seed), lambda: None), ("law", law, draw)):
        total, error = episode(env, policy, after_step)
        print(f"{name:8s} {total:10.3f} {error:16.3e}")
    if options.video:
        import mediapy

        from tensegrity_mj.pictures.video import ffmpeg_program

        mediapy.set_ffmpeg(ffmpeg_program())
        mediapy.write_video(options.video, frames, fps=30)
        print(f"video: {options.video}")
    if options.view:
        from dm_control import viewer

        viewer.launch(env, law, title=scene.name)


if __name__ == "__main__":
    try:
        main()
    except tmj.TensegrityError as error:
        sys.exit(f"error: {error}")

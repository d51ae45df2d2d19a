"""Draws the moving picture of the README: python scripts/figures/moving_picture.py docs/pictures/feeding.gif"""

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import avrgym  # registers the environments
from avrgym.policies.actors import Actor
from avrgym.policies.trained_policies import Policy, find_policy_file

ENVIRONMENT, POLICY, SEED = "avrgym/FeedingJaco-v1", "adaptive", 3
STEPS, EVERY, WIDTH, COLOURS = 110, 2, 400, 96


def main(out: Path) -> None:
    """Draw every second control step of the beginning of an episode, twice as fast as real time."""
    assert avrgym
    env = gym.make(ENVIRONMENT, people="revised", render_mode="rgb_array")
    observation, _ = env.reset(seed=SEED)
    actor, generators = (
        Actor(Policy.load(find_policy_file(POLICY, ENVIRONMENT)), 1),
        [np.random.default_rng(SEED)],
    )
    pictures = []
    for step in range(STEPS):
        observation, *_ = env.step(actor.act(observation[None], generators)[0])
        if step % EVERY == 0:
            picture = Image.fromarray(env.render())
            size = (WIDTH, WIDTH * picture.height // picture.width)
            pictures.append(picture.resize(size).quantize(COLOURS, dither=Image.Dither.NONE))
    pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=100, loop=0, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

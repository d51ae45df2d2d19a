"""Define your own population: ``python 05_own_person.py``

A fixed person, an impairment, and a population file as ``avrgym fit-people`` writes. Writes ``people.png``.
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import avrgym  # noqa: F401  registers the environments
from avrgym.models.human import Person, make_seated_joint_angles

ENVIRONMENT = "avrgym/FeedingJaco-v1"
PEOPLE = """
cooperating = false

[torso_height_m]
man = [0.62, 0.66]
woman = [0.58, 0.60]

[poses.Feeding]  # degrees
waist_x = [5.0, 15.0]
"""

leaning = Person("man", 0.58, make_seated_joint_angles(waist_x=12.0, head_z=-15.0), skin_tone="brown")
Path("tall.toml").write_text(PEOPLE)

pictures = []
for name, options in {
    "a short woman": {"person": Person("woman", 0.50)},
    "a leaning man with tremor": {"person": leaning, "impairment": "tremor"},
    "a person of the file": {"people": "tall.toml"},
}.items():
    env = gym.make(ENVIRONMENT, render_mode="rgb_array", **options)
    observation, info = env.reset(seed=1)
    pictures.append(env.render())
    print(f"{name}: the spoon starts {info['reward_terms']['distance_m']:.2f} m away")
    env.close()
Image.fromarray(np.concatenate(pictures, axis=1)).save("people.png")

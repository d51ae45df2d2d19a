"""Step one environment and render it: ``python 01_step_and_render.py``

Writes ``feeding.png``. Actions are random.
"""

import gymnasium as gym
from PIL import Image

import avrgym  # noqa: F401  registers the environments

env = gym.make("avrgym/FeedingJaco-v1", people="revised", render_mode="rgb_array")
observation, info = env.reset(seed=3)
env.action_space.seed(3)
print(f"{observation.shape[0]} observed numbers, {env.action_space.shape[0]} joints")

reward_so_far = 0.0
for _ in range(20):  # two seconds; an episode has 200 steps of 0.1 s
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    reward_so_far += float(reward)

print(f"reward {reward_so_far:.2f}, success {info['success']}, force {info['force_on_person']:.1f} N")
for term, value in info["reward_terms"].items():
    print(f"    {term:24} {value:8.3f}")
Image.fromarray(env.render()).save("feeding.png")
env.close()

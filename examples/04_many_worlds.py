"""Step many worlds together: ``python 04_many_worlds.py [WORLDS]``

One call steps them all on threads. Each world gives the bits that it would give alone.
"""

import sys
import time

import gymnasium as gym
import numpy as np

import avrgym  # noqa: F401  registers the environments
from avrgym.policies.trained import Policy, find_policy

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"
WORLDS = int(sys.argv[1]) if len(sys.argv) > 1 else 64

policy = Policy.load(find_policy("revised", ENVIRONMENT))
chance = [np.random.default_rng([0, world]) for world in range(WORLDS)]
worlds = gym.make_vec(ENVIRONMENT, num_envs=WORLDS, people="revised")
observations, infos = worlds.reset(seed=0)

rewards = np.zeros(WORLDS)
strongest_n = np.zeros(WORLDS)
began_s = time.perf_counter()
for _ in range(200):
    observations, reward, _, ended, infos = worlds.step(policy.act(observations, chance))
    rewards += reward
    shown = infos["final_info"] if ended.any() else infos  # after the last step infos are of the next start
    strongest_n = np.maximum(strongest_n, shown["force_on_person"])
took_s = time.perf_counter() - began_s

print(f"{200 * WORLDS / took_s:,.0f} steps a second")
print(f"success {shown['success'].mean():.0%}, reward {rewards.mean():.0f} ± {rewards.std():.0f}")
print(f"the median episode's strongest force is {np.median(strongest_n):.1f} N")
worlds.close()

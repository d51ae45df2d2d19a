"""Step many worlds together: ``python 04_many_worlds.py [WORLDS]``

One call steps all worlds on threads. Each world gives the same bits as alone.
"""

import sys
import time

import gymnasium as gym
import numpy as np

import avrgym  # noqa: F401  registers the environments
from avrgym.policies.trained_policies import Policy, find_policy_file

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"
WORLDS = int(sys.argv[1]) if len(sys.argv) > 1 else 64

policy = Policy.load(find_policy_file("revised", ENVIRONMENT))
generators = [np.random.default_rng([0, world]) for world in range(WORLDS)]
worlds = gym.make_vec(ENVIRONMENT, num_envs=WORLDS, people="revised")
observations, infos = worlds.reset(seed=0)

rewards = np.zeros(WORLDS)
peak_n = np.zeros(WORLDS)
start_s = time.perf_counter()
for _ in range(200):
    observations, reward, _, ended, infos = worlds.step(policy.act(observations, generators))
    rewards += reward
    shown = infos["final_info"] if ended.any() else infos  # after the last step infos are of the next start
    peak_n = np.maximum(peak_n, shown["force_on_person"])
duration_s = time.perf_counter() - start_s

print(f"{200 * WORLDS / duration_s:,.0f} steps a second")
print(f"success {shown['success'].mean():.0%}, reward {rewards.mean():.0f} ± {rewards.std():.0f}")
print(f"median of the episodes' peak force: {np.median(peak_n):.1f} N")
worlds.close()

"""TorchRL's PPO on many worlds: ``python 11_torchrl.py``

Needs ``torchrl`` and PyTorch; arguments: updates, worlds.
"""

import sys

import gymnasium as gym
import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import avrgym  # noqa: F401  registers the environments

UPDATES, WORLDS = map(int, sys.argv[1:] or (100, 32))
STEPS, EPOCHS, MINIBATCH = 200, 10, 640
torch.manual_seed(0)
worlds = gym.make_vec("avrgym/FeedingJaco-v1", num_envs=WORLDS, people="original")
inputs, outputs = worlds.single_observation_space.shape[0], worlds.single_action_space.shape[0]

layers = [[nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()] for _ in range(2)]
scaled = NormalParamExtractor(scale_mapping="biased_softplus_0.4")
acting = nn.Sequential(*layers[0], nn.Linear(64, 2 * outputs), scaled)
module = TensorDictModule(acting, in_keys=["observation"], out_keys=["loc", "scale"])
how = {"distribution_class": IndependentNormal, "return_log_prob": True}
actor = ProbabilisticActor(module, in_keys=["loc", "scale"], **how)
critic = ValueOperator(nn.Sequential(*layers[1], nn.Linear(64, 1)), in_keys=["observation"])
advantage = GAE(gamma=0.97, lmbda=0.95, value_network=critic)
loss = ClipPPOLoss(actor, critic, entropy_bonus=False)
optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
for update in range(1, UPDATES + 1):
    observation, _ = worlds.reset(seed=update * WORLDS)
    steps = []
    for _ in range(STEPS):  # whole episodes
        step = TensorDict({"observation": torch.as_tensor(observation).float()}, [WORLDS])
        with torch.no_grad():
            actor(step)
        observation, reward, _, cut, infos = worlds.step(step["action"].numpy())
        after = np.stack(infos["final_obs"]) if cut.all() else observation
        step["next", "observation"] = torch.as_tensor(after).float()
        step["next", "reward"] = torch.as_tensor(reward).float()[:, None]
        step["next", "done"] = torch.as_tensor(cut)[:, None]
        step["next", "terminated"] = torch.zeros(WORLDS, 1, dtype=torch.bool)  # truncated
        steps.append(step)
    episodes = torch.stack(steps, dim=1)  # (worlds, steps)
    with torch.no_grad():
        rows = advantage(episodes).reshape(-1)
    for chosen in (part for _ in range(EPOCHS) for part in torch.randperm(len(rows)).split(MINIBATCH)):
        lost = loss(rows[chosen])
        optimizer.zero_grad()
        (lost["loss_objective"] + lost["loss_critic"]).backward()
        optimizer.step()
    success, total = infos["final_info"]["success"].mean(), episodes["next", "reward"].sum(dim=1).mean()
    print(f"{update * WORLDS * STEPS:9,} steps  reward {total:7.1f}  success {success:.0%}")

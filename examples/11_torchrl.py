"""TorchRL's PPO on many worlds: ``python 11_torchrl.py``

Needs ``torchrl`` and PyTorch; takes a number of updates and one of worlds.
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


def network(size: int, *last: nn.Module) -> nn.Module:
    return nn.Sequential(
        nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, size), *last
    )


mean_and_deviation = network(2 * outputs, NormalParamExtractor(scale_mapping="biased_softplus_0.4"))
actor = ProbabilisticActor(
    TensorDictModule(mean_and_deviation, in_keys=["observation"], out_keys=["loc", "scale"]),
    in_keys=["loc", "scale"],
    distribution_class=IndependentNormal,
    return_log_prob=True,
)
critic = ValueOperator(network(1), in_keys=["observation"])
advantage = GAE(gamma=0.97, lmbda=0.95, value_network=critic)
loss = ClipPPOLoss(actor, critic, entropy_bonus=False)
optimizer = torch.optim.Adam(loss.parameters(), lr=3e-4)
for update in range(1, UPDATES + 1):
    observation, _ = worlds.reset(seed=update * WORLDS)
    steps = []
    for _ in range(STEPS):  # every world's whole episode
        step = TensorDict({"observation": torch.as_tensor(observation, dtype=torch.float32)}, [WORLDS])
        with torch.no_grad():
            actor(step)
        observation, reward, _, cut, infos = worlds.step(step["action"].numpy())
        after = (
            np.stack(infos["final_obs"]) if cut.all() else observation
        )  # an end is followed by a beginning
        step["next"] = TensorDict(
            {
                "observation": torch.as_tensor(after, dtype=torch.float32),
                "reward": torch.as_tensor(reward, dtype=torch.float32)[:, None],
                "terminated": torch.zeros(WORLDS, 1, dtype=torch.bool),  # cut off, not over
                "done": torch.as_tensor(cut)[:, None],
            },
            [WORLDS],
        )
        steps.append(step)
    episodes = torch.stack(steps, dim=1)  # (worlds, steps)
    with torch.no_grad():
        advantage(episodes)
    rows = episodes.reshape(-1)
    for chosen in (part for _ in range(EPOCHS) for part in torch.randperm(len(rows)).split(MINIBATCH)):
        told = loss(rows[chosen])
        optimizer.zero_grad()
        (told["loss_objective"] + told["loss_critic"]).backward()
        optimizer.step()
    fed = infos["final_info"]["success"].mean()
    total = episodes["next", "reward"].sum(dim=1).mean()
    print(f"{update * WORLDS * STEPS:9,} steps  reward {total:7.1f}  success {fed:.0%}")

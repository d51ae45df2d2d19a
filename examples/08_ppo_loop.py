"""PPO in one file, in CleanRL's style, as a start for your own trainer: ``python 08_ppo_loop.py``

Needs PyTorch; arguments: updates, worlds. Schulman et al., "Proximal Policy Optimization", 2017.
"""

import sys

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import avrgym  # noqa: F401  registers the environments

UPDATES, WORLDS = map(int, sys.argv[1:] or (100, 32))
STEPS, EPOCHS, MINIBATCH, GAMMA, LAMBDA, CLIP = 200, 10, 640, 0.97, 0.95, 0.2
torch.manual_seed(0)
worlds = gym.make_vec("avrgym/FeedingJaco-v1", num_envs=WORLDS, people="original")
inputs, outputs = worlds.single_observation_space.shape[0], worlds.single_action_space.shape[0]
actor, critic = (
    nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, size))
    for size in (outputs, 1)
)
log_std = nn.Parameter(torch.full((outputs,), -0.7))
optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=3e-4)
observed = [worlds.reset(seed=0)[0]]  # normalise by an episode of random actions
observed += [worlds.step(worlds.action_space.sample())[0] for _ in range(STEPS)]
mean, deviation = np.mean(observed, axis=(0, 1)), np.std(observed, axis=(0, 1)) + 0.01
for update in range(1, UPDATES + 1):
    observation, _ = worlds.reset(seed=update * WORLDS)
    states, actions, rewards = [], [], []
    for _ in range(STEPS):  # whole episodes
        states.append(torch.as_tensor((observation - mean) / deviation, dtype=torch.float32))
        with torch.no_grad():
            actions.append(Normal(actor(states[-1]), log_std.exp()).sample())
        observation, reward, _, _, infos = worlds.step(actions[-1].numpy())
        rewards.append(torch.as_tensor(reward, dtype=torch.float32))
    last = (np.stack(infos["final_obs"]) - mean) / deviation  # truncated: its value counts
    with torch.no_grad():
        values = critic(torch.stack([*states, torch.as_tensor(last, dtype=torch.float32)])).squeeze(-1)
        advantages, after = torch.zeros(STEPS, WORLDS), torch.zeros(WORLDS)
        for step in reversed(range(STEPS)):
            after = rewards[step] + GAMMA * values[step + 1] - values[step] + GAMMA * LAMBDA * after
            advantages[step] = after
        state, action = torch.cat(states), torch.cat(actions)
        before = Normal(actor(state), log_std.exp()).log_prob(action).sum(-1)
        gain, returns = advantages.flatten(), (advantages + values[:-1]).flatten()
    for chosen in (part for _ in range(EPOCHS) for part in torch.randperm(len(state)).split(MINIBATCH)):
        now = Normal(actor(state[chosen]), log_std.exp()).log_prob(action[chosen]).sum(-1)
        ratio = (now - before[chosen]).exp()
        better = (gain[chosen] - gain[chosen].mean()) / (gain[chosen].std() + 1e-8)
        surrogate = torch.min(ratio * better, ratio.clamp(1 - CLIP, 1 + CLIP) * better).mean()
        value_loss = (critic(state[chosen]).squeeze(-1) - returns[chosen]).square().mean()
        optimizer.zero_grad()
        (0.5 * value_loss - surrogate).backward()
        optimizer.step()
    success = infos["final_info"]["success"].mean()
    print(f"{update * WORLDS * STEPS:9,} steps  reward {sum(rewards).mean():7.1f}  success {success:.0%}")

#!/bin/bash
# sbatch slurm.sh; send it again to go on where the time limit cut it off
#SBATCH --job-name=avrgym
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=16
#SBATCH --time=12:00:00
set -euo pipefail
source "$HOME/avrgym/bin/activate"
out=runs/drinking

head=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
address=$head:6379
srun --nodes=1 --ntasks=1 -w "$head" ray start --head --port=6379 --num-cpus=15 --block &
sleep 30
srun --nodes=$((SLURM_NNODES - 1)) --ntasks=$((SLURM_NNODES - 1)) -x "$head" \
    ray start --address="$address" --num-cpus=16 --block &
sleep 30

if [ -e "$out/configuration.json" ]; then
    avrgym train avrgym/DrinkingJaco-v1 --out "$out" --cluster "$address" --resume
else
    avrgym train avrgym/DrinkingJaco-v1 --out "$out" --cluster "$address" --worlds 2048 --steps 50000000
fi

"""Loads a CROSS policy into PyTorch and runs its recurrent unit: load_checkpoint.py RUN/checkpoints/ID/model.safetensors"""
import json
import sys

import torch
from safetensors import safe_open

with safe_open(sys.argv[1], framework="pt") as file:
    about = json.loads(file.metadata()["cross"])
    weights = {name: file.get_tensor(name) for name in file.keys()}
model = json.loads(about["model"])
print(about["format"], about["format_version"], "policy version", about["policy_version"], "gfe", model["gfe"])
for network in ("actor", "critic"):
    own = {name: tensor for name, tensor in weights.items() if name.startswith(f"{network}.")}
    gru = torch.nn.GRU(model["hidden"], model["hidden"], batch_first=True)
    gru.load_state_dict({f"{name}_l0": own[f"{network}.gfe.gru.{name}"] for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")})
    with torch.no_grad():
        _, state = gru(torch.ones(1, 10, model["hidden"]))
    print(network, sum(tensor.numel() for tensor in own.values()), "numbers; state after ten steps of ones:", f"{state.norm():.5f}")

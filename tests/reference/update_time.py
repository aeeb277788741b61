"""Times a PPO update of the PyTorch reference (`golden.py`) on the batch of `cross bench update`, on one thread.

    python3 -m venv /tmp/torchenv
    /tmp/torchenv/bin/pip install torch==2.11.0 numpy safetensors
    target/release/cross bench update --export /tmp/batch               # the batch, for both forms
    target/release/cross bench update --json > /tmp/update.json         # our time, for the last column
    /tmp/torchenv/bin/python tests/reference/update_time.py /tmp/batch --ours /tmp/update.json

Weights, minibatches and their order are those of the Rust program; the losses of the first minibatch are compared with the
ones it wrote. Computed in float32 with torch's own GRU, which the reference writes out step by step. Only forward passes,
losses, backward passes and Adam are timed, in processor time: features, values and advantages are ready in the file.
"""

import argparse
import json
import pathlib
import statistics
import sys
import time

import torch
from safetensors import safe_open

import golden

torch.set_default_dtype(torch.float32)
golden.STRICT = False


class Network(golden.Network):
    """The reference with the library's GRU."""

    def gru(self, xs, h):
        weights = [self.w[f"gfe.gru.{part}"] for part in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")]
        return torch.gru(xs, h[None], weights, True, 1, 0.0, False, False, False)[0]


class Batch:
    """An exported epoch: configuration, weights, minibatches as the reference wants them ([T, N, ...])."""

    def __init__(self, path):
        with safe_open(path, "pt") as file:
            metadata = json.loads(file.metadata()["cross"])
            self.config = json.loads(metadata["config"])
            self.tensors = {name: file.get_tensor(name) for name in file.keys()}
        self.minibatches = [self.minibatch(str(i)) for i in range(int(metadata["minibatches"]))]
        self.expected = [self.tensors[f"0/{network}_loss"].item() for network in golden.NETWORKS]

    def weights(self):
        own = {name.removeprefix("weight/"): value for name, value in self.tensors.items() if name.startswith("weight/")}
        return {name: value.clone().requires_grad_() for name, value in own.items()}

    def minibatch(self, number):
        own = {name.split("/")[1]: value for name, value in self.tensors.items() if name.split("/")[0] == number}
        by_step = lambda name: own[name].transpose(0, 1).contiguous()
        mask = lambda name: by_step(name) > 0.5
        x = {"I": by_step("topology"), "phase_mask": mask("phase_mask")}
        if self.config["model"]["gfe"] == "paper":
            x["S"] = by_step("states").unflatten(-1, (-1, 5))
            x["G"] = by_step("greens")
            x["movement_mask"] = by_step("real").unflatten(-1, (-1, 5))[..., 0] > 0.5
        else:
            x |= {"X": by_step("phases"), "context": by_step("context"), "lanes": by_step("lanes"), "lane_mask": mask("lane_mask")}
        target = {name: by_step(name) for name in ("log_probs", "advantages", "returns", "next")}
        target |= {"actions": by_step("actions").long(), "has_next": mask("has_next")}
        return x, target, {network: own[f"{network}_state"] for network in golden.NETWORKS}


class Learner:
    """Both networks with their optimisers."""

    def __init__(self, batch):
        self.config, weights = batch.config, batch.weights()
        self.nets, self.own, self.optimisers = {}, {}, {}
        for network in golden.NETWORKS:
            self.nets[network] = Network(network, weights, self.config)
            self.own[network] = [w for name, w in weights.items() if name.startswith(network + ".")]
            self.optimisers[network] = torch.optim.Adam(self.own[network], lr=self.config["ppo"][f"{network}_lr"])

    def losses(self, minibatch):
        x, target, starts = minibatch
        with torch.no_grad():
            return [
                golden.losses(self.config, network, self.nets[network](x, starts[network]), x, target)[0].item()
                for network in golden.NETWORKS
            ]

    def step(self, minibatch):
        x, target, starts = minibatch
        for network in golden.NETWORKS:
            self.optimisers[network].zero_grad()
            golden.losses(self.config, network, self.nets[network](x, starts[network]), x, target)[0].backward()
            torch.nn.utils.clip_grad_norm_(self.own[network], self.config["ppo"]["max_grad_norm"])
            self.optimisers[network].step()


def ours(path, form):
    """Seconds of an update from `cross bench update --json`."""
    rows = json.loads(path.read_text())["rows"]
    return next((row["ours"] for row in rows if row["case"].startswith(f"update, {form},")), None)


def main():
    parser = argparse.ArgumentParser(description="times an update of the PyTorch reference")
    parser.add_argument("folder", type=pathlib.Path, help="what cross bench update --export wrote")
    parser.add_argument("--ours", type=pathlib.Path, help="what cross bench update --json printed")
    parser.add_argument("--epochs", type=int, help="epochs that really run; the rest is scaled (default: all)")
    parser.add_argument("--repeats", type=int, default=1, help="repetitions, of which the median counts (default: %(default)s)")
    args = parser.parse_args()
    files = [path for form in ("paper", "movement") if (path := args.folder / f"{form}.safetensors").exists()]
    if not files:
        print(f"{args.folder} holds no batch; write one with: cross bench update --export {args.folder}", file=sys.stderr)
        return 2
    for path in files:
        batch = Batch(path)
        learner = Learner(batch)
        found = learner.losses(batch.minibatches[0])
        for network, a, b in zip(golden.NETWORKS, found, batch.expected):
            if abs(a - b) > 1e-4 * max(abs(b), 0.1):
                print(f"{path.stem}: the {network}'s loss is {a}, the Rust program's {b}: not the same computation", file=sys.stderr)
                return 1
        wanted = batch.config["ppo"]["epochs"]
        epochs = min(args.epochs or wanted, wanted)
        times = []
        for _ in range(args.repeats):
            start = time.process_time()
            for _ in range(epochs):
                for minibatch in batch.minibatches:
                    learner.step(minibatch)
            times.append((time.process_time() - start) * wanted / epochs)
        seconds = statistics.median(times)
        line = f"{path.stem}: PyTorch {torch.__version__} {seconds:.1f} CPU s an update of {wanted} epochs"
        if epochs < wanted:
            line += f" (scaled from {epochs})"
        if args.ours and (own := ours(args.ours, path.stem)):
            line += f"; ours {own:.1f} s; {seconds / own:.2f} times faster"
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

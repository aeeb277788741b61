"""A slow, padded, paper-shaped CROSS in PyTorch, and the golden numbers that the Rust model is held against.

It shares no code, no weights and no data with the Rust model: everything is drawn here from fixed seeds, computed in
double precision on tensors padded to the most phases, movements and lanes ([T, N, P, ...] with masks), and written to
`model/tests/fixtures/*.safetensors`, which `model/tests/golden.rs` reproduces. Only developers run it, after a change of
what the model computes:

    python3 -m venv /tmp/torchenv
    /tmp/torchenv/bin/pip install torch==2.11.0 numpy safetensors
    /tmp/torchenv/bin/python tests/reference/golden.py            # writes the fixtures
    /tmp/torchenv/bin/python tests/reference/golden.py --check    # computes them anew and compares

Parameters bear the Rust model's names and shapes. Section numbers are the paper's; what it leaves open is in docs/model.md.

A fixture holds, as float32, `weight/*`, `feature/*`, `forward/{actor,critic}/*`, `target/*`, `loss/{actor,critic}/*`,
`grad/*`, `norm/*`, and `after/*` (weights after three Adam steps); its metadata key `golden` holds configuration,
layouts and fragments as JSON. Rows are in order of fragments, agents, sequences, steps, phases: the masks' order.
"""

import argparse
import json
import math
import pathlib
import sys

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file

torch.set_num_threads(1)
torch.set_default_dtype(torch.float64)

# Whether a draw too close to an edge, where rounding would decide, stops the program: for fixtures, not for timing.
STRICT = True
MAX_ROADS = 7
ADAM_STEPS = 3
SEQUENCE_STEPS = 2
NETWORKS = ("actor", "critic")

# Every weight and temperature differs from every other and is large enough that a term gone wrong shows in the gradients.
PPO = {
    "epochs": ADAM_STEPS, "sequence_steps": SEQUENCE_STEPS, "minibatch_decisions": 1_000_000,
    "actor_lr": 2e-3, "critic_lr": 3e-3, "max_grad_norm": 0.7, "clip_ratio": 0.15, "gamma": 0.9, "gae_lambda": 0.8,
    "entropy": 0.05, "value": 0.6, "prediction": 0.45, "clustering": 0.35, "diversity": 0.8, "load_balance": 0.25,
    "selection_entropy": 0.2, "normalise_advantages": True, "reward_scale": "capacity", "reward_factor": 5.0,
}
MODEL = {
    "gfe": "movement", "lane_green": "strongest", "pcc": True, "moe": True, "hidden": 12, "latent": 6, "heads": 3,
    "clusters": 6, "experts": 6, "top_k": 2, "tau_k": 0.3, "tau_c": 0.2, "tau_r": 0.7, "detach_contrastive_target": True,
}
# name: (seed, detection, changes of the model, changes of the algorithm)
FIXTURES = {
    "paper": (11, "paper", {"gfe": "paper", "hidden": 8, "heads": 2, "latent": 4, "clusters": 5, "experts": 5}, {}),
    "movement": (22, "default", {"lane_green": "mean"}, {}),
    "movement_without_pcc": (
        33, "paper", {"pcc": False, "hidden": 8, "heads": 2, "experts": 4, "top_k": 3},
        {"reward_scale": "raw", "reward_factor": 0.3},
    ),
    "movement_without_moe": (
        44, "default", {"moe": False, "hidden": 8, "heads": 1, "detach_contrastive_target": False},
        {"normalise_advantages": False, "max_grad_norm": 10.0},
    ),
}
# Phases, movements, incoming lanes, outgoing lanes, roads in, roads out of every intersection. Four phases occur
# twice with other numbers of lanes, so that lanes are padded among equals too.
SCENARIOS = {
    "alpha": [(3, 5, 4, 3, 3, 3), (8, 36, 14, 12, 5, 4), (4, 12, 8, 6, 4, 4)],
    "beta": [(4, 20, 12, 10, 6, 7), (5, 9, 5, 6, 3, 4), (6, 14, 7, 5, 2, 2), (7, 25, 10, 8, 4, 5)],
}
MAX_MOVEMENTS, MAX_PHASES = 36, 8


# ---------------------------------------------------------------------------------------------------------- inputs


def draw_intersection(rng, name, phases, movements, n_in, n_out, roads_in, roads_out):
    """A made-up intersection: every lane has a movement, every phase a green, some greens permissive."""
    quarters = lambda low, high: float(rng.integers(4 * low, 4 * high)) / 4
    lane = lambda i: {"id": i, "length": quarters(30, 400), "speed": 13.75}
    incoming = sorted(list(range(n_in)) + list(rng.integers(0, n_in, movements - n_in)))
    outgoing = list(range(n_out)) + list(rng.integers(0, n_out, movements - n_out))
    rng.shuffle(outgoing)
    greens = rng.choice([0.0, 0.5, 1.0], size=(phases, movements), p=[0.6, 0.15, 0.25])
    greens[np.arange(phases), rng.permutation(movements)[:phases]] = 1.0
    road = lambda i: {
        "id": i, "length": quarters(30, 600), "speed": quarters(8, 28),
        "lanes": int(rng.integers(1, 5)), "movements": int(rng.integers(1, 10)),
    }
    return {
        "id": name, "position": [0.0, 0.0],
        "incoming": [lane(f"{name}_in{i}") for i in range(n_in)],
        "outgoing": [lane(f"{name}_out{i}") for i in range(n_out)],
        "movements": [{"incoming": int(i), "outgoing": int(o)} for i, o in zip(incoming, outgoing)],
        "phases": [{"state": "".join({0.0: "r", 0.5: "g", 1.0: "G"}[g] for g in row), "green": row.tolist()} for row in greens],
        "roads_in": [road(f"{name}_rin{i}") for i in range(roads_in)],
        "roads_out": [road(f"{name}_rout{i}") for i in range(roads_out)],
    }


def draw_episode(rng, layout, bands, steps, start, end):
    """What a network showed and what its agents did over `steps` steps; `start` is its first step's number."""
    rows = sum(len(j["incoming"]) + len(j["outgoing"]) for j in layout)
    counts = rng.integers(0, 13, (steps + 1, rows, bands))
    limits = np.array([len(j["phases"]) for j in layout])
    phases = rng.integers(0, limits, (steps + 1, len(layout)))
    return {
        "counts": counts, "phases": phases, "actions": phases[1:], "start": start, "end": end,
        "rewards": -rng.integers(0, 30, (steps, len(layout))).astype(float),
    }


# -------------------------------------------------------------------------------------------------------- features


def lane_rows(layout):
    """First lane row of each agent in an observation."""
    sizes = [len(j["incoming"]) + len(j["outgoing"]) for j in layout]
    return np.cumsum([0] + sizes[:-1])


def topology(junction, form):
    """I_i (III-B): type, phase configuration, roads."""
    kinds = [0.0] * 3
    kinds[0 if len(junction["roads_in"]) <= 3 else 1 if len(junction["roads_in"]) == 4 else 2] = 1.0
    counts = [float(len(junction["phases"]) == n) for n in range(2, MAX_PHASES + 1)]
    out = kinds + counts
    for side, width in (("roads_in", 4), ("roads_out", 3)):
        roads = np.array([[r["length"] / 300, r["speed"] / 30, r["lanes"] / 8, r["movements"] / 8] for r in junction[side]])
        roads = roads[:, :width]
        if form == "paper":
            padded = np.zeros((MAX_ROADS, width))
            padded[: len(roads)] = roads
            out += padded.flatten().tolist()
        else:
            out += roads.mean(0).tolist() + roads.max(0).tolist()
    return np.array(out)


def paper_state(junction, counts, current):
    """S_i (III-B): [P_in, Q_in, Q_out, N_in, N_out] of every movement, padded; counts [lanes, bands]."""
    state = np.zeros((MAX_MOVEMENTS, 5))
    for m, movement in enumerate(junction["movements"]):
        a, b = counts[movement["incoming"]], counts[len(junction["incoming"]) + movement["outgoing"]]
        green = junction["phases"][current]["green"][m]
        state[m] = [green, a[0] / 10, b[0] / 10, a[1:].sum() / 10, b[1:].sum() / 10]
    return state


def phase_features(junction, counts, current, lane_green):
    """Per phase: summed counts of green lanes in and out by band, is it current, green lanes in and out."""
    out = []
    for p, phase in enumerate(junction["phases"]):
        sums, opened = [], []
        for side, base in (("incoming", 0), ("outgoing", len(junction["incoming"]))):
            of_lane = {}
            for movement, green in zip(junction["movements"], phase["green"]):
                of_lane.setdefault(movement[side], []).append(green)
            together = np.mean if side == "incoming" and lane_green == "mean" else max
            weights = {lane: together(greens) for lane, greens in of_lane.items()}
            sums += list(sum(g * counts[base + lane] / 10 for lane, g in weights.items()))
            opened.append(sum(g > 0 for g in weights.values()) / 8)
        out.append(sums + [float(p == current)] + opened)
    return np.array(out)


def lane_tokens(junction, counts):
    """Per lane: counts by band, incoming, outgoing, length."""
    rows = []
    for i, lane in enumerate(junction["incoming"] + junction["outgoing"]):
        inward = float(i < len(junction["incoming"]))
        rows.append([*(counts[i] / 10), inward, 1 - inward, lane["length"] / 300])
    return np.array(rows)


def agent_inputs(config, layout, agent, episode):
    """All inputs of one agent over an episode's T+1 observations, padded to the limits of the whole fixture."""
    junction, first, form = layout[agent], lane_rows(layout)[agent], config["model"]["gfe"]
    lanes = len(junction["incoming"]) + len(junction["outgoing"])
    most_lanes = max(n_in + n_out for spec in SCENARIOS.values() for _, _, n_in, n_out, _, _ in spec)
    own = episode["counts"][:, first : first + lanes]
    current = episode["phases"][:, agent]
    steps, phases = len(own), len(junction["phases"])
    pad = lambda x, axis, size: np.pad(x, [(0, size - x.shape[a]) if a == axis else (0, 0) for a in range(x.ndim)])
    out = {
        "I": topology(junction, form),
        "phase_mask": np.arange(MAX_PHASES) < phases,
        "movement_mask": np.arange(MAX_MOVEMENTS) < len(junction["movements"]),
        "lane_mask": np.arange(most_lanes) < lanes,
    }
    constant = list(out)
    if form == "paper":
        greens = pad(np.array([p["green"] for p in junction["phases"]]), 1, MAX_MOVEMENTS)
        out["G"] = pad(greens, 0, MAX_PHASES)
        constant.append("G")
        out["S"] = np.stack([paper_state(junction, c, p) for c, p in zip(own, current)])
    else:
        real = np.stack([phase_features(junction, c, p, config["model"]["lane_green"]) for c, p in zip(own, current)])
        out["context"] = np.concatenate([real.mean(1), real.max(1)], 1)
        out["X"] = pad(real, 1, MAX_PHASES)
        out["lanes"] = pad(np.stack([lane_tokens(junction, c) for c in own]), 1, most_lanes)
    for key in constant:
        out[key] = np.broadcast_to(out[key], (steps, *out[key].shape))
    return {k: torch.tensor(np.ascontiguousarray(v)) for k, v in out.items()}


def stack(agents):
    """Inputs of several agents, each [T, ...], as [T, N, ...]."""
    return {key: torch.stack([a[key] for a in agents], 1) for key in agents[0]}


# --------------------------------------------------------------------------------------------------------- network


def parameter_shapes(config, bands):
    """Names and shapes of one network's parameters."""
    m = config["model"]
    d, dz, out = m["hidden"], m["latent"], {}

    def linear(name, inputs, outputs, bias=True):
        out[f"{name}.weight"] = (outputs, inputs)
        if bias:
            out[f"{name}.bias"] = (outputs,)

    def mlp(name, inputs, hidden, outputs):
        linear(f"{name}.0", inputs, hidden)
        linear(f"{name}.1", hidden, outputs)

    def norm(name, width):
        out[f"{name}.weight"] = out[f"{name}.bias"] = (width,)

    one_hots = 3 + MAX_PHASES - 1
    if m["gfe"] == "paper":
        phase, state, target, topo = MAX_MOVEMENTS, MAX_MOVEMENTS * 5, MAX_MOVEMENTS * 5, one_hots + MAX_ROADS * 7
        mlp("gfe.phase", phase, 64, d)
        mlp("gfe.state", state, d, d)
    else:
        phase, state, target, topo = 2 * bands + 3, 2 * (2 * bands + 3), 2 * bands, one_hots + 2 * 7
        mlp("gfe.phase", phase, d, d)
        mlp("gfe.state", 2 * d, d, d)
        norm("gfe.attention.norm", d)
        linear("gfe.attention.query", d, d)
        linear("gfe.attention.state_key", d, d)
        linear("gfe.attention.lane_key", bands + 3, d, bias=False)
        linear("gfe.attention.lane_value", bands + 3, d, bias=False)
    for part in ("weight_ih", "weight_hh"):
        out[f"gfe.gru.{part}"] = (3 * d, d)
    for part in ("bias_ih", "bias_hh"):
        out[f"gfe.gru.{part}"] = (3 * d,)
    linear("gfe.value", d, d)
    linear("gfe.output", d, d)
    if m["pcc"]:
        linear("pcc.phase", phase, 2 * d, bias=False)
        linear("pcc.state", state, 2 * d, bias=False)
        linear("pcc.topology", topo, 2 * d)
        linear("pcc.second", d, dz)
        linear("pcc.predict", dz, target)
        linear("pcc.project", dz, dz)
        norm("pcc.norm", dz)
        out["pcc.centres"] = (m["clusters"], dz)
    if m["moe"]:
        mlp("moe.router", d + (dz if m["pcc"] else 0), d, m["experts"])
        for e in range(m["experts"]):
            mlp(f"moe.expert{e}", d, d, d)
    else:
        mlp("moe.dense", d, m["top_k"] * d, d)
    linear("head", d, 1)
    return out


def draw_weights(rng, config, bands):
    """Weights that are exact in float32; larger than a fresh network's, so that nothing is nearly uniform."""
    out = {}
    for network in NETWORKS:
        for name, shape in parameter_shapes(config, bands).items():
            values = rng.uniform(-1, 1, shape) * (1.6 / math.sqrt(shape[-1]) if len(shape) == 2 else 0.3)
            if name.endswith("norm.weight"):
                values = values + 1
            out[f"{network}.{name}"] = torch.tensor(values.astype(np.float32).astype(np.float64), requires_grad=True)
    return out


class Network:
    """One CROSS network (IV) on padded inputs."""

    def __init__(self, prefix, weights, config):
        self.w = {name.removeprefix(prefix + "."): value for name, value in weights.items() if name.startswith(prefix + ".")}
        self.model = config["model"]

    def linear(self, name, x):
        y = x @ self.w[f"{name}.weight"].T
        return y + self.w[f"{name}.bias"] if f"{name}.bias" in self.w else y

    def mlp(self, name, x):
        return self.linear(f"{name}.1", torch.relu(self.linear(f"{name}.0", x)))

    def norm(self, name, x):
        centred = x - x.mean(-1, keepdim=True)
        scaled = centred / torch.sqrt((centred**2).mean(-1, keepdim=True) + 1e-5)
        return scaled * self.w[f"{name}.weight"] + self.w[f"{name}.bias"]

    def gru(self, xs, h):
        """xs [T, N, d], h [N, d]: the state after every step [T, N, d]."""
        out = []
        for x in xs:
            ir, iz, i_n = (x @ self.w["gfe.gru.weight_ih"].T + self.w["gfe.gru.bias_ih"]).chunk(3, -1)
            hr, hz, hn = (h @ self.w["gfe.gru.weight_hh"].T + self.w["gfe.gru.bias_hh"]).chunk(3, -1)
            r, z = torch.sigmoid(ir + hr), torch.sigmoid(iz + hz)
            h = (1 - z) * torch.tanh(i_n + r * hn) + z * h
            out.append(h)
        return torch.stack(out)

    def attention(self, query, keys, values, mask):
        """query [T, N, P, d], keys and values [T, N, L, d], mask [T, N, L]: multi-head attention [T, N, P, d]."""
        heads = self.model["heads"]
        split = lambda x: x.unflatten(-1, (heads, -1)).transpose(-2, -3)
        q, k, v = split(query), split(keys), split(values)
        scores = q @ k.transpose(-1, -2) / math.sqrt(q.shape[-1])
        scores = scores.masked_fill(~mask[:, :, None, None, :], -torch.inf)
        return (scores.softmax(-1) @ v).transpose(-2, -3).flatten(-2)

    def gfe(self, x, h0):
        """IV-A. h_sp [T, N, P, d] and the recurrent states [T, N, d]."""
        mask = x["phase_mask"]
        if self.model["gfe"] == "paper":
            h_p = self.mlp("gfe.phase", x["G"])
            e = self.mlp("gfe.state", x["S"].flatten(2))
        else:
            h_p = self.mlp("gfe.phase", x["X"])
            real = h_p.masked_fill(~mask[..., None], 0)
            mean = real.sum(2) / mask.sum(2, keepdim=True)
            most = h_p.masked_fill(~mask[..., None], -torch.inf).amax(2)
            e = self.mlp("gfe.state", torch.cat([mean, most], -1))
        states = self.gru(e, h0)
        h_s = e + states
        token, one = h_s[:, :, None], torch.ones_like(mask[:, :, :1])
        value = self.linear("gfe.value", token)
        if self.model["gfe"] == "paper":
            # Queries and keys are arbitrary: over one token the softmax is 1 whatever they are.
            generator = torch.Generator().manual_seed(5)
            w_q, w_k = torch.randn(2, h_p.shape[-1], h_p.shape[-1], generator=generator)
            attended = self.attention(h_p @ w_q, token @ w_k, value, one)
        else:
            query = self.linear("gfe.attention.query", self.norm("gfe.attention.norm", h_p))
            lane = lambda part: self.linear(f"gfe.attention.lane_{part}", x["lanes"])
            keys = torch.cat([lane("key"), self.linear("gfe.attention.state_key", token)], 2)
            values = torch.cat([lane("value"), value], 2)
            attended = self.attention(query, keys, values, torch.cat([x["lane_mask"], one], 2))
        return h_p + self.linear("gfe.output", attended), states

    def pcc(self, x):
        """IV-B, from the concatenation x = [S, G^p, I] of every phase."""
        if self.model["gfe"] == "paper":
            state, phase = x["S"].flatten(2), x["G"]
        else:
            state, phase = x["context"], x["X"]
        spread = lambda y: y[:, :, None].expand(-1, -1, MAX_PHASES, -1)
        joined = torch.cat([spread(state), phase, spread(x["I"])], -1)
        weight = torch.cat([self.w[f"pcc.{part}.weight"] for part in ("state", "phase", "topology")], 1)
        a, b = (joined @ weight.T + self.w["pcc.topology.bias"]).chunk(2, -1)
        z = self.linear("pcc.second", a * torch.sigmoid(b))
        phi, centres = self.norm("pcc.norm", self.linear("pcc.project", z)), self.w["pcc.centres"]
        dots = phi @ centres.T
        similarity = dots / (torch.linalg.norm(phi, dim=-1, keepdim=True) * torch.linalg.norm(centres, dim=-1))
        w = torch.softmax(similarity / self.model["tau_k"], -1)
        return {"z": z, "similarity": similarity, "w": w, "z_hat": w @ centres, "predicted": self.linear("pcc.predict", z)}

    def moe(self, h_sp, z_hat):
        """IV-C. All experts run; those not chosen have weight zero."""
        if not self.model["moe"]:
            return self.mlp("moe.dense", h_sp), None
        routed = h_sp if z_hat is None else torch.cat([h_sp, z_hat], -1)
        logits = self.mlp("moe.router", routed) / self.model["tau_r"]
        best = logits.topk(min(self.model["top_k"] + 1, self.model["experts"]), -1).values
        self.gate_margin = best[..., -2] - best[..., -1]
        kept = logits >= best[..., self.model["top_k"] - 1, None]
        alpha = torch.softmax(logits.masked_fill(~kept, -torch.inf), -1)
        outputs = torch.stack([self.mlp(f"moe.expert{e}", h_sp) for e in range(self.model["experts"])], -2)
        return (alpha[..., None] * outputs).sum(-2), alpha

    def __call__(self, x, h0):
        h_sp, states = self.gfe(x, h0)
        out = {"states": states, "h_sp": h_sp}
        if self.model["pcc"]:
            out |= self.pcc(x)
        out["h_moe"], alpha = self.moe(h_sp, out.get("z_hat"))
        if alpha is not None:
            out["alpha"] = alpha
            real = self.gate_margin[x["phase_mask"]].min().item()
            assert real > 1e-5 or not STRICT, f"experts too close to call ({real}): take another seed"
        out["scores"] = self.linear("head", out["h_moe"])[..., 0]
        return out


def policy(scores, mask):
    """Log-probabilities [T, N, P], minus infinity on padding."""
    return torch.log_softmax(scores.masked_fill(~mask, -torch.inf), -1)


def value(scores, mask):
    """Mean over the real phases [T, N]."""
    return scores.masked_fill(~mask, 0).sum(-1) / mask.sum(-1)


# ------------------------------------------------------------------------------------------------------ objectives


def entropy(p, dim=-1):
    """Shannon entropy, with 0 log 0 = 0."""
    positive = p > 0
    return -(p * torch.where(positive, p, torch.ones_like(p)).log()).sum(dim)


def auxiliary(config, out, x, target):
    """Terms of IV-B and IV-C, by name."""
    terms, model, mask = {}, config["model"], x["phase_mask"]
    if model["pcc"]:
        taken = target["actions"][..., None, None].expand(-1, -1, 1, out["predicted"].shape[-1])
        chosen = out["predicted"].gather(2, taken)[:, :, 0]
        real = target["has_next"][..., None].expand_as(chosen).clone()
        if model["gfe"] == "paper":
            real &= x["movement_mask"].repeat_interleave(5, dim=-1)
        terms["prediction"] = ((chosen - target["next"]) ** 2)[real].mean()
        w, similarity = out["w"][mask], out["similarity"][mask]
        aim = w.detach() if model["detach_contrastive_target"] else w
        terms["contrastive"] = -(aim * torch.log_softmax(similarity / model["tau_c"], -1)).sum(-1).mean()
        terms["diversity"] = 1 - entropy(w.mean(0)) / math.log(model["clusters"])
    if model["moe"]:
        alpha = out["alpha"][mask]
        f = alpha.sum(0) / alpha.sum()
        used = f > 0
        terms["load_balance"] = (f[used] * (f[used] * model["experts"]).log()).sum()
        terms["selection_entropy"] = entropy(alpha).mean()
    return terms


def losses(config, network, out, x, target):
    """Terms of one network's loss, and their weighted sum (IV-D)."""
    ppo, mask = config["ppo"], x["phase_mask"]
    weights = {
        "policy": 1.0, "entropy": -ppo["entropy"], "value": ppo["value"], "prediction": ppo["prediction"],
        "contrastive": ppo["clustering"], "diversity": ppo["clustering"] * ppo["diversity"],
        "load_balance": ppo["load_balance"], "selection_entropy": ppo["selection_entropy"],
    }
    if network == "actor":
        log_p = policy(out["scores"], mask)
        kappa = torch.exp(log_p.gather(2, target["actions"][..., None])[..., 0] - target["log_probs"])
        low, high = 1 - ppo["clip_ratio"], 1 + ppo["clip_ratio"]
        margin = torch.minimum((kappa - low).abs(), (kappa - high).abs()).min().item()
        assert margin > 1e-5 or not STRICT, f"a ratio too close to the clip range's edge ({margin}): take another seed"
        a = target["advantages"]
        terms = {"policy": -torch.minimum(kappa * a, kappa.clamp(low, high) * a).mean()}
        terms["entropy"] = entropy(log_p.exp()).mean()
    else:
        terms = {"value": ((value(out["scores"], mask) - target["returns"]) ** 2).mean()}
    terms |= auxiliary(config, out, x, target)
    return sum(weights[name] * term for name, term in terms.items()), terms


def gae(rewards, values, gamma, lam):
    """Advantages [T, N] by their definition, sum by sum; values [T+1, N], the last row for bootstrapping."""
    delta = rewards + gamma * values[1:] - values[:-1]
    steps = len(rewards)
    return torch.stack([sum((gamma * lam) ** (k - t) * delta[k] for k in range(t, steps)) for t in range(steps)])


# ----------------------------------------------------------------------------------------------------------- rounds


def prepare_episode(config, layout, episode, nets):
    """Adds to an episode what learning needs: inputs, values, advantages, recurrent states. No fragment is seen here."""
    ppo = config["ppo"]
    agents = [agent_inputs(config, layout, i, episode) for i in range(len(layout))]
    x = stack(agents)
    with torch.no_grad():
        outs = {name: nets[name](x, episode["h0"][name]) for name in NETWORKS}
    values = value(outs["critic"]["scores"], x["phase_mask"])
    if episode["end"] == "terminated":
        values = torch.cat([values[:-1], torch.zeros_like(values[:1])])
    scale = torch.full((len(layout),), ppo["reward_factor"])
    if ppo["reward_scale"] == "capacity":
        scale = scale / torch.tensor([7.0 * len(j["incoming"]) for j in layout])
    advantages = gae(torch.tensor(episode["rewards"]) * scale, values, ppo["gamma"], ppo["gae_lambda"])
    if config["model"]["gfe"] == "paper":
        following = x["S"].flatten(2)[1:]
    else:
        pooled = x["X"][1:, ..., : x["X"].shape[-1] - 3]
        taken = torch.tensor(episode["actions"])[..., None, None].expand(-1, -1, 1, pooled.shape[-1])
        following = pooled.gather(2, taken)[:, :, 0]
    has_next = torch.ones(advantages.shape, dtype=torch.bool)
    has_next[-1] = episode["end"] == "continues"
    episode["x"] = x
    episode["states"] = {n: torch.cat([episode["h0"][n][None], outs[n]["states"]])[:-1] for n in NETWORKS}
    taken = torch.tensor(episode["actions"])[..., None]
    episode["policy"] = policy(outs["actor"]["scores"], x["phase_mask"])[:-1].gather(2, taken)[..., 0]
    episode["target"] = {
        "actions": torch.tensor(episode["actions"]), "advantages": advantages, "returns": advantages + values[:-1],
        "next": following, "has_next": has_next,
    }


def normalise(episodes):
    """Advantages of one scenario to mean 0 and deviation 1."""
    every = torch.cat([e["target"]["advantages"].flatten() for e in episodes])
    deviation = ((every - every.mean()) ** 2).mean().sqrt()
    for e in episodes:
        e["target"]["advantages"] = (e["target"]["advantages"] - every.mean()) / (deviation + 1e-8)


def fragments_of(episodes):
    """Fragments as (episode, first step in it, steps, sequence number, end), in an order that is not the episodes'."""
    alpha, first, second = episodes
    return [
        (first, 0, 4, 2, "continues"),
        (alpha, 2, 2, 1, "truncated"),
        (alpha, 0, 2, 0, "continues"),
        (second, 0, 2, 5, "terminated"),
    ]


def fragment_json(fragment):
    """A fragment as an actor would send it."""
    episode, at, steps, sequence, end = fragment
    flat = lambda x: np.asarray(x).flatten().tolist()
    short = lambda x: [float(str(v)) for v in x.to(torch.float32).numpy().flatten()]
    first_step = episode["start"] + at
    recurrent = {n: short(episode["states"][n][at]) if first_step else [] for n in NETWORKS}
    return {
        "scenario": episode["scenario"], "episode": episode["number"], "sequence": sequence, "first_step": first_step,
        "steps": steps, "counts": flat(episode["counts"][at : at + steps + 1]),
        "phases": flat(episode["phases"][at : at + steps + 1]), "actions": flat(episode["actions"][at : at + steps]),
        "log_probs": short(episode["target"]["log_probs"][at : at + steps]),
        "rewards": flat(episode["rewards"][at : at + steps]), "recurrent": recurrent, "end": end,
    }


def sequences(fragments):
    """All training sequences side by side: inputs, targets, start states. Order: fragments, agents, starts."""
    xs, targets, starts = [], [], {n: [] for n in NETWORKS}
    for episode, at, steps, _, _ in fragments:
        for agent in range(episode["actions"].shape[1]):
            for t in range(at, at + steps, SEQUENCE_STEPS):
                cut = lambda v: v[t : t + SEQUENCE_STEPS, agent]
                xs.append({k: cut(v) for k, v in episode["x"].items()})
                targets.append({k: cut(v) for k, v in episode["target"].items()})
                for n in NETWORKS:
                    starts[n].append(episode["states"][n][t, agent])
    return stack(xs), stack(targets), {n: torch.stack(v) for n, v in starts.items()}


def build(name):
    """Tensors and metadata of one fixture."""
    seed, detection, model, ppo = FIXTURES[name]
    rng = np.random.default_rng(seed)
    bands = {"paper": 2, "default": 3, "fine": 6}[detection]
    config = {
        "seed": seed, "scenarios": list(SCENARIOS),
        "env": {"detection": detection, "max_movements": MAX_MOVEMENTS, "max_phases": MAX_PHASES},
        "model": MODEL | model, "ppo": PPO | ppo,
    }
    layouts = {s: [draw_intersection(rng, f"{s}{i}", *spec) for i, spec in enumerate(specs)] for s, specs in SCENARIOS.items()}
    weights = draw_weights(rng, config, bands)
    nets = {n: Network(n, weights, config) for n in NETWORKS}

    plan = [("alpha", 7, 4, 0, "truncated"), ("beta", 8, 4, 20, "continues"), ("beta", 9, 2, 50, "terminated")]
    episodes = []
    for scenario, number, steps, start, end in plan:
        layout = layouts[scenario]
        episode = draw_episode(rng, layout, bands, steps, start, end) | {"scenario": scenario, "number": number}
        h0 = rng.uniform(-0.8, 0.8, (2, len(layout), config["model"]["hidden"])).astype(np.float32) * (start > 0)
        episode["h0"] = dict(zip(NETWORKS, torch.tensor(h0.astype(np.float64))))
        prepare_episode(config, layout, episode, nets)
        # The behaviour policy was a little different, on both sides of the clip range.
        noise = rng.normal(0, 0.2, episode["actions"].shape)
        behaviour = (episode["policy"] + torch.tensor(noise)).clamp(max=-1e-3)
        episode["target"]["log_probs"] = behaviour.float().double()
        episodes.append(episode)
    if config["ppo"]["normalise_advantages"]:
        for scenario in SCENARIOS:
            normalise([e for e in episodes if e["scenario"] == scenario])

    fragments = fragments_of(episodes)
    x, target, starts = sequences(fragments)
    tensors = {f"weight/{n}": w.detach().clone() for n, w in weights.items()}
    add_features(tensors, fragments, layouts, config)
    samples = lambda v: v.transpose(0, 1).flatten(0, 1)
    for key in ("advantages", "returns", "log_probs", "has_next"):
        tensors[f"target/{key}"] = samples(target[key])
    for n in NETWORKS:
        tensors[f"target/{n}_state"] = starts[n]
        learn(config, n, weights, nets[n], x, target, starts[n], tensors)
    golden = {
        "config": config, "layouts": layouts,
        "fragments": [fragment_json(f) for f in fragments],
    }
    tensors = {k: v.detach().to(torch.float32).contiguous() for k, v in tensors.items()}
    return tensors, {"golden": json.dumps(golden, separators=(",", ":"))}


def add_features(tensors, fragments, layouts, config):
    """Features of the first and last observation of the first fragment of each scenario, without padding of phases and lanes."""
    seen = set()
    for number, (episode, at, steps, _, _) in enumerate(fragments):
        if episode["scenario"] in seen:
            continue
        seen.add(episode["scenario"])
        for agent in range(len(layouts[episode["scenario"]])):
            own = {k: v[[at, at + steps], agent] for k, v in episode["x"].items()}
            put = lambda key, v: tensors.__setitem__(f"feature/{number}/{agent}/{key}", v)
            mask = own["phase_mask"][0]
            put("topology", own["I"][0])
            if config["model"]["gfe"] == "paper":
                put("states", own["S"].flatten(1))
                put("phase_state", own["G"][0][mask])
            else:
                put("phases", own["X"][:, mask])
                put("context", own["context"])
                put("lanes", own["lanes"][:, own["lane_mask"][0]])


def learn(config, network, weights, net, x, target, start, tensors):
    """Three Adam steps on the minibatch; records the first pass, its losses and gradients, and every step's norm and loss."""
    own = {n: w for n, w in weights.items() if n.startswith(network + ".")}
    optimiser = torch.optim.Adam(own.values(), lr=config["ppo"][f"{network}_lr"])
    mask = x["phase_mask"].transpose(0, 1)
    totals, norms = [], []
    for step in range(ADAM_STEPS):
        optimiser.zero_grad()
        out = net(x, start)
        total, terms = losses(config, network, out, x, target)
        total.backward()
        totals.append(total.detach())
        if step == 0:
            for key, v in out.items():
                # The critic's other parts are the same code as the actor's; its gradients show them.
                if key == "predicted" or (network == "critic" and key not in ("states", "scores")):
                    continue
                v = v.transpose(0, 1)
                tensors[f"forward/{network}/{key}"] = v if key == "states" else v[mask]
            if network == "critic":
                tensors["forward/critic/values"] = value(out["scores"], x["phase_mask"]).transpose(0, 1).flatten()
            else:
                log_p = policy(out["scores"], x["phase_mask"]).transpose(0, 1)
                tensors["forward/actor/log_policy"] = log_p[mask]
            for key, v in terms.items():
                tensors[f"loss/{network}/{key}"] = v
            for n, w in own.items():
                tensors[f"grad/{n}"] = w.grad.clone()
        norms.append(torch.nn.utils.clip_grad_norm_(own.values(), config["ppo"]["max_grad_norm"]))
        optimiser.step()
    tensors[f"loss/{network}/totals"] = torch.stack(totals)
    tensors[f"norm/{network}"] = torch.stack(norms)
    for n, w in own.items():
        tensors[f"after/{n}"] = w.detach().clone()


# ------------------------------------------------------------------------------------------------------------ files


def check(path, tensors, metadata):
    """Largest deviation from a written fixture, relative to each tensor's largest entry."""
    with safe_open(path, "pt") as file:
        assert file.metadata() == metadata, f"{path.name}: the inputs differ; write it anew"
        assert set(file.keys()) == set(tensors), f"{path.name}: it holds other tensors; write it anew"
        relative = lambda a, b: ((a - b).abs().max() / b.abs().max().clamp(min=1e-12)).item()
        return max(relative(tensors[name], file.get_tensor(name)) for name in tensors)


def main():
    parser = argparse.ArgumentParser(description="writes or checks the golden fixtures of the Rust model")
    parser.add_argument("--check", action="store_true", help="compare with the fixtures instead of writing them")
    folder = pathlib.Path(__file__).resolve().parents[2] / "model" / "tests" / "fixtures"
    parser.add_argument("--folder", type=pathlib.Path, default=folder, help="where the fixtures lie (default: %(default)s)")
    args = parser.parse_args()
    for name in FIXTURES:
        path = args.folder / f"{name}.safetensors"
        tensors, metadata = build(name)
        if args.check:
            worst = check(path, tensors, metadata)
            print(f"{name}: largest relative deviation {worst:.1e}")
            if worst > 1e-5:
                return 1
        else:
            args.folder.mkdir(parents=True, exist_ok=True)
            save_file(tensors, path, metadata)
            print(f"{name}: {path.stat().st_size / 1000:.0f} kB, {len(tensors)} tensors")
    return 0


if __name__ == "__main__":
    sys.exit(main())

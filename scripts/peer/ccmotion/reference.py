"""The contents of a reference file of the denoiser, its loss or its sampler, computed from the
file's inputs and weights.

Keys are those of the files without the `64` of a float64 run: `out.X`, `grad.X`, `gradnorm.X`.
"""

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from golden import Golden

from .diffusion import NoiseSchedule, PredictionType, rollout_timesteps
from .unet1d import UNet1d, UNetConfig

DISTANCES = {"mse": F.mse_loss, "l1": F.l1_loss, "huber": F.huber_loss}
TARGETS = {"epsilon": PredictionType.EPSILON, "x0": PredictionType.SAMPLE}


def config(sizes: dict) -> UNetConfig:
    """Our sizes from those in a file's metadata."""
    return UNetConfig(sizes["base"], tuple(sizes["mult"]), sizes["time_dim"], sizes["ctx_dim"])


def network(golden: Golden, key: str, dtype: torch.dtype) -> UNet1d:
    """The network whose sizes are the metadata entry `key`, with the file's weights."""
    unet = UNet1d(config(golden.json(key)))
    golden.load(unet)
    return unet.to(dtype)


def unet_values(golden: Golden, dtype: torch.dtype) -> dict[str, Tensor]:
    """03_unet*: output, loss, intermediate values and all gradients of every case."""
    unet = network(golden, "config", dtype)
    taps: dict[str, Tensor] = {}
    # A tap of a decoder level is its output, one of an encoder level its skip.
    places = {"input_conv": unet.input_conv, "mid": unet.mid, "time_emb": unet.time_embed}
    places |= {"audio_ctx": unet.audio_proj}
    places |= {f"enc.{i}": level for i, level in enumerate(unet.enc)}
    places |= {f"dec.{i}": level for i, level in enumerate(unet.dec)}
    for name, module in places.items():
        module.register_forward_hook(lambda _m, _i, out, name=name: taps.update({name: out}))
    values: dict[str, Tensor] = {}
    for case in sorted({key.split(".")[0] for key in golden.under("in.")}):
        unet.zero_grad()
        given = golden.under(f"in.{case}.")
        x, cond = (given[key].to(dtype, copy=True).requires_grad_() for key in ("x", "cond"))
        y = unet(x, given["t"], cond)
        loss = F.mse_loss(y, given["eps"].to(dtype))
        loss.backward()
        values |= {f"out.{case}.y": y, f"out.{case}.loss": loss}
        values |= {f"out.{case}.tap.{name}": value for name, value in taps.items()}
        values[f"out.{case}.tap.audio_ctx"] = taps["audio_ctx"].transpose(1, 2)
        values |= {f"grad.{case}.in.x": x.grad, f"grad.{case}.in.cond": cond.grad}
        for name, gradient in gradients(unet).items():
            values[f"grad.{case}.model.{name}"] = gradient
            values[f"gradnorm.{case}.{name}"] = gradient.norm()
    return detached(values)


def loss_values(golden: Golden, dtype: torch.dtype) -> dict[str, Tensor]:
    """05_diffusion_loss: noised motion, output, and each loss of the file with its gradients. The
    weights are those of the file that it names."""
    weights = Golden(golden.folder, golden.metadata["weights"].removesuffix(".safetensors"))
    unet = network(weights, "config", dtype)
    schedule = NoiseSchedule.cosine(1000)
    x_start, noise, cond = (golden[f"in.{key}"].to(dtype) for key in ("x0", "noise", "cond"))
    x_t = schedule.add_noise(x_start, noise, golden["in.t"])
    values = {"out.x_t": x_t}
    for case in [f"{target}.{distance}" for target in TARGETS for distance in DISTANCES]:
        target, distance = case.split(".")
        unet.zero_grad()
        values["out.model_out"] = output = unet(x_t, golden["in.t"], cond)
        wanted = schedule.target(x_start, noise, golden["in.t"], TARGETS[target])
        loss = DISTANCES[distance](output, wanted)
        loss.backward()
        values[f"out.loss.{case}"] = loss
        for name, gradient in gradients(unet).items():
            values[f"grad.{case}.model.{name}"] = gradient
    return detached(values)


@torch.no_grad()
def ddim_values(golden: Golden, dtype: torch.dtype) -> dict[str, Tensor]:
    """08_ddim: timesteps, single steps, and every sampler's states."""
    unet = network(golden, "unet", dtype)
    values: dict[str, Tensor] = {}
    for total, counts in [(1000, [5, 10, 20, 30, 50, 1000]), (50, [5, 20])]:
        for count in counts:
            evenly, between = evenly_down(total, count), rollout_timesteps(total, count)
            values[f"out.timesteps_8_1.T{total}.N{count}"] = torch.tensor(evenly)
            values[f"out.timesteps_7_3.T{total}.N{count}"] = torch.tensor(between)
    schedules = {f"{kind}1000": getattr(NoiseSchedule, kind)(1000) for kind in ("cosine", "linear")}
    schedules["linear50"] = NoiseSchedule.linear(50)
    x, eps, z = (golden[f"in.step.{key}"].to(dtype) for key in ("x", "eps", "z"))
    for clip in ("clip", "noclip"):
        for eta in (0.0, 0.5, 1.0):
            for jump in ((499, 449), (49, 0)):
                key = f"out.step.eta{eta}.t{jump[0]}_{jump[1]}.{clip}"
                clipped = clip == "clip"
                values[key] = step(schedules["cosine1000"], x, eps, jump, clipped, eta, z)
        for name, schedule in schedules.items():
            for scale in (1, 3):
                states = sampled(golden, unet, schedule, clip == "clip", scale, dtype)
                case = f"out.{name}.{clip}.cfg{scale}"
                values |= {f"{case}.x_after.{i}": state for i, state in enumerate(states)}
                values[f"{case}.x_final"] = states[-1]
    return values


def evenly_down(total: int, count: int) -> list[int]:
    """The first `count` of T - 1, T - 1 - s, ... with s = floor(T / count)."""
    return [total - 1 - i * (total // count) for i in range(count)]


def step(
    schedule: NoiseSchedule,
    x: Tensor,
    eps: Tensor,
    jump: tuple[int, int],
    clip: bool,
    eta: float = 0.0,
    z: Tensor | None = None,
) -> Tensor:
    """One DDIM step; `eps` is not computed anew where the predicted motion is clipped to 1."""
    here, there = jump
    signal, sigma = float(schedule.sqrt_abar[here]), float(schedule.sqrt_one_minus_abar[here])
    next_signal = float(schedule.sqrt_abar[there])
    next_sigma = float(schedule.sqrt_one_minus_abar[there])
    x_start = (x - sigma * eps) / signal
    if clip:
        x_start = x_start.clamp(-1, 1)
    if eta == 0.0:
        return next_signal * x_start + next_sigma * eps
    spread = eta * next_sigma / sigma * np.sqrt(1 - (signal / next_signal) ** 2)
    direction = np.sqrt(next_sigma**2 - spread**2)
    return next_signal * x_start + float(direction) * eps + float(spread) * z


def sampled(
    golden: Golden,
    unet: nn.Module,
    schedule: NoiseSchedule,
    clip: bool,
    scale: int,
    dtype: torch.dtype,
) -> list[Tensor]:
    """The states of a sampler; the last step goes to timestep 0. Above 1, `scale` guides away from
    a condition of zeros."""
    x, cond = golden["in.x_T"].to(dtype), golden["in.cond"].to(dtype)
    timesteps = evenly_down(schedule.num_train_timesteps, int(golden.metadata["num_steps"]))
    states = []
    for jump in zip(timesteps, [*timesteps[1:], 0], strict=True):
        at = torch.full((len(x),), jump[0])
        eps = unet(x, at, cond)
        if scale != 1:
            without = unet(x, at, torch.zeros_like(cond))
            eps = without + scale * (eps - without)
        x = step(schedule, x, eps, jump, clip)
        states.append(x)
    return states


def gradients(model: nn.Module) -> dict[str, Tensor]:
    """By parameter."""
    return {name: parameter.grad.clone() for name, parameter in model.named_parameters()}


def detached(values: dict[str, Tensor]) -> dict[str, Tensor]:
    """Without their graphs."""
    return {key: value.detach() for key, value in values.items()}

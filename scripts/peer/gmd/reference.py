"""The contents of a reference file of a denoiser, computed from the file's inputs and weights, by
the file's keys."""

import torch
from torch import Tensor, nn

from golden import Golden

from .conditioning import guided, sinusoid_rows
from .denoiser import UNetDenoiser
from .unet import UNet, UNetConfig

TAIL = 4
"""Frames after the motion's end that a file contains of the padded input and output."""


def multipliers(golden: Golden) -> tuple[float, ...]:
    """Of a file's metadata."""
    return tuple(float(value) for value in golden.metadata["dim_mults"].split(","))


def gradients(model: nn.Module) -> dict[str, Tensor]:
    """By the names of a file."""
    return {f"grad.model.{name}": p.grad for name, p in model.named_parameters()}


def bare_network(golden: Golden) -> UNet:
    """The network of `unet_*`, with the file's weights."""
    meta = golden.metadata
    config = UNetConfig(
        motion_channels=int(meta["input_dim"]),
        width=int(meta["dim"]),
        multipliers=multipliers(golden),
        cond_dim=int(meta["cond_dim"]),
        adagn=meta["adagn"] == "true",
        zero_init=meta["zero"] == "true",
    )
    unet = UNet(config)
    golden.load(unet)
    return unet


def unet_values(golden: Golden, dtype: torch.dtype) -> dict[str, Tensor]:
    """A bare network: intermediate values, output, loss and all gradients."""
    unet = bare_network(golden).to(dtype)
    places: dict[str, nn.Module] = {"c": unet.time_mlp, "final0": unet.final_conv[0]}
    places |= {"mid1": unet.mid_block1, "mid2": unet.mid_block2}
    for kind, levels in {"down": unet.downs, "up": unet.ups}.items():
        for i, blocks in enumerate(levels):
            places |= {f"{kind}{i}.res0": blocks[0], f"{kind}{i}.res1": blocks[1]}
            places[f"{kind}{i}.{kind}"] = blocks[3]
    values: dict[str, Tensor] = {}
    for place, module in places.items():
        key = f"out.{place}"
        module.register_forward_hook(lambda _m, _i, out, key=key: values.update({key: out}))
    x, cond = (golden[f"in.{key}"].to(dtype, copy=True).requires_grad_() for key in ("x", "cond"))
    y = unet(x.permute(1, 2, 0), cond).permute(2, 0, 1)
    loss = y.square().mean()
    loss.backward()
    values |= {"out.y": y, "out.loss": loss[None], "grad.in.x": x.grad, "grad.in.cond": cond.grad}
    values |= gradients(unet)
    return {key: value.detach() for key, value in values.items()}


def whole_network(golden: Golden) -> UNetDenoiser:
    """The network of `mdm_unet_tiny`, with the file's weights."""
    meta = golden.metadata
    width = int(meta["latent_dim"])
    config = UNetConfig(int(meta["njoints"]), width, multipliers(golden), width)
    model = UNetDenoiser(config, int(meta["padded_frames"]))
    golden.load(model)
    return model


def denoiser_values(golden: Golden, dtype: torch.dtype) -> dict[str, Tensor]:
    """The complete model: conditioning, padding, outputs, guidance and all gradients."""
    model = whole_network(golden).to(dtype)
    calls: list[tuple[Tensor, Tensor, Tensor]] = []
    model.unet.register_forward_hook(lambda _m, args, out: calls.append((*args, out)))
    x = golden["in.x"].to(dtype, copy=True).requires_grad_()
    t, text = golden["in.t"], golden["in.text_features"].to(dtype)
    frames = x.shape[3]
    y = model(x[:, :, 0], t, text)
    loss = y.square().mean()
    loss.backward()
    padded, emb, out = calls[0]
    padded, out = padded.permute(2, 0, 1), out.permute(2, 0, 1)
    values = {"emb": emb, "time_emb": model.embed_timestep(t), "y": y[:, :, None]}
    values |= {"unet_in_padded": padded[: frames + TAIL], "loss": loss[None]}
    values["unet_out_padded_tail"] = out[frames : frames + TAIL]
    values["y_uncond"] = model(x[:, :, 0], t, torch.zeros_like(text))[:, :, None]
    values["emb_uncond"] = calls[-1][1]
    values["pe_rows"] = sinusoid_rows(t, model.unet.config.cond_dim)[:, None].to(dtype)
    scale = golden["in.cfg_scale"].to(dtype)
    values["y_cfg"] = guided(model, x[:, :, 0], t, text, scale)[:, :, None]
    values = {f"out.{key}": value for key, value in values.items()}
    values |= {"grad.in.x": x.grad} | gradients(model)
    return {key: value.detach() for key, value in values.items()}

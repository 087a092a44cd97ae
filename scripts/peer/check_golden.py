#!/usr/bin/env python3
"""Compares the peer with reference tensors: outputs, losses and gradients.

    python3 scripts/peer/check_golden.py GOLDEN_DIR

GOLDEN_DIR contains `03_unet`, `03_unet_mult1248_hashed`, `04_decoder`, `05_diffusion_loss`,
`06_temporal_loss`, `07_e2e` and `08_ddim`, each `.safetensors`: the full set or the reduced one.
Errors are `max|a - ref| / max|ref|` over a tensor, against the float64 reference. Exits with 1 if
one is above its tolerance.
"""

import argparse
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ccmotion.decoder import MotionDecoder
from ccmotion.diffusion import (
    NoiseSchedule,
    PredictionType,
    RolloutMode,
    rollout,
    rollout_timesteps,
)
from ccmotion.e2e import Batch, EndToEndConfig, EndToEndModel, Trainer, backward
from ccmotion.losses import TemporalLosses, temporal_losses
from ccmotion.reference import config, ddim_values, loss_values, unet_values
from ccmotion.unet1d import UNet1d
from golden import Golden, Report


def check_unet(
    report: Report,
    golden: Golden,
    group: str,
    grad_tolerance: float,
    dtype: torch.dtype = torch.float32,
) -> None:
    """The network of 03_unet*: intermediate values, output, loss and gradients."""
    values = unet_values(golden, dtype)
    zero = golden.json("structurally_zero_gradients")
    for key in [*golden.keys("out."), *golden.keys("grad.")]:
        if key.split(".model.")[-1] not in zero:
            kind, tolerance = network_bound(key, grad_tolerance)
            report.compare(f"{group} {kind}", tolerance, key, values[key], golden.reference(key))
    for key in golden.keys("gradnorm64."):
        case, name = key.removeprefix("gradnorm64.").split(".", 1)
        found, expected = values[f"gradnorm.{case}.{name}"], golden[key]
        if name in zero:
            report.enter(f"{group} norms of zero gradients", 1e-5, key, found.item())
        else:
            report.compare(f"{group} gradient norms", grad_tolerance, key, found, expected)


def network_bound(key: str, grad_tolerance: float) -> tuple[str, float]:
    """The meaning of a key of a network's file, and its tolerance."""
    if key.startswith("grad."):
        return "gradients", grad_tolerance
    if ".tap." in key:
        return "intermediate", 5e-5
    return ("loss", 1e-5) if "loss" in key else ("y", 2e-5)


def check_loss(report: Report, golden: Golden, dtype: torch.dtype = torch.float32) -> None:
    """05_diffusion_loss: noised motion, output, losses and gradients."""
    values = loss_values(golden, dtype)
    for key in [*golden.keys("out."), *golden.keys("grad.")]:
        kind, tolerance = network_bound(key, 1e-4)
        report.compare(f"diffusion loss {kind}", tolerance, key, values[key], golden.reference(key))


def check_ddim(report: Report, golden: Golden, dtype: torch.dtype = torch.float32) -> None:
    """08_ddim: timesteps, single steps and samples."""
    values = ddim_values(golden, dtype)
    for key in golden.keys("out."):
        kind, tolerance = ddim_bound(key)
        report.compare(f"ddim {kind}", tolerance, key, values[key], golden.reference(key))


def ddim_bound(key: str) -> tuple[str, float]:
    """The meaning of a key of 08_ddim, and its tolerance."""
    if ".timesteps_" in key:
        return "timesteps", 0.0
    if ".step." in key:
        return "steps", 3e-5
    return ("samples without clipping", 2e-5) if ".noclip." in key else ("samples", 2e-4)


def check_decoder(report: Report, golden: Golden) -> None:
    """04_decoder: output, loss and gradients."""
    decoder = MotionDecoder(int(golden.metadata["hidden"]), int(golden.metadata["layers"]))
    decoder.load_state_dict(golden.under("model."))
    for case, tolerance in [("unit", 1e-5), ("large", 2e-4)]:
        decoder.zero_grad()
        x = golden[f"in.{case}.x"].clone().requires_grad_()
        y = decoder(x)
        loss = F.mse_loss(y, golden[f"in.{case}.target"])
        loss.backward()
        report.compare("decoder y", 1e-5, case, y, golden[f"out64.{case}.y"])
        report.compare("decoder loss", 1e-5, case, loss, golden[f"out64.{case}.loss"])
        gradients = {"in.x": x.grad}
        gradients |= {f"model.{name}": p.grad for name, p in decoder.named_parameters()}
        for name, reference in golden.under(f"grad64.{case}.").items():
            report.compare(
                f"decoder gradients, {case}", tolerance, name, gradients[name], reference
            )


def check_temporal(report: Report, golden: Golden) -> None:
    """06_temporal_loss: each term and its gradient."""
    for case, tolerance in [("random", 2e-6), ("smooth", 1e-4), ("raw", 2e-6)]:
        motion = golden[f"in.{case}.motion"].clone().requires_grad_()
        terms = temporal_losses(motion)
        for name in [field.name for field in fields(TemporalLosses)] + ["total"]:
            label, value = f"{case} {name}", getattr(terms, name)
            (gradient,) = torch.autograd.grad(value, motion, retain_graph=True)
            report.compare("temporal values", 2e-6, label, value, golden[f"out64.{case}.{name}"])
            reference = golden[f"grad64.{case}.{name}"]
            report.compare(f"temporal gradients, {case}", tolerance, label, gradient, reference)
    motion = golden["in.const_accel.motion"].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(temporal_losses(motion).jerk, motion)
    reference = golden["grad64.const_accel.jerk"]
    report.compare("jerk gradient, constant acceleration", 2e-6, "", gradient, reference)


class EndToEnd:
    """The cases of 07_e2e."""

    def __init__(self, report: Report, golden: Golden) -> None:
        self.report = report
        self.golden = golden
        self.weights = golden.under("model.")

    def config(self, case: str, mode: RolloutMode, **changes: object) -> EndToEndConfig:
        """The reference's settings; no clipping."""
        kind, timesteps = split_case(case)
        schedule = getattr(NoiseSchedule, kind)(timesteps)
        golden = self.golden
        config = EndToEndConfig(
            steps=int(golden.metadata["ddim_steps"]),
            mode=mode,
            prediction_type=PredictionType.EPSILON,
            schedule=schedule,
            unet_learning_rate=float(golden.metadata["lr_unet"]),
            decoder_learning_rate=float(golden.metadata["lr_decoder"]),
            weight_decay=float(golden.metadata["weight_decay"]),
        )
        return replace(config, **changes)

    def model(self) -> EndToEndModel:
        """Both networks with the reference's weights."""
        sizes = self.golden.json("decoder")
        unet = UNet1d(config(self.golden.json("unet")))
        model = EndToEndModel(unet, MotionDecoder(sizes["hidden"], sizes["layers"]))
        model.load_state_dict(self.weights)
        return model

    def batch(self, case: str) -> Batch:
        """The reference's inputs; x_T wants a gradient."""
        golden = self.golden
        x_T = golden["in.x_T"].clone().requires_grad_()
        return Batch(
            golden["in.gt"], golden["in.cond"], golden[f"in.{case}.t"], golden["in.noise"], x_T
        )

    def check_graph(self, case: str, config: EndToEndConfig) -> None:
        """Losses and gradients with a fully differentiated rollout."""
        golden, report = self.golden, self.report
        group = f"{case} {config.mode.value}"
        group += " (last_k = all)" if config.mode is RolloutMode.LAST_K else ""
        model, batch = self.model(), self.batch(case)
        calls, decoded = record_calls(model.unet), record_calls(model.decoder)
        total, diffusion, losses = backward(model, batch, config)

        values = {"L_diff": diffusion, "L_pos": losses.position, "L_quat": losses.quaternion}
        values |= {"L_temp": losses.temporal.total, "total": total}
        values |= {
            f"temp.{f.name}": getattr(losses.temporal, f.name) for f in fields(TemporalLosses)
        }
        for name, value in values.items():
            report.compare(f"{group} losses", 1e-5, name, value, golden[f"out64.{case}.{name}"])
        report.compare(
            f"{group} decoded", 5e-5, "", losses.decoded, golden[f"out64.{case}.decoded"]
        )
        report.compare(
            f"{group} gradient of x_T", 5e-5, "", batch.x_T.grad, golden[f"grad64.{case}.in.x_T"]
        )
        # The first call is that of the diffusion loss; a checkpointed step makes no second graph.
        if config.mode is RolloutMode.FULL:
            after = [x for x, _ in calls[2:]] + [decoded[0][0].transpose(1, 2)]
            for i, ((_, prediction), x) in enumerate(zip(calls[1:], after, strict=True)):
                label = f"step {i}"
                report.compare(
                    f"{group} states", 5e-5, label, x, golden[f"out64.{case}.x_after.{i}"]
                )
                eps, gradient = golden[f"out64.{case}.eps.{i}"], golden[f"grad64.{case}.eps.{i}"]
                report.compare(f"{group} predictions", 5e-5, label, prediction, eps)
                report.compare(
                    f"{group} gradients of predictions", 5e-4, label, prediction.grad, gradient
                )

        gradients = {name: p.grad for name, p in model.named_parameters()}
        tolerances = {"unet": 2e-4, "decoder": decoder_tolerance(case)}
        zero = set(golden.json("structurally_zero_gradients"))
        for part, tolerance in tolerances.items():
            for name, reference in golden.under(f"grad64.{case}.model.{part}.").items():
                gradient = gradients[f"{part}.{name}"]
                report.compare(f"{group} {part} gradients", tolerance, name, gradient, reference)
            for name, reference in golden.under(f"gradnorm64.{case}.{part}.").items():
                if name not in zero:
                    norm = gradients[f"{part}.{name}"].norm()
                    report.compare(
                        f"{group} {part} gradient norms", tolerance, name, norm, reference
                    )

    def check_truncated(self, case: str) -> None:
        """The gradient that is left where only the last step is differentiated.

        It comes out of the decoder directly, and shares its conditioning and its tolerance.
        """
        tolerance = decoder_tolerance(case)
        model = self.model()
        batch = replace(self.batch(case), x_T=self.golden["in.x_T"])
        backward(model, batch, self.config(case, RolloutMode.LAST_K, last_k=1))
        gradients = {name: p.grad for name, p in model.named_parameters()}
        for name, reference in self.golden.under(f"truncgrad64.{case}.").items():
            group = f"{case} last_k (last_k = 1) unet gradients"
            self.report.compare(group, tolerance, name, gradients[name], reference)

    def check_recomputation(self, case: str) -> None:
        """Every gradient of `checkpointed` against that of `full`."""
        gradients = []
        for mode in [RolloutMode.FULL, RolloutMode.CHECKPOINTED]:
            model = self.model()
            backward(model, self.batch(case), self.config(case, mode))
            gradients.append({name: p.grad for name, p in model.named_parameters()})
        full, checkpointed = gradients
        for name, reference in full.items():
            group = f"{case} checkpointed against full, all gradients"
            self.report.compare(group, 1e-6, name, checkpointed[name], reference)

    def check_adamw(self, case: str) -> None:
        """Parameters after one step: `|change - reference|` as a share of `ulp + 5e-3 lr`."""
        golden = self.golden
        trainer = Trainer(self.model(), self.config(case, RolloutMode.CHECKPOINTED))
        trainer.step(self.batch(case))
        rates = {
            "unet": trainer.config.unet_learning_rate,
            "decoder": trainer.config.decoder_learning_rate,
        }
        after = dict(trainer.model.named_parameters())
        for name, reference in golden.under(f"delta64.{case}.model.").items():
            before = self.weights[name].numpy()
            change = after[name].detach().double().numpy() - before.astype(np.float64)
            allowed = (
                np.spacing(np.abs(before)).astype(np.float64) + 5e-3 * rates[name.split(".")[0]]
            )
            share = np.abs(change - reference.numpy()) / allowed
            mask = golden[f"aftermask.{case}.model.{name}"].numpy() == 1
            if mask.any():
                self.report.enter(
                    f"{case} AdamW step (share of allowed)", 1.0, name, share[mask].max()
                )


def decoder_tolerance(case: str) -> float:
    """Tolerance of gradients in or right after the decoder; `cosine1000` decodes latents of 1e5."""
    return 5e-3 if case == "cosine1000" else 2e-4


def split_case(case: str) -> tuple[str, int]:
    """`linear50` into the schedule's name and its number of timesteps."""
    kind = case.rstrip("0123456789")
    return kind, int(case[len(kind) :])


def record_calls(module: nn.Module) -> list[tuple[Tensor, Tensor]]:
    """Input and output of all calls of `module` from now on; the outputs keep their gradients."""
    calls: list[tuple[Tensor, Tensor]] = []

    def record(_module: nn.Module, inputs: tuple, output: Tensor) -> None:
        if output.requires_grad:
            output.retain_grad()
        calls.append((inputs[0], output))

    module.register_forward_hook(record)
    return calls


def check_e2e(report: Report, golden: Golden) -> None:
    """07_e2e in all modes."""
    cases = EndToEnd(report, golden)
    for case in ["linear50", "linear1000", "cosine1000"]:
        timesteps = golden[f"out.{case}.timesteps"].tolist()
        steps = len(timesteps)
        assert rollout_timesteps(split_case(case)[1], steps) == timesteps
        for mode in RolloutMode:
            cases.check_graph(case, cases.config(case, mode, last_k=steps))
        cases.check_truncated(case)
        cases.check_recomputation(case)
    for case in ["linear50", "cosine1000"]:
        cases.check_adamw(case)


def check_prediction_types(report: Report) -> None:
    """A rollout with the exact output of each prediction type reaches the original motion."""
    schedule = NoiseSchedule.cosine(1000)
    generator = torch.Generator().manual_seed(0)
    x_start, noise = torch.randn(2, 2, 25, 16, generator=generator, dtype=torch.float64)
    x_T = schedule.add_noise(x_start, noise, torch.tensor([999, 999]))
    for kind in PredictionType:

        def exact(
            x: Tensor, timesteps: Tensor, cond: Tensor, kind: PredictionType = kind
        ) -> Tensor:
            return schedule.target(x_start, noise, timesteps, kind)

        sample = rollout(exact, schedule, kind, x_T, x_start, 10, RolloutMode.FULL)
        report.compare("rollout with exact predictions", 1e-9, kind.value, sample, x_start)


def main() -> int:
    """Runs all checks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("golden_dir", type=Path, help="folder with the .safetensors files")
    folder = parser.parse_args().golden_dir
    torch.set_num_threads(2)
    report = Report()
    check_unet(report, Golden(folder, "03_unet"), "unet", 2e-4)
    check_unet(report, Golden(folder, "03_unet_mult1248_hashed"), "unet hashed", 1e-4)
    check_loss(report, Golden(folder, "05_diffusion_loss"))
    check_ddim(report, Golden(folder, "08_ddim"))
    check_decoder(report, Golden(folder, "04_decoder"))
    check_temporal(report, Golden(folder, "06_temporal_loss"))
    check_prediction_types(report)
    check_e2e(report, Golden(folder, "07_e2e"))
    return 0 if report.print() else 1


if __name__ == "__main__":
    sys.exit(main())

"""Reference numbers of second-order samplers, made with diffusers.

    pip install torch diffusers safetensors
    python scripts/peer/samplers.py data_fixtures/samplers/diffusers.safetensors

The network is `s tanh(W x + v t / 1000)` of each frame, in double precision. States are those of the
variance-preserving process: the factor sqrt(sigma^2 + 1) of some schedulers is removed.
"""

import json
import sys

import torch
from diffusers import DPMSolverMultistepScheduler, HeunDiscreteScheduler
from safetensors.torch import save_file

SHAPE = (2, 3, 5)
STEPS = {"few": 5, "many": 20}


def linspace(total, steps):
    return [(total - 1) * (steps - 1 - i) // (steps - 1) for i in range(steps)]


def main(path):
    generator = torch.Generator().manual_seed(9)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
    w, v, s, x_T = draw(3, 3) / 2, draw(3), 1.5, draw(*SHAPE)
    # Single precision, as in the written file.
    w, v, x_T = (x.float().double() for x in (w, v, x_T))

    def network(x, t):
        return s * torch.tanh(torch.einsum("ij,bjt->bit", w, x) + v[None, :, None] * t / 1000)

    tensors = {"W": w, "v": v, "x_T": x_T}
    betas = dict(num_train_timesteps=1000, beta_start=1e-4, beta_end=0.02, beta_schedule="linear")
    for name, steps in STEPS.items():
        timesteps = linspace(1000, steps)
        for prediction_type in ("epsilon", "sample", "v_prediction"):
            scheduler = DPMSolverMultistepScheduler(**betas, prediction_type=prediction_type)
            scheduler.set_timesteps(timesteps=timesteps)
            assert scheduler.timesteps.tolist() == timesteps
            x, states = x_T, []
            for t in scheduler.timesteps:
                x = scheduler.step(network(x.double(), t.item()), t, x).prev_sample
                states.append(x)
            tensors[f"dpmpp_2m.{prediction_type}.{name}"] = torch.stack(states)

            if prediction_type == "sample":
                continue  # diffusers' Heun does not support it
            scheduler = HeunDiscreteScheduler(**betas, prediction_type=prediction_type)
            scheduler.set_timesteps(timesteps=timesteps)
            sigmas = scheduler.sigmas.double()
            x, states = x_T * (sigmas[0] ** 2 + 1).sqrt(), []
            for index, t in enumerate(scheduler.timesteps):
                y = scheduler.scale_model_input(x, t)
                x = scheduler.step(network(y.double(), t.item()), t, x).prev_sample
                # Every second call ends a step, and so does the single last one.
                if index % 2 == 1 or index + 1 == len(scheduler.timesteps):
                    states.append(x / (sigmas[index + 1] ** 2 + 1).sqrt())
            assert len(states) == steps
            tensors[f"heun.{prediction_type}.{name}"] = torch.stack(states)
    tensors = {name: tensor.float().contiguous() for name, tensor in tensors.items()}
    save_file(tensors, path, metadata={"s": str(s), "steps": json.dumps(STEPS)})
    for name, tensor in tensors.items():
        print(name, tuple(tensor.shape), tensor.abs().max().item())


if __name__ == "__main__":
    main(sys.argv[1])

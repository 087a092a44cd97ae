#!/usr/bin/env python3
"""Writes the references of `data_fixtures/golden` that are smaller than the full ones.

    python3 scripts/peer/reduced.py GOLDEN_DIR FOLDER [--seed SEED] [--only PART ...]

GOLDEN_DIR contains the full references, FOLDER receives the reduced ones (`data_fixtures/golden`).
First the peer, in float64, must agree with the full references of the networks. Then, for each:

- inputs are new random numbers with the sizes and standard deviations of the full file's;
- weights are not stored but come from a hash (`golden.hashed`); the sampler's are those of a small
  fitted network, because hashed weights would make float32 useless there;
- results are computed by the peer in float64. A file of `ccmotion` has `out64.*`, and in `out.*` a
  float32 run; all other results are rounded to float32.

Finally a float32 run of the peer must agree with the written files. Recordings are compressed and
some of their tensors omitted (`reduced_audio`); all other files are copied. Another SEED changes
inputs and weights of networks; the rest does not depend on it.
"""

import argparse
import json
import shutil
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

import check_gmd
import check_golden
from ccmotion import reference as ccmotion
from ccmotion.fitted import SIZES, fitted
from ccmotion.unet1d import UNet1d
from gmd import reference as gmd
from golden import Golden, Report, checksums, hashed, write

NETWORKS: dict[str, tuple[Callable[[Golden, torch.dtype], dict[str, Tensor]], Callable | None]] = {
    "ccmotion/03_unet": (
        ccmotion.unet_values,
        lambda golden: UNet1d(ccmotion.config(golden.json("config"))),
    ),
    "ccmotion/05_diffusion_loss": (ccmotion.loss_values, None),
    "ccmotion/08_ddim": (ccmotion.ddim_values, None),
    "gmd/mdm_unet_tiny": (gmd.denoiser_values, gmd.whole_network),
    "gmd/unet_motion_tiny": (gmd.unet_values, gmd.bare_network),
    "gmd/unet_traj_xxs_plain_tiny": (gmd.unet_values, gmd.bare_network),
}
"""The computation of a file's results, and the network whose weights it describes."""


def check(folder: Path, dtype: torch.dtype) -> None:
    """Compares the peer with the networks' files of a folder; exits if they disagree."""
    report = Report()
    part = folder / "ccmotion"
    check_golden.check_unet(report, Golden(part, "03_unet"), "unet", 2e-4, dtype)
    check_golden.check_loss(report, Golden(part, "05_diffusion_loss"), dtype)
    check_golden.check_ddim(report, Golden(part, "08_ddim"), dtype)
    part = folder / "gmd"
    check_gmd.check_denoiser(report, part, "mdm_unet_tiny", dtype)
    check_gmd.check_unet(report, part, "unet_motion_tiny", dtype)
    check_gmd.check_unet(report, part, "unet_traj_xxs_plain_tiny", dtype)
    print(f"\nThe peer in {dtype} against {folder}:\n")
    if not report.print():
        sys.exit(1)


def seed_of(seed: int, name: str) -> int:
    """A seed of 32 bits for each use."""
    return zlib.crc32(f"{seed}/{name}".encode())


def inputs(full: Golden, seed: int) -> dict[str, Tensor]:
    """Normal values of the full file's sizes and deviations; timesteps of each half of the process;
    constant tensors unchanged."""
    generator = torch.Generator().manual_seed(seed)
    drawn: dict[str, Tensor] = {}
    for key in sorted(full.keys("in.")):
        values = full[key]
        if not values.is_floating_point():
            low, high = (torch.randint(1, 499, (1,), generator=generator) for _ in range(2))
            drawn[key] = torch.cat([low, 500 + high]).to(values.dtype)
            assert drawn[key].shape == values.shape
        elif values.min() == values.max():
            drawn[key] = values
        else:
            drawn[key] = values.std() * torch.randn(values.shape, generator=generator)
    return drawn


def weights(full: Golden, name: str, seed: int) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of the weights."""
    if name == "ccmotion/08_ddim":
        tensors = {f"model.{key}": value for key, value in fitted(seed).items()}
        return {"unet": json.dumps(SIZES)}, tensors
    describe = NETWORKS[name][1]
    if describe is None:
        return {}, {}
    model: nn.Module = describe(full)
    shapes = {key: value.shape for key, value in model.state_dict().items()}
    made = {key: hashed(key, shape, i, seed) for i, (key, shape) in enumerate(shapes.items())}
    metadata = {
        "hash_seed": str(seed),
        "param_order": json.dumps(list(shapes)),
        "param_shapes": json.dumps([list(shape) for shape in shapes.values()]),
    }
    return metadata, checksums(made)


def results(full: Golden, golden: Golden, name: str) -> dict[str, Tensor]:
    """Results under the keys of the full file."""
    compute = NETWORKS[name][0]
    single, double = compute(golden, torch.float32), compute(golden, torch.float64)
    stored: dict[str, Tensor] = {}
    for key in [*full.keys("out."), *full.keys("grad."), *full.keys("gradnorm64.")]:
        if not double[key.replace("64.", ".", 1)].is_floating_point():
            stored[key] = double[key]
        elif key.startswith("gradnorm64."):
            stored[key] = double[key.replace("64.", ".", 1)]
        elif key.startswith("out.") and name.startswith("ccmotion/"):
            stored[key] = single[key]
            stored[key.replace("out.", "out64.", 1)] = double[key]
        else:
            stored[key] = double[key].float()
        shape = full[key].shape
        assert stored[key].shape == shape, f"{name}: {key} is {stored[key].shape}, not {shape}"
    return stored


def reduce_network(source: Path, folder: Path, name: str, seed: int) -> None:
    """Writes the reduced file of a network."""
    family, _, file = name.partition("/")
    full = Golden(source / family, file)
    described, held = weights(full, name, seed_of(seed, f"{name}/weights"))
    tensors = inputs(full, seed_of(seed, f"{name}/inputs")) | held
    golden = Golden.unwritten(folder / family, full.metadata | described, tensors)
    golden.tensors |= results(full, golden, name)
    write(golden, file)


def networks(source: Path, folder: Path, seed: int) -> None:
    """All files of networks, between the two checks."""
    check(source, torch.float64)
    for name in NETWORKS:
        reduce_network(source, folder, name, seed)
    check(folder, torch.float32)


def copied(source: Path, folder: Path) -> None:
    """The unreduced files."""
    for family in ("ccmotion", "flow", "flowmdm", "genmm", "gmd", "humanml", "paths"):
        (folder / family).mkdir(parents=True, exist_ok=True)
        for path in sorted((source / family).iterdir()):
            if path.suffix != ".md" and f"{family}/{path.stem}" not in NETWORKS:
                shutil.copyfile(path, folder / family / path.name)


def audio(source: Path, folder: Path) -> None:
    """The clips."""
    import reduced_audio  # only this needs soundfile

    reduced_audio.reduce(source / "audio", folder / "audio")


def main() -> None:
    """Writes the selected parts, or everything."""
    parts = {
        "networks": lambda args: networks(args.golden_dir, args.folder, args.seed),
        "copied": lambda args: copied(args.golden_dir, args.folder),
        "audio": lambda args: audio(args.golden_dir, args.folder),
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("golden_dir", type=Path, help="folder with the full references")
    parser.add_argument("folder", type=Path, help="folder that receives the reduced ones")
    parser.add_argument("--seed", type=int, default=1, help="of inputs and weights")
    parser.add_argument("--only", choices=parts, nargs="+", default=list(parts))
    args = parser.parse_args()
    torch.set_num_threads(1)
    for part in args.only:
        parts[part](args)


if __name__ == "__main__":
    main()

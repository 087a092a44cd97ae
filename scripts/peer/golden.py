"""Files of reference tensors, and a report of errors against them."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor, nn

DTYPES = {
    torch.float64: "F64",
    torch.float32: "F32",
    torch.int64: "I64",
    torch.int32: "I32",
    torch.uint8: "U8",
}


class Golden:
    """One file of reference tensors."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        with safe_open(folder / f"{name}.safetensors", "pt") as file:
            self.metadata: dict[str, str] = file.metadata() or {}
            self.tensors: dict[str, Tensor] = {key: file.get_tensor(key) for key in file.keys()}

    @classmethod
    def unwritten(
        cls, folder: Path, metadata: dict[str, str], tensors: dict[str, Tensor]
    ) -> "Golden":
        """A missing file of `folder`."""
        golden = cls.__new__(cls)
        golden.folder, golden.metadata, golden.tensors = folder, metadata, tensors
        return golden

    def __getitem__(self, key: str) -> Tensor:
        return self.tensors[key]

    def under(self, prefix: str) -> dict[str, Tensor]:
        """All tensors whose key starts with `prefix`, by the rest of the key."""
        return {k[len(prefix) :]: v for k, v in self.tensors.items() if k.startswith(prefix)}

    def json(self, key: str) -> Any:
        """A metadata entry that is JSON."""
        return json.loads(self.metadata[key])

    def keys(self, prefix: str) -> list[str]:
        """All keys that start with `prefix`, except other readings of the documentation."""
        return [key for key in self.tensors if key.startswith(prefix) and ".alt." not in key]

    def reference(self, key: str) -> Tensor:
        """The float64 twin of `out.X` or `grad.X`, or the entry itself if there is none."""
        kind, _, rest = key.partition(".")
        return self.tensors.get(f"{kind}64.{rest}", self.tensors[key])

    def load(self, model: nn.Module) -> None:
        """Gives a network the file's weights, stored or hashed."""
        stored = self.under("model.")
        model.load_state_dict(stored if stored else hashed_weights(self, model))


class Report:
    """The worst error of each group of comparisons."""

    def __init__(self) -> None:
        self.groups: dict[str, tuple[float, float, str, int]] = {}

    def compare(
        self, group: str, tolerance: float, name: str, ours: Tensor, reference: Tensor
    ) -> None:
        """Enters one comparison."""
        if ours.shape != reference.shape:
            raise SystemExit(f"check_golden: {group}: `{name}` has shape {tuple(ours.shape)}")
        scale = reference.abs().max().item()
        error = (ours.detach().double() - reference.double()).abs().max().item()
        self.enter(group, tolerance, name, error / scale if scale > 0 else error)

    def enter(self, group: str, tolerance: float, name: str, error: float) -> None:
        """Enters one error, already scaled."""
        worst, _, where, count = self.groups.get(group, (-1.0, tolerance, "", 0))
        if not error <= worst:  # also if it is NaN
            worst, where = error, name
        self.groups[group] = (worst, tolerance, where, count + 1)

    def print(self) -> bool:
        """Prints all groups; true if every one is within its tolerance."""
        print("| group | compared | largest error | tolerance | at | |\n|---|---|---|---|---|---|")
        for group, (worst, tolerance, where, count) in self.groups.items():
            verdict = "ok" if worst <= tolerance else "TOO LARGE"
            print(f"| {group} | {count} | {worst:.1e} | {tolerance:.0e} | {where} | {verdict} |")
        return all(worst <= tolerance for worst, tolerance, _, _ in self.groups.values())


def hashed(name: str, shape: torch.Size, position: int, seed: int) -> Tensor:
    """Parameter number `position`, made by the integer hash that `data_fixtures/golden/README.md`
    describes."""
    first = (seed + position * 0x9E3779B9) % 2**32
    x = np.arange(shape.numel(), dtype=np.uint32) + np.uint32(first)
    x ^= x >> np.uint32(16)
    x *= np.uint32(0x7FEB352D)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x846CA68B)
    x ^= x >> np.uint32(16)
    u = 2.0 * x.astype(np.float64) / 2.0**32 - 1.0
    if len(shape) >= 2:
        u /= np.sqrt(shape[1:].numel())
    elif name.endswith("weight"):
        u = 1.0 + 0.2 * u
    else:
        u *= 0.1
    return torch.from_numpy(u.astype(np.float32)).reshape(shape)


def checksums(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """The description of hashed weights in a file."""
    return {
        "check.num_parameters": torch.tensor(sum(w.numel() for w in weights.values())),
        "check.sum64_of_all_parameters": sum(w.double().sum() for w in weights.values()),
    }


def hashed_weights(golden: Golden, model: nn.Module) -> dict[str, Tensor]:
    """The weights of a file that stores none, with its checks."""
    shapes = {name: values.shape for name, values in model.state_dict().items()}
    order, seed = golden.json("param_order"), int(golden.metadata["hash_seed"])
    if "param_shapes" in golden.metadata:
        assert [list(shapes[name]) for name in order] == golden.json("param_shapes")
    weights = {name: hashed(name, shapes[name], i, seed) for i, name in enumerate(order)}
    for name, found in checksums(weights).items():
        assert torch.isclose(found.double(), golden[name].double(), rtol=1e-9, atol=0), name
    last = golden.tensors.get("check.last8.output_conv.weight")
    if last is not None:
        assert weights["output_conv.weight"].flatten()[-8:].equal(last)
    return weights


def write(golden: Golden, name: str) -> None:
    """Writes an unwritten file. The order within is fixed, that of the `safetensors` package is
    not."""
    header: dict[str, Any] = {"__metadata__": dict(sorted(golden.metadata.items()))}
    parts: list[bytes] = []
    end = 0
    # As the format asks: the widest types first, which keeps all aligned.
    tensors = sorted(golden.tensors.items(), key=lambda item: (-item[1].element_size(), item[0]))
    for key, values in tensors:
        parts.append(values.detach().contiguous().numpy().tobytes())
        begin, end = end, end + len(parts[-1])
        shape, dtype = list(values.shape), DTYPES[values.dtype]
        header[key] = {"dtype": dtype, "shape": shape, "data_offsets": [begin, end]}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    golden.folder.mkdir(parents=True, exist_ok=True)
    path = golden.folder / f"{name}.safetensors"
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(parts))

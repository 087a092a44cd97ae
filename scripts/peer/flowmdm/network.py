"""The transformer with blended positional encodings in PyTorch, from the formulas of
docs/sources/flowmdm.md, for comparison with kinegrad's. One motion of several texts."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

HEAD, ROTATED = 64, 32


class Attention(nn.Module):
    """Pose-centric attention."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.merge = nn.Linear(2 * width, width)
        self.q, self.k, self.v = (nn.Linear(width, heads * HEAD, bias=False) for _ in range(3))
        self.out = nn.Linear(heads * HEAD, width, bias=False)

    def forward(self, u: Tensor, cond: Tensor, allowed: Tensor, turn: tuple | None) -> Tensor:
        batch, time, _ = u.shape
        split = lambda x: x.view(batch, time, self.heads, HEAD).transpose(1, 2)
        q = split(self.q(self.merge(torch.cat([u, cond], -1))))
        k, v = split(self.k(u)), split(self.v(u))
        if turn is not None:
            q, k = rotated(q, *turn), rotated(k, *turn)
        y = functional.scaled_dot_product_attention(q, k, v, attn_mask=allowed)
        return self.out(y.transpose(1, 2).reshape(batch, time, -1))


def rotated(x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """The first channels turned by the frame's number."""
    half = ROTATED // 2
    a, b, rest = x[..., :half], x[..., half:ROTATED], x[..., ROTATED:]
    return torch.cat([a * cos - b * sin, b * cos + a * sin, rest], -1)


class Network(nn.Module):
    """The published size."""

    def __init__(self, features=263, width=512, layers=8, heads=4, inner=1024, horizon=150) -> None:
        super().__init__()
        self.width, self.horizon = width, horizon
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.text = nn.Linear(512, width)
        self.pose, self.project_in = nn.Linear(features, width), nn.Linear(width, width)
        self.scale = nn.Parameter(torch.tensor([width**-0.5]))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2 * layers))
        self.attention = nn.ModuleList(Attention(width, heads) for _ in range(layers))
        self.feed_forward = nn.ModuleList(
            nn.Sequential(nn.Linear(width, inner), nn.GELU(), nn.Linear(inner, width))
            for _ in range(layers)
        )
        self.final_norm, self.project_out = nn.LayerNorm(width), nn.Linear(width, width)
        self.last = nn.Linear(width, features)

    def forward(self, x: Tensor, t: float, texts: Tensor, segments: Tensor, relative: bool) -> Tensor:
        """`x` is `[1, frames, features]`, `segments` the text of each frame."""
        frames = x.shape[1]
        places = torch.arange(frames, dtype=torch.float32)
        row = torch.arange(self.width // 2) * (-2 * math.log(10000) / self.width)
        angles = t * torch.exp(row)
        table = torch.stack([angles.sin(), angles.cos()], -1).flatten()
        cond = self.time(table) + self.text(texts)[segments][None]
        h = self.project_in(self.pose(x))
        near = (places[:, None] - places[None]).abs() <= self.horizon
        turn = None
        if relative:
            angles = places[:, None] * 10000 ** (-torch.arange(ROTATED // 2) / (ROTATED // 2))
            turn = (angles.cos(), angles.sin())
        else:
            near &= segments[:, None] == segments[None]
            begins = torch.searchsorted(segments, segments)
            angles = (places - begins)[:, None] * torch.exp(row)
            h = h + self.scale * torch.cat([angles.sin(), angles.cos()], -1)
        for index, (attention, feed_forward) in enumerate(zip(self.attention, self.feed_forward)):
            h = h + attention(self.norms[2 * index](h), cond, near, turn)
            h = h + feed_forward(self.norms[2 * index + 1](h))
        return self.last(self.project_out(self.final_norm(h)))

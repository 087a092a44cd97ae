"""The history encoder and the predictor of the next pose (docs/sources/flow.md). Features are those of
HumanML3D's 22 joints, one row per frame; joints are tokens: `[B, J, channels]`."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

JOINTS = 22
FEATURES = 12 * JOINTS - 1
TEXT_FEATURES = 512
CHAINS = [2, 1, 0, 2, 1, 0, 2, 1, 0, 2, 1, 0, 2, 4, 3, 2, 4, 3, 4, 3, 4, 3]
"""Of each joint: right leg, left leg, spine, right arm, left arm."""
DEPTHS = [0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 6, 6, 7, 7]
"""Of each joint: steps from the root."""
HEIGHT = 3
POSITIONS = slice(4, 67)
ROTATIONS = slice(67, 193)
VELOCITIES = slice(193, 259)
CONTACTS = slice(259, 263)


@dataclass(frozen=True)
class FlowConfig:
    """The document's widths."""

    joint_dim: int = 128
    context_dim: int = 64
    gru_dim: int = 128
    decoder_dim: int = 256
    latent_dim: int = 128
    num_layers: int = 4
    num_heads: int = 4
    ff_size: int = 512


def positions(rows: Tensor) -> Tensor:
    """Features `[..., 263]` to positions `[..., J, 3]`: the root's is (0, its height, 0)."""
    root = torch.zeros_like(rows[..., :3])
    root[..., 1] = rows[..., HEIGHT]
    return torch.cat([root, rows[..., POSITIONS]], -1).unflatten(-1, (JOINTS, 3))


def velocities(rows: Tensor) -> Tensor:
    """Features `[..., 263]` to velocities `[..., J, 3]`."""
    return rows[..., VELOCITIES].unflatten(-1, (JOINTS, 3))


def previous_state(last: Tensor) -> Tensor:
    """Position, rotation and velocity of each joint: `[B, 263]` to `[B, J, 12]`."""
    unturned = last.new_tensor([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]).expand(*last.shape[:-1], 6)
    rotations = torch.cat([unturned, last[..., ROTATIONS]], -1).unflatten(-1, (JOINTS, 6))
    return torch.cat([positions(last), rotations, velocities(last)], -1)


def perceptron(inputs: int, inside: int, outputs: int) -> nn.Sequential:
    """Two linear layers with GELU between them."""
    return nn.Sequential(nn.Linear(inputs, inside), nn.GELU(), nn.Linear(inside, outputs))


class HistoryEncoder(nn.Module):
    """Past frames and a text to a context of each joint."""

    def __init__(self, config: FlowConfig) -> None:
        super().__init__()
        text_dim = 32
        all_joints = JOINTS * config.context_dim
        self.text_proj = nn.Linear(TEXT_FEATURES, text_dim)
        self.joint_mlp = perceptron(15 + text_dim, config.joint_dim, config.context_dim)
        self.gru = nn.GRU(all_joints, config.gru_dim, batch_first=True, bidirectional=True)
        self.decoder = perceptron(2 * config.gru_dim, config.decoder_dim, all_joints)

    def forward(self, history: Tensor, text: Tensor, duration: Tensor) -> Tensor:
        """`history [B, T, 263]`, `text [B, 512]`, `duration [B, 1]` to `[B, J, context_dim]`."""
        body = torch.cat([history[..., : HEIGHT + 1], history[..., CONTACTS]], -1)
        clip = torch.cat([duration, self.text_proj(text)], -1)
        clip = clip[:, None].expand(-1, history.shape[1], -1)
        shared = torch.cat([body, clip], -1)[:, :, None].expand(-1, -1, JOINTS, -1)
        inputs = torch.cat([positions(history), velocities(history), shared], -1)
        _, last = self.gru(self.joint_mlp(inputs).flatten(2))
        summary = last.transpose(0, 1).flatten(1)
        return self.decoder(summary).unflatten(-1, (JOINTS, -1))


class FlowPredictor(nn.Module):
    """The velocity of a noisy pose."""

    def __init__(self, config: FlowConfig) -> None:
        super().__init__()
        width, context = config.latent_dim, 32
        self.ctx_proj = nn.Linear(config.context_dim, context)
        self.in_proj = nn.Linear(context + 12 + 3 + 1 + 1, width)
        self.chain_emb = nn.Embedding(1 + max(CHAINS), width)
        self.depth_emb = nn.Embedding(1 + max(DEPTHS), width)
        layer = nn.TransformerEncoderLayer(
            width,
            config.num_heads,
            config.ff_size,
            dropout=0.0,
            activation="gelu",
            batch_first=True,
        )
        self.transformer = nn.TransformerEncoder(layer, config.num_layers)
        self.head = perceptron(width, width, 3)

    def forward(
        self, x_t: Tensor, t: Tensor, context: Tensor, previous: Tensor, progress: Tensor
    ) -> Tensor:
        """`x_t [B, J, 3]`, `t [B]`, `context [B, J, context_dim]`, `previous [B, J, 12]`,
        `progress [B]` to `[B, J, 3]`."""
        numbers = torch.stack([progress, t], -1)[:, None].expand(-1, JOINTS, -1)
        inputs = torch.cat([self.ctx_proj(context), previous, x_t, numbers], -1)
        chains = torch.tensor(CHAINS, device=x_t.device)
        depths = torch.tensor(DEPTHS, device=x_t.device)
        tokens = self.in_proj(inputs) + self.chain_emb(chains) + self.depth_emb(depths)
        return self.head(self.transformer(tokens))


class FlowModel(nn.Module):
    """Both networks."""

    def __init__(self, config: FlowConfig) -> None:
        super().__init__()
        self.encoder = HistoryEncoder(config)
        self.predictor = FlowPredictor(config)

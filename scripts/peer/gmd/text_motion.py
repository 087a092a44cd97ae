"""The text-motion evaluator of C. Guo et al., "Generating Diverse and Natural 3D Human Motions from
Text" (2022): two encoders whose embeddings are close if a caption describes a motion, and the
metrics on them.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_padded_sequence

CONTACTS = 4
UNIT_FRAMES = 4
PADDED_FRAMES = 196
MAX_WORDS = 20
POOL = 32
CLASSES = ["VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV"]
CLASSES += ["Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP", "OTHER"]
WORD_CLASSES = {
    "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down "
    "straight curve",
    "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
    "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
    "Act_VIP": "walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit "
    "lift lower raise wash stand kneel stroll rub bend balance flap jog shuffle lean rotate spin "
    "spread climb",
    "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
}
"""Words that count as a class of their own."""


@dataclass(frozen=True)
class TextMotionConfig:
    """Widths of the networks; the defaults are the published ones."""

    channels: int = 263
    convolution: int = 512
    movement: int = 512
    motion_state: int = 1024
    word_vector: int = 300
    text_state: int = 512
    embedding: int = 512


class MovementEncoder(nn.Module):
    """A vector for every four frames."""

    def __init__(self, config: TextMotionConfig) -> None:
        super().__init__()
        self.main = nn.Sequential(
            nn.Conv1d(config.channels - CONTACTS, config.convolution, 4, stride=2, padding=1),
            nn.Dropout(0.2),
            nn.LeakyReLU(0.2),
            nn.Conv1d(config.convolution, config.movement, 4, stride=2, padding=1),
            nn.Dropout(0.2),
            nn.LeakyReLU(0.2),
        )
        self.out_net = nn.Linear(config.movement, config.movement)

    def forward(self, frames: Tensor) -> Tensor:
        """`[B, T, channels - 4]` to `[B, T // 4, movement]`."""
        return self.out_net(self.main(frames.transpose(1, 2)).transpose(1, 2))


class SequenceEncoder(nn.Module):
    """One embedding of sequences of unequal length."""

    def __init__(self, inputs: int, state: int, embedding: int) -> None:
        super().__init__()
        self.input_emb = nn.Linear(inputs, state)
        self.gru = nn.GRU(state, state, batch_first=True, bidirectional=True)
        self.hidden = nn.Parameter(torch.zeros(2, 1, state))
        self.output_net = nn.Sequential(
            nn.Linear(2 * state, state),
            nn.LayerNorm(state),
            nn.LeakyReLU(0.2),
            nn.Linear(state, embedding),
        )

    def forward(self, steps: Tensor, lengths: Tensor) -> Tensor:
        """`[B, steps, inputs]` to `[B, embedding]`."""
        packed = pack_padded_sequence(
            self.input_emb(steps), lengths, batch_first=True, enforce_sorted=False
        )
        _, last = self.gru(packed, self.hidden.expand(-1, len(steps), -1).contiguous())
        return self.output_net(torch.cat([last[0], last[1]], dim=1))


class TextEncoder(SequenceEncoder):
    """One embedding of words with their classes."""

    def __init__(self, config: TextMotionConfig) -> None:
        super().__init__(config.word_vector, config.text_state, config.embedding)
        self.pos_emb = nn.Linear(len(CLASSES), config.word_vector)

    def captions(self, captions: list[str], vectors: dict[str, Tensor]) -> Tensor:
        """Captions `word/POS word/POS ...` to `[B, embedding]`."""
        read = [sentence(caption, vectors) for caption in captions]
        lengths = torch.tensor([len(words) for words, _ in read])
        words = nn.utils.rnn.pad_sequence([words for words, _ in read], batch_first=True)
        classes = nn.utils.rnn.pad_sequence([classes for _, classes in read], batch_first=True)
        return self(words + self.pos_emb(classes), lengths)


def sentence(caption: str, vectors: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Word vectors and one-hot classes of a caption between its frame of `sos` and `eos`."""
    tokens = ["sos/OTHER", *caption.split()[:MAX_WORDS], "eos/OTHER"]
    words, classes = [], []
    for token in tokens:
        word, _, name = token.partition("/")
        for own, members in WORD_CLASSES.items():
            if word in members.split():
                name = own
        if word not in vectors:
            word, name = "unk", "OTHER"
        words.append(vectors[word])
        index = CLASSES.index(name if name in CLASSES else "OTHER")
        classes.append(nn.functional.one_hot(torch.tensor(index), len(CLASSES)))
    stacked = torch.stack(words)
    return stacked, torch.stack(classes).to(stacked.dtype)


class Evaluator(nn.Module):
    """Both encoders; the parts are named as in the published file."""

    def __init__(self, config: TextMotionConfig) -> None:
        super().__init__()
        self.movement_encoder = MovementEncoder(config)
        self.motion_encoder = SequenceEncoder(
            config.movement, config.motion_state, config.embedding
        )
        self.text_encoder = TextEncoder(config)

    def motions(self, clips: list[Tensor], mean: Tensor, std: Tensor) -> Tensor:
        """Embeddings of clips `[T, channels]` of at most 196 frames."""
        batch = torch.zeros(len(clips), PADDED_FRAMES, len(mean), dtype=mean.dtype)
        for row, clip in zip(batch, clips, strict=True):
            row[: len(clip)] = (clip - mean) / std
        lengths = torch.tensor([len(clip) // UNIT_FRAMES for clip in clips])
        movements = self.movement_encoder(batch[..., :-CONTACTS])
        return self.motion_encoder(movements, lengths)


def metrics(texts: Tensor, motions: Tensor, real: Tensor) -> dict[str, Tensor]:
    """R-precision of top 1 to 3, mean distance of pairs and Fréchet distance from `real`."""
    hits = []
    for first in range(0, len(texts) - POOL + 1, POOL):
        pool = slice(first, first + POOL)
        nearest = torch.cdist(texts[pool], motions[pool]).argsort(dim=1)[:, :3]
        hits.append(nearest == torch.arange(POOL)[:, None])
    product = motions.T.cov() @ real.T.cov()
    cross = torch.linalg.eigvals(product).sqrt().real.sum()
    frechet = (motions.mean(0) - real.mean(0)).square().sum()
    frechet += motions.T.cov().trace() + real.T.cov().trace() - 2 * cross
    return {
        "r_precision": torch.cat(hits).double().mean(0).cumsum(0),
        "multimodal_distance": (texts - motions).norm(dim=1).mean()[None],
        "frechet_distance": frechet[None],
    }

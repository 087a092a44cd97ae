#!/usr/bin/env python3
"""Writes the files of `data_fixtures/clip`: a tiny text encoder of CLIP with random weights, in the
layout of the model hub, and embeddings of some sentences by the Python package `transformers`.

    python3 scripts/peer/clip_fixtures.py [FOLDER]

With `--merges FILE`, the vocabulary is that of a published list of merges, and with `--full` the
network has the sizes of ViT-B/32: too large to be committed, for a manual check

    python3 scripts/peer/clip_fixtures.py /tmp/clip --merges bpe_simple_vocab_16e6.txt --full
    KINEGRAD_CLIP=/tmp/clip cargo test -p kinegrad-train --lib text_encoder
"""

import argparse
import json
from collections import Counter
from pathlib import Path

import torch
from safetensors.torch import save_file
from transformers import CLIPTextConfig, CLIPTextModelWithProjection, CLIPTokenizer

FOLDER = Path(__file__).resolve().parents[2] / "data_fixtures" / "clip"
MERGES = 180
STORED = 64  # values of each embedding
MAX_LENGTH = 22  # start, 20 tokens of the text, end

SENTENCES = [
    "a person walks in a circle",
    "A person walks in a circle.",
    "a man slowly walks forward, turns around and walks back",
    "someone is jumping up and down; then he sits down on a chair!",
    "a person walks forward 10 steps",
    "3.14159 steps in 2026",
    "the person's left arm isn't raised, they're waving",
    "I'll say he'd've walked; we're done, it's o'clock",
    "walks/runs (quickly) - then stops...",
    "",
    "   spaces   and\ttabs\nand lines  ",
    "a",
    "?!",
    "caf\u00e9 na\u00efve r\u00e9sum\u00e9",
    "cafe\u0301 nai\u0308ve",  # the same letters in two parts
    "eine Person l\u00e4uft \u00fcber die Stra\u00dfe",
    "\u4eba\u304c\u6b69\u304f",
    "\u0447\u0435\u043b\u043e\u0432\u0435\u043a \u0418\u0434\u0451\u0442",
    "dance \U0001f483\U0001f57a now",
    "\u0130stanbul",
    "x\u00b2 + y\u00b3 = \u00bd",
    "\u201cquoted\u201d \u2014 and a dash\u2026",
    "HTML &amp; entities &lt;b&gt;",
    "under_score and-hyphen and@at #tag $5 50% ~ ^ |",
    "UPPER lower MiXeD",
    "a person walks in a counterclockwise circle while waving both of their hands above the head, "
    "then stops, bows, and leaves to the left",
    "one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen "
    "seventeen eighteen nineteen twenty twenty-one",
    "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
    "123456789012345678901234567890",
    "supercalifragilisticexpialidocious pneumonoultramicroscopicsilicovolcanoconiosis",
    "a\u00a0b\u2003c",
    "the man's dog's toys",
    "'s 't 're 've 'm 'll 'd",
    "walk walking walked walks walker",
    "someone does a cartwheel then another cartwheel",
]


def letters() -> list[str]:
    """The character of each byte: itself if visible, in the order of the published vocabulary."""
    visible = [*range(33, 127), *range(161, 173), *range(174, 256)]
    hidden = [byte for byte in range(256) if byte not in visible]
    return [chr(byte) for byte in visible] + [chr(256 + n) for n in range(len(hidden))]


def byte_letters() -> dict[int, str]:
    visible = [*range(33, 127), *range(161, 173), *range(174, 256)]
    hidden = [byte for byte in range(256) if byte not in visible]
    return dict(zip(visible + hidden, letters()))


def learned_merges(count: int) -> list[tuple[str, str]]:
    """Byte pairs that are frequent in the sentences, as byte-pair encoding learns them."""
    of_byte = byte_letters()
    words: Counter[tuple[str, ...]] = Counter()
    for sentence in SENTENCES:
        for word in "".join(c if c.isalpha() else " " for c in sentence.lower()).split():
            parts = [of_byte[byte] for byte in word.encode()]
            words[(*parts[:-1], parts[-1] + "</w>")] += 1
    merges: list[tuple[str, str]] = []
    while len(merges) < count:
        pairs: Counter[tuple[str, str]] = Counter()
        for word, times in words.items():
            for pair in zip(word, word[1:]):
                pairs[pair] += times
        best = min(pairs, key=lambda pair: (-pairs[pair], pair))
        merges.append(best)
        merged: Counter[tuple[str, ...]] = Counter()
        for word, times in words.items():
            parts: list[str] = []
            for part in word:
                if parts and (parts[-1], part) == best:
                    parts[-1] += part
                else:
                    parts.append(part)
            merged[tuple(parts)] += times
        words = merged
    return merges


def read_merges(path: Path) -> list[tuple[str, str]]:
    """The part of the published list of merges that the published model uses."""
    lines = path.read_text("utf-8").split("\n")[1 : 49152 - 256 - 2 + 1]
    return [(one, other) for one, other in (line.split() for line in lines)]


def network(config: CLIPTextConfig) -> CLIPTextModelWithProjection:
    """Random weights of which each matters: a matrix divided by the root of its fan-in."""
    model = CLIPTextModelWithProjection(config).eval()
    random = torch.Generator().manual_seed(7)
    with torch.no_grad():
        for name, weight in model.named_parameters():
            normal = torch.randn(weight.shape, generator=random)
            if "norm" in name and name.endswith("weight"):
                normal = 1 + 0.2 * normal
            elif "embedding" not in name and weight.dim() == 2:
                normal = 1.5 * normal / weight.shape[1] ** 0.5
            elif weight.dim() == 1:
                normal = 0.1 * normal
            # As stored.
            weight.copy_(normal.half().float())
    return model


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER)
    parser.add_argument("--merges", type=Path)
    parser.add_argument("--full", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    folder: Path = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)

    merges = read_merges(arguments.merges) if arguments.merges else learned_merges(MERGES)
    tokens = letters()
    tokens += [letter + "</w>" for letter in tokens]
    tokens += [one + other for one, other in merges]
    tokens += ["<|startoftext|>", "<|endoftext|>"]
    assert len(set(tokens)) == len(tokens)
    vocabulary = {token: number for number, token in enumerate(tokens)}
    with (folder / "vocab.json").open("w", encoding="utf-8") as file:
        json.dump(vocabulary, file, ensure_ascii=False, separators=(",", ":"))
        file.write("\n")
    lines = "".join(f"{one} {other}\n" for one, other in merges)
    (folder / "merges.txt").write_text("#version: 0.2\n" + lines, "utf-8")

    sizes = dict(
        hidden_size=12,
        intermediate_size=20,
        num_hidden_layers=2,
        num_attention_heads=3,
        max_position_embeddings=24,
    )
    sizes = {} if arguments.full else sizes
    end = len(tokens) - 1
    config = CLIPTextConfig(
        vocab_size=len(tokens),
        projection_dim=512,
        bos_token_id=end - 1,
        eos_token_id=end,
        pad_token_id=end,
        **sizes,
    )
    keys = [
        "hidden_act",
        "hidden_size",
        "intermediate_size",
        "layer_norm_eps",
        "max_position_embeddings",
        "model_type",
        "num_attention_heads",
        "num_hidden_layers",
        "projection_dim",
        "vocab_size",
    ]
    stated = {"architectures": ["CLIPTextModelWithProjection"]}
    stated |= {key: config.to_dict()[key] for key in keys}
    (folder / "config.json").write_text(json.dumps(stated, indent=2) + "\n", "utf-8")

    model = network(config)
    weights = {name: value.half().contiguous() for name, value in model.state_dict().items()}
    weights = {name: value for name, value in weights.items() if "position_ids" not in name}
    save_file(weights, folder / "model.safetensors", {"format": "pt"})

    tokenizer = CLIPTokenizer(
        vocab=str(folder / "vocab.json"), merges=str(folder / "merges.txt")
    )
    given = tokenizer(SENTENCES, truncation=True, max_length=MAX_LENGTH)["input_ids"]
    batch = tokenizer(
        SENTENCES, truncation=True, max_length=MAX_LENGTH, padding=True, return_tensors="pt"
    )
    with torch.no_grad():
        embeddings = model.double()(**batch).text_embeds
        single = model.float()(**batch).text_embeds
    print(f"{len(SENTENCES)} sentences, tokens {min(map(len, given))} to {max(map(len, given))}")
    print(f"embeddings up to {embeddings.abs().max():.3f}; in float32 {(single - embeddings).abs().max():.2e} off")
    expected = {"sentences": SENTENCES, "tokens": given}
    with (folder / "expected.json").open("w", encoding="utf-8") as file:
        json.dump(expected, file, separators=(",", ":"))
        file.write("\n")
    text = embeddings[:, :STORED].float().contiguous()
    save_file({"text": text}, folder / "expected.safetensors")


if __name__ == "__main__":
    main()

"""Datasets from Python: items, training batches, and forked processes."""

import multiprocessing
import pickle

import numpy as np
import pytest

import kinegrad


@pytest.fixture(scope="session")
def folder(tmp_path_factory, command):
    """A dataset of phrases on disk."""
    folder = tmp_path_factory.mktemp("data") / "phrases"
    command("data", "synth", "--out", folder, "--phrases", "10", "--frames", "30")
    return folder


@pytest.fixture(scope="session")
def config(folder, tmp_path_factory):
    path = tmp_path_factory.mktemp("config") / "own.toml"
    path.write_text(
        f'[run]\nseed = 5\n[data]\nsource = "{folder}"\ntarget_frames = 24\nbatch_size = 4\n'
        "num_workers = 2\n[data.validation]\nfraction = 0.3\n[data.augment]\nmirror = true\n"
    )
    return path


def equal(one, other):
    assert list(one) == list(other)
    for key, value in one.items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, other[key])
        else:
            assert value == other[key]


def test_items_are_the_files(folder, config):
    train, held_out = kinegrad.Dataset(config), kinegrad.Dataset(config, split="validation")
    assert len(train) + len(held_out) == 10 and len(held_out) > 0
    assert not set(train.ids) & set(held_out.ids)
    for dataset in (train, held_out):
        for position, item in enumerate(dataset):
            assert item["id"] == dataset.ids[position]
            stored = np.load(folder / "motion" / item["id"] / "trajectory.npy")
            np.testing.assert_array_equal(item["motion"], stored)
            assert item["audio"].shape == (163, 30) and item["audio"].dtype == np.float32
    equal(train[-1], train[len(train) - 1])
    equal(train[train.ids[2]], train[2])
    assert [item["id"] for item in train[1:3]] == train.ids[1:3]
    assert train.fps == 30 and train.config["batch_size"] == 4
    with pytest.raises(IndexError):
        train[len(train)]
    with pytest.raises(KeyError):
        train["nobody"]
    whole = kinegrad.Dataset(folder, settings={"data.validation.fraction": 0.0})
    assert sorted(whole.ids) == sorted(train.ids + held_out.ids)


def test_batches_follow_from_seed_and_number(config):
    dataset = kinegrad.Dataset(config)
    stream = dataset.batches()
    batches = [next(stream) for _ in range(6)]
    assert stream.number == 6
    for batch in batches:
        assert batch["motion"].shape == (4, 25, 24) and batch["audio"].shape == (4, 163, 24)
        assert batch["mask"].shape == (4, 24) and len(batch["ids"]) == 4
    seen = [id for batch in batches for id in batch["ids"]]
    whole = len(seen) // len(dataset)
    for epoch in range(whole):
        epoch_ids = seen[epoch * len(dataset) : (epoch + 1) * len(dataset)]
        assert sorted(epoch_ids) == dataset.ids
    equal(next(dataset.batches(first=4)), batches[4])
    equal(next(dataset.batches(5, 4, num_workers=2)), batches[0])
    assert next(dataset.batches(seed=6))["ids"] != batches[0]["ids"]
    with pytest.raises(kinegrad.Error):
        dataset.batches(batch_size=0)


def test_batches_are_those_of_training(config, command, tmp_path):
    """A run's dataset has the table, the seed and the statistics of the run."""
    dataset = kinegrad.Dataset(config)
    stream = dataset.batches()
    order = [next(stream)["ids"] for _ in range(3)]
    command(
        *["train", config, "--runs-dir", tmp_path, "--set", "model.size=tiny"],
        *["--set", "train.max_steps=1", "--set", "validation.every_steps=0"],
        *["--set", "sampling.count_at_end=0"],
    )
    run = kinegrad.Run(tmp_path / "own")
    own = run.dataset().batches()
    assert [next(own)["ids"] for _ in range(3)] == order
    np.testing.assert_array_equal(run.dataset().mean, dataset.mean)
    # Denormalised, an uncropped and unmirrored batch is the phrases themselves.
    plain = {"data.augment.mirror": False, "data.target_frames": 30}
    dataset = kinegrad.Dataset(config, settings=plain)
    batch = next(dataset.batches())
    for id, motion in zip(batch["ids"], batch["motion"]):
        rows = motion.T * dataset.std + dataset.mean
        np.testing.assert_allclose(rows, dataset[id]["motion"], atol=1e-4)


def test_clips(clips):
    dataset = clips.dataset()
    item = dataset[0]
    assert item["motion"].shape[1] == 263 and isinstance(item["captions"], list)
    batch = next(dataset.batches(batch_size=3))
    assert batch["motion"].shape == (3, 263, 80) and batch["text"].shape == (3, 512, 1)
    assert dataset.fps == 20


def work(dataset, stream, results):
    results.put((dataset[1]["motion"], next(stream), dataset.ids, len(dataset)))


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.parametrize("workers", [0, 2])
def test_other_processes_read_on(config, method, workers):
    dataset = kinegrad.Dataset(config)
    stream = dataset.batches(num_workers=workers)
    # Threads and caches of this process are in use before the fork.
    item, first = dataset[1], next(stream)
    context = multiprocessing.get_context(method)
    results = context.Queue()
    processes = [
        context.Process(target=work, args=(dataset, stream, results), daemon=True)
        for _ in range(2)
    ]
    for process in processes:
        process.start()
    answers = [results.get(timeout=60) for _ in processes]
    for process in processes:
        process.join(timeout=60)
        assert process.exitcode == 0
    second = next(stream)
    for motion, batch, ids, length in answers:
        np.testing.assert_array_equal(motion, item["motion"])
        equal(batch, second)
        assert ids == dataset.ids and length == len(dataset)
    assert first["ids"] != second["ids"]


def compute(run, results):
    results.put(run.sample(steps=2, progress=False)[0].motion)


def test_forks_compute_with_threads_of_their_own(phrases, song):
    expected = phrases.sample(steps=2, progress=False)[0].motion
    kinegrad.audio_features(song)
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=compute, args=(phrases, results), daemon=True)
    process.start()
    np.testing.assert_array_equal(results.get(timeout=60), expected)
    process.join(timeout=60)
    assert process.exitcode == 0


def test_a_pickled_stream_goes_on(config):
    stream = kinegrad.Dataset(config).batches()
    next(stream)
    copy = pickle.loads(pickle.dumps(stream))
    equal(next(copy), next(stream))


def test_what_is_no_dataset(tmp_path):
    with pytest.raises(kinegrad.Error):
        kinegrad.Dataset(tmp_path / "none")
    with pytest.raises(TypeError):
        kinegrad.Dataset()
    with pytest.raises(kinegrad.UsageError, match="split"):
        kinegrad.Dataset(tmp_path, split="test")

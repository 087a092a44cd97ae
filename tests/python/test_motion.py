"""BVH files, checks and metrics."""

import json

import numpy as np
import pytest

import kinegrad
from kinegrad import metrics


def test_bvh_is_read_at_the_joints_it_was_written_with(clips, command, tmp_path):
    (sample,) = clips.sample(steps=2, progress=False)
    bodies = np.repeat(sample.motion[:1], 5, axis=0) + np.arange(5)[:, None, None] * 0.1
    kinegrad.write_bvh(tmp_path / "clip.bvh", bodies)
    read = kinegrad.read_bvh(tmp_path / "clip.bvh")
    assert read.fps == pytest.approx(20) and read.parents[0] == -1
    assert all(parent < joint for joint, parent in enumerate(read.parents))
    names = ["pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee"]
    for joint, name in enumerate(names):
        found = read.positions[:, read.names.index(name)]
        np.testing.assert_allclose(found, bodies[:, joint], atol=1e-4)
    metres = kinegrad.read_bvh(tmp_path / "clip.bvh", units_per_metre=1.0)
    np.testing.assert_allclose(metres.positions, 100 * read.positions)
    # The command line writes the same text.
    kinegrad.write_bvh(tmp_path / "again.bvh", sample.motion)
    command("sample", clips.path, "--steps", "2", "--out", tmp_path / "cli")
    made, written = (kinegrad.read_bvh(tmp_path / name) for name in ("again.bvh", "cli.bvh"))
    np.testing.assert_allclose(made.positions, written.positions, atol=1e-4)


def test_bvh_refuses(tmp_path):
    with pytest.raises(kinegrad.UsageError, match="5 joints"):
        kinegrad.write_bvh(tmp_path / "x.bvh", np.zeros((3, 5, 3)))
    with pytest.raises(kinegrad.UsageError, match="shape"):
        kinegrad.write_bvh(tmp_path / "x.bvh", np.zeros((3, 66)))
    with pytest.raises(kinegrad.DataError):
        kinegrad.write_bvh(tmp_path / "x.bvh", np.full((3, 22, 3), np.nan))
    (tmp_path / "bad.bvh").write_text("HIERARCHY\nnothing\n")
    with pytest.raises(kinegrad.UsageError, match="bad.bvh"):
        kinegrad.read_bvh(tmp_path / "bad.bvh")
    with pytest.raises(kinegrad.StorageError) as raised:
        kinegrad.read_bvh(tmp_path / "none.bvh")
    assert isinstance(raised.value, OSError)
    with pytest.raises(ValueError):
        kinegrad.read_bvh(tmp_path / "bad.bvh", units_per_metre=0)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.bvh"]


def test_checks_are_those_of_the_command_line(phrases, command, tmp_path):
    (sample,) = phrases.sample(progress=False)
    (path, _, *_) = sample.save(tmp_path / "x")
    for profile, options in [("ccmotion", []), ("strict", ["--run", phrases.path])]:
        code = 0 if kinegrad.check(sample.motion, profile, phrases.path)["passed"] else 1
        text = command("check", path, "--profile", profile, "--json", *options, code=code)
        (expected,) = json.loads(text)["files"]
        found = kinegrad.check(path, profile, run=phrases.path)
        assert found["checks"] == expected["checks"] and found["passed"] == expected["passed"]
    # Without a run the bounds are those of captured people.
    assert kinegrad.check(sample.motion) == kinegrad.check(sample.motion, "strict")
    found = kinegrad.check(sample.motion, "ccmotion", thresholds={"max_jerk": 0.0})
    assert "jerk" in [check["name"] for check in found["checks"] if not check["passed"]]
    for profile, thresholds in [("strict", {}), ("ccmotion", {"max_jerks": 1.0})]:
        with pytest.raises(kinegrad.UsageError, match="thresholds"):
            kinegrad.check(sample.motion, profile, thresholds=thresholds)
    with pytest.raises(kinegrad.UsageError, match="not a known motion representation"):
        kinegrad.check(np.zeros((4, 7)))
    with pytest.raises(kinegrad.UsageError, match="profile"):
        kinegrad.check(sample.motion, "loose")


def test_phrases_are_processed_as_samples_are(phrases):
    (sample,) = phrases.sample(progress=False)
    for profile in ["ccmotion", "none"]:
        (other,) = phrases.sample(postprocess=profile, progress=False)
        assert np.array_equal(kinegrad.postprocess(sample.raw, profile, phrases.path), other.motion)
    smooth = kinegrad.postprocess(sample.raw, "none", settings={"apply_smoothing": True})
    raw = kinegrad.postprocess(sample.raw, "none")
    assert np.abs(np.diff(smooth[:, :3], 3, axis=0)).mean() < np.abs(
        np.diff(raw[:, :3], 3, axis=0)
    ).mean()
    for settings in [{"smooth": True}, {"smoothing_kernel_size": 2}]:
        with pytest.raises(kinegrad.UsageError, match="smooth"):
            kinegrad.postprocess(sample.raw, settings=settings)
    with pytest.raises(kinegrad.UsageError, match="25"):
        kinegrad.postprocess(np.zeros((4, 22, 3)))


def test_metrics_of_bodies():
    time = np.arange(6)[:, None] / 4
    moving = np.concatenate([time**3, np.ones_like(time), 0 * time], axis=1)
    resting = np.zeros((6, 3))
    positions = np.stack([moving, resting], axis=1)
    assert metrics.jerk(positions, 4.0) == pytest.approx(3.0)
    assert metrics.jerk(positions[:3], 4.0) is None
    sliding = np.zeros((5, 22, 3), dtype=np.float32)
    sliding[:, 10, 0] = np.arange(5)
    sliding[3:, 10, 1] = 1.0
    assert metrics.foot_skating(sliding, 20.0) == pytest.approx(0.5)
    sliding[1:, 10, 0] -= 0.9
    assert metrics.foot_sliding(sliding, 20.0) == pytest.approx(0.5)
    assert metrics.foot_skating(sliding, 20.0, feet=[11]) == 0.0
    with pytest.raises(kinegrad.UsageError, match="joint 22"):
        metrics.foot_skating(sliding, 20.0, feet=[22])


def test_metrics_of_sets():
    features = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 10.0]])
    assert metrics.diversity(features) == pytest.approx((15 + 45**0.5) / 3)
    assert metrics.diversity(features[:1]) is None
    a, b = np.array([[0.0], [2.0]]), np.array([[3.0], [9.0]])
    expected = 25 + (18**0.5 - 2**0.5) ** 2
    assert metrics.frechet_distance(a, b) == pytest.approx(expected)
    # Strided arrays and other dtypes are accepted.
    assert metrics.frechet_distance(a[::-1].astype(np.int64), b[::-1]) == pytest.approx(expected)
    assert metrics.frechet_distance(a, np.full((2, 1), np.nan)) is None
    with pytest.raises(kinegrad.UsageError, match="features"):
        metrics.frechet_distance(a, features)


def test_metrics_of_phrases(phrases):
    motion = np.zeros((6, 25), dtype=np.float32)
    motion[:, 3] = [3.0, 1.0, 2.0, 4.0, 0.5, 5.0]
    np.testing.assert_allclose(metrics.kinematic_beats(motion) * 30, [1.0, 4.0])
    assert metrics.beat_alignment([1.0], [0.9, 1.05]) == pytest.approx(np.exp(-0.5))
    assert metrics.beat_alignment([], [1.0]) is None
    item = phrases.dataset()[0]["motion"]
    features = metrics.trajectory_features(item, phrases.dataset().std)
    assert features.shape == (18,)
    expected = item[:, :9].mean(0) / phrases.dataset().std[:9]
    np.testing.assert_allclose(features[:9], expected, rtol=1e-3, atol=1e-5)
    with pytest.raises(kinegrad.UsageError):
        metrics.trajectory_features(item, [1.0])

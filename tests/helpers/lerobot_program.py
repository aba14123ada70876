# mypy: ignore-errors
"""Run by a Python that has LeRobot: reads a dataset with LeRobot's own reader, writes one with its own
writer, or asks a policy of its own for actions.

python lerobot_program.py read ROOT FOUND.npz
python lerobot_program.py write ROOT image|video
python lerobot_program.py act ROOT MODEL ACTIONS.npy
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.compute_stats import compute_episode_stats
from lerobot.datasets.feature_utils import validate_frame
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.utils.constants import DEFAULT_FEATURES
from lerobot.utils.feature_utils import dataset_to_policy_features

WINDOW = 3
FPS = 20


def read(root: str, found: str) -> None:
    """Save what LeRobot gives of a dataset: batches, windows, statistics. Raises where a check of its fails."""
    dataset = opened(root)
    loader = torch.utils.data.DataLoader(dataset, batch_size=7, shuffle=False, num_workers=2)
    batches = list(loader)
    result = {}
    for key in batches[0]:
        values = [batch[key] for batch in batches]
        if isinstance(values[0], torch.Tensor):
            joined = torch.cat(values).numpy()
            result[key] = np.rint(joined * 255).astype(np.uint8) if "images" in key else joined
        else:
            result[key] = np.array([value for batch in values for value in batch])
    check(dataset)
    windows = opened(root, delta_timestamps={"action": [step / dataset.fps for step in range(WINDOW)]})
    result["windows"] = np.stack([windows[at]["action"].numpy() for at in range(len(windows))])
    result["windows_pad"] = np.stack([windows[at]["action_is_pad"].numpy() for at in range(len(windows))])
    last = opened(root, episodes=[dataset.num_episodes - 1])
    result["last_episode"] = np.array([last[at]["index"].item() for at in range(len(last))])
    if not dataset.meta.video_keys:
        streamed = StreamingLeRobotDataset(dataset.repo_id, root=root, shuffle=False)
        result["streamed"] = np.array([int(frame["index"]) for frame in streamed])
        merged = Path(root).parent / "merged"
        aggregate_datasets(["own/one", "own/two"], "own/merged", roots=[Path(root)] * 2, aggr_root=merged)
        both = opened(str(merged))
        result["merged"] = np.stack([both[at]["action"].numpy() for at in range(len(both))])
    for feature, of in computed(dataset).items():
        result |= {f"stats/{feature}/{key}": value for key, value in of.items()}
    result["mean_of_pictures"] = dataset.meta.stats[dataset.meta.camera_keys[0]]["mean"]
    np.savez(found, **result)


def opened(root: str, **options: object) -> LeRobotDataset:
    return LeRobotDataset("own/dataset", root=root, video_backend="pyav", **options)


def check(dataset: LeRobotDataset) -> None:
    """LeRobot's own checks of a dataset's features and frames."""
    assert dataset.meta.total_frames == len(dataset)
    policy = dataset_to_policy_features(dataset.features)
    assert {"action", *dataset.meta.camera_keys} <= policy.keys() <= {*dataset.features}
    assert not any(name.startswith("log_") for name in policy)
    for at in range(0, len(dataset), 5):
        frame = {}
        for key, value in dataset[at].items():
            if key in DEFAULT_FEATURES:
                continue
            frame[key] = value
            if isinstance(value, torch.Tensor):
                of = dataset.features[key]
                is_camera = key in dataset.meta.camera_keys
                # its reader makes 32 bits of every number; the column has those that it says
                frame[key] = value.numpy() if is_camera else value.numpy().reshape(of["shape"]).astype(of["dtype"])
        features = {
            name: {**of, "shape": (3, of["shape"][0], of["shape"][1])} if name in dataset.meta.camera_keys else of
            for name, of in dataset.features.items()
        }
        validate_frame(frame, features)


def computed(dataset: LeRobotDataset) -> dict:
    """Statistics of the numbers of the first episode, as LeRobot computes them."""
    length = dataset.meta.episodes[0]["length"]
    names = ("action", "observation.state")
    rows = [dataset[at] for at in range(length)]
    data = {name: np.stack([row[name].numpy() for row in rows]) for name in names if name in dataset.features}
    return compute_episode_stats(data, dataset.features)


def write(root: str, dtype: str) -> None:
    """Two episodes of 6 and 4 frames, as somebody with LeRobot records them."""
    features = {
        "observation.images.front": {
            "dtype": dtype,
            "shape": (64, 96, 3),
            "names": ["height", "width", "channels"],
        },
        "action": {"dtype": "float32", "shape": (2,), "names": ["throttle", "steering"]},
    }
    dataset = LeRobotDataset.create("own/dataset", FPS, features, root=root, use_videos=dtype == "video")
    row = 0
    for length in (6, 4):
        for _ in range(length):
            picture = np.zeros((64, 96, 3), np.uint8)
            picture[..., 0] = 20 * row  # red
            picture[:, :48, 2] = 200
            action = np.array([0.5, -1 + 0.2 * row], np.float32)
            dataset.add_frame({"observation.images.front": picture, "action": action, "task": "Drive."})
            row += 1
        dataset.save_episode()
    dataset.finalize()


def act(root: str, model: str, actions: str) -> None:
    """Save the action (3,) that a trained ACT gives for each frame, one observation at a time, as a robot asks."""
    policy = ACTPolicy.from_pretrained(model)
    before, after = make_pre_post_processors(policy.config, model)
    answers = []
    for frame in opened(root):
        policy.reset()
        observation = {key: value for key, value in frame.items() if key.startswith("observation.")}
        answers.append(after(policy.select_action(before(observation)))[0].numpy())
    np.save(actions, np.stack(answers))


if __name__ == "__main__":
    {"read": read, "write": write, "act": act}[sys.argv[1]](*sys.argv[2:])

"""What trackers' own readers find: every point as often as it is there, and the settings."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from otc_dist.run.folder import RunFolder
from otc_dist.track.points import Points

# (source/name, step, value as float32), sorted; and section.key -> value, as text.
Found = tuple[list[tuple[str, int, float]], Mapping[str, str]]


def tensorboard(folder: Path) -> Found:
    from google.protobuf.json_format import MessageToDict
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.plugins.hparams import metadata, plugin_data_pb2

    points, settings = [], {}
    for source in folder.iterdir():
        if not source.is_dir():
            continue
        read = EventAccumulator(str(source), size_guidance={"scalars": 0}).Reload()
        points += [
            (f"{source.name}/{tag}", event.step, float(event.value))
            for tag in read.Tags()["scalars"]
            for event in read.Scalars(tag)
        ]
        if content := read.summary_metadata.get(metadata.SESSION_START_INFO_TAG):
            content = plugin_data_pb2.HParamsPluginData.FromString(content.plugin_data.content)
            settings = MessageToDict(content)["sessionStartInfo"]["hparams"]
    return sorted(points), {name: str(value) for name, value in settings.items()}


def mlflow(folder: Path) -> Found:
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"
    from mlflow.tracking import MlflowClient

    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    (experiment,) = client.search_experiments(filter_string="name = 'otc_dist'")
    (run,) = client.search_runs([experiment.experiment_id])
    points = [
        (name, point.step, float(np.float32(point.value)))
        for name in run.data.metrics
        for point in client.get_metric_history(run.info.run_id, name)
    ]
    return sorted(points), run.data.params


READERS: dict[str, Callable[[Path], Found]] = {"mlflow": mlflow, "tensorboard": tensorboard}


def measured(folder: RunFolder) -> list[tuple[str, int, float]]:
    """What a run's folder holds, in the readers' form."""
    return sorted(
        (f"{each.source}/{name}", each.step, float(np.float32(value)))
        for each in Points(folder).new()
        for name, value in each.values.items()
    )

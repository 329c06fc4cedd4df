# SPDX-License-Identifier: MIT
"""What `--dry-run` prints."""

from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.commands.line.output import console
from salsanext_cli.core.texts import counted

if TYPE_CHECKING:
    from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
    from salsanext_cli.commands.jobs.plans.training_plan import TrainingPlan


def print_plan(stage: str, plan: "RunPlan", out: Path, output: console.Output) -> None:
    """Print what a run of a stage into an output folder would do."""
    from salsanext_cli.core.fitting.sensor_texts import image_text

    output.result({"stage": stage, "out": str(out), **plan.to_dict()})
    scans = counted(plan.scans, "scan")
    todo = f"{len(plan.todo):,} to do"
    output.print(f"{stage}: {scans} found, {plan.done:,} done already, {todo} → {out}")
    for line in plan.lines():
        output.print(line)
    if plan.sensor is not None:
        members = plan.sensor.members
        for text in dict.fromkeys(image_text(sensor, plan.trained) for sensor in members):
            output.print(f"image: {text}")
    output.print(f"{_size_text(plan)}nothing was computed or written into {out}")


def _size_text(plan: "RunPlan") -> str:
    """Return the size of the results, followed by a semicolon; nothing without any."""
    if not plan.size:
        return ""
    limit = "at most " if plan.is_limit else ""
    points = ""
    if plan.points_per_scan is not None:
        points = f" for scans of {plan.points_per_scan:,} points"
    return f"results: {limit}{plan.size / 1e6:,.1f} MB{points}; "


def print_training_plan(plan: "TrainingPlan", run: Path, output: console.Output) -> None:
    """Print what a training in a run folder would do."""
    from salsanext_cli.core.fitting.sensor_texts import image_text

    output.result({"stage": "train", "run": str(run), **plan.to_dict()})
    scans, *lines = plan.lines()
    output.print(f"train: {scans} → {run}")
    for line in [*lines, f"image: {image_text(plan.sensor)}"]:
        output.print(line)
    size = f"{plan.size / 1e6:,.1f} MB"
    output.print(f"weights and checkpoints: {size}; nothing was trained or written into {run}")

# SPDX-License-Identifier: MIT
"""What `--dry-run` prints."""

from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.commands.line.output import console
from salsanext_cli.core.texts import counted

if TYPE_CHECKING:
    from salsanext_cli.commands.jobs.run_plan import RunPlan


def print_plan(stage: str, plan: "RunPlan", out: Path, output: console.Output) -> None:
    """Print what a run of a stage into an output folder would do."""
    from salsanext_cli.core.fitting.sensor_texts import image_text

    output.result({"stage": stage, "out": str(out), **plan.to_dict()})
    scans = counted(plan.scans, "scan")
    output.print(f"{stage}: {scans} found, {plan.done:,} done already, {plan.todo:,} to do → {out}")
    for text in dict.fromkeys(image_text(sensor, plan.trained) for sensor in plan.sensor.members):
        output.print(f"image: {text}")
    size = f"{plan.todo * plan.bytes_per_scan / 1e6:,.1f} MB"
    points = f"scans of {plan.points_per_scan:,} points"
    output.print(f"results: {size} for {points}; nothing was computed or written into {out}")

# SPDX-License-Identifier: MIT
"""`salsanext demo`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import progress_display
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import named_label_space
from salsanext_cli.runs.sensor_request import AUTO


def demo(
    folder: Path = argument("Folder to write to.", default=Path("demo"), metavar="FOLDER"),
    *,
    scans: int = option("Number of scans of the simulated drive.", default=4),
    samples: int = option("Monte-Carlo passes per scan.", default=8),
    classes: str | None = declarations.CLASSES,
    device: str = declarations.DEVICE,
    jobs: int = declarations.JOBS,
    cluster: str | None = declarations.CLUSTER,
    overwrite: bool = declarations.OVERWRITE,
    output: console.Output,
) -> None:
    """Run the whole pipeline on a simulated drive and list the results.

    Example: salsanext demo demo/
    """
    from salsanext_cli.commands.stages.demo import demo as stage
    from salsanext_cli.report.tables import score_table

    space = named_label_space(classes)
    demonstration = stage(
        folder,
        scans=scans,
        samples=samples,
        settings=NetworkSettings(device=device, precision=AUTO, classes=space),
        options=RunOptions(jobs=jobs, cluster=cluster, overwrite=overwrite),
        progress_of_step=lambda step: progress_display(step, output.quiet),
    )
    evaluation = demonstration.evaluation
    page = demonstration.page
    data = evaluation.to_dict()
    data["stage"] = "demo"
    data["pictures"] = [str(picture) for picture in demonstration.pictures]
    data["page"] = str(page)
    output.result(data, score_table(evaluation.scores))
    failures = (*demonstration.failures, *evaluation.failures)
    summary.print_failures(failures)
    results = folder / "out/sequences/00"
    output.print(f"scans: {folder / 'data'}; results: {results}")
    output.print(f"point clouds for CloudCompare, MeshLab or Open3D: {results}/ply/*.ply")
    output.print(f"one page with all results, for any browser: {page}")
    summary.exit_with_status(failures, evaluation.missing)

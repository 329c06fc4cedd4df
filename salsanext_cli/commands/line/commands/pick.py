# SPDX-License-Identifier: MIT
"""`salsanext pick`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.expansion import Declared
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_scans
from salsanext_cli.commands.line.values.scans_and_out import in_topic
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import demote_result_notices
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.scans.scan_selection import PICKED_SCANS, ScanSelection

if TYPE_CHECKING:
    from salsanext_cli.commands.picked_labels import PickedLabels
    from salsanext_cli.runs.loop.run import Failure


def pick(
    scans: Path = argument(declarations.SCANS_HELP, default=..., metavar="SCANS"),
    out: Path = declarations.NEW_DATASET,
    *,
    count: int | None = option("Number of scans to pick.", show_default=str(PICKED_SCANS)),
    names: Path | None = option(
        "Pick the scans whose names this text file lists, one per line.", "--from", metavar="FILE"
    ),
    tool: str | None = option(
        "Also write the scans for a labelling tool: point-labeler, segments, sse or supervisely.",
        "--for",
        metavar="TOOL",
    ),
    seed: int = option("Seed of the dropout masks.", default=0),
    labelled: list[Path] | None = option(
        "Data set of labelled scans, which the picked scans should differ from; may be given "
        "several times."
    ),
    selection: Annotated[ScanSelection, Declared(limit=declarations.SUBSET)],
    topic: str | None = declarations.TOPIC,
    settings: declarations.Network,
    running: declarations.Unsharded,
    dry_run: bool = declarations.DRY_RUN,
    strict: bool = declarations.STRICT,
    output: console.Output,
) -> None:
    """Pick the scans most worth labelling; write them as a data set with pre-labels to correct.

    Example: salsanext pick my/drive to-label/ --count 10
    """
    from salsanext_cli.commands.line.output.after_pick import lines_after_pick
    from salsanext_cli.commands.picked_labels import label_picked_scans
    from salsanext_cli.commands.stages.pick import pick as stage
    from salsanext_cli.commands.stages.pick import plan_pick
    from salsanext_cli.io.annotation_tools.registry import tool_named
    from salsanext_cli.report.picked import picked_table
    from salsanext_cli.runs.scans.layouts import TOOL_FOLDER

    if names and count is not None:
        raise UsageError("--count", "chooses scans, and so does --from", "one of both")
    source = in_topic(scans, topic)
    count = PICKED_SCANS if count is None else count
    if dry_run:
        with demote_result_notices():
            plan = plan_pick(
                source,
                out,
                count=count,
                seed=seed,
                labelled=labelled or (),
                names=names,
                tool=tool,
                settings=settings,
                selection=selection,
                options=running,
            )
        print_plan("pick", plan, out, output)
        return
    with over_scans("pick", running, output.quiet) as options:
        picking = stage(
            source,
            out,
            count=count,
            seed=seed,
            labelled=labelled or (),
            names=names,
            tool=tool,
            settings=settings,
            selection=selection,
            options=options,
        )
    failures = picking.outcome.failures
    labels = None
    if picking.picked:
        with over_scans("pick", running, output.quiet) as options:
            labels = label_picked_scans(out, settings, options)
        failures = (*failures, *labels.failures)
    tool_folder = None if tool is None or not picking.picked else out / TOOL_FOLDER / tool
    data = picking.to_dict() | _labels_as_data(labels, failures)
    data |= {"out": str(out), "tool_folder": tool_folder and str(tool_folder)}
    output.result(data, picked_table(picking.picked) if picking.picked else None)
    summary.print_failures(failures)
    numbers = f"{len(picking.picked):,} of {counted(picking.scans, 'scan')}"
    counts = ", ".join([numbers, *summary.skipped_and_failed_texts(picking.outcome)])
    output.print(f"pick: {counts} → {out}" if picking.picked else f"pick: {counts}")
    if labels is not None:
        lines = lines_after_pick(
            out,
            picking,
            labels,
            settings.weights,
            labelled or (),
            tool_named(tool) if tool else None,
        )
        for line in lines:
            output.print(line)
    summary.exit_with_status(failures, failed=strict and bool(picking.warnings))


def _labels_as_data(
    labels: "PickedLabels | None", failures: Sequence["Failure"]
) -> dict[str, object]:
    """Return plain data about the labels of picked scans, and all failures, for JSON."""
    decision = labels.verdict.decision if labels and labels.verdict else None
    return {
        "predicted": labels and str(labels.folder),
        "decision": decision,
        "failures": [failure.to_dict() for failure in failures],
    }

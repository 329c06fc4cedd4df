# SPDX-License-Identifier: MIT
"""`salsanext eval`."""

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.errors import counted
from salsanext_cli.options import ScanSelection


def evaluate(
    *,
    results: options.Results,
    by_distance: options.ByDistance = False,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    running: options.Reading,
    output: console.Output,
) -> None:
    """Compare predictions with labels, as the official benchmark does.

    Scans that the weights were trained on are left out, unless all were.

    Example: salsanext eval --split valid
    """
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report.tables import ring_table, score_table, uncertainty_tables
    from salsanext_cli.results.result_folder import ResultFolder
    from salsanext_cli.stages.evaluate import ON_TRAINING_SCANS
    from salsanext_cli.stages.evaluate import evaluate as stage

    out = results.folder()
    folder = ResultFolder(out, dataset)
    labels = options.label_space(label_space)
    files, space = folder.predicted(selection, labels, options.label_space(classes))
    with over_scans("eval", running, output.quiet) as run:
        settings = folder.provenance(selection)
        evaluation = stage(
            *(files, out, space, run), by_distance=by_distance, settings=settings, labels=labels
        )
    tables = [score_table(evaluation.scores, ON_TRAINING_SCANS * evaluation.on_training_scans)]
    if by_distance:
        tables.append(ring_table(evaluation.by_distance))
    tables += uncertainty_tables(evaluation.uncertainty)
    kept = evaluation.uncertainty.kept
    sentences = [Text(kept.sentence)] if kept else []
    if settings["reject"] is not None:
        above = f"predict --reject {settings['reject']:g}"
        found = f"Points left unlabelled by {above} are missed ones, without uncertainty."
        sentences.append(Text(found))
    output.result(evaluation.to_dict(), Group(*tables, *sentences))
    run_end.name_failures(evaluation.failures)
    left_out = run_end.left_out(evaluation.missing)
    written = "scores.txt, eval.json, eval_*.png"
    output.say(f"eval: {counted(evaluation.scans, 'scan')}{left_out} → {out}/{written}")
    run_end.leave(evaluation.failures, evaluation.missing)

# SPDX-License-Identifier: MIT
"""`salsanext eval`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.core.notices import demote_reader_notices
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.results.query import ResultQuery

if TYPE_CHECKING:
    from rich.console import Group

    from salsanext_cli.commands.evaluation import Evaluation
    from salsanext_cli.commands.score_limits import JudgedLimit
    from salsanext_cli.core.measures.accepted_labels import AcceptedLabels


def evaluate(
    out: Path = declarations.RESULTS,
    *,
    by_distance: bool = option("Also evaluate by distance from the sensor.", default=False),
    fail_under: str | None = option(
        "Exit with status 1 if a score is below its limit in %, such as "
        "mean_iou=40,iou.person=20; mean_iou is that of the classes present.",
        metavar="LIMITS",
    ),
    fail_over: str | None = option(
        "Exit with status 1 if a score is above its limit in %, such as ece=2; guarantee has the "
        "limit of `tune risk`.",
        metavar="LIMITS",
    ),
    query: ResultQuery,
    running: declarations.ReadOnlyRunOptions,
    dry_run: bool = declarations.DRY_RUN,
    output: console.Output,
) -> None:
    """Compare predictions with labels, as the official benchmark does.

    Scans that the weights were trained on do not count, unless there are no others.

    Example: salsanext eval --split valid
    """
    from salsanext_cli.commands.line.values.limit_options import (
        FAIL_OVER,
        FAIL_UNDER,
        option_of,
        parse_limits,
    )
    from salsanext_cli.commands.stages.evaluate import evaluate as stage
    from salsanext_cli.commands.stages.evaluate import plan_evaluation

    lower_limits = parse_limits(fail_under, FAIL_UNDER)
    upper_limits = parse_limits(fail_over, FAIL_OVER)
    limits = (*lower_limits, *upper_limits)
    if dry_run:
        with demote_reader_notices():
            plan = plan_evaluation(out, by_distance=by_distance, limits=limits, query=query)
        print_plan("eval", plan, out, output)
        return
    with over_results("eval", running, output.quiet, at_end=True) as options:
        evaluation = stage(
            out, by_distance=by_distance, limits=limits, query=query, options=options
        )
    judged = evaluation.judged_limits(limits)
    missed = [score for score in judged if not score.is_kept]
    names = _names_of_missed(missed, fail_under, fail_over)
    output.result(evaluation.to_dict() | names, _evaluation_tables(evaluation))
    summary.print_failures(evaluation.failures)
    missing = evaluation.missing
    scans = f"{counted(evaluation.counts.scans, 'scan')}{summary.text_of_other_scans(missing)}"
    output.print(f"eval: {scans} → {evaluation.folder}/scores.txt, eval.json, eval_*.png")
    for score in judged:
        text = f"{option_of(score.limit.kind)} {score.text}"
        if score.is_kept:
            output.print(text)
        else:
            console.print_line(f"error: {text}")
    summary.exit_with_status(evaluation.failures, missing, failed=bool(missed))


def _names_of_missed(
    missed: "Sequence[JudgedLimit]", fail_under: str | None, fail_over: str | None
) -> dict[str, list[str]]:
    """Return the names of the missed limits of each option that was given, as keys of JSON."""
    names = {}
    if fail_under is not None:
        names["below"] = [score.name for score in missed if score.limit.kind.higher_is_better]
    if fail_over is not None:
        names["above"] = [score.name for score in missed if not score.limit.kind.higher_is_better]
    return names


def _evaluation_tables(evaluation: "Evaluation") -> "Group":
    """Return the tables and sentences of an evaluation."""
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report import tables

    printed: list[Any] = [tables.score_table(evaluation.scores, evaluation.doubt)]
    if evaluation.by_distance:
        printed.append(tables.band_table(evaluation.by_distance))
    printed += tables.uncertainty_tables(evaluation.uncertainty)
    if evaluation.uncertainty.accepted:
        printed.append(Text(evaluation.uncertainty.accepted.sentence))
    if evaluation.accepted:
        printed.append(tables.accepted_table(evaluation.accepted.classes))
        printed.append(Text("\n".join(_rejection_sentences(evaluation, evaluation.accepted))))
    return Group(*printed)


def _rejection_sentences(evaluation: "Evaluation", accepted: "AcceptedLabels") -> list[str]:
    """Return the sentences about the accepted labels of a run that rejected others."""
    threshold = evaluation.settings["reject"]
    counting = (
        f"Points rejected by `predict --reject` (threshold {threshold:.4g}) count as wrong in "
        "accuracy and IoU, and do not count in the official accuracy."
    )
    sentences = [counting, *accepted.sentences]
    if evaluation.guarantee:
        sentences.append(evaluation.guarantee.sentence)
    return sentences

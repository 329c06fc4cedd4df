# SPDX-License-Identifier: MIT
"""End of a run over scans: summary on stderr, JSON on stdout, exit status."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from salsanext_cli.commands.line.console import DONE, FAILED, Output, duration_text, print_line
from salsanext_cli.core.texts import MAX_NAMES_SHOWN, counted, first_few, percentage, with_hint

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from salsanext_cli.runs.loop.run import Failure, Outcome
    from salsanext_cli.runs.results.selection import MissingResults
    from salsanext_cli.runs.summary.scan_summary import RunSummary

LEAST_SHOWN = 0.0005  # Share that is rounded to 0.1 %


def finish(
    stage: str,
    outcome: Outcome,
    out: object,
    output: Output,
    *more: str,
    split: str | None = None,
    strict: bool = False,
    results: object = None,
    limit: float | str | None = None,
    advice: str = "",
) -> NoReturn:
    """Print the summary of a run and exit with its status.

    `more`: further options of the next command; `results`: folder of the next command, if not
    `out`; `limit`: largest probability of error of an accepted point, or "risk"; `advice`: a
    further line.
    """
    print_failures(outcome.failures)
    following = next_command(stage, outcome, str(results or out), more, split)
    output.result({"stage": stage, "out": str(out), **_as_data(outcome), "next": following})
    took = f" in {duration_text(output.seconds)}"
    took += f", {duration_text(outcome.seconds / outcome.done)} per scan" if outcome.done else ""
    scans = f"{counted(outcome.done, 'scan')}{others_text(outcome)}{took}"
    output.print(f"{stage}: {scans}{skipped_text(outcome.missing)} → {out}")
    lines = _lines(outcome.summary, following) if outcome.done + outcome.skipped else ()
    for line in (*_rejection_lines(outcome, limit), advice, *lines):
        if line:
            output.print(line)
    is_doubtful = strict and outcome.summary is not None and bool(outcome.summary.findings)
    leave(outcome.failures, outcome.missing, failed=is_doubtful)


def _rejection_lines(outcome: Outcome, limit: float | str | None) -> Iterable[str]:
    """Yield how many points were rejected or filtered."""
    if (rejected := outcome.rejected_points) is not None:
        share = ""
        if outcome.summary and outcome.summary.judged_points:
            share = f" ({percentage(outcome.summary.rejected_share)} of the points with a label)"
        reason = "above the threshold of `tune risk`"
        if limit != "risk":
            reason = f"probability of error above {limit:g}"
        before = f"; {outcome.skipped} done already not counted" if outcome.skipped else ""
        yield f"{counted(rejected, 'point')}{share} rejected: {reason}{before}"
    filtered = outcome.filtered_points
    if filtered and outcome.done:
        without_error = ""
        if filtered.without_error:
            cause = "on the housing or the vehicle, not measured, or outside the image"
            number = counted(filtered.without_error, "point")
            without_error = f"; {number} dropped without a probability of error ({cause})"
        yield f"{filtered.remaining:,} of {counted(filtered.points, 'point')} remain{without_error}"


def _as_data(outcome: Outcome) -> dict[str, Any]:
    """Return plain data for JSON; docs/reference/json.md lists the keys."""
    data: dict[str, Any] = {
        "done": outcome.done,
        "skipped": outcome.skipped,
        "failed": len(outcome.failures),
        "failures": [failure.to_dict() for failure in outcome.failures],
        "seconds_per_scan": round(outcome.seconds / outcome.done, 4) if outcome.done else None,
    }
    if missing := outcome.missing:
        data |= missing.to_dict()
    if outcome.rejected_points is not None:
        data["rejected_points"] = outcome.rejected_points
        if outcome.summary:
            data["rejected_share"] = round(outcome.summary.rejected_share, 4)
    if filtered := outcome.filtered_points:
        data["points"] = filtered.points
        data["accepted_points"] = filtered.remaining
        data["accepted_without_label"] = filtered.rejected
        data["points_without_error"] = filtered.without_error
    if summary := outcome.summary:
        from salsanext_cli.core.plain_data import plain
        from salsanext_cli.core.sensors.sensor import NOISE

        data["folders"] = {scan.sequence: str(scan.path.parent) for scan in summary.scans}
        is_used = outcome.done + outcome.skipped > 0
        data["sensor"] = summary.sensor.to_dict(NOISE) if is_used else None
        data["unlabelled_share"] = round(summary.unlabelled_share, 4)
        data["unmeasured_share"] = round(summary.unmeasured_share, 4)
        data["largest_classes"] = summary.largest_classes()
        data["ego_share"] = round(summary.ego_share, 4)
        expected = summary.expected_accuracy()
        data["expected_accuracy"] = expected and asdict(expected)
        data["warnings"] = plain(summary.warnings())
    return data


def _lines(summary: RunSummary | None, following: str | None) -> Iterable[str]:
    """Yield images, unlabelled points, estimated accuracy, largest classes and next command."""
    if summary is not None:
        sensor = summary.sensor
        from salsanext_cli.core.fitting.sensor_texts import ego_text, image_text

        images = (image_text(member, summary.trained) for member in sensor.members)
        yield from (f"image: {text}" for text in dict.fromkeys(images))
        if (share := summary.unlabelled_share) >= LEAST_SHOWN:
            causes = "; ".join(_causes(summary, ego_text(sensor)))
            yield f"unlabelled: {percentage(share)} of all points{causes and f' ({causes})'}"
        if expected := summary.expected_accuracy():
            yield expected.text
        if largest := summary.largest_classes():
            shares = ", ".join(f"{name} {percentage(share)}" for name, share in largest.items())
            yield f"largest classes: {shares}"
    if following is not None:
        yield f"next: {following}"


def _causes(summary: RunSummary, region: str) -> Iterable[str]:
    """Yield why points are unlabelled, with shares of all points; `region`: of the vehicle."""
    if (unmeasured := summary.unmeasured_share) >= LEAST_SHOWN:
        yield f"{percentage(unmeasured)} without a measurement"
    if (ego := summary.ego_share) >= LEAST_SHOWN:
        where = "" if summary.sensor.others else f", {region}"
        yield f"{percentage(ego)} on the sensor's housing and vehicle{where}"
    if (rejected := summary.rejected_share_of_all) >= LEAST_SHOWN:
        yield f"{percentage(rejected)} rejected"


def next_command(
    stage: str, outcome: Outcome, out: str, more: Iterable[str], split: str | None = None
) -> str | None:
    """Return the usual next command line; return None if there are no results."""
    summary = outcome.summary
    if not outcome.done + outcome.skipped:
        return None
    if stage == "convert":
        words = ["predict", out]
    elif summary is None:
        return None
    elif stage == "project":
        words = ["predict", out, out]
    elif stage == "uncertainty":
        words = ["export-ply", out, "--colour", "uncertainty"]
    elif summary.space is None:
        words = ["knn-refine", out]  # The labels belong to pixels.
    else:
        words = ["eval" if summary.labelled else "report", out]
        if split == "test" and not summary.labelled:
            from salsanext_cli.runs.results.selection import unmerged

            if not unmerged(summary.space, summary.scans[:1]):
                words = ["submit", out, "submission.zip"]
    return shlex.join(["salsanext", *words, *more])


def print_failures(failures: tuple[Failure, ...]) -> None:
    """Print the errors of the failed scans on stderr; one for many scans with the same problem."""
    groups: dict[tuple[str, str], list[Failure]] = {}
    for failure in failures:
        problem = failure.reason.removeprefix(f"{failure.scan.path}: ")
        groups.setdefault((problem, failure.hint), []).append(failure)
    for (problem, hint), equal in groups.items():
        if len(equal) > MAX_NAMES_SHOWN:
            names = first_few([failure.scan.name for failure in equal])
            problem = f"{problem}: {names}" if problem != equal[0].reason else problem
            print_line(f"error: {counted(len(equal), 'scan')}: {with_hint(problem, hint)}")
            continue
        for text in dict.fromkeys(failure.text for failure in equal):
            print_line(f"error: {text}")


def others_text(outcome: Outcome) -> str:
    """Return how many scans were done already and how many failed, if any."""
    already = f", {outcome.skipped} done already" if outcome.skipped else ""
    failed = f", {len(outcome.failures)} failed" if outcome.failures else ""
    return f"{already}{failed}"


def leave(
    failures: Sequence[object], missing: MissingResults | None = None, *, failed: bool = False
) -> NoReturn:
    """Exit with status 1 if scans failed or lack results, else with 0."""
    raise typer.Exit(FAILED if failed or failures or (missing and missing.scans) else DONE)


def skipped_text(missing: MissingResults | None) -> str:
    """Return the part of a summary about scans that the earlier stages were not run on."""
    count = missing.not_asked_for if missing else 0
    return f" (not part of the run: {counted(count, 'other scan')})" if count else ""

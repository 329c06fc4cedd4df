# SPDX-License-Identifier: MIT
"""End of a run over scans: a summary on stderr, the same as JSON, and the exit status."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from salsanext_cli.cli.console import DONE, FAILED, Output, duration_text, tell
from salsanext_cli.errors import counted

if TYPE_CHECKING:
    from collections.abc import Iterable

    from salsanext_cli.measures.scan_summary import RunSummary
    from salsanext_cli.parallel.run import Failure, Outcome
    from salsanext_cli.results.selection import MissingResults

LEAST_SHOWN = 0.0005  # Share that is rounded to 0.1 %
SUBMITTED_SPLIT = "test"
SUBMISSION = "submission.zip"


def finish(
    stage: str,
    outcome: Outcome,
    out: object,
    output: Output,
    *more: str,
    split: str | None = None,
    strict: bool = False,
    results: object = None,
    advice: str = "",
) -> NoReturn:
    """Say what became of a run and leave with its exit status.

    `more`: options to type next; `results`: folder for the next command, if not `out`; `advice`: a
    line before the next command.
    """
    name_failures(outcome.failures)
    following = next_command(stage, outcome, str(results or out), more, split)
    found = {"stage": stage, "out": str(out), **_as_data(outcome), "next": following}
    output.result(found)
    each, missing = found["seconds_per_scan"], outcome.missing
    already = f", {outcome.skipped} done already" if outcome.skipped else ""
    failed = f", {len(outcome.failures)} failed" if outcome.failures else ""
    others = left_out(missing) if missing else ""
    took = f" in {duration_text(output.seconds)}"
    took += "" if each is None else f", {duration_text(each)} per scan"
    output.say(f"{stage}: {counted(outcome.done, 'scan')}{already}{failed}{took}{others} → {out}")
    if (rejected := outcome.rejected_points) is not None:
        before = f", besides {counted(outcome.skipped, 'scan')} before" if outcome.skipped else ""
        output.say(f"{counted(rejected, 'point')} unlabelled for their error{before}")
    if outcome.kept_points and outcome.done:
        points, kept = outcome.kept_points
        output.say(f"{kept:,} of {counted(points, 'point')} stay")
    for line in (*_lines(outcome.summary), advice, following and f"next: {following}"):
        if line:
            output.say(line)
    doubted = strict and outcome.summary is not None and bool(outcome.summary.findings)
    leave(outcome.failures, missing, failed=doubted)


def _as_data(outcome: Outcome) -> dict[str, Any]:
    """Return plain data for JSON; docs/json.md lists the keys."""
    each = outcome.seconds / outcome.done if outcome.done else None
    found: dict[str, Any] = {
        "done": outcome.done,
        "skipped": outcome.skipped,
        "failed": len(outcome.failures),
        "failures": [failure.to_dict() for failure in outcome.failures],
        "seconds_per_scan": None if each is None else round(each, 4),
    }
    if missing := outcome.missing:
        found |= missing.to_dict()
    if outcome.rejected_points is not None:
        found["rejected_points"] = outcome.rejected_points
    if outcome.kept_points:
        found["points"], found["kept_points"] = outcome.kept_points
    if summary := outcome.summary:
        from salsanext_cli.files.json_files import plain
        from salsanext_cli.sensors.sensor import NOISE

        found["sensor"] = summary.sensor.to_dict(NOISE)
        found["unlabelled_share"] = round(summary.unlabelled_share, 4)
        found["largest_classes"] = summary.largest_classes()
        found["ego_share"] = round(summary.ego_share, 4)
        expected = summary.expected_accuracy()
        found["expected_accuracy"] = expected and asdict(expected)
        found["warnings"] = plain(summary.warnings())
    return found


def _lines(summary: RunSummary | None) -> Iterable[str]:
    """Yield what else is worth knowing: the sensor, the classes."""
    if summary is not None:
        sensor = summary.sensor
        from salsanext_cli.fitting.field_of_view import ego_text, view_text

        lines = (f"{s.name}, {s.height}×{s.width}, {view_text(s)}" for s in sensor.members)
        yield from (f"sensor: {line}" for line in dict.fromkeys(lines))
        if (share := summary.unlabelled_share) >= LEAST_SHOWN:
            # The sample that the share of the vehicle is estimated from may exceed the total.
            ego = min(summary.ego_share, share)
            place = "" if sensor.others else f" ({ego_text(sensor)})"
            words = f", about {100 * ego:.1f} % on the sensor's housing and vehicle{place}"
            of_ego = words * (ego >= LEAST_SHOWN)
            yield f"unlabelled: {100 * share:.1f} % of the points{of_ego}"
        if expected := summary.expected_accuracy():
            yield expected.text
        if largest := summary.largest_classes():
            shares = ", ".join(f"{name} {100 * share:.1f} %" for name, share in largest.items())
            yield f"largest classes: {shares}"


def next_command(
    stage: str, outcome: Outcome, out: str, more: Iterable[str], split: str | None = None
) -> str | None:
    """Return the command line that most users type after a stage, None if nothing is there."""
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
        words = ["knn-refine", out]  # The labels are those of pixels.
    else:
        words = ["eval" if summary.labelled else "export-ply", out]
        if split == SUBMITTED_SPLIT and not summary.labelled:
            from salsanext_cli.stages.submit import unmerged

            if not unmerged(summary.space, [summary.first] if summary.first else []):
                words = ["submit", out, SUBMISSION]
    return shlex.join(["salsanext", *words, *more])


def name_failures(failures: tuple[Failure, ...]) -> None:
    """Name every scan that failed, on stderr; once what several failed for."""
    for text in dict.fromkeys(failure.text for failure in failures):
        tell(f"error: {text}")


def leave(
    failures: tuple[Failure, ...], missing: MissingResults | None = None, *, failed: bool = False
) -> NoReturn:
    """Leave with the exit status for scans that failed or lack results."""
    raise typer.Exit(FAILED if failed or failures or (missing and missing.scans) else DONE)


def left_out(missing: MissingResults) -> str:
    """Return the part of a sentence that says how many scans were left out on purpose."""
    count = missing.not_asked_for
    others, them = (f"{count:,} scans are", "them") if count > 1 else ("scan is", "it")
    text = f" (the other {others} left out: no earlier stage was asked for {them})"
    return text if count else ""

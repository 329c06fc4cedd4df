# SPDX-License-Identifier: MIT
"""End of a run over scans: summary on stderr, JSON on stdout, exit status."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from salsanext_cli.commands.line.output.console import DONE, FAILED, Output, print_line
from salsanext_cli.commands.line.output.progress import duration_text
from salsanext_cli.core.texts import MAX_LISTED_NAMES, counted, first_few, percentage, with_hint

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from salsanext_cli.runs.loop.run import Failure, Outcome
    from salsanext_cli.runs.scans.selection import MissingResults
    from salsanext_cli.runs.summary.run_summary import RunSummary

LEAST_SHARE = 0.0005  # Least share that a line states; it is rounded to 0.1 %


@dataclass(frozen=True, slots=True, kw_only=True)
class StageNumbers:
    """Numbers of one stage, beside those of every run."""

    data: Mapping[str, object] = field(default_factory=dict)  # By key of the JSON
    lines: Sequence[str] = ()  # Printed before the lines about the scans


NO_NUMBERS = StageNumbers()


def print_summary_and_exit(
    stage: str,
    outcome: Outcome,
    out: Path,
    output: Output,
    *,
    following: str | None = None,
    numbers: StageNumbers = NO_NUMBERS,
    strict: bool = False,
) -> NoReturn:
    """Print the summary of a run and exit with its status.

    Parameters
    ----------
    stage : str
        Name of the command.
    outcome : Outcome
        Outcome of the run.
    out : Path
        Folder of the results.
    output : Output
        Amount and form of the output.
    following : str, optional
        Command line that usually follows.
    numbers : StageNumbers
        Numbers of this stage only.
    strict : bool
        Whether a warning about a scan is a failure.
    """
    print_failures(outcome.failures)
    data = {"stage": stage, "out": str(out), **run_data(outcome), **numbers.data}
    if outcome.summary:
        data |= scans_data(outcome.summary, has_results=outcome.has_results)
    output.result({**data, "next": following})
    output.print(_headline(stage, outcome, out, output.seconds))
    for line in numbers.lines:
        output.print(line)
    if outcome.has_results:
        if outcome.summary and outcome.done and outcome.skipped:
            output.print(f"of the {counted(outcome.done, 'new scan')}:")
        for line in _lines_on_scans(outcome.summary):
            output.print(line)
        if following is not None:
            output.print(f"next: {following}")
    is_doubtful = outcome.summary is not None and bool(outcome.summary.findings.by_code)
    exit_with_status(outcome.failures, outcome.missing, failed=strict and is_doubtful)


def _headline(stage: str, outcome: Outcome, out: Path, seconds: float) -> str:
    """Return the line about the number of scans, the time and the folder of the results, if any."""
    counts = ", ".join([counted(outcome.done, "scan"), *skipped_and_failed_texts(outcome)])
    times = [duration_text(seconds)]
    if outcome.done:
        times.append(f"{duration_text(outcome.seconds / outcome.done)} per scan")
    if outcome.workers:
        times.append(f"by {outcome.workers} processes")
    scans = f"{counts} in {', '.join(times)}{text_of_other_scans(outcome.missing)}"
    return f"{stage}: {scans} → {out}" if outcome.has_results else f"{stage}: {scans}"


def run_data(outcome: Outcome) -> dict[str, Any]:
    """Return the numbers of a run as plain data for JSON; docs/reference/json.md lists the keys."""
    data: dict[str, Any] = {
        "done": outcome.done,
        "skipped": outcome.skipped,
        "failed": len(outcome.failures),
        "failures": [failure.to_dict() for failure in outcome.failures],
        "seconds_per_scan": round(outcome.seconds / outcome.done, 4) if outcome.done else None,
    }
    if outcome.missing:
        data |= outcome.missing.to_dict()
    return data


def scans_data(summary: RunSummary, *, has_results: bool) -> dict[str, Any]:
    """Return the summary of scans as plain data for JSON; no sensor without any results."""
    from salsanext_cli.core.plain_data import plain
    from salsanext_cli.core.sensors.sensor import NOISE

    expected = summary.expected_accuracy()
    return {
        "folders": {scan.sequence: str(scan.path.parent) for scan in summary.scans},
        "sensor": summary.sensor.to_dict(NOISE) if has_results else None,
        "unlabelled_share": round(summary.counts.unlabelled_share, 4),
        "unmeasured_share": round(summary.counts.unmeasured_share, 4),
        "largest_classes": summary.counts.largest_classes(summary.space),
        "ego_share": round(summary.counts.ego_share, 4),
        "expected_accuracy": None if expected is None else asdict(expected),
        "warnings": plain(summary.warnings()),
    }


def _lines_on_scans(summary: RunSummary | None) -> Iterator[str]:
    """Yield lines about images, unlabelled points, estimated accuracy and largest classes."""
    if summary is None:
        return
    from salsanext_cli.core.fitting.sensor_texts import ego_text, image_text

    sensor = summary.sensor
    images = [image_text(member, summary.trained) for member in sensor.members]
    for image in dict.fromkeys(images):
        yield f"image: {image}"
    unlabelled = summary.counts.unlabelled_share
    if unlabelled >= LEAST_SHARE:
        causes = "; ".join(_causes_of_unlabelled(summary, ego_text(sensor)))
        in_brackets = f" ({causes})" if causes else ""
        yield f"unlabelled: {percentage(unlabelled)} of all points{in_brackets}"
    expected = summary.expected_accuracy()
    if expected:
        yield expected.text
    largest = summary.counts.largest_classes(summary.space)
    if largest:
        shares = ", ".join(f"{name} {percentage(share)}" for name, share in largest.items())
        yield f"largest classes: {shares}"


def _causes_of_unlabelled(summary: RunSummary, vehicle: str) -> Iterator[str]:
    """Yield why points are unlabelled, with shares of all points.

    `vehicle`: text about the region of the vehicle, for scans of one sensor.
    """
    if summary.counts.unmeasured_share >= LEAST_SHARE:
        yield f"{percentage(summary.counts.unmeasured_share)} without a measurement"
    if summary.counts.ego_share >= LEAST_SHARE:
        region = "" if summary.sensor.others else f", {vehicle}"
        yield f"{percentage(summary.counts.ego_share)} on the sensor's housing and vehicle{region}"
    if summary.counts.rejected_share_of_all >= LEAST_SHARE:
        yield f"{percentage(summary.counts.rejected_share_of_all)} rejected"


def print_failures(failures: tuple[Failure, ...]) -> None:
    """Print the errors of the failed scans on stderr; one for many scans with the same problem."""
    groups: dict[tuple[str, str], list[Failure]] = {}
    for failure in failures:
        problem = failure.reason.removeprefix(f"{failure.scan.path}: ")
        groups.setdefault((problem, failure.hint), []).append(failure)
    for (problem, hint), group in groups.items():
        if len(group) > MAX_LISTED_NAMES:
            names_its_scan = problem != group[0].reason
            if names_its_scan:
                # The path of a single scan was removed, so the scans are named.
                names = first_few([failure.scan.name for failure in group])
                problem = f"{problem}: {names}"
            print_line(f"error: {counted(len(group), 'scan')}: {with_hint(problem, hint)}")
        else:
            for text in dict.fromkeys(failure.text for failure in group):
                print_line(f"error: {text}")


def skipped_and_failed_texts(outcome: Outcome) -> Iterator[str]:
    """Yield how many scans were done already and how many failed, if any."""
    if outcome.skipped:
        yield f"{outcome.skipped} done already"
    if outcome.failures:
        yield f"{len(outcome.failures)} failed"


def exit_with_status(
    failures: Sequence[object], missing: MissingResults | None = None, *, failed: bool = False
) -> NoReturn:
    """Exit with status 1 if scans failed or lack results, else with 0."""
    has_missing = missing is not None and bool(missing.scans)
    raise typer.Exit(FAILED if failed or failures or has_missing else DONE)


def text_of_other_scans(missing: MissingResults | None) -> str:
    """Return the part of a summary about scans that the earlier stages were not run on."""
    count = missing.not_asked_for if missing else 0
    return f" (not part of the run: {counted(count, 'other scan')})" if count else ""

# SPDX-License-Identifier: MIT
"""Warnings about scans: their texts, and how they are logged."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.label_checks import LABELS_HINT
from salsanext_cli.core.texts import first_few

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanWarning:
    """Reason to doubt some scans, with the text of the first of them."""

    code: str
    message: str
    hint: str
    scans: list[str]  # Names of the scans, or of their sequences


def hint_in(out: Path | None, hint: str) -> str:
    """Return a hint with the command that shows the labels in a folder of results, if it needs one.

    The command is no part of recorded hints, since folders of results may be moved.
    """
    if out is None or not hint.endswith(LABELS_HINT):
        return hint
    return f"{hint}: `{shlex.join(['salsanext', 'report', str(out)])}`"


def log_finding(name: str, finding: Finding, out: Path | None = None) -> None:
    """Log a reason to doubt a scan or sequence as a warning; `out`: folder of the results."""
    finding = replace(finding, hint=hint_in(out, finding.hint))
    log.warning("%s", finding.about(log_text(name)))


def log_recorded(warnings: Iterable[ScanWarning]) -> None:
    """Log the warnings of an earlier run."""
    for warning in warnings:
        finding = Finding(warning.code, warning.message, warning.hint)
        log_finding(first_few(warning.scans), finding)


def log_text(names: str) -> str:
    """Return names as valid text, which log handlers of other programs may require."""
    return names.encode(errors="backslashreplace").decode()

# SPDX-License-Identifier: MIT
"""Value of `--shard`: a share of the scans as text, or that of a task of a cluster.

Tasks of a Slurm array and pods of an indexed job of Kubernetes get their number in variables.
"""

import logging
import os
import re
from collections.abc import Mapping

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.loop.run_options import Shard

OPTION = "--shard"
SLURM_PREFIX = "SLURM_ARRAY_TASK_"
KUBERNETES_VARIABLES = ("JOB_COMPLETION_INDEX", "JOB_COMPLETIONS")
"""Index of a pod from 0, which Kubernetes sets, and their number, which its job must set."""

log = logging.getLogger(__name__)


def typed_shard(text: str | None) -> Shard:
    """Read ``i/n``; without it, return the share of this task of a cluster, else all."""
    if text is not None:
        return shard_of_text(text)
    for kind, find in (
        ("a task of a Slurm array", shard_of_slurm),
        ("a pod of an indexed job", shard_of_kubernetes),
    ):
        shard = find(os.environ)
        if shard is not None:
            log.log(NOTICE, "shard %s of the scans: this is %s", shard, kind)
            return shard
    return Shard()


def shard_of_text(text: str) -> Shard:
    """Read ``i/n``, counted from 1."""
    parts = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
    if not parts:
        raise UsageError(OPTION, repr(text), "i/n, such as 1/8")
    return Shard(int(parts[1]), int(parts[2]))


def shard_of_slurm(environment: Mapping[str, str]) -> Shard | None:
    """Return the shard of a task of a Slurm array with any start and step."""
    required = [SLURM_PREFIX + name for name in ("ID", "MIN", "COUNT")]
    if any(name not in environment for name in required):
        return None
    number = _whole_number(environment, "ID")
    least = _whole_number(environment, "MIN")
    count = _whole_number(environment, "COUNT")
    step = _whole_number(environment, "STEP", default="1")
    index, rest = divmod(number - least, max(1, step))
    if rest or min(number, least, step) < 0 or not 0 <= index < count:
        raise _with_gaps(environment)
    return Shard(index + 1, count)


def shard_of_kubernetes(environment: Mapping[str, str]) -> Shard | None:
    """Return the shard of a pod of an indexed job, whose number of completions is a variable."""
    if any(name not in environment for name in KUBERNETES_VARIABLES):
        return None
    texts = [environment[name] for name in KUBERNETES_VARIABLES]
    if not all(re.fullmatch(r"\d{1,9}", text, re.ASCII) for text in texts):
        raise _wrong_pod(environment)
    index, count = map(int, texts)
    if index >= count:
        raise _wrong_pod(environment)
    return Shard(index + 1, count)


def _wrong_pod(environment: Mapping[str, str]) -> UsageError:
    """Return the error of a pod whose variables are no share of a run."""
    index, count = (f"{name}={environment[name]}" for name in KUBERNETES_VARIABLES)
    hint = f"set the completions of the job, or name the share with {OPTION} i/n"
    return UsageError(index, f"with {count}", "an index below the completions", hint)


def _whole_number(environment: Mapping[str, str], name: str, default: str = "") -> int:
    """Return a number that Slurm sets; -1 for anything else."""
    text = environment.get(SLURM_PREFIX + name, default)
    return int(text) if re.fullmatch(r"\d{1,9}", text, re.ASCII) else -1


def _with_gaps(environment: Mapping[str, str]) -> UsageError:
    """Return the error of an array whose tasks do not stand for the shares of a run."""
    count = environment[f"{SLURM_PREFIX}COUNT"]
    least = environment[f"{SLURM_PREFIX}MIN"]
    step = environment.get(f"{SLURM_PREFIX}STEP", "1")
    subject = f"{SLURM_PREFIX}ID={environment[f'{SLURM_PREFIX}ID']}"
    problem = f"the array has {count} tasks from {least} in steps of {step}"
    hint = f"name the share with {OPTION} i/n"
    return UsageError(subject, problem, "numbers without gaps", hint)

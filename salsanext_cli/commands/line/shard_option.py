# SPDX-License-Identifier: MIT
"""Value of `--shard`: a share of the scans as text, or that of a task of a Slurm array."""

import logging
import os
import re
from collections.abc import Mapping

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.loop.run_options import Shard

OPTION = "--shard"
SLURM_PREFIX = "SLURM_ARRAY_TASK_"

log = logging.getLogger(__name__)


def typed_shard(text: str | None) -> Shard:
    """Read ``i/n``; without it, return the share of this task of a Slurm array, else all."""
    if text is not None:
        return shard_of_text(text)
    of_array = shard_of_slurm(os.environ)
    if of_array is None:
        return Shard()
    log.log(NOTICE, "shard %s of the scans: this is a task of a Slurm array", of_array)
    return of_array


def shard_of_text(text: str) -> Shard:
    """Read ``i/n``, counted from 1."""
    parts = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
    if not parts:
        raise UsageError(OPTION, repr(text), "i/n, such as 1/8")
    return Shard(int(parts[1]), int(parts[2]))


def shard_of_slurm(environment: Mapping[str, str]) -> Shard | None:
    """Return the shard of a task of a Slurm array with any start and step."""
    names = [SLURM_PREFIX + name for name in ("ID", "MIN", "COUNT")]
    if any(name not in environment for name in names):
        return None
    texts = (*map(environment.__getitem__, names), environment.get(SLURM_PREFIX + "STEP", "1"))
    digits = re.compile(r"\d{1,9}", re.ASCII)
    number, least, count, step = (int(t) if digits.fullmatch(t) else -1 for t in texts)
    index, rest = divmod(number - least, max(1, step))
    if rest or min(number, least, step) < 0 or not 0 <= index < count:
        problem = f"the array has {texts[2]} tasks from {texts[1]} in steps of {texts[3]}"
        hint = f"name the share with {OPTION} i/n"
        raise UsageError(f"{names[0]}={texts[0]}", problem, "numbers without gaps", hint)
    return Shard(index + 1, count)

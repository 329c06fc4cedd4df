# SPDX-License-Identifier: MIT
"""All that waits for a GPU, in one run of some minutes: tests, speed, speed of training, training.

It needs torch with CUDA, numba, numpy, safetensors, joblib, filelock, pyyaml, matplotlib, typer,
pytest and hypothesis, but neither an installation of salsanext nor OpenVINO, open3d, plyfile or a
network. Each part is a process of its own with a share of the minutes; one that fails does not stop
the others. OUT gets at most eight files: ``run.log`` with all that was printed, ``report.json``
with all figures, and those of the training (`gpu_train.py`). `pack.py` packs real scans.

Run: python -m benchmarks.gpu.gpu_run OUT [--minutes 9] [--parts tests,speed,training,train]
     [--device cuda] [--weights FILE] [--pack pack.npz] [--seed 0] [--set batch=32] [--small]
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from pathlib import Path
from typing import Any, TextIO

from benchmarks.gpu import tests_in_time
from benchmarks.processes import ROOT, script_command, script_environment

SHARES = {"tests": 4.0, "speed": 3.0, "training": 2.5, "train": 5.0}
"""Parts in their order, and their shares of the time; what one leaves, later ones get."""
TESTS = (
    "tests/core/on_device",
    "tests/core/engines/test_device_copies.py",
    "tests/core/engines/test_device_time.py",
    "tests/core/engines/test_cuda_graphs.py",
    "tests/cuda",
)
"""Tests that run on a GPU, quick ones first; others need packages that such a machine may lack."""
SHARE_OF_STARTED_TESTS = 0.7  # Of the time of the tests; the last of them ends in the rest
GRACE_S = 20.0  # Time in which a part may still write, at the end of its own
GRACE_SHARE = 0.2  # Of the time of a short part
SHARE_BEFORE_END = 0.5  # Of the grace, after which a part is ended where it is
KILLED = 124


def run(options: argparse.Namespace) -> int:
    """Run the parts one after the other; return the exit status."""
    begun, out = time.monotonic(), options.out
    out.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {"parts": {}}
    with (out / "run.log").open("w") as log, tempfile.TemporaryDirectory() as scratch:
        for number, part in enumerate(options.parts):
            left = begun + 60 * options.minutes - time.monotonic()
            share = SHARES[part] / sum(SHARES[each] for each in options.parts[number:])
            if left * share < 1:
                report["parts"][part] = {"status": KILLED, "figures": []}
                continue
            figures = Path(scratch, f"{part}.json")
            status = run_part(options, part, left * share, figures, log)
            found = json.loads(figures.read_text()) if figures.exists() else {}
            report |= {"machine": found.get("machine", report.get("machine"))}
            report["parts"][part] = {"status": status, "figures": found.get("figures", [])}
            report["seconds"] = round(time.monotonic() - begun, 1)
            draft = out / "report.json.draft"
            draft.write_text(json.dumps(report, indent=1))
            draft.replace(out / "report.json")
        summary = summary_of(report)
        log.write(summary)
    sys.stdout.write(summary)
    return int(any(part["status"] for part in report["parts"].values()))


def run_part(
    options: argparse.Namespace, part: str, seconds: float, figures: Path, log: TextIO
) -> int:
    """Run a part in a process of its own, and log what it prints; return its exit status."""
    grace = min(GRACE_S, GRACE_SHARE * seconds)
    end = time.monotonic() + seconds - grace  # By the clock of all processes
    words = ["--part", part, "--deadline", f"{end:.3f}", "--figures", str(figures)]
    words += ["--last", f"{end + SHARE_BEFORE_END * grace:.3f}", "--parent", str(os.getpid())]
    command = script_command("benchmarks.gpu.gpu_run", *options.words, *words)
    environment = {**script_environment(), "PYTHONUNBUFFERED": "1"}
    tell(log, f"\n== {part}, {seconds:.0f} s\n")
    # In a group of their own, the part and its processes end together.
    with subprocess.Popen(
        command,
        env=environment,
        process_group=0,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        killer = threading.Timer(seconds, os.killpg, (process.pid, signal.SIGKILL))
        killer.start()
        for line in process.stdout or ():
            tell(log, line)
        killed = process.wait() and not killer.is_alive()
        killer.cancel()
    if killed:
        tell(log, f"{part} was killed {grace:.0f} s after its time was over\n")
    return KILLED if killed else process.returncode


def tell(log: TextIO, text: str) -> None:
    """Print a text and write it to the log at once."""
    for stream in (sys.stdout, log):
        stream.write(text)
        stream.flush()


def summary_of(report: dict[str, Any]) -> str:
    """Return the figures of all parts as a table."""
    lines = ["", "== summary", json.dumps(report.get("machine"))]
    for part, found in report["parts"].items():
        status = found["status"]
        ended = f", FAILED with status {status}" if status else ""
        ended = ", ended by its time: the rest is missing" if status == KILLED else ended
        lines.append(f"-- {part}{ended}")
        for row in found["figures"]:
            value = row["value"]
            text = f"{value:,.4g}" if isinstance(value, float) else str(value)
            lines.append(f"{row['name']:56} {text:>14} {row['unit']}".rstrip())
    return "\n".join(lines) + "\n"


def work(options: argparse.Namespace) -> int:
    """Do one part in this process; return the exit status."""
    # Only here: the whole run needs no torch.
    from benchmarks.gpu.gpu_measures import Figures, machine
    from benchmarks.gpu.gpu_use import mean_text, utilisation
    from benchmarks.gpu.time_limit import TimeOverError, time_limit
    from salsanext_cli.core.engines.device import choose_device
    from salsanext_cli.io.weights.card_file import default_weights
    from salsanext_cli.runs.loop.pool import end_with_parent

    end_with_parent(options.parent)
    figures = Figures(options.figures, choose_device(options.device), options.deadline)
    figures.machine = machine(figures.device)
    figures.write()
    weights = options.weights or default_weights()
    status = 0
    is_over = False
    with utilisation(figures.device) as used:
        try:
            with time_limit(options.last):
                status = measure(options, figures, weights)
        except TimeOverError:
            is_over = True
            figures.add(f"the part {options.part}", "ended by its time: the rest is missing")
        except Exception:  # noqa: BLE001 - whatever it is, the log has it
            traceback.print_exc()
            status = 1
    figures.add(f"GPU used by the part {options.part}", mean_text(used), "%")
    if is_over:
        # Threads and processes of what was ended may take longer than the grace to end.
        sys.stdout.flush()
        os._exit(status)
    return status


def measure(options: argparse.Namespace, figures: Any, weights: Path) -> int:
    """Measure one part in this process; return the exit status."""
    scratch = options.figures.parent
    if options.part == "tests":
        return run_tests(figures)
    if options.part == "speed":
        from benchmarks.gpu import gpu_speed

        gpu_speed.measure(figures, weights, small=options.small)
    elif options.part == "training":
        from benchmarks.gpu import gpu_training

        gpu_training.measure(figures, weights, scratch, small=options.small)
    else:
        from benchmarks.gpu import gpu_train

        request = gpu_train.TrainRequest(
            out=options.out,
            scratch=scratch,
            weights=weights,
            seed=options.seed,
            pack=options.pack,
            changes=options.set,
            small=options.small,
        )
        gpu_train.train(figures, request)
    return 0


def run_tests(figures: Any) -> int:
    """Run the tests of the GPU or, on a CPU, the same tests of the CPU; skip what has no time."""
    chosen = ("-k", "cpu") if figures.device == "cpu" else ("-m", "cuda")
    words = ("-q", "-rfEs", "--color=no", "--continue-on-collection-errors")
    plug_ins = ("-p", "no:cacheprovider", "-p", tests_in_time.__name__)
    command = [sys.executable, "-m", "pytest", *words, *plug_ins, *TESTS, *chosen]
    end = time.monotonic() + SHARE_OF_STARTED_TESTS * figures.left()
    environment = {**os.environ, tests_in_time.END: str(end)}
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=figures.left(),
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        printed = (error.stdout or b"").decode()
        sys.stdout.write(printed)
        figures.add("tests", f"about {printed.count('.')} passed; the next does not end in time")
        return int("F" in printed or "E" in printed)
    sys.stdout.write(done.stdout + done.stderr)
    figures.add("tests", (done.stdout.strip() or done.stderr).splitlines()[-1])
    return done.returncode


def parts_of(text: str) -> list[str]:
    """Return the parts that a text names."""
    parts = [part.strip() for part in text.split(",")]
    if unknown := sorted({*parts} - SHARES.keys()):
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not of {', '.join(SHARES)}")
    return [part for part in SHARES if part in parts]


def main(*words: str) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path, help="folder of all results")
    parser.add_argument("--minutes", type=float, default=9.0, help="of the whole run")
    parser.add_argument("--parts", type=parts_of, default=[*SHARES])
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--weights", type=Path, help="begin with these; default: the package's")
    parser.add_argument("--pack", type=Path, help="real scans to train on, of pack.py")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes, with the next two")
    parser.add_argument("--set", action="append", default=[], help="key=value of the recipe")
    parser.add_argument("--small", action="store_true", help="tiny images, to check the script")
    # Of the process of one part
    for name in ("deadline", "last"):
        parser.add_argument(f"--{name}", type=float, help=argparse.SUPPRESS)
    for name, kind in (("part", str), ("figures", Path), ("parent", int)):
        parser.add_argument(f"--{name}", type=kind, help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    options.words = words
    return work(options) if options.part else run(options)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

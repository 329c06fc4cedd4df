# SPDX-License-Identifier: MIT
"""Training of the default weights on a CPU, for days beside other work: it may end at any time.

The same command continues it. SCENES has a folder of scenes for each kind of sensor, which
`scene_pool.py` fills; scenes that are added later are trained on, too. HELD_OUT has others.
Real data sets are the folders ``pandaset``, ``pandargt`` and ``aachen`` that `default_weights.py`
describes. After each epoch the running average is scored on what is held out, at each width, in
``scores.csv``; no choice is made by it here.

With --write, nothing is trained: the running average of the checkpoint becomes a weights file,
without class weights in its logits.

Run: python -m benchmarks.weights.background_training RUN SCENES HELD_OUT
     [pandaset/ pandargt/ aachen/] [--weights default] [--set learning_rate=1e-3] [--write FILE]
"""

import argparse
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch

from benchmarks.gpu.gpu_train import DESCRIPTION
from benchmarks.gpu.gpu_train_data import real_scans, training_data
from benchmarks.weights.finish_weights import remove_class_weights
from benchmarks.weights.scene_pool import KINDS, ScenePool
from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.plain_data import Json
from salsanext_cli.io.files.json_files import read_json, write_json
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import named_weights, read_card
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.runs.network_settings import weights_file
from salsanext_cli.training.checkpoint import load_checkpoint
from salsanext_cli.training.data.batch_source import WorkerBatches
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.fit import StepReport, Training
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner, fastest_precision
from salsanext_cli.training.recipe import Recipe, recipe
from salsanext_cli.training.run_folder import CHECKPOINT, CLASS_COUNTS, Row, write_log
from salsanext_cli.training.scoring.validation import validate_widths

CHANGES: Json = {
    "widths": "1024,512,1024,2048",
    "crop_width": 512,
    "epochs": 1000,
    "samples_per_epoch": 4000,
    "learning_rate": 1e-3,
    "schedule": "decay",
    "decay": 1.0,
    "warm_up": 0.1,
}
"""Changes of the recipe `street`: a constant learning rate, a score every thousand steps."""
SCORES, SCORED = "scores.csv", "scores.json"
REPORTED_STEPS = 20  # Steps between two lines of the log


@dataclass
class Scoring:
    """Scores of the running average on held-out scans, after each epoch."""

    run: Path
    card: WeightsCard
    held_out: dict[str, Source]  # By name
    learner: Learner
    begun: float = field(default_factory=time.monotonic)

    def report(self, step: StepReport) -> None:
        """Print the progress; after an epoch, score the average and write the scores."""
        if step.row is None:
            if step.step % REPORTED_STEPS == 0:
                seconds = time.monotonic() - self.begun
                self.begun = time.monotonic()
                print(f"{time.ctime()} step {step.step}, {seconds:.0f} s", flush=True)
            return
        row: Row = {"step": step.step, "loss": step.row["loss"], "seconds": step.row["seconds"]}
        network = network_of_module(self.learner.average.eval(), self.card, "cpu")
        for name, source in self.held_out.items():
            widths = self.learner.recipe.image_widths
            scores, _ = validate_widths(network, source, widths)
            keys = [key for key in scores if key.startswith(("accuracy", "miou"))]
            row |= {f"{name}_{key}": scores[key] for key in keys}
        rows = [*self.rows(), row]
        write_json(self.run / SCORED, {"rows": rows})
        write_log(self.run / SCORES, rows)
        print(time.ctime(), row, flush=True)

    def rows(self) -> list[Row]:
        """Return the scores of all epochs before."""
        known = read_json(self.run / SCORED) or {"rows": []}
        return list(known["rows"])


def training_of(
    run: Path, weights: Path, scenes: Path, held_out: Path, real: list[Path], how: Recipe
) -> Training:
    """Return a training from weights, or from the checkpoint in a folder."""
    given = read_card(weights).sensor
    module, card = initial_network(weights, label_space(), how, given)
    pool = ScenePool(scenes, card.sensor)
    simulated = {kind: ScenePool(held_out, card.sensor).source(kind) for kind in KINDS}
    packed = real_scans({root.name: root for root in real}, run, card.sensor, 1)
    validation = simulated[KINDS[0]]
    data = training_data(run / CLASS_COUNTS, pool, packed.training, validation, how, card, 1)
    name = named_weights(read_card(weights), weights)
    also = " and real scans" if packed.training else ""
    card = replace(
        card,
        trained_on=card.trained_on | data.digests,
        recipe=how.to_dict() | {"initial": name},
        description=DESCRIPTION.format(also=also, weights=name),
    )
    learner = Learner(module, how, data.weights, torch.device("cpu"), sets=data.samples.sets)
    scoring = Scoring(run, card, simulated | packed.held_out, learner)
    nothing = replace(validation, files=[])
    return Training(
        run=run,
        learner=learner,
        batches=WorkerBatches(samples=data.samples, workers=1),
        validation=nothing,
        card=card,
        report=scoring.report,
    )


def write_average(training: Training, target: Path) -> None:
    """Write the running average of the last checkpoint as weights, and print its steps."""
    state = load_checkpoint(training.run / CHECKPOINT, training.learner)
    steps = state.epoch * training.plan.steps_per_epoch + len(state.losses)
    module = training.learner.average.eval()
    remove_class_weights(module, training.card, training.run / CLASS_COUNTS)
    save_weights(target, module, training.card, half=True)
    print(f"{target}: the running average after {steps} steps", flush=True)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    for name in ("run", "scenes", "held_out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("real", type=Path, nargs="*")
    parser.add_argument("--weights", type=Path, default=Path("default"))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--write", type=Path, metavar="FILE")
    given = parser.parse_args(words or None)
    how = recipe("street").with_changes(**CHANGES | read_overrides(given.set))
    if how.precision == "auto":
        how = how.with_changes(precision=fastest_precision(torch.device("cpu")))
    given.run.mkdir(parents=True, exist_ok=True)
    start = weights_file(given.weights)
    training = training_of(given.run, start, given.scenes, given.held_out, given.real, how)
    if given.write:
        write_average(training, given.write)
    else:
        training.fit()


if __name__ == "__main__":
    main()

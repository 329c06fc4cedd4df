# SPDX-License-Identifier: MIT
"""Memory of a step of a training, by number of images, their width and the number type.

Each measurement is a process of its own, since memory that torch has freed stays with a process.
On a CPU it is the peak of the resident memory above the memory before the first step; on a GPU the
peak that torch allocates.

Run: python -m benchmarks.speed.training_memory [--device cpu --precision float32]
"""

import argparse
import resource
import subprocess

import torch

from benchmarks.processes import script_command, script_environment
from salsanext_cli import label_space
from salsanext_cli.io.sensors import sensor
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

STEPS = 2  # The second step has the buffers of the optimiser
SIZES = ((1, 512), (2, 512), (4, 512), (1, 2048), (2, 2048))


def peak_bytes(images: int, width: int, precision: str, device: torch.device) -> int:
    """Return the peak memory of steps on random images, in bytes."""
    recipe = Recipe(batch=images, precision=precision)
    space = label_space()
    module, _ = initial_network(None, space, recipe, None)
    learner = Learner(module, recipe, torch.ones(space.class_count), device)
    generator = torch.Generator().manual_seed(1)
    height = sensor("hdl64").height
    batch = torch.randn(images, 5, height, width, generator=generator)
    truth = torch.randint(1, space.class_count, (images, height, width), generator=generator)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    for step in range(STEPS):
        learner.step(batch, truth.to(torch.uint8), step, STEPS)
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before


def main() -> None:
    """Print a row per size, or measure a single one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", default="float32")
    parser.add_argument("--one", nargs=2, type=int, metavar=("IMAGES", "WIDTH"))
    options = parser.parse_args()
    if options.one:
        images, width = options.one
        print(peak_bytes(images, width, options.precision, torch.device(options.device)))
        return
    print("images  width  GB     bytes per pixel")
    for images, width in SIZES:
        words = ["--one", images, width]
        words += ["--device", options.device, "--precision", options.precision]
        command = script_command("benchmarks.speed.training_memory", *words)
        environment = script_environment()
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
        measured = int(done.stdout)
        pixels = images * sensor("hdl64").height * width
        print(f"{images:6}  {width:5}  {measured / 1e9:5.2f}  {measured / pixels:8.0f}")


if __name__ == "__main__":
    main()

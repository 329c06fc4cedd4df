# SPDX-License-Identifier: MIT
"""Memory that a step of a training needs, compared with that of the device."""

import logging
import math
from dataclasses import dataclass

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import with_hint
from salsanext_cli.core.wording import setting
from salsanext_cli.training.memory import Memory
from salsanext_cli.training.recipe import Recipe

BYTES_PER_PIXEL = {
    ("cpu", "float32"): 16_000,
    ("cpu", "bfloat16"): 11_500,
    ("cuda", "float32"): 16_000,
    ("cuda", "bfloat16"): 8_000,
    ("cuda", "float16"): 8_000,
}
"""Peak of a step per pixel of the images of a part, by device and number type of SalsaNext.

docs/experiments/performance.md has the measurements; the lowest of them counts here.
"""
ESTIMATED = "salsanext"  # Network that the measurements are of
USED_SHARE = 0.8  # Largest share of the available memory that a step should need
STEP_PIXELS = 64  # Crop widths of hints are multiples of it

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepMemory:
    """Images that a worker computes at once in a step."""

    recipe: Recipe
    rows: int  # Height of an image, in pixels
    columns: int  # Width of an image, in pixels
    device: str  # "cpu" or "cuda"
    workers: int = 1  # Number of workers that share a batch
    sharing: int = 1  # Number of workers that share the memory

    @classmethod
    def from_recipe(
        cls, recipe: Recipe, sensor: Sensor, device: str, workers: int = 1, sharing: int = 1
    ) -> "StepMemory | None":
        """Return the step of a recipe; None if nothing is known about its network."""
        if recipe.architecture != ESTIMATED or (device, recipe.precision) not in BYTES_PER_PIXEL:
            return None
        columns = max(recipe.image_widths or (sensor.width,))
        if recipe.crop_width:
            columns = min(columns, recipe.crop_width)
        return cls(
            recipe=recipe,
            rows=sensor.height,
            columns=columns,
            device=device,
            workers=workers,
            sharing=sharing,
        )

    @property
    def images(self) -> int:
        """Number of images that a worker computes at once."""
        images_of_worker = math.ceil(self.recipe.batch / self.workers)
        return math.ceil(images_of_worker / min(self.recipe.accumulate, images_of_worker))

    @property
    def needed(self) -> int:
        """Estimated memory in bytes."""
        return self._bytes(self.images * self.columns)

    @property
    def room(self) -> int:
        """Memory that should be available for a step, in bytes: more than the estimate."""
        return math.ceil(self.needed / USED_SHARE)

    def _bytes(self, columns: int) -> int:
        """Return the estimate for all columns of the images together, and all sharing workers."""
        per_pixel = BYTES_PER_PIXEL[self.device, self.recipe.precision]
        return self.sharing * columns * self.rows * per_pixel

    def require_fits(self, memory: Memory) -> None:
        """Refuse a step that needs more than the device has; warn if less may be available."""
        usable = int(USED_SHARE * memory.available)
        if self.needed <= usable:
            return
        images = f"{self.images} × {self.rows}×{self.columns} pixels in {self.recipe.precision}"
        problem = f"a step of {images} needs about {_text(self.needed)}"
        where = "this machine" if self.device == "cpu" else "the GPU"
        hint = self._hint(usable)
        if self.needed > memory.total:
            raise TrainingError(
                "memory", f"{problem}, {where} has {_text(memory.total)}", hint=hint
            )
        text = f"memory: {problem}, and {_text(memory.available)} are available"
        log.warning("%s", with_hint(text, hint))

    def _hint(self, usable: int) -> str:
        """Return the settings that fit into a number of bytes, in words."""
        fitting = usable // self._bytes(self.columns)
        if fitting:
            parts = math.ceil(math.ceil(self.recipe.batch / self.workers) / fitting)
            in_parts = setting("recipe.accumulate", parts)
            smaller = setting("recipe.batch", fitting * self.workers)
            return f"use {in_parts} to compute a batch in parts, or {smaller}"
        columns = usable // self._bytes(1) // STEP_PIXELS * STEP_PIXELS
        if not columns:
            return "use a machine with more memory"
        parts = math.ceil(self.recipe.batch / self.workers)
        in_parts = setting("recipe.accumulate", parts)
        return f"use {in_parts} and narrower windows: {setting('recipe.crop_width', columns)}"


def _text(size: int) -> str:
    return f"{size / 1e9:.3g} GB"

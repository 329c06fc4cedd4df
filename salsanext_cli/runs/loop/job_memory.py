# SPDX-License-Identifier: MIT
"""Memory that a process needs for a job of a network, beside that of a GPU."""

from dataclasses import dataclass

MIN_BYTES = 1_000_000_000  # Of any worker, also without a network: libraries, scans, results
STEP_BYTES = 100_000_000  # To whose multiples estimates are rounded up


@dataclass(frozen=True, slots=True, kw_only=True)
class JobMemory:
    """Peak of a process on a CPU, as docs/experiments/performance.md has it.

    Attributes
    ----------
    process : int
        Bytes of the process without its images.
    pixel : int
        Bytes for each pixel of the images that are computed together.
    """

    process: int
    pixel: int

    def estimate(self, pixels: int) -> int:
        """Return the bytes to reserve for a process.

        Parameters
        ----------
        pixels : int
            Number of pixels of all images that are computed together.

        Returns
        -------
        int
        """
        needed = self.process + pixels * self.pixel
        return max(MIN_BYTES, -(-needed // STEP_BYTES) * STEP_BYTES)


LABELS = JobMemory(process=400_000_000, pixel=5_000)
SAMPLES = JobMemory(process=800_000_000, pixel=12_000)  # Passes with dropout, and noisy copies
FILTERED = JobMemory(process=1_200_000_000, pixel=21_000)  # Assumed density filtering

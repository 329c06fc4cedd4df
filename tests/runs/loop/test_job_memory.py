# SPDX-License-Identifier: MIT
"""The memory of a worker grows with the images that it computes."""

import pickle
from dataclasses import replace

import pytest
from scans import SMALL

from salsanext_cli.runs.loop.job_memory import LABELS, MIN_BYTES, SAMPLES, STEP_BYTES, JobMemory
from salsanext_cli.runs.loop.network_task import NetworkTask, sampling_task
from salsanext_cli.runs.network_settings import NetworkSettings

WIDE = replace(SMALL, height=64, width=8192)
PIXELS = 64 * 8192


@pytest.mark.parametrize(
    ("pixels", "expected"), [(0, MIN_BYTES), (10**6, 3 * 10**9), (10**6 + 1, 31 * 10**8)]
)
def test_an_estimate_is_rounded_up_and_has_room_for_the_libraries(pixels, expected):
    memory = JobMemory(process=10**9, pixel=2_000)
    assert memory.estimate(pixels) == expected


@pytest.mark.parametrize(
    ("device", "batch", "images"),
    [("cpu", None, 1), ("cpu", 4, 4), ("cuda", None, 1), ("cuda", 4, 1)],
)
def test_a_worker_has_the_images_of_a_batch_unless_they_are_on_a_gpu(device, batch, images):
    settings = NetworkSettings(device=device, sensor=WIDE)
    task = NetworkTask(job=len, settings=settings, batch=batch)
    needed = LABELS.process + images * PIXELS * LABELS.pixel
    assert 0 <= task.worker_memory - needed < STEP_BYTES


def test_a_job_of_samples_needs_more_memory_in_a_worker_too():
    settings = NetworkSettings(device="cpu", sensor=WIDE)
    task = sampling_task(len, settings, None)
    assert task.worker_memory == SAMPLES.estimate(PIXELS)
    assert pickle.loads(pickle.dumps(task)).worker_memory == task.worker_memory

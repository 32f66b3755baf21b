"""What all trainings share: several processes under `torchrun`, and an end that loses nothing."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

import torch
import torch.distributed as dist


@contextmanager
def training_process(threads: int | None) -> Iterator[list[int]]:
    """Join the other processes of `torchrun`, if it started this one.

    Args:
        threads: Of torch in this process; None leaves it be.

    Yields:
        The signals that asked for an end (SIGINT, SIGTERM); the training looks at it between steps.
    """
    if threads:
        torch.set_num_threads(threads)
    together = dist.is_torchelastic_launched()
    if together:
        dist.init_process_group("gloo")
    stop: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = {number: signal.signal(number, lambda number, _: stop.append(number)) for number in numbers}
    try:
        yield stop
        if together:
            dist.barrier()  # who leaves while another still saves takes the connections along
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        if together:
            dist.destroy_process_group()

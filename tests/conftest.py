"""What tests in several folders ask for."""

import pytest


@pytest.fixture(scope="module")
def one_thread():
    """Small networks on one thread: tests run beside each other, and sums are the same everywhere."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)

"""Tiles worked on side by side: their order, how many wait, errors, and that threads do not show."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
import torch

from mipbake.models.workers import in_order, one_torch_thread


@pytest.fixture(params=[1, 3])
def workers(request: pytest.FixtureRequest) -> Iterator[int]:
    """Sets so many threads of torch."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def test_results_come_in_order_and_without_gradients(workers: int) -> None:
    weight = torch.ones(3, requires_grad=True)

    def work(index: int) -> torch.Tensor:
        time.sleep(0.002 * (5 - index % 5))
        return weight * index

    found = list(in_order(work, range(20)))
    assert [int(each[0]) for each in found] == list(range(20))
    assert not any(each.requires_grad for each in found)
    assert torch.get_num_threads() == workers


def test_workers_are_used_and_each_has_one_thread(workers: int) -> None:
    together = threading.Barrier(workers, timeout=10)

    def work(_: int) -> int:
        together.wait()  # breaks unless so many are here at once
        return torch.get_num_threads()

    assert list(in_order(work, range(2 * workers))) == [1] * (2 * workers)


def test_results_that_nobody_takes_do_not_pile_up(workers: int) -> None:
    begun: list[int] = []
    results = in_order(begun.append, range(100))
    next(results)
    time.sleep(0.05)
    assert len(begun) <= 2 * workers
    results.close()  # type: ignore[attr-defined]
    assert torch.get_num_threads() == workers


def test_an_error_comes_out_and_leaves_the_number_of_threads(workers: int) -> None:
    def work(index: int) -> int:
        if index == 3:
            raise ValueError("the third")
        return index

    with pytest.raises(ValueError, match="the third"):
        list(in_order(work, range(50)))
    assert torch.get_num_threads() == workers


def test_those_who_overlap_go_back_to_the_number_before_both(workers: int) -> None:
    inside, left, found = threading.Event(), threading.Event(), []

    def second() -> None:
        with one_torch_thread():
            inside.set()
            left.wait(10)
        found.append(torch.get_num_threads())

    with one_torch_thread():
        other = threading.Thread(target=second)
        other.start()
        assert inside.wait(10)
    left.set()
    other.join()
    third = threading.Thread(target=lambda: found.append(torch.get_num_threads()))
    third.start()
    third.join()
    assert found == [workers, workers]

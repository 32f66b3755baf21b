from dataclasses import replace
from typing import Any, cast

import pytest
import torch

from footfall.models.trace.config import COMPACT, DISTILLED_STEPS
from footfall.models.trace.context import scene_context
from footfall.models.trace.diffusion import DDIM, CosineSchedule
from footfall.models.trace.distillation import (
    DistilledStep,
    Paths,
    distillation_loss,
    teacher_paths,
    teacher_timesteps,
)
from footfall.models.trace.network import Trace
from footfall.models.trace.planner import WEIGHTS, Sampling, TracePlanner
from footfall.models.trace.scene_map import SceneMaps
from footfall.models.trace.weights import load_model

SCHEDULE = CosineSchedule(100)


@pytest.fixture(scope="module")
def teacher():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield load_model(WEIGHTS)[0]
    torch.set_num_threads(threads)


def walkers(apart=2.0):
    """Three who walk side by side along x at 1.2 m/s."""
    states = torch.zeros(3, 31, 4)
    states[..., 0] = 0.12 * torch.arange(-30, 1)
    states[..., 1] = apart * torch.arange(3)[:, None]
    states[..., 3] = 1.2
    return states, torch.full((3, 2), 0.8)


def test_the_teacher_takes_short_steps_through_all_of_the_students():
    fine = teacher_timesteps(DISTILLED_STEPS)
    assert set(DISTILLED_STEPS) <= set(fine) and fine[0] == DISTILLED_STEPS[0]
    strides = [a - b for a, b in zip(fine, [*fine[1:], 0], strict=True)]
    assert all(1 <= stride <= 5 for stride in strides)
    assert max(strides[: fine.index(DISTILLED_STEPS[1])]) == 2


def test_who_predicts_what_is_wanted_arrives_where_the_teacher_does(teacher):
    context = scene_context(*walkers())
    paths = teacher_paths(teacher.prepared(False), SCHEDULE, context, torch.Generator().manual_seed(3))
    solver = DDIM(SCHEDULE, DISTILLED_STEPS)
    noisy = paths.noisy[:, 0]
    for i in range(len(DISTILLED_STEPS)):
        assert torch.allclose(noisy, paths.noisy[:, i], atol=1e-3)
        noisy = solver.step(paths.clean[:, i], noisy, i)
    sampling = Sampling(timesteps=tuple(teacher_timesteps(DISTILLED_STEPS)), samples=1, context_weight=0.5)
    planner = TracePlanner(teacher, replace(sampling, reduced=False))
    states, size = walkers()
    plan = planner.plan(states, size, seed=3)  # the same noise, by the sampler itself
    assert torch.allclose(noisy, plan.actions[:, 0], atol=2e-2)


def test_a_step_predicts_at_every_step_what_sampling_would(teacher):
    context = scene_context(*walkers())
    noisy, clean = torch.randn(2, 3, 4, 52, 2, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        predicted = DistilledStep(teacher)(Paths(context, noisy, clean), DISTILLED_STEPS)
        encoding = teacher.encode(context)
        for i, k in enumerate(DISTILLED_STEPS):
            known = clean[:, i - 1] if i else None
            alone = teacher(noisy[:, i], torch.full((3,), k), encoding, estimate=known)
            assert torch.allclose(predicted[:, i], alone, atol=1e-4)


def test_the_loss_is_zero_for_the_teachers_way_and_counts_who_touches():
    trace, clean = Trace(COMPACT), torch.zeros(3, 4, 52, 2)

    def loss(apart, **weights):
        paths = Paths(scene_context(*walkers(apart)), torch.randn_like(clean), clean)
        return distillation_loss(cast(Any, lambda *_: clean), trace, SCHEDULE, paths, **weights).item()

    assert loss(2.0, touch=1.0, calm=1.0) == 0.0
    assert loss(0.7, calm=1.0) == 0.0  # who follows the teacher is right, though discs overlap
    # Discs of 0.4 m are to keep 0.05 m more: 0.15 m short of it, of one neighbour or of two.
    assert loss(0.7, touch=1.0) == pytest.approx(0.15 * (1 + 2 + 1) / 3, abs=1e-3)


def test_a_student_learns_to_do_in_four_steps_what_takes_twenty(teacher):
    generator = torch.Generator().manual_seed(0)
    paths = [
        teacher_paths(teacher.prepared(False), SCHEDULE, scene_context(*walkers()), generator)
        for _ in range(4)
    ]
    student = Trace(COMPACT.distilled(DISTILLED_STEPS))
    student.load_state_dict(teacher.state_dict())
    optimizer = torch.optim.Adam(student.parameters(), 3e-4)

    def error():
        step = DistilledStep(student)
        return torch.stack([distillation_loss(step, student, SCHEDULE, path) for path in paths]).sum()

    before = error().item()
    for _ in range(15):
        optimizer.zero_grad()
        error().backward()
        optimizer.step()
    assert error().item() < 0.6 * before


def test_obstacles_count_and_the_crowd_keeps_its_pace():
    states, size = walkers()
    axis = torch.arange(-5.0, 10.0, 0.1)
    block = ((axis[None] - 4).abs() < 0.5) & ((axis[:, None] - 2.3).abs() < 0.4)  # in the second one's way
    maps = SceneMaps.from_raster({"obstacle": block.numpy()}, 0.1, (-5.0, -5.0))
    clean, trace = torch.zeros(3, 4, 52, 2), Trace(COMPACT)
    context = scene_context(states, size, maps)

    def loss_and_slope(predicted, touch):
        predicted = predicted.requires_grad_()
        paths = Paths(context, torch.zeros_like(clean), clean)
        loss = distillation_loss(cast(Any, lambda *_: predicted), trace, SCHEDULE, paths, touch=touch)
        return loss.item(), torch.autograd.grad(loss, predicted)[0]

    depth, slope = loss_and_slope(clean.clone(), 1.0)
    assert depth > 0 and slope[1, -1, :10, 1].min() > 0  # to the right means less of it
    assert slope[[0, 2]].abs().max() == 0 and slope[:, :-1].abs().max() == 0
    # Somebody's obstacle is nothing to the others; a crowd that is too slow is everybody's affair.
    slow = clean.clone()
    slow[2, -1, 0, 0] = -3.0  # 0.3 m/s slower from the first frame on: 0.1 m/s of three people
    errors, _ = loss_and_slope(slow.clone(), 0.0)
    total, slope = loss_and_slope(slow.clone(), 1.0)
    assert total - errors - depth == pytest.approx(2 * 0.1**2 / trace.trajectory_std[3].item() ** 2, rel=1e-3)
    assert slope[0, -1, :, 0].max() < 0

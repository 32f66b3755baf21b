from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch

from footfall.models.trace import denoising, settling
from footfall.models.trace.context import scene_context
from footfall.models.trace.denoising import Denoiser
from footfall.models.trace.diffusion import DDIM, CosineSchedule
from footfall.models.trace.guidance import Guidance
from footfall.models.trace.objectives import Future, Objective, ObjectiveError
from footfall.models.trace.planner import DISTILLED, FEW, SHIPPED, THOROUGH, WEIGHTS, Sampling, TracePlanner
from footfall.models.trace.scene_map import SceneMaps
from footfall.models.trace.weights import WeightsError, load_model

GUIDANCES = [
    Guidance(),
    Guidance(mode="clean"),
    Guidance(mode="clean", scale="variance", strength=0.5),
    Guidance(mode="noisy"),
]


@pytest.fixture(scope="module")
def trace():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield load_model(WEIGHTS)[0]
    torch.set_num_threads(threads)


def crowd(agents=3):
    """People who walked along x at 1.2 m/s, two metres apart."""
    states = np.zeros((agents, 31, 4))
    states[:, :, 0] = 0.12 * np.arange(-30, 1)
    states[:, :, 1] = 2.0 * np.arange(agents)[:, None]
    states[:, :, 3] = 1.2
    return states, np.full((agents, 2), 0.8)


def test_plan_has_the_promised_shape(trace):
    plan = TracePlanner(trace, Sampling(samples=4)).plan(*crowd())
    assert plan.positions.shape == (3, 4, 50, 2)
    assert plan.headings.shape == plan.speeds.shape == (3, 4, 50)
    assert plan.chosen.tolist() == [0, 0, 0] and plan.losses == {}
    assert np.isfinite(plan.positions).all()


def test_states_of_a_plan_fit_each_other(trace):
    plan = TracePlanner(trace, Sampling(samples=4)).plan(*crowd())
    step = np.diff(plan.positions, axis=2)
    forward = np.stack([np.cos(plan.headings), np.sin(plan.headings)], -1)[:, :, 1:]
    assert np.allclose(step, 0.1 * plan.speeds[:, :, 1:, None] * forward, atol=1e-5)
    states, _ = crowd()
    first = plan.positions[:, :, 0] - states[:, None, -1, :2]
    assert np.linalg.norm(first, axis=-1).max() < 0.1 * (1.2 + 10 * 0.1)


def test_same_seed_same_plan(trace):
    planner = TracePlanner(trace, Sampling(samples=2))
    first, again, other = (planner.plan(*crowd(), seed=s).positions for s in (5, 5, 6))
    assert np.array_equal(first, again) and not np.allclose(first, other)


def test_nobody_is_led_to_race_and_who_runs_already_may_go_on(trace):
    states, size = crowd(2)
    states[1, :, 0], states[1, :, 3] = 0.27 * np.arange(-30, 1), 2.7
    far = Objective("waypoint", {"goal": torch.tensor([[30.0, 0.0], [30.0, 2.0]])})
    speeds = TracePlanner(trace, Sampling(steps=4, samples=4)).plan(states, size, objectives=[far]).speeds
    assert 2.0 < speeds[0].max() <= 2.2 + 1e-3  # 6 m/s would reach it
    assert 2.3 < speeds[1].max() <= 2.7 + 1e-3
    assert speeds.min() >= -1e-3


@pytest.mark.parametrize("guidance", GUIDANCES, ids=lambda g: f"{g.mode}-{g.scale}")
def test_guidance_lowers_the_loss(trace, guidance):
    goal = np.array([[4.0, 1.0], [4.0, 1.0], [4.0, 5.0]])
    wishes = [Objective("waypoint", {"goal": torch.tensor(goal), "temperature": 0.3})]
    sampling = Sampling(samples=4, reduced=False, solver="ddim", steps=8)
    free = TracePlanner(trace, sampling, Guidance(strength=0.0)).plan(*crowd(), objectives=wishes)
    guided = TracePlanner(trace, sampling, guidance).plan(*crowd(), objectives=wishes)
    assert guided.losses["waypoint"].mean() < free.losses["waypoint"].mean()


def test_everything_asked_at_once_is_nearly_met(trace):
    axis = np.arange(-5, 15, 0.2)
    x, y = np.meshgrid(axis, axis)
    maps = SceneMaps.from_raster({"obstacle": (np.abs(x - 3) < 0.5) & (np.abs(y) < 0.6)}, 0.2, (-5, -5))
    goal = torch.tensor([[5.0, 0.0], [5.0, 2.0], [5.0, 4.0]])
    wishes = [
        Objective("waypoint", {"goal": goal, "temperature": 0.2}),
        Objective("agent_avoid"),
        Objective("obstacle_avoid"),
    ]
    rough = TracePlanner(trace, Sampling(steps=8), Guidance(inner_steps=8, polish=0))
    plan = rough.plan(*crowd(), maps, wishes)
    assert len(set(plan.chosen.tolist())) == 1  # agents interact: one sample for the scene, as in the paper
    plan = TracePlanner(trace, Sampling(steps=8), Guidance(inner_steps=8)).plan(*crowd(), maps, wishes)
    assert set(plan.losses) == {"waypoint", "agent_avoid", "obstacle_avoid"}
    path = plan.positions[np.arange(3), plan.chosen]
    assert np.linalg.norm(path - goal.numpy()[:, None], axis=-1).min(1).max() < 0.6
    assert plan.losses["obstacle_avoid"][np.arange(3), plan.chosen].max() < 0.5


def test_a_plan_of_many_agents_equals_plans_of_few(trace):
    """Guidance is per agent and sample: no hidden mean over the batch."""
    states, size = crowd(2)
    states[1, :, 1] = 40.0  # too far to see each other
    wishes = [Objective("target_speed", {"speed": 1.8})]
    # Every step of guidance lets rounding grow; after those of polishing it is millimetres.
    for asked, polish, tries, tolerance in (([], 0, 0, 1e-5), (wishes, 0, 0, 1e-3), (wishes, 6, 1, 1e-2)):
        guidance = Guidance(polish=polish, tries=tries)
        planner = TracePlanner(trace, replace(FEW, samples=4, reduced=False), guidance)
        both = planner.plan(states, size, objectives=asked)
        alone = planner.plan(states[:1], size[:1], objectives=asked)
        assert np.allclose(both.positions[0], alone.positions[0], rtol=0, atol=tolerance)


def test_classifier_free_weight_minus_one_ignores_the_crowd(trace):
    states, size = crowd(3)
    planner = TracePlanner(trace, Sampling(samples=2, context_weight=-1.0, reduced=False))
    together = planner.plan(states, size).positions[0]
    alone = planner.plan(states[:1], size[:1]).positions[0]
    assert np.allclose(together, alone, atol=1e-3)


def test_a_previous_plan_is_continued(trace):
    states, size = crowd()
    planner = TracePlanner(trace, Sampling(samples=3, keep=0.0, steps=20, reduced=False))
    first = planner.plan(states, size, seed=1)
    moved = states.copy()
    chosen = first.positions[np.arange(3), first.chosen]
    moved[:, -1, :2], moved[:, -1, 2] = chosen[:, 9], first.headings[np.arange(3), first.chosen, 9]
    moved[:, -1, 3] = first.speeds[np.arange(3), first.chosen, 9]
    again = planner.plan(moved, size, previous=first, elapsed=10, seed=2)
    fresh = planner.plan(moved, size, seed=2)
    drift, other = (
        np.linalg.norm(p.positions[:, 0, :30] - chosen[:, 10:40], axis=-1).mean() for p in (again, fresh)
    )
    assert drift < other
    with pytest.raises(ValueError, match="agents 0, 1, 2, none of 8, 9"):
        planner.plan(states[:2], size[:2], previous=first, ids=[8, 9])


def test_bad_input_is_named(trace):
    planner = TracePlanner(trace, Sampling(samples=1))
    states, size = crowd()
    with pytest.raises(ValueError, match="31 frames"):
        planner.plan(states[:, 1:], size)
    with pytest.raises(ObjectiveError, match="goal"):
        planner.plan(states, size, objectives=[Objective("waypoint")])
    with pytest.raises(ValueError, match="no solver 'euler'"):
        Sampling(solver=cast(Any, "euler")).make_solver(CosineSchedule())
    with pytest.raises(ValueError, match="1 to 100 steps"):
        TracePlanner(trace, Sampling(steps=200)).plan(states, size)


def test_polishing_that_does_harm_is_taken_back(trace, monkeypatch):
    states, size = crowd(2)
    states[1, :, 0] = 8.0 - states[1, :, 0]  # they walk towards each other, half a metre beside the line
    states[1, :, 1], states[1, :, 2] = 0.5, np.pi
    monkeypatch.setattr(settling, "polished", lambda best, *_: torch.zeros_like(best))  # straight on
    planner = TracePlanner(trace, Sampling(samples=4))
    straight = planner.world_states(torch.zeros(2, 1, 52, 2), torch.as_tensor(states[:, -1]).float())[:, 0]
    assert (straight[0, :, :2] - straight[1, :, :2]).norm(dim=-1).min() < 0.75  # they would touch
    plan = planner.plan(states, size, objectives=[Objective("agent_avoid")])
    paths = plan.positions[np.arange(2), plan.chosen]
    assert np.linalg.norm(paths[0] - paths[1], axis=-1).min() > 0.79


def test_distilled_weights_take_their_own_steps_only():
    planner = TracePlanner.load()
    assert planner.sampling == SHIPPED and planner.config.timesteps == SHIPPED.timesteps
    assert planner.sampling.name(planner.config) == "distilled 4"
    assert TracePlanner.load(sampling=replace(SHIPPED, samples=2)).config.timesteps  # the same steps
    assert not TracePlanner.load(sampling=FEW).config.timesteps  # weights for any steps
    for other in (FEW, replace(SHIPPED, context_weight=0.5), replace(SHIPPED, timesteps=(99, 50))):
        with pytest.raises(WeightsError, match="distilled for the steps 99, 90, 70, 28 of ddim"):
            TracePlanner.load(DISTILLED, other)


def test_every_sample_of_a_distilled_network_has_a_first_step_of_its_own():
    trace, _ = load_model(DISTILLED)
    states, size = crowd(1)
    plan = TracePlanner(trace, replace(SHIPPED, samples=3, reduced=False)).plan(states, size, seed=5)
    noise = torch.randn((1, 3, 52, 2), generator=torch.Generator().manual_seed(5))
    noisy, estimate = SHIPPED.temperature * noise[0], None
    context = scene_context(torch.tensor(states).float(), torch.tensor(size).float())
    solver = DDIM(CosineSchedule(100), SHIPPED.timesteps)
    with torch.no_grad():
        encoding = trace.encode(context).repeat(3)
        for i, k in enumerate(SHIPPED.timesteps):
            estimate = trace(noisy, torch.full((3,), k), encoding, estimate=estimate)
            noisy = solver.step(estimate, noisy, i)
    assert torch.allclose(plan.actions[0], noisy, atol=1e-4)


def test_who_misses_what_they_are_asked_tries_again_and_the_others_keep_to_their_plans(trace):
    states, size = crowd(4)
    goal = torch.tensor(
        [[5.0, 0.0], [-1.5, 3.5], [5.0, 4.0], [-2.0, 7.0]]
    )  # two of them behind people's backs
    wishes = [
        Objective("waypoint", {"goal": goal, "temperature": 0.05, "widening": 0.3}),
        Objective("agent_avoid"),
    ]
    missed = []
    for tries in (0, 2):
        planner = TracePlanner(trace, replace(FEW, samples=4), Guidance(tries=tries))
        plans = [planner.plan(states, size, objectives=wishes, seed=seed) for seed in range(6)]
        paths = np.stack([plan.positions[np.arange(4), plan.chosen] for plan in plans])
        missed.append(np.linalg.norm(paths - goal.numpy()[:, None], axis=-1).min(-1))  # (seeds, people)
    first, again = missed
    far = first > 0.15
    assert far.any() and again[far].mean() < 0.8 * first[far].mean()
    assert again.max() <= first.max() + 0.05
    before, after = (
        TracePlanner(trace, replace(FEW, samples=4), Guidance(tries=tries)).plan(
            states,
            size,
            objectives=[Objective("target_speed", {"speed": torch.tensor([torch.nan] * 3 + [9.0])})],
        )
        for tries in (0, 1)
    )
    moved = np.linalg.norm(after.positions - before.positions, axis=-1).max((1, 2))
    assert moved[:3].max() < 1e-6 < moved[3]


@pytest.mark.parametrize(("polish", "guided"), [(0, 4), (8, 3)])
def test_the_last_step_is_left_to_who_is_polished(trace, monkeypatch, polish, guided):
    asked = []
    guide = Denoiser._guided

    def spy(self, noisy, k, encodings, estimate, future_of, objectives, lag):
        asked.append(len(objectives))
        return guide(self, noisy, k, encodings, estimate, future_of, objectives, lag)

    monkeypatch.setattr(Denoiser, "_guided", spy)
    planner = TracePlanner(trace, replace(FEW, samples=2), Guidance(polish=polish))
    planner.plan(*crowd(), objectives=[Objective("agent_avoid")])
    assert asked == [1] * guided + [0] * (4 - guided)


def test_objectives_take_variety_off_the_noise(trace):
    def spread(temperature, objectives):
        planner = TracePlanner(trace, replace(FEW, samples=6), Guidance(temperature=temperature))
        return planner.plan(*crowd(), objectives=objectives).positions[:, :, -1].std(1).mean()

    met = [Objective("minimum_speed", {"speed": 0.0})]  # of everybody, so nothing but the noise differs
    assert spread(0.1, met) < 0.3 * spread(1.0, met)
    assert spread(0.1, []) == spread(1.0, [])


def test_haste_holds_back_whoever_is_led_and_may_come_at_any_time(trace):
    def speeds(haste, objective, weight: torch.Tensor | float = 1.0, **more):
        goal = torch.tensor([[4.0, 0.0], [torch.nan, torch.nan], [4.0, 4.0]])
        wish = [Objective(objective, {"goal": goal, **more}, weight)]
        how = Guidance(strength=0.0, polish=0, haste=haste)  # nobody is bent: what differs is held back
        return TracePlanner(trace, Sampling(steps=1, samples=2), how).plan(*crowd(), objectives=wish).speeds

    held = speeds(0.0, "waypoint") - speeds(0.1, "waypoint")
    assert np.allclose(held[1], 0, atol=1e-6)  # has no goal
    half = trace.config.horizon // 2
    profile = np.concatenate([0.01 * np.arange(1, half + 1), 0.01 * half - 0.005 * np.arange(1, 51 - half)])
    assert np.allclose(held[[0, 2]], profile, atol=1e-4)
    some = speeds(0.0, "waypoint") - speeds(0.1, "waypoint", torch.tensor([1.0, 1.0, 0.0]))
    assert np.allclose(some[2], 0, atol=1e-6) and np.allclose(some[0], profile, atol=1e-4)
    assert np.array_equal(speeds(0.0, "waypoint_at", time=4.0), speeds(0.1, "waypoint_at", time=4.0))


@pytest.mark.parametrize(("people", "tries"), [(1, 3), (9, 1)])
def test_who_is_still_lost_tries_again_unless_so_many_are(trace, monkeypatch, people, tries):
    tried = []
    resample = Denoiser.resample
    monkeypatch.setattr(Denoiser, "resample", lambda *args: tried.append(args[1]) or resample(*args))
    planner = TracePlanner(trace, replace(FEW, samples=2), Guidance(tries=3))
    beyond = [Objective("target_speed", {"speed": 9.0})]
    planner.plan(*crowd(people), objectives=beyond)
    assert [rows.tolist() for rows in tried] == [list(range(people))] * tries


def test_who_tries_again_is_led_at_a_part_of_the_noise_but_not_at_the_last_step(trace, monkeypatch):
    led, guided = [], []
    resample, guide = Denoiser.resample, denoising.guide_direct
    monkeypatch.setattr(denoising, "guide_direct", lambda *args: guided.append(args[-1]) or guide(*args))

    def spy(*args):
        guided.clear()
        found = resample(*args)
        led.append([round(float(variance), 4) for variance in guided])
        return found

    monkeypatch.setattr(Denoiser, "resample", spy)
    planner = TracePlanner(trace, replace(FEW, samples=2), Guidance(tries=2))
    planner.plan(*crowd(1), objectives=[Objective("target_speed", {"speed": 9.0})])
    steps = planner.sampling.make_solver(planner.denoiser.schedule).timesteps
    part = [k for k in steps if k <= FEW.keep * 99]
    assert led == [[round(float(planner.denoiser.schedule.variance(k)), 4) for k in part[:-1]]] * 2


def test_who_stands_with_the_goal_behind_sets_out_in_other_directions(trace):
    states, size, goal = torch.zeros(1, 31, 4), torch.full((1, 2), 0.8), torch.tensor([[-3.0, 0.0]])
    planner = TracePlanner(trace, replace(FEW, samples=8), THOROUGH)
    context = scene_context(
        states, size, None, None, trace.config.max_neighbors, trace.config.neighbor_radius
    )
    still = (-trace.trajectory_mean[4:] / trace.trajectory_std[4:]).expand(1, 1, trace.config.horizon, 2)

    def future_of(actions):
        return Future(planner.world_states(actions, states[:, -1]), states[:, -1], size[:, 0] / 2)

    def missed(start):
        wish = [Objective("waypoint", {"goal": goal, "temperature": 0.05})]
        rows, generator = torch.tensor([0]), torch.Generator().manual_seed(0)
        found = planner.denoiser.resample(rows, start, still, context, future_of, wish, generator)
        return (future_of(found).positions - goal).norm(dim=-1).amin(-1)

    starts = planner.denoiser.starts(still, torch.zeros(1))
    assert torch.equal(starts[:, ::2], still.expand(1, 4, -1, -1))
    ahead = future_of(starts).states[0, 1::2, -1]
    assert torch.allclose(ahead[:, 3], torch.ones(4), atol=1e-3)  # a usual pace
    assert torch.allclose(ahead[:, 2].rad2deg(), torch.tensor([-112.5, -22.5, 67.5, 157.5]), atol=0.1)
    assert missed(starts)[0, 1::2].min() < 1.5 < 2.5 < missed(still.expand(1, 8, -1, -1)).min()


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"size": np.full((3, 2), np.nan)}, "sizes of agents must be finite and above zero"),
        ({"ids": [4, 4, 5]}, "ids must differ, not be 4, 4, 5"),
        ({"states": crowd()[0] + [[[1e6, 0, 0, 0]]]}, "more than 100000 m from the origin"),
        (
            {"objectives": [Objective("waypoint", {"goal": [[1.0, 2.0, 3.0]] * 3})]},
            "'waypoint': a place has the 3",
        ),
        ({"objectives": [Objective("waypoint", {"goal": [1e30, 0.0]})]}, "outside what can be planned for"),
        ({"objectives": [Objective("waypoint", {"goal": "there"})]}, "objective 'waypoint': "),
        (
            {"objectives": [Objective("agent_avoid", weight=torch.ones(2))]},
            "there are 2 weights for 3 agents",
        ),
        ({"objectives": [Objective("social_group", {"group": [0, 0]})]}, "objective 'social_group': "),
    ],
)
def test_what_cannot_be_planned_is_said_in_one_sentence(trace, changed, text):
    states, size = crowd()
    with pytest.raises(ValueError, match=text) as caught:
        TracePlanner(trace, Sampling(steps=1, samples=2)).plan(**{"states": states, "size": size} | changed)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", [2**60 * 1_000_003, 2**64 - 1, -1])
def test_any_whole_number_is_a_seed(trace, seed):
    group = [Objective("social_group", {"group": [0, 0, 1]})]
    assert (
        TracePlanner(trace, Sampling(steps=1, samples=2))
        .plan(*crowd(), objectives=group, seed=seed)
        .chosen.size
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0},
        {"steps": 2.5},
        {"power": 0.0},
        {"temperature": np.nan},
        {"context_weight": np.inf},
        {"keep": 1.5},
        {"timesteps": (50, 200)},
        {"timesteps": (50, -1)},
    ],
)
def test_sampling_out_of_range_is_refused(wrong):
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} of sampling must"):
        Sampling(**wrong)

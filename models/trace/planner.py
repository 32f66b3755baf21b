"""Plans for all agents of a scene at once: encode, denoise jointly under guidance, choose a sample."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..crowd.planning import Futures
from .choice import unmet
from .config import DISTILLED_STEPS, TraceConfig
from .context import Context, scene_context
from .diffusion import CosineSchedule, Solver
from .dynamics import rollout
from .guidance import FutureOf, Guidance, gradient_of, guide_direct, total_loss
from .network import Encoding, Trace
from .objectives import Future, Objective, ObjectiveError
from .sampling import FEW, SHIPPED, Sampling
from .scene_map import SceneMaps
from .settling import Candidates, setting_out
from .weights import WeightsError, load_model

_FOLDER = Path(__file__).parent.parent / "weights"
WEIGHTS = _FOLDER / "trace_compact.safetensors"
"""For any number of steps."""
DISTILLED = _FOLDER / "trace_compact_distilled.safetensors"
"""For the steps of `SHIPPED` only."""

BEYOND = 5.0
"""Goals may lie so far outside the map [m]."""


THOROUGH = Guidance(limit=0.5, polish=8, tries=3, temperature=0.97, haste=0.008)
"""How objectives bend the samples unless told otherwise."""

_LOST = 8
"""So many who try again and still are where they are not to be are in each other's way: more tries do not help."""


def weights_for(sampling: Sampling) -> Path:
    """The weights shipped with the package that suit."""
    return DISTILLED if sampling.suits(DISTILLED_STEPS) else WEIGHTS


def default_sampling(config: TraceConfig) -> Sampling:
    """The steps for which a network is distilled, or the few which one wants that is not."""
    return replace(SHIPPED, timesteps=config.timesteps) if config.timesteps else FEW


@dataclass(frozen=True)
class TraceFutures(Futures):
    """Futures and what the next plan starts with.

    Attributes:
        actions: (A, S, horizon, 2) normalised actions behind the futures.
        ids: Numbers of the agents.
    """

    actions: Tensor = field(default_factory=lambda: torch.empty(0))
    ids: tuple[int, ...] = ()


class TracePlanner:
    """TRACE as a planner.

    Args:
        trace: Trained denoiser.
        sampling: How futures are drawn; by default in the steps of a distilled network, or `FEW`.
        guidance: How objectives bend them; `THOROUGH` by default.

    Raises:
        WeightsError: When the network is distilled for other steps than those of `sampling`.
    """

    polishes = False
    """Whether chosen samples may get the last steps of mode `direct`."""

    def __init__(self, trace: Trace, sampling: Sampling | None = None, guidance: Guidance | None = None):
        steps = trace.config.timesteps
        self.sampling, self.guidance = sampling or default_sampling(trace.config), guidance or THOROUGH
        if steps and not self.sampling.suits(steps):
            raise WeightsError(
                f"this network is distilled for the steps {', '.join(map(str, steps))} of ddim without "
                "context_weight; other sampling needs weights that are not distilled"
            )
        self.trace, self.config = trace.prepared(self.sampling.reduced), trace.config
        self.schedule = CosineSchedule(trace.config.diffusion_steps)
        self.polishes = self.guidance.mode == "direct" and self.guidance.polish > 0

    @classmethod
    def load(
        cls, path: Path | None = None, sampling: Sampling | None = None, guidance: Guidance | None = None
    ) -> "TracePlanner":
        """A planner with trained weights.

        Args:
            path: File; by default what `weights_for` ships.
            sampling: How futures are drawn; `SHIPPED` by default.
            guidance: How objectives bend them.

        Raises:
            WeightsError: When the file is missing or broken, or distilled for other steps than those of `sampling`.
        """
        return cls(load_model(path or weights_for(sampling or SHIPPED))[0], sampling, guidance)

    def plan(
        self,
        states: np.ndarray | Tensor,
        size: np.ndarray | Tensor,
        maps: SceneMaps | None = None,
        objectives: Sequence[Objective] = (),
        present: np.ndarray | Tensor | None = None,
        previous: TraceFutures | None = None,
        elapsed: int = 10,
        seed: int = 0,
        ids: Sequence[int] | None = None,
    ) -> TraceFutures:
        """Futures of all A agents of a scene.

        Args:
            states: (A, 31, 4) world x, y [m], heading [rad], speed [m/s] at 10 Hz; the last frame is now.
            size: (A, 2) length and width of the agents [m]; the disc that avoids things is half the larger
                one.
            maps: One scene's map, or None where it is unknown.
            objectives: What is asked; see `objectives.OBJECTIVES`.
            present: (A, 31) false where an agent was not seen.
            previous: The last plan: saves denoising steps and keeps plans from flickering. Who is new since
                then starts from walking straight on.
            elapsed: Frames since `previous` was made.
            seed: Same seed, same plan.
            ids: Numbers of the agents, by which `previous` knows them; 0 to A - 1 by default.

        Raises:
            ValueError: On wrong shapes, values that are not finite, a map without the layers the network
                reads, or a previous plan of other agents.
            ObjectiveError: On parameters that do not fit an objective, or a goal outside the map.
        """
        states, size = _float(states), _float(size)
        names = tuple(range(len(states))) if ids is None else tuple(ids)
        if len(names) != len(states):
            raise ValueError(f"ids must name {len(states)} agents, not {len(names)}")
        if not len(states):
            return _nobody(self.sampling.samples, self.config.plan, self.config.horizon)
        if states.ndim == 3 and states.shape[1] != self.config.history:
            raise ValueError(f"states must hold {self.config.history} frames an agent, not {states.shape[1]}")
        seen = None if present is None else torch.as_tensor(present, dtype=torch.bool)
        config = self.config
        if maps is not None:
            maps = maps.select(config.map_layers)
            check_goals(objectives, maps)
        context = scene_context(states, size, maps, seen, config.max_neighbors, config.neighbor_radius)
        now, radius = states[:, -1], size.max(1).values / 2

        def future_of(actions: Tensor) -> Future:
            return Future(self.world_states(actions, now), now, radius, config.dt, maps, seed=seed, ids=names)

        return self.plan_context(context, future_of, objectives, previous, elapsed, seed, names)

    def plan_context(
        self,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective] = (),
        previous: TraceFutures | None = None,
        elapsed: int = 10,
        seed: int = 0,
        ids: tuple[int, ...] | None = None,
    ) -> TraceFutures:
        """The same for a context that is already there, and a function from actions to futures."""
        generator = torch.Generator().manual_seed(seed)
        ids = tuple(range(len(context))) if ids is None else ids
        start = None if previous is None else self._shifted(previous, ids, elapsed)
        actions = self.sample(context, future_of, objectives, generator, start)
        found = Candidates.judged(actions, future_of, objectives)
        if objectives and self.polishes:
            found = self._settled(found, context, future_of, objectives, seed)
        states = found.future.states.double().numpy()
        return TraceFutures(
            positions=states[..., :2],
            headings=states[..., 2],
            speeds=states[..., 3],
            chosen=found.chosen.numpy(),
            losses={label: loss.double().numpy() for label, loss in found.losses.items()},
            actions=found.actions,
            ids=ids,
        )

    def world_states(self, actions: Tensor, now: Tensor) -> Tensor:
        """World states (A, M, plan, 4) from normalised actions (A, M, horizon, 2) and states now (A, 4)."""
        actions = actions[..., : self.config.plan, :]
        actions = actions * self.trace.trajectory_std[4:] + self.trace.trajectory_mean[4:]
        return rollout(now[:, None], actions, self.config.dt)

    def sample(
        self,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        generator: torch.Generator,
        start: Tensor | None = None,
    ) -> Tensor:
        """Denoise all samples of all agents together: (A, M, horizon, 2) normalised actions.

        Args:
            context: A agents.
            future_of: From actions to what the objectives look at.
            objectives: What is asked.
            generator: Draws the noise.
            start: (A, M, horizon, 2) actions to start from, noised part of the way only.
        """
        sampling, shape = self.sampling, (len(context), self.sampling.samples, self.config.horizon, 2)
        solver, first = self._solver(anew=start is None)
        temperature = sampling.temperature * (self.guidance.temperature if objectives else 1.0)
        noise = temperature * torch.randn(shape, generator=generator)
        one = self._encode(context)
        many = [encoding.repeat(sampling.samples) for encoding in one]
        if start is not None:
            noise = self._noised(start, noise, solver.timesteps[first])
        lag = self._lag(objectives, len(context))
        noisy, estimate = noise, start
        for i, k in list(enumerate(solver.timesteps))[first:]:
            # What the last step would be led to nothing mends any more: that is for those who are polished.
            wishes = [] if self.polishes and i + 1 == len(solver.timesteps) else objectives
            if start is None and i == 0 and not self.config.timesteps:
                # All noise, which says nothing: one prediction serves all samples. To a distilled network it says
                # which of the teacher's futures to go for.
                clean, shift = self._guided(noisy[:, :1], k, one, None, future_of, wishes, lag)
                clean = clean.expand_as(noisy)
            else:
                clean, shift = self._guided(noisy, k, many, estimate, future_of, wishes, lag)
            if objectives:
                clean = self._within_speeds(clean, context.speed)
            noisy, estimate = solver.step(clean, noisy, i, generator) - shift, clean
        return noisy

    def _settled(
        self,
        found: Candidates,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        seed: int,
    ) -> Candidates:
        """Choose and polish; who is not led where they are asked to go tries again."""

        def polish() -> None:
            found.polish(future_of, objectives, self.guidance, bound)

        def bound(actions: Tensor) -> Tensor:
            return self._within_speeds(actions, context.speed)

        found.regroup(objectives)
        polish()
        for attempt in range(self.guidance.tries):
            rows = unmet(found.chosen, found.losses, objectives).nonzero()[:, 0]
            if not len(rows) or (attempt and len(rows) > _LOST):
                break
            actions, chosen = found.actions.clone(), found.chosen.clone()
            generator = torch.Generator().manual_seed(seed + (attempt + 1) * 2**32)
            start = self._starts(found.own[rows], context.speed[rows])
            actions[rows] = self._resample(rows, start, found.own, context, future_of, objectives, generator)
            actions[rows, 0], chosen[rows] = found.own[rows, 0], 0  # what they have is one of the samples
            found = Candidates.judged(actions, future_of, objectives, chosen)
            found.regroup(objectives)
            polish()
        if found.regroup(objectives):
            polish()
            found.regroup(objectives)
        found.reconsider(objectives)
        return found

    def _starts(self, own: Tensor, speed: Tensor) -> Tensor:
        """Where to look for other ways (R, M, horizon, 2): near one's own (R, 1, horizon, 2), and in all directions.

        Of those who stand with the goal behind, guidance alone makes people who stand: no turn of theirs gets anywhere.
        """
        ways = setting_out(speed, self.sampling.samples, self.config.horizon, self.config.dt)
        starts = self.trace.normalized(ways)
        starts[:, ::2] = own
        return starts

    def _resample(
        self,
        rows: Tensor,
        start: Tensor,
        own: Tensor,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        generator: torch.Generator,
    ) -> Tensor:
        """New samples (R, M, horizon, 2) of some people (R,), not far from where they start, of the same shape.

        All others keep to their `own` actions (A, 1, horizon, 2).
        """
        sampling = self.sampling
        solver, first = self._solver(anew=False)
        many = [encoding.repeat(sampling.samples) for encoding in self._encode(context.take(rows))]
        estimate = own.repeat(1, sampling.samples, 1, 1)  # of everybody
        noise = torch.randn(estimate.shape, generator=generator)[rows]  # the same whoever else tries again
        estimate[rows] = start
        noisy = self._noised(estimate[rows], noise, solver.timesteps[first])
        lag = self._lag(objectives, len(context))
        for i, k in list(enumerate(solver.timesteps))[first:]:
            others = None  # who the network sees is where they are by now, (R * M, N, horizon, 2)
            if context.rows is not None:
                others = estimate[context.rows[rows]].transpose(1, 2).flatten(0, 1)
            estimate[rows] = self._predict(noisy, k, many, estimate[rows], others) - lag[rows]
            if i + 1 < len(solver.timesteps):
                guided = guide_direct(
                    estimate, future_of, objectives, self.guidance, self.schedule.variance(k)
                )
                estimate[rows] = guided[rows]
            estimate[rows] = self._within_speeds(estimate[rows], context.speed[rows])
            noisy = solver.step(estimate[rows], noisy, i, generator)
        return noisy

    def _solver(self, anew: bool) -> tuple[Solver, int]:
        """A solver, and the number of its first step: for what is not drawn `anew` that at a part of the noise."""
        solver = self.sampling.make_solver(self.schedule)
        if anew:
            return solver, 0
        level = self.sampling.keep * (len(self.schedule) - 1)
        last = len(solver.timesteps) - 1
        return solver, next((i for i, k in enumerate(solver.timesteps) if k <= level), last)

    def _noised(self, actions: Tensor, noise: Tensor, k: int) -> Tensor:
        return self.schedule.add_noise(actions, noise, torch.full((len(actions),), k))

    def _lag(self, objectives: Sequence[Objective], agents: int) -> Tensor:
        """What `haste` takes off normalised actions (A, 1, horizon, 2): nothing of who is not led anywhere."""
        led = torch.zeros(agents, 1, dtype=torch.bool)
        if self.guidance.haste:
            for wish in objectives:
                led = led | wish.led(agents)
        horizon = self.config.horizon
        lag = torch.zeros(horizon, 2)
        lag[: horizon // 2, 0] = self.guidance.haste / self.trace.trajectory_std[4]
        lag[horizon // 2 :, 0] = -lag[0, 0] / 2
        return led[..., None, None] * lag

    def _within_speeds(self, actions: Tensor, speed: Tensor) -> Tensor:
        """The nearest actions (A, M, horizon, 2) whose speeds, from (A,) now, keep the bounds of guidance."""
        mean, std = self.trace.trajectory_mean[4], self.trace.trajectory_std[4]
        low, high = self.guidance.speeds
        start = speed[:, None, None].expand(*actions.shape[:2], 1)
        speeds = start + torch.cumsum(actions[..., 0] * std + mean, -1) * self.config.dt
        speeds = torch.cat([start, torch.minimum(speeds.clamp(min=low), start.clamp(min=high))], -1)
        acceleration = (speeds.diff(dim=-1) / self.config.dt - mean) / std
        return torch.stack([acceleration, actions[..., 1]], -1)

    def _guided(
        self,
        noisy: Tensor,
        k: int,
        encodings: list[Encoding],
        estimate: Tensor | None,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        lag: Tensor,
    ) -> tuple[Tensor, Tensor | float]:
        """Guided clean actions, and what guidance takes off the next noisy ones."""
        guidance = self.guidance
        if not objectives:
            return self._predict(noisy, k, encodings, estimate) - lag, 0.0
        variance = self.schedule.variance(k)
        if guidance.mode == "clean":
            with torch.enable_grad():
                noisy = noisy.detach().requires_grad_()
                clean = self._predict(noisy, k, encodings, estimate) - lag
                loss = total_loss(objectives, future_of(clean))
                gradient = gradient_of(loss, noisy)
            return clean.detach() - guidance.step(loss.detach(), gradient, variance), 0.0
        clean = self._predict(noisy, k, encodings, estimate) - lag
        if guidance.mode == "direct":
            return guide_direct(clean, future_of, objectives, guidance, variance), 0.0
        with torch.enable_grad():
            mean = self.schedule.posterior(clean, noisy, k)[0].detach().requires_grad_()
            loss = total_loss(objectives, future_of(mean))
            gradient = gradient_of(loss, mean)
        return clean, guidance.step(loss.detach(), gradient, variance)

    def _encode(self, context: Context) -> list[Encoding]:
        """The conditional encoding, and the unconditional one where it is mixed in; a row per agent."""
        contexts = [context]
        if self.sampling.context_weight:
            contexts.append(context.unconditional())
        with torch.no_grad():
            return [self.trace.encode(c) for c in contexts]

    def _predict(
        self,
        noisy: Tensor,
        k: int,
        encodings: list[Encoding],
        estimate: Tensor | None,
        neighbors: Tensor | None = None,
    ) -> Tensor:
        rows = noisy.flatten(0, 1)
        known = None if estimate is None else estimate.flatten(0, 1)
        steps = torch.full((len(rows),), k)
        with torch.set_grad_enabled(noisy.requires_grad):
            clean = [self.trace(rows, steps, e, neighbors, known).reshape(noisy.shape) for e in encodings]
        if len(clean) == 1:
            return clean[0]
        return self.schedule.classifier_free(clean[0], clean[1], noisy, k, self.sampling.context_weight)

    def _shifted(self, previous: TraceFutures, ids: tuple[int, ...], elapsed: int) -> Tensor:
        """The chosen actions of the last plan, moved on in time, for every sample.

        After their end, and for who was not in it, nothing changes: straight on at the same speed.
        """
        row_of = {agent: row for row, agent in enumerate(previous.ids)}
        if previous.ids and not row_of.keys() & set(ids):
            raise ValueError(f"the previous plan is of agents {_some(previous.ids)}, none of {_some(ids)}")
        if elapsed < 0:
            raise ValueError(f"elapsed must not be negative, it is {elapsed}")
        horizon = self.config.horizon
        start = self.trace.normalized(torch.zeros(len(ids), horizon, 2))
        known = [(row, row_of[agent]) for row, agent in enumerate(ids) if agent in row_of]
        if known and elapsed < horizon:
            rows, old = torch.tensor(known).unbind(1)
            chosen = previous.actions[old, torch.as_tensor(previous.chosen)[old]]  # (known, horizon, 2)
            start[rows, : horizon - elapsed] = chosen[:, elapsed:]
        return start[:, None].expand(-1, self.sampling.samples, -1, -1)


def check_goals(objectives: Sequence[Objective], maps: SceneMaps) -> None:
    """Every `goal` must lie on the map, or a few steps beyond its border, where its border goes on.

    Raises:
        ObjectiveError: One does not; says whose, and how far the map reaches.
    """
    low, high = maps.bounds()
    for wish in objectives:
        if (goal := wish.parameters.get("goal")) is None:
            continue
        goals = torch.as_tensor(goal, dtype=torch.float32).reshape(-1, 2)
        outside = ((goals < low - BEYOND) | (goals > high + BEYOND)).any(-1)  # false for NaN: who has no goal
        if outside.any():
            agent = int(outside.nonzero()[0])
            x, y = goals[agent].tolist()
            raise ObjectiveError(
                f"objective {wish.name!r}: the goal of agent {agent}, ({x:.1f}, {y:.1f}), lies outside the map, "
                f"which reaches from ({low[0]:.1f}, {low[1]:.1f}) to ({high[0]:.1f}, {high[1]:.1f})"
            )


def _nobody(samples: int, steps: int, horizon: int) -> TraceFutures:
    """The plan of an empty scene."""
    positions = np.zeros((0, samples, steps, 2))
    empty = positions[..., 0]
    return TraceFutures(positions, empty, empty, np.zeros(0, int), {}, torch.zeros(0, samples, horizon, 2))


def _some(ids: tuple[int, ...]) -> str:
    return ", ".join(map(str, ids[:5])) + (", ..." if len(ids) > 5 else "")


def _float(values: np.ndarray | Tensor) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)

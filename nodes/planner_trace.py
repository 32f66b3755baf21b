"""TRACE as a planning method: live agents, maps and objectives in, guided samples out. Needs torch."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from ..messages.config import ConfigError
from ..messages.map import SemanticMap
from ..models.crowd.navigation import Navigator
from ..models.crowd.planning import PLAN_DT, PLAN_STEPS
from ..models.crowd.routes import Routes
from ..models.trace.config import DISTILLED_STEPS
from ..models.trace.objectives import Objective, ObjectiveError
from ..models.trace.planner import (
    FEW,
    SHIPPED,
    THOROUGH,
    TracePlanner,
    default_sampling,
    weights_for,
)
from ..models.trace.scene_map import SceneMaps
from ..models.trace.scene_planner import TraceFutures
from ..models.trace.weights import WeightsError, load_model
from .planner_moment import Moment, place_of
from .planner_objectives import Surroundings, facing_the_way, objectives_of, timed_way
from .planner_stops import halted, settled

log = logging.getLogger(__name__)

CLEARANCE = 0.4
"""Ways keep so far from obstacles [m]."""
GUIDANCE_STEPS = 3
"""Per denoising step: wishes here lead far from what people would do by themselves, as round a wall."""
SPEEDS = (0.0, 3.0)
"""As fast as somebody may be asked to walk [m/s]."""
POWER = 1.0
"""Of the strides where weights are not distilled: longer ones at the end would leave such wishes half met."""


class TraceMethod:
    """Guided samples that continue each other from plan to plan.

    Args:
        seed: Of the run; noise follows from it and from the time.
        samples: Futures a pedestrian.
        steps: Denoising steps, where weights are not distilled for steps of their own.
        context_weight: w of classifier-free sampling.
        guidance: Where gradients are taken.
        weights: File, or None for those shipped: the distilled ones for their number of steps without
            `context_weight`, else those for any.
        modules: Python files or modules that register objectives.
        ask: Objectives for everybody, with parameters and `weight`.
        margin: Added to every body's radius [m].
        threads: Of torch, in this process.

    Raises:
        ConfigError: Weights, modules or objectives cannot be had.
    """

    def __init__(
        self,
        seed: int,
        samples: int,
        steps: int,
        context_weight: float,
        guidance: Literal["direct", "clean", "noisy"],
        weights: str | None,
        modules: Sequence[str],
        ask: Mapping[str, Mapping[str, float]],
        margin: float,
        threads: int,
    ) -> None:
        torch.set_num_threads(threads)
        for name in modules:
            load_objectives(name)
        try:
            few = steps == len(DISTILLED_STEPS) and not context_weight
            network, _ = load_model(Path(weights) if weights else weights_for(SHIPPED if few else FEW))
            sampling = replace(
                default_sampling(network.config), samples=samples, context_weight=context_weight
            )
            if not network.config.timesteps:
                sampling = replace(sampling, steps=steps, power=POWER)
            how = replace(THOROUGH, mode=guidance, inner_steps=GUIDANCE_STEPS, tries=0, speeds=SPEEDS)
            self._planner = TracePlanner(network, sampling, how)
            self._everybody = [
                Objective(name, {k: v for k, v in values.items() if k != "weight"}, values.get("weight", 1.0))
                for name, values in ask.items()
            ]
        except (WeightsError, ObjectiveError) as error:
            raise ConfigError(f"planner: config: {error}") from None
        config = self._planner.config
        if (config.dt, config.plan) != (PLAN_DT, PLAN_STEPS):
            raise ConfigError(
                f"planner: config: weights: plans of {weights} have {config.plan} points {config.dt:g} s "
                f"apart; the graph's have {PLAN_STEPS}, {PLAN_DT:g} s apart"
            )
        self._seed, self._margin = seed, margin
        self._surroundings: Surroundings | None = None
        self._maps: SceneMaps | None = None
        self._last: TraceFutures | None = None
        self._last_time = 0.0

    def place(self, semantic_map: SemanticMap) -> None:
        """Distance fields and ways of a new map; plans go on from the last one."""
        place = place_of(semantic_map)
        height, width = place.blocked.shape
        low = np.array(place.origin)
        navigator = Navigator(place.blocked, place.resolution, place.origin, CLEARANCE, place.cost)
        self._maps = SceneMaps.from_raster(
            {"obstacle": place.blocked}, place.resolution, (low + place.resolution / 2).tolist()
        )
        high = low + place.resolution * np.array([width, height])
        self._surroundings = Surroundings(Routes(navigator), low, high)

    def plan(self, moment: Moment) -> TraceFutures:
        """All samples of everybody, and which to follow."""
        assert self._surroundings is not None
        way, slack = timed_way(moment, self._surroundings.routes)
        wishes = objectives_of(moment, way, slack, self._surroundings, self._margin) + self._everybody
        states = moment.history[:, :, :4].copy()
        states[:, -1] = now = facing_the_way(moment.states, way)
        elapsed = round((moment.now - self._last_time) / PLAN_DT)
        ids = moment.ids.tolist()
        last = self._last
        if last is not None and (elapsed >= PLAN_STEPS or not set(last.ids) & set(ids)):
            last = None
        futures = self._planner.plan(
            states,
            np.repeat(2 * moment.radius[:, None], 2, axis=1),
            self._maps,
            wishes,
            moment.history[:, :, 6] > 0,
            previous=last,
            elapsed=elapsed,
            seed=self._seed * 1_000_003 + round(moment.now / PLAN_DT),
            ids=ids,
        )
        self._last, self._last_time = futures, moment.now
        heeds = moment.asked.weights["ObstacleAvoidance"] != 0  # NaN, nothing said, does
        return settled(halted(futures, now, self._maps, moment.radius, heeds), now)


def load_objectives(name: str) -> None:
    """Run a Python file, or import a module, for the objectives it registers.

    Raises:
        ConfigError: There is none, or it fails.
    """
    path = Path(name)
    try:
        if path.suffix != ".py":
            import_module(name)
            return
        spec = spec_from_file_location(path.stem, path)
        assert spec is not None and spec.loader is not None
        spec.loader.exec_module(module_from_spec(spec))
    except Exception as error:  # whatever a stranger's module does wrong
        reason = f"{type(error).__name__}: {error}"
        raise ConfigError(f"planner: config: objectives: cannot load {name}: {reason}") from error

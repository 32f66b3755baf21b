"""Training samples: windows of past and future motion cut from crowds, gathered for a whole batch at once."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from .config import TraceConfig
from .context import Context, ego_context
from .crowd_file import SPLITS, CrowdFileError, Crowds
from .dynamics import LIMITS, UnicycleLimits, fit_actions, headings_along, rollout
from .scene_map import SceneMaps


@dataclass(frozen=True)
class FittedCrowds:
    """Crowds as the unicycle walks them.

    Attributes:
        states: (S, N, T, 4) world x, y [m], continuous heading [rad], speed [m/s]; zero where absent.
        actions: (S, N, T, 2) the action that led to each state; zero at the first frame of a person.
        present: (S, N, T) bool.
    """

    states: Tensor
    actions: Tensor
    present: Tensor


def fit_crowds(positions: np.ndarray, dt: float, limits: UnicycleLimits = LIMITS) -> FittedCrowds:
    """Fit the unicycle to (S, N, T, 2) observed positions, NaN where absent.

    Raises:
        CrowdFileError: When somebody vanishes and comes back.
    """
    observed = torch.from_numpy(np.ascontiguousarray(positions, np.float32))
    present = torch.isfinite(observed).all(-1)
    if ((present[..., 1:] & ~present[..., :-1]).sum(-1) + present[..., 0] > 1).any():
        raise CrowdFileError("somebody vanishes and comes back; give them a new row from then on")
    # Before they enter people walk in at constant velocity, after they left they stand, so that rows are
    # alike.
    frames = torch.arange(observed.shape[2])
    entered = torch.where(present.any(-1), present.to(torch.int8).argmax(-1), 0)[..., None]  # (S, N, 1)
    left = torch.cummax(torch.where(present, frames, -1), -1).values
    left = torch.where(left >= 0, left, entered)
    filled = observed.gather(2, left[..., None].expand_as(observed)).nan_to_num()
    pick = entered[..., None].expand(*entered.shape, 2)
    first = filled.gather(2, pick)
    stride = filled.gather(2, (pick + 1).clamp(max=filled.shape[2] - 1)) - first  # (S, N, 1, 2)
    early = (frames - entered).clamp(max=0)[..., None]
    filled = filled + early * stride
    heading = headings_along(filled, dt)[..., 0]
    speed = (stride[:, :, 0] / dt).norm(dim=-1)
    start = torch.cat([filled[:, :, 0], heading[..., None], speed[..., None]], -1)
    actions = fit_actions(start, filled[:, :, 1:], dt, limits)
    states = torch.cat([start[:, :, None], rollout(start, actions, dt, limits)], 2)
    actions = torch.cat([torch.zeros_like(actions[:, :, :1]), actions], 2)
    shown = present[..., None]
    return FittedCrowds(torch.where(shown, states, 0.0), torch.where(shown, actions, 0.0), present)


class CrowdWindows:
    """All windows of one split of a set of crowds.

    Args:
        crowds: The set.
        split: `train`, `val` or `test`.
        config: Lengths of history and horizon, neighbour radius.
        stride: Frames between the starts of consecutive windows of one person.
        mirror: Add every scene's mirror image (y to -y).
    """

    def __init__(
        self, crowds: Crowds, split: str, config: TraceConfig, stride: int = 1, mirror: bool = False
    ):
        self.config, self.name, self.radius = config, crowds.name, crowds.radius
        rows = np.flatnonzero(crowds.split == SPLITS.index(split))
        fitted = fit_crowds(crowds.positions[rows], crowds.dt)
        self.states, self.actions, self.present = fitted.states, fitted.actions, fitted.present
        self.observed = torch.from_numpy(crowds.positions[rows])
        self.distance = torch.from_numpy(crowds.distance[rows]) if crowds.has_map else None
        self.resolution, self.layers = crowds.resolution, crowds.layers
        self.origin = torch.tensor(crowds.origin, dtype=torch.float32).repeat(len(rows), 1)
        if mirror:
            self._add_mirror_images()
        frames = self.present.shape[2]
        first = config.history - 1
        now = torch.arange(first, max(first, frames - config.horizon), stride)
        stays = self.present[:, :, now] & self.present[:, :, now + config.horizon]  # (S, N, W)
        index = stays.nonzero()
        self.index = torch.stack([index[:, 0], index[:, 1], now[index[:, 2]]], 1)  # (windows, 3)
        if not len(self.index):
            raise CrowdFileError(
                f"{crowds.name} has no window of {config.history + config.horizon} frames in {split}"
            )

    def __len__(self) -> int:
        return len(self.index)

    def batch(self, rows: Tensor) -> tuple[Context, Tensor]:
        """Contexts and the true future actions (B, horizon, 2) in SI units of windows number `rows` (B,)."""
        return self.gather(*self.index[rows].unbind(1))

    @cached_property
    def moments(self) -> Tensor:
        """(M, 2) scenes and frames at which there is a window of somebody."""
        return self.index[:, [0, 2]].unique(dim=0)

    def batch_scenes(self, rows: Tensor) -> tuple[Context, Tensor]:
        """Everybody who has a window at moments number `rows` (M,), among each other: contexts name their rows.

        Returns:
            Contexts of the B people of all moments, and their true future actions (B, horizon, 2) in SI units.
        """
        scene, now = self.moments[rows].unbind(1)
        stays = self.present[scene, :, now] & self.present[scene, :, now + self.config.horizon]  # (M, N)
        moment, agent = stays.nonzero().unbind(1)
        return self.gather(scene[moment], agent, now[moment], stays, moment)

    def gather(
        self,
        scene: Tensor,
        agent: Tensor,
        now: Tensor,
        among: Tensor | None = None,
        moment: Tensor | None = None,
    ) -> tuple[Context, Tensor]:
        """The same for people `agent` (B,) of scenes `scene` (B,) at frames `now` (B,).

        Args:
            scene: Numbers of scenes.
            agent: Numbers of people in them.
            now: Numbers of frames.
            among: (M, N) who else is there at M moments, where these people are all of them; else everybody is.
            moment: (B,) of these, for each.
        """
        past = now[:, None] + torch.arange(1 - self.config.history, 1)  # (B, H)
        future = now[:, None] + torch.arange(1, self.config.horizon + 1)
        everybody = self.states[scene, :, now, :2]  # (B, N, 2)
        distance = (everybody - self.states[scene, agent, now, :2][:, None]).norm(dim=-1)
        there = self.present[scene, :, now] if among is None else among[moment]
        distance = torch.where(there, distance, torch.inf)
        distance[torch.arange(len(agent)), agent] = torch.inf
        others = distance.argsort(1)[:, : min(self.config.max_neighbors, distance.shape[1] - 1)]
        s, p = scene[:, None, None], past[:, None]
        ego = self._people(scene[:, None], agent[:, None], past)
        states, present, size = self._people(s, others[..., None], p)
        apart = torch.isfinite(distance.gather(1, others))  # nobody is a neighbour of themselves
        neighbors = states, present & apart[..., None], size
        unique, local = scene.unique(return_inverse=True)
        context = ego_context(ego, neighbors, self.maps(unique), local, radius=self.config.neighbor_radius)
        if among is None:
            theirs = self.actions[s, others[..., None], future[:, None]]
            context = replace(context, neighbor_actions=theirs)
        else:
            row_of = torch.zeros(among.shape, dtype=torch.long)
            row_of[moment, agent] = torch.arange(len(agent))
            context = replace(context, rows=row_of[moment].gather(1, others), moment=moment)
        return context, self.actions[scene[:, None], agent[:, None], future]

    def maps(self, scenes: Tensor) -> SceneMaps | None:
        """The maps of these scenes, or None for a set without maps."""
        if self.distance is None:
            return None
        field = self.distance[scenes].float()
        field = field if field.ndim == 4 else field[:, None]
        return SceneMaps(field, self.origin[scenes], self.resolution, self.layers)

    def _add_mirror_images(self) -> None:
        flip = torch.tensor([1.0, -1.0, -1.0, 1.0])
        self.states = torch.cat([self.states, self.states * flip])
        self.observed = torch.cat([self.observed, self.observed * flip[:2]])
        self.actions = torch.cat([self.actions, self.actions * flip[[0, 1]]])
        self.present = self.present.repeat(2, 1, 1)
        if self.distance is not None:
            top = self.origin[:, 1] + (self.distance.shape[-2] - 1) * self.resolution
            self.distance = torch.cat([self.distance, self.distance.flip(-2)])
            self.origin = torch.cat([self.origin, torch.stack([self.origin[:, 0], -top], 1)])

    def _people(self, scene: Tensor, agent: Tensor, frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        states = self.states[scene, agent, frames]
        return (
            states,
            self.present[scene, agent, frames],
            torch.full_like(states[..., 0, :2], 2 * self.radius),
        )

"""From agents and a map in the world frame to what the denoiser sees, each agent in its own frame."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from .scene_map import SceneMaps

FAR = 1e5
"""Places are float32: so far from the origin they are a centimetre apart [m]."""


@dataclass(frozen=True)
class Context:
    """Conditioning of B ego agents. Ego frame: origin at the agent now, x along its heading.

    Attributes:
        ego: (B, H, 8) past frames [x y hx hy v l w present], the last one is now; zero where absent.
        neighbors: (B, N, H, 8) the same of the neighbours, in the ego frame; zero where absent.
        pose: (B, 3) world x, y [m], heading [rad] of the ego frame.
        speed: (B,) current speed [m/s].
        maps: Signed distance fields of all scenes, or None.
        scene: (B,) the scene of each agent in `maps`.
        map_known: (B,) false where there is no map or it was dropped.
        rows: (B, N) which of the B agents each neighbour is, where all are denoised together; else None.
        neighbor_actions: (B, N, T, 2) true future actions of the neighbours in SI units, zero where they are
            gone; known in training only.
        moment: (B,) number of the scene and time at which each stands, where those of several are denoised at
            once: all of one moment have the same noise level.
    """

    ego: Tensor
    neighbors: Tensor
    pose: Tensor
    speed: Tensor
    maps: SceneMaps | None
    scene: Tensor
    map_known: Tensor
    rows: Tensor | None = None
    neighbor_actions: Tensor | None = None
    moment: Tensor | None = None

    def __len__(self) -> int:
        return len(self.ego)

    def take(self, rows: Tensor) -> "Context":
        """The context of some people (R,), by themselves: nobody is denoised together."""
        parts = {
            name: getattr(self, name)[rows]
            for name in ("ego", "neighbors", "pose", "speed", "scene", "map_known")
        }
        return replace(self, rows=None, neighbor_actions=None, moment=None, **parts)

    def initial_state(self) -> Tensor:
        """(B, 4) current x, y, heading, speed in the ego frame: zero but for the speed."""
        return torch.nn.functional.pad(self.speed[:, None], (3, 0))

    def drop(self, maps: Tensor, neighbors: Tensor) -> "Context":
        """A copy without the map (B,) and without the neighbours (B,) where the masks are true.

        The ego history is never dropped: neither training nor the unconditional branch of classifier-free
        sampling does (TRACE app. A.1.3).
        """
        kept = torch.where(neighbors[:, None, None, None], torch.zeros(()), self.neighbors)
        return replace(self, map_known=self.map_known & ~maps, neighbors=kept)

    def unconditional(self) -> "Context":
        """A copy without any map and neighbours."""
        everything = torch.ones(len(self), dtype=torch.bool)
        return self.drop(everything, everything)


def to_frame(points: Tensor, pose: Tensor) -> Tensor:
    """World points (B, ..., 2) in the frames `pose` (B, 3) [x, y, heading]."""
    shape = (-1,) + (1,) * (points.ndim - 2)
    cos, sin = pose[:, 2].cos().reshape(shape), pose[:, 2].sin().reshape(shape)
    x, y = points[..., 0] - pose[:, 0].reshape(shape), points[..., 1] - pose[:, 1].reshape(shape)
    return torch.stack([cos * x + sin * y, cos * y - sin * x], -1)


def from_frame(points: Tensor, pose: Tensor) -> Tensor:
    """Points (B, ..., 2) of the frames `pose` (B, 3) in the world: the inverse of `to_frame`."""
    shape = (-1,) + (1,) * (points.ndim - 2)
    cos, sin = pose[:, 2].cos().reshape(shape), pose[:, 2].sin().reshape(shape)
    x = cos * points[..., 0] - sin * points[..., 1] + pose[:, 0].reshape(shape)
    y = sin * points[..., 0] + cos * points[..., 1] + pose[:, 1].reshape(shape)
    return torch.stack([x, y], -1)


def history_features(states: Tensor, present: Tensor, size: Tensor, pose: Tensor) -> Tensor:
    """Past frames as the network reads them (TRACE app. A.1.1).

    Args:
        states: (B, ..., H, 4) world x, y, heading, speed.
        present: (B, ..., H) bool.
        size: (B, ..., 2) length and width of the bounding box [m].
        pose: (B, 3) ego frame.

    Returns:
        (B, ..., H, 8) [x y hx hy v l w present] in the ego frame, zero where absent.
    """
    position = to_frame(states[..., :2], pose)
    heading = states[..., 2] - pose[:, 2].reshape((-1,) + (1,) * (states.ndim - 2))
    box = size[..., None, :].expand(*states.shape[:-1], 2)
    rows = [position, heading.cos()[..., None], heading.sin()[..., None], states[..., 3:4], box]
    features = torch.cat([*rows, torch.ones_like(states[..., :1])], -1)
    return torch.where(present[..., None], features, torch.zeros(()))


def ego_context(
    ego: tuple[Tensor, Tensor, Tensor],
    neighbors: tuple[Tensor, Tensor, Tensor],
    maps: SceneMaps | None = None,
    scene: Tensor | None = None,
    map_known: Tensor | None = None,
    radius: float = 15.0,
) -> Context:
    """Context of B agents whose neighbours are already gathered.

    Args:
        ego: States (B, H, 4), present (B, H), size (B, 2), world frame.
        neighbors: States (B, N, H, 4), present (B, N, H), size (B, N, 2), world frame.
        maps: Maps of all scenes.
        scene: (B,) scene of each agent; all 0 by default.
        map_known: (B,) false where an agent has no map.
        radius: Neighbours that are now further away, or absent now, are dropped [m].
    """
    states, present, size = ego
    count = len(states)
    pose = states[:, -1, :3]
    near_states, near_present, near_size = neighbors
    distance = (near_states[:, :, -1, :2] - pose[:, None, :2]).norm(dim=-1)
    near = near_present[:, :, -1] & (distance <= radius)
    if scene is None:
        scene = torch.zeros(count, dtype=torch.long)
    if map_known is None:
        map_known = torch.full((count,), maps is not None)
    return Context(
        ego=history_features(states, present, size, pose),
        neighbors=history_features(near_states, near_present & near[..., None], near_size, pose),
        pose=pose,
        speed=states[:, -1, 3],
        maps=maps,
        scene=scene,
        map_known=map_known,
    )


def scene_context(
    states: Tensor,
    size: Tensor,
    maps: SceneMaps | None = None,
    present: Tensor | None = None,
    max_neighbors: int = 20,
    radius: float = 15.0,
) -> Context:
    """Context of all A agents of one scene: each sees the others that are nearest to it now.

    Args:
        states: (A, H, 4) world x, y [m], heading [rad], speed [m/s]; the last frame is now.
        size: (A, 2) length and width of each agent [m].
        maps: Map of the scene, or None where it is unknown.
        present: (A, H) false where an agent was not seen; everybody must be seen now.
        max_neighbors: At most this many neighbours are kept.
        radius: Only neighbours within this distance are kept [m].

    Raises:
        ValueError: On a wrong shape, a value that is not finite, or an agent that is absent now.
    """
    if states.ndim != 3 or states.shape[-1] != 4:
        raise ValueError(f"states must be (agents, frames, 4 [x y heading speed]), not {tuple(states.shape)}")
    agents, frames = states.shape[:2]
    if size.shape != (agents, 2):
        raise ValueError(f"size must be ({agents}, 2 [length width]), not {tuple(size.shape)}")
    if not (torch.isfinite(size) & (size > 0)).all():
        raise ValueError("the sizes of agents must be finite and above zero")
    if present is None:
        present = torch.ones(agents, frames, dtype=torch.bool)
    if present.shape != (agents, frames):
        raise ValueError(f"present must be ({agents}, {frames}), not {tuple(present.shape)}")
    if not present[:, -1].all():
        raise ValueError(
            f"agent {int((~present[:, -1]).nonzero()[0])} is absent now and cannot be planned for"
        )
    if not torch.isfinite(states[present]).all():
        raise ValueError("states of present agents must be finite")
    if states[present][:, :2].abs().max() > FAR:
        raise ValueError(
            f"somebody is more than {FAR:g} m from the origin, where places are rounded to centimetres and more; "
            "take an origin nearer by"
        )
    states = torch.where(present[..., None], states, torch.zeros(()))
    now = states[:, -1, :2]
    distance = torch.cdist(now, now).fill_diagonal_(torch.inf)
    nearest = distance.argsort(-1)[:, : min(max_neighbors, agents - 1)]  # (A, N)
    others = (states[nearest], present[nearest], size[nearest])
    context = ego_context((states, present, size), others, maps, radius=radius)
    return replace(context, rows=nearest)

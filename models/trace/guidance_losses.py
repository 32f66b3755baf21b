"""The objectives of TRACE (Rempe et al. 2023, app. A.2.2) and a few more."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .objectives import Future, objective, per_agent

_AHEAD = 0.3  # share of the gradient along the motion that the avoidance of obstacles keeps
_SHARP = 1e-3  # m, softness of a minimum over time that counts but one state
_AT_REST = 0.3  # m/s, by which somebody who stands in an obstacle is still pushed out


def distance_to(future: Future, goal: Tensor) -> tuple[Tensor, Tensor]:
    """(A, M, T) distances to (A, 2) or (2,) goals [m], and (A, 1) who has one."""
    goals, given = per_agent(goal, len(future.states), 1)
    return (future.positions - goals[:, :, None]).norm(dim=-1), given


@objective("agent_avoid", joint=True, safety=True)
def agent_avoid(future: Future, buffer: Tensor | float = 0.2) -> Tensor:
    """Overlap of discs, 1 - d / (r_i + r_j + buffer), summed over time and other agents.

    Args:
        future: Of one scene.
        buffer: Social distance that is kept beyond touching [m] (app. C.5); of two people (A,) the mean.
    """
    agents, samples = future.states.shape[:2]
    if agents == 1:
        return future.states.new_zeros(1, samples)
    distance, given = per_agent(buffer, agents)
    kept = future.radius + distance[:, 0] / 2
    p = future.positions
    with torch.no_grad():
        low, high = p.amin((1, 2)), p.amax((1, 2))
        gap = torch.relu(torch.maximum(low[:, None] - high, low - high[:, None]))  # between bounding boxes
        i, j = (gap.norm(dim=-1) < kept[:, None] + kept).triu(1).nonzero().unbind(1)
        if not len(i):
            return future.states.new_zeros(agents, samples)
        square = (p[i] - p[j]).square().sum(-1)  # (P, M, T)
        reach = (kept[i] + kept[j]).square()[:, None, None]
        pair, sample, time = (square < reach).nonzero().unbind(1)
        i, j = i[pair], j[pair]
    total = _Overlaps.apply(p, i * samples + sample, j * samples + sample, time, kept[i] + kept[j])
    return total if given.all() else total * given


class _Overlaps(torch.autograd.Function):
    """Sums (A, M) of 1 - d / reach over pairs that touch, with the gradient written out; see `Future.sloped`.

    Both of a pair have the loss, and each moves both: this is what that function leaves out.
    """

    @staticmethod
    def forward(
        ctx: Any, positions: Tensor, one: Tensor, other: Tensor, time: Tensor, reach: Tensor
    ) -> Tensor:
        """Positions (A, M, T, 2); of P pairs two rows of A * M each, the time and the reach (P,)."""
        agents, samples, steps = positions.shape[:3]
        first, second = one * steps + time, other * steps + time
        flat = positions.reshape(-1, 2)
        apart = flat.index_select(0, first) - flat.index_select(0, second)
        distance = (apart.square().sum(-1) + 1e-8).sqrt()
        overlap = torch.relu(1 - distance / reach)
        ctx.save_for_backward(one, other, first, second, apart / (distance * reach)[:, None])
        ctx.shape = positions.shape
        total = overlap.new_zeros(agents * samples)
        return total.index_add_(0, one, overlap).index_add_(0, other, overlap).view(agents, samples)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None, None, None]:
        one, other, first, second, direction = ctx.saved_tensors
        grad = grads[0].reshape(-1)
        push = direction * (grad.index_select(0, one) + grad.index_select(0, other))[:, None]
        slope = push.new_zeros(ctx.shape[:3].numel(), 2)
        slope.index_add_(0, first, -push).index_add_(0, second, push)
        return slope.view(ctx.shape), None, None, None, None


@objective("obstacle_avoid", safety=True)
def obstacle_avoid(future: Future, buffer: Tensor | float = 0.0) -> Tensor:
    """Depth [m] of each disc inside obstacles times its speed [m/s] (plus `_AT_REST`), summed over time.

    As an integral over the way (Ratliff et al. 2009, CHOMP) it pays nobody for racing through. Its gradient leads
    around rather than back: speeds are held, and of the part along the motion `_AHEAD` is left. Of a way through a
    narrow obstacle the first half would else go slower, the second half faster, and little would lead around it.

    Args:
        future: Of one scene.
        buffer: Distance that is kept beyond touching [m], for all or (A,).
    """
    recorded = torch.is_grad_enabled()
    with torch.no_grad():
        distance, given = per_agent(buffer, len(future.states))
        reach = (future.radius[:, None] + distance)[..., None]
        clearance, away = future.clearance_and_way_out(future.positions)
        depth = torch.relu(reach - clearance) * given[..., None]  # (A, M, T)
        heading, speed = future.states[..., 2:].unbind(-1)
        loss = (depth * (speed + _AT_REST)).sum(-1)
        if not (recorded and depth.any()):
            return loss
        forward = torch.stack([heading.cos(), heading.sin()], -1)
        away = away - (1 - _AHEAD) * (away * forward).sum(-1, keepdim=True) * forward
        slope = away * ((speed + _AT_REST) * (depth > 0)).neg()[..., None]
    return future.sloped(loss, slope)


@objective("obstacle_avoid_points", safety=True)
def obstacle_avoid_points(future: Future, points: int = 10, buffer: float = 0.0) -> Tensor:
    """The paper's loss: 1 - d_min / b summed over the body points that are embedded in an obstacle.

    A grid of points covers the bounding box; d_min is the distance from an embedded point to the nearest
    free point of the body, b the diagonal. Embedded points are detached: they count as part of the
    obstacle. Steps at which the body is wholly free or wholly embedded give no gradient and are left out.

    Args:
        future: Of one scene.
        points: Grid points along each side.
        buffer: Added to all sides of the box [m].
    """
    side = torch.linspace(-1, 1, points)
    grid = torch.stack(torch.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)  # (P, 2)
    half = (future.radius + buffer)[:, None, None, None]
    heading = future.states[..., 2, None]
    along, across = grid[:, 0] * half, grid[:, 1] * half
    offset = torch.stack(
        [heading.cos() * along - heading.sin() * across, heading.sin() * along + heading.cos() * across], -1
    )
    body = future.positions[..., None, :] + offset  # (A, M, T, P, 2)
    with torch.no_grad():
        embedded = future.clearance(body) < 0
        partial = embedded.any(-1) & ~embedded.all(-1)
    index = partial.nonzero()
    body, inside = body[partial], embedded[partial]  # (Q, P, 2), (Q, P)
    apart = torch.cdist(body.detach(), body).masked_fill(inside[:, None], torch.inf)
    diagonal = 2 * 2**0.5 * (future.radius + buffer)[index[:, 0], None]
    loss = ((1 - apart.min(-1).values / diagonal) * inside).sum(-1)
    total = future.states.new_zeros(future.states.shape[:3])
    return total.index_put(tuple(index.unbind(1)), loss).sum(-1)


@objective("waypoint_at")
def waypoint_at(future: Future, goal: Tensor, time: Tensor | float) -> Tensor:
    """Distance [m] to a goal at a time within the horizon.

    Args:
        future: Of one scene.
        goal: (A, 2) world x, y [m].
        time: (A,) seconds from now.
    """
    distance, given = distance_to(future, goal)
    due, timed = per_agent(time, len(future.states))
    frame = ((due / future.dt).round().long() - 1).clamp(0, distance.shape[2] - 1)[..., None]
    return distance.gather(2, frame.expand(-1, distance.shape[1], 1))[..., 0] * (given & timed)


@objective("waypoint", untimed=True)
def waypoint(future: Future, goal: Tensor, temperature: float = 1.0, widening: float = 0.0) -> Tensor:
    """Squared distance to a goal at whatever time the agent is nearest (eq 12-13), [m^2].

    With a low temperature alone, who stands with the goal behind stays: the nearest state is the present one, which
    nothing can move. With some widening all states count as long as the goal is far.

    Args:
        future: Of one scene.
        goal: (A, 2) world x, y [m].
        temperature: Of the soft minimum over time [m]; 1 is the paper's, towards 0 only the nearest state
            counts.
        widening: The temperature grows by this share of the distance of the nearest state; 0 is the paper's. To
            the gradient the temperature is a constant. With some widening and once futures are settled there is
            no other temperature: a soft minimum comes to rest with the goal halfway between two states.
    """
    recorded = torch.is_grad_enabled()
    with torch.no_grad():
        goals, given = per_agent(goal, len(future.states), 1)
        offset = future.positions - goals[:, :, None]
        square = offset.square().sum(-1)
        distance = square.sqrt()
        nearest = distance.amin(-1, keepdim=True)
        if future.settled and widening:
            softness = _SHARP + widening * nearest * nearest.clamp(max=1.0)
        else:
            softness = temperature + widening * nearest
        share = torch.softmax(-distance / softness, -1) * given[..., None]
        loss = (share * square).sum(-1)
        if not recorded:
            return loss
        pull = share * (2 + (loss[..., None] - square) / (softness * distance).clamp(min=1e-9))
    return future.sloped(loss, pull[..., None] * offset)


@objective("global_waypoint_at")
def global_waypoint_at(
    future: Future,
    goal: Tensor,
    time: Tensor | float,
    urgency: Tensor | float = 0.7,
    speed: Tensor | float = 1.25,
) -> Tensor:
    """Be near enough to a goal for a time beyond the horizon (eq 14-16) [m]; within it, `waypoint_at`.

    Args:
        future: Of one scene.
        goal: (A, 2) world x, y [m].
        time: (A,) seconds from now.
        urgency: 0 to 1, arrive earlier; for all or (A,).
        speed: Preferred speed [m/s], for all or (A,).
    """
    agents = len(future.states)
    distance, given = distance_to(future, goal)
    (due, timed), (pace, paced), (urge, urged) = (per_agent(v, agents) for v in (time, speed, urgency))
    beyond = due > distance.shape[-1] * future.dt
    far = torch.relu(distance[..., -1] - due * pace * (1 - urge))
    return torch.where(beyond, far, waypoint_at(future, goal, time)) * (given & timed & paced & urged)


@objective("global_waypoint")
def global_waypoint(
    future: Future,
    goal: Tensor,
    urgency: Tensor | float = 0.7,
    speed: Tensor | float = 1.25,
    temperature: float = 1.0,
    widening: float = 0.0,
) -> Tensor:
    """Make progress towards a goal beyond the horizon (eq 17-20) [m]; within reach, `waypoint`.

    Args:
        future: Of one scene.
        goal: (A, 2) world x, y [m].
        urgency: 0 to 1, share of the distance the horizon allows; for all or (A,).
        speed: Preferred speed [m/s], for all or (A,).
        temperature: See `waypoint`.
        widening: See `waypoint`.
    """
    agents = len(future.states)
    distance, given = distance_to(future, goal)
    goals, _ = per_agent(goal, agents, 1)
    start = (future.now[:, None, :2] - goals).norm(dim=-1)  # (A, 1)
    (pace, paced), (urge, urged) = per_agent(speed, agents), per_agent(urgency, agents)
    reach = distance.shape[-1] * future.dt * pace
    behind = torch.relu(urge * reach - (start - distance[..., -1]))
    near = waypoint(future, goal, temperature, widening)
    return torch.where(start > reach, behind, near) * (given & paced & urged)


@objective("social_group", joint=True)
def social_group(
    future: Future,
    group: Tensor,
    distance: Tensor | float = 1.5,
    cohesion: Tensor | float = 0.3,
    leader: Tensor | None = None,
) -> Tensor:
    """Members keep a distance to the nearest other member of their group (eq 21), summed over time [m^2].

    Others follow the leader of a group, who is not pulled.

    Args:
        future: Of one scene.
        group: (A,) group number of each agent; negative walks alone.
        distance: Social distance [m], for all or (A,).
        cohesion: Probability with which a member follows a random other member instead of the nearest.
        leader: (A,) true for who leads; by default the first member of each group.
    """
    group = torch.as_tensor(group)
    agents, samples, steps = future.states.shape[:3]
    same = (group[:, None] == group) & (group[:, None] >= 0)
    leads = same.to(torch.int8).argmax(1) == torch.arange(agents) if leader is None else leader
    rows = (same.sum(1) > 1).nonzero()[:, 0]  # (G,) who walks with somebody
    total = future.states.new_zeros(agents, samples)
    if not len(rows):
        return total
    count, leads = len(rows), leads[rows]
    mates = same[rows][:, rows] & ~torch.eye(count, dtype=torch.bool)
    p = future.positions[rows].transpose(0, 1)
    p = torch.where(leads[:, None, None], p.detach(), p)  # (M, G, T, 2)
    apart = ((p[:, :, None] - p[:, None]).square().sum(-1) + 1e-8).sqrt()  # (M, G, G, T)
    nearest = apart.detach().masked_fill(~mates[..., None], torch.inf).argmin(2)  # (M, G, T)
    generator = torch.Generator().manual_seed(future.seed)
    random = torch.multinomial(mates.float(), samples * steps, replacement=True, generator=generator)
    random = random.reshape(count, samples, steps).transpose(0, 1)
    chance = per_agent(cohesion, agents)[0][rows]
    strays = torch.rand(samples, count, steps, generator=generator) < chance
    mate = torch.where(strays, random, nearest)
    wanted, given = per_agent(distance, agents)
    error = (apart.gather(2, mate[:, :, None])[:, :, 0] - wanted[rows]).square()
    return total.index_add(0, rows, error.sum(-1).T * (given[rows] & ~leads[:, None]))


@objective("target_speed")
def target_speed(future: Future, speed: Tensor | float) -> Tensor:
    """Squared deviation from a walking speed (A,) [m/s], summed over time."""
    wanted, given = per_agent(speed, len(future.states))
    return (future.states[..., 3] - wanted[..., None]).square().sum(-1) * given


@objective("minimum_speed")
def minimum_speed(future: Future, speed: Tensor | float) -> Tensor:
    """Squared shortfall of the speed below (A,) [m/s], summed over time."""
    wanted, given = per_agent(speed, len(future.states))
    return torch.relu(wanted[..., None] - future.states[..., 3]).square().sum(-1) * given


@objective("maximum_speed", safety=True)
def maximum_speed(future: Future, speed: Tensor | float) -> Tensor:
    """Squared excess of the speed above (A,) [m/s], summed over time."""
    wanted, given = per_agent(speed, len(future.states))
    return torch.relu(future.states[..., 3] - wanted[..., None]).square().sum(-1) * given


@objective("follow")
def follow(future: Future, way: Tensor, slack: Tensor | float = 0.5) -> Tensor:
    """Distance beyond a slack from a timed way, mean over time [m].

    What eq 14-20 ask of a goal beyond the horizon, along a way around obstacles instead of the straight line:
    the slack is how far somebody may lag behind, or stray, by then.

    Args:
        future: Of one scene.
        way: (A, T, 2) world x, y of where each would be at the times of the future [m].
        slack: (A, T), (A,) or one for all [m].
    """
    points, given = per_agent(way, len(future.states), 2)
    room = torch.as_tensor(slack, dtype=torch.float32)
    room = room.reshape(len(points), 1, -1) if room.ndim else room
    distance = ((future.positions - points).square().sum(-1) + 1e-8).sqrt()
    return torch.relu(distance - room).mean(-1) * given


def learned_value(value: Callable[[Future], Tensor]) -> Callable[[Future], Tensor]:
    """A loss exp(-V) from a value function of plans (app. A.2.2); register the result with `objective`.

    Args:
        value: Maps a future to expected rewards (A, M), differentiably in its states; what else it needs to
            know about somebody (a body's pose, the ground) it finds by `future.ids`.
    """
    return lambda future: torch.exp(-value(future))

"""Writes a `Body` as MuJoCo bodies, hinges, contact solids and PD actuators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from ..body.body import Body
from ..body.skeleton import (
    BODY_NAMES,
    GAIN_REFERENCE_MASS,
    JOINT_GAINS,
    JOINT_LIMITS,
    JOINT_NAMES,
    LITE_JOINTS,
    N_JOINTS,
    PARENTS,
)

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

Actuation = Literal["full", "lite"]
"""``full``: all 69 hinges; ``lite``: 28 of them (`LITE_JOINTS`), twice as fast to simulate."""

FOOT_FRICTION = 1.0
_ARMATURE = 0.02  # kg m^2; PACER's humanoid, and it keeps light bodies stable at 120 Hz
_AXES = np.eye(3)

AGENT_BITS = 10
GROUND_BIT = 1 << (2 * AGENT_BITS)
OBSTACLE_BIT = 1 << (2 * AGENT_BITS + 1)
MAX_AGENTS = 1 << AGENT_BITS


@dataclass(frozen=True, slots=True)
class ContactMask:
    """MuJoCo's contype and conaffinity of one geom."""

    contype: int
    conaffinity: int


def agent_mask(agent: int) -> ContactMask:
    """Masks under which a person touches everybody else, the ground and obstacles, but not themselves.

    MuJoCo lets two geoms touch when a contype bit of one is a conaffinity bit of the other. A person's
    contype marks the ones (low bits) and the zeros (high bits) of their number, their conaffinity the
    opposite: two people then match exactly when some digit differs, so 20 bits serve 1024 people.
    """
    ones = (1 << AGENT_BITS) - 1
    zeros = ~agent & ones
    spelt = agent | zeros << AGENT_BITS
    opposite = zeros | agent << AGENT_BITS
    return ContactMask(spelt, opposite | GROUND_BIT | OBSTACLE_BIT)


def actuated_joints(actuation: Actuation) -> np.ndarray:
    """Indices of the hinges that exist, among the 69.

    Raises:
        ValueError: the actuation is neither ``full`` nor ``lite``.
    """
    if actuation == "full":
        return np.arange(N_JOINTS)
    if actuation == "lite":
        return np.flatnonzero(LITE_JOINTS)
    raise ValueError(f"The actuation is either 'full' or 'lite', not {actuation!r}.")


def add_humanoid(
    spec: mujoco.MjSpec,
    body: Body,
    prefix: str = "",
    actuation: Actuation = "full",
    mask: ContactMask | None = None,
    powered: bool = True,
) -> None:
    """Add one person in the zero pose, soles on z = 0, to a model's world body.

    Bodies come in the order of `BODY_NAMES`; hinges, after a free joint, in the order of `JOINT_NAMES`.

    Args:
        spec: the model under construction.
        body: the person.
        prefix: put before every body's and joint's name.
        actuation: which hinges exist.
        mask: contact masks; those of agent 0 when left out.
        powered: whether to add PD actuators, gains and torque caps scaled by mass / 77 kg. The D part is the
            joint's damping, which MuJoCo integrates implicitly and which the cap on the P part leaves alone:
            that keeps 120 Hz stable while an actuator saturates.
    """
    mask = mask or agent_mask(0)
    hinges = actuated_joints(actuation)
    gains = JOINT_GAINS * (body.mass / GAIN_REFERENCE_MASS)
    parents = [spec.worldbody]
    for i, name in enumerate(BODY_NAMES):
        parent = parents[PARENTS[i] + 1]
        segment = parent.add_body(
            name=prefix + name,
            pos=body.offsets[i] if i else [0.0, 0.0, body.pelvis_height],
            explicitinertial=True,
            mass=body.masses[i],
            ipos=body.segments.centres[i],
            inertia=body.segments.inertias[i],
        )
        parents.append(segment)
        if i == 0:
            segment.add_freejoint(name=prefix + "root")
        for hinge in hinges[hinges // 3 == i - 1]:
            segment.add_joint(
                name=prefix + JOINT_NAMES[hinge],
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=_AXES[hinge % 3],
                range=JOINT_LIMITS[hinge],
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                armature=_ARMATURE,
                damping=[gains[hinge, 1], 0, 0],
            )
    _add_solids(parents[1:], body, mask)
    if powered:
        for hinge in hinges:
            kp, _, cap = gains[hinge]
            actuator = spec.add_actuator(
                name=prefix + JOINT_NAMES[hinge],
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                target=prefix + JOINT_NAMES[hinge],
                forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
                forcerange=[-cap, cap],
            )
            actuator.set_to_position(kp=kp)


def _add_solids(bodies: list[mujoco.MjsBody], body: Body, mask: ContactMask) -> None:
    for solid in body.segments.solids:
        sphere = solid.start == solid.end
        bodies[solid.body].add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE if sphere else mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[solid.radius, 0, 0],
            mass=0.0,
            contype=mask.contype,
            conaffinity=mask.conaffinity,
            friction=[FOOT_FRICTION, 0.005, 0.0001],
            **({"pos": solid.start} if sphere else {"fromto": [*solid.start, *solid.end]}),
        )


def to_mjcf(body: Body, actuation: Actuation = "full", timestep: float = 1 / 120) -> str:
    """Return a stand-alone MJCF model: the person on a flat floor, with PD actuators."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 1], contype=GROUND_BIT, conaffinity=0
    )
    add_humanoid(spec, body, actuation=actuation)
    spec.compile()
    return spec.to_xml()

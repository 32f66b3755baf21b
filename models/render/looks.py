"""What a person looks like: convex pieces for each body part, clothes, skin and hair.

Pieces are hulls of points in the body's frame (m); they follow the measurements: a broad person looks broad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body.body import Body
from ..body.skeleton import BODY_INDEX

Points = NDArray[np.float64]
Colour = tuple[float, float, float]

# sRGB; the shirt is the agent's own colour.
_SKIN = ((0.94, 0.78, 0.67), (0.86, 0.66, 0.52), (0.72, 0.50, 0.37), (0.50, 0.33, 0.24), (0.36, 0.24, 0.18))
_HAIR = ((0.10, 0.08, 0.07), (0.24, 0.15, 0.09), (0.45, 0.31, 0.17), (0.62, 0.50, 0.33), (0.55, 0.54, 0.53))
_TROUSERS = (
    (0.16, 0.19, 0.27),
    (0.22, 0.22, 0.24),
    (0.35, 0.31, 0.26),
    (0.27, 0.33, 0.42),
    (0.48, 0.44, 0.38),
)
_SHOES = ((0.10, 0.10, 0.11), (0.28, 0.19, 0.13), (0.82, 0.82, 0.80))
SHIRTS: tuple[Colour, ...] = (
    (0.82, 0.27, 0.25),
    (0.20, 0.45, 0.74),
    (0.93, 0.69, 0.22),
    (0.25, 0.58, 0.42),
    (0.55, 0.36, 0.67),
    (0.91, 0.49, 0.27),
    (0.24, 0.63, 0.69),
    (0.84, 0.46, 0.61),
    (0.55, 0.65, 0.25),
    (0.35, 0.36, 0.62),
    (0.90, 0.87, 0.80),
    (0.58, 0.28, 0.30),
)
"""Shirt colours; agent i wears number i, counted around."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A convex piece of a person."""

    body: int
    points: Points
    """(K, 3) m, body frame; the piece is their convex hull."""
    colour: Colour


def dress(body: Body, agent: int, shirt: Colour | None = None) -> list[Piece]:
    """Return a person's pieces; colours other than the shirt's follow from the agent's number."""
    wardrobe = np.random.default_rng(agent)
    skin, hair, trousers, shoes = (
        palette[wardrobe.integers(len(palette))] for palette in (_SKIN, _HAIR, _TROUSERS, _SHOES)
    )
    shirt = shirt or SHIRTS[agent % len(SHIRTS)]
    tailor = _Tailor(body)
    tailor.trunk(shirt, trousers)
    tailor.head(skin, hair)
    for prefix, sign in (("L_", 1.0), ("R_", -1.0)):
        tailor.arm(prefix, sign, shirt, skin)
        tailor.leg(prefix, trousers, shoes)
    return tailor.pieces


def _ball(rings: int = 7, around: int = 12) -> Points:
    """Points of the unit sphere, poles along z."""
    polar = np.linspace(0, np.pi, rings)[1:-1, None]
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    side = np.stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar) + 0 * angle], -1
    )
    return np.concatenate([side.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])


_BALL = _ball()
_FINE_BALL = _ball(11, 18)


def _balls(*balls: tuple[ArrayLike, float]) -> Points:
    """Points on spheres given as (centre, radius)."""
    return np.concatenate([np.asarray(centre, dtype=float) + radius * _BALL for centre, radius in balls])


def _rings(*rings: tuple[float, float, float, float], around: int = 20) -> Points:
    """Points on level ellipses given as (x of the axis, height, half width along y, half depth along x)."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    return np.concatenate(
        [np.stack([x + b * np.cos(angle), a * np.sin(angle), z + 0 * angle], -1) for x, z, a, b in rings]
    )


class _Tailor:
    def __init__(self, body: Body):
        self.pieces: list[Piece] = []
        self.m = body.measurements
        self.h = body.stature
        self.offset = {name: body.offsets[i] for name, i in BODY_INDEX.items()}
        self.thick = {name: float(body.segments.thickness[i]) for name, i in BODY_INDEX.items()}
        self.reach = {s.body: abs(s.end[1]) for s in body.segments.solids}
        self.ankle = 0.026 * self.h

    def add(self, name: str, points: Points, colour: Colour) -> None:
        self.pieces.append(Piece(BODY_INDEX[name], points, colour))

    def trunk(self, shirt: Colour, trousers: Colour) -> None:
        h, thick, offset = self.h, self.thick, self.offset

        def half_width(name: str) -> float:
            return self.reach[BODY_INDEX[name]] + thick[name]

        waist, chest = (
            (0.93 * half_width("Spine"), 0.9 * thick["Spine"]),
            (half_width("Chest"), thick["Chest"]),
        )
        hips = (max(half_width("Pelvis"), self.m.hip_half_width + thick["L_Hip"]), 1.02 * thick["Pelvis"])
        hip_z, torso, spine = offset["L_Hip"][2], offset["Torso"], offset["Spine"]
        belt = (0.98 * waist[0], 1.0 * waist[1])
        self.add(
            "Pelvis",
            _rings(
                (0.0, hip_z - 0.055 * h, 0.55 * hips[0], 0.6 * hips[1]),
                (-0.006 * h, hip_z - 0.03 * h, 0.93 * hips[0], 0.97 * hips[1]),
                (-0.008 * h, hip_z, hips[0], hips[1]),
                (-0.006 * h, torso[2] - 0.01 * h, 0.98 * belt[0], belt[1]),
                (-0.004 * h, torso[2] + 0.015 * h, 0.85 * belt[0], 0.85 * belt[1]),
            ),
            trousers,
        )
        x = 0.004 * h
        self.add(
            "Torso",
            _rings(
                (x, -0.035 * h, 1.03 * belt[0], 1.05 * belt[1]),
                (x, 0.0, *belt),
                (x, spine[2], *waist),
                (x, spine[2] + 0.02 * h, 0.9 * waist[0], 0.9 * waist[1]),
            ),
            shirt,
        )
        top = offset["Chest"][2]
        middle = (0.5 * (waist[0] + chest[0]), 0.5 * (waist[1] + chest[1]))
        self.add(
            "Spine",
            _rings(
                (x, -0.02 * h, 0.95 * waist[0], 0.95 * waist[1]),
                (x, 0.0, *waist),
                (x, top, *middle),
                (x, top + 0.02 * h, 0.95 * middle[0], 0.95 * middle[1]),
            ),
            shirt,
        )
        neck, shoulder = offset["Neck"], offset["L_Thorax"] + offset["L_Shoulder"]
        self.add(
            "Chest",
            _rings(
                (x, -0.03 * h, 0.95 * middle[0], 0.95 * middle[1]),
                (x, 0.0, *middle),
                (x, 0.45 * shoulder[2], chest[0], chest[1]),
                (0.5 * x, shoulder[2], 0.86 * shoulder[1], 0.72 * chest[1]),
                (0.0, shoulder[2] + 0.018 * h, 0.62 * shoulder[1], 0.5 * chest[1]),
                (neck[0], neck[2] + 0.004 * h, 0.036 * h, 0.036 * h),
            ),
            shirt,
        )

    def head(self, skin: Colour, hair: Colour) -> None:
        h, bone = self.h, self.offset["Head"]
        self.add("Neck", _balls(([0, 0, -0.01 * h], 0.033 * h), (1.1 * bone, 0.031 * h)), skin)
        half = np.array([0.056, 0.043, 0.062]) * h
        crown = np.array([0.008 * h, 0, h - self.m.head_height - half[2]])
        skull = crown + half * _FINE_BALL
        jaw = crown + np.array([0.016, 0.0, -0.034]) * h + np.array([0.034, 0.030, 0.034]) * h * _FINE_BALL
        self.add("Head", np.concatenate([skull, jaw]), skin)
        nose = crown + np.array([0.057, 0, -0.014]) * h
        self.add("Head", _balls((nose, 0.007 * h), (nose - [0.004 * h, 0, -0.02 * h], 0.004 * h)), skin)
        covered = (_FINE_BALL[:, 2] > 0.45) | ((_FINE_BALL[:, 0] < -0.15) & (_FINE_BALL[:, 2] > -0.55))
        self.add("Head", crown + 1.05 * half * _FINE_BALL[covered], hair)

    def arm(self, prefix: str, sign: float, shirt: Colour, skin: Colour) -> None:
        h, offset = self.h, self.offset
        upper, lower = self.thick[prefix + "Shoulder"] / 0.9, self.thick[prefix + "Elbow"] / 0.9
        shoulder, elbow, wrist = (offset[prefix + name] for name in ("Shoulder", "Elbow", "Wrist"))
        self.add(
            prefix + "Thorax", _balls((0.35 * shoulder, 0.034 * h), (0.93 * shoulder, 1.1 * upper)), shirt
        )
        self.add(
            prefix + "Shoulder",
            _balls(([0, 0, 0], 1.12 * upper), (0.4 * elbow, upper), (elbow, 0.8 * upper)),
            shirt,
        )
        self.add(
            prefix + "Elbow",
            _balls(([0, 0, 0], 0.8 * upper), (0.3 * wrist, lower), (wrist, 0.62 * lower)),
            shirt,
        )

        def at(x: float, y: float) -> list[float]:
            return [x * h, sign * y, 0.0]

        palm, fingers = self.m.palm, self.m.hand - self.m.palm
        r = 0.0085 * h
        self.add(
            prefix + "Wrist",
            _balls((at(-0.008, 0), r), (at(0.008, 0), r), (at(-0.017, palm), r), (at(0.017, palm), r)),
            skin,
        )
        self.add(
            prefix + "Wrist", _balls((at(0.012, 0.3 * palm), r), (at(0.032, 0.95 * palm), 0.7 * r)), skin
        )
        tips = 0.92 * fingers
        self.add(
            prefix + "Hand",
            _balls(
                (at(-0.017, 0), r), (at(0.017, 0), r), (at(-0.011, tips), 0.7 * r), (at(0.011, tips), 0.7 * r)
            ),
            skin,
        )

    def leg(self, prefix: str, trousers: Colour, shoes: Colour) -> None:
        h, m, offset = self.h, self.m, self.offset
        thigh, shank = self.thick[prefix + "Hip"] / 0.9, self.thick[prefix + "Knee"] / 0.9
        knee, ankle, toe = (offset[prefix + name] for name in ("Knee", "Ankle", "Toe"))
        joint = 0.5 * (0.72 * thigh + 1.02 * shank)
        self.add(
            prefix + "Hip", _balls((0.1 * knee, thigh), (0.4 * knee, 0.92 * thigh), (knee, joint)), trousers
        )
        calf = 0.3 * ankle - [0.008 * h, 0, 0]
        cuff = 0.9 * ankle
        self.add(
            prefix + "Knee",
            _balls(([0, 0, 0], joint), (calf, 1.08 * shank), (cuff, 1.1 * self.ankle)),
            trousers,
        )

        sole, half = -m.ankle_height, 0.5 * m.foot_breadth
        heel, ball = 0.42 * m.ankle_height, 0.36 * m.ankle_height
        back = -0.25 * m.foot_length + heel
        toe_y = half - ball
        self.add(
            prefix + "Ankle",
            _balls(
                ([back, 0.3 * half, sole + heel], heel),
                ([back, -0.3 * half, sole + heel], heel),
                ([toe[0], toe_y, sole + ball], ball),
                ([toe[0], -toe_y, sole + ball], ball),
                ([0.02 * m.foot_length, 0, -0.1 * m.ankle_height], 0.95 * self.ankle),
            ),
            shoes,
        )
        front = 0.75 * m.foot_length - toe[0] - 0.8 * ball
        level = sole - toe[2] + ball
        self.add(
            prefix + "Toe",
            _balls(
                ([0, toe_y, level], ball),
                ([0, -toe_y, level], ball),
                ([front, 0.45 * toe_y, level - 0.2 * ball], 0.8 * ball),
                ([front, -0.45 * toe_y, level - 0.2 * ball], 0.8 * ball),
            ),
            shoes,
        )

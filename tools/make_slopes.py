"""The `slopes` scene: a lower and an upper terrace joined by ramps, stairs and rough ground."""

from itertools import pairwise

import numpy as np
import shapely
from scipy import ndimage

from ..models.scene import Flow, Groups, RandomPopulation, Scene, Terrain
from .scene_shapes import bench, covered, litter_bin, outline, pole, rect, solid, tree

TOP = 1.44  # m from the lower to the upper terrace: 9 steps of 16 cm, 12 of 12 cm, 16 of 9 cm
TREAD = 0.31  # m; the step width of PACER's training terrain (Rempe et al. 2023, appendix B)
LANDING = 1.5  # m of flat ground half way up the middle stairs
FOOT = -6.0  # x where everything starts to rise
POINT = 0.05  # m between height samples
STRIPS = {  # south to north: lowest y, highest y
    "meadow": (-11.7, -7.3),
    "steep_ramp": (-7.0, -4.3),
    "steep_stairs": (-4.0, -0.8),
    "stairs": (-0.5, 3.5),
    "shallow_stairs": (3.8, 7.0),
    "ramp": (7.3, 11.7),
}


def slopes() -> Scene:
    """Six ways up: step heights 0.05 + 0.175 d and slopes 0.7 d for d up to 0.63, rough ground of +-0.1 m."""
    origin, resolution = (-17.0, -12.0), 0.1
    cells = (240, 340)
    walls = [
        rect(left, high, right, high + 0.3)
        for _, high in list(STRIPS.values())[:-1]
        for left, right in pairwise((FOOT, -4.5, -3.0, -1.5, 0.0, 3.0, 6.0, 9.0))  # short: they climb
    ]
    obstacles = [
        solid("north wall", rect(-17, 11.7, 17, 12), 2.2),
        solid("south wall", rect(-17, -12, 17, -11.7), 2.2),
        *(solid("parapet", wall, 1.1) for wall in walls),
        bench(-13.0, -9.0, 90),
        bench(-13.0, 9.0, 90),
        bench(14.5, 4.4, 90),
        bench(14.5, -5.6, 90),
        tree(-10.0, -5.65),
        tree(-10.0, 5.4),
        tree(12.0, -7.15),
        tree(12.0, 7.15),
        litter_bin(-8.0, -0.65),
        litter_bin(10.2, 3.65),
        pole(-8.0, 7.15),
        pole(-8.0, -7.15),
        pole(10.4, -4.15),
    ]
    areas = {}
    for name, (low, high) in STRIPS.items():
        areas[f"{name}_bottom"] = outline(rect(-16.5, low + 0.3, -10.6, high - 0.3))
        areas[f"{name}_top"] = outline(rect(10.6, low + 0.3, 16.5, high - 0.3))
    flows = [Flow(f"{name}_bottom", f"{name}_top", 1.2) for name in STRIPS]
    flows += [Flow(f"{name}_top", f"{name}_bottom") for name in STRIPS]
    return Scene(
        name="slopes",
        description="Two terraces 1.44 m apart, joined by two ramps, three stairs and a rough meadow.",
        resolution=resolution,
        origin=origin,
        layers={
            "walkable": covered(rect(-17, -11.7, 17, 11.7), cells, resolution, origin),
            "stairs": covered(shapely.union_all(_flights()), cells, resolution, origin),
            "green": covered(rect(-6, -11.7, 9, -7.3), cells, resolution, origin),
        },
        obstacles=tuple(obstacles),
        terrain=Terrain(_heights(), POINT, origin),
        areas=areas,
        population=RandomPopulation(
            count=20, flows=tuple(flows), enter_over=10.0, groups=Groups(share=0.3, sizes={2: 1.0})
        ),
    )


def _flights() -> list[shapely.Polygon]:
    """Ground plans of the three stairs."""
    lengths = {"steep_stairs": 9 * TREAD, "stairs": 12 * TREAD + LANDING, "shallow_stairs": 16 * TREAD}
    return [rect(FOOT, STRIPS[name][0], FOOT + length, STRIPS[name][1]) for name, length in lengths.items()]


def _heights() -> np.ndarray:
    """Heights (481, 681) float32, m, of points 5 cm apart over 34 x 24 m."""
    x = -17.0 + POINT * np.arange(681)
    y = -12.0 + POINT * np.arange(481)
    rise = x - FOOT
    profile = {
        "meadow": np.clip(rise * TOP / 14.0, 0.0, TOP),
        "steep_ramp": np.clip(0.28 * rise, 0.0, TOP),  # d = 0.4
        "steep_stairs": _stairs(rise, 0.16),
        "stairs": _stairs(rise, 0.12, LANDING),
        "shallow_stairs": _stairs(rise, 0.09),
        "ramp": np.clip(rise * TOP / 14.0, 0.0, TOP),  # 1 : 9.7
    }
    middles = np.array([(low + high) / 2 for low, high in STRIPS.values()])
    halves = np.array([(high - low) / 2 for low, high in STRIPS.values()])
    strip = (np.abs(y[:, None] - middles) - halves).argmin(axis=1)  # (481,), changes inside parapets
    heights = np.stack(list(profile.values()))[strip]  # (481, 681)

    rng = np.random.default_rng(16)
    rough = ndimage.zoom(rng.uniform(-0.1, 0.1, (41, 58)), 12, order=1, grid_mode=True, mode="nearest")
    bumps = rough[: len(y), : len(x)]
    low, high = STRIPS["meadow"]
    edge = np.minimum(np.clip((rise - 0.5) / 1.0, 0, 1), np.clip((14.5 - rise) / 1.0, 0, 1))
    heights += bumps * edge * ((y > low - 0.15) & (y < high + 0.15))[:, None]
    return _slabs(heights, x, y, rng).astype(np.float32)


def _stairs(rise: np.ndarray, step: float, landing: float = 0.0) -> np.ndarray:
    """Profile of a flight up to `TOP`, with a landing half way."""
    count = round(TOP / step)
    edges = TREAD * np.arange(count) + landing * (np.arange(count) >= count // 2)
    return step * (rise[:, None] >= edges - 1e-9).sum(axis=1)


def _slabs(heights: np.ndarray, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lift and sink paving slabs of 1-2 m on both terraces by up to 0.025 + 0.15 d m, d = 0.1."""
    for _ in range(40):
        left = rng.uniform(-9.5, -8.0) if rng.random() < 0.5 else rng.uniform(9.5, 11.0)
        bottom = rng.uniform(-11.5, 9.5)
        length, width = rng.uniform(1.0, 2.0, 2)
        inside = np.ix_((y >= bottom) & (y < bottom + width), (x >= left) & (x < left + length))
        base = 0.0 if left < 0 else TOP
        heights[inside] = base + rng.choice([-0.04, -0.02, 0.02, 0.04])
    return heights

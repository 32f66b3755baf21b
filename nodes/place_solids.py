"""What of a map is solid: obstacles and ground, as the models take them."""

import numpy as np

from ..messages.map import SemanticMap
from ..models.scene import Obstacle, Terrain


def solids_of(place: SemanticMap) -> tuple[list[Obstacle], Terrain | None]:
    """Obstacles of a map, and its ground where it is not level."""
    ground = place.terrain
    obstacles = [Obstacle(o.name, np.array(o.polygon), o.height) for o in place.obstacles]
    return obstacles, ground and Terrain(np.array(ground.heights), ground.resolution, ground.origin)

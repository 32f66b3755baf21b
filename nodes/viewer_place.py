"""Draws a place into a viser scene: ground, obstacles, trees, and the plain around it."""

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ..messages.map import Obstacle, SemanticMap
from ..models.render.convex_hull import convex_hull
from ..models.render.street import Colour, colour_of_obstacle, crown
from .viewer_ground import ground_mesh, hides, obstacles_mesh
from .viewer_picture import Picture

if TYPE_CHECKING:
    import viser

GLASS = 0.45
"""Opacity of what is tall, and of the crowns of trees."""
PLAIN_COLOUR, PLAIN_RADIUS, PLAIN_DEPTH = (150, 149, 143), 400.0, 0.08
"""The plain around the place: its colour, reach [m] and depth below the ground [m]."""


class PlaceDrawing:
    """The place of one run in a viser scene.

    Args:
        server: Where to draw.
        root: Path of everything drawn.
    """

    def __init__(self, server: "viser.ViserServer", root: str) -> None:
        self._scene = server.scene
        self._root = root
        self._handles: dict[str, list[Any]] = {"obstacles": [], "buildings": []}
        self._painted: SemanticMap | None = None
        self._shown: tuple[list[tuple[str, float, bytes]], bool, bool] | None = None

    def draw(self, picture: Picture, obstacles: bool, buildings: bool) -> None:
        """Draw the place of a picture; obstacles and tall ones if they are to be shown."""
        place = picture.place
        if place is None:
            return
        if self._painted is None or not _same_ground(self._painted, place):
            self._painted = place
            self._scene.add_mesh_trimesh(f"{self._root}/ground", ground_mesh(place), cast_shadow=False)
            self._draw_plain(place)
        outlines = [(o.name, o.height, np.asarray(o.polygon).tobytes()) for o in place.obstacles]
        if self._shown == (shown := (outlines, obstacles, buildings)):
            return
        self._shown = shown
        for handles in self._handles.values():
            while handles:
                handles.pop().remove()
        tall = [hides(obstacle) for obstacle in place.obstacles]
        if obstacles:
            solid = [o for o, high in zip(place.obstacles, tall, strict=True) if not high]
            self._draw_obstacles("obstacles", picture, solid, None)
        if buildings:
            high = [o for o, high in zip(place.obstacles, tall, strict=True) if high]
            self._draw_obstacles("buildings", picture, high, GLASS)
            self._draw_crowns(picture, place.obstacles)

    def _draw_plain(self, place: SemanticMap) -> None:
        low = 0.0 if place.terrain is None else float(place.terrain.heights.min())
        angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        middle = _middle(place)
        rim = np.column_stack([PLAIN_RADIUS * np.cos(angle), PLAIN_RADIUS * np.sin(angle), 0 * angle])
        here = np.arange(48)
        faces = np.stack([here, (here + 1) % 48, np.full(48, 48)], axis=1)
        self._scene.add_mesh_simple(
            f"{self._root}/plain",
            np.concatenate([rim, np.zeros((1, 3))]).astype(np.float32),
            faces.astype(np.uint32),
            color=PLAIN_COLOUR,
            position=(*middle, low - PLAIN_DEPTH),
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_obstacles(
        self, kind: str, picture: Picture, obstacles: list[Obstacle], opacity: float | None
    ) -> None:
        """One mesh a colour."""
        of_colour: dict[Colour, list[Obstacle]] = defaultdict(list)
        seen: Counter[str] = Counter()
        for obstacle in obstacles:
            of_colour[colour_of_obstacle(obstacle.name, seen[obstacle.name])].append(obstacle)
            seen[obstacle.name] += 1
        for colour, alike in of_colour.items():
            corners = [np.asarray(o.polygon, dtype=np.float64).mean(axis=0) for o in alike]
            vertices, faces = obstacles_mesh(alike, [float(picture.height_at(c)) for c in corners])
            self._add(kind, vertices, faces, colour, opacity, flat_shading=True)

    def _draw_crowns(self, picture: Picture, obstacles: list[Obstacle]) -> None:
        for obstacle in obstacles:
            outline = np.asarray(obstacle.polygon, dtype=np.float64)
            if (found := crown(obstacle.name, outline, obstacle.height)) is not None:
                points, colour = found
                faces = convex_hull(points)
                points[:, 2] += float(picture.height_at(outline.mean(axis=0)))
                self._add("buildings", points, faces, colour, GLASS, flat_shading=False)

    def _add(
        self,
        kind: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        colour: Colour,
        opacity: float | None,
        flat_shading: bool,
    ) -> None:
        handles = self._handles[kind]
        red, green, blue = (round(255 * channel) for channel in colour)
        handles.append(
            self._scene.add_mesh_simple(
                f"{self._root}/{kind}/{len(handles)}",
                vertices.astype(np.float32),
                faces.astype(np.uint32),
                color=(red, green, blue),
                opacity=opacity,
                flat_shading=flat_shading,
                cast_shadow=opacity is None,
            )
        )


def _middle(place: SemanticMap) -> tuple[float, float]:
    rows, columns = place.raster.shape[1:]
    x, y = np.array(place.origin) + 0.5 * place.resolution * np.array([columns, rows])
    return float(x), float(y)


def _same_ground(one: SemanticMap, other: SemanticMap) -> bool:
    """Whether two maps differ in their obstacles at most."""
    heights = [None if place.terrain is None else place.terrain.heights for place in (one, other)]
    return (
        one.layers == other.layers
        and one.origin == other.origin
        and one.resolution == other.resolution
        and np.array_equal(one.raster, other.raster)
        and ((heights[0] is None) == (heights[1] is None))
        and (heights[0] is None or heights[1] is None or np.array_equal(heights[0], heights[1]))
    )


def look_at_place(server: "viser.ViserServer", picture: Picture) -> None:
    """Put new visitors at a corner of the place, looking down on where people are."""
    _, xy = picture.places()
    if picture.place is not None:
        rows, columns = picture.place.raster.shape[1:]
        size = picture.place.resolution * np.array([columns, rows])
        centre = np.array(_middle(picture.place))
    else:
        centre = xy.mean(axis=0) if len(xy) else np.zeros(2)
        size = np.array([20.0, 20.0])
    reach = 0.55 * float(max(size))
    target = np.array([*centre, 0.0])
    server.initial_camera.look_at = target
    server.initial_camera.position = target + reach * np.array([0.25, -0.75, 0.75])

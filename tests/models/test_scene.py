import re
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.interpolate import RegularGridInterpolator

from footfall.models.scene import (
    Flow,
    Groups,
    NewGoal,
    Obstacle,
    ObstacleDropped,
    RandomPopulation,
    RecordedPopulation,
    Scene,
    SceneError,
    Terrain,
    Track,
    load_scene,
    save_scene,
    shipped_scenes,
)
from footfall.models.scene.layers import rasterize


def box(low_x: float, low_y: float, high_x: float, high_y: float) -> np.ndarray:
    return np.array([(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)], dtype=float)


def hall(**changes: object) -> Scene:
    """20 x 10 m around the origin, a 2 m box in the middle, everything a scene can have."""
    rng = np.random.default_rng(0)
    road = np.zeros((100, 200), dtype=bool)
    road[:30] = True
    crosswalk = np.zeros((100, 200), dtype=np.uint8)
    crosswalk[:30, 90:110] = 200
    parts: dict = {
        "name": "hall",
        "description": "A hall.",
        "resolution": 0.1,
        "origin": (-10.0, -5.0),
        "layers": {"walkable": np.ones((100, 200), dtype=bool), "road": road, "crosswalk": crosswalk},
        "obstacles": (Obstacle("box", box(-1, -1, 1, 1), 2.5),),
        "terrain": Terrain(rng.uniform(-0.5, 2.0, (21, 41)).astype(np.float32), 0.5, (-10.0, -5.0)),
        "areas": {"west": box(-9, -4, -5, 4), "east": box(5, -4, 9, 4)},
        "population": RandomPopulation(
            30, (Flow("west", "east", 2.0), Flow("east", "west")), groups=Groups(0.4, {2: 1.0, 3: 1.0})
        ),
        "events": (
            NewGoal(3.0, 2, "west"),
            ObstacleDropped(4.0, Obstacle("crate", box(2, 2, 3, 3), 1.0)),
            NewGoal(5.0, 2, (1.5, 2.0)),
        ),
    }
    return Scene(**{**parts, **changes})


def straight(number: int, start: tuple[float, float], velocity: tuple[float, float], seconds: float) -> Track:
    t = np.arange(0.0, seconds + 1e-9, 0.1)
    xy = np.array(start) + t[:, None] * np.array(velocity)
    return Track(number, np.column_stack([t + number, xy]))


def test_a_saved_scene_comes_back_whole(tmp_path: Path) -> None:
    scene = hall()
    back = load_scene(save_scene(scene, tmp_path / "hall"))
    assert (back.name, back.description, back.resolution, back.origin) == ("hall", "A hall.", 0.1, (-10, -5))
    for layer, cells in scene.layers.items():
        assert back.layers[layer].dtype == cells.dtype
        np.testing.assert_array_equal(back.layers[layer], cells)
    assert scene.terrain and back.terrain
    np.testing.assert_allclose(back.terrain.heights, scene.terrain.heights, atol=0.00051)  # 1 mm steps
    assert (back.terrain.resolution, back.terrain.origin) == (0.5, (-10.0, -5.0))
    (obstacle,) = back.obstacles
    assert (obstacle.name, obstacle.height) == ("box", 2.5)
    np.testing.assert_array_equal(obstacle.polygon, box(-1, -1, 1, 1))
    assert {name: area.tolist() for name, area in back.areas.items()} == {
        name: area.tolist() for name, area in scene.areas.items()
    }
    assert isinstance(back.population, RandomPopulation)
    first, second = back.population.flows
    assert (first.spawn, first.goal, first.weight) == ("west", "east", 2.0)
    assert (second.spawn, second.goal, second.weight) == ("east", "west", 1.0)
    assert back.population.groups.sizes == {2: 1.0, 3: 1.0}
    goal_area, dropped, goal_point = back.events
    assert isinstance(goal_area, NewGoal)
    assert (goal_area.time, goal_area.agent, goal_area.goal) == (3.0, 2, "west")
    assert isinstance(dropped, ObstacleDropped)
    np.testing.assert_array_equal(dropped.obstacle.polygon, box(2, 2, 3, 3))
    assert isinstance(goal_point, NewGoal) and goal_point.goal == (1.5, 2.0)


def test_saving_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    first = save_scene(hall(), tmp_path / "a")
    second = save_scene(load_scene(first), tmp_path / "b")
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes()


def test_y_points_up_in_the_png(tmp_path: Path) -> None:
    walkable = np.ones((100, 200), dtype=bool)
    walkable[:10, :20] = False  # lower left corner
    folder = save_scene(hall(layers={"walkable": walkable}), tmp_path / "hall")
    with Image.open(folder / "walkable.png") as image:
        assert not image.getpixel((0, 99))
        assert image.getpixel((0, 0))


def test_outlines_are_counter_clockwise_after_loading(tmp_path: Path) -> None:
    scene = hall(obstacles=(Obstacle("box", box(-1, -1, 1, 1)[::-1], 2.5),))
    polygon = load_scene(save_scene(scene, tmp_path / "hall")).obstacles[0].polygon
    assert shapely.LinearRing(polygon).is_ccw


def test_a_recorded_population_comes_back(tmp_path: Path) -> None:
    tracks = (straight(3, (-8, 0), (1.25, 0), 4.0), straight(7, (8, 1), (-1, 0.25), 2.0))
    scene = hall(population=RecordedPopulation(tracks, ((3, 7),)), events=())
    population = load_scene(save_scene(scene, tmp_path / "hall")).population
    assert isinstance(population, RecordedPopulation)
    assert population.groups == ((3, 7),)
    for track, back in zip(tracks, population.tracks, strict=True):
        assert track.id == back.id
        np.testing.assert_allclose(back.samples, track.samples, atol=0.00051)


# --- what the map says ---


def test_an_aligned_box_blocks_exactly_its_cells() -> None:
    blocked = hall().blocked()
    expected = np.zeros((100, 200), dtype=bool)
    expected[40:60, 90:110] = True
    np.testing.assert_array_equal(blocked, expected)


def test_not_walkable_is_blocked_and_the_answer_is_read_only() -> None:
    walkable = np.ones((100, 200), dtype=bool)
    walkable[5, 7] = False
    blocked = hall(layers={"walkable": walkable}).blocked()
    assert blocked[5, 7] and not blocked[5, 8]
    with pytest.raises(ValueError, match="read-only"):
        blocked[0, 0] = True


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_touched_cells_are_those_that_overlap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 6))
    polygon = (
        rng.uniform(0.5, 1.5)
        * np.column_stack([np.cos(angles), np.sin(angles)])
        * rng.uniform(0.3, 1, (6, 1))
    )
    area = shapely.Polygon(polygon)
    if not area.is_valid:
        return
    cells = rasterize([polygon], (20, 20), 0.2, (-2.0, -2.0), touched=True)
    centers = rasterize([polygon], (20, 20), 0.2, (-2.0, -2.0))
    for i in range(20):
        for j in range(20):
            cell = shapely.box(-2 + 0.2 * j, -2 + 0.2 * i, -1.8 + 0.2 * j, -1.8 + 0.2 * i)
            if abs(shared := area.intersection(cell).area) > 1e-8 or not shared:
                assert cells[i, j] == (shared > 0)
            assert centers[i, j] == area.contains(cell.centroid)


def test_a_thin_wall_blocks(tmp_path: Path) -> None:
    wall = Obstacle("wall", box(-3.02, -5, -2.97, 5))
    assert hall(obstacles=(wall,)).blocked()[:, 69:71].all()


def test_obstacle_distance_is_shapelys() -> None:
    cross = np.array([(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)], dtype=float)  # not convex
    scene = hall(obstacles=(Obstacle("corner", cross), Obstacle("box", box(-3, -3, -2, -2))))
    points = np.random.default_rng(1).uniform(-5, 5, (20, 10, 2))
    solids = [shapely.Polygon(obstacle.polygon) for obstacle in scene.obstacles]
    for point, distance in zip(points.reshape(-1, 2), scene.obstacle_distance(points).ravel(), strict=True):
        here = shapely.Point(point)
        signed = min(-s.boundary.distance(here) if s.contains(here) else s.distance(here) for s in solids)
        assert distance == pytest.approx(signed, abs=1e-9)
    assert np.isinf(hall(obstacles=()).obstacle_distance(np.zeros((3, 2)))).all()


def test_height_is_bilinear_and_flat_beyond_the_edge() -> None:
    scene = hall()
    assert scene.terrain
    x, y = np.linspace(-10, 10, 41), np.linspace(-5, 5, 21)
    oracle = RegularGridInterpolator((y, x), scene.terrain.heights.astype(float))
    points = np.random.default_rng(2).uniform((-10, -5), (10, 5), (7, 11, 2))
    np.testing.assert_allclose(scene.height_at(points), oracle(points[..., ::-1]), atol=1e-6)
    assert scene.height_at(np.array([30.0, 30.0])) == scene.terrain.heights[-1, -1]
    assert (hall(terrain=None).height_at(points) == 0).all()


def test_walking_on_the_road_costs_more() -> None:
    cost = hall().walking_cost()
    assert cost[10, 10] == 4.0  # road
    assert cost[10, 100] == 1.0  # crosswalk over the road
    assert cost[80, 10] == 1.0  # pavement
    assert np.isinf(cost[50, 100])  # in the box


# --- who walks there ---


@pytest.mark.parametrize("name", ["corridor", "crossing", "plaza", "slopes"])
@pytest.mark.parametrize("seed", range(5))
def test_nobody_enters_in_another_or_in_an_obstacle(name: str, seed: int) -> None:
    scene = load_scene(name)
    assert isinstance(scene.population, RandomPopulation)
    entries = scene.sample_population(seed)
    assert len(entries) == scene.population.count
    solids = shapely.union_all([shapely.Polygon(obstacle.polygon) for obstacle in scene.obstacles])
    for index, entry in enumerate(entries):
        assert solids.distance(shapely.Point(entry.xy)) >= 0.4
        for other in entries[:index]:
            if abs(entry.time - other.time) < 3.0:
                assert np.hypot(*(entry.xy - other.xy)) >= 0.8
    goals = np.array([entry.goal for entry in entries])
    assert (scene.obstacle_distance(goals) > 0.2).all()
    assert np.array([0 <= entry.time <= scene.population.enter_over for entry in entries]).all()
    assert sorted(entry.time for entry in entries) == [entry.time for entry in entries]


def key(scene: Scene, seed: int, count: int | None = None) -> list[tuple]:
    entries = scene.sample_population(seed, count)
    return [(e.time, *e.xy, *e.goal, *e.velocity, e.preferred_speed, e.body_seed, e.group) for e in entries]


def test_the_seed_decides() -> None:
    scene = load_scene("plaza")
    assert key(scene, 4) == key(scene, 4)
    assert key(scene, 4) != key(scene, 5)


def test_bodies_follow_the_run_unless_the_scene_fixes_them() -> None:
    def bodies(seed: int, body_seed: int | None) -> list[int]:
        population = RandomPopulation(10, (Flow("west", "east"),), body_seed=body_seed)
        return [entry.body_seed for entry in hall(population=population).sample_population(seed)]

    assert bodies(1, None) != bodies(2, None)
    assert bodies(1, 9) == bodies(2, 9)
    assert len(set(bodies(1, 9))) == 10


def test_the_flows_get_their_shares() -> None:
    west = [entry.xy[0] < 0 for entry in hall().sample_population(3)]
    assert 19 <= sum(west) <= 21  # 2 : 1 of 30, groups cannot be split


def test_half_of_the_people_walk_in_groups_of_their_sizes() -> None:
    population = RandomPopulation(
        60, (Flow("west", "east"),), enter_over=60.0, groups=Groups(0.5, {2: 2.0, 4: 1.0}), speed_sd=0.2
    )
    scene = hall(population=population)
    share, sizes = [], []
    for seed in range(20):
        entries = scene.sample_population(seed)
        groups: dict[int, list] = {}
        for entry in entries:
            if entry.group is not None:
                groups.setdefault(entry.group, []).append(entry)
        share.append(sum(map(len, groups.values())) / len(entries))
        sizes += [len(members) for members in groups.values()]
        for members in groups.values():
            assert len({(m.time, m.preferred_speed) for m in members}) == 1
            assert np.ptp([m.xy for m in members], axis=0).max() <= 2 * 2 * 0.8
            assert np.ptp([m.goal for m in members], axis=0).max() <= 2 * 2 * 0.8
    assert np.mean(share) == pytest.approx(0.5, abs=0.05)
    assert sizes.count(2) / (sizes.count(2) + sizes.count(4)) == pytest.approx(2 / 3, abs=0.08)


def test_preferred_speeds_are_normal_cut_at_two_deviations() -> None:
    population = RandomPopulation(100, (Flow("west", "east"),), enter_over=300.0)
    scene = hall(population=population)
    speeds = np.array([e.preferred_speed for seed in range(10) for e in scene.sample_population(seed)])
    assert speeds.mean() == pytest.approx(1.34, abs=0.03)
    assert speeds.std() == pytest.approx(0.26 * 0.8796, abs=0.02)  # sd of a normal cut at 2 sd
    assert np.abs(speeds - 1.34).max() <= 0.52


def test_people_walk_towards_their_goal_at_their_speed() -> None:
    for entry in hall().sample_population(0):
        assert np.hypot(*entry.velocity) == pytest.approx(entry.preferred_speed)
        way = entry.goal - entry.xy
        np.testing.assert_allclose(entry.velocity / entry.preferred_speed, way / np.hypot(*way))


def test_count_and_duration_limit_the_draw() -> None:
    population = RandomPopulation(30, (Flow("west", "east"),), enter_over=20.0)
    scene = hall(population=population)
    assert len(scene.sample_population(0, count=7)) == 7
    assert scene.sample_population(0, count=0) == []
    early = scene.sample_population(0, duration=5.0)
    assert 0 < len(early) < 30
    assert max(entry.time for entry in early) <= 5.0
    assert hall(population=None, events=()).sample_population(0) == []
    with pytest.raises(SceneError, match="negative"):
        scene.sample_population(-1)


def test_a_full_area_is_an_error() -> None:
    with pytest.raises(SceneError, match=r"areas\.west: no room for pedestrian \d+ of 200"):
        hall(population=RandomPopulation(200, (Flow("west", "east"),))).sample_population(0)


def test_recorded_people_enter_as_recorded() -> None:
    tracks = (straight(7, (8, 1), (-1, 0.25), 2.0), straight(3, (-8, 0), (1.25, 0), 4.0))
    scene = hall(population=RecordedPopulation(tracks, ((3, 7),)), events=())
    first, second = scene.sample_population(0)
    assert (first.time, second.time) == (3.0, 7.0)
    np.testing.assert_allclose(first.xy, (-8, 0))
    np.testing.assert_allclose(first.velocity, (1.25, 0))
    np.testing.assert_allclose(first.goal, (-3, 0))
    assert (first.exit_time, first.preferred_speed) == (pytest.approx(7.0), pytest.approx(1.25))
    assert first.group == second.group == 0
    assert (first.moved, second.moved) == (0.0, 0.0)
    assert first.track is not None and first.track.shape == (41, 3)
    assert [entry.time for entry in scene.sample_population(0, duration=5.0)] == [3.0]
    assert [entry.time for entry in scene.sample_population(0, count=1)] == [3.0]


def test_recorded_entries_in_obstacles_move_to_the_nearest_free_ground() -> None:
    in_box, off_map = straight(0, (0.8, 0.0), (1, 0), 1.0), straight(1, (10.5, 3.0), (-1, 0), 2.0)
    tracks = (in_box, off_map, Track(2, np.array([[2.0, 4, 4]])))
    scene = hall(population=RecordedPopulation(tracks), events=())
    inside, outside, still = scene.sample_population(0)
    assert scene.obstacle_distance(inside.xy) > 0
    assert inside.moved == pytest.approx(0.25, abs=0.06)  # from x = 0.8 to the cell behind x = 1.0
    assert outside.xy[0] == pytest.approx(9.95)
    assert outside.moved == pytest.approx(0.55, abs=0.06)
    assert still.moved == 0.0 and (still.velocity == 0).all()


# --- what is refused ---

# fmt: off
BREAKS = [  # right, wrong, what is said
    ("resolution: 0.1", "resolutoin: 0.1", r"top level: unknown key '.*'; did you mean 'resolution'\?"),
    ("weight: 2.0", "wieght: 2.0", r"population\.flows\[0\]: unknown key 'wieght'; did you mean 'weight'\?"),
    ("agent: 2", "agnt: 2", r"events\[0\]: unknown key 'agnt'; did you mean 'agent'\?"),
    ("height: 1.0", "heigt: 1.0", r"events\[1\]\.obstacle: unknown key 'heigt'; did you mean 'height'\?"),
    ("type: random", "type: randm", r"population\.type: unknown value 'randm'; did you mean 'random'\?"),
    ("count: 30", "count: many", r"population\.count: expected `int`, got `str`"),
    ("count: 30", "count: -1", r"population\.count: expected `int` >= 0"),
    ("resolution: 0.1", "resolution: 0", r"resolution: expected `float` > 0"),
    ("resolution: 0.1", "resolution: .nan", "resolution: nan is not a finite number"),
    ("height: 2.5", "height: .inf", r"obstacles\[0\]\.height: inf is not a finite number"),
    ("[-9.0, -4.0]", "[-9.0, .nan]", r"areas\.west\[0\]\[1\]: nan"),
    ("west: [[-9.0, -4.0]", "west: [[-9.0, x]", r"areas\.west: expected a polygon: a list of at least three"),
    ("[1.0, -1.0], [1.0, 1.0]", "[1.0, 1.0], [1.0, -1.0]", r"obstacles\[0\] 'box': the polygon crosses"),
    ("size: [20.0, 10.0]", "size: [21.0, 10.0]", r"walkable\.png: 200 x 100 pixels; .* need 210 x 100"),
    ("resolution: 0.5", "resolution: 0.25", r"heights\.png: 41 x 21 pixels of uint16; .* need 81 x 41"),
    ("walkable: walkable.png", "walkabel: walkable.png", "'walkable' is needed"),
    ("walkable: walkable.png", "walkable: ../walkable.png", "not a file name inside the scene's folder"),
    ("walkable: walkable.png", "walkable: gone.png", r"gone\.png: no such file"),
    ("walkable: walkable.png", "walkable: scene.yaml", r"scene\.yaml: not a PNG file"),
    ("spawn: west", "spawn: wst", r"flows\[0\]\.spawn: there is no area 'wst'; did you mean 'west'\?"),
    ("goal: west", "goal: nowhere", r"there is no area 'nowhere'; areas are west, east"),
    ("agent: 2", "agent: 30", r"events\[0\]\.agent: 30, but the last pedestrian is 29"),
    ("name: hall", "name: [hall", "not a YAML file"),
    ("name: hall", "name: 2020-13-45", "not a YAML file: month must be in"),
]
# fmt: on


@pytest.mark.parametrize(("right", "wrong", "message"), BREAKS, ids=[wrong for _, wrong, _ in BREAKS])
def test_a_broken_file_is_named_with_what_is_wrong(
    tmp_path: Path, right: str, wrong: str, message: str
) -> None:
    folder = save_scene(hall(), tmp_path / "hall")
    text = (folder / "scene.yaml").read_text()
    assert right in text
    (folder / "scene.yaml").write_text(text.replace(right, wrong, 1))
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(folder)
    assert str(folder) in str(caught.value)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"areas": {"west": box(-0.5, -0.5, 0.5, 0.5)}}, "areas.west: lies wholly in an obstacle"),
        ({"areas": {"west": box(50, 0, 60, 4)}}, "areas.west: lies outside the map"),
        ({"resolution": -0.1}, "resolution: -0.1 m a cell"),
        ({"resolution": float("nan")}, "resolution: nan m a cell"),
        ({"layers": {"road": np.ones((4, 4), dtype=bool)}}, "'walkable' is needed, there is only road"),
        ({"layers": {"walkable": np.ones((100, 200))}}, "layers.walkable: float64"),
        ({"obstacles": (Obstacle("dot", np.zeros((4, 2))),)}, "obstacles[0] 'dot'"),
        ({"obstacles": (Obstacle("gap", np.array([(0, 0), (1, 0), (np.nan, 1)])),)}, "not a finite number"),
        ({"terrain": Terrain(np.zeros((3, 3), np.float32), 5.0, (0, 0))}, "span [0.0, 0.0, 10.0, 10.0]"),
        ({"terrain": Terrain(np.full((3, 3), np.nan, np.float32), 5.0, (0, 0))}, "terrain: heights"),
    ],
)  # fmt: skip
def test_a_broken_scene_cannot_be_made(changes: dict, message: str) -> None:
    with pytest.raises(SceneError, match=re.escape(message)):
        hall(**changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id;t;x;y\n1,0,0,0\n", "the header is 'id;t;x;y', not 'id,t,x,y'"),
        ("id,t,x,y\n1,0,0\n", "a row is not an id and three numbers"),
        ("id,t,x,y\n1,0,0,nan\n", "not finite"),
        ("id,t,x,y\n1,0,0,0\n1,0,1,1\n", "track 1: samples must be finite and their times must grow"),
        ("id,t,x,y\n2,0,0,0\n", "names 3, who has no track"),
    ],
)
def test_broken_tracks_are_refused(tmp_path: Path, text: str, message: str) -> None:
    tracks = (straight(3, (-8, 0), (1, 0), 1.0), straight(7, (8, 1), (-1, 0), 1.0))
    folder = save_scene(hall(population=RecordedPopulation(tracks, ((3, 7),)), events=()), tmp_path / "hall")
    (folder / "tracks.csv").write_text(text)
    with pytest.raises(SceneError, match=re.escape(message)):
        load_scene(folder)


def test_scenes_are_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert shipped_scenes() == ["corridor", "crossing", "plaza", "slopes"]
    monkeypatch.chdir(tmp_path)
    save_scene(hall(), tmp_path / "scenes" / "hall")
    assert load_scene("hall").name == load_scene(tmp_path / "scenes" / "hall" / "scene.yaml").name == "hall"
    with pytest.raises(
        SceneError, match=r"no scene 'crosing'; did you mean 'crossing'\? \(known here: .*hall\)"
    ):
        load_scene("crosing")
    with pytest.raises(SceneError, match="no scene 'nowhere'; give a folder"):
        load_scene("nowhere")


def test_the_scene_in_the_documentation_loads(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "scenes.md"
    (text,) = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "scene.yaml").write_text(text)
    for layer in ("walkable", "road"):
        Image.new("1", (100, 80), 1).save(tmp_path / f"{layer}.png")
    Image.fromarray(np.zeros((161, 201), dtype=np.uint16)).save(tmp_path / "heights.png")
    scene = load_scene(tmp_path)
    assert scene.bounds == pytest.approx((-5.0, -4.0, 5.0, 4.0))
    assert len(scene.sample_population(0)) == 6
    assert isinstance(scene.population, RandomPopulation) and scene.population.body_seed == 7
    assert [type(event) for event in scene.events] == [NewGoal, ObstacleDropped]

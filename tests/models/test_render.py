"""Pictures of the crowd: what is drawn stands where the camera's geometry says."""

import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from footfall.models.body import describe, sample_shapes
from footfall.models.render import gl
from footfall.models.render.camera import FIELD_OF_VIEW_DEG, Camera
from footfall.models.render.gl import RenderError, find_gl_backend
from footfall.models.render.looks import dress
from footfall.models.render.renderer import CrowdRenderer, GroundPicture, Stroke
from footfall.models.render.video import write_video
from footfall.models.scene import Obstacle

WIDTH, HEIGHT = 192, 144
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
PEOPLE = [describe(shape) for shape in sample_shapes(2, seed=5)]


def can_draw() -> bool:
    try:
        find_gl_backend()
    except RenderError:
        return False
    return True


needs_gl = pytest.mark.skipif(not can_draw(), reason="neither EGL nor OSMesa is installed")


def standing(body, x, y):
    poses = np.zeros((24, 7))
    poses[:, :3] = body.zero_positions
    poses[:, :2] += (x, y)
    poses[:, 3] = 1.0
    return poses


def centre_of(picture, colour):
    """Mean pixel (column, row) of those where one channel clearly leads; None: there are none."""
    channel = int(np.argmax(colour))
    values = picture.astype(int)
    others = np.delete(values, channel, axis=2).max(axis=2)
    rows, columns = np.nonzero((values[..., channel] > 2 * others) & (values[..., channel] > 60))
    return (columns.mean(), rows.mean()) if len(rows) > 5 else None


@pytest.fixture(scope="module")
def renderer():
    with CrowdRenderer(PEOPLE, width=WIDTH, height=HEIGHT, shadows=False, shirts=[RED, BLUE]) as drawn:
        yield drawn


@needs_gl
def test_seen_from_above_everybody_is_where_they_stand(renderer):
    """Pinhole geometry: a point `z` m up is nearer the camera and drawn larger."""
    span = 8.0
    poses = np.stack([standing(PEOPLE[0], 1.0, 1.2), standing(PEOPLE[1], -1.2, -0.5)])
    picture = renderer.render(poses, Camera.top((0.0, 0.0), span))
    assert picture.shape == (HEIGHT, WIDTH, 3) and picture.dtype == np.uint8
    distance = 0.5 * span / np.tan(np.radians(FIELD_OF_VIEW_DEG / 2))
    for (x, y), body, colour in [((1.0, 1.2), PEOPLE[0], RED), ((-1.2, -0.5), PEOPLE[1], BLUE)]:
        scale = HEIGHT / span * distance / (distance - 0.8 * body.stature)
        expected = WIDTH / 2 + scale * x, HEIGHT / 2 - scale * y
        assert centre_of(picture, colour) == pytest.approx(expected, abs=4)


@needs_gl
def test_only_those_named_are_drawn(renderer):
    picture = renderer.render(standing(PEOPLE[1], 0.0, 0.0)[None], Camera.top((0, 0), 6.0), agents=[1])
    assert centre_of(picture, BLUE) == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=4)
    assert centre_of(picture, RED) is None


@needs_gl
def test_the_following_camera_keeps_the_person_in_the_middle(renderer):
    poses = np.stack([standing(PEOPLE[0], 30.0, -12.0), standing(PEOPLE[1], 0.0, 0.0)])
    picture = renderer.render(poses, Camera.follow(poses[0]))
    assert centre_of(picture, RED) == pytest.approx((WIDTH / 2, 0.4 * HEIGHT), abs=0.1 * HEIGHT)
    assert Camera.follow(poses[0, 0]) == Camera.follow(np.pad(poses[0], ((0, 0), (0, 6))))


@needs_gl
def test_the_same_poses_give_the_same_pixels(renderer):
    poses, camera = standing(PEOPLE[0], 0, 0)[None], Camera.street((0, 0), 5.0)
    assert np.array_equal(renderer.render(poses, camera), renderer.render(poses, camera))


@needs_gl
def test_obstacles_hide_and_the_ground_picture_lies_where_it_belongs():
    wall = Obstacle(name="wall", polygon=np.array([[1.0, -3], [1.2, -3], [1.2, 3], [1.0, 3]]), height=3.0)
    pixels = np.zeros((10, 10, 3), dtype=np.uint8)
    pixels[:5, :, 0] = 255  # the half of small y is red
    pixels[5:, :, 2] = 255
    ground = GroundPicture(pixels, resolution=0.2, origin=(-3.0, -1.0))
    with CrowdRenderer(
        PEOPLE[:1], [wall], width=WIDTH, height=HEIGHT, shirts=[RED], ground=ground
    ) as renderer:
        hidden = renderer.render(
            standing(PEOPLE[0], -2.0, 2.0)[None], Camera((-2.0, 2.0, 1.0), 6.0, 180.0, 0.0)
        )
        assert centre_of(hidden, RED) is None
        above = renderer.render(np.zeros((0, 24, 7)), Camera.top((0, 0), 8.0))
    scale = HEIGHT / 8.0
    assert centre_of(above, RED) == pytest.approx((WIDTH / 2 - 2 * scale, HEIGHT / 2 + 0.5 * scale), abs=2)
    assert centre_of(above, BLUE) == pytest.approx((WIDTH / 2 - 2 * scale, HEIGHT / 2 - 0.5 * scale), abs=2)


@needs_gl
def test_the_following_camera_stays_before_walls():
    behind = Obstacle(
        name="wall", polygon=np.array([[-1.6, -3], [-1.4, -3], [-1.4, 3], [-1.6, 3]]), height=3.0
    )
    with CrowdRenderer(PEOPLE[:1], [behind], width=WIDTH, height=HEIGHT, shirts=[RED]) as renderer:
        picture = renderer.render(standing(PEOPLE[0], 0, 0)[None], Camera.follow([0, 0, 1, 1, 0, 0, 0]))
    assert centre_of(picture, RED) == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=0.2 * HEIGHT)


@needs_gl
def test_poses_of_a_wrong_shape_are_refused(renderer):
    with pytest.raises(ValueError, match=r"\(people, 24, 7\)"):
        renderer.render(np.zeros((24, 7)), Camera.top((0, 0), 5.0))


@pytest.mark.parametrize("body", PEOPLE)
def test_clothes_fit(body):
    """Drawn pieces reach the ground and the crown, and are no wider than a person."""
    points = np.concatenate([piece.points + body.zero_positions[piece.body] for piece in dress(body, 3)])
    assert points[:, 2].min() == pytest.approx(0.0, abs=0.004)
    assert points[:, 2].max() == pytest.approx(body.stature, abs=0.01)
    trunk = [piece for piece in dress(body, 3) if piece.body in (0, 9, 10, 11)]
    assert max(abs(piece.points[:, 1]).max() for piece in trunk) < body.radius


def test_without_opengl_the_error_says_what_to_install(monkeypatch):
    find_gl_backend.cache_clear()
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_PROBE", "raise SystemExit(3)")
    with pytest.raises(RenderError, match=r"libegl1 libegl-mesa0 libgl1-mesa-dri.*libosmesa6"):
        find_gl_backend()


@needs_gl
def test_a_wish_for_one_backend_is_respected(monkeypatch):
    find_gl_backend.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(gl, "_draws", lambda backend: True)
    assert find_gl_backend() == "osmesa"
    find_gl_backend.cache_clear()


def test_a_film_has_every_frame(tmp_path):
    frames = [np.full((48, 64, 3), 10 * i, dtype=np.uint8) for i in range(12)]
    path, seen = tmp_path / "film.mp4", []
    assert write_video(path, iter(frames), 30.0, seen.append) == 12
    assert seen == list(range(1, 13))
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 12 and seconds == pytest.approx(0.4, abs=0.05)
    decoded = subprocess.run(
        [
            imageio_ffmpeg.get_ffmpeg_exe(),
            "-v",
            "error",
            "-i",
            str(path),
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-",
        ],
        capture_output=True,
        check=True,
    ).stdout
    last = np.frombuffer(decoded, dtype=np.uint8).reshape(12, 48, 64, 3)[-1]
    assert last.mean() == pytest.approx(110, abs=8)


def test_films_that_cannot_be_are_refused(tmp_path):
    frame = np.zeros((48, 64, 3), dtype=np.uint8)
    with pytest.raises(RenderError, match="without a frame"):
        write_video(tmp_path / "a.mp4", [], 30.0)
    with pytest.raises(RenderError, match="must be even"):
        write_video(tmp_path / "a.mp4", [frame[:47]], 30.0)
    with pytest.raises(RenderError, match="no folder"):
        write_video(tmp_path / "nowhere" / "a.mp4", [frame], 30.0)
    with pytest.raises(RenderError, match="Frame 1 has shape"):
        write_video(tmp_path / "a.mp4", [frame, frame[:, :32]], 30.0)


@needs_gl
def test_strokes_and_the_crowns_of_trees():
    """A line lies where it was drawn; a tree between camera and people is seen through, one behind is not."""
    square = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
    trees = [
        Obstacle(name="tree", polygon=square - np.array([0.0, 6.0]), height=5.0),
        Obstacle(name="tree", polygon=square + np.array([0.0, 6.0]), height=5.0),
    ]
    line = Stroke(np.array([[-1.0, 0.0, 0.5], [1.0, 0.0, 0.5]]), RED, 0.1)
    with CrowdRenderer([], trees, width=WIDTH, height=HEIGHT, shadows=False) as renderer:
        camera = Camera((0.0, 0.0, 0.5), 8.0, 90.0, -10.0)
        with_line = renderer.render(np.zeros((0, 24, 7)), camera, strokes=[line])
        assert centre_of(with_line, RED) == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=2)
        assert centre_of(renderer.render(np.zeros((0, 24, 7)), camera), RED) is None
        near, far = renderer.model.geom_rgba[renderer._crowns, 3]
        assert near < 0.5 and far == 1.0
        renderer.render(np.zeros((0, 24, 7)), Camera.top((0.0, 0.0), 20.0))
        assert (renderer.model.geom_rgba[renderer._crowns, 3] < 0.5).all()


def test_a_gif_has_every_frame_and_repeats(tmp_path):
    frames = [np.full((48, 64, 3), (20 * i, 0, 255 - 20 * i), dtype=np.uint8) for i in range(8)]
    path = tmp_path / "film.gif"
    assert write_video(path, iter(frames), 10.0) == 8
    with Image.open(path) as picture:
        assert (picture.size, picture.n_frames, picture.info["loop"]) == ((64, 48), 8, 0)  # type: ignore[attr-defined]
        assert picture.info["duration"] == 100
        picture.seek(7)
        last = np.array(picture.convert("RGB"))
    assert last.reshape(-1, 3).mean(axis=0) == pytest.approx([140, 0, 115], abs=8)

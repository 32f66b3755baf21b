"""The text half of a scene: what `scene.yaml` may say, decoded strictly."""

import difflib
import math
import re
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import yaml
from msgspec import Meta, Struct, inspect

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster where PyYAML has libyaml

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(ge=0)]
Point = tuple[float, float]


class SceneError(ValueError):
    """A scene that cannot be used; the sentence says what is wrong, where, and what would be right."""


class _Strict(Struct, frozen=True, eq=False, forbid_unknown_fields=True, omit_defaults=True):
    """Base of everything in `scene.yaml`: unknown keys are errors, defaults are not written back."""


class Obstacle(_Strict, frozen=True):
    """A vertical prism that nobody walks through.

    Attributes:
        name: What it is, for people ("bus shelter").
        polygon: Ground outline (K, 2), metres, world frame, counter-clockwise (a file may say it either way
            round), no hole.
        height: Height above the mean ground level of its corners, metres.
    """

    name: str
    polygon: np.ndarray
    height: Positive = 2.0


class Flow(_Strict, frozen=True):
    """Pedestrians who enter in the area `spawn` and walk to the area `goal`; `weight` is their share."""

    spawn: str
    goal: str
    weight: Positive = 1.0


class Groups(_Strict, frozen=True):
    """How many walk together: `share` of all pedestrians, `sizes` the relative frequency of group sizes."""

    share: Annotated[float, Meta(ge=0, le=1)] = 0.0
    sizes: dict[Annotated[int, Meta(ge=2, le=8)], Positive] = msgspec.field(
        default_factory=lambda: {2: 0.75, 3: 0.25}
    )


class RandomPopulation(_Strict, frozen=True, tag_field="type", tag="random"):
    """Pedestrians drawn from a seed.

    The default preferred speed is Weidmann's free walking speed, 1.34 +- 0.26 m/s (Transporttechnik der
    Fussgaenger, 1993, table 2).

    Attributes:
        count: Number of pedestrians.
        flows: Where they come from and go to.
        speed_mean: Mean preferred speed, m/s.
        speed_sd: Standard deviation of the preferred speed, m/s; draws are cut at two of them.
        enter_over: They enter at uniformly drawn times in [0, enter_over] s; 0 = all at the start.
        groups: Who walks together.
        body_seed: None: bodies change with the run's seed. A number: pedestrian i always has the same body.
        spacing: Smallest distance between the centres of two people at entry, metres; half of it is kept
            to obstacles.
    """

    count: Count
    flows: Annotated[tuple[Flow, ...], Meta(min_length=1)]
    speed_mean: Positive = 1.34
    speed_sd: NotNegative = 0.26
    enter_over: NotNegative = 0.0
    groups: Groups = msgspec.field(default_factory=Groups)
    body_seed: Count | None = None
    spacing: Positive = 0.8


class RecordedFile(_Strict, frozen=True, tag_field="type", tag="recorded"):
    """Pedestrians as recorded: `tracks` is a CSV file `id,t,x,y` (s, m), `groups` lists who walk together."""

    tracks: str
    groups: tuple[tuple[int, ...], ...] = ()


class NewGoal(_Strict, frozen=True, tag_field="type", tag="new_goal"):
    """At `time` s pedestrian `agent` (its index in the population) turns to an area or a point (x, y) m."""

    time: NotNegative
    agent: Count
    goal: str | Point


class ObstacleDropped(_Strict, frozen=True, tag_field="type", tag="obstacle_dropped"):
    """At `time` s an obstacle appears."""

    time: NotNegative
    obstacle: Obstacle


Event = NewGoal | ObstacleDropped


class TerrainFile(_Strict, frozen=True):
    """A 16-bit PNG of heights: metres = offset + step * value, one sample every `resolution` m."""

    file: str
    resolution: Positive
    step: Positive = 0.001
    offset: float = 0.0


class SceneFile(_Strict, frozen=True):
    """The whole of `scene.yaml`; see docs/scenes.md."""

    name: str
    description: str
    resolution: Positive
    origin: Point
    size: tuple[Positive, Positive]
    layers: dict[str, str]
    terrain: TerrainFile | None = None
    obstacles: tuple[Obstacle, ...] = ()
    areas: dict[str, np.ndarray] = {}
    population: RandomPopulation | RecordedFile | None = None
    events: tuple[Event, ...] = ()


def near(word: str, known: list[str]) -> str:
    """A hint `; did you mean 'x'?` when one of the known words is close, else nothing."""
    match = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f"; did you mean '{match[0]}'?" if match else ""


def read_scene_file(path: Path) -> SceneFile:
    """Decode one `scene.yaml`.

    Raises:
        SceneError: The file is not YAML, has an unknown key, a wrong type or a number that is not finite.
    """
    try:
        raw = yaml.load(path.read_text(encoding="utf-8"), Loader=LOADER)
        _check_finite(raw, "", path)
    except SceneError:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise SceneError(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    try:
        return msgspec.convert(raw, SceneFile, dec_hook=_decode_array)
    except msgspec.ValidationError as error:
        raise SceneError(f"{path}: {_explain(str(error), raw)}") from error


def write_scene_file(scene: SceneFile, path: Path) -> None:
    """Write `scene.yaml`, a polygon a line, numbers to a tenth of a millimetre; always the same bytes."""
    plain = msgspec.to_builtins(scene, enc_hook=np.ndarray.tolist)
    text = yaml.dump(_flow(plain), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=math.inf)
    path.write_text(text, encoding="utf-8")


def _decode_array(kind: type, value: Any) -> Any:
    if kind is not np.ndarray:
        raise NotImplementedError(kind)
    if not _is_polygon(value):
        raise ValueError("Expected a polygon: a list of at least three points [x, y] in metres")
    return _counter_clockwise(np.array(value, dtype=np.float64))


def _counter_clockwise(polygon: np.ndarray) -> np.ndarray:
    """The same outline (K, 2) in counter-clockwise order, without a repeated last point."""
    points = polygon[:-1] if len(polygon) > 3 and np.allclose(polygon[0], polygon[-1]) else polygon
    x, y = points.T
    area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return points if area >= 0 else points[::-1].copy()


def _is_polygon(value: Any) -> bool:
    try:
        points: np.ndarray = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return points.ndim == 2 and points.shape[0] >= 3 and points.shape[1] == 2


def _check_finite(value: Any, where: str, path: Path) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise SceneError(f"{path}: {where}: {value} is not a finite number")
    if isinstance(value, dict):
        for key, item in value.items():
            _check_finite(item, f"{where}.{key}".lstrip("."), path)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _check_finite(item, f"{where}[{index}]", path)


def _explain(message: str, raw: Any) -> str:
    """The message with the place in front and, for an unknown key or type, the nearest known one."""
    text, _, place = message.partition(" - at ")
    where = place.strip("`").removeprefix("$").lstrip(".")
    steps = re.findall(r"[^.\[\]]+", where)
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", text):
        struct = _structs_at(inspect.type_info(SceneFile), raw, steps)[0]
        tag = [struct.tag_field] if struct.tag_field else []
        return _unknown(where, "key", unknown[1], tag + [field.encode_name for field in struct.fields])
    if unknown := re.fullmatch(r"Invalid value '(.*)'", text):
        structs = _structs_at(inspect.type_info(SceneFile), raw, steps[:-1])
        return _unknown(where, "value", unknown[1], [str(struct.tag) for struct in structs])
    if where == "areas[...]":
        where = f"areas.{next(name for name, points in raw['areas'].items() if not _is_polygon(points))}"
    return f"{where or 'top level'}: {text[0].lower()}{text[1:]}"


def _unknown(where: str, what: str, word: str, known: list[str]) -> str:
    hint = near(word, known) or f"; known: {', '.join(known)}"
    return f"{where or 'top level'}: unknown {what} '{word}'{hint}"


def _structs_at(kind: inspect.Type, raw: Any, steps: list[str]) -> list[inspect.StructType]:
    """The kinds of object that `raw` may be after following `steps`; one, if its type is told apart."""
    if isinstance(kind, inspect.UnionType):
        structs = [option for option in kind.types if isinstance(option, inspect.StructType)]
        named = [option for option in structs if option.tag in (None, raw.get("type"))]
        return _structs_at(named[0], raw, steps) if named else structs
    if isinstance(kind, inspect.VarTupleType):
        return _structs_at(kind.item_type, raw[int(steps[0])], steps[1:])
    assert isinstance(kind, inspect.StructType), kind
    if not steps:
        return [kind]
    fields = {field.encode_name: field.type for field in kind.fields}
    return _structs_at(fields[steps[0]], raw[steps[0]], steps[1:])


class _Row(list):
    """A list written in one line."""


class _Dumper(yaml.SafeDumper):
    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)


_Dumper.add_representer(_Row, lambda dump, row: dump.represent_sequence("tag:yaml.org,2002:seq", row, True))


def _flow(value: Any) -> Any:
    """Numbers and points in one line each, so that a polygon is a line; floats rounded to 0.1 mm."""
    if isinstance(value, dict):
        return {key: _flow(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = [_flow(item) for item in value]
        in_line = all(isinstance(item, float | int) or _is_point(item) for item in items)
        return _Row(items) if in_line else items
    if isinstance(value, float):
        return round(value, 4) + 0.0
    return value


def _is_point(value: Any) -> bool:
    return isinstance(value, _Row) and len(value) == 2 and all(isinstance(item, float) for item in value)

"""From what somebody types to a launch file: a path, a shipped launch, a scene."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..messages.config import ConfigError, near
from .expand import SHIPPED

BASE = "pedestrians.yaml"
"""The launch file scenes are run through."""


@dataclass(frozen=True)
class Target:
    """What is to be launched."""

    path: Path
    """The launch file."""
    args: dict[str, Any] = field(default_factory=dict)
    """Arguments that go with it."""
    name: str | None = None
    """Name of the graph, where it is not the file's."""


def shipped_launches() -> list[str]:
    """Names of the launch files of the package."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def find_launch(name: str) -> Target:
    """What somebody means by `name`.

    Args:
        name: A launch file, a scene folder, a shipped launch, a scene in ./scenes, or a shipped scene.

    Raises:
        ConfigError: none of these; names the nearest.
    """
    path = Path(name)
    if path.is_file() and path.suffix in (".yaml", ".yml") and path.name != "scene.yaml":
        return Target(path)
    if path.name == "scene.yaml" and path.is_file():
        path = path.parent
    if (path / "scene.yaml").is_file():
        return Target(SHIPPED / BASE, {"scene": str(path.resolve())}, path.resolve().name)
    if name in shipped_launches():
        return Target(SHIPPED / f"{name}.yaml")
    scenes = {
        scene.parent.name: scene.parent
        for home in (SHIPPED / "scenes", Path("scenes"))
        for scene in home.glob("*/scene.yaml")
    }
    if name in scenes:
        return Target(SHIPPED / BASE, {"scene": name}, name)
    if path.suffix in (".yaml", ".yml") or "/" in name:
        raise ConfigError(f"no launch file or scene folder {name}")
    raise ConfigError(f"no launch file or scene {name!r}; {near(name, {*shipped_launches(), *scenes})}")

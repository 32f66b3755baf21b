"""Finding the graphs that run on this machine."""

from pathlib import Path

from ..messages.config import ConfigError, near
from ..messages.graph import Graph
from ..messages.link import load_graph
from .run_dir import RunDir, all_runs


def running() -> list[Graph]:
    """The running graphs of this user, oldest first."""
    return [load_graph(str(run.graph_file)) for run in all_runs() if run.alive]


def find_graph(name: str | None = None) -> Graph:
    """The running graph of that name (or run directory); without a name the only one.

    Raises:
        ConfigError: there is none, or more than one.
    """
    if name and (Path(name) / "graph.json").is_file():
        run = RunDir(Path(name))
        if not run.alive:
            raise ConfigError(f"{name}: that run has ended")
        return load_graph(str(run.graph_file))
    graphs = running()
    folders = {Path(graph.run_dir).name: graph for graph in graphs}
    if name in folders:
        return folders[name]
    found = [graph for graph in graphs if name in (None, graph.name)]
    if len(found) == 1:
        return found[0]
    if found:
        raise ConfigError(
            f"{len(found)} graphs are running; choose one: {', '.join(g.run_dir for g in found)}"
        )
    if not graphs:
        raise ConfigError("no graph is running; `footfall launch` starts one")
    raise ConfigError(f"no graph {name!r} is running; {near(str(name), {g.name for g in graphs})}")

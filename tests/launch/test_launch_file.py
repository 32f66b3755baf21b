"""Launch files: arguments, includes, near matches, and the schema editors use."""

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from footfall.launch.expand import SHIPPED
from footfall.launch.find import find_launch, shipped_launches
from footfall.launch.launch_file import declared_args, load_launch
from footfall.launch.launch_schema import launch_schema
from footfall.messages.config import ConfigError
from footfall.messages.graph import Input, Restart

BASE = """
args: {method: slow, speed: 1.5, name: x}
seed: 3
clock: {mode: free, rate: 2}
nodes:
  planner:
    module: footfall.nodes.planner
    inputs: [agents, map]
    outputs: {plans: plans}
    config: {method: $method, speed: $speed, label: "a ${name} b $$5", deep: {list: [$method]}}
    env: {LEVEL: 3}
    restart: on-failure
"""


@pytest.fixture
def base(tmp_path: Path) -> Path:
    path = tmp_path / "base.yaml"
    path.write_text(BASE)
    return path


def write(folder: Path, text: str, name: str = "own.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_arguments_keep_their_types_and_fill_text(base: Path) -> None:
    config = load_launch(base, {"method": "fast"}).node("planner").config
    assert config == {"method": "fast", "speed": 1.5, "label": "a x b $5", "deep": {"list": ["fast"]}}


def test_file_becomes_graph(base: Path) -> None:
    graph = load_launch(base)
    planner = graph.node("planner")
    assert (graph.name, graph.seed, graph.clock.mode, graph.clock.rate) == ("base", 3, "free", 2)
    assert planner.inputs == {"agents": Input("agents"), "map": Input("map")}
    assert planner.outputs == {"plans": "plans"}
    assert planner.env == {"LEVEL": "3"}
    assert planner.restart == Restart(policy="on-failure")


@pytest.mark.parametrize(
    ("written", "wire"),
    [
        ("latest", Input("agents")),
        ("reliable", Input("agents", "reliable", 100)),
        ("{queue: 7}", Input("agents", "queue", 7)),
        ("{topic: agents2, policy: queue, depth: 4}", Input("agents2", "queue", 4)),
        ("{policy: reliable, depth: 9, timeout: 0.5}", Input("agents", "reliable", 9, 0.5)),
    ],
)
def test_inputs_can_be_written_short_and_long(tmp_path: Path, written: str, wire: Input) -> None:
    path = write(tmp_path, f"nodes: {{a: {{module: m, inputs: {{agents: {written}}}}}}}")
    assert load_launch(path).node("a").inputs == {"agents": wire}


def test_include_gives_arguments_and_own_keys_win(base: Path) -> None:
    path = write(
        base.parent,
        """
include: [{file: base.yaml, args: {method: mine}}]
seed: 9
nodes:
  planner: {config: {speed: 4.0}, threads: 2}
  extra: {module: m}
""",
    )
    graph = load_launch(path)
    planner = graph.node("planner")
    assert (graph.name, graph.seed, graph.clock.mode) == ("own", 9, "free")
    assert (planner.config["method"], planner.config["speed"], planner.threads) == ("mine", 4.0, 2)
    assert [node.name for node in graph.nodes] == ["planner", "extra"]
    assert load_launch(path, {"method": "given"}).node("planner").config["method"] == "given"
    assert declared_args(path) == {"method": "mine", "speed": 1.5, "name": "x"}


def test_null_takes_an_included_node_out(base: Path) -> None:
    path = write(base.parent, "include: [base.yaml]\nnodes: {planner: null, other: {module: m}}")
    assert [node.name for node in load_launch(path).nodes] == ["other"]


def test_command_line_sets_nested_configuration(base: Path) -> None:
    config = load_launch(base, {}, {"planner.speed": 2, "planner.a.b": [1]}).node("planner").config
    assert config["speed"] == 2
    assert config["a"] == {"b": [1]}


def test_duration_and_seed_reach_arguments_of_that_name(tmp_path: Path) -> None:
    text = "args: {duration: null}\nduration: $duration\nnodes: {a: {module: m, config: {until: $duration}}}"
    path = write(tmp_path, text)
    assert load_launch(path).duration is None
    graph = load_launch(path, duration=12.5, seed=4)
    assert (graph.duration, graph.seed, graph.node("a").config) == (12.5, 4, {"until": 12.5})


def test_key_files_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "keys").mkdir()
    write(tmp_path / "keys", "security: {secret_key_file: me.key, authorized_keys_dir: /abs}", "keys.yaml")
    security = load_launch(write(tmp_path, "include: [keys/keys.yaml]")).security
    assert security is not None
    assert security.secret_key_file == str(tmp_path / "keys" / "me.key")
    assert security.authorized_keys_dir == "/abs"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nods: {}", "own.yaml: unknown key 'nods'; did you mean 'nodes'?"),
        ("nodes: {a: {modul: m}}", "nodes.a: unknown key 'modul'; did you mean 'module'?"),
        ("nodes: {a: {}}", "nodes.a: Object missing required field `module`"),
        ("nodes: {a: {module: m, threads: two}}", "nodes.a: threads: Expected `int`, got `str`"),
        ("nodes: {a: {module: m, threads: 0}}", "nodes.a.threads: 0, must be at least 1"),
        (
            "nodes: {a: {module: m, inputs: {map: {polcy: queue}}}}",
            "nodes.a.inputs.map: unknown key 'polcy'; did you mean 'policy'?",
        ),
        (
            "nodes: {a: {module: m, inputs: {map: newest}}}",
            "nodes.a.inputs.map: policy: no such choice 'newest'",
        ),
        ("nodes: {a: {module: m, inputs: {map: {queue: 0}}}}", "depth 0"),
        ("nodes: {a: {module: m, inputs: {map: {queue: 2, depth: 3}}}}", "leave those out"),
        (
            "nodes: {a: {module: m, inputs: {map: {timeout: 0}}}}",
            "nodes.a.inputs.map.timeout: 0 s, must be above 0",
        ),
        ("nodes: {A b: {module: m}}", "a node's name is small letters"),
        ("nodes: {a: {module: $modle}}", "'modle' is not among the file's `args`; known: none"),
        ("args: {module: m}\nnodes: {a: {module: $modle}}", "did you mean 'module'?"),
        ("clock: {mode: lokstep}", "clock.mode: no such choice 'lokstep'"),
        ("duration: -1", "duration: -1 s, must be above 0"),
        ("? [a]\n: 1", "own.yaml:1: not valid YAML: a key must be a word"),
        ("seed: 2020-13-45", "own.yaml: not valid YAML: month must be in 1..12"),
        (f"seed: {'[' * 5000}{']' * 5000}", "own.yaml: not valid YAML: maximum recursion depth"),
        ("seed: 1\nseed: 2", "own.yaml:2: not valid YAML: key 'seed' is written twice"),
        ("nodes: {a: [}", "own.yaml:1: not valid YAML"),
        ("- 1", "a launch file is a mapping with `nodes`, not list"),
        ("include: [own.yaml]", "includes itself"),
        ("include: [crosing.yaml]", "did you mean 'crossing.yaml'?"),
        (
            "include: [{file: pedestrians.yaml, args: {scen: x}}]",
            "has no argument 'scen'; did you mean 'scene'?",
        ),
        ("name: a/b", "names a folder"),
    ],
)
def test_mistakes_are_named_with_place_and_remedy(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_launch(write(tmp_path, text))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_settings_are_named(base: Path) -> None:
    with pytest.raises(ConfigError, match="no argument 'metod'; did you mean 'method'"):
        load_launch(base, {"metod": 1})
    with pytest.raises(ConfigError, match=r"--set planer.x: no node 'planer'; did you mean 'planner'"):
        load_launch(base, {}, {"planer.x": 1})
    with pytest.raises(ConfigError, match=r"'speed' is 1.5, which has no keys"):
        load_launch(base, {}, {"planner.speed.x": 1})


def test_schema_for_editors_is_the_committed_one() -> None:
    committed = json.loads((SHIPPED / "launch.schema.json").read_text())
    assert committed == launch_schema(), "run: footfall launch --schema > launch/launch.schema.json"


def test_schema_accepts_shipped_files_and_refuses_mistakes() -> None:
    validator = jsonschema.Draft202012Validator(launch_schema())
    validator.check_schema(launch_schema())
    for name in shipped_launches():
        validator.validate(yaml.safe_load((SHIPPED / f"{name}.yaml").read_text()))
    validator.validate(yaml.safe_load(BASE))
    for wrong in ({"nods": {}}, {"nodes": {"a": {"module": 3}}}, {"seed": "three"}):
        assert not validator.is_valid(wrong)


def test_names_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes" / "yard").mkdir(parents=True)
    (tmp_path / "scenes" / "yard" / "scene.yaml").write_text("name: yard")
    file = write(tmp_path, "nodes: {}")
    assert find_launch("crossing").path == SHIPPED / "crossing.yaml"
    assert find_launch(str(file)).path == file
    assert find_launch("yard").args == {"scene": "yard"}
    for folder in ("scenes/yard", "scenes/yard/scene.yaml"):
        target = find_launch(folder)
        assert (target.args, target.name) == ({"scene": str(tmp_path / "scenes" / "yard")}, "yard")
    with pytest.raises(ConfigError, match=r"no launch file or scene 'crosing'; did you mean 'crossing'\?"):
        find_launch("crosing")
    with pytest.raises(ConfigError, match=r"no launch file or scene folder gone/x.yaml"):
        find_launch("gone/x.yaml")

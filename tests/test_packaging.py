"""The package as users get it: every folder in the list, a wheel that works alone, a light core."""

import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

import footfall

ROOT = Path(footfall.__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FOLDERS = ("messages", "models", "nodes", "launch", "tools")


def test_every_package_is_listed():
    found = {"footfall"}
    for folder in FOLDERS:
        for init in (ROOT / folder).rglob("__init__.py"):
            found.add(".".join(("footfall", *init.parent.relative_to(ROOT).parts)))
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == found


def test_modules_have_the_names_of_no_other():
    """`footfall.nodes.planner` and the like are found by path; a module and a package of one name collide."""
    for folder in FOLDERS:
        names = [path.stem if path.is_file() else path.name for path in (ROOT / folder).iterdir()]
        modules = [name for name in names if name.isidentifier() and not name.startswith("__")]
        packages = [path.parent.name for path in (ROOT / folder).glob("*/__init__.py")]
        assert not {name for name in packages if modules.count(name) > 1}


@pytest.mark.parametrize(
    "module", ["footfall.messages.topics", "footfall.messages.zmq_bus", "footfall.tools.cli"]
)
def test_the_core_imports_neither_torch_nor_mujoco(module):
    heavy = "('torch', 'mujoco', 'scipy', 'matplotlib', 'shapely', 'PIL')"
    code = f"import sys, {module}; sys.exit(', '.join(m for m in {heavy} if m in sys.modules) or 0)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.slow
def test_the_wheel_holds_everything_and_its_core_runs_alone(tmp_path):
    build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert "footfall/py.typed" in names
    tracked = subprocess.run(
        ["git", "ls-files", *FOLDERS], check=True, capture_output=True, text=True, cwd=ROOT
    ).stdout.split()
    wanted = {f"footfall/{path}" for path in tracked if not path.endswith(".md")}
    assert wanted <= names
    assert not [name for name in names if name.startswith("footfall/tests")]
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env/bin/python"
    install = [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", str(wheel)]
    subprocess.run(install, check=True, capture_output=True, cwd=tmp_path)
    run = [str(tmp_path / "env/bin/footfall"), "topic", "schema", "clock"]
    result = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert '"title": "Clock"' in result.stdout

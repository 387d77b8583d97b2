"""The packages lie where the imports find them, and the import contracts hold, and would break."""

import importlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("fieldloc", "estimators", "logs")

# A module that breaks the contract whose name follows.
VIOLATIONS = {
    "fieldloc/looks_up.py": ("import logs", "Imports point down"),
    "estimators/looks_up.py": ("import logs", "Imports point down"),
    "logs/calls_the_roof.py": ("import fieldloc.cli", "Nothing imports the command line"),
    "estimators/second_graph.py": ("import gtsam", "Only estimators.graph knows gtsam"),
    "logs/second_reader.py": ("from mcap.reader import make_reader", "Only logs.writer knows mcap"),
    "logs/second_bags.py": ("import rosbags.highlevel", "Only logs.ros knows rosbags"),
    "logs/second_view.py": ("import foxglove", "Only logs.foxglove and logs.viewing know foxglove"),
    "logs/second_report.py": ("import matplotlib.pyplot", "Only logs.report knows matplotlib"),
    "fieldloc/borrows_from_tests.py": ("from evo.core import metrics", "What only the tests need"),
}


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_is_imported_from_the_repository(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__file__ is not None, f"{package} is a namespace package: its __init__.py is missing"
    assert Path(module.__file__).resolve().parent == ROOT / package


def test_every_folder_with_code_is_a_package() -> None:
    folders = {file.parent for package in PACKAGES for file in (ROOT / package).rglob("*.py")}
    assert [folder for folder in folders if not (folder / "__init__.py").exists()] == []


def test_the_tests_lie_flat_and_hide_no_package() -> None:
    assert list((ROOT / "tests").rglob("__init__.py")) == []
    assert [name for name in PACKAGES if (ROOT / "tests" / name).exists()] == []
    assert [file for file in (ROOT / "tests").rglob("test_*.py") if file.parent != ROOT / "tests"] == []


def test_git_ignores_nothing_named_logs() -> None:
    patterns = [line for line in (ROOT / ".gitignore").read_text().splitlines() if line and not line.startswith("#")]
    assert [pattern for pattern in patterns if re.search(r"(^|/)logs?\b|\.mcap|\*\*?/?$", pattern)] == []


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("importlinter")
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    command = [sys.executable, "-c", code, "--no-cache"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_the_import_contracts_hold() -> None:
    result = lint_imports(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


def test_each_import_contract_can_break(tmp_path: Path) -> None:
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("samples", "__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for module, (line, _) in VIOLATIONS.items():
        (tmp_path / module).write_text(line + "\n")
    output = " ".join(lint_imports(tmp_path).stdout.split())
    for module, (_, contract) in VIOLATIONS.items():
        assert re.search(rf"{re.escape(contract)}(?:(?!KEPT).)*?BROKEN", output), (
            f"{contract!r} does not see {module}:\n{output}"
        )
        assert module.removesuffix(".py").replace("/", ".") in output

"""The import contracts of pyproject.toml, held by the tests as well."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def lint() -> subprocess.CompletedProcess[str]:
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(cache_dir=None))"
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)


def test_imports_run_down_only():
    done = lint()
    assert done.returncode == 0, done.stdout


def test_every_top_level_module_has_a_layer():
    """The contract is exhaustive, so a module without a layer breaks it: the list here is read off the folder."""
    declared = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    modules = [path for path in (ROOT / "station").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()]
    names = {path.stem for path in modules}
    assert "exhaustive = true" in declared
    for name in names - {"__init__"}:
        assert name in declared

"""The notebooks run from top to bottom, and what is stored in them came
from such a run."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient

pytestmark = pytest.mark.documentation
FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))


def test_all_are_there():
    assert [name[0] for name in NOTEBOOKS] == ["1", "2", "3", "4"]


@pytest.fixture(scope="module")
def kernel():
    """One process for all, which need not load JAX and the programs again."""
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(FOLDER))
    yield manager
    manager.shutdown_kernel(now=True)


@pytest.mark.filterwarnings("default")  # of the kernel's own machinery
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_runs(kernel, name):
    notebook = nbformat.read(FOLDER / name, as_version=4)
    nothing_known = nbformat.v4.new_code_cell(f"%reset -f\n%cd -q {FOLDER}")
    notebook.cells.insert(0, nothing_known)
    client = NotebookClient(notebook, timeout=300, km=kernel)
    client.execute()
    client.kc.stop_channels()


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_outputs_are_stored(name):
    cells = [
        cell
        for cell in nbformat.read(FOLDER / name, as_version=4).cells
        if cell.cell_type == "code"
    ]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any(output.output_type == "error" for output in outputs)
    assert not any(output.get("name") == "stderr" for output in outputs)

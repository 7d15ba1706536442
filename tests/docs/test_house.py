"""The house: no circles, and each room opens with a sentence of purpose."""

from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
LAYERS = ("drive", "envs", "training")
FILES = [path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))]
ROOMS = sorted({path.parent for path in FILES})


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph("servogym", cache_dir=None)


def room(module):
    """The room of a module: its first folder below the layer; a file of the layer is its own."""
    parts = module.split(".")[1:]
    folder = ROOT.joinpath(*parts)
    inner = len(parts) > 2 or (len(parts) == 2 and folder.is_dir())
    return ".".join(parts[:2]) if inner else module.removeprefix("servogym.")


def test_a_room_says_what_it_is_for():
    assert len(ROOMS) > 20
    for folder in ROOMS:
        first = (folder / "__init__.py").read_text(encoding="utf-8").lstrip()
        assert first.startswith('"""'), folder
        assert len(first.split('"""')[1].split()) >= 4, folder


def test_no_file_imports_itself_over_others(graph):
    """Imports for type checking count; `__init__` files, which only collect, do not."""
    inits = {m for m in graph.modules
             if graph.find_children(m) and graph.find_modules_directly_imported_by(m)}
    own = {m for m in graph.modules if m not in inits or m.endswith(("modes", "hooks"))}
    TopologicalSorter(
        {m: graph.find_modules_directly_imported_by(m) & own for m in own}
    ).prepare()  # raises CycleError, naming the circle


@pytest.mark.parametrize("layer", LAYERS)
def test_the_arrows_between_the_rooms_of_a_layer_point_down(graph, layer):
    arrows = Counter()
    for module in graph.modules:
        for other in graph.find_modules_directly_imported_by(module):
            here, there = room(module), room(other)
            inside = here.startswith(f"{layer}.") and there.startswith(f"{layer}.")
            if inside and here != there:
                arrows[here, there] += 1
    before: dict[str, set[str]] = {}
    for here, there in arrows:
        before.setdefault(here, set()).add(there)
    TopologicalSorter(before).prepare()


def test_test_files_have_names_of_their_own():
    """Pytest imports them by their names alone."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []

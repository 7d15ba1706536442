"""A Sphinx extension: lessons as pages, docstrings in Markdown, tables from the code.

Each lesson of `examples/` becomes a page of the tutorial. A lesson is a script in cells, in the
percent format of jupytext; text becomes text, the rest code. It is run once for its picture,
unless ``SERVOGYM_DOCS_PICTURES=0``.
"""

import importlib
import inspect
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

EXAMPLES = Path(__file__).parents[1] / "examples"
CELL = re.compile(r"^# %%( \[markdown\])?\n", re.MULTILINE)


def page(source: str) -> str:
    """The Markdown of a lesson."""
    parts = CELL.split(source)[1:]
    texts = []
    for kind, cell in zip(parts[::2], parts[1::2], strict=True):
        cell = cell.strip("\n")
        if kind:
            texts.append(re.sub(r"^# ?", "", cell, flags=re.MULTILINE))
        elif cell:
            texts.append(f"```python\n{cell}\n```")
    return "\n\n".join(texts) + "\n"


def write(folder: Path, pictures: bool) -> None:
    """Write the pages, each with its picture at the end, into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for lesson in sorted(EXAMPLES.glob("[0-9]*.py")):
        text = page(lesson.read_text(encoding="utf-8"))
        picture = folder / f"{lesson.stem}.png"
        if pictures and not (picture.exists() and picture.stat().st_mtime > lesson.stat().st_mtime):
            environment = {**os.environ, "NUMBA_DISABLE_JIT": "0", "MPLBACKEND": "Agg"}
            with TemporaryDirectory() as own:  # a lesson may leave more than its picture
                drawn = Path(own, picture.name)
                command = [sys.executable, str(lesson), str(drawn)]
                subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
                shutil.copyfile(drawn, picture)
        if picture.exists():
            text += f"\n![What the lesson draws]({picture.name})\n"
        text += f"\nThe script: `examples/{lesson.name}`.\n"
        target = folder / f"{lesson.stem}.md"
        if not target.exists() or target.read_text(encoding="utf-8") != text:
            target.write_text(text, encoding="utf-8")


class Docstring(SphinxDirective):
    """``{docstring} package.module.Name``: a docstring whose text is Markdown."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The docstring, headings one level down as bold lines."""
        module, _, name = self.arguments[0].rpartition(".")
        try:
            thing = importlib.import_module(self.arguments[0])
        except ImportError:
            thing = getattr(importlib.import_module(module), name)
        text = re.sub(r"^#+ (.*)$", r"**\1**\n", inspect.getdoc(thing) or "", flags=re.MULTILINE)
        node = nodes.container()
        self.state.nested_parse(StringList(text.splitlines(), self.arguments[0]), 0, node)
        return node.children


class Quirks(SphinxDirective):
    """``{quirks}``: the flags of a drive model, with what they mean."""

    def run(self) -> list[nodes.Node]:
        """A table."""
        from servogym.drive.model.drive_toml import QUIRKS

        lines = ["| quirk | meaning |", "|---|---|"]
        lines += [f"| `{name}` | {text} |" for name, text in QUIRKS.items()]
        node = nodes.container()
        self.state.nested_parse(StringList(lines, "quirks"), 0, node)
        return node.children


def setup(app):
    """Write the pages before Sphinx reads any."""
    app.add_directive("docstring", Docstring)
    app.add_directive("quirks", Quirks)
    write(Path(app.srcdir) / "tutorial", os.environ.get("SERVOGYM_DOCS_PICTURES") != "0")
    return {"parallel_read_safe": True}

"""What the pages take from elsewhere, so that it is written once: parts of the project's documents, notebooks, help, public names.

A line of a page in double braces is replaced:

    {{ README.md }}                        the document without its title
    {{ README.md / Files }}                a section without its heading; of the first one what stands before the second
    {{ README.md / Measured / How far }}   the paragraph or list item that begins so, with the table or code that follows it
    {{ help }}                             what `jaxmorph --help` and each `jaxmorph COMMAND --help-all` (else `--help`) print
    {{ api deform refit }}                 these names of jaxmorph, with signature and docstring
    {{ api io }}                           all public names of jaxmorph.io

What is not there stops the build.
"""

import contextlib
import importlib
import io
import os
import pathlib
import posixpath
import re
import types

import nbformat
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File
from nbconvert import MarkdownExporter

ROOT = pathlib.Path(__file__).parents[1]
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "extend.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "measured.md",
}
"""Where a document of the project is found among the pages."""

SUBMODULES = ("shapes", "io", "plot", "cases")


def on_config(config):
    """Notebooks in the navigation, pages that change with the files they take from."""
    notebooks = [f"notebooks/{file.stem}.md" for file in sorted((ROOT / "notebooks").glob("*.ipynb"))]
    for entry in config.nav:
        if isinstance(entry, dict) and "Notebooks" in entry:
            entry["Notebooks"] = notebooks
    config.watch += [str(ROOT / name) for name in (*PAGES, "jaxmorph", "notebooks")]
    return config


def on_files(files, config):
    """Pictures of README and the notebooks, as they ran."""
    for picture in sorted((ROOT / "docs").glob("*.png")):
        files.append(File.generated(config, picture.name, abs_src_path=str(picture)))
    for file in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for name, content in notebook(file).items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown, page, config, files):
    """Lines in double braces replaced."""
    return re.sub(r"^\{\{ (.*) \}\}$", lambda line: expanded(line[1], page.file.src_uri), markdown, flags=re.MULTILINE)


def expanded(wanted: str, page: str) -> str:
    if wanted == "help":
        return helps()
    if wanted.startswith("api "):
        return api(wanted.split()[1:])
    document, *place = wanted.split(" / ")
    return linked(part((ROOT / document).read_text(), place, wanted), document, page)


def part(text: str, place: list[str], wanted: str) -> str:
    """Of a document: all of it but the title, a section, or what begins in it with some words."""
    if not place:
        return text.split("\n", 1)[1]
    rows, heads = text.splitlines(), headings(text)
    begins = [i for i in heads if rows[i].lstrip("# ") == place[0]]
    if len(begins) != 1:
        raise PluginError(f"{{{{ {wanted} }}}}: {len(begins)} sections have this heading.")
    depth = len(rows[begins[0]].split()[0])
    after = [i for i in heads if i > begins[0] and (depth == 1 or len(rows[i].split()[0]) <= depth)]
    section = "\n".join(rows[begins[0] + 1 : after[0] if after else None]).strip()
    if len(place) == 1:
        return section
    blocks = paragraphs(section)
    found = [i for i, block in enumerate(blocks) if block.removeprefix("- ").startswith(place[1])]
    if len(found) != 1:
        raise PluginError(f"{{{{ {wanted} }}}}: {len(found)} paragraphs or items begin so.")
    first, *following = blocks[found[0] :]
    kept = [first.removeprefix("- ").replace("\n  ", "\n")]
    return "\n\n".join(kept + [block for block in following[:1] if block.startswith(("|", "```"))])


def paragraphs(section: str) -> list[str]:
    """Paragraphs, list items, tables, and fenced blocks whole."""
    found, fenced = [[]], False
    for line in section.splitlines():
        if not fenced and (not line or line.startswith("- ")):
            found.append([])
        fenced ^= line.startswith("```")
        found[-1].append(line)
    return [said for block in found if (said := "\n".join(block).strip())]


def headings(text: str) -> list[int]:
    """Numbers of the lines that are headings, and not in a fenced block."""
    found, fenced = [], False
    for i, line in enumerate(text.splitlines()):
        fenced ^= line.startswith("```")
        if not fenced and line.startswith("#"):
            found.append(i)
    return found


def linked(text: str, document: str, page: str) -> str:
    """The text of a document with its links to files of the project turned to the pages made of them, or to their names."""

    def target(link):
        said, to = link.groups()
        if re.match(r"\w+:|#", to):
            return link[0]
        file = posixpath.normpath(posixpath.join(posixpath.dirname(document), to))
        if not (ROOT / file).exists():
            raise PluginError(f"{document} links to {to}, which is not there.")
        found = PAGES.get(file, re.sub(r"^docs/(pages/)?", "", file).replace(".ipynb", ".md"))
        if found == file and file.split("/")[0] != "notebooks":
            return f"{said} (`{file}`)"
        return f"[{said}]({posixpath.relpath(found, posixpath.dirname(page) or '.')})"

    return re.sub(r"\[([^\]]*)\]\(([^)\s]+)\)", target, text)


def notebook(file: pathlib.Path) -> dict[str, str | bytes]:
    """A page, and its pictures by name."""
    resources = {"unique_key": file.stem, "output_files_dir": f"{file.stem}_files"}
    exporter = MarkdownExporter(preprocessors=["nbconvert.preprocessors.CoalesceStreamsPreprocessor"])
    cells = nbformat.read(file, as_version=4)
    for cell in cells.cells:
        if cell.cell_type == "markdown":
            cell.source = linked(cell.source, f"notebooks/{file.name}", f"notebooks/{file.stem}.md")
    body, found = exporter.from_notebook_node(cells, resources=resources)
    title, text = body.strip().split("\n", 1)
    body = f"{title}\n\n*`notebooks/{file.name}`, as it ran.*\n{text}"
    body = re.sub(r"!\[(?:png|jpeg|gif)\]", "![What the cell above draws]", body)
    return {f"{file.stem}.md": body} | found["outputs"]


def helps() -> str:
    top = helped()
    commands = re.findall(r"^    (\w+)(?: |$)", top, flags=re.MULTILINE)
    pages = [("jaxmorph", top), *((f"jaxmorph {name}", helped(name)) for name in commands)]
    return "\n\n".join(f"### `{name}`\n\n```text\n{said}\n```" for name, said in pages)


def helped(*command: str) -> str:
    """All that is told of a command, at a width that fits a page: by `--help-all` where `--help` leaves something out."""
    from jaxmorph.cli import main

    os.environ |= {"COLUMNS": "84", "NO_COLOR": "1"}
    said = ""
    for flag in ("--help", "--help-all"):
        if flag == "--help" or flag in said:
            page = io.StringIO()
            with contextlib.redirect_stdout(page), contextlib.suppress(SystemExit):
                main([*command, flag])
            said = page.getvalue().strip()
    return said


def api(names: list[str]) -> str:
    """Directives for mkdocstrings: names of jaxmorph, or all those of one of its submodules."""
    if names[0] not in SUBMODULES:
        return "\n\n".join(directive("jaxmorph", "jm", name) for name in names)
    module = importlib.import_module(f"jaxmorph.{names[0]}")
    public = {name: value for name, value in vars(module).items() if not name.startswith("_")}
    callables = [name for name, value in public.items() if callable(value) and value.__module__.startswith("jaxmorph")]
    others = [
        name for name, value in public.items() if name not in callables and not isinstance(value, types.ModuleType)
    ]
    parts = [directive(module.__name__, names[0], name) for name in sorted(callables)]
    if others:
        rows = [f"| `{names[0]}.{name}` | `{public[name]!r}` |" for name in sorted(others)]
        parts.append("\n".join(["## Constants", "", "| name | value |", "|---|---|", *rows]))
    return "\n\n".join(parts)


def directive(module: str, shown: str, name: str) -> str:
    return f"::: {module}.{name}\n    options:\n      heading: {shown}.{name}\n      toc_label: {name}"

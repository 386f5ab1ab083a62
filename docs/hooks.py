"""Adds to the pages what the project keeps elsewhere: its documents, its notebooks, its examples, equations.

- README.md, CONTRIBUTING.md, CHANGELOG.md and benchmarks/README.md are pages as they stand.
- Each notebook is a page with its pictures, as it ran. Cells tagged `hide-input` are folded. The first page has
  a small picture of each.
- The programs of docs/examples are a page, too.
- A link of a page to a file of the project leads to the page made from that file. The same link works on a code host.
- A fenced block `math` becomes MathML, which browsers draw without a script.

A link to a file that is not there stops the build.
"""

import ast
import base64
import io
import pathlib
import posixpath
import re

import nbformat
import numpy as np
from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File
from nbconvert import MarkdownExporter
from PIL import Image

ROOT = pathlib.Path(__file__).parents[1]
DOCUMENTS = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
}
"""The page made from each document of the project."""


def on_config(config):
    """Lists the notebooks after the first in the navigation, watches the sources, and sets how equations are written."""
    notebooks = [
        f"notebooks/{file.stem}.md" for file in sorted((ROOT / "notebooks").glob("*.ipynb"))[1:]
    ]
    entries = [entry for group in config.nav for entries in group.values() for entry in entries]
    (entry,) = [entry for entry in entries if isinstance(entry, dict) and "Notebooks" in entry]
    entry["Notebooks"] = notebooks
    config.watch += [
        str(ROOT / name) for name in (*DOCUMENTS, "docs/examples", "jaxmorph", "notebooks")
    ]
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {}).setdefault(
        "custom_fences", []
    )
    fences.append({"name": "math", "class": "math", "format": mathml})
    return config


def on_files(files, config):
    """Adds the generated pages, the pictures, and the table behind the championship."""
    notebooks = sorted((ROOT / "notebooks").glob("*.ipynb"))
    for file in sorted(
        file
        for file in (ROOT / "docs").iterdir()
        if file.suffix in (".png", ".gif", ".webp", ".csv")
    ):
        files.append(File.generated(config, file.name, abs_src_path=str(file)))
    for document, page in DOCUMENTS.items():
        text = linked((ROOT / document).read_text(), document, page)
        files.append(
            File.generated(
                config, page, content=with_gallery(text, notebooks) if page == "index.md" else text
            )
        )
    files.append(File.generated(config, "examples.md", content=examples()))
    for file in notebooks:
        files.append(File.generated(config, f"gallery/{file.stem}.jpg", content=thumbnail(file)))
        for name, content in notebook(file).items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turns links to files of the project into links to pages."""
    if page.file.generated_by:
        return markdown
    return linked(markdown, f"docs/pages/{page.file.src_uri}", page.file.src_uri)


def linked(text: str, document: str, page: str) -> str:
    """Returns a document's text with its links to files of the project leading to pages; files without a page are named."""

    def target(link):
        words, address = link.groups()
        path, _, anchor = address.partition("#")
        if re.match(r"\w+:", address) or not path:
            return link[0]
        file = posixpath.normpath(posixpath.join(posixpath.dirname(document), path))
        if not (ROOT / file).exists():
            raise PluginError(f"{document} links to {address}, which is not there.")
        goal = DOCUMENTS.get(file, re.sub(r"^docs/(pages/)?", "", file).replace(".ipynb", ".md"))
        if file.startswith("docs/examples/"):
            goal, anchor = "examples.md", posixpath.basename(file).replace(".", "")
        if goal == file and file.split("/")[0] != "notebooks":
            named = words.strip("`") in (file, posixpath.basename(file))
            return f"`{file}`" if named else f"{words} (`{file}`)"
        goal = posixpath.relpath(goal, posixpath.dirname(page) or ".")
        return f"[{words}]({goal}{'#' + anchor if anchor else ''})"

    return re.sub(r"\[([^\]]*)\]\(([^)\s]+)\)", target, text)


def notebook(file: pathlib.Path) -> dict[str, str | bytes]:
    """Returns a notebook's page, and its pictures by name."""
    resources = {"unique_key": file.stem, "output_files_dir": f"{file.stem}_files"}
    exporter = MarkdownExporter(
        preprocessors=["nbconvert.preprocessors.CoalesceStreamsPreprocessor"]
    )
    cells = nbformat.read(file, as_version=4)
    films: dict[str, str | bytes] = {}
    folded = [cell.source for cell in cells.cells if "hide-input" in cell.metadata.get("tags", [])]
    for cell in cells.cells:
        if cell.cell_type == "markdown":
            cell.source = linked(cell.source, f"notebooks/{file.name}", f"notebooks/{file.stem}.md")
        for output in cell.get("outputs", []):
            if film := output.get("data", {}).get(
                "image/gif"
            ):  # nbconvert would print the name of its class
                name = f"{file.stem}_files/film{len(films)}.gif"
                films[name] = base64.b64decode(film)
                output["data"] = {"text/markdown": f"![Output of the cell above]({name})"}
    body, outputs = exporter.from_notebook_node(cells, resources=resources)
    title, text = body.strip().split("\n", 1)
    body = f"{title}\n\n*`notebooks/{file.name}`, as it ran.*\n{text}"
    body = re.sub(r"!\[(?:png|jpeg|gif)\]", "![Output of the cell above]", body)
    for source in folded:
        code = f"```python\n{source}\n```"
        lines = source.count("\n") + 1
        summary = (
            f"<details markdown>\n<summary>Code, {lines} lines</summary>\n\n{code}\n\n</details>"
        )
        body = body.replace(code, summary)
    return {f"{file.stem}.md": body} | outputs["outputs"] | films


def with_gallery(text: str, files: list[pathlib.Path]) -> str:
    """Puts the notebooks' pictures into the first page, before its first section."""
    start, mark, rest = text.partition("\n## ")
    return start + gallery(files) + mark + rest


def gallery(files: list[pathlib.Path]) -> str:
    """Returns a section with a small picture of each notebook above its title, all leading to its page."""
    cards = []
    for file in files:
        title = nbformat.read(file, as_version=4).cells[0].source.split("\n", 1)[0].lstrip("# ")
        picture = f'<img src="gallery/{file.stem}.jpg" alt="A picture of the notebook: {title}" loading="lazy">'
        cards.append(f"<div markdown>\n[{picture}<br>{title}](notebooks/{file.stem}.md)\n</div>")
    return (
        "\n\n## Notebooks\n\n"
        + "\n".join(['<div class="gallery" markdown>', *cards, "</div>"])
        + "\n"
    )


def thumbnail(file: pathlib.Path) -> bytes:
    """Returns the main part of the picture with most ink in a notebook, of at most 40 kB, as JPEG."""
    outputs = (
        each for cell in nbformat.read(file, as_version=4).cells for each in cell.get("outputs", [])
    )
    pictures = [
        text
        for each in outputs
        for kind, text in each.get("data", {}).items()
        if kind.startswith("image/")
    ]
    if not pictures:
        raise PluginError(f"{file.name} has no picture: run it, and save it with its outputs.")
    parts = [
        main_part(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB"))
        for text in pictures
    ]
    small = max(parts, key=lambda part: (np.asarray(part).min(axis=2) < 225).sum())
    small.thumbnail((480, 300), Image.Resampling.LANCZOS)
    for quality in (85, 70, 50, 30):
        content = io.BytesIO()
        small.save(content, "JPEG", quality=quality, optimize=True)
        if content.tell() < 40_000:
            break
    return content.getvalue()


def main_part(picture: Image.Image) -> Image.Image:
    """Cuts out the largest part of a picture between white columns and rows: of several axes one, without labels."""
    for axis in (0, 1, 0, 1):
        ink = np.concatenate(
            [[False], (np.asarray(picture).min(axis=2) < 225).any(axis=axis), [False]]
        )
        begins, ends = (
            np.flatnonzero(np.diff(ink.astype(int)) == 1),
            np.flatnonzero(np.diff(ink.astype(int)) == -1),
        )
        widest = np.argmax(ends - begins)
        box = [0, 0, *picture.size]
        box[axis], box[axis + 2] = int(begins[widest]), int(ends[widest])
        picture = picture.crop((box[0], box[1], box[2], box[3]))
    return picture


def examples() -> str:
    """Returns the page of the programs in docs/examples: of each its first words, and its code folded."""
    parts = ["# Examples\n\nShort programs, which the tests run: `docs/examples` of a checkout."]
    for file in sorted((ROOT / "docs" / "examples").glob("*.py")):
        source = file.read_text()
        words = ast.get_docstring(ast.parse(source)) or ""
        title = words.split("\n", 1)[0]
        summary = f"<details markdown>\n<summary>Code, {source.count(chr(10))} lines</summary>"
        parts.append(
            f"## `{file.name}`\n\n{title}\n\n{summary}\n\n```python\n{source}```\n\n</details>"
        )
    return "\n\n".join(parts) + "\n"


def mathml(source, language, css_class, options, md, **_) -> str:
    """Returns an equation in LaTeX as MathML, with its number at the right."""
    number = re.search(r"\\tag\{(\w+)\}", source)
    equation = convert(source.replace(number[0], "") if number else source, display="block")
    # of a least value the index stands below
    equation = re.sub(
        r"<msub>(<mo>min</mo>)(<mi>\w</mi>|<mrow>.*?</mrow>)</msub>",
        r"<munder>\1\2</munder>",
        equation,
    )
    return f'<div class="{css_class}">{equation}<span>{f"({number[1]})" if number else ""}</span></div>'

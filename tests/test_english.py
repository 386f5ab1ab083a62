"""How the code speaks: docstrings open with a verb, sentences are short, variables are nouns."""

import ast
import pathlib
import re
from collections.abc import Iterator

import pytest

ROOT = pathlib.Path(__file__).parents[1]
FILES = sorted((ROOT / "jaxmorph").rglob("*.py"))
LONGEST = 30  # words in a sentence

NOT_VERBS = """
axes bases boundaries boxes bumps cells centres coefficients columns components coordinates corners curves derivatives
displacements distances edges elements errors faces fields files forms functions halves heights ids indices inverses is
its keys keywords layers lengths lines loops masses meshes motions nodes normals options parts patches pictures
planes points polynomials positions radius ranges ratios reports rows sections seconds shapes sides sizes sources
stations steps surfaces tables terms thickness this titles unless values vectors vertices wells weights widths words
"""
"""Words that end like a verb and are none in the first place of a docstring, such as plurals."""

NOT_FOR_THINGS = {"what", "whether", "those", "of", "how", "which", "where", "when", "that", "it", "whatever"}
"""Words that open no docstring of a class, a property or an attribute: these may also open with the noun of the thing."""

NOT_NAMES = {"of", "found", "mine", "own", "said", "pts", "idx", "cfg"}

FOREIGN = {("jaxmorph/integrations/idwarp.py", "pts")}
"""Names of another library's arguments, in the file that is called as that library is."""


NODES = [(str(file.relative_to(ROOT)), list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))) for file in FILES]


def docstrings(nodes: list[ast.AST]) -> Iterator[tuple[ast.AST | None, int, str]]:
    """Yields what a string documents (None for an attribute), the line it starts in, and the string."""
    for node in nodes:
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.If | ast.With | ast.For | ast.Try):
            continue
        for place, statement in enumerate(node.body):
            value = statement.value if isinstance(statement, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield node if place == 0 else None, statement.lineno, value.value


def is_property(node: ast.FunctionDef) -> bool:
    return any("property" in ast.unparse(each) for each in node.decorator_list)


def sentences(text: str) -> Iterator[str]:
    """Yields the sentences of a docstring: no code, no formulas, no tables; each entry of a list is a paragraph."""
    text = re.sub(r"```.*?```|\$\$.*?\$\$|\\\[.*?\\\]", "\n\n", text, flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "Code", text)
    lines = []
    for line in text.split("\n"):
        plain = line.strip()
        if plain.startswith((">>>", "...", "|")):
            plain = ""
        lines.append(f"\n\n{plain}" if re.match(r"[-*+] |\d+\. ", plain) else plain)
    for paragraph in re.split(r"\n\s*\n", "\n".join(lines)):
        yield from re.split(r"(?<=[.!?])[)\"']*\s+(?=[A-Z`(\"*])", " ".join(paragraph.split()))


def words(sentence: str) -> int:
    return sum(bool(re.search(r"[A-Za-z]", word)) for word in sentence.split())


def wrong_openings() -> list[str]:
    rows = []
    for file, nodes in NODES:
        for node, line, text in docstrings(nodes):
            first = re.sub(r"[^a-z`_].*", "", text.strip().lower(), flags=re.DOTALL)
            if isinstance(node, ast.FunctionDef) and not is_property(node):
                is_noun = first in NOT_VERBS.split() or text.strip().lower().startswith(f"{first} of")
                wrong = not first.endswith("s") or is_noun
            else:
                wrong = first in NOT_FOR_THINGS
            if wrong:
                rows.append(f"{file}:{line}: {text.strip().splitlines()[0]}")
    return rows


def long_sentences() -> list[str]:
    return [
        f"{file}:{line}: {words(sentence)} words: {sentence}"
        for file, nodes in NODES
        for _, line, text in docstrings(nodes)
        for sentence in sentences(text)
        if words(sentence) > LONGEST
    ]


def wrong_dimensions() -> list[str]:
    """Lists strings and comments that say "in the plane" for 2-D or "in space" for 3-D."""
    pattern = re.compile(r"\bin[\s#]+(the[\s#]+plane|space)\b(?!\s+of)", re.IGNORECASE)
    rows = []
    for file in FILES:
        text = file.read_text(encoding="utf-8")
        for match in pattern.finditer(text):
            rows.append(f"{file.relative_to(ROOT)}:{1 + text.count(chr(10), 0, match.start())}: {match.group()}")
    return rows


def wrong_names() -> list[str]:
    rows = []
    for file, nodes in NODES:
        for node in nodes:
            name = ""
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                name = node.id
            elif isinstance(node, ast.arg | ast.keyword):
                name = node.arg or ""
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                name = node.name
            elif isinstance(node, ast.alias):
                name = node.asname or ""
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                name = node.attr
            if name.lstrip("_") in NOT_NAMES and (file, name) not in FOREIGN:
                rows.append(f"{file}:{getattr(node, 'lineno', 0)}: {name}")
    return rows


@pytest.mark.parametrize("check", [wrong_openings, long_sentences, wrong_dimensions, wrong_names])
def test_no_line_breaks_the_rule(check):
    rows = check()
    assert not rows, "\n" + "\n".join(rows)


if __name__ == "__main__":
    for check in (wrong_openings, long_sentences, wrong_dimensions, wrong_names):
        rows = check()
        print(*rows, f"{check.__name__}: {len(rows)}", sep="\n")

"""Numbers in text, many at once: as Python reads and writes each of them."""

import itertools
import random

import numpy as np
import pytest
from runs import over

from jaxmorph.io import _text
from jaxmorph.io._text import splice
from jaxmorph.io.openfoam.file import load_file


def as_python_reads(words):
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            return values, False
    return values, True


def test_words_are_read_as_python_reads_them():
    """Numbers of all lengths and signs, and words that only begin like one, of which none may pass."""
    rng = random.Random(1)
    good = bad = 0
    for _ in range(1500):
        words = []
        for _ in range(rng.randint(1, 4)):
            letters = "0123456789..--+eE" if rng.random() < 0.5 else "0123456789"
            made = "".join(rng.choice(letters) for _ in range(rng.randint(1, 9)))
            words.append(
                made if rng.random() < 0.5 else repr(rng.gauss(0, 1) * 10 ** rng.randint(-9, 9))
            )
        values, fine = as_python_reads(words)
        text = " ".join(words).encode() + b"\n"
        found = _text.parse(text, np.float64).tolist()
        if fine:
            good += 1
            assert found == values
        else:
            bad += 1
            assert len(found) < len(words)
    assert min(good, bad) > 400


@over(
    "word",
    [
        "1.5.2",
        "1-2",
        "1.5-300",
        "1e5.3",
        "1e5e3",
        "5e",
        "5e+",
        "--1",
        "1..2",
        "1d5d3",
        "1x",
        "0x10",
        "1,2",
    ],
)
def test_what_begins_like_a_number_is_none(word):
    text = f"1 2\n3 {word}\n5 6\n".encode()
    assert len(_text.parse(text, np.float64)) < 6


def test_rows_of_every_form_are_read():
    texts = [b"1 2\n3\n", b"1  2\n3 4\n", b"1 2\n\n3 4\n", b" 1 2\n 3 4\n", b"1 2\r\n3 4\r\n"]
    for text in (*texts, b"1 2\n3 4", b"1 2 \n3 4 \n", b"12 -3 4\n5 6 789\n"):
        assert _text.parse(text, np.float64).tolist() == [float(word) for word in text.split()]
        assert _text.parse(text, np.int64).tolist() == [int(word) for word in text.split()]
    assert len(_text.parse(b"12 3.5 4\n5 6 789\n", np.int64)) < 6


def hard_values():
    rng = np.random.default_rng(0)
    edges = [0.0, -0.0, 1.0, 0.1, 1 / 3, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308]
    edges += [9007199254740993.0, 1e22, 1e23]
    return np.concatenate(
        [
            edges,
            rng.normal(size=3000),
            rng.normal(size=3000) * 10.0 ** rng.integers(-300, 300, 3000),
        ]
    )


@pytest.mark.parametrize("enough", [1, 1 << 30])
def test_written_numbers_read_back_bit_for_bit(monkeypatch, enough):
    """With as few digits as Python's own."""
    monkeypatch.setattr(_text, "LONG_TEXT", enough)
    values = hard_values()
    lines = _text.number_lines(values).split(b"\n")
    assert np.array([float(line) for line in lines]).tobytes() == values.tobytes()
    mantissa = lambda text: len(text.lower().split("e")[0].strip("-").replace(".", "").strip("0"))  # noqa: E731
    assert [mantissa(line.decode()) for line in lines] == [
        mantissa(repr(value)) for value in values.tolist()
    ]
    assert _text.parse(b" ".join(lines), np.float64).tobytes() == values.tobytes()


def test_pieces_are_replaced_where_they_stand():
    rng = random.Random(2)
    for longest in (3, 200):  # in a table, and one by one
        words = ["".join(rng.choice("abc") for _ in range(rng.randint(1, 9))) for _ in range(50)]
        blanks = [" " * rng.randint(0 if i in (0, 50) else 1, longest) for i in range(51)]
        new = ["".join(rng.choice("xyz") for _ in range(rng.randint(0, 12))) for _ in range(50)]
        text = "".join(a + b for a, b in zip(blanks, [*words, ""], strict=True)).encode()
        starts, ends, _ = _text.scan(text)
        found = splice(text, starts, ends, "\n".join(new).encode())
        assert found.decode() == "".join(a + b for a, b in zip(blanks, [*new, ""], strict=True))


FACES = (
    "4(0 1 2 3)\n4(4 5 6 7)\n",
    "4(0 1 2 3)\n3(4 5 6)\n",
    "3(0 1 2) 3(3 4 5)\n",
    "3\n(\n0\n1 2)\n3(3\n4 5)",
    "5(1 2 3 4 5)\n3(9 8 7)",
)


@pytest.mark.parametrize("faces", FACES)
@pytest.mark.parametrize("chunk", [1, 1 << 20])
def test_faces_of_one_size_and_of_several(tmp_path, monkeypatch, faces, chunk):
    monkeypatch.setattr(_text, "CHUNK", chunk)
    expected = [
        [int(word) for word in face.split("(")[1].split()] for face in faces.split(")")[:-1]
    ]
    head = "FoamFile { format ascii; class faceList; object faces; }\n"
    (tmp_path / "faces").write_text(f"{head}2\n(\n{faces})\n")
    rows = load_file(tmp_path, "faces").faces()
    assert [rows.values[a:b].tolist() for a, b in itertools.pairwise(rows.starts)] == expected
    for bad in (faces.replace("(", "(9 ", 1), faces.replace("2", "x", 1)):
        (tmp_path / "faces").write_text(f"{head}2\n(\n{bad})\n")
        with pytest.raises(ValueError, match="2 faces expected, each as"):
            load_file(tmp_path, "faces").faces()

"""Ids and their rows in a list, rows of different lengths: against Python's lists."""

import numpy as np
import pytest

from jaxmorph._host.ragged import Ragged
from jaxmorph._host.rows import Rows, first_of_equals

LISTS = ([], [7], [5, 3, 9, 0], [5, 3, 5, 3, 1], [10**12, 4, -3], [4, 10**12, 4])


@pytest.mark.parametrize("ids", LISTS)
def test_rows_are_those_of_a_list(ids):
    rows = Rows(np.array(ids, np.int64))
    wanted = [*ids, 2, -7, 10**13]
    expected = [ids.index(one) if one in ids else -1 for one in wanted]
    assert rows.of(wanted).tolist() == expected
    assert rows.of([wanted, wanted]).tolist() == [expected, expected]
    assert rows.mask(wanted).tolist() == [one in ids for one in wanted]
    assert rows.take(wanted).tolist() == [ids.index(one) for one in ids]
    assert rows.renumbered({"a": wanted})["a"].tolist() == expected
    assert rows.repeated.tolist() == [k for k, one in enumerate(ids) if one in ids[:k]]


def test_first_of_equals_counts_values_and_rows():
    values = np.array([3, 1, 3, 2, 1])
    for table in (values, np.stack([values, values], axis=1)):
        first, place = first_of_equals(table)
        assert first.tolist() == [1, 3, 0]
        np.testing.assert_array_equal(table[first][place], table)


def test_ragged_rows_are_lists():
    lists = [[4, 1], [], [7, 7, 2]]
    rows = Ragged.of(np.concatenate([np.array(each, int) for each in lists]), [2, 0, 3])
    assert len(rows) == 3
    assert rows.sizes.tolist() == [2, 0, 3]
    assert rows.row.tolist() == [0, 0, 2, 2, 2]
    chosen = rows.take(np.array([2, 0, 2]))
    assert np.split(chosen.values, chosen.starts[1:-1])[1].tolist() == [4, 1]
    assert rows.table(np.array([2, 2]), 3).tolist() == [[7, 7, 2]] * 2
    assert rows.column.tolist() == [0, 1, 0, 1, 2]
    assert rows.padded(-1).tolist() == [[4, 1, -1], [-1, -1, -1], [7, 7, 2]]
    assert rows.padded(0, 4).shape == (3, 4)
    assert rows.turned(np.array([True, False, True])).values.tolist() == [1, 4, 2, 7, 7]


def test_counts_cut_a_stream_into_rows():
    rows = Ragged.counted(np.array([2, 8, 9, 0, 1, 5]))
    assert rows.values.tolist() == [8, 9, 5]
    assert rows.starts.tolist() == [0, 2, 2, 3]
    assert Ragged.counted(np.array([1, 8, 9]), more=1).sizes.tolist() == [2]
    assert len(Ragged.counted(np.zeros(0, int))) == 0

"""PLOT3D grids for tests, in every form."""

import numpy as np


def record(data, order):
    mark = np.array([len(data)], f"{order}i4").tobytes()
    return mark + data + mark


def write(path, blocks, form, order="<", width=8, is_multiple=True, blank=False):
    """Returns the path; `blocks` are arrays (d, i, j[, k]); `form` is text, records or plain."""
    sizes = [block.shape[1:] for block in blocks]
    if form == "text":
        words = [f"{len(blocks)}"] if is_multiple else []
        words += [" ".join(map(str, shape)) for shape in sizes]
        for block in blocks:
            words += [
                " ".join(f"{x:.17e}".replace("e", "D") for x in axis.ravel(order="F"))
                for axis in block
            ]
            words += [" ".join(["1"] * block[0].size)] * blank
        path.write_text("\n".join(words) + "\n")
        return path
    close = record if form == "records" else lambda data, order: data
    out = close(np.array([len(blocks)], f"{order}i4").tobytes(), order) if is_multiple else b""
    out += close(np.array(sizes, f"{order}i4").tobytes(), order)
    for block in blocks:
        data = (
            np.concatenate([axis.ravel(order="F") for axis in block])
            .astype(f"{order}f{width}")
            .tobytes()
        )
        out += close(data + np.ones(block[0].size * blank, f"{order}i4").tobytes(), order)
    path.write_bytes(out)
    return path


def box(*counts):
    """Two blocks in 3-D, the second one beyond x = 1 and with its own directions."""
    grids = [np.linspace(0, 1, count) ** 1.5 for count in counts]
    one = np.stack(np.meshgrid(*grids, indexing="ij"))
    two = one + np.array([1.0, 0, 0][: len(counts)]).reshape(-1, *[1] * len(counts))
    return [one, np.swapaxes(two, 1, 2)[:, ::-1]]
